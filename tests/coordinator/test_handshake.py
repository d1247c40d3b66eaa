"""Choice of the handshake, and its limits against the eigenvalues of the maps that they come from."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from coordinator.handshake import (
    CHOSEN_NUMBER,
    LARGEST_EXPONENT,
    LARGEST_STIFFNESS,
    SMALL_STIFFNESS,
    SMALLEST_WEIGHT,
    SPRING_NUMBER,
    STABILITY_LIMIT,
    HandshakeError,
    Scheme,
    choose,
    damping_share,
    exact_weight,
    exchange_number,
)
from coordinator.overlap_theory import exact_stiffness, static_error
from coordinator.weight_profile import Kind, WeightProfile

YOUNG, DENSITY, WIDTH = 1.05e12, 2200.0, 15e-10


def constant(weight: float) -> WeightProfile:
    return WeightProfile("constant", weight)


def serial_radius(spring: float, drag: float) -> float:
    """Return the spectral radius of v' = v - 4 S u / Dt - 2 D v, u' = u + Dt v', in units of Dt = 1."""
    velocity = np.array([-4.0 * spring, 1.0 - 2.0 * drag])  # of (u, v)
    place = np.array([1.0, 0.0]) + velocity
    return float(np.abs(np.linalg.eigvals(np.array([place, velocity]))).max())


def parallel_radius(spring: float, drag: float, inner: float, second: float = 1.0) -> float:
    """Return the spectral radius of the parallel exchange of one light node with a spring to rest of its own.

    State (u, v, v one step before, F); `second` scales the second difference in the prediction.
    """
    u, v, w, f = np.eye(4)
    told = u + v + second * (v - w)  # where the anchors stand while the continuum moves
    moved = v - inner * u + f
    reaction = -4.0 * spring * told - 2.0 * drag * v
    return float(np.abs(np.linalg.eigvals(np.array([u + moved, moved, v, reaction]))).max())


@pytest.mark.parametrize("drag", [0.0, 0.1, 0.4])
def test_serial_exchange_loses_stability_at_number_one(drag: float) -> None:
    assert serial_radius(0.98 * (1.0 - drag), drag) <= 1.0 + 1e-12
    assert serial_radius(1.02 * (1.0 - drag), drag) > 1.0 + 1e-3


@pytest.mark.parametrize("drag", [0.0, 0.05, 0.2])
@pytest.mark.parametrize("inner", [0.0, 0.25, 0.5])
def test_parallel_exchange_loses_stability_at_number_one(drag: float, inner: float) -> None:
    at_one = (1.0 - 2.0 * drag - inner) / 8.0
    assert parallel_radius(0.98 * at_one, drag, inner) <= 1.0 + 1e-12
    assert parallel_radius(1.02 * at_one, drag, inner) > 1.0 + 1e-4


def test_parallel_exchange_without_the_second_difference_is_unstable_at_any_number() -> None:
    for spring in (1e-3, 1e-2, 0.1):
        assert parallel_radius(spring, 0.0, 0.0, second=0.0) > 1.0 + spring**2
        assert parallel_radius(spring, 0.0, 0.0) < 1.0 + 1e-12


@pytest.mark.parametrize("parts", [2, 5, 50])
def test_force_as_an_impulse_has_the_serial_map_and_spread_evenly_grows(parts: int) -> None:
    spring = 0.1
    impulse, spread = np.eye(2), np.eye(2)  # of (u, v), Dt = 1
    start = np.array([-4.0 * spring, 0.0])  # force for unit mass from the place at the start
    for part in range(parts):
        impulse[1] += start if part == 0 else 0.0
        impulse[0] += impulse[1] / parts
        spread[1] += start / parts
        spread[0] += spread[1] / parts
    whole = np.array([[1.0 - 4.0 * spring, 1.0], [-4.0 * spring, 1.0]])
    np.testing.assert_allclose(impulse, whole, atol=1e-14)
    assert np.linalg.det(spread) == pytest.approx(1.0 + 2.0 * spring * (parts - 1) / parts)
    assert np.abs(np.linalg.eigvals(spread)).max() > 1.0


@pytest.mark.parametrize("damping_time", [None, 2e-13, 5e-14])
def test_exchange_number_counts_springs_and_dampers(damping_time: float | None) -> None:
    weight, step, kappa = 0.3, 5e-15, 3e31
    spring = 0.25 * step**2 * kappa / (weight * DENSITY)
    drag = 0.0 if damping_time is None else 0.5 * step / (weight * damping_time)
    serial = exchange_number(kappa, constant(weight), DENSITY, step, damping_time)
    parallel = exchange_number(kappa, constant(weight), DENSITY, step, damping_time, "parallel", 0.2)
    assert serial**2 == pytest.approx(spring + drag)
    assert parallel**2 == pytest.approx(8.0 * spring + 2.0 * drag + 0.16)


