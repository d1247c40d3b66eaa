"""Linear functions of a nested grid, averaged over the domains of points.

The average of a bilinear function over a rectangle is its value at the rectangle's centre, so a point's domain is
cut along cell lines and along the kinks of five-node cells, and each piece adds its share of the area times the
functions (and gradients) at its own centre. That is exact at any size of the domain, in plain cells and across
levels; on one level and domains up to a cell wide it is uniform GIMP.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from .hierarchy import (
    AX,
    AY,
    BX,
    BY,
    CELLS_X,
    CELLS_Y,
    FIRST,
    HierarchicalGrid,
    HierarchyArrays,
    cells_touched,
    fine_edge,
    locate,
    middle_row,
    owned_row,
)
from .material_points import HALF, HXX, HXY, HYX, HYY, X, Y
from .stencils import Stencils

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Entries that a stencil row needs for domains up to four cells wide, cells of the finest level touched.
STENCIL_NODES = 40
#: Kinds of point domain for `fill_stencils`: none (linear functions), fixed square, square that follows F.
NO_DOMAIN, FIXED_DOMAIN, CONVECTED_DOMAIN = 0, 1, 2
#: `grid_stencil` returns these instead of a count.
OUTSIDE, TOO_WIDE = -1, -2

_OPTIONS = {"cache": True, "nogil": True, "error_model": "numpy"}


@njit(inline="always")
def _piece(low: float, high: float, cell: int) -> tuple[float, float]:
    """Share of an interval [cells] in a cell that it overlaps, and that part's centre there, 0 to 1."""
    left = max(low, float(cell))
    right = min(high, cell + 1.0)
    share = (right - left) / (high - low) if high > low else 1.0
    return share, 0.5 * (left + right) - cell


@njit(**_OPTIONS)
def _add(
    row: int,
    w: float,
    wx: float,
    wy: float,
    node: IntArray,
    weight: FloatArray,
    gradient: FloatArray,
    count: int,
) -> int:
    for k in range(count):
        if node[k] == row:
            weight[k] += w
            gradient[k, 0] += wx
            gradient[k, 1] += wy
            return count
    if count == node.size:
        return TOO_WIDE
    node[count] = row
    weight[count] = w
    gradient[count, 0] = wx
    gradient[count, 1] = wy
    return count + 1


@njit(**_OPTIONS)
def _add_piece(
    levels: IntArray,
    level: int,
    i: int,
    j: int,
    edge: int,
    u: float,
    v: float,
    share: float,
    inverse_cell: float,
    node: IntArray,
    weight: FloatArray,
    gradient: FloatArray,
    count: int,
) -> int:
    """Add ``share`` of the functions of cell (i, j) at its place (u, v), 0 to 1; returns the count.

    Of the functions of Eqs 33-37, with t along the refined edge, those of its corners are linear in t on their own
    half of the cell and zero, to the last bit, on the other; a node there must not get a rest of mass.
    """
    slope = share * inverse_cell
    along = u if edge <= 2 else v
    first_half = along < 0.5
    if edge > 0:
        f = 2.0 * along if first_half else 2.0 - 2.0 * along
        g = 2.0 if first_half else -2.0
        away = edge in (2, 4)  # the edge is the cell's upper or right one
        across = v if edge <= 2 else u
        near = across if away else 1.0 - across
        near_slope = 1.0 if away else -1.0
        wx = g * near if edge <= 2 else f * near_slope
        wy = f * near_slope if edge <= 2 else g * near
        row = middle_row(levels, level, i, j, edge)
        count = _add(row, share * f * near, slope * wx, slope * wy, node, weight, gradient, count)
    for b in range(2):
        for a in range(2):
            fu, gu = (u, 1.0) if a == 1 else (1.0 - u, -1.0)
            fv, gv = (v, 1.0) if b == 1 else (1.0 - v, -1.0)
            if b == edge - 1:
                if first_half == (a == 1):
                    continue
                fu, gu = (1.0 - 2.0 * u, -2.0) if first_half else (2.0 * u - 1.0, 2.0)
            elif a == edge - 3:
                if first_half == (b == 1):
                    continue
                fv, gv = (1.0 - 2.0 * v, -2.0) if first_half else (2.0 * v - 1.0, 2.0)
            if count < 0:
                return count
            row = owned_row(levels, level, i + a, j + b)
            count = _add(row, share * fu * fv, slope * gu * fv, slope * fu * gv, node, weight, gradient, count)
    return count


