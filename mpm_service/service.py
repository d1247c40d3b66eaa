"""The continuum role by the material point method: messages in, solver calls out. The only file that sees both."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from mpm_service.boundary import EdgeCondition
from mpm_service.crack import Crack
from mpm_service.errors import SolverError
from mpm_service.grid import Grid
from mpm_service.material_points import Overlap, fill_rectangle
from mpm_service.materials import IsotropicElastic
from mpm_service.solver import MaterialPointSolver
from protocol import continuum as messages
from protocol.arrays import FloatArray
from protocol.errors import ProtocolError
from protocol.messages import CheckpointReply, Empty, FieldsReply, FieldsRequest, Restored, RestoreRequest
from protocol.service import Capabilities, Service
from protocol.version import package_version

FIELDS = ["position", "displacement", "velocity", "stress", "weight"]
#: Cells around the body, so that domains of points near an edge stay inside the grid.
MARGIN_CELLS = 3
#: Steps between two reports of progress.
CHUNK = 100
#: Names of solver arguments as the messages have them.
FIELD_NAMES = {
    "position": "anchor_position",
    "ivc": "anchor_ivc",
    "lower": "ivc_lower",
    "upper": "ivc_upper",
    "edge_conditions": "edges",
    "crack": "cracks",
    "Crack": "cracks",
}


class MaterialPointService(Service):
    """One material point solver at a time."""

    role = "continuum"
    backend = "mpm_service"
    backend_version = package_version()

    def __init__(self) -> None:
        super().__init__()
        self._solver: MaterialPointSolver | None = None
        self._edges: list[EdgeCondition] = []
        self._time_step = 0.0

    def capabilities(self) -> Capabilities:
        """Return assumptions, fields, and the number of cracks."""
        return {
            "assumptions": ["plane_stress", "plane_strain"],
            "fields": FIELDS,
            "dimension": 2,
            "cracks": 1,
            "spread": ["ivc", "anchor"],
        }

    @property
    def step(self) -> int:
        """Steps since configure."""
        return 0 if self._solver is None else self._solver.step

    def configure(self, request: messages.ContinuumConfigure) -> messages.ContinuumConfigured:
        """Fill the body with points and make the solver."""
        if len(request.cracks) > 1 or any(len(crack.points) != 2 for crack in request.cracks):
            raise ProtocolError("unsupported", "this backend has at most one straight crack", field="cracks")
        edges = [EdgeCondition(edge.edge, edge.component, edge.times, edge.displacements) for edge in request.edges]
        try:
            solver = _make_solver(request, edges)
        except ValueError as error:
            raise _bad_field(error) from None
        self._solver, self._edges, self._time_step = solver, edges, request.time_step
        points = solver.points
        return messages.ContinuumConfigured(
            courant_number=solver.courant_number,
            stable_time_step=solver.stable_time_step,
            cells=points.count // request.points_per_cell**2,
            position=_with_z(points.position),
            weight=points.weight,
        )

    def register(self, request: messages.ContinuumRegister) -> messages.ContinuumRegistered:
        """Place anchors and interface volume cells."""
        solver = self._configured()
        try:
            solver.register_anchors(_flat(request.anchor_position), request.anchor_ivc)
            found = solver.register_interface_cells(_flat(request.ivc_lower), _flat(request.ivc_upper))
        except ValueError as error:
            raise _bad_field(error) from None
        return messages.ContinuumRegistered(points_in_ivc=np.asarray(found, dtype=np.int64))

    def advance(self, request: messages.ContinuumAdvance) -> messages.ContinuumAdvanced:
        """Advance under constant reaction forces."""
        solver = self._configured()
        if request.ivc_force is not None and request.anchor_force is not None:
            raise ProtocolError("bad_field", "give ivc_force or anchor_force, not both", field="anchor_force")
        ivc_force = None if request.ivc_force is None else _flat(request.ivc_force)
        anchor_force = None if request.anchor_force is None else _flat(request.anchor_force)
        try:
            for done in range(0, request.steps, CHUNK):
                if done:
                    self.activity.progress(done, request.steps)
                solver.advance(min(CHUNK, request.steps - done), ivc_force=ivc_force, anchor_force=anchor_force)
        except SolverError as error:
            raise ProtocolError("solver_failed", str(error), step=solver.step) from error
        except ValueError as error:
            raise _bad_field(error) from None
        energies = solver.energies()
        time = np.array([solver.step * self._time_step])
        return messages.ContinuumAdvanced(
            step=solver.step,
            anchor_displacement=_with_z(solver.anchor_displacement),
            anchor_velocity=_with_z(solver.anchor_velocity),
            edge_force=np.asarray(solver.edge_reaction, dtype=np.float64),
            edge_displacement=np.array([float(edge.displacement(time)[0]) for edge in self._edges]),
            kinetic_energy=energies.kinetic,
            strain_energy=energies.strain,
            edge_work=energies.edge_work,
            interface_work=energies.interface_work,
            damping_loss=energies.damping_loss,
            points_lost=solver.points_lost,
        )

    def fields(self, request: FieldsRequest) -> FieldsReply:
        """Return fields of the points in the order of `configure`; vectors have a z component of 0."""
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


def _flat(values: FloatArray) -> FloatArray:
    """Return x and y of vectors: the third component does not exist in a plane problem."""
    return np.ascontiguousarray(values[:, :2])


def _with_z(values: FloatArray) -> FloatArray:
    return np.column_stack([values, np.zeros(len(values))])


def _make_solver(request: messages.ContinuumConfigure, edges: list[EdgeCondition]) -> MaterialPointSolver:
    """Return the solver of a problem."""
    material = request.material
    overlap = request.overlap
    body = fill_rectangle(
        request.body.lower,
        request.body.upper,
        request.cell_size,
        request.points_per_cell,
        hole=(overlap.inner.lower, overlap.inner.upper) if overlap else None,
        overlap=Overlap(
            overlap.inner.lower, overlap.inner.upper, overlap.outer.lower, overlap.outer.upper, overlap.weight
        )
        if overlap
        else None,
    )
    largest = max((abs(d) for edge in request.edges for d in edge.displacements), default=0.0)
    margin = MARGIN_CELLS + int(np.ceil(largest / request.cell_size))
    size = np.asarray(request.body.upper) - np.asarray(request.body.lower)
    cells = np.round(size / request.cell_size).astype(int) + 2 * margin
    origin = np.asarray(request.body.lower) - margin * request.cell_size
    return MaterialPointSolver(
        Grid(tuple(origin), request.cell_size, (int(cells[0]), int(cells[1]))),
        body,
        IsotropicElastic(material.young, material.poisson, material.density, request.assumption),
        request.thickness,
        request.time_step,
        edge_conditions=edges,
        crack=Crack((request.cracks[0].points[0], request.cracks[0].points[1])) if request.cracks else None,
        damping_rate=request.damping_rate,
        initial_velocity_gradient=np.reshape(request.initial_velocity_gradient, (2, 2))
        if request.initial_velocity_gradient is not None
        else None,
    )


def _bad_field(error: ValueError) -> ProtocolError:
    """Return the solver's complaint with the field as the messages name it."""
    name = re.split(r"[ \[:=]", str(error), maxsplit=1)[0]
    return ProtocolError("bad_field", str(error), field=FIELD_NAMES.get(name, name))
