"""Failure criteria against values computed by hand."""

from __future__ import annotations

import numpy as np
import pytest

from gmc_service.cell import Cell
from gmc_service.failure import (
    HASHIN,
    MAXIMUM_STRAIN,
    MAXIMUM_STRESS,
    TSAI_HILL,
    checks_of,
    failure_index,
    governing_component,
    rates_of,
)
from gmc_service.material import CRITERIA, Criterion, Failure, constant_material, isotropic_stiffness

INF = np.inf


def index(failure: Failure, load: tuple[float, ...]) -> float:
    """Index of a load, by the compiled function."""
    return float(failure_index(CRITERIA.index(failure.criterion), *map(float, load), rates_of(failure)[None], 0))


PLY = {"tension": (2000.0, 50.0, 50.0), "compression": (1500.0, 200.0, 200.0), "shear": (60.0, 80.0, 80.0)}


@pytest.mark.parametrize("criterion", CRITERIA)
@pytest.mark.parametrize("axis", range(6))
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_one_component_alone_fails_at_its_allowable(criterion: Criterion, axis: int, sign: float) -> None:
    failure = Failure(criterion, **PLY)
    limits = [*PLY["tension" if sign > 0 else "compression"], *PLY["shear"]]
    load = [0.0] * 6
    load[axis] = sign * limits[axis]
    assert index(failure, tuple(load)) == pytest.approx(1.0, rel=1e-14)
    assert index(failure, tuple(0.5 * value for value in load)) == pytest.approx(0.5, rel=1e-14)


@pytest.mark.parametrize("criterion", CRITERIA)
def test_a_component_without_allowable_is_not_checked(criterion: Criterion) -> None:
    only_transverse_shear = Failure(criterion, shear=(60.0, INF, INF))
    assert index(only_transverse_shear, (1e9, 0.0, 0.0, 0.0, 1e9, -1e9)) == 0.0
    assert index(only_transverse_shear, (-1e9, 0.0, 0.0, 30.0, 0.0, 0.0)) == pytest.approx(0.5)


@pytest.mark.parametrize("criterion", CRITERIA)
def test_index_grows_in_proportion_to_the_load(criterion: Criterion) -> None:
    failure = Failure(criterion, **PLY)
    rng = np.random.default_rng(5)
    for load in rng.normal(size=(200, 6)) * [1000.0, 60.0, 60.0, 40.0, 40.0, 40.0]:
        one = index(failure, tuple(load))
        assert index(failure, tuple(3.0 * load)) == pytest.approx(3.0 * one, rel=1e-12)


def test_tsai_hill_of_a_lamina_in_plane_stress() -> None:
    # Azzi and Tsai: s1^2/X^2 - s1 s2/X^2 + s2^2/Y^2 + s12^2/S^2, with Y = Z; compression picks X' and Y'.
    failure = Failure("tsai_hill", **PLY)
    s1, s2, s12 = 700.0, 20.0, 35.0
    expected = s1**2 / 2000.0**2 - s1 * s2 / 2000.0**2 + s2**2 / 50.0**2 + s12**2 / 80.0**2
    assert index(failure, (s1, s2, 0.0, 0.0, 0.0, s12)) == pytest.approx(np.sqrt(expected), rel=1e-13)
    # With s2 < 0 its strength is Y', and so is that of axis 3, whose stress is zero but for rounding.
    expected = s1**2 / 2000.0**2 + s1 * s2 / 2000.0**2 + s2**2 / 200.0**2 + s12**2 / 80.0**2
    for rounding in (0.0, 1e-11, -1e-11):
        assert index(failure, (s1, -s2, rounding, 0.0, 0.0, s12)) == pytest.approx(np.sqrt(expected), rel=1e-13)
    # With s3 > 0 axis 3 has its tensile strength Z and the form is no longer that of a lamina.
    x, y, z = 1.0 / 1500.0**2, 1.0 / 200.0**2, 1.0 / 50.0**2
    s1, s2, s3 = -10.0, -150.0, 20.0
    expected = x * s1**2 + y * s2**2 + z * s3**2
    expected -= (x + y - z) * s1 * s2 + (x + z - y) * s1 * s3 + (y + z - x) * s2 * s3
    assert index(failure, (s1, s2, s3, 0.0, 0.0, 0.0)) == pytest.approx(np.sqrt(expected), rel=1e-13)


def test_tsai_hill_of_an_isotropic_material_is_von_mises() -> None:
    strength = 100.0
    failure = Failure("tsai_hill", (strength,) * 3, (strength,) * 3, (strength / np.sqrt(3.0),) * 3)
    rng = np.random.default_rng(2)
    for load in rng.normal(size=(50, 6)) * 50.0:
        a, b, c, d, e, f = load
        mises = np.sqrt(0.5 * ((a - b) ** 2 + (b - c) ** 2 + (c - a) ** 2) + 3.0 * (d**2 + e**2 + f**2))
        assert index(failure, tuple(load)) == pytest.approx(mises / strength, rel=1e-12)


