"""Benchmark `mpm`: time of a particle-step beside what bounds it, and error against seconds."""

from __future__ import annotations

from pathlib import Path

from benchmarks.mpm_accuracy import STUDIES, measure_accuracy
from benchmarks.mpm_accuracy_picture import draw_accuracy
from benchmarks.mpm_bandwidth import ARRAY_BYTES, measure_bandwidth
from benchmarks.mpm_speed import ROUNDS, bandwidth_rows, measure_speed
from benchmarks.mpm_speed_picture import draw_speed
from protocol.verification import Benchmark, BenchmarkRow


def run(folder: Path) -> tuple[list[BenchmarkRow], list[Path]]:
    """Measure and draw; the pictures are written into `folder`."""
    bandwidth = measure_bandwidth((1, 2), ROUNDS)
    rows = measure_speed(bandwidth=bandwidth)
    pictures = [folder / "speed.png"]
    draw_speed(rows, bandwidth, pictures[0])
    rows += bandwidth_rows(bandwidth, ARRAY_BYTES)
    for study in STUDIES:
        own = measure_accuracy(study)
        pictures.append(folder / f"{study.name.replace(' ', '_')}.png")
        draw_accuracy(study, own, pictures[-1])
        rows += own
    return rows, pictures


BENCHMARK = Benchmark(
    "mpm", "material point solver: time of a particle-step and its bounds, error against seconds", run
)
