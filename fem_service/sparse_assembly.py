"""From element matrices to one sparse matrix whose pattern is found once."""

from __future__ import annotations

from collections.abc import Sequence

import numba as nb
import numpy as np
import scipy.sparse
from numpy.typing import NDArray


@nb.njit(nogil=True, cache=True)
def _add(values, places, data):  # type: ignore[no-untyped-def]
    for n in range(len(values)):
        data[places[n]] += values[n]


class SparsePattern:
    """Where the entries of element matrices go in a compressed sparse column matrix over all degrees of freedom.

    Degree of freedom 3 n + i is component i of node n.

    Parameters
    ----------
    groups : sequence of ndarray of int64, shape (elements, nodes per element)
        Elements of each kind, for example bricks and cohesive layers.
    nodes : int
    """

    def __init__(self, groups: Sequence[NDArray[np.int64]], nodes: int) -> None:
        self.size = 3 * nodes
        self._freedoms = [
            (3 * elements[:, :, None] + np.arange(3)).reshape(len(elements), -1).astype(np.int64) for elements in groups
        ]
        keys = []
        for freedom in self._freedoms:
            rows, columns = freedom[:, :, None], freedom[:, None, :]
            keys.append((columns * self.size + rows).reshape(-1))
        unique, places = np.unique(np.concatenate(keys), return_inverse=True)
        self._places = np.split(places.reshape(-1), np.cumsum([len(key) for key in keys])[:-1])
        self._rows = unique % self.size
        self._ends = np.searchsorted(unique // self.size, np.arange(self.size + 1))

    def matrix(self, stiffnesses: Sequence[NDArray[np.float64]]) -> scipy.sparse.csc_matrix:
        """Sum of element matrices, one array of shape (elements, n, n) for each group."""
        data = np.zeros(len(self._rows))
        for stiffness, places in zip(stiffnesses, self._places, strict=True):
            _add(stiffness.reshape(-1), places, data)
        return scipy.sparse.csc_matrix((data, self._rows, self._ends), shape=(self.size, self.size))

    def vector(self, forces: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
        """Sum of element vectors, one array of shape (elements, n) for each group; shape (3 nodes,)."""
        total = np.zeros(self.size)
        for force, freedom in zip(forces, self._freedoms, strict=True):
            _add(force.reshape(-1), freedom.reshape(-1), total)
        return total
