"""Bodies in space against the theory of elasticity, conservation, and exact restarts."""

from typing import Any

import numpy as np
import pytest

from mpm_service import (
    BodyForce,
    EdgeCondition,
    Grid,
    IsotropicElastic,
    J2Plasticity,
    MaterialPointSolver,
    NeoHookean,
    Scheme,
    Traction,
    fill_rectangle,
    fill_region,
    relax,
    symmetry,
)
from mpm_service.material_points import columns

E, NU, RHO = 1.0e9, 0.3, 1000.0
ELASTIC = IsotropicElastic(E, NU, RHO, "three_dimensional")
LARGE = NeoHookean(E, NU, RHO, "three_dimensional")
C = ELASTIC.pressure_wave_speed
H = columns(3).gradient
FACES = (("left", 0), ("right", 0), ("bottom", 1), ("top", 1), ("back", 2), ("front", 2))
INTERPOLATIONS = ["linear", "ugimp"]


def held(*faces: str) -> list[EdgeCondition]:
    return [symmetry(face) for face in faces]  # type: ignore[arg-type]


def with_gradient(solver: MaterialPointSolver, gradient: np.ndarray) -> MaterialPointSolver:
    """Give every point a displacement gradient and the stress that belongs to it; places stay as they are."""
    state = solver.state()
    state["rows"][:, H : H + 9] = gradient.ravel()
    history = solver.material.start_history(solver.points.count)
    solver.material.update_stress(state["rows"], state["ids"], history)
    solver.restore(state)
    return solver


def bar(scheme: Scheme, velocity: Any, length: int = 24, **options: Any) -> MaterialPointSolver:
    """Bar of 2 x 2 cells along z with held sides, fixed at the back end: plane strain in both directions across."""
    body = fill_rectangle((0.0, 0.0, 0.0), (2.0, 2.0, float(length)), 1.0)
    start = np.zeros(body.position.shape)
    start[:, 2] = velocity(body.position[:, 2])
    return MaterialPointSolver(
        Grid((-2.0, -2.0, -2.0), 1.0, (6, 6, length + 4)),
        body,
        ELASTIC,
        1.0,
        0.4 / C,
        held("left", "right", "bottom", "top", "back"),
        scheme=scheme,
        initial_velocity=start,
        **options,
    )


@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
def test_confined_bar_vibrates_with_the_pressure_wave_speed(interpolation: str) -> None:
    """Mode 1, fixed and free end: period 4 L / c with c = sqrt(M / rho); energy after five half periods as before."""
    length = 24
    assert pytest.approx(np.sqrt(E * (1 - NU) / ((1 + NU) * (1 - 2 * NU)) / RHO), rel=1e-14) == C
    solver = bar(
        Scheme(interpolation, transfer="flip"),  # type: ignore[arg-type]
        lambda z: 1e-5 * C * np.sin(0.5 * np.pi * z / length),
    )
    mode = np.sin(0.5 * np.pi * solver.points.reference_position[:, 2] / length)
    start = solver.energies().kinetic
    signal = []
    for _ in range(round(2.5 * 4 * length / 0.4)):
        solver.advance(1)
        signal.append(float(mode @ solver.points.displacement[:, 2]))
    values = np.array(signal)
    up = np.flatnonzero((values[:-1] < 0.0) & (values[1:] >= 0.0))
    crossing = up - values[up] / (values[up + 1] - values[up])
    assert crossing.size == 2
    assert 4.0 * length / (0.4 * (crossing[1] - crossing[0])) == pytest.approx(1.0, abs=2e-3)
    energies = solver.energies()
    assert energies.kinetic + energies.strain == pytest.approx(start, rel=1e-3)
    assert np.abs(solver.points.displacement[:, :2]).max() < 1e-12


def test_front_in_a_confined_bar_runs_at_the_pressure_wave_speed() -> None:
    """A traction step on the free end: stress behind the front, nothing ahead of the precursor, front at c t."""
    length, pull = 60, 1e3
    solver = bar(Scheme(), np.zeros_like, length, loads=[Traction("front", (0.0, 0.0, pull))])
    solver.advance(round(40.0 / 0.4))
    z = solver.points.reference_position[:, 2]
    stress = solver.points.stress
    behind = (z > 35.0) & (z < 55.0)
    np.testing.assert_allclose(stress[behind, 2], pull, rtol=0.02)
    np.testing.assert_allclose(stress[behind, 0], NU / (1 - NU) * pull, rtol=0.02)
    assert np.abs(stress[z < 8.0]).max() < 1e-3 * pull
    levels = np.unique(z)
    profile = np.array([stress[z == level, 2].mean() for level in levels])
    ahead = levels < 30.0
    front = np.interp(0.5 * pull, profile[ahead], levels[ahead])
    assert length - front == pytest.approx(40.0, abs=0.4)


