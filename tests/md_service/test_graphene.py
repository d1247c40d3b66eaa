import numpy as np
import pytest
from scipy.spatial import cKDTree

from md_service.graphene import CrackCut, area_per_atom, bonds_of, sheet

BOND = 1.42e-10


def coordination(position):
    return np.bincount(bonds_of(position, BOND).ravel(), minlength=len(position))


def test_every_bond_has_the_lattice_constant_and_inner_atoms_have_three():
    built = sheet(30e-10, 40e-10, BOND)
    bonds = bonds_of(built.position, BOND)
    length = np.linalg.norm(built.position[bonds[:, 0]] - built.position[bonds[:, 1]], axis=1)
    np.testing.assert_allclose(length, BOND, rtol=1e-12)
    neighbours = coordination(built.position)
    half = np.abs(built.position[:, :2]).max(axis=0)
    inside = (np.abs(built.position[:, :2]) < half - 1.5 * BOND).all(axis=1)
    assert inside.sum() > 200
    assert (neighbours[inside] == 3).all()
    assert neighbours.min() == 2


def test_bond_directions_put_zigzag_along_x():
    built = sheet(30e-10, 30e-10, BOND)
    bonds = bonds_of(built.position, BOND)
    vector = built.position[bonds[:, 1]] - built.position[bonds[:, 0]]
    angle = np.round(np.degrees(np.arctan2(vector[:, 1], vector[:, 0]))) % 180
    assert set(angle) == {30.0, 90.0, 150.0}


def test_size_is_whole_cells_nearest_to_the_request_and_centred():
    built = sheet(103e-10, 103e-10, BOND)
    assert abs(built.width - 103e-10) <= 0.5 * np.sqrt(3) * BOND
    assert abs(built.height - 103e-10) <= 0.75 * BOND
    # All atoms but the two with a single neighbour: the area holds width * height / area per atom.
    assert round(built.width * built.height / area_per_atom(BOND)) == len(built.position) + 2
    np.testing.assert_allclose(built.position.min(axis=0), -built.position.max(axis=0), atol=1e-20)


def test_cracked_sheet_of_the_graphene_scene_has_about_4163_atoms():
    built = sheet(103e-10, 103e-10, 1.398e-10, CrackCut(0.0))
    assert abs(len(built.position) - 4163) < 0.01 * 4163


@pytest.mark.parametrize("y", [0.0, 1.3e-10, -7.7e-10])
def test_slit_lies_exactly_on_the_crack_with_zigzag_faces_that_cannot_rebind(y):
    tip = 1.0e-10
    built = sheet(40e-10, 40e-10, BOND, CrackCut(tip, y))
    behind = built.position[built.position[:, 0] < tip - BOND]
    above, below = behind[behind[:, 1] > y], behind[behind[:, 1] < y]
    top, bottom = above[:, 1].min(), below[:, 1].max()
    assert top - y == pytest.approx(y - bottom, rel=1e-9) == pytest.approx(1.25 * BOND, rel=1e-9)
    gap, _ = cKDTree(below).query(above)
    # The faces are shifted against each other by half a cell.
    assert gap.min() == pytest.approx(np.hypot(2.5, np.sqrt(0.75)) * BOND)
    assert gap.min() > 2e-10
    faces = behind[(np.abs(behind[:, 1] - top) < 1e-14) | (np.abs(behind[:, 1] - bottom) < 1e-14)]
    rows = cKDTree(built.position).query(faces)[1]
    assert (coordination(built.position)[rows] == 2).all()
    assert coordination(built.position).min() == 2


def test_slit_removes_one_chain_up_to_the_tip():
    tip = -0.4e-10
    whole, cut = sheet(40e-10, 41e-10, BOND), sheet(40e-10, 41e-10, BOND, CrackCut(tip))
    assert whole.height == cut.height
    chain = np.abs(whole.position[:, 1]) < 0.3 * BOND
    removed = np.count_nonzero(chain & (whole.position[:, 0] < tip))
    # One more goes at the slit's mouth, where an edge atom would be left with a single neighbour.
    assert len(whole.position) - len(cut.position) == removed + 1 > 10


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ((1e-10, 40e-10, BOND), "width"),
        ((40e-10, 40e-10, 0.0), "lattice_constant"),
        ((40e-10, 40e-10, BOND, CrackCut(30e-10)), "crack.tip_x"),
        ((40e-10, 40e-10, BOND, CrackCut(0.0, 30e-10)), "crack.y"),
    ],
)
def test_bad_input_names_its_field(arguments, field):
    with pytest.raises(ValueError, match=field):
        sheet(*arguments)
