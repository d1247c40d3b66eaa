"""Lattice spacing and elastic constants at 0 K from energies alone, for any engine that knows energy and forces.

A periodic crystal is scaled to its least energy and then strained; the second differences of the relaxed energy are
the stiffnesses. Nothing but energies and forces is asked of the code, so this is also a check on its stresses.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from md_service.atoms import Atoms, Box
from md_service.crystals import fcc, hexagonal
from md_service.elastic_tensor import SHEET, SOLID, VOIGT, isotropic_average
from md_service.fire import relax
from md_service.graphene import graphene
from md_service.velocity_verlet import Interactions

if TYPE_CHECKING:
    from md_service.elastic_constants import IsotropicProperties

_FCC: Final = {"copper": "Cu", "aluminium": "Al", "argon": "Ar"}
_STRAIN: Final = 5e-4
_SCALING_STEPS: Final = 6
_TOLERANCE: Final = 1e-16  # N, of all forces while the inner positions relax
_LARGEST_MOVE: Final = 0.05e-10  # m
_ITERATIONS: Final = 2000


def require_rest(temperature: float) -> None:
    """Refuse a temperature, K, other than 0, for engines that have no constants but those of `static_constants`.

    Raises
    ------
    ValueError
        If the temperature is not 0.
    """
    if temperature != 0.0:
        raise ValueError(
            f"temperature is {temperature} K; this engine measures constants at 0 K only; take md_service above"
        )


def crystal(material: str, spacing: float, reach: float = 0.0) -> Atoms:
    """A periodic crystal for `static_constants`.

    Parameters
    ----------
    material : str
        ``hexagonal``, ``graphene``, ``copper``, ``aluminium`` or ``argon``.
    spacing : float
        Nearest-neighbour distance, m.
    reach : float
        Range of the forces if the code sees only the nearest image of an atom: the cell is then larger than twice it.

    Raises
    ------
    ValueError
        For another material.
    """
    size = max(2.1 * reach, 2.5 * spacing)
    if material == "hexagonal":
        size = max(size, 4.0 * spacing)
        return hexagonal(spacing, size, size, periodic=True)
    if material == "graphene":
        size = max(size, 6.0 * spacing)
        return graphene(size, size, spacing=spacing, periodic=True)
    if material in _FCC:
        cells = int(np.ceil(size / (np.sqrt(2.0) * spacing)))
        return fcc(_FCC[material], spacing, (cells, cells, cells))
    raise ValueError(f"material is {material!r}; known are hexagonal, graphene, {', '.join(_FCC)}")


def static_constants(interactions: Callable[[Atoms], Interactions], crystal: Atoms) -> IsotropicProperties:
    """Spacing, Young's modulus, Poisson's ratio and density without stress at 0 K.

    Parameters
    ----------
    interactions : callable
        Makes the forces of a strained crystal.
    crystal : Atoms
        Periodic cell, within a few per cent of its true spacing. With a thickness it is a sheet in plane stress, which
        is periodic along x and y; without, it is periodic in all directions.

    Returns
    -------
    IsotropicProperties
        Those of the isotropic material nearest to the crystal (Hill's mean).

    Raises
    ------
    ValueError
        If the crystal is not periodic where it must be, or states no spacing.
    """
    from md_service.elastic_constants import IsotropicProperties

    sheet = crystal.thickness is not None
    if not all(crystal.box.periodic[: 2 if sheet else 3]):
        raise ValueError(f"crystal.box.periodic is {crystal.box.periodic}; constants need a periodic crystal")
    if crystal.spacing is None:
        raise ValueError("crystal.spacing is absent; it is needed")
    scale = _stressless_scale(interactions, crystal, 2 if sheet else 3)
    stressless = _deformed(crystal, _scaling(scale, 2 if sheet else 3))
    tensor = _stiffness(interactions, stressless, SHEET if sheet else SOLID)
    mean = isotropic_average(tensor)
    return IsotropicProperties(
        temperature=0.0,
        lattice_constant=crystal.spacing * scale,
        young=float(mean.young),
        poisson=float(mean.poisson),
        density=stressless.density,
        thickness=crystal.thickness if crystal.thickness is not None else 0.0,
    )


def _stressless_scale(interactions: Callable[[Atoms], Interactions], crystal: Atoms, axes: int) -> float:
    """Factor on all lengths at which the energy is least, by Newton's method on its differences."""
    scale, step = 1.0, 10.0 * _STRAIN
    for _ in range(_SCALING_STEPS):
        below, here, above = (
            _relaxed_energy(interactions, _deformed(crystal, _scaling(value, axes)))
            for value in (scale - step, scale, scale + step)
        )
        change = -0.5 * step * (above - below) / (above - 2.0 * here + below)
        scale += float(np.clip(change, -0.05, 0.05))
        step = _STRAIN
    return scale


def _stiffness(
    interactions: Callable[[Atoms], Interactions], crystal: Atoms, components: tuple[int, ...]
) -> NDArray[np.float64]:
    """Stiffness by second differences of the relaxed energy over the volume, Pa."""
    count = len(components)

    def energy(*strained: tuple[int, float]) -> float:
        gradient = np.eye(3)
        for component, strain in strained:
            # Upper triangular, so that the box keeps its first edge along x.
            row, column = VOIGT[components[component]]
            gradient[row, column] += strain
        return _relaxed_energy(interactions, _deformed(crystal, gradient))

    h = _STRAIN
    rest = energy()
    tensor = np.zeros((count, count))
    for i in range(count):
        tensor[i, i] = (energy((i, h)) - 2.0 * rest + energy((i, -h))) / h**2
        for j in range(i):
            mixed = (
                energy((i, h), (j, h)) - energy((i, h), (j, -h)) - energy((i, -h), (j, h)) + energy((i, -h), (j, -h))
            )
            tensor[i, j] = tensor[j, i] = mixed / (4.0 * h**2)
    return tensor / crystal.volume


def _scaling(factor: float, axes: int) -> NDArray[np.float64]:
    return np.diag([factor] * axes + [1.0] * (3 - axes))


def _deformed(crystal: Atoms, gradient: NDArray[np.float64]) -> Atoms:
    """The crystal under an upper triangular deformation gradient, about the lower corner of its box."""
    edges = crystal.box.edges @ gradient.T
    low = crystal.box.low
    box = Box(low, low + np.diag(edges), crystal.box.periodic, np.array([edges[1, 0], edges[2, 0], edges[2, 1]]))
    return crystal.at(low + (crystal.position - low) @ gradient.T, box)


def _relaxed_energy(interactions: Callable[[Atoms], Interactions], crystal: Atoms) -> float:
    """Energy with the inner positions relaxed, J."""
    made = interactions(crystal)
    try:
        found = relax(
            crystal.position, lambda position: made.forces(position)[0], _ITERATIONS, _TOLERANCE, _LARGEST_MOVE
        )
        return made.forces(found)[1]
    finally:
        made.close()
