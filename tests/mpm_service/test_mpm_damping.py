"""Damping against the damped oscillator, force scaling against Eq 45, relaxation against statics."""

from collections.abc import Callable

import numpy as np
import pytest

from mpm_service import Grid, IsotropicElastic, MaterialPointSolver, Scheme, Traction, fill_rectangle, symmetry
from mpm_service.damping import Damping, ForceBalance, Relaxation, damp_points, relax, scale_forces
from mpm_service.material_points import columns


class Chain:
    """Masses on springs, the first one held, moved as the nodes of a grid are; a `Relaxable`."""

    def __init__(self, masses: int, stiffness: float, time_step: float, damping: Damping | None = None) -> None:
        self.momentum = np.zeros((masses, 5))
        self.momentum[:, 0] = 1.0
        self.motion = np.zeros((masses, 4))
        self.u = np.zeros(masses)
        self.v = np.zeros(masses)
        self.stiffness, self.dt = stiffness, time_step
        self.external = np.zeros(masses)
        self.damping = damping or Damping()
        self.balance = ForceBalance()
        self.listed = np.arange(masses)
        self.residual = 0.0
        self.steps = 0
        self.at_rest = False

    def forces(self) -> np.ndarray:
        stretch = self.stiffness * np.diff(self.u)
        return np.concatenate([stretch, [0.0]]) - np.concatenate([[0.0], stretch])

    def advance(self, steps: int) -> None:
        keep = self.damping.grid_factor(self.dt)
        for _ in range(steps):
            self.momentum[:, 1] = self.v
            self.momentum[:, 3] = self.forces()
            self.balance.before_loads(self.momentum, (self.listed,))
            self.momentum[:, 3] += self.external
            factor = self.damping.force_factor * (0.5 if self.at_rest else 1.0)
            self.at_rest = False
            scale_forces(self.listed, self.momentum, factor)
            new = keep * (self.v + self.dt * self.momentum[:, 3])
            new[0] = 0.0
            self.motion[:, 0], self.motion[:, 2] = new, new - self.v
            self.residual = self.balance.residual(self.momentum, self.motion, (self.listed,), self.dt, factor)
            self.v = new
            self.u = self.u + self.dt * new
            self.steps += 1

    @property
    def kinetic_energy(self) -> float:
        return 0.5 * float(self.v @ self.v)

    def stop(self) -> None:
        self.v[:] = 0.0
        self.at_rest = True


def crossings(signal: np.ndarray, time_step: float) -> np.ndarray:
    """Times at which a signal rises through zero."""
    up = np.flatnonzero((signal[:-1] < 0.0) & (signal[1:] >= 0.0))
    return time_step * (up + signal[up] / (signal[up] - signal[up + 1]))


def history(chain: Chain, steps: int) -> np.ndarray:
    values = np.empty(steps)
    for step in range(steps):
        chain.advance(1)
        values[step] = chain.u[1]
    return values


def test_mass_proportional_damping_is_that_of_the_damped_oscillator() -> None:
    rate, omega, dt = 0.08, 1.3, 0.002
    chain = Chain(2, omega**2, dt, Damping(grid_rate=rate))
    chain.u[1] = 1.0
    signal = history(chain, 20000)
    damped = np.sqrt(omega**2 - 0.25 * rate**2)
    times = crossings(signal, dt)
    assert np.diff(times).mean() == pytest.approx(2 * np.pi / damped, rel=1e-4)
    peaks = [signal[round(t / dt) : round((t + 2 * np.pi / damped) / dt)].max() for t in times[:-1]]
    assert np.log(peaks[0] / peaks[4]) / (4 * 2 * np.pi / damped) == pytest.approx(0.5 * rate, rel=1e-3)


