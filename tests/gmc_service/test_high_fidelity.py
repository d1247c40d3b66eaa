"""Finite elements on the periodic cell against closed forms."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from gmc_service.high_fidelity import (
    default_refinement,
    grid_mesh,
    homogenise,
    homogenise_with_error,
    richardson,
)
from gmc_service.homogenised import Homogenised
from gmc_service.material import isotropic_stiffness
from gmc_service.verification.exact_axial_shear import checkerboard, square_quarter

FIBRE = isotropic_stiffness(276e9, 0.33)
MATRIX = isotropic_stiffness(2.963e9, 0.36)
CONTRAST = float(FIBRE[5, 5] / MATRIX[5, 5])
QUARTER = (np.ones(2), np.ones(2), np.array([FIBRE, MATRIX, MATRIX, MATRIX]), np.zeros((4, 6)))


def random_stiffness(random: np.random.Generator, count: int) -> np.ndarray:
    """Stiffness without any symmetry of the material, Pa, shape (count, 6, 6)."""
    factor = random.normal(size=(count, 6, 6))
    return (factor @ factor.transpose(0, 2, 1) + np.eye(6)) * 1e9


def square_cell(fraction: float) -> tuple[np.ndarray, ...]:
    sizes = np.array([np.sqrt(fraction), 1.0 - np.sqrt(fraction)])
    return sizes, sizes, QUARTER[2], QUARTER[3]


def laminate(shares: np.ndarray, stiffness: np.ndarray, expansion: np.ndarray, axis: int) -> Homogenised:
    """Exact constants of layers stacked along `axis`: stresses on the layers are shared, the other strains too."""
    shared = [1, 3, 5] if axis == 2 else [2, 3, 4]
    strains = [k for k in range(6) if k not in shared]
    # Per layer: unknown strains x along `shared` from sigma = C_ss x + C_st e - (C alpha)_s, the mean of x being given.
    soft = np.linalg.inv(stiffness[:, shared][:, :, shared])
    across = stiffness[:, shared][:, :, strains]
    locked = np.einsum("nij,nj->ni", stiffness, expansion)[:, shared]
    mean_soft = np.linalg.inv(np.einsum("n,nij->ij", shares, soft))
    mean_across = np.einsum("n,nij,njk->ik", shares, soft, across)
    mean_locked = np.einsum("n,nij,nj->i", shares, soft, locked)
    concentration = np.zeros((len(shares), 6, 6))
    thermal = np.zeros((len(shares), 6))
    for n in range(len(shares)):
        concentration[n][strains, strains] = 1.0
        concentration[n][np.ix_(shared, shared)] = soft[n] @ mean_soft
        concentration[n][np.ix_(shared, strains)] = soft[n] @ (mean_soft @ mean_across - across[n])
        thermal[n, shared] = soft[n] @ (locked[n] - mean_soft @ mean_locked)
    effective = np.einsum("n,nij,njk->ik", shares, stiffness, concentration)
    stress = np.einsum("n,nij,nj->i", shares, stiffness, thermal - expansion)
    return Homogenised(effective, -np.linalg.solve(effective, stress), concentration, thermal)


def assert_close(found: Homogenised, expected: Homogenised, tolerance: float) -> None:
    for name in ("stiffness", "expansion", "concentration", "thermal"):
        one, other = getattr(found, name), getattr(expected, name)
        assert np.abs(one - other).max() <= tolerance * max(np.abs(other).max(), 1e-6), name


def test_homogeneous_cell_gives_its_own_constants() -> None:
    random = np.random.default_rng(1)
    own = random_stiffness(random, 1)
    expansion = random.normal(size=6) * 1e-5
    found = homogenise(
        random.uniform(0.1, 1.0, 3),
        random.uniform(0.1, 1.0, 2),
        np.repeat(own, 6, axis=0),
        np.tile(expansion, (6, 1)),
        2,
    )
    whole = Homogenised(own[0], expansion, np.tile(np.eye(6), (6, 1, 1)), np.zeros((6, 6)))
    assert_close(found, whole, 1e-11)


@pytest.mark.parametrize("axis", [2, 3])
def test_layers_of_any_anisotropy_are_exact(axis: int) -> None:
    random = np.random.default_rng(axis)
    stiffness = random_stiffness(random, 4) * np.array([1.0, 30.0, 0.1, 4.0])[:, None, None]
    expansion = random.normal(size=(4, 6)) * 1e-5
    layers, whole = random.uniform(0.1, 1.0, 4), np.array([0.7])
    sizes = (layers, whole) if axis == 2 else (whole, layers)
    found = homogenise(*sizes, stiffness, expansion, 1)
    assert_close(found, laminate(layers / layers.sum(), stiffness, expansion, axis), 1e-10)


def test_axial_shear_of_square_fibres_is_obnosovs() -> None:
    exact = square_quarter(CONTRAST)
    errors = [homogenise(*QUARTER, n).stiffness[5, 5] / MATRIX[5, 5] / exact - 1.0 for n in (4, 8, 16)]
    assert 0.0 < errors[2] < 2e-5
    orders = np.log2(np.divide(errors[:2], errors[1:]))
    assert (orders > 3.0).all(), "the grading takes the corners' singularity away"


def test_axial_shear_of_a_checkerboard_is_the_geometric_mean() -> None:
    soft, stiff = isotropic_stiffness(1e9, 0.3), isotropic_stiffness(3e9, 0.2)
    found = homogenise(np.ones(2), np.ones(2), np.array([soft, stiff, stiff, soft]), np.zeros((4, 6)), 12).stiffness
    exact = soft[5, 5] * checkerboard(stiff[5, 5] / soft[5, 5])
    assert found[5, 5] == pytest.approx(exact, rel=1e-4)
    assert found[4, 4] == pytest.approx(exact, rel=1e-4)


def test_exchange_of_phases_obeys_kellers_theorem() -> None:
    """Axial shear along 2 times that along 3 with the phases exchanged is the product of the phases' moduli."""
    heights, widths = np.array([0.3, 0.5, 0.2]), np.array([0.6, 0.4])
    phase = np.array([0, 1, 0, 0, 1, 1])
    table = np.array([isotropic_stiffness(1e9, 0.3), isotropic_stiffness(8e9, 0.1)])
    one, other = (homogenise(heights, widths, table[p], np.zeros((6, 6)), 8).stiffness for p in (phase, 1 - phase))
    assert one[5, 5] * other[4, 4] == pytest.approx(table[0, 5, 5] * table[1, 5, 5], rel=1e-3)


