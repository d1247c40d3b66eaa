"""The epoxy builder: types, reactions, rings, and small resins built whole."""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from md_service.atoms import Atoms, Box
from md_service.epoxy import (
    SHIPPED,
    SHIPPED_UNITS,
    UNIT,
    UNIT_ATOMS,
    build_epoxy,
    shipped_epoxy,
    without_topology,
)
from md_service.epoxy_curing import Reaction, conversion_of, cross_links, cure, epoxide_groups, react
from md_service.epoxy_monomers import Molecule, joined, monomer
from md_service.epoxy_packing import GAP, pack
from md_service.epoxy_relaxation import Schedule
from md_service.epoxy_rings import aromatic_rings, nearest_image, speared_rings
from md_service.epoxy_typing import BondGraph, bonds_of, elements_of, graph_of, typed

VALENCE = {"C": (3, 4), "N": (3,), "O": (2,), "H": (1,)}
QUICK = Schedule(hot=0.2e-12, cooling=0.4e-12, holding=0.4e-12)


def _ring(radius: float) -> NDArray[np.float64]:
    angle = np.arange(6) * np.pi / 3.0
    return radius * np.stack([np.cos(angle), np.sin(angle), np.zeros(6)], axis=1)


def _benzene() -> Molecule:
    bonds = [(i, (i + 1) % 6) for i in range(6)] + [(i, i + 6) for i in range(6)]
    position = np.concatenate([_ring(1.4e-10), _ring(2.48e-10)])
    return Molecule(("C",) * 6 + ("H",) * 6, position, np.array(bonds, dtype=np.int64))


def _ethane() -> Molecule:
    """Two carbons along z, 1.53 Angstrom apart, the middle of their bond at the origin."""
    foot, down = _ring(1.02e-10), np.array([0.0, 0.0, 1.13e-10])
    position = np.array([[0.0, 0.0, -0.765e-10], [0.0, 0.0, 0.765e-10]])
    hydrogen = np.concatenate([foot[::2] - down, foot[1::2] + down])
    bonds = [(0, 1), (0, 2), (0, 3), (0, 4), (1, 5), (1, 6), (1, 7)]
    return Molecule(("C",) * 2 + ("H",) * 6, np.concatenate([position, hydrogen]), np.array(bonds, dtype=np.int64))


def _box(edge: float) -> Box:
    return Box(np.zeros(3), np.full(3, edge), (True, True, True))


def _check_valences(atoms: Atoms) -> None:
    graph = graph_of(atoms)
    for atom, element in enumerate(graph.elements):
        assert len(graph.neighbours[atom]) in VALENCE[element], f"atom {atom} ({element})"


def test_monomers_have_their_formulas() -> None:
    assert Counter(monomer("DGEBF").elements) == {"C": 19, "H": 20, "O": 4}
    assert Counter(monomer("DETDA").elements) == {"C": 11, "H": 18, "N": 2}
    assert UNIT_ATOMS == 117
    with pytest.raises(ValueError, match="EPON"):
        monomer("EPON")


@pytest.mark.parametrize("shift", [(0.0, 0.0, 0.0), (0.6e-10, 0.3e-10, 0.2e-10)])
@pytest.mark.parametrize("origin", [(15e-10, 15e-10, 15e-10), (0.1e-10, 29.9e-10, 0.0)])
def test_a_bond_through_a_ring_is_found(shift: tuple[float, ...], origin: tuple[float, ...]) -> None:
    """Also where the ring lies across the faces of the box, and where the atoms are images of each other."""
    ethane = _ethane()
    both = joined([_benzene(), ethane.at(ethane.position + shift + [0.0, 0.0, 30e-10])])
    found = speared_rings(typed(both.at(both.position + origin), _box(30e-10)))
    assert [(bond, sorted(ring)) for bond, ring in found] == [((12, 13), [0, 1, 2, 3, 4, 5])]


@pytest.mark.parametrize("shift", [(2.0e-10, 0.0, 0.0), (0.0, 0.0, 1.2e-10), (0.0, 1.35e-10, 0.0)])
def test_a_bond_beside_or_above_a_ring_is_none(shift: tuple[float, ...]) -> None:
    """The last passes by the middle of an edge, 1.21 Angstrom from the centre, nearer than a corner is."""
    ethane = _ethane()
    both = joined([_benzene(), ethane.at(ethane.position + shift)])
    atoms = typed(both.at(both.position + 15e-10), _box(30e-10))
    bonds = [bond for bond, _ in speared_rings(atoms) if bond == (12, 13)]
    assert bonds == []


def test_rings_of_a_sheet_are_found_once() -> None:
    """Naphthalene has two, its outer ring of ten is none."""
    rings = [(0, 1, 2, 3, 4, 5), (4, 5, 6, 7, 8, 9)]
    bonds = sorted({tuple(sorted((r[i], r[(i + 1) % 6]))) for r in rings for i in range(6)})
    hydrogen = [(c, 10 + i) for i, c in enumerate((0, 1, 2, 3, 6, 7, 8, 9))]
    graph = BondGraph.of(("C",) * 10 + ("H",) * 8, np.array(bonds + hydrogen, dtype=np.int64))
    assert sorted(sorted(ring) for ring in aromatic_rings(graph).tolist()) == [sorted(ring) for ring in rings]


