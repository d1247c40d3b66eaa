"""How case `coupling/patch` tells strain: windows, what the unloaded run takes off, standard errors."""

import numpy as np
import pytest

from coordinator.scene import read_scene
from coordinator.verification_cases import patch
from coordinator.verification_cases.edge_texts import gradient_text
from coordinator.verification_cases.patch_strain import PatchState, standard_error, strain_errors, window_means
from coordinator.verification_cases.runs import shipped

CELL = 6.0
STRAIN = 1e-3
GRADIENT = STRAIN * patch.STATES["xx"]


def grid(low: float, high: float, step: float) -> np.ndarray:
    """Places in rows and columns, half a step from the borders."""
    one = np.arange(low + 0.5 * step, high, step)
    return np.stack(np.meshgrid(one, one, indexing="ij"), axis=-1).reshape(-1, 2)


ATOMS = grid(-30.0, 30.0, 1.0)
POINTS = grid(-60.0, 60.0, 3.0)
POINTS = POINTS[np.any(np.abs(POINTS) > 30.0, axis=1)]


def state(displacement: np.ndarray, strain: np.ndarray) -> PatchState:
    """A sample of 60 with a ring of 12 in a body of 120; displacement with or without blocks."""
    moved = displacement if displacement.ndim == 3 else displacement[None]
    return PatchState(
        ATOMS, moved, POINTS, strain, np.array([[-18.0] * 2, [18.0] * 2]), np.array([[-30.0] * 2, [30.0] * 2]),
        np.array([[-60.0] * 2, [60.0] * 2]), CELL,
    )  # fmt: skip


def uniform(factor: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    strain = np.tile([STRAIN, 0.0, 0.0], (len(POINTS), 1))
    return factor * ATOMS @ GRADIENT.T, factor * strain


def test_a_uniform_strain_has_no_error_whatever_the_unloaded_body_looks_like():
    rng = np.random.default_rng(1)
    relaxed, prestrain = rng.normal(0.0, 0.1, ATOMS.shape), rng.normal(0.0, 0.01, (len(POINTS), 3))
    u, e = uniform()
    found = strain_errors(state(u + relaxed, e + prestrain), state(relaxed, prestrain), GRADIENT)
    assert max(found.worst_inside, found.worst_outside, found.worst_handshake) < 1e-10
    assert np.abs(found.mean).max() < 1e-10


def test_errors_are_told_over_the_applied_strain_and_by_region():
    u, e = uniform()
    rest = state(0.0 * u, 0.0 * e)
    inside = np.all(np.abs(ATOMS) < 18.0, axis=1)
    # 1 % too much strain in all atoms, continuum as applied.
    found = strain_errors(state(1.01 * u, e), rest, GRADIENT)
    assert found.mean == pytest.approx([0.01, 0.0, 0.0], abs=1e-12)
    assert found.worst_inside == pytest.approx(0.01) and found.worst_outside < 1e-12
    # 4 % too much in the continuum within a cell of the ring: that is in the handshake; beyond nothing is off.
    near = np.all(np.abs(POINTS) < 30.0 + CELL, axis=1)
    found = strain_errors(state(u, e * np.where(near, 1.04, 1.0)[:, None]), rest, GRADIENT)
    assert found.worst_handshake == pytest.approx(0.04) and found.worst_outside < 1e-12
    # The rim of the body is left out, what lies before it is not.
    rim = np.any(np.abs(POINTS) > 60.0 - CELL, axis=1)
    found = strain_errors(state(u, e * np.where(rim, 1.5, 1.0)[:, None]), rest, GRADIENT)
    assert found.worst_outside < 1e-12
    between = ~rim & np.any(np.abs(POINTS) > 30.0 + CELL, axis=1)
    found = strain_errors(state(u, e * np.where(between, 0.98, 1.0)[:, None]), rest, GRADIENT)
    assert found.worst_outside == pytest.approx(0.02)
    # One atom off inside, by a tenth of a window's stretch: seen there, not in the ring.
    middle = np.argmin(np.linalg.norm(ATOMS, axis=1))
    moved = u.copy()
    moved[middle, 0] += 0.1 * STRAIN * 2.0 * CELL
    found = strain_errors(state(moved, e), rest, GRADIENT)
    assert found.worst_inside > 1e-4 and found.worst_handshake < 1e-12 and inside[middle]


def test_mean_over_windows_of_a_linear_field_is_its_value_in_the_middle():
    place = grid(0.0, 24.0, 0.5)
    value = np.column_stack([2.0 * place[:, 0] - place[:, 1], np.ones(len(place))])
    centre, mean = window_means(place, value, 4.0)
    full = np.all((centre > 4.0) & (centre < 20.0), axis=1)
    assert full.sum() == 16
    # Bins begin 0.004 below their first of eight places in a row: the middle of those is 0.246 below that of the bin.
    middle = centre - 0.246
    assert mean[full, 0] == pytest.approx(2.0 * middle[full, 0] - middle[full, 1])
    assert mean[:, 1] == pytest.approx(1.0)


def test_standard_errors_are_those_of_independent_blocks():
    rng = np.random.default_rng(2)
    told = standard_error(rng.normal(0.0, 3.0, (16, 4000)))
    assert np.sqrt(np.mean(told**2)) == pytest.approx(3.0 / 4.0, rel=0.03)
    assert np.array_equal(standard_error(np.ones((1, 5))), np.zeros(5))


def test_noise_that_both_runs_share_cancels_and_what_they_do_not_share_is_told():
    rng = np.random.default_rng(3)
    u, e = uniform()
    shared = 1e-2 * rng.normal(size=(8, *u.shape))
    one, other = (shared + 1e-3 * rng.normal(size=shared.shape) for _ in range(2))
    found = strain_errors(state(u + one, e), state(other, 0.0 * e), GRADIENT)
    far = np.abs(found.atoms[found.inside]) / found.atoms_error[found.inside]
    # Of Student's t with 7 degrees of freedom 48 % lie within 0.67 and 8.6 % beyond 2; windows overlap.
    assert 0.35 < np.mean(far < 0.67) < 0.61 and np.mean(far > 2.0) < 0.18
    # The error of a slope by least squares over n points with x of variance s2: noise / sqrt(n s2 blocks).
    n, spread = 12.0**2, (12.0**2 - 1.0) / 12.0
    whole = np.all(np.abs(found.place) < 12.0, axis=1)
    expected = np.sqrt(2.0) * 1e-3 / np.sqrt(n * spread * 8) / STRAIN
    assert np.sqrt(np.mean(found.atoms_error[whole, 0] ** 2)) == pytest.approx(expected, rel=0.15)
    assert found.mean_scatter[0] > 3.0 * found.mean_error[0]


@pytest.mark.parametrize("body", [patch.LATTICE, patch.ARGON, patch.GRAPHENE, patch.HOT_GRAPHENE])
def test_the_scenes_are_squares_of_the_size_that_the_case_takes_them_for(body):
    scene = read_scene(shipped(body.scene) + gradient_text(body.strain * patch.STATES["xy"], body.half), body.scene)
    assert scene.continuum.lower == pytest.approx((-body.half, -body.half))
    assert scene.continuum.upper == pytest.approx((body.half, body.half))
    assert body.blocks == 1 or scene.atomistic.fields is not None
