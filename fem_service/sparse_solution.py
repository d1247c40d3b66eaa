"""Sparse systems with some degrees of freedom held: one symbolic pattern, factors that serve many matrices.

From one iteration to the next a laminate changes at the points that have just failed alone. So factors of an earlier
matrix are a good preconditioner for the next: a few steps of GMRES (Saad and Schultz, SIAM J. Sci. Stat. Comput. 7
(1986) 856-869), each one solution with the factors, stand for a factorisation, which costs as much as tens of them.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import scipy.sparse
import scipy.sparse.linalg
from numpy.typing import NDArray

from fem_service.factorisation import Factoriser, Solve, SuperLU

#: Largest residual of a solution by GMRES over the right-hand side.
_ACCURATE: Final = 1e-10


class HeldSystem:
    """Solves K u = f where some u are given.

    Parameters
    ----------
    size : int
        Degrees of freedom.
    held : ndarray of int64, shape (held,)
        Those that are given.
    factoriser : Factoriser, optional
        SuperLU where none is given.

    Attributes
    ----------
    factorisations : int
        How many have been made; a solution with the matrix of the last one makes none.
    reused : int
        Solutions for other matrices that earlier factors were good enough for.

    Raises
    ------
    ValueError
        If a held one is beyond the size or given twice.
    """

    def __init__(self, size: int, held: NDArray[np.int64], factoriser: Factoriser | None = None) -> None:
        if len(np.unique(held)) != len(held):
            raise ValueError("held holds a degree of freedom twice")
        if len(held) and (held.min() < 0 or held.max() >= size):
            raise ValueError(f"held holds {held.min()} to {held.max()}; allowed is 0 to {size - 1}")
        self.held = held
        self.free = np.setdiff1d(np.arange(size), held)
        self.factorisations = self.reused = 0
        self._factoriser = factoriser or SuperLU()
        self._pattern: tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.int32]] | None = None
        self._factored: tuple[NDArray[np.float64], Solve] | None = None
        self._preconditions = False

    def begin(self) -> None:
        """From here on factors are those of the next matrix: what follows does not depend on what went before."""
        self._preconditions = False

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
        whole[self.free] = self._solved(self._over_free(matrix), right[self.free])
        return whole

    def _solved(self, matrix: scipy.sparse.csc_matrix, right: NDArray[np.float64]) -> NDArray[np.float64]:
        if self._factored is not None:
            values, solve = self._factored
            if np.array_equal(matrix.data, values):
                self._preconditions = True
                return solve(right)
            if self._preconditions:
                found = _iterated(matrix, right, solve, self._factoriser.worth)
                if found is not None:
                    self.reused += 1
                    return found
        self._factored = None  # whatever comes of the next one
        solve = self._factoriser.factorise(matrix)
        self.factorisations += 1
        self._factored, self._preconditions = (matrix.data, solve), True
        return solve(right)

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


def _iterated(
    matrix: scipy.sparse.csc_matrix, right: NDArray[np.float64], solve: Solve, steps: int
) -> NDArray[np.float64] | None:
    """Solution by GMRES with the factors of another matrix; None where it takes more steps."""
    preconditioner = scipy.sparse.linalg.LinearOperator(matrix.shape, matvec=solve, dtype=np.float64)
    found, _ = scipy.sparse.linalg.gmres(
        matrix, right, M=preconditioner, rtol=_ACCURATE, atol=0.0, restart=steps, maxiter=1
    )
    off = float(np.linalg.norm(matrix @ found - right))
    return found if off <= 10.0 * _ACCURATE * float(np.linalg.norm(right)) else None
