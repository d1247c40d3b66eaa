"""Time of a particle-step of the material point solver, with what bounds it."""

from __future__ import annotations

import os
import time
import tracemalloc
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from benchmarks.mpm_bandwidth import bytes_per_step, measure_bandwidth, point_passes
from mpm_service import (
    Body,
    Crack,
    Grid,
    HierarchicalGrid,
    IsotropicElastic,
    MaterialPointSolver,
    Scheme,
    fill_hierarchy,
    fill_rectangle,
)
from protocol.arrays import FloatArray
from protocol.verification import BenchmarkRow

LAW = IsotropicElastic(1.0e9, 0.3, 1000.0, "plane_strain")
#: Cells around the body [cells].
MARGIN = 4
POINTS_IN_CELL = 4
COURANT = 0.4
#: A slow stretch and shear [1/s], so that every point has velocity, strain and stress, and a crack opens.
SHAKE = ((0.02, 0.01), (0.0, 0.03))
SIZES = (10_000, 100_000, 400_000)
#: Size that is also run with two threads, whose memory is stated and whose target it is.
MIDDLE = 100_000
#: Particle-steps of a batch: a fifth of a second.
BATCH = 1_000_000
ROUNDS = 9


@dataclass(frozen=True)
class Configuration:
    """What is timed.

    Parameters
    ----------
    label : str
    scheme : Scheme
    target : float or None
        Time of a particle-step to reach on an idle core [ns].
    feature : {"", "crack", "levels"}
        A crack half through the square, or a middle quarter of the area with cells of half the size.
    """

    label: str
    scheme: Scheme
    target: float | None
    feature: Literal["", "crack", "levels"] = ""


FLIP = Scheme(transfer="flip")
CONFIGURATIONS = (
    Configuration("linear, USL, FLIP", Scheme("linear", "usl", "flip"), 45.0),
    Configuration("uGIMP, USL, FLIP", Scheme("ugimp", "usl", "flip"), 95.0),
    Configuration("uGIMP, MUSL, FLIP", FLIP, 150.0),
    Configuration("uGIMP, MUSL, FMPM(2) (default)", Scheme(), 220.0),
    Configuration("uGIMP, MUSL, FLIP, crack", FLIP, 200.0, "crack"),
    Configuration("uGIMP, MUSL, FLIP, level transition", FLIP, None, "levels"),
)


def make_square(configuration: Configuration, points: int, threads: int) -> MaterialPointSolver:
    """Build a free square of about so many points, four a cell, all in motion.

    Parameters
    ----------
    configuration : Configuration
    points : int
        The nearest square that the cells allow is taken.
    threads : int
    """
    # Three quarters of the coarse cells stay, each cell of the other quarter becomes four.
    cells = points / POINTS_IN_CELL / (1.75 if configuration.feature == "levels" else 1.0)
    side = 4 * max(2, round(np.sqrt(cells) / 4.0))
    plain = Grid((-MARGIN, -MARGIN), 1.0, (side + 2 * MARGIN, side + 2 * MARGIN))
    upper = (float(side), float(side))
    grid: Grid | HierarchicalGrid = plain
    smallest = plain.cell_size
    body: Body
    if configuration.feature == "levels":
        grid = HierarchicalGrid(plain, [((0.25 * side, 0.25 * side), (0.75 * side, 0.75 * side))])
        body = fill_hierarchy(grid, (0.0, 0.0), upper)
        smallest = grid.cell_sizes[-1]
    else:
        body = fill_rectangle((0.0, 0.0), upper, 1.0)
    middle = 0.5 * side + 0.5  # of a row of cells
    crack = Crack(((-1.0, middle), (0.5 * side, middle)))
    scheme = configuration.scheme
    courant = min(COURANT, scheme.courant_limit)
    return MaterialPointSolver(
        grid,
        body,
        LAW,
        thickness=1.0,
        time_step=courant * smallest / LAW.pressure_wave_speed,
        cracks=[crack] if configuration.feature == "crack" else [],
        initial_velocity_gradient=SHAKE,
        scheme=scheme,
        threads=threads,
    )


def bytes_per_point(configuration: Configuration, points: int) -> float:
    """Memory that a solver holds, everything included, per point [bytes]; nodal tables are a part of it."""
    make_square(configuration, points, 1).advance(1)  # compiles before the count begins
    tracemalloc.start()
    try:
        solver = make_square(configuration, points, 1)
        solver.advance(1)
        return tracemalloc.get_traced_memory()[0] / solver.points.count
    finally:
        tracemalloc.stop()


@dataclass
class _Lane:
    """A solver that takes its turns."""

    configuration: Configuration
    solver: MaterialPointSolver
    threads: int
    size: int

    def batch(self, particle_steps: int) -> tuple[float, float]:
        """Return the wall time of a particle-step [s], and the share of the cores this process had meanwhile."""
        count = self.solver.points.count
        steps = max(1, round(particle_steps / count))
        self.solver.advance(1)  # brings back what other lanes pushed out of the caches
        began, used = time.perf_counter(), time.process_time()
        self.solver.advance(steps)
        used, wall = time.process_time() - used, time.perf_counter() - began
        return wall / (steps * count), used / (wall * self.threads)


