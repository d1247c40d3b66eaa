"""Theory of the handshake against published constants and against two elastic bars solved by finite elements."""

from __future__ import annotations

import math

import numpy as np
import pytest

from coordinator.handshake import (
    CHOSEN_NUMBER,
    SMALLEST_WEIGHT,
    STABILITY_LIMIT,
    HandshakeError,
    choose,
    exact_lambda,
    exact_stiffness,
    exact_weight,
    exchange_number,
)

YOUNG, DENSITY, WIDTH = 1.05e12, 2200.0, 15e-10


def elongation_error(weight: float, stiffness: float, elements: int = 400) -> float:
    """Return how far two overlapping bars stretch beyond one whole bar under the same pull.

    Bars of length 2 and modulus 1 overlap over length 1, so the whole is 3 long; the first one is scaled by
    `weight` in the overlap. Springs of `stiffness` per length join them there. Linear elements, consistent
    springs, solved as one linear system; unit pull at the far end, so a single bar would stretch by 3.
    """
    h = 1.0 / elements
    size = 2 * elements + 1
    matrix = np.zeros((2 * size, 2 * size))
    bar = np.array([[1.0, -1.0], [-1.0, 1.0]]) / h
    mass = np.array([[2.0, 1.0], [1.0, 2.0]]) * h / 6.0
    for element in range(2 * elements):
        pair = np.array([element, element + 1])
        modulus = weight if element >= elements else 1.0  # the first bar's second half overlaps
        matrix[np.ix_(pair, pair)] += modulus * bar
        matrix[np.ix_(size + pair, size + pair)] += bar
    for element in range(elements):
        first = np.array([elements + element, elements + element + 1])
        second = size + np.array([element, element + 1])
        springs = stiffness * mass
        matrix[np.ix_(first, first)] += springs
        matrix[np.ix_(second, second)] += springs
        matrix[np.ix_(first, second)] -= springs
        matrix[np.ix_(second, first)] -= springs
    pull = np.zeros(2 * size)
    pull[-1] = 1.0
    free = slice(1, None)  # the first bar is clamped at its far end
    moved = np.linalg.solve(matrix[free, free], pull[free])
    return float(moved[-1] - 3.0)


@pytest.mark.parametrize(
    ("weight", "published", "rounding"), [(1.0, 2.878, 5e-4), (0.5, 8.51, 5e-3), (0.12, 532.0, 0.5), (0.2, 113.0, 0.5)]
)
def test_exact_stiffness_has_the_measured_constants(weight: float, published: float, rounding: float) -> None:
    assert exact_stiffness(weight) == pytest.approx(published, abs=rounding)


def test_exact_stiffness_of_a_light_continuum() -> None:
    # 913 comes from a discretised overlap, 927 from the limit of thin elements.
    assert 913.0 < exact_stiffness(0.1) < 928.0


@pytest.mark.parametrize("weight", [1.0, 0.5, 0.3, 0.2])
def test_exact_stiffness_leaves_the_far_field_of_two_bars_unchanged(weight: float) -> None:
    stiffness = exact_stiffness(weight)
    assert abs(elongation_error(weight, stiffness)) < 2e-4
    # ... and it is the only such stiffness: springs a tenth softer or stiffer are seen.
    assert elongation_error(weight, 0.9 * stiffness) > 2e-3
    assert elongation_error(weight, 1.1 * stiffness) < -2e-3


def test_stiff_springs_at_full_weight_shorten_the_bars_by_nearly_half_the_overlap() -> None:
    assert elongation_error(1.0, 1e4) == pytest.approx(-0.5, abs=0.02)


@pytest.mark.parametrize("weight", [0.05, 0.2, 0.7, 1.0])
def test_exact_lambda_solves_its_equation(weight: float) -> None:
    root = exact_lambda(weight)
    # divided by cosh: the terms themselves overflow at small weights
    left = root * weight * math.tanh(root)
    right = 2.0 / math.cosh(min(root, 700.0)) + weight + 1.0 / weight
    assert left == pytest.approx(right, rel=1e-10)


def test_exact_weight_inverts_exact_stiffness() -> None:
    for weight in (0.06, 0.1, 0.35, 0.8, 1.0):
        assert exact_weight(exact_stiffness(weight)) == pytest.approx(weight, abs=2e-6)
    assert exact_weight(0.5 * exact_stiffness(1.0)) == 1.0
    assert exact_weight(2.0 * exact_stiffness(SMALLEST_WEIGHT)) == pytest.approx(SMALLEST_WEIGHT, abs=2e-6)


