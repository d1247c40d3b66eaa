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
    rng.shuffle(edges)
    return edges


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
    time_step = rng.uniform(0.1, 0.5) / max(m.pressure_wave_speed for m in materials)
    options = {
        "scheme": _random_scheme(rng, dimension),
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
    for name in ("kinetic", "strain", "edge_work", "interface_work", "damping_loss", "dissipated"):
        assert getattr(found, name) == pytest.approx(getattr(reference, name), abs=TOLERANCE * scale), name
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
