"""Forces from other solvers: anchors that ride on the grid, and interface volume cells of material points."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from . import stencils
from .cracks import CrackSet
from .mapping import Mapping

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# A node with less than this share of the heaviest node an anchor reads moves by its own noise: a sliver of a
# point's domain reaches it. It is left out and the other weights are scaled up.
_LEAST_MASS_SHARE = 1e-3


@njit(cache=True, nogil=True)
def _drop_light_nodes(node: IntArray, weight: FloatArray, count: IntArray, momentum: FloatArray) -> None:
    for a in range(count.size):
        heaviest = 0.0
        for e in range(count[a]):
            heaviest = max(heaviest, momentum[node[a, e], 0])
        total = 0.0
        for e in range(count[a]):
            if not momentum[node[a, e], 0] > _LEAST_MASS_SHARE * heaviest:
                weight[a, e] = 0.0
            total += weight[a, e]
        if total > 0.0:
            for e in range(count[a]):
                weight[a, e] /= total


@njit(cache=True, nogil=True)
def _ride(
    node: IntArray,
    weight: FloatArray,
    count: IntArray,
    motion: FloatArray,
    time_step: float,
    displacement: FloatArray,
    velocity: FloatArray,
) -> None:
    for a in range(count.size):
        for axis in range(displacement.shape[1]):
            v = 0.0
            for e in range(count[a]):
                v += weight[a, e] * motion[node[a, e], axis]
            velocity[a, axis] = v
            displacement[a, axis] += time_step * v


class Anchors:
    """Massless anchors: they read the grid's motion and hand forces back by the same weights.

    Parameters
    ----------
    position : (n, d) ndarray
        Reference positions [m].
    ivc : (n,) ndarray of int
        Interface volume cell of each anchor.
    displacement : (n, d) ndarray, optional
        That they have already [m]; none if not given.

    Attributes
    ----------
    displacement, velocity, force : (n, d) ndarray
        Since registration, plus what they had [m]; of the last step [m/s]; on the continuum now [N].
    work : float
        Done by the forces on the anchors since registration [J]: force times the mean of the ways that the anchors
        make in the step before and in that of the force.
    """

    def __init__(
        self,
        position: FloatArray,
        ivc: IntArray,
        mapping: Mapping,
        cracks: CrackSet | None,
        displacement: FloatArray | None = None,
    ) -> None:
        self.position = position
        self.ivc = ivc
        self.displacement = np.zeros_like(position) if displacement is None else displacement.copy()
        self.velocity = np.zeros_like(position)
        self.force = np.zeros_like(position)
        self.work = 0.0
        self._given = 0.0  # work of the forces on the nodes in this step [J]
        self._mapping = mapping
        self._cracks = cracks
        self._node = np.zeros((len(position), 1), dtype=np.int64)
        self._weight = np.zeros((len(position), 1))
        self._count = np.zeros(len(position), dtype=np.int64)

    def weigh(self, momentum: FloatArray) -> FloatArray:
        """Find nodes and weights at the present places; returns the sums of weights, 0 without material, (n,)."""
        node, weight, count = self._mapping.stencils_at(self.position + self.displacement)
        if self._cracks is not None:
            self._cracks.assign_fields_at(self.position, node, count)
        self._mapping.list_nodes(node, count)
        _drop_light_nodes(node, weight, count, momentum)
        self._node, self._weight, self._count = node, weight, count
        return np.asarray(weight.sum(axis=1))

    def add_forces(self, step: int, momentum: FloatArray) -> None:
        """Put the forces on the nodes that carry material around the anchors."""
        if self.position.size:
            self.weigh(momentum)
            stencils.add_forces(self._node, self._weight, self._count, self.force, momentum)

    def book(self, momentum: FloatArray, halfway: FloatArray, duration: float) -> None:
        """Keep what work the forces do on the nodes, for `follow`."""
        if self.position.size:
            self._given = duration * stencils.power_of(self._node, self._weight, self._count, self.force, halfway)

    def follow(self, motion: FloatArray, time_step: float) -> float:
        """Move with the nodes; returns by how much the work on the anchors exceeds that on the nodes [J]."""
        if not self.position.size:
            return 0.0
        before = self.velocity.copy()
        _ride(self._node, self._weight, self._count, motion, time_step, self.displacement, self.velocity)
        done = 0.5 * time_step * float(np.sum(self.force * (before + self.velocity)))
        self.work += done
        return done - self._given


class CellForces:
    """Forces on interface volume cells (IVC), spread evenly over the points of each (Eq 87).

    Parameters
    ----------
    mapping : Mapping
    cells : sequence of (k,) ndarray of int
        Ids of the points of each cell.

    Attributes
    ----------
    work : float
        Done by the forces on the nodes since the start [J].
    """

    def __init__(self, mapping: Mapping, cells: Sequence[IntArray]) -> None:
        self.cells = list(cells)
        self.work = 0.0
        self._mapping = mapping
        self._ids = np.zeros(0, dtype=np.int64)
        self._force = np.zeros((0, mapping.columns.dimension))

    def set_forces(self, force: FloatArray | None) -> None:
        """Set the force on each cell (m, d) [N], or none; lost points take no share."""
        ids, shares = [], []
        row_of = self._mapping.points.row_of
        for points, total in zip(self.cells, force if force is not None else (), strict=force is not None):
            living = points[row_of[points] < self._mapping.alive]
            if living.size:
                ids.append(living)
                shares.append(np.broadcast_to(total / living.size, (living.size, len(total))))
        self._ids = np.concatenate(ids) if ids else np.zeros(0, dtype=np.int64)
        self._force = (
            np.ascontiguousarray(np.concatenate(shares)) if ids else np.zeros((0, self._mapping.columns.dimension))
        )

    def add_forces(self, step: int, momentum: FloatArray) -> None:
        """Put the forces on the nodes by the shape functions of the points."""
        if self._ids.size:
            self._mapping.scatter_point_forces(self._mapping.points.row_of[self._ids], self._force, momentum)

    def book(self, momentum: FloatArray, halfway: FloatArray, duration: float) -> None:
        """Add the work of the forces on the nodes."""
        if self._ids.size:
            velocity = self._mapping.read_points(self._mapping.points.row_of[self._ids], halfway)
            self.work += duration * float(np.sum(self._force * velocity))