def test_dampers_follow_a_profile_so_its_lightest_place_does_not_limit_them() -> None:
    profile = WeightProfile("power", 0.05, 8.0)
    across = np.linspace(0.0, 1.0, 1001)
    share = damping_share(profile, across)
    ratio = share / profile.at(across)
    assert set(share) == {1.0 / 16.0, 0.125, 0.25, 0.5, 1.0}
    assert 0.7 < ratio.min() < ratio.max() < 1.42
    assert (damping_share(constant(0.2), across) == 1.0).all()
    alone = exchange_number(0.0, profile, DENSITY, 5e-15, 5e-14)
    assert alone**2 == pytest.approx(0.05 * ratio.max(), rel=1e-2)


@pytest.mark.parametrize("damping_time", [None, 2e-13])
@pytest.mark.parametrize("step", [1e-15, 3e-15, 5e-15])
def test_constant_weight_is_the_smallest_below_the_aim(step: float, damping_time: float | None) -> None:
    chosen = choose(YOUNG, DENSITY, WIDTH, step, damping_time=damping_time, profile="constant")
    assert chosen.exchange_number < CHOSEN_NUMBER["serial"] < STABILITY_LIMIT["serial"]
    kappa = exact_stiffness(constant(chosen.weight)) * YOUNG / WIDTH**2
    assert chosen.stiffness_density == pytest.approx(kappa, rel=1e-12)
    assert abs(chosen.static_error) < 1e-10
    lighter = constant(chosen.weight - 0.002)
    kappa = exact_stiffness(lighter) * YOUNG / WIDTH**2
    assert exchange_number(kappa, lighter, DENSITY, step, damping_time) >= CHOSEN_NUMBER["serial"]


@pytest.mark.parametrize("scheme", ["serial", "parallel"])
@pytest.mark.parametrize("step", [2e-15, 5e-15, 1.2e-14])
def test_the_default_is_the_steepest_power_below_the_aim(step: float, scheme: Scheme) -> None:
    chosen = choose(YOUNG, DENSITY, WIDTH, step, damping_time=1e-12, scheme=scheme)
    assert chosen.profile.kind == "power"
    assert chosen.exchange_number < CHOSEN_NUMBER[scheme]
    assert abs(chosen.static_error) < 1e-9
    if chosen.weight == SMALLEST_WEIGHT and chosen.exponent < LARGEST_EXPONENT:
        steeper = WeightProfile("power", SMALLEST_WEIGHT, chosen.exponent + 1.0)
        kappa = exact_stiffness(steeper) * YOUNG / WIDTH**2
        assert exchange_number(kappa, steeper, DENSITY, step, 1e-12, scheme) >= CHOSEN_NUMBER[scheme]


def test_the_default_reaches_the_limits_of_reflection_at_twenty_steps_of_graphene() -> None:
    chosen = choose(YOUNG, DENSITY, WIDTH, 20 * 0.5e-15)
    reflected = [chosen.reflection(wavelength) for wavelength in (5.0, 10.0, 20.0, 50.0)]
    assert (np.array(reflected) < [0.12, 0.05, 0.03, 0.01]).all()
    # A constant weight that is stable at the same step misses all four.
    plain = choose(YOUNG, DENSITY, WIDTH, 20 * 0.5e-15, profile="constant")
    assert (
        np.array([plain.reflection(wavelength) for wavelength in (5.0, 10.0, 20.0, 50.0)]) > [0.24, 0.1, 0.04, 0.02]
    ).all()


@pytest.mark.parametrize("kind", ["linear", "cubic", "power"])
def test_springs_follow_the_weight_and_stand_at_their_density_at_the_outer_border(kind: Kind) -> None:
    chosen = choose(YOUNG, DENSITY, WIDTH, 5e-15, profile=kind)
    across = np.linspace(0.0, 1.0, 11)
    np.testing.assert_allclose(
        chosen.stiffness_at(across), chosen.stiffness_density * chosen.weight_at(across), rtol=1e-14
    )
    assert chosen.stiffness_at(np.array(1.0)) == pytest.approx(chosen.stiffness_density)


