"""The conformance kit passes sound services, and catches each of many services broken in one way."""

from __future__ import annotations

import contextlib
import dataclasses
import threading
import time
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from toy_services import TOYS, Toy, ToyAtomistic, ToyContinuum, ToyMicromechanics

from protocol import atomistic as a
from protocol import continuum as c
from protocol import dispatcher as dispatching
from protocol import micromechanics as m
from protocol.conformance import Check, check_service
from protocol.dispatcher import Dispatcher, Host
from protocol.errors import ProtocolError
from protocol.frames import Envelope, Frame, decode, encode
from protocol.messages import (
    CheckpointReply,
    Empty,
    FieldsReply,
    FieldsRequest,
    Hello,
    Message,
    Restored,
    RestoreRequest,
    Status,
    Welcome,
)
from protocol.roles import CONTROL, ROLES, Operation
from protocol.server import Server, _answer_until

LIMIT = 1 << 22


@contextlib.contextmanager
def served(service: Toy, folder: Path, work: type[Dispatcher], control: type[Dispatcher]) -> Iterator[Server]:
    server = Server(service, f"ipc://{folder}/s", max_message_bytes=LIMIT)
    server.host.work = work(server.host, ROLES[service.role].operations, keeps_state=True)
    server.host.control = control(server.host, CONTROL, keeps_state=False)
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    try:
        yield server
    finally:
        server.stop()
        thread.join(timeout=10)


def held(service: Toy, folder: Path) -> list[Check]:
    with served(service, folder, Dispatcher, Dispatcher) as server:
        return check_service(server.endpoint, deadline=5.0, shutdown=True)


def failures(checks: list[Check]) -> list[str]:
    return [f"{check.name}: {check.detail}" for check in checks if check.passed is not True]


@pytest.mark.parametrize("noise", [False, True], ids=["quiet", "noisy"])
@pytest.mark.parametrize("role", sorted(TOYS))
def test_sound_services_pass_every_check(role: str, noise: bool, tmp_path: Path) -> None:
    amplitude = {"continuum": 1e12, "atomistic": 1e-12, "micromechanics": 0.0}[role]
    checks = held(TOYS[role](amplitude if noise else 0.0), tmp_path)
    assert failures(checks) == []
    assert len(checks) > 85
    assert len({check.name for check in checks}) > 80
    assert all(check.seconds >= 0 for check in checks)


def test_a_large_limit_is_reported_as_not_tried(tmp_path: Path) -> None:
    with served(ToyContinuum(), tmp_path, Dispatcher, Dispatcher) as server:
        server.host.max_message_bytes = 1 << 30
        checks = check_service(server.endpoint, deadline=3.0)
    assert [check.name for check in checks if check.passed is None] == ["size: a message beyond the limit is refused"]
    assert all(check.passed is not False for check in checks)


def test_nobody_there_is_one_failed_check(tmp_path: Path) -> None:
    checks = check_service(f"ipc://{tmp_path}/nobody", deadline=0.3)
    assert [(check.passed, check.name) for check in checks] == [(False, "hello: is answered")]
    assert "no answer within 0.3 s" in checks[0].detail


# --- services broken in one way ----------------------------------------------------------------------------------


class WrongVersionTaken(Host):
    def _welcome(self, hello: Hello) -> Welcome:
        right = hello.model_copy(update={"versions": hello.versions.model_copy(update={"oldest": (1, 0),
                                                                                      "newest": (1, 0)})})  # fmt: skip
        return super()._welcome(right)


class AnyRole(Host):
    def _welcome(self, hello: Hello) -> Welcome:
        return super()._welcome(hello.model_copy(update={"role": self.service.role}))


class WrongUnits(Host):
    def _welcome(self, hello: Hello) -> Welcome:
        return super()._welcome(hello).model_copy(update={"units": "metal"})


class NoFieldNames(ToyContinuum):
    def capabilities(self) -> dict[str, Any]:
        return {"dimension": 2}


class ForgetsReplies(Dispatcher):
    def _kept_reply(self, request: Envelope) -> None:
        return None


class KeepsTooFew(Dispatcher):
    def _keep(self, request: Envelope, answer: list[Frame]) -> None:
        super()._keep(request, answer)
        while len(self._replies) > 1:
            self._replies.popitem(last=False)


