"""OPLS-AA types of a resin, from nothing but elements and bonds.

The type of an atom follows from its neighbours, so the whole sample is typed anew after every reaction. Charges of
OPLS-AA sum to zero over each of the groups that occur here, before and after a reaction; the net charge stays zero.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from md_service.atoms import Atoms, Box, Note, Topology
from md_service.epoxy_monomers import ELEMENT_MASS, Molecule
from md_service.opls import ANY, canonical, opls_table


@dataclass(frozen=True)
class BondGraph:
    """Elements and neighbours of bonded atoms.

    Attributes
    ----------
    elements : sequence of str
    neighbours : list of list of int
        Rows of the atoms bonded to each atom, ascending.
    """

    elements: tuple[str, ...]
    neighbours: list[list[int]]

    @classmethod
    def of(cls, elements: tuple[str, ...], bonds: NDArray[np.int64]) -> BondGraph:
        """Graph of a list of bonds, shape (m, 2)."""
        neighbours: list[list[int]] = [[] for _ in elements]
        for a, b in bonds.tolist():
            neighbours[a].append(b)
            neighbours[b].append(a)
        for row in neighbours:
            row.sort()
        return cls(elements, neighbours)

    def of_element(self, atom: int, element: str) -> list[int]:
        """Neighbours of an atom that are of an element."""
        return [other for other in self.neighbours[atom] if self.elements[other] == element]

    def hydrogens(self, atom: int) -> int:
        """Number of hydrogens on an atom."""
        return len(self.of_element(atom, "H"))

    def is_planar_carbon(self, atom: int) -> bool:
        """Whether an atom is carbon with three neighbours."""
        return self.elements[atom] == "C" and len(self.neighbours[atom]) == 3

    def is_epoxide_oxygen(self, atom: int) -> bool:
        """Whether an atom is the oxygen of a three-membered ring."""
        if self.elements[atom] != "O" or len(self.neighbours[atom]) != 2:
            return False
        a, b = self.neighbours[atom]
        return b in self.neighbours[a]


def bonds_of(atoms: Atoms) -> NDArray[np.int64]:
    """Rows of the bonded atoms of a sample, shape (m, 2).

    Raises
    ------
    ValueError
        If the sample has no topology.
    """
    if atoms.topology is None:
        raise ValueError("the sample has no bonds")
    return atoms.topology.bonds[:, 1:]


def elements_of(atoms: Atoms) -> tuple[str, ...]:
    """Chemical symbol of each atom."""
    return tuple(atoms.elements[kind] for kind in atoms.kind.tolist())


def graph_of(atoms: Atoms) -> BondGraph:
    """Elements and neighbours of a sample's atoms."""
    return BondGraph.of(elements_of(atoms), bonds_of(atoms))


def typed(molecule: Molecule, box: Box, notes: dict[str, Note] | None = None) -> Atoms:
    """Give atoms their OPLS-AA species, charges and bonded terms.

    Parameters
    ----------
    molecule : Molecule
        All atoms of the sample.
    box : Box
    notes : dict, optional
        For the sample.

    Returns
    -------
    Atoms
        With charges, numbers of the connected molecules, and a topology.

    Raises
    ------
    ValueError
        If an atom is of none of the known kinds, which names the atom and its neighbours.
    """
    graph = BondGraph.of(molecule.elements, molecule.bonds)
    names = [species_name(graph, atom) for atom in range(len(molecule))]
    table = opls_table().species
    species = tuple(sorted(set(names)))
    number = {name: index for index, name in enumerate(species)}
    elements = tuple(table[name].element for name in species)
    return Atoms(
        position=np.ascontiguousarray(molecule.position),
        kind=np.array([number[name] for name in names], dtype=np.int64),
        species=species,
        elements=elements,
        mass=np.array([ELEMENT_MASS[element] for element in elements]),
        box=box,
        charge=np.array([table[name].charge for name in names]),
        molecule=connected_molecules(graph),
        topology=_topology(graph, molecule.bonds, [table[name].bonded_class for name in names]),
        notes=dict(notes or {}),
    )


def retyped(atoms: Atoms, bonds: NDArray[np.int64], position: NDArray[np.float64] | None = None) -> Atoms:
    """The same atoms with other bonds, shape (m, 2), and positions, m, if they are given."""
    molecule = Molecule(elements_of(atoms), atoms.position if position is None else position, bonds)
    return typed(molecule, atoms.box, atoms.notes)


def species_name(graph: BondGraph, atom: int) -> str:
    """OPLS-AA species of an atom, from its neighbours.

    Raises
    ------
    ValueError
        If no rule fits.
    """
    name = _RULES[graph.elements[atom]](graph, atom) if graph.elements[atom] in _RULES else None
    if name is None:
        around = ", ".join(graph.elements[other] for other in graph.neighbours[atom]) or "none"
        raise ValueError(f"atom {atom} ({graph.elements[atom]}) has no OPLS-AA type here; its neighbours: {around}")
    return name


