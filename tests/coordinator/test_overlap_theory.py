"""Two overlapping bars: published constants, the same bars assembled from scratch, conservation of energy."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import spsolve

from coordinator.overlap_theory import exact_lambda, exact_stiffness, scatter, static_error
from coordinator.weight_profile import WeightProfile

PROFILES = [
    WeightProfile("constant", 0.3),
    WeightProfile("linear", 0.05),
    WeightProfile("cubic", 0.05),
    WeightProfile("power", 0.05, 4.0),
    WeightProfile("power", 0.05, 8.0),
]
KINDS = [f"{profile.kind} {profile.exponent:g}" for profile in PROFILES]


def bars_error(profile: WeightProfile, stiffness: float, elements: int = 300) -> float:
    """Return how far two overlapping bars stretch beyond one whole bar under the same pull, assembled from scratch.

    Bars of length 2 and modulus 1 overlap over length 1, so the whole is 3 long; the first one is scaled by the
    weight in the overlap. Lumped springs at the nodes join them there; a single bar would stretch by 3.
    """
    h = 1.0 / elements
    size = 2 * elements + 1
    matrix = np.zeros((2 * size, 2 * size))
    bar = np.array([[1.0, -1.0], [-1.0, 1.0]]) / h
    for element in range(2 * elements):
        pair = np.array([element, element + 1])
        inside = (element + 0.5) * h - 1.0
        modulus = float(profile.at(1.0 - inside)) if inside > 0.0 else 1.0
        matrix[np.ix_(pair, pair)] += modulus * bar
        matrix[np.ix_(size + pair, size + pair)] += bar
    for node in range(elements + 1):
        tie = stiffness * h * float(profile.at(1.0 - node * h)) / profile.at_border
        pair = np.array([elements + node, size + node])
        matrix[np.ix_(pair, pair)] += tie * (0.5 if node in (0, elements) else 1.0) * np.array([[1.0, -1], [-1, 1]])
    pull = np.zeros(2 * size)
    pull[-1] = 1.0
    # The first bar is clamped at its far end.
    moved = spsolve(csc_matrix(matrix[1:, 1:]), pull[1:])
    return float(moved[-1] - 3.0)


@pytest.mark.parametrize(
    ("weight", "published", "rounding"), [(1.0, 2.878, 5e-4), (0.5, 8.51, 5e-3), (0.12, 532.0, 0.5), (0.2, 113.0, 0.5)]
)
def test_exact_stiffness_has_the_measured_constants(weight: float, published: float, rounding: float) -> None:
    assert exact_stiffness(WeightProfile("constant", weight)) == pytest.approx(published, abs=rounding)


def test_exact_stiffness_of_a_light_continuum() -> None:
    # 913 comes from a discretised overlap, 927 from the limit of thin elements.
    assert 913.0 < exact_stiffness(WeightProfile("constant", 0.1)) < 928.0


@pytest.mark.parametrize("weight", [0.05, 0.2, 0.7, 1.0])
def test_exact_lambda_solves_its_equation(weight: float) -> None:
    root = exact_lambda(weight)
    # divided by cosh: the terms themselves overflow at small weights
    left = root * weight * math.tanh(root)
    right = 2.0 / math.cosh(min(root, 700.0)) + weight + 1.0 / weight
    assert left == pytest.approx(right, rel=1e-10)


@pytest.mark.parametrize("profile", PROFILES, ids=KINDS)
def test_exact_stiffness_leaves_the_far_field_of_two_bars_unchanged(profile: WeightProfile) -> None:
    stiffness = exact_stiffness(profile)
    assert abs(bars_error(profile, stiffness)) < 4e-4
    # ... and it is the only such stiffness: springs a tenth softer or stiffer are seen.
    assert bars_error(profile, 0.9 * stiffness) > 5e-3
    assert bars_error(profile, 1.1 * stiffness) < -5e-3


@pytest.mark.parametrize("profile", PROFILES, ids=KINDS)
def test_static_error_is_that_of_two_bars(profile: WeightProfile) -> None:
    for stiffness in (2.0, 10.0, 300.0):
        assert static_error(profile, stiffness) == pytest.approx(bars_error(profile, stiffness), abs=1e-3)


def test_stiff_springs_at_full_weight_shorten_the_bars_by_nearly_half_the_overlap() -> None:
    assert static_error(WeightProfile("constant", 1.0), 1000.0) == pytest.approx(-0.48, abs=5e-3)
    assert static_error(WeightProfile("constant", 1.0), 1e7) == pytest.approx(-0.5, abs=1e-3)


@pytest.mark.parametrize(
    ("profile", "stiffness", "published"),
    [
        (WeightProfile("constant", 1.0), 1000.0, 0.40),
        (WeightProfile("constant", 1.0), 2.8785, 0.29),
        (WeightProfile("linear", 0.02), None, 0.157),
        (WeightProfile("constant", 0.1), None, 0.038),
    ],
)
def test_reflection_of_a_wave_of_ten_widths_as_measured(
    profile: WeightProfile, stiffness: float | None, published: float
) -> None:
    springs = exact_stiffness(profile) if stiffness is None else stiffness
    assert scatter(profile, springs, 10.0).reflected == pytest.approx(published, abs=2.5e-3)


@pytest.mark.parametrize("profile", PROFILES, ids=KINDS)
@pytest.mark.parametrize("wavelength", [2.0, 5.0, 20.0])
def test_springs_conserve_the_energy_of_a_wave_and_dampers_take_some(profile: WeightProfile, wavelength: float) -> None:
    stiffness = exact_stiffness(profile)
    assert abs(scatter(profile, stiffness, wavelength).absorbed) < 1e-10
    damped = scatter(profile, stiffness, wavelength, damping=2.0)
    assert damped.absorbed > 0.0
    assert damped.reflected**2 + damped.transmitted**2 < 1.0


@pytest.mark.parametrize("profile", PROFILES, ids=KINDS)
def test_a_long_wave_is_reflected_by_the_mean_weight(profile: WeightProfile) -> None:
    wavelength = 500.0
    reflected = scatter(profile, exact_stiffness(profile), wavelength).reflected
    assert reflected == pytest.approx(math.pi * profile.mean / wavelength, rel=2e-3)


@pytest.mark.parametrize("profile", PROFILES, ids=KINDS)
def test_profiles_go_from_weight_to_one_with_the_stated_mean(profile: WeightProfile) -> None:
    across = np.linspace(0.0, 1.0, 20001)
    weight = profile.at(across)
    assert weight[0] == pytest.approx(profile.weight)
    assert weight[-1] == pytest.approx(profile.at_border)
    assert (np.diff(weight) >= 0.0).all()
    assert np.trapezoid(weight, across) == pytest.approx(profile.mean, rel=1e-6)


@pytest.mark.parametrize(("weight", "exponent"), [(0.0, 1.0), (1.2, 1.0), (0.5, 0.5)])
def test_a_profile_out_of_range_is_refused(weight: float, exponent: float) -> None:
    with pytest.raises(ValueError, match=r"weight is|exponent is"):
        WeightProfile("power", weight, exponent)
