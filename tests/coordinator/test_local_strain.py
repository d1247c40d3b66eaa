"""Local strain against displacement fields with known gradients."""

from __future__ import annotations

import numpy as np
import pytest

from coordinator.local_strain import local_strain, mean_gradient

RNG = np.random.default_rng(11)
POINTS = RNG.uniform(-5e-9, 5e-9, size=(4000, 2))
GRADIENT = np.array([[0.002, 0.01], [-0.004, 0.013]])


def test_a_linear_field_is_exact_everywhere() -> None:
    found = local_strain(POINTS, POINTS @ GRADIENT.T + [1e-10, -2e-10], 3e-10)
    assert len(found.centre) > 900
    np.testing.assert_allclose(found.gradient, np.broadcast_to(GRADIENT, found.gradient.shape), atol=1e-13)
    np.testing.assert_allclose(mean_gradient(POINTS, POINTS @ GRADIENT.T), GRADIENT, atol=1e-15)
    np.testing.assert_allclose(found.yy, 0.013, atol=1e-13)


def test_a_quadratic_field_gives_the_gradient_at_the_centre() -> None:
    axis = np.linspace(-4.95e-9, 4.95e-9, 100)  # regular points: no noise of their places
    points = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    curvature = 1e7
    displacement = np.column_stack([np.zeros(len(points)), 0.5 * curvature * points[:, 1] ** 2])
    found = local_strain(points, displacement, 4e-10)
    inner = np.all(np.abs(found.centre) < 4.0e-9, axis=1)
    # centres of the fits lie within the bin's shift and the spacing of the points around the bin's centre
    np.testing.assert_allclose(found.yy[inner], curvature * found.centre[inner, 1], atol=curvature * 0.6e-10)


def test_noise_averages_as_least_squares_says() -> None:
    axis = np.arange(60) * 1e-10
    points = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    noise = 1e-12
    found = local_strain(points, RNG.normal(0.0, noise, points.shape), 3e-10)
    full = found.count == 81
    # standard error of a slope: noise / sqrt(sum of squares); 9 rows of 9 points, spacing 1e-10
    expected = noise / np.sqrt(9 * np.sum((np.arange(9) - 4.0) ** 2) * 1e-20)
    assert full.sum() > 200
    assert np.std(found.yy[full]) == pytest.approx(expected, rel=0.15)


def test_too_few_points_give_no_strain() -> None:
    assert len(local_strain(POINTS[:0], POINTS[:0], 1e-10).centre) == 0
    line = np.column_stack([np.linspace(0, 1e-9, 50), np.zeros(50)])
    assert len(local_strain(line, 0.01 * line, 3e-10).centre) == 0, "a line determines no gradient across it"
    with pytest.raises(ValueError, match="2 points do not determine a gradient"):
        mean_gradient(POINTS[:2], POINTS[:2])
