"""OPLS-AA as an OpenMM system, term by term as LAMMPS computes the profile ``opls-aa``.

Lennard-Jones with geometric mixing, Coulomb forces damped and shifted to vanish at the cut-off (Fennell and Gezelter,
J. Chem. Phys. 124, 234104, 2006). Bonded neighbours up to the third keep that Coulomb term less the part
(1 - w) q q / r of the bare charges, with weights w of 0, 0 and 1/2, and w of the Lennard-Jones term.
"""

from __future__ import annotations

from math import erfc, exp, pi, sqrt
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from md_service import units
from md_service.atoms import Atoms, Topology
from md_service.errors import EngineError
from md_service.opls import STYLES, coefficients, opls_table

COULOMB: Final = 332.06371 * 4.184 / 10.0  # kJ nm/mol/e^2, LAMMPS' constant of "real" units
_KILOCALORIE: Final = 4.184  # kJ
_ANGSTROM: Final = 0.1  # nm
_KILOJOULE: Final = 1e3 / units.AVOGADRO  # J per kJ/mol
_THIRD_WEIGHT: Final = 0.5  # of third neighbours

#: erfc(x) = t P(t) exp(-x^2) with t = 1 / (1 + 0.3275911 x), to 1.5e-7 (Abramowitz and Stegun, 7.1.26), as in LAMMPS.
_ERFC: Final = "(0.254829592 + t*(-0.284496736 + t*(1.421413741 + t*(-1.453152027 + t*1.061405429))))"
_ERFC_SCALE: Final = 0.3275911


def add_opls(system: Any, atoms: Atoms) -> tuple[float, float]:
    """Add all forces to a system that has the particles.

    Parameters
    ----------
    system : openmm.System
    atoms : Atoms
        With OPLS-AA species, charges and topology.

    Returns
    -------
    cutoff : float
        m.
    constant : float
        Energy that depends on no position, J: of each charge with its own neutralising shell, and of dispersion
        beyond the cut-off where the box is periodic in all directions.

    Raises
    ------
    ValueError
        If a species or a term is not tabulated, or topology or charges are missing.
    """
    topology, table = atoms.topology, opls_table()
    if topology is None or atoms.charge is None:
        raise ValueError("force field opls-aa needs a sample with bonds and charges; this one has none")
    unknown = sorted(set(atoms.species) - set(table.species))
    if unknown:
        raise ValueError(f"species {', '.join(unknown)} are not in OPLS-AA as tabulated: {', '.join(table.species)}")
    kinds = [table.species[name] for name in atoms.species]
    sigma = np.array([kind.sigma for kind in kinds]) * _ANGSTROM
    epsilon = np.array([kind.epsilon for kind in kinds]) * _KILOCALORIE
    alpha, cutoff = _coulomb_damping()
    periodic = any(atoms.box.periodic)
    for force in _bonded_forces(topology):
        force.setUsesPeriodicBoundaryConditions(periodic)
        system.addForce(force)
    _add_pairs(system, atoms, topology, sigma, epsilon, alpha, cutoff)
    beyond, pull = _at_cutoff(alpha, cutoff)
    constant = -(0.5 * (beyond + pull * cutoff) + alpha / sqrt(pi)) * COULOMB * float(np.sum(atoms.charge**2))
    if all(atoms.box.periodic):
        constant += _dispersion_beyond(np.bincount(atoms.kind, minlength=len(kinds)), sigma, epsilon, cutoff) / (
            atoms.box.volume / 1e-27
        )
    return cutoff * 1e-9, constant * _KILOJOULE


def _coulomb_damping() -> tuple[float, float]:
    """Damping constant, 1/nm, and cut-off, nm, of the profile."""
    for line in STYLES:
        words = line.split()
        if words[:2] == ["pair_style", "lj/cut/coul/dsf"]:
            return float(words[2]) / _ANGSTROM, float(words[3]) * _ANGSTROM
    raise EngineError(f"OpenMM has no counterpart of the OPLS-AA styles {'; '.join(STYLES)}")


def _at_cutoff(alpha: float, cutoff: float) -> tuple[float, float]:
    """Damped potential of two unit charges at the cut-off, 1/nm, and its slope with the sign changed, 1/nm^2."""
    beyond = erfc(alpha * cutoff) / cutoff
    return beyond, beyond / cutoff + 2.0 * alpha / sqrt(pi) * exp(-((alpha * cutoff) ** 2)) / cutoff


