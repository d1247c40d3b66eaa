"""`serve micromechanics --workers N`: real processes, one of which is killed in the middle of a query."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import psutil
import pytest

from protocol import micromechanics as m
from protocol.client import Client
from protocol.conformance import check_service
from protocol.conformance_micromechanics import micromechanics_cell
from protocol.errors import ProtocolError
from protocol.messages import Acknowledged, Status

SCALEBRIDGE = [sys.executable, "-m", "coordinator.cli"]
POINTS = 60_000


def large_cell() -> m.RegisterCell:
    """Nine by nine subcells: a point that fails takes about a hundredth of a millisecond or more."""
    small, chance = micromechanics_cell(), np.random.default_rng(5)
    return small.model_copy(
        update={
            "heights": chance.uniform(1e-6, 2e-6, 9), "widths": chance.uniform(1e-6, 2e-6, 9),
            "phase": chance.integers(0, 2, (9, 9)),
        }
    )  # fmt: skip


def query(cell: str, points: int = POINTS) -> m.EvaluateRequest:
    strain = np.random.default_rng(2).uniform(-0.03, 0.03, (points, 6))
    return m.EvaluateRequest(cell=cell, temperature=300.0, strain=strain)


class Served:
    """A front with its workers, as a user starts it."""

    def __init__(self, folder: Path, *words: str) -> None:
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        self._socket = tempfile.TemporaryDirectory(prefix="scalebridge-")
        self.endpoint = f"ipc://{self._socket.name}/s"
        self.log = folder / "front.txt"
        command = [*SCALEBRIDGE, "serve", "micromechanics", "--bind", self.endpoint, "--folder", str(folder), *words]
        with self.log.open("wb") as file:
            self.process = subprocess.Popen(command, stdout=file, stderr=file)
        self.client = Client.connect(self.endpoint, "micromechanics", watch=self._watch, deadline=120.0)

    def _watch(self) -> None:
        assert self.process.poll() is None, self.log.read_text()

    def workers(self) -> list[psutil.Process]:
        return psutil.Process(self.process.pid).children()

    def stop(self) -> None:
        self.client.close()
        self.process.terminate()
        try:
            self.process.wait(20)
        finally:
            self.process.kill()
            self.process.wait(10)
            self._socket.cleanup()


@contextlib.contextmanager
def served(folder: Path, *words: str) -> Iterator[Served]:
    started = Served(folder, *words)
    try:
        yield started
    finally:
        started.stop()


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    with served(tmp_path_factory.mktemp("two"), "--workers", "2") as started:
        yield started


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """The same backend as one process without a front."""
    with served(tmp_path_factory.mktemp("alone")) as started:
        yield started


@pytest.fixture(scope="module")
def expected(alone: Served) -> tuple[m.Evaluated, float]:
    """What one process answers to the large query, and its seconds."""
    name = alone.client.call("register", large_cell(), m.CellRegistered).cell
    alone.client.call("evaluate", query(name, 10), m.Evaluated)
    began = time.monotonic()
    answer = alone.client.call("evaluate", query(name), m.Evaluated)
    assert answer.new_failures > POINTS and answer.tangents is not None and len(answer.tangents) > 10
    return answer, time.monotonic() - began


def differences(first: m.Evaluated, second: m.Evaluated) -> list[str]:
    others = second.array_values()
    found = [name for name, array in first.array_values().items() if array.tobytes() != others[name].tobytes()]
    return found + ([] if first.plain_values() == second.plain_values() else ["new_failures"])


def test_the_front_keeps_the_contract(two: Served) -> None:
    checks = check_service(two.endpoint, deadline=60.0)
    assert [f"{check.name}: {check.detail}" for check in checks if check.passed is False] == []
    # The check of the size limit would need a message beyond 1 GiB.
    assert [check.name for check in checks if check.passed is None] == ["size: a message beyond the limit is refused"]
    assert two.client.welcome is not None and two.client.welcome.capabilities["workers"] == 2


def test_two_workers_answer_the_bits_of_one_process(two: Served, expected: tuple[m.Evaluated, float]) -> None:
    name = two.client.call("register", large_cell(), m.CellRegistered).cell
    assert differences(two.client.call("evaluate", query(name), m.Evaluated), expected[0]) == []


def test_a_worker_killed_in_mid_query_loses_nothing(two: Served, expected: tuple[m.Evaluated, float]) -> None:
    name = two.client.call("register", large_cell(), m.CellRegistered).cell
    two.client.call("evaluate", query(name, 20_000), m.Evaluated)
    before = two.workers()
    assert len(before) == 2
    killed: list[int] = []

    def kill() -> None:
        """Kill a worker that is busy with the query."""
        end = time.monotonic() + 20
        while not killed and time.monotonic() < end:
            if two.client.control.call("status", None, Status).operation == "evaluate":
                before[0].kill()
                killed.append(before[0].pid)

    assassin = threading.Thread(target=kill)
    assassin.start()
    answer = two.client.call("evaluate", query(name), m.Evaluated)
    assassin.join()
    assert killed
    assert differences(answer, expected[0]) == []
    log = two.log.read_text()
    assert f"its process {killed[0]} was killed by signal 9" in log and "its part goes to another" in log
    end = time.monotonic() + 60
    while "is started again" not in two.log.read_text():
        assert time.monotonic() < end, two.log.read_text()
        time.sleep(0.1)
    after = two.workers()
    assert len(after) == 2 and before[1] in after and before[0] not in after
    # The new one knows no cell yet, and is told.
    assert differences(two.client.call("evaluate", query(name), m.Evaluated), expected[0]) == []


def test_a_query_can_be_aborted_and_the_front_goes_on(two: Served) -> None:
    name = two.client.call("register", large_cell(), m.CellRegistered).cell
    timer = threading.Timer(0.3, lambda: two.client.control.call("abort", None, Acknowledged))
    timer.start()
    began = time.monotonic()
    with pytest.raises(ProtocolError) as caught:
        two.client.call("evaluate", query(name, 1_000_000), m.Evaluated)
    timer.join()
    assert caught.value.code == "aborted"
    assert time.monotonic() - began < 10.0
    assert two.client.call("evaluate", query(name, 10), m.Evaluated).stress.shape == (10, 6)


def test_the_workers_end_with_their_front(tmp_path: Path) -> None:
    with served(tmp_path, "--workers", "2") as started:
        workers = started.workers()
        assert len(workers) == 2
        started.process.kill()
        _, alive = psutil.wait_procs(workers, timeout=10)
        assert alive == []
    with served(tmp_path / "again", "--workers", "2") as started:
        workers = started.workers()
        started.client.control.call("shutdown", None, Acknowledged)
        assert started.process.wait(20) == 0
        _, alive = psutil.wait_procs(workers, timeout=5)
        assert alive == []


def test_workers_are_for_stateless_backends_alone(tmp_path: Path) -> None:
    command = [*SCALEBRIDGE, "serve", "continuum", "--workers", "2", "--folder", str(tmp_path)]
    refused = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert refused.returncode == 1
    assert "mpm_service holds a state in one process" in refused.stderr
    assert "Traceback" not in refused.stderr