LAWS = {
    "elastic": ELASTIC,
    "neo-Hookean": LARGE,
    "J2": J2Plasticity(E, NU, RHO, 2.0e6, 1.0e7, assumption="three_dimensional"),
}


@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
@pytest.mark.parametrize("law", LAWS)
def test_static_patch_of_any_uniform_stretch_stays_exact(law: str, interpolation: str) -> None:
    """Six held faces, three different stretches, those of J2 beyond yield: stress of the law, and no motion."""
    material = LAWS[law]
    body = fill_rectangle((0.0, 0.0, 0.0), (4.0, 3.0, 2.0), 1.0)
    strain = np.array([3e-3, -1e-3, 5e-4])
    solver = with_gradient(
        MaterialPointSolver(
            Grid((-2.0, -2.0, -2.0), 1.0, (8, 7, 6)),
            body,
            material,
            1.0,
            0.3 / C,
            held(*(face for face, _ in FACES)),
            scheme=Scheme(interpolation),  # type: ignore[arg-type]
        ),
        np.diag(strain),
    )
    stress = solver.points.stress
    if law == "elastic":
        expected = ELASTIC.lame * strain.sum() + 2.0 * ELASTIC.shear_modulus * strain
        np.testing.assert_allclose(stress[:, :3] * np.prod(1.0 + strain), np.tile(expected, (192, 1)), rtol=0.01)
    if law == "neo-Hookean":
        volume = np.prod(1.0 + strain)
        shear, lame = LARGE.shear_modulus, LARGE.lame
        expected = (shear * ((1.0 + strain) ** 2 - 1.0) + 0.5 * lame * (volume**2 - 1.0)) / volume
        np.testing.assert_allclose(stress[:, :3], np.tile(expected, (192, 1)), rtol=1e-10)
    solver.advance(100)
    np.testing.assert_allclose(solver.points.stress, stress, rtol=0.0, atol=1e-13 * E)
    assert np.abs(solver.points.velocity).max() < 1e-13 * C
    # The faces carry the stress on the reference area: first Piola, tau / stretch.
    tau = solver.points.kirchhoff_stress[0]
    force = [sign * tau[a] * 24.0 / (4.0, 3.0, 2.0)[a] for _, a in FACES[::2] for sign in (-1.0, 1.0)]
    np.testing.assert_allclose(solver.edge_reaction, force, rtol=1e-9)


def test_driven_patch_is_exact() -> None:
    """Faces that move apart evenly: every point has the strain of the faces and Hooke's stress in each step."""
    body = fill_rectangle((0.0, 0.0, 0.0), (4.0, 3.0, 2.0), 1.0)
    strain, steps, dt = np.array([2e-7, -1e-7, 1.5e-7]), 60, 0.3 / C
    end, size = steps * dt, np.array([4.0, 3.0, 2.0])
    edges = [
        EdgeCondition(face, a, (0.0, end), (0.0, strain[a] * size[a] if k % 2 else 0.0))  # type: ignore[arg-type]
        for k, (face, a) in enumerate(FACES)
    ]
    solver = MaterialPointSolver(
        Grid((-2.0, -2.0, -2.0), 1.0, (9, 8, 7)),
        body,
        ELASTIC,
        1.0,
        dt,
        edges,
        initial_velocity_gradient=np.diag(strain / end),
    )
    solver.advance(steps)
    expected = np.zeros(6)
    expected[:3] = ELASTIC.lame * strain.sum() + 2.0 * ELASTIC.shear_modulus * strain
    assert np.abs(solver.points.stress - expected).max() < 1e-6 * expected[0]
    # The reaction of a step belongs to the stress at its start.
    force = [sign * expected[a] * 24.0 / size[a] for a in range(3) for sign in (-1.0, 1.0)]
    np.testing.assert_allclose(solver.edge_reaction, np.array(force) * (steps - 1) / steps, rtol=2e-5)


