"""The builders of crystals: neighbour shells, densities, faces and slits."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

from md_service.atoms import Atoms, CrackCut
from md_service.crystals import fcc, hexagonal, plane_distance
from md_service.graphene import bonds_of

ATOMIC_MASS_UNIT = 1.66053906660e-27


def shells(atoms: Atoms, distances: list[float]) -> list[int]:
    """Numbers of neighbours of each atom, the same for all, at the given distances."""
    size = np.where(atoms.box.periodic, atoms.box.high - atoms.box.low, 0.0)
    inside = atoms.box.wrapped(atoms.position)[0] - atoms.box.low
    tree = cKDTree(inside, boxsize=size)
    counts = []
    for distance in distances:
        outer = tree.query_ball_point(inside, distance * 1.001, return_length=True)
        inner = tree.query_ball_point(inside, distance * 0.999, return_length=True)
        assert np.ptp(outer - inner) == 0
        counts.append(int(outer[0] - inner[0]))
    return counts


def test_fcc_has_the_shells_and_the_density_of_copper() -> None:
    edge = 3.615e-10
    built = fcc("Cu", edge / np.sqrt(2.0), (4, 5, 4))
    assert len(built) == 4 * 80
    assert shells(built, [edge / np.sqrt(2.0), edge, edge * np.sqrt(1.5)]) == [12, 6, 24]
    np.testing.assert_allclose(built.box.high - built.box.low, edge * np.array([4, 5, 4]))
    assert built.density == pytest.approx(4 * 63.546 * ATOMIC_MASS_UNIT / edge**3, rel=1e-6)
    assert built.site_volume == pytest.approx(built.volume / len(built), rel=1e-12)
    assert built.density == pytest.approx(8930.0, rel=5e-3)  # measured density of copper


def test_free_faces_of_an_fcc_crystal_are_alike() -> None:
    built = fcc("Al", 2.86e-10, (2, 3, 4), periodic=(False, True, False))
    assert built.box.periodic == (False, True, False)
    np.testing.assert_allclose(built.position.max(axis=0), -built.position.min(axis=0), rtol=1e-12)
    assert (np.abs(built.position) < built.box.high).all()


def test_hexagonal_layer_has_six_neighbours_in_each_of_three_shells() -> None:
    spacing = 3.8e-10
    built = hexagonal(spacing, 40e-10, 45e-10, periodic=True)
    assert shells(built, [spacing, np.sqrt(3.0) * spacing, 2 * spacing]) == [6, 6, 6]
    assert built.thickness == plane_distance(spacing)
    assert built.site_volume == pytest.approx(built.volume / len(built), rel=1e-12)
    # Stacked at that distance such layers are the fcc crystal.
    assert built.density == pytest.approx(fcc("Ar", spacing, (1, 1, 1)).density, rel=1e-12)


def test_hexagonal_layer_with_free_edges_is_centred_and_of_the_nearest_size() -> None:
    spacing = 3.8e-10
    built = hexagonal(spacing, 100e-10, 80e-10)
    size = built.box.high - built.box.low
    assert abs(size[0] - 100e-10) <= 0.5 * spacing and abs(size[1] - 80e-10) <= 0.25 * np.sqrt(3) * spacing
    assert len(built) == round(built.volume / plane_distance(spacing) / (0.5 * np.sqrt(3) * spacing**2))
    np.testing.assert_allclose(built.position[:, :2].min(axis=0), -built.position[:, :2].max(axis=0), rtol=1e-12)
    assert built.box.periodic == (False, False, False)


@pytest.mark.parametrize("y", [0.0, 2e-10])
@pytest.mark.parametrize("left", [None, -12e-10])
def test_a_slit_takes_three_rows_and_lies_on_the_crack(y: float, left: float | None) -> None:
    spacing, tip = 3.8e-10, 1e-10
    row = 0.5 * np.sqrt(3.0) * spacing
    built = hexagonal(spacing, 80e-10, 80e-10, crack=CrackCut(tip, y, left))
    x, height = built.position[:, 0], built.position[:, 1] - y
    # Over the open length the nearest rows are two row distances away, on both sides.
    along = (x < tip - spacing) & (x > (x.min() if left is None else left) + spacing)
    assert height[along & (height > 0)].min() == pytest.approx(2 * row)
    assert -height[along & (height < 0)].max() == pytest.approx(2 * row)
    whole = hexagonal(spacing, 80e-10, float(built.box.high[1] - built.box.low[1]))
    length = tip - (x.min() if left is None else left)
    assert len(whole) - len(built) == pytest.approx(3 * length / spacing, abs=3)
    ahead = (x > tip + spacing) & (x < x.max() - spacing) & (np.abs(height) < 10e-10)
    neighbours = np.bincount(bonds_of(built.position, spacing).ravel(), minlength=len(built))
    assert (neighbours[ahead] == 6).all()


@pytest.mark.parametrize(
    ("build", "arguments", "said"),
    [
        (fcc, ("Cx", 2.5e-10, (3, 3, 3)), "'Cx'"),
        (fcc, ("Cu", -2.5e-10, (3, 3, 3)), "spacing"),
        (fcc, ("Cu", 2.5e-10, (3, 0, 3)), "cells"),
        (hexagonal, (float("nan"), 1e-9, 1e-9), "spacing"),
        (hexagonal, (3.8e-10, 5e-10, 1e-8), "width"),
        (hexagonal, (3.8e-10, 1e-8, float("inf")), "height"),
    ],
)
def test_bad_input_names_its_field(build: Any, arguments: tuple[Any, ...], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        build(*arguments)


def test_a_slit_outside_of_the_layer_is_refused() -> None:
    for crack, said in (
        (CrackCut(1e-7), "crack.tip_x"),
        (CrackCut(0.0, 1e-8), "crack.y"),
        (CrackCut(0.0, 0.0, 1e-9), "crack.left_x"),
    ):
        with pytest.raises(ValueError, match=said):
            hexagonal(3.8e-10, 80e-10, 80e-10, crack=crack)
    with pytest.raises(ValueError, match=r"crack\.left_x"):
        hexagonal(3.8e-10, 80e-10, 80e-10, crack=CrackCut(0.0), periodic=True)