class ForgetsIds(Dispatcher):
    def _keep(self, request: Envelope, answer: list[Frame]) -> None:
        super()._keep(request, answer)
        self._answered.clear()


class TakesReusedIds(Dispatcher):
    def _kept_reply(self, request: Envelope) -> list[Frame] | None:
        kept = self._replies.get(request.id)
        return kept[1] if kept else super()._kept_reply(request)


class Edited(Dispatcher):
    """Changes the answers on their way out."""

    def edit(self, answer: Envelope) -> Envelope:
        raise NotImplementedError

    def handle(self, frames: list[Frame]) -> list[Frame]:
        return encode(self.edit(decode([bytes(memoryview(frame)) for frame in super().handle(frames)])))


def replaced(answer: Envelope, **values: Any) -> Envelope:
    return dataclasses.replace(answer, **values)


class OtherId(Edited):
    def edit(self, answer: Envelope) -> Envelope:
        return replaced(answer, id="?")


class SilentStep(Edited):
    def edit(self, answer: Envelope) -> Envelope:
        return replaced(answer, step=0)


class NewSessionEachTime(Edited):
    def edit(self, answer: Envelope) -> Envelope:
        return replaced(answer, session=uuid.uuid4().hex)


class OwnCodes(Edited):
    def edit(self, answer: Envelope) -> Envelope:
        body = {**answer.body, "code": "oops"} if answer.kind == "error" else answer.body
        return replaced(answer, body=body)


class NoFieldPaths(Edited):
    def edit(self, answer: Envelope) -> Envelope:
        body = {**answer.body, "field": ""} if answer.kind == "error" else answer.body
        return replaced(answer, body=body)


class LeavesOutAKey(Edited):
    def edit(self, answer: Envelope) -> Envelope:
        body = {key: value for key, value in answer.body.items() if key != "kinetic_energy"}
        return replaced(answer, body=body)


class AnswersNan(Edited):
    def edit(self, answer: Envelope) -> Envelope:
        if "strain_energy" in answer.body:
            return replaced(answer, body={**answer.body, "strain_energy": float("nan")})
        return answer


class SilentOnNonsense(Dispatcher):
    """Ignores what it cannot read, as a loop with a bare `except: continue` does."""

    def handle(self, frames: list[Frame]) -> list[Frame]:
        decode(frames)
        return super().handle(frames)


class NoStateCheck(Dispatcher):
    def _run(self, request: Envelope) -> Message:
        if request.type in ("hello", "status"):
            return super()._run(request)
        state, self._host.state = self._host.state, "ready"
        try:
            return super()._run(request)
        finally:
            if self._host.state == "ready" and request.type not in ("advance", "register", "equilibrate", "restore"):
                self._host.state = state


class StrictAboutUnknown(Dispatcher):
    def _run(self, request: Envelope) -> Message:
        operation = self._operations.get(request.type)
        known = set(operation.request.model_fields) if operation else set(request.body)
        if set(request.body) - known:
            raise ProtocolError("bad_field", "unknown field", field=sorted(set(request.body) - known)[0])
        return super()._run(request)


class NoSizeCheck(Dispatcher):
    def handle(self, frames: list[Frame]) -> list[Frame]:
        limit, self._host.max_message_bytes = self._host.max_message_bytes, 1 << 40
        try:
            answer = decode(super().handle(frames))
        finally:
            self._host.max_message_bytes = limit
        if answer.type == "hello" and "max_message_bytes" in answer.body:
            answer = replaced(answer, body={**answer.body, "max_message_bytes": limit})
        return encode(answer)


class FailedIsReady(Dispatcher):
    def _state_is_lost(self, operation: Operation) -> None:
        pass


class UncheckedNumbers(Dispatcher):
    """Takes any number for any number, as a service without range checks does."""

    def _run(self, request: Envelope) -> Message:
        operation = self._operations.get(request.type)
        if operation is not None and request.type == "configure":
            try:
                operation.request.from_parts(request.body, request.arrays)
            except ValidationError as error:
                kinds = {problem["type"] for problem in error.errors()}
                if kinds <= {"greater_than", "less_than", "finite_number", "greater_than_equal"}:
                    return c.ContinuumConfigured(
                        courant_number=0.1, stable_time_step=1.0, cells=1, position=np.zeros((1, 3)), weight=np.ones(1)
                    )
        return super()._run(request)


