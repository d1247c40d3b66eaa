"""Speed of the bare solver."""

from __future__ import annotations

import time

import numpy as np

from .grid import Grid
from .material_points import fill_rectangle
from .materials import IsotropicElastic
from .solver import MaterialPointSolver


def particle_step_nanoseconds(points: int = 100_000, repeats: int = 5, steps: int = 10) -> float:
    """Median nanoseconds per material point and step, uGIMP MUSL, one thread, no crack.

    A plane strain square, four points a cell, shaken by a shear and a stretch so that every path is live.

    Parameters
    ----------
    points : int
        Wanted number of material points; the nearest square is taken.
    repeats : int
        Runs of which the median counts.
    steps : int
        Steps per run.

    Returns
    -------
    float
        Median [ns]. The figure, its spread and the real number of points are printed.
    """
    side = max(2, round(np.sqrt(points / 4.0)))
    material = IsotropicElastic(1e9, 0.3, 1000.0, "plane_strain")
    body = fill_rectangle((0.0, 0.0), (side * 1.0, side * 1.0), 1.0)
    grid = Grid((-3.0, -3.0), 1.0, (side + 6, side + 6))
    step = 0.4 / material.pressure_wave_speed
    solver = MaterialPointSolver(
        grid, body, material, 1.0, step, initial_velocity_gradient=[[0.02, 0.01], [0.0, -0.01]]
    )
    solver.advance(2)
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        solver.advance(steps)
        times.append((time.perf_counter() - start) / (steps * body.count) * 1e9)
    median = float(np.median(times))
    print(
        f"{body.count} points, {repeats} x {steps} steps: {median:.1f} ns per point and step "
        f"(least {min(times):.1f}, most {max(times):.1f})"
    )
    return median


if __name__ == "__main__":
    particle_step_nanoseconds()
