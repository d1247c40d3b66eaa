"""Anchors and interface volume cells: the continuum's side of the handshake."""

import numpy as np
import pytest

from mpm_service import Crack, EdgeCondition, Grid, IsotropicElastic, MaterialPointSolver, Scheme, fill_rectangle

LAW = IsotropicElastic(1.0e9, 0.3, 1000.0, "plane_strain")
DT = 0.4 / LAW.pressure_wave_speed
GRID = Grid((-4.0, -4.0), 1.0, (20, 18))


def solver_with(anchors: np.ndarray, crack: Crack | None = None, **options: object) -> MaterialPointSolver:
    body = fill_rectangle((0.0, 0.0), (12.0, 10.0), 1.0)
    solver = MaterialPointSolver(GRID, body, LAW, 1.0, DT, cracks=[] if crack is None else [crack], **options)  # type: ignore[arg-type]
    solver.register_anchors(anchors, np.zeros(len(anchors), dtype=int))
    return solver


def random_anchors(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).random((count, 2)) * [8.0, 6.0] + 2.0


def test_anchors_follow_a_homogeneous_deformation() -> None:
    anchors = random_anchors(50)
    rate = np.diag([2e-9, -1e-9]) / DT
    end = 1e3 * DT
    edges = [
        EdgeCondition("left", 0, (0.0, end), (0.0, 0.0)),
        EdgeCondition("right", 0, (0.0, end), (0.0, 12.0 * rate[0, 0] * end)),
        EdgeCondition("bottom", 1, (0.0, end), (0.0, 0.0)),
        EdgeCondition("top", 1, (0.0, end), (0.0, 10.0 * rate[1, 1] * end)),
    ]
    solver = solver_with(anchors, edge_conditions=edges, initial_velocity_gradient=rate)
    solver.advance(100)
    expected = anchors @ rate * 100 * DT
    np.testing.assert_allclose(solver.anchor_displacement, expected, rtol=1e-6)
    np.testing.assert_allclose(solver.anchor_velocity, anchors @ rate, rtol=1e-6)


def test_anchor_force_gives_its_impulse_and_its_work() -> None:
    anchors = random_anchors(30)
    force = np.random.default_rng(5).normal(size=(30, 2)) * 1e3 + 500.0
    solver = solver_with(anchors)
    steps = 400
    solver.advance(steps, anchor_force=force)
    momentum = (solver.points.mass[:, None] * solver.points.velocity).sum(axis=0)
    np.testing.assert_allclose(momentum, force.sum(axis=0) * steps * DT, rtol=1e-10)
    energy = solver.energies()
    work = energy.interface_work
    assert energy.kinetic + energy.strain + energy.filter_loss == pytest.approx(work, rel=1e-5)
    # The force acts half a step before the place that it leads to, so displacement counts half a step of it more.
    moved = solver.anchor_displacement - 0.5 * DT * solver.anchor_velocity
    assert float((force * moved).sum()) == pytest.approx(work, rel=1e-12)


def test_springs_on_anchors_hold_what_the_continuum_gave_and_the_filter_only_takes() -> None:
    anchors = random_anchors(30)
    count = fill_rectangle((0.0, 0.0), (12.0, 10.0), 1.0).count
    solver = solver_with(anchors, initial_velocity=np.tile([2e-3, -1e-3], (count, 1)))
    stiffness = 2e7
    start = solver.energies()
    lost = []
    for _ in range(300):
        before = solver.anchor_displacement
        solver.advance(1, anchor_force=-stiffness * before)
        energy = solver.energies()
        lost.append(energy.filter_loss)
    # Besides what smoothing takes the loss holds the difference of two measures of the kinetic energy, which is small.
    assert np.max(np.maximum.accumulate(lost) - lost) < 1e-3 * lost[-1]
    # Of a leapfrog the energy of a spring is that of the product of two places, one step apart.
    stored = 0.5 * stiffness * float(np.sum(before * solver.anchor_displacement))
    assert stored > 0.01 * start.kinetic
    assert energy.interface_work == pytest.approx(-stored, rel=1e-10)
    assert energy.kinetic + energy.strain + energy.filter_loss + stored == pytest.approx(start.kinetic, rel=1e-6)


