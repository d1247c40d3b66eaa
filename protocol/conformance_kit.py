"""What the checks of the conformance kit stand on: one pass over one service, and its record."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from protocol.channel import ZmqChannel
from protocol.conformance_probe import NoAnswer, Probe, Refuted, read_reply
from protocol.conformance_problems import Problem
from protocol.errors import ProtocolError
from protocol.frames import Envelope
from protocol.messages import (
    CheckpointReply,
    FieldsRequest,
    Restored,
    RestoreRequest,
    Status,
    Welcome,
)
from protocol.roles import ROLES, Role
from protocol.version import NEWEST, OLDEST, Version


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


class KitBase:
    """One pass over one service: its connections, what was found so far, and requests that checks share."""

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
        answer = self._work.ask(problem.operation, problem.advance(self._exchanges))
        self._exchanges += 1
        read_reply(answer, self._role.operations[problem.operation].reply)
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
