"""One step of the material point method in plain numpy: the scheme of `time_integration`, written to be read.

Shape functions are a sparse matrix S from nodal rows to points, made anew each step, so every pass of the method is
one product: ``S u`` reads nodal velocities at the points, ``S^T (m v)`` gathers momenta.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from .conditions import EdgeCondition
from .damping import Damping
from .errors import SolverError
from .grid import Grid
from .mapping import Points
from .material_points import Body
from .point_table import PointTable
from .reference_boundary import StraightLineRule
from .reference_cracks import StraightCracks
from .reference_shapes import shape_functions
from .scheme import Scheme
from .time_integration import STRAIN_SHARE

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# A node with less than this share of a full node's mass counts as empty.
EMPTY = 1e-30
# An anchor leaves out nodes with less than this share of its heaviest node's mass.
LEAST_MASS_SHARE = 1e-3
# Points are looked at for having left the grid when one may have travelled this share of a cell.
TRAVEL = 0.5


class _Nodes(NamedTuple):
    """The nodes as a step finds them. Rows are those of all velocity fields, field by field."""

    shape: csr_array
    """S (points, rows)."""
    slopes: list[csr_array]
    """Its derivative along each axis [1/m]."""
    mass: FloatArray
    """(rows,) [kg]"""
    velocity: FloatArray
    """S+ of the points' velocities, (rows, d) [m/s]."""
    to_nodes: Callable[[FloatArray], FloatArray]
    """S+, the mass-weighted way from points to nodes."""
    rule: StraightLineRule


