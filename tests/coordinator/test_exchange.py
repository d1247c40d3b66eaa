"""The exchange: what each service is asked, in which order, with which anchors and forces."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
import pytest

from coordinator.books import Books
from coordinator.exchange import Exchange
from coordinator.frame import Frame
from protocol import atomistic as a
from protocol import continuum as c

DT = 1e-14
ANCHORS = 3


class Continuum:
    """A continuum whose anchors have been told displacements."""

    def __init__(self, displacements: list[float]) -> None:
        self.asked: list[c.ContinuumAdvance] = []
        self._left = list(displacements)
        self._now = 0.0

    def call(self, operation: str, request: c.ContinuumAdvance, reply: Any, step: int = 0) -> c.ContinuumAdvanced:
        self.asked.append(request)
        if request.anchor_force is not None or request.ivc_force is not None or request.steps == 1:
            self._now = self._left.pop(0) if self._left else self._now
        return c.ContinuumAdvanced.model_construct(
            step=step, events=[], tips=[], anchor_displacement=np.full((ANCHORS, 3), self._now)
        )


class Atoms:
    """A region that answers a force of its own number, and keeps where its anchors were set."""

    def __init__(self, force: float, meet: threading.Barrier | None = None) -> None:
        self.placed: list[np.ndarray] = []
        self.speeds: list[np.ndarray] = []
        self.anchor_reference = np.zeros((ANCHORS, 3))
        self.scene: Any = type("S", (), {"handshake": type("H", (), {"motion": "held"})()})()
        self._force, self._meet = force, meet

    def advance(self, position: np.ndarray, velocity: np.ndarray, step: int) -> a.AtomisticAdvanced:
        if self._meet is not None:
            self._meet.wait(5.0)
        self.placed.append(position.copy())
        self.speeds.append(velocity.copy())
        force = np.full((ANCHORS, 3), self._force * len(self.placed))
        return a.AtomisticAdvanced.model_construct(anchor_force=force, ivc_force=force[:1])


def exchange(continuum: Any, *atoms: Any, n: int = 1, spread: str = "anchor", parallel: bool = False) -> Exchange:
    return Exchange(continuum, atoms, DT, n, spread, parallel)


def test_serial_sets_anchors_where_the_continuum_is_now_and_hands_back_the_last_reaction() -> None:
    continuum, atoms = Continuum([1.0, 3.0]), Atoms(2.0)
    loop = exchange(continuum, atoms)
    first, second = loop.advance(1), loop.advance(2)
    assert continuum.asked[0].anchor_force is None
    np.testing.assert_array_equal(continuum.asked[1].anchor_force, 2.0)
    assert [place[0, 0] for place in atoms.placed] == [1.0, 3.0]
    np.testing.assert_allclose([speed[0, 0] * DT for speed in atoms.speeds], [1.0, 2.0])
    np.testing.assert_array_equal(first.moved, 1.0)
    np.testing.assert_array_equal(second.moved, 2.0)


def test_regions_get_their_own_anchors_and_their_forces_follow_each_other() -> None:
    continuum, left, right = Continuum([1.0, 1.0]), Atoms(2.0), Atoms(5.0)
    continuum.call = _twice(continuum.call)  # type: ignore[method-assign]
    loop = exchange(continuum, left, right)
    loop.advance(1)
    assert loop.reaction is not None
    np.testing.assert_array_equal(loop.reaction[:, 0], [2.0] * ANCHORS + [5.0] * ANCHORS)


def _twice(call: Any) -> Any:
    def doubled(*arguments: Any, **named: Any) -> Any:
        reply = call(*arguments, **named)
        return reply.model_copy(update={"anchor_displacement": np.tile(reply.anchor_displacement, (2, 1))})

    return doubled


def test_sub_steps_take_the_force_as_one_impulse_in_the_first() -> None:
    continuum = Continuum([1.0, 2.0])
    loop = exchange(continuum, Atoms(2.0), n=4, spread="ivc")
    loop.advance(1)
    loop.advance(2)
    steps = [(request.steps, request.ivc_force) for request in continuum.asked]
    assert [steps[k][0] for k in range(4)] == [1, 3, 1, 3]
    assert steps[0][1] is steps[1][1] is steps[3][1] is None
    np.testing.assert_array_equal(steps[2][1], 4 * 2.0)


def test_parallel_runs_both_at_once_with_anchors_predicted() -> None:
    meet = threading.Barrier(2)

    class Meeting(Continuum):
        def call(self, *arguments: Any, **named: Any) -> Any:
            meet.wait(5.0)  # neither gets on before the other has begun
            return super().call(*arguments, **named)

    places = [1.0, 3.0, 4.0, 4.5]
    atoms = Atoms(2.0, meet)
    loop = exchange(Meeting(places), atoms, parallel=True)
    for step in range(4):
        loop.advance(step + 1)
    u = np.array([0.0, *places])
    v = np.diff(u, prepend=0.0)
    before = np.concatenate([[0.0], v[:-1]])
    np.testing.assert_allclose([place[0, 0] for place in atoms.placed], (u + v + v - before)[:4], atol=1e-12)


def test_a_preload_is_where_the_anchors_begin() -> None:
    continuum, atoms = Continuum([7.0]), Atoms(2.0)
    loop = exchange(continuum, atoms)
    loop.start_at(np.full((ANCHORS, 3), 5.0))
    loop.hold(0)
    found = loop.advance(1)
    assert [place[0, 0] for place in atoms.placed] == [5.0, 7.0]
    np.testing.assert_array_equal(atoms.speeds[0], 0.0)
    np.testing.assert_allclose(atoms.speeds[1], 2.0 / DT)
    np.testing.assert_array_equal(continuum.asked[0].anchor_force, 2.0)  # of the hold
    np.testing.assert_array_equal(found.moved, 2.0)


def test_its_state_is_restored() -> None:
    one = exchange(Continuum([1.0, 3.0]), Atoms(2.0))
    one.advance(1)
    other = exchange(Continuum([3.0]), Atoms(2.0))
    other.restore(one.state())
    np.testing.assert_array_equal(one.advance(2).moved, other.advance(2).moved)
    np.testing.assert_array_equal(one.anchor_velocity, other.anchor_velocity)


# --- frames ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_frame_takes_places_there_and_back(mirrored: bool) -> None:
    frame = Frame((3.0, -2.0), mirrored)
    place = np.array([[1.0, 2.0, 5.0], [0.0, 0.0, 0.0]])
    there = frame.to_scene(place)
    np.testing.assert_array_equal(there[1], [3.0, -2.0, 0.0])
    np.testing.assert_array_equal(there[0], [3.0 - 1.0 if mirrored else 3.0 + 1.0, 0.0, 5.0])
    np.testing.assert_array_equal(frame.to_sample(there), place)
    np.testing.assert_array_equal(frame.turn(frame.turn(place)), place)
    assert frame.x_to_sample(frame.x_to_scene(0.7)) == pytest.approx(0.7)


# --- books -------------------------------------------------------------------------------------------------------


def books_of(held: float, work: float, filtered: float | None, way: float = 0.0) -> c.ContinuumAdvanced:
    return c.ContinuumAdvanced.model_construct(
        kinetic_energy=0.25 * held, strain_energy=0.75 * held, damping_loss=0.5, dissipated_energy=0.25,
        filter_loss=filtered, edge_work=work, load_work=0.0, interface_work=-1.0,
        anchor_velocity=np.full((2, 3), way / DT),
    )  # fmt: skip


def atoms_of(kinetic: float, spring: float, work: float, heat: float, force: float, momentum: float) -> Any:
    return a.AtomisticAdvanced.model_construct(
        kinetic_energy=kinetic, potential_energy=-3.0, spring_energy=spring, anchor_work=work, thermostat_work=heat,
        anchor_force=np.full((2, 3), force), momentum=(momentum, 0.0, 0.0), windows=1,
    )  # fmt: skip


def test_books_begin_with_the_first_step_and_miss_by_what_nothing_explains() -> None:
    books, still = Books(), np.zeros((2, 3))
    first = books.enter(books_of(4.0, 2.0, 0.0), [atoms_of(1.0, 0.5, 0.1, 0.0, 0.0, 0.0)], still, still, DT)
    assert first["residual_continuum"] == first["residual_atoms"] == first["residual_interface"] == 0.0
    # Held grew by 3 with work of 2.5, of which the filter took 0.25: 0.75 too much.
    moved, reference = np.full((2, 3), 0.5), np.full((2, 3), 0.25)
    atoms = atoms_of(kinetic=1.5, spring=0.75, work=0.4, heat=-0.1, force=2.0, momentum=-4.0 * DT)
    values = books.enter(books_of(7.0, 4.5, 0.25, way=0.1), [atoms], moved, reference, DT)
    assert values["residual_continuum"] == pytest.approx(0.75)
    assert values["residual_atoms"] == pytest.approx(0.5 - 0.3)
    assert values["reference_work"] == pytest.approx(0.75)
    # What springs store, what they gave less heat, reference work; and half the work of six components of 2 N over the
    # last way, which the next step makes.
    assert values["residual_interface"] == pytest.approx(0.25 + 0.3 + 0.1 + 0.75 + 0.5 * 6 * 2.0 * 0.1)
    # Forces of 2 and reference forces of 0.25 at two anchors act back on the atoms.
    assert values["residual_momentum_x"] == pytest.approx(-4.0 * DT + 2 * 2.25 * DT)


def test_books_are_restored() -> None:
    books, other = Books(), Books()
    still = np.zeros((2, 3))
    books.enter(books_of(4.0, 2.0, 0.0), [atoms_of(1.0, 0.5, 0.1, 0.0, 0.0, 1.0)], still, still, DT)
    other.restore(books.state())
    step = (books_of(5.0, 2.0, 0.1), [atoms_of(1.0, 0.5, 0.2, 0.0, 1.0, 2.0)], still + 1.0, still + 0.5, DT)
    assert books.enter(*step) == other.enter(*step)