class AcceptsNanArrays(Dispatcher):
    def _run(self, request: Envelope) -> Message:
        arrays = {
            name: array if array.dtype.kind != "f" or name.startswith("state.") else np.nan_to_num(array, posinf=0.0)
            for name, array in request.arrays.items()
        }
        return super()._run(replaced(request, arrays=arrays))


class StatusWaits(Dispatcher):
    def handle(self, frames: list[Frame]) -> list[Frame]:
        end = time.monotonic() + 1.5
        while self._host.service.activity.operation and time.monotonic() < end:
            time.sleep(0.01)
        return super().handle(frames)


class StatusKnowsNothing(Host):
    def _status(self) -> Status:
        return super()._status().model_copy(update={"operation": ""})


class DeafToAbort(Host):
    def perform(self, operation: str, request: Message) -> Message:
        reply = super().perform(operation, request)
        if operation == "abort":
            self.service.activity.abort.clear()
        return reply


class NeverEnds(Host):
    def perform(self, operation: str, request: Message) -> Message:
        reply = super().perform(operation, request)
        if operation == "shutdown":
            self.stopping = False
        return reply


class ForgetsVelocity(ToyContinuum):
    def restore(self, request: RestoreRequest) -> Restored:
        velocity = self.state["velocity"]
        reply = super().restore(request)
        self.state["velocity"] = velocity
        return reply


class CheckpointDoesNotReseed(ToyContinuum):
    def checkpoint(self, request: Empty) -> CheckpointReply:
        return CheckpointReply(step=self.step, state={name: array.copy() for name, array in self.state.items()})


class ForgetsReference(ToyAtomistic):
    def restore(self, request: RestoreRequest) -> Restored:
        reply = super().restore(request)
        self.state["reference"] = np.zeros_like(self.state["reference"])
        return reply


class RestoresAnything(ToyContinuum):
    def restore(self, request: RestoreRequest) -> Restored:
        self.state = {**self.state, **{name: array.copy() for name, array in request.state.items()}}
        self.reseed()
        return Restored(step=self.step)


class ConfigureDropsTheOldProblem(ToyContinuum):
    """Throws the old solver away before it has looked at the new problem."""

    def configure(self, request: c.ContinuumConfigure) -> c.ContinuumConfigured:
        if "velocity" in self.state:
            self.state["velocity"] *= 0.5
        return super().configure(request)


class MovesOneStep(ToyContinuum):
    def advance(self, request: c.ContinuumAdvance) -> c.ContinuumAdvanced:
        return super().advance(request.model_copy(update={"steps": 1}))


class TooManyRows(ToyContinuum):
    def advance(self, request: c.ContinuumAdvance) -> c.ContinuumAdvanced:
        reply = super().advance(request)
        return reply.model_copy(
            update={name: np.vstack([getattr(reply, name)] * 2) for name in ("anchor_displacement", "anchor_velocity")}
        )


class WrongRowsOfFields(ToyContinuum):
    def fields(self, request: FieldsRequest) -> FieldsReply:
        reply = super().fields(request)
        return reply.model_copy(update={"fields": {name: array[1:] for name, array in reply.fields.items()}})


class OutOfPlane(ToyContinuum):
    def advance(self, request: c.ContinuumAdvance) -> c.ContinuumAdvanced:
        reply = super().advance(request)
        return reply.model_copy(update={"anchor_velocity": reply.anchor_velocity + 1e-9})


class WrongSums(ToyAtomistic):
    def advance(self, request: a.AtomisticAdvance) -> a.AtomisticAdvanced:
        reply = super().advance(request)
        return reply.model_copy(update={"ivc_force": -reply.ivc_force})


class TakesAnyForceRows(ToyContinuum):
    def advance(self, request: c.ContinuumAdvance) -> c.ContinuumAdvanced:
        if request.ivc_force is not None:
            request = request.model_copy(update={"ivc_force": request.ivc_force[: len(self.points_of_ivc)]})
        return super().advance(request)


class TakesAnyName(ToyAtomistic):
    def _check_names(self, force_field: str, field: str, material: str) -> None:
        return


class TakesAnyTimeStep(ToyContinuum):
    def configure(self, request: c.ContinuumConfigure) -> c.ContinuumConfigured:
        return super().configure(request.model_copy(update={"time_step": min(request.time_step, 1e-13)}))


