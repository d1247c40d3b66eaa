"""The large lattice that case `phonon` is held against: its springs, its energy, its waves."""

from __future__ import annotations

import numpy as np

from coordinator.verification_cases.chain import BOND, SPACING
from coordinator.verification_cases.phonon import _pair, _stiffness, unbounded
from coordinator.verification_cases.whole_lattice import Lattice
from protocol.arrays import FloatArray


def hexagonal(rows: int, columns: int) -> FloatArray:
    j, i = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    return np.column_stack([(i + 0.5 * (j % 2)).ravel() * SPACING, j.ravel() * SPACING * np.sqrt(0.75)])


def test_the_stiffness_matrix_is_that_of_the_springs() -> None:
    lattice = Lattice.of(hexagonal(6, 7), SPACING)
    matrix = _stiffness(lattice)
    way = 1e-12 * np.random.default_rng(1).normal(size=lattice.place.shape)
    quadratic = 0.5 * float(way.ravel() @ (matrix @ way.ravel()))
    springs = 0.5 * BOND * float(np.sum(lattice.stretches(way) ** 2))
    np.testing.assert_allclose(quadratic, springs, rtol=1e-12)
    moved = np.tile([1e-12, -2e-12], len(lattice.place))
    assert np.abs(matrix @ moved).max() < 1e-12 * BOND * 1e-12


def test_the_pair_is_two_neighbours_in_the_middle() -> None:
    place = hexagonal(9, 10)
    moved = _pair(place)
    (one, other) = np.flatnonzero(np.any(moved != 0.0, axis=1))
    assert np.isclose(np.linalg.norm(place[one] - place[other]), SPACING)
    np.testing.assert_array_equal(moved.sum(axis=0), [0.0, 0.0])
    assert np.linalg.norm(place[one] - place.mean(axis=0)) < 1.6 * SPACING


def test_waves_leave_the_inner_atoms_after_the_time_that_they_need_and_none_comes_back() -> None:
    inside = hexagonal(25, 21)  # about 72 Angstrom wide: waves of 24 km/s at most need 0.15 ps to the border
    decay = unbounded(inside, np.array([0.0, 0.05, 0.1, 0.6, 1.2]) * 1e-12)
    np.testing.assert_allclose(decay.energy[:3], 1.0, atol=0.02)
    assert decay.energy[3] < 0.6
    assert decay.energy[4] < 0.5 * decay.energy[3]