class ReferenceStep:
    """The points of a body, and the step that moves them.

    Attributes
    ----------
    table : PointTable
        The points, living ones first.
    alive : int
        How many live.
    travel : float
        Upper bound of any point's way since lost points were last looked for [m].
    totals : (4,) ndarray
        Work of edges, work of interface forces, loss by damping since step 0, and the kinetic energy that the points
        would have, had the way to the nodes and back taken nothing [J].
    strain_velocity : (rows, d) ndarray
        Nodal velocity of the last strain update [m/s].
    pending : float
        Duration of that update as long as the second half of its work is not booked [s].
    reaction : (k,) ndarray
        Force of each edge condition on the body in the last step [N].
    anchor, anchor_displacement, anchor_velocity : (n, d) ndarray
        Reference places [m], displacements [m], velocities over the last step [m/s].
    """

    def __init__(
        self,
        grid: Grid,
        body: Body,
        table: PointTable,
        thickness: float,
        time_step: float,
        edges: Sequence[EdgeCondition],
        cracks: StraightCracks,
        damping: Damping,
        scheme: Scheme,
        started_moving: bool,
    ) -> None:
        self.grid, self.body, self.table, self.scheme, self.damping = grid, body, table, scheme, damping
        self.time_step, self.edges, self.cracks, self._started_moving = time_step, edges, cracks, started_moving
        self._dimension = d = body.dimension
        self._node_counts = tuple(n + 1 for n in grid.cells)
        self._grid_rows = int(np.prod(self._node_counts))
        self._origin = np.asarray(grid.origin)
        densest = max(material.density for material in table.materials)
        self._least_mass = EMPTY * densest * grid.cell_size**d * thickness
        self.alive = body.count
        self.travel = 0.0
        self.totals = np.zeros(4)
        self.strain_velocity = np.zeros((self._grid_rows * cracks.field_count, d))
        self.pending = 0.0
        self.reaction = np.zeros(len(edges))
        self.place_anchors(np.zeros((0, d)), np.zeros((0, d)))

    def place_anchors(self, position: FloatArray, displacement: FloatArray) -> None:
        """Take anchors at reference places (n, d) with the displacements that they have already [m]."""
        self.anchor = position
        self.anchor_displacement, self.anchor_velocity = displacement.copy(), np.zeros_like(position)

    def lonely_anchors(self) -> IntArray:
        """Numbers of anchors that no material reaches at step 0."""
        self.cracks.follow(self.positions_by_id())
        nodes = self._gather(self._edge_motion(0)[2])
        return np.flatnonzero(self._anchor_reader(nodes.mass).sum(axis=1) == 0.0)

    def pending_work(self, number: int) -> float:
        """Work of the internal forces, before step `number`, in the second half of the last strain update [J]."""
        self.cracks.follow(self.positions_by_id())
        return self._pending_work(self._gather(self._edge_motion(number)[2]))

    def _pending_work(self, nodes: _Nodes) -> float:
        return -0.5 * self.pending * float(np.sum(self._stress_divergence(nodes) * self.strain_velocity))

    def advance(self, number: int, push: FloatArray, pull: FloatArray) -> None:
        """Make the step from `number` to `number` + 1.

        Parameters
        ----------
        number : int
        push : (points, d) ndarray
            Forces on points by id [N].
        pull : (n, d) ndarray
            Forces on anchors [N].

        Raises
        ------
        SolverError
            If a point moves by more than a cell.
        """
        dt, scheme, keep = self.time_step, self.scheme, self.damping.grid_factor(self.time_step)
        if self.travel > TRAVEL * self.grid.cell_size:
            self._drop_lost()
        self.cracks.follow(self.positions_by_id())
        before, after, edge_place = self._edge_motion(number)
        nodes = self._gather(edge_place)
        self._book_second_half(nodes)
        share = 0.5 if scheme.integration == "usavg" else 1.0
        if scheme.integration in ("usf", "usavg"):
            self._deform(nodes, self._constrained(nodes, nodes.velocity, before), share * dt)
            nodes = self._gather(edge_place)  # domains that convect have changed
            self._book_second_half(nodes)

        position, velocity = self._part("position"), self._part("velocity")
        push = push[self.table.points.ids[: self.alive]]
        reader = self._anchor_reader(nodes.mass)
        inner = -self._stress_divergence(nodes)
        force = nodes.shape.T @ push + reader.T @ pull + inner
        factor = self.damping.force_factor  # reactions are those of a body of masses over it, see `Damping`
        force *= factor
        free, increment, self.reaction, work, loss = nodes.rule.accelerate(
            nodes.velocity, force, dt, keep, before, after
        )
        self.reaction, work = self.reaction / factor, work / factor
        new = self.cracks.press(nodes.mass, free, dt)
        increment += new - free
        gain = float(np.sum(nodes.mass[:, None] * increment * (new - 0.5 * increment))) / factor
        halfway = 0.5 * (new / keep + new - increment)  # forces do their work with the mean of old and undamped new
        nodes.rule.hold_halfway(halfway, after, keep)
        gain -= dt * float(np.sum(inner * halfway))
        pushed = dt * float(np.sum(push * (nodes.shape @ halfway)))
        given = dt * float(np.sum(pull * (reader @ halfway)))

        carrier = new  # the nodal velocity that moves points and anchors
        filters = scheme.filters(number)
        if not filters:
            velocity += nodes.shape @ increment
        elif scheme.transfer == "xpic":
            velocity[:] = nodes.shape @ (self._filtered(nodes, new - increment, before) + increment)
        else:
            carrier = self._filtered(nodes, new, after)
            velocity[:] = nodes.shape @ carrier
        moved = dt * (nodes.shape @ carrier)
        self._stop_runaway(number, moved)

        if scheme.integration == "usl":
            self._deform(nodes, carrier, dt)
        elif scheme.integration != "usf":
            mapped = self._constrained(nodes, nodes.to_nodes(velocity), after)
            if filters and scheme.transfer == "fmpm":
                mapped += STRAIN_SHARE * (self._filtered(nodes, mapped, after) - mapped)
            self._deform(nodes, mapped, share * dt)
        # Anchors move with the strain: the gradient of their displacement is then the one that the points carry.
        ridden = self.anchor_velocity
        self.anchor_velocity = reader @ (carrier if scheme.integration == "usf" else self.strain_velocity)
        self.anchor_displacement = self.anchor_displacement + dt * self.anchor_velocity
        pulled = 0.5 * dt * float(np.sum(pull * (ridden + self.anchor_velocity)))
        position += moved
        self._part("increment")[:] = moved
        left = self.damping.point_factor(dt)
        lost = (1.0 - left**2) * self.kinetic_energy
        velocity *= left
        self.totals += work, pushed + pulled, loss + lost, gain + pulled - given - lost / factor
        self.travel += float(np.max(np.abs(moved), initial=0.0))

    # ---- between points and nodes ------------------------------------------------------------------

    def _gather(self, edge_place: FloatArray) -> _Nodes:
        """Map the points to the nodes (Eqs 11-13)."""
        shape, slopes = self._matrices()
        weight = self._column("mass")
        mass = shape.T @ weight
        mass[mass <= self._least_mass] = 0.0
        inverse = np.divide(1.0, mass, out=np.zeros_like(mass), where=mass > 0.0)[:, None]

        def to_nodes(values: FloatArray) -> FloatArray:
            return inverse * (shape.T @ (weight[:, None] * values))

        by_field = mass.reshape(self.cracks.field_count, -1)
        splines = self.scheme.interpolation == "bspline"
        rule = StraightLineRule(self.edges, edge_place, self._node_counts, by_field, splines)
        return _Nodes(shape, slopes, mass, to_nodes(self._part("velocity")), to_nodes, rule)

    def _constrained(self, nodes: _Nodes, velocity: FloatArray, edge_velocity: FloatArray) -> FloatArray:
        return self.cracks.press(nodes.mass, nodes.rule.impose(velocity, edge_velocity), self.time_step)

    def _filtered(self, nodes: _Nodes, velocity: FloatArray, edge_velocity: FloatArray) -> FloatArray:
        """Q_k of a nodal velocity: ``u <- v + u - S+ S u``, k - 1 times."""
        field = velocity
        for _ in range(self.scheme.passes):
            field = velocity + field - nodes.to_nodes(nodes.shape @ field)
            field = self._constrained(nodes, field, edge_velocity)
        return field

    def _deform(self, nodes: _Nodes, velocity: FloatArray, duration: float) -> None:
        """Let F grow by the nodal velocity's gradient for a time, and ask the material for stress (Eqs 22-24).

        Books the first half of the work of the internal forces; see `time_integration`.
        """
        self.totals[-1] -= 0.5 * duration * float(np.sum(self._stress_divergence(nodes) * velocity))
        self.strain_velocity, self.pending = velocity, duration
        rate = np.stack([slope @ velocity for slope in nodes.slopes], axis=2)
        gradient = self._gradient()
        gradient += duration * (rate + rate @ gradient)
        self.table.update_stress(slice(0, self.alive))

    def _book_second_half(self, nodes: _Nodes) -> None:
        self.totals[-1] += self._pending_work(nodes)
        self.pending = 0.0

    def _stress_divergence(self, nodes: _Nodes) -> FloatArray:
        """Sum of reference volume times Kirchhoff stress times gradient (Eq 11), (rows, d) [N]."""
        first = self.table.columns.stress
        place = [[0, 2], [2, 1]] if self._dimension == 2 else [[0, 5, 4], [5, 1, 3], [4, 3, 2]]
        volume, rows = self._column("volume")[:, None], self.table.points.rows[: self.alive]
        total = np.zeros((nodes.mass.size, self._dimension))
        for slope, column in zip(nodes.slopes, place, strict=True):
            total += slope.T @ (volume * rows[:, [first + k for k in column]])
        return total

    def _matrices(self) -> tuple[csr_array, list[csr_array]]:
        """Return S and its derivatives [1/m], (points, rows) each."""
        h = self.grid.cell_size
        half = np.repeat(self._column("half")[:, None] / h, self._dimension, axis=1)
        xi = (self._part("position") - self._origin) / h
        if self.scheme.interpolation == "cpgimp":
            half *= np.linalg.norm(self._gradient() + np.eye(self._dimension), axis=2)
            half = np.minimum(half, np.minimum(xi, np.asarray(self.grid.cells) - xi))  # stay in the grid
        node, weight, slope = shape_functions(xi, half, self.scheme.interpolation, self._node_counts)
        reference = self.body.position[self.table.points.ids[: self.alive]]
        field, share = self.cracks.fields(reference, node, 1e-12)
        row = np.hstack([node + self._grid_rows * field, node])
        return (
            self._matrix(row, np.hstack([share * weight, (1.0 - share) * weight])),
            [self._matrix(row, np.hstack([share * s, (1.0 - share) * s]) / h) for s in slope],
        )

    def _anchor_reader(self, mass: FloatArray) -> csr_array:
        """Return the matrix from nodes to anchors: linear functions over nodes that carry material (Eq 32)."""
        xi = (self.anchor + self.anchor_displacement - self._origin) / self.grid.cell_size
        node, weight, _ = shape_functions(xi, np.zeros_like(xi), "linear", self._node_counts)
        row = node + self._grid_rows * self.cracks.fields(self.anchor, node, 0.5)[0]
        heavy = mass[row] > LEAST_MASS_SHARE * mass[row].max(axis=1, keepdims=True, initial=0.0)
        weight = np.where(heavy, weight, 0.0)
        total = weight.sum(axis=1, keepdims=True)
        return self._matrix(row, np.divide(weight, total, out=np.zeros_like(weight), where=total > 0.0))

    def _matrix(self, row: IntArray, weight: FloatArray) -> csr_array:
        size = row.shape[0], self._grid_rows * self.cracks.field_count
        return csr_array((weight.ravel(), row.ravel(), np.arange(row.shape[0] + 1) * row.shape[1]), size)

    # ---- edges and points --------------------------------------------------------------------------

    def _edge_motion(self, number: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Edge velocities of the last step and this one [m/s], and where edges are now [cells from the lowest node]."""
        time = self.time_step * np.arange(number - 1, number + 2, dtype=np.float64)
        way = np.array([edge.displacement(time) for edge in self.edges]).reshape(-1, 3)
        if number == 0:
            way[:, 0] = way[:, 1] - (way[:, 2] - way[:, 1] if self._started_moving else 0.0)
        normal = {e.edge: way[k, 1] for k, e in enumerate(self.edges) if e.component == e.axis}
        place = [
            (self.body.upper if e.sign > 0 else self.body.lower)[e.axis]
            + normal.get(e.edge, 0.0)
            - self._origin[e.axis]
            for e in self.edges
        ]
        speed = np.diff(way, axis=1) / self.time_step
        return speed[:, 0], speed[:, 1], np.array(place) / self.grid.cell_size

    @property
    def kinetic_energy(self) -> float:
        """Of the living points [J]."""
        return 0.5 * float(self._column("mass") @ np.sum(self._part("velocity") ** 2, axis=1))

    def positions_by_id(self) -> FloatArray:
        """Positions of all points [m], (n, d)."""
        return self.table.points.rows[self.table.points.row_of, : self._dimension]

    def _part(self, name: str) -> FloatArray:
        """Columns of a vector of the living points, a view, (n, d)."""
        first = getattr(self.table.columns, name)
        return self.table.points.rows[: self.alive, first : first + self._dimension]

    def _column(self, name: str) -> FloatArray:
        return self.table.points.rows[: self.alive, getattr(self.table.columns, name)]

    def _gradient(self) -> FloatArray:
        """F - I of the living points, a view, (n, d, d)."""
        first, d = self.table.columns.gradient, self._dimension
        return self.table.points.rows[: self.alive, first : first + d * d].reshape(-1, d, d)

    def _drop_lost(self) -> None:
        """Put points within a cell of the grid's border or beyond behind the living ones."""
        xi = (self._part("position") - self._origin) / self.grid.cell_size
        inside = np.all((xi >= 1.0) & (xi < np.asarray(self.grid.cells) - 1.0), axis=1)
        rows, ids, _ = self.table.points
        order = np.concatenate([np.flatnonzero(inside), np.flatnonzero(~inside), np.arange(self.alive, ids.size)])
        before = self.kinetic_energy
        self.table.points = Points(rows[order], ids[order], np.argsort(ids[order]))
        self.alive = int(inside.sum())
        self.totals[-1] += (self.kinetic_energy - before) / self.damping.force_factor
        self.travel = 0.0

    def _stop_runaway(self, number: int, moved: FloatArray) -> None:
        wild = np.flatnonzero(~np.all(np.abs(moved) < self.grid.cell_size, axis=1))
        if wild.size:
            point = int(self.table.points.ids[wild[0]])
            place = tuple(self._part("position")[wild[0]].tolist())
            raise SolverError(
                f"velocity of material point {point} at {place} m runs away in step {number}: next move "
                f"{moved[wild[0]].tolist()} m, above one cell ({self.grid.cell_size:.6g} m) or not finite; lower "
                "time_step or the interface forces",
                number,
                point,
                place,
            )
