"""Two-dimensional material point solver."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .anchors import weigh_anchors
from .boundary import EdgeCondition, edge_set
from .crack import Crack, crack_fields, find_near_nodes, follow_crack
from .errors import SolverError
from .grid import Grid
from .material_points import COLUMNS, MASS, VX, VY, Body, X, Y
from .materials import IsotropicElastic
from .ordering import reachable_nodes, sort_points
from .point_view import PointView
from .time_integration import Anchors, Nodes, PointForces, Points, Totals, advance_steps
from .transfer import point_energies, scatter_momentum

# Largest stable Courant number found by trial for uGIMP MUSL on this grid, with one to three points a
# cell and direction; 1.0 still held in every trial. See tests/mpm_service/test_mpm_waves.py.
COURANT_LIMIT = 0.8

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Energies:
    """Energies and cumulative work [J].

    Attributes
    ----------
    kinetic, strain : float
        Of the material points now. Velocities lag half a step behind positions, so their sum swings about
        the true total by the first order of the time step.
    edge_work : float
        Done on the body by edge conditions since step 0.
    interface_work : float
        Done by IVC and anchor forces, force times displacement of what it acts on.
    damping_loss : float
        Taken out by damping.
    """

    kinetic: float
    strain: float
    edge_work: float
    interface_work: float
    damping_loss: float


def _array(name: str, value: ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    array = np.ascontiguousarray(value, dtype=np.float64)
    if array.shape != shape:
        raise ValueError(f"{name}: shape {shape} is needed, got {array.shape}")
    if not np.all(np.isfinite(array)):
        bad = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise ValueError(f"{name}[{', '.join(map(str, bad))}] = {array[bad]!r}: must be finite")
    return array


class MaterialPointSolver:
    """Explicit material point solver: uGIMP, MUSL, FLIP, small-strain elasticity, at most one crack.

    Parameters
    ----------
    grid : Grid
        Background grid; holds the body with at least one cell of margin.
    body : Body
        Points, made for the same cell size.
    material : IsotropicElastic
        Material of all points.
    thickness : float
        Thickness of the body [m].
    time_step : float
        [s], at most ``stable_time_step``.
    edge_conditions : sequence of EdgeCondition
        Prescribed edge displacements.
    crack : Crack, optional
        One straight crack.
    damping_rate : float
        Mass-proportional damping c [1/s]: momentum on the grid is multiplied by ``exp(-c dt)`` each step.
    initial_velocity_gradient : (2, 2) array_like, optional
        Points start with the velocity ``L x`` [1/s], x from the coordinates' origin. Edges are then taken to
        have moved with the velocity of their first interval before step 0, else to have been at rest.

    Raises
    ------
    ValueError
        If a value is outside its range; the message names it.

    Notes
    -----
    A step follows Eqs 17-24, with the nodal velocity re-mapped from momenta. After a ``SolverError`` the
    state is that of a half-done step: restore a saved one.
    """

    def __init__(
        self,
        grid: Grid,
        body: Body,
        material: IsotropicElastic,
        thickness: float,
        time_step: float,
        edge_conditions: Sequence[EdgeCondition] = (),
        crack: Crack | None = None,
        damping_rate: float = 0.0,
        initial_velocity_gradient: ArrayLike | None = None,
    ) -> None:
        if not (np.isfinite(thickness) and thickness > 0.0):
            raise ValueError(f"thickness = {thickness!r}: a positive length [m] is needed")
        if not (np.isfinite(damping_rate) and damping_rate >= 0.0):
            raise ValueError(f"damping_rate = {damping_rate!r}: must not be negative [1/s]")
        _check_fit(grid, body)
        self.grid = grid
        self.body = body
        self.material = material
        self.thickness = float(thickness)
        self.time_step = float(time_step)
        self.edge_conditions = tuple(edge_conditions)
        self.crack = crack
        self.damping_rate = float(damping_rate)
        if not (np.isfinite(time_step) and 0.0 < time_step <= self.stable_time_step):
            raise ValueError(
                f"time_step = {time_step!r} s: must be above 0 and at most {self.stable_time_step:.6g} s "
                f"(Courant number {COURANT_LIMIT}, cell {grid.cell_size:.6g} m, pressure wave "
                f"{material.pressure_wave_speed:.6g} m/s); this one has Courant number "
                f"{self.courant_number:.4g}"
            )
        self._mesh = grid.mesh(body.point_size)
        self._law = material.law()
        self._edges = edge_set(self.edge_conditions, body.lower, body.upper)
        self._crack = crack_fields(crack, self._mesh, body.position)
        count = body.count
        rows = np.zeros((count, COLUMNS))
        rows[:, [X, Y]] = body.position
        rows[:, MASS] = body.weight * material.density * body.point_size**2 * self.thickness
        self._started_moving = initial_velocity_gradient is not None
        if initial_velocity_gradient is not None:
            gradient = _array("initial_velocity_gradient", initial_velocity_gradient, (2, 2))
            rows[:, [VX, VY]] = body.position @ gradient.T
        self._points = Points(rows, np.arange(count), np.arange(count))
        table = grid.node_count + self._crack.near_node.size
        self._nodes = Nodes(np.zeros((table, 5)), np.zeros((table, 4)), np.zeros((table, 2)))
        self._totals = Totals(np.array([count], dtype=np.int64), np.zeros(1), np.zeros(1), np.zeros(1), np.zeros(1))
        sort_points(rows, self._points.ids, self._points.row_of, count, self._mesh)
        self._active = reachable_nodes(rows, count, self._mesh)
        self._reaction = np.zeros(len(self.edge_conditions))
        self._anchors = _no_anchors(0)
        self._anchor_ivc = np.zeros(0, dtype=np.int64)
        self._ivc_points: list[NDArray[np.int64]] = []
        self._step = 0
        self.points = PointView(body, material, self.thickness, self._points, self._totals.alive)

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
        """Pressure wave speed times time step over cell size."""
        return self.material.pressure_wave_speed * self.time_step / self.grid.cell_size

    @property
    def stable_time_step(self) -> float:
        """Largest allowed time step [s]."""
        return COURANT_LIMIT * self.grid.cell_size / self.material.pressure_wave_speed

    @property
    def points_lost(self) -> int:
        """Points that have left the grid and take no further part."""
        return self.points.count - int(self._totals.alive[0])

    @property
    def anchor_displacement(self) -> FloatArray:
        """Displacement of the anchors since registration [m], (n, 2)."""
        return self._anchors.displacement.copy()

    @property
    def anchor_velocity(self) -> FloatArray:
        """Displacement increment of the last step over the time step [m/s], (n, 2)."""
        return self._anchors.velocity.copy()

    @property
    def edge_reaction(self) -> FloatArray:
        """Force each edge condition put on the body in the last step, along its component [N]."""
        return self._reaction.copy()

    @property
    def crack_opening(self) -> tuple[FloatArray, FloatArray]:
        """Distance from the crack's first point (k,) and relative displacement of the faces (k, 2) [m].

        The columns are opening (along the normal, positive when open) and sliding (upper face relative to
        the lower one, along the crack). Upper is left of the direction of travel.
        """
        if self.crack is None:
            return np.zeros(0), np.zeros((0, 2))
        marker = self._crack.marker
        relative = marker[:, :2] - marker[:, 2:]
        tangent = np.array([self._crack.tangent_x, self._crack.tangent_y])
        normal = np.array([-tangent[1], tangent[0]])
        return (
            np.linspace(0.0, self.crack.length, marker.shape[0]),
            np.stack([relative @ normal, relative @ tangent], axis=1),
        )

    def energies(self) -> Energies:
        """Energies now and work so far [J]."""
        kinetic, strain = point_energies(self._points.rows, self._totals.alive[0], self._law)
        return Energies(
            float(kinetic),
            float(strain),
            float(self._totals.edge_work[0]),
            float(self._totals.interface_work[0]),
            float(self._totals.damping_loss[0]),
        )

    # ---- coupling ----------------------------------------------------------------------------------

    def register_anchors(self, position: ArrayLike, ivc: ArrayLike) -> None:
        """Place massless anchors before the first step.

        Parameters
        ----------
        position : (n, 2) array_like
            Reference positions [m].
        ivc : (n,) array_like of int
            Interface volume cell of each anchor, from 0.

        Raises
        ------
        ValueError
            If an anchor has no material around it, or steps have been made already.
        """
        self._only_at_start("register_anchors")
        place = np.ascontiguousarray(position, dtype=np.float64)
        if place.ndim != 2:
            raise ValueError(f"position: shape (n, 2) is needed, got {place.shape}")
        place = _array("position", place, (place.shape[0], 2))
        cell = np.ascontiguousarray(ivc, dtype=np.int64)
        if cell.shape != (place.shape[0],):
            raise ValueError(f"ivc: shape ({place.shape[0]},) is needed, got {cell.shape}")
        if cell.size and cell.min() < 0:
            raise ValueError(f"ivc[{int(cell.argmin())}] = {int(cell.min())}: must not be negative")
        if self._ivc_points:
            _check_cells(cell, self._ivc_points)
        anchors = _no_anchors(place.shape[0])
        anchors.position[:] = place
        if self.crack is not None:
            anchors.local[:] = self.crack.local(place)
            follow_crack(self._crack, self._mesh)
        self._nodes.momentum[:] = 0.0
        scatter_momentum(
            self._points.rows,
            self._totals.alive[0],
            self._points.ids,
            self._mesh,
            self._law,
            self._crack,
            self._nodes.momentum,
        )
        weigh_anchors(
            anchors.position,
            anchors.displacement,
            anchors.local,
            self._mesh,
            self._crack,
            self._nodes.momentum,
            anchors.node,
            anchors.weight,
        )
        lonely = np.flatnonzero(anchors.weight.sum(axis=1) == 0.0)
        if lonely.size:
            k = int(lonely[0])
            raise ValueError(
                f"position[{k}] = ({place[k, 0]:.9g}, {place[k, 1]:.9g}) m: no material point reaches the "
                f"cell of this anchor ({lonely.size} such anchors)"
            )
        self._anchors = anchors
        self._anchor_ivc = cell

    def register_interface_cells(self, lower: ArrayLike, upper: ArrayLike) -> NDArray[np.int64]:
        """Find the material points of each interface volume cell (IVC) before the first step.

        Parameters
        ----------
        lower, upper : (m, 2) array_like
            Corners in the reference frame [m]; a point on the lower side belongs, on the upper side not.

        Returns
        -------
        (m,) ndarray of int
            Points in each cell.

        Raises
        ------
        ValueError
            If a cell that holds anchors holds no points.
        """
        self._only_at_start("register_interface_cells")
        low = np.ascontiguousarray(lower, dtype=np.float64)
        if low.ndim != 2:
            raise ValueError(f"lower: shape (m, 2) is needed, got {low.shape}")
        low = _array("lower", low, (low.shape[0], 2))
        high = _array("upper", upper, low.shape)
        place = self.body.position
        cells = [np.flatnonzero(np.all((place >= a) & (place < b), axis=1)) for a, b in zip(low, high, strict=True)]
        _check_cells(self._anchor_ivc, cells)
        self._ivc_points = cells
        return np.array([c.size for c in cells], dtype=np.int64)

    def advance(self, steps: int, ivc_force: ArrayLike | None = None, anchor_force: ArrayLike | None = None) -> None:
        """Advance under forces that stay constant meanwhile.

        Parameters
        ----------
        steps : int
            Number of steps.
        ivc_force : (m, 2) array_like, optional
            Force on each interface volume cell [N], spread equally over its points (Eq 87).
        anchor_force : (n, 2) array_like, optional
            Force on each anchor [N], put on the nodes by the weights that give the anchor its velocity, so
            its work is force times anchor displacement.

        Raises
        ------
        ValueError
            If a shape is wrong or a value not finite.
        SolverError
            If a point moves by more than a cell in a step, or its velocity is not finite.
        """
        if int(steps) != steps or steps < 0:
            raise ValueError(f"steps = {steps!r}: a whole number of at least 0 is needed")
        steps = int(steps)
        count = self._anchors.position.shape[0]
        self._anchors.force[:] = 0.0 if anchor_force is None else _array("anchor_force", anchor_force, (count, 2))
        loads = self._point_forces(ivc_force)
        time = self.time_step * np.arange(self._step - 1, self._step + steps + 1, dtype=np.float64)
        motion = np.zeros((steps + 2, len(self.edge_conditions)))
        for k, condition in enumerate(self.edge_conditions):
            motion[:, k] = condition.displacement(time)
            if self._step == 0 and steps > 0:
                before = motion[2, k] - motion[1, k] if self._started_moving else 0.0
                motion[0, k] = motion[1, k] - before
        done, runaway, self._active = advance_steps(
            steps,
            self.time_step,
            float(np.exp(-self.damping_rate * self.time_step)),
            self.material.density * self.grid.cell_size**2 * self.thickness,
            self._mesh,
            self._law,
            self._points,
            self._nodes,
            self._active,
            self._crack,
            self._edges,
            motion,
            self._reaction,
            self._anchors,
            loads,
            self._totals,
        )
        self._step += int(done)
        if runaway >= 0:
            self._raise_runaway(int(runaway))

    # ---- saving ------------------------------------------------------------------------------------

    def state(self) -> dict[str, NDArray[Any]]:
        """Everything that changes during a run, as copies; ``restore`` takes it back exactly."""
        return {
            "step": np.array([self._step], dtype=np.int64),
            "configuration": self._configuration(),
            "rows": self._points.rows.copy(),
            "ids": self._points.ids.copy(),
            "active_nodes": self._active.copy(),
            "alive": self._totals.alive.copy(),
            "travel": self._totals.travel.copy(),
            "edge_work": self._totals.edge_work.copy(),
            "interface_work": self._totals.interface_work.copy(),
            "damping_loss": self._totals.damping_loss.copy(),
            "edge_reaction": self._reaction.copy(),
            "anchor_displacement": self._anchors.displacement.copy(),
            "anchor_velocity": self._anchors.velocity.copy(),
            "crack_marker": self._crack.marker.copy(),
            "crack_marker_found": self._crack.marker_found.copy(),
        }

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Take back a state of a solver built and registered alike; the run goes on bit for bit.

        Raises
        ------
        ValueError
            If a field is missing, has another shape, or the state belongs to another set-up.
        """
        here = self.state()
        missing = sorted(set(here) - set(state))
        if missing:
            raise ValueError(f"state: field {missing[0]!r} is missing")
        for name, mine in here.items():
            if name != "active_nodes" and np.shape(state[name]) != mine.shape:
                raise ValueError(f"state[{name!r}]: shape {mine.shape} is needed, got {np.shape(state[name])}")
        if not np.array_equal(np.asarray(state["configuration"]), here["configuration"]):
            raise ValueError("state['configuration']: belongs to another grid, body, material or time step")
        self._step = int(np.asarray(state["step"])[0])
        self._points.rows[:] = state["rows"]
        self._points.ids[:] = state["ids"]
        self._points.row_of[self._points.ids] = np.arange(self.points.count)
        self._active = np.array(state["active_nodes"], dtype=np.int64)
        for name, target in (
            ("alive", self._totals.alive),
            ("travel", self._totals.travel),
            ("edge_work", self._totals.edge_work),
            ("interface_work", self._totals.interface_work),
            ("damping_loss", self._totals.damping_loss),
            ("edge_reaction", self._reaction),
            ("anchor_displacement", self._anchors.displacement),
            ("anchor_velocity", self._anchors.velocity),
            ("crack_marker", self._crack.marker),
            ("crack_marker_found", self._crack.marker_found),
        ):
            target[:] = state[name]
        for table in self._nodes:
            table[:] = 0.0
        if self.crack is not None:
            find_near_nodes(self._crack, self._mesh)

    # ---- inner -------------------------------------------------------------------------------------

    def _configuration(self) -> FloatArray:
        return np.array(
            [
                *self.grid.origin,
                self.grid.cell_size,
                *self.grid.cells,
                self.time_step,
                self.thickness,
                self.damping_rate,
                self.body.point_size,
                float(self.body.weight.sum()),
                self.material.young,
                self.material.poisson,
                self.material.density,
                float(self.material.assumption == "plane_stress"),
            ],
            dtype=np.float64,
        )

    def _only_at_start(self, name: str) -> None:
        if self._step != 0:
            raise ValueError(f"{name}: allowed before the first step only, {self._step} steps are done")

    def _point_forces(self, ivc_force: ArrayLike | None) -> PointForces:
        if ivc_force is None or not self._ivc_points:
            if ivc_force is not None:
                _array("ivc_force", ivc_force, (0, 2))
            return PointForces(np.zeros(0, dtype=np.int64), np.zeros((0, 2)))
        force = _array("ivc_force", ivc_force, (len(self._ivc_points), 2))
        alive = self.points.alive
        ids = []
        shares = []
        for points, total in zip(self._ivc_points, force, strict=True):
            living = points[alive[points]]
            if living.size:
                ids.append(living)
                shares.append(np.broadcast_to(total / living.size, (living.size, 2)))
        if not ids:
            return PointForces(np.zeros(0, dtype=np.int64), np.zeros((0, 2)))
        return PointForces(np.concatenate(ids), np.ascontiguousarray(np.concatenate(shares)))

    def _raise_runaway(self, row: int) -> None:
        x, y = (float(v) for v in self._points.rows[row, [X, Y]])
        vx, vy = (float(v) for v in self._points.rows[row, [VX, VY]])
        point = int(self._points.ids[row])
        raise SolverError(
            f"velocity of material point {point} at ({x:.9g}, {y:.9g}) m runs away in step {self._step}: "
            f"last value ({vx:.6g}, {vy:.6g}) m/s, next move above one cell ({self.grid.cell_size:.6g} m) or "
            f"not finite; lower time_step (Courant number is {self.courant_number:.3g}) or the interface "
            "forces",
            self._step,
            point,
            (x, y),
        )


