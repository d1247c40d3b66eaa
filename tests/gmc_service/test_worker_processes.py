"""The queue of worker processes: what is asked again, what is given up, what is said."""

from __future__ import annotations

import logging
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import psutil
import pytest
from cell_definitions import square_fibre

from gmc_service.front import Front
from gmc_service.workers import MOST_TRIES, WorkerEnded, WorkerProcesses
from protocol import micromechanics as m
from protocol.errors import ProtocolError

COMMAND = [sys.executable, str(Path(__file__).with_name("mortal_worker.py"))]


@pytest.fixture
def front(tmp_path: Path) -> Iterator[Front]:
    made = Front("mortal", WorkerProcesses(COMMAND, tmp_path, 2))
    made.register(square_fibre())
    yield made
    made.close()


def query(points: int, sign: float = 1.0, temperature: float = 300.0) -> m.EvaluateRequest:
    strain = sign * np.arange(1.0, 6.0 * points + 1.0).reshape(points, 6)
    return m.EvaluateRequest(cell="c", temperature=temperature, strain=strain)


def test_parts_come_back_in_order(front: Front) -> None:
    for points in (1, 8_191, 8_192, 100_001):
        assert front.evaluate(query(points)).stress.tobytes() == (2.0 * query(points).strain).tobytes()


def test_a_worker_that_ends_is_replaced_and_told_the_cell(
    front: Front, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    front.evaluate(query(20_000))  # both know the cell
    told = (tmp_path / "registered.txt").read_text().count("one")
    assert told == 2
    (tmp_path / "die_once").touch()
    with caplog.at_level(logging.INFO):
        assert front.evaluate(query(20_000)).stress.tobytes() == (2.0 * query(20_000).strain).tobytes()
        end = time.monotonic() + 20
        while "is started again" not in caplog.text and time.monotonic() < end:
            time.sleep(0.05)
    assert "ended with exit status 7" in caplog.text and "the end is near" in caplog.text
    assert "its part goes to another" in caplog.text and "is started again" in caplog.text
    front.evaluate(query(20_000))
    assert (tmp_path / "registered.txt").read_text().count("one") > told


def test_a_query_that_ends_every_worker_is_given_up_and_others_are_answered(front: Front) -> None:
    with pytest.raises(ProtocolError) as caught:
        front.evaluate(query(10, sign=-1.0))
    assert caught.value.code == "solver_failed"
    assert f"{MOST_TRIES} workers in a row" in caught.value.report.sentence
    assert front.evaluate(query(10)).stress[0, 0] == 2.0


def test_workers_that_cannot_be_started_again_are_a_clear_error(front: Front, tmp_path: Path) -> None:
    (tmp_path / "stillborn").touch()
    (tmp_path / "die").touch()
    for _ in range(2):  # the second one finds nobody from the start
        with pytest.raises(ProtocolError) as caught:
            front.evaluate(query(20_000))
        assert caught.value.code == "solver_failed"
        assert "all 2 workers ended" in caught.value.report.sentence and "no luck" in caught.value.report.sentence


def test_a_worker_that_never_starts_is_told_at_once(tmp_path: Path) -> None:
    (tmp_path / "stillborn").touch()
    began = time.monotonic()
    with pytest.raises(WorkerEnded, match="no luck"):
        WorkerProcesses(COMMAND, tmp_path, 2)
    assert time.monotonic() - began < 30.0
    assert [one for one in psutil.Process().children() if "mortal_worker.py" in " ".join(one.cmdline())] == []


def test_an_aborted_query_frees_its_workers(front: Front) -> None:
    front.activity.begin("evaluate")
    threading.Timer(0.5, front.activity.abort.set).start()
    began = time.monotonic()
    with pytest.raises(ProtocolError) as caught:
        front.evaluate(query(20_000, temperature=77.0))  # ten seconds of work
    assert caught.value.code == "aborted"
    front.activity.begin("evaluate")
    assert front.evaluate(query(20_000)).stress[0, 0] == 2.0
    assert time.monotonic() - began < 6.0
