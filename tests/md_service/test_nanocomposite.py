"""Epoxy around a graphene platelet: the platelet, the amount of resin, and a small cured sample."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.distance import pdist

from md_service.atoms import Atoms
from md_service.epoxy import UNIT_ATOMS, UNIT_MASS
from md_service.epoxy_relaxation import Schedule
from md_service.epoxy_rings import speared_rings
from md_service.nanocomposite import build_nanocomposite, platelet, units_for

SMALL = 7e-10
WANTED = 0.08


def test_the_smallest_platelet_is_pyrene() -> None:
    built = platelet(SMALL, SMALL)
    assert (built.elements.count("C"), built.elements.count("H")) == (16, 10)
    assert built.mass / 1.66053906660e-27 == pytest.approx(202.256, abs=0.01)  # molar mass of pyrene


def test_the_edge_of_a_platelet_is_closed_by_hydrogen() -> None:
    built = platelet(15e-10, 12e-10)
    carbon = np.array(built.elements) == "C"
    neighbours = np.bincount(built.bonds.ravel(), minlength=len(built))
    assert (neighbours[carbon] == 3).all() and (neighbours[~carbon] == 1).all()
    vector = built.position[built.bonds[:, 1]] - built.position[built.bonds[:, 0]]
    length = np.linalg.norm(vector, axis=1)
    to_hydrogen = ~carbon[built.bonds[:, 1]]
    np.testing.assert_allclose(length[~to_hydrogen], 1.40e-10, rtol=1e-12)
    np.testing.assert_allclose(length[to_hydrogen], 1.08e-10, rtol=1e-12)
    # Each hydrogen halves the open angle of its carbon atom: the three unit vectors sum to zero.
    total = np.zeros_like(built.position)
    np.add.at(total, built.bonds[:, 0], vector / length[:, None])
    np.add.at(total, built.bonds[:, 1], -vector / length[:, None])
    np.testing.assert_allclose(total[carbon], 0.0, atol=1e-12)
    assert np.ptp(built.position[:, 2]) == 0.0
    assert pdist(built.position[~carbon]).min() > 1.7e-10


@pytest.mark.parametrize("fraction", [0.02, 0.05, 0.1])
def test_the_weight_fraction_is_met_by_the_nearest_number_of_units(fraction: float) -> None:
    filler = platelet(12e-10, 12e-10)
    units = units_for(fraction, filler)

    def off(n: int) -> float:
        return abs(filler.mass / (filler.mass + n * UNIT_MASS) - fraction)

    assert off(units) < off(units + 1) and off(units) < off(units - 1)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((SMALL, SMALL, 0.0), "weight_fraction"),
        ((SMALL, SMALL, 1.0), "weight_fraction"),
        ((SMALL, SMALL, 0.6), "with one unit"),
        ((SMALL, SMALL, 0.12), "does not fit"),
        ((4e-10, SMALL, 0.02), "width"),
    ],
)
def test_bad_input_is_refused_before_anything_is_built(
    tmp_path: Path, arguments: tuple[float, float, float], said: str
) -> None:
    with pytest.raises(ValueError, match=said):
        build_nanocomposite(*arguments, work_dir=tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Atoms:
    return build_nanocomposite(
        SMALL, SMALL, WANTED, work_dir=tmp_path_factory.mktemp("composite"), schedule=Schedule(2e-13, 5e-13, 5e-13)
    )


def test_a_small_nanocomposite_holds_what_was_asked_for(small: Atoms) -> None:
    filler = platelet(SMALL, SMALL)
    units = units_for(WANTED, filler)
    assert len(small) == len(filler) + units * UNIT_ATOMS
    assert small.notes["platelet_atoms"] == len(filler) and small.notes["units"] == units
    share = small.atom_mass[: len(filler)].sum() / small.atom_mass.sum()
    assert small.notes["weight_fraction"] == pytest.approx(share, rel=1e-12)
    # Four epoxide groups a unit.
    assert small.notes["conversion"] == round(0.76 * 4 * units) / (4 * units)
    assert small.charge is not None and abs(small.charge.sum()) < 1e-9
    assert small.box.periodic == (True, True, True)
    # The relaxation of this test is short; a sample that came apart or was crushed is told from a resin, no more.
    assert 900.0 < small.density < 1350.0


def test_the_platelet_of_a_small_nanocomposite_is_whole_and_alone(small: Atoms) -> None:
    filler = platelet(SMALL, SMALL)
    n = len(filler)
    assert small.topology is not None
    bonds = small.topology.bonds[:, 1:]
    own = bonds[(bonds < n).any(axis=1)]
    assert {tuple(sorted(pair)) for pair in own.tolist()} == {tuple(sorted(pair)) for pair in filler.bonds.tolist()}
    length = np.linalg.norm(small.position[own[:, 1]] - small.position[own[:, 0]], axis=1)
    assert ((length > 0.95e-10) & (length < 1.6e-10)).all()
    # Flat to within its thermal motion.
    centred = small.position[:16] - small.position[:16].mean(axis=0)
    assert np.linalg.svd(centred)[1][2] / np.sqrt(16) < 0.3e-10
    assert speared_rings(small) == []