def test_springs_of_a_constant_weight_are_equal() -> None:
    chosen = choose(YOUNG, DENSITY, WIDTH, 2e-15, weight=0.5)
    assert chosen.profile == constant(0.5)
    np.testing.assert_allclose(chosen.stiffness_at(np.linspace(0.0, 1.0, 5)), chosen.stiffness_density)
    assert chosen.relative_stiffness == pytest.approx(8.506, rel=1e-3)


def test_the_weight_grows_where_even_a_straight_profile_is_unstable() -> None:
    softest = exact_stiffness(WeightProfile("linear", SMALLEST_WEIGHT)) * YOUNG / WIDTH**2
    step = 1.2 * 2.0 * CHOSEN_NUMBER["serial"] * (DENSITY / softest) ** 0.5
    chosen = choose(YOUNG, DENSITY, WIDTH, step)
    assert chosen.exponent == 1.0
    assert SMALLEST_WEIGHT < chosen.weight < 1.0
    assert chosen.exchange_number == pytest.approx(CHOSEN_NUMBER["serial"], rel=2e-3)


def test_full_weight_is_taken_where_only_that_is_stable() -> None:
    # The exchange number is linear in the step without damper: 0.8 lies between aim and limit.
    kappa = exact_stiffness(constant(1.0)) * YOUNG / WIDTH**2
    step = 0.8 * 5e-15 / exchange_number(kappa, constant(1.0), DENSITY, 5e-15)
    chosen = choose(YOUNG, DENSITY, WIDTH, step, profile="constant")
    assert chosen.weight == 1.0
    assert chosen.exchange_number == pytest.approx(0.8, rel=1e-12)


def test_choose_stops_at_the_smallest_weight_and_the_largest_exponent() -> None:
    assert choose(YOUNG, DENSITY, WIDTH, 1e-17, profile="constant").weight == SMALLEST_WEIGHT
    assert choose(YOUNG, DENSITY, WIDTH, 1e-17).profile == WeightProfile("power", SMALLEST_WEIGHT, LARGEST_EXPONENT)


def test_choose_finds_the_weight_of_a_given_stiffness() -> None:
    given = exact_stiffness(constant(0.4)) * YOUNG / WIDTH**2
    chosen = choose(YOUNG, DENSITY, WIDTH, 2e-15, stiffness_density=given)
    assert chosen.stiffness_density == given
    assert chosen.weight == pytest.approx(0.4, abs=2e-6)


def test_exact_weight_inverts_exact_stiffness() -> None:
    for weight in (0.06, 0.1, 0.35, 0.8, 1.0):
        assert exact_weight(exact_stiffness(constant(weight))) == pytest.approx(weight, abs=2e-6)
    assert exact_weight(0.5 * exact_stiffness(constant(1.0))) == 1.0
    assert exact_weight(2.0 * exact_stiffness(constant(SMALLEST_WEIGHT))) == pytest.approx(SMALLEST_WEIGHT, abs=2e-6)


def test_stiff_springs_are_as_stiff_as_the_exchange_bears() -> None:
    short = choose(YOUNG, DENSITY, WIDTH, 1e-15, weight=1.0, stiff=True)
    assert short.relative_stiffness == pytest.approx(1000.0)
    assert short.static_error == pytest.approx(-0.4776, abs=1e-4)
    assert short.reflection(10.0) == pytest.approx(0.399, abs=1e-3)
    long = choose(YOUNG, DENSITY, WIDTH, 1.5e-14, weight=1.0, damping_time=5e-14, stiff=True)
    assert long.relative_stiffness < 100.0
    assert long.exchange_number == pytest.approx(CHOSEN_NUMBER["serial"])


@pytest.mark.parametrize(
    "given",
    [
        {"weight": 0.06},
        {"stiffness_density": 1e35},
        {"weight": 1.0, "damping_time": 1e-15},
        {"weight": 1.0, "step": 1e-12},
        {"step": 5e-13},
    ],
)
def test_an_unstable_exchange_is_refused_with_limit_and_knobs(given: dict[str, float]) -> None:
    step = given.pop("step", 5e-15)
    with pytest.raises(HandshakeError) as refused:
        choose(YOUNG, DENSITY, WIDTH, step, **given)
    text = str(refused.value)
    assert f"allowed is {STABILITY_LIMIT['serial']}" in text
    assert f"coupling step {step * 1e15:.3g} fs" in text
    for knob in ("handshake.steps_per_exchange", "handshake.stiffness", "handshake.weight"):
        assert knob in text


