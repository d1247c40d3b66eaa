"""OPLS-AA force field: parameters by species and by bonded class, as LAMMPS coefficients.

A species is named ``CLASS_NUMBER`` after its bonded class and its OPLS number, such as ``CA_145``. Bonded terms are
named by the classes of their atoms, such as ``CA-CA-HA``.
"""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Final

from md_service.atoms import Atoms

#: LAMMPS commands of the force field's functions, units "real". Coulomb forces are damped and shifted to vanish at
#: the cut-off (Fennell and Gezelter, J. Chem. Phys. 124, 234104, 2006), which for a neutral melt stands in for an
#: Ewald sum; pressure and energy of dispersion beyond the cut-off are added as for a uniform fluid.
STYLES: Final = (
    "pair_style lj/cut/coul/dsf 0.2 9.0",
    "pair_modify mix geometric tail yes",
    "special_bonds lj/coul 0.0 0.0 0.5",
    "bond_style harmonic",
    "angle_style harmonic",
    "dihedral_style opls",
    "improper_style cvff",
)
ANY: Final = "X"
_TABLE = Path(__file__).parent / "data" / "opls_aa.toml"


@dataclass(frozen=True)
class Species:
    """An atom type of OPLS-AA.

    Attributes
    ----------
    element : str
    bonded_class : str
        Name under which bonds, angles and dihedrals are tabulated.
    charge : float
        Elementary charges.
    epsilon, sigma : float
        Lennard-Jones well depth, kcal/mol, and diameter, Angstrom.
    """

    element: str
    bonded_class: str
    charge: float
    epsilon: float
    sigma: float


@dataclass(frozen=True)
class OplsTable:
    """The tabulated parameters; bonded terms map classes to LAMMPS coefficients."""

    species: dict[str, Species]
    bonds: dict[tuple[str, ...], tuple[float, ...]]
    angles: dict[tuple[str, ...], tuple[float, ...]]
    dihedrals: dict[tuple[str, ...], tuple[float, ...]]
    impropers: dict[tuple[str, ...], tuple[float, ...]]


@lru_cache
def opls_table() -> OplsTable:
    """Parameters that ship with the package."""
    text = tomllib.loads(_TABLE.read_text())

    def terms(section: str) -> dict[tuple[str, ...], tuple[float, ...]]:
        return {
            tuple(name.split("-")): tuple(values) if isinstance(values, list) else (values,)
            for name, values in text[section].items()
        }

    return OplsTable(
        {
            name: Species(row["element"], row["class"], row["charge"], row["epsilon"], row["sigma"])
            for name, row in text["species"].items()
        },
        terms("bonds"),
        terms("angles"),
        terms("dihedrals"),
        terms("impropers"),
    )


def canonical(classes: Sequence[str]) -> tuple[str, ...]:
    """One of the two ways to read a chain of classes, the same for both."""
    return min(tuple(classes), tuple(reversed(classes)))


def coefficients(
    table: dict[tuple[str, ...], tuple[float, ...]], classes: Sequence[str], reversible: bool = True
) -> tuple[float, ...]:
    """Coefficients of a bonded term; an exact entry goes before one with ``X``.

    Parameters
    ----------
    table : dict
        One of the bonded tables of `opls_table`.
    classes : sequence of str
        Of the atoms, along the chain.
    reversible : bool
        Whether the term reads the same from both ends.

    Raises
    ------
    ValueError
        If the table has no such term.
    """
    readings = [tuple(classes), tuple(reversed(classes))] if reversible else [tuple(classes)]
    for reading in readings:
        if reading in table:
            return table[reading]
    for names, values in table.items():
        for reading in readings:
            if len(names) == len(reading) and all(a in (ANY, b) for a, b in zip(names, reading, strict=True)):
                return values
    raise ValueError(f"OPLS-AA term {'-'.join(classes)} is not in the table {_TABLE.name}")


def coefficient_commands(atoms: Atoms) -> list[str]:
    """LAMMPS coefficients of all types of a sample, to follow the `STYLES`.

    Parameters
    ----------
    atoms : Atoms
        Species and names of bonded terms as made by `md_service.epoxy_typing.typed`.

    Raises
    ------
    ValueError
        If a species or a bonded term is not tabulated, or the sample has no topology.
    """
    table = opls_table()
    topology = atoms.topology
    if topology is None or atoms.charge is None:
        raise ValueError("opls-aa needs a sample with bonds and charges; this one has none")
    unknown = sorted(set(atoms.species) - set(table.species))
    if unknown:
        raise ValueError(f"species {', '.join(unknown)} are not in OPLS-AA as tabulated: {', '.join(table.species)}")
    commands = []
    for number, name in enumerate(atoms.species, start=1):
        kind = table.species[name]
        commands.append(f"pair_coeff {number} {number} {kind.epsilon!r} {kind.sigma!r}")
    for word, names, terms in (
        ("bond", topology.bond_names, table.bonds),
        ("angle", topology.angle_names, table.angles),
        ("dihedral", topology.dihedral_names, table.dihedrals),
    ):
        for number, name in enumerate(names, start=1):
            values = " ".join(repr(value) for value in coefficients(terms, name.split("-")))
            commands.append(f"{word}_coeff {number} {values}")
    for number, name in enumerate(topology.improper_names, start=1):
        (strength,) = coefficients(table.impropers, name.split("-"), reversible=False)
        commands.append(f"improper_coeff {number} {strength!r} -1 2")
    return commands
