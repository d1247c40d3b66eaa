"""Prescribed motion against linear algebra, linear fields, and the balance of momentum and energy."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import get_args

import numpy as np
import pytest
from scipy.integrate import quad

from mpm_service import BodyForce, Grid, IsotropicElastic, MaterialPointSolver, Scheme, fill_rectangle, relax
from mpm_service.boundary_set import BoundarySet
from mpm_service.conditions import FACES, EdgeCondition, NodeCondition, face_axis, face_sign, symmetry
from mpm_service.scheme import Integration, Interpolation, Transfer
from mpm_service.time_functions import Constant, Ramp, Schedule, Sine, Step, Table
from mpm_service.velocity_fields import FieldMap

H = 0.5
DT = 1e-3


@dataclass(frozen=True)
class Lattice:
    """A grid in two or three dimensions."""

    origin: tuple[float, ...]
    cell_size: float
    cells: tuple[int, ...]

    @property
    def places(self) -> np.ndarray:
        axes = [self.origin[b] + self.cell_size * np.arange(n + 1) for b, n in enumerate(self.cells)]
        mesh = np.meshgrid(*reversed(axes), indexing="ij")
        return np.stack([m.ravel() for m in reversed(mesh)], axis=1)


PLANE = Lattice((-2.0, -1.5), H, (14, 12))
SPACE = Lattice((-2.0, -1.5, -2.5), H, (12, 11, 13))
BODY = {2: (np.array([0.0, 0.0]), np.array([3.0, 3.0])), 3: (np.zeros(3), np.array([2.0, 2.5, 2.0]))}
GRIDS = {2: PLANE, 3: SPACE}


# ---- time functions ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "function",
    [
        Constant(2.5),
        Sine(1.5, 7.0, 0.4),
        Step(2.0, 0.3),
        Step(2.0, -0.3),
        Ramp(0.5, -2.0, 0.2),
        Ramp(0.5, -2.0, -0.1, smooth=True),
        Ramp(0.4, 3.0, 0.3, smooth=True),
        Table((0.1, 0.4, 0.9), (1.0, -2.0, 4.0)),
        Table((-0.5, 0.25), (1.0, 3.0)),
        Table((0.3,), (4.0,)),
    ],
)
def test_integrals_of_time_functions_against_quadrature(function: Callable) -> None:
    corners = [0.1, 0.2, 0.25, 0.3, 0.4, 0.7, 0.9]
    for end in (0.05, 0.25, 0.55, 1.3):
        inside = [c for c in corners if c < end]
        expected = quad(lambda t: float(function(np.array([t]))[0]), 0.0, end, points=inside or None, epsabs=1e-13)[0]
        assert function.integral(np.array([end]))[0] == pytest.approx(expected, rel=1e-10, abs=1e-12)


def test_time_functions_at_chosen_times() -> None:
    time = np.array([0.0, 0.25, 0.5, 2.0])
    np.testing.assert_allclose(Ramp(1.0, 4.0)(time), [0.0, 1.0, 2.0, 4.0])
    np.testing.assert_allclose(Ramp(1.0, 4.0, smooth=True)(time), [0.0, 2.0 - np.sqrt(2.0), 2.0, 4.0])
    np.testing.assert_allclose(Step(3.0, 0.5)(time), [0.0, 0.0, 3.0, 3.0])
    np.testing.assert_allclose(Sine(2.0, np.pi, 0.5 * np.pi)(time), [2.0, np.sqrt(2.0), 0.0, 2.0], atol=1e-15)
    np.testing.assert_allclose(Table((0.25, 0.5), (1.0, 3.0))(time), [1.0, 1.0, 3.0, 3.0])


def test_schedule_gives_the_functions_at_whole_steps_from_anywhere() -> None:
    schedule = Schedule([Sine(1.0, 3.0), Table((0.0, 1.0), (0.0, 5.0))], ["a", "b"], 0.01)
    for step in (0, 511, 512, 3, 513, 1500):
        time = np.maximum((np.array([-1.0, 0.0, 1.0]) + step) * 0.01, 0.0)
        expected = np.stack([np.sin(3.0 * time), np.minimum(5.0 * time, 5.0)], axis=1)
        np.testing.assert_allclose(schedule.window(step), expected, rtol=1e-14, atol=1e-15)
        np.testing.assert_array_equal(schedule.now(step), schedule.window(step)[1])
    with pytest.raises(ValueError, match="a: must return one value per time"):
        Schedule([lambda time: np.zeros(2)], ["a"], 0.01).now(0)
    with pytest.raises(ValueError, match=r"a = .*nan.* at time 0.5 s: must be finite"):
        Schedule([lambda time: np.where(time == 0.5, np.nan, 0.0)], ["a"], 0.5).now(0)


# ---- straight lines across a face ----------------------------------------------------------------------


def hat(x: float) -> tuple[float, float]:
    return max(1.0 - abs(x), 0.0), -np.sign(x) if abs(x) < 1.0 else 0.0


def averaged_hat(x: float, half: float = 0.25) -> tuple[float, float]:
    def primitive(s: float) -> float:
        s = float(np.clip(s, -1.0, 1.0))
        return s - 0.5 * s * abs(s)

    value = (primitive(x + half) - primitive(x - half)) / (2 * half)
    return value, (hat(x + half)[0] - hat(x - half)[0]) / (2 * half)


def spline(x: float) -> tuple[float, float]:
    if abs(x) < 0.5:
        return 0.75 - x * x, -2.0 * x
    if abs(x) < 1.5:
        return 0.5 * (1.5 - abs(x)) ** 2, -np.sign(x) * (1.5 - abs(x))
    return 0.0, 0.0


def interpolate(
    grid: Lattice, shape: Callable[[float], tuple[float, float]], at: np.ndarray, field: np.ndarray
) -> tuple[float, np.ndarray]:
    """Value and gradient of a nodal field at a place, by products of functions of one direction."""
    parts = [
        [shape((at[b] - grid.origin[b]) / grid.cell_size - i) for i in range(n + 1)] for b, n in enumerate(grid.cells)
    ]
    table = field.reshape([n + 1 for n in reversed(grid.cells)])

    def sum_with(slope_axis: int) -> float:
        result = table
        for b in range(len(grid.cells)):
            factors = np.array([p[1] / grid.cell_size if b == slope_axis else p[0] for p in parts[b]])
            result = result @ factors
        return float(result)

    return sum_with(-1), np.array([sum_with(b) for b in range(len(grid.cells))])


@pytest.mark.parametrize("shape", [hat, averaged_hat, spline])
@pytest.mark.parametrize(("dimension", "face"), [(2, f) for f in FACES[:4]] + [(3, f) for f in FACES])
@pytest.mark.parametrize("shift", [0.0, 0.12, -0.17, 0.8])
def test_linear_velocities_stay_linear_up_to_a_moved_face(
    shape: Callable, dimension: int, face: str, shift: float
) -> None:
    grid = GRIDS[dimension]
    lower, upper = BODY[dimension]
    axis, sign = face_axis(face), face_sign(face)
    edge = float((upper if sign > 0 else lower)[axis]) + shift
    rng = np.random.default_rng(3)
    velocity_at_edge = 2.5
    slope = np.zeros(dimension)
    slope[axis] = 1.7
    component = dimension - 1
    # The face is displaced by `shift` along its normal and moves its other component with 2.5 m/s.
    conditions = [EdgeCondition(face, component, velocities=Constant(velocity_at_edge))]  # type: ignore[arg-type]
    if component == axis:
        history = Table((0.0, DT), (shift, shift + velocity_at_edge * DT))
        conditions = [EdgeCondition(face, axis, displacements=history)]  # type: ignore[arg-type]
    else:
        conditions.append(EdgeCondition(face, axis, (0.0,), (shift,)))  # type: ignore[arg-type]
    boundary = BoundarySet(conditions, grid, lower, upper, DT)
    places = grid.places
    linear = velocity_at_edge + (places - [edge if b == axis else 0.0 for b in range(dimension)]) @ slope
    inside = sign * (places[:, axis] - edge) < -0.5 * H - 1e-12
    table = rng.normal(size=(places.shape[0], dimension))
    table[inside, component] = linear[inside]
    momentum = np.ones((places.shape[0], 1 + 2 * dimension))
    boundary.impose(momentum, table)
    for _ in range(5):
        at = np.asarray(rng.uniform(lower + 0.3, upper - 0.3))
        at[axis] = edge - sign * rng.choice([0.0, 0.25 * H, 0.49 * H, 1.3 * H])
        if shape is averaged_hat:  # the domain of a point lies inside the body
            at[axis] = edge - sign * max(abs(at[axis] - edge), 0.25 * H)
        expected = velocity_at_edge + slope[axis] * (at[axis] - edge)
        value, gradient = interpolate(grid, shape, at, table[:, component])
        assert value == pytest.approx(expected, rel=1e-12)
        if shape is hat:  # a hat function has no slope at a node: look to the inner side of it
            at[axis] -= sign * 1e-7
            _, gradient = interpolate(grid, shape, at, table[:, component])
        np.testing.assert_allclose(gradient, slope, atol=1e-9)


def test_a_velocity_is_prescribed_by_its_exact_mean_over_the_step() -> None:
    lower, upper = BODY[2]
    boundary = BoundarySet([EdgeCondition("top", 0, velocities=Sine(3.0, 900.0))], PLANE, lower, upper, DT)
    row = np.flatnonzero(np.all(np.abs(PLANE.places - [1.0, 3.0]) < 1e-9, axis=1))[0]
    momentum = np.ones((PLANE.places.shape[0], 5))
    for step in (0, 1, 700):
        boundary.locate(step)
        table = np.zeros((momentum.shape[0], 2))
        boundary.impose(momentum, table)
        mean = 3.0 / (900.0 * DT) * (np.cos(900.0 * DT * step) - np.cos(900.0 * DT * (step + 1)))
        assert table[row, 0] == pytest.approx(mean, rel=1e-12)
        if step:
            boundary.impose(momentum, table, before=True)
            mean = 3.0 / (900.0 * DT) * (np.cos(900.0 * DT * (step - 1)) - np.cos(900.0 * DT * step))
            assert table[row, 0] == pytest.approx(mean, rel=1e-12)


@pytest.mark.parametrize("started_moving", [False, True])
def test_before_the_first_step_faces_rest_or_move_on(started_moving: bool) -> None:
    lower, upper = BODY[2]
    boundary = BoundarySet(
        [EdgeCondition("left", 1, velocities=Constant(4.0))], PLANE, lower, upper, DT, started_moving=started_moving
    )
    table = np.zeros((PLANE.places.shape[0], 2))
    boundary.impose(np.ones((table.shape[0], 5)), table, before=True)
    on_face = PLANE.places[:, 0] == 0.0
    np.testing.assert_allclose(table[on_face, 1], 4.0 if started_moving else 0.0, rtol=1e-12)


# ---- momentum equation ---------------------------------------------------------------------------------


def random_tables(grid: Lattice, rng: np.random.Generator, extra: int = 0) -> tuple[np.ndarray, np.ndarray]:
    dimension = len(grid.cells)
    rows = grid.places.shape[0] + extra
    momentum = rng.normal(size=(rows, 1 + 2 * dimension))
    momentum[:, 0] = rng.uniform(0.2, 2.0, rows)
    motion = np.zeros((rows, 2 * dimension))
    motion[:, dimension:] = DT * momentum[:, 1 + dimension :] / momentum[:, :1]
    motion[:, :dimension] = momentum[:, 1 : 1 + dimension] / momentum[:, :1] + motion[:, dimension:]
    return momentum, motion


@pytest.mark.parametrize(
    ("dimension", "faces"),
    [(2, ["left", "top"]), (2, ["bottom", "right", "top"]), (3, ["left", "top", "front"]), (3, list(FACES))],
)
@pytest.mark.parametrize("splines", [False, True])
def test_momentum_and_energy_balance_of_a_step(splines: bool, dimension: int, faces: list[str]) -> None:
    """Gain of momentum is force plus reaction, gain of energy their work, corners and edges of faces included."""
    grid = GRIDS[dimension]
    lower, upper = BODY[dimension]
    rng = np.random.default_rng(7)
    conditions = []
    for component in range(dimension):
        for face in faces:
            displacements = 0.13 + 0.001 * rng.normal(size=4)
            conditions.append(EdgeCondition(face, component, (0.0, DT, 2 * DT, 3 * DT), displacements))  # type: ignore[arg-type]
    boundary = BoundarySet(conditions, grid, lower, upper, DT, splines=splines)
    boundary.locate(1)
    momentum, motion = random_tables(grid, rng)
    before = motion.copy()
    work, not_lost = boundary.accelerate(momentum, motion)
    assert not_lost == 0.0
    touched = np.any(motion != before, axis=1)
    assert touched.sum() > 40 and not touched.all()
    mass = momentum[:, :1]
    new, increment = motion[:, :dimension], motion[:, dimension:]
    force = momentum[:, 1 + dimension :]
    reaction = np.zeros(dimension)
    for condition, r in zip(conditions, boundary.reaction, strict=True):
        reaction[condition.component] += r
    gain = (mass * increment).sum(axis=0)
    np.testing.assert_allclose(gain, DT * (force.sum(axis=0) + reaction), rtol=1e-10, atol=1e-12)
    middle = new - 0.5 * increment
    np.testing.assert_allclose((mass * increment * middle).sum(), DT * (force * middle).sum() + work, rtol=1e-10)


def test_constrained_step_against_lagrange_multipliers() -> None:
    lower, upper = BODY[2]
    rng = np.random.default_rng(11)
    shift, v0, v1 = 0.11, 0.7, -1.2
    history = Table((0.0, DT, 2 * DT, 3 * DT), (shift, shift - v0 * DT, shift, shift + v1 * DT))
    boundary = BoundarySet([EdgeCondition("right", 0, displacements=history)], PLANE, lower, upper, DT)
    boundary.locate(2)
    momentum, motion = random_tables(PLANE, rng)
    boundary.accelerate(momentum, motion)
    edge = 3.0 + shift
    total = 0.0
    places = PLANE.places
    for y in np.unique(places[:, 1]):
        line = np.flatnonzero(places[:, 1] == y)
        free = line[places[line, 0] == 2.5][0]
        nodes = [line[places[line, 0] == x][0] for x in (3.0, 3.5, 4.0)]
        ratio = np.array([(edge - places[n, 0]) / (edge - 2.5) for n in nodes])
        own = [free, *nodes]
        mass = momentum[own, 0]
        old = np.array([momentum[free, 1] / momentum[free, 0], 0.0, 0.0, 0.0])
        old[1:] = v0 + ratio * (old[0] - v0)
        # M (v - old) - C^T l = dt f with C v = (1 - r) v1
        constraint = np.column_stack([-ratio, np.eye(3)])
        system = np.block([[np.diag(mass), -constraint.T], [constraint, np.zeros((3, 3))]])
        right = np.concatenate([mass * old + DT * momentum[own, 3], (1.0 - ratio) * v1])
        answer = np.linalg.solve(system, right)
        np.testing.assert_allclose(motion[own, 0], answer[:4], rtol=1e-10)
        np.testing.assert_allclose(motion[own, 2], answer[:4] - old, rtol=1e-9, atol=1e-12)
        total += (1.0 - ratio) @ answer[4:] / DT
    assert boundary.reaction[0] == pytest.approx(total, rel=1e-10)


def test_damping_of_constrained_nodes_is_accounted_for() -> None:
    """Of what all nodes would lose by damping, the constrained nodes' own part is handed back."""
    lower, upper = BODY[2]
    boundary = BoundarySet([EdgeCondition("left", 1, velocities=Constant(2.0))], PLANE, lower, upper, DT, True)
    momentum, motion = random_tables(PLANE, np.random.default_rng(5))
    momentum[:, 3:] = 0.0
    momentum[:, 1:3] = 2.0 * momentum[:, :1]
    keep = 0.9
    _, not_lost = boundary.accelerate(momentum, motion, keep)
    fixed = PLANE.places[:, 0] == 0.0
    beyond = (PLANE.places[:, 0] < 0.0) & (PLANE.places[:, 0] > -1.25)
    # At s = 0 the face's nodes keep 2 m/s, those beyond follow the line to the inner ones, at 2 keep.
    np.testing.assert_allclose(motion[fixed, 1], 2.0)
    far = (0.0 - PLANE.places[beyond, 0]) / H
    np.testing.assert_allclose(motion[beyond, 1], 2.0 - far * (2.0 * keep - 2.0), rtol=1e-12)
    speeds = np.concatenate([motion[fixed, 1], motion[beyond, 1]])
    masses = np.concatenate([momentum[fixed, 0], momentum[beyond, 0]])
    expected = 0.5 * (masses * speeds**2).sum() * (1.0 / keep**2 - 1.0)
    assert not_lost == pytest.approx(expected, rel=1e-12)