@njit(**_OPTIONS)
def _nested_stencil(
    grid: HierarchyArrays,
    x: float,
    y: float,
    half_x: float,
    half_y: float,
    node: IntArray,
    weight: FloatArray,
    gradient: FloatArray,
) -> int:
    """`grid_stencil` for domains that touch several levels or their borders."""
    levels = grid.levels
    inverse_cell = grid.inverse_cell
    xi = (x - grid.origin_x) * inverse_cell
    eta = (y - grid.origin_y) * inverse_cell
    x0, x1 = xi - half_x * inverse_cell, xi + half_x * inverse_cell
    y0, y1 = eta - half_y * inverse_cell, eta + half_y * inverse_cell
    if not (x0 >= 0.0 and y0 >= 0.0 and x1 <= levels[0, CELLS_X] and y1 <= levels[0, CELLS_Y]):
        return OUTSIDE
    count = 0
    for level in range(levels.shape[0]):
        i0, i1 = cells_touched(x0, x1, levels[level, CELLS_X], level)
        j0, j1 = cells_touched(y0, y1, levels[level, CELLS_Y], level)
        if i0 > i1 or j0 > j1:
            break
        ax, ay, bx, by = levels[level, AX], levels[level, AY], levels[level, BX], levels[level, BY]
        for j in range(j0, j1 + 1):
            for i in range(i0, i1 + 1):
                if ax <= i < bx and ay <= j < by:
                    continue
                edge = fine_edge(levels, level, i, j)
                left, right = max(x0, float(i)), min(x1, i + 1.0)
                low, high = max(y0, float(j)), min(y1, j + 1.0)
                share_x = (right - left) / (x1 - x0) if x1 > x0 else 1.0
                share_y = (high - low) / (y1 - y0) if y1 > y0 else 1.0
                share = share_x * share_y
                u0, u1, v0, v1 = left - i, right - i, low - j, high - j
                part = 1.0  # share of the piece before the kink
                if edge in (1, 2) and u0 < 0.5 < u1:
                    part = (0.5 - u0) / (u1 - u0)
                    u, v = 0.5 * (0.5 + u1), 0.5 * (v0 + v1)
                    u1 = 0.5
                elif edge in (3, 4) and v0 < 0.5 < v1:
                    part = (0.5 - v0) / (v1 - v0)
                    u, v = 0.5 * (u0 + u1), 0.5 * (0.5 + v1)
                    v1 = 0.5
                else:
                    u, v = 0.0, 0.0
                if part < 1.0:
                    count = _add_piece(
                        levels,
                        level,
                        i,
                        j,
                        edge,
                        u,
                        v,
                        (1.0 - part) * share,
                        inverse_cell,
                        node,
                        weight,
                        gradient,
                        count,
                    )
                    if count < 0:
                        return count
                u, v = 0.5 * (u0 + u1), 0.5 * (v0 + v1)
                count = _add_piece(
                    levels, level, i, j, edge, u, v, part * share, inverse_cell, node, weight, gradient, count
                )
                if count < 0:
                    return count
        x0, x1, y0, y1 = 2.0 * (x0 - ax), 2.0 * (x1 - ax), 2.0 * (y0 - ay), 2.0 * (y1 - ay)
        inverse_cell *= 2.0
    return count


@njit(**_OPTIONS)
def grid_stencil(
    grid: HierarchyArrays,
    x: float,
    y: float,
    half_x: float,
    half_y: float,
    node: IntArray,
    weight: FloatArray,
    gradient: FloatArray,
) -> int:
    """Nodal functions averaged over a rectangle, and their averaged gradients.

    Parameters
    ----------
    grid : HierarchyArrays
        `HierarchicalGrid.arrays`.
    x, y : float
        Centre of the rectangle [m].
    half_x, half_y : float
        Half sides [m]; both 0 gives the linear functions at the point (at a kink those of its right or upper side).
    node, weight, gradient : (K,), (K,), (K, 2) ndarray
        Written: rows without repetition, weights, gradients [1/m]. K = `STENCIL_NODES` serves domains up to four
        cells wide.

    Returns
    -------
    int
        Number of entries; `OUTSIDE` if the rectangle leaves the grid, `TOO_WIDE` if K entries do not suffice.

    Notes
    -----
    Exact, see the module's text. Eqs 32-37 for the cells along a finer level.
    """
    level, xi, eta = locate(grid, x, y)
    levels = grid.levels
    inverse_cell = grid.inverse_cell * (1 << level)
    x0, x1 = xi - half_x * inverse_cell, xi + half_x * inverse_cell
    y0, y1 = eta - half_y * inverse_cell, eta + half_y * inverse_cell
    cells_x, cells_y = levels[level, CELLS_X], levels[level, CELLS_Y]
    if not (x0 >= 0.0 and y0 >= 0.0 and x1 <= cells_x and y1 <= cells_y):
        if level == 0:
            return OUTSIDE
        return _nested_stencil(grid, x, y, half_x, half_y, node, weight, gradient)
    i0, i1 = cells_touched(x0, x1, cells_x, level)
    j0, j1 = cells_touched(y0, y1, cells_y, level)
    if (
        levels[level, BX] > 0
        and i1 + 1 >= levels[level, AX]
        and i0 <= levels[level, BX]
        and j1 + 1 >= levels[level, AY]
        and j0 <= levels[level, BY]
    ):
        return _nested_stencil(grid, x, y, half_x, half_y, node, weight, gradient)
    # Plain cells of one level: the functions are products of one-dimensional ones.
    width = i1 - i0 + 2
    height = j1 - j0 + 2
    if width * height > node.size:
        return TOO_WIDE
    stride = cells_x + 1
    corner = levels[level, FIRST] + j0 * stride + i0
    before, u_before = 0.0, 0.0
    for i in range(width):
        share, u = _piece(x0, x1, i0 + i) if i0 + i <= i1 else (0.0, 0.0)
        weight[i] = before * u_before + share * (1.0 - u)
        gradient[i, 0] = (before - share) * inverse_cell
        before, u_before = share, u
    above, v_above = 0.0, 0.0
    for j in range(height - 1, -1, -1):  # downwards: the first row holds the functions of x until it is its turn
        share, v = _piece(y0, y1, j0 + j - 1) if j > 0 else (0.0, 0.0)
        sy = share * v + above * (1.0 - v_above)
        gy = (share - above) * inverse_cell
        above, v_above = share, v
        for i in range(width):
            k = j * width + i
            sx = weight[i]
            node[k] = corner + j * stride + i
            weight[k] = sx * sy
            gradient[k, 0] = gradient[i, 0] * sy
            gradient[k, 1] = sx * gy
    return width * height


