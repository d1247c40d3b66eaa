"""What must hold for the generalized method of cells on any cell."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st
from random_cells import RandomCell, random_cells

from gmc_service import gmc_dense, gmc_reduced, high_fidelity
from gmc_service.homogenised import Homogenise
from gmc_service.material import isotropic_stiffness

METHODS = {"dense": gmc_dense.homogenise, "reduced": gmc_reduced.homogenise}
#: Order of the six components after axes 2 and 3 changed places.
SWAPPED = [0, 2, 1, 3, 5, 4]


@pytest.fixture(params=METHODS)
def homogenise(request: pytest.FixtureRequest) -> Homogenise:
    return METHODS[request.param]


def close(found: np.ndarray, wanted: np.ndarray, tolerance: float = 1e-9) -> bool:
    return bool(np.abs(found - wanted).max() <= tolerance * max(np.abs(wanted).max(), 1e-300))


@given(random_cells(most=5))
@settings(max_examples=60, deadline=None)
def test_the_two_formulations_agree(cell: RandomCell) -> None:
    dense, reduced = gmc_dense.homogenise(*cell.arguments), gmc_reduced.homogenise(*cell.arguments)
    assert close(reduced.stiffness, dense.stiffness, 1e-10)
    assert close(reduced.expansion, dense.expansion, 1e-10)
    assert close(reduced.concentration, dense.concentration, 1e-10)
    # Strains of the subcells at no macroscopic strain are differences of expansions: these set the scale.
    assert np.abs(reduced.thermal - dense.thermal).max() <= 1e-10 * np.abs(cell.expansion).max()


@given(random_cells())
@settings(max_examples=40, deadline=None)
def test_stiffness_lies_between_reuss_and_voigt(cell: RandomCell) -> None:
    for homogenise in METHODS.values():
        effective = homogenise(*cell.arguments).stiffness
        voigt = np.einsum("n,nij->ij", cell.fractions, cell.stiffness)
        reuss = np.linalg.inv(np.einsum("n,nij->ij", cell.fractions, np.linalg.inv(cell.stiffness)))
        assert np.array_equal(effective, effective.T)
        # In the sense of energies: for every macroscopic strain.
        assert scipy.linalg.eigh(effective, voigt, eigvals_only=True)[-1] <= 1.0 + 1e-9
        assert scipy.linalg.eigh(effective, reuss, eigvals_only=True)[0] >= 1.0 - 1e-9


@given(random_cells(most=3))
@settings(max_examples=25, deadline=None)
def test_energy_is_at_most_that_of_finite_elements(cell: RandomCell) -> None:
    # The piecewise constant stress is in equilibrium, so it bounds the exact energy from below; displacements of
    # finite elements bound it from above.
    below = gmc_reduced.homogenise(*cell.arguments).stiffness
    above = high_fidelity.homogenise(*cell.arguments).stiffness
    assert scipy.linalg.eigh(below, above, eigvals_only=True)[-1] <= 1.0 + 1e-9


@given(random_cells())
@settings(max_examples=40, deadline=None)
def test_mean_strain_and_stress_of_subcells_are_the_macroscopic_ones(cell: RandomCell) -> None:
    for homogenise in METHODS.values():
        found = homogenise(*cell.arguments)
        assert close(np.einsum("n,nij->ij", cell.fractions, found.concentration), np.eye(6))
        stress = cell.stiffness @ found.concentration
        assert close(np.einsum("n,nij->ij", cell.fractions, stress), found.stiffness)
        assert np.abs(cell.fractions @ found.thermal).max() <= 1e-9 * np.abs(cell.expansion).max()


@given(random_cells())
@settings(max_examples=40, deadline=None)
def test_levin(cell: RandomCell) -> None:
    # Levin (1967): the macroscopic thermal stress is the mean of the subcells' own, weighted with the concentration.
    for homogenise in METHODS.values():
        found = homogenise(*cell.arguments)
        own = np.einsum("nij,nj->ni", cell.stiffness, cell.expansion)
        levin = np.einsum("n,nji,nj->i", cell.fractions, found.concentration, own)
        assert close(found.stiffness @ found.expansion, levin)
        # And the other way, by the strains that the subcells have when the macroscopic strain is held at zero.
        locked = np.einsum("n,ni->i", cell.fractions, np.einsum("nij,nj->ni", cell.stiffness, found.thermal) - own)
        assert close(-locked, levin)


@given(random_cells(most=3), st.integers(0, 2), st.floats(0.1, 0.9))
@settings(max_examples=40, deadline=None)
def test_subdividing_a_row_changes_nothing(cell: RandomCell, row: int, share: float) -> None:
    row %= len(cell.heights)
    heights = np.insert(cell.heights, row, share * cell.heights[row])
    heights[row + 1] *= 1.0 - share
    twice = np.insert(np.arange(len(cell.heights)), row, row)

    def divided(values: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(values.reshape(*cell.shape, *values.shape[1:])[twice]).reshape(
            -1, *values.shape[1:]
        )

    for homogenise in METHODS.values():
        before = homogenise(*cell.arguments)
        after = homogenise(heights, cell.widths, divided(cell.stiffness), divided(cell.expansion))
        assert close(after.stiffness, before.stiffness)
        assert close(after.expansion, before.expansion)
        assert close(after.concentration, divided(before.concentration))


@given(random_cells(), st.randoms(use_true_random=False))
@settings(max_examples=40, deadline=None)
def test_order_of_rows_and_columns_does_not_matter(cell: RandomCell, random: object) -> None:
    rows, columns = list(range(len(cell.heights))), list(range(len(cell.widths)))
    random.shuffle(rows)  # type: ignore[attr-defined]
    random.shuffle(columns)  # type: ignore[attr-defined]

    def moved(values: np.ndarray) -> np.ndarray:
        table = values.reshape(*cell.shape, *values.shape[1:])
        return np.ascontiguousarray(table[rows][:, columns]).reshape(-1, *values.shape[1:])

    for homogenise in METHODS.values():
        before = homogenise(*cell.arguments)
        after = homogenise(cell.heights[rows], cell.widths[columns], moved(cell.stiffness), moved(cell.expansion))
        assert close(after.stiffness, before.stiffness)
        assert close(after.expansion, before.expansion)
        assert close(after.concentration, moved(before.concentration))


@given(random_cells())
@settings(max_examples=40, deadline=None)
def test_transposing_the_cell_swaps_axes_2_and_3(cell: RandomCell) -> None:
    def turned(values: np.ndarray) -> np.ndarray:
        table = np.swapaxes(values.reshape(*cell.shape, *values.shape[1:]), 0, 1)
        return np.ascontiguousarray(table).reshape(-1, *values.shape[1:])

    swap = np.ix_(SWAPPED, SWAPPED)
    stiffness = turned(cell.stiffness)[:, SWAPPED][:, :, SWAPPED]
    for homogenise in METHODS.values():
        before = homogenise(*cell.arguments)
        after = homogenise(
            cell.widths, cell.heights, np.ascontiguousarray(stiffness), turned(cell.expansion)[:, SWAPPED]
        )
        assert close(after.stiffness, before.stiffness[swap])
        assert close(after.expansion, before.expansion[SWAPPED])


def test_one_material_gives_back_its_own_constants(homogenise: Homogenise) -> None:
    random = np.random.default_rng(3)
    root = random.normal(size=(6, 6))
    own = (root @ root.T + np.eye(6)) * 1e9
    expansion = random.normal(size=6) * 1e-5
    found = homogenise(
        np.array([0.2, 1.0, 0.5]), np.array([0.7, 0.1]), np.tile(own, (6, 1, 1)), np.tile(expansion, (6, 1))
    )
    assert close(found.stiffness, own, 1e-12)
    assert close(found.expansion, expansion, 1e-12)
    assert close(found.concentration, np.tile(np.eye(6), (6, 1, 1)), 1e-12)


@pytest.mark.parametrize("orthotropic", [True, False])
def test_layers_are_exact(homogenise: Homogenise, orthotropic: bool) -> None:
    """A stack along axis 2 has a closed form: strains 11, 33, 13 and stresses 22, 23, 12 are common to all layers."""
    random = np.random.default_rng(5)
    heights, count = np.array([0.3, 0.5, 0.2]), 3
    stiffness = np.empty((count, 6, 6))
    for one in stiffness:
        root = random.normal(size=(6, 6))
        one[:] = (root @ root.T + np.eye(6)) * 1e9
        if orthotropic:
            one[:3, 3:] = one[3:, :3] = 0.0
            one[3:, 3:] = np.diag(np.diag(one[3:, 3:]))
    common, through = [0, 2, 4], [1, 3, 5]
    mixed = np.zeros((6, 6))
    for share, one in zip(heights, stiffness, strict=True):
        inverse = np.linalg.inv(one[np.ix_(through, through)])
        coupling = one[np.ix_(common, through)] @ inverse
        mixed[:3, :3] += share * (one[np.ix_(common, common)] - coupling @ one[np.ix_(through, common)])
        mixed[:3, 3:] += share * coupling
        mixed[3:, 3:] += share * inverse
    mixed[3:, :3] = mixed[:3, 3:].T
    wanted = np.zeros((6, 6))
    stiff = np.linalg.inv(mixed[3:, 3:])
    wanted[np.ix_(through, through)] = stiff
    wanted[np.ix_(common, through)] = mixed[:3, 3:] @ stiff
    wanted[np.ix_(through, common)] = wanted[np.ix_(common, through)].T
    wanted[np.ix_(common, common)] = mixed[:3, :3] + mixed[:3, 3:] @ stiff @ mixed[3:, :3]
    found = homogenise(heights, np.array([1.0]), stiffness, np.zeros((count, 6)))
    assert close(found.stiffness, wanted, 1e-12)


def test_many_states_are_those_of_one_by_one() -> None:
    random = np.random.default_rng(7)
    table = np.array([isotropic_stiffness(276e9, 0.33), isotropic_stiffness(3e9, 0.36), isotropic_stiffness(3e5, 0.36)])
    heights, widths = random.uniform(0.5, 1.0, 4), random.uniform(0.5, 1.0, 6)
    choices = random.integers(0, 3, (20, 24))
    many = gmc_reduced.effective_stiffness_many(heights, widths, table, choices)
    for state, choice in zip(many, choices, strict=True):
        one = gmc_dense.homogenise(heights, widths, table[choice], np.zeros((24, 6))).stiffness
        assert close(state, one, 1e-10)


@pytest.mark.parametrize(
    ("choices", "problem"),
    [
        (np.zeros((3, 4), np.int64), r"choices has shape \(3, 4\); it must have \(states, 6\)"),
        (np.full((1, 6), 2), "choices holds 2 to 2; allowed is 0 to 1"),
        (np.full((1, 6), -1), "choices holds -1 to -1; allowed is 0 to 1"),
    ],
)
def test_wrong_choices_are_named(choices: np.ndarray, problem: str) -> None:
    table = np.array([isotropic_stiffness(1e9, 0.3)] * 2)
    with pytest.raises(ValueError, match=problem):
        gmc_reduced.effective_stiffness_many(np.ones(2), np.ones(3), table, choices)


def test_many_states_refuse_coupled_stiffness() -> None:
    table = np.array([isotropic_stiffness(1e9, 0.3)])
    table[0, 0, 5] = table[0, 5, 0] = 1e8
    with pytest.raises(ValueError, match="stiffness must be orthotropic"):
        gmc_reduced.effective_stiffness_many(np.ones(1), np.ones(1), table, np.zeros((1, 1), np.int64))
