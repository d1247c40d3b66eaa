"""A simply supported beam under a harmonic force at mid-span (Sec 2.5, Fig 2.6).

Lengths are in beam heights and the modulus is such that the first Euler-Bernoulli frequency is pi per second, twice
the force's ``omega = pi/2``. The span is ten heights.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..conditions import EdgeCondition, symmetry
from ..damping import Damping
from ..elastic import IsotropicElastic
from ..grid import Grid
from ..loads import Traction
from ..material_points import fill_rectangle
from ..scheme import Scheme
from ..solver import MaterialPointSolver
from ..time_functions import Constant, Sine
from .beam_theory import Beam, bernoulli_deflection, elastic_deflection, timoshenko_deflection
from .plots import BLUE, GREEN, GREY, ORANGE, RED, new_picture, save_picture

FloatArray = NDArray[np.float64]

LENGTH, HEIGHT = 10.0, 1.0  # m
POISSON, DENSITY = 0.3, 1000.0
FUNDAMENTAL = np.pi  # 1/s
BEAM = Beam(
    LENGTH,
    HEIGHT,
    12.0 * DENSITY * FUNDAMENTAL**2 * (LENGTH / np.pi) ** 4 / HEIGHT**2,
    POISSON,
    DENSITY,
    force=1.0,
    angular_frequency=0.5 * np.pi,
    strip=0.5 * HEIGHT,
)
#: Two periods of the force [s].
DURATION = 8.0
CELLS_IN_HEIGHT = 12
COURANT = 0.6


@dataclass(frozen=True)
class Deflection:
    """Mid-span deflection of one run beside the exact one of the same problem.

    Attributes
    ----------
    time, value, exact : (k,) ndarray
        [s], [m], [m]; mean over the column of points next to mid-span.
    error : float
        Largest difference over the largest exact deflection.
    """

    time: FloatArray
    value: FloatArray
    exact: FloatArray

    @property
    def error(self) -> float:
        """Largest difference over the largest exact deflection."""
        return float(np.abs(self.value - self.exact).max() / np.abs(self.exact).max())


def scaled_beam(force_scaling: float) -> Beam:
    """Beam whose exact motion is that of `BEAM` under force scaling c (Eq 45).

    Scaling every force by 1 - c is the same as a density larger by 1/(1 - c): the beam is slower by the root.
    """
    return replace(BEAM, density=BEAM.density / (1.0 - force_scaling))


def make_beam(cells: int, scheme: Scheme, force_scaling: float = 0.0, courant: float = COURANT) -> MaterialPointSolver:
    """Build the left half of the beam.

    Its left end face does not deflect but is free to move along the beam, its right one lies in the plane of symmetry.

    Parameters
    ----------
    cells : int
        Cells through the height, a multiple of four, so that the half strip of the load ends on a cell line.
    scheme : Scheme
    force_scaling : float
        c of Eq 45.
    courant : float
        Courant number.
    """
    cell = HEIGHT / cells
    law = IsotropicElastic(BEAM.young, POISSON, DENSITY, "plane_stress")
    return MaterialPointSolver(
        Grid((-3.0 * cell, -3.0 * cell), cell, (round(0.5 * LENGTH / cell) + 6, cells + 6)),
        fill_rectangle((0.0, 0.0), (0.5 * LENGTH, HEIGHT), cell),
        law,
        thickness=1.0,
        time_step=courant * cell / law.pressure_wave_speed,
        edge_conditions=(EdgeCondition("left", 1, displacements=Constant(0.0)), symmetry("right")),
        loads=(
            Traction(
                "top",
                (0.0, BEAM.force / BEAM.strip),
                Sine(1.0, BEAM.angular_frequency),
                region=((0.5 * (LENGTH - BEAM.strip), HEIGHT), (0.5 * LENGTH, HEIGHT)),
            ),
        ),
        damping=Damping(force_scaling=force_scaling),
        scheme=scheme,
    )


def run_beam(
    scheme: Scheme | None = None,
    *,
    cells: int = CELLS_IN_HEIGHT,
    force_scaling: float = 0.0,
    courant: float = COURANT,
    samples: int = 400,
    duration: float = DURATION,
) -> Deflection:
    """Bend the beam over two periods of the force, without damping.

    Parameters
    ----------
    scheme : Scheme, optional
        FLIP if not given: filtered transfers (PIC, XPIC, FMPM) smear the rotation of cross-sections at the free
        faces in every step, which acts as damping.
    cells : int
        Cells through the height, a multiple of four, so that the half strip of the load ends on a cell line.
    force_scaling : float
        c of Eq 45; the exact deflection returned is that of the problem so changed.
    courant : float
        Courant number.
    samples : int
        Times at which the deflection is read.
    duration : float
        [s]
    """
    solver = make_beam(cells, scheme or Scheme(transfer="flip"), force_scaling, courant)
    place = solver.points.reference_position
    middle = place[:, 0] > 0.5 * LENGTH - 0.5 * HEIGHT / cells
    steps = round(duration / solver.time_step)
    time, value = np.zeros((2, samples))
    for k in range(samples):
        solver.advance(steps * (k + 1) // samples - solver.step)
        time[k] = solver.time
        value[k] = solver.points.displacement[middle, 1].mean()
    return Deflection(time, value, elastic_deflection(scaled_beam(force_scaling), place[middle], time))


def draw_beam(runs: dict[float, Deflection], path: Path) -> Path:
    """Draw the deflection for several force scalings c beside theory, and the error of the unscaled run."""
    picture, (upper, lower) = new_picture(2, 1, height=6.2)
    exact = runs[0.0]
    time = exact.time
    scale = BEAM.young * HEIGHT / BEAM.force  # deflections without dimension
    bernoulli, timoshenko = bernoulli_deflection(BEAM, time), timoshenko_deflection(BEAM, time)
    upper.plot(time, scale * bernoulli, color=GREY, linestyle="--", linewidth=1.0, label="Euler-Bernoulli (Eq 49)")
    upper.plot(time, scale * exact.exact, color=GREY, linewidth=4.0, alpha=0.45, label="exact, plane stress")
    for (c, run), colour in zip(runs.items(), (BLUE, ORANGE, RED), strict=False):
        label = "material points, c = 0 (no scaling)" if c == 0.0 else f"material points, c = {c:g}"
        upper.plot(run.time, scale * run.value, color=colour, linewidth=1.2, label=label)
    upper.set_title(r"Simply supported beam, $P_0 \sin(\omega t)$ at mid-span, $\omega = \pi/2 = \omega_1/2$")
    upper.set_ylabel(r"deflection $w E H / P_0$")
    low, high = upper.get_ylim()
    upper.set_ylim(low, high + 0.45 * (high - low))
    upper.legend(frameon=False, ncols=2, fontsize=8, loc="upper center")
    largest = np.abs(exact.exact).max()
    lower.plot(time, 100.0 * (exact.value - exact.exact) / largest, color=BLUE, linewidth=1.1, label="material points")
    lower.plot(
        time, 100.0 * (timoshenko - exact.exact) / largest, color=GREEN, linewidth=1.1, label="Timoshenko's theory"
    )
    lower.axhspan(-0.5, 0.5, color=BLUE, alpha=0.08, linewidth=0)
    lower.set_ylabel("off the exact solution\n(% of largest deflection)")
    lower.set_xlabel("time (s)")
    lower.legend(frameon=False, fontsize=8)
    return save_picture(picture, path)
