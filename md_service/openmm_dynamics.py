"""OpenMM as an engine of the role `atomistic`: Lennard-Jones solids and OPLS-AA molecules.

OpenMM computes the forces, on one thread of its CPU platform, in single precision; positions, velocities, anchors
and means are in double precision in `md_service.velocity_verlet`, which costs less here than OpenMM's own custom
integrators. Forces therefore err by about 2e-5 of the largest one. They are a function of the positions and of the
neighbour list, which `reset` makes anew, so a restored run still goes on bit by bit.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from md_service import units
from md_service.atoms import Atoms, Box
from md_service.dynamics import Dynamics
from md_service.errors import EngineError
from md_service.force_fields import ForceField, force_field
from md_service.lennard_jones import PROFILE as LENNARD_JONES
from md_service.lennard_jones import is_flat, lennard_jones_parameters, lennard_jones_virials
from md_service.velocity_verlet import VelocityVerlet

if TYPE_CHECKING:
    from md_service.elastic_constants import IsotropicProperties
    from md_service.engines import Progress

OPLS: Final = "opls-aa"
NANOMETRE: Final = 1e-9  # m
KILOJOULE: Final = 1e3 / units.AVOGADRO  # J per kJ/mol
_ROOM: Final = 100e-10  # m that atoms may move out along a free direction of a box that is periodic in another


class OpenmmForces:
    """Forces of an OpenMM system; implements `md_service.velocity_verlet.Interactions`.

    Parameters
    ----------
    atoms : Atoms
        The sample.
    name : str
        ``lennard-jones`` or ``opls-aa``.
    platform : str
        ``CPU`` in single precision, or ``Reference`` in double precision, some ten times slower.

    Raises
    ------
    ValueError
        If the force field does not know the atoms, or the box is smaller than twice the cut-off.
    EngineError
        If OpenMM is not installed.
    """

    def __init__(self, atoms: Atoms, name: str, platform: str = "CPU") -> None:
        openmm = openmm_module()
        self._atoms = atoms
        self._name = name
        self.dimension = 2 if name == LENNARD_JONES and is_flat(atoms) else 3
        system = openmm.System()
        for mass in atoms.atom_mass / units.MASS:
            system.addParticle(mass)
        self._constant = 0.0  # J, of energies without forces
        if name == LENNARD_JONES:
            cutoff = _add_lennard_jones(system, atoms)
        else:
            from md_service.openmm_opls import add_opls

            cutoff, self._constant = add_opls(system, atoms)
        if any(atoms.box.periodic):
            system.setDefaultPeriodicBoxVectors(*_periodic_edges(atoms, cutoff))
        properties = {"Threads": "1", "DeterministicForces": "true"} if platform == "CPU" else {}
        self._integrator = openmm.VerletIntegrator(0.001)  # never steps: a context needs one
        self._context = openmm.Context(
            system, self._integrator, openmm.Platform.getPlatformByName(platform), properties
        )

    def forces(self, position: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
        """Forces, N, shape (n, 3), and the energy, J."""
        openmm = openmm_module()
        try:
            self._context.setPositions(position / NANOMETRE)
            state = self._context.getState(getForces=True, getEnergy=True)
        except openmm.OpenMMException as error:
            raise EngineError(f"OpenMM stopped: {error}") from error
        force = np.array(state.getForces(asNumpy=True)._value, order="C") * (KILOJOULE / NANOMETRE)
        if self.dimension == 2:
            force[:, 2] = 0.0
        return force, state.getPotentialEnergy()._value * KILOJOULE + self._constant

    def virial_and_energy(self, position: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Virial, J, shape (n, 6), and energy, J, shape (n,), of Lennard-Jones atoms, summed here.

        Raises
        ------
        EngineError
            For OPLS-AA: OpenMM does not tell what belongs to which atom.
        """
        if self._name != LENNARD_JONES:
            raise EngineError(
                f"OpenMM has no virial and no energy of single atoms for {self._name}; ask for positions and "
                "velocities only, or take md_service, whose LAMMPS has them"
            )
        return lennard_jones_virials(self._atoms, position)

    def reset(self) -> None:
        """Make the neighbour list anew."""
        self._context.reinitialize()

    def close(self) -> None:
        """Free the context."""
        if hasattr(self, "_context"):
            del self._context, self._integrator


def openmm_module() -> Any:
    """The package openmm.

    Raises
    ------
    EngineError
        If it is not installed.
    """
    try:
        return import_module("openmm")
    except ImportError as error:
        raise EngineError("this engine needs openmm: pip install 'scalebridge[openmm]'") from error


