"""The conformance kit on extensions of cracks: the service passes, and services broken in one way are caught."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest

from mpm_service.service import MaterialPointService, ReferenceService
from protocol import continuum as c
from protocol.conformance import Kit
from protocol.conformance_kit import Check
from protocol.errors import ProtocolError
from protocol.messages import CheckpointReply, Empty
from protocol.server import Server
from protocol.service import Capabilities


class DoesNothing(MaterialPointService):
    def extend_crack(self, request: c.CrackExtension) -> c.CrackExtended:
        reply = super().extend_crack(request)
        self._solver, self._edges = self._untouched
        return reply

    def configure(self, request: c.ContinuumConfigure) -> c.ContinuumConfigured:
        super().configure(request)
        self._untouched = (self._solver, self._edges)
        return super().configure(request)

    def register(self, request: c.ContinuumRegister) -> c.ContinuumRegistered:
        here = (self._solver, self._edges)
        self._solver, self._edges = self._untouched
        super().register(request)
        self._solver, self._edges = here
        return super().register(request)


class LeavesTheTip(MaterialPointService):
    def extend_crack(self, request: c.CrackExtension) -> c.CrackExtended:
        assert self._cracks is not None
        before = self._cracks.tips()
        return super().extend_crack(request).model_copy(update={"tips": before})


class DropsTheLine(MaterialPointService):
    def checkpoint(self, request: Empty) -> CheckpointReply:
        assert self._solver is not None and self._solver.cracks is not None
        saved = super().checkpoint(request)
        fresh = type(self)()
        fresh.configure(self._first)
        fresh.register(self._registered)
        plain = fresh.checkpoint_of_parent(request)
        return saved.model_copy(
            update={
                "state": {
                    name: plain.state[name] if name.startswith("crack_") else value
                    for name, value in saved.state.items()
                }
            }
        )

    def checkpoint_of_parent(self, request: Empty) -> CheckpointReply:
        return super().checkpoint(request)

    def configure(self, request: c.ContinuumConfigure) -> c.ContinuumConfigured:
        self._first = request
        return super().configure(request)


class TakesAnything(MaterialPointService):
    def extend_crack(self, request: c.CrackExtension) -> c.CrackExtended:
        try:
            return super().extend_crack(request)
        except ProtocolError:
            assert self._cracks is not None
            return c.CrackExtended(step=self.step, tips=self._cracks.tips())


class BoastsOfIt(ReferenceService):
    operations = ["extend_crack"]  # noqa: RUF012


class HidesIt(MaterialPointService):
    def capabilities(self) -> Capabilities:
        return {**super().capabilities(), "operations": []}


def crack_checks(service: MaterialPointService, folder: Path) -> list[Check]:
    server = Server(service, f"ipc://{folder}/s")
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    kit = Kit(server.endpoint, "continuum", None, 60.0)
    try:
        kit._check("hello", kit._hello)
        problem = kit._check("problem", kit._set_problem)
        kit._cracks(problem)
    finally:
        kit.close()
        server.stop()
        thread.join(timeout=10)
    return [check for check in kit.checks if check.name.startswith("extend_crack")]


def test_the_service_passes(tmp_path: Path) -> None:
    checks = crack_checks(MaterialPointService(), tmp_path)
    assert len(checks) == 4
    assert [check for check in checks if check.passed is not True] == []


def test_a_service_without_it_must_refuse(tmp_path: Path) -> None:
    assert [check.passed for check in crack_checks(ReferenceService(), tmp_path)] == [True]


@pytest.mark.parametrize(
    ("broken", "caught_by"),
    [
        (DoesNothing, "acts as a crack"),
        (LeavesTheTip, "the tip is where"),
        (DropsTheLine, "a checkpoint holds"),
        (TakesAnything, "what makes no sense"),
        (BoastsOfIt, "the tip is where"),
        (HidesIt, "is not offered"),
    ],
)
def test_a_broken_service_is_caught(broken: type[MaterialPointService], caught_by: str, tmp_path: Path) -> None:
    failed = [check.name for check in crack_checks(broken(), tmp_path) if check.passed is False]
    assert any(caught_by in name for name in failed), failed
