"""Benchmark `wire`: the time of one exchange between two processes, ours beside others in one run.

All lanes are open at once and take turns in batches, so that what else the machine does falls on all of
them alike; ratios are taken within a round of batches.
"""

from __future__ import annotations

import contextlib
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.lane import DirectLane, Lane
from benchmarks.muscle_echo import muscle_lane
from benchmarks.raw_echo import RawLane, raw_lane
from benchmarks.service_echo import service_lane
from benchmarks.wire_picture import draw
from protocol.arrays import FloatArray
from protocol.security import make_keys
from protocol.verification import Benchmark, BenchmarkRow, CannotRun

#: Rows of three doubles each way, and round trips of one batch: 47 kB (the anchors of the graphene scene), 2.4 MB.
PAYLOADS = {1968: 200, 100_000: 30}
ROUNDS = 9
OURS = "ours, ipc"
OURS_CURVE = "ours, tcp with CURVE"


class MemoryCopy(DirectLane):
    """One copy each way inside this process: what no exchange between processes can beat without sharing memory."""

    label = "memory copy"
    peer = True

    def __init__(self) -> None:
        self._there = self._back = np.empty((0, 3))

    def trip(self, values: FloatArray) -> FloatArray:
        """Copy the array (shape (n, 3)) there and back."""
        if self._there.shape != values.shape:
            self._there, self._back = np.empty_like(values), np.empty_like(values)
        np.copyto(self._there, values)
        np.copyto(self._back, self._there)
        return self._back


def measure(
    payloads: dict[int, int], rounds: int, *, with_muscle: bool = True
) -> tuple[list[BenchmarkRow], dict[str, str]]:
    """Time all lanes in turn.

    Parameters
    ----------
    payloads : dict of int to int
        Rows of the array (of 3 doubles, an even number), and the round trips of one batch.
    rounds : int
        Batches of each lane and payload.
    with_muscle : bool
        Measure MUSCLE3 too, where it is installed.

    Returns
    -------
    rows : list of BenchmarkRow
        Lane by lane within each payload.
    left_out : dict of str to str
        Lanes that could not run, with the reason.
    """
    rows: list[BenchmarkRow] = []
    left_out: dict[str, str] = {}
    with tempfile.TemporaryDirectory(prefix="wire") as name, contextlib.ExitStack() as stack:
        folder = Path(name)
        keys = folder / "keys"
        make_keys(keys)
        # MUSCLE3 starts first: it forks, which is better done before this process has ZeroMQ threads.
        muscle: list[Lane] = []
        if with_muscle:
            try:
                muscle.append(stack.enter_context(muscle_lane(folder)))
            except CannotRun as reason:
                left_out["MUSCLE3"] = str(reason)
        lanes: list[Lane] = [
            MemoryCopy(),
            stack.enter_context(raw_lane(folder)),
            stack.enter_context(service_lane(OURS, f"ipc://{folder / 'ours'}")),
            stack.enter_context(service_lane(OURS_CURVE, "tcp://127.0.0.1:*", keys)),
            *muscle,
        ]
        for count, repeats in payloads.items():
            values = np.random.default_rng(1).normal(size=(count, 3))
            batches: list[list[FloatArray]] = [[] for _ in lanes]
            for turn in range(rounds):
                # Another lane begins each round, so that none always follows the same one.
                for k in range(len(lanes)):
                    index = (turn + k) % len(lanes)
                    batches[index].append(lanes[index].batch(values, repeats))
            rows += _rows(lanes, values.nbytes, np.array(batches))
    return rows, left_out


def _rows(lanes: list[Lane], payload: int, seconds: FloatArray) -> list[BenchmarkRow]:
    """Return one row a lane from the times, shape (lanes, rounds, repeats)."""
    medians = np.median(seconds, axis=2)
    raw = next(index for index, lane in enumerate(lanes) if isinstance(lane, RawLane))
    rows = []
    for lane, times, by_round in zip(lanes, seconds, medians, strict=True):
        median = float(np.median(by_round))
        rows.append(
            BenchmarkRow(
                label=f"{lane.label}, {size_text(payload)}",
                knobs={"lane": lane.label, "payload_bytes": payload, "batches": len(by_round), "trips": len(times[0])},
                seconds=median,
                figures={
                    "median us": 1e6 * median,
                    "min us": 1e6 * float(times.min()),
                    "times raw pyzmq": float(np.median(by_round / medians[raw])),
                },
                peer=lane.peer,
            )
        )
    return rows


def size_text(count: int) -> str:
    """Return a number of bytes in kB or MB of ten."""
    return f"{count / 1e6:.1f} MB" if count >= 1e6 else f"{count / 1e3:.0f} kB"


def run(folder: Path) -> tuple[list[BenchmarkRow], list[Path]]:
    """Measure and draw; the picture is written into `folder`."""
    rows, left_out = measure(PAYLOADS, ROUNDS)
    for lane, reason in left_out.items():
        print(f"{lane} is left out: {reason}")
    picture = folder / "wire.png"
    draw(rows, picture)
    return rows, [picture]


BENCHMARK = Benchmark("wire", "round trip of an array to another process and back, each way the same bytes", run)