def test_moduli_of_the_2x2_cell_agree_with_other_finite_elements() -> None:
    """E22 and G12 of IM7 and neat EPON 862 at 0.6, computed by another periodic code."""
    compliance = np.linalg.inv(homogenise(*square_cell(0.6)).stiffness)
    assert 1.0 / compliance[1, 1] == pytest.approx(17125.36e6, rel=1e-3)
    assert 1.0 / compliance[5, 5] == pytest.approx(4342.189e6, rel=1e-3)


def test_stiffness_falls_to_its_limit_from_above() -> None:
    cells = [homogenise(*square_cell(0.6), n).stiffness for n in (2, 4, 8)]
    for coarse, fine in itertools.pairwise(cells):
        assert np.linalg.eigvalsh(coarse - fine)[0] > -1e-10 * fine[0, 0]


@pytest.mark.parametrize("contrast", [1.0 / 93.0, 3.0, 93.0, 300.0])
def test_stated_error_is_above_the_true_one(contrast: float) -> None:
    """Of the axial shear of square fibres and of a checkerboard, exact; the latter converges slowly."""
    for phase, exact in ([0, 1, 1, 1], square_quarter(contrast)), ([0, 1, 1, 0], checkerboard(contrast)):
        stiffness = np.array([contrast * MATRIX, MATRIX])[phase]
        stated = homogenise_with_error(np.ones(2), np.ones(2), stiffness, np.zeros((4, 6)), 4)
        true = stated.homogenised.stiffness[5, 5] / MATRIX[5, 5] / exact - 1.0
        assert 0.0 < true < stated.error


def test_stated_error_is_small_where_the_mesh_resolves_the_corners() -> None:
    assert homogenise_with_error(*QUARTER, 8).error < 5e-3


def test_richardson_finds_limit_and_order_of_a_power() -> None:
    limit, order = richardson(5.0 + 3.0 * np.array([0.2, 0.1, 0.05]) ** 2.5)
    assert limit == pytest.approx(5.0, abs=1e-12)
    assert order == pytest.approx(2.5, abs=1e-10)
    with pytest.raises(ValueError, match="move one way"):
        richardson(np.array([1.0, 2.0, 1.5]))


