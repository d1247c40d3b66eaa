"""What a laminate behind the continuum role tells of its plies: which constituent failed first, where, and queries."""

from __future__ import annotations

import numpy as np

from mpm_service.laminate import Laminate
from mpm_service.solver import MaterialPointSolver
from protocol.arrays import FloatArray
from protocol.continuum import ContinuumEvent


class LaminateReports:
    """Watches the plies of a solver.

    Parameters
    ----------
    solver : MaterialPointSolver
    laminate : Laminate
        Its material.
    materials : list of str
        Names of the constituents.
    """

    def __init__(self, solver: MaterialPointSolver, laminate: Laminate, materials: list[str]) -> None:
        self._solver, self._laminate, self._materials = solver, laminate, materials
        self.catch_up()

    def catch_up(self) -> None:
        """Take what has failed so far as told, and count queries from here on."""
        self._told = self.failed().max(axis=0, initial=0.0) > 0.0
        self._laminate.has_failed = False
        self._laminate.queried = self._laminate.spared = 0

    def failed(self) -> FloatArray:
        """Share of the subcells of each material that has failed, (points, directions, materials)."""
        return self._laminate.failed_share(self._solver.histories[0])

    def events(self) -> list[ContinuumEvent]:
        """First failures of each material in plies of each direction since the last call."""
        if not self._laminate.has_failed:
            return []
        self._laminate.has_failed = False
        failed, found = self.failed(), []
        for direction, material in np.argwhere((failed.max(axis=0) > 0.0) & ~self._told):
            share = failed[:, direction, material]
            x, y = self._solver.points.reference_position[int(np.argmax(share))]
            angle = round(float(np.degrees(self._laminate.directions[direction])), 6)
            sentence = (
                f"{self._materials[material]} fails first in the {angle:g} degree plies, at ({x * 1e3:.4g},"
                f" {y * 1e3:.4g}) mm of the undeformed body"
            )
            count = int(np.count_nonzero(share))
            found.append(ContinuumEvent(kind="failure", step=self._solver.step, sentence=sentence, count=count))
            self._told[direction, material] = True
        return found

    def queries(self) -> tuple[int, int]:
        """Plies of points that were asked for and that were spared since the last call."""
        counts = self._laminate.queried, self._laminate.spared
        self._laminate.queried = self._laminate.spared = 0
        return counts