def test_column_under_gravity_relaxes_to_the_hydrostatic_profile() -> None:
    """sigma_yy = -rho g (H - y), the sides nu / (1 - nu) of it, in a confined column; settlement by integration.

    With linear functions under the averages the points of a cell share its mean stress, which is then exact.
    """
    height, gravity = 10.0, 1.0
    body = fill_rectangle((0.0, 0.0, 0.0), (2.0, height, 2.0), 1.0)
    solver = MaterialPointSolver(
        Grid((-2.0, -2.0, -2.0), 1.0, (6, 14, 6)),
        body,
        ELASTIC,
        1.0,
        0.5 / C,
        held("left", "right", "bottom", "back", "front"),
        loads=[BodyForce((0.0, -gravity, 0.0))],
    )
    outcome = relax(solver, 1e-9, 4000)
    assert outcome.converged
    y = solver.points.reference_position[:, 1]
    expected = -RHO * gravity * (height - np.floor(y) - 0.5)
    stress = solver.points.stress
    top = -expected.min()
    np.testing.assert_allclose(stress[:, 1], expected, atol=1e-5 * top)
    for across in (0, 2):
        np.testing.assert_allclose(stress[:, across], NU / (1 - NU) * expected, atol=1e-5 * top)
    assert np.abs(stress[:, 3:]).max() < 1e-6 * top
    weight = RHO * gravity * 4.0 * height
    assert solver.edge_reaction[2] == pytest.approx(weight, rel=1e-6)
    settled = -RHO * gravity / (RHO * C**2) * (height * y - 0.5 * y * y)
    np.testing.assert_allclose(solver.points.displacement[:, 1], settled, atol=0.01 * np.abs(settled).max())


def test_tractions_on_all_faces_balance_the_stress_they_belong_to() -> None:
    """A free block with a uniform stress and the dead tractions of it: nothing moves."""
    strain = np.diag([2e-4, -1e-4, 3e-4])
    body = fill_rectangle((0.0, 0.0, 0.0), (3.0, 2.0, 4.0), 1.0)
    law_stress = ELASTIC.lame * np.trace(strain) + 2.0 * ELASTIC.shear_modulus * np.diag(strain)
    probe = with_gradient(MaterialPointSolver(Grid((-2.0,) * 3, 1.0, (7, 6, 8)), body, ELASTIC, 1.0, 0.3 / C), strain)
    tau = probe.points.kirchhoff_stress[0]
    np.testing.assert_allclose(tau[:3], law_stress, rtol=1e-3)
    loads = []
    for k, (face, a) in enumerate(FACES):
        vector = np.zeros(3)
        vector[a] = tau[a] if k % 2 else -tau[a]
        loads.append(Traction(face, vector))  # type: ignore[arg-type]
    solver = with_gradient(
        MaterialPointSolver(Grid((-2.0,) * 3, 1.0, (7, 6, 8)), body, ELASTIC, 1.0, 0.3 / C, loads=loads), strain
    )
    solver.advance(100)
    assert np.abs(solver.points.velocity).max() < 1e-15 * C
    np.testing.assert_allclose(solver.points.stress, probe.points.stress, rtol=0.0, atol=1e-14 * E)


def test_traction_accelerates_a_free_body_as_newton_says() -> None:
    body = fill_rectangle((0.0, 0.0, 0.0), (3.0, 2.0, 4.0), 1.0)
    vector = np.array([1e3, -2e3, 5e2])
    solver = MaterialPointSolver(
        Grid((-2.3, -2.1, -2.4), 1.0, (8, 7, 9)), body, ELASTIC, 1.0, 0.4 / C, loads=[Traction("front", vector)]
    )
    solver.advance(50)
    momentum = solver.points.mass @ solver.points.velocity
    np.testing.assert_allclose(momentum, vector * 6.0 * solver.time, rtol=1e-11)


@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
@pytest.mark.parametrize("integration", ["musl", "usl", "usf", "usavg"])
def test_momentum_is_kept_to_round_off(interpolation: str, integration: str) -> None:
    body = fill_region((0.0, 0.0, 0.0), (5.0, 4.0, 4.0), 1.0, lambda x: np.linalg.norm(x - [2.5, 2, 2], axis=1) < 2.4)
    velocity = (np.random.default_rng(2).normal(size=body.position.shape) * 1e-3 + [0.004, 0.003, 0.002]) * C
    for transfer, order in (("flip", 1), ("xpic", 2), ("fmpm", 2)):
        solver = MaterialPointSolver(
            Grid((-2.3, -2.2, -2.4), 1.0, (10, 9, 9)),
            body,
            LARGE,
            1.0,
            0.1 / C,
            scheme=Scheme(interpolation, integration, transfer, order),  # type: ignore[arg-type]
            initial_velocity=velocity,
        )
        before = solver.points.mass @ velocity
        solver.advance(30)
        assert np.abs(solver.points.stress).max() > 1e-5 * E
        change = solver.points.mass @ solver.points.velocity - before
        assert np.abs(change).max() < 2e-14 * (solver.points.mass @ np.abs(velocity)).max()


