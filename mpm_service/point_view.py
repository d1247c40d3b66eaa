"""What a user sees of the material points while a run goes on."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from .point_table import PointTable

FloatArray = NDArray[np.float64]


class PointView:
    """State of the material points, ordered by stable id (the order of ``Body.position``).

    Points that were split at a level border have further ids at the end. Every property returns a new array.
    """

    def __init__(self, table: PointTable, alive: Callable[[], int]) -> None:
        self._table = table
        self._alive = alive

    def _columns(self, first: int, count: int) -> FloatArray:
        points = self._table.points
        return np.ascontiguousarray(points.rows[points.row_of, first : first + count])

    @property
    def count(self) -> int:
        """Number of points, lost ones included."""
        return self._table.count

    @property
    def alive(self) -> NDArray[np.bool_]:
        """False for points that have left the grid, (n,)."""
        return np.asarray(self._table.points.row_of < self._alive())

    @property
    def reference_position(self) -> FloatArray:
        """Positions at step 0 [m], (n, d)."""
        return self._table.reference.copy()

    @property
    def position(self) -> FloatArray:
        """Positions [m], (n, d)."""
        return self._columns(0, self._table.columns.dimension)

    @property
    def displacement(self) -> FloatArray:
        """Displacements since step 0 [m], (n, d)."""
        return self.position - self._table.reference

    @property
    def velocity(self) -> FloatArray:
        """Velocities [m/s], (n, d)."""
        c = self._table.columns
        return self._columns(c.velocity, c.dimension)

    @property
    def displacement_gradient(self) -> FloatArray:
        """F - I, exact for small strains, (n, d, d)."""
        c = self._table.columns
        return self._columns(c.gradient, c.dimension**2).reshape(-1, c.dimension, c.dimension)

    @property
    def deformation_gradient(self) -> FloatArray:
        """F, (n, d, d)."""
        return self.displacement_gradient + np.eye(self._table.columns.dimension)

    @property
    def strain(self) -> FloatArray:
        """Small strain of Eq 25: xx, yy, tensor xy (n, 3), or xx, yy, zz, yz, xz, xy (n, 6)."""
        h = self.displacement_gradient
        e = 0.5 * (h + h.transpose(0, 2, 1))
        pairs = ((0, 0), (1, 1), (0, 1)) if h.shape[1] == 2 else ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))
        return np.ascontiguousarray(np.stack([e[:, i, j] for i, j in pairs], axis=1))

    @property
    def kirchhoff_stress(self) -> FloatArray:
        """J times Cauchy stress [Pa]: xx, yy, xy (n, 3), or xx, yy, zz, yz, xz, xy (n, 6)."""
        c = self._table.columns
        return self._columns(c.stress, c.mass - c.stress)

    @property
    def volume_ratio(self) -> FloatArray:
        """J = current over reference volume, with the thickness stretch in plane stress, (n,)."""
        return np.asarray(np.linalg.det(self.deformation_gradient) * self._table.by_material("thickness_stretch"))

    @property
    def stress(self) -> FloatArray:
        """Cauchy stress of the material, not scaled by the weight [Pa]; components as `kirchhoff_stress`."""
        return self.kirchhoff_stress / self.volume_ratio[:, None]

    @property
    def stress_zz(self) -> FloatArray:
        """Cauchy stress across the thickness [Pa], (n,)."""
        return self._table.by_material("stress_zz")

    @property
    def strain_energy(self) -> FloatArray:
        """Recoverable energy of each point, scaled by the share of stiffness [J], (n,)."""
        return self._table.by_material("strain_energy")

    @property
    def weight(self) -> FloatArray:
        """Share of mass the points carry, and of stiffness where that has none of its own, (n,)."""
        return self._table.weight.copy()

    @property
    def stiffness(self) -> FloatArray:
        """Share of stiffness the points carry, (n,)."""
        return self._table.stiffness.copy()

    @property
    def material(self) -> NDArray[np.int64]:
        """Number of each point's material, (n,)."""
        return self._table.material.copy()

    @property
    def mass(self) -> FloatArray:
        """Weighted masses [kg], (n,)."""
        return self._columns(self._table.columns.mass, 1)[:, 0]

    @property
    def reference_volume(self) -> FloatArray:
        """Volumes at step 0, scaled by the share of stiffness [m^3], (n,)."""
        return self._columns(self._table.columns.volume, 1)[:, 0]

    @property
    def volume(self) -> FloatArray:
        """Current volumes, not scaled by the weight [m^3], (n,) (Eq 29; with the thickness stretch)."""
        return self.volume_ratio * self.reference_volume / self._table.stiffness

    @property
    def half(self) -> FloatArray:
        """Half sides of the points' domains at step 0 [m], (n,)."""
        return self._columns(self._table.columns.half, 1)[:, 0]