def test_each_step_of_the_reaction_keeps_valences_and_charge() -> None:
    """One nitrogen takes two epoxide groups: primary, secondary, tertiary amine."""
    atoms = typed(joined([monomer("DGEBF"), monomer("DGEBF"), monomer("DETDA")]), _box(50e-10))
    names = []
    for _ in range(2):
        graph = graph_of(atoms)
        nitrogen = 43 + 43 + monomer("DETDA").elements.index("N")
        carbon, oxygen = epoxide_groups(graph)[0]
        atoms = react(atoms, [Reaction(nitrogen, graph.of_element(nitrogen, "H")[0], carbon, oxygen)])
        names.append([atoms.species[atoms.kind[atom]] for atom in (nitrogen, carbon, oxygen)])
        assert atoms.charge is not None and abs(atoms.charge.sum()) < 1e-12
        _check_valences(atoms)
    assert names == [["NT_901", "CT_907", "OH_154"], ["NT_902", "CT_908", "OH_154"]]
    assert cross_links(graph_of(atoms)) == 2 and conversion_of(atoms) == 0.5
    assert Counter(elements_of(atoms)) == Counter(e for molecule in UNIT for e in molecule.elements)


def test_packed_molecules_keep_apart_from_each_other_and_from_a_platelet() -> None:
    platelet = _benzene()
    atoms = pack(UNIT * 3, 5, platelet)
    assert atoms.molecule is not None and atoms.molecule.max() == 10
    for molecule in range(1, 11):
        mine, others = atoms.position[atoms.molecule == molecule], atoms.position[atoms.molecule != molecule]
        apart = nearest_image(mine[:, None] - others[None], atoms.box)
        assert np.linalg.norm(apart, axis=-1).min() > 0.9 * GAP
    np.testing.assert_allclose(atoms.position[:12].mean(axis=0), 0.5 * atoms.box.high, atol=1e-13)


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Atoms:
    return build_epoxy(2, seed=11, work_dir=tmp_path_factory.mktemp("epoxy"), schedule=QUICK)


def test_a_small_resin_has_the_wanted_conversion_valences_and_no_speared_ring(small: Atoms) -> None:
    assert len(small) == 2 * UNIT_ATOMS
    graph = graph_of(small)
    assert cross_links(graph) == round(0.76 * 8) == 6
    assert len(epoxide_groups(graph)) == 2
    assert small.notes["conversion"] == conversion_of(small) == 0.75
    _check_valences(small)
    assert speared_rings(small) == []
    assert small.charge is not None and abs(small.charge.sum()) < 1e-12
    assert Counter(elements_of(small)) == Counter(e for molecule in UNIT * 2 for e in molecule.elements)


def test_bonds_of_a_small_resin_are_as_long_as_bonds(small: Atoms) -> None:
    a, b = bonds_of(small).T
    length = np.linalg.norm(nearest_image(small.position[a] - small.position[b], small.box), axis=1)
    assert length.min() > 0.85e-10 and length.max() < 1.75e-10


def test_the_same_seed_gives_the_same_resin(small: Atoms, tmp_path: Path) -> None:
    again = build_epoxy(2, seed=11, work_dir=tmp_path, schedule=QUICK)
    np.testing.assert_array_equal(again.position, small.position)
    np.testing.assert_array_equal(bonds_of(again), bonds_of(small))


def test_curing_goes_on_from_a_resin(small: Atoms, tmp_path: Path) -> None:
    more = cure(small, 7.0 / 8.0, 3, tmp_path)
    assert cross_links(graph_of(more)) == 7
    before, after = ({tuple(bond) for bond in bonds_of(atoms).tolist()} for atoms in (small, more))
    assert len(before - after) == len(after - before) == 2
    assert speared_rings(more) == []


def test_without_topology_elements_remain(small: Atoms) -> None:
    bare = without_topology(small)
    assert bare.species == bare.elements == ("C", "H", "N", "O")
    assert bare.topology is None and bare.charge is None
    assert elements_of(bare) == elements_of(small)
    np.testing.assert_array_equal(bare.atom_mass, small.atom_mass)


def test_what_cannot_be_built_is_refused(small: Atoms, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="units is 0"):
        build_epoxy(0)
    with pytest.raises(ValueError, match=r"conversion is 1\.2"):
        build_epoxy(1, conversion=1.2)
    with pytest.raises(ValueError, match=r"conversion is -0\.1"):
        cure(small, -0.1, 1, tmp_path)


def test_an_atom_of_no_known_kind_is_named() -> None:
    methane = Molecule(("C", "H", "H", "H", "H"), np.zeros((5, 3)), np.array([(0, i) for i in range(1, 5)]))
    with pytest.raises(ValueError, match=r"atom 0 \(C\).*H, H, H, H"):
        typed(methane, _box(20e-10))


def test_the_shipped_resin_is_what_its_notes_say() -> None:
    atoms = shipped_epoxy()
    assert len(atoms) == SHIPPED_UNITS * UNIT_ATOMS == 17901
    graph = graph_of(atoms)
    assert cross_links(graph) == round(0.76 * 4 * SHIPPED_UNITS) == 465
    assert cross_links(graph) + len(epoxide_groups(graph)) == 4 * SHIPPED_UNITS
    assert conversion_of(atoms) == atoms.notes["conversion"]
    _check_valences(atoms)
    assert speared_rings(atoms) == []
    assert atoms.charge is not None and abs(atoms.charge.sum()) < 1e-9
    assert atoms.density == pytest.approx(float(atoms.notes["density"]), rel=1e-5)
    assert SHIPPED.stat().st_size < 2_000_000
    assert "--units 153" in str(atoms.notes["command"])


def test_types_of_the_shipped_resin_are_those_of_its_bonds() -> None:
    atoms = shipped_epoxy()
    again = typed(Molecule(elements_of(atoms), atoms.position, bonds_of(atoms)), atoms.box)
    assert again.species == atoms.species
    np.testing.assert_array_equal(again.kind, atoms.kind)
    assert again.topology is not None and atoms.topology is not None
    assert again.topology.dihedral_names == atoms.topology.dihedral_names
    np.testing.assert_array_equal(again.topology.dihedrals, atoms.topology.dihedrals)
