"""Filling a body on a nested grid with points, each sized with its level."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .hierarchy import HierarchicalGrid
from .material_points import Body

FloatArray = NDArray[np.float64]

# Round-off of decimal input at cell lines, in cells.
_LINE_TOLERANCE = 1e-6


def _covered(origin: float, cell: float, cells: int, low: float, high: float) -> FloatArray:
    """Share of each of a row of cells that an interval covers; exactly 0 or 1 within round-off of input."""
    line = np.arange(cells, dtype=np.float64)
    share = np.minimum(line + 1.0, (high - origin) / cell) - np.maximum(line, (low - origin) / cell)
    share = np.clip(share, 0.0, 1.0)
    share[share < _LINE_TOLERANCE] = 0.0
    share[share > 1.0 - _LINE_TOLERANCE] = 1.0
    return share


def _cells_inside(grid: HierarchicalGrid, level: int, corners: FloatArray) -> NDArray[np.bool_]:
    """Cells of a level, finer ones left out, that lie in a rectangle; none may be cut."""
    lattice = grid.grids[level]
    along = [
        _covered(lattice.origin[a], lattice.cell_size, lattice.cells[a], corners[0, a], corners[1, a]) for a in (0, 1)
    ]
    share = along[1][:, None] * along[0][None, :]
    if level < len(grid.spans):
        ax, ay, bx, by = grid.spans[level]
        share[ay:by, ax:bx] = 0.0
    cut = np.argwhere((share > 0.0) & (share < 1.0))
    if cut.size:
        j, i = cut[0]
        axis = 0 if 0.0 < along[0][i] < 1.0 else 1
        start = lattice.origin[axis] + (i, j)[axis] * lattice.cell_size
        which = 0 if start < corners[0, axis] else 1
        value = float(corners[which, axis])
        nearest = lattice.origin[axis] + round((value - lattice.origin[axis]) / lattice.cell_size) * lattice.cell_size
        raise ValueError(
            f"body {('lower', 'upper')[which]}[{axis}] = {value!r} m: cuts cells of level {level} "
            f"({lattice.cell_size!r} m); the nearest allowed value is {nearest!r} m"
        )
    return share > 0.0


def fill_hierarchy(
    grid: HierarchicalGrid,
    lower: Sequence[float],
    upper: Sequence[float],
    points_per_cell: int = 2,
) -> Body:
    """Fill a rectangle with points at the centres of equal parts of the cells of each level.

    Parameters
    ----------
    grid : HierarchicalGrid
        Grid; every cell of it is filled once, by points of its own size.
    lower, upper : (2,) sequence of float
        Corners of the body [m]; edges lie on cell lines of every level that they pass through.
    points_per_cell : int
        Points per cell and direction.

    Returns
    -------
    Body
        Points level by level, coarsest first.

    Raises
    ------
    ValueError
        If the body leaves the grid, or an edge cuts a cell (level and nearest allowed value are named).
    """
    if int(points_per_cell) != points_per_cell or points_per_cell < 1:
        raise ValueError(f"points_per_cell = {points_per_cell!r}: a whole number of at least 1 is needed")
    points_per_cell = int(points_per_cell)
    body = np.array([lower, upper], dtype=np.float64)
    slack = _LINE_TOLERANCE * grid.grid.cell_size
    for axis in range(2):
        if not body[0, axis] < body[1, axis]:
            raise ValueError(f"upper[{axis}] = {float(body[1, axis])!r} m: must lie above lower[{axis}]")
        start, end = float(grid.grid.lower[axis]), float(grid.grid.upper[axis])
        if body[0, axis] < start - slack or body[1, axis] > end + slack:
            raise ValueError(
                f"body from {float(body[0, axis])!r} to {float(body[1, axis])!r} m, axis {axis}: leaves the grid, "
                f"which spans {start!r} to {end!r} m"
            )
    position, half = [], []
    part = (np.arange(points_per_cell) + 0.5) / points_per_cell
    py, px = (a.ravel() for a in np.meshgrid(part, part, indexing="ij"))
    for level, lattice in enumerate(grid.grids):
        j, i = np.nonzero(_cells_inside(grid, level, body))
        place = np.stack([(i[:, None] + px).ravel(), (j[:, None] + py).ravel()], axis=1)
        position.append(lattice.lower + lattice.cell_size * place)
        half.append(np.full(place.shape[0], 0.5 * lattice.cell_size / points_per_cell))
    place = np.ascontiguousarray(np.concatenate(position))
    count = place.shape[0]
    return Body(
        place,
        np.ones(count),
        np.concatenate(half),
        grid.grid.cell_size,
        points_per_cell,
        body[0],
        body[1],
        np.zeros(count, dtype=np.int64),
    )
