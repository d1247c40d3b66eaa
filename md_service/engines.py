"""Codes that can stand behind the role `atomistic`: what each one offers, and how to make one.

To bring another code, write a `md_service.dynamics.Dynamics` and an object with the attributes of `EngineFactory`,
and announce a backend whose factory is ``serve(folder, that object)`` of `md_service.service`.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from md_service.atoms import Atoms
from md_service.force_fields import FORCE_FIELDS, ForceField, force_field

if TYPE_CHECKING:
    from md_service.dynamics import Dynamics
    from md_service.elastic_constants import IsotropicProperties

Progress = Callable[[int, int], None]

#: Half of the least extent of a crystal whose constants are measured at a temperature, m.
_REACH = 1.2e-9


class EngineFactory(Protocol):
    """What a code offers."""

    @property
    def backend(self) -> str:
        """Name on the wire: ``md_service``, ``lattice``, ``ase``, ``openmm``."""

    @property
    def summary(self) -> str:
        """A few words."""

    @property
    def ensembles(self) -> tuple[str, ...]:
        """Thermostats of `md_service.ensembles` that `Dynamics.hold` knows, besides ``none``."""

    @property
    def severs(self) -> bool:
        """Whether its atoms can be severed along a line."""

    def force_fields(self) -> list[str]:
        """Names of the force fields, the one to try first first."""

    def force_field(self, name: str) -> ForceField | None:
        """Profile of a force field where it has one: its limits of a bond and its traps.

        Raises
        ------
        ValueError
            If there is no force field of that name.
        """

    def time_step(self, name: str) -> float:
        """Recommended step of a force field, s."""

    def materials(self, name: str) -> list[str]:
        """Materials of which a sample can be built for a force field."""

    def spacing(self, name: str, material: str) -> float:
        """Nearest-neighbour distance of a material at 0 K, m."""

    def make(
        self,
        folder: Path,
        force_field: str,
        atoms: Atoms,
        *,
        temperature: float,
        seed: int,
        time_step: float,
    ) -> Dynamics:
        """The code with the atoms in it.

        Raises
        ------
        ValueError
            If the force field does not know the atoms.
        EngineError
            If the code is not installed or refuses the input.
        """

    def properties(
        self, folder: Path, force_field: str, material: str, temperature: float, seed: int, progress: Progress
    ) -> IsotropicProperties:
        """Isotropic constants of a material at zero stress and a temperature, K.

        Raises
        ------
        ValueError
            If this is not measured for the material or temperature.
        EngineError
            If the code fails.
        """


class LammpsFactory:
    """LAMMPS on one rank; see `EngineFactory`."""

    backend = "md_service"
    summary = "molecular dynamics by LAMMPS"
    ensembles = ("langevin", "nose-hoover", "berendsen", "andersen")
    severs = True

    def force_fields(self) -> list[str]:
        """Names of the profiles."""
        return sorted(FORCE_FIELDS)

    def force_field(self, name: str) -> ForceField:
        """Profile of a force field."""
        return force_field(name)

    def time_step(self, name: str) -> float:
        """Recommended step of a force field, s."""
        return force_field(name).time_step

    def materials(self, name: str) -> list[str]:
        """Crystals whose spacing the profile states."""
        return list(force_field(name).lattice)

    def spacing(self, name: str, material: str) -> float:
        """Nearest-neighbour distance of a material at 0 K, m."""
        return force_field(name).spacing(material, 0.0)

    def make(
        self,
        folder: Path,
        force_field: str | ForceField,
        atoms: Atoms,
        *,
        temperature: float,
        seed: int,
        time_step: float,
    ) -> Dynamics:
        """LAMMPS with the atoms in it; the force field may also be a profile of the caller's own."""
        from md_service.lammps_dynamics import LammpsDynamics

        return LammpsDynamics(
            folder, _profile(force_field), atoms, temperature=temperature, seed=seed, time_step=time_step
        )

    def properties(
        self, folder: Path, force_field: str, material: str, temperature: float, seed: int, progress: Progress
    ) -> IsotropicProperties:
        """Constants of a crystal: of graphene by its own fast way, of others from their stiffness tensors."""
        from md_service.elastic_constants import measure_graphene, measure_isotropic
        from md_service.static_constants import crystal

        profile = _profile(force_field)
        if material == "graphene":
            return measure_graphene(profile, temperature, seed=seed, work_dir=folder, progress=progress)
        cell = crystal(material, profile.spacing(material, temperature), _REACH if temperature > 0.0 else 0.0)
        return measure_isotropic(cell, profile, temperature, folder, seed=seed, progress=progress)


def _profile(name: str | ForceField) -> ForceField:
    return name if isinstance(name, ForceField) else force_field(name)


LAMMPS: EngineFactory = LammpsFactory()