def test_reaction_under_scaled_forces_is_that_of_scaled_masses() -> None:
    """Forces times 1/4 with masses m move like whole forces with masses 4 m, and report the same reaction."""
    lower, upper = BODY[2]
    edges = [EdgeCondition("right", 0, (0.0, DT, 2 * DT), (0.1, 0.1 + 1e-3, 0.1 + 3e-3))]
    answers = []
    for factor, inertia in ((0.25, 1.0), (1.0, 4.0)):
        momentum, motion = random_tables(PLANE, np.random.default_rng(8))
        momentum[:, :3] *= inertia
        momentum[:, 3:] *= factor
        boundary = BoundarySet(edges, PLANE, lower, upper, DT)
        work, _ = boundary.accelerate(momentum, motion, 1.0, factor)
        answers.append((boundary.reaction[0], work, motion[PLANE.places[:, 0] == 3.0, 0]))
    assert answers[0][0] == pytest.approx(answers[1][0], rel=1e-12)
    assert answers[0][1] == pytest.approx(answers[1][1], rel=1e-12)
    np.testing.assert_allclose(answers[0][2], answers[1][2], rtol=1e-12)


@pytest.mark.parametrize("dimension", [2, 3])
def test_node_condition_holds_its_nodes_and_reports_their_reaction(dimension: int) -> None:
    grid = GRIDS[dimension]
    lower, upper = BODY[dimension]
    box = (np.full(dimension, 0.5), np.array([1.0, 1.5, 1.0][:dimension]))
    held = NodeCondition(box[0], box[1], 1, velocities=Constant(3.0))
    boundary = BoundarySet([symmetry("left"), held], grid, lower, upper, DT, started_moving=True)
    momentum, motion = random_tables(grid, np.random.default_rng(2))
    before = motion.copy()
    work, _ = boundary.accelerate(momentum, motion)
    inside = np.all((grid.places >= box[0]) & (grid.places <= box[1]), axis=1)
    assert inside.sum() == (2 * 3 if dimension == 2 else 2 * 3 * 2)
    np.testing.assert_array_equal(motion[inside, 1], np.full(inside.sum(), 3.0 * DT / DT))
    np.testing.assert_allclose(motion[inside, dimension + 1], 0.0, atol=1e-12)
    np.testing.assert_array_equal(motion[~inside, 1], before[~inside, 1])
    force = -momentum[inside, 1 + dimension + 1].sum()
    assert boundary.reaction[1] == pytest.approx(force, rel=1e-10)
    assert work == pytest.approx(force * 3.0 * DT, rel=1e-10)
    table = np.zeros((momentum.shape[0], dimension))
    boundary.impose(momentum, table)
    np.testing.assert_allclose(table[inside, 1], 3.0, rtol=1e-12)
    assert np.count_nonzero(table) == inside.sum()