def _no_anchors(count: int) -> Anchors:
    return Anchors(
        np.zeros((count, 2)),
        np.zeros((count, 2)),
        np.zeros((count, 2)),
        np.zeros((count, 2)),
        np.zeros((count, 2)),
        np.zeros((count, 4), dtype=np.int64),
        np.zeros((count, 4)),
    )


def _check_cells(ivc: NDArray[np.int64], cells: Sequence[NDArray[np.int64]]) -> None:
    for k in np.unique(ivc):
        if k >= len(cells):
            raise ValueError(f"ivc = {int(k)}: only {len(cells)} interface cells are registered")
        if cells[k].size == 0:
            raise ValueError(f"interface cell {int(k)}: holds {int(np.sum(ivc == k))} anchors but no material point")


def _check_fit(grid: Grid, body: Body) -> None:
    h = grid.cell_size
    if abs(body.cell_size / h - 1.0) > 1e-9:
        raise ValueError(f"body.cell_size = {body.cell_size!r} m: the grid's cell size is {h!r} m")
    for axis, name in enumerate("xy"):
        offset = (body.lower[axis] - grid.origin[axis]) / h
        if abs(offset - round(offset)) > 1e-6:
            raise ValueError(
                f"body lower {name} = {float(body.lower[axis])!r} m is not on a grid line; nearest is "
                f"{float(grid.origin[axis] + round(offset) * h)!r} m"
            )
        low = (body.lower[axis] - grid.lower[axis]) / h
        high = (grid.upper[axis] - body.upper[axis]) / h
        if min(low, high) < 1.0 - 1e-6:
            raise ValueError(
                f"grid: needs at least one cell of margin around the body in {name}, has {low:.3g} below and "
                f"{high:.3g} above"
            )
