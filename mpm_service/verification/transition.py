"""A wave passes a 2:1 change of cell size: what is thrown back."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..conditions import EdgeCondition
from ..elastic import IsotropicElastic
from ..grid import Grid
from ..hierarchy import HierarchicalGrid
from ..hierarchy_filling import fill_hierarchy
from ..scheme import Scheme
from ..solver import MaterialPointSolver
from .plots import BLUE, GREY, ORANGE, new_picture, save_picture

FloatArray = NDArray[np.float64]

LAW = IsotropicElastic(1.0e9, 0.0, 1000.0, "plane_stress")
#: Height of the bar in coarse cells (side one).
HEIGHT = 2
#: Wavelengths in the burst, and from the driven end to the transition.
CYCLES, APPROACH = 5, 7.5
_STRAIN = 1.0e-6
_COURANT = 0.5  # in the fine cells


@dataclass(frozen=True)
class Reflection:
    """What a tone burst leaves behind.

    Attributes
    ----------
    reflected : float
        Largest velocity left in the coarse part after the burst has passed, over the burst's own.
    place : (k,) ndarray
        Places of the point columns [m].
    velocity : list of (k,) ndarray
        Velocity over the burst's amplitude before, at, and after the passage.
    """

    reflected: float
    place: FloatArray
    velocity: list[FloatArray]


def tone_burst(phase: FloatArray) -> FloatArray:
    """Sine under a Hann window; ``phase`` counts wavelengths since the head, the burst is zero outside it."""
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.clip(phase / CYCLES, 0.0, 1.0))
    return np.asarray(window * np.sin(2.0 * np.pi * phase))


def run_transition(wavelength: float = 20.0, scheme: Scheme | None = None, refined: bool = True) -> Reflection:
    """Send a burst along a bar from coarse into fine cells.

    Parameters
    ----------
    wavelength : float
        In coarse cells.
    scheme : Scheme, optional
        The default scheme if not given.
    refined : bool
        Without, the whole bar has coarse cells: what the burst then leaves behind is not due to a transition.
    """
    speed = LAW.pressure_wave_speed
    front = round(APPROACH * wavelength)
    length = front + round(CYCLES * wavelength) + 10
    coarse = Grid((-4.0, -4.0), 1.0, (length + 8, HEIGHT + 8))
    levels = [((float(front), -2.0), (length + 2.0, HEIGHT + 2.0))] if refined else []
    grid = HierarchicalGrid(coarse, levels)
    amplitude = _STRAIN * wavelength

    def drive(time: FloatArray) -> FloatArray:
        return np.asarray(amplitude * tone_burst(speed * time / wavelength))

    solver = MaterialPointSolver(
        grid,
        fill_hierarchy(grid, (0.0, 0.0), (float(length), float(HEIGHT))),
        LAW,
        1.0,
        _COURANT * 0.5 / speed,
        edge_conditions=(EdgeCondition("left", 0, displacements=drive),),
        scheme=scheme or Scheme(),
    )
    place, column = np.unique(np.round(solver.points.reference_position[:, 0], 9), return_inverse=True)
    count = np.bincount(column)
    passed = CYCLES * wavelength + front
    velocity = []
    for travelled in (0.7 * front, front + 0.5 * CYCLES * wavelength, passed + 5.0):
        solver.advance(round(travelled / (_COURANT * 0.5)) - solver.step)
        velocity.append(np.bincount(column, weights=solver.points.velocity[:, 0]) / count)
    height = float(np.abs(velocity[0]).max())
    scaled = [v / height for v in velocity]
    return Reflection(float(np.abs(scaled[2][place < front - 2.0]).max()), place, scaled)


def draw_transition(refined: Reflection, plain: Reflection, wavelength: float, path: Path) -> Path:
    """Draw the burst before, at and after the transition, and what it leaves behind, enlarged."""
    picture, panels = new_picture(4, 1, height=8.0)
    front = round(APPROACH * wavelength)
    titles = ("before", "at the transition", "after", "after, enlarged")
    for panel, title in zip(panels, titles, strict=True):
        panel.axvspan(front, refined.place[-1], color=ORANGE, alpha=0.12, linewidth=0)
        panel.set_title(title, loc="left", fontsize=9)
        panel.set_xlim(0.0, refined.place[-1])
    for panel, velocity in zip(panels, refined.velocity, strict=False):
        panel.plot(refined.place, velocity, color=BLUE, linewidth=1.1)
        panel.set_ylabel("velocity over\namplitude")
    for run, colour, label in ((plain, GREY, "coarse throughout"), (refined, BLUE, "2:1 transition")):
        left = run.place < front - 2.0
        panels[3].plot(run.place[left], 100.0 * run.velocity[2][left], color=colour, linewidth=1.1, label=label)
    panels[3].set_ylabel("velocity over\namplitude (%)")
    panels[3].legend(frameon=False, fontsize=8, loc="upper right")
    panels[3].set_xlabel("place along the bar (coarse cells); fine cells in the shaded part")
    picture.suptitle(f"Burst of {wavelength:g} coarse cells wavelength through a 2:1 transition", fontsize=11)
    return save_picture(picture, path)