def test_held_nodes_are_left_out_of_a_face() -> None:
    lower, upper = BODY[2]
    support = NodeCondition((0.0, 0.0), (0.0, 0.0), 1, (0.0,), (0.0,))
    face = EdgeCondition("bottom", 1, velocities=Constant(2.0))
    boundary = BoundarySet([face, support], PLANE, lower, upper, DT)
    momentum, _ = random_tables(PLANE, np.random.default_rng(4))
    table = np.full((momentum.shape[0], 2), 2.0)
    boundary.impose(momentum, table)
    corner = np.all(PLANE.places == 0.0, axis=1)
    assert table[corner, 1] == 0.0
    np.testing.assert_allclose(table[~corner], 2.0, rtol=1e-12)


def test_empty_nodes_are_left_alone_and_a_face_without_inner_node_moves_as_one() -> None:
    lower, upper = BODY[2]
    boundary = BoundarySet([EdgeCondition("right", 0, velocities=Constant(1.5))], PLANE, lower, upper, DT)
    momentum, motion = random_tables(PLANE, np.random.default_rng(4))
    momentum[PLANE.places[:, 0] > 3.0, 0] = 0.0
    momentum[PLANE.places[:, 0] == 2.5, 0] = 0.0
    before = motion.copy()
    boundary.accelerate(momentum, motion)
    on_face = PLANE.places[:, 0] == 3.0
    np.testing.assert_allclose(motion[on_face, 0], 1.5, rtol=1e-12)
    np.testing.assert_array_equal(motion[~on_face], before[~on_face])


