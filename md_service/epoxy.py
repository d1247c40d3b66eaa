"""Builder of the cross-linked epoxy EPON 862 (DGEBF) / DETDA.

Molecules are packed like a gas, compressed, cross-linked by distance, and annealed with OPLS-AA. A unit is two DGEBF
and one DETDA, 117 atoms, in which every amine hydrogen has its epoxide group.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from md_service.atoms import Atoms
from md_service.data_file import read_data_file
from md_service.epoxy_curing import conversion_of, cure
from md_service.epoxy_monomers import ELEMENT_MASS, Molecule, monomer
from md_service.epoxy_packing import pack
from md_service.epoxy_relaxation import HOT, Schedule, compress, relax
from md_service.epoxy_rings import speared_rings
from md_service.epoxy_typing import elements_of
from md_service.errors import EngineError

#: Molecules of a unit.
UNIT: Final = (monomer("DGEBF"), monomer("DGEBF"), monomer("DETDA"))
UNIT_ATOMS: Final = sum(len(molecule) for molecule in UNIT)  # 117
UNIT_MASS: Final = sum(molecule.mass for molecule in UNIT)  # kg
SHIPPED_UNITS: Final = 153
SHIPPED: Final = Path(__file__).parent / "data" / "epoxy_153.data.gz"
MELT_DENSITY: Final = 1200.0  # kg/m^3, at which it is cured


def build_epoxy(
    units: int,
    conversion: float = 0.76,
    temperature: float = 300.0,
    seed: int = 1,
    work_dir: Path | None = None,
    platelet: Molecule | None = None,
    schedule: Schedule | None = None,
    progress: Callable[[str], None] | None = None,
    aspect: float = 1.0,
) -> Atoms:
    """Build a cross-linked epoxy, at rest at a temperature and at atmospheric pressure.

    Parameters
    ----------
    units : int
        Number of units of 117 atoms.
    conversion : float
        Share of epoxide groups that have reacted, met to the nearest group.
    temperature : float
        Of the relaxed sample, K.
    seed : int
        Of all random choices; one rank with the same seed gives the same sample.
    work_dir : Path, optional
        Folder of the LAMMPS files; a temporary one if not given.
    platelet : Molecule, optional
        A filler, bonded in itself, around which the resin is built. Planar carbon and hydrogen.
    schedule : Schedule, optional
        Times of the relaxation.
    progress : callable, optional
        Given a line of text after each part.
    aspect : float
        Width of the box along x and y over its depth along z: above 1 a slab, thin along z.

    Returns
    -------
    Atoms
        Typed for OPLS-AA, in a periodic box, a cube without `aspect`. Notes hold seed, units, conversion, density
        (kg/m^3).

    Raises
    ------
    ValueError
        If units or aspect is not positive, or the conversion is not between 0 and 1.
    EngineError
        If LAMMPS stops, or the sample fails a check.
    """
    if units < 1:
        raise ValueError(f"units is {units}; at least one is needed")
    if not 0.0 <= conversion <= 1.0:
        raise ValueError(f"conversion is {conversion}; it must lie between 0 and 1")
    if not aspect > 0.0:
        raise ValueError(f"aspect is {aspect}; it must be positive")
    if work_dir is None:
        with tempfile.TemporaryDirectory() as folder:
            return build_epoxy(units, conversion, temperature, seed, Path(folder), platelet, schedule, progress, aspect)
    tell = progress or (lambda line: None)
    atoms = pack(UNIT * units, seed, platelet)
    tell(f"packed {len(atoms)} atoms at {atoms.density:.0f} kg/m3")
    atoms = compress(atoms, MELT_DENSITY, HOT, seed, work_dir, aspect=aspect)
    tell(f"compressed to {atoms.density:.0f} kg/m3")
    atoms = cure(atoms, conversion, seed, work_dir, progress)
    atoms, density = relax(atoms, temperature, seed, work_dir, schedule)
    tell(f"relaxed to {atoms.density:.0f} kg/m3 at {temperature:g} K")
    speared = speared_rings(atoms)
    if speared:
        raise EngineError(f"bond {speared[0][0]} passes through the ring of atoms {speared[0][1]}; try another seed")
    half = density[len(density) // 2 :]
    return replace(
        atoms,
        notes={
            "material": "EPON 862 / DETDA",
            "units": units,
            "seed": seed,
            "conversion": conversion_of(atoms),
            "temperature": temperature,
            "density": atoms.density,
            "density_scatter": float(half.std()),
        },
    )


def shipped_epoxy() -> Atoms:
    """The sample of 153 units (17901 atoms) that comes with the package; its notes name the command that made it."""
    return read_data_file(SHIPPED)[0]


def without_topology(atoms: Atoms) -> Atoms:
    """The same atoms with elements as species, no bonds and no charges, for reactive force fields.

    Returns
    -------
    Atoms
        Species in the order C, H, N, O as far as they occur.
    """
    elements = elements_of(atoms)
    species = tuple(sorted(set(elements)))
    number = {element: index for index, element in enumerate(species)}
    return replace(
        atoms,
        kind=np.array([number[element] for element in elements], dtype=np.int64),
        species=species,
        elements=species,
        mass=np.array([ELEMENT_MASS[element] for element in species]),
        charge=None,
        topology=None,
    )
