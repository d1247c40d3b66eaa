"""Benchmark `coupling`: error of a coupled run against seconds, over the knobs of the handshake."""

from __future__ import annotations

from pathlib import Path

from benchmarks.coupling_picture import draw
from benchmarks.coupling_runs import STUDIES, study_rows
from protocol.verification import Benchmark, BenchmarkRow


def run(folder: Path) -> tuple[list[BenchmarkRow], list[Path]]:
    """Measure and draw; the pictures are written into `folder`."""
    rows: list[BenchmarkRow] = []
    pictures = []
    for study in STUDIES:
        name = study.problem.name.replace(" ", "_")
        own = study_rows(study, folder / "work" / name)
        pictures.append(folder / f"{name}.png")
        draw(study, own, pictures[-1])
        rows += own
    return rows, pictures


BENCHMARK = Benchmark(
    "coupling", "handshake: error of a coupled run against seconds, beside the whole body of atoms", run
)
