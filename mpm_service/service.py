"""The continuum role by the material point method: messages in, solver calls out. The only file that sees both."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from mpm_service.conditions import EdgeCondition, symmetry
from mpm_service.crack_line import Crack
from mpm_service.cracks import MOST_CRACKS
from mpm_service.damping import Damping, relax
from mpm_service.elastic import IsotropicElastic, LinearElastic, OrthotropicElastic
from mpm_service.errors import SolverError
from mpm_service.grid import Grid
from mpm_service.hierarchy import HierarchicalGrid
from mpm_service.hierarchy_filling import fill_hierarchy
from mpm_service.hyperelastic import NeoHookean
from mpm_service.loads import AbsorbingEdge, BodyForce, Load, Traction
from mpm_service.material import Material
from mpm_service.material_points import Body, Overlap, fill_rectangle
from mpm_service.plasticity import J2Plasticity
from mpm_service.scheme import Scheme
from mpm_service.solver import MaterialPointSolver
from mpm_service.time_functions import Constant, Table
from protocol import continuum as messages
from protocol.arrays import FloatArray
from protocol.continuum_parts import Edge
from protocol.errors import ProtocolError
from protocol.messages import CheckpointReply, Empty, FieldsReply, FieldsRequest, Restored, RestoreRequest
from protocol.service import Activity, Capabilities, Service
from protocol.version import package_version

FIELDS = ["position", "displacement", "velocity", "stress", "weight"]
#: Cells around the body, so that domains of points near an edge stay inside the grid.
MARGIN_CELLS = 3
#: Steps between two reports of progress.
CHUNK = 100
#: Levels of the grid that are accepted; ten span the sizes of the dissertation's Sec 5.1.
MOST_LEVELS = 12
#: What the solver's complaints begin with, as the messages name it.
CONFIGURE_NAMES = {
    "lower": "body",
    "upper": "body",
    "grid": "body",
    "hole": "overlap",
    "Overlap": "overlap",
    "edge_conditions": "edges",
    "EdgeCondition": "edges",
    "loads": "edges",
    "Traction": "edges",
    "Crack": "cracks",
    "crack": "cracks",
    "Scheme": "scheme",
    "HierarchicalGrid": "refinement",
}
REGISTER_NAMES = {"position": "anchor_position", "ivc": "anchor_ivc", "interface": "ivc_lower", "lower": "ivc_lower",
                  "upper": "ivc_upper"}  # fmt: skip
_LAWS: dict[str, Callable[..., Material]] = {
    "isotropic": IsotropicElastic,
    "orthotropic": OrthotropicElastic,
    "neo_hookean": NeoHookean,
    "j2_plasticity": J2Plasticity,
}


class MaterialPointService(Service):
    """One material point solver at a time."""

    role = "continuum"
    backend = "mpm_service"
    backend_version = package_version()

    def __init__(self) -> None:
        super().__init__()
        self._solver: MaterialPointSolver | None = None
        self._edges = _Edges([], 1.0, (0.0, 0.0), frozen=True)
        self._stop_on_loss = False

    def capabilities(self) -> Capabilities:
        """Return what this backend can do."""
        return {
            "assumptions": ["plane_stress", "plane_strain"],
            "fields": FIELDS,
            "dimension": 2,
            "interpolations": ["linear", "ugimp", "cpgimp", "bspline"],
            "integrations": ["usf", "usl", "musl", "usavg"],
            "transfers": ["flip", "pic", "xpic", "fmpm"],
            "laws": ["isotropic", "orthotropic", "neo_hookean", "j2_plasticity"],
            "edge_kinds": ["displacement", "velocity", "symmetry", "traction", "pressure", "absorbing"],
            "contacts": ["frictionless", "stick", "coulomb"],
            "growth_rules": ["straight", "max_hoop"],
            "levels": MOST_LEVELS,
            "cracks": MOST_CRACKS,
            "spread": ["ivc", "anchor"],
        }

    @property
    def step(self) -> int:
        """Steps since configure."""
        return 0 if self._solver is None else self._solver.step

    def configure(self, request: messages.ContinuumConfigure) -> messages.ContinuumConfigured:
        """Fill the body with points, make the solver, relax it where the request says so."""
        if len(request.refinement) >= MOST_LEVELS:
            raise ProtocolError("unsupported", f"this backend has at most {MOST_LEVELS} levels", field="refinement")
        material = _make_material(request)
        try:
            solver, edges = _make_solver(request, material)
            relaxation = self._preload(request, material, solver) if request.preload else None
        except SolverError as error:
            raise ProtocolError("solver_failed", f"preload: {error}", step=error.step) from error
        except ValueError as error:
            raise _bad_field(error, CONFIGURE_NAMES) from None
        self._solver, self._edges = solver, edges
        self._stop_on_loss = request.on_lost_points == "stop"
        levels = _levels(request, solver)
        return messages.ContinuumConfigured(
            courant_number=solver.courant_number,
            stable_time_step=solver.stable_time_step,
            cells=sum(level.cells for level in levels),
            levels=levels,
            relaxation=relaxation,
            position=_with_z(solver.points.reference_position),
            weight=solver.points.weight,
        )

    def _preload(
        self, request: messages.ContinuumConfigure, material: Material, solver: MaterialPointSolver
    ) -> messages.Relaxation:
        """Relax a body alike under the loads of time zero, and let the solver start from its state."""
        assert request.preload is not None
        still, _ = _make_solver(request, material, frozen=True)
        most = request.preload.max_steps
        relaxed = relax(_Told(still, self.activity, most), request.preload.tolerance, most)
        state = still.state()
        state["step"][:] = 0
        state["totals"][:] = 0.0
        solver.restore(state)
        gradient = request.initial_velocity_gradient
        if gradient is not None:
            solver.set_velocity(solver.points.reference_position @ np.reshape(gradient, (2, 2)).T)
        return messages.Relaxation(residual=relaxed.residual, steps=relaxed.steps, converged=relaxed.converged)

    def register(self, request: messages.ContinuumRegister) -> messages.ContinuumRegistered:
        """Place anchors and interface volume cells."""
        solver = self._configured()
        try:
            solver.register_anchors(_flat(request.anchor_position), request.anchor_ivc)
            found = solver.register_interface_cells(_flat(request.ivc_lower), _flat(request.ivc_upper))
        except ValueError as error:
            raise _bad_field(error, REGISTER_NAMES) from None
        return messages.ContinuumRegistered(points_in_ivc=np.asarray(found, dtype=np.int64))

    def advance(self, request: messages.ContinuumAdvance) -> messages.ContinuumAdvanced:
        """Advance under constant reaction forces."""
        solver = self._configured()
        if request.ivc_force is not None and request.anchor_force is not None:
            raise ProtocolError("bad_field", "give ivc_force or anchor_force, not both", field="anchor_force")
        ivc_force = None if request.ivc_force is None else _flat(request.ivc_force)
        anchor_force = None if request.anchor_force is None else _flat(request.anchor_force)
        events: list[messages.ContinuumEvent] = []
        try:
            for done in range(0, request.steps, CHUNK):
                if done:
                    self.activity.progress(done, request.steps)
                lost = solver.points_lost
                solver.advance(min(CHUNK, request.steps - done), ivc_force=ivc_force, anchor_force=anchor_force)
                if solver.points_lost > lost:
                    events.append(self._lost(solver.points_lost - lost))
        except SolverError as error:
            raise ProtocolError("solver_failed", str(error), step=solver.step) from error
        except ValueError as error:
            raise _bad_field(error, {}) from None
        energies = solver.energies()
        force, displacement = self._edges.state(solver.edge_reaction, solver.time)
        return messages.ContinuumAdvanced(
            step=solver.step,
            anchor_displacement=_with_z(solver.anchor_displacement),
            anchor_velocity=_with_z(solver.anchor_velocity),
            edge_force=force,
            edge_displacement=displacement,
            kinetic_energy=energies.kinetic,
            strain_energy=energies.strain,
            edge_work=energies.edge_work,
            interface_work=energies.interface_work,
            damping_loss=energies.damping_loss,
            load_work=energies.load_work,
            dissipated_energy=energies.dissipated + energies.friction_loss,
            points_lost=solver.points_lost,
            tips=_tips(solver),
            events=events,
        )

    def _lost(self, count: int) -> messages.ContinuumEvent:
        """Return the event of points that left the grid, or end the operation where the request said so."""
        solver = self._configured()
        place = solver.points.position[~solver.points.alive][-1]
        noun = "material point" if count == 1 else "material points"
        sentence = f"{count} {noun} left the grid by step {solver.step}, one at ({place[0]:.6g}, {place[1]:.6g}) m"
        if self._stop_on_loss:
            raise ProtocolError(
                "solver_failed", f"{sentence}, and on_lost_points is stop", step=solver.step, field="on_lost_points"
            )
        return messages.ContinuumEvent(kind="points_lost", step=solver.step, sentence=sentence, count=count)

    def fields(self, request: FieldsRequest) -> FieldsReply:
        """Return fields of the points; those of `configure` come first, in its order. Vectors have z = 0."""
        solver = self._configured()
        points = solver.points
        found = {}
        for index, name in enumerate(request.names):
            if name not in FIELDS:
                raise ProtocolError(
                    "bad_field",
                    f"names.{index}: no field {name!r}; there are {', '.join(FIELDS)}",
                    field=f"names.{index}",
                )
            value = getattr(points, name)
            found[name] = _with_z(value) if value.ndim == 2 and value.shape[1] == 2 else np.ascontiguousarray(value)
        return FieldsReply(step=solver.step, fields=found)

    def checkpoint(self, request: Empty) -> CheckpointReply:
        """Return the state."""
        solver = self._configured()
        return CheckpointReply(step=solver.step, state=solver.state())

    def restore(self, request: RestoreRequest) -> Restored:
        """Set the state."""
        solver = self._configured()
        step = request.state.get("step")
        if step is None or step.size == 0 or int(step.flat[0]) != request.step:
            raise ProtocolError("bad_field", f"step {request.step} is not the step of the state", field="step")
        try:
            solver.restore(request.state)
        except (ValueError, KeyError) as error:
            raise ProtocolError("bad_field", f"state: {error}", field="state") from None
        return Restored(step=solver.step)

    def _configured(self) -> MaterialPointSolver:
        if self._solver is None:
            raise ProtocolError("wrong_state", "there is no body: the last configure failed")
        return self._solver


def make_service(folder: Path) -> MaterialPointService:
    """Return the service; it needs no folder."""
    return MaterialPointService()


class _Told:
    """A solver that is relaxed, and says how far it is; see `damping.Relaxable`."""

    def __init__(self, solver: MaterialPointSolver, activity: Activity, most: int) -> None:
        self._solver, self._activity, self._most = solver, activity, most

    def advance(self, steps: int) -> None:
        if self._solver.step % CHUNK == 0:
            self._activity.progress(self._solver.step, self._most, "relaxing")
        self._solver.advance(steps)

    @property
    def kinetic_energy(self) -> float:
        return self._solver.kinetic_energy

    @property
    def residual(self) -> float:
        return self._solver.residual

    def stop(self) -> None:
        self._solver.stop()


class _Edges:
    """What the entries of `edges` are to the solver, and what it tells of them.

    Parameters
    ----------
    edges : list
        Of the request.
    thickness : float
        [m].
    size : (2,) sequence of float
        Extent of the body [m].
    frozen : bool
        Everything stays as it is at time zero.
    material : Material, optional
        What absorbing edges are matched to.
    """

    def __init__(
        self,
        edges: list[messages.AnyEdge],
        thickness: float,
        size: Sequence[float] | FloatArray,
        *,
        frozen: bool,
        material: Material | None = None,
    ) -> None:
        self.conditions: list[EdgeCondition] = []
        self.loads: list[Load] = []
        #: Row of the condition, or None, and nominal force over time, or None, of each entry.
        self._entries: list[tuple[int | None, tuple[float, Constant | Table] | None]] = []
        for edge in edges:
            condition, nominal = None, None
            axis = 0 if edge.edge in ("left", "right") else 1
            outward = 1.0 if edge.edge in ("right", "top") else -1.0
            area = thickness * size[1 - axis]
            if isinstance(edge, messages.EdgeAbsorbing):
                assert material is not None
                self.loads.append(_absorbing(edge.edge, axis, material))
            elif isinstance(edge, messages.EdgeTraction):
                function = _over_time(edge.times, edge.tractions, frozen)
                vector = np.zeros(2)
                vector[edge.component] = 1.0
                self.loads.append(Traction(edge.edge, vector, function))
                nominal = (area, function)
            elif isinstance(edge, messages.EdgePressure):
                function = _over_time(edge.times, edge.pressures, frozen)
                vector = np.zeros(2)
                vector[axis] = -outward
                self.loads.append(Traction(edge.edge, vector, function, follower=True))
                nominal = (-outward * area, function)
            else:
                condition = len(self.conditions)
                self.conditions.append(_condition(edge, frozen))
            self._entries.append((condition, nominal))

    def state(self, reaction: FloatArray, time: float) -> tuple[FloatArray, FloatArray]:
        """Return force on the body [N] and prescribed displacement [m] of each entry."""
        now = np.array([time])
        force, displacement = np.zeros(len(self._entries)), np.zeros(len(self._entries))
        for k, (row, nominal) in enumerate(self._entries):
            if row is not None:
                force[k] = reaction[row]
                displacement[k] = self.conditions[row].displacement(now)[0]
            elif nominal is not None:
                force[k] = nominal[0] * nominal[1](now)[0]
        return force, displacement


def _over_time(times: list[float], values: list[float], frozen: bool) -> Constant | Table:
    return Constant(float(np.interp(0.0, times, values))) if frozen else Table(times, values)


def _condition(
    edge: messages.EdgeCondition | messages.EdgeVelocity | messages.EdgeSymmetry, frozen: bool
) -> EdgeCondition:
    if isinstance(edge, messages.EdgeSymmetry):
        return symmetry(edge.edge)
    if isinstance(edge, messages.EdgeCondition):
        return EdgeCondition(
            edge.edge, edge.component, displacements=_over_time(edge.times, edge.displacements, frozen)
        )
    if frozen:
        return EdgeCondition(edge.edge, edge.component, displacements=Constant(0.0))
    return EdgeCondition(edge.edge, edge.component, velocities=Table(edge.times, edge.velocities))


def _absorbing(edge: Edge, axis: int, material: Material) -> AbsorbingEdge:
    """Return an absorbing edge for waves along its normal."""
    if isinstance(material, LinearElastic):
        normal, shear = material.stiffness[axis, axis], material.stiffness[2, 2]
    else:
        assert isinstance(material, NeoHookean | J2Plasticity)
        normal = material.density * material.pressure_wave_speed**2
        shear = material.young / (2.0 * (1.0 + material.poisson))
    density = material.density
    return AbsorbingEdge(edge, density, float(np.sqrt(normal / density)), float(np.sqrt(shear / density)))


def _make_material(request: messages.ContinuumConfigure) -> Material:
    given = request.material
    constants = {name: value for name, value in given.model_dump().items() if name != "law"}
    try:
        if isinstance(given, messages.OrthotropicMaterial):
            # Moduli out of the plane play no part in it.
            constants |= {"shear_13": given.shear_12, "shear_23": given.shear_12}
        return _LAWS[given.law](**constants, assumption=request.assumption)
    except ValueError as error:
        raise _bad_field(error, {name: f"material.{name}" for name in constants}) from None


def _make_solver(
    request: messages.ContinuumConfigure, material: Material, frozen: bool = False
) -> tuple[MaterialPointSolver, _Edges]:
    """Return the solver of a problem and its edges; frozen, loads and edges stay at their values of time zero."""
    size = np.subtract(request.body.upper, request.body.lower)
    edges = _Edges(request.edges, request.thickness, size, frozen=frozen, material=material)
    loads = list(edges.loads)
    if request.body_force is not None:
        force = request.body_force
        loads.append(BodyForce(force.acceleration, _over_time(force.times, force.factors, frozen)))
    gradient = request.initial_velocity_gradient
    grid, body = _fill(request, size)
    solver = MaterialPointSolver(
        grid,
        body,
        material,
        request.thickness,
        request.time_step,
        edge_conditions=edges.conditions,
        cracks=[Crack(crack.points, crack.contact, crack.friction) for crack in request.cracks],
        damping=Damping(request.damping_rate, request.point_damping_rate, request.force_scaling),
        initial_velocity_gradient=None if gradient is None or frozen else np.reshape(gradient, (2, 2)),
        scheme=Scheme(**request.scheme.model_dump()),
        loads=loads,
    )
    return solver, edges


def _fill(request: messages.ContinuumConfigure, size: FloatArray) -> tuple[Grid | HierarchicalGrid, Body]:
    """Return the grid, with room for the motion of its edges, and the points."""
    moves = [abs(value) for edge in request.edges for value in getattr(edge, "displacements", ())]
    margin = MARGIN_CELLS + int(np.ceil(max(moves, default=0.0) / request.cell_size))
    cells = np.round(size / request.cell_size).astype(int) + 2 * margin
    origin = np.asarray(request.body.lower) - margin * request.cell_size
    uniform = Grid(tuple(origin), request.cell_size, (int(cells[0]), int(cells[1])))
    given = request.overlap
    ring = (
        Overlap(given.inner.lower, given.inner.upper, given.outer.lower, given.outer.upper, given.weight)
        if given
        else None
    )
    hole = (given.inner.lower, given.inner.upper) if given else None
    lower, upper = request.body.lower, request.body.upper
    if not request.refinement:
        return uniform, fill_rectangle(lower, upper, request.cell_size, request.points_per_cell, hole, ring)
    nested = HierarchicalGrid(uniform, [(level.lower, level.upper) for level in request.refinement])
    return nested, fill_hierarchy(nested, lower, upper, request.points_per_cell, hole, ring)


def _levels(request: messages.ContinuumConfigure, solver: MaterialPointSolver) -> list[messages.GridLevel]:
    """Return the levels of the grid with what they hold."""
    grid = solver.grid
    sizes = grid.cell_sizes if isinstance(grid, HierarchicalGrid) else (grid.cell_size,)
    level = np.round(np.log2(0.5 * sizes[0] / request.points_per_cell / solver.points.half)).astype(int)
    counts = np.bincount(level, minlength=len(sizes))
    return [
        messages.GridLevel(cell_size=size, cells=int(count) // request.points_per_cell**2, points=int(count))
        for size, count in zip(sizes, counts, strict=True)
    ]


def _tips(solver: MaterialPointSolver) -> list[messages.CrackTip]:
    if solver.cracks is None:
        return []
    return [
        messages.CrackTip(
            crack=tip.crack, end=tip.end, position=(float(tip.position[0]), float(tip.position[1])), length=tip.length
        )
        for tip in solver.cracks.tips
    ]


def _flat(values: FloatArray) -> FloatArray:
    """Return x and y of vectors: the third component does not exist in a plane problem."""
    return np.ascontiguousarray(values[:, :2])


def _with_z(values: FloatArray) -> FloatArray:
    return np.column_stack([values, np.zeros(len(values))])


def _bad_field(error: ValueError, names: dict[str, str]) -> ProtocolError:
    """Return the solver's complaint with the field as the messages name it."""
    name = re.split(r"[ \[:=.]", str(error), maxsplit=1)[0]
    return ProtocolError("bad_field", str(error), field=names.get(name, name))
