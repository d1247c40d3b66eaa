"""Checks of the conformance kit that need a problem: replies, states, checkpoints, wrong fields, control.

Each check is a method; it returns a word for the user, or raises `Refuted`.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

import numpy as np

from protocol import atomistic as a
from protocol.arrays import ArraySpec
from protocol.channel import CONNECTED, DISCONNECTED, ZmqChannel
from protocol.conformance_kit import KitBase, NotTried
from protocol.conformance_probe import NoAnswer, Probe, Refuted, difference, expect_error, read_reply
from protocol.conformance_problems import Problem, Requests, continuum_problem
from protocol.frames import Envelope, decode
from protocol.messages import (
    Acknowledged,
    FieldsReply,
    FieldsRequest,
    Message,
    RestoreRequest,
    Status,
    Welcome,
    array_fields,
    newer_fields,
)
from protocol.version import Version
from protocol.wrong_requests import WrongRequest, wrong_requests

#: Larger messages are not sent to try the size limit.
LARGEST_TRIED = 1 << 27
#: A service answers on its control socket within this time, s.
CONTROL_SECONDS = 1.0
REFUSED = ("bad_field", "unsupported")


class SolverChecks(KitBase):
    """Checks on a small problem of the service's role."""

    def _nothing_is_set(self) -> None:
        for operation in ("fields", "checkpoint"):
            body = FieldsRequest(names=["position"]) if operation == "fields" else None
            expect_error(self._work.ask(operation, body), ("wrong_state",))
        self._expect_state("new")

    def _set_problem(self) -> Problem:
        """Configure and so on up to `ready`, with the state and what is not allowed in it checked on the way."""
        assert self._welcome is not None
        problem = continuum_problem() if self._welcome.role == "continuum" else self._atomistic_problem()
        self._set(problem, self._check_allowed)
        return problem

    def _atomistic_problem(self) -> Problem:
        # Here, since that module stands on this one.
        from protocol.conformance_atomistic import atomistic_configure, atomistic_problem

        assert self._welcome is not None
        try:
            configure = atomistic_configure(self._welcome)
        except ValueError as error:
            raise Refuted(str(error)) from None
        built = self._work.reply("configure", configure, a.AtomisticConfigured)
        words = self._welcome.capabilities.get("ensembles")
        return atomistic_problem(configure, built, tuple(words) if isinstance(words, list) else ())

    def _set(
        self, problem: Problem, after_each: Callable[[Problem, str], None] | None = None, collect: bool = False
    ) -> None:
        for operation, request in problem.steps:
            if collect and operation == "equilibrate":
                self._work.reply("collect_fields", a.CollectRequest(active=True), a.Collecting)
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
            if getattr(reply, name) is None:  # an optional array that the service does not give
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
            **dict.fromkeys(("position", "displacement", "velocity", "mean_position", "mean_velocity"), 3),
            "virial": 6,
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
            expect_error(self._work.ask("fields", body), REFUSED, ("names",))

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
        self._each_wrong(problem)
        self._check(
            "wrong fields: none of them disturbed the solver",
            lambda: self._same(expected or [], self._advance_from(problem, first, 1), "after refused requests"),
        )

    def _each_wrong(self, problem: Problem) -> None:
        """Make a check of each field of the problem's whole requests, and of each of its rules."""
        assert self._welcome is not None
        version = Version(*self._welcome.version)
        for operation, message in problem.whole:
            if newer_fields(message, version):
                continue
            groups: dict[str, list[WrongRequest]] = {}
            for wrong in wrong_requests(message, problem.sizes, version):
                groups.setdefault(wrong.field, []).append(wrong)
            for field, requests in groups.items():
                self._check(
                    f"wrong field: {operation} {field}",
                    partial(self._refused, operation, requests),
                )
        for rule in problem.wrong:
            if newer_fields(rule.message, version):
                continue
            request = WrongRequest("", rule.label, rule.paths, rule.message.plain_values(), rule.message.array_values())
            self._check(
                f"wrong rule: {rule.operation}, {rule.label}",
                partial(self._refused, rule.operation, [request]),
            )

    def _kinds(self, problem: Problem) -> None:
        """Each thing that a service may have or not is taken, or refused as such."""
        assert self._welcome is not None
        version = Version(*self._welcome.version)
        for label, requests in problem.kinds:
            if not any(newer_fields(request, version) for _, request in requests):
                self._check(f"kinds: {label}", partial(self._taken_or_unsupported, requests))

    def _taken_or_unsupported(self, requests: Requests) -> str:
        sizes: dict[str, int] = {}
        for operation, request in requests:
            before = self._status().step
            answer = self._work.ask(operation, request)
            if answer.kind == "error":
                report = expect_error(answer, ("unsupported",))
                if not report.field:
                    raise Refuted(f"the error names no field: {report.sentence}")
                return f"unsupported: {report.field}"
            reply = read_reply(answer, self._role.operations[operation].reply)
            self._note_sizes(reply, sizes)
            if isinstance(request, a.EquilibrateRequest) and isinstance(reply, a.Equilibrated):
                _check_settling(request, reply)
            if isinstance(request, a.AtomisticAdvance) and isinstance(reply, a.AtomisticAdvanced):
                _check_windows(request, reply, before)
        return "taken"

    def _refused(self, operation: str, requests: list[WrongRequest]) -> str:
        for request in requests:
            try:
                answer = self._work.ask(operation, request.body, request.arrays)
                expect_error(answer, REFUSED, request.paths)
            except NoAnswer as problem:
                raise NoAnswer(f"{request.label}: {problem}") from None
            except Refuted as problem:
                raise Refuted(f"{request.label}: {problem}") from None
        return ", ".join(request.label for request in requests)

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
            expect_error(answer, REFUSED, ("atom_id", "anchor_position"))
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


def _check_settling(request: a.EquilibrateRequest, reply: a.Equilibrated) -> None:
    if not request.settle:
        return
    if reply.settled is None or not reply.drifts or reply.steps_done is None:
        raise Refuted("with settle the reply must have settled, drifts and steps_done")
    if reply.steps_done > request.steps:
        raise Refuted(f"{reply.steps_done} steps were made, {request.steps} are the most")
    for quantity in {drift.quantity.split("_")[0] for drift in reply.drifts}:
        group = [drift for drift in reply.drifts if drift.quantity.split("_")[0] == quantity]
        moved = sum((drift.drift / drift.standard_error) ** 2 for drift in group if drift.standard_error > 0)
        if reply.settled and moved > len(group) * (1.0 + 1e-9):
            raise Refuted(f"it says settled, but the drift of {quantity} is above its error")


def _check_windows(request: a.AtomisticAdvance, reply: a.AtomisticAdvanced, before: int) -> None:
    most = request.most_windows if request.until_error is not None else 1
    if not reply.windows <= most:
        raise Refuted(f"{reply.windows} windows were made, {most} are the most")
    if reply.step != before + reply.windows * request.steps:
        raise Refuted(f"the step is {reply.step} after {before} and {reply.windows} windows of {request.steps}")
    error = float(reply.ivc_standard_error.max(initial=0.0))
    if request.until_error is not None and reply.windows < most and error > request.until_error:
        raise Refuted(f"it ended after {reply.windows} windows with an error of {error:g} N")
