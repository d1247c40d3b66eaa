"""States with a closed form: rigid motion, uniform stretch and shear, weights, conservation of momentum."""

from dataclasses import replace

import numpy as np
import pytest

from mpm_service import (
    Crack,
    EdgeCondition,
    Grid,
    IsotropicElastic,
    MaterialPointSolver,
    Overlap,
    Scheme,
    cut_overlaps,
    fill_rectangle,
)
from mpm_service.material_points import COLUMNS, HXX, HXY, HYX, HYY, SXX, SXY, SYY, VX, VY

E, NU, RHO = 2.0e9, 0.3, 1200.0
# Plain FLIP keeps exactly what FMPM keeps to the order of the strain only.
FLIP = Scheme(transfer="flip")
GRID = Grid((-4.0, -4.0), 1.0, (20, 16))


def material(assumption: str = "plane_strain") -> IsotropicElastic:
    return IsotropicElastic(E, NU, RHO, assumption)  # type: ignore[arg-type]


def with_velocities(solver: MaterialPointSolver, velocity: np.ndarray) -> MaterialPointSolver:
    state = solver.state()
    state["rows"][:, [VX, VY]] = velocity[state["ids"]]
    solver.restore(state)
    return solver


def step_of(law: IsotropicElastic, courant: float = 0.4) -> float:
    return courant / law.pressure_wave_speed


@pytest.mark.parametrize("assumption", ["plane_stress", "plane_strain"])
def test_elastic_law_against_hookes_law_in_three_dimensions(assumption: str) -> None:
    law = material(assumption)
    rows, ids, history = np.zeros((1, COLUMNS)), np.zeros(1, dtype=np.int64), np.zeros((1, 0))
    rows[0, [HXX, HXY, HYX, HYY]] = (1e-3, 3e-4, 3e-4, -2e-4)
    law.update_stress(rows, ids, history)
    ratio = ((1.0 + 1e-3) * (1.0 - 2e-4) - 9e-8) * law.thickness_stretch(rows, ids, history)[0]
    stress = rows[0, [SXX, SYY, SXY]] / ratio
    zz = law.stress_zz(rows, ids, history)[0]
    back_xx = (stress[0] - NU * (stress[1] + zz)) / E
    back_yy = (stress[1] - NU * (stress[0] + zz)) / E
    back_zz = (zz - NU * (stress[0] + stress[1])) / E
    assert back_xx == pytest.approx(1e-3, rel=1e-12)
    assert back_yy == pytest.approx(-2e-4, rel=1e-12)
    assert stress[2] == pytest.approx(E / (1 + NU) * 3e-4, rel=1e-12)
    if assumption == "plane_strain":
        assert abs(back_zz) < 1e-15
    else:
        assert zz == 0.0


def test_rigid_translation_across_cells_gives_no_stress() -> None:
    law = material()
    body = fill_rectangle((0.0, 0.0), (10.0, 6.0), 1.0)
    solver = MaterialPointSolver(GRID, body, law, 1.0, step_of(law))
    with_velocities(solver, np.full((body.count, 2), 0.02 * law.pressure_wave_speed) * [1.0, 0.5])
    solver.advance(300)
    moved = solver.points.displacement
    assert moved[:, 0].mean() == pytest.approx(300 * 0.4 * 0.02, rel=1e-12)
    assert np.ptp(moved, axis=0).max() < 1e-11
    assert np.abs(solver.points.stress).max() < 1e-10 * E


def test_small_rigid_rotation_gives_stress_of_second_order_only() -> None:
    law = material()
    body = fill_rectangle((0.0, 0.0), (8.0, 6.0), 1.0)
    rate = 1e-6 * law.pressure_wave_speed
    solver = MaterialPointSolver(
        GRID, body, law, 1.0, step_of(law), initial_velocity_gradient=[[0.0, -rate], [rate, 0.0]], scheme=FLIP
    )
    solver.advance(1)
    angle = rate * solver.time_step
    interior = np.all((body.position > 1.5) & (body.position < [6.5, 4.5]), axis=1)
    gradient = solver.points.displacement_gradient[interior]
    np.testing.assert_allclose(gradient[:, 1, 0], angle, rtol=1e-9)
    np.testing.assert_allclose(gradient[:, 0, 1], -angle, rtol=1e-9)
    assert np.abs(solver.points.stress[interior]).max() < 1e-9 * E * angle


