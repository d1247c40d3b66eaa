"""Massless anchors: they read the grid's motion and hand forces back by the same weights."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from .crack import CrackFields, field_row
from .grid import Mesh

# A node with less than this share of the heaviest node of the anchor's cell moves by its own noise: a sliver
# of a point's domain reaches it. It is left out and the other weights are scaled up.
_LEAST_MASS_SHARE = 1e-3


@njit(cache=True, nogil=True)
def weigh_anchors(
    position: NDArray[np.float64],
    displacement: NDArray[np.float64],
    local: NDArray[np.float64],
    mesh: Mesh,
    crack: CrackFields,
    momentum: NDArray[np.float64],
    node: NDArray[np.int64],
    weight: NDArray[np.float64],
) -> None:
    """Linear shape functions (Eq 32) of all anchors over the nodes that carry material on their side."""
    near = crack.near
    node_local = crack.node_local
    base = crack.base
    length = crack.length
    tolerance = crack.tolerance
    for a in range(position.shape[0]):
        xi = (position[a, 0] + displacement[a, 0] - mesh.origin_x) * mesh.inverse_cell
        eta = (position[a, 1] + displacement[a, 1] - mesh.origin_y) * mesh.inverse_cell
        for k in range(4):
            node[a, k] = 0
            weight[a, k] = 0.0
        if not (0.0 <= xi < mesh.cells_x and 0.0 <= eta < mesh.cells_y):
            continue
        ix = int(xi)
        jy = int(eta)
        fx = xi - ix
        fy = eta - jy
        heaviest = 0.0
        for k in range(4):
            n = (jy + k // 2) * mesh.stride + ix + k % 2
            if crack.on:
                n = field_row(near, node_local, base, length, tolerance, n, local[a, 0], local[a, 1])
            node[a, k] = n
            weight[a, k] = (fx if k % 2 else 1.0 - fx) * (fy if k // 2 else 1.0 - fy)
            heaviest = max(heaviest, momentum[n, 0])
        total = 0.0
        for k in range(4):
            if not momentum[node[a, k], 0] > _LEAST_MASS_SHARE * heaviest:
                weight[a, k] = 0.0
            total += weight[a, k]
        if total > 0.0:
            for k in range(4):
                weight[a, k] /= total


@njit(cache=True, nogil=True)
def scatter_anchor_forces(
    node: NDArray[np.int64],
    weight: NDArray[np.float64],
    force: NDArray[np.float64],
    momentum: NDArray[np.float64],
) -> None:
    """Put anchor forces [N] onto the nodes the anchors read."""
    for a in range(node.shape[0]):
        for k in range(4):
            momentum[node[a, k], 3] += weight[a, k] * force[a, 0]
            momentum[node[a, k], 4] += weight[a, k] * force[a, 1]


@njit(cache=True, nogil=True)
def move_anchors(
    node: NDArray[np.int64],
    weight: NDArray[np.float64],
    force: NDArray[np.float64],
    motion: NDArray[np.float64],
    time_step: float,
    displacement: NDArray[np.float64],
    velocity: NDArray[np.float64],
) -> float:
    """Advance anchor displacements [m] with the nodal velocities [m/s]; returns the forces' work [J]."""
    work = 0.0
    for a in range(node.shape[0]):
        for axis in range(2):
            v = 0.0
            for k in range(4):
                v += weight[a, k] * motion[node[a, k], axis]
            velocity[a, axis] = v
            displacement[a, axis] += time_step * v
            work += time_step * force[a, axis] * v
    return work
