"""The conformance kit passes the real laminate service, and catches each of several that are broken in one way."""

from __future__ import annotations

import tempfile
from typing import Any

import numpy as np
import pytest

import fem_service.service
from fem_service.cell_client import CellClient
from fem_service.service import LaminateService
from protocol import structure as s
from protocol.conformance import Check, check_service
from protocol.messages import CheckpointReply, Empty, FieldsReply, FieldsRequest, Restored, RestoreRequest
from protocol.server import running

LIMIT = 1 << 22


def held(service: LaminateService, on_check: Any = None, deadline: float = 30.0) -> list[Check]:
    with (
        tempfile.TemporaryDirectory(prefix="scalebridge-") as folder,
        running(service, f"ipc://{folder}/s", max_message_bytes=LIMIT) as server,
    ):
        return check_service(server.endpoint, deadline=deadline, shutdown=True, on_check=on_check)


def test_the_real_service_passes_every_check() -> None:
    checks = held(LaminateService())
    assert [f"{check.name}: {check.detail}" for check in checks if check.passed is not True] == []
    assert len({check.name for check in checks}) > 100


class HalfTheForce(LaminateService):
    def advance(self, request: s.StructureAdvance) -> s.StructureAdvanced:
        made = super().advance(request)
        return made.model_copy(update={"force": 0.5 * made.force})


class ForgetsThatItIsAQuarter(LaminateService):
    def configure(self, request: s.StructureConfigure) -> s.StructureConfigured:
        found = super().configure(request)
        if request.quarter and self._problem is not None:
            self._problem.share /= 2.0
        return found


class TakesAnglesForDegrees(LaminateService):
    def configure(self, request: s.StructureConfigure) -> s.StructureConfigured:
        if request.quarter:
            return super().configure(request)
        angles = [float(np.radians(angle)) for angle in request.angles]
        return super().configure(request.model_copy(update={"angles": angles}))


class AsksNobody(LaminateService):
    """Answers each point by the elastic stiffness."""

    def configure(self, request: s.StructureConfigure) -> s.StructureConfigured:
        found = super().configure(request)
        assert self._problem is not None
        self._problem.cell._safe = np.inf
        return found


class LargerThanAsked(LaminateService):
    def advance(self, request: s.StructureAdvance) -> s.StructureAdvanced:
        return super().advance(s.StructureAdvance())


class FailsAlthoughToldNotTo(LaminateService):
    def configure(self, request: s.StructureConfigure) -> s.StructureConfigured:
        return super().configure(request.model_copy(update={"damage": "elimination"}))


class MovesInItsCheckpoint(LaminateService):
    def checkpoint(self, request: Empty) -> CheckpointReply:
        saved = super().checkpoint(request)
        return saved.model_copy(update={"state": {**saved.state, "displacement": 0.9 * saved.state["displacement"]}})


class ForgetsFailures(LaminateService):
    """A checkpoint without the state of the points."""

    def checkpoint(self, request: Empty) -> CheckpointReply:
        saved = super().checkpoint(request)
        return saved.model_copy(update={"state": {**saved.state, "failed": np.zeros_like(saved.state["failed"])}})


class ForgetsTheSize(LaminateService):
    def restore(self, request: RestoreRequest) -> Restored:
        found = super().restore(request)
        assert self._problem is not None
        self._problem.size = 0.001
        return found


class TakesAnyStep(LaminateService):
    def restore(self, request: RestoreRequest) -> Restored:
        numbers = request.state.get("numbers")
        step = int(numbers[-1]) if numbers is not None and numbers.ndim == 1 and len(numbers) == 8 else request.step
        found = super().restore(request.model_copy(update={"step": step}))
        self._step = request.step
        return found.model_copy(update={"step": request.step})


class RowsOfPoints(LaminateService):
    def fields(self, request: FieldsRequest) -> FieldsReply:
        found = super().fields(request)
        if "stress" not in found.fields:
            return found
        return found.model_copy(update={"fields": {**found.fields, "stress": np.repeat(found.fields["stress"], 8, 0)}})


class WorkOfTheModelledPart(LaminateService):
    def advance(self, request: s.StructureAdvance) -> s.StructureAdvanced:
        made = super().advance(request)
        return made.model_copy(update={"work": 0.5 * made.work})


class WatchesOneBrick(LaminateService):
    def advance(self, request: s.StructureAdvance) -> s.StructureAdvanced:
        return super().advance(request.model_copy(update={"watched": request.watched[:1]}))


class MakesItsOwnMesh(LaminateService):
    def configure(self, request: s.StructureConfigure) -> s.StructureConfigured:
        if request.plane_nodes is not None:
            nodes = request.plane_nodes * np.array([1.0, 0.9])
            request = request.model_copy(update={"plane_nodes": nodes, "width": 0.9 * request.width})
        return super().configure(request)


class DropsTheOldLaminate(LaminateService):
    def configure(self, request: s.StructureConfigure) -> s.StructureConfigured:
        self.close()
        self._problem, self._step = None, 0
        return super().configure(request)


class DeafToAbort(LaminateService):
    def _look(self) -> None:
        pass


BROKEN: list[tuple[str, type[LaminateService]]] = [
    ("force: a ply", HalfTheForce),
    ("force: is that of the whole", ForgetsThatItIsAQuarter),
    ("force: a ply", TakesAnglesForDegrees),
    ("cells: are asked", AsksNobody),
    ("advance: increments", LargerThanAsked),
    ("failure: is counted", FailsAlthoughToldNotTo),
    ("checkpoint: going back", MovesInItsCheckpoint),
    ("failure: is counted", ForgetsFailures),
    ("checkpoint: going back", ForgetsTheSize),
    ("restore: a state", TakesAnyStep),
    ("fields: each named", RowsOfPoints),
    ("watched: bricks", WorkOfTheModelledPart),
    ("watched: bricks", WatchesOneBrick),
    ("mesh: a given one", MakesItsOwnMesh),
    ("wrong fields: none of them", DropsTheOldLaminate),
    ("control: status while it waits", DeafToAbort),
]


class Caught(Exception):
    """The awaited check failed; no need to go on."""


@pytest.mark.parametrize(("caught_by", "broken"), BROKEN, ids=[broken.__name__ for _, broken in BROKEN])
def test_a_service_broken_in_one_way_is_caught(caught_by: str, broken: type[LaminateService]) -> None:
    found: list[str] = []

    def look(check: Check) -> None:
        if check.passed is False:
            found.append(f"{check.name}: {check.detail}")
            if check.name.startswith(caught_by):
                raise Caught

    with pytest.raises(Caught):
        held(broken(), look, deadline=3.0)
        print(*found, sep="\n")


def test_a_client_that_spares_by_a_wrong_energy_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    """The kit's cells call no energy safe."""

    class Careless(CellClient):
        def __init__(self, *words: Any, **named: Any) -> None:
            super().__init__(*words, **named)
            self._safe = 1.0

    monkeypatch.setattr(fem_service.service, "CellClient", Careless)
    checks = {check.name: check.passed for check in held(LaminateService())}
    assert checks["cells: are asked, in queries that are counted"] is False