@pytest.mark.parametrize("splines", [False, True])
def test_extra_velocity_fields_are_constrained_like_the_first(splines: bool) -> None:
    """A second and third field with the state of another body moves as that body would alone."""
    lower, upper = BODY[2]
    rng = np.random.default_rng(9)
    edges = [
        EdgeCondition("right", 0, (0.0, DT), (0.1, 0.1 + 2e-3 * DT)),
        EdgeCondition("right", 1, velocities=Constant(0.3)),
    ]
    rows = PLANE.places.shape[0]
    near = np.full(rows, -1, dtype=np.int64)
    chosen = np.flatnonzero((PLANE.places[:, 1] > 0.9) & (PLANE.places[:, 1] < 2.1))
    near[chosen] = rng.permutation(chosen.size)
    fields = FieldMap(near, rows, chosen.size + 3, 2)
    alone = [random_tables(PLANE, rng) for _ in range(3)]
    expected = []
    reactions = []
    for momentum, motion in alone:
        result = motion.copy()
        boundary = BoundarySet(edges, PLANE, lower, upper, DT, splines=splines)
        boundary.accelerate(momentum, result)
        expected.append(result)
        reactions.append(boundary.reaction.copy())
    momentum, motion = random_tables(PLANE, rng, 2 * fields.capacity)
    momentum[:rows], motion[:rows] = alone[0]
    for which in (1, 2):
        extra = fields.base + (which - 1) * fields.capacity + near[chosen]
        momentum[extra], motion[extra] = alone[which][0][chosen], alone[which][1][chosen]
    boundary = BoundarySet(edges, PLANE, lower, upper, DT, splines=splines)
    boundary.locate(0, fields)
    boundary.accelerate(momentum, motion)
    np.testing.assert_array_equal(motion[:rows], expected[0])
    for which in (1, 2):
        extra = fields.base + (which - 1) * fields.capacity + near[chosen]
        np.testing.assert_array_equal(motion[extra], expected[which][chosen])
    assert np.all(np.abs(boundary.reaction - reactions[0]) > 1e-6 * np.abs(reactions[0]))


