"""Hard cases of the handshake that need no run: extreme M and springs, a ring one cell wide, anchors on grid lines."""

from __future__ import annotations

import math

import numpy as np
import pytest

from coordinator.handshake import STABILITY_LIMIT, HandshakeError, choose
from mpm_service.service import MaterialPointService
from protocol import continuum as c

# The harmonic lattice of the shipped scenes.
MASS, SPACING, THICKNESS, SPRING = 6.6335e-26, 3.45e-10, 2.8169e-10, 250.0
YOUNG = 2.0 * SPRING / (math.sqrt(3.0) * THICKNESS)
DENSITY = MASS / (0.5 * math.sqrt(3.0) * SPACING**2 * THICKNESS)
SPEED = math.sqrt(YOUNG / DENSITY)
CELL, WIDTH = 8e-10, 24e-10


def courant(step: float) -> float:
    return SPEED * step / CELL


def test_one_step_per_exchange_is_far_inside_the_limit() -> None:
    chosen = choose(YOUNG, DENSITY, WIDTH, 1e-15, damping_time=2e-13, courant=courant(1e-15))
    assert chosen.exchange_number < 0.25
    assert abs(chosen.static_error) < 0.1


def test_a_thousand_steps_per_exchange_are_refused_with_the_limit_named() -> None:
    with pytest.raises(HandshakeError, match="steps_per_exchange") as caught:
        choose(YOUNG, DENSITY, WIDTH, 1000e-15, damping_time=2e-13, courant=courant(1000e-15))
    assert str(STABILITY_LIMIT["serial"]) in str(caught.value)


def test_springs_a_hundred_times_as_stiff_are_refused_and_a_hundredth_is_stable_but_slips() -> None:
    step = 10e-15
    plain = choose(YOUNG, DENSITY, WIDTH, step, courant=courant(step))

    def with_springs(factor: float) -> float:
        return choose(
            YOUNG, DENSITY, WIDTH, step, courant=courant(step), weight=plain.weight, profile="power",
            stiffness_density=factor * plain.stiffness_density, stiffness_share=plain.stiffness_share,
        ).static_error  # fmt: skip

    with pytest.raises(HandshakeError, match=r"handshake\.stiffness"):
        with_springs(100.0)
    # Springs in series with the bar: the softer they are, the further it stretches.
    assert with_springs(0.01) > 10.0 * abs(plain.static_error)


def test_a_ring_one_cell_wide_is_chosen_or_refused_but_never_unstable() -> None:
    for steps in (1, 3, 10, 30):
        try:
            chosen = choose(YOUNG, DENSITY, CELL, steps * 1e-15, courant=courant(steps * 1e-15))
        except HandshakeError as error:
            assert steps >= 10 and "steps_per_exchange" in str(error)
        else:
            assert chosen.exchange_number < STABILITY_LIMIT["serial"]


@pytest.mark.parametrize("shift", [0.0, 1e-16, -1e-16, 0.25])
def test_anchors_on_grid_lines_and_nodes_follow_a_linear_field_and_lose_no_force(shift: float) -> None:
    """On a line, a rounding error to either side, and inside a cell: the same answer."""
    side = 1e-9
    gradient = np.array([[1e7, 2e6], [-3e6, -1e7]])
    step = 1e-4 * side / 1e3
    service = MaterialPointService()
    service.configure(
        c.ContinuumConfigure(
            assumption="plane_stress", thickness=side,
            body=c.Rectangle(lower=(-14 * side, -14 * side), upper=(14 * side, 14 * side)), cell_size=side,
            points_per_cell=2, material=c.IsotropicMaterial(young=1e9, poisson=0.3, density=1e3),
            initial_velocity_gradient=tuple(gradient.ravel()), time_step=step,
        )
    )  # fmt: skip
    place = np.array([[0, 0], [1, 0], [0, 2], [3, 3], [2, -0.5], [-0.5, 1], [-2, 2]]) * side
    place = np.column_stack([place + shift * side, np.zeros(len(place))])
    cells = np.zeros(len(place), dtype=np.int64)
    service.register(
        c.ContinuumRegister(
            anchor_position=place, anchor_ivc=cells, ivc_lower=np.array([[-5 * side, -5 * side, 0.0]]),
            ivc_upper=np.array([[5 * side, 5 * side, 0.0]]),
        )
    )  # fmt: skip
    first = service.advance(c.ContinuumAdvance(steps=1, anchor_force=np.zeros((len(place), 3))))
    np.testing.assert_allclose(
        first.anchor_displacement[:, :2], step * place[:, :2] @ gradient.T, rtol=1e-6, atol=1e-9 * step * 1e7 * side
    )
    force = np.zeros((len(place), 3))
    force[:, 0], force[:, 1] = 1e-12 * np.arange(1, len(place) + 1), -3e-13
    pushed = service.advance(c.ContinuumAdvance(steps=1, anchor_force=force))
    assert first.momentum is not None and pushed.momentum is not None
    gained = np.array(pushed.momentum) - np.array(first.momentum)
    np.testing.assert_allclose(gained, step * force.sum(axis=0)[:2], rtol=1e-6)