def test_expansion_of_two_phases_follows_from_the_stiffness() -> None:
    """Levin's relation is exact for two phases, whatever the geometry and the mesh."""
    random = np.random.default_rng(3)
    table, expansion = random_stiffness(random, 2), random.normal(size=(2, 6)) * 1e-5
    phase = np.array([0, 1, 1, 1, 0, 1, 1, 1, 1])
    sizes = random.uniform(0.2, 1.0, (2, 3))
    found = homogenise(*sizes, table[phase], expansion[phase], 2)
    first, second, whole = (np.linalg.inv(c) for c in (table[0], table[1], found.stiffness))
    levin = expansion[1] + (whole - second) @ np.linalg.solve(first - second, expansion[0] - expansion[1])
    assert np.abs(found.expansion - levin).max() < 1e-9 * np.abs(levin).max()


def test_means_of_the_subcells_carry_the_whole() -> None:
    random = np.random.default_rng(4)
    heights, widths = random.uniform(0.2, 1.0, 2), random.uniform(0.2, 1.0, 3)
    stiffness, expansion = random_stiffness(random, 6), random.normal(size=(6, 6)) * 1e-5
    found = homogenise(heights, widths, stiffness, expansion, 2)
    shares = (np.outer(heights, widths) / (heights.sum() * widths.sum())).reshape(-1)
    assert np.abs(np.einsum("n,nij->ij", shares, found.concentration) - np.eye(6)).max() < 1e-12
    assert np.abs(shares @ found.thermal).max() < 1e-17
    stress = np.einsum("n,nij,njk->ik", shares, stiffness, found.concentration)
    assert np.abs(stress - found.stiffness).max() < 1e-11 * np.abs(found.stiffness).max()
    of_change = np.einsum("n,nij,nj->i", shares, stiffness, found.thermal - expansion)
    assert np.abs(of_change + found.stiffness @ found.expansion).max() < 1e-11 * np.abs(of_change).max()


def test_transposed_cell_swaps_axes_2_and_3() -> None:
    random = np.random.default_rng(5)
    heights, widths = random.uniform(0.2, 1.0, 2), random.uniform(0.2, 1.0, 3)
    stiffness, expansion = random_stiffness(random, 6), random.normal(size=(6, 6)) * 1e-5
    swap = [0, 2, 1, 3, 5, 4]
    other = np.arange(6).reshape(2, 3).T.reshape(-1)
    one = homogenise(heights, widths, stiffness, expansion, 2)
    two = homogenise(widths, heights, stiffness[other][:, swap][:, :, swap], expansion[other][:, swap], 2)
    assert np.abs(two.stiffness - one.stiffness[np.ix_(swap, swap)]).max() < 1e-11 * one.stiffness.max()
    assert np.abs(two.expansion - one.expansion[swap]).max() < 1e-16


def test_uncoupled_and_coupled_equations_give_the_same() -> None:
    """A trace of coupling of axial shear with the rest makes one system of the two, and changes next to nothing."""
    uncoupled = homogenise(*square_cell(0.6), 3).stiffness
    heights, widths, stiffness, expansion = square_cell(0.6)
    traced = stiffness.copy()
    traced[:, 5, 1] = traced[:, 1, 5] = 1e-3
    coupled = homogenise(heights, widths, traced, expansion, 3).stiffness
    assert np.abs(coupled - uncoupled).max() < 1e-11 * uncoupled.max()


@pytest.mark.parametrize("contrast", [1e-4, 1e-8, 1e-12])
@pytest.mark.parametrize("failed", [[0], [3], [1, 2], [1, 2, 3], [0, 1, 2, 3]])
def test_failed_subcells_stay_finite_and_bounded(contrast: float, failed: list[int]) -> None:
    heights, widths, stiffness, _ = square_cell(0.6)
    stiffness = stiffness.copy()
    stiffness[failed] *= contrast
    expansion = np.array([[1e-6] * 3 + [0.0] * 3] + [[5e-5] * 3 + [0.0] * 3] * 3)
    found = homogenise(heights, widths, stiffness, expansion, 4)
    for values in (found.stiffness, found.expansion, found.concentration, found.thermal):
        assert np.isfinite(values).all()
    assert (found.stiffness == found.stiffness.T).all()
    shares = np.outer(heights, widths).reshape(-1)
    voigt = np.einsum("n,nij->ij", shares, stiffness)
    reuss = np.linalg.inv(np.einsum("n,nij->ij", shares, np.linalg.inv(stiffness)))
    slack = 1e-9
    scale = np.sqrt(np.outer(np.diag(voigt), np.diag(voigt)))
    assert np.linalg.eigvalsh((voigt - found.stiffness) / scale)[0] > -slack
    scale = np.sqrt(np.outer(np.diag(found.stiffness), np.diag(found.stiffness)))
    assert np.linalg.eigvalsh((found.stiffness - reuss) / scale)[0] > -slack
    assert found.expansion[:3].min() > 0.99e-6 and found.expansion[:3].max() < 5.5e-5


