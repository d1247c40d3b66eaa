"""Strip with an edge crack under tension: energy release rate against Tada, by J-integral and by crack closure.

The crack lies in the middle of a row of cells, half a cell above mid-height where the number of rows is even, with
its tip on a line of nodes; `run_edge_crack` takes other places too. The load is a hundredth of the one stated and J
is referred to that by its square: Tada's answer is that of linear elasticity, and at 1 MPa the strip already
straightens under its load enough to take 1 % off J.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..crack_growth import jump_behind
from ..crack_line import Crack
from ..elastic import IsotropicElastic
from ..fracture import (
    CLOSURE,
    RING,
    Intensities,
    TipFrame,
    fields_around,
    interaction_intensities,
    j_integral,
    plane_constants,
    vcct,
)
from ..grid import Grid
from ..loads import Traction
from ..material_points import fill_rectangle
from ..scheme import Scheme
from ..solver import MaterialPointSolver
from ..time_functions import Ramp
from .plots import COLOURS, GREY, new_picture, save_picture

FloatArray = NDArray[np.float64]

WIDTH, HEIGHT, LENGTH = 20e-3, 50e-3, 10e-3  # m
YOUNG, POISSON, DENSITY = 2.5e9, 0.33, 1000.0
STRESS = 1.0e6  # Pa, to which all results are referred
LOAD_SHARE = 0.01
CELLS = (5, 10, 20)  # in the crack's length
#: Rings by cells in the crack's length; the first one is the answer [cells].
RINGS = {
    5: ((1.0, 4.0), (1.0, 4.5), (1.5, 4.5)),
    10: (RING, (1.0, 5.0), (2.0, 8.0), (3.0, 8.0), (3.0, 9.5)),
    20: (RING, (1.0, 5.0), (2.0, 8.0), (3.0, 9.0), (4.0, 12.0), (2.0, 19.0)),
}
COURANT = 0.6
# Ramp, and rest after it, in travels of a wave over the height; damping in their inverse.
_RAMP, _REST, _DAMPING = 8.0, 8.0, 0.9


@dataclass(frozen=True)
class EdgeCrack:
    """What was measured at the tip at rest, referred to `STRESS`.

    Attributes
    ----------
    cells : int
        Cells in the crack's length, a/h.
    rings : tuple of (float, float)
        Radii of the rings [cells].
    release_rate : (k,) ndarray
        J of each ring [J/m^2].
    closure : tuple of float
        G_I and G_II by virtual crack closure [J/m^2]; NaN where the closure length does not fit.
    intensities : Intensities
        By the interaction integral over the first ring [Pa sqrt(m)].
    behind, opening : (m,) ndarray
        Distance behind the tip, and opening there [m].
    """

    cells: int
    rings: tuple[tuple[float, float], ...]
    release_rate: FloatArray
    closure: tuple[float, float]
    intensities: Intensities
    behind: FloatArray
    opening: FloatArray

    @property
    def contour_spread(self) -> float:
        """Largest less smallest J of all rings over that of the first."""
        return float(np.ptp(self.release_rate) / self.release_rate[0])


def tada_intensity(length: float = LENGTH) -> float:
    """K_I of the strip under `STRESS` for a crack of this length [Pa sqrt(m)], within 0.5 %."""
    x = 0.5 * np.pi * length / WIDTH
    shape = np.sqrt(np.tan(x) / x) * (0.752 + 2.02 * length / WIDTH + 0.37 * (1.0 - np.sin(x)) ** 3) / np.cos(x)
    return float(STRESS * np.sqrt(np.pi * length) * shape)


def tada_release_rate(length: float = LENGTH) -> float:
    """J of the strip in plane strain [J/m^2]."""
    return tada_intensity(length) ** 2 / plane_constants(YOUNG, POISSON, False)[0]


def run_edge_crack(
    cells: int, scheme: Scheme | None = None, tip_offset: float = 0.0, row_offset: float = 0.5
) -> EdgeCrack:
    """Pull the strip, let it come to rest, and measure.

    Parameters
    ----------
    cells : int
        Cells in the crack's length of 10 mm, one of `CELLS`.
    scheme : Scheme, optional
        The default scheme if not given.
    tip_offset, row_offset : float
        Place of the tip beyond a line of nodes, and of the crack above one [cells].

    Returns
    -------
    EdgeCrack
        With a tip offset the crack is longer than 10 mm; compare with `tada_release_rate` of its length.
    """
    h = LENGTH / cells
    law = IsotropicElastic(YOUNG, POISSON, DENSITY, "plane_strain")
    rows = round(HEIGHT / h)
    tip = (LENGTH + tip_offset * h, (rows // 2 + row_offset) * h)
    travel = HEIGHT / law.pressure_wave_speed
    pull = Ramp(_RAMP * travel, LOAD_SHARE * STRESS, smooth=True)
    time_step = COURANT * h / law.pressure_wave_speed
    solver = MaterialPointSolver(
        Grid((-3.0 * h, -3.0 * h), h, (2 * cells + 6, rows + 6)),
        fill_rectangle((0.0, 0.0), (WIDTH, HEIGHT), h),
        law,
        1.0,
        time_step,
        cracks=[Crack(((-2.0 * h, tip[1]), (tip[0], tip[1])))],
        damping=_DAMPING / travel,
        scheme=scheme,
        loads=[Traction("top", (0.0, 1.0), pull), Traction("bottom", (0.0, -1.0), pull)],
    )
    solver.advance(round((_RAMP + _REST) * travel / time_step))
    return _measure(solver, cells, h)


def _measure(solver: MaterialPointSolver, cells: int, h: float) -> EdgeCrack:
    assert solver.cracks is not None
    found = solver.cracks.tips[0]
    tip = TipFrame(found.reference, found.reference_direction)
    rings = RINGS[cells]
    reach = max(max(outer for _, outer in rings), np.sqrt(2.0) * CLOSURE) * h
    fields = fields_around(solver.points, solver.thickness, tip.position, reach)
    release = np.array([j_integral(fields, tip, inner * h, outer * h) for inner, outer in rings])
    inner, outer = (radius * h for radius in rings[0])
    first, second = interaction_intensities(fields, tip, inner, outer, YOUNG, POISSON, False)
    closure = (float("nan"), float("nan"))
    if CLOSURE * h < 0.8 * LENGTH:
        opening, sliding = jump_behind(solver.cracks, found, CLOSURE * h)
        closure = vcct(fields, tip, float(opening), float(sliding), CLOSURE * h)
    behind = np.linspace(0.0, LENGTH, 4 * cells + 1)
    jumps = np.array([jump_behind(solver.cracks, found, s)[0] for s in behind])
    square = LOAD_SHARE**2
    return EdgeCrack(
        cells,
        rings,
        release / square,
        (closure[0] / square, closure[1] / square),
        Intensities(first / LOAD_SHARE, second / LOAD_SHARE),
        behind,
        jumps / LOAD_SHARE,
    )


#: Places of the tip in its cell that are tried beside the standard one: along the crack, and across it.
PLACES = ((0.25, 0.5), (0.5, 0.5), (0.75, 0.5), (0.0, 0.0), (0.5, 0.25))
#: a/h for `elsewhere`.
ELSEWHERE = 10


def elsewhere(scheme: Scheme | None = None) -> dict[tuple[float, float], float]:
    """Relative errors of J for tips at other places of their cell, a/h = `ELSEWHERE`, by (tip, row) offset."""
    errors = {}
    for along, across in PLACES:
        run = run_edge_crack(ELSEWHERE, scheme, along, across)
        errors[along, across] = run.release_rate[0] / tada_release_rate(LENGTH * (1.0 + along / ELSEWHERE)) - 1.0
    return errors


def draw_edge_crack(runs: dict[int, EdgeCrack], places: dict[tuple[float, float], float], path: Path) -> Path:
    """Draw J over the ring's size, its error over a/h, and the opening beside Williams' field."""
    reference = tada_release_rate()
    picture, panels = new_picture(1, 3, width=14.0, height=4.3)
    for colour, (cells, run) in zip(COLOURS, runs.items(), strict=False):
        outer = np.array([ring[1] for ring in run.rings])
        order = np.argsort(outer)
        panels[0].plot(outer[order], run.release_rate[order], "o-", color=colour, label=f"a/h = {cells}")
        panels[2].plot(1e3 * run.behind, 1e6 * run.opening, "o", ms=3.0, color=colour, label=f"a/h = {cells}")
    panels[0].axhline(reference, color=GREY, label="Tada")
    panels[0].set(xlabel="outer radius of the ring [cells]", ylabel="J [J/m²]", title="J over the size of the ring")
    panels[0].set_ylim(0.94 * reference, 1.06 * reference)
    errors = np.array([run.release_rate[0] / reference - 1.0 for run in runs.values()])
    panels[1].plot(list(runs), 100.0 * errors, "o-", color=COLOURS[0], label="tip on a node line, mid-row")
    panels[1].plot(
        np.full(len(places), ELSEWHERE), 100.0 * np.array(list(places.values())), "x", color=COLOURS[1],
        label="tip elsewhere in its cell",
    )  # fmt: skip
    panels[1].plot((5, 10, 20), (5.3, 1.8, -0.5), "s--", color=GREY, mfc="none", label="NairnMPM")
    panels[1].axhline(0.0, color=GREY, lw=0.8)
    panels[1].set(xlabel="cells in the crack's length, a/h", ylabel="error of J [%]", title="J against Tada")
    effective = plane_constants(YOUNG, POISSON, False)[0]
    behind = np.linspace(0.0, LENGTH, 200)
    williams = 8.0 * tada_intensity() / effective * np.sqrt(behind / (2.0 * np.pi))
    panels[2].plot(1e3 * behind, 1e6 * williams, color=GREY, label="Williams, singular term")
    panels[2].set(xlabel="distance behind the tip [mm]", ylabel="opening [µm]", title="Opening of the crack")
    for panel in panels:
        panel.legend(frameon=False)
    return save_picture(picture, path)


def edge_crack(folder: Path) -> tuple[dict[int, EdgeCrack], dict[tuple[float, float], float]]:
    """Run the case at every a/h and for tips elsewhere in their cell; draw ``edge_crack.png`` into the folder."""
    runs = {cells: run_edge_crack(cells) for cells in CELLS}
    places = elsewhere()
    draw_edge_crack(runs, places, folder / "edge_crack.png")
    return runs, places
