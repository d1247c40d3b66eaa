"""Order of points in memory: along the grid, regular points first, those near anything special behind them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from .material_points import Columns

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


class Levels(NamedTuple):
    """All levels of a grid, coarsest first."""

    origin: FloatArray
    """(levels, d) [m]"""
    inverse_cell: FloatArray
    """(levels,) [1/m]"""
    cells: IntArray
    """(levels, d)"""
    offset: IntArray
    """(levels + 1,) first row of each level in the nodal tables, and the number of all rows."""


@njit(inline="always")
def _inside(levels: Levels, level: int, rows: FloatArray, p: int, margin: float) -> bool:
    """Is the point inside a level's lattice by a margin [cells]?"""
    for a in range(levels.cells.shape[1]):
        xi = (rows[p, a] - levels.origin[level, a]) * levels.inverse_cell[level]
        if not margin <= xi < levels.cells[level, a] - margin:
            return False
    return True


@njit(inline="always")
def _level_of(levels: Levels, rows: FloatArray, p: int) -> int:
    """Finest level whose lattice holds the point."""
    level = levels.inverse_cell.size - 1
    while level > 0 and not _inside(levels, level, rows, p, 0.0):
        level -= 1
    return level


@njit(inline="always")
def _nearest_row(levels: Levels, level: int, rows: FloatArray, p: int) -> int:
    row = levels.offset[level]
    step = 1
    for a in range(levels.cells.shape[1]):
        xi = (rows[p, a] - levels.origin[level, a]) * levels.inverse_cell[level]
        row += step * int(xi + 0.5)
        step *= levels.cells[level, a] + 1
    return row


@njit(cache=True, nogil=True)
def drop_lost(rows: FloatArray, ids: IntArray, row_of: IntArray, alive: int, levels: Levels) -> int:
    """Move points within a cell of the grid's border or outside behind the living ones; returns how many live."""
    keep = np.empty(alive, dtype=np.int64)
    lost = np.empty(alive, dtype=np.int64)
    kept = 0
    gone = 0
    for p in range(alive):
        if _inside(levels, 0, rows, p, 1.0):
            keep[kept] = p
            kept += 1
        else:
            lost[gone] = p
            gone += 1
    if gone:
        old_rows = rows[:alive].copy()
        old_ids = ids[:alive].copy()
        for k in range(alive):
            p = keep[k] if k < kept else lost[k - kept]
            rows[k] = old_rows[p]
            ids[k] = old_ids[p]
            row_of[ids[k]] = k
    return kept


@njit(cache=True, nogil=True)
def sort_points(
    rows: FloatArray,
    ids: IntArray,
    row_of: IntArray,
    alive: int,
    columns: Columns,
    levels: Levels,
    special: NDArray[np.uint8],
    regular_half: float,
    widest: float,
) -> IntArray:
    """Sort the living rows by their nearest node (stable counting sort).

    Parameters
    ----------
    special : (rows,) ndarray of uint8
        1 where a point with this nearest node is irregular.
    regular_half : float
        Half domain [cells] that a regular point has; not positive: any.
    widest : float
        Half domain [cells], times the largest row norm of F, from which a point is irregular; not positive: none is.

    Returns
    -------
    (rows + 1,) ndarray of int
        First row of the point table for each nearest node, regular points only; the last entry is the number
        of regular points.
    """
    nodes = special.size
    dim = columns.dimension
    key = np.empty(alive, dtype=np.int64)
    start = np.zeros(2 * nodes + 1, dtype=np.int64)
    for p in range(alive):
        level = _level_of(levels, rows, p)
        row = _nearest_row(levels, level, rows, p)
        irregular = special[row] != 0
        half = rows[p, columns.half] * levels.inverse_cell[level]
        if regular_half > 0.0 and abs(half - regular_half) > 1e-6:
            irregular = True
        if widest > 0.0 and not irregular:
            for a in range(dim):
                norm = 0.0
                for b in range(dim):
                    f = rows[p, columns.gradient + a * dim + b] + (1.0 if a == b else 0.0)
                    norm += f * f
                if half * np.sqrt(norm) > widest:
                    irregular = True
        key[p] = row + nodes if irregular else row
        start[key[p] + 1] += 1
    for n in range(2 * nodes):
        start[n + 1] += start[n]
    begin = start[: nodes + 1].copy()
    old_rows = rows[:alive].copy()
    old_ids = ids[:alive].copy()
    for p in range(alive):
        to = start[key[p]]
        start[key[p]] += 1
        rows[to] = old_rows[p]
        ids[to] = old_ids[p]
        row_of[old_ids[p]] = to
    return begin


@njit(cache=True, nogil=True)
def mark_reachable(rows: FloatArray, alive: int, levels: Levels, mark: NDArray[np.uint8]) -> None:
    """Mark the nodes of its level that any point can touch while it moves by less than a cell."""
    nodes = mark.size
    dim = levels.cells.shape[1]
    centre = np.zeros(nodes, dtype=np.uint8)
    for p in range(alive):
        centre[_nearest_row(levels, _level_of(levels, rows, p), rows, p)] = 1
    low = np.zeros(3, dtype=np.int64)
    high = np.zeros(3, dtype=np.int64)
    for level in range(levels.inverse_cell.size):
        nx = levels.cells[level, 0] + 1
        ny = levels.cells[level, 1] + 1
        for n in range(levels.offset[level], levels.offset[level + 1]):
            if not centre[n]:
                continue
            local = n - levels.offset[level]
            at = (local % nx, local // nx % ny, local // (nx * ny))
            for a in range(dim):
                low[a] = max(at[a] - 2, 0)
                high[a] = min(at[a] + 2, levels.cells[level, a])
            for k in range(low[2], high[2] + 1):
                for j in range(low[1], high[1] + 1):
                    for i in range(low[0], high[0] + 1):
                        mark[levels.offset[level] + (k * ny + j) * nx + i] = 1


@njit(cache=True, nogil=True)
def mark_touched(node: IntArray, count: IntArray, mark: NDArray[np.uint8], listed: IntArray, used: int) -> int:
    """Add nodes of stencils that are not marked yet to a list; returns its new length."""
    for k in range(count.size):
        for e in range(count[k]):
            n = node[k, e]
            if not mark[n]:
                mark[n] = 1
                listed[used] = n
                used += 1
    return used