def test_all_failed_is_the_intact_cell_times_the_factor() -> None:
    heights, widths, stiffness, expansion = square_cell(0.6)
    intact = homogenise(heights, widths, stiffness, expansion, 4).stiffness
    failed = homogenise(heights, widths, 1e-4 * stiffness, expansion, 4).stiffness
    assert np.abs(failed / 1e-4 - intact).max() < 1e-11 * intact.max()


def test_thin_subcells_and_nearly_incompressible_matrix_stay_near_the_cell_without_them() -> None:
    rubber = isotropic_stiffness(1e9, 0.499999)
    plain = (np.array([0.7, 0.3]), np.array([0.7, 0.3]))
    thin = (np.array([0.7, 1e-7, 0.3]), np.array([0.7, 1e-7, 0.3]))
    reference = homogenise(*plain, np.array([FIBRE, rubber, rubber, rubber]), np.zeros((4, 6)), 6).stiffness
    # Thin subcells widen the fibre by a share of 1e-7.
    phase = np.array([0, 0, 1, 0, 0, 1, 1, 1, 1])
    found = homogenise(*thin, np.array([FIBRE, rubber])[phase], np.zeros((9, 6)), 6).stiffness
    assert np.abs(found - reference).max() < 1e-5 * reference.max()
    assert np.linalg.eigvalsh(found)[0] > 0.0


@pytest.mark.parametrize("contrast", [1e-8, 1e-16])
def test_equal_expansion_stays_equal_where_the_cell_is_almost_a_mechanism(contrast: float) -> None:
    """A strip of 1e-9 of the width and failed subcells hold the cell together; expansion causes no stress."""
    sizes = np.array([0.7, 1e-9, 0.3])
    stiffness = np.array([FIBRE, MATRIX])[[0, 0, 1, 0, 0, 1, 1, 1, 1]]
    stiffness[[2, 8]] *= contrast
    expansion = np.tile([1e-5, 1e-5, 1e-5, 0.0, 0.0, 0.0], (9, 1))
    found = homogenise(sizes, sizes, stiffness, expansion)
    assert found.expansion == pytest.approx(expansion[0], rel=1e-9, abs=1e-14)
    scale = 1.0 / np.sqrt(np.diag(found.stiffness))
    assert np.linalg.eigvalsh(found.stiffness * np.outer(scale, scale))[0] > 0.1


def test_mesh_covers_each_subcell() -> None:
    heights, widths = np.array([0.2, 0.5]), np.array([0.3, 0.1, 0.6])
    mesh = grid_mesh(heights, widths, 3)
    size = mesh.points[:, 8] - mesh.points[:, 0]
    assert np.bincount(mesh.subcell, size.prod(axis=1)) == pytest.approx(np.outer(heights, widths).reshape(-1))
    assert len(np.unique(mesh.nodes)) == (2 * 6) * (2 * 9)


@pytest.mark.parametrize(("cells", "expected"), [((2, 2), 8), ((7, 7), 3), ((26, 26), 1), ((1, 40), 3)])
def test_default_refinement_keeps_the_work_bounded(cells: tuple[int, int], expected: int) -> None:
    assert default_refinement(*cells) == expected


@pytest.mark.parametrize(
    ("heights", "refinement", "message"),
    [([1.0, 0.0], 2, "heights"), ([1.0, np.nan], 2, "heights"), ([1.0, 1.0], 0, "refinement is 0")],
)
def test_bad_input_is_named(heights: list[float], refinement: int, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        homogenise(np.array(heights), np.ones(2), QUARTER[2], QUARTER[3], refinement)
