"""Cohesive layers against closed forms: areas under curves, onset, final opening, unloading, contact."""

from __future__ import annotations

import numpy as np
import pytest

from fem_service.cohesive_law import CohesiveLaw
from fem_service.cohesive_layer import CohesiveLayers
from fem_service.hexahedron import InvertedElement

#: Table 6.6: K = 2.71e8 MPa/mm, G_Ic = 0.2 and G_IIc = 1 N/mm, strengths 60 and 90 MPa, alpha = 1.
LAW = CohesiveLaw(2.71e17, 60e6, 90e6, 200.0, 1000.0, 1.0)
#: The same, soft enough to see its rising part.
SOFT = CohesiveLaw(1e14, 60e6, 90e6, 200.0, 1000.0, 1.6)
FACE = np.array([[0.0, 0.0, 0.0], [2e-3, 0.0, 0.0], [2e-3, 1e-3, 0.0], [0.0, 1e-3, 0.0]])


def layer(law: CohesiveLaw) -> CohesiveLayers:
    return CohesiveLayers(np.concatenate([FACE, FACE]), np.arange(8)[None], law)


def pull(law: CohesiveLaw, direction: np.ndarray, sizes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Tractions along the direction, and damage, while a layer opens evenly to sizes in turn."""
    one = layer(law)
    damage, tractions, damages = np.zeros((1, 4, 2)), [], []
    for size in sizes:
        found = one.respond(np.tile(size * direction, (1, 4, 1)), damage)
        damage = found.damage
        tractions.append(found.traction[0, 0] @ direction)
        damages.append(damage[0, 0, 0])
    return np.array(tractions), np.array(damages)


def direction_of(mix: float) -> np.ndarray:
    return np.array([np.sqrt(0.5 * mix), np.sqrt(0.5 * mix), np.sqrt(1.0 - mix)])


def test_final_opening_of_table_6_6() -> None:
    assert LAW.final_opening(0.0) == pytest.approx(6.66666667e-6, rel=1e-9)
    traction, damage = pull(LAW, direction_of(0.0), np.array([6.66e-6, 6.66666667e-6 * (1 + 1e-9)]))
    assert 0.0 < traction[0] < 0.002 * 60e6
    assert traction[1] == 0.0 and damage[1] == 1.0


@pytest.mark.parametrize("mix", [0.0, 0.2, 0.5, 0.9, 1.0])
@pytest.mark.parametrize("law", [LAW, SOFT])
def test_area_under_the_curve_is_the_toughness(law: CohesiveLaw, mix: float) -> None:
    wanted = law.opening_toughness + (law.sliding_toughness - law.opening_toughness) * mix**law.mix_exponent
    onset = 1.0 / (law.stiffness * np.sqrt((1 - mix) / law.normal_strength**2 + mix / law.shear_strength**2))
    final = law.final_opening(mix)
    # The curve is straight between these, so the trapezoidal rule is exact.
    sizes = np.array([0.0, onset, 0.5 * (onset + final), final, 1.1 * final])
    traction, _ = pull(law, direction_of(mix), sizes)
    assert np.trapezoid(traction, sizes) == pytest.approx(wanted, rel=1e-9)


@pytest.mark.parametrize("mix", [0.0, 0.3, 1.0])
def test_onset_meets_the_quadratic_criterion(mix: float) -> None:
    direction = direction_of(mix)
    onset = 1.0 / (SOFT.stiffness * np.sqrt((1 - mix) / 60e6**2 + mix / 90e6**2))
    traction, damage = pull(SOFT, direction, np.array([onset * (1 - 1e-9), onset * (1 + 1e-6)]))
    assert damage[0] == 0.0 < damage[1]
    vector = traction[0] * direction
    assert (vector[2] / 60e6) ** 2 + (vector[0] / 90e6) ** 2 + (vector[1] / 90e6) ** 2 == pytest.approx(1.0, rel=1e-6)


def test_unloading_goes_to_the_origin_and_damage_stays() -> None:
    final = SOFT.final_opening(0.0)
    sizes = np.array([0.5 * final, 0.25 * final, 0.0, 0.25 * final, 0.5 * final, 0.6 * final])
    traction, damage = pull(SOFT, direction_of(0.0), sizes)
    assert traction[1] == pytest.approx(0.5 * traction[0])
    assert traction[2] == 0.0
    assert np.array_equal(traction[3:5], traction[[1, 0]])
    assert np.all(damage[:5] == damage[0]) and damage[5] > damage[0]


def test_closed_faces_press_with_the_whole_stiffness() -> None:
    one = layer(SOFT)
    broken = np.ones((1, 4, 2))
    found = one.respond(np.tile([1e-6, 0.0, -1e-9], (1, 4, 1)), broken)
    assert np.allclose(found.traction[0], [0.0, 0.0, -1e-9 * SOFT.stiffness])
    assert np.array_equal(found.damage, broken)


@pytest.mark.parametrize("opening", [[3e-7, 2e-7, 2e-6], [2e-6, -1e-6, -3e-9], [1e-7, 0.0, 4e-7], [1e-5, 2e-6, 1e-9]])
@pytest.mark.parametrize("relaxation", [1.0, 0.3])
def test_the_tangent_is_the_derivative_whatever_the_mix(opening: list[float], relaxation: float) -> None:
    one = layer(SOFT)
    at, start, size = np.array(opening), np.zeros((1, 4, 2)), 1e-11
    found = one.respond(np.tile(at, (1, 4, 1)), start, relaxation)
    wanted = np.empty((3, 3))
    for j in range(3):
        step = size * np.eye(3)[j]
        more = one.respond(np.tile(at + step, (1, 4, 1)), start, relaxation).traction[0, 0]
        less = one.respond(np.tile(at - step, (1, 4, 1)), start, relaxation).traction[0, 0]
        wanted[:, j] = (more - less) / (2 * size)
    assert np.allclose(found.tangent[0, 0], wanted, rtol=1e-5, atol=1e-5 * np.abs(wanted).max())
    assert np.allclose(found.secant[0, 0] @ at, found.traction[0, 0], rtol=1e-12)


def test_forces_and_stiffness_of_an_element() -> None:
    one = layer(SOFT)
    assert one.areas.sum() == pytest.approx(2e-6)
    assert np.allclose(one.normals, [0.0, 0.0, 1.0])
    displacement = np.random.default_rng(3).normal(size=(8, 3)) * 1e-9
    displacement[4:, 2] = np.abs(displacement[4:, 2]) + displacement[:4, 2]  # open everywhere
    found = one.respond(one.openings(displacement), np.zeros((1, 4, 2)))
    force = one.forces(found.traction)[0]
    assert np.allclose(force, one.stiffnesses(found.tangent)[0] @ displacement.reshape(-1), rtol=1e-12)
    assert np.abs(force.reshape(8, 3).sum(axis=0)).max() < 1e-12 * np.abs(force).max()
    assert one.energy(found, one.openings(displacement)) == pytest.approx(0.5 * force @ displacement.reshape(-1))


def test_viscosity_delays_damage_by_its_share() -> None:
    one = layer(SOFT)
    size = 0.5 * SOFT.final_opening(0.0)
    opening = np.tile([0.0, 0.0, size], (1, 4, 1))
    found = one.respond(opening, np.zeros((1, 4, 2)), relaxation=0.25)
    damage, follower = found.damage[0, 0]
    assert follower == pytest.approx(0.25 * damage)
    assert found.traction[0, 0, 2] == pytest.approx((1 - follower) * SOFT.stiffness * size)


def test_wrong_constants_and_faces_are_named() -> None:
    with pytest.raises(ValueError, match="stiffness is -1"):
        CohesiveLaw(-1.0, 60e6, 90e6, 200.0, 1000.0)
    with pytest.raises(ValueError, match="opening_toughness is 100 J/m"):
        CohesiveLaw(1e13, 60e6, 90e6, 100.0, 1000.0)
    nodes = np.concatenate([FACE, FACE])
    with pytest.raises(InvertedElement, match="element 1"):
        CohesiveLayers(nodes, np.array([np.arange(8), [0, 2, 1, 3, 4, 6, 5, 7]]), SOFT)
