"""Meshes that follow a round fibre, against multipoles, mean fields, symmetry and published moduli."""

from __future__ import annotations

import numpy as np
import pytest

from gmc_service.engineering_constants import engineering_constants
from gmc_service.material import isotropic_stiffness
from gmc_service.mori_tanaka import homogenise as mori_tanaka
from gmc_service.periodic_elements import homogenise_mesh
from gmc_service.round_fibre import Array, largest_fraction, round_fibre_mesh
from gmc_service.verification.exact_axial_shear import round_fibres

FIBRE = isotropic_stiffness(276e9, 0.33)
MATRIX = isotropic_stiffness(2.963e9, 0.36)


def stiffness_of(fraction: float, refinement: int, array: Array, phases: tuple = (FIBRE, MATRIX)) -> np.ndarray:
    return homogenise_mesh(round_fibre_mesh(fraction, refinement, array), np.array(phases), np.zeros((2, 6))).stiffness


def test_multipoles_give_the_published_conductivities() -> None:
    """Perfectly conducting cylinders in a square array (Perrins, McKenzie and McPhedran 1979, Table 1)."""
    published = {0.1: 1.222, 0.2: 1.500, 0.3: 1.860, 0.4: 2.351, 0.5: 3.080, 0.6: 4.342, 0.7: 7.433}
    for fraction, value in published.items():
        assert round_fibres(fraction, 1e12) == pytest.approx(value, abs=6e-4)


@pytest.mark.parametrize("array", ["square", "hexagonal"])
def test_axial_shear_converges_to_the_multipoles_with_fourth_order(array: Array) -> None:
    exact = MATRIX[5, 5] * round_fibres(0.6, float(FIBRE[5, 5] / MATRIX[5, 5]), array)
    errors = [stiffness_of(0.6, n, array)[5, 5] / exact - 1.0 for n in (1, 2, 4)]
    assert 0.0 < errors[2] < 3e-7
    assert np.log2(errors[1] / errors[2]) > 3.5


def test_hexagonal_array_is_isotropic_around_its_fibres() -> None:
    found = stiffness_of(0.6, 2, "hexagonal")
    assert found[1, 1] == pytest.approx(found[2, 2], rel=1e-7)
    assert found[4, 4] == pytest.approx(found[5, 5], rel=1e-7)
    assert found[3, 3] == pytest.approx(0.5 * (found[1, 1] - found[1, 2]), rel=1e-7)


@pytest.mark.parametrize("fraction", [0.2, 0.5, 0.8])
def test_hexagonal_array_lies_within_the_bounds_of_hashin(fraction: float) -> None:
    """Bounds of transversely isotropic composites (Hill 1964, Hashin 1965): either phase around the other."""
    found = stiffness_of(fraction, 2, "hexagonal")
    sizes = (np.array([fraction, 1.0 - fraction]), np.ones(1))
    low, high = (
        mori_tanaka(*sizes, np.array([FIBRE, MATRIX]), np.zeros((2, 6)), matrix=outer).stiffness for outer in (1, 0)
    )
    for value in (lambda c: c[1, 1] + c[1, 2], lambda c: c[3, 3], lambda c: c[5, 5]):
        # Finite elements err upwards by less than 1e-4, the bounds lie much further apart.
        assert value(low) < value(found) < value(high)


def test_small_fraction_in_a_hexagonal_array_agrees_with_mori_tanaka() -> None:
    sizes = (np.array([0.05, 0.95]), np.ones(1))
    mean_field = mori_tanaka(*sizes, np.array([FIBRE, MATRIX]), np.zeros((2, 6)), matrix=1).stiffness
    added = np.diag(stiffness_of(0.05, 4, "hexagonal") - MATRIX) / np.diag(mean_field - MATRIX)
    assert added == pytest.approx(np.ones(6), abs=2e-3)


def test_boron_aluminium_has_the_published_moduli() -> None:
    """Square array at 0.47: E11, E22, G23 and nu12 of Sun and Vaidya, Composites Science and Technology 56 (1996) 171.

    Their G12 of 57.2 GPa is not periodic: the multipoles have 54.4.
    """
    boron, aluminium = isotropic_stiffness(379.3e9, 0.1), isotropic_stiffness(68.3e9, 0.3)
    found = engineering_constants(stiffness_of(0.47, 2, "square", (boron, aluminium)))
    assert pytest.approx(215e9, rel=3e-3) == found.E11
    assert pytest.approx(144e9, rel=3e-3) == found.E22
    assert pytest.approx(45.9e9, rel=3e-3) == found.G23
    assert found.nu12 == pytest.approx(0.19, abs=0.005)
    exact = aluminium[5, 5] * round_fibres(0.47, float(boron[5, 5] / aluminium[5, 5]))
    assert pytest.approx(exact, rel=1e-5) == found.G12


@pytest.mark.parametrize("array", ["square", "hexagonal"])
def test_mesh_has_the_fraction_asked_for(array: Array) -> None:
    mesh = round_fibre_mesh(0.6, 4, array)
    shares = homogenise_mesh(mesh, np.array([FIBRE, MATRIX]), np.zeros((2, 6))).concentration
    # Mean strains of the phases weigh to the whole only with the true shares.
    assert np.abs(0.6 * shares[0] + 0.4 * shares[1] - np.eye(6)).max() < 1e-5


@pytest.mark.parametrize(("fraction", "array"), [(0.0, "square"), (0.79, "square"), (0.91, "hexagonal")])
def test_fraction_out_of_range_is_named(fraction: float, array: Array) -> None:
    assert largest_fraction("square") == pytest.approx(np.pi / 4.0)
    assert largest_fraction("hexagonal") == pytest.approx(np.pi / np.sqrt(12.0))
    with pytest.raises(ValueError, match=f"fraction is {fraction}"):
        round_fibre_mesh(fraction, 1, array)
