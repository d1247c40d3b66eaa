"""The material point method in plain numpy: the same scheme as `time_integration`, written to be read.

Shape functions are sparse matrices S from nodal rows to points, made anew each step, so every pass of the method is
one product: ``S u`` reads nodal velocities at the points, ``S^T (m v)`` gathers momenta. No arithmetic is shared with
the compiled sweeps, which makes this solver their independent judge, one to two orders of magnitude slower.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array

from .conditions import EdgeCondition
from .crack_line import Crack
from .damping import Damping
from .errors import SolverError
from .grid import Grid
from .mapping import Points
from .material import Material
from .material_points import Body
from .point_table import PointTable
from .point_view import PointView
from .reference_boundary import StraightLineRule
from .reference_cracks import StraightCracks
from .reference_shapes import shape_functions
from .scheme import Scheme
from .solver import Energies
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


class ReferenceSolver:
    """Material point solver in numpy and scipy.sparse, with the interface of `MaterialPointSolver`.

    Parameters are those of `MaterialPointSolver`. A uniform grid, edge conditions, straight frictionless cracks clear
    of one another, all damping, anchors and interface cells are supported; other loads and conditions are not.

    Raises
    ------
    ValueError
        If a value is outside its range or not supported; the message names it.
    """

    def __init__(
        self,
        grid: Grid,
        body: Body,
        material: Material | Sequence[Material],
        thickness: float,
        time_step: float,
        edge_conditions: Sequence[EdgeCondition] = (),
        cracks: Sequence[Crack] = (),
        damping: Damping | float = 0.0,
        initial_velocity_gradient: ArrayLike | None = None,
        *,
        scheme: Scheme | None = None,
        loads: Sequence[object] = (),
        initial_velocity: ArrayLike | None = None,
        threads: int = 1,
    ) -> None:
        self.grid, self.body, self.scheme = grid, body, scheme or Scheme()
        self.materials = (material,) if isinstance(material, Material) else tuple(material)
        self.thickness, self.time_step = float(thickness), float(time_step)
        self.damping = damping if isinstance(damping, Damping) else Damping(grid_rate=float(damping))
        self.edge_conditions = tuple(edge_conditions)
        if not 0.0 < self.time_step <= self.stable_time_step:
            raise ValueError(f"time_step = {time_step!r} s: must be above 0 and at most {self.stable_time_step:.6g} s")
        for name, given in (("grid", not isinstance(grid, Grid)), ("loads", len(loads) > 0), ("threads", threads != 1)):
            if given:
                raise ValueError(f"{name}: the reference solver has uniform grids, no loads, one thread")
        for k, condition in enumerate(self.edge_conditions):
            if not isinstance(condition, EdgeCondition):
                raise ValueError(f"edge_conditions[{k}]: the reference solver has conditions on edges only")
        self._dimension = d = body.dimension
        self._node_counts = tuple(n + 1 for n in grid.cells)
        self._grid_rows = int(np.prod(self._node_counts))
        self._origin = np.asarray(grid.origin)
        densest = max(m.density for m in self.materials)
        self._least_mass = EMPTY * densest * grid.cell_size**d * self.thickness
        self._table = PointTable(body, self.materials, self.thickness)
        self._alive = body.count
        self.points = PointView(self._table, lambda: self._alive)
        self._started_moving = initial_velocity_gradient is not None
        velocity = self._part("velocity")
        if initial_velocity_gradient is not None:
            velocity += body.position @ np.asarray(initial_velocity_gradient, dtype=np.float64).T
        if initial_velocity is not None:
            velocity += np.asarray(initial_velocity, dtype=np.float64)
        self._cracks = StraightCracks(cracks, grid, body.position)
        self._step = 0
        self._travel = 0.0
        self._totals = np.zeros(3)
        self.edge_reaction = np.zeros(len(self.edge_conditions))
        self._place_anchors(np.zeros((0, d)))
        self._cells: list[IntArray] = []
        self._edge_place = self._edge_motion()[2]

    # ---- what a run can ask ------------------------------------------------------------------------

    @property
    def step(self) -> int:
        """Steps done."""
        return self._step

    @property
    def time(self) -> float:
        """Time [s], steps times time step."""
        return self._step * self.time_step

    @property
    def courant_number(self) -> float:
        """Fastest wave speed at rest times time step over the cell size (Eq 31)."""
        return max(m.pressure_wave_speed for m in self.materials) * self.time_step / self.grid.cell_size

    @property
    def stable_time_step(self) -> float:
        """Largest allowed time step [s]."""
        fastest = max(m.pressure_wave_speed for m in self.materials)
        return self.scheme.courant_limit * self.grid.cell_size / fastest

    @property
    def points_lost(self) -> int:
        """Points that have left the grid and take no further part."""
        return self.body.count - self._alive

    def energies(self) -> Energies:
        """Energies now and work so far [J]."""
        alive = self.points.alive
        kinetic = 0.5 * self.points.mass[alive] @ np.sum(self.points.velocity[alive] ** 2, axis=1)
        strain = np.sum(self.points.strain_energy[alive])
        edge_work, interface_work, damping_loss = (float(value) for value in self._totals)
        dissipated = float(np.sum(self._table.by_material("dissipated")))
        return Energies(float(kinetic), float(strain), edge_work, interface_work, 0.0, damping_loss, 0.0, dissipated)

    # ---- coupling ----------------------------------------------------------------------------------

    def register_anchors(self, position: ArrayLike, ivc: ArrayLike) -> None:
        """Place massless anchors at reference positions (n, d) [m] before the first step."""
        self._place_anchors(np.array(position, dtype=np.float64).reshape(-1, self._dimension))
        self._cracks.follow(self.points.position)
        lonely = np.flatnonzero(self._anchor_reader(self._gather().mass).sum(axis=1) == 0.0)
        if lonely.size:
            raise ValueError(f"position[{lonely[0]}]: no material point reaches the cell of this anchor")

    def register_interface_cells(self, lower: ArrayLike, upper: ArrayLike) -> IntArray:
        """Find the points between lower and upper corners (m, d) [m]; returns how many each cell has, (m,)."""
        place = self.body.position
        boxes = zip(np.asarray(lower), np.asarray(upper), strict=True)
        self._cells = [np.flatnonzero(np.all((place >= low) & (place < high), axis=1)) for low, high in boxes]
        return np.array([cell.size for cell in self._cells], dtype=np.int64)

    def _place_anchors(self, position: FloatArray) -> None:
        self._anchor = position
        self.anchor_displacement, self.anchor_velocity = np.zeros_like(position), np.zeros_like(position)

    def advance(self, steps: int, ivc_force: ArrayLike | None = None, anchor_force: ArrayLike | None = None) -> None:
        """Advance under forces on cells (m, d) and anchors (n, d) [N] that stay constant meanwhile."""
        push = np.zeros_like(self.body.position)
        if ivc_force is not None:
            alive = self.points.alive
            for cell, total in zip(self._cells, np.asarray(ivc_force, dtype=np.float64), strict=True):
                living = cell[alive[cell]]
                push[living] += total / max(living.size, 1)
        pull = np.zeros_like(self._anchor) if anchor_force is None else np.asarray(anchor_force, dtype=np.float64)
        for _ in range(steps):
            self._advance(push, pull)
            self._step += 1

    # ---- the step ----------------------------------------------------------------------------------

    def _advance(self, push: FloatArray, pull: FloatArray) -> None:
        dt, scheme, keep = self.time_step, self.scheme, self.damping.grid_factor(self.time_step)
        if self._travel > TRAVEL * self.grid.cell_size:
            self._drop_lost()
        self._cracks.follow(self.points.position)
        before, after, self._edge_place = self._edge_motion()
        nodes = self._gather()
        share = 0.5 if scheme.integration == "usavg" else 1.0
        if scheme.integration in ("usf", "usavg"):
            self._deform(nodes, self._constrained(nodes, nodes.velocity, before), share * dt)
            nodes = self._gather()  # domains that convect have changed

        position, velocity = self._part("position"), self._part("velocity")
        push = push[self._table.points.ids[: self._alive]]
        reader = self._anchor_reader(nodes.mass)
        force = nodes.shape.T @ push + reader.T @ pull - self._stress_divergence(nodes)
        force *= self.damping.force_factor
        free, increment, self.edge_reaction, work, loss = nodes.rule.accelerate(
            nodes.velocity, force, dt, keep, before, after
        )
        new = self._cracks.press(nodes.mass, free, dt)
        increment += new - free

        carrier = new  # the nodal velocity that moves points and anchors
        filters = scheme.filters(self._step)
        if not filters:
            velocity += nodes.shape @ increment
        elif scheme.transfer == "xpic":
            velocity[:] = nodes.shape @ (self._filtered(nodes, nodes.velocity, before) + increment)
        else:
            carrier = self._filtered(nodes, new, after)
            velocity[:] = nodes.shape @ carrier
        moved = dt * (nodes.shape @ carrier)
        self._stop_runaway(moved)
        self.anchor_velocity = reader @ carrier
        self.anchor_displacement = self.anchor_displacement + dt * self.anchor_velocity
        pushed = float(np.sum(push * moved) + dt * np.sum(pull * self.anchor_velocity))

        if scheme.integration == "usl":
            self._deform(nodes, carrier, dt)
        elif scheme.integration != "usf":
            mapped = self._constrained(nodes, nodes.to_nodes(velocity), after)
            if filters and scheme.transfer == "fmpm":
                mapped += STRAIN_SHARE * (self._filtered(nodes, mapped, after) - mapped)
            self._deform(nodes, mapped, share * dt)
        position += moved
        self._part("increment")[:] = moved
        factor = self.damping.point_factor(dt)
        loss += 0.5 * (1.0 - factor**2) * float(self._column("mass") @ np.sum(velocity**2, axis=1))
        velocity *= factor
        self._totals += work, pushed, loss
        self._travel += float(np.max(np.abs(moved), initial=0.0))

    def _gather(self) -> _Nodes:
        """Map the points to the nodes (Eqs 11-13)."""
        shape, slopes = self._matrices()
        weight = self._column("mass")
        mass = shape.T @ weight
        mass[mass <= self._least_mass] = 0.0
        inverse = np.divide(1.0, mass, out=np.zeros_like(mass), where=mass > 0.0)[:, None]

        def to_nodes(values: FloatArray) -> FloatArray:
            return inverse * (shape.T @ (weight[:, None] * values))

        by_field = mass.reshape(self._cracks.field_count, -1)
        rule = StraightLineRule(self.edge_conditions, self._edge_place, self._node_counts, by_field)
        return _Nodes(shape, slopes, mass, to_nodes(self._part("velocity")), to_nodes, rule)

    def _constrained(self, nodes: _Nodes, velocity: FloatArray, edge_velocity: FloatArray) -> FloatArray:
        return self._cracks.press(nodes.mass, nodes.rule.impose(velocity, edge_velocity), self.time_step)

    def _filtered(self, nodes: _Nodes, velocity: FloatArray, edge_velocity: FloatArray) -> FloatArray:
        """Q_k of a nodal velocity: ``u <- v + u - S+ S u``, k - 1 times."""
        field = velocity
        for _ in range(self.scheme.passes):
            field = velocity + field - nodes.to_nodes(nodes.shape @ field)
            field = self._constrained(nodes, field, edge_velocity)
        return field

    def _deform(self, nodes: _Nodes, velocity: FloatArray, duration: float) -> None:
        """Let F grow by the nodal velocity's gradient for a time, and ask the material for stress (Eqs 22-24)."""
        rate = np.stack([slope @ velocity for slope in nodes.slopes], axis=2)
        gradient = self._gradient()
        gradient += duration * (rate + rate @ gradient)
        self._table.update_stress(slice(0, self._alive))

    def _stress_divergence(self, nodes: _Nodes) -> FloatArray:
        """Sum of reference volume times Kirchhoff stress times gradient (Eq 11), (rows, d) [N]."""
        first = self._table.columns.stress
        place = [[0, 2], [2, 1]] if self._dimension == 2 else [[0, 5, 4], [5, 1, 3], [4, 3, 2]]
        volume = self._column("volume")[:, None]
        stress = self._table.points.rows[: self._alive]
        return sum(
            slope.T @ (volume * stress[:, [first + k for k in column]])
            for slope, column in zip(nodes.slopes, place, strict=True)
        )

    # ---- matrices ----------------------------------------------------------------------------------

    def _matrices(self) -> tuple[csr_array, list[csr_array]]:
        """Return S and its derivatives [1/m], (points, rows) each."""
        h = self.grid.cell_size
        half = np.repeat(self._column("half")[:, None] / h, self._dimension, axis=1)
        xi = (self._part("position") - self._origin) / h
        if self.scheme.interpolation == "cpgimp":
            half *= np.linalg.norm(self._gradient() + np.eye(self._dimension), axis=2)
            half = np.minimum(half, np.minimum(xi, np.asarray(self.grid.cells) - xi))  # stay in the grid
        node, weight, slope = shape_functions(xi, half, self.scheme.interpolation, self._node_counts)
        row = self._rows_of(self.body.position[self._table.points.ids[: self._alive]], node)
        return self._matrix(row, weight), [self._matrix(row, s / h) for s in slope]

    def _anchor_reader(self, mass: FloatArray) -> csr_array:
        """Return the matrix from nodes to anchors: linear functions over nodes that carry material (Eq 32)."""
        xi = (self._anchor + self.anchor_displacement - self._origin) / self.grid.cell_size
        node, weight, _ = shape_functions(xi, np.zeros_like(xi), "linear", self._node_counts)
        row = self._rows_of(self._anchor, node)
        heavy = mass[row] > LEAST_MASS_SHARE * mass[row].max(axis=1, keepdims=True, initial=0.0)
        weight = np.where(heavy, weight, 0.0)
        total = weight.sum(axis=1, keepdims=True)
        return self._matrix(row, np.divide(weight, total, out=np.zeros_like(weight), where=total > 0.0))

    def _rows_of(self, reference: FloatArray, node: IntArray) -> IntArray:
        """Rows of the nodal tables that material at reference places uses at its nodes."""
        return node + self._grid_rows * self._cracks.fields(reference, node)

    def _matrix(self, row: IntArray, weight: FloatArray) -> csr_array:
        size = row.shape[0], self._grid_rows * self._cracks.field_count
        return csr_array((weight.ravel(), row.ravel(), np.arange(row.shape[0] + 1) * row.shape[1]), size)

    def _edge_motion(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Edge velocities of the last step and this one [m/s], and where edges are now [cells from the lowest node]."""
        time = self.time_step * np.arange(self._step - 1, self._step + 2, dtype=np.float64)
        way = np.array([edge.displacement(time) for edge in self.edge_conditions]).reshape(-1, 3)
        if self._step == 0:
            way[:, 0] = way[:, 1] - (way[:, 2] - way[:, 1] if self._started_moving else 0.0)
        normal = {e.edge: way[k, 1] for k, e in enumerate(self.edge_conditions) if e.component == e.axis}
        place = [
            (self.body.upper if e.sign > 0 else self.body.lower)[e.axis] + normal.get(e.edge, 0.0) - self._origin[e.axis]
            for e in self.edge_conditions
        ]
        speed = np.diff(way, axis=1) / self.time_step
        return speed[:, 0], speed[:, 1], np.array(place) / self.grid.cell_size

    # ---- points ------------------------------------------------------------------------------------

    def _part(self, name: str) -> FloatArray:
        """Columns of a vector of the living points, a view, (n, d)."""
        first = getattr(self._table.columns, name)
        return self._table.points.rows[: self._alive, first : first + self._dimension]

    def _column(self, name: str) -> FloatArray:
        return self._table.points.rows[: self._alive, getattr(self._table.columns, name)]

    def _gradient(self) -> FloatArray:
        """F - I of the living points, a view, (n, d, d)."""
        first, d = self._table.columns.gradient, self._dimension
        return self._table.points.rows[: self._alive, first : first + d * d].reshape(-1, d, d)

    def _drop_lost(self) -> None:
        """Put points within half a cell of the grid's border or beyond behind the living ones."""
        xi = (self._part("position") - self._origin) / self.grid.cell_size
        inside = np.all((xi >= 0.5) & (xi < np.asarray(self.grid.cells) - 0.5), axis=1)
        rows, ids, _ = self._table.points
        order = np.concatenate([np.flatnonzero(inside), np.flatnonzero(~inside), np.arange(self._alive, ids.size)])
        self._table.points = Points(rows[order], ids[order], np.argsort(ids[order]))
        self._alive = int(inside.sum())
        self._travel = 0.0

    def _stop_runaway(self, moved: FloatArray) -> None:
        wild = np.flatnonzero(~np.all(np.abs(moved) < self.grid.cell_size, axis=1))
        if wild.size:
            point = int(self._table.points.ids[wild[0]])
            place = tuple(self._part("position")[wild[0]].tolist())
            raise SolverError(
                f"velocity of material point {point} at {place} m runs away in step {self._step}: next move "
                f"{moved[wild[0]].tolist()} m, above one cell ({self.grid.cell_size:.6g} m) or not finite; lower "
                f"time_step (Courant number is {self.courant_number:.3g}) or the interface forces",
                self._step,
                point,
                place,
            )

    # ---- saving ------------------------------------------------------------------------------------

    def state(self) -> dict[str, NDArray[Any]]:
        """Everything that changes during a run, as copies; ``restore`` takes it back exactly."""
        return {
            "step": np.array([self._step, self._alive], dtype=np.int64),
            "totals": np.array([*self._totals, self._travel]),
            "edge_reaction": self.edge_reaction.copy(),
            "anchors": np.stack([self.anchor_displacement, self.anchor_velocity]),
            **self._table.state(),
        }

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Take back a state of a solver built and registered alike.

        Raises
        ------
        ValueError
            If a field is missing or has another shape.
        """
        for name, mine in self.state().items():
            if np.shape(state.get(name)) != mine.shape:
                raise ValueError(f"state[{name!r}]: shape {mine.shape} is needed, got {np.shape(state.get(name))}")
        self._step, self._alive = (int(value) for value in state["step"])
        *totals, self._travel = (float(value) for value in state["totals"])
        self._totals = np.array(totals)
        self.edge_reaction = np.array(state["edge_reaction"])
        self.anchor_displacement, self.anchor_velocity = np.array(state["anchors"])
        self._table.restore(state)
