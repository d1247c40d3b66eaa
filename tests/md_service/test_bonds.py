import time

import numpy as np
import pytest

from md_service.atoms import Atoms, Box, CrackCut, Topology
from md_service.bonds import BROKEN, Bonds
from md_service.crystals import fcc
from md_service.force_fields import force_field
from md_service.graphene import bonds_of, graphene

FIELD = force_field("airebo")
A = FIELD.lattice_constant
CRACK = CrackCut(0.0)


@pytest.fixture
def cracked() -> Atoms:
    return graphene(40e-10, 40e-10, spacing=A, crack=CRACK)


def opened(atoms: Atoms, tip_x: float) -> np.ndarray:
    """Sheet with its upper half lifted by 1 A left of a new tip: the vertical bonds below the chain at y = 0 break."""
    new = atoms.position.copy()
    new[(new[:, 1] > -0.5 * A) & (new[:, 0] < tip_x), 1] += 1e-10
    return new


def molecule(elements: list[str], position: list[list[float]], topology: Topology | None = None) -> Atoms:
    species = tuple(sorted(set(elements)))
    x = np.array(position) * 1e-10
    kind = np.array([species.index(element) for element in elements])
    return Atoms(x, kind, species, species, np.ones(len(species)), Box(x.min(axis=0), x.max(axis=0)), topology=topology)


def test_undeformed_sheet_has_no_broken_bond_and_its_tip_at_the_slit(cracked: Atoms) -> None:
    report = Bonds(cracked, FIELD).report(cracked.position)
    assert (report.broken, report.tip_x, report.sticking) == (0, 0.0, 0)
    assert report.longest_length == pytest.approx(A)
    assert list(map(tuple, Bonds(cracked, FIELD).pairs)) == list(map(tuple, bonds_of(cracked.position, A)))


def test_tip_moves_with_the_bonds_that_break_ahead_of_the_slit(cracked: Atoms) -> None:
    new_tip = 9e-10
    bonds = Bonds(cracked, FIELD)
    report = bonds.report(opened(cracked, new_tip))
    cell = np.sqrt(3) * A
    assert report.broken >= round(new_tip / cell)
    assert new_tip - cell < report.tip_x < new_tip + cell
    # The tip is remembered between reports, and forgotten with the bonds.
    assert bonds.report(opened(cracked, new_tip)).tip_x == report.tip_x
    assert bonds.report(cracked.position).tip_x == 0.0


def test_a_hole_away_from_the_crack_is_counted_but_moves_no_tip(cracked: Atoms) -> None:
    lifted = cracked.position.copy()
    atom = np.argmin(np.linalg.norm(lifted - [8e-10, 12e-10, 0.0], axis=1))
    lifted[atom, 2] += 3e-10
    report = Bonds(cracked, FIELD).report(lifted)
    assert report.broken == 3
    assert report.tip_x == 0.0


def test_a_slit_inside_has_its_right_tip_moved_by_bonds_on_its_left_too() -> None:
    atoms = graphene(60e-10, 40e-10, spacing=A, crack=CrackCut(5e-10, left_x=-5e-10))
    new = atoms.position.copy()
    new[(new[:, 1] > -0.5 * A) & (np.abs(new[:, 0]) < 12e-10), 1] += 1e-10
    cell = np.sqrt(3) * A
    assert 12e-10 - cell < Bonds(atoms, FIELD).report(new).tip_x < 12e-10 + cell


def test_without_a_slit_there_is_no_tip() -> None:
    atoms = graphene(30e-10, 30e-10, spacing=A)
    assert np.isnan(Bonds(atoms, FIELD).report(atoms.position).tip_x)


