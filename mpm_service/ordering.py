"""Order of points in memory, and the list of nodes they can reach."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from .grid import Mesh
from .material_points import X, Y


@njit(cache=True, nogil=True)
def sort_points(
    rows: NDArray[np.float64],
    ids: NDArray[np.int64],
    row_of: NDArray[np.int64],
    count: int,
    mesh: Mesh,
) -> None:
    """Sort the first ``count`` rows by their nearest node (stable counting sort)."""
    nodes = (mesh.cells_x + 1) * (mesh.cells_y + 1)
    start = np.zeros(nodes + 1, dtype=np.int64)
    key = np.empty(count, dtype=np.int64)
    for p in range(count):
        cx = int((rows[p, X] - mesh.origin_x) * mesh.inverse_cell + 0.5)
        cy = int((rows[p, Y] - mesh.origin_y) * mesh.inverse_cell + 0.5)
        key[p] = cy * mesh.stride + cx
        start[key[p] + 1] += 1
    for n in range(nodes):
        start[n + 1] += start[n]
    old_rows = rows[:count].copy()
    old_ids = ids[:count].copy()
    for p in range(count):
        to = start[key[p]]
        start[key[p]] += 1
        rows[to] = old_rows[p]
        ids[to] = old_ids[p]
        row_of[old_ids[p]] = to


@njit(cache=True, nogil=True)
def reachable_nodes(rows: NDArray[np.float64], count: int, mesh: Mesh) -> NDArray[np.int64]:
    """Grid nodes that any point can touch while it moves by less than a cell, in memory order."""
    nodes = (mesh.cells_x + 1) * (mesh.cells_y + 1)
    centre = np.zeros(nodes, dtype=np.uint8)
    mark = np.zeros(nodes, dtype=np.uint8)
    for p in range(count):
        cx = int((rows[p, X] - mesh.origin_x) * mesh.inverse_cell + 0.5)
        cy = int((rows[p, Y] - mesh.origin_y) * mesh.inverse_cell + 0.5)
        centre[cy * mesh.stride + cx] = 1
    for n in range(nodes):
        if centre[n]:
            cx = n % mesh.stride
            cy = n // mesh.stride
            for j in range(max(cy - 2, 0), min(cy + 2, mesh.cells_y) + 1):
                for i in range(max(cx - 2, 0), min(cx + 2, mesh.cells_x) + 1):
                    mark[j * mesh.stride + i] = 1
    return np.nonzero(mark)[0].astype(np.int64)


@njit(cache=True, nogil=True)
def drop_lost(
    rows: NDArray[np.float64],
    ids: NDArray[np.int64],
    row_of: NDArray[np.int64],
    count: int,
    mesh: Mesh,
) -> int:
    """Move points outside the grid behind the living ones; returns the number still alive."""
    kept = 0
    gone = 0
    lost_rows = np.empty((count, rows.shape[1]))
    lost_ids = np.empty(count, dtype=np.int64)
    for p in range(count):
        xi = (rows[p, X] - mesh.origin_x) * mesh.inverse_cell
        eta = (rows[p, Y] - mesh.origin_y) * mesh.inverse_cell
        if 0.5 <= xi < mesh.cells_x - 0.5 and 0.5 <= eta < mesh.cells_y - 0.5:
            rows[kept] = rows[p]
            ids[kept] = ids[p]
            row_of[ids[kept]] = kept
            kept += 1
        else:
            lost_rows[gone] = rows[p]
            lost_ids[gone] = ids[p]
            gone += 1
    for k in range(gone):
        rows[kept + k] = lost_rows[k]
        ids[kept + k] = lost_ids[k]
        row_of[lost_ids[k]] = kept + k
    return kept
