"""Running, saving, failing: exact checkpoints, lost points, errors a user can act on."""

import numpy as np
import pytest

from mpm_service import (
    Crack,
    EdgeCondition,
    Grid,
    IsotropicElastic,
    MaterialPointSolver,
    Overlap,
    SolverError,
    cut_overlaps,
    fill_rectangle,
)
from mpm_service.material_points import VX, VY

LAW = IsotropicElastic(1.0e9, 0.3, 1000.0, "plane_stress")
DT = 0.5 / LAW.pressure_wave_speed
GRID = Grid((-4.0, -4.0), 1.0, (20, 18))


def full_solver() -> MaterialPointSolver:
    """Everything at once: crack, hole, overlap, edges, anchors, cells, damping."""
    overlap = Overlap.between(((7.0, 4.0), (9.0, 7.0)), ((6.0, 3.0), (10.0, 8.0)), 0.3)
    body = cut_overlaps(fill_rectangle((0.0, 0.0), (12.0, 10.0), 1.0), [overlap])
    edges = [
        EdgeCondition("bottom", 1, (0.0, 300 * DT), (0.0, -0.9)),
        EdgeCondition("top", 1, (0.0, 300 * DT), (0.0, 1.7)),
    ]
    crack = Crack(((-1.0, 5.5), (5.2, 5.5)))
    solver = MaterialPointSolver(GRID, body, LAW, 1.0, DT, edges, [crack], damping=0.01 / DT)
    solver.register_anchors([[6.5, 5.2], [6.5, 5.9], [9.5, 5.5]], [0, 0, 1])
    solver.register_interface_cells([[6.0, 4.0], [9.0, 4.0]], [[7.0, 7.0], [10.0, 7.0]])
    return solver


IVC_FORCE = np.array([[2e4, 1e4], [-1e4, 0.0]])
ANCHOR_FORCE = np.array([[3e3, 0.0], [0.0, 2e3], [-1e3, 1e3]])


def test_a_restored_run_goes_on_bit_for_bit() -> None:
    straight = full_solver()
    straight.advance(250, IVC_FORCE, ANCHOR_FORCE)
    first = full_solver()
    for _ in range(5):
        first.advance(25, IVC_FORCE, ANCHOR_FORCE)
    saved = first.state()
    order = saved["ids"].copy()
    first.advance(7)
    second = full_solver()
    second.restore(saved)
    second.advance(125, IVC_FORCE, ANCHOR_FORCE)
    assert second.step == straight.step == 250
    assert not np.array_equal(straight.state()["ids"], order)  # the points were sorted anew on the way
    for name, value in straight.state().items():
        np.testing.assert_array_equal(second.state()[name], value, err_msg=name)
    np.testing.assert_array_equal(second.points.stress, straight.points.stress)
    assert second.energies() == straight.energies()


def test_points_keep_their_order_in_public() -> None:
    solver = full_solver()
    solver.advance(250)
    moved = solver.points.position - solver.points.reference_position
    assert np.abs(solver.points.displacement - moved).max() == 0.0
    assert np.abs(moved).max() < 2.0
    assert np.argsort(solver.points.reference_position[:, 1])[0] < 24


def test_state_of_another_set_up_is_refused() -> None:
    solver = full_solver()
    state = solver.state()
    short = {name: value for name, value in state.items() if name != "travel"}
    with pytest.raises(ValueError, match="'travel' is missing"):
        solver.restore(short)
    state["configuration"] = state["configuration"] + 1.0
    with pytest.raises(ValueError, match="another grid"):
        solver.restore(state)
    with pytest.raises(ValueError, match="rows"):
        body = fill_rectangle((0.0, 0.0), (4.0, 4.0), 1.0)
        MaterialPointSolver(GRID, body, LAW, 1.0, DT).restore(full_solver().state())


def moving_block(speed: float) -> MaterialPointSolver:
    body = fill_rectangle((0.0, 0.0), (4.0, 4.0), 1.0)
    solver = MaterialPointSolver(GRID, body, LAW, 1.0, DT)
    state = solver.state()
    state["rows"][:, VX] = speed
    solver.restore(state)
    return solver


def test_points_that_leave_are_counted_and_the_run_goes_on() -> None:
    speed = 0.1 * LAW.pressure_wave_speed
    solver = moving_block(speed)
    # Right face at 4 m, last allowed place 15.5 m: after 12.5 m of way two columns of points have left.
    steps = round(12.5 / (speed * DT))
    solver.advance(steps)
    assert solver.points_lost == 2 * 8 or solver.points_lost == 3 * 8
    assert np.all(solver.points.alive == (solver.points.reference_position[:, 0] < 4.0 - solver.points_lost / 16))
    alive = solver.points.alive
    np.testing.assert_allclose(solver.points.velocity[alive, 0], speed, rtol=1e-3)
    solver.advance(1000)
    assert solver.points_lost == 64
    assert solver.energies().kinetic == 0.0


