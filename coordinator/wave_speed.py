"""Speed of the fastest wave in the continuum, for the Courant number before anything is built."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from coordinator.scene import Scene
from protocol import continuum as c

_DIRECTIONS = 180
#: Courant number up to which the continuum makes one step an exchange; the default scheme is stable to 0.8.
LARGEST_COURANT = 0.78


def sub_steps(scene: Scene, material: c.Material) -> int:
    """Return how many steps the continuum makes in one exchange: the scene's number, or as few as are stable."""
    table = scene.handshake
    if table is None:
        return 1
    if table.continuum_steps is not None:
        return table.continuum_steps
    return max(1, math.ceil(_courant_of_exchange(scene, material) / LARGEST_COURANT))


def courant_number(scene: Scene, material: c.Material) -> float:
    """Return the Courant number of the continuum's step in its finest cells (Eq 31)."""
    return _courant_of_exchange(scene, material) / sub_steps(scene, material)


def _courant_of_exchange(scene: Scene, material: c.Material) -> float:
    return wave_speed(material, scene.continuum.assumption) * scene.time_step / scene.finest_cell


def wave_speed(material: c.Material, assumption: Literal["plane_stress", "plane_strain"]) -> float:
    """Return the speed of the fastest plane wave in the undeformed material, m/s.

    Parameters
    ----------
    material : Material
    assumption : {"plane_stress", "plane_strain"}

    Raises
    ------
    ValueError
        For a laminate, whose stiffness only its microstructure knows.

    Notes
    -----
    The largest eigenvalue of n.C.n over the directions n in the plane, over the density.
    """
    if isinstance(material, c.LaminateMaterial):
        raise ValueError("the stiffness of a laminate is known to its micromechanics service alone")
    if isinstance(material, c.OrthotropicMaterial):
        stiffness, shear = _orthotropic(material, assumption)
    else:
        young, poisson = material.young, material.poisson
        shear = young / (2 * (1 + poisson))
        lame = (
            young * poisson / ((1 - poisson**2) if assumption == "plane_stress" else (1 + poisson) * (1 - 2 * poisson))
        )
        stiffness = lame * np.ones((2, 2)) + 2 * shear * np.eye(2)
    angle = np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    x, y = np.cos(angle), np.sin(angle)
    across = (stiffness[0, 1] + shear) * x * y
    acoustic = np.array(
        [[stiffness[0, 0] * x**2 + shear * y**2, across], [across, stiffness[1, 1] * y**2 + shear * x**2]]
    )
    return float(np.sqrt(np.linalg.eigvalsh(acoustic.transpose(2, 0, 1)).max() / material.density))


def _orthotropic(material: c.OrthotropicMaterial, assumption: str) -> tuple[np.ndarray, float]:
    """Return stiffness of the normal strains along axes 1 and 2, and shear modulus, Pa."""
    m = material
    compliance = np.array(
        [
            [1 / m.young_1, -m.poisson_12 / m.young_1, -m.poisson_13 / m.young_1],
            [-m.poisson_12 / m.young_1, 1 / m.young_2, -m.poisson_23 / m.young_2],
            [-m.poisson_13 / m.young_1, -m.poisson_23 / m.young_2, 1 / m.young_3],
        ]
    )
    if assumption == "plane_stress":
        return np.linalg.inv(compliance[:2, :2]), m.shear_12
    return np.linalg.inv(compliance)[:2, :2], m.shear_12
