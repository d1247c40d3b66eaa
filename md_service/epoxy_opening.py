"""Free faces for a cross-linked resin: a periodic sample is opened along x and y, and slit where a crack runs.

A network that repeats has no faces, and a cut through it leaves radicals, which the resin does not hold. So no ring is
cut, and both ends of a cut bond are closed with a hydrogen: all valences stay as they were. Species become elements:
the sample is for reactive force fields, which need no topology.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from md_service.atoms import Atoms, Box, CrackCut
from md_service.epoxy_monomers import ELEMENT_MASS
from md_service.epoxy_rings import nearest_image
from md_service.epoxy_typing import BondGraph, bonds_of, elements_of

#: Half the height of the band along a crack's line, m, whose groups are taken out.
SLIT_HALF_HEIGHT: Final = 3e-10
#: Length of a bond to hydrogen, m.
BOND_TO_HYDROGEN: Final = {"C": 1.09e-10, "N": 1.01e-10, "O": 0.96e-10}
#: Hydrogens that close cut bonds are at least so far from each other, m.
APART: Final = 1.5e-10
_ROUNDS = 50


def repeats_in_plane(atoms: Atoms) -> bool:
    """Whether bonds of a sample pass through the faces of its box along x or y."""
    if atoms.topology is None or not any(atoms.box.periodic[:2]) or not len(atoms.topology.bonds):
        return False
    bonds = bonds_of(atoms)
    way = np.abs(atoms.position[bonds[:, 1]] - atoms.position[bonds[:, 0]])[:, :2]
    edge = (atoms.box.high - atoms.box.low)[:2]
    return bool(((way > 0.5 * edge) & np.array(atoms.box.periodic[:2])).any())


def opened(atoms: Atoms, crack: CrackCut | None = None) -> Atoms:
    """Open a periodic resin along x and y, with its middle at the origin.

    Groups (a ring; an atom that is not of a ring; either with its hydrogens and with end groups of one atom) are put
    into the box whole, by their centres of mass. Bonds between groups that come to lie at opposite faces are cut. A
    crack takes out the groups whose centres lie within `SLIT_HALF_HEIGHT` of its line, behind its tip. Cut bonds are
    closed with hydrogen along the old bond; where two of these would come nearer than `APART`, the group that they
    stand in for stays.

    Parameters
    ----------
    atoms : Atoms
        With bonds, in a box with right angles.
    crack : CrackCut, optional
        In coordinates whose origin is the middle of the box along x and y.

    Returns
    -------
    Atoms
        Elements as species, no bonds, no charges; along x and y the box holds the atoms and does not repeat. An atom's
        volume stays what it was. Notes tell how many bonds its faces cut (`cut_bonds`), how many atoms a slit took out
        (`slit_atoms`), and how many hydrogens there are for them (`caps`).

    Raises
    ------
    ValueError
        If the sample has no bonds, its box is sheared, or it cannot be opened so.
    """
    if atoms.box.tilt.any():
        raise ValueError("the box is sheared; a resin is opened in a box with right angles")
    bonds = bonds_of(atoms)
    elements = np.array(elements_of(atoms))
    mass = atoms.atom_mass
    group = _groups(tuple(elements.tolist()), bonds)
    position = _whole(atoms, bonds, group)
    weight = np.bincount(group, mass)
    centre = np.column_stack([np.bincount(group, mass * position[:, k]) for k in range(3)]) / weight[:, None]
    inside, _ = atoms.box.wrapped(centre)
    middle = 0.5 * (atoms.box.low + atoms.box.high) * (1.0, 1.0, 0.0)
    position += (inside - centre - middle)[group]
    centre = inside - middle

    edge = atoms.box.high - atoms.box.low
    towards = nearest_image(position[bonds[:, 1]] - position[bonds[:, 0]], atoms.box)
    gone = np.zeros(len(weight), dtype=bool)
    if crack is not None:
        left = -np.inf if crack.left_x is None else crack.left_x
        gone = (
            (np.abs(centre[:, 1] - crack.y) < SLIT_HALF_HEIGHT) & (centre[:, 0] < crack.tip_x) & (centre[:, 0] > left)
        )
    for _ in range(_ROUNDS):
        taken = gone[group]
        step = towards - (position[bonds[:, 1]] - position[bonds[:, 0]])
        torn = np.any(np.abs(step[:, :2]) > 0.5 * edge[:2], axis=1)
        caps, kept, bond = _caps(position, elements, bonds, towards, torn, taken)
        crowded = _crowded(caps, edge[2])
        if not len(crowded):
            return _joined(atoms, position, elements, taken, caps, int(torn.sum()), crack)
        # What two hydrogens stand in for stays: a group that was taken out, or one that lies at the other face.
        partner = group[np.where(bonds[bond, 0] == kept, bonds[bond, 1], bonds[bond, 0])][crowded]
        sign = np.where(bonds[bond, 0] == kept, 1.0, -1.0)[crowded]
        partner, first = np.unique(partner, return_index=True)
        moved = np.zeros_like(centre)
        moved[partner] = np.where(gone[partner][:, None], 0.0, (sign[:, None] * step[bond[crowded]])[first] * (1, 1, 0))
        position += moved[group]
        gone[partner] = False
    raise ValueError("the resin could not be opened so that no two of the hydrogens at its faces touch")


def _groups(elements: tuple[str, ...], bonds: NDArray[np.int64]) -> NDArray[np.int64]:
    """Group of each atom, shape (n,): what no cut may part."""
    hydrogen = np.array([element == "H" for element in elements])
    graph = BondGraph.of(elements, bonds)
    ring = ring_bonds(graph, bonds)
    light = hydrogen[bonds].any(axis=1)
    degree = np.bincount(bonds[~light].ravel(), minlength=len(elements))
    last = (degree[bonds] == 1).any(axis=1)  # CH3, OH, NH2 go with what they hang on
    joined = bonds[ring | light | last]
    links = csr_array((np.ones(len(joined)), (joined[:, 0], joined[:, 1])), shape=(len(elements), len(elements)))
    return np.asarray(connected_components(links, directed=False)[1], dtype=np.int64)


def ring_bonds(graph: BondGraph, bonds: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which bonds belong to a ring of three or six atoms, as epoxides and aromatic rings are, shape (m,)."""
    found = np.zeros(len(bonds), dtype=bool)
    for row, (first, second) in enumerate(bonds.tolist()):
        of_three = not set(graph.neighbours[first]).isdisjoint(graph.neighbours[second])
        found[row] = of_three or (graph.is_planar_carbon(first) and graph.is_planar_carbon(second))
    return found