class RefusesWithoutSayingWhat(ToyContinuum):
    def configure(self, request: c.ContinuumConfigure) -> c.ContinuumConfigured:
        if request.force_scaling:
            raise ProtocolError("unsupported", "something in there is not for this service")
        return super().configure(request)


class OrderOfSubcells(ToyMicromechanics):
    """Counts subcells column by column in the fields inside the cell."""

    def localise(self, request: m.LocaliseRequest) -> m.Localised:
        reply, cell = super().localise(request), self.cell(request.cell)
        rows, columns = cell.phase.shape
        turned = reply.stress.reshape(-1, rows, columns, 6).transpose(0, 2, 1, 3).reshape(reply.stress.shape)
        return reply.model_copy(update={"stress": np.ascontiguousarray(turned)})


class TensorShear(ToyMicromechanics):
    """Takes shear strains for the components of the tensor."""

    def evaluate(self, request: m.EvaluateRequest) -> m.Evaluated:
        factor = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])
        return super().evaluate(request.model_copy(update={"strain": request.strain * factor}))


class SummedOverAll(ToyMicromechanics):
    """Adds a rounding error that depends on how many points there are."""

    def evaluate(self, request: m.EvaluateRequest) -> m.Evaluated:
        reply = super().evaluate(request)
        return reply.model_copy(update={"stress": reply.stress * (1.0 + 1e-15 * len(reply.stress))})


class RandomIds(ToyMicromechanics):
    def register(self, request: m.RegisterCell) -> m.CellRegistered:
        reply = super().register(request)
        name = uuid.uuid4().hex
        self.cells[name] = self.cells[reply.cell]
        return reply.model_copy(update={"cell": name})


class OneIdForAll(ToyMicromechanics):
    def register(self, request: m.RegisterCell) -> m.CellRegistered:
        reply = super().register(request)
        self.cells["cell"] = self.cells[reply.cell]
        return reply.model_copy(update={"cell": "cell"})


class ForgetsFailure(ToyMicromechanics):
    def evaluate(self, request: m.EvaluateRequest) -> m.Evaluated:
        return super().evaluate(request.model_copy(update={"failed": None}))


class CountsAllFailures(ToyMicromechanics):
    def evaluate(self, request: m.EvaluateRequest) -> m.Evaluated:
        reply = super().evaluate(request)
        return reply.model_copy(update={"new_failures": int(np.unpackbits(reply.failed).sum())})


class TangentOfEachPoint(ToyMicromechanics):
    def evaluate(self, request: m.EvaluateRequest) -> m.Evaluated:
        reply = super().evaluate(request)
        if reply.tangents is None or reply.tangent_index is None:
            return reply
        every = reply.tangents[reply.tangent_index]
        return reply.model_copy(update={"tangents": every, "tangent_index": np.arange(len(every))})


