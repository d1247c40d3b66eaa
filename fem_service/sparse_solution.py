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
        self._pattern: tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.int32]] | None = None
        self._factored: tuple[NDArray[np.float64], scipy.sparse.linalg.SuperLU] | None = None

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
        whole = np.zeros(matrix.shape[0])
        if not len(self.free):
            return whole
        reduced = self._over_free(matrix)
        if self._factored is None or not np.array_equal(reduced.data, self._factored[0]):
            self._factored = None  # whatever comes of the next one
            self._factored = reduced.data, self._factors(reduced)
        whole[self.free] = self._factored[1].solve(right[self.free])
        return whole

    def _over_free(self, matrix: scipy.sparse.csc_matrix) -> scipy.sparse.csc_matrix:
        """Rows and columns of the free degrees of freedom; where their entries are is found once."""
        if self._pattern is None:
            numbered = scipy.sparse.csc_matrix(
                (np.arange(1, matrix.nnz + 1), matrix.indices, matrix.indptr), shape=matrix.shape
            )
            reduced = numbered[self.free][:, self.free].tocsc()
            reduced.sort_indices()
            self._pattern = reduced.data - 1, reduced.indices, reduced.indptr
        entries, rows, ends = self._pattern
        return scipy.sparse.csc_matrix((matrix.data[entries], rows, ends), shape=(len(self.free), len(self.free)))

    def _factors(self, reduced: scipy.sparse.csc_matrix) -> scipy.sparse.linalg.SuperLU:
        try:
            # Stiffnesses are symmetric and nearly always positive definite: the diagonal is pivot enough.
            factors = scipy.sparse.linalg.splu(
                reduced, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=1e-3, options={"SymmetricMode": True}
            )
        except RuntimeError as error:
            raise ValueError(f"the stiffness is singular, so something can move without force ({error})") from None
        self.factorisations += 1
        return factors