def _bonded_forces(topology: Topology) -> list[Any]:
    import openmm

    table = opls_table()
    bonds, angles = openmm.HarmonicBondForce(), openmm.HarmonicAngleForce()
    torsions = openmm.PeriodicTorsionForce()
    for kind, i, j in topology.bonds.tolist():
        strength, length = coefficients(table.bonds, topology.bond_names[kind].split("-"))
        bonds.addBond(i, j, length * _ANGSTROM, 2.0 * strength * _KILOCALORIE / _ANGSTROM**2)
    for kind, i, j, k in topology.angles.tolist():
        strength, degrees = coefficients(table.angles, topology.angle_names[kind].split("-"))
        angles.addAngle(i, j, k, degrees * pi / 180.0, 2.0 * strength * _KILOCALORIE)
    for kind, i, j, k, m in topology.dihedrals.tolist():
        series = coefficients(table.dihedrals, topology.dihedral_names[kind].split("-"))
        for fold, strength in enumerate(series, start=1):
            if strength:
                # V/2 (1 + cos n phi) for odd n, V/2 (1 - cos n phi) for even n
                torsions.addTorsion(i, j, k, m, fold, 0.0 if fold % 2 else pi, 0.5 * strength * _KILOCALORIE)
    for kind, i, j, k, m in topology.impropers.tolist():
        (strength,) = coefficients(table.impropers, topology.improper_names[kind].split("-"), reversible=False)
        torsions.addTorsion(i, j, k, m, 2, pi, strength * _KILOCALORIE)
    return [bonds, angles, torsions]


def _add_pairs(
    system: Any,
    atoms: Atoms,
    topology: Topology,
    sigma: NDArray[np.float64],
    epsilon: NDArray[np.float64],
    alpha: float,
    cutoff: float,
) -> None:
    import openmm

    assert atoms.charge is not None
    # Numbers, not parameters, so that OpenMM evaluates them once and not for each pair. Its own erfc is eight times
    # slower than this polynomial.
    beyond, pull = _at_cutoff(alpha, cutoff)
    damped = f"charge*(t*{_ERFC}*exp(-({alpha!r}*r)^2)/r - {beyond!r} + {pull!r}*(r - {cutoff!r}))"
    steps = f"t=1/(1 + {_ERFC_SCALE * alpha!r}*r)"
    dispersion = "4*epsilon*(s6^2 - s6)"
    pairs = openmm.CustomNonbondedForce(
        f"{dispersion} + {damped}; s6=(sigma1*sigma2)^3/r^6; epsilon=sqrt(epsilon1*epsilon2); "
        f"charge={COULOMB!r}*charge1*charge2; {steps}"
    )
    neighbours = openmm.CustomBondForce(
        f"weight*{dispersion} + step({cutoff!r} - r)*({damped} - (1 - weight)*charge/r); s6=(sigma/r)^6; {steps}"
    )
    for name in ("sigma", "epsilon", "charge"):
        pairs.addPerParticleParameter(name)
        neighbours.addPerBondParameter(name)
    neighbours.addPerBondParameter("weight")
    for kind, charge in zip(atoms.kind.tolist(), atoms.charge.tolist(), strict=True):
        pairs.addParticle([sigma[kind], epsilon[kind], charge])
    for (i, j), weight in _near_neighbours(topology, len(atoms)).items():
        a, b = atoms.kind[i], atoms.kind[j]
        charge = COULOMB * float(atoms.charge[i] * atoms.charge[j])
        neighbours.addBond(i, j, [sqrt(sigma[a] * sigma[b]), sqrt(epsilon[a] * epsilon[b]), charge, weight])
        pairs.addExclusion(i, j)
    periodic = any(atoms.box.periodic)
    pairs.setNonbondedMethod(pairs.CutoffPeriodic if periodic else pairs.CutoffNonPeriodic)
    pairs.setCutoffDistance(cutoff)
    neighbours.setUsesPeriodicBoundaryConditions(periodic)
    system.addForce(pairs)
    system.addForce(neighbours)


def _near_neighbours(topology: Topology, n_atoms: int) -> dict[tuple[int, int], float]:
    """Weight of each pair of first, second and third neighbours along bonds; the nearest relation counts."""
    bonded: list[list[int]] = [[] for _ in range(n_atoms)]
    for _, i, j in topology.bonds.tolist():
        bonded[i].append(j)
        bonded[j].append(i)
    weight: dict[tuple[int, int], float] = {}
    for start in range(n_atoms):
        distance = {start: 0}
        shell = [start]
        for away in (1, 2, 3):
            shell = [k for k in dict.fromkeys(k for j in shell for k in bonded[j]) if k not in distance]
            distance |= dict.fromkeys(shell, away)
        for other, away in distance.items():
            if other > start:
                weight[start, other] = _THIRD_WEIGHT if away == 3 else 0.0
    return weight


def _dispersion_beyond(
    count: NDArray[np.int64], sigma: NDArray[np.float64], epsilon: NDArray[np.float64], cutoff: float
) -> float:
    """Lennard-Jones energy beyond the cut-off of a uniform fluid times the volume, kJ nm^3/mol."""
    s6 = np.sqrt(np.outer(sigma, sigma)) ** 6
    depth = np.sqrt(np.outer(epsilon, epsilon))
    each = 8.0 * pi * depth * s6 * (s6 - 3.0 * cutoff**6) / (9.0 * cutoff**9)
    return float(count @ each @ count)
