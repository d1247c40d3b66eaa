"""Contact of crack faces against collisions, planar impact, and blocks that slide under friction."""

import numpy as np
import pytest

from mpm_service import (
    BodyForce,
    Crack,
    CrackSet,
    EdgeCondition,
    Grid,
    IsotropicElastic,
    MaterialPointSolver,
    fill_rectangle,
)

E, NU, RHO = 1.0e9, 0.3, 1000.0
LAW = IsotropicElastic(E, NU, RHO, "plane_strain")
SPEED = LAW.pressure_wave_speed
GRID = Grid((-4.0, -4.0), 1.0, (20, 20))
PLACE = fill_rectangle((0.0, 0.0), (10.0, 10.0), 1.0).position
NODE = 9 * 21 + 9  # at (5, 5)


def at_node(cracks: list[Crack], material: np.ndarray) -> tuple[CrackSet, np.ndarray]:
    """Crack set and the rows that material at the given places uses at the node at (5, 5)."""
    held = CrackSet(cracks, GRID, PLACE)
    held.follow()
    table = np.full((material.shape[0], 1), NODE)
    held.assign_fields_at(material, table, np.ones(material.shape[0], dtype=np.int64))
    return held, table[:, 0]


@pytest.mark.parametrize("contact", ["frictionless", "stick", "coulomb"])
def test_impulses_of_two_fields(contact: str) -> None:
    """Against the textbook impulse: reduced mass times approach, and friction up to mu times it."""
    friction = 0.4 if contact == "coulomb" else 0.0
    tangent = np.array([0.8, 0.6])
    normal = np.array([-0.6, 0.8])
    ends = (np.array([4.9, 4.8]) - 9.0 * tangent, np.array([4.9, 4.8]) + 9.0 * tangent)
    crack = Crack(ends, contact, friction)
    held, row = at_node([crack], np.array([4.9, 4.8]) + np.array([0.5, -0.5])[:, None] * normal)
    mass = np.array([2.0, 3.0])
    reduced = 1.2
    for slide in (0.5, -3.0):
        for approach in (1.5, -1.0):
            momentum = np.zeros((held.row_count, 5))
            motion = np.zeros((held.row_count, 4))
            momentum[row, 0] = mass
            relative = slide * tangent - approach * normal
            old = np.array([[0.7, -0.2], [0.1, 0.4]])
            motion[row, :2] = old[1] + np.array([relative, [0.0, 0.0]])
            motion[row, 2:] = motion[row, :2] - old
            before = motion.copy()
            lost = held.hold(momentum, motion, 0.1, 2)
            press = reduced * approach if approach > 0 else 0.0
            most = {"frictionless": 0.0, "stick": np.inf, "coulomb": friction * press}[contact]
            drag = np.sign(slide) * min(abs(reduced * slide), most) if press > 0 else 0.0
            impulse = press * normal - drag * tangent
            np.testing.assert_allclose(motion[row[0], :2], before[row[0], :2] + impulse / mass[0], atol=1e-14)
            np.testing.assert_allclose(motion[row[1], :2], before[row[1], :2] - impulse / mass[1], atol=1e-14)
            np.testing.assert_allclose(motion[row, 2:], motion[row, :2] - old, atol=1e-14)
            # work against friction: its impulse over the mean sliding velocity of the step
            mean = 0.5 * ((old[0] - old[1]) + (motion[row[0], :2] - motion[row[1], :2])) @ tangent
            assert lost == pytest.approx(drag * mean, abs=1e-14)


@pytest.mark.parametrize("contact", ["frictionless", "stick", "coulomb"])
def test_three_fields_keep_momentum_and_come_to_rest_on_each_other(contact: str) -> None:
    friction = 0.3 if contact == "coulomb" else 0.0
    cracks = [
        Crack(((-3.0, 5.2), (13.0, 5.2)), contact, friction),
        Crack(((4.9, 5.2), (4.9, -3.0)), contact, friction),
    ]
    held, row = at_node(cracks, np.array([[5.0, 5.5], [4.5, 4.9], [5.5, 4.9]]))  # above, left below, right below
    assert len(set(row)) == 3
    random = np.random.default_rng(2)
    pressed = 0
    for _ in range(50):
        momentum = np.zeros((held.row_count, 5))
        velocity = np.zeros((held.row_count, 2))
        momentum[row, 0] = random.uniform(0.1, 2.0, 3)
        velocity[row] = random.normal(size=(3, 2))
        mass = momentum[row, 0][:, None]
        before = (mass * velocity[row]).sum(axis=0)
        energy = (mass * velocity[row] ** 2).sum()
        started = velocity[row].copy()
        held.hold(momentum, velocity, 0.1)
        np.testing.assert_allclose((mass * velocity[row]).sum(axis=0), before, atol=1e-13)
        assert (mass * velocity[row] ** 2).sum() <= energy * (1.0 + 1e-13)
        above, left, right = velocity[row]
        assert min(above[1] - left[1], above[1] - right[1], right[0] - left[0]) > -1e-9
        pressed += not np.array_equal(started, velocity[row])
    assert pressed > 25