def test_restart_inside_a_block_gives_the_same_numbers() -> None:
    lower, upper = BODY[2]
    edges = [
        EdgeCondition("right", 0, displacements=Sine(0.05, 31.0)),
        EdgeCondition("top", 0, velocities=Sine(1.0, 17.0)),
    ]
    one = BoundarySet(edges, PLANE, lower, upper, DT)
    momentum, motion = random_tables(PLANE, np.random.default_rng(1))
    for step in range(700):
        one.locate(step)
    other = BoundarySet(edges, PLANE, lower, upper, DT)
    other.locate(699)
    copy = motion.copy()
    assert one.accelerate(momentum, motion) == other.accelerate(momentum, copy)
    np.testing.assert_array_equal(motion, copy)


# ---- with the solver -----------------------------------------------------------------------------------


@pytest.mark.parametrize("interpolation", get_args(Interpolation))
def test_uniform_stretch_is_exact_up_to_driven_faces(interpolation: str) -> None:
    """One step between faces driven apart, in the body's first and last points too."""
    law = IsotropicElastic(1e9, 0.3, 1000.0, "plane_strain")
    dt = 0.4 / law.pressure_wave_speed
    rate = 1e-6 / dt
    body = fill_rectangle((0.0, 0.0), (10.0, 6.0), 1.0)
    edges = [
        EdgeCondition("left", 0, velocities=Constant(0.0)),
        EdgeCondition("right", 0, velocities=Constant(10.0 * rate)),
        symmetry("bottom"),
        symmetry("top"),
    ]
    solver = MaterialPointSolver(
        Grid((-3.0, -3.0), 1.0, (16, 12)),
        body,
        law,
        1.0,
        dt,
        edges,
        initial_velocity_gradient=[[rate, 0.0], [0.0, 0.0]],
        scheme=Scheme(interpolation=interpolation, transfer="flip"),  # type: ignore[arg-type]
    )
    solver.advance(1)
    expected = np.tile([[1e-6, 0.0], [0.0, 0.0]], (body.count, 1, 1))
    gradient = solver.points.deformation_gradient - np.eye(2)
    np.testing.assert_allclose(gradient, expected, atol=1e-13)