def _add_lennard_jones(system: Any, atoms: Atoms) -> float:
    """The profile's atoms, cut off and not shifted; returns the cut-off, m."""
    openmm = openmm_module()
    epsilon, sigma, cutoff = lennard_jones_parameters()
    force = openmm.NonbondedForce()
    for _ in range(len(atoms)):
        force.addParticle(0.0, sigma / NANOMETRE, epsilon / KILOJOULE)
    force.setNonbondedMethod(force.CutoffPeriodic if any(atoms.box.periodic) else force.CutoffNonPeriodic)
    force.setCutoffDistance(cutoff / NANOMETRE)
    force.setUseDispersionCorrection(False)
    system.addForce(force)
    return cutoff


def _periodic_edges(atoms: Atoms, cutoff: float) -> NDArray[np.float64]:
    """Edges of a box that is periodic in all directions, nm, with room along the free ones.

    Raises
    ------
    ValueError
        If OpenMM cannot take the box.
    """
    low, high = atoms.box.low.copy(), atoms.box.high.copy()
    for axis in range(3):
        if not atoms.box.periodic[axis]:
            low[axis] = atoms.position[:, axis].min()
            high[axis] = atoms.position[:, axis].max() + cutoff + _ROOM
        elif high[axis] - low[axis] < 2.0 * cutoff:
            raise ValueError(
                f"box is {high[axis] - low[axis]:.4g} m along {'xyz'[axis]}; OpenMM needs at least "
                f"{2.0 * cutoff:.4g} m, twice the cut-off, in a periodic direction"
            )
    edges = Box(low, high, atoms.box.periodic, atoms.box.tilt).edges
    if (2.0 * np.abs(atoms.box.tilt) > np.array([edges[0, 0], edges[0, 0], edges[1, 1]])).any():
        raise ValueError(f"box.tilt is {atoms.box.tilt} m; OpenMM takes at most half of the edge")
    return np.asarray(edges / NANOMETRE)


class OpenmmFactory:
    """OpenMM; see `md_service.engines.EngineFactory`."""

    backend = "openmm"
    summary = "molecular dynamics with the forces of OpenMM: Lennard-Jones and OPLS-AA"
    ensembles = ("langevin", "nose-hoover", "berendsen", "andersen")
    severs = False

    def force_fields(self) -> list[str]:
        """The two that OpenMM serves here."""
        return [LENNARD_JONES, OPLS]

    def force_field(self, name: str) -> ForceField | None:
        """The profile that LAMMPS has."""
        if name not in self.force_fields():
            raise ValueError(f"force_field is {name!r}; known are {', '.join(self.force_fields())}")
        return force_field(name)

    def time_step(self, name: str) -> float:
        """The profile's step, s."""
        self.force_field(name)
        return force_field(name).time_step

    def materials(self, name: str) -> list[str]:
        """Crystals of the profile; molecules come as a data file."""
        self.force_field(name)
        return list(force_field(name).lattice)

    def spacing(self, name: str, material: str) -> float:
        """Nearest-neighbour distance at 0 K, m."""
        self.force_field(name)
        return force_field(name).spacing(material, 0.0)

    def make(
        self, folder: Path, force_field: str, atoms: Atoms, *, temperature: float, seed: int, time_step: float
    ) -> Dynamics:
        """OpenMM with the atoms; nothing is written into the folder."""
        return VelocityVerlet(
            atoms, self.forces(force_field, atoms), temperature=temperature, seed=seed, time_step=time_step
        )

    def properties(
        self, folder: Path, force_field: str, material: str, temperature: float, seed: int, progress: Progress
    ) -> IsotropicProperties:
        """Constants at 0 K from energies; above, this engine measures none."""
        from md_service.static_constants import crystal, require_rest, static_constants

        require_rest(temperature)
        cell = crystal(material, self.spacing(force_field, material), lennard_jones_parameters()[2])
        # Differences of energies need double precision.
        return static_constants(lambda atoms: self.forces(force_field, atoms, "Reference"), cell)

    def forces(self, name: str, atoms: Atoms, platform: str = "CPU") -> OpenmmForces:
        """Forces of a sample.

        Raises
        ------
        ValueError
            If the force field does not know the atoms.
        EngineError
            If OpenMM is not installed.
        """
        self.force_field(name)
        known = force_field(name).elements
        unknown = [element for element in atoms.elements if element not in known]
        if unknown:
            raise ValueError(f"force field {name} knows {', '.join(known)}; the sample has {', '.join(unknown)}")
        return OpenmmForces(atoms, name, platform)


OPENMM: Final = OpenmmFactory()
