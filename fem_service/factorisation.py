"""Factorisations of a sparse matrix: SuperLU, which comes with SciPy, or PARDISO of Intel's MKL where it is installed.

PARDISO uses all cores and is several times as fast on large laminates; `pip install scalebridge[pardiso]` installs it,
and nothing else has to be said. Both give the same bits whenever they are asked again on one machine; one and the other
differ by rounding.
"""

from __future__ import annotations

import importlib.util
import weakref
from collections.abc import Callable
from typing import Final, Protocol

import numpy as np
import scipy.sparse
import scipy.sparse.linalg
from numpy.typing import NDArray

#: Solves with the matrix that was factorised last: from right-hand sides to solutions, shape (size,).
Solve = Callable[[NDArray[np.float64]], NDArray[np.float64]]

_SINGULAR: Final = "the stiffness is singular, so something can move without force"
# PARDISO's words: a matrix with a symmetric pattern, and where it keeps how many pivots it had to lift off zero.
_SYMMETRIC_PATTERN, _LIFTED_PIVOTS = 1, 14
# MKL's word for results that do not depend on how memory happens to be aligned.
_REPRODUCIBLE = 2


class Factoriser(Protocol):
    """Factorises matrices of one pattern, one after the other.

    Attributes
    ----------
    name : str
    worth : int
        Solutions with other factors that take about as long as a factorisation.
    """

    name: str
    worth: int

    def factorise(self, matrix: scipy.sparse.csc_matrix) -> Solve:
        """Factorise a matrix; raises ValueError where it is singular."""


class SuperLU:
    """SuperLU, on one core."""

    name = "SuperLU"
    worth = 24

    def factorise(self, matrix: scipy.sparse.csc_matrix) -> Solve:
        """See `Factoriser`."""
        try:
            # Stiffnesses are symmetric and nearly always positive definite: the diagonal is pivot enough.
            factors = scipy.sparse.linalg.splu(
                matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=1e-3, options={"SymmetricMode": True}
            )
        except RuntimeError as error:
            raise ValueError(f"{_SINGULAR} ({error})") from None
        solve: Solve = factors.solve
        return solve


class Pardiso:
    """PARDISO, on all cores.

    Raises
    ------
    ImportError
        If it is not installed.
    """

    name = "PARDISO"
    worth = 5

    def __init__(self) -> None:
        from pypardiso import PyPardisoSolver

        self._solver = PyPardisoSolver(mtype=_SYMMETRIC_PATTERN)
        self._solver.libmkl.MKL_CBWR_Set(_REPRODUCIBLE)
        # Its memory is not Python's; at the end of the process it goes by itself.
        weakref.finalize(self, self._solver.free_memory, everything=True).atexit = False

    def factorise(self, matrix: scipy.sparse.csc_matrix) -> Solve:
        """See `Factoriser`."""
        from pypardiso.pardiso_wrapper import PyPardisoError

        try:
            self._solver.factorize(matrix)
        except PyPardisoError as error:
            raise ValueError(f"{_SINGULAR} ({error})") from None
        lifted = int(self._solver.get_iparm(_LIFTED_PIVOTS))
        if lifted:
            raise ValueError(f"{_SINGULAR} ({lifted} pivots are next to zero)")
        return lambda right: self._solver.solve(matrix, right)


def fastest() -> Factoriser:
    """The fastest that is installed."""
    return SuperLU() if importlib.util.find_spec("pypardiso") is None else Pardiso()