def test_the_step_that_a_refusal_names_is_taken() -> None:
    with pytest.raises(HandshakeError, match=r"a coupling step of (\S+) fs is stable") as refused:
        choose(YOUNG, DENSITY, WIDTH, 5e-14, weight=0.5, damping_time=1e-13)
    step = float(str(refused.value).split("a coupling step of ")[1].split(" fs")[0]) * 1e-15
    assert (
        choose(YOUNG, DENSITY, WIDTH, step, weight=0.5, damping_time=1e-13).exchange_number < STABILITY_LIMIT["serial"]
    )


def test_the_parallel_exchange_is_refused_where_the_serial_one_is_stable() -> None:
    with pytest.raises(HandshakeError, match=r"handshake.scheme = parallel; serial has 0\.\d"):
        choose(YOUNG, DENSITY, WIDTH, 2e-14, weight=0.5, scheme="parallel")
    assert choose(YOUNG, DENSITY, WIDTH, 2e-14, weight=0.5).scheme == "serial"


# --- continuum of small stiffness ------------------------------------------------------------------------------------

SPEED = (YOUNG / DENSITY) ** 0.5


def courant(step: float, cells: int = 3) -> float:
    return SPEED * step * cells / WIDTH


@pytest.mark.parametrize("damping_time", [None, 2e-13])
def test_mass_alone_carries_where_the_springs_slip_little(damping_time: float | None) -> None:
    step = 10 * 0.5e-15
    chosen = choose(YOUNG, DENSITY, WIDTH, step, damping_time=damping_time, courant=courant(step))
    assert chosen.stiffness_share == SMALL_STIFFNESS
    assert chosen.cells == 3
    assert chosen.exchange_number == pytest.approx(SPRING_NUMBER)
    assert 0.0 < chosen.static_error < chosen.mean_weight
    limits = np.array([0.12, 0.05, 0.03, 0.01])
    assert (np.array([chosen.reflection(wavelength) for wavelength in (5.0, 10.0, 20.0, 50.0)]) < 0.5 * limits).all()


def test_stiffness_goes_with_mass_where_springs_would_slip_much() -> None:
    step = 30 * 0.5e-15
    chosen = choose(YOUNG, DENSITY, WIDTH, step, courant=courant(step))
    assert chosen.stiffness_share is None
    assert abs(chosen.static_error) < 1e-9
    asked = choose(YOUNG, DENSITY, WIDTH, step, courant=courant(step), stiffness_share=0.01)
    assert asked.stiffness_share == 0.01
    assert asked.static_error > asked.mean_weight


def test_the_springs_of_a_short_step_end_at_the_largest_stiffness() -> None:
    chosen = choose(YOUNG, DENSITY, WIDTH, 1e-15, courant=courant(1e-15))
    assert chosen.relative_stiffness == pytest.approx(LARGEST_STIFFNESS)
    assert chosen.exchange_number < SPRING_NUMBER


@pytest.mark.parametrize(
    "given", [{"weight": 0.5}, {"stiffness_density": 1e31}, {"profile": "power"}, {"courant": 0.0}]
)
def test_what_the_scene_gives_leaves_stiffness_as_mass(given: dict[str, Any]) -> None:
    chosen = choose(YOUNG, DENSITY, WIDTH, 2e-15, **{"courant": courant(2e-15), **given})
    assert chosen.stiffness_share is None


def test_springs_that_are_given_are_kept_beside_a_small_stiffness() -> None:
    given = 100.0 * YOUNG / WIDTH**2
    chosen = choose(
        YOUNG, DENSITY, WIDTH, 5e-15, courant=courant(5e-15), stiffness_density=given, profile="power",
        stiffness_share=0.05,
    )  # fmt: skip
    assert chosen.stiffness_density == given
    assert chosen.profile == WeightProfile("power", SMALLEST_WEIGHT, LARGEST_EXPONENT, 0.05)


def test_a_coarser_grid_slips_less_than_theory_of_fine_bars() -> None:
    profile = WeightProfile("power", 0.05, 8.0, 0.01)
    errors = [static_error(profile, 300.0, cells) for cells in (2, 4, 8, 16, 50)]
    assert errors == sorted(errors)
    assert errors[-1] > 2.0 * errors[0]


def test_no_springs_are_exact_for_a_stiffness_of_its_own() -> None:
    with pytest.raises(ValueError, match="stiffness of its own"):
        exact_stiffness(WeightProfile("power", 0.05, 8.0, 0.01))
