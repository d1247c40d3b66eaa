import numpy as np
import pytest
from scipy.signal import lfilter

from md_service.statistics import (
    estimate,
    scatter_about_line,
    settled,
    windows_needed,
)


def correlated(c, n, columns, seed=3):
    """x_i = c x_(i-1) + noise, of variance 1 and mean 0, in equilibrium from the first entry."""
    rng = np.random.default_rng(seed)
    series = rng.normal(size=(n, columns))
    for i in range(1, n):
        series[i] = c * series[i - 1] + np.sqrt(1.0 - c**2) * series[i]
    return series


def exact_standard_error(c, n):
    lag = np.arange(1, n)
    return np.sqrt((1.0 + 2.0 * np.sum((1.0 - lag / n) * c**lag)) / n)


def test_standard_error_of_a_correlated_series_against_the_closed_form():
    c, n = 0.8, 4096
    series = correlated(c, n, 50)
    expected = exact_standard_error(c, n)
    naive = np.std(series, axis=0).mean() / np.sqrt(n)
    measured = estimate(series, 1.0).standard_error
    assert naive < 0.4 * expected
    assert measured.mean() == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize(
    ("c", "n", "low", "high"),
    [
        (0.0, 8, 0.97, 1.13),
        (0.0, 1000, 0.96, 1.04),
        (0.5, 32, 0.90, 1.02),
        (0.5, 1000, 0.95, 1.05),
        (0.8, 256, 0.93, 1.06),
        (0.8, 4096, 0.96, 1.05),
        (0.95, 4096, 0.93, 1.07),
        (-0.5, 256, 0.95, 1.06),
    ],
)
def test_error_and_correlation_time_against_the_closed_form(c, n, low, high):
    """Root mean square over 400 series; single ones scatter by what `uncertainty` tells."""
    interval = 5e-15
    found = estimate(correlated(c, n, 400, seed=n), interval)
    ratio = found.standard_error / exact_standard_error(c, n)
    assert low < np.sqrt(np.mean(ratio**2)) < high
    assert 0.8 < np.mean(found.uncertainty) / np.std(ratio) < 1.6
    tau = 0.5 * interval * (1.0 + c) / (1.0 - c)
    if n * interval > 50 * tau:
        assert found.correlation_time.mean() == pytest.approx(tau, rel=0.1)


def test_error_of_a_series_that_swings_against_its_scatter():
    """A damped oscillation in noise: neighbours alike, entries half a period apart opposite."""
    swing, damping, n = 2.0 * np.pi / 8.0, np.exp(-1.0 / 3.0), 256
    noise = np.random.default_rng(7).normal(size=(n + 200, 600))
    series = lfilter([1.0], [1.0, -2.0 * damping * np.cos(swing), damping**2], noise, axis=0)[200:]
    found = estimate(series, 1.0)
    scatter = np.std(found.mean)
    assert np.sqrt(np.mean(found.standard_error**2)) == pytest.approx(scatter, rel=0.12)
    independent = np.std(series) / np.sqrt(n)
    assert independent < 0.8 * scatter  # so blocks are needed


def test_the_mean_lies_within_two_standard_errors_as_often_as_it_should():
    found = estimate(correlated(0.8, 512, 2000, seed=8), 1.0)
    inside = np.mean(np.abs(found.mean) < 2.0 * found.standard_error)
    assert 0.88 < inside < 0.95  # 0.954 for an error known without scatter


def test_a_series_far_too_short_for_its_correlation_is_told_less_than_its_error():
    """What the docstring says of series of two correlation times; nothing can do better without a model."""
    ratio = estimate(correlated(0.8, 8, 1000), 1.0).standard_error / exact_standard_error(0.8, 8)
    assert 0.3 < ratio.mean() < 0.5


def test_components_are_estimated_each_for_itself_and_scale_with_unit_and_interval():
    series = np.stack([correlated(c, 400, 3, seed=9) for c in (0.0, 0.9)], axis=1)
    whole = estimate(series, 2.0)
    assert whole.mean.shape == whole.standard_error.shape == (2, 3)
    for i in range(2):
        for j in range(3):
            alone = estimate(-1e-9 * series[:, i, j] + 1e-9, 1.0)
            assert alone.mean == pytest.approx(1e-9 - 1e-9 * whole.mean[i, j], rel=1e-12)
            assert alone.standard_error == pytest.approx(1e-9 * whole.standard_error[i, j], rel=1e-9)
            assert 2.0 * alone.correlation_time == pytest.approx(whole.correlation_time[i, j], rel=1e-9)


def test_a_constant_series_has_no_error_and_no_drift():
    found = estimate(np.full((20, 2), [3.0, 0.0]), 1e-15)
    np.testing.assert_array_equal(found.mean, [3.0, 0.0])
    np.testing.assert_array_equal(found.standard_error, 0.0)
    np.testing.assert_allclose(found.correlation_time, 0.5e-15)
    looked = settled(np.full((20, 2), [0.1, 0.0]))
    assert looked.settled
    np.testing.assert_allclose(looked.drift, 0.0, atol=1e-15)


