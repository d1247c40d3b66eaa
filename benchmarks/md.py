"""Benchmark `md`: cost of service, anchors and J beside bare LAMMPS, and error of the reaction against seconds."""

from __future__ import annotations

from pathlib import Path

from benchmarks.md_cost import j_row, service_rows
from benchmarks.md_pictures import draw_cost, draw_error
from benchmarks.md_reaction import reaction_rows
from protocol.verification import Benchmark, BenchmarkRow


def run(folder: Path) -> tuple[list[BenchmarkRow], list[Path]]:
    """Measure and draw; the pictures are written into `folder`."""
    work = folder / "work"
    work.mkdir(parents=True, exist_ok=True)
    cost = [*service_rows(work), j_row(work)]
    reaction = reaction_rows(work)
    pictures = [folder / "cost.png", folder / "reaction.png"]
    draw_cost(cost, pictures[0])
    draw_error(reaction, pictures[1])
    return [*cost, *reaction], pictures


BENCHMARK = Benchmark(
    "md", "molecular dynamics: service, anchors and J beside bare LAMMPS, error of the reaction against seconds", run
)