@pytest.mark.parametrize("transfer", get_args(Transfer))
@pytest.mark.parametrize("integration", get_args(Integration))
def test_patch_of_splines_is_exact_with_faces_on_nodes(integration: Integration, transfer: Transfer) -> None:
    """A block stretched between four faces keeps an even strain, with the stress and reactions that belong to it."""
    law = IsotropicElastic(2.0, 0.3, 1.0, "plane_strain")
    exx, eyy, thickness = 1e-12, -4e-13, 0.5  # per second, so small that faces stay on their nodes
    scheme = Scheme("bspline", integration, transfer, 3)
    solver = MaterialPointSolver(
        Grid((-3.0, -3.0), 1.0, (14, 11)),
        fill_rectangle((0.0, 0.0), (8.0, 5.0), 1.0),
        law,
        thickness,
        0.5 * scheme.courant_limit / law.pressure_wave_speed,
        [
            EdgeCondition("left", 0, velocities=Constant(-3.0 * exx)),
            EdgeCondition("right", 0, velocities=Constant(5.0 * exx)),
            EdgeCondition("bottom", 1, velocities=Constant(0.0)),
            EdgeCondition("top", 1, velocities=Constant(5.0 * eyy)),
        ],
        initial_velocity_gradient=[[exx, 0.0], [0.0, eyy]],
        scheme=scheme,
    )
    solver.set_velocity((solver.points.reference_position - [3.0, 0.0]) * [exx, eyy])
    solver.advance(40)
    strain = np.array([exx, eyy]) * solver.time
    gradient = solver.points.displacement_gradient
    np.testing.assert_allclose(gradient, np.tile(np.diag(strain), (gradient.shape[0], 1, 1)), atol=1e-10 * strain[0])
    stress = law.lame * strain.sum() + 2.0 * law.shear_modulus * strain
    np.testing.assert_allclose(solver.points.stress[:, :2], np.tile(stress, (gradient.shape[0], 1)), rtol=1e-10)
    # The last forces were those of the stress before the last step, after it (USF), or half way (USAVG).
    lag = {"usf": 0.0, "usavg": 0.5}.get(integration, 1.0) * solver.time_step / solver.time
    pull = (1.0 - lag) * thickness * stress * [5.0, 8.0]
    np.testing.assert_allclose(solver.edge_reaction, [-pull[0], pull[0], -pull[1], pull[1]], rtol=1e-10)


