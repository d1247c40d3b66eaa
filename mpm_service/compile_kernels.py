"""Compile every kernel once, so that the first run does not wait: ``python -m mpm_service.compile_kernels``.

numba keeps what it compiled beside the sources; a later process loads it from there.
"""

from __future__ import annotations

import time

import numpy as np

from mpm_service import Crack, EdgeCondition, Grid, IsotropicElastic, MaterialPointSolver, fill_rectangle


def compile_kernels() -> float:
    """Run a small cracked plate with edges, anchors and volume cells; return the seconds it took."""
    began = time.perf_counter()
    body = fill_rectangle((0.0, 0.0), (8.0, 8.0), 1.0)
    material = IsotropicElastic(1.0, 0.3, 1.0, "plane_stress")
    edges = [EdgeCondition("top", 1, (0.0, 1.0), (0.0, 1e-6)), EdgeCondition("bottom", 1, (0.0, 1.0), (0.0, 0.0))]
    for crack in (None, Crack(((-1.0, 4.5), (4.0, 4.5)))):
        solver = MaterialPointSolver(
            Grid((-3.0, -3.0), 1.0, (14, 14)), body, material, 1.0, 0.1, edge_conditions=edges, cracks=[] if crack is None else [crack],
            damping=0.1,
        )  # fmt: skip
        solver.register_anchors(np.array([[6.0, 6.2]]), np.array([0]))
        solver.register_interface_cells(np.array([[5.0, 5.0]]), np.array([[7.0, 7.0]]))
        solver.advance(2, ivc_force=np.array([[0.0, 1e-6]]))
        solver.advance(2, anchor_force=np.array([[0.0, 1e-6]]))
        solver.restore(solver.state())
        solver.energies()
    return time.perf_counter() - began


if __name__ == "__main__":
    print(f"kernels compiled or loaded in {compile_kernels():.1f} s")
