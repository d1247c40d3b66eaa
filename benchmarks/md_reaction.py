"""Error of the averaged reaction against seconds, over the window M, the time step and the anchors' stiffness."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Final

import numpy as np

from md_service.engine import Engine
from md_service.force_fields import force_field as profile_of
from md_service.lammps_dynamics import LammpsDynamics
from md_service.overhead import DAMPING_TIME, TEMPERATURE, framed_sheet
from md_service.statistics import estimate
from protocol.verification import BenchmarkRow

SIZE: Final = 52e-10  # m
MARGIN: Final = 10e-10  # m
STRAIN: Final = 0.01
LENGTH: Final = 3e-12  # s of each run
#: Window M, time step (fs), stiffness (N/m): one knob at a time about the middle.
MIDDLE: Final = (30, 0.5, 30.0)
CONFIGURATIONS: Final = (
    MIDDLE,
    *[(window, 0.5, 30.0) for window in (3, 10, 100, 300)],
    *[(round(15 / step), step, 30.0) for step in (0.1, 0.25, 1.0)],
    *[(30, 0.5, stiffness) for stiffness in (3.0, 10.0, 100.0, 300.0)],
)


def reaction_rows(folder: Path) -> list[BenchmarkRow]:
    """Rows of a tersoff sheet at 300 K, held at a strain of 1 % by anchors on its frame.

    `seconds` is the wall time of the run, `error` the standard error of the mean pull of the two sides, relative to
    that pull. The figures are the pull (N), the standard deviation of one window's mean relative to it, and the
    correlation time (s).
    """
    return [_row(folder, *configuration) for configuration in CONFIGURATIONS]


def _row(folder: Path, window: int, femtoseconds: float, stiffness: float) -> BenchmarkRow:
    profile = profile_of("tersoff")
    atoms, frame = framed_sheet("tersoff", SIZE, MARGIN)
    place = atoms.position[frame]
    dynamics = LammpsDynamics(
        folder / "reaction", profile, atoms, temperature=TEMPERATURE, seed=2, time_step=femtoseconds * 1e-15
    )
    engine = Engine(dynamics, temperature=TEMPERATURE)
    side = (place[:, 0] > 0.0).astype(np.int64)
    engine.register_anchors(frame, place, np.full(len(frame), stiffness), side, DAMPING_TIME)
    engine.equilibrate(round(1e-12 / engine.time_step))
    engine.measure_reference(max(8, round(LENGTH / (window * engine.time_step))), window)
    pulled, still = place * [1.0 + STRAIN, 1.0, 1.0], np.zeros_like(place)
    for _ in range(max(1, round(1e-12 / (window * engine.time_step)))):
        engine.advance(window, pulled, still)  # until the strain has gone through the sheet
    windows = max(8, round(LENGTH / (window * engine.time_step)))
    start = time.perf_counter()
    force = np.array([engine.advance(window, pulled, still).ivc_force[:, 0] for _ in range(windows)])
    seconds = time.perf_counter() - start
    engine.close()
    # The left side is pulled to the right and the right side to the left.
    pull = estimate(0.5 * (force[:, 0] - force[:, 1]), window * engine.time_step)
    mean = float(pull.mean)
    return BenchmarkRow(
        f"M = {window}, {femtoseconds:g} fs, {stiffness:g} N/m",
        {"M": window, "time_step_fs": femtoseconds, "stiffness": stiffness},
        seconds,
        float(pull.standard_error) / abs(mean),
        {
            "pull": mean,
            "window_deviation": float(np.std(0.5 * (force[:, 0] - force[:, 1]), ddof=1)) / abs(mean),
            "correlation_time": float(pull.correlation_time),
        },
    )
