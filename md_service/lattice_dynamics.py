"""Harmonic lattice: nearest neighbours tied by equal springs, for teaching and fast tests.

The bonds are those of the sample's reference positions. A hexagonal lattice of springs k at distance a, of thickness
t, is isotropic in its plane with E = 2 k / (sqrt(3) t), nu = 1/3 and one atom to the area sqrt(3)/2 a^2 (Hrennikoff's
lattice). A planar sheet moves in its plane only, because springs at rest give it no stiffness across. An fcc crystal
of such springs has C11 = sqrt(2) k / a and C12 = C44 = C11 / 2. A chain, one row of atoms along x, is a bar with
E = k a / A of the cross-section A = a^2 / sqrt(2), for one-dimensional theory; it moves along x only.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from md_service.atoms import Atoms
from md_service.cuts import Cut, severed
from md_service.dynamics import Dynamics
from md_service.force_fields import ForceField
from md_service.neighbour_pairs import VIRIAL_AXES, neighbour_pairs
from md_service.sample_source import CHAIN
from md_service.velocity_verlet import VelocityVerlet

if TYPE_CHECKING:
    from md_service.elastic_constants import IsotropicProperties
    from md_service.engines import Progress

MATERIAL: Final = "hexagonal"
MATERIALS: Final = (MATERIAL, CHAIN)
_NEIGHBOUR_RANGE = 1.2  # bonds of an undeformed lattice are shorter than this many spacings
_FLAT = 1e-3  # spacings; a sample no higher than this moves in its plane


@dataclass(frozen=True)
class Springs:
    """Springs of a lattice.

    Attributes
    ----------
    name, summary : str
    stiffness : float
        Spring constant k, N/m.
    spacing : float
        Length without force a, m.
    break_stretch : float
        Stretch at which a spring lets go, keeping its energy as a loss; infinite for springs that never do. A spring
        that comes back below it holds again.
    time_step : float
        Recommended for atoms of argon's mass, s.
    """

    name: str
    summary: str
    stiffness: float
    spacing: float
    break_stretch: float = float("inf")
    time_step: float = 1e-15

    def young(self, thickness: float) -> float:
        """Young's modulus of a hexagonal sheet of a thickness in m, and of a row of it, Pa."""
        return float(2.0 * self.stiffness / (np.sqrt(3.0) * thickness))


# A sheet of argon's mass then has about the density, stiffness and wave speed of graphene.
SPRINGS: Final[dict[str, Springs]] = {
    springs.name: springs
    for springs in (
        Springs("harmonic", "hexagonal lattice of springs that never break", 250.0, 3.45e-10),
        Springs("harmonic-brittle", "hexagonal lattice of springs that break at 15 % stretch", 250.0, 3.45e-10, 0.15),
    )
}