def test_a_runaway_names_point_place_step_and_knob() -> None:
    solver = moving_block(0.0)
    solver.advance(3)
    state = solver.state()
    row = int(np.flatnonzero(state["ids"] == 17)[0])
    state["rows"][row, VY] = np.nan
    solver.restore(state)
    with pytest.raises(SolverError, match=r"velocity of material point \d+ at .* step 3.*time_step") as caught:
        solver.advance(5)
    assert caught.value.step == 3
    assert np.hypot(*(np.array(caught.value.position) - solver.points.reference_position[17])) < 3.0


def test_a_force_that_is_too_large_is_a_solver_error() -> None:
    solver = full_solver()
    with pytest.raises(SolverError, match="runs away"):
        solver.advance(100, ivc_force=1e14 * IVC_FORCE)


def test_time_step_above_the_limit_is_refused_with_the_numbers() -> None:
    body = fill_rectangle((0.0, 0.0), (4.0, 4.0), 1.0)
    with pytest.raises(ValueError, match=r"time_step = .*at most .*Courant number"):
        MaterialPointSolver(GRID, body, LAW, 1.0, 2.0 / LAW.pressure_wave_speed)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: fill_rectangle((0.0, 0.0), (4.3, 4.0), 1.0),
            r"upper\[0\] = 4.3 .*nearest allowed value is 4.0",
        ),
        (
            lambda: fill_rectangle((0.0, 0.0), (4.0, 4.0), 1.0, hole=((1.0, 1.2), (2.0, 3.0))),
            r"hole lower\[1\] = 1.2 .*nearest allowed value is 1.0",
        ),
        (
            lambda: fill_rectangle((0.0, 0.0), (4.0, 4.0), 1.0, hole=((0.0, 0.0), (4.0, 4.0))),
            "whole rectangle",
        ),
        (lambda: Grid((0.0, 0.0), -1.0, (4, 4)), "cell_size = -1.0"),
        (lambda: IsotropicElastic(1e9, 0.5, 1000.0), "poisson = 0.5"),
        (lambda: IsotropicElastic(1e9, 0.3, 1000.0, "plane"), "assumption = 'plane'"),  # type: ignore[arg-type]
        (lambda: EdgeCondition("middle", 0, (0.0,), (0.0,)), "edge = 'middle'"),  # type: ignore[arg-type]
        (lambda: EdgeCondition("left", 0, (0.0, 0.0), (0.0, 1.0)), "increase strictly"),
        (
            lambda: MaterialPointSolver(GRID, fill_rectangle((0.0, 0.0), (16.0, 4.0), 1.0), LAW, 1.0, DT),
            "margin",
        ),
        (
            lambda: MaterialPointSolver(
                GRID,
                fill_rectangle((0.0, 0.0), (4.0, 4.0), 1.0),
                LAW,
                1.0,
                DT,
                [EdgeCondition("left", 0, (0.0,), (0.0,)), EdgeCondition("left", 0, (0.0,), (1.0,))],
            ),
            "already prescribed",
        ),
        (lambda: moving_block(0.0).advance(-1), "steps = -1"),
    ],
)
def test_bad_input_is_named(call: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()  # type: ignore[operator]


def test_registration_after_the_start_is_refused() -> None:
    solver = moving_block(0.0)
    solver.advance(1)
    with pytest.raises(ValueError, match="before the first step"):
        solver.register_anchors([[1.0, 1.0]], [0])


def test_the_answer_does_not_depend_on_the_unit_of_length() -> None:
    """The same body measured in units of 2^-32 m: everything scales, down to round-off."""
    small = 2.0**-32
    runs = []
    for unit in (1.0, small):
        body = fill_rectangle((0.0, 0.0), (8 * unit, 8 * unit), unit)
        edges = [
            EdgeCondition("bottom", 1, (0.0, 300 * DT * unit), (0.0, -0.3 * unit)),
            EdgeCondition("top", 1, (0.0, 300 * DT * unit), (0.0, 0.4 * unit)),
        ]
        grid = Grid((-4 * unit, -4 * unit), unit, (16, 16))
        crack = Crack(((-1.0 * unit, 3.5 * unit), (4.2 * unit, 3.5 * unit)))
        solver = MaterialPointSolver(grid, body, LAW, unit, DT * unit, edges, [crack])
        solver.register_anchors([[6.5 * unit, 3.2 * unit]], [0])
        solver.advance(200, anchor_force=[[1e4 * unit**2, 0.0]])
        runs.append(solver)
    np.testing.assert_allclose(runs[1].points.stress, runs[0].points.stress, rtol=1e-6, atol=1e-9 * 1e9)
    np.testing.assert_allclose(runs[1].anchor_displacement / small, runs[0].anchor_displacement, rtol=1e-6)
    np.testing.assert_allclose(runs[1].cracks.opening()[1] / small, runs[0].cracks.opening()[1], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(runs[1].edge_reaction / small**2, runs[0].edge_reaction, rtol=1e-6)
    assert runs[1].energies().strain / small**3 == pytest.approx(runs[0].energies().strain, rel=1e-6)
