"""How much of the speed of one process is left through the service, and where the rest goes."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np
from matplotlib.figure import Figure

from gmc_service.evaluation import Answer, Evaluator
from gmc_service.service import definition_of
from gmc_service.verification.failure_events import neat_composite
from protocol import micromechanics as m
from protocol.arrays import all_finite
from protocol.client import Client
from protocol.micromechanics_query import PART_POINTS, CellQueries
from protocol.verification import Case, Check

POINTS: Final = 1_000_000
ROUNDS: Final = 5
#: Standard deviation of the strains: subcells of half of the points fail in the query.
STRAIN: Final = 8.5e-3
#: Share of the rate in one process that is to be left.
WANTED: Final = 0.6
#: Times that a number crosses the check for NaN: where a message is made and where it arrives, both ways.
PASSES: Final = 4

IN_PARTS: Final = "in process, in parts"

_SERVE = """
import sys
from pathlib import Path
from gmc_service.service import make_gmc
from protocol.server import Server
Server(make_gmc(Path(".")), sys.argv[1], parent=int(sys.argv[2])).run(lambda bound: print(bound, flush=True))
"""

Seconds = dict[str, list[float]]


@contextmanager
def _served(endpoint: str) -> Iterator[Client]:
    """A service in a process of its own, and its client."""
    words = [sys.executable, "-c", _SERVE, endpoint, str(os.getpid())]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None  # asked for above
        client = Client.connect(process.stdout.readline().strip(), "micromechanics")
        yield client
        client.close()
    finally:
        process.terminate()
        process.wait(10)


def _speed(folder: Path) -> list[Check]:
    cell = neat_composite()
    evaluator, definition = Evaluator(cell), definition_of(cell)
    strain = np.random.default_rng(1).normal(size=(POINTS, 6)) * STRAIN
    failed, history = np.zeros((POINTS, 1), np.uint8), np.zeros((POINTS, 0))
    seconds: Seconds = {}
    parts: dict[str, Seconds] = {}
    differ = 0

    def timed(label: str, ask: Callable[[], Answer | m.Evaluated]) -> Answer | m.Evaluated:
        began = time.perf_counter()
        answer = ask()
        seconds.setdefault(label, []).append(time.perf_counter() - began)
        return answer

    with ExitStack() as stack:
        sockets = stack.enter_context(TemporaryDirectory(prefix="scalebridge-"))
        clients = {
            "ipc": stack.enter_context(_served(f"ipc://{sockets}/s")),
            "tcp": stack.enter_context(_served("tcp://127.0.0.1:*")),
        }
        queries = {transport: CellQueries(client, definition) for transport, client in clients.items()}

        def request() -> m.EvaluateRequest:
            name = queries["ipc"].registered.cell
            return m.EvaluateRequest(cell=name, temperature=300.0, strain=strain, failed=failed)

        for warm in (True, *(False,) * ROUNDS):
            if warm:  # compiles, and fills tables of damage masks
                seconds.clear()
            expected = timed("in process", lambda: evaluator.evaluate(strain, 300.0, failed, history))
            began = time.perf_counter()
            for start in range(0, POINTS, PART_POINTS):
                part = slice(start, start + PART_POINTS)
                evaluator.evaluate(strain[part], 300.0, failed[part], history[part])
            seconds.setdefault(IN_PARTS, []).append(time.perf_counter() - began)
            for transport, client in clients.items():
                timing, before = client.timing, dict(vars(client.timing))
                label = f"{transport}, one message"
                whole = timed(label, lambda client=client: client.call("evaluate", request(), m.Evaluated))  # type: ignore[misc]
                for name, value in vars(timing).items():
                    parts.setdefault(label, {}).setdefault(name, []).append(value - before[name])
                asked = queries[transport]
                inside = timed(f"{transport}, in parts", lambda asked=asked: asked.evaluate(request()))  # type: ignore[misc]
                differ += sum(not _same(answer, expected) for answer in (whole, inside))
            if warm:
                seconds.clear()
                parts.clear()
    checked = median(_seconds(lambda: all_finite(strain)) for _ in range(ROUNDS))
    medians = {label: median(values) for label, values in seconds.items()}
    _draw(folder / "speed-service.png", medians, parts, checked)
    return [
        *(_share(transport, medians, parts, checked) for transport in ("ipc", "tcp")),
        Check("answers that differ from those of one process in a bit", differ, 0.0, 0.0, "the same query in process"),
    ]


def _share(transport: str, medians: dict[str, float], parts: dict[str, Seconds], checked: float) -> Check:
    whole, inside = medians[f"{transport}, one message"], medians[f"{transport}, in parts"]
    # Small parts spare the evaluator new memory, too: the wire is held against the faster of both ways in process.
    alone = min(medians["in process"], medians[IN_PARTS])
    components = _components(medians, parts[f"{transport}, one message"], f"{transport}, one message", checked)
    words = ", ".join(f"{name} {1e3 * value:.0f}" for name, value in components.items())
    return Check(
        f"seconds of a query of {POINTS:g} points over {transport}, to those in process ({alone:.3f} s, "
        f"{POINTS / alone:.3g} points/s; through the service {POINTS / inside:.3g} points/s)",
        inside / alone,
        1.0 / WANTED,
        0.0,
        f"at least {WANTED:.0%} of the rate; as one message {alone / whole:.0%}, in ms: {words}",
        at_most=True,
    )


def _components(medians: dict[str, float], parts: Seconds, label: str, checked: float) -> dict[str, float]:
    """Where the time of a query in one message goes, s."""
    compute, wire = median(parts["computing"]), median(parts["waiting"])
    checks = PASSES * checked
    found = {"evaluate": min(medians["in process"], compute), "check for NaN": checks, "send and receive": wire}
    return {**found, "encode, decode and the rest": max(0.0, medians[label] - sum(found.values()))}


def _same(answer: Answer | m.Evaluated, expected: Answer | m.Evaluated) -> bool:
    names = ("stress", "failed", "tangent_index", "tangents")
    return all(np.array_equal(getattr(answer, name), getattr(expected, name)) for name in names)


def _seconds(work: Callable[[], object]) -> float:
    began = time.perf_counter()
    work()
    return time.perf_counter() - began


def _draw(path: Path, medians: dict[str, float], parts: dict[str, Seconds], checked: float) -> None:
    figure = Figure(figsize=(8.0, 3.2), layout="constrained")
    axes = figure.subplots()
    labels = list(medians)
    alone = min(medians["in process"], medians[IN_PARTS])
    colours = ("#4477aa", "#ccbb44", "#ee6677", "#bbbbbb")
    named: set[str] = set()
    for row, label in enumerate(labels):
        if label in parts:
            left = 0.0
            for colour, (name, value) in zip(colours, _components(medians, parts[label], label, checked).items(),
                                             strict=True):  # fmt: skip
                axes.barh(row, value, left=left, color=colour, label=None if name in named else name)
                named.add(name)
                left += value
        else:
            axes.barh(row, medians[label], color="#4477aa" if label.startswith("in process") else "#228833")
        axes.text(medians[label], row, f" {alone / medians[label]:.0%}", va="center")
    axes.set_yticks(range(len(labels)), labels)
    axes.invert_yaxis()
    axes.set_xlim(0.0, 1.35 * max(medians.values()))
    axes.axvline(alone / WANTED, color="black", linestyle=":", linewidth=1.0)
    axes.set_xlabel(f"seconds of a query of {POINTS:,} points; dotted: {WANTED:.0%} of the rate in process")
    figure.legend(loc="outside upper center", ncols=4, fontsize="small")
    figure.savefig(path, dpi=150)


CASES: list[Case] = [
    Case("gmc", "speed-service", "a million points a query through the service against the same in one process", _speed)
]
