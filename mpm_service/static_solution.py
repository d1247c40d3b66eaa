"""Equilibrium of a body under loads and edges that stay as they are, by Newton's method on the nodes of the grid.

An iteration is a step without inertia. At the present places of the points the nodes have forces f, internal ones and
loads, and a stiffness K; what prescribed motion leaves free, ``u = T q + g``, follows from

    (T' K T + s M) q = T' (f - K g),

and u moves and deforms the points as the velocities of a step do. So what ends as equilibrium here is what a step of
a run measures as such, and the run stays at rest.

The part s M, mass times a number so small that the lowest mode of a compact body is 1e-8 of it stiffer, stands in for
supports: a body that nothing holds takes no rigid motion, in the mean over its mass, which is what dynamic relaxation
from rest does too. It changes the way, not the end: the forces must vanish whatever K is. Nodes that a sliver of a
domain reaches need nothing more: their force falls with the sliver as the square root of their stiffness does, and
the points feel their displacement by that root again. They are scaled by their own stiffness, and left out only where
round-off has eaten it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, csc_matrix, diags
from scipy.sparse.linalg import splu

from . import nodes as node_kernels
from .boundary_set import Constraints
from .errors import SolverError
from .interface import Anchors
from .point_table import PointTable
from .static_contact import ClosedFaces
from .static_stiffness import assemble_stiffness
from .time_integration import TimeIntegration

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

# Stiffness that stands in for supports, over the largest of a node.
_SUPPORT = 1e-8
# A component with less than this share of the largest stiffness of a node is left out.
_LEAST_STIFFNESS = 1e-14
# Largest displacement gradient of an iteration; a larger one is cut to it.
_LARGEST_GRADIENT = 0.5
# Rounds of an iteration in which crack faces are closed and let go.
_ROUNDS = 20


@dataclass(frozen=True)
class Equilibrium:
    """How a static solution ended.

    Attributes
    ----------
    residual : float
        Norm of the out-of-balance forces over the largest of those of internal forces, loads, and reactions.
    steps : int
        Iterations made.
    converged : bool
        Did the residual fall below the tolerance?
    """

    residual: float
    steps: int
    converged: bool


class StaticSolution:
    """Newton's method on the parts of a solver.

    Parameters
    ----------
    run : TimeIntegration
        With an approach of its faces, see `boundary_set.BoundarySet`.
    table : PointTable
    anchors : Anchors
        They ride along.
    sort : callable
        Sorts the points and lists the nodes that they reach.
    """

    def __init__(self, run: TimeIntegration, table: PointTable, anchors: Anchors, sort: Callable[[], None]) -> None:
        self._run = run
        self._table = table
        self._anchors = anchors
        self._sort = sort
        #: Share of their approach that the faces of the body have made.
        self._share = 0.0
        #: Forces between closed crack faces.
        self._pressing: dict[int, FloatArray] = {}

    def solve(self, tolerance: float, max_steps: int, told: Callable[[int], None]) -> Equilibrium:
        """Iterate until the residual is at most the tolerance.

        Raises
        ------
        SolverError
            If nothing holds the body against its loads, a point leaves the grid, or the system cannot be solved.
        """
        self._run.mapping.tabulates_all = True
        done = 0
        while True:
            told(done)
            system = self._gather()
            if (self._share == 1.0 and system.residual <= tolerance) or done == max_steps:
                return Equilibrium(system.residual, done, self._share == 1.0 and system.residual <= tolerance)
            displacement = system.solve(self._stiffness(system.number, system.rows.size))
            self._pressing = system.faces.forces if system.faces is not None else {}
            self._move(system.rows, displacement)
            done += 1

    def _gather(self) -> _System:
        """Bring points and nodes up to their places, and the forces on the nodes."""
        run = self._run
        if run.cracks is not None:
            run.cracks.follow()
        self._sort()
        mapping, momentum = run.mapping, run.nodes.momentum
        if mapping.alive < self._table.count:
            lost, point = self._table.count - mapping.alive, int(mapping.points.ids[-1])
            place = tuple(mapping.points.rows[-1, : mapping.columns.dimension].tolist())
            raise SolverError(
                f"statics: {lost} points leave the grid, one to {place} m: nothing holds the body against its loads, "
                "or the grid has no room for the motion of its faces",
                0,
                point,
                place,
            )
        mapping.tabulate(0)
        if run.cracks is None:
            run.boundary.approach_between(self._share, 1.0)
        else:
            run.boundary.approach_between(self._share, 1.0, run.cracks.field_map)
        node_kernels.clear(mapping.active, momentum)
        mapping.scatter_state(momentum)
        dimension = mapping.columns.dimension
        pull = slice(1 + dimension, 1 + 2 * dimension)
        internal = momentum[:, pull].copy()
        for load in run.loads:
            load.add_forces(0, momentum)
        active = mapping.active
        node_kernels.drop_slivers(active, momentum, run.least_mass)
        rows = active[momentum[active, 0] > 0.0]
        number = np.full(momentum.shape[0], -1, dtype=np.int64)
        number[rows] = np.arange(rows.size)
        faces = None
        if run.cracks is not None:
            faces = ClosedFaces(run.cracks.facing(momentum), number, rows.size, self._pressing)
        return _System(
            rows,
            number,
            momentum[rows, 0],
            internal[rows].ravel(),
            (momentum[rows, pull] - internal[rows]).ravel(),
            (rows >= mapping.levels.offset[-2]) & (rows < mapping.levels.offset[-1]),
            run.boundary.constraints(momentum),
            faces,
        )

    def _stiffness(self, number: IntArray, count: int) -> csc_matrix:
        mapping, table = self._run.mapping, self._table
        first = mapping.tabulated.first
        rows, ids = table.points.rows[first : mapping.alive], table.points.ids[first : mapping.alive]
        return assemble_stiffness(
            mapping.tabulated,
            number,
            count,
            np.ascontiguousarray(rows[:, mapping.columns.volume]),
            table.tangent(rows, ids),
            rows[:, mapping.columns.stress : mapping.columns.mass],
        )

    def _move(self, rows: IntArray, displacement: FloatArray) -> None:
        """Move and deform the points by nodal displacements [m], cut where they deform them too much."""
        run = self._run
        mapping = run.mapping
        dimension = mapping.columns.dimension
        motion = run.nodes.motion
        node_kernels.clear(mapping.active, motion)
        motion[rows, :dimension] = displacement.reshape(-1, dimension)
        stencils = mapping.tabulated
        valid = np.arange(stencils.node.shape[1]) < stencils.entries[:, None]
        steep = np.einsum("pka,pkb->pab", np.where(valid[:, :, None], motion[stencils.node, :dimension], 0.0),
                          stencils.gradient)  # fmt: skip
        share = min(1.0, _LARGEST_GRADIENT / max(float(np.abs(steep).max()), 1e-300))
        motion[rows, :dimension] *= share
        mapping.update_deform(motion, 1.0, 1.0, run.stress)
        self._anchors.follow(motion, 1.0)
        self._anchors.velocity[:] = 0.0
        if run.cracks is not None:
            run.cracks.move(mapping.points.rows, mapping.points.row_of)
        self._share += share * (1.0 - self._share)


class _System:
    """Forces on the nodes and what holds them.

    Attributes
    ----------
    rows : (n,) ndarray of int
        Rows of the nodal tables that carry material.
    number : (R,) ndarray of int
        Their numbers, -1 for the other rows.
    faces : ClosedFaces or None
    residual : float
    """

    def __init__(
        self,
        rows: IntArray,
        number: IntArray,
        mass: FloatArray,
        internal: FloatArray,
        external: FloatArray,
        centre: BoolArray,
        held: Constraints,
        faces: ClosedFaces | None,
    ) -> None:
        self.rows, self.number, self.faces = rows, number, faces
        dimension = internal.size // max(rows.size, 1)
        self._mass = np.repeat(mass, dimension)
        self._centre = np.repeat(centre, dimension)
        self._force = internal + external
        follower = dimension * number[held.node] + held.component
        self._offset = np.zeros(internal.size)
        self._offset[follower] = (1.0 - held.ratio) * held.motion
        free = np.ones(internal.size, dtype=bool)
        free[follower] = False
        place = np.cumsum(free) - 1
        leading = held.free >= 0
        leader = dimension * number[held.free[leading]] + held.component[leading]
        own = np.flatnonzero(free)
        self._free = csc_matrix(
            coo_matrix(
                (
                    np.concatenate([np.ones(own.size), held.ratio[leading]]),
                    (np.concatenate([own, follower[leading]]), np.concatenate([place[own], place[leader]])),
                ),
                shape=(internal.size, own.size),
            )
        )
        component = own % dimension
        self._loose = [component == a for a in range(dimension) if not np.any(held.component == a)]
        self._own = own
        reaction = (1.0 - held.ratio) * self._force[follower]
        scale = max(float(np.linalg.norm(part)) for part in (internal, external, reaction))
        unbalanced = self._force if faces is None else self._force + faces.push
        self.residual = float(np.linalg.norm(self._free.T @ unbalanced)) / scale if scale > 0.0 else 0.0

    def solve(self, stiffness: csc_matrix) -> FloatArray:
        """Return displacements that would bring the forces to balance [m], (n d,)."""
        if self.faces is None:
            return self._solve(stiffness, self._force, float(stiffness.diagonal().max()))
        stiff = stiffness.diagonal().reshape(self.rows.size, -1).max(axis=1)
        for _ in range(_ROUNDS):
            springs = self.faces.springs(stiff)
            reach = springs.reach.T
            stiffened = stiffness + reach @ diags(springs.stiffness) @ springs.reach
            force = self._force + reach @ (springs.force - springs.stiffness * springs.gap)
            found = self._solve(stiffened, force, float(stiff.max()))
            if self.faces.settle(springs, found):
                break
        return found

    def _solve(self, stiffness: csc_matrix, force: FloatArray, stiffest: float) -> FloatArray:
        """Solve; ``stiffest`` is the largest stiffness of a node, springs not counted [N/m]."""
        free = self._free
        matrix = (free.T @ stiffness @ free).tocsc()
        stiff = matrix.diagonal()
        mass = (free.T @ diags(self._mass) @ free).diagonal()
        kept = stiff > _LEAST_STIFFNESS * stiffest
        if not np.any(kept):
            return self._offset
        pull = (free.T @ (force - stiffness @ self._offset))[kept]
        # What the components that are left out bear would let a body that nothing holds drift, a little in each
        # iteration: it is spread over the mass.
        for loose in self._loose:
            mine = loose[kept]
            pull[mine] -= mass[kept][mine] * (pull[mine].sum() / mass[kept][mine].sum())
        support = _SUPPORT * stiffest / mass.sum() * mass
        matrix = matrix[kept][:, kept] + diags(support[kept])
        scale = 1.0 / np.sqrt(stiff[kept] + support[kept])
        scaled = (diags(scale) @ matrix @ diags(scale)).tocsc()
        factors = splu(scaled, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        found = np.zeros(kept.size)
        found[kept] = scale * factors.solve(scale * pull)
        for loose in self._loose:
            mine = loose & kept & self._centre[self._own]
            if np.any(mine):
                found[loose] -= np.average(found[mine], weights=mass[mine])
        return np.asarray(free @ found + self._offset)
