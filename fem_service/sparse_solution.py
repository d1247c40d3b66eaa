"""Sparse systems with some degrees of freedom held: one symbolic pattern, factors kept while the matrix stays."""

from __future__ import annotations

import numpy as np
import scipy.sparse
import scipy.sparse.linalg
from numpy.typing import NDArray


class HeldSystem:
    """Solves K u = f where some u are given.

    Parameters
    ----------
    size : int
        Degrees of freedom.
    held : ndarray of int64, shape (held,)
        Those that are given.

    Attributes
    ----------
    factorisations : int
        How many have been made; a solution with the matrix of the last one makes none.

    Raises
    ------
    ValueError
        If a held one is beyond the size or given twice.
    """

    def __init__(self, size: int, held: NDArray[np.int64]) -> None:
        if len(np.unique(held)) != len(held):
            raise ValueError("held holds a degree of freedom twice")
        if len(held) and (held.min() < 0 or held.max() >= size):
            raise ValueError(f"held holds {held.min()} to {held.max()}; allowed is 0 to {size - 1}")
        self.held = held
        self.free = np.setdiff1d(np.arange(size), held)
        self.factorisations = 0
        self._entries: NDArray[np.int64] | None = None
        self._reduced: scipy.sparse.csc_matrix | None = None
        self._factor: scipy.sparse.linalg.SuperLU | None = None

    def solve(self, matrix: scipy.sparse.csc_matrix, right: NDArray[np.float64]) -> NDArray[np.float64]:
        """Solution over the free degrees of freedom, with zero at the held ones.

        Parameters
        ----------
        matrix : csc_matrix, shape (size, size)
            Always of the same pattern.
        right : ndarray of float, shape (size,)

        Returns
        -------
        ndarray, shape (size,)

        Raises
        ------
        ValueError
            If the matrix is singular: something can move without force.
        """
        data = self._free_entries(matrix)
        if self._factor is None or self._reduced is None or not np.array_equal(data, self._reduced.data):
            self._factorise(data)
        assert self._factor is not None
        whole = np.zeros(matrix.shape[0])
        whole[self.free] = self._factor.solve(right[self.free])
        return whole

    def _free_entries(self, matrix: scipy.sparse.csc_matrix) -> NDArray[np.float64]:
        if self._entries is None:
            numbered = scipy.sparse.csc_matrix(
                (np.arange(1, matrix.nnz + 1), matrix.indices, matrix.indptr), shape=matrix.shape
            )
            reduced = numbered[self.free][:, self.free].tocsc()
            reduced.sort_indices()
            self._entries = reduced.data - 1
            self._reduced = reduced.astype(np.float64)
            self._reduced.data[:] = np.nan  # not equal to anything yet
        return np.asarray(matrix.data[self._entries], dtype=np.float64)

    def _factorise(self, data: NDArray[np.float64]) -> None:
        assert self._reduced is not None
        self._reduced.data = data
        try:
            # Stiffnesses are symmetric and nearly always positive definite: the diagonal is pivot enough.
            self._factor = scipy.sparse.linalg.splu(
                self._reduced, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=1e-3, options={"SymmetricMode": True}
            )
        except RuntimeError as error:
            self._factor = None
            raise ValueError(f"the stiffness is singular, so something can move without force ({error})") from None
        self.factorisations += 1