def test_a_gap_closes_and_no_more() -> None:
    held = CrackSet([Crack(((-3.0, 5.2), (13.0, 5.2)))], GRID, PLACE)
    moved = PLACE + np.where(PLACE[:, 1:] > 5.2, [[0.0, 0.02]], 0.0)
    held.move(np.ascontiguousarray(moved), np.arange(PLACE.shape[0]))
    held.follow()
    table = np.full((2, 1), NODE)
    held.assign_fields_at(np.array([[5.0, 5.5], [5.0, 4.9]]), table, np.ones(2, dtype=np.int64))
    above, below = table[:, 0]
    momentum = np.zeros((held.row_count, 5))
    momentum[[above, below], 0] = 1.0
    for approach, left in ((0.15, 0.15), (0.5, 0.2)):  # the gap of 0.02 m closes in a step of 0.1 s at 0.2 m/s
        velocity = np.zeros((held.row_count, 2))
        velocity[above, 1] = -approach
        held.hold(momentum, velocity, 0.1)
        assert velocity[below, 1] - velocity[above, 1] == pytest.approx(left, rel=1e-9)


@pytest.mark.parametrize(("line", "tolerance"), [(30.0, 2e-4), (30.5, 2e-4), (30.3, 0.02)])
@pytest.mark.parametrize("contact", ["frictionless", "stick"])
def test_closed_faces_hand_on_a_planar_impact(line: float, tolerance: float, contact: str) -> None:
    """Two equal bodies in uniaxial strain: stress - rho c v / 2 and velocity v / 2 behind both fronts.

    Off the middle and the ends of a cell the halves share domains of points, which the tolerance covers.
    """
    body = fill_rectangle((0.0, 0.0), (6.0, 60.0), 1.0)
    sides = [EdgeCondition(edge, 0, (0.0,), (0.0,)) for edge in ("left", "right")]
    speed = 1e-4 * SPEED
    solver = MaterialPointSolver(
        Grid((-4.0, -4.0), 1.0, (14, 68)),
        body,
        LAW,
        1.0,
        0.5 / SPEED,
        sides,
        [Crack(((-3.0, line), (9.0, line)), contact)],
        initial_velocity=np.where(body.position[:, 1:] > line, [[0.0, -speed]], 0.0),
    )
    momentum = (solver.points.mass * solver.points.velocity[:, 1]).sum()
    solver.advance(60)
    assert (solver.points.mass * solver.points.velocity[:, 1]).sum() == pytest.approx(momentum, rel=1e-12)
    behind = np.abs(body.position[:, 1] - line) < 10.0
    np.testing.assert_allclose(solver.points.stress[behind, 1], -0.5 * RHO * SPEED * speed, rtol=tolerance)
    np.testing.assert_allclose(solver.points.velocity[behind, 1].mean(), -0.5 * speed, rtol=1e-5)
    assert np.abs(solver.cracks.opening()[1][:, 0]).max() < 1e-4 * 10.0


@pytest.mark.parametrize(("friction", "slope", "expected"), [(0.1, 0.3, 0.2), (0.5, 0.3, 0.0), (0.0, 0.3, 0.3)])
def test_block_on_an_incline(friction: float, slope: float, expected: float) -> None:
    """A block on a base under gravity: it slides with g (slope - mu), or stays if the slope is below mu."""
    body = fill_rectangle((0.0, 0.0), (20.0, 4.0), 1.0)
    gravity = 2e-5 * SPEED**2
    held = [EdgeCondition("bottom", component, (0.0,), (0.0,)) for component in range(2)]
    solver = MaterialPointSolver(
        Grid((-4.0, -4.0), 1.0, (28, 12)),
        body,
        LAW,
        1.0,
        0.5 / SPEED,
        held,
        [Crack(((-3.0, 2.0), (23.0, 2.0)), "coulomb", friction)],
        loads=[BodyForce((slope * gravity, -gravity))],
    )
    block = body.position[:, 1] > 2.0
    solver.advance(1600)
    gained = solver.points.velocity[block, 0].mean() / (gravity * solver.time)
    assert gained == pytest.approx(expected, abs=0.001)
    slid = solver.points.displacement[block, 0].mean()
    normal_force = RHO * 40.0 * gravity
    scale = slope * normal_force * (0.5 * slope * gravity * solver.time**2)
    assert solver.energies().friction_loss == pytest.approx(
        friction * normal_force * slid * (expected > 0), abs=0.005 * scale
    )