@pytest.mark.parametrize("crack", [None, Crack(((-1.0, 5.5), (7.3, 5.5)))])
def test_reading_and_loading_are_adjoint(crack: Crack | None) -> None:
    """One step from rest: force at a read at b equals force at b read at a, whatever the fields."""
    anchors = random_anchors(12, seed=4)
    anchors[0] = (4.3, 5.4)
    anchors[1] = (4.3, 5.6)
    response = np.zeros((24, 24))
    for column in range(24):
        force = np.zeros(24)
        force[column] = 1.0
        solver = solver_with(anchors, crack)
        if crack is not None:  # a hair open: closed faces push but do not pull, which is not linear
            state = solver.state()
            state["crack_faces"][:, 1] = 1e-9
            solver.restore(state)
        solver.advance(1, anchor_force=force.reshape(12, 2))
        response[:, column] = solver.anchor_velocity.ravel()
    scale = np.abs(response).max()
    assert np.abs(response - response.T).max() < 1e-13 * scale
    assert np.all(np.linalg.eigvalsh(response) > -1e-13 * scale)
    if crack is not None:
        assert response[0, 2] == 0.0  # the anchors on the two faces do not see each other


def test_anchors_take_the_side_they_stand_on() -> None:
    anchors = np.array([[4.3, 5.4], [4.3, 5.6]])
    solver = solver_with(anchors, Crack(((-3.0, 5.5), (15.0, 5.5))))
    state = solver.state()
    upper = solver.points.reference_position[state["ids"], 1] > 5.5
    state["rows"][:, 3] = np.where(upper, 2.0, 0.0)
    solver.restore(state)
    solver.advance(50)
    np.testing.assert_allclose(solver.anchor_displacement[:, 1], [0.0, 100 * DT], atol=1e-12 * DT)


def test_cell_force_is_shared_equally() -> None:
    solver = solver_with(np.array([[4.5, 4.5]]), scheme=Scheme(transfer="flip"))  # keeps energy
    counts = solver.register_interface_cells([[4.0, 4.0], [7.0, 4.0]], [[6.0, 5.0], [8.0, 5.0]])
    assert counts.tolist() == [8, 4]
    force = np.array([[100.0, 0.0], [0.0, -30.0]])
    solver.advance(200, ivc_force=force)
    momentum = (solver.points.mass[:, None] * solver.points.velocity).sum(axis=0)
    np.testing.assert_allclose(momentum, force.sum(axis=0) * 200 * DT, rtol=1e-9)
    energy = solver.energies()
    assert energy.kinetic + energy.strain + energy.filter_loss == pytest.approx(energy.interface_work, rel=1e-6)
    place = solver.points.reference_position
    inside = np.all((place >= [4.0, 4.0]) & (place < [6.0, 5.0]), axis=1)
    work = (solver.points.displacement[inside] * [100.0 / 8.0, 0.0]).sum()
    other = np.all((place >= [7.0, 4.0]) & (place < [8.0, 5.0]), axis=1)
    work += (solver.points.displacement[other] * [0.0, -30.0 / 4.0]).sum()
    # The force acts half a step before the place that it leads to, so displacement counts half a step of it more.
    velocity = solver.points.velocity
    late = (velocity[inside] * [100.0 / 8.0, 0.0]).sum() + (velocity[other] * [0.0, -30.0 / 4.0]).sum()
    assert energy.interface_work == pytest.approx(work - 0.5 * DT * late, rel=1e-3)


def test_cell_with_anchors_and_no_points_is_named() -> None:
    solver = solver_with(np.array([[4.5, 4.5]]))
    with pytest.raises(ValueError, match="interface cell 0: holds 1 anchors but no material point"):
        solver.register_interface_cells([[20.0, 20.0]], [[21.0, 21.0]])


def test_anchor_outside_the_material_is_named() -> None:
    with pytest.raises(ValueError, match=r"position\[1\]"):
        solver_with(np.array([[4.5, 4.5], [-3.5, -3.5]]))


def test_wrong_force_arrays_are_refused() -> None:
    solver = solver_with(np.array([[4.5, 4.5]]))
    with pytest.raises(ValueError, match="anchor_force"):
        solver.advance(1, anchor_force=np.zeros((2, 2)))
    with pytest.raises(ValueError, match="ivc_force"):
        solver.advance(1, ivc_force=np.zeros((1, 2)))
    with pytest.raises(ValueError, match=r"anchor_force\[0, 1\]"):
        solver.advance(1, anchor_force=[[0.0, np.nan]])


@pytest.mark.parametrize("place", [(-3.5, 5.0), (400.0, 5.0)])
def test_an_anchor_without_material_is_refused(place: tuple[float, float]) -> None:
    with pytest.raises(ValueError, match="no material point reaches"):
        solver_with(np.array([[5.0, 5.0], place]))