def test_bonds_within_two_percent_of_the_switching_start_stick(cracked: Atoms) -> None:
    bonds = Bonds(cracked, FIELD)
    first, second = bonds.pairs[len(bonds) // 2]
    direction = (cracked.position[second] - cracked.position[first]) / A
    assert FIELD.switching_start is not None
    for factor, sticking in ((0.97, 0), (0.99, 1), (1.01, 1), (1.03, 0)):
        stretched = cracked.position.copy()
        stretched[second] = cracked.position[first] + direction * factor * FIELD.switching_start
        report = bonds.report(stretched)
        assert report.sticking == sticking
        assert report.longest_atoms == (first, second)
        assert report.longest_length == pytest.approx(factor * FIELD.switching_start, rel=1e-12)
        assert report.longest_position == pytest.approx(0.5 * (stretched[first] + stretched[second]))
    # A cut has no window in which a bond could stick.
    assert Bonds(cracked, force_field("airebo-sharp")).report(stretched).sticking == 0


# --- samples of other kinds ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "spacing", "each"), [("graphene", A, 3), ("copper", 2.556e-10, 12)])
def test_periodic_samples_have_all_bonds_also_across_the_faces_and_after_atoms_left_the_box(
    name: str, spacing: float, each: int
) -> None:
    if name == "graphene":
        atoms = graphene(20e-10, 20e-10, spacing=spacing, periodic=True)
    else:
        atoms = fcc("Cu", spacing, (4, 4, 4))
    images = np.random.default_rng(1).integers(-2, 3, (len(atoms), 3)) * np.array(atoms.box.periodic)
    moved = atoms.at(atoms.position + images @ atoms.box.edges)
    bonds = Bonds(moved, None)
    assert np.bincount(bonds.pairs.ravel()).tolist() == [each] * len(atoms)
    assert bonds.lengths(moved.position) == pytest.approx(spacing)
    # Moved as a whole, each bond keeps the image it was found with.
    report = bonds.report(moved.position + np.array([1e-10, 2e-10, 3e-10]))
    assert (report.broken, report.longest_length) == (0, pytest.approx(spacing))


def test_sheared_box_has_the_bonds_of_the_straight_one() -> None:
    straight = graphene(20e-10, 20e-10, spacing=A, periodic=True)
    low, high = straight.box.low, straight.box.high
    tilted = straight.at(
        straight.position, Box(low, high, straight.box.periodic, np.array([high[0] - low[0], 0.0, 0.0]))
    )
    one, other = Bonds(straight, None), Bonds(tilted, None)
    assert np.array_equal(one.pairs, other.pairs)
    assert other.lengths(tilted.position) == pytest.approx(A)


def test_bonds_of_a_topology_are_taken_as_they_are() -> None:
    none = np.empty((0, 4), dtype=np.int64)
    bonds = np.array([[0, 2, 1], [0, 1, 0]])
    topology = Topology(bonds, none, none[:, :0], none[:, :0], ("C-C",), (), (), ())
    atoms = molecule(["C"] * 3, [[0, 0, 0], [1.5, 0, 0], [3.0, 0, 0]], topology)
    found = Bonds(atoms, None)
    assert found.pairs.tolist() == [[0, 1], [1, 2]]
    stretched = atoms.position * [1.01 * BROKEN, 1, 1]
    assert found.report(stretched).broken == 2
    assert found.report(atoms.position * [0.99 * BROKEN, 1, 1]).broken == 0


def test_without_lattice_or_topology_bonds_follow_from_covalent_radii() -> None:
    # Methanol-like chain H-C-O-H, and a water too far away to be bonded.
    atoms = molecule(["H", "C", "O", "H", "O"], [[-1.09, 0, 0], [0, 0, 0], [1.43, 0, 0], [1.75, 0.9, 0], [4.2, 0, 0]])
    bonds = Bonds(atoms, FIELD)
    assert bonds.pairs.tolist() == [[0, 1], [1, 2], [2, 3]]
    # Only carbon-carbon bonds are switched where the force field says.
    assert bonds.limit == pytest.approx(BROKEN * bonds.lengths(atoms.position))


def test_a_sample_without_bonds_has_none_to_report() -> None:
    atoms = molecule(["Cu", "Cu"], [[0, 0, 0], [2.5, 0, 0]])
    report = Bonds(atoms, None).report(atoms.position)
    assert (report.broken, report.longest_atoms, report.sticking) == (0, (), 0)
    assert np.isnan(report.longest_length)


def test_a_report_costs_less_than_a_fiftieth_of_ten_steps_of_tersoff() -> None:
    atoms = graphene(103e-10, 103e-10, spacing=A, crack=CRACK)
    bonds, position = Bonds(atoms, FIELD), opened(graphene(103e-10, 103e-10, spacing=A, crack=CRACK), 20e-10)
    bonds.report(position)
    start = time.process_time()
    for _ in range(50):
        bonds.report(position)
    # 10 steps of tersoff on 4168 atoms take 50 ms.
    assert (time.process_time() - start) / 50 < 0.02 * 50e-3
