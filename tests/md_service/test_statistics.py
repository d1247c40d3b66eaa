import numpy as np
import pytest

from md_service.statistics import block_standard_error, scatter_about_line


def test_block_standard_error_of_a_correlated_series_against_the_closed_form():
    # x_i = c x_(i-1) + noise: variance of the mean of n entries is var / n (1 + c) / (1 - c) for large n.
    c, n = 0.8, 4096
    noise = np.random.default_rng(3).normal(size=(n, 50))
    series = np.zeros_like(noise)
    for i in range(1, n):
        series[i] = c * series[i - 1] + noise[i]
    expected = np.sqrt(1.0 / (1.0 - c**2) / n * (1.0 + c) / (1.0 - c))
    naive = np.std(series, axis=0).mean() / np.sqrt(n)
    measured = block_standard_error(series)
    assert naive < 0.4 * expected
    # The largest of several estimates, the coarsest of 8 blocks, lies somewhat above.
    assert expected < measured.mean() < 1.4 * expected
    assert (measured > 0.7 * expected).all()


def test_scatter_about_line_is_the_residual_of_a_straight_fit():
    rng = np.random.default_rng(5)
    time = np.arange(32.0)
    windows = rng.normal(size=(32, 3, 3)) + 4.0 * time[:, None, None]
    measured = scatter_about_line(windows)
    for i in range(3):
        for j in range(3):
            fit = np.polyval(np.polyfit(time, windows[:, i, j], 1), time)
            expected = np.sqrt(np.sum((windows[:, i, j] - fit) ** 2) / 30)
            assert measured[i, j] == pytest.approx(expected, rel=1e-10)


def test_scatter_about_line_does_not_see_a_steady_load():
    windows = np.linspace(0.0, 7.0, 12)[:, None] * [1.0, -3.0]
    np.testing.assert_allclose(scatter_about_line(windows), 0.0, atol=1e-13)


def test_too_short_series_are_refused():
    with pytest.raises(ValueError, match="series has 1"):
        block_standard_error(np.zeros((1, 3)))
    with pytest.raises(ValueError, match="windows has 2"):
        scatter_about_line(np.zeros((2, 3)))
