"""The builder of graphene: distances, directions, layers, edges and slits."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from md_service.atoms import CrackCut
from md_service.graphene import area_per_atom, bonds_of, graphene

BOND = 1.42e-10


def coordination(position):
    return np.bincount(bonds_of(position, BOND).ravel(), minlength=len(position))


def test_every_bond_has_the_lattice_constant_and_inner_atoms_have_three():
    built = graphene(30e-10, 40e-10, spacing=BOND)
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
    built = graphene(30e-10, 30e-10, spacing=BOND)
    bonds = bonds_of(built.position, BOND)
    vector = built.position[bonds[:, 1]] - built.position[bonds[:, 0]]
    angle = np.round(np.degrees(np.arctan2(vector[:, 1], vector[:, 0]))) % 180
    assert set(angle) == {30.0, 90.0, 150.0}


def test_size_is_whole_cells_nearest_to_the_request_and_centred():
    built = graphene(103e-10, 103e-10, spacing=BOND)
    width, height, _ = built.box.high - built.box.low
    assert abs(width - 103e-10) <= 0.5 * np.sqrt(3) * BOND
    assert abs(height - 103e-10) <= 0.75 * BOND
    # All atoms but the two with a single neighbour: the area holds width * height / area per atom.
    assert round(width * height / area_per_atom(BOND)) == len(built.position) + 2
    np.testing.assert_allclose(built.position.min(axis=0), -built.position.max(axis=0), atol=1e-20)


def test_cracked_sheet_of_the_graphene_scene_has_about_4163_atoms():
    built = graphene(103e-10, 103e-10, spacing=1.398e-10, crack=CrackCut(0.0))
    assert abs(len(built.position) - 4163) < 0.01 * 4163


@pytest.mark.parametrize("y", [0.0, 1.3e-10, -7.7e-10])
def test_slit_lies_exactly_on_the_crack_with_zigzag_faces_that_cannot_rebind(y):
    tip = 1.0e-10
    built = graphene(40e-10, 40e-10, spacing=BOND, crack=CrackCut(tip, y))
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
    whole, cut = (graphene(40e-10, 41e-10, spacing=BOND, crack=crack) for crack in (None, CrackCut(tip)))
    np.testing.assert_array_equal(whole.box.high[1] - whole.box.low[1], cut.box.high[1] - cut.box.low[1])
    chain = np.abs(whole.position[:, 1]) < 0.3 * BOND
    removed = np.count_nonzero(chain & (whole.position[:, 0] < tip))
    # One more goes at the slit's mouth, where an edge atom would be left with a single neighbour.
    assert len(whole.position) - len(cut.position) == removed + 1 > 10


@pytest.mark.parametrize(
    ("wrong", "field"),
    [
        ({"width": 1e-10}, "width"),
        ({"spacing": 0.0}, "spacing"),
        ({"crack": CrackCut(30e-10)}, "crack.tip_x"),
        ({"crack": CrackCut(0.0, 30e-10)}, "crack.y"),
    ],
)
def test_bad_input_names_its_field(wrong, field):
    with pytest.raises(ValueError, match=field):
        graphene(**{"width": 40e-10, "height": 40e-10, "spacing": BOND, **wrong})


def inner(built, margin):
    """Atoms farther than `margin` from the box's faces in the plane."""
    low, high = built.box.low[:2] + margin, built.box.high[:2] - margin
    return ((built.position[:, :2] > low) & (built.position[:, :2] < high)).all(axis=1)


def test_armchair_direction_along_x():
    built = graphene(30e-10, 40e-10, spacing=BOND, orientation="armchair")
    bonds = bonds_of(built.position, BOND)
    vector = built.position[bonds[:, 1]] - built.position[bonds[:, 0]]
    np.testing.assert_allclose(np.linalg.norm(vector, axis=1), BOND, rtol=1e-12)
    assert set(np.round(np.degrees(np.arctan2(vector[:, 1], vector[:, 0]))) % 180) == {0.0, 60.0, 120.0}
    assert (coordination(built.position)[inner(built, 1.5 * BOND)] == 3).all()
    size = built.box.high - built.box.low
    assert abs(size[0] - 30e-10) <= 0.75 * BOND and abs(size[1] - 40e-10) <= 0.5 * np.sqrt(3) * BOND
    assert (np.diff(np.round(built.position[:, 1], 14)) >= 0).all()


@pytest.mark.parametrize("orientation", ["zigzag", "armchair"])
@pytest.mark.parametrize("y", [0.0, 1.3e-10])
def test_faces_of_a_slit_of_either_direction_are_beyond_the_reach_of_bonds(orientation, y):
    built = graphene(40e-10, 40e-10, spacing=BOND, orientation=orientation, crack=CrackCut(0.0, y))
    behind = built.position[built.position[:, 0] < -BOND]
    above, below = behind[behind[:, 1] > y], behind[behind[:, 1] < y]
    assert above[:, 1].min() - y == pytest.approx(y - below[:, 1].max(), rel=1e-9)
    gap, _ = cKDTree(below).query(above)
    assert gap.min() == pytest.approx(np.sqrt(7.0) * BOND, rel=1e-6)
    assert coordination(built.position).min() == 2
    # Ahead of the tip nothing is missing.
    ahead = inner(built, 3 * BOND) & (built.position[:, 0] > 2 * BOND)
    assert (coordination(built.position)[ahead] == 3).all()
    centre = 0.5 * (built.box.high + built.box.low)
    assert abs(centre[1]) < 0.75 * BOND  # the sheet moved by no more than half a row distance


