"""Mori-Tanaka against closed forms of composite cylinders, another code and relations that hold for any geometry."""

from __future__ import annotations

import numpy as np
import pytest

from gmc_service.architectures import square_pack
from gmc_service.engineering_constants import EngineeringConstants, engineering_constants
from gmc_service.material import isotropic_stiffness
from gmc_service.mori_tanaka import find_matrix, hill_tensor, homogenise

FIBRE = isotropic_stiffness(276e9, 0.33)
MATRIX = isotropic_stiffness(2.963e9, 0.36)


def two_phases(fraction: float, fibre: np.ndarray, matrix: np.ndarray, expansion: np.ndarray | None = None):
    """A square fibre in matrix, homogenised by shares."""
    sizes = np.array([np.sqrt(fraction), 1.0 - np.sqrt(fraction)])
    phase = [0, 1, 1, 1]
    given = np.zeros((2, 6)) if expansion is None else expansion
    return homogenise(sizes, sizes, np.array([fibre, matrix])[phase], given[phase])


@pytest.mark.parametrize("fraction", [0.05, 0.4, 0.6, 0.9])
def test_composite_cylinders_of_hashin_and_rosen(fraction: float) -> None:
    """Plane-strain bulk modulus, G12, E11 and nu12 of the composite cylinder assemblage (Hashin and Rosen 1964)."""
    (young_f, nu_f), (young_m, nu_m) = (276e9, 0.33), (2.963e9, 0.36)
    shear_f, shear_m = young_f / (2.0 * (1.0 + nu_f)), young_m / (2.0 * (1.0 + nu_m))
    bulk_f, bulk_m = shear_f / (1.0 - 2.0 * nu_f), shear_m / (1.0 - 2.0 * nu_m)
    rest = 1.0 - fraction
    bulk = bulk_m + fraction / (1.0 / (bulk_f - bulk_m) + rest / (bulk_m + shear_m))
    shear = shear_m + fraction / (1.0 / (shear_f - shear_m) + rest / (2.0 * shear_m))
    share = rest / bulk_f + fraction / bulk_m + 1.0 / shear_m
    young = fraction * young_f + rest * young_m + 4.0 * fraction * rest * (nu_f - nu_m) ** 2 / share
    poisson = fraction * nu_f + rest * nu_m
    poisson += fraction * rest * (nu_f - nu_m) * (1.0 / bulk_m - 1.0 / bulk_f) / share
    stiffness = two_phases(fraction, FIBRE, MATRIX).stiffness
    found = engineering_constants(stiffness)
    assert 0.5 * (stiffness[1, 1] + stiffness[1, 2]) == pytest.approx(bulk, rel=1e-12)
    assert pytest.approx(shear, rel=1e-12) == found.G12
    assert pytest.approx(young, rel=1e-12) == found.E11
    assert found.nu12 == pytest.approx(poisson, rel=1e-12)


@pytest.mark.parametrize("fraction", [0.1, 0.6])
def test_transverse_shear_is_the_lower_bound_of_hashin(fraction: float) -> None:
    """G23 of soft matrix around stiff fibres is Hashin's (1965) lower bound."""
    soft, stiff = float(MATRIX[3, 3]), float(FIBRE[3, 3])
    bulk = 0.5 * float(MATRIX[1, 1] + MATRIX[1, 2])
    bound = soft + fraction / (
        1.0 / (stiff - soft) + (bulk + 2.0 * soft) * (1.0 - fraction) / (2.0 * soft * (bulk + soft))
    )
    assert two_phases(fraction, FIBRE, MATRIX).stiffness[3, 3] == pytest.approx(bound, rel=1e-12)