@pytest.mark.parametrize("assumption", ["plane_stress", "plane_strain"])
def test_uniform_stretch_matches_hooke(assumption: str) -> None:
    law = material(assumption)
    body = fill_rectangle((0.0, 0.0), (10.0, 6.0), 1.0)
    dt = step_of(law)
    exx, eyy, steps, thickness = 2e-7, -1e-7, 100, 0.25
    end = steps * dt
    edges = [
        EdgeCondition("left", 0, (0.0, end), (0.0, 0.0)),
        EdgeCondition("right", 0, (0.0, end), (0.0, 10.0 * exx)),
        EdgeCondition("bottom", 1, (0.0, end), (0.0, 0.0)),
        EdgeCondition("top", 1, (0.0, end), (0.0, 6.0 * eyy)),
    ]
    start = [[exx / end, 0.0], [0.0, eyy / end]]
    solver = MaterialPointSolver(GRID, body, law, thickness, dt, edges, initial_velocity_gradient=start)
    solver.advance(1)
    first = solver.points.displacement_gradient * steps
    assert np.abs(first - np.diag([exx, eyy])).max() < 1e-7 * exx  # round-off of table values of 1e-8 m
    solver.advance(steps - 1)
    if assumption == "plane_stress":
        sxx = E / (1 - NU**2) * (exx + NU * eyy)
        syy = E / (1 - NU**2) * (eyy + NU * exx)
    else:
        factor = E / ((1 + NU) * (1 - 2 * NU))
        sxx = factor * ((1 - NU) * exx + NU * eyy)
        syy = factor * ((1 - NU) * eyy + NU * exx)
    stress = solver.points.stress
    np.testing.assert_allclose(stress[:, 0], sxx, rtol=1e-6)
    np.testing.assert_allclose(stress[:, 1], syy, atol=1e-6 * sxx)
    assert np.abs(stress[:, 2]).max() < 1e-6 * sxx
    # The reaction of a step belongs to the stress at its start, hence one step's share less.
    np.testing.assert_allclose(
        solver.edge_reaction,
        np.array([-sxx * 6, sxx * 6, -syy * 10, syy * 10]) * thickness * (steps - 1) / steps,
        rtol=1e-5,
    )


@pytest.mark.parametrize("shift", [0.3, -0.4, 1.6, -2.7])
def test_stretch_stays_uniform_while_the_body_moves_over_the_grid(shift: float) -> None:
    law = material()
    body = fill_rectangle((0.0, 0.0), (10.0, 6.0), 1.0)
    dt = step_of(law)
    strain, steps = 1e-6, 400
    end = steps * dt
    edges = [
        EdgeCondition("left", 0, (0.0, end), (0.0, shift)),
        EdgeCondition("right", 0, (0.0, end), (0.0, shift + 10.0 * strain)),
        EdgeCondition("bottom", 1, (0.0,), (0.0,)),
        EdgeCondition("top", 1, (0.0,), (0.0,)),
    ]
    solver = MaterialPointSolver(
        GRID, body, law, 1.0, dt, edges, initial_velocity_gradient=[[strain / end, 0.0], [0.0, 0.0]], scheme=FLIP
    )
    start = body.position * [strain / end, 0.0] + [shift / end, 0.0]
    with_velocities(solver, start)
    solver.advance(steps)
    assert solver.points.displacement[:, 0].mean() == pytest.approx(shift + 5.0 * strain, rel=1e-9)
    np.testing.assert_allclose(solver.points.strain[:, 0], strain, rtol=2e-3)


