"""The plain-numpy solver against closed forms, and the compiled solver against it on random problems."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, get_args

import numpy as np
import pytest

from mpm_service.conditions import EdgeCondition
from mpm_service.crack_line import Crack
from mpm_service.damping import Damping
from mpm_service.errors import SolverError
from mpm_service.grid import Grid
from mpm_service.material import Material
from mpm_service.material_points import Body, fill_rectangle, fill_region
from mpm_service.materials import IsotropicElastic, J2Plasticity, NeoHookean, OrthotropicElastic
from mpm_service.reference import ReferenceSolver
from mpm_service.scheme import Integration, Interpolation, Scheme, Transfer
from mpm_service.solver import MaterialPointSolver

# What the two solvers may differ by, relative to the largest value of a field.
TOLERANCE = 1e-12
STEPS = 6
Generator = np.random.Generator


@dataclass
class Problem:
    """Arguments of a solver, and the forces of a run."""

    grid: Grid
    body: Body
    material: Sequence[Material]
    time_step: float
    options: dict[str, Any]
    anchors: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    cells: tuple[np.ndarray, np.ndarray] | None = None
    forces: dict[str, np.ndarray] = field(default_factory=dict)

    def solver(self, kind: type[Any]) -> Any:
        made = kind(self.grid, self.body, self.material, 1.0, self.time_step, **self.options)
        if self.anchors.size:
            made.register_anchors(self.anchors, np.zeros(len(self.anchors), dtype=np.int64))
        if self.cells is not None:
            made.register_interface_cells(*self.cells)
        return made


def _random_material(rng: Generator, assumption: str) -> Material:
    density = rng.uniform(0.5, 2.0)
    kind = rng.integers(4)
    if kind == 0:
        return IsotropicElastic(1.0, rng.uniform(0.0, 0.45), density, assumption)
    if kind == 1:
        return NeoHookean(1.0, rng.uniform(0.0, 0.4), density, assumption)
    if kind == 2:
        return J2Plasticity(1.0, 0.3, density, yield_stress=0.01, hardening=0.1, assumption=assumption)
    return OrthotropicElastic(
        1.0, 0.5, 0.7, 0.2, 0.1, 0.15, 0.3, 0.35, 0.25, density, rng.uniform(0.0, 1.5), assumption
    )


def _random_scheme(rng: Generator, dimension: int) -> Scheme:
    shapes = get_args(Interpolation) if dimension == 2 else ("linear", "ugimp")
    return Scheme(
        rng.choice(shapes),
        rng.choice(get_args(Integration)),
        rng.choice(get_args(Transfer)),
        int(rng.integers(1, 5)),
        int(rng.integers(1, 4)),
    )


def _random_body(rng: Generator, size: tuple[int, ...]) -> Body:
    per_cell = int(rng.integers(1, 4)) if len(size) == 2 else int(rng.integers(1, 3))
    lower, upper = (0.0,) * len(size), tuple(float(n) for n in size)
    if rng.random() < 0.3:
        centre = np.array(upper) / 2.0
        return fill_region(
            lower, upper, 1.0, lambda x: np.linalg.norm((x - centre) / centre, axis=1) < 1.0, max(per_cell, 2)
        )
    body = fill_rectangle(lower, upper, 1.0, per_cell)
    if rng.random() < 0.3:
        body = replace(body, weight=rng.uniform(0.1, 1.0, body.count))
    return body


def _random_edges(rng: Generator, dimension: int, time_step: float) -> list[EdgeCondition]:
    faces = ("left", "right", "bottom", "top", "back", "front")[: 2 * dimension]
    edges = []
    for face in faces:
        for component in range(dimension):
            if rng.random() < 0.25:
                times = time_step * np.cumsum(rng.uniform(0.5, 3.0, 4))
                edges.append(EdgeCondition(face, component, times, np.cumsum(rng.normal(0.0, 0.02, 4))))
    return [edges[k] for k in rng.permutation(len(edges))]


def _random_problem(seed: int, dimension: int = 2, cracks: Sequence[Crack] = (), **fixed: Any) -> Problem:
    """A body at a random place between the nodes, everything else random too."""
    rng = np.random.default_rng(seed)
    assumption = "three_dimensional" if dimension == 3 else str(rng.choice(["plane_stress", "plane_strain"]))
    size = (4, 3, 3) if dimension == 3 else (10, 8)
    body = _random_body(rng, size) if not cracks else fill_rectangle((0.0, 0.0), (10.0, 8.0), 1.0, 2)
    shift = rng.uniform(0.0, 1.0, dimension) if rng.random() < 0.7 else np.zeros(dimension)
    grid = Grid(tuple(-3.0 - shift), 1.0, tuple(n + 7 for n in size))
    materials = [_random_material(rng, assumption) for _ in range(int(rng.integers(1, 3)))]
    middle = rng.uniform(0.2, 0.8) * size[0]
    body = body.with_material(lambda x: x[:, 0] > middle, len(materials) - 1)
    scheme = fixed.get("scheme") or _random_scheme(rng, dimension)
    fastest = max(m.pressure_wave_speed for m in materials)
    time_step = rng.uniform(0.3, 1.0) * scheme.courant_limit / fastest
    options = {
        "scheme": scheme,
        "edge_conditions": _random_edges(rng, dimension, time_step),
        "cracks": cracks,
        "damping": Damping(rng.choice([0.0, 0.1]), rng.choice([0.0, 0.05]), rng.choice([0.0, 0.25])),
        "initial_velocity_gradient": rng.normal(0.0, 0.02, (dimension, dimension)) if rng.random() < 0.7 else None,
        "initial_velocity": rng.normal(0.0, 0.01, body.position.shape) if rng.random() < 0.5 else None,
    } | fixed
    problem = Problem(grid, body, materials, time_step, options)
    if rng.random() < 0.6:
        problem.anchors = body.position[rng.choice(body.count, 5)] + rng.uniform(-0.2, 0.2, (5, dimension))
        low = np.multiply.outer([0.3, 0.5], np.array(size, dtype=np.float64))
        problem.cells = low, low + 1.5
        problem.forces = {
            "anchor_force": rng.normal(0.0, 0.01, (5, dimension)),
            "ivc_force": rng.normal(0.0, 0.01, (2, dimension)),
        }
    return problem


def _assert_alike(fast: Any, slow: Any) -> None:
    for name in ("position", "velocity", "displacement_gradient", "kirchhoff_stress"):
        found, reference = getattr(fast.points, name), getattr(slow.points, name)
        np.testing.assert_allclose(found, reference, rtol=0.0, atol=TOLERANCE * np.abs(reference).max(), err_msg=name)
    for name in ("edge_reaction", "anchor_displacement", "anchor_velocity"):
        found, reference = getattr(fast, name), getattr(slow, name)
        largest = np.abs(reference).max(initial=0.0)
        np.testing.assert_allclose(found, reference, rtol=0.0, atol=TOLERANCE * largest, err_msg=name)
    found, reference = fast.energies(), slow.energies()
    scale = reference.kinetic + reference.strain + reference.dissipated
    names = ["kinetic", "edge_work", "interface_work", "damping_loss", "dissipated"]
    if fast.cracks is None and not fast.points_lost:  # else the fast one may estimate the last half step of both
        names += ["strain", "filter_loss"]
    for name in names:
        assert getattr(found, name) == pytest.approx(getattr(reference, name), abs=TOLERANCE * scale), name
    strain, other = (np.sum(solver.points.strain_energy[solver.points.alive]) for solver in (fast, slow))
    assert strain == pytest.approx(other, abs=TOLERANCE * scale)
    assert fast.points_lost == slow.points_lost


def _compare(problem: Problem, steps: int = STEPS) -> tuple[Any, Any]:
    fast, slow = problem.solver(MaterialPointSolver), problem.solver(ReferenceSolver)
    fast.advance(steps, **problem.forces)
    slow.advance(steps, **problem.forces)
    assert np.abs(slow.points.displacement).max() > 0.0
    _assert_alike(fast, slow)
    return fast, slow


@pytest.mark.parametrize("seed", range(40))
def test_random_plane_problem(seed: int) -> None:
    _compare(_random_problem(seed))


@pytest.mark.parametrize("seed", range(10))
def test_random_problem_in_space(seed: int) -> None:
    _compare(_random_problem(1000 + seed, 3))


@pytest.mark.parametrize("seed", range(16))
def test_random_problem_with_cracks(seed: int) -> None:
    """One crack to a tip, one through the body, both at random places and slopes; faces part, slide, close."""
    rng = np.random.default_rng(seed)
    y = rng.uniform(2.0, 6.0)
    cracks = [Crack([(-1.0, y), (rng.uniform(3.0, 6.0), y + rng.normal(0.0, 0.3))])]
    if seed % 4 == 0:
        cracks = [Crack([(-1.0, y), (11.0, y + rng.normal(0.0, 0.3))])]
    options = {"initial_velocity_gradient": rng.normal(0.0, 0.015, (2, 2))}
    if seed % 2:
        options["scheme"] = Scheme()
    fast, _ = _compare(_random_problem(2000 + seed, cracks=cracks, **options), 8)
    opening = fast.cracks.opening(0)[1]
    assert np.abs(opening).max() > 1e-3  # the faces have moved against each other


def test_two_cracks() -> None:
    body = fill_rectangle((0.0, 0.0), (8.0, 16.0), 1.0, 2)
    cracks = [Crack([(-1.0, 3.2), (4.3, 3.4)]), Crack([(3.1, 12.6), (9.0, 12.3)])]
    material = IsotropicElastic(1.0, 0.3, 1.0)
    options = {"cracks": cracks, "initial_velocity_gradient": [[0.01, 0.02], [-0.03, 0.05]]}
    problem = Problem(Grid((-3.3, -3.4), 1.0, (15, 23)), body, [material], 0.3, options)
    problem.anchors = np.array([[2.0, 3.3], [2.0, 3.2], [6.0, 12.4]])
    problem.forces = {"anchor_force": np.array([[0.0, 0.02], [0.0, -0.02], [0.01, 0.0]])}
    _compare(problem, 10)


@pytest.mark.parametrize("interpolation", get_args(Interpolation))
def test_points_that_leave_the_grid_are_lost_alike(interpolation: Interpolation) -> None:
    body = fill_rectangle((0.0, 0.0), (4.0, 3.0), 1.0, 2)
    velocity = np.full(body.position.shape, 0.4) + 0.02 * np.sin(body.position)
    options = {"scheme": Scheme(interpolation), "initial_velocity": velocity}
    problem = Problem(Grid((-3.0, -3.0), 1.0, (9, 8)), body, [NeoHookean(1.0, 0.3, 1.0)], 0.3, options)
    problem.cells = np.array([[0.0, 0.0]]), np.array([[4.0, 3.0]])
    problem.forces = {"ivc_force": np.array([[0.05, 0.0]])}
    fast, slow = problem.solver(MaterialPointSolver), problem.solver(ReferenceSolver)
    lost = []
    for _ in range(5):
        fast.advance(6, **problem.forces)
        slow.advance(6, **problem.forces)
        lost.append(slow.points_lost)
        np.testing.assert_array_equal(fast.points.alive, slow.points.alive)
        _assert_alike(fast, slow)
    assert 0 < lost[-1] < body.count


@pytest.mark.parametrize("interpolation", ["ugimp", "cpgimp"])
def test_long_run_with_crossings_stays_close(interpolation: Interpolation) -> None:
    """A disk that turns by half a turn: round-off may grow with steps, but not more than a hundredfold."""
    body = fill_region((0.0, 0.0), (8.0, 8.0), 1.0, lambda x: np.linalg.norm(x - 4.0, axis=1) < 3.7, 2)
    spin = 0.1 * np.stack([4.0 - body.position[:, 1], body.position[:, 0] - 4.0], axis=1)
    options = {"scheme": Scheme(interpolation), "initial_velocity": spin}
    problem = Problem(Grid((-2.0, -2.0), 1.0, (12, 12)), body, [NeoHookean(1.0, 0.3, 1.0)], 0.3, options)
    fast, slow = problem.solver(MaterialPointSolver), problem.solver(ReferenceSolver)
    fast.advance(100)
    slow.advance(100)
    assert np.abs(slow.points.displacement).max() > 6.0
    for name in ("position", "velocity", "displacement_gradient"):
        found, reference = getattr(fast.points, name), getattr(slow.points, name)
        assert np.abs(found - reference).max() < 100.0 * TOLERANCE * np.abs(reference).max(), name


# ---- every scheme on one problem ----------------------------------------------------------------------


@pytest.mark.parametrize("transfer", get_args(Transfer))
@pytest.mark.parametrize("integration", get_args(Integration))
@pytest.mark.parametrize("interpolation", get_args(Interpolation))
def test_every_scheme_with_a_crack(interpolation: Interpolation, integration: Integration, transfer: Transfer) -> None:
    body = fill_rectangle((0.0, 0.0), (10.0, 8.0), 1.0, 2)
    scheme = Scheme(interpolation, integration, transfer, 3)
    material = IsotropicElastic(1.0, 0.3, 1.0, "plane_stress")
    options = {
        "scheme": scheme,
        "initial_velocity_gradient": [[0.03, 0.01], [-0.02, -0.02]],
        "edge_conditions": [
            EdgeCondition("left", 0, [0.0, 1.0], [0.0, 0.1]),
            EdgeCondition("bottom", 0, [0.0, 3.0], [0.0, -0.1]),
            EdgeCondition("bottom", 1, [0.0, 1.0], [0.0, 0.0]),
        ],
        "cracks": [Crack([(-1.0, 4.03), (5.2, 4.1)])],
    }
    time_step = 0.7 * scheme.courant_limit / material.pressure_wave_speed
    _compare(Problem(Grid((-3.31, -3.17), 1.0, (17, 15)), body, [material], time_step, options))


# ---- the reference alone, against closed forms --------------------------------------------------------


@pytest.mark.parametrize("integration", get_args(Integration))
@pytest.mark.parametrize("interpolation", get_args(Interpolation))
def test_bar_pulled_evenly_stays_even(interpolation: Interpolation, integration: Integration) -> None:
    """Points that start with v = rate X keep it, so strain is rate t and the ends pull with E rate t A."""
    rate, young, height, thickness = 1e-12, 2.0, 3.0, 0.5
    edges = [
        EdgeCondition("left", 0, [0.0], [0.0]),
        EdgeCondition("right", 0, [0.0, 1e3], [0.0, 8.0 * rate * 1e3]),
    ]
    solver = ReferenceSolver(
        Grid((-3.0, -3.0), 1.0, (15, 9)),
        fill_rectangle((0.0, 0.0), (8.0, height), 1.0, 2),
        IsotropicElastic(young, 0.0, 1.0, "plane_stress"),
        thickness,
        0.1,
        edges,
        initial_velocity_gradient=[[rate, 0.0], [0.0, 0.0]],
        scheme=Scheme(interpolation, integration, "flip"),
    )
    solver.advance(40)
    strain = rate * solver.time
    np.testing.assert_allclose(solver.points.displacement_gradient[:, 0, 0], strain, rtol=1e-10)
    assert np.abs(solver.points.displacement_gradient[:, [0, 1, 1], [1, 0, 1]]).max() < 1e-10 * strain
    np.testing.assert_allclose(solver.points.stress[:, 0], young * strain, rtol=1e-10)
    # The last forces were those of the stress before the last step, after it (USF), or half way (USAVG).
    lag = {"usf": 0.0, "usavg": 0.5}.get(integration, 1.0) * rate * solver.time_step
    pull = young * (strain - lag) * height * thickness
    np.testing.assert_allclose(solver.edge_reaction, [-pull, pull], rtol=1e-10)


def test_pushed_end_sends_a_wave_at_the_speed_of_sound() -> None:
    young, density, speed, length, height = 4.0, 1.0, 1e-3, 60.0, 2.0
    celerity = np.sqrt(young / density)
    solver = ReferenceSolver(
        Grid((-3.0, -3.0), 1.0, (67, 8)),
        fill_rectangle((0.0, 0.0), (length, height), 1.0, 2),
        IsotropicElastic(young, 0.0, density, "plane_stress"),
        1.0,
        0.4 / celerity,
        [EdgeCondition("left", 0, [0.0, 1e3], [0.0, 1e3 * speed])],
    )
    solver.advance(110)
    way = celerity * solver.time
    stress = -solver.points.stress[:, 0].reshape(4, -1).mean(axis=0) / (density * celerity * speed)
    place = solver.points.reference_position[:120, 0]
    front = np.interp(-0.5, -stress, place)
    assert front == pytest.approx(way, abs=1.0)  # half the height within a cell
    assert np.abs(stress[(place > 5.0) & (place < way - 8.0)] - 1.0).max() < 0.01
    assert solver.edge_reaction[0] == pytest.approx(density * celerity * speed * height, rel=0.01)


def test_fixed_bar_swings_with_its_period() -> None:
    """Mode 1 of a bar held at one end: period 4 l / c."""
    length, celerity = 12.0, 2.0
    body = fill_rectangle((0.0, 0.0), (length, 1.0), 1.0, 2)
    mode = np.sin(0.5 * np.pi * body.position[:, 0] / length)
    solver = ReferenceSolver(
        Grid((-3.0, -3.0), 1.0, (18, 7)),
        body,
        IsotropicElastic(celerity**2, 0.0, 1.0, "plane_stress"),
        1.0,
        0.4 / celerity,
        [EdgeCondition("left", 0, [0.0], [0.0])],
        initial_velocity=1e-4 * np.stack([mode, np.zeros_like(mode)], axis=1),
    )
    period = 4.0 * length / celerity
    steps = round(1.1 * period / solver.time_step)
    swing = [0.0]
    for _ in range(steps):
        solver.advance(1)
        swing.append(float(mode @ solver.points.displacement[:, 0]))
    falls = np.flatnonzero(np.diff(np.sign(swing)) != 0)
    crossings = [k + swing[k] / (swing[k] - swing[k + 1]) for k in falls[1:]]
    found = 2.0 * (crossings[1] - crossings[0]) * solver.time_step
    assert found == pytest.approx(period, rel=0.003)
    energies = solver.energies()
    assert energies.kinetic + energies.strain == pytest.approx(0.25e-8 * length, rel=0.05)


def test_forces_change_the_momentum_of_a_free_body_by_their_impulse() -> None:
    body = fill_rectangle((0.0, 0.0), (6.0, 5.0), 1.0, 2)
    material = NeoHookean(1.0, 0.3, 1.0)
    solver = ReferenceSolver(Grid((-3.2, -3.1), 1.0, (13, 12)), body, material, 1.0, 0.2)
    solver.register_anchors([[2.2, 2.6], [4.1, 0.7]], [0, 0])
    solver.register_interface_cells([[1.0, 1.0]], [[3.0, 3.0]])
    pull, push = np.array([[0.01, -0.02], [0.03, 0.01]]), np.array([[-0.02, 0.05]])
    solver.advance(20, anchor_force=pull, ivc_force=push)
    momentum = solver.points.mass @ solver.points.velocity
    np.testing.assert_allclose(momentum, (pull.sum(axis=0) + push[0]) * solver.time, rtol=1e-12)


# ---- saving, errors -----------------------------------------------------------------------------------


def test_restored_run_goes_on_bit_for_bit() -> None:
    problem = _random_problem(7)
    first, second = problem.solver(ReferenceSolver), problem.solver(ReferenceSolver)
    first.advance(4, **problem.forces)
    second.restore(first.state())
    first.advance(4, **problem.forces)
    second.advance(4, **problem.forces)
    for name, value in first.state().items():
        np.testing.assert_array_equal(second.state()[name], value, err_msg=name)


def test_state_of_another_problem_is_refused() -> None:
    solver, other = _random_problem(7).solver(ReferenceSolver), _random_problem(8).solver(ReferenceSolver)
    with pytest.raises(ValueError, match=r"state\['"):
        solver.restore(other.state())
    state = solver.state()
    del state["rows"]
    with pytest.raises(ValueError, match="field 'rows' is missing"):
        solver.restore(state)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"loads": [object()]}, "loads"),
        ({"threads": 2}, "threads"),
        ({"time_step": 10.0}, "time_step = 10.0"),
        ({"edge_conditions": [EdgeCondition("left", 0, [0.0], [0.0])] * 2}, r"edge_conditions\[1\]"),
        ({"cracks": [Crack([(0.0, 1.0), (2.0, 1.0), (3.0, 2.0)])]}, r"cracks\[0\]"),
        ({"cracks": [Crack([(-1.0, 1.0), (2.0, 1.0)]), Crack([(-1.0, 3.0), (2.0, 3.0)])]}, r"cracks\[1\]"),
    ],
)
def test_what_the_reference_lacks_is_refused(options: dict[str, Any], message: str) -> None:
    body = fill_rectangle((0.0, 0.0), (4.0, 4.0), 1.0, 2)
    arguments: dict[str, Any] = {"time_step": 0.1} | options
    with pytest.raises(ValueError, match=message):
        ReferenceSolver(Grid((-3.0, -3.0), 1.0, (10, 10)), body, IsotropicElastic(1.0, 0.3, 1.0), 1.0, **arguments)


def test_runaway_names_point_step_and_knob() -> None:
    body = fill_rectangle((0.0, 0.0), (4.0, 4.0), 1.0, 2)
    solver = ReferenceSolver(Grid((-3.0, -3.0), 1.0, (10, 10)), body, IsotropicElastic(1.0, 0.3, 1.0), 1.0, 0.1)
    solver.set_velocity(np.full(body.position.shape, 20.0))
    with pytest.raises(SolverError, match=r"step 0.*time_step") as caught:
        solver.advance(3)
    assert caught.value.step == 0
