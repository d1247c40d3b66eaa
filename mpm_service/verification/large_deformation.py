"""Large motion: a spinning disk that crosses many cells, and a bar pulled to twice its length."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..conditions import EdgeCondition, symmetry
from ..grid import Grid
from ..hyperelastic import NeoHookean
from ..material_points import fill_rectangle
from ..scheme import Scheme
from ..solver import MaterialPointSolver
from ..time_functions import Ramp
from .plots import BLUE, GREEN, GREY, ORANGE, RED, new_picture, save_picture
from .rigid import disk

FloatArray = NDArray[np.float64]

DISK = NeoHookean(1.0e7, 0.3, 1000.0, "plane_strain")
RADIUS = 12.0  # cells
_COURANT = 0.4

BAR = NeoHookean(1.0e6, 0.3, 1000.0, "plane_strain")
#: Cells along and across the quarter of the bar that is modelled, and its stretch.
LONG, ACROSS, STRETCH = 16, 4, 2.0


@dataclass(frozen=True)
class SpinningDisk:
    """A free disk that spins and drifts.

    Attributes
    ----------
    crossings : int
        Cell lines that a point at the rim has crossed.
    momentum_error : float
        Largest change of the momentum over mass times rim speed.
    turns, angular_momentum, energy : (k,) ndarray
        Turns, and the two over their values at the start. Energy is kinetic plus strain.
    """

    crossings: int
    momentum_error: float
    turns: FloatArray
    angular_momentum: FloatArray
    energy: FloatArray


def run_disk(scheme: Scheme, crossings: int = 1000, rim: float = 0.1, radius: float = RADIUS) -> SpinningDisk:
    """Spin a disk, drifting slowly, until a rim point has crossed so many cell lines.

    Parameters
    ----------
    scheme : Scheme
    crossings : int
        Cell lines.
    rim : float
        Speed of the rim over the speed of the pressure wave.
    radius : float
        In cells.
    """
    grid, body = disk(radius, margin=6)
    speed = rim * DISK.pressure_wave_speed
    rate = speed / radius
    place = body.position
    # The drift carries the disk by some two cells in all, so that it meets the grid in ever new ways.
    duration = 1.2 * 2.0 * np.pi / rate * crossings / (8.0 * radius)
    drift = 2.0 / duration
    velocity = np.stack([-rate * place[:, 1] + drift, rate * place[:, 0] + 0.6 * drift], axis=1)
    solver = MaterialPointSolver(
        grid,
        body,
        DISK,
        1.0,
        min(_COURANT, scheme.courant_limit) / DISK.pressure_wave_speed,
        initial_velocity=velocity,
        scheme=scheme,
    )
    mass = solver.points.mass
    rim_point = int(np.argmax(np.hypot(place[:, 0], place[:, 1])))

    def figures() -> tuple[FloatArray, float, float]:
        x, v = solver.points.position, solver.points.velocity
        energy = solver.energies()
        spin = float(mass @ (x[:, 0] * v[:, 1] - x[:, 1] * v[:, 0]))
        return mass @ v, spin, energy.kinetic + energy.strain

    start = figures()
    chunk = int(0.2 / (rim * solver.time_step * DISK.pressure_wave_speed))  # a rim point moves by a fifth of a cell
    turns, spin, energy = [], [], []
    momentum_error, crossed, angle, chunks = 0.0, 0, 0.0, 0
    before = solver.points.position[rim_point]
    while crossed < crossings and solver.time < 3.0 * duration:
        solver.advance(chunk)
        now = solver.points.position[rim_point]
        crossed += int(np.abs(np.floor(now) - np.floor(before)).sum())
        angle += float(np.angle(complex(*now) / complex(*before)))
        before = now
        chunks += 1
        if chunks % 20 and crossed < crossings:
            continue
        momentum, angular, total = figures()
        momentum_error = max(momentum_error, float(np.abs(momentum - start[0]).max()))
        turns.append(angle / (2.0 * np.pi))
        spin.append(angular / start[1])
        energy.append(total / start[2])
    return SpinningDisk(
        crossed, momentum_error / (float(mass.sum()) * speed), np.array(turns), np.array(spin), np.array(energy)
    )


def uniaxial_stress(law: NeoHookean, stretch: float) -> tuple[float, float]:
    """Axial Cauchy stress [Pa] and lateral stretch of a bar in plane strain with free sides, in closed form.

    From ``tau = mu (b - I) + lambda/2 (J^2 - 1) I`` with no lateral stress:
    ``mu (s^2 - 1) + lambda/2 (stretch^2 s^2 - 1) = 0`` for the lateral stretch s.
    """
    lame, shear = law.lame, law.shear_modulus
    squared = (shear + 0.5 * lame) / (shear + 0.5 * lame * stretch**2)
    lateral = float(np.sqrt(squared))
    pressure = 0.5 * lame * (stretch**2 * squared - 1.0)
    return (shear * (stretch**2 - 1.0) + pressure) / (stretch * lateral), lateral


@dataclass(frozen=True)
class TensileBar:
    """A quarter of a bar, pulled slowly to its final stretch.

    Attributes
    ----------
    stress_error : float
        Largest error of the axial stress of a point over the closed form, at the end.
    spread : float
        Largest distance of two neighbours along the bar over what a uniform stretch gives: 1 is even, a gap of
        numerical fracture is far larger.
    position : (n, 2) ndarray
        Points at the end [m].
    stretch, stress : (k,) ndarray
        Stretch, and mean axial stress of the points [Pa].
    """

    stress_error: float
    spread: float
    position: FloatArray
    stretch: FloatArray
    stress: FloatArray


def run_tensile_bar(
    scheme: Scheme, stretch: float = STRETCH, rate: float = 0.01, points_per_cell: int = 3
) -> TensileBar:
    """Pull a bar slowly, with damping, then let it rest.

    Points under large tension are unstable on a grid (a uniform state already is, far from any edge): with mapped
    momenta (MUSL) from a stretch of 1.2 to 1.7 on, whatever the shape function and transfer. Stress from the new
    nodal velocities (USL), domains that follow F and three points a cell and direction stay even.

    Parameters
    ----------
    scheme : Scheme
    stretch : float
        Final length over the first one.
    rate : float
        Largest speed of the pulled end over the speed of the pressure wave, divided by pi/2.
    points_per_cell : int
        Points per cell and direction.
    """
    body = fill_rectangle((0.0, 0.0), (float(LONG), float(ACROSS)), 1.0, points_per_cell)
    grid = Grid((-4.0, -4.0), 1.0, (int(np.ceil(LONG * stretch)) + 10, ACROSS + 8))
    travel = (stretch - 1.0) * LONG
    duration = travel / (rate * BAR.pressure_wave_speed)
    pulled = EdgeCondition("right", 0, displacements=Ramp(duration, travel, smooth=True))
    solver = MaterialPointSolver(
        grid,
        body,
        BAR,
        1.0,
        min(_COURANT / stretch, scheme.courant_limit) / BAR.pressure_wave_speed,  # waves run faster once stretched
        edge_conditions=(
            symmetry("left"),
            symmetry("bottom"),
            pulled,
        ),
        damping=0.3 * BAR.pressure_wave_speed / LONG,
        scheme=scheme,
    )
    steps = round(1.3 * duration / solver.time_step)
    stretches, stresses = [], []
    for part in range(1, 31):
        solver.advance(steps * part // 30 - solver.step)
        x = solver.points.position
        stretches.append(float(pulled.displacement(np.array([solver.time]))[0]) / LONG + 1.0)
        stresses.append(float(solver.points.stress[:, 0].mean()))
    exact, _ = uniaxial_stress(BAR, stretch)
    first = body.position
    order = np.lexsort((first[:, 0], first[:, 1]))
    rows = x[order, 0].reshape(points_per_cell * ACROSS, points_per_cell * LONG)
    spread = float(np.diff(rows, axis=1).max() / (stretch / points_per_cell))
    error = float(np.abs(solver.points.stress[:, 0] / exact - 1.0).max())
    return TensileBar(error, spread, x, np.array(stretches), np.array(stresses))


def draw_disk(disks: dict[str, SpinningDisk], path: Path) -> Path:
    """Draw angular momentum and energy over the turns."""
    picture, (upper, lower) = new_picture(2, 1, height=5.2)
    for (label, run), colour in zip(disks.items(), (BLUE, ORANGE, RED), strict=False):
        upper.plot(run.turns, 100.0 * (run.angular_momentum - 1.0), color=colour, linewidth=1.2, label=label)
        lower.plot(run.turns, 100.0 * (run.energy - 1.0), color=colour, linewidth=1.0, label=label)
    crossings = next(iter(disks.values())).crossings
    upper.set_title(f"Spinning neo-Hookean disk, {crossings:.0f} cell lines crossed at the rim")
    upper.set_ylabel("angular momentum:\nchange (%)")
    lower.set_ylabel("energy: change (%)")
    lower.set_xlabel("turns")
    upper.legend(frameon=False)
    return save_picture(picture, path)


def draw_bars(bars: dict[str, TensileBar], path: Path) -> Path:
    """Draw the stress over the stretch, and the points at the end."""
    picture, panels = new_picture(len(bars) + 1, 1, height=3.2 + 1.0 * len(bars))
    stretch = np.linspace(1.0, STRETCH, 101)
    exact = np.array([uniaxial_stress(BAR, float(s))[0] for s in stretch])
    panels[0].plot(stretch, 1e-6 * exact, color=GREY, linewidth=3.0, alpha=0.5, label="closed form")
    for (label, bar), colour, panel in zip(bars.items(), (BLUE, ORANGE, GREEN), panels[1:], strict=False):
        panels[0].plot(bar.stretch, 1e-6 * bar.stress, color=colour, marker=".", linewidth=0.8, label=label)
        panel.plot(bar.position[:, 0], bar.position[:, 1], ".", color=colour, markersize=2.5)
        panel.set_aspect("equal")
        panel.set_ylabel("y (cells)")
        panel.set_yticks([0, 2])
        panel.set_title(f"{label}: points at stretch {STRETCH:g}", loc="left", fontsize=9)
        panel.set_xticks(np.arange(0, LONG * STRETCH + 1, 4))
    panels[0].set_title("Neo-Hookean bar in plane strain, pulled to twice its length")
    panels[0].set_xlabel("stretch")
    panels[0].set_ylabel("axial stress (MPa)")
    panels[0].legend(frameon=False)
    panels[-1].set_xlabel("x (cells)")
    return save_picture(picture, path)