def test_supports_of_nodes_carry_the_weight() -> None:
    law = IsotropicElastic(1e9, 0.3, 1000.0, "plane_stress")
    supports = [
        NodeCondition((0.0, 0.0), (0.0, 4.0), 1, (0.0,), (0.0,)),
        NodeCondition((20.0, 0.0), (20.0, 4.0), 1, (0.0,), (0.0,)),
    ]
    solver = MaterialPointSolver(
        Grid((-3.0, -3.0), 1.0, (26, 10)),
        fill_rectangle((0.0, 0.0), (20.0, 4.0), 1.0),
        law,
        1.0,
        0.5 / law.pressure_wave_speed,
        supports,
        loads=[BodyForce((0.0, -0.01))],
    )
    assert relax(solver, 1e-4, 5000).converged
    np.testing.assert_allclose(solver.edge_reaction, 0.5 * 80.0 * 1000.0 * 0.01, rtol=1e-3)
    middle = np.abs(solver.points.reference_position[:, 0] - 10.0) < 0.5
    # Bernoulli's deflection 5 q L^4 / (384 E I) and Timoshenko's shear q L^2 / (8 k G A), k = 5/6.
    q, inertia, shear = 40.0, 4.0**3 / 12.0, 1e9 / 2.6
    bend = 5.0 * q * 20.0**4 / (384.0 * 1e9 * inertia) + q * 20.0**2 / (8.0 * 5.0 / 6.0 * shear * 4.0)
    assert solver.points.displacement[middle, 1].mean() == pytest.approx(-bend, rel=0.03)


