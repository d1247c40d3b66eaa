"""Holds a running service against the contract of its role, over the wire alone.

Each check is a method of `Kit`; it returns a word for the user, or raises `Refuted`.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import msgpack
import numpy as np

from protocol import atomistic as a
from protocol.arrays import ArraySpec
from protocol.channel import CONNECTED, DISCONNECTED, ZmqChannel
from protocol.conformance_probe import NoAnswer, Probe, Refuted, difference, error_report, expect_error, read_reply
from protocol.conformance_problems import Problem, atomistic_configure, atomistic_problem, continuum_problem
from protocol.errors import ProtocolError
from protocol.frames import Envelope, decode
from protocol.malformed_messages import MALFORMED_ID, malformed_messages
from protocol.messages import (
    Acknowledged,
    CheckpointReply,
    FieldsReply,
    FieldsRequest,
    Message,
    Restored,
    RestoreRequest,
    Status,
    Welcome,
    array_fields,
)
from protocol.roles import ROLES, Role
from protocol.version import NEWEST, OLDEST, Version
from protocol.wrong_requests import WrongRequest, wrong_requests

#: Larger messages are not sent to try the size limit.
LARGEST_TRIED = 1 << 27
#: A service answers on its control socket within this time, s.
CONTROL_SECONDS = 1.0
_REFUSED = ("bad_field", "unsupported")


class NotTried(Exception):
    """The check cannot be made here; the text says why."""


@dataclass(frozen=True)
class Check:
    """What one check found.

    Parameters
    ----------
    name : str
    passed : bool or None
        None where it could not be tried; `detail` says why.
    detail : str
    seconds : float
    """

    name: str
    passed: bool | None
    detail: str
    seconds: float


def check_service(
    endpoint: str,
    *,
    role: str | None = None,
    keys: Path | None = None,
    deadline: float = 60.0,
    shutdown: bool = False,
    on_check: Callable[[Check], None] | None = None,
) -> list[Check]:
    """Hold the service at `endpoint` against `SPEC.md` and return what each check found.

    The service is given a small problem; whatever it held before is lost.

    Parameters
    ----------
    endpoint : str
    role : str, optional
        Role that it must have; by default the kit finds it out.
    keys : Path, optional
        Folder with CURVE keys.
    deadline : float
        Seconds to wait for one answer.
    shutdown : bool
        Also check that the service can be shut down, last of all.
    on_check : callable, optional
        Called with each check when it is done.
    """
    kit = Kit(endpoint, role, keys, deadline, on_check)
    try:
        kit.run(shutdown)
    finally:
        kit.close()
    return kit.checks


class Kit:
    """One pass over one service; see `check_service`."""

    def __init__(
        self,
        endpoint: str,
        role: str | None,
        keys: Path | None,
        deadline: float,
        on_check: Callable[[Check], None] | None = None,
    ) -> None:
        self.checks: list[Check] = []
        self._endpoint, self._keys, self._deadline = endpoint, keys, deadline
        self._wanted_role = role
        self._on_check = on_check
        self._silent = False
        self._work = Probe(ZmqChannel(endpoint, keys), deadline)
        self._control: Probe | None = None
        self._welcome: Welcome | None = None
        self._exchanges = 0
        self._sizes: dict[str, int] = {}

    # --- running -------------------------------------------------------------------------------------------------

    def run(self, shutdown: bool) -> None:
        """Make all checks, in an order in which a later one can build on an earlier one."""
        self._check("hello: is answered", self._hello)
        if self._welcome is None:
            return
        self._check("hello: ranges that do not meet are refused", self._no_common_version)
        self._check("hello: the smaller newest version is taken", self._agreed_version)
        self._check("hello: another role is refused", self._other_role)
        self._check("version: another major in the header is refused", self._other_major)
        for label, frames in malformed_messages():
            self._check(f"malformed: {label}", partial(self._malformed, frames))
        self._check("type: an unknown one is refused", self._unknown_type)
        self._check("fields: unknown ones are ignored", self._unknown_fields)
        self._check("frames: an empty delimiter is understood and returned", self._delimiter)
        self._check("frames: two clients get each their own reply", self._two_clients)
        self._check("control: status is answered", self._control_status)
        if self._welcome.state == "new":
            self._check("state new: what needs a problem is refused", self._nothing_is_set)
        problem = self._check("problem: is set, every reply has its shape", self._set_problem)
        if problem is None:
            return
        self._check("advance: moves the step counter, replies fit the problem", lambda: self._advance_replies(problem))
        self._check("fields: each named one is answered", lambda: self._fields(problem))
        self._check("fields: an unknown name is refused", self._unknown_field_name)
        self._check("id: a repeated request is answered from its reply, run once", lambda: self._repeated(problem))
        self._check("id: an old one is never run again", lambda: self._old_id(problem))
        self._check("id: one that is used for another request is refused", lambda: self._reused_id(problem))
        self._check("checkpoint: going back to it gives the same bits", lambda: self._go_back(problem))
        self._check("checkpoint: a problem set anew goes on with the same bits", lambda: self._resume(problem))
        self._check("restore: a state that does not fit is refused", self._wrong_states)
        self._wrong_fields(problem)
        self._check("control: status while the solver computes, and abort", lambda: self._status_and_abort(problem))
        self._check("state failed: only configure helps", lambda: self._failed(problem))
        self._check("size: a message beyond the limit is refused", self._too_large)
        self._check("size: arrays without rows are understood", lambda: self._zero_rows(problem))
        self._check("end: the service still answers", self._still_there)
        if shutdown:
            self._check("shutdown: the service ends", self._shutdown)

    def close(self) -> None:
        """Close the connections."""
        self._work.close()
        if self._control is not None:
            self._control.close()

    def _check(self, name: str, what: Callable[[], Any]) -> Any:
        """Make one check and note it; return what it returned, or None where it did not pass."""
        began = time.perf_counter()
        found: Any = None
        passed: bool | None = True
        detail = ""
        try:
            if self._silent:
                raise NotTried("the service stopped answering")
            found = what()
            detail = found if isinstance(found, str) else ""
        except NotTried as reason:
            passed, detail = (False if self._silent else None), f"not tried: {reason}"
        except (Refuted, ProtocolError) as problem:
            passed, detail = False, str(problem)
            self._silent = isinstance(problem, NoAnswer) and self._is_silent()
        check = Check(name, passed, detail, time.perf_counter() - began)
        self.checks.append(check)
        if self._on_check is not None:
            self._on_check(check)
        return found

    def _is_silent(self) -> bool:
        """Return whether the service answers nothing any more, not only what it just was asked."""
        try:
            self._work.ask("hello", self._hello_body(), wait=min(5.0, self._deadline))
        except NoAnswer:
            return True
        except Refuted:
            return False
        return False

    # --- helpers -------------------------------------------------------------------------------------------------

    @property
    def _role(self) -> Role:
        assert self._welcome is not None
        return ROLES[self._welcome.role]

    def _hello_body(self, oldest: Version = OLDEST, newest: Version = NEWEST, role: str = "") -> dict[str, Any]:
        wanted = role or (self._welcome.role if self._welcome else self._wanted_role or "continuum")
        return {
            "versions": {"oldest": list(oldest), "newest": list(newest)},
            "role": wanted,
            "client": "scalebridge conformance",
        }

    def _status(self) -> Status:
        return self._work.reply("status", None, Status)

    def _control_probe(self) -> Probe:
        if self._control is None:
            assert self._welcome is not None
            channel = self._work.channel.control(self._welcome.control_endpoint)
            self._control = Probe(channel, self._deadline)
            self._control.session = self._work.session
        return self._control

    def _advance(self, problem: Problem) -> Envelope:
        answer = self._work.ask("advance", problem.advance(self._exchanges))
        self._exchanges += 1
        read_reply(answer, self._role.operations["advance"].reply)
        return answer

    def _advance_from(self, problem: Problem, first: int, count: int) -> list[Envelope]:
        self._exchanges = first
        return [self._advance(problem) for _ in range(count)] + [self._all_fields()]

    def _all_fields(self) -> Envelope:
        assert self._welcome is not None
        names = self._welcome.capabilities.get("fields")
        return self._work.ask("fields", FieldsRequest(names=list(names) if isinstance(names, list) else []))

    def _checkpoint(self) -> CheckpointReply:
        return self._work.reply("checkpoint", None, CheckpointReply)

    def _restore(self, saved: CheckpointReply) -> None:
        request = RestoreRequest(step=saved.step, state=saved.state)
        restored = self._work.reply("restore", request, Restored)
        if restored.step != saved.step:
            raise Refuted(f"restore answers step {restored.step}, the checkpoint has {saved.step}")

    def _expect_state(self, wanted: str) -> None:
        state = self._status().state
        if state != wanted:
            raise Refuted(f"the state is {state!r}, must be {wanted!r}")

    # --- hello, frames, types ------------------------------------------------------------------------------------

    def _hello(self) -> str:
        roles = [self._wanted_role] if self._wanted_role else list(ROLES)
        for role in roles:
            answer = self._work.ask("hello", self._hello_body(role=role))
            if answer.kind == "error" and error_report(answer).code == "role_mismatch" and role != roles[-1]:
                continue
            welcome = read_reply(answer, Welcome)
            if welcome.role not in ROLES:
                raise Refuted(f"the role {welcome.role!r} is none of {', '.join(ROLES)}")
            if self._wanted_role and welcome.role != self._wanted_role:
                raise Refuted(f"hello for the role {self._wanted_role} was answered by the role {welcome.role}")
            self._welcome = welcome
            break
        assert self._welcome is not None
        if self._welcome.units != "SI":
            raise Refuted(f"units are {self._welcome.units!r}, must be 'SI'")
        for name in ("fields", "force_fields", "materials")[: 3 if self._welcome.role == "atomistic" else 1]:
            names = self._welcome.capabilities.get(name)
            if not isinstance(names, list) or (not names and name != "fields"):
                raise Refuted(f"capabilities.{name} must be a list of names, is {names!r}")
        return f"{self._welcome.role} by {self._welcome.backend} {self._welcome.backend_version}"

    def _no_common_version(self) -> None:
        assert self._welcome is not None
        theirs = self._welcome.versions
        for oldest, newest in (
            (Version(theirs.newest[0] + 1, 0), Version(theirs.newest[0] + 1, 7)),
            (Version(0, 1), Version(0, 9)),
        ):
            answer = self._work.ask("hello", self._hello_body(oldest, newest), version=newest)
            report = expect_error(answer, ("version_mismatch",))
            for version in (oldest, newest, Version(*theirs.oldest), Version(*theirs.newest)):
                if str(version) not in report.sentence:
                    raise Refuted(f"the sentence does not name version {version}: {report.sentence}")

    def _agreed_version(self) -> None:
        assert self._welcome is not None
        newest = Version(*self._welcome.versions.newest)
        for oldest, offered in ((OLDEST, newest), (OLDEST, Version(newest.major, newest.minor + 9))):
            reply = read_reply(self._work.ask("hello", self._hello_body(oldest, offered)), Welcome)
            if Version(*reply.version) != min(newest, offered):
                raise Refuted(f"{oldest} to {offered} met version {Version(*reply.version)}, must be {newest}")

    def _other_role(self) -> None:
        for role in (next(name for name in ROLES if name != self._role.name), "no-such-role"):
            report = expect_error(self._work.ask("hello", self._hello_body(role=role)), ("role_mismatch",), ("role",))
            if role not in report.sentence or self._role.name not in report.sentence:
                raise Refuted(f"the sentence does not name both roles: {report.sentence}")

    def _other_major(self) -> None:
        assert self._welcome is not None
        version = Version(self._welcome.versions.newest[0] + 1, 0)
        expect_error(self._work.ask("status", version=version), ("version_mismatch",))

    def _malformed(self, frames: list[bytes]) -> None:
        answer = decode(self._work.ask_frames(frames, MALFORMED_ID, min(5.0, self._deadline)))
        expect_error(answer, ("malformed_message",))

    def _unknown_type(self) -> None:
        expect_error(self._work.ask("no-such-operation"), ("unknown_type",))

    def _unknown_fields(self) -> None:
        body = {**self._hello_body(), "a field of version 1.9": [1, {"x": None}]}
        body["versions"] = {**body["versions"], "unknown": 1}
        frames, request_id = self._work.request("hello", body, {"unknown.array": np.zeros((2, 3))})
        header = {**msgpack.unpackb(frames[0]), "unknown": {"nested": True}}
        answer = decode(self._work.ask_frames([msgpack.packb(header), *frames[1:]], request_id))
        read_reply(answer, Welcome)

    def _delimiter(self) -> None:
        frames, request_id = self._work.request("status")
        answer = self._work.ask_frames([b"", *frames], request_id)
        if len(answer) < 2 or len(answer[0]):
            raise Refuted("the reply to a request with an empty first frame has none")
        read_reply(decode(answer[1:]), Status)

    def _two_clients(self) -> None:
        other = Probe(ZmqChannel(self._endpoint, self._keys), self._deadline)
        try:
            mine, my_id = self._work.request("status")
            theirs, their_id = other.request("hello", self._hello_body())
            self._work.channel.send(mine)
            other.channel.send(theirs)
            read_reply(decode(other.receive(their_id, self._deadline)), Welcome)
            read_reply(decode(self._work.receive(my_id, self._deadline)), Status)
        finally:
            other.close()

    def _control_status(self) -> None:
        self._control_probe().reply("status", None, Status)

    # --- the problem and its replies -----------------------------------------------------------------------------

    def _nothing_is_set(self) -> None:
        for operation in ("fields", "checkpoint"):
            body = FieldsRequest(names=["position"]) if operation == "fields" else None
            expect_error(self._work.ask(operation, body), ("wrong_state",))
        self._expect_state("new")

    def _set_problem(self) -> Problem:
        """Configure and so on up to `ready`, with the state and what is not allowed in it checked on the way."""
        assert self._welcome is not None
        if self._welcome.role == "continuum":
            problem = continuum_problem()
        else:
            try:
                configure = atomistic_configure(self._welcome)
            except ValueError as error:
                raise Refuted(str(error)) from None
            built = self._work.reply("configure", configure, a.AtomisticConfigured)
            problem = atomistic_problem(configure, built)
        self._set(problem, self._check_allowed)
        return problem

    def _set(self, problem: Problem, after_each: Callable[[Problem, str], None] | None = None) -> None:
        for operation, request in problem.steps:
            kind = self._role.operations[operation]
            reply = self._work.reply(operation, request, kind.reply)
            self._note_sizes(reply, problem.sizes)
            if operation == "configure" and self._status().step != 0:
                raise Refuted(f"after configure the step counter is {self._status().step}, must be 0")
            if after_each is not None:
                self._expect_state(str(kind.leads_to))
                after_each(problem, str(kind.leads_to))
        self._exchanges = 0

    def _check_allowed(self, problem: Problem, state: str) -> None:
        requests = {**dict(problem.steps), "advance": problem.advance(0), "checkpoint": None}
        for operation, request in requests.items():
            if state not in self._role.operations[operation].allowed:
                report = expect_error(self._work.ask(operation, request), ("wrong_state",))
                if state not in report.sentence:
                    raise Refuted(f"the sentence does not name the state {state!r}: {report.sentence}")
                self._expect_state(state)

    def _note_sizes(self, reply: Message, sizes: dict[str, int]) -> None:
        """Hold the named sizes of a reply against those of the problem."""
        for name, spec in array_fields(type(reply)).items():
            if not isinstance(spec, ArraySpec):
                continue
            for size, length in zip(spec.shape, getattr(reply, name).shape, strict=True):
                if isinstance(size, str) and sizes.setdefault(size, length) != length:
                    raise Refuted(f"{name} of the reply has {length} {size}, must have {sizes[size]}")

    def _advance_replies(self, problem: Problem) -> None:
        operation = self._role.operations["advance"]
        for number in range(3):
            before = self._status().step
            request = problem.advance(number)
            reply = read_reply(self._work.ask("advance", request, step=number), operation.reply)
            self._exchanges = number + 1
            self._note_sizes(reply, problem.sizes)
            moved, wanted = getattr(reply, "step", None), before + getattr(request, "steps", 0)
            if moved != wanted or self._status().step != wanted:
                raise Refuted(f"the step counter is {moved} after {before} and an advance to {wanted}")
            if isinstance(reply, a.AtomisticAdvanced):
                self._check_ivc_sums(problem, reply)
            else:
                for name in ("anchor_displacement", "anchor_velocity"):
                    if np.any(getattr(reply, name)[:, 2]):
                        raise Refuted(f"{name} has a z component in a plane problem")

    def _check_ivc_sums(self, problem: Problem, reply: a.AtomisticAdvanced) -> None:
        register = problem.request("register")
        assert isinstance(register, a.AtomisticRegister)
        summed = np.zeros_like(reply.ivc_force)
        np.add.at(summed, register.anchor_ivc, reply.anchor_force)
        scale = float(np.abs(reply.anchor_force).sum()) or 1.0
        if float(np.abs(summed - reply.ivc_force).max()) > 1e-12 * scale:
            raise Refuted("ivc_force is not the sum of anchor_force over the anchors of each IVC")
        if (reply.ivc_standard_error < 0).any():
            raise Refuted("ivc_standard_error is negative")

    def _fields(self, problem: Problem) -> None:
        assert self._welcome is not None
        rows = problem.sizes["points" if self._welcome.role == "continuum" else "atoms"]
        names = self._welcome.capabilities["fields"]
        assert isinstance(names, list)
        columns = {
            "position": 3,
            "displacement": 3,
            "velocity": 3,
            "stress": 3 if self._role.name == "continuum" else 6,
        }
        for name in names:
            reply = self._work.reply("fields", FieldsRequest(names=[name]), FieldsReply)
            if set(reply.fields) != {name}:
                raise Refuted(f"asked for {name}, got {sorted(reply.fields)}")
            wanted = (rows, columns[name]) if name in columns else (rows,)
            if reply.fields[name].shape[: len(wanted)] != wanted:
                raise Refuted(f"field {name} has shape {reply.fields[name].shape}, must begin with {wanted}")

    def _unknown_field_name(self) -> None:
        for names in (["no such field"], []):
            body = {"names": names}
            expect_error(self._work.ask("fields", body), _REFUSED, ("names",))

    # --- exactly once --------------------------------------------------------------------------------------------

    def _repeated(self, problem: Problem) -> None:
        frames, request_id = self._work.request("advance", problem.advance(self._exchanges))
        self._exchanges += 1
        first = decode(self._work.ask_frames(frames, request_id))
        read_reply(first, self._role.operations["advance"].reply)
        for others in range(4):
            step = self._status().step if others else None
            again = decode(self._work.ask_frames(frames, request_id))
            if difference(first, again):
                raise Refuted(f"the repeated id got another reply after {others} others: {difference(first, again)}")
            if step is not None and self._status_step_by_control() != step:
                raise Refuted("the repeated request was run again: the step counter moved")
            # One status of the work socket lies between two repeats, so at most three replies came since.
        bad, bad_id = self._work.request("advance", {"steps": "x"})
        one, two = (decode(self._work.ask_frames(bad, bad_id)) for _ in range(2))
        if difference(one, two):
            raise Refuted("a repeated request that was refused got another answer")

    def _status_step_by_control(self) -> int:
        return self._control_probe().reply("status", None, Status).step

    def _old_id(self, problem: Problem) -> str:
        frames, request_id = self._work.request("advance", problem.advance(self._exchanges))
        self._exchanges += 1
        first = decode(self._work.ask_frames(frames, request_id))
        for _ in range(40):
            step = self._status().step
        again = decode(self._work.ask_frames(frames, request_id))
        if self._status().step != step:
            raise Refuted("an id that came again after 40 other requests was run a second time")
        if again.kind == "reply" and not difference(first, again):
            return "its reply is still kept"
        expect_error(again, ("request_expired",))
        return ""

    def _reused_id(self, problem: Problem) -> None:
        frames, request_id = self._work.request("status", step=1)
        self._work.ask_frames(frames, request_id)
        other = self._work.ask("hello", self._hello_body(), request_id=request_id, step=1)
        expect_error(other, ("request_id_reused",))
        expect_error(self._work.ask("status", request_id=request_id, step=2), ("request_id_reused",))

    # --- checkpoint ----------------------------------------------------------------------------------------------

    def _go_back(self, problem: Problem) -> None:
        first = self._exchanges
        saved = self._checkpoint()
        went_on = self._advance_from(problem, first, 2)
        self._restore(saved)
        self._same(went_on, self._advance_from(problem, first, 2), "after restore")

    def _resume(self, problem: Problem) -> None:
        first = self._exchanges
        saved = self._checkpoint()
        went_on = self._advance_from(problem, first, 2)
        for operation, request in problem.steps:
            if operation in ("configure", "register"):
                self._work.reply(operation, request, self._role.operations[operation].reply)
        self._restore(saved)
        self._expect_state("ready")
        self._same(went_on, self._advance_from(problem, first, 2), "after configure, register, restore")

    def _same(self, first: list[Envelope], second: list[Envelope], when: str) -> None:
        for one, two in zip(first, second, strict=True):
            if difference(one, two):
                raise Refuted(f"{when} {one.type} answers other bits: {difference(one, two)}")

    def _wrong_states(self) -> None:
        saved = self._checkpoint()
        name = max(saved.state, key=lambda key: saved.state[key].size)
        state = dict(saved.state)
        array = state.pop(name)
        before = self._all_fields()
        for label, wrong in (
            ("without its largest array", state),
            ("with a row too few", {**state, name: array[:-1]}),
            ("with an axis too many", {**state, name: array[..., None]}),
        ):
            request = RestoreRequest.model_construct(step=saved.step, state=wrong)
            try:
                expect_error(self._work.ask("restore", request), ("bad_field",), ("state",))
            except Refuted as problem:
                raise Refuted(f"a state {label} {problem}") from None
        request = RestoreRequest(step=saved.step + 1, state=saved.state)
        try:
            expect_error(self._work.ask("restore", request), ("bad_field",), ("step",))
        except Refuted as problem:
            raise Refuted(f"a step that is not the checkpoint's {problem}") from None
        if difference(before, self._all_fields()):
            raise Refuted(f"a refused restore changed the fields: {difference(before, self._all_fields())}")

    # --- wrong fields --------------------------------------------------------------------------------------------

    def _wrong_fields(self, problem: Problem) -> None:
        """Make each field wrong in turn; afterwards the solver must be where it was."""
        # Set anew, for a service may take `register` before its first step only.
        self._check("wrong fields: the problem is set anew", partial(self._set, problem))
        first = self._exchanges
        saved = self._check("wrong fields: a checkpoint to compare with", self._checkpoint)
        if saved is None:
            return
        expected = self._check(
            "wrong fields: an advance to compare with", lambda: self._advance_from(problem, first, 1)
        )
        self._check("wrong fields: back to the checkpoint", lambda: self._restore(saved))
        for operation, message in problem.whole:
            groups: dict[str, list[WrongRequest]] = {}
            for wrong in wrong_requests(message, problem.sizes):
                groups.setdefault(wrong.field, []).append(wrong)
            for field, requests in groups.items():
                self._check(
                    f"wrong field: {operation} {field}",
                    partial(self._refused, operation, requests),
                )
        for rule in problem.wrong:
            request = WrongRequest("", rule.label, rule.paths, rule.message.plain_values(), rule.message.array_values())
            self._check(
                f"wrong rule: {rule.operation}, {rule.label}",
                partial(self._refused, rule.operation, [request]),
            )
        self._check(
            "wrong fields: none of them disturbed the solver",
            lambda: self._same(expected or [], self._advance_from(problem, first, 1), "after refused requests"),
        )

    def _refused(self, operation: str, requests: list[WrongRequest]) -> str:
        for request in requests:
            try:
                answer = self._work.ask(operation, request.body, request.arrays)
                expect_error(answer, _REFUSED, request.paths)
            except NoAnswer as problem:
                raise NoAnswer(f"{request.label}: {problem}") from None
            except Refuted as problem:
                raise Refuted(f"{request.label}: {problem}") from None
        return ", ".join(request.label for request in requests)

    # --- control socket, failure, limits -------------------------------------------------------------------------

    def _status_and_abort(self, problem: Problem) -> str:
        self._set(problem)
        operation, request = problem.long
        control = self._control_probe()
        frames, request_id = self._work.request(operation, request)
        self._work.channel.send(frames)
        slowest = 0.0
        end = time.monotonic() + 5.0
        while time.monotonic() < end:
            asked = time.monotonic()
            status = control.reply("status", None, Status, wait=max(10.0, CONTROL_SECONDS))
            slowest = max(slowest, time.monotonic() - asked)
            if status.operation == operation and status.operation_seconds > 0.2:
                break
            early = self._work.channel.receive(0.02)
            if early is not None:
                read_reply(decode(early), self._role.operations[operation].reply)
                raise NotTried(f"{operation} was over before status could be asked for")
        else:
            raise Refuted(f"status never told of {operation} in work")
        if slowest > CONTROL_SECONDS:
            raise Refuted(f"status took {slowest:.2f} s while the solver computed, allowed is {CONTROL_SECONDS:g} s")
        stopped = control.reply("abort", None, Acknowledged)
        if stopped.operation != operation:
            raise Refuted(f"abort names the operation {stopped.operation!r}, in work is {operation!r}")
        asked = time.monotonic()
        answer = decode(self._work.receive(request_id, self._deadline))
        self._work.check_answer(answer, operation, request_id, 0)
        expect_error(answer, ("aborted",))
        ended = time.monotonic() - asked
        return f"status within {slowest * 1e3:.0f} ms, aborted within {ended:.2f} s"

    def _failed(self, problem: Problem) -> None:
        self._expect_state("failed")
        requests = {**dict(problem.steps), "advance": problem.advance(0), "checkpoint": None}
        for operation, request in requests.items():
            if operation != "configure":
                expect_error(self._work.ask(operation, request), ("wrong_state",))
        self._set(problem)
        self._advance(problem)
        idle = self._control_probe().reply("abort", None, Acknowledged)
        if idle.operation:
            raise Refuted(f"abort when idle names the operation {idle.operation!r}")
        self._advance(problem)

    def _too_large(self) -> str:
        assert self._welcome is not None
        limit = self._welcome.max_message_bytes
        if limit > LARGEST_TRIED:
            raise NotTried(f"the limit is {limit} bytes; start the service with at most {LARGEST_TRIED}")
        padding = {"padding": np.zeros(limit + 1, np.uint8)}
        expect_error(self._work.ask("status", {}, padding), ("message_too_large",))
        return f"limit {limit} bytes"

    def _zero_rows(self, problem: Problem) -> str:
        arrays = {
            name: array[:0] if name.startswith(("anchor", "atom", "stiffness", "ivc")) else array
            for name, array in problem.request("register").array_values().items()
        }
        register = self._role.operations["register"]
        self._work.reply("configure", problem.request("configure"), self._role.operations["configure"].reply)
        answer = self._work.ask("register", problem.request("register").plain_values(), arrays)
        if answer.kind == "error":
            expect_error(answer, _REFUSED, ("atom_id", "anchor_position"))
            detail = "no anchors: refused, as a service may"
        else:
            self._note_sizes(read_reply(answer, register.reply), {"ivcs": 0})
            detail = "no anchors: taken"
        self._set(problem)
        return detail

    def _still_there(self) -> None:
        read_reply(self._work.ask("hello", self._hello_body()), Welcome)

    def _shutdown(self) -> None:
        self._work.channel.link_events()
        self._control_probe().reply("shutdown", None, Acknowledged)
        end = time.monotonic() + 5.0
        while time.monotonic() < end:
            if DISCONNECTED in self._work.channel.link_events():
                break
            time.sleep(0.05)
        else:
            raise Refuted("the service keeps its connection 5 s after shutdown")
        fresh = Probe(ZmqChannel(self._endpoint, self._keys), 1.0)
        try:
            time.sleep(0.5)
            if CONNECTED in fresh.channel.link_events():
                raise Refuted("the service still takes connections after shutdown")
        finally:
            fresh.close()
