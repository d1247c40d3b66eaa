"""What a user sees of the material points while a run goes on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .material_points import HXX, HXY, HYX, HYY, MASS, VX, VY, Body, X, Y
from .materials import IsotropicElastic
from .time_integration import Points

FloatArray = NDArray[np.float64]


class PointView:
    """State of the material points, ordered by stable id (the order of ``Body.position``).

    Every property returns a new array.
    """

    def __init__(
        self,
        body: Body,
        material: IsotropicElastic,
        thickness: float,
        points: Points,
        alive: NDArray[np.int64],
    ) -> None:
        self._body = body
        self._material = material
        self._thickness = thickness
        self._points = points
        self._alive = alive

    def _column(self, *columns: int) -> FloatArray:
        rows = self._points.rows[self._points.row_of]
        return np.ascontiguousarray(rows[:, columns[0]] if len(columns) == 1 else rows[:, list(columns)])

    @property
    def count(self) -> int:
        """Number of points, lost ones included."""
        return int(self._points.rows.shape[0])

    @property
    def alive(self) -> NDArray[np.bool_]:
        """False for points that have left the grid, (n,)."""
        return self._points.row_of < self._alive[0]

    @property
    def reference_position(self) -> FloatArray:
        """Positions at step 0 [m], (n, 2)."""
        return self._body.position.copy()

    @property
    def position(self) -> FloatArray:
        """Positions [m], (n, 2)."""
        return self._column(X, Y)

    @property
    def displacement(self) -> FloatArray:
        """Displacements since step 0 [m], (n, 2)."""
        return self.position - self._body.position

    @property
    def velocity(self) -> FloatArray:
        """Velocities [m/s], (n, 2)."""
        return self._column(VX, VY)

    @property
    def displacement_gradient(self) -> FloatArray:
        """F - I, exact for small strains, (n, 2, 2)."""
        return self._column(HXX, HXY, HYX, HYY).reshape(-1, 2, 2)

    @property
    def deformation_gradient(self) -> FloatArray:
        """F, (n, 2, 2)."""
        return self.displacement_gradient + np.eye(2)

    @property
    def strain(self) -> FloatArray:
        """Small strain of Eq 25: xx, yy, tensor xy, (n, 3)."""
        h = self.displacement_gradient
        return np.ascontiguousarray(np.stack([h[:, 0, 0], h[:, 1, 1], 0.5 * (h[:, 0, 1] + h[:, 1, 0])], axis=1))

    @property
    def stress(self) -> FloatArray:
        """Stress of the material, not scaled by the weight: xx, yy, xy [Pa], (n, 3)."""
        return self._material.stress(self.strain)

    @property
    def stress_zz(self) -> FloatArray:
        """Stress across the thickness [Pa], (n,)."""
        return self._material.stress_zz(self.strain)

    @property
    def weight(self) -> FloatArray:
        """Share of mass and stiffness the points carry, (n,)."""
        return self._body.weight.copy()

    @property
    def mass(self) -> FloatArray:
        """Weighted masses [kg], (n,)."""
        return self._column(MASS)

    @property
    def volume(self) -> FloatArray:
        """Current volumes, not scaled by the weight [m^3], (n,) (Eq 29; with the thickness strain)."""
        f = self.deformation_gradient
        strain = self.strain
        thickness = 1.0 - self._material.law().contraction * (strain[:, 0] + strain[:, 1])
        return np.linalg.det(f) * thickness * self._thickness * self._body.point_size**2
