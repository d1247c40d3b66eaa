"""Compile the kernels of usual runs, so that the first one does not wait: ``python -m mpm_service.compile_kernels``.

numba keeps what it compiled beside the sources; a later process loads it from there. Compiled is what runs in the
plane with the default scheme need: all loads, conditions, materials, cracks and nested grids. Other shape functions
and bodies in space are compiled by the first run that has them.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Literal

import numpy as np

from mpm_service import (
    AbsorbingEdge,
    Body,
    BodyForce,
    Constant,
    Crack,
    Damping,
    EdgeCondition,
    Grid,
    HierarchicalGrid,
    IsotropicElastic,
    J2Plasticity,
    MaterialPointSolver,
    NeoHookean,
    NodeCondition,
    OrthotropicElastic,
    Traction,
    fill_hierarchy,
    fill_rectangle,
    relax,
)

GRID = Grid((-3.0, -3.0), 1.0, (14, 14))
LOWER, UPPER = (0.0, 0.0), (8.0, 8.0)
TIME_STEP = 0.1
SMALL = 1e-6
"""Size of loads and motions: nothing moves far."""
ELASTIC = IsotropicElastic(1.0, 0.3, 1.0, "plane_stress")
EDGES = (
    EdgeCondition("top", 1, (0.0, 1.0), (0.0, SMALL)),
    EdgeCondition("bottom", 1, (0.0, 1.0), (0.0, 0.0)),
    NodeCondition((2.0, 0.0), (3.0, 0.0), 0, velocities=Constant(0.0)),
)
CRACKS = (Crack(((-1.0, 4.5), (4.0, 4.5))), Crack(((6.0, 2.5), (9.0, 2.5)), contact="coulomb", friction=0.1))


def couple_and_advance(solver: MaterialPointSolver) -> None:
    """Register an anchor and an interface cell, make a few steps under forces, save and restore."""
    solver.register_anchors([(6.0, 6.2)], [0])
    solver.register_interface_cells([(5.0, 5.0)], [(7.0, 7.0)])
    solver.advance(2, ivc_force=[(0.0, SMALL)], anchor_force=[(0.0, SMALL)])
    solver.restore(solver.state())
    solver.energies()
    relax(solver, max_steps=2)


def run_materials(assumption: Literal["plane_stress", "plane_strain"]) -> None:
    """Run a square of all materials."""
    materials = (
        IsotropicElastic(1.0, 0.3, 1.0, assumption),
        OrthotropicElastic(1.0, 0.5, 0.5, 0.3, 0.3, 0.3, 0.3, 0.3, 0.3, 1.0, 0.0, assumption),
        NeoHookean(1.0, 0.3, 1.0, assumption),
        J2Plasticity(1.0, 0.3, 1.0, 1e-9, 0.1, assumption=assumption),
    )
    body = fill_rectangle(LOWER, UPPER, 1.0)
    body = replace(body, material=np.arange(body.count) % len(materials))
    motion = np.outer(np.ones(body.count), (0.0, SMALL)) * body.position
    solver = MaterialPointSolver(GRID, body, materials, 1.0, TIME_STEP, initial_velocity=motion)
    solver.advance(2)
    solver.energies()


def run_loads() -> None:
    """Run a square under every kind of load."""
    loads = (
        Traction("right", (SMALL, 0.0), region=((8.0, 0.0), (8.0, 4.0))),
        Traction("top", (0.0, SMALL), follower=True),
        BodyForce((0.0, -SMALL)),
        AbsorbingEdge.of("left", ELASTIC),
    )
    solver = MaterialPointSolver(
        GRID, fill_rectangle(LOWER, UPPER, 1.0), ELASTIC, 1.0, TIME_STEP, EDGES[1:2], loads=loads,
        damping=Damping(grid_rate=0.1, point_rate=0.1, force_scaling=0.1),
    )  # fmt: skip
    couple_and_advance(solver)


def run_grids() -> None:
    """Run a cracked square on a uniform and on a nested grid."""
    nested = HierarchicalGrid(GRID, [((3.0, 3.0), (5.0, 5.0))])
    grids: list[tuple[Grid | HierarchicalGrid, Body]] = [
        (GRID, fill_rectangle(LOWER, UPPER, 1.0)),
        (nested, fill_hierarchy(nested, LOWER, UPPER)),
    ]
    for grid, body in grids:
        couple_and_advance(MaterialPointSolver(grid, body, ELASTIC, 1.0, TIME_STEP, EDGES, cracks=CRACKS, damping=0.1))


def compile_kernels() -> float:
    """Run small bodies that need every kernel; return the seconds it took."""
    began = time.perf_counter()
    run_loads()
    run_grids()
    run_materials("plane_stress")
    run_materials("plane_strain")
    return time.perf_counter() - began


if __name__ == "__main__":
    print(f"kernels compiled or loaded in {compile_kernels():.1f} s")