def test_hashin_modes_by_hand() -> None:
    failure = Failure("hashin", **PLY)
    fibre = np.sqrt((1000.0 / 2000.0) ** 2 + (40.0**2 + 20.0**2) / 80.0**2)
    assert index(failure, (1000.0, 0.0, 0.0, 0.0, 20.0, 40.0)) == pytest.approx(fibre, rel=1e-14)
    assert index(failure, (-750.0, 0.0, 0.0, 0.0, 0.0, 0.0)) == pytest.approx(0.5)
    s2, s3, s23 = 30.0, -10.0, 25.0
    matrix = np.sqrt((s2 + s3) ** 2 / 50.0**2 + (s23**2 - s2 * s3) / 60.0**2)
    assert index(failure, (0.0, s2, s3, s23, 0.0, 0.0)) == pytest.approx(matrix, rel=1e-14)


def test_hashin_matrix_in_compression_solves_its_printed_equation() -> None:
    failure = Failure("hashin", **PLY)
    rng = np.random.default_rng(8)
    for _ in range(50):
        s2, s3 = -rng.uniform(5.0, 100.0, 2)
        s23, s13, s12 = rng.uniform(-50.0, 50.0, 3)
        factor = 1.0 / index(failure, (0.0, s2, s3, s23, s13, s12))
        s2, s3, s23, s13, s12 = (factor * value for value in (s2, s3, s23, s13, s12))
        fibre = np.sqrt(s12**2 + s13**2) / 80.0
        printed = ((200.0 / 120.0) ** 2 - 1.0) * (s2 + s3) / 200.0 + (s2 + s3) ** 2 / (4.0 * 60.0**2)
        printed += (s23**2 - s2 * s3) / 60.0**2 + (s12**2 + s13**2) / 80.0**2
        assert max(printed, fibre) == pytest.approx(1.0, rel=1e-12)


def test_hashin_needs_a_material_isotropic_across_the_fibre() -> None:
    with pytest.raises(ValueError, match="tension of hashin is 50 and 60 for 2 and 3"):
        rates_of(Failure("hashin", tension=(1.0, 50.0, 60.0)))
    with pytest.raises(ValueError, match="shear of hashin is 7 and 8 for 13 and 12"):
        rates_of(Failure("hashin", shear=(1.0, 7.0, 8.0)))


@pytest.mark.parametrize(
    ("criterion", "load", "name"),
    [
        (MAXIMUM_STRESS, (0.0, 49.0, 0.0, 0.0, 0.0, 10.0), "22 tension"),
        (MAXIMUM_STRESS, (-1400.0, 10.0, 0.0, 0.0, 0.0, 10.0), "11 compression"),
        (MAXIMUM_STRAIN, (0.0, 0.0, 0.0, -59.0, 0.0, 10.0), "23 shear"),
        (MAXIMUM_STRESS, (0.0, 0.0, 0.0, 0.0, 0.0, -70.0), "12 shear"),
        (TSAI_HILL, (0.0, 0.0, -190.0, 0.0, 70.0, 0.0), "33 compression"),
        (HASHIN, (-100.0, 0.0, 0.0, 0.0, 0.0, 0.0), "fibre compression"),
        (HASHIN, (100.0, -150.0, -20.0, 0.0, 0.0, 0.0), "matrix compression"),
        (HASHIN, (100.0, 30.0, 20.0, 0.0, 0.0, 0.0), "matrix tension"),
    ],
)
def test_governing_component_is_named(criterion: int, load: tuple[float, ...], name: str) -> None:
    rates = rates_of(Failure(CRITERIA[criterion], **PLY))
    assert governing_component(criterion, np.array(load), rates) == name


def test_checks_leave_out_subcells_without_allowables() -> None:
    stiffness = isotropic_stiffness(3e9, 0.3)
    strong = constant_material("strong", stiffness, failures=(Failure("maximum_stress"),))
    weak = constant_material(
        "weak",
        stiffness,
        failures=(Failure("maximum_stress", shear=(1e6, INF, INF)), Failure("maximum_strain", (0.01, INF, INF))),
    )
    cell = Cell(np.ones(2), np.ones(2), np.array([[0, 1], [1, 0]]), (strong, weak))
    checks = checks_of(cell)
    assert checks.subcell.tolist() == [1, 1, 2, 2]
    assert checks.of_strain().tolist() == [False, True, False, True]