@pytest.mark.parametrize("orientation", ["zigzag", "armchair"])
def test_a_periodic_sheet_has_no_edge_and_the_density_of_graphite(orientation):
    built = graphene(25e-10, 30e-10, spacing=BOND, orientation=orientation, periodic=True)
    neighbours = np.bincount(bonds_of(built.position, BOND, built.box).ravel(), minlength=len(built))
    assert (neighbours == 3).all()
    assert built.box.periodic == (True, True, False)
    # 12.011 u on 3 sqrt(3)/4 a^2 times 3.35 Angstrom
    assert built.density == pytest.approx(12.011 * 1.66053907e-27 / (area_per_atom(BOND) * 3.35e-10), rel=1e-6)
    assert built.density == pytest.approx(2273.0, rel=2e-3)
    assert built.site_volume == pytest.approx(built.volume / len(built), rel=1e-12)


@pytest.mark.parametrize("orientation", ["zigzag", "armchair"])
@pytest.mark.parametrize("periodic", [True, False])
def test_a_slit_with_two_ends_lies_inside(orientation, periodic):
    left, tip, y = -8e-10, 6e-10, 2e-10
    options = {"spacing": BOND, "orientation": orientation, "periodic": periodic}
    whole = graphene(50e-10, 40e-10, **options)
    cut = graphene(50e-10, 40e-10, crack=CrackCut(tip, y, left), **options)
    near = np.abs(cut.position[:, 1] - y) < 0.8 * BOND
    assert not (near & (cut.position[:, 0] >= left) & (cut.position[:, 0] < tip)).any()
    assert (near & (cut.position[:, 0] < left)).any() and (near & (cut.position[:, 0] > tip)).any()
    # The rows of a slit hold 4 / (3 a) atoms per length in either direction, to within an atom at each end of a row.
    per_length = (2 / np.sqrt(3.0) if orientation == "zigzag" else 4.0 / 3.0) / BOND
    missing = round(whole.volume / (3.35e-10 * area_per_atom(BOND))) - len(cut)
    missing -= 0 if periodic else round(whole.volume / (3.35e-10 * area_per_atom(BOND))) - len(whole)
    assert missing == pytest.approx((tip - left) * per_length, abs=4)
    neighbours = np.bincount(bonds_of(cut.position, BOND, cut.box).ravel(), minlength=len(cut))
    assert neighbours.min() == 2


@pytest.mark.parametrize("orientation", ["zigzag", "armchair"])
def test_layers_in_ab_stacking_lie_atom_over_atom_and_atom_over_ring(orientation):
    built = graphene(30e-10, 30e-10, spacing=BOND, layers=3, orientation=orientation)
    levels = np.unique(np.round(built.position[:, 2], 14))
    np.testing.assert_allclose(levels, [-3.35e-10, 0.0, 3.35e-10])
    assert built.thickness == pytest.approx(3 * 3.35e-10)
    assert (built.position >= built.box.low).all() and (built.position <= built.box.high).all()
    low, middle, top = (built.position[np.isclose(built.position[:, 2], level, atol=1e-13)] for level in levels)
    np.testing.assert_array_equal(low[:, :2], top[:, :2])
    inside = (np.abs(low[:, :2]) < 10e-10).all(axis=1)
    aside, _ = cKDTree(middle[:, :2]).query(low[inside, :2])
    over_atom, over_ring = aside < 1e-14, np.isclose(aside, BOND, atol=1e-14)
    assert (over_atom | over_ring).all()
    assert over_atom.mean() == pytest.approx(0.5, abs=0.05)


def test_layers_in_aa_stacking_are_equal_and_a_slit_goes_through_all_layers():
    built = graphene(30e-10, 30e-10, spacing=BOND, layers=2, stacking="AA", crack=CrackCut(0.0))
    half = len(built) // 2
    np.testing.assert_array_equal(built.position[:half, :2], built.position[half:, :2])
    for stacking in ("AA", "AB"):
        cut = graphene(30e-10, 30e-10, spacing=BOND, layers=2, stacking=stacking, crack=CrackCut(0.0))
        behind = cut.position[cut.position[:, 0] < -BOND]
        assert np.abs(behind[:, 1]).min() >= 0.99 * BOND


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"layers": 0}, "layers"),
        ({"orientation": "chiral"}, "orientation is 'chiral'"),
        ({"stacking": "BA"}, "stacking is 'BA'"),
        ({"layer_distance": float("nan")}, "layer_distance"),
        ({"width": float("inf")}, "width"),
        ({"periodic": True, "crack": CrackCut(0.0)}, "crack.left_x"),
        ({"crack": CrackCut(0.0, 0.0, 1e-10)}, "crack.left_x"),
        ({"crack": CrackCut(0.0, 0.0, -30e-10)}, "crack.left_x"),
        ({"crack": CrackCut(0.0, 0.0, -1e-13)}, "no atom"),
    ],
)
def test_bad_choices_name_their_field(change, field):
    with pytest.raises(ValueError, match=field):
        graphene(**({"width": 40e-10, "height": 40e-10, "spacing": BOND} | change))
