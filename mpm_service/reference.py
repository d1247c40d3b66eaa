"""The material point method in plain numpy: the same scheme as `solver`, with the same interface.

No arithmetic is shared with the compiled sweeps, which makes this solver their independent judge, one to two orders
of magnitude slower. `reference_step` holds the step.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .conditions import EdgeCondition
from .crack_line import Crack
from .damping import Damping
from .errors import SolverError
from .grid import Grid
from .material import Material, MaterialError
from .material_points import Body
from .point_table import PointTable
from .point_view import PointView
from .reference_cracks import StraightCracks
from .reference_step import ReferenceStep
from .scheme import Scheme
from .set_up import check_cells, check_set_up, checked_array
from .solver import Energies

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


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
        self.materials: tuple[Material, ...] = (material,) if isinstance(material, Material) else tuple(material)
        self.thickness, self.time_step = float(thickness), float(time_step)
        self.damping = damping if isinstance(damping, Damping) else Damping(grid_rate=float(damping))
        self.edge_conditions = tuple(edge_conditions)
        for name, given in (("grid", not isinstance(grid, Grid)), ("loads", len(loads) > 0), ("threads", threads != 1)):
            if given:
                raise ValueError(f"{name}: the reference solver has uniform grids, no loads, one thread")
        seen = set()
        for k, condition in enumerate(self.edge_conditions):
            if not isinstance(condition, EdgeCondition):
                raise ValueError(f"edge_conditions[{k}]: the reference solver has conditions on edges only")
            if (condition.edge, condition.component) in seen:
                raise ValueError(f"edge_conditions[{k}]: {condition.edge!r}, {condition.component} is given twice")
            seen.add((condition.edge, condition.component))
        check_set_up(grid, False, body, self.materials, self.thickness, self.scheme)
        if not 0.0 < self.time_step <= self.stable_time_step:
            raise ValueError(
                f"time_step = {time_step!r} s: must be above 0 and at most {self.stable_time_step:.6g} s (Courant "
                f"number {self.scheme.courant_limit}); this one has Courant number {self.courant_number:.4g}"
            )
        self._table = PointTable(body, self.materials, self.thickness)
        self.cracks = StraightCracks(cracks, grid, body.position) if cracks else None
        self._run = ReferenceStep(
            grid,
            body,
            self._table,
            self.thickness,
            self.time_step,
            self.edge_conditions,
            self.cracks or StraightCracks((), grid, body.position),
            self.damping,
            self.scheme,
            initial_velocity_gradient is not None,
        )
        self.points = PointView(self._table, lambda: self._run.alive)
        velocity = np.zeros_like(body.position)
        if initial_velocity_gradient is not None:
            shape = (body.dimension, body.dimension)
            velocity += body.position @ checked_array("initial_velocity_gradient", initial_velocity_gradient, shape).T
        if initial_velocity is not None:
            velocity += checked_array("initial_velocity", initial_velocity, velocity.shape)
        self.set_velocity(velocity)
        self._step = 0
        self._anchor_ivc = np.zeros(0, dtype=np.int64)
        self._cells: list[IntArray] = []

    # ---- what a run can ask ------------------------------------------------------------------------

    @property
    def step(self) -> int:
        """Steps done."""
        return self._step

    @property
    def histories(self) -> list[FloatArray]:
        """Variables of each material's law by id of the points, as they are kept; see `Material`."""
        return self._table.histories

    @property
    def time(self) -> float:
        """Time [s], steps times time step."""
        return self._step * self.time_step

    @property
    def courant_number(self) -> float:
        """Fastest wave speed at rest times time step over the cell size (Eq 31)."""
        return self._wave_speed * self.time_step / self.grid.cell_size

    @property
    def stable_time_step(self) -> float:
        """Largest allowed time step [s]."""
        return self.scheme.courant_limit * self.grid.cell_size / self._wave_speed

    @property
    def _wave_speed(self) -> float:
        return float(max(m.pressure_wave_speed for m in self.materials))

    @property
    def points_lost(self) -> int:
        """Points that have left the grid and take no further part."""
        return self.body.count - self._run.alive

    @property
    def edge_reaction(self) -> FloatArray:
        """Force each edge condition put on the body in the last step, along its component [N]."""
        return self._run.reaction.copy()

    @property
    def anchor_displacement(self) -> FloatArray:
        """Displacement of the anchors since registration [m], (n, d)."""
        return self._run.anchor_displacement.copy()

    @property
    def anchor_velocity(self) -> FloatArray:
        """Displacement increment of the last step over the time step [m/s], (n, d)."""
        return self._run.anchor_velocity.copy()

    def energies(self) -> Energies:
        """Energies now and work so far [J]."""
        pending = self._run.pending_work(self._step)
        alive, kinetic = self.points.alive, self._run.kinetic_energy
        edge_work, interface_work, damping_loss, unfiltered = (float(value) for value in self._run.totals)
        return Energies(
            kinetic,
            float(np.sum(self.points.strain_energy[alive])) + pending,
            edge_work,
            interface_work,
            0.0,
            damping_loss,
            0.0,
            float(np.sum(self._table.by_material("dissipated"))),
            unfiltered - kinetic / self.damping.force_factor,
        )

    @property
    def momentum(self) -> FloatArray:
        """Of the points [kg m/s], (d,)."""
        alive = self.points.alive
        return np.asarray(self.points.mass[alive] @ self.points.velocity[alive])

    def set_velocity(self, velocity: ArrayLike) -> None:
        """Set the velocity of each point [m/s], (n, d), by id."""
        first, count = self._table.columns.velocity, self.body.dimension
        rows = self._table.points.row_of
        self._table.points.rows[rows, first : first + count] = checked_array(
            "velocity", velocity, self.body.position.shape
        )
        self._run.totals[-1] = self._run.kinetic_energy / self.damping.force_factor

    # ---- coupling ----------------------------------------------------------------------------------

    def register_anchors(self, position: ArrayLike, ivc: ArrayLike, displacement: ArrayLike | None = None) -> None:
        """Place massless anchors at reference positions (n, d) plus displacements [m] before the first step.

        Raises
        ------
        ValueError
            If an anchor has no material around it, or steps have been made already.
        """
        self._only_at_start("register_anchors")
        place = checked_array("position", position, (len(np.asarray(ivc)), self.body.dimension))
        cell = np.asarray(ivc, dtype=np.int64)
        if np.any(cell < 0):
            raise ValueError(f"ivc[{int(cell.argmin())}] = {int(cell.min())}: must not be negative")
        if self._cells:
            check_cells(cell, self._cells)
        moved = np.zeros_like(place) if displacement is None else displacement
        moved = checked_array("displacement", moved, place.shape)
        self._run.place_anchors(place, moved)
        lonely = self._run.lonely_anchors()
        if lonely.size:
            self._run.place_anchors(place[:0], place[:0])
            raise ValueError(
                f"position[{lonely[0]}] = {tuple(place[lonely[0]].tolist())} m: no material point reaches the cell of "
                f"this anchor ({lonely.size} such anchors)"
            )
        self._anchor_ivc = cell

    def register_interface_cells(self, lower: ArrayLike, upper: ArrayLike) -> IntArray:
        """Find the points between corners (m, d) [m] before the first step; returns how many each cell has, (m,).

        Raises
        ------
        ValueError
            If a cell that holds anchors holds no points, or steps have been made already.
        """
        self._only_at_start("register_interface_cells")
        shape = (len(np.asarray(lower)), self.body.dimension)
        boxes = zip(checked_array("lower", lower, shape), checked_array("upper", upper, shape), strict=True)
        place = self.body.position
        cells = [np.flatnonzero(np.all((place >= low) & (place < high), axis=1)) for low, high in boxes]
        check_cells(self._anchor_ivc, cells)
        self._cells = cells
        return np.array([cell.size for cell in cells], dtype=np.int64)

    def _only_at_start(self, name: str) -> None:
        if self._step != 0:
            raise ValueError(f"{name}: allowed before the first step only, {self._step} steps are done")

    def advance(self, steps: int, ivc_force: ArrayLike | None = None, anchor_force: ArrayLike | None = None) -> None:
        """Advance under forces on cells (m, d) and anchors (n, d) [N] that stay constant meanwhile.

        Raises
        ------
        ValueError
            If a shape is wrong or a value not finite.
        SolverError
            If a point moves by more than a cell in a step, or its material has no stress for its deformation.
        """
        if int(steps) != steps or steps < 0:
            raise ValueError(f"steps = {steps!r}: a whole number of at least 0 is needed")
        push, pull = np.zeros_like(self.body.position), np.zeros_like(self._run.anchor)
        if anchor_force is not None:
            pull = checked_array("anchor_force", anchor_force, pull.shape)
        if ivc_force is not None:
            alive = self.points.alive
            given = checked_array("ivc_force", ivc_force, (len(self._cells), self.body.dimension))
            for cell, total in zip(self._cells, given, strict=True):
                living = cell[alive[cell]]
                push[living] += total / max(living.size, 1)
        for _ in range(int(steps)):
            try:
                self._run.advance(self._step, push, pull)
            except MaterialError as error:
                place = tuple(self.points.position[error.point].tolist())
                raise SolverError(f"step {self._step}: {error}", self._step, error.point, place) from error
            self._step += 1

    # ---- saving ------------------------------------------------------------------------------------

    def state(self) -> dict[str, NDArray[Any]]:
        """Everything that changes during a run, as copies; ``restore`` takes it back exactly."""
        run = self._run
        return {
            "step": np.array([self._step], dtype=np.int64),
            "alive": np.array([run.alive], dtype=np.int64),
            "totals": np.array([*run.totals, run.pending, run.travel]),
            "strain_velocity": run.strain_velocity.copy(),
            "edge_reaction": run.reaction.copy(),
            "anchor_displacement": run.anchor_displacement.copy(),
            "anchor_velocity": run.anchor_velocity.copy(),
            "set_up": np.array([*self.grid.origin, self.grid.cell_size, *self.grid.cells, self.time_step]),
            **self._table.state(),
        }

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Take back a state of a solver built and registered alike; the run goes on bit for bit.

        Raises
        ------
        ValueError
            If a field is missing, has another shape, or the state belongs to another set-up.
        """
        for name, mine in self.state().items():
            if name not in state:
                raise ValueError(f"state: field {name!r} is missing")
            if np.shape(state[name]) != mine.shape:
                raise ValueError(f"state[{name!r}]: shape {mine.shape} is needed, got {np.shape(state[name])}")
            if name == "set_up" and not np.array_equal(state[name], mine):
                raise ValueError("state['set_up']: belongs to another grid or time step")
        run = self._run
        self._step, run.alive = int(state["step"][0]), int(state["alive"][0])
        run.totals = np.array(state["totals"][:-2])
        run.pending, run.travel = (float(value) for value in state["totals"][-2:])
        run.strain_velocity = np.array(state["strain_velocity"])
        run.reaction = np.array(state["edge_reaction"])
        run.anchor_displacement = np.array(state["anchor_displacement"])
        run.anchor_velocity = np.array(state["anchor_velocity"])
        self._table.restore(state)