def _whole(atoms: Atoms, bonds: NDArray[np.int64], group: NDArray[np.int64]) -> NDArray[np.float64]:
    """Positions with the atoms of each group next to each other."""
    position = atoms.position.copy()
    inner = bonds[group[bonds[:, 0]] == group[bonds[:, 1]]]
    neighbours: dict[int, list[int]] = {}
    for first, second in inner.tolist():
        neighbours.setdefault(first, []).append(second)
        neighbours.setdefault(second, []).append(first)
    seen = np.zeros(len(atoms), dtype=bool)
    for start in range(len(atoms)):
        if seen[start]:
            continue
        seen[start] = True
        open_ends = [start]
        while open_ends:
            atom = open_ends.pop()
            for other in neighbours.get(atom, []):
                if not seen[other]:
                    seen[other] = True
                    position[other] = position[atom] + nearest_image(position[other] - position[atom], atoms.box)
                    open_ends.append(other)
    return position


def _caps(
    position: NDArray[np.float64],
    elements: NDArray[np.str_],
    bonds: NDArray[np.int64],
    towards: NDArray[np.float64],
    torn: NDArray[np.bool_],
    taken: NDArray[np.bool_],
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Hydrogens that close cut bonds: places (c, 3), m, rows of the atoms they sit on, and of the bonds they close."""
    places, atoms, rows = [], [], []
    for end, sign in ((0, 1.0), (1, -1.0)):
        kept, partner = bonds[:, end], bonds[:, 1 - end]
        cut = np.flatnonzero(~taken[kept] & (torn | taken[partner]))
        atom = kept[cut]
        direction = sign * towards[cut] / np.linalg.norm(towards[cut], axis=1)[:, None]
        length = np.array([BOND_TO_HYDROGEN[str(element)] for element in elements[atom]])
        places.append(position[atom] + length[:, None] * direction)
        atoms.append(atom)
        rows.append(cut)
    return np.concatenate(places), np.concatenate(atoms), np.concatenate(rows)


def _crowded(caps: NDArray[np.float64], depth: float) -> NDArray[np.int64]:
    """Rows of hydrogens that would touch, in a sample that repeats along z with a depth, m."""
    if len(caps) < 2:
        return np.zeros(0, dtype=np.int64)
    shifted = caps - caps.min(axis=0)
    shifted[:, 2] %= depth
    tree = cKDTree(shifted, boxsize=[0.0, 0.0, depth])
    return np.unique(tree.query_pairs(APART, output_type="ndarray")).astype(np.int64)


def _joined(
    atoms: Atoms,
    position: NDArray[np.float64],
    elements: NDArray[np.str_],
    taken: NDArray[np.bool_],
    caps: NDArray[np.float64],
    torn: int,
    crack: CrackCut | None,
) -> Atoms:
    """The atoms that are left, and the hydrogens, as a sample."""
    symbols = [*elements[~taken].tolist(), *["H"] * len(caps)]
    place = np.concatenate([position[~taken], caps])
    species = tuple(sorted(set(symbols)))
    number = {element: index for index, element in enumerate(species)}
    low, high = atoms.box.low.copy(), atoms.box.high.copy()
    low[:2], high[:2] = place[:, :2].min(axis=0), place[:, :2].max(axis=0)
    return Atoms(
        position=np.ascontiguousarray(place),
        kind=np.array([number[symbol] for symbol in symbols], dtype=np.int64),
        species=species,
        elements=species,
        mass=np.array([ELEMENT_MASS[element] for element in species]),
        box=Box(low, high, (False, False, atoms.box.periodic[2])),
        crack=crack,
        site_volume=atoms.atom_volume,
        notes={**atoms.notes, "cut_bonds": torn, "slit_atoms": int(taken.sum()), "caps": len(caps)},
    )
