"""A step of traction runs along a bar of graphene (Sec 2.6, Fig 2.9)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..elastic import IsotropicElastic
from ..grid import Grid
from ..loads import Traction
from ..material_points import fill_rectangle
from ..scheme import Scheme
from ..solver import MaterialPointSolver
from .plots import BLUE, GREY, ORANGE, RED, new_picture, save_picture
from .signals import Front, read_front

FloatArray = NDArray[np.float64]

LENGTH = 100.0  # m
CELLS = 200
TRACTION = 100.0e6  # Pa
YOUNG = 1.03e12  # Pa, graphene
DENSITY = 2250.0  # kg/m3, graphene
#: Cells travelled when the front is read.
TRAVEL = 150
COURANT = 0.4


def wave_speed() -> float:
    """Speed of a wave along a thin bar [m/s] (Eq 50)."""
    return float(np.sqrt(YOUNG / DENSITY))


def switched_on(time: FloatArray) -> FloatArray:
    """Unit step at time zero; one half there, so that the first explicit step gives the impulse since time zero."""
    return np.asarray(np.heaviside(time, 0.5))


@dataclass(frozen=True)
class BarWave:
    """What was measured on the bar.

    Attributes
    ----------
    time : float
        When the front was read [s].
    place : (k,) ndarray
        Middles of the cells [m].
    stress : (k,) ndarray
        Axial stress over the traction, mean over the points of each cell.
    front : Front
        Lengths in metres.
    speed : float
        Place of half the height over the time [m/s].
    rise_in_cells : float
    profiles : list of (time, stress)
        Stress along the bar on the way, for the picture.
    """

    time: float
    place: FloatArray
    stress: FloatArray
    front: Front
    speed: float
    rise_in_cells: float
    profiles: list[tuple[float, FloatArray]]


def make_bar(scheme: Scheme, courant: float = COURANT, cells: int = CELLS) -> MaterialPointSolver:
    """Build the bar: two cells high, in plane stress with free sides; without lateral contraction Eq 50 is exact."""
    cell = LENGTH / cells
    law = IsotropicElastic(YOUNG, 0.0, DENSITY, "plane_stress")
    return MaterialPointSolver(
        Grid((-3.0 * cell, -3.0 * cell), cell, (cells + 6, 8)),
        fill_rectangle((0.0, 0.0), (LENGTH, 2.0 * cell), cell),
        law,
        thickness=1.0,
        time_step=courant * cell / law.pressure_wave_speed,
        loads=(Traction("left", (-TRACTION, 0.0), switched_on),),
        scheme=scheme,
    )


def run_bar_wave(scheme: Scheme | None = None, courant: float = COURANT) -> BarWave:
    """Pull the bar at its left end and read the front after `TRAVEL` cells.

    Parameters
    ----------
    scheme : Scheme, optional
        The default scheme if not given.
    courant : float
        Courant number.
    """
    solver = make_bar(scheme or Scheme(), courant)
    steps = round(TRAVEL / courant)
    cell = LENGTH / CELLS
    column = (solver.points.reference_position[:, 0] // cell).astype(np.int64)
    place: FloatArray = np.linspace(0.5 * cell, LENGTH - 0.5 * cell, CELLS, dtype=np.float64)
    profiles: list[tuple[float, FloatArray]] = []
    stress: FloatArray = np.zeros(0)
    for part in range(3):
        solver.advance(steps * (part + 1) // 3 - solver.step)
        axial = solver.points.stress[:, 0] / TRACTION
        stress = np.bincount(column, weights=axial) / np.bincount(column)
        profiles.append((solver.time, stress))
    front = read_front(place, stress, 1.0)
    return BarWave(solver.time, place, stress, front, front.place / solver.time, front.rise / cell, profiles)


def draw_bar_wave(waves: dict[str, BarWave], path: Path) -> Path:
    """Draw the stress along the bar at three times, and the front close up, for several schemes."""
    picture, (whole, close) = new_picture(2, 1, height=6.4)
    colours = (BLUE, ORANGE, RED)
    for (label, wave), colour in zip(waves.items(), colours, strict=False):
        for k, (_, stress) in enumerate(wave.profiles):
            whole.plot(wave.place, 100.0 * stress, color=colour, linewidth=1.1, label=label if k == 0 else None)
        close.plot(wave.place, 100.0 * wave.stress, color=colour, marker=".", markersize=4, linewidth=1.0, label=label)
    speed = wave_speed()
    for k, (time, _) in enumerate(wave.profiles):
        exact = {"color": GREY, "linewidth": 1.0, "linestyle": "--", "zorder": 0}
        whole.plot([0, speed * time, speed * time], [100, 100, 0], label="exact" if k == 0 else None, **exact)
        label = f"{1e3 * time:.2f} ms"
        whole.annotate(label, (speed * time, 50), xytext=(4, 0), textcoords="offset points", fontsize=8)
    front = speed * wave.time
    close.plot([0, front, front, LENGTH], [100, 100, 0, 0], **exact)
    close.set_xlim(front - 14, front + 5)
    whole.axhline(120, color=GREY, linewidth=0.8, linestyle=":")
    whole.annotate("overshoot in the source's figure", (99, 122), ha="right", va="bottom", fontsize=8, color=GREY)
    whole.set_title("Graphene bar, 100 m in 200 cells, a pull of 100 MPa at the left end")
    whole.set_ylim(-24, 142)
    for panel in (whole, close):
        panel.set_ylabel("axial stress (MPa)")
        panel.legend(frameon=False, loc="lower left")
    close.set_xlabel("place along the bar (m)")
    return save_picture(picture, path)
