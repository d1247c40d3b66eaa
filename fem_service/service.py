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
from fem_service.equilibrium import Equilibrium, NotConverged
from fem_service.factorisation import fastest
from fem_service.hexahedron import POINTS
from fem_service.increments import Increment, Steps, next_increment
from fem_service.path_following import PathIncrement, next_on_path
from fem_service.point_material import PointState
from fem_service.problem import cell_of, dissipation_of, grips_of, law_of, mesh_of, shares
from fem_service.quasi_static import QuasiStatic
from fem_service.watched_bricks import watch
from protocol import structure as s
from protocol.client import Client
from protocol.errors import ProtocolError
from protocol.messages import CheckpointReply, Empty, FieldsReply, FieldsRequest, Restored, RestoreRequest
from protocol.security import SecurityError, keys_of_link
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
    dissipation: float | None
    share: float
    final_strain: float
    phase: NDArray[np.int64]
    materials: int
    plies: int
    equilibrium: Equilibrium
    size: float
    work: float = 0.0
    by_dissipation: bool = False

    def next(self, largest: float) -> Increment:
        """The next increment, by the load or on the path."""
        if self.dissipation is None:
            return next_increment(self.laminate, self.equilibrium, min(self.size, largest), 1.0, self.steps)
        return next_on_path(
            self.laminate,
            self.equilibrium,
            self.size,
            1.0,
            self.steps,
            self.dissipation,
            largest=min(self.steps.most, largest),
            by_dissipation=self.by_dissipation,
        )

    def take(self, made: Increment) -> None:
        """Go to the end of an increment."""
        before, after = self.equilibrium, made.equilibrium
        self.work += 0.5 * (before.force + after.force) * (after.load - before.load)
        self.equilibrium, self.size = after, made.next_size
        self.by_dissipation = isinstance(made, PathIncrement) and made.by_dissipation

    def force(self) -> float:
        """Force on the whole laminate, N: the work of the grips over the elongation that makes it."""
        elongation = 2.0 * float(np.abs(self.laminate.grips.per_load).max())
        return self.equilibrium.force * self.share / elongation

    def bricks(self, watched: list[int]) -> NDArray[np.int64]:
        """Numbers of the bricks that are watched; ``bad_field`` where there is no such brick."""
        count = len(self.laminate.mesh.bricks)
        for place, brick in enumerate(watched):
            if brick >= count:
                where = f"watched.{place}"
                raise ProtocolError(
                    "bad_field", f"{where}: there is no brick {brick}, only 0 to {count - 1}", field=where
                )
        return np.array(watched, dtype=np.int64)

    def failures(self, failed: NDArray[np.uint8]) -> NDArray[np.int64]:
        """Subcells by brick and material, shape (bricks, materials), of the bits that are set at all points."""
        bits = np.unpackbits(failed, axis=1, bitorder="little")[:, : len(self.phase)]
        of_brick = bits.reshape(len(self.laminate.mesh.bricks), -1, len(self.phase)).sum(axis=1)
        counts = [of_brick[:, self.phase == material].sum(axis=1) for material in range(self.materials)]
        return np.stack(counts, axis=1).astype(np.int64)

    def new_failures(self, before: Equilibrium) -> NDArray[np.int64]:
        """Subcells that have failed since, shape (plies, materials)."""
        new = self.failures(self.equilibrium.points.failed & ~before.points.failed)
        found = np.zeros((self.plies, self.materials), dtype=np.int64)
        np.add.at(found, self.laminate.mesh.ply, new)
        return found

    def layer_damage(self) -> NDArray[np.float64]:
        """Share of the area of each interface that has no traction left; none where no plies are parted by layers."""
        layers, interface = self.laminate.layers, self.laminate.mesh.interface
        if layers is None:
            return np.zeros(0)
        gone = (self.equilibrium.layers[:, :, 0] >= 1.0) * layers.areas
        count = self.plies - 1
        whole = np.bincount(interface, layers.areas.sum(axis=1), count)
        # An interface between plies of one angle has no layer.
        return np.bincount(interface, gone.sum(axis=1), count) / np.where(whole > 0.0, whole, 1.0)

    def field(self, name: str) -> NDArray[np.float64]:
        """One of `FIELDS`."""
        now = self.equilibrium
        if name == "displacement":
            return now.displacement
        if name == "stress":
            return np.ascontiguousarray(now.stress.mean(axis=1))
        if name == "layer_damage":
            return np.ascontiguousarray(now.layers[:, :, 0].mean(axis=1))
        subcells = np.bincount(self.phase, minlength=self.materials)
        # A material may be defined and have no subcell.
        return self.failures(now.points.failed) / (POINTS * np.maximum(subcells, 1))


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
        return {"fields": list(FIELDS), "solver": [fastest().name]}

    def configure(self, request: s.StructureConfigure) -> s.StructureConfigured:
        """Mesh the laminate and register its cell."""
        mesh, law, dissipation = mesh_of(request), law_of(request), dissipation_of(request)
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
                viscosity=request.increments.viscosity,
                factoriser=fastest(),
            )
        except ValueError as error:  # elements that are turned inside out
            cell.close()
            raise ProtocolError("bad_field", f"mesh: {error}", field="mesh") from None
        share, section = shares(request)
        sizes = request.increments
        steps = Steps(sizes.first, sizes.least, sizes.most)
        # A refused request leaves the laminate that there was.
        self.close()
        self._step = 0
        self._problem = _Problem(
            laminate=laminate,
            cell=cell,
            steps=steps,
            dissipation=dissipation,
            share=share,
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
        bricks = problem.bricks(request.watched)
        laminate, cell = problem.laminate, problem.cell
        cell.queried = cell.spared = 0
        cell.link.seconds = cell.link.wire = 0.0
        laminate.seconds.clear()
        began = time.perf_counter()
        laminate.watch = lambda done: self.activity.progress(done, laminate.iterations, "finding the equilibrium")
        try:
            made = problem.next(request.largest)
        except NotConverged as error:
            raise ProtocolError("solver_failed", str(error), field="increments", step=self._step) from None
        after = made.equilibrium
        # Before the increment counts: the microstructure may be gone.
        watched = watch(laminate, after, bricks, cell.localise) if len(bricks) else None
        problem.take(made)
        self._step += 1
        spent = {**laminate.seconds, "micromechanics": cell.link.seconds, "wire": cell.link.wire}
        spent["other"] = max(0.0, time.perf_counter() - began - sum(spent.values()) + cell.link.wire)
        return s.StructureAdvanced(
            step=self._step,
            load=after.load,
            strain=after.load * problem.final_strain,
            force=problem.force(),
            iterations=made.iterations,
            halved=made.halved,
            residual=after.residual,
            factorisations=laminate.factorisations,
            queried=cell.queried,
            spared=cell.spared,
            new_failures=problem.new_failures(before),
            layer_damage=problem.layer_damage(),
            seconds=spent,
            work=problem.work * problem.share,
            viscous_energy=after.viscous_energy * problem.share,
            watched_strain=watched.strain if watched else None,
            watched_stress=watched.stress if watched else None,
            watched_subcells=watched.subcells if watched else None,
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
            found[name] = problem.field(name)
        return FieldsReply(step=self._step, fields=found)

    def checkpoint(self, request: Empty) -> CheckpointReply:
        """The whole state."""
        problem = self._configured()
        now = problem.equilibrium
        numbers = [
            now.load,
            now.force,
            now.residual,
            now.viscous_energy,
            problem.size,
            problem.work,
            float(problem.by_dissipation),
            float(self._step),
        ]
        return CheckpointReply(step=self._step, state={**_arrays(now), "numbers": np.array(numbers)})

    def restore(self, request: RestoreRequest) -> Restored:
        """Set the state."""
        problem = self._configured()
        wanted = {**_arrays(problem.laminate.rest()), "numbers": np.zeros(8)}
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
        load, force, residual, viscous, size, work, by_dissipation, step = given_state["numbers"].tolist()
        if request.step != step:
            raise ProtocolError(
                "bad_field", f"step is {request.step}; the state is that of step {step:g}", field="step"
            )
        if not (0.0 <= load <= 1.0 and 0.0 < size <= 1.0):
            raise ProtocolError("bad_field", f"state: numbers has load {load:g} and size {size:g}", field="state")
        problem.size, problem.work, problem.by_dissipation = size, work, bool(by_dissipation)
        problem.equilibrium = Equilibrium(
            load=load,
            displacement=given_state["displacement"],
            stress=given_state["stress"],
            points=PointState(given_state["failed"], given_state["history"]),
            layers=given_state["layers"],
            force=force,
            iterations=0,
            residual=residual,
            viscous_energy=viscous,
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
            return Client.connect(
                endpoint,
                "micromechanics",
                keys=keys_of_link(endpoint, self.link_keys),
                watch=self._look,
                deadline=CONNECT_SECONDS,
            )
        except zmq.ZMQError as error:
            raise ProtocolError(
                "bad_field", f"micromechanics: {endpoint!r} is no endpoint: {error}", field="micromechanics"
            ) from None
        except SecurityError as error:
            raise ProtocolError("bad_field", f"micromechanics: {error}", field="micromechanics") from None

    def _look(self) -> None:
        self.activity.progress(self.activity.done, self.activity.total, self.activity.note)

    def _configured(self) -> _Problem:
        if self._problem is None:
            raise ProtocolError("wrong_state", "there is no laminate")
        return self._problem


def _arrays(of: Equilibrium) -> dict[str, NDArray[Any]]:
    """The arrays of a checkpoint."""
    return {
        "displacement": of.displacement,
        "stress": of.stress,
        "failed": of.points.failed,
        "history": of.points.history,
        "layers": of.layers,
    }


def make_service(folder: Path) -> LaminateService:
    """Return the service; it needs no folder."""
    return LaminateService()