def measure_speed(
    configurations: Sequence[Configuration] = CONFIGURATIONS,
    sizes: Sequence[int] = SIZES,
    middle: int = MIDDLE,
    rounds: int = ROUNDS,
    batch: int = BATCH,
    bandwidth: dict[int, float] | None = None,
) -> list[BenchmarkRow]:
    """Time all configurations in turns, on one thread at all sizes and on two at the middle one.

    Parameters
    ----------
    configurations : sequence of Configuration
    sizes : sequence of int
        Numbers of points.
    middle : int
        Size with two threads and of the statement of memory, one of `sizes`.
    rounds : int
        Batches of each.
    batch : int
        Particle-steps of a batch.
    bandwidth : dict of int to float, optional
        Of one and of two threads [bytes/s]; measured if not given.

    Returns
    -------
    list of BenchmarkRow
        Configuration by configuration; `seconds` are those of a whole step. Figures, nanoseconds per particle-step
        unless they say otherwise: ``ns`` median, ``least``, ``target`` where there is one and ``ns/target``,
        ``bound`` by memory bandwidth, ``B/point`` held in memory, ``speed-up`` over one thread (median of the
        rounds), ``core share`` (median share of its cores the process had; near 1 on an idle machine with one
        thread), ``load`` (of the machine, mean over the last minute, median of the rounds).
    """
    speed_of_memory = bandwidth or measure_bandwidth((1, 2), rounds)
    memory = {c.label: bytes_per_point(c, middle) for c in configurations}
    lanes = [
        _Lane(c, make_square(c, size, threads), threads, size)
        for c in configurations
        for size, threads in [*((size, 1) for size in sizes), (middle, 2)]
    ]
    for lane in lanes:
        lane.batch(1)
    seconds, shares = np.zeros((2, len(lanes), rounds))
    load = np.zeros(rounds)
    for turn in range(rounds):
        # Another lane begins each round, so that none always follows the same one.
        for k in range(len(lanes)):
            index = (turn + k) % len(lanes)
            seconds[index, turn], shares[index, turn] = lanes[index].batch(batch)
        load[turn] = os.getloadavg()[0]
    rows = []
    for index, lane in enumerate(lanes):
        alone = next(
            k for k, other in enumerate(lanes)
            if (other.configuration, other.size, other.threads) == (lane.configuration, lane.size, 1)
        )  # fmt: skip
        figures = _figures(lane, seconds[index], shares[index], seconds[alone], speed_of_memory)
        if lane.size == middle and lane.threads == 1:
            figures["B/point"] = memory[lane.configuration.label]
        figures["load"] = float(np.median(load))
        rows.append(_row(lane, figures))
    return rows


def _figures(
    lane: _Lane, seconds: FloatArray, shares: FloatArray, alone: FloatArray, bandwidth: dict[int, float]
) -> dict[str, float]:
    median = 1e9 * float(np.median(seconds))
    figures = {"ns": median, "least": 1e9 * float(seconds.min())}
    target = lane.configuration.target
    if target is not None and lane.threads == 1:
        figures |= {"target": target, "ns/target": median / target}
    figures["bound"] = 1e9 * bytes_per_step(lane.configuration.scheme) / bandwidth[lane.threads]
    if lane.threads > 1:
        figures["speed-up"] = float(np.median(alone / seconds))
    figures["core share"] = float(np.median(shares))
    return figures


def _row(lane: _Lane, figures: dict[str, float]) -> BenchmarkRow:
    c, count = lane.configuration, lane.solver.points.count
    reads, writes = point_passes(c.scheme)
    return BenchmarkRow(
        label=f"{c.label}: {size_text(lane.size)} points{f', {lane.threads} threads' if lane.threads > 1 else ''}",
        knobs={
            "benchmark": "speed",
            "configuration": c.label,
            "interpolation": c.scheme.interpolation,
            "integration": c.scheme.integration,
            "transfer": c.scheme.transfer,
            "order": c.scheme.order,
            "feature": c.feature or "none",
            "points": count,
            "size": lane.size,
            "threads": lane.threads,
            "reads": reads,
            "writes": writes,
            "bytes": bytes_per_step(c.scheme),
        },
        seconds=1e-9 * figures["ns"] * count,
        figures=figures,
    )


def bandwidth_rows(bandwidth: dict[int, float], array_bytes: int) -> list[BenchmarkRow]:
    """Return a row for each number of threads; `seconds` are those of one triad."""
    return [
        BenchmarkRow(
            label=f"memory bandwidth, {threads} thread{'s' if threads > 1 else ''}",
            knobs={"benchmark": "bandwidth", "threads": threads, "array_bytes": array_bytes},
            seconds=4 * array_bytes / rate,
            figures={"GB/s": 1e-9 * rate},
        )
        for threads, rate in bandwidth.items()
    ]


def size_text(points: int) -> str:
    """Return a number of points in thousands."""
    return f"{points // 1000}k" if points >= 1000 else str(points)
