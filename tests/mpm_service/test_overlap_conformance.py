"""Checks of the conformance kit on overlaps, energies and momentum: sound backends pass, each broken one is caught."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest

from mpm_service.service import MaterialPointService, ReferenceService
from protocol import continuum as c
from protocol.conformance import Kit
from protocol.conformance_kit import Check
from protocol.conformance_problems import continuum_problem
from protocol.server import Server


def held(service: MaterialPointService, folder: Path) -> dict[str, Check]:
    server = Server(service, f"ipc://{folder}/s")
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    kit = Kit(server.endpoint, "continuum", None, 20.0, None)
    try:
        kit._check("hello", kit._hello)
        kit._overlaps(continuum_problem())
    finally:
        kit.close()
        server.stop()
        thread.join(timeout=10)
    return {check.name: check for check in kit.checks}


@pytest.mark.parametrize("kind", [MaterialPointService, ReferenceService])
def test_sound_backends_pass(kind: type[MaterialPointService], tmp_path: Path) -> None:
    checks = held(kind(), tmp_path)
    assert [f"{check.name}: {check.detail}" for check in checks.values() if check.passed is not True] == []
    assert len(checks) == 7
    assert checks["overlaps: are taken, or refused as unsupported"].detail == "taken"
    assert "kg m/s" in checks["momentum: goes with the kinetic energy"].detail
    assert "is left" in checks["energies: they and the works add up"].detail


class IgnoresRings(MaterialPointService):
    def configure(self, request: c.ContinuumConfigure) -> c.ContinuumConfigured:
        return super().configure(request.model_copy(update={"overlaps": []}))


class IgnoresProfiles(MaterialPointService):
    def configure(self, request: c.ContinuumConfigure) -> c.ContinuumConfigured:
        plain = [ring.model_copy(update={"profile": "constant"}) for ring in request.overlaps]
        return super().configure(request.model_copy(update={"overlaps": plain}))


class TakesTheFirstRing(MaterialPointService):
    def configure(self, request: c.ContinuumConfigure) -> c.ContinuumConfigured:
        return super().configure(request.model_copy(update={"overlaps": request.overlaps[:1]}))


class TellsTooMuchMomentum(MaterialPointService):
    def advance(self, request: c.ContinuumAdvance) -> c.ContinuumAdvanced:
        reply = super().advance(request)
        assert reply.momentum is not None
        x, y = reply.momentum
        return reply.model_copy(update={"momentum": (50.0 * x, 50.0 * y)})


class ForgetsWork(MaterialPointService):
    def advance(self, request: c.ContinuumAdvance) -> c.ContinuumAdvanced:
        reply = super().advance(request)
        return reply.model_copy(update={"interface_work": 0.5 * reply.interface_work})


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        (IgnoresRings, "overlaps: polygons say the same as rectangles"),
        (IgnoresProfiles, "overlaps: weights lie between those of their borders"),
        (TakesTheFirstRing, "overlaps: what makes no ring is refused"),
        (TellsTooMuchMomentum, "momentum: goes with the kinetic energy"),
        (ForgetsWork, "energies: they and the works add up"),
    ],
)
def test_a_backend_that_is_broken_in_one_way_is_caught(
    kind: type[MaterialPointService], name: str, tmp_path: Path
) -> None:
    assert held(kind(), tmp_path)[name].passed is False