def test_transversely_isotropic_fibre_agrees_with_another_code() -> None:
    """Printed by HomoComPy 1.1.1: mori_tanaka(0.5, 230, 20, 0.2, 30, 7, 4, 0.3)."""
    across = 20.0 / (2.0 * 7.0) - 1.0
    fibre = EngineeringConstants(230.0, 20.0, 20.0, 0.2, 0.2, across, 30.0, 30.0, 7.0).stiffness()
    found = engineering_constants(two_phases(0.5, fibre, isotropic_stiffness(4.0, 0.3)).stiffness)
    printed = (117.01237281362393, 7.955159558965277, 0.24370369801112785)
    assert (found.E11, found.E22, found.nu12) == pytest.approx(printed, rel=1e-12)
    printed = (0.41355531287724334, 4.068376068376068, 2.8138833643420798)
    assert (found.nu23, found.G12, found.G23) == pytest.approx(printed, rel=1e-12)


def test_eshelby_tensor_of_a_cylinder() -> None:
    """Isotropic matrix: the components of Mura, Micromechanics of Defects in Solids (1987), Eq 11.22 with a1 = a2."""
    nu = 0.36
    eshelby = hill_tensor(MATRIX) @ MATRIX
    below = 8.0 * (1.0 - nu)
    expected = np.zeros((6, 6))
    expected[1, 1] = expected[2, 2] = (5.0 - 4.0 * nu) / below
    expected[1, 2] = expected[2, 1] = (4.0 * nu - 1.0) / below
    expected[1, 0] = expected[2, 0] = 4.0 * nu / below
    expected[3, 3] = 2.0 * (3.0 - 4.0 * nu) / below
    expected[4, 4] = expected[5, 5] = 0.5
    assert np.abs(eshelby - expected).max() < 1e-13


def test_hill_tensor_where_axial_shear_depends_on_direction() -> None:
    """Mean of cos^2 / (a cos^2 + b sin^2) is 1 / (a + sqrt(a b))."""
    along, across = 9e9, 0.25e9
    matrix = MATRIX.copy()
    matrix[5, 5], matrix[4, 4] = along, across
    found = hill_tensor(matrix)
    assert found[5, 5] == pytest.approx(1.0 / (along + np.sqrt(along * across)), rel=1e-11)
    assert found[4, 4] == pytest.approx(1.0 / (across + np.sqrt(along * across)), rel=1e-11)


def test_hill_tensor_that_does_not_settle_is_an_error() -> None:
    matrix = MATRIX.copy()
    matrix[4, 4] *= 1e-14
    with pytest.raises(ValueError, match="varies too much with direction"):
        hill_tensor(matrix)


def test_expansion_of_two_phases_follows_from_the_stiffness() -> None:
    """Levin's relation, exact for two phases of any geometry."""
    expansion = np.array([[-0.68e-6, 9.74e-6, 9.74e-6, 0, 0, 0], [45e-6, 45e-6, 45e-6, 0, 0, 0]])
    found = two_phases(0.65, FIBRE, MATRIX, expansion)
    first, second, whole = (np.linalg.inv(c) for c in (FIBRE, MATRIX, found.stiffness))
    levin = expansion[1] + (whole - second) @ np.linalg.solve(first - second, expansion[0] - expansion[1])
    assert np.abs(found.expansion - levin).max() < 1e-12 * np.abs(levin).max()


def test_several_phases_carry_the_whole() -> None:
    random = np.random.default_rng(6)
    factor = random.normal(size=(9, 6, 6))
    stiffness = (factor @ factor.transpose(0, 2, 1) + np.eye(6)) * 1e9
    expansion = random.normal(size=(9, 6)) * 1e-5
    sizes = random.uniform(0.2, 1.0, (2, 3))
    found = homogenise(*sizes, stiffness, expansion)
    shares = (np.outer(*sizes) / np.outer(*sizes).sum()).reshape(-1)
    assert np.abs(np.einsum("n,nij->ij", shares, found.concentration) - np.eye(6)).max() < 1e-12
    assert np.abs(shares @ found.thermal).max() < 1e-17
    stress = np.einsum("n,nij,njk->ik", shares, stiffness, found.concentration)
    # Not made symmetric before it is compared: aligned cylinders make it so.
    assert np.abs(stress - found.stiffness).max() < 1e-10 * np.abs(stress).max()
    of_change = np.einsum("n,nij,nj->i", shares, stiffness, found.thermal - expansion)
    assert np.abs(of_change + found.stiffness @ found.expansion).max() < 1e-10 * np.abs(of_change).max()


