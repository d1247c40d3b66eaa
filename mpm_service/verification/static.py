"""Static preload of an edge-cracked square plate on nested levels, and a run that starts from it.

The plate is that of the dissertation's Sec 5.1: 40960 Å wide and high, a crack of 19980 Å, cells from 2560 Å down to
10 Å in nine levels or 5 Å in ten. Dead tractions; the load is small, since a linear law that is strained by a tenth, as
cells of 5 Å at the tip are under the load of a first broken bond, has no J that all contours agree on.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import numpy as np

from protocol.verification import Case, Check

from ..crack_line import Crack
from ..elastic import IsotropicElastic
from ..fracture import TipFrame, fields_around, interaction_intensities, j_integral
from ..grid import Grid
from ..hierarchy import HierarchicalGrid
from ..hierarchy_filling import fill_hierarchy
from ..loads import Traction
from ..solver import MaterialPointSolver
from .collocation import edge_crack_factor
from .plots import COLOURS, GREY, new_picture, save_picture

ANGSTROM = 1e-10
SIDE, CRACK, COARSE = 40960 * ANGSTROM, 19980 * ANGSTROM, 2560 * ANGSTROM
#: Half width of a level [cells of its parent].
_HALF = 6
LAW = IsotropicElastic(1e12, 0.2, 2200.0, "plane_stress")
STRESS = 5e6
#: Outer radii of the rings, all with an inner one of 1.5 [cells of the finest level].
RINGS = (4.0, 6.0, 8.0, 11.0)


@dataclass(frozen=True)
class Preloaded:
    """What a static preload gave.

    Attributes
    ----------
    levels, points, iterations : int
    seconds, residual : float
    intensity : float
        K_I by the interaction integral [Pa sqrt(m)].
    release_rate : tuple of float
        J of each ring [J/m^2].
    reference : float
        K_I by boundary collocation [Pa sqrt(m)].
    moved : float
        Largest displacement of the tip [cells of the finest level].
    rest : float
        Kinetic over strain energy after 200 steps of a run.
    """

    levels: int
    points: int
    iterations: int
    seconds: float
    residual: float
    intensity: float
    release_rate: tuple[float, ...]
    reference: float
    moved: float
    rest: float


def plate(levels: int) -> tuple[MaterialPointSolver, float, float]:
    """Return the plate, its finest cell and the length of its crack [m]; the tip is the origin."""
    fine = COARSE / 2 ** (levels - 1)
    length = fine * round(CRACK / fine)
    lower = np.array([-length, -0.5 * SIDE])
    refined, cell = [], COARSE
    for _ in range(levels - 1):
        low, high = (lower + cell * np.round((sign * _HALF * cell - lower) / cell) for sign in (-1.0, 1.0))
        refined.append((tuple(low), tuple(high)))
        cell *= 0.5
    cells = round(SIDE / COARSE) + 6
    grid = HierarchicalGrid(Grid(tuple(lower - 3 * COARSE), COARSE, (cells, cells)), refined)
    solver = MaterialPointSolver(
        grid,
        fill_hierarchy(grid, tuple(lower), tuple(lower + SIDE), 2),
        LAW,
        3.35 * ANGSTROM,
        0.4 * fine / LAW.pressure_wave_speed,
        cracks=[Crack(((float(lower[0] - COARSE), 0.0), (0.0, 0.0)))],
        loads=[Traction("top", (0.0, STRESS)), Traction("bottom", (0.0, -STRESS))],
    )
    return solver, fine, length


def preload(levels: int) -> Preloaded:
    """Solve, measure, and run on."""
    solver, fine, length = plate(levels)
    began = perf_counter()
    ended = solver.equilibrate(1e-7, 15)
    seconds = perf_counter() - began
    assert solver.cracks is not None
    tip = solver.cracks.tips[0]
    frame = TipFrame(tip.reference, tip.reference_direction)
    fields = fields_around(solver.points, solver.thickness, tip.reference, 1.5 * max(RINGS) * fine)
    rates = tuple(float(j_integral(fields, frame, 1.5 * fine, ring * fine)) for ring in RINGS)
    found = interaction_intensities(fields, frame, 1.5 * fine, 8.0 * fine, LAW.young, LAW.poisson, True)
    factor = edge_crack_factor(length / SIDE, 1.0, terms=80, places=400)
    moved = float(np.abs(tip.position - tip.reference).max() / fine)
    strain = solver.energies().strain
    solver.advance(200)
    return Preloaded(
        levels,
        solver.points.count,
        ended.steps,
        seconds,
        ended.residual,
        float(found.opening),
        rates,
        float(factor * STRESS * np.sqrt(np.pi * length)),
        moved,
        solver.kinetic_energy / strain,
    )


def static_preload(folder: Path) -> list[Check]:
    """K, J and rest of the plate on five, nine and ten levels."""
    runs = [preload(levels) for levels in (5, 9, 10)]
    figure, axes = new_picture()
    for colour, run in zip(COLOURS, runs, strict=False):
        exact = run.reference**2 / LAW.young
        fine = COARSE / 2 ** (run.levels - 1) / ANGSTROM
        axes.plot(
            RINGS, np.array(run.release_rate) / exact, "o-", color=colour, label=f"{run.levels} levels, {fine:g} Å"
        )
    axes.axhline(1.0, color=GREY, lw=0.8)
    axes.set_xlabel("outer radius of the ring [finest cells]")
    axes.set_ylabel("J over boundary collocation")
    axes.legend()
    save_picture(figure, folder / "static.png")
    source = "boundary collocation of Williams' series, a/W = 0.488, square plate"
    at_rest = "equilibrium; limit set for the product"
    checks = []
    for run in runs:
        name = f"{run.levels} levels"
        checks += [
            Check(f"K_I by the interaction integral, {name}", run.intensity, run.reference, 0.005, source,
                  unit="Pa m^0.5"),
            Check(f"J of the widest ring, {name}", run.release_rate[-1], run.reference**2 / LAW.young, 0.01, source,
                  unit="J/m^2"),
            Check(f"residual, {name}, {run.iterations} iterations", run.residual, 1e-7, 0.0, at_rest, at_most=True),
            Check(f"kinetic over strain energy after 200 steps, {name}", run.rest, 1e-8, 0.0, at_rest, at_most=True),
            Check(f"displacement of the tip over a finest cell, {name}", run.moved, 0.1, 0.0,
                  "the finest level stays with its material", at_most=True),
        ]  # fmt: skip
    last = runs[-1]
    checks.append(Check(f"seconds of the solution, {last.levels} levels, {last.points} points", last.seconds, 60.0, 0.0,
                        "limit set for the product", at_most=True, unit="s"))  # fmt: skip
    return checks


CASES = [Case("mpm", "static", "static preload of an edge-cracked plate on nested levels", static_preload)]
