"""The closed forms and figures that verification cases of the material point solver are held against."""

import numpy as np
import pytest
from scipy.optimize import brentq

from mpm_service.verification.beam_theory import (
    Beam,
    bernoulli_deflection,
    elastic_deflection,
    elastic_harmonic,
    timoshenko_deflection,
)
from mpm_service.verification.manufactured import StretchingSquare
from mpm_service.verification.signals import mean_period, observed_order, read_front

NU = 0.3
RHO = 1.3


def beam(length: float, angular_frequency: float = 0.5) -> Beam:
    """Beam of height 1 whose Euler-Bernoulli frequency is 1."""
    young = 12.0 * RHO * (length / np.pi) ** 4
    return Beam(length, 1.0, young, NU, RHO, 0.7, angular_frequency, 0.25)


@pytest.mark.parametrize("n", [1, 3, 8])
def test_bending_modes_of_the_plane_beam_solve_the_rayleigh_lamb_equation(n: int) -> None:
    case = beam(10.0)
    harmonic = elastic_harmonic(case, n)
    k = harmonic.wave_number
    shear = case.young / (2 * (1 + NU)) / RHO
    plate = case.young / (1 - NU**2) / RHO

    def antisymmetric(w: float) -> float:
        """Antisymmetric Rayleigh-Lamb equation of a layer of half height 1/2, with real arguments below c_s k."""
        p, q = np.sqrt(k**2 - w**2 / plate), np.sqrt(k**2 - w**2 / shear)
        return float(np.tanh(p / 2) * (q**2 + k**2) ** 2 - 4 * k**2 * p * q * np.tanh(q / 2))

    slender = n**2 * case.fundamental
    w = np.linspace(0.02, 0.999, 2000) * k * np.sqrt(shear)
    values = np.array([antisymmetric(v) for v in w])
    i = int(np.flatnonzero(values[:-1] * values[1:] < 0)[0])
    exact = brentq(antisymmetric, w[i], w[i + 1], xtol=1e-14 * slender, rtol=1e-14)
    assert exact < slender
    # eigh of a 42 x 42 problem: absolute round-off scales with the largest eigenvalue
    assert harmonic.frequency[0] == pytest.approx(exact, rel=1e-6)


def test_theories_meet_in_the_slender_limit() -> None:
    case = beam(200.0)
    time = np.linspace(0.0, 20.0, 201)
    slender = bernoulli_deflection(case, time)
    scale = np.abs(slender).max()
    middle = np.array([[100.0, 0.5]])
    assert np.abs(timoshenko_deflection(case, time) - slender).max() < 2e-3 * scale
    assert np.abs(elastic_deflection(case, middle, time, terms=39, degree=8) - slender).max() < 2e-3 * scale


def test_timoshenko_comes_close_to_elasticity_where_bernoulli_does_not() -> None:
    case = beam(10.0)
    time = np.linspace(0.0, 25.0, 401)
    height = (np.arange(20) + 0.5) / 20
    exact = elastic_deflection(case, np.stack([np.full(20, 5.0), height], axis=1), time)
    scale = np.abs(exact).max()
    assert np.abs(timoshenko_deflection(case, time) - exact).max() < 5e-3 * scale
    assert np.abs(bernoulli_deflection(case, time) - exact).max() > 0.05 * scale


def test_a_slow_force_bends_the_beam_by_the_static_deflection() -> None:
    case = beam(100.0, angular_frequency=1e-3)
    time = np.array([0.5 * np.pi / 1e-3])
    static = case.force * case.length**3 / (48.0 * case.young / 12.0)
    # Starting from rest leaves a free vibration of the order of the ratio of the frequencies.
    assert bernoulli_deflection(case, time)[0] == pytest.approx(static, rel=2e-3)


def test_series_of_the_plane_beam_has_converged() -> None:
    case = beam(10.0)
    time = np.linspace(0.0, 12.0, 50)
    place = np.array([[5.0, 0.1], [5.0, 0.9], [4.7, 0.5]])
    value = elastic_deflection(case, place, time)
    finer = elastic_deflection(case, place, time, terms=119, degree=26)
    assert np.abs(value - finer).max() < 1e-4 * np.abs(finer).max()


def test_manufactured_acceleration_balances_the_momentum_of_the_law() -> None:
    square = StretchingSquare(2.0, 0.2, 3.0, 5.0, 2.0, 1.7)
    rng = np.random.default_rng(2)
    place = rng.uniform(0.1, 1.9, (20, 2))
    time, step = 0.4, 1e-3

    def stress(at: np.ndarray) -> np.ndarray:
        """First Piola-Kirchhoff stress from F by central differences of the displacement."""
        gradient = np.zeros((len(at), 2, 2))
        for axis in range(2):
            shift = 1e-6 * np.eye(2)[axis]
            gradient[:, :, axis] = (
                square.displacement(at + shift, time) - square.displacement(at - shift, time)
            ) / 2e-6
        f = np.eye(2) + gradient
        inverse = np.linalg.inv(f).transpose(0, 2, 1)
        j = np.linalg.det(f)[:, None, None]
        return square.shear_modulus * (f - inverse) + 0.5 * square.lame * (j**2 - 1.0) * inverse

    divergence = np.zeros((20, 2))
    for axis in range(2):
        shift = step * np.eye(2)[axis]
        ahead, behind = stress(place + shift)[:, :, axis], stress(place - shift)[:, :, axis]
        divergence += (ahead - behind) / (2 * step)
    inertia = (square.velocity(place, time + 1e-5) - square.velocity(place, time - 1e-5)) / 2e-5
    at = place + square.displacement(place, time)
    np.testing.assert_allclose(square.reference(at, time), place, rtol=0, atol=1e-13)
    moving = (square.displacement(place, time + 1e-5) - square.displacement(place, time - 1e-5)) / 2e-5
    np.testing.assert_allclose(square.velocity(place, time), moving, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(square.acceleration(place, time), inertia - divergence / 1.7, rtol=1e-4, atol=1e-5)


def test_figures_of_a_front() -> None:
    place = np.linspace(0.0, 10.0, 101)
    value = 3.0 * np.clip((7.0 - place) / 2.0, 0.0, 1.0)
    value[20] = 3.3
    value[95] = -0.6
    front = read_front(place, value, 3.0)
    assert front.place == pytest.approx(6.0, abs=1e-12)
    assert front.rise == pytest.approx(1.6, abs=1e-12)
    assert front.overshoot == pytest.approx(0.1, abs=1e-12)
    assert front.undershoot == pytest.approx(0.2, abs=1e-12)
    with pytest.raises(ValueError, match=r"0\.5"):
        read_front(place, np.zeros(101), 1.0)


def test_mean_period_of_a_damped_sine() -> None:
    time = np.linspace(0.0, 10.0, 4001)
    signal = np.exp(-0.05 * time) * np.sin(2 * np.pi * (time - 0.1) / 0.9)
    assert mean_period(time, signal) == pytest.approx(0.9, rel=1e-6)
    with pytest.raises(ValueError, match="1 upward"):
        mean_period(time[:300], signal[:300])


def test_observed_order() -> None:
    size = np.array([1.0, 0.5, 0.25])
    assert observed_order(size, 3.0 * size**1.9) == pytest.approx(1.9, rel=1e-12)
