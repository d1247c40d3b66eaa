"""Checks of the conformance kit that hold for any role: hello, versions, frames, types, ids.

Each check is a method; it returns a word for the user, or raises `Refuted`.
"""

from __future__ import annotations

import msgpack
import numpy as np

from protocol.channel import ZmqChannel
from protocol.conformance_kit import KitBase
from protocol.conformance_probe import Probe, Refuted, difference, error_report, expect_error, read_reply
from protocol.conformance_problems import Problem
from protocol.frames import decode
from protocol.malformed_messages import MALFORMED_ID
from protocol.messages import (
    Status,
    Welcome,
)
from protocol.roles import ROLES
from protocol.version import OLDEST, Version

#: Capabilities that a service of each role must list.
LISTS: dict[str, tuple[str, ...]] = {
    "continuum": ("fields",),
    "atomistic": ("fields", "force_fields", "materials"),
    "micromechanics": ("criteria", "after_failure"),
    "structure": ("fields",),
}


class WireChecks(KitBase):
    """Checks that need no problem, or only one that is set."""

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
        for name in LISTS[self._welcome.role]:
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

    def _repeated(self, problem: Problem) -> None:
        frames, request_id = self._work.request(problem.operation, problem.advance(self._exchanges))
        self._exchanges += 1
        first = decode(self._work.ask_frames(frames, request_id))
        read_reply(first, self._role.operations[problem.operation].reply)
        for others in range(4):
            step = self._status().step if others else None
            again = decode(self._work.ask_frames(frames, request_id))
            if difference(first, again):
                raise Refuted(f"the repeated id got another reply after {others} others: {difference(first, again)}")
            if step is not None and self._status_step_by_control() != step:
                raise Refuted("the repeated request was run again: the step counter moved")
            # One status of the work socket lies between two repeats, so at most three replies came since.
        bad, bad_id = self._work.request(problem.operation, {})
        one, two = (decode(self._work.ask_frames(bad, bad_id)) for _ in range(2))
        if difference(one, two):
            raise Refuted("a repeated request that was refused got another answer")

    def _status_step_by_control(self) -> int:
        return self._control_probe().reply("status", None, Status).step

    def _old_id(self, problem: Problem) -> str:
        frames, request_id = self._work.request(problem.operation, problem.advance(self._exchanges))
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
