"""Ten periods of the first axial mode of a bar that is held at one end."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..conditions import symmetry
from ..elastic import IsotropicElastic
from ..grid import Grid
from ..material_points import fill_rectangle
from ..scheme import Scheme
from ..solver import MaterialPointSolver
from .plots import BLUE, GREY, new_picture, save_picture
from .signals import mean_period

FloatArray = NDArray[np.float64]

CELLS = 40
PERIODS = 10
YOUNG, DENSITY = 1.0e9, 1000.0
COURANT = 0.4
_AMPLITUDE = 1.0e-5  # of the velocity, over the wave speed: strains stay linear


@dataclass(frozen=True)
class FreeVibration:
    """What was measured on the vibrating bar.

    Attributes
    ----------
    frequency, exact_frequency : float
        [Hz].
    energy_kept : float
        Total energy at the end over that at the start, each averaged over half a period, in which the time
        scheme's own swing about the true energy cancels.
    time, modal_displacement, energy : (k,) ndarray
        [s], over the largest exact one, over that at the start.
    """

    frequency: float
    exact_frequency: float
    energy_kept: float
    time: FloatArray
    modal_displacement: FloatArray
    energy: FloatArray


def run_free_vibration(scheme: Scheme | None = None, courant: float = COURANT) -> FreeVibration:
    """Start the bar with the velocity of its first mode and follow it over ten periods.

    Parameters
    ----------
    scheme : Scheme, optional
        The default scheme if not given.
    courant : float
        Courant number.
    """
    law = IsotropicElastic(YOUNG, 0.0, DENSITY, "plane_stress")
    speed = law.pressure_wave_speed
    body = fill_rectangle((0.0, 0.0), (float(CELLS), 2.0), 1.0)
    mode = np.sin(0.5 * np.pi * body.position[:, 0] / CELLS)
    solver = MaterialPointSolver(
        Grid((-3.0, -3.0), 1.0, (CELLS + 6, 8)),
        body,
        law,
        thickness=1.0,
        time_step=courant / speed,
        edge_conditions=(symmetry("left"),),
        initial_velocity=np.stack([_AMPLITUDE * speed * mode, np.zeros_like(mode)], axis=1),
        scheme=scheme or Scheme(),
    )
    exact = speed / (4.0 * CELLS)
    steps_per_sample = 4
    samples = round((PERIODS + 0.55) / exact / solver.time_step / steps_per_sample)
    time, moved, energy = np.zeros((3, samples))
    for k in range(samples):
        solver.advance(steps_per_sample)
        time[k] = solver.time
        moved[k] = mode @ solver.points.displacement[:, 0] / (mode @ mode)
        now = solver.energies()
        energy[k] = now.kinetic + now.strain
    period = mean_period(time, moved)
    half = round(0.5 / exact / solver.time_step / steps_per_sample)
    end = round(PERIODS / exact / solver.time_step / steps_per_sample)
    start = energy[:half].mean()
    return FreeVibration(
        1.0 / period,
        exact,
        float(energy[end : end + half].mean() / start),
        time,
        moved * 2.0 * np.pi * exact / (_AMPLITUDE * speed),
        energy / start,
    )


def draw_free_vibration(vibration: FreeVibration, path: Path) -> Path:
    """Draw the modal displacement beside the exact one, and the energy."""
    picture, (upper, lower) = new_picture(2, 1, height=5.2)
    periods = vibration.time * vibration.exact_frequency
    upper.plot(periods, np.sin(2.0 * np.pi * periods), color=GREY, linewidth=2.5, alpha=0.5, label="exact")
    upper.plot(periods, vibration.modal_displacement, color=BLUE, linewidth=1.0, label="material points")
    upper.set_ylabel("displacement of mode 1\nover exact amplitude")
    upper.set_title(f"Free vibration of a bar of {CELLS} cells, fixed and free end")
    upper.set_ylim(-1.2, 1.7)
    upper.legend(frameon=False, loc="upper left", ncols=2)
    lower.plot(periods, vibration.energy, color=BLUE, linewidth=1.0)
    lower.set_ylabel("energy over that at the start")
    lower.set_xlabel("time over exact period")
    return save_picture(picture, path)