def spectral_radius(kappa: float, weight: float, step: float, damping_time: float | None) -> float:
    """Return the spectral radius of one exchange of a light continuum against atoms at rest."""
    pull = step * kappa / (weight * DENSITY)
    drag = 0.0 if damping_time is None else step / (weight * damping_time)
    velocity = np.array([-pull, 1.0 - drag])  # of (u, v)
    place = np.array([1.0, 0.0]) + step * velocity
    return float(np.abs(np.linalg.eigvals(np.array([place, velocity]))).max())


@pytest.mark.parametrize("damping_time", [None, 2e-13, 5e-14])
def test_exchange_number_one_is_where_the_exchange_loses_stability(damping_time: float | None) -> None:
    weight, step = 0.3, 5e-15
    damper = 0.0 if damping_time is None else step / (2 * weight * damping_time)
    kappa_at_one = (1.0 - damper) * 4.0 * weight * DENSITY / step**2
    assert exchange_number(kappa_at_one, weight, DENSITY, step, damping_time) == pytest.approx(1.0, rel=1e-12)
    assert spectral_radius(0.98 * kappa_at_one, weight, step, damping_time) <= 1.0 + 1e-12
    assert spectral_radius(1.02 * kappa_at_one, weight, step, damping_time) > 1.0 + 1e-3


@pytest.mark.parametrize("damping_time", [None, 2e-13])
@pytest.mark.parametrize("step", [1e-15, 3e-15, 5e-15])
def test_choose_takes_the_smallest_weight_below_the_number_it_aims_at(step: float, damping_time: float | None) -> None:
    chosen = choose(YOUNG, DENSITY, WIDTH, step, damping_time=damping_time)
    assert chosen.exchange_number < CHOSEN_NUMBER < STABILITY_LIMIT
    assert chosen.stiffness_density == pytest.approx(exact_stiffness(chosen.weight) * YOUNG / WIDTH**2, rel=1e-12)
    lighter = chosen.weight - 0.002
    kappa = exact_stiffness(lighter) * YOUNG / WIDTH**2
    assert exchange_number(kappa, lighter, DENSITY, step, damping_time) >= CHOSEN_NUMBER


def test_full_weight_is_taken_where_only_that_is_stable() -> None:
    # The exchange number is linear in the step without damper: 0.8 lies between aim and limit.
    step = 0.8 * 5e-15 / exchange_number(exact_stiffness(1.0) * YOUNG / WIDTH**2, 1.0, DENSITY, 5e-15)
    chosen = choose(YOUNG, DENSITY, WIDTH, step)
    assert chosen.weight == 1.0
    assert chosen.exchange_number == pytest.approx(0.8, rel=1e-12)


def test_choose_stops_at_the_smallest_weight() -> None:
    assert choose(YOUNG, DENSITY, WIDTH, 1e-17).weight == SMALLEST_WEIGHT


def test_choose_keeps_a_given_weight_and_finds_its_stiffness() -> None:
    chosen = choose(YOUNG, DENSITY, WIDTH, 2e-15, weight=0.5)
    assert chosen.weight == 0.5
    assert chosen.stiffness_density * WIDTH**2 / YOUNG == pytest.approx(8.506, rel=1e-3)


def test_choose_finds_the_weight_of_a_given_stiffness() -> None:
    given = exact_stiffness(0.4) * YOUNG / WIDTH**2
    chosen = choose(YOUNG, DENSITY, WIDTH, 2e-15, stiffness_density=given)
    assert chosen.stiffness_density == given
    assert chosen.weight == pytest.approx(0.4, abs=2e-6)


@pytest.mark.parametrize(
    "given",
    [{"weight": 0.06}, {"stiffness_density": 1e35}, {"weight": 1.0, "damping_time": 1e-15}, {"weight": 1.0, "step": 1}],
)
def test_an_unstable_exchange_is_refused_with_limit_and_knobs(given: dict[str, float]) -> None:
    step = 1e-12 if given.pop("step", None) else 5e-15
    with pytest.raises(HandshakeError) as refused:
        choose(YOUNG, DENSITY, WIDTH, step, **given)
    text = str(refused.value)
    assert f"allowed is {STABILITY_LIMIT}" in text
    assert f"{step * 1e15:.3g} fs" in text
    for knob in ("handshake.steps_per_exchange", "handshake.stiffness", "handshake.weight"):
        assert knob in text
