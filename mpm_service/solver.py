"""Material point solver in two or three dimensions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from .applied_loads import AppliedLoads
from .boundary_set import BoundarySet
from .conditions import Approach, EdgeCondition, FieldCondition, NodeCondition
from .crack_line import Crack
from .cracks import CrackSet
from .damping import Damping, ForceBalance
from .errors import SolverError
from .grid import Grid
from .hierarchy import HierarchicalGrid
from .interface import Anchors, CellForces
from .load_set import LoadSet
from .loads import Load
from .mapping import Mapping
from .material import Material, MaterialError
from .material_points import Body
from .nodes import EMPTY
from .point_table import PointTable
from .point_view import PointView
from .scheme import Scheme
from .set_up import check_cells, check_set_up, checked_array, largest_time_step
from .splitting import find_oversized, split_points
from .static_solution import Equilibrium, StaticSolution
from .time_integration import Nodes, TimeIntegration

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Energies:
    """Energies and cumulative work [J].

    Attributes
    ----------
    kinetic, strain : float
        Of the material points, both at the time of the velocities, half a step from that of the positions.
    edge_work : float
        Done on the body by boundary conditions since step 0.
    interface_work : float
        Done by IVC and anchor forces.
    load_work : float
        Done by tractions, body forces and absorbing edges (these: negative).
    damping_loss, friction_loss : float
        Taken out by damping and by crack faces that rub.
    dissipated : float
        By the materials.
    filter_loss : float
        Lost on the way from points to nodes and back; the balance is in `time_integration`.
    """

    kinetic: float
    strain: float
    edge_work: float
    interface_work: float
    load_work: float
    damping_loss: float
    friction_loss: float
    dissipated: float
    filter_loss: float


class MaterialPointSolver:
    """Explicit material point solver.

    Parameters
    ----------
    grid : Grid or HierarchicalGrid
        Background grid; holds the body with at least one cell of margin.
    body : Body
        Points, made for the same cells.
    material : Material or sequence of Material
        Material of all points, or those that ``body.material`` counts in.
    thickness : float
        Thickness of a plane body [m]; 1 in space.
    time_step : float
        [s], at most ``stable_time_step``.
    edge_conditions : sequence of EdgeCondition, FieldCondition or NodeCondition
        Prescribed motion of faces and nodes.
    cracks : sequence of Crack
        Plane bodies only.
    damping : Damping or float
        Damping; a number is the mass-proportional rate on the grid [1/s].
    initial_velocity_gradient : (d, d) array_like, optional
        Points start with the velocity ``L x`` [1/s], x from the coordinates' origin. Faces are then taken to
        have moved with the velocity of their first interval before step 0, else to have been at rest.
    scheme : Scheme
        Interpolation, time integration, transfer.
    loads : sequence of Load
        Body forces, tractions, absorbing edges.
    initial_velocity : (n, d) array_like, optional
        Velocity of each point at step 0 [m/s].
    threads : int
        Threads for the sweeps over the points.
    approach : Approach, optional
        Faces go to where they are to be at time 0 and stay there: for a solver that brings a body to rest.

    Raises
    ------
    ValueError
        If a value is outside its range; the message names it.

    Notes
    -----
    A step is described in ``time_integration``. After a ``SolverError`` the state is that of a half-done step:
    restore a saved one.
    """

    def __init__(
        self,
        grid: Grid | HierarchicalGrid,
        body: Body,
        material: Material | Sequence[Material],
        thickness: float,
        time_step: float,
        edge_conditions: Sequence[EdgeCondition | FieldCondition | NodeCondition] = (),
        cracks: Sequence[Crack] = (),
        damping: Damping | float = 0.0,
        initial_velocity_gradient: ArrayLike | None = None,
        *,
        scheme: Scheme | None = None,
        loads: Sequence[Load] = (),
        initial_velocity: ArrayLike | None = None,
        threads: int = 1,
        approach: Approach | None = None,
    ) -> None:
        self.scheme = scheme or Scheme()
        self.grid = grid
        self.body = body
        self.materials: tuple[Material, ...] = (material,) if isinstance(material, Material) else tuple(material)
        self.thickness = float(thickness)
        self.damping = damping if isinstance(damping, Damping) else Damping(grid_rate=float(damping))
        self.edge_conditions = tuple(edge_conditions)
        self._coarse = grid.grid if isinstance(grid, HierarchicalGrid) else grid
        refined = grid.refinements if isinstance(grid, HierarchicalGrid) else ()
        if int(threads) != threads or threads < 1:
            raise ValueError(f"threads = {threads!r}: a whole number of at least 1 is needed")
        check_set_up(self._coarse, bool(refined), body, self.materials, self.thickness, self.scheme)
        self.time_step = float(time_step)
        if not (np.isfinite(time_step) and 0.0 < time_step <= self.stable_time_step):
            raise ValueError(
                f"time_step = {time_step!r} s: must be above 0 and at most {self.stable_time_step:.6g} s "
                f"(Courant number {self.scheme.courant_limit} for {self.scheme}, cell "
                f"{self._smallest_cell:.6g} m, wave speed {self._wave_speed:.6g} m/s); this one has Courant number "
                f"{self.courant_number:.4g}"
            )
        self._table = PointTable(body, self.materials, self.thickness)
        self._set_velocities(initial_velocity_gradient, initial_velocity)
        rows = self._coarse.node_count if not isinstance(grid, HierarchicalGrid) else grid.node_count
        self.cracks = CrackSet(cracks, grid, self._table.reference, self._reach()) if cracks else None
        if self.cracks is not None:
            rows = self.cracks.row_count
        half = 0.5 / body.points_per_cell
        self._mapping = Mapping(grid, self._table.points, self.scheme, half, rows, self.cracks, int(threads))
        boundary = BoundarySet(
            self.edge_conditions,
            self._coarse,
            body.lower,
            body.upper,
            self.time_step,
            initial_velocity_gradient is not None,
            refined,
            self.scheme.interpolation == "bspline",
            approach,
        )
        self._balance = ForceBalance()
        self._cells = CellForces(self._mapping, [])
        self._anchors = Anchors(np.zeros((0, body.dimension)), np.zeros(0, dtype=np.int64), self._mapping, self.cracks)
        self._applied = AppliedLoads(self._load_set(loads), self._mapping, self.cracks) if loads else None
        densest = max(m.density for m in self.materials)
        self._integration = TimeIntegration(
            self._mapping,
            Nodes.zeros(rows, body.dimension),
            self.scheme,
            boundary,
            self.cracks,
            self._table.update_stress,
            self.time_step,
            EMPTY * densest * self._smallest_cell**body.dimension * self.thickness,
            self.damping,
            self._balance,
        )
        self._step = 0
        self._set_loads()
        self.points = PointView(self._table, lambda: self._mapping.alive)
        self._integration.totals.unfiltered = self.kinetic_energy / self.damping.force_factor
        self._sort()

    # ---- what a run can ask ----------------------------------------------------------------------------

    @property
    def material(self) -> Material:
        """The first material."""
        return self.materials[0]

    @property
    def step(self) -> int:
        """Steps done."""
        return self._step

    @property
    def time(self) -> float:
        """Time [s], steps times time step."""
        return self._step * self.time_step

    @property
    def _smallest_cell(self) -> float:
        sizes = self.grid.cell_sizes if isinstance(self.grid, HierarchicalGrid) else (self.grid.cell_size,)
        return float(min(sizes))

    @property
    def _wave_speed(self) -> float:
        return float(max(m.pressure_wave_speed for m in self.materials))

    @property
    def courant_number(self) -> float:
        """Fastest wave speed at rest times time step over the smallest cell (Eq 31)."""
        return self._wave_speed * self.time_step / self._smallest_cell

    @property
    def stable_time_step(self) -> float:
        """Largest allowed time step [s]."""
        return largest_time_step(self.grid, self.materials, self.scheme)

    @property
    def histories(self) -> list[FloatArray]:
        """Variables of each material's law by id of the points, as they are kept; see `Material`."""
        return self._table.histories

    @property
    def points_lost(self) -> int:
        """Points that have left the grid and take no further part."""
        return self._table.count - self._mapping.alive

    @property
    def anchor_displacement(self) -> FloatArray:
        """Displacement of the anchors since registration [m], (n, d)."""
        return self._anchors.displacement.copy()

    @property
    def anchor_velocity(self) -> FloatArray:
        """Displacement increment of the last step over the time step [m/s], (n, d)."""
        return self._anchors.velocity.copy()

    @property
    def edge_reaction(self) -> FloatArray:
        """Force each boundary condition put on the body in the last step, along its component [N]."""
        return self._integration.boundary.reaction.copy()

    @property
    def kinetic_energy(self) -> float:
        """Of the points [J]."""
        c = self._table.columns
        rows = self._table.points.rows[: self._mapping.alive]
        velocity = rows[:, c.velocity : c.gradient]
        return 0.5 * float(np.sum(rows[:, c.mass] * np.einsum("ij,ij->i", velocity, velocity)))

    @property
    def momentum(self) -> FloatArray:
        """Of the points [kg m/s], (d,)."""
        c = self._table.columns
        rows = self._table.points.rows[: self._mapping.alive]
        return np.asarray(rows[:, c.mass] @ rows[:, c.velocity : c.gradient])

    @property
    def residual(self) -> float:
        """Out-of-balance force of the last step over the largest force at work; see ``damping.ForceBalance``.

        It is measured in the steps that follow the first time it is asked for; that time it is infinite.
        """
        self._integration.watches_balance = True
        return self._integration.residual

    def energies(self) -> Energies:
        """Energies now and work so far [J]."""
        totals = self._integration.totals
        kinetic = self.kinetic_energy
        return Energies(
            kinetic,
            self._table.total("strain_energy", self._mapping.alive) + self._integration.pending_work(),
            totals.edge_work,
            self._cells.work + self._anchors.work,
            self._applied.work if self._applied else 0.0,
            totals.damping_loss,
            totals.friction_loss,
            self._table.total("dissipated", self._mapping.alive),
            totals.unfiltered - kinetic / self.damping.force_factor,
        )

    def stop(self) -> None:
        """Set the velocities of all points to zero."""
        self._set_velocity(0.0)
        self._integration.at_rest = True

    def set_velocity(self, velocity: ArrayLike) -> None:
        """Set the velocity of each point [m/s], (n, d), by id."""
        c = self._table.columns
        values = checked_array("velocity", velocity, (self._table.count, c.dimension))
        self._set_velocity(values[self._table.points.ids])

    def _set_velocity(self, velocity: FloatArray | float) -> None:
        """Set the velocities of the rows [m/s]."""
        c = self._table.columns
        before = self.kinetic_energy
        self._table.points.rows[:, c.velocity : c.gradient] = velocity
        self._book_change(before)

    def _book_change(self, before: float) -> None:
        """What has changed the kinetic energy from outside is no loss."""
        self._integration.totals.unfiltered += (self.kinetic_energy - before) / self.damping.force_factor

    def deform(self, displacement: ArrayLike, gradient: ArrayLike) -> None:
        """Give each point, by id, a displacement and ``F - I``, and the stress of it, before the first step.

        Parameters
        ----------
        displacement : (n, d) array_like
            [m]
        gradient : (n, d, d) array_like

        Raises
        ------
        ValueError
            If steps have been made already, a shape is wrong or a value not finite.
        """
        self._only_at_start("deform")
        shape = (self._table.count, self.body.dimension)
        moved = checked_array("displacement", displacement, shape)
        self._table.deform(moved, checked_array("gradient", gradient, (*shape, shape[1])))
        self._settle()

    def start_from(self, other: MaterialPointSolver) -> None:
        """Take displacement, deformation, stress and history of a solver alike whose body may hold more points.

        Velocities are set to zero. Points that were split there are here too.

        Raises
        ------
        ValueError
            If steps have been made already, a point of this body is none of the other, or points were lost there.
        """
        self._only_at_start("start_from")
        distance, found = cKDTree(other.body.position).query(self.body.position)
        if not np.all(distance < 1e-9 * self._smallest_cell):
            raise ValueError("start_from: the other solver has no point where this one has")
        if other.points_lost:
            raise ValueError(f"start_from: {other.points_lost} points of the other solver have left its grid")
        self._table.take(other._table, found, self.body)
        self._mapping.points = self._table.points
        self._mapping.alive = self._table.count
        if self.cracks is not None:
            self.cracks.set_points(self._table.reference)
        if self._applied is not None:
            self._applied.set_points(self._table.reference)
        self._settle()

    def equilibrate(
        self, tolerance: float, max_steps: int, told: Callable[[int], None] = lambda _: None
    ) -> Equilibrium:
        """Bring the body to rest under the loads of time 0, its faces where they are to be then, by statics.

        Anchors ride along. The points are where they then are; see `static_solution`.

        Parameters
        ----------
        tolerance : float
            Residual to reach.
        max_steps : int
            Iterations after which to end without it.
        told : callable
            Is told the iterations made.

        Raises
        ------
        ValueError
            If steps have been made already, a cell has one point, or a material has no tangent.
        SolverError
            If nothing holds the body, a point leaves the grid or its material has no stress for its deformation.
        """
        self._only_at_start("equilibrate")
        if self.body.points_per_cell < 2:
            raise ValueError(
                "points_per_cell = 1: statics needs at least 2, since one point in a cell does not see all that its "
                "nodes can do; dynamic relaxation takes any number"
            )
        solution = StaticSolution(self._integration, self._table, self._anchors, self._sort)
        try:
            return solution.solve(tolerance, max_steps, told)
        except NotImplementedError as error:
            raise ValueError(f"material: {error}; dynamic relaxation needs none") from None
        except MaterialError as error:
            place = tuple(self.points.position[error.point].tolist())
            raise SolverError(f"statics: {error}", 0, error.point, place) from error

    def _settle(self) -> None:
        """Bring cracks and the order of the points up to their new places."""
        if self.cracks is not None:
            points = self._table.points
            self.cracks.move(points.rows, points.row_of)
            self.cracks.follow()
        self._sort()
        self._integration.totals.unfiltered = self.kinetic_energy / self.damping.force_factor

    # ---- coupling --------------------------------------------------------------------------------------

    def register_anchors(self, position: ArrayLike, ivc: ArrayLike, displacement: ArrayLike | None = None) -> None:
        """Place massless anchors before the first step.

        Parameters
        ----------
        position : (n, d) array_like
            Reference positions [m].
        ivc : (n,) array_like of int
            Interface volume cell of each anchor, from 0.
        displacement : (n, d) array_like, optional
            That the anchors have already, as the body around them has [m]; none if not given.

        Raises
        ------
        ValueError
            If an anchor has no material around it, or steps have been made already.
        """
        self._only_at_start("register_anchors")
        dimension = self.body.dimension
        place = np.ascontiguousarray(position, dtype=np.float64)
        if place.ndim != 2:
            raise ValueError(f"position: shape (n, {dimension}) is needed, got {place.shape}")
        place = checked_array("position", place, (place.shape[0], dimension))
        cell = np.ascontiguousarray(ivc, dtype=np.int64)
        if cell.shape != (place.shape[0],):
            raise ValueError(f"ivc: shape ({place.shape[0]},) is needed, got {cell.shape}")
        if cell.size and cell.min() < 0:
            raise ValueError(f"ivc[{int(cell.argmin())}] = {int(cell.min())}: must not be negative")
        if self._cells.cells:
            check_cells(cell, self._cells.cells)
        moved = None if displacement is None else checked_array("displacement", displacement, place.shape)
        anchors = Anchors(place, cell, self._mapping, self.cracks, moved)
        self._integration.gather_state()
        lonely = np.flatnonzero(anchors.weigh(self._integration.nodes.momentum) == 0.0)
        if lonely.size:
            k = int(lonely[0])
            raise ValueError(
                f"position[{k}] = ({place[k, 0]:.9g}, {place[k, 1]:.9g}) m: no material point reaches the "
                f"cell of this anchor ({lonely.size} such anchors)"
            )
        self._anchors = anchors
        self._set_loads()

    def register_interface_cells(self, lower: ArrayLike, upper: ArrayLike) -> IntArray:
        """Find the material points of each interface volume cell (IVC) before the first step.

        Parameters
        ----------
        lower, upper : (m, d) array_like
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
        dimension = self.body.dimension
        low = np.ascontiguousarray(lower, dtype=np.float64)
        if low.ndim != 2:
            raise ValueError(f"lower: shape (m, {dimension}) is needed, got {low.shape}")
        low = checked_array("lower", low, (low.shape[0], dimension))
        high = checked_array("upper", upper, low.shape)
        place = self._table.reference
        cells = [np.flatnonzero(np.all((place >= a) & (place < b), axis=1)) for a, b in zip(low, high, strict=True)]
        check_cells(self._anchors.ivc, cells)
        self._cells = CellForces(self._mapping, cells)
        self._set_loads()
        return np.array([c.size for c in cells], dtype=np.int64)

    def advance(self, steps: int, ivc_force: ArrayLike | None = None, anchor_force: ArrayLike | None = None) -> None:
        """Advance under interface forces that stay constant meanwhile.

        Parameters
        ----------
        steps : int
            Number of steps.
        ivc_force : (m, d) array_like, optional
            Force on each interface volume cell [N], spread equally over its points (Eq 87).
        anchor_force : (n, d) array_like, optional
            Force on each anchor [N], put on the nodes by the weights that give the anchor its velocity, so
            its work is force times anchor displacement.

        Raises
        ------
        ValueError
            If a shape is wrong or a value not finite.
        SolverError
            If a point moves by more than a cell in a step, its velocity is not finite, or its material has no
            stress for its deformation.
        """
        if int(steps) != steps or steps < 0:
            raise ValueError(f"steps = {steps!r}: a whole number of at least 0 is needed")
        anchors = self._anchors
        anchors.force[:] = (
            0.0 if anchor_force is None else checked_array("anchor_force", anchor_force, anchors.force.shape)
        )
        shape = (len(self._cells.cells), self.body.dimension)
        self._cells.set_forces(None if ivc_force is None else checked_array("ivc_force", ivc_force, shape))
        for _ in range(int(steps)):
            self._advance_one()

    def extend_crack(self, crack: int, end: int, points: ArrayLike) -> None:
        """Let a crack go on along given corners from the next step on, whatever its growth law says.

        Parameters
        ----------
        crack, end : int
            Number of the crack, and its end: 0 or 1, inside the body, holes included, and not on another crack.
        points : (k, 2) array_like
            Corners in the reference state [m]; the last is the new end.

        Raises
        ------
        ValueError
            If there is no such end, a corner lies outside the body, or the line would meet another crack or itself;
            the message begins with ``crack``, ``end`` or ``points``.
        """
        if self.cracks is None:
            raise ValueError(f"crack = {crack!r}: the body has no cracks")
        self.cracks.lengthen(crack, end, points, (self.body.lower, self.body.upper))

    def _advance_one(self) -> None:
        run = self._integration
        try:
            if run.must_sort():
                self._sort()
            run.step(self._step)
        except MaterialError as error:
            place = self.points.position[error.point]
            if not np.all(np.isfinite(self.points.velocity[error.point])):
                self._raise_runaway()
            raise SolverError(f"step {self._step}: {error}", self._step, error.point, tuple(place.tolist())) from error
        if not run.largest_increment < self._smallest_cell:
            self._raise_runaway()
        self._step += 1

    def _sort(self) -> None:
        """Drop lost points, split those that have entered finer cells, sort."""
        mapping = self._mapping
        self._integration.settle()
        living, before = mapping.alive, self.kinetic_energy
        mapping.drop_lost()
        if mapping.alive < living:
            self._book_change(before)
        if isinstance(self.grid, HierarchicalGrid):
            while True:
                rows = self._table.points.rows
                found = find_oversized(self.grid.arrays, rows, 0, mapping.alive, self.body.points_per_cell)
                if not found.size:
                    break
                split = split_points(rows, found)
                self._table.replace_by_four(split.parent, split.rows, split.reference_offset, mapping.alive)
                mapping.points = self._table.points
                mapping.alive += 3 * found.size
                if self.cracks is not None:
                    self.cracks.set_points(self._table.reference)
                if self._applied is not None:
                    self._applied.set_points(self._table.reference)
        self._integration.sort()

    # ---- saving ----------------------------------------------------------------------------------------

    def state(self) -> dict[str, NDArray[Any]]:
        """Everything that changes during a run, as copies; ``restore`` takes it back exactly."""
        totals = self._integration.totals
        state: dict[str, NDArray[Any]] = {
            "step": np.array([self._step], dtype=np.int64),
            "configuration": self._configuration(),
            "totals": np.array(
                [
                    totals.edge_work,
                    totals.damping_loss,
                    totals.friction_loss,
                    self._cells.work,
                    self._anchors.work,
                    self._applied.work if self._applied else 0.0,
                    self._integration.residual,
                    float(self._integration.at_rest),
                    totals.unfiltered,
                    totals.pending,
                    totals.half,
                ]
            ),
            "edge_reaction": self._integration.boundary.reaction.copy(),
            "anchor_displacement": self._anchors.displacement.copy(),
            "anchor_velocity": self._anchors.velocity.copy(),
            "strain_velocity": self._integration.strain_velocity[self._mapping.active, : self.body.dimension],
        }
        state |= self._table.state() | self._mapping.state()
        if self.cracks is not None:
            state |= self.cracks.state()
        return state

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
        count = np.size(state["ids"])
        splits = isinstance(self.grid, HierarchicalGrid)
        fits = count >= self.body.count if splits else count == self.body.count
        if np.shape(state["rows"]) != (count, self._table.columns.width) or not fits:
            raise ValueError(
                f"state['rows']: shape {np.shape(state['rows'])} does not fit a body of {self.body.count} points"
            )
        shape = (np.size(state["active"]), self.body.dimension)
        if np.shape(state["strain_velocity"]) != shape:
            raise ValueError(
                f"state['strain_velocity']: shape {shape} is needed, got {np.shape(state['strain_velocity'])}"
            )
        for name in ("configuration", "totals", "edge_reaction", "anchor_displacement", "anchor_velocity", "begin"):
            if np.shape(state[name]) != here[name].shape:
                raise ValueError(f"state[{name!r}]: shape {here[name].shape} is needed, got {np.shape(state[name])}")
        if not np.array_equal(np.asarray(state["configuration"]), here["configuration"]):
            raise ValueError("state['configuration']: belongs to another grid, body, material, scheme or time step")
        self._step = int(np.asarray(state["step"])[0])
        for table in self._integration.nodes:
            table[:] = 0.0
        self._table.restore(state)
        self._mapping.points = self._table.points
        if self.cracks is not None:
            self.cracks.set_points(self._table.reference)
            self.cracks.restore(state)
            self._integration.make_room()
        self._mapping.restore(state)
        self._integration.strain_velocity[self._mapping.active, : self.body.dimension] = state["strain_velocity"]
        totals = self._integration.totals
        values = [float(v) for v in np.asarray(state["totals"])]
        totals.edge_work, totals.damping_loss, totals.friction_loss = values[:3]
        self._cells.work, self._anchors.work = values[3:5]
        if self._applied:
            self._applied.work = values[5]
        self._integration.residual = values[6]
        self._integration.at_rest = bool(values[7])
        totals.unfiltered, totals.pending, totals.half = values[8:11]
        self._integration.boundary.reaction[:] = state["edge_reaction"]
        self._anchors.displacement[:] = state["anchor_displacement"]
        self._anchors.velocity[:] = state["anchor_velocity"]
        if self._applied is not None:
            self._applied.set_points(self._table.reference)

    # ---- inner -----------------------------------------------------------------------------------------

    def _set_velocities(self, gradient: ArrayLike | None, velocity: ArrayLike | None) -> None:
        c = self._table.columns
        values = np.zeros((self._table.count, c.dimension))
        if gradient is not None:
            shape = (c.dimension, c.dimension)
            values += self.body.position @ checked_array("initial_velocity_gradient", gradient, shape).T
        if velocity is not None:
            values += checked_array("initial_velocity", velocity, values.shape)
        self._table.points.rows[:, c.velocity : c.gradient] = values

    def _reach(self) -> float:
        """How far the nodes that a point feels may lie from it along an axis [cells]."""
        if self.scheme.interpolation == "cpgimp":
            return 2.5  # one and a domain stretched to three cells; wider ones near a crack are refused
        return 1.5

    def _load_set(self, loads: Sequence[Load]) -> LoadSet:
        body = self.body
        return LoadSet(
            loads,
            self._table.reference,
            body.half,
            body.weight,
            body.lower,
            body.upper,
            self.thickness,
            self.time_step,
            self.scheme.interpolation,
        )

    def _set_loads(self) -> None:
        applied = [self._applied] if self._applied else []
        self._integration.loads = [self._cells, self._anchors, *applied]
        self._integration.rider = self._anchors

    def _configuration(self) -> FloatArray:
        grids = self.grid.grids if isinstance(self.grid, HierarchicalGrid) else (self.grid,)
        numbers = [
            self.time_step,
            self.thickness,
            self.damping.grid_rate,
            self.damping.point_rate,
            self.damping.force_scaling,
            float(self.body.points_per_cell),
            float(self.body.weight.sum()),
            float(self.body.stiffness_share.sum()),
            float(self.scheme.order),
            float(self.scheme.period),
            *(float(sum(map(ord, repr(self.scheme)))),),
        ]
        for grid in grids:
            numbers += [*grid.origin, grid.cell_size, *map(float, grid.cells)]
        for material in self.materials:
            numbers += [material.density, material.pressure_wave_speed, float(len(material.assumption))]
        return np.array(numbers, dtype=np.float64)

    def _only_at_start(self, name: str) -> None:
        if self._step != 0:
            raise ValueError(f"{name}: allowed before the first step only, {self._step} steps are done")

    def _raise_runaway(self) -> None:
        c = self._table.columns
        rows = self._table.points.rows[: self._mapping.alive]
        size = np.abs(rows[:, c.increment : c.increment + c.dimension]).max(axis=1)
        bad = np.flatnonzero(~(size < self._smallest_cell))
        row = int(bad[0]) if bad.size else int(np.argmax(size))
        point = int(self._table.points.ids[row])
        place = tuple(rows[row, : c.dimension].tolist())
        velocity = tuple(float(f"{v:.6g}") for v in rows[row, c.velocity : c.gradient])
        raise SolverError(
            f"velocity of material point {point} at {place} m runs away in step {self._step}: last value {velocity} "
            f"m/s, next move above one cell ({self._smallest_cell:.6g} m) or not finite; lower time_step (Courant "
            f"number is {self.courant_number:.3g}) or the interface forces",
            self._step,
            point,
            place,
        )