# ---- bad input -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: EdgeCondition("north", 0, (0.0,), (0.0,)), "edge = 'north': allowed are left"),  # type: ignore[arg-type]
        (lambda: EdgeCondition("left", 3, (0.0,), (0.0,)), "component = 3"),
        (lambda: EdgeCondition("left", 0), "give one of the two"),
        (lambda: EdgeCondition("left", 0, (0.0,), (0.0,), (0.0,)), "give one of the two"),
        (lambda: EdgeCondition("left", 0, displacements=(0.0,)), "EdgeCondition.times: needed"),
        (lambda: EdgeCondition("left", 0, (0.0,), Constant(1.0)), "EdgeCondition.times: not allowed"),
        (lambda: EdgeCondition("left", 0, (0.0, 0.0), (0.0, 1.0)), "EdgeCondition.times: must increase strictly"),
        (lambda: EdgeCondition("left", 0, (0.0, 1.0), (0.0,)), r"shapes \(2,\) and \(1,\)"),
        (lambda: EdgeCondition("left", 0, velocities=np.sin), r"method integral\(time\)"),
        (lambda: symmetry("up"), "edge = 'up'"),  # type: ignore[arg-type]
        (lambda: NodeCondition((0.0, 1.0), (1.0, 0.0), 0, (0.0,), (0.0,)), "lower <= upper"),
        (lambda: NodeCondition((0.0, 0.0), (1.0, 1.0), 5, (0.0,), (0.0,)), "component = 5"),
        (lambda: Sine(1.0, 0.0), "angular_frequency = 0"),
        (lambda: Ramp(0.0), "duration = 0.0 s"),
        (lambda: Constant(np.inf), "Constant.value = inf"),
        (lambda: Table((0.0, 1.0), (0.0, np.nan)), "must be finite"),
    ],
)
def test_bad_conditions_are_named(call: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()


@pytest.mark.parametrize(
    ("conditions", "message"),
    [
        ([symmetry("front")], r"edge_conditions\[0\].edge = 'front': allowed in the plane"),
        ([EdgeCondition("left", 2, (0.0,), (0.0,))], "component = 2: below 2 is needed"),
        ([symmetry("left"), symmetry("left")], r"already prescribed by edge_conditions\[0\]"),
        ([NodeCondition((0.1, 0.1), (0.2, 0.2), 0, (0.0,), (0.0,))], "no grid node lies between"),
        ([NodeCondition((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 0, (0.0,), (0.0,))], "2 coordinates are needed"),
        (
            [
                NodeCondition((0.0, 0.0), (1.0, 1.0), 0, (0.0,), (0.0,)),
                NodeCondition((1.0, 1.0), (2.0, 2.0), 0, (0.0,), (0.0,)),
            ],
            r"edge_conditions\[1\]: component 0 of 1 of its nodes is already prescribed by edge_conditions\[0\]",
        ),
    ],
)
def test_conditions_that_do_not_fit_are_named(conditions: list, message: str) -> None:
    lower, upper = BODY[2]
    with pytest.raises(ValueError, match=message):
        BoundarySet(conditions, PLANE, lower, upper, DT)


def test_faces_must_stay_clear_of_refined_rectangles() -> None:
    lower, upper = BODY[2]
    fine = [((1.0, 1.0), (1.5, 1.5))]
    held = symmetry("left")
    pushed = EdgeCondition("right", 0, (0.0, 1000 * DT), (0.0, -0.4))
    clear = BoundarySet([EdgeCondition("right", 0, (0.0,), (0.01,))], PLANE, lower, (3.2, 3.0), DT, refined=fine)
    clear.locate(5000)
    with pytest.raises(ValueError, match=r"edge_conditions\[0\]: face 'left' comes within 1.5 m of the refined"):
        BoundarySet([held], PLANE, lower, upper, DT, refined=fine)
    with pytest.raises(ValueError, match="overlaps the refined rectangle"):
        BoundarySet([NodeCondition((1.0, 1.0), (2.0, 2.0), 0, (0.0,), (0.0,))], PLANE, lower, upper, DT, refined=fine)
    moving = BoundarySet([pushed], PLANE, lower, (3.25, 3.0), DT, refined=fine)
    with pytest.raises(ValueError, match="face 'right' comes within"):
        moving.locate(600)