def test_rigid_motion_across_cells_is_exact() -> None:
    body = fill_rectangle((0.0, 0.0, 0.0), (3.0, 2.0, 2.0), 1.0)
    speed = np.array([0.05, 0.031, 0.02]) * C
    for shift in (0.0, 0.37, 0.25):
        solver = MaterialPointSolver(
            Grid((-2.0 - shift,) * 3, 1.0, (11, 9, 8)),
            body,
            LARGE,
            1.0,
            0.4 / C,
            initial_velocity=np.broadcast_to(speed, body.position.shape),
        )
        solver.advance(120)
        assert np.abs(solver.points.displacement - speed * solver.time).max() < 1e-12
        assert np.abs(solver.points.stress).max() < 1e-12 * E


def moving_block() -> MaterialPointSolver:
    """J2 with a load and faces; it moves over cell lines and yields."""
    body = fill_rectangle((0.0, 0.0, 0.0), (3.0, 3.0, 2.0), 1.0)
    velocity = np.random.default_rng(4).normal(size=body.position.shape) * 0.02 * C + [0.0, 0.03 * C, 0.01 * C]
    return MaterialPointSolver(
        Grid((-2.0, -2.3, -2.4), 1.0, (8, 10, 9)),
        body,
        LAWS["J2"],
        1.0,
        0.3 / C,
        held("left"),
        scheme=Scheme(transfer="xpic", order=2, period=3),
        loads=[Traction("right", (2e6, 1e5, 0.0)), BodyForce((0.0, 0.0, 1.0))],
        initial_velocity=velocity,
    )


def test_a_restored_run_goes_on_bit_for_bit() -> None:
    straight, first, second = (moving_block() for _ in range(3))
    straight.advance(130)
    first.advance(61)
    saved = first.state()
    first.advance(3)
    second.restore(saved)
    second.advance(69)
    assert straight.energies().dissipated > 0.0
    assert not np.array_equal(straight.state()["ids"], saved["ids"])
    for name, value in straight.state().items():
        np.testing.assert_array_equal(second.state()[name], value, err_msg=name)
    assert second.energies() == straight.energies()


def test_lost_points_are_counted_and_the_run_goes_on() -> None:
    body = fill_rectangle((0.0, 0.0, 0.0), (2.0, 2.0, 3.0), 1.0)
    velocity = np.broadcast_to([0.0, 0.0, -0.1 * C], body.position.shape)
    grid = Grid((-2.0, -2.0, -3.0), 1.0, (6, 6, 8))
    solver = MaterialPointSolver(grid, body, ELASTIC, 1.0, 0.4 / C, initial_velocity=velocity)
    solver.advance(90)  # 3.6 cells of way: points from z = 1.6 on down are at most one cell above the border
    lost = solver.points_lost
    assert 16 <= lost <= 16 * 4
    assert lost == np.count_nonzero(~solver.points.alive)
    assert np.all(body.position[~solver.points.alive, 2] < 1.61)
    np.testing.assert_allclose(solver.points.velocity[solver.points.alive, 2], -0.1 * C, rtol=0.02)
    solver.advance(150)
    assert solver.points_lost == body.count
    assert solver.energies().kinetic == 0.0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"scheme": Scheme("cpgimp")}, "'cpgimp' is for plane bodies"),
        ({"scheme": Scheme("bspline")}, "'bspline' is for plane bodies"),
        ({"thickness": 0.5}, "thickness = 0.5: must be 1"),
        ({"material": IsotropicElastic(E, NU, RHO)}, "does not fit a body in 3 dimensions"),
        ({"grid": Grid((-2.0, -2.0), 1.0, (6, 6))}, "3 dimensions, the grid has 2"),
    ],
)
def test_what_space_does_not_have_is_refused(options: dict[str, Any], message: str) -> None:
    body = fill_rectangle((0.0, 0.0, 0.0), (2.0, 2.0, 2.0), 1.0)
    arguments = {
        "grid": Grid((-2.0,) * 3, 1.0, (6, 6, 6)),
        "body": body,
        "material": ELASTIC,
        "thickness": 1.0,
        "time_step": 0.1 / C,
    }
    with pytest.raises(ValueError, match=message):
        MaterialPointSolver(**(arguments | options))