def test_homogeneous_cell_gives_its_own_constants() -> None:
    found = homogenise(np.array([0.3, 0.7]), np.ones(2), np.tile(MATRIX, (4, 1, 1)), np.full((4, 6), 1e-5))
    assert np.abs(found.stiffness - MATRIX).max() < 1e-12 * MATRIX.max()
    assert found.expansion == pytest.approx(np.full(6, 1e-5), rel=1e-12)


@pytest.mark.parametrize("subcells", [2, 7, 26])
def test_matrix_is_the_phase_that_runs_through_the_cell(subcells: int) -> None:
    cell = square_pack(subcells, 0.75)
    for phase in (cell.phase, 1 - cell.phase):
        fractions = np.array([(phase == k).mean() for k in range(2)])
        assert find_matrix(phase, fractions) == phase[-1, -1]


@pytest.mark.parametrize(
    ("phase", "share", "matrix"),
    [
        ([[0, 1], [2, 1]], [0.6, 0.2, 0.2], 1),  # one failed: the column that is whole
        ([[0, 1], [1, 2]], [0.6, 0.3, 0.1], 1),  # the corner failed: the rest touches by corners
        ([[0, 2], [2, 2]], [0.6, 0.0, 0.4], 2),  # all failed
        ([[0], [1]], [0.6, 0.4], 0),  # layers both run through along one axis
        ([[0, 1], [1, 0]], [0.3, 0.7], 1),  # both touch by corners
    ],
)
def test_matrix_after_failures(phase: list[list[int]], share: list[float], matrix: int) -> None:
    assert find_matrix(np.array(phase), np.array(share)) == matrix


@pytest.mark.parametrize("failed", [[0], [1], [3], [1, 2, 3], [0, 1, 2, 3]])
@pytest.mark.parametrize("knock_down", [1e-4, 1e-8])
def test_failure_never_stiffens(failed: list[int], knock_down: float) -> None:
    sizes = np.array([np.sqrt(0.6), 1.0 - np.sqrt(0.6)])
    intact = np.array([FIBRE, MATRIX, MATRIX, MATRIX])
    stiffness = intact.copy()
    stiffness[failed] *= knock_down
    before, after = (homogenise(sizes, sizes, c, np.full((4, 6), 1e-6)) for c in (intact, stiffness))
    assert np.linalg.eigvalsh(before.stiffness - after.stiffness)[0] > 0.0
    assert np.linalg.eigvalsh(after.stiffness)[0] > 0.0
    for values in (after.expansion, after.concentration, after.thermal):
        assert np.isfinite(values).all()


def test_stated_matrix_is_taken_and_checked() -> None:
    sizes = (np.array([0.6, 0.4]), np.ones(1))
    phases = (np.array([FIBRE, MATRIX]), np.zeros((2, 6)))
    soft, stiff = (homogenise(*sizes, *phases, matrix=k).stiffness[5, 5] for k in (1, 0))
    assert soft == pytest.approx(two_phases(0.6, FIBRE, MATRIX).stiffness[5, 5], rel=1e-12)
    assert stiff > 2.0 * soft
    with pytest.raises(ValueError, match="matrix is subcell 2"):
        homogenise(*sizes, *phases, matrix=2)


def test_bad_sizes_are_named() -> None:
    with pytest.raises(ValueError, match="widths"):
        homogenise(np.ones(1), np.array([1.0, -1.0]), np.array([FIBRE, MATRIX]), np.zeros((2, 6)))
