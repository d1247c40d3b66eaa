"""The other engines: the harmonic lattice against closed forms, OpenMM and ASE against LAMMPS on the same atoms."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from md_service.ase_dynamics import ASE
from md_service.atom_system import AtomSystem
from md_service.atoms import Atoms, Box
from md_service.crystals import fcc, hexagonal
from md_service.epoxy_monomers import joined, monomer
from md_service.epoxy_typing import typed
from md_service.errors import EngineError
from md_service.force_fields import force_field
from md_service.graphene import graphene
from md_service.lattice_dynamics import LATTICE, SPRINGS, LatticeForces
from md_service.openmm_dynamics import OPENMM
from md_service.velocity_verlet import Interactions, VelocityVerlet
from protocol.verification import CannotRun, Case, Check

_LAMMPS = "the same atoms in LAMMPS"


def lattice(folder: Path) -> list[Check]:
    """Elastic constants from energies, and the frequency of a wave from a run."""
    measured = LATTICE.properties(folder, "harmonic", "hexagonal", 0.0, 1, lambda done, total: None)
    springs = SPRINGS["harmonic"]
    source = "closed form of nearest-neighbour springs on the hexagonal lattice"
    sheet = hexagonal(springs.spacing, 16 * springs.spacing, 4 * springs.spacing, periodic=True)
    wave = 2.0 * np.pi / float(sheet.box.high[0] - sheet.box.low[0])
    phase = wave * springs.spacing
    squared = 2.0 * (1.0 - np.cos(phase)) + (1.0 - np.cos(0.5 * phase))
    expected = float(np.sqrt(springs.stiffness / sheet.mass[0] * squared))
    return [
        Check("Young's modulus", measured.young, springs.young(measured.thickness), 1e-6, source, "Pa"),
        Check("Poisson's ratio", measured.poisson, 1.0 / 3.0, 1e-6, source),
        Check("spacing", measured.lattice_constant, springs.spacing, 1e-9, source, "m"),
        Check("frequency of a longitudinal wave", _frequency(sheet, wave), expected, 1e-3, source, "rad/s"),
    ]


def _frequency(sheet: Atoms, wave: float) -> float:
    """Angular frequency of a standing wave along x, rad/s."""
    step = SPRINGS["harmonic"].time_step
    forces = LatticeForces(sheet, SPRINGS["harmonic"])
    dynamics = VelocityVerlet(sheet, forces, temperature=0.0, seed=1, time_step=step)
    shape = np.cos(wave * sheet.position[:, 0])
    state = dynamics.state()
    state["velocity"][:, 0] = 0.1 * shape
    dynamics.restore(state)
    amplitude = [0.0]
    for _ in range(4000):
        dynamics.run(1)
        amplitude.append(float(shape @ (dynamics.position() - sheet.position)[:, 0]))
    rising = np.array(amplitude)
    row = np.flatnonzero(rising[:-1] * rising[1:] < 0.0)
    moments = row + rising[row] / (rising[row] - rising[row + 1])
    return float(np.pi * (len(moments) - 1) / (step * (moments[-1] - moments[0])))


def openmm(folder: Path) -> list[Check]:
    """Forces and energy of Lennard-Jones argon and of OPLS-AA monomers."""
    argon = fcc("Ar", 3.72e-10, (5, 5, 5), (True, True, False))
    resin = _monomers()
    checks = []
    for name, atoms, way, tolerance in (("lennard-jones", argon, 0.1e-10, 5e-5), ("opls-aa", resin, 0.03e-10, 1e-5)):
        checks += _against_lammps(folder / name, name, atoms, way, OPENMM.forces, tolerance)
    return checks


def ase(folder: Path) -> list[Check]:
    """Forces and energy of graphene by Tersoff's potential in matscipy, and of Lennard-Jones argon."""
    sheet = graphene(14e-10, 14e-10, spacing=1.44e-10)
    argon = fcc("Ar", 3.72e-10, (3, 3, 3), (True, True, False))
    checks = _against_lammps(folder / "t", "tersoff", sheet, 0.05e-10, ASE.forces, 1e-6)
    shifted = _against_lammps(folder / "lj", "lennard-jones", argon, 0.1e-10, ASE.forces, 1e-6)
    return [*checks, shifted[0]]  # ASE shifts the pair energy to zero at the cut-off


def _against_lammps(
    folder: Path, name: str, atoms: Atoms, way: float, make: Callable[[str, Atoms], Interactions], tolerance: float
) -> list[Check]:
    """Largest difference of a force, over the largest force, and energy, of atoms moved from their places at random."""
    position = atoms.position + np.random.default_rng(5).normal(0.0, way, atoms.position.shape)
    try:
        interactions = make(name, atoms)
    except EngineError as error:
        raise CannotRun(str(error)) from error
    try:
        force, energy = interactions.forces(position)
    finally:
        interactions.close()
    reference, reference_energy = _in_lammps(folder, name, atoms, position)
    apart = float(np.abs(force - reference).max() / np.abs(reference).max())
    return [
        Check(f"{name}: difference of the forces over the largest", apart, 0.0, tolerance, _LAMMPS),
        Check(f"{name}: energy", energy, reference_energy, tolerance, _LAMMPS, "J"),
    ]


def _in_lammps(
    folder: Path, name: str, atoms: Atoms, position: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float]:
    system = AtomSystem(folder, force_field(name), atoms, force_field(name).time_step)
    try:
        system.build(position)
        system.run(0, True, 0)
        return system.gather(np.array(system.local("f"))) * system.units.force, system.potential_energy()
    finally:
        system.session.close()


def _monomers() -> Atoms:
    """One molecule of resin above one of hardener, in a periodic box."""
    resin, hardener = monomer("DGEBF"), monomer("DETDA")
    above = resin.position.mean(axis=0) + np.array([0.0, 0.0, 7e-10])
    both = joined([resin, hardener.at(hardener.position - hardener.position.mean(axis=0) + above)])
    middle = both.position.mean(axis=0)
    return typed(both, Box(middle - 14e-10, middle + 14e-10, (True, True, True)))


CASES: list[Case] = [
    Case("md", "lattice", "harmonic lattice: elastic constants and a wave against closed forms", lattice),
    Case("md", "openmm", "OpenMM: forces and energy of Lennard-Jones and OPLS-AA against LAMMPS", openmm),
    Case("md", "ase", "ASE: forces of matscipy's Tersoff and of Lennard-Jones against LAMMPS", ase),
]
