"""The benchmark `wire` measures what it says, in a short run."""

from __future__ import annotations

from importlib import metadata
from pathlib import Path

import numpy as np
import pytest

from benchmarks.lane import WrongAnswer, check_answer
from benchmarks.wire import OURS, OURS_CURVE, PAYLOADS, MemoryCopy, measure
from benchmarks.wire_picture import draw
from protocol.verification import BENCHMARKS, BenchmarkRow

RAW = "raw pyzmq, ipc"


@pytest.fixture(scope="module")
def rows() -> list[BenchmarkRow]:
    measured, left_out = measure(dict.fromkeys(PAYLOADS, 12), rounds=7, with_muscle=False)
    assert left_out == {}
    return measured


def row(rows: list[BenchmarkRow], lane: str, payload: int) -> BenchmarkRow:
    (found,) = [r for r in rows if r.knobs["lane"] == lane and r.knobs["payload_bytes"] == payload]
    return found


@pytest.mark.parametrize("payload", [47_232, 2_400_000])
def test_each_lane_has_a_row_with_sound_figures(rows: list[BenchmarkRow], payload: int) -> None:
    for lane, peer in (("memory copy", True), (RAW, True), (OURS, False), (OURS_CURVE, False)):
        found = row(rows, lane, payload)
        assert found.peer is peer
        assert 0 < found.figures["min us"] <= found.figures["median us"]
        assert found.figures["median us"] == pytest.approx(1e6 * found.seconds)
        assert found.figures["times raw pyzmq"] > 0
    assert row(rows, RAW, payload).figures["times raw pyzmq"] == 1.0
    assert row(rows, "memory copy", payload).seconds < row(rows, RAW, payload).seconds


@pytest.mark.parametrize(("payload", "measured"), [(47_232, 3.3), (2_400_000, 2.4)])
def test_regression_cost_of_our_checks(rows: list[BenchmarkRow], payload: int, measured: float) -> None:
    """A regression bound, twice the ratio that was measured on a busy machine; `bench wire` shows the true one."""
    assert row(rows, OURS, payload).figures["times raw pyzmq"] < 2 * measured


def test_a_lane_that_brings_back_other_values_is_refused() -> None:
    values = np.arange(12.0).reshape(4, 3)
    check_answer("whole", values, values.copy())
    check_answer("in pieces", values, (values[:2], values[2:]))
    for wrong in (values + 1e-9, values[:3], (values[2:], values[:2])):
        with pytest.raises(WrongAnswer, match="lane x: other values came back"):
            check_answer("lane x", values, wrong)


def test_memory_copy_returns_the_values_in_other_memory() -> None:
    values = np.arange(12.0).reshape(4, 3)
    copied = MemoryCopy().trip(values)
    assert np.array_equal(copied, values)
    assert not np.shares_memory(copied, values)


def test_the_picture_is_a_png(rows: list[BenchmarkRow], tmp_path: Path) -> None:
    path = tmp_path / "wire.png"
    draw(rows, path)
    assert path.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


def test_bench_finds_it_by_its_entry_point() -> None:
    (entry,) = [e for e in metadata.entry_points(group=BENCHMARKS) if e.name == "wire"]
    assert entry.load().name == "wire"
