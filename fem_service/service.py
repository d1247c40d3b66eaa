"""The role `structure` on the finite elements of laminates: messages in, messages out."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import zmq
from numpy.typing import NDArray

from fem_service.cell_client import CellClient
from fem_service.hexahedron import POINTS
from fem_service.increments import Steps, next_increment
from fem_service.point_material import PointState
from fem_service.problem import cell_of, grips_of, law_of, mesh_of, shares, steps_of
from fem_service.quasi_static import Equilibrium, NotConverged, QuasiStatic
from protocol import structure as s
from protocol.client import Client
from protocol.errors import ProtocolError
from protocol.messages import CheckpointReply, Empty, FieldsReply, FieldsRequest, Restored, RestoreRequest
from protocol.service import Capabilities, Service
from protocol.version import package_version

#: Fields with one row a node, a brick, or a point of a brick.
FIELDS: Final = ("displacement", "stress", "failed", "layer_damage")
#: Within which a micromechanics service must answer, s.
CONNECT_SECONDS = 30.0


@dataclass
class _Problem:
    """A laminate, where it is, and what its microstructure is asked with."""

    laminate: QuasiStatic
    cell: CellClient
    steps: Steps
    force_share: float
    final_strain: float
    phase: NDArray[np.int64]
    materials: int
    plies: int
    equilibrium: Equilibrium
    size: float


class LaminateService(Service):
    """A laminate that is pulled."""

    role = "structure"
    backend = "fem_service"
    backend_version = package_version()

    def __init__(self) -> None:
        super().__init__()
        self._problem: _Problem | None = None
        self._step = 0

    @property
    def step(self) -> int:
        """Increments made."""
        return self._step

    def capabilities(self) -> Capabilities:
        """Words of this backend."""
        return {"fields": list(FIELDS)}

    def configure(self, request: s.StructureConfigure) -> s.StructureConfigured:
        """Mesh the laminate and register its cell."""
        mesh, law = mesh_of(request), law_of(request)
        cell = CellClient(lambda: self._client(request.micromechanics), cell_of(request), request.temperature)
        try:
            laminate = QuasiStatic(
                mesh,
                cell,
                grips_of(request, mesh),
                law=law,
                mean_dilatation=request.mesh.mean_dilatation,
                tolerance=request.increments.tolerance,
                iterations=request.increments.iterations,
            )
        except ValueError as error:  # elements that are turned inside out
            cell.close()
            raise ProtocolError("bad_field", f"mesh: {error}", field="mesh") from None
        force_share, section = shares(request)
        steps = steps_of(request)
        # A refused request leaves the laminate that there was.
        self.close()
        self._step = 0
        self._problem = _Problem(
            laminate=laminate,
            cell=cell,
            steps=steps,
            force_share=force_share,
            final_strain=request.final_strain,
            phase=request.phase.reshape(-1).copy(),
            materials=len(request.materials),
            plies=len(request.angles),
            equilibrium=laminate.rest(),
            size=steps.first,
        )
        return s.StructureConfigured(
            nodes=mesh.nodes,
            bricks=mesh.bricks,
            ply=mesh.ply,
            layers=mesh.layers,
            interface=mesh.interface,
            points=len(mesh.bricks) * POINTS,
            unknowns=laminate.unknowns,
            cell=cell.registered.cell,
            section=section,
        )

    def advance(self, request: s.StructureAdvance) -> s.StructureAdvanced:
        """Make one increment."""
        problem = self._configured()
        before = problem.equilibrium
        if before.load >= 1.0:
            raise ProtocolError("bad_field", "the whole load acts already", field="largest")
        laminate, cell = problem.laminate, problem.cell
        cell.queried = cell.spared = 0
        cell.seconds = cell.wire = 0.0
        laminate.seconds.clear()
        began = time.perf_counter()
        laminate.watch = lambda done: self.activity.progress(done, laminate.iterations, "finding the equilibrium")
        try:
            made = next_increment(laminate, before, min(problem.size, request.largest), 1.0, problem.steps)
        except NotConverged as error:
            raise ProtocolError("solver_failed", str(error), field="increments", step=self._step) from None
        after = made.equilibrium
        problem.equilibrium, problem.size = after, made.next_size
        self._step += 1
        spent = {**laminate.seconds, "micromechanics": cell.seconds, "wire": cell.wire}
        spent["other"] = max(0.0, time.perf_counter() - began - sum(spent.values()) + cell.wire)
        return s.StructureAdvanced(
            step=self._step,
            load=after.load,
            strain=after.load * problem.final_strain,
            force=self._force(problem, after),
            iterations=made.iterations,
            halved=made.halved,
            residual=after.residual,
            factorisations=laminate.factorisations,
            queried=cell.queried,
            spared=cell.spared,
            new_failures=self._new_failures(problem, before.points.failed, after.points.failed),
            layer_damage=self._layer_damage(problem),
            seconds=spent,
        )

    def fields(self, request: FieldsRequest) -> FieldsReply:
        """Fields of the laminate as it is.

        ``displacement`` (nodes, 3); ``stress`` (bricks, 6), mean of the points, in the axes of the laminate; ``failed``
        (bricks, materials), the share of each material's subcells that has failed; ``layer_damage`` (layers,), mean.
        """
        problem = self._configured()
        found = {}
        for index, name in enumerate(request.names):
            if name not in FIELDS:
                place = f"names.{index}"
                raise ProtocolError(
                    "bad_field", f"{place}: no field {name!r}; there are {', '.join(FIELDS)}", field=place
                )
            found[name] = self._field(problem, name)
        return FieldsReply(step=self._step, fields=found)

    def checkpoint(self, request: Empty) -> CheckpointReply:
        """The whole state."""
        problem = self._configured()
        now = problem.equilibrium
        numbers = np.array([now.load, now.force, now.residual, problem.size, float(self._step)])
        state: dict[str, NDArray[Any]] = {
            "displacement": now.displacement,
            "stress": now.stress,
            "failed": now.points.failed,
            "history": now.points.history,
            "layers": now.layers,
            "numbers": numbers,
        }
        return CheckpointReply(step=self._step, state=state)

    def restore(self, request: RestoreRequest) -> Restored:
        """Set the state."""
        problem = self._configured()
        rest = problem.laminate.rest()
        wanted: dict[str, NDArray[Any]] = {
            "displacement": rest.displacement,
            "stress": rest.stress,
            "failed": rest.points.failed,
            "history": rest.points.history,
            "layers": rest.layers,
            "numbers": np.zeros(5),
        }
        for name, like in wanted.items():
            given = request.state.get(name)
            if given is None or given.shape != like.shape or given.dtype != like.dtype:
                raise ProtocolError(
                    "bad_field",
                    f"state: {name} must be an array of shape {like.shape} and type {like.dtype.str}",
                    field="state",
                )
            if given.dtype.kind == "f" and not np.isfinite(given).all():
                raise ProtocolError("bad_field", f"state: {name} holds a number that is not finite", field="state")
        given_state = {name: request.state[name].copy() for name in wanted}
        load, force, residual, size, step = given_state["numbers"].tolist()
        if request.step != step:
            raise ProtocolError(
                "bad_field", f"step is {request.step}; the state is that of step {step:g}", field="step"
            )
        if not (0.0 <= load <= 1.0 and 0.0 < size <= 1.0):
            raise ProtocolError("bad_field", f"state: numbers has load {load:g} and size {size:g}", field="state")
        problem.size = size
        problem.equilibrium = Equilibrium(
            load=load,
            displacement=given_state["displacement"],
            stress=given_state["stress"],
            points=PointState(given_state["failed"], given_state["history"]),
            layers=given_state["layers"],
            force=force,
            iterations=0,
            residual=residual,
        )
        self._step = request.step
        return Restored(step=self._step)

    def close(self) -> None:
        """Let go of the micromechanics service."""
        if self._problem is not None:
            self._problem.cell.close()

    def _client(self, endpoint: str) -> Client:
        """A new client of the micromechanics service, which `abort` can end while it waits."""
        try:
            return Client.connect(endpoint, "micromechanics", watch=self._look, deadline=CONNECT_SECONDS)
        except zmq.ZMQError as error:
            raise ProtocolError(
                "bad_field", f"micromechanics: {endpoint!r} is no endpoint: {error}", field="micromechanics"
            ) from None

    def _look(self) -> None:
        self.activity.progress(self.activity.done, self.activity.total, self.activity.note)

    def _configured(self) -> _Problem:
        if self._problem is None:
            raise ProtocolError("wrong_state", "there is no laminate")
        return self._problem

    def _force(self, problem: _Problem, at: Equilibrium) -> float:
        """Force on the whole laminate: the work of the grips over the elongation that makes it."""
        elongation = 2.0 * float(np.abs(problem.laminate.grips.per_load).max())
        return at.force * problem.force_share / elongation

    def _new_failures(
        self, problem: _Problem, before: NDArray[np.uint8], after: NDArray[np.uint8]
    ) -> NDArray[np.int64]:
        new = np.unpackbits(after & ~before, axis=1, bitorder="little")[:, : len(problem.phase)]
        by_point = np.zeros((len(new), problem.materials), dtype=np.int64)
        for material in range(problem.materials):
            by_point[:, material] = new[:, problem.phase == material].sum(axis=1)
        found = np.zeros((problem.plies, problem.materials), dtype=np.int64)
        np.add.at(found, np.repeat(problem.laminate.mesh.ply, POINTS), by_point)
        return found

    def _layer_damage(self, problem: _Problem) -> NDArray[np.float64]:
        laminate = problem.laminate
        if laminate.layers is None:
            return np.zeros(0)
        areas, interface = laminate.layers.areas, laminate.mesh.interface
        gone = (problem.equilibrium.layers[:, :, 0] >= 1.0) * areas
        count = problem.plies - 1
        whole = np.bincount(interface, areas.sum(axis=1), count)
        # An interface between plies of one angle has no layer.
        return np.bincount(interface, gone.sum(axis=1), count) / np.where(whole > 0.0, whole, 1.0)

    def _field(self, problem: _Problem, name: str) -> NDArray[np.float64]:
        now, count = problem.equilibrium, len(problem.laminate.mesh.bricks)
        if name == "displacement":
            return now.displacement
        if name == "stress":
            return np.ascontiguousarray(now.stress.mean(axis=1))
        if name == "layer_damage":
            return np.ascontiguousarray(now.layers[:, :, 0].mean(axis=1))
        bits = np.unpackbits(now.points.failed, axis=1, bitorder="little")[:, : len(problem.phase)]
        of_brick = bits.reshape(count, POINTS, -1).mean(axis=1)
        found = [of_brick[:, problem.phase == material].mean(axis=1) for material in range(problem.materials)]
        return np.ascontiguousarray(np.stack(found, axis=1))


def make_service(folder: Path) -> LaminateService:
    """Return the service; it needs no folder."""
    return LaminateService()