def _carbon(graph: BondGraph, atom: int) -> str | None:
    if graph.is_planar_carbon(atom):
        return _planar_carbon(graph, atom)
    if len(graph.neighbours[atom]) != 4:
        return None
    hydrogens = graph.hydrogens(atom)
    oxygen, nitrogen = graph.of_element(atom, "O"), graph.of_element(atom, "N")
    aromatic = sum(graph.is_planar_carbon(other) for other in graph.neighbours[atom])
    if oxygen and graph.is_epoxide_oxygen(oxygen[0]):
        return {2: "CY_1026", 1: "CY_1027"}.get(hydrogens)
    if oxygen and graph.hydrogens(oxygen[0]):
        return {1: "CT_158"}.get(hydrogens)
    if oxygen:
        return {2: "CT_182"}.get(hydrogens)
    if nitrogen and hydrogens == 2:
        return {1: "CT_907", 0: "CT_908"}.get(graph.hydrogens(nitrogen[0]))
    if aromatic:
        return {3: "CT_148", 2: "CT_149"}.get(hydrogens)
    return {3: "CT_135"}.get(hydrogens)


def _planar_carbon(graph: BondGraph, atom: int) -> str | None:
    around = graph.neighbours[atom]
    planar = [other for other in around if graph.is_planar_carbon(other)]
    if len(planar) == 3:
        return "CA_147"
    if len(planar) < 2:
        return None
    (substituent,) = set(around) - set(planar)
    element = graph.elements[substituent]
    if element == "N":
        return {2: "CA_916", 1: "CA_917", 0: "CA_918"}.get(graph.hydrogens(substituent))
    if element == "C":
        bridge = sum(graph.is_planar_carbon(other) for other in graph.neighbours[substituent]) == 2
        return "CA_1004" if bridge else "CA_145"
    return {"H": "CA_145", "O": "CA_199"}.get(element)


def _nitrogen(graph: BondGraph, atom: int) -> str | None:
    if len(graph.neighbours[atom]) != 3:
        return None
    return {2: "NT_900", 1: "NT_901", 0: "NT_902"}.get(graph.hydrogens(atom))


def _oxygen(graph: BondGraph, atom: int) -> str | None:
    if len(graph.neighbours[atom]) != 2:
        return None
    if graph.is_epoxide_oxygen(atom):
        return "OY_1025"
    if graph.hydrogens(atom):
        return "OH_154"
    return "OS_179" if any(graph.is_planar_carbon(other) for other in graph.neighbours[atom]) else None


def _hydrogen(graph: BondGraph, atom: int) -> str | None:
    if len(graph.neighbours[atom]) != 1:
        return None
    (other,) = graph.neighbours[atom]
    if graph.elements[other] == "O":
        return "HO_155"
    if graph.elements[other] == "N":
        return {2: "HN_909", 1: "HN_910"}.get(graph.hydrogens(other))
    if graph.is_planar_carbon(other):
        return "HA_146"
    on = _carbon(graph, other)
    if on is None:
        return None
    return {"CY_1026": "HC_1029", "CY_1027": "HC_1029", "CT_182": "HC_185", "CT_907": "HC_911", "CT_908": "HC_911"}.get(
        on, "HC_140"
    )


_RULES: dict[str, Callable[[BondGraph, int], str | None]] = {
    "C": _carbon,
    "N": _nitrogen,
    "O": _oxygen,
    "H": _hydrogen,
}


def connected_molecules(graph: BondGraph) -> NDArray[np.int64]:
    """Number of the molecule of each atom, from 1 in the order of the first atoms, shape (n,)."""
    number = np.zeros(len(graph.elements), dtype=np.int64)
    count = 0
    for start in range(len(graph.elements)):
        if number[start]:
            continue
        count += 1
        number[start] = count
        open_ends = [start]
        while open_ends:
            for other in graph.neighbours[open_ends.pop()]:
                if not number[other]:
                    number[other] = count
                    open_ends.append(other)
    return number


def _topology(graph: BondGraph, bonds: NDArray[np.int64], classes: list[str]) -> Topology:
    """All bonded terms: every angle and dihedral along bonds, an improper at each planar carbon (centre third)."""
    around = graph.neighbours
    angles = [(a, centre, b) for centre in range(len(classes)) for a, b in combinations(around[centre], 2)]
    dihedrals = [
        (a, b, c, d) for b, c in bonds.tolist() for a in around[b] if a != c for d in around[c] if d not in (a, b)
    ]
    impropers = [
        (around[centre][0], around[centre][1], centre, around[centre][2])
        for centre in range(len(classes))
        if classes[centre] == "CA"
    ]
    bond_names, bond_rows = _named([tuple(row) for row in bonds.tolist()], 2, classes)
    angle_names, angle_rows = _named(angles, 3, classes)
    dihedral_names, dihedral_rows = _named(dihedrals, 4, classes)
    improper_rows = np.zeros((len(impropers), 5), dtype=np.int64)
    improper_rows[:, 1:] = np.array(impropers, dtype=np.int64).reshape(-1, 4)
    improper_names = (f"{ANY}-{ANY}-CA-{ANY}",) if impropers else ()
    return Topology(
        bond_rows, angle_rows, dihedral_rows, improper_rows, bond_names, angle_names, dihedral_names, improper_names
    )


def _named(
    terms: Sequence[tuple[int, ...]], width: int, classes: list[str]
) -> tuple[tuple[str, ...], NDArray[np.int64]]:
    """Names of the kinds of terms of so many atoms, in the alphabet's order, and rows of (kind, atoms)."""
    names = ["-".join(canonical([classes[atom] for atom in term])) for term in terms]
    kinds = tuple(sorted(set(names)))
    number = {name: index for index, name in enumerate(kinds)}
    rows = np.array([(number[name], *term) for name, term in zip(names, terms, strict=True)], dtype=np.int64)
    return kinds, rows.reshape(-1, width + 1)
