"""The load set of a solver, as one of the loads that a step puts on the nodes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .cracks import CrackSet
from .load_set import LoadSet
from .mapping import Mapping

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


class AppliedLoads:
    """Tractions, body forces and absorbing edges.

    Attributes
    ----------
    work : float
        Done by all of them since the start [J].
    """

    def __init__(self, loads: LoadSet, mapping: Mapping, cracks: CrackSet | None) -> None:
        self.work = 0.0
        self._loads = loads
        self._mapping = mapping
        self._cracks = cracks

    def add_forces(self, step: int, momentum: FloatArray) -> None:
        """Apply all loads; after all other forces, since dashpots look at them."""
        mapping = self._mapping
        points = mapping.points
        self._loads.apply(
            step,
            points.rows,
            points.row_of,
            mapping.alive,
            momentum,
            (mapping.active,),
            self._stencils_at,
            lambda rows, force: mapping.scatter_point_forces(rows, force, momentum),
        )

    def book(self, momentum: FloatArray, halfway: FloatArray, duration: float) -> None:
        """Add the work of all loads on the nodes."""
        mapping = self._mapping
        power = self._loads.power(halfway, momentum, (mapping.active,), mapping.read_points)
        self.work += duration * float(power.sum())

    def set_points(self, reference: FloatArray) -> None:
        """Take the reference places of all points (n, d) [m] after some were split."""
        self._loads.set_points(reference)

    def _stencils_at(
        self, position: FloatArray, half: FloatArray, reference: FloatArray
    ) -> tuple[IntArray, FloatArray, IntArray]:
        node, weight, count = self._mapping.stencils_at(position, half)
        if self._cracks is not None:
            self._cracks.assign_fields_at(reference, node, count)
        self._mapping.list_nodes(node, count)
        return node, weight, count