class LatticeForces:
    """Forces of the springs; implements `md_service.velocity_verlet.Interactions`.

    Parameters
    ----------
    atoms : Atoms
        Reference, whose neighbours within 1.2 spacings are tied.
    springs : Springs
        Their constants.

    Raises
    ------
    ValueError
        If the lattice is not that of the springs: no neighbours, or at a distance more than 10 % off.
    """

    def __init__(self, atoms: Atoms, springs: Springs) -> None:
        flat = np.ptp(atoms.position, axis=0) <= _FLAT * springs.spacing
        self.dimension = 3 if not flat[2] else 1 if flat[1] else 2
        self._springs = springs
        self._atoms = atoms
        self._whole = neighbour_pairs(atoms, _NEIGHBOUR_RANGE * springs.spacing)
        self.first, self.second, self._shift = self._whole
        if len(self.first) == 0:
            raise ValueError(
                f"position holds no atoms nearer than {_NEIGHBOUR_RANGE * springs.spacing:.3g} m, so there is no bond; "
                f"force field {springs.name} is for a lattice of spacing {springs.spacing:.4g} m"
            )
        way = atoms.position[self.second] + self._shift - atoms.position[self.first]
        length = float(np.median(np.linalg.norm(way, axis=1)))
        if abs(length / springs.spacing - 1.0) > 0.1:
            raise ValueError(
                f"position has neighbours {length:.4g} m apart; force field {springs.name} is for a lattice of "
                f"spacing {springs.spacing:.4g} m, within 10 %"
            )
        # A bound as a square root of the largest double, so that its square is still a number.
        self._reach = min(springs.spacing * (1.0 + springs.break_stretch), 1e150)

    def sever(self, cuts: tuple[Cut, ...]) -> None:
        """Take away the springs across these lines, and no others."""
        pairs = np.column_stack(self._whole[:2])
        held = np.ones(len(pairs), dtype=bool)
        for cut in cuts:
            held &= ~severed(cut, self._atoms, pairs)
        first, second, shift = self._whole
        self.first, self.second, self._shift = first[held], second[held], shift[held]

    def forces(self, position: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
        """Forces, N, shape (n, 3), and the energy, J."""
        force = np.zeros_like(position)
        energy = _spring_forces(
            position, self.first, self.second, self._shift, self._springs.stiffness, self._springs.spacing, self._reach,
            force,
        )  # fmt: skip
        return force, energy

    def virial_and_energy(self, position: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Virial, J, shape (n, 6), and energy, J, shape (n,), half of each spring's to either atom."""
        virial, energy = np.zeros((len(position), 6)), np.zeros(len(position))
        _spring_virials(
            position, self.first, self.second, self._shift, self._springs.stiffness, self._springs.spacing, self._reach,
            virial, energy,
        )  # fmt: skip
        return virial, energy

    def reset(self) -> None:
        """Nothing to forget: forces depend on the positions alone."""

    def close(self) -> None:
        """Nothing to free."""


@njit(nogil=True, cache=True)
def _spring_forces(position, first, second, shift, stiffness, spacing, reach, force):  # type: ignore[no-untyped-def]  # numba
    """Add the springs' forces; returns their energy."""
    energy = 0.0
    lost = 0.5 * stiffness * (reach - spacing) ** 2
    for bond in range(len(first)):
        i, j = first[bond], second[bond]
        dx = position[j, 0] - position[i, 0] + shift[bond, 0]
        dy = position[j, 1] - position[i, 1] + shift[bond, 1]
        dz = position[j, 2] - position[i, 2] + shift[bond, 2]
        length = np.sqrt(dx * dx + dy * dy + dz * dz)
        if length > reach:
            energy += lost
            continue
        stretch = length - spacing
        pull = stiffness * stretch / length
        energy += 0.5 * stiffness * stretch * stretch
        force[i, 0] += pull * dx
        force[i, 1] += pull * dy
        force[i, 2] += pull * dz
        force[j, 0] -= pull * dx
        force[j, 1] -= pull * dy
        force[j, 2] -= pull * dz
    return energy


@njit(nogil=True, cache=True)
def _spring_virials(position, first, second, shift, stiffness, spacing, reach, virial, energy):  # type: ignore[no-untyped-def]  # numba
    way = np.empty(3)
    for bond in range(len(first)):
        i, j = first[bond], second[bond]
        for axis in range(3):
            way[axis] = position[j, axis] - position[i, axis] + shift[bond, axis]
        length = np.sqrt(way[0] ** 2 + way[1] ** 2 + way[2] ** 2)
        stretch = min(length, reach) - spacing
        half = 0.25 * stiffness * stretch * stretch
        energy[i] += half
        energy[j] += half
        if length > reach:
            continue
        pull = 0.5 * stiffness * stretch / length
        for column in range(6):
            a, b = VIRIAL_AXES[column]
            virial[i, column] += pull * way[a] * way[b]
            virial[j, column] += pull * way[a] * way[b]


class LatticeFactory:
    """The harmonic lattice; see `md_service.engines.EngineFactory`."""

    backend = "lattice"
    summary = "harmonic lattice in numpy and numba, for teaching and fast tests"
    ensembles = ("langevin", "nose-hoover", "berendsen", "andersen")
    severs = True

    def force_fields(self) -> list[str]:
        """Names of the springs."""
        return list(SPRINGS)

    def force_field(self, name: str) -> ForceField:
        """Limits of a bond in the form of a profile; it has no LAMMPS commands."""
        springs = _springs(name)
        breaks = np.isfinite(springs.break_stretch)
        limit = springs.spacing * (1.0 + springs.break_stretch) if breaks else None
        return ForceField(
            name=name,
            summary=springs.summary,
            source="closed form",
            unit_style="metal",
            atom_style="atomic",
            elements=("Ar",),
            styles=(),
            time_step=springs.time_step,
            lattice={material: {0.0: springs.spacing} for material in MATERIALS},
            switching_start=limit,
            switching_end=limit,
        )

    def time_step(self, name: str) -> float:
        """Recommended step, s: a 42nd of the fastest vibration of a hexagonal sheet of argon's mass."""
        return _springs(name).time_step

    def materials(self, name: str) -> list[str]:
        """The hexagonal lattice and the chain."""
        _springs(name)
        return list(MATERIALS)

    def spacing(self, name: str, material: str) -> float:
        """Distance of neighbours without force, m."""
        _check_material(material)
        return _springs(name).spacing

    def make(
        self, folder: Path, force_field: str, atoms: Atoms, *, temperature: float, seed: int, time_step: float
    ) -> Dynamics:
        """The lattice with its atoms; nothing is written into the folder."""
        forces = LatticeForces(atoms, _springs(force_field))
        return VelocityVerlet(atoms, forces, temperature=temperature, seed=seed, time_step=time_step)

    def properties(
        self, folder: Path, force_field: str, material: str, temperature: float, seed: int, progress: Progress
    ) -> IsotropicProperties:
        """Constants measured on a periodic sheet at 0 K, or those of a chain in closed form.

        They hold at a temperature too: what the motion of a lattice of springs changes in them is of the order of
        kT / (k a^2), 0.014 % at 300 K.
        """
        from md_service.static_constants import crystal, static_constants

        _check_material(material)
        springs = _springs(force_field)
        if material == CHAIN:
            return _chain_constants(springs, temperature)
        measured = static_constants(lambda atoms: LatticeForces(atoms, springs), crystal(material, springs.spacing))
        return replace(measured, temperature=temperature)


def _springs(name: str) -> Springs:
    if name not in SPRINGS:
        raise ValueError(f"force_field is {name!r}; known are {', '.join(SPRINGS)}")
    return SPRINGS[name]


def _check_material(material: str) -> None:
    if material not in MATERIALS:
        raise ValueError(f"material is {material!r}; the harmonic lattice has {', '.join(MATERIALS)}")


def _chain_constants(springs: Springs, temperature: float) -> IsotropicProperties:
    from md_service.crystals import chain
    from md_service.elastic_constants import IsotropicProperties

    bar = chain(springs.spacing, 3.0 * springs.spacing)
    assert bar.thickness is not None  # of every chain
    return IsotropicProperties(
        temperature=temperature,
        lattice_constant=springs.spacing,
        young=springs.young(bar.thickness),
        poisson=0.0,
        density=bar.density,
        thickness=bar.thickness,
    )


LATTICE: Final = LatticeFactory()
