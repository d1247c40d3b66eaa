"""Conditions under which a material point solver may run away."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..conditions import symmetry
from ..elastic import IsotropicElastic
from ..grid import Grid
from ..hyperelastic import NeoHookean
from ..material_points import HXX, HYY, Body, fill_rectangle
from ..scheme import Scheme
from ..solver import MaterialPointSolver
from .plots import COLOURS, new_picture, save_picture

FloatArray = NDArray[np.float64]
Law = NeoHookean | IsotropicElastic

_COURANT = 0.5
FLIP = Scheme(transfer="flip")


@dataclass(frozen=True)
class Shaken:
    """A body that starts with random velocities at all its points and is left alone.

    Attributes
    ----------
    time : (k,) ndarray
        Cells that a pressure wave has run.
    energy : (k,) ndarray
        Kinetic plus strain energy over that at the start.
    """

    time: FloatArray
    energy: FloatArray

    @property
    def peak(self) -> float:
        """Largest energy over that at the start.

        Velocities lag half a step behind positions, so the energy of the fastest modes swings and the sum may
        pass one by some percent without any growth.
        """
        return float(np.max(self.energy)) if np.all(np.isfinite(self.energy)) else float("inf")

    @property
    def growth(self) -> float:
        """Mean energy of the last quarter of the run over that of the first: above one means a mode that grows."""
        quarter = self.energy.size // 4
        return float(self.energy[-quarter:].mean() / self.energy[:quarter].mean())


def shake(
    law: Law,
    body: Body | None = None,
    *,
    courant: float = _COURANT,
    scheme: Scheme = FLIP,
    drift: tuple[float, float] = (0.0, 0.0),
    travel: float = 800.0,
    strength: float = 1.0e-4,
) -> Shaken:
    """Give every point of a block a random velocity and watch the energy.

    FLIP is the default here: it has no dissipation that could hide a growing mode.

    Parameters
    ----------
    law : Law
    body : Body, optional
        In cells of side one; a block of 12 x 8 cells with a hole if not given.
    courant : float
        Courant number.
    scheme : Scheme
    drift : (float, float)
        Velocity of the whole body over the speed of the pressure wave.
    travel : float
        Duration in cells that the pressure wave runs.
    strength : float
        Standard deviation of the random velocities over the speed of the pressure wave.
    """
    body = body or fill_rectangle((0.0, 0.0), (12.0, 8.0), 1.0, hole=((4.0, 3.0), (7.0, 6.0)))
    speed = law.pressure_wave_speed
    noise = np.random.default_rng(1).normal(size=(body.count, 2)) * strength * speed
    noise -= noise.mean(axis=0)
    solver = MaterialPointSolver(
        Grid((-4.0, -4.0), 1.0, (24, 18)),
        body,
        law,
        1.0,
        courant / speed,
        initial_velocity=noise + np.array(drift) * speed,
        scheme=scheme,
    )
    mass = float(solver.points.mass.sum())
    drifting = 0.5 * mass * float(np.sum((np.array(drift) * speed) ** 2))
    start = solver.energies().kinetic - drifting
    samples, steps = 100, round(travel / courant)
    energy = np.zeros(samples)
    for k in range(samples):
        solver.advance(steps * (k + 1) // samples - solver.step)
        now = solver.energies()
        energy[k] = (now.kinetic + now.strain - drifting) / start
    return Shaken(travel * np.arange(1, samples + 1) / samples, energy)


def sliver_drift(travel: float = 800.0) -> tuple[float, float]:
    """Drift that carries the body by a millionth of a cell over a run, so that its edges lie just over cell lines."""
    return (1.0e-6 / travel, 0.7e-6 / travel)


@dataclass(frozen=True)
class AtRest:
    """A held body with a uniform stress, after many steps.

    Attributes
    ----------
    steps : int
    stress_change : float
        Largest change of a stress component over the stress.
    speed : float
        Largest velocity of a point over the speed of the pressure wave.
    moved : float
        Largest displacement of a point in cells.
    """

    steps: int
    stress_change: float
    speed: float
    moved: float


def rest(steps: int, strain: float, scheme: Scheme | None = None) -> AtRest:
    """Hold a small stressed body between four fixed faces for many steps.

    Parameters
    ----------
    steps : int
    strain : float
        Of both axes; zero for a body without stress, whose stress is then given over Young's modulus.
    scheme : Scheme, optional
        The default scheme if not given.
    """
    law = IsotropicElastic(1.0e9, 0.3, 1000.0, "plane_strain")
    body = fill_rectangle((0.0, 0.0), (2.0, 2.0), 1.0)
    solver = MaterialPointSolver(
        Grid((-3.0, -3.0), 1.0, (8, 8)),
        body,
        law,
        1.0,
        _COURANT / law.pressure_wave_speed,
        edge_conditions=(symmetry("left"), symmetry("right"), symmetry("bottom"), symmetry("top")),
        scheme=scheme or Scheme(),
    )
    state = solver.state()
    state["rows"][:, [HXX, HYY]] = strain
    law.update_stress(state["rows"], state["ids"], np.zeros((body.count, 0)))
    solver.restore(state)
    before = solver.points.stress
    solver.advance(steps)
    scale = float(np.abs(before).max()) or law.young
    return AtRest(
        solver.step,
        float(np.abs(solver.points.stress - before).max()) / scale,
        float(np.abs(solver.points.velocity).max()) / law.pressure_wave_speed,
        float(np.abs(solver.points.displacement).max()),
    )


def hard_runs() -> dict[str, Shaken]:
    """Shake the block under each hard condition; the label says which."""
    plain = IsotropicElastic(1.0e9, 0.3, 1000.0, "plane_strain")
    soft_in_shear = IsotropicElastic(1.0e9, 0.499, 1000.0, "plane_strain")
    large = NeoHookean(1.0e9, 0.499, 1000.0, "plane_strain")
    single = fill_rectangle((0.0, 0.0), (12.0, 8.0), 1.0, 1)
    return {
        "nu = 0.499": shake(soft_in_shear),
        "nu = 0.499, neo-Hookean": shake(large),
        "largest allowed time step": shake(plain, courant=FLIP.courant_limit),
        "the same, default scheme": shake(plain, courant=Scheme().courant_limit, scheme=Scheme()),
        "one point a cell": shake(plain, single),
        "edges just over cell lines": shake(plain, drift=sliver_drift()),
    }


def refusal_names_limit(courant: float = 0.9) -> bool:
    """Is a Courant number above the limit refused with a message that names both?"""
    law = IsotropicElastic(1.0e9, 0.3, 1000.0, "plane_strain")
    body = fill_rectangle((0.0, 0.0), (2.0, 2.0), 1.0)
    try:
        MaterialPointSolver(Grid((-3.0, -3.0), 1.0, (8, 8)), body, law, 1.0, courant / law.pressure_wave_speed)
    except ValueError as error:
        return f"{Scheme().courant_limit}" in str(error) and f"{courant:.4g}" in str(error)
    return False


def draw_shaken(runs: dict[str, Shaken], path: Path) -> Path:
    """Draw the energy of all runs."""
    picture, panel = new_picture()
    for (label, run), colour in zip(runs.items(), COLOURS, strict=False):
        panel.plot(run.time, run.energy, color=colour, linewidth=1.1, label=label)
    panel.set_title("Random velocities at all points: a mode that grows would pass any bound")
    panel.set_xlabel("cells run by the pressure wave")
    panel.set_ylabel("energy over that at the start")
    panel.set_ylim(0.0, 1.15)
    panel.legend(frameon=False, fontsize=8)
    return save_picture(picture, path)
