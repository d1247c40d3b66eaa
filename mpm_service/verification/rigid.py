"""Rigid motion must not strain a body: along the grid, over a change of level, with a crack, turned, spinning."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..crack_line import Crack
from ..elastic import IsotropicElastic
from ..grid import Grid
from ..hierarchy import HierarchicalGrid
from ..hyperelastic import NeoHookean
from ..material_points import HXX, HXY, HYX, HYY, Body, fill_rectangle, fill_region
from ..scheme import Scheme
from ..solver import MaterialPointSolver

FloatArray = NDArray[np.float64]
Law = NeoHookean | IsotropicElastic

_YOUNG, _POISSON, _DENSITY = 1.0e9, 0.3, 1000.0
_COURANT = 0.5
NEO_HOOKEAN = NeoHookean(_YOUNG, _POISSON, _DENSITY, "plane_stress")
SMALL_STRAIN = IsotropicElastic(_YOUNG, _POISSON, _DENSITY, "plane_stress")


def _time_step(cell: float) -> float:
    return _COURANT * cell / NEO_HOOKEAN.pressure_wave_speed


def _largest_stress(solver: MaterialPointSolver) -> float:
    """Largest stress component over Young's modulus."""
    return float(np.abs(solver.points.stress[solver.points.alive]).max() / _YOUNG)


def _uniform(body: Body, velocity: FloatArray) -> FloatArray:
    return np.tile(velocity, (body.count, 1))


def translate(scheme: Scheme, steps: int = 160) -> tuple[float, float]:
    """Move a block by an eighth of a cell in x and a quarter in y a step, so that its points meet cell lines exactly.

    Returns
    -------
    float, float
        Largest stress over Young's modulus, and largest error of a displacement in cells.
    """
    body = fill_rectangle((0.0, 0.0), (6.0, 5.0), 1.0)
    dt = _time_step(1.0)
    velocity = np.array([0.125, 0.25]) / dt
    cells = (12 + round(0.125 * steps), 12 + round(0.25 * steps))
    solver = MaterialPointSolver(
        Grid((-3.0, -3.0), 1.0, cells),
        body,
        NEO_HOOKEAN,
        1.0,
        dt,
        initial_velocity=_uniform(body, velocity),
        scheme=scheme,
    )
    solver.advance(steps)
    off = solver.points.displacement - np.array([0.125, 0.25]) * steps
    return _largest_stress(solver), float(np.abs(off).max())


def translate_across_levels(scheme: Scheme) -> tuple[float, int]:
    """Move a block out of coarse cells, all the way through a finer level, into coarse cells again.

    Returns
    -------
    float, int
        Largest stress over Young's modulus, and the number of points that the splits have added.
    """
    body = fill_rectangle((0.0, 0.0), (4.0, 4.0), 1.0)
    dt = _time_step(0.5)
    grid = HierarchicalGrid(Grid((-4.0, -4.0), 1.0, (28, 14)), [((8.0, -2.0), (14.0, 8.0))])
    solver = MaterialPointSolver(
        grid,
        body,
        NEO_HOOKEAN,
        1.0,
        dt,
        initial_velocity=_uniform(body, np.array([0.1, 0.013]) / dt),
        scheme=scheme,
    )
    stress = 0.0
    for _ in range(16):
        solver.advance(10)
        stress = max(stress, _largest_stress(solver))
    return stress, solver.points.count - body.count


def translate_with_crack(scheme: Scheme) -> float:
    """Move a block with a slanted closed crack over several cells; largest stress over Young's modulus."""
    body = fill_rectangle((0.0, 0.0), (8.0, 8.0), 1.0)
    dt = _time_step(1.0)
    solver = MaterialPointSolver(
        Grid((-3.0, -3.0), 1.0, (26, 26)),
        body,
        NEO_HOOKEAN,
        1.0,
        dt,
        cracks=(Crack(((-1.0, 2.3), (4.6, 4.9))),),
        initial_velocity=_uniform(body, np.array([0.07, 0.05]) / dt),
        scheme=scheme,
    )
    solver.advance(150)
    return _largest_stress(solver)


