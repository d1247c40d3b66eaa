"""The continuum role by the material point method: operations of the role in, solver calls out."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar, cast

import numpy as np
import zmq

from mpm_service.cell_client import CellClient
from mpm_service.conditions import Approach
from mpm_service.crack_reports import RULES, CrackReports
from mpm_service.cracks import MOST_CRACKS
from mpm_service.damping import Relaxation as Relaxed
from mpm_service.damping import relax
from mpm_service.errors import SolverError
from mpm_service.k_field import CrackTipField
from mpm_service.laminate import Laminate
from mpm_service.laminate_reports import LaminateReports
from mpm_service.material import Material
from mpm_service.problem import (
    CONFIGURE_NAMES,
    REGISTER_NAMES,
    Edges,
    SolverMaker,
    bad_field,
    crack_tip_field,
    levels_of,
    make_material,
    make_solver,
)
from mpm_service.reference import ReferenceSolver
from mpm_service.solver import MaterialPointSolver
from mpm_service.static_solution import Equilibrium
from protocol import continuum as messages
from protocol.arrays import FloatArray, IntArray
from protocol.client import Client
from protocol.errors import ProtocolError
from protocol.messages import CheckpointReply, Empty, FieldsReply, FieldsRequest, Restored, RestoreRequest
from protocol.security import SecurityError, keys_of_link
from protocol.service import Activity, Capabilities, Service
from protocol.version import package_version

FIELDS = ["position", "displacement", "velocity", "stress", "weight", "failed"]
#: Steps of a preload between two reports of progress.
PROGRESS_EVERY = 100
#: Within which a micromechanics service must answer [s].
CONNECT_SECONDS = 30.0
#: Levels of the grid that are accepted; ten span the sizes of the dissertation's Sec 5.1.
MOST_LEVELS = 12

NOTHING_REGISTERED = messages.ContinuumRegister(
    anchor_position=np.zeros((0, 3)),
    anchor_ivc=np.zeros(0, dtype=np.int64),
    ivc_lower=np.zeros((0, 3)),
    ivc_upper=np.zeros((0, 3)),
)


class MaterialPointService(Service):
    """One material point solver at a time."""

    role = "continuum"
    backend = "mpm_service"
    backend_version = package_version()

    #: Makes the solver; what follows is what that one can do.
    solver: ClassVar[SolverMaker] = MaterialPointSolver
    edge_kinds: ClassVar[list[str]] = [
        "displacement",
        "velocity",
        "symmetry",
        "traction",
        "pressure",
        "absorbing",
        "k_field",
    ]
    contacts: ClassVar[list[str]] = ["frictionless", "stick", "coulomb"]
    growth_rules: ClassVar[list[str]] = list(RULES)
    operations: ClassVar[list[str]] = ["extend_crack"]
    most_levels: ClassVar[int] = MOST_LEVELS
    most_cracks: ClassVar[int] = MOST_CRACKS
    kinks: ClassVar[bool] = True
    loads: ClassVar[bool] = True
    #: Steps between two reports of progress.
    chunk: ClassVar[int] = 100

    def __init__(self) -> None:
        super().__init__()
        self._solver: MaterialPointSolver | None = None
        self._edges = Edges([], 1.0, (0.0, 0.0), (0.0, 0.0), frozen=True)
        self._cracks: CrackReports | None = None
        self._cell: CellClient | None = None
        self._laminate: LaminateReports | None = None
        self._stop_on_loss = False
        self._registered = NOTHING_REGISTERED

    def capabilities(self) -> Capabilities:
        """Return what this backend can do."""
        return {
            "assumptions": ["plane_stress", "plane_strain"],
            "fields": FIELDS,
            "dimension": 2,
            "interpolations": ["linear", "ugimp", "cpgimp", "bspline"],
            "integrations": ["usf", "usl", "musl", "usavg"],
            "transfers": ["flip", "pic", "xpic", "fmpm"],
            "laws": ["isotropic", "orthotropic", "neo_hookean", "j2_plasticity", "laminate"],
            "edge_kinds": self.edge_kinds,
            "contacts": self.contacts,
            "growth_rules": self.growth_rules,
            "levels": self.most_levels,
            "cracks": self.most_cracks,
            "body_force": self.loads,
            "preload": self.loads,
            "spread": ["ivc", "anchor"],
            "operations": self.operations,
        }

    def _unsupported(self, request: messages.ContinuumConfigure) -> Iterator[tuple[str, str]]:
        """Yield field and value of what this backend cannot do."""
        if len(request.refinement) >= self.most_levels:
            yield "refinement", f"{1 + len(request.refinement)} levels; it has at most {self.most_levels}"
        if len(request.cracks) > self.most_cracks:
            yield "cracks", f"{len(request.cracks)} cracks; it has at most {self.most_cracks}"
        for k, edge in enumerate(request.edges):
            if edge.kind not in self.edge_kinds:
                yield f"edges.{k}.kind", f"an edge of kind {edge.kind}; it has {', '.join(self.edge_kinds)}"
        for k, crack in enumerate(request.cracks):
            if len(crack.points) > 2 and not self.kinks:
                yield f"cracks.{k}.points", "a crack with kinks"
            if crack.contact not in self.contacts:
                yield f"cracks.{k}.contact", f"contact {crack.contact}; it has {', '.join(self.contacts)}"
            for name in ("growth", "measure_every"):
                if getattr(crack, name) and not self.growth_rules:
                    yield f"cracks.{k}.{name}", "measurement of crack tips"
        for name in ("body_force", "preload", "initial_field"):
            if getattr(request, name) is not None and not self.loads:
                yield name, f"a {name.replace('_', ' ')}"

    @property
    def step(self) -> int:
        """Steps since configure."""
        return 0 if self._solver is None else self._solver.step

    def configure(self, request: messages.ContinuumConfigure) -> messages.ContinuumConfigured:
        """Fill the body with points, make the solver, relax it where the request says so."""
        for field, what in self._unsupported(request):
            raise ProtocolError("unsupported", f"the backend {self.backend} does not have {what}", field=field)
        material = make_material(request, self._client)
        cell = material.cell if isinstance(material, Laminate) and isinstance(material.cell, CellClient) else None
        try:
            solver, edges = make_solver(request, material, type(self).solver)
            cracks = CrackReports(solver, request)
            relaxation, probed = self._start(request, material, solver)
        except BaseException as error:
            if cell is not None:
                cell.close()
            if isinstance(error, SolverError):
                raise ProtocolError("solver_failed", f"preload: {error}", step=error.step) from error
            if isinstance(error, ValueError):
                raise bad_field(error, CONFIGURE_NAMES) from None
            raise
        self.close()
        self._cell = cell
        self._laminate = None
        if isinstance(material, Laminate) and cell is not None:
            self._laminate = LaminateReports(solver, material, cell.materials)
        self._solver, self._edges, self._cracks, self._registered = solver, edges, cracks, NOTHING_REGISTERED
        self._stop_on_loss = request.on_lost_points == "stop"
        levels = levels_of(request, solver)
        return messages.ContinuumConfigured(
            courant_number=solver.courant_number,
            stable_time_step=solver.stable_time_step,
            cells=sum(level.cells for level in levels),
            levels=levels,
            relaxation=relaxation,
            position=_with_z(solver.points.reference_position),
            weight=solver.points.weight,
            probe_displacement=None if probed is None else _with_z(probed),
        )

    def _start(
        self, request: messages.ContinuumConfigure, material: Material, solver: MaterialPointSolver
    ) -> tuple[messages.Relaxation | None, FloatArray | None]:
        """Give the points the state that the request asks for; returns how a preload ended, and displaced probes."""
        given = request.initial_field
        field = None if given is None else crack_tip_field(given, material, "initial_field")
        probes = None
        if request.probe_position is not None:
            probes = _inside(solver, "probe_position", request.probe_position)
        moved = None if probes is None else field.displacement(probes) if field else np.zeros_like(probes)
        relaxation = None
        if request.preload is not None:
            relaxation, moved = self._preload(request, material, solver, field, probes, moved)
        elif field is not None:
            _deform(solver, field)
        gradient = request.initial_velocity_gradient
        if gradient is not None and (relaxation is not None or field is not None):
            solver.set_velocity(solver.points.reference_position @ np.reshape(gradient, (2, 2)).T)
        return relaxation, moved

    def _preload(
        self,
        request: messages.ContinuumConfigure,
        material: Material,
        solver: MaterialPointSolver,
        field: CrackTipField | None,
        probes: FloatArray | None,
        moved: FloatArray | None,
    ) -> tuple[messages.Relaxation, FloatArray | None]:
        """Bring the whole body to rest under the loads of time zero, and let the solver start from its state."""
        assert request.preload is not None
        size = float(np.subtract(request.body.upper, request.body.lower).max())
        crossing = int(np.ceil(size / (material.pressure_wave_speed * request.time_step)))
        still, _ = make_solver(request, material, type(self).solver, Approach(crossing, field))
        if field is not None:
            _deform(still, field)
        if probes is not None:
            try:
                still.register_anchors(probes, np.zeros(len(probes), dtype=np.int64), moved)
            except ValueError as error:
                raise bad_field(error, {"position": "probe_position"}) from None
        tolerance, most = request.preload.tolerance, request.preload.max_steps
        ended: Equilibrium | Relaxed
        if request.preload.method == "static":
            ended = still.equilibrate(tolerance, most, lambda done: self.activity.progress(done, most, "solving"))
        else:
            ended = relax(_Told(still, self.activity, most), tolerance, most)
        solver.start_from(still)
        relaxation = messages.Relaxation(residual=ended.residual, steps=ended.steps, converged=ended.converged)
        return relaxation, None if probes is None else still.anchor_displacement

    def register(self, request: messages.ContinuumRegister) -> messages.ContinuumRegistered:
        """Place anchors and interface volume cells; where one is refused, both stay as they were."""
        solver = self._configured()
        _inside(solver, "anchor_position", request.anchor_position)
        try:
            found = _place(solver, request)
        except ValueError as error:
            if solver.step == 0:
                _place(solver, self._registered)
            raise bad_field(error, REGISTER_NAMES) from None
        self._registered = request
        return messages.ContinuumRegistered(points_in_ivc=found)

    def advance(self, request: messages.ContinuumAdvance) -> messages.ContinuumAdvanced:
        """Advance under constant reaction forces."""
        solver = self._configured()
        if request.ivc_force is not None and request.anchor_force is not None:
            raise ProtocolError("bad_field", "give ivc_force or anchor_force, not both", field="anchor_force")
        ivc_force = self._force("ivc_force", request.ivc_force, len(self._registered.ivc_lower))
        anchor_force = self._force("anchor_force", request.anchor_force, len(self._registered.anchor_position))
        cracks = self._cracks
        assert cracks is not None
        events: list[messages.ContinuumEvent] = []
        end = solver.step + request.steps
        try:
            while solver.step < end:
                self.activity.progress(request.steps - (end - solver.step), request.steps)
                lost = solver.points_lost
                events += cracks.advance(
                    min(self.chunk, end - solver.step, cracks.next_stop(solver.step)), ivc_force, anchor_force
                )
                if self._laminate is not None:
                    events += self._laminate.events()
                if solver.points_lost > lost:
                    events.append(self._lost(solver.points_lost - lost))
        except (SolverError, ValueError) as error:
            # The request was checked before, so what is wrong now came up on the way.
            raise ProtocolError("solver_failed", str(error), step=solver.step) from error
        energies, momentum = solver.energies(), solver.momentum
        queried, spared = (0, 0) if self._laminate is None else self._laminate.queries()
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
            filter_loss=energies.filter_loss,
            momentum=(float(momentum[0]), float(momentum[1])),
            points_lost=solver.points_lost,
            queried=queried,
            spared=spared,
            tips=cracks.tips(),
            events=events,
        )

    def extend_crack(self, request: messages.CrackExtension) -> messages.CrackExtended:
        """Let a crack go on along given corners from the next step on."""
        if "extend_crack" not in self.operations:
            raise ProtocolError("unsupported", f"the backend {self.backend} does not extend cracks")
        self._configured()
        assert self._cracks is not None
        try:
            return self._cracks.extend(request)
        except ValueError as error:
            raise bad_field(error, {}) from None

    def _force(self, name: str, force: FloatArray | None, rows: int) -> FloatArray | None:
        """Return x and y of a force of as many rows as were registered."""
        if force is not None and len(force) != rows:
            raise ProtocolError("bad_field", f"{name} has {len(force)} rows, registered are {rows}", field=name)
        return None if force is None else _flat(force)

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
        """Return fields of the points; those of `configure` come first, in its order. Vectors have z = 0.

        ``failed`` has the share of each material's subcells that has failed in plies of each direction of fibres, in
        the order of `angles`; without plies it has no columns.
        """
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
            if name == "failed":
                found[name] = np.zeros((points.count, 0)) if self._laminate is None else self._laminate.failed()
                continue
            value = getattr(points, name)
            found[name] = _with_z(value) if value.ndim == 2 and value.shape[1] == 2 else np.ascontiguousarray(value)
        return FieldsReply(step=solver.step, fields=found)

    def checkpoint(self, request: Empty) -> CheckpointReply:
        """Return the state."""
        solver = self._configured()
        assert self._cracks is not None
        state = {**solver.state(), **self._cracks.state()}
        # The wire has no array of truth values; bytes of 0 and 1 mean the same to the solver.
        plain = {name: value.astype(np.uint8) if value.dtype == bool else value for name, value in state.items()}
        return CheckpointReply(step=solver.step, state=plain)

    def restore(self, request: RestoreRequest) -> Restored:
        """Set the state."""
        solver = self._configured()
        step = request.state.get("step")
        if step is None or step.size == 0 or int(step.flat[0]) != request.step:
            raise ProtocolError("bad_field", f"step {request.step} is not the step of the state", field="step")
        assert self._cracks is not None
        try:
            self._cracks.check(request.state)
            solver.restore(request.state)
            self._cracks.restore(request.state)
            if self._laminate is not None:
                self._laminate.catch_up()
        except (ValueError, KeyError) as error:
            raise ProtocolError("bad_field", f"state: {error}", field="state") from None
        return Restored(step=solver.step)

    def close(self) -> None:
        """Let go of the micromechanics service."""
        if self._cell is not None:
            self._cell.close()
            self._cell = None

    def _client(self, endpoint: str) -> Client:
        """A new client of the micromechanics service, which `abort` can end while it waits."""
        field = "material.micromechanics"
        try:
            return Client.connect(
                endpoint,
                "micromechanics",
                keys=keys_of_link(endpoint, self.link_keys),
                watch=self._look,
                deadline=CONNECT_SECONDS,
            )
        except SecurityError as error:
            raise ProtocolError("bad_field", f"{field}: {error}", field=field) from None
        except zmq.ZMQError as error:
            raise ProtocolError("bad_field", f"{field}: {endpoint!r} is no endpoint: {error}", field=field) from None

    def _look(self) -> None:
        self.activity.progress(self.activity.done, self.activity.total, self.activity.note)

    def _configured(self) -> MaterialPointSolver:
        if self._solver is None:
            raise ProtocolError("wrong_state", "there is no body: the last configure failed")
        return self._solver


class ReferenceService(MaterialPointService):
    """The same scheme in plain numpy, to hold the compiled one against."""

    backend = "reference"
    # Same arguments and attributes, as far as this service uses them.
    solver = cast(SolverMaker, ReferenceSolver)
    edge_kinds: ClassVar[list[str]] = ["displacement", "velocity", "symmetry"]
    contacts: ClassVar[list[str]] = ["frictionless"]
    growth_rules: ClassVar[list[str]] = []
    operations: ClassVar[list[str]] = []
    most_levels = 1
    most_cracks = 1
    kinks = False
    loads = False
    chunk = 5


def make_service(folder: Path) -> MaterialPointService:
    """Return the service; it needs no folder."""
    return MaterialPointService()


def make_reference_service(folder: Path) -> ReferenceService:
    """Return the service on the numpy solver; it needs no folder."""
    return ReferenceService()


class _Told:
    """A solver that is relaxed, and says how far it is; see `damping.Relaxable`."""

    def __init__(self, solver: MaterialPointSolver, activity: Activity, most: int) -> None:
        self._solver, self._activity, self._most = solver, activity, most

    def advance(self, steps: int) -> None:
        if self._solver.step % PROGRESS_EVERY == 0:
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


def _inside(solver: MaterialPointSolver, name: str, position: FloatArray) -> FloatArray:
    """Return x and y of places, which must lie in the body."""
    place = _flat(position)
    outside = np.flatnonzero(np.any((place < solver.body.lower) | (place > solver.body.upper), axis=1))
    if outside.size:
        row = int(outside[0])
        sentence = f"{name} row {row} ({place[row, 0]:.9g}, {place[row, 1]:.9g}) m lies outside the body"
        raise ProtocolError("bad_field", sentence, field=name)
    return place


def _deform(solver: MaterialPointSolver, field: CrackTipField) -> None:
    """Give the points displacement, gradient and stress of a field."""
    place = solver.points.reference_position
    solver.deform(field.displacement(place), field.gradient(place))


def _place(solver: MaterialPointSolver, request: messages.ContinuumRegister) -> IntArray:
    """Register anchors and cells, return the number of points in each cell."""
    moved = request.anchor_displacement
    solver.register_anchors(_flat(request.anchor_position), request.anchor_ivc, None if moved is None else _flat(moved))
    found = solver.register_interface_cells(_flat(request.ivc_lower), _flat(request.ivc_upper))
    return np.asarray(found, dtype=np.int64)


def _flat(values: FloatArray) -> FloatArray:
    """Return x and y of vectors: the third component does not exist in a plane problem."""
    return np.ascontiguousarray(values[:, :2])


def _with_z(values: FloatArray) -> FloatArray:
    return np.column_stack([values, np.zeros(len(values))])
