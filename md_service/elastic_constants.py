"""Isotropic constants of a material, which the continuum needs: spacing, E, nu, density.

Graphene at 0 K is pulled by 0.2 % with the lateral stress relaxed to zero. At a temperature the columns of the
stiffness are measured by `md_service.stiffness`.

The temperature matters far more than thermal expansion suggests. REBO-type potentials have a kink in their
angular stiffness exactly at 120 degrees; thermal motion smears it, so airebo's E rises and its Poisson ratio falls
considerably from 0 K to 300 K.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from md_service.atoms import Atoms
from md_service.elastic_tensor import SHEET, SOLID
from md_service.force_fields import ForceField
from md_service.force_fields import force_field as profile_of
from md_service.graphene import GRAPHENE_THICKNESS, graphene
from md_service.stiffness import Stiffness, static_stiffness, thermal_stiffness
from md_service.strained_sample import StrainedSample

_STATIC_CELLS: Final = (6, 4)
_STATIC_STRAIN: Final = 2e-3
_THERMAL_CELLS: Final = (12, 8)  # 384 atoms, about 29 A x 34 A


@dataclass(frozen=True)
class IsotropicProperties:
    """Properties of an isotropic material, or of a cell of one, at zero stress, for the continuum.

    Attributes
    ----------
    temperature : float
        K.
    lattice_constant : float
        Nearest-neighbour distance of a crystal (carbon-carbon in graphene), m; NaN for a sample that is none.
    young : float
        Young's modulus, Pa; of a sheet with the given thickness.
    poisson : float
        Poisson's ratio.
    density : float
        Mass over volume, of a sheet over area and thickness, kg/m^3.
    thickness : float
        Of a sheet, m; NaN for a solid.
    lattice_constant_error, young_error, poisson_error, density_error : float
        Standard errors in the same units; 0 at 0 K.
    """

    temperature: float
    lattice_constant: float
    young: float
    poisson: float
    density: float
    thickness: float
    lattice_constant_error: float = 0.0
    young_error: float = 0.0
    poisson_error: float = 0.0
    density_error: float = 0.0


def measure_graphene(
    force_field: ForceField | str,
    temperature: float,
    work_dir: Path,
    *,
    seed: int = 1,
    thickness: float = GRAPHENE_THICKNESS,
    progress: Callable[[int, int], None] | None = None,
) -> IsotropicProperties:
    """Measure lattice constant, Young's modulus, Poisson's ratio and density of graphene.

    Parameters
    ----------
    force_field : ForceField or str
        Profile or its name.
    temperature : float
        K; 0 for the static constants.
    work_dir : Path
        Folder of LAMMPS' files; made if missing.
    seed : int
        Of velocities and thermostat.
    thickness : float
        Of the sheet, m.
    progress : callable, optional
        Called with steps done and steps in all; may raise to stop. Not called at 0 K, which takes less than a
        second.

    Returns
    -------
    IsotropicProperties

    Raises
    ------
    ValueError
        For a negative temperature, a thickness that is not positive, or an unknown force field.
    EngineError
        If LAMMPS stops.
    """
    if not (np.isfinite(temperature) and temperature >= 0.0):
        raise ValueError(f"temperature is {temperature} K; it must be finite and not negative")
    if not (np.isfinite(thickness) and thickness > 0.0):
        raise ValueError(f"thickness is {thickness} m; it must be finite and positive")
    profile = profile_of(force_field) if isinstance(force_field, str) else force_field
    if temperature == 0.0:
        return _static_graphene(profile, thickness, Path(work_dir))
    sheet = _periodic_graphene(profile.lattice_constant, _THERMAL_CELLS, thickness)
    return isotropic_properties(
        thermal_stiffness(sheet, profile, temperature, Path(work_dir), seed=seed, isotropic=True, progress=progress)
    )


def measure_isotropic(
    atoms: Atoms,
    force_field: ForceField | str,
    temperature: float,
    work_dir: Path,
    *,
    seed: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> IsotropicProperties:
    """Measure the constants of the isotropic material nearest to a periodic sample (Hill's average).

    Parameters
    ----------
    atoms : Atoms
        A solid, periodic along x, y and z, or a sheet, periodic along x and y.
    force_field, temperature, work_dir, seed, progress
        As `measure_graphene`.

    Returns
    -------
    IsotropicProperties

    Raises
    ------
    ValueError
        As `md_service.stiffness.thermal_stiffness`.
    EngineError
        If LAMMPS stops.
    """
    if not (np.isfinite(temperature) and temperature >= 0.0):
        raise ValueError(f"temperature is {temperature} K; it must be finite and not negative")
    if temperature == 0.0:
        return isotropic_properties(static_stiffness(atoms, force_field, work_dir))
    return isotropic_properties(
        thermal_stiffness(atoms, force_field, temperature, work_dir, seed=seed, progress=progress)
    )


def isotropic_properties(stiffness: Stiffness) -> IsotropicProperties:
    """Isotropic constants of a measured stiffness.

    Raises
    ------
    ValueError
        If the sample is neither a solid nor a sheet.
    """
    if stiffness.components not in (SOLID, SHEET):
        raise ValueError("isotropic constants need a sample that is periodic along x and y, or along x, y and z")
    value, error = stiffness.isotropic()
    axes = 2 if stiffness.components == SHEET else 3
    atoms = stiffness.atoms
    # Of a cubic or hexagonal crystal every spacing grows with the mean of the axes.
    spacing = float("nan") if atoms.spacing is None else atoms.spacing
    stretch = 1.0 + float(stiffness.rest_strain[:axes].mean())
    relative = stiffness.density_error / stiffness.density / axes
    return IsotropicProperties(
        temperature=stiffness.temperature,
        lattice_constant=spacing * stretch,
        young=value.young,
        poisson=value.poisson,
        density=stiffness.density,
        thickness=float("nan") if atoms.thickness is None else atoms.thickness,
        lattice_constant_error=spacing * relative,
        young_error=error.young,
        poisson_error=error.poisson,
        density_error=stiffness.density_error,
    )


def _static_graphene(profile: ForceField, thickness: float, work_dir: Path) -> IsotropicProperties:
    """Tension along the zigzag direction, with the lateral strain that leaves no lateral stress."""
    flat = _periodic_graphene(profile.lattice_constant, _STATIC_CELLS, thickness)
    sample = StrainedSample(work_dir, profile, flat)
    try:
        bond, strain = profile.lattice_constant, 1e-4
        for _ in range(3):
            equal = np.array([strain, strain, 0.0])
            low, high = (sample.static_stress(sign * equal)[:2].mean() for sign in (-1, 1))
            growth = -0.5 * (low + high) * 2.0 * strain / (high - low)
            sample.adopt_strain(np.array([growth, growth, 0.0]))
            bond *= 1.0 + growth
        lateral, step = 0.0, _STATIC_STRAIN / 10.0
        for _ in range(4):
            here = sample.static_stress(np.array([_STATIC_STRAIN, lateral, 0.0]))[1]
            slope = (sample.static_stress(np.array([_STATIC_STRAIN, lateral - step, 0.0]))[1] - here) / -step
            lateral -= here / slope
        young = sample.static_stress(np.array([_STATIC_STRAIN, lateral, 0.0]))[0] / _STATIC_STRAIN
        density = sample.atoms.density
    finally:
        sample.close()
    return IsotropicProperties(
        temperature=0.0,
        lattice_constant=float(bond),
        young=float(young),
        poisson=float(-lateral / _STATIC_STRAIN),
        density=density,
        thickness=thickness,
    )


def _periodic_graphene(bond: float, cells: tuple[int, int], thickness: float) -> Atoms:
    """Flat graphene of rectangular cells of four atoms, periodic along x (zigzag) and y."""
    width, height = cells[0] * 3.0**0.5 * bond, cells[1] * 3.0 * bond
    return graphene(width, height, spacing=bond, periodic=True, layer_distance=thickness)