def disk(radius_in_cells: float, margin: int = 4) -> tuple[Grid, Body]:
    """Disk around the origin in cells of side one, and its grid."""
    reach = int(np.ceil(radius_in_cells)) + margin
    grid = Grid((-float(reach), -float(reach)), 1.0, (2 * reach, 2 * reach))
    body = fill_region(
        (-float(reach - margin), -float(reach - margin)),
        (float(reach - margin), float(reach - margin)),
        1.0,
        lambda place: np.hypot(place[:, 0], place[:, 1]) < radius_in_cells,
    )
    return grid, body


def turned(angle: float, law: Law = NEO_HOOKEAN, steps: int = 50) -> float:
    """Start a disk turned by an angle, at rest, and let it be; largest stress over Young's modulus."""
    grid, body = disk(5.0)
    solver = MaterialPointSolver(grid, body, law, 1.0, _time_step(1.0))
    state = solver.state()
    cosine, sine = np.cos(angle), np.sin(angle)
    state["rows"][:, [HXX, HXY, HYX, HYY]] = (cosine - 1.0, -sine, sine, cosine - 1.0)
    law.update_stress(state["rows"], state["ids"], np.zeros((body.count, 0)))
    solver.restore(state)
    solver.advance(steps)
    return _largest_stress(solver)


def false_stress(angle: float) -> float:
    """Stress over Young's modulus that the small-strain law finds in a body turned by an angle.

    The false strain is ``cos(angle) - 1`` in both directions, in plane stress ``sigma = E/(1 - nu) strain``.
    """
    return (1.0 - float(np.cos(angle))) / (1.0 - _POISSON)


@dataclass(frozen=True)
class Spin:
    """A disk that spins freely once around.

    Attributes
    ----------
    virial : float
        Time mean of the volume integral of the trace of stress over twice that of the kinetic energy: one for
        any elastic body in any bounded motion.
    stress : float
        Largest stress over that of theory at the centre of a spinning disk, ``(3 + nu)/8 rho w^2 R^2``.
    """

    virial: float
    stress: float


def spin(
    law: Law = NEO_HOOKEAN,
    scheme: Scheme | None = None,
    radius: float = 8.0,
    rim: float = 0.05,
    courant: float = 0.3,
) -> Spin:
    """Spin a disk by one turn at a rim speed of a small share of the wave speed.

    Free rotation is not without stress: the centrifugal force strains the disk, and in plane stress the mean of the
    stress follows from the virial theorem. A law that is not objective fails it by orders of magnitude.

    Parameters
    ----------
    law : NeoHookean or IsotropicElastic
    scheme : Scheme, optional
        FLIP with the stress last (USL) if not given: it disturbs free rotation least.
    radius : float
        In cells.
    rim : float
        Speed of the rim over that of the pressure wave.
    courant : float
        Courant number.
    """
    grid, body = disk(radius)
    rate = rim * law.pressure_wave_speed / radius
    solver = MaterialPointSolver(
        grid,
        body,
        law,
        1.0,
        courant / law.pressure_wave_speed,
        initial_velocity_gradient=[[0.0, -rate], [rate, 0.0]],
        scheme=scheme or Scheme(integration="usl", transfer="flip"),
    )
    steps = round(2.0 * np.pi / rate / solver.time_step)
    samples = 200
    trace, kinetic, largest = 0.0, 0.0, 0.0
    for part in range(1, samples + 1):
        solver.advance(steps * part // samples - solver.step)
        stress = solver.points.stress
        trace += float(solver.points.volume @ (stress[:, 0] + stress[:, 1]))
        kinetic += solver.kinetic_energy
        largest = max(largest, float(np.abs(stress).max()))
    centre = (3.0 + _POISSON) / 8.0 * _DENSITY * (rate * radius) ** 2
    return Spin(trace / (2.0 * kinetic), largest / centre)