def test_shear_of_the_first_step_is_uniform() -> None:
    law = material()
    body = fill_rectangle((0.0, 0.0), (10.0, 6.0), 1.0)
    dt = step_of(law)
    rate = 1e-6 / dt
    edges = [
        EdgeCondition("bottom", 0, (0.0, dt), (0.0, 0.0)),
        EdgeCondition("top", 0, (0.0, dt), (0.0, 6.0 * 1e-6)),
    ]
    solver = MaterialPointSolver(GRID, body, law, 1.0, dt, edges, initial_velocity_gradient=[[0.0, rate], [0.0, 0.0]])
    solver.advance(1)
    np.testing.assert_allclose(solver.points.displacement_gradient[:, 0, 1], 1e-6, rtol=1e-9)
    np.testing.assert_allclose(solver.points.stress[:, 2], E / (2 * (1 + NU)) * 1e-6, rtol=1e-9)


def test_volume_and_thickness_follow_the_deformation() -> None:
    law = material("plane_stress")
    body = fill_rectangle((0.0, 0.0), (4.0, 4.0), 1.0)
    solver = MaterialPointSolver(GRID, body, law, 0.5, step_of(law))
    state = solver.state()
    state["rows"][:, 4:8] = [0.01, 0.0, 0.0, -0.002]
    solver.restore(state)
    expected = 1.01 * 0.998 * (1.0 - NU / (1 - NU) * 0.008) * 0.25 * 0.5
    np.testing.assert_allclose(solver.points.volume, expected, rtol=1e-13)


@pytest.mark.parametrize("scheme", [FLIP, Scheme()])
@pytest.mark.parametrize("cracks", [[], [Crack(((-1.0, 3.5), (6.3, 3.5)))]])
def test_momentum_of_a_free_body_is_kept_to_round_off(cracks: list[Crack], scheme: Scheme) -> None:
    law = material()
    overlap = Overlap.between(((3.0, 2.0), (5.0, 4.0)), ((2.0, 1.0), (6.0, 5.0)), 0.2)
    body = cut_overlaps(fill_rectangle((0.0, 0.0), (10.0, 6.0), 1.0), [overlap])
    solver = MaterialPointSolver(GRID, body, law, 1.0, step_of(law), cracks=cracks, scheme=scheme)
    speed = 1e-3 * law.pressure_wave_speed
    with_velocities(solver, np.random.default_rng(0).normal(size=(body.count, 2)) * speed + speed)
    mass = solver.points.mass[:, None]
    before = (mass * solver.points.velocity).sum(axis=0)
    solver.advance(500)
    after = (mass * solver.points.velocity).sum(axis=0)
    assert solver.points.stress.std() > 1e-6 * E
    np.testing.assert_allclose(after, before, rtol=1e-11)


def test_weight_scales_mass_and_force_but_not_motion() -> None:
    law = material("plane_stress")
    plain = fill_rectangle((0.0, 0.0), (10.0, 6.0), 1.0)
    light = replace(plain, weight=0.1 * plain.weight)
    dt = step_of(law)
    edges = [EdgeCondition("left", 0, (0.0,), (0.0,)), EdgeCondition("right", 0, (0.0, 50 * dt), (0.0, 1e-3))]
    runs = [MaterialPointSolver(GRID, body, law, 1.0, dt, edges) for body in (plain, light)]
    for run in runs:
        run.advance(120)
    np.testing.assert_allclose(runs[1].points.displacement, runs[0].points.displacement, atol=1e-13)
    np.testing.assert_allclose(runs[1].points.stress, runs[0].points.stress, atol=1e-9 * E * 1e-4)
    np.testing.assert_allclose(runs[1].edge_reaction, 0.1 * runs[0].edge_reaction, rtol=1e-8)
    np.testing.assert_allclose(runs[1].points.mass, 0.1 * runs[0].points.mass, rtol=1e-14)
