"""Acceleration of an iteration that creeps: Anderson's mixing of the last steps.

D. G. Anderson, J. ACM 12 (1965) 547-560; H. F. Walker and P. Ni, SIAM J. Numer. Anal. 49 (2011) 1715-1735.

With secant stiffnesses, which softening points answer, each iteration leaves a nearly constant part of the error: steps
f_k at places x_k fall off in geometric series. Weights g that make f_k - (differences of f) g as short as can be tell
how much of the last steps was too short; the place goes on by f_k - (differences of x and f) g.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

#: Steps that are mixed.
_DEPTH: Final = 5
#: Differences of steps that are this close to being dependent, relative, count as dependent.
_DEPENDENT: Final = 1e-10


class Acceleration:
    """Mixes the steps of one increment."""

    def __init__(self) -> None:
        self._places: list[NDArray[np.float64]] = []
        self._steps: list[NDArray[np.float64]] = []

    def forget(self) -> None:
        """Start anew: the equations have changed, as where something failed for good."""
        self._places.clear()
        self._steps.clear()

    def mixed(
        self, place: NDArray[np.float64], step: NDArray[np.float64], force: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """The step to take from a place, of the one that the stiffness there gives and of those before.

        Parameters
        ----------
        place, step, force : ndarray of float, shape (unknowns,)
            The force is that which the step is to balance.

        Returns
        -------
        ndarray, shape (unknowns,)
            The step as it was, and nothing remembered, where the mixed one would go against the force.
        """
        self._places = [*self._places[-_DEPTH:], place]
        self._steps = [*self._steps[-_DEPTH:], step]
        if len(self._steps) == 1:
            return step
        moved, changed = (np.diff(np.array(values), axis=0).T for values in (self._places, self._steps))
        weights = np.linalg.lstsq(changed, step, rcond=_DEPENDENT)[0]
        mixed = step - (moved + changed) @ weights
        if float(mixed @ force) <= 0.0:
            self.forget()
            return step
        return np.asarray(mixed)