@njit(**_OPTIONS)
def fill_stencils(grid: HierarchyArrays, rows: FloatArray, domain: int, stencils: Stencils) -> int:
    """`grid_stencil` of the points that a table of stencils is for.

    Parameters
    ----------
    grid : HierarchyArrays
        Grid.
    rows : (capacity, 16) ndarray
        Point table.
    domain : int
        `NO_DOMAIN`, `FIXED_DOMAIN` (half sides of column HALF), `CONVECTED_DOMAIN` (times the norms of the rows of F).
    stencils : Stencils
        Written.

    Returns
    -------
    int
        -1, or the row of the first point whose domain leaves the grid or is too wide; its count says which.
    """
    failed = -1
    node, weight, gradient = stencils.node, stencils.weight, stencils.gradient
    for k in range(stencils.entries.size):
        p = stencils.first + k
        half_x = rows[p, HALF] if domain != NO_DOMAIN else 0.0
        half_y = half_x
        if domain == CONVECTED_DOMAIN:
            half_x *= np.sqrt((1.0 + rows[p, HXX]) ** 2 + rows[p, HXY] ** 2)
            half_y *= np.sqrt((1.0 + rows[p, HYY]) ** 2 + rows[p, HYX] ** 2)
        entries = grid_stencil(grid, rows[p, X], rows[p, Y], half_x, half_y, node[k], weight[k], gradient[k])
        stencils.entries[k] = entries
        if entries < 0 and failed < 0:
            failed = p
    return failed


@njit(**_OPTIONS)
def place_stencils(grid: HierarchyArrays, position: FloatArray, half: FloatArray, stencils: Stencils) -> None:
    """`grid_stencil` at places (m, 2) with half sides (m, 2) [m], into a table of m stencils."""
    for p in range(position.shape[0]):
        stencils.entries[p] = grid_stencil(
            grid,
            position[p, 0],
            position[p, 1],
            half[p, 0],
            half[p, 1],
            stencils.node[p],
            stencils.weight[p],
            stencils.gradient[p],
        )


def hierarchy_stencils(grid: HierarchicalGrid, position: FloatArray, half: FloatArray | float = 0.0) -> Stencils:
    """Stencils of any places: anchors, crack points, loads; or of point domains.

    Parameters
    ----------
    grid : HierarchicalGrid
        Grid, of one level or more.
    position : (n, 2) ndarray
        Centres [m].
    half : float, (n, 1) or (n, 2) ndarray
        Half sides of the domains [m]; 0 gives the linear functions at the places.

    Returns
    -------
    Stencils
        With ``first`` 0 and as many columns as the longest needs; entries behind a place's count are zero.

    Raises
    ------
    ValueError
        If a domain leaves the grid or is more than four cells wide.
    """
    position = np.ascontiguousarray(position, dtype=np.float64).reshape(-1, 2)
    count = position.shape[0]
    stencils = Stencils(
        0,
        np.zeros((count, STENCIL_NODES), dtype=np.int64),
        np.zeros((count, STENCIL_NODES)),
        np.zeros((count, STENCIL_NODES, 2)),
        np.zeros(count, dtype=np.int64),
    )
    wide = np.ascontiguousarray(np.broadcast_to(np.asarray(half, dtype=np.float64), (count, 2)))
    place_stencils(grid.arrays, position, wide, stencils)
    bad = np.flatnonzero(stencils.entries < 0)
    if bad.size:
        p = int(bad[0])
        why = "leaves the grid" if stencils.entries[p] == OUTSIDE else "touches too many nodes, four cells is the most"
        raise ValueError(
            f"domain {p} at {tuple(position[p].tolist())} m, half sides {tuple(wide[p].tolist())} m: {why}"
        )
    longest = int(stencils.entries.max(initial=1))
    return Stencils(
        0,
        stencils.node[:, :longest].copy(),
        stencils.weight[:, :longest].copy(),
        stencils.gradient[:, :longest].copy(),
        stencils.entries,
    )
