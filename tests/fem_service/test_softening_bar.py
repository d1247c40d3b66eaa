"""Bars with one brick that softens: the solver against the closed form of bricks in series, and past a snap-back."""

from __future__ import annotations

import numpy as np
import pytest

from fem_service.acceleration import Acceleration
from fem_service.equilibrium import Equilibrium
from fem_service.laminate_mesh import stack
from fem_service.plane_mesh import rectangle
from fem_service.point_material import PointAnswer, PointState
from fem_service.quasi_static import QuasiStatic
from fem_service.tension import tension_grips

YOUNG, STRENGTH, END = 10e9, 50e6, 4.0  # Pa; strain at the end of softening over that at its start
START = STRENGTH / YOUNG
SIDE = 1e-3  # m, of each brick


class OneSoftens:
    """Springs along each axis without contraction; the points of one brick soften along x, with secant stiffnesses."""

    softens = True

    def __init__(self, points: slice, bricks: int) -> None:
        self.soft = np.zeros(8 * bricks, dtype=bool)
        self.soft[points] = True

    def fresh(self, points: int) -> PointState:
        return PointState(np.zeros((points, 0), np.uint8), np.zeros((points, 1)))

    def intact(self, points: int) -> PointAnswer:
        return self.respond(np.zeros((points, 6)), self.fresh(points), np.zeros(points))

    def respond(self, strain: np.ndarray, state: PointState, element_length: np.ndarray) -> PointAnswer:
        ratio = np.maximum(strain[:, 0] / START, 1.0)
        kept = np.where(self.soft, np.maximum((END - ratio) / (ratio * (END - 1.0)), 1e-6), 1.0)
        damage = np.maximum(state.history[:, 0], 1.0 - kept)
        tangents = np.repeat(np.diag([YOUNG] * 3 + [0.5 * YOUNG] * 3)[None], len(strain), axis=0)
        tangents[:, 0, 0] *= 1.0 - damage
        stress = np.einsum("pij,pj->pi", tangents, strain)
        return PointAnswer(stress, PointState(state.failed, damage[:, None]), np.arange(len(strain)), tangents)


def bar(bricks: int) -> QuasiStatic:
    """Bricks in a row along x, the first of which softens; the load is the elongation."""
    mesh = stack(rectangle(bricks * SIDE, SIDE, bricks, 1), np.zeros(1), SIDE)
    return QuasiStatic(mesh, OneSoftens(slice(0, 8), bricks), tension_grips(mesh), tolerance=1e-9, iterations=200)


def pulled(laminate: QuasiStatic, loads: np.ndarray) -> list[Equilibrium]:
    found = [laminate.rest()]
    for load in loads:
        found.append(laminate.advance(found[-1], float(load)))
    return found[1:]


def test_a_bar_that_does_not_snap_back_follows_its_closed_form(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two bricks: the force falls in a straight line from the elongation 2 START SIDE to none at 4 START SIDE."""
    laminate = bar(2)
    last = END * START * SIDE
    loads = np.linspace(0.05, 1.0, 20) * last
    found = pulled(laminate, loads)
    first = 2.0 * START * SIDE
    expected = np.where(loads <= first, STRENGTH * loads / first, STRENGTH * (last - loads) / (last - first)) * SIDE**2
    # At the end the brick keeps a millionth of its stiffness.
    assert [one.force for one in found] == pytest.approx(expected, rel=1e-6, abs=1e-4 * STRENGTH * SIDE**2)
    monkeypatch.setattr(Acceleration, "mixed", lambda self, place, step, force: step)
    plain = pulled(laminate, loads)
    assert max(one.iterations for one in found) < 0.5 * max(one.iterations for one in plain)


def test_a_bar_that_snaps_back_comes_to_rest_beyond() -> None:
    """Five bricks would have to go back: past the strength of the first there is nothing but the broken bar."""
    laminate = bar(5)
    first = 5.0 * START * SIDE
    whole, broken = pulled(laminate, np.array([0.999, 1.05]) * first)
    assert whole.force == pytest.approx(0.999 * STRENGTH * SIDE**2, rel=1e-9)
    assert not whole.points.history.any()
    assert 0.0 < broken.force < 1e-4 * STRENGTH * SIDE**2
    assert broken.points.history[:8] == pytest.approx(1.0 - 1e-6, abs=1e-12)
    assert not broken.points.history[8:].any()


def test_mixed_steps_end_a_linear_iteration_of_three_unknowns_after_four() -> None:
    """Then the differences of the steps span the space; the plain iteration still has a tenth of its error."""
    random = np.random.default_rng(2)
    basis = np.linalg.qr(random.normal(size=(3, 3)))[0]
    matrix = basis @ np.diag([0.1, 0.4, 0.7]) @ basis.T
    wanted = random.normal(size=3)
    places = []
    for mixes in (True, False):
        acceleration, place = Acceleration(), np.zeros(3)
        for _ in range(4):
            step = matrix @ (wanted - place)
            place = place + (acceleration.mixed(place, step, step) if mixes else step)
        places.append(place)
    assert places[0] == pytest.approx(wanted, abs=1e-12)
    assert np.abs(places[1] - wanted).max() > 0.1 * np.abs(wanted).max()


def test_a_mixed_step_against_the_force_is_not_taken() -> None:
    acceleration = Acceleration()
    acceleration.mixed(np.array([0.0]), np.array([1.0]), np.array([1.0]))
    # Steps of 1 and then 2 where the place went on by 1: the line through them ends behind.
    step = np.array([2.0])
    assert acceleration.mixed(np.array([1.0]), step, np.array([1.0])) is step
    # And that is all it remembers.
    assert acceleration.mixed(np.array([5.0]), np.array([0.5]), np.array([1.0])) == pytest.approx(0.5)