class NearestTemperature(ToyMicromechanics):
    """Takes the nearest entry where a temperature is outside the table."""

    def constants(self, cell: m.RegisterCell, temperature: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        tables = [material.temperatures for material in cell.materials]
        return super().constants(cell, float(np.clip(temperature, max(t[0] for t in tables), 300.0)))


class ExpansionFromZero(ToyMicromechanics):
    def subcell_stress(self, cell: m.RegisterCell, request: Any, bits: np.ndarray, rows: slice) -> np.ndarray:
        return super().subcell_stress(cell.model_copy(update={"stress_free_temperature": 0.0}), request, bits, rows)


class UnknownIsBadField(ToyMicromechanics):
    def cell(self, name: str) -> m.RegisterCell:
        if name not in self.cells:
            raise ProtocolError("bad_field", f"no cell {name!r}", field="cell")
        return self.cells[name]


class TakesAnyBits(ToyMicromechanics):
    def bits(self, cell: m.RegisterCell, failed: np.ndarray | None, points: int) -> np.ndarray:
        return super().bits(cell, None if failed is None else failed[:, :1] & 0x3F, points)


class AlwaysTangents(ToyMicromechanics):
    def evaluate(self, request: m.EvaluateRequest) -> m.Evaluated:
        return super().evaluate(request.model_copy(update={"want_tangent": True}))


BROKEN: list[tuple[str, type]] = [
    ("localise: means", OrderOfSubcells),
    ("properties: stiffness and expansion", TensorShear),
    ("evaluate: any split", SummedOverAll),
    ("register: equal cells", RandomIds),
    ("register: equal cells", OneIdForAll),
    ("evaluate: failure is kept", ForgetsFailure),
    ("evaluate: failure is kept", CountsAllFailures),
    ("evaluate: any split", TangentOfEachPoint),
    ("properties: between temperatures", NearestTemperature),
    ("properties: stiffness and expansion", ExpansionFromZero),
    ("cell: an unknown one", UnknownIsBadField),
    ("wrong rule: evaluate, a byte of bits", TakesAnyBits),
    ("evaluate: absent state", AlwaysTangents),
    ("kinds: force scaling", RefusesWithoutSayingWhat),
    ("hello: ranges that do not meet", WrongVersionTaken),
    ("hello: another role", AnyRole),
    ("hello: is answered", WrongUnits),
    ("hello: is answered", NoFieldNames),
    ("id: a repeated request", ForgetsReplies),
    ("id: a repeated request", KeepsTooFew),
    ("id: an old one", ForgetsIds),
    ("id: one that is used for another", TakesReusedIds),
    ("hello: is answered", OtherId),
    ("advance: moves", SilentStep),
    ("hello: ", NewSessionEachTime),
    ("type: an unknown one", OwnCodes),
    ("wrong field: ", NoFieldPaths),
    ("advance: moves", LeavesOutAKey),
    ("advance: moves", AnswersNan),
    ("malformed: ", SilentOnNonsense),
    ("state new: ", NoStateCheck),
    ("fields: unknown ones are ignored", StrictAboutUnknown),
    ("size: a message beyond", NoSizeCheck),
    ("state failed: ", FailedIsReady),
    ("wrong field: configure thickness", UncheckedNumbers),
    ("wrong field: register anchor_position", AcceptsNanArrays),
    ("control: status while", StatusWaits),
    ("control: status while", StatusKnowsNothing),
    ("control: status while", DeafToAbort),
    ("shutdown: ", NeverEnds),
    ("checkpoint: going back", ForgetsVelocity),
    ("checkpoint: going back", CheckpointDoesNotReseed),
    ("checkpoint: going back", ForgetsReference),
    ("restore: a state that does not fit", RestoresAnything),
    ("wrong fields: none of them disturbed", ConfigureDropsTheOldProblem),
    ("advance: moves", MovesOneStep),
    ("advance: moves", TooManyRows),
    ("fields: each named one", WrongRowsOfFields),
    ("advance: moves", OutOfPlane),
    ("advance: moves", WrongSums),
    ("wrong field: advance ivc_force", TakesAnyForceRows),
    ("wrong rule: configure, unknown force field", TakesAnyName),
    ("wrong rule: configure, time step above", TakesAnyTimeStep),
]


class Caught(Exception):
    """The awaited check failed; no need to go on."""


@pytest.mark.parametrize(("caught_by", "broken"), BROKEN, ids=[broken.__name__ for _, broken in BROKEN])
def test_a_service_broken_in_one_way_is_caught(
    caught_by: str, broken: type, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    service: Toy = ToyContinuum(1e12)
    work = control = Dispatcher
    if issubclass(broken, Toy):
        service = broken(1e12 if issubclass(broken, ToyContinuum) else 1e-12)
    elif issubclass(broken, Host):
        monkeypatch.setattr("protocol.server.Host", broken)
    elif broken is StatusWaits:
        control = StatusWaits
    elif broken is SilentOnNonsense:
        work = broken
        monkeypatch.setattr("protocol.server._answer_until", _passing_over_errors)
    else:
        work = broken
    found: list[Check] = []

    def look(check: Check) -> None:
        found.append(check)
        if check.passed is False and check.name.startswith(caught_by):
            raise Caught

    deadline = 0.3 if broken is SilentOnNonsense else 3.0
    with served(service, tmp_path, work, control) as server, pytest.raises(Caught):
        check_service(server.endpoint, deadline=deadline, shutdown=True, on_check=look)
        print(*failures(found), sep="\n")


def _passing_over_errors(socket: Any, dispatcher: Dispatcher, done: Any) -> None:
    while not done():
        with contextlib.suppress(ProtocolError):
            _answer_until(socket, dispatcher, done)


def test_kept_numbers_are_what_the_kit_relies_on() -> None:
    """The kit repeats an id after three other replies and after forty; both must be told apart by the constants."""
    assert 4 <= dispatching.KEPT_REPLIES < 40 < dispatching.KEPT_IDS