def test_the_error_of_a_drift_is_its_scatter_over_series_of_noise():
    for c, n in ((0.0, 64), (0.7, 512)):
        looked = settled(correlated(c, n, 1000, seed=4))
        scatter = np.std(looked.drift)
        assert 0.85 < looked.standard_error.mean() / scatter < 1.1
        below = np.mean(np.abs(looked.drift) < looked.standard_error)
        assert 0.55 < below < 0.75  # 0.68 for an error known without scatter


def test_the_drift_is_the_rise_of_the_line_over_the_length():
    noise = correlated(0.3, 200, 1, seed=6)[:, 0]
    time = np.arange(200)
    slope = np.polyfit(time, noise + 0.05 * time, 1)[0]
    looked = settled(noise + 0.05 * time)
    assert looked.drift == pytest.approx(200 * slope, rel=1e-10)
    assert not looked.settled
    assert not settled(np.linspace(0.0, 1.0, 50)).settled


def test_a_relaxing_energy_settles_once_it_has_decayed_into_its_noise():
    time = np.arange(800)
    energy = 6.0 * np.exp(-time[:, None] / 60.0) + correlated(0.6, 800, 300, seed=12)
    settled_at = [np.mean([settled(energy[s : s + 200, i]).settled for i in range(300)]) for s in (0, 100, 300, 600)]
    assert settled_at[0] == 0.0
    assert settled_at[1] < 0.25  # e^(-100/60) of 6 is 1.1, over the noise of 1
    assert settled_at[2] > 0.5
    assert 0.6 < settled_at[3] < 0.8


def test_several_components_settle_together():
    """One of six that drifts by ten of its errors is seen; six of noise pass in half of the looks."""
    noise = correlated(0.5, 256, 6 * 200, seed=2).reshape(256, 200, 6)
    passed = np.mean([settled(noise[:, i]).settled for i in range(200)])
    assert 0.4 < passed < 0.6
    one = noise[:, 0] + np.outer(np.linspace(0.0, 4.0, 256), [0, 0, 1, 0, 0, 0])
    assert not settled(one).settled


def test_windows_needed_for_an_error():
    assert windows_needed([0.1, 0.2], 40, 0.1) == 160
    assert windows_needed(0.2, 40, 0.19) == 45
    assert windows_needed([0.01], 40, 0.1) == 8
    assert windows_needed(np.zeros((0, 3)), 40, 0.1) == 8
    # It holds: over series so long the error is what was asked for.
    start = correlated(0.5, 400, 200, seed=1)
    needed = windows_needed(np.sqrt(np.mean(estimate(start, 1.0).standard_error ** 2)), 400, 0.04)
    assert exact_standard_error(0.5, needed) == pytest.approx(0.04, rel=0.1)


@pytest.mark.parametrize(("c", "n", "low", "high"), [(0.0, 8, 0.9, 1.1), (0.0, 64, 0.97, 1.03), (0.8, 64, 0.92, 1.05)])
def test_scatter_about_line_is_that_of_the_entries(c, n, low, high):
    """Variance 1, for independent and for correlated windows."""
    told = scatter_about_line(correlated(c, n, 1000, seed=5).reshape(n, 100, 10))
    assert told.shape == (100, 10)
    assert low < np.sqrt(np.mean(told**2)) < high


def test_scatter_of_few_windows_is_the_residual_of_a_straight_fit():
    time = np.arange(6.0)
    windows = np.random.default_rng(5).normal(size=6) + 4.0 * time
    fit = np.polyval(np.polyfit(time, windows, 1), time)
    assert scatter_about_line(windows) == pytest.approx(np.sqrt(np.sum((windows - fit) ** 2) / 4), rel=1e-10)


def test_scatter_about_line_does_not_see_a_steady_load():
    noise = correlated(0.5, 40, 3)
    load = np.linspace(0.0, 70.0, 40)[:, None]
    np.testing.assert_allclose(scatter_about_line(noise + load), scatter_about_line(noise), rtol=1e-10)
    windows = np.linspace(0.0, 7.0, 12)[:, None] * [1.0, -3.0]
    np.testing.assert_allclose(scatter_about_line(windows), 0.0, atol=1e-13)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: scatter_about_line(np.zeros((2, 3))), "windows has 2"),
        (lambda: estimate(np.zeros((7, 3)), 1.0), "series has 7 entries; at least 8"),
        (lambda: estimate(3.0, 1.0), "series has 0 entries"),
        (lambda: estimate(np.full(9, np.nan), 1.0), "series holds values that are not finite"),
        (lambda: estimate(np.zeros(9), 0.0), "interval is 0.0 s"),
        (lambda: settled(np.zeros(7)), "series has 7 entries"),
        (lambda: windows_needed(0.1, 0, 0.1), "windows is 0"),
        (lambda: windows_needed(0.1, 8, 0.0), "target is 0.0"),
        (lambda: windows_needed(np.nan, 8, 0.1), "standard_error holds"),
    ],
)
def test_bad_input_names_field_and_value(call, message):
    with pytest.raises(ValueError, match=message):
        call()