@pytest.mark.parametrize("scaling", [0.25, 0.5, 0.75])
def test_force_scaling_slows_by_the_root_and_takes_no_energy(scaling: float) -> None:
    omega, dt = 1.3, 0.005
    chain = Chain(2, omega**2, dt, Damping(force_scaling=scaling))
    chain.u[1] = 1.0
    signal = history(chain, 15000)
    period = np.diff(crossings(signal, dt)).mean()
    assert period == pytest.approx(2 * np.pi / (omega * np.sqrt(1.0 - scaling)), rel=1e-5)
    assert signal[-3000:].max() == pytest.approx(signal[:3000].max(), rel=1e-4)
    assert signal[-3000:].max() == pytest.approx(1.0, rel=2e-3)


@pytest.mark.parametrize("dimension", [2, 3])
def test_points_lose_velocity_and_the_energy_is_booked(dimension: int) -> None:
    c = columns(dimension)
    rng = np.random.default_rng(3)
    rows = rng.random((9, c.width))
    before = rows.copy()
    factor = Damping(point_rate=7.0).point_factor(0.01)
    assert factor == pytest.approx(np.exp(-0.07))
    lost = damp_points(rows, 6, c.velocity, c.mass, factor)
    speed = slice(c.velocity, c.velocity + dimension)
    np.testing.assert_allclose(rows[:6, speed], factor * before[:6, speed], rtol=1e-15)
    np.testing.assert_array_equal(np.delete(rows, range(speed.start, speed.stop), axis=1)[:6],
                                  np.delete(before, range(speed.start, speed.stop), axis=1)[:6])  # fmt: skip
    np.testing.assert_array_equal(rows[6:], before[6:])
    kinetic = [0.5 * (r[:6, c.mass] * (r[:6, speed] ** 2).sum(axis=1)).sum() for r in (before, rows)]
    assert lost == pytest.approx(kinetic[0] - kinetic[1], rel=1e-12)


def test_residual_by_hand() -> None:
    """Two nodes: one free and out of balance by 1 N under 3 N and 4 N, one held by a reaction of 12 N."""
    momentum = np.zeros((3, 5))
    momentum[:, 0] = [2.0, 1.0, 0.0]
    momentum[:, 3] = [3.0, 12.0, 99.0]
    balance = ForceBalance()
    listed = (np.array([0, 2]), np.array([1]))
    balance.before_loads(momentum, listed)
    momentum[0, 3] -= 4.0
    motion = np.zeros((3, 4))
    motion[0, 2] = 0.1 * -1.0 / 2.0
    internal, external, reaction = np.hypot(3.0, 12.0), 4.0, 12.0
    expected = 1.0 / max(internal, external, reaction)
    assert balance.residual(momentum, motion, listed, 0.1) == pytest.approx(expected, rel=1e-14)
    # Forces scaled before the step: the same balance.
    momentum[:, 3] *= 0.4
    motion *= 0.4
    assert balance.residual(momentum, motion, listed, 0.1, 0.4) == pytest.approx(expected, rel=1e-14)
    nothing = np.zeros((3, 5))
    balance.before_loads(nothing, listed)
    assert balance.residual(nothing, np.zeros((3, 4)), listed, 0.1) == 0.0


def test_relaxation_reaches_the_static_solution() -> None:
    chain = Chain(21, 4.0, 0.05)
    chain.external[:] = np.linspace(-1.0, 2.0, 21)
    chain.external[0] = 0.0
    result = relax(chain, 1e-8, 20000)
    assert result.converged
    assert result.residual <= 1e-8
    assert result.steps == chain.steps < 3000
    assert result.peaks > 2
    pull = np.cumsum(chain.external[::-1])[::-1][1:] / 4.0
    np.testing.assert_allclose(chain.u[1:], np.cumsum(pull), rtol=1e-6)
    assert chain.kinetic_energy == 0.0


