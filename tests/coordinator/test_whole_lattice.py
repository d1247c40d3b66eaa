"""The lattices that coupled runs are held against, by closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from coordinator.verification_cases.k_field import k_displacement
from coordinator.verification_cases.swap import bonded_lattice
from coordinator.verification_cases.whole_lattice import Lattice, lengthened

A = 3.45e-10


def sheet(half_size: float, start: float = 0.3 * A) -> np.ndarray:
    """Close-packed rows along x, one of them at y = 0."""
    row, column = np.meshgrid(np.arange(-60, 61), np.arange(-60, 61), indexing="ij")
    place = np.column_stack(
        [start + (column + 0.5 * (row % 2)).ravel() * A, (0.5 * np.sqrt(3.0) * A * row).ravel()]
    )  # fmt: skip
    return place[(np.abs(place) < half_size).all(axis=1)]


def test_uniform_strain_passes_a_lattice_unchanged() -> None:
    lattice = Lattice.of(sheet(20 * A), A)
    strain = np.array([[1e-3, 4e-4], [4e-4, -2e-3]])
    given = lattice.place @ strain.T
    at_border = (np.abs(lattice.place) > 18 * A).any(axis=1)
    found = lattice.at_rest(given, at_border)
    np.testing.assert_allclose(found, given, rtol=0.0, atol=1e-10 * np.abs(given).max())
    expected = A * np.einsum("bi,ij,bj->b", lattice.directions, strain, lattice.directions)
    np.testing.assert_allclose(lattice.stretches(found), expected, rtol=0.0, atol=1e-10 * np.abs(expected).max())
    # Six neighbours inside, so three bonds an atom.
    assert len(lattice.bonds) == pytest.approx(3 * len(lattice.place), rel=0.05)


def test_lattice_without_a_load_on_it_stays_where_it_is() -> None:
    lattice = Lattice.of(sheet(8 * A), A)
    found = lattice.at_rest(np.zeros_like(lattice.place), np.abs(lattice.place[:, 1]) > 6 * A)
    np.testing.assert_array_equal(found, 0.0)


def test_lengthened_lattice_begins_with_the_sample_and_has_its_slit() -> None:
    whole = sheet(40 * A)
    slit = (np.abs(whole[:, 1]) < 1.4 * A) & (whole[:, 0] < 0.0)
    cracked = whole[~slit]
    sample = cracked[(np.abs(cracked) < 15 * A).all(axis=1)][::-1]
    found = lengthened(sample, A, 40 * A, 0.0, 0.0, 3)
    np.testing.assert_array_equal(found[: len(sample)], sample)
    order, wanted = np.lexsort(np.round(found / A, 6).T), np.lexsort(np.round(cracked / A, 6).T)
    np.testing.assert_allclose(found[order], cracked[wanted], rtol=0.0, atol=1e-6 * A)


def test_sample_of_another_lattice_is_refused() -> None:
    with pytest.raises(ValueError, match="from all sites"):
        lengthened(1.01 * sheet(15 * A), A, 40 * A, -100 * A, 0.0, 3)


def test_k_displacement_opens_the_crack_as_irwin_says() -> None:
    young, poisson, k_1 = 1e12, 1.0 / 3.0, 2e5
    r = np.array([1e-9, 4e-9])
    upper = k_displacement(np.column_stack([-r, np.zeros(2)]), k_1, young, poisson)
    np.testing.assert_allclose(upper[:, 1], 4.0 * k_1 / young * np.sqrt(r / (2.0 * np.pi)), rtol=1e-12)
    np.testing.assert_allclose(upper[:, 0], 0.0, atol=1e-12 * upper[:, 1].max())
    # Ahead of the tip strains are those of equal stresses along both axes, K / sqrt(2 pi r).
    h = 1e-14
    ahead = k_displacement(np.array([[1e-9 + h, 0.0], [1e-9 - h, 0.0]]), k_1, young, poisson)
    stress = k_1 / np.sqrt(2.0 * np.pi * 1e-9)
    assert (ahead[0, 0] - ahead[1, 0]) / (2.0 * h) == pytest.approx((1.0 - poisson) * stress / young, rel=1e-6)


def test_springs_of_a_lattice_are_the_bonds_of_a_file() -> None:
    place = np.column_stack([sheet(6 * A), np.zeros(len(sheet(6 * A)))])
    lines = bonded_lattice(place).splitlines()
    assert lines[2] == f"{len(place)} atoms" and lines[4] == f"{len(Lattice.of(place[:, :2], A).bonds)} bonds"
    rows = [line.split() for line in lines[lines.index("Bonds") + 2 :]]
    ends = np.array(rows, dtype=np.int64)[:, 2:] - 1
    lengths = np.linalg.norm(place[ends[:, 0]] - place[ends[:, 1]], axis=1)
    np.testing.assert_allclose(lengths, A, rtol=1e-9)