@pytest.mark.parametrize(("transfer", "courant"), [("fmpm", 0.5), ("flip", 0.5), ("flip", 0.75)])
def test_a_pulled_bar_relaxes_to_uniform_stress(transfer: str, courant: float) -> None:
    law = IsotropicElastic(1e9, 0.3, 1000.0, "plane_stress")
    solver = MaterialPointSolver(
        Grid((-3.0, -3.0), 1.0, (26, 10)),
        fill_rectangle((0.0, 0.0), (20.0, 4.0), 1.0),
        law,
        1.0,
        courant / law.pressure_wave_speed,
        [symmetry("left"), symmetry("bottom")],
        scheme=Scheme(transfer=transfer),  # type: ignore[arg-type]
        loads=[Traction("right", (1e3, 0.0))],
    )
    result = relax(solver, 1e-6, 3000)
    assert result.converged
    np.testing.assert_allclose(solver.points.stress, np.tile([1e3, 0.0, 0.0], (320, 1)), atol=0.02)
    assert solver.edge_reaction[0] == pytest.approx(-4e3, rel=1e-5)
    assert abs(solver.edge_reaction[1]) < 0.05


def test_point_damping_of_rigid_motion_is_exact() -> None:
    law = IsotropicElastic(1e9, 0.3, 1000.0, "plane_strain")
    dt = 0.4 / law.pressure_wave_speed
    body = fill_rectangle((0.0, 0.0), (6.0, 6.0), 1.0)
    solver = MaterialPointSolver(
        Grid((-3.0, -3.0), 1.0, (12, 12)),
        body,
        law,
        1.0,
        dt,
        damping=Damping(point_rate=0.01 / dt),
        initial_velocity=np.full((body.count, 2), 3.0),
    )
    start = solver.energies().kinetic
    solver.advance(100)
    np.testing.assert_allclose(solver.points.velocity, 3.0 * np.exp(-1.0), rtol=1e-11)
    assert solver.energies().damping_loss == pytest.approx(start * (1.0 - np.exp(-2.0)), rel=1e-11)


def test_scaled_forces_slow_a_bar_by_the_root() -> None:
    periods = []
    for scaling in (0.0, 0.75):
        law = IsotropicElastic(1e9, 0.0, 1000.0, "plane_stress")
        body = fill_rectangle((0.0, 0.0), (20.0, 1.0), 1.0)
        dt = 0.4 / law.pressure_wave_speed
        velocity = np.zeros((body.count, 2))
        velocity[:, 0] = 1e-3 * np.sin(0.5 * np.pi * body.position[:, 0] / 20.0)
        solver = MaterialPointSolver(
            Grid((-3.0, -3.0), 1.0, (26, 7)),
            body,
            law,
            1.0,
            dt,
            [symmetry("left")],
            damping=Damping(force_scaling=scaling),
            initial_velocity=velocity,
        )
        end = np.empty(1300 if scaling else 700)
        for step in range(end.size):
            solver.advance(1)
            end[step] = solver.points.displacement[-1, 0]
        periods.append(np.diff(crossings(end, dt)).mean())
    assert periods[1] / periods[0] == pytest.approx(2.0, rel=1e-3)
    assert periods[0] == pytest.approx(80.0 / law.pressure_wave_speed, rel=2e-3)


def test_relaxation_that_cannot_end_says_so() -> None:
    chain = Chain(21, 4.0, 0.2)
    chain.external[-1] = 1.0
    result = relax(chain, 1e-12, 50)
    assert result == Relaxation(result.residual, 50, result.peaks, False)
    assert result.residual > 1e-3


def test_relaxation_of_a_body_at_rest_ends_at_once() -> None:
    result = relax(Chain(3, 1.0, 0.1), 1e-6)
    assert result == Relaxation(0.0, 1, 0, True)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Damping(grid_rate=-1.0), "Damping.grid_rate = -1.0"),
        (lambda: Damping(point_rate=np.inf), "Damping.point_rate = inf"),
        (lambda: Damping(force_scaling=1.0), "Damping.force_scaling = 1.0"),
        (lambda: relax(Chain(2, 1.0, 0.1), 0.0), "tolerance = 0.0"),
        (lambda: relax(Chain(2, 1.0, 0.1), 1e-3, 0), "max_steps = 0"),
    ],
)
def test_bad_input_is_named(call: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()
