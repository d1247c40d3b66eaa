"""Nested 2:1 grid: levels of halved cells, which rows of the nodal tables their nodes have.

A level covers a rectangle of its parent's cells and halves them. Where a coarse cell touches the rectangle from
outside, the middle of the shared edge is a node of the fine lattice and the cell has five nodes (Eqs 32-37)::

      4-----------3          Every level has a full lattice of rows in the nodal tables. Nodes on a level's
      |           |          border belong to that level; the parent's nodes that lie on them are other names
      |  coarse   |          for the same rows, the parent's nodes inside are unused. So the functions are
      |           |          continuous across the border, sum to one and reproduce linear fields.
      1-----5-----2
      |  f  |  f  |          The five functions have a kink from node 5 upwards; on either side of it they are
      +-----+-----+          bilinear, like those of a plain cell on the whole of it.

Places are kept in cells of the level at hand; one level down is ``2 (xi - a)``, which is exact at the border, so
the levels can never disagree on whose side a place lies. A level owns its lower and left border, its parent the
upper and right ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from .grid import Grid
from .material_points import Rectangle

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Cells of the parent between two borders: the stencils of fine points then end in the parent's own cells.
_MARGIN = 2
# How far a corner may sit off a cell line, in cells: covers round-off of decimal input, nothing more.
_LINE_TOLERANCE = 1e-6
_OPTIONS = {"cache": True, "nogil": True, "error_model": "numpy"}

# Columns of HierarchyArrays.levels.
CELLS_X, CELLS_Y, FIRST, AX, AY, BX, BY = range(7)


class HierarchyArrays(NamedTuple):
    """Grid numbers in the form the kernels read: lengths of level 0 in metres, all else in cells of its level."""

    origin_x: float
    origin_y: float
    inverse_cell: float
    levels: IntArray
    """(levels, 7): cells in x, cells in y, first row, then the refined rectangle ax, ay, bx, by (0 if none)."""


@dataclass(frozen=True)
class HierarchicalGrid:
    """Uniform grid with nested rectangles in which cells are halved, each inside the one before.

    Parameters
    ----------
    grid : Grid
        Level 0.
    refinements : sequence of (lower, upper)
        Corners [m] of level 1, 2, ... Each lies on cell lines of the level before, at least two of that level's
        cells inside its border, and spans at least two of them in each direction.

    Raises
    ------
    ValueError
        If a rectangle breaks these rules; names level, value and the nearest allowed value.
    """

    grid: Grid
    refinements: Sequence[Rectangle] = ()
    spans: tuple[tuple[int, int, int, int], ...] = field(init=False, repr=False)
    """Rectangle ax, ay, bx, by of level l + 1 in cells of level l."""

    def __post_init__(self) -> None:
        spans: list[tuple[int, int, int, int]] = []
        parent = self.grid
        for level, corners in enumerate(self.refinements, start=1):
            low = [_line(level, "lower", axis, corners[0][axis], parent) for axis in range(2)]
            high = [_line(level, "upper", axis, corners[1][axis], parent) for axis in range(2)]
            for axis in range(2):
                if high[axis] - low[axis] < 2:
                    raise ValueError(
                        f"HierarchicalGrid level {level}, upper[{axis}] = {corners[1][axis]!r} m: must be at least "
                        f"two cells of level {level - 1} above lower; the lowest allowed value is "
                        f"{_at(parent, axis, low[axis] + 2)!r} m"
                    )
            spans.append((low[0], low[1], high[0], high[1]))
            parent = _halved(parent, spans[-1])
        object.__setattr__(self, "spans", tuple(spans))

    @cached_property
    def grids(self) -> tuple[Grid, ...]:
        """Level lattices as grids of their own, coarsest first."""
        grids = [self.grid]
        for span in self.spans:
            grids.append(_halved(grids[-1], span))
        return tuple(grids)

    @property
    def cell_sizes(self) -> tuple[float, ...]:
        """Side of a cell of each level [m]."""
        return tuple(grid.cell_size for grid in self.grids)

    @cached_property
    def first_rows(self) -> tuple[int, ...]:
        """Row of the first node of each level in the nodal tables."""
        counts = [grid.node_count for grid in self.grids]
        return tuple(int(n) for n in np.concatenate([[0], np.cumsum(counts)[:-1]]))

    @property
    def node_count(self) -> int:
        """Rows of all levels, those that are unused or other names included."""
        return sum(grid.node_count for grid in self.grids)

    @cached_property
    def arrays(self) -> HierarchyArrays:
        """Kernel form."""
        levels = np.zeros((len(self.grids), 7), dtype=np.int64)
        for level, grid in enumerate(self.grids):
            levels[level, :3] = (*grid.cells, self.first_rows[level])
            if level < len(self.spans):
                levels[level, 3:] = self.spans[level]
        return HierarchyArrays(
            float(self.grid.origin[0]), float(self.grid.origin[1]), 1.0 / self.grid.cell_size, levels
        )

    def node_positions(self) -> FloatArray:
        """Positions of the nodes of all rows [m], (node_count, 2)."""
        return np.concatenate([grid.node_positions() for grid in self.grids])

    def owner(self) -> IntArray:
        """Row that holds the values of each row's node: itself, the finer level's row there, or -1 (unused)."""
        rows = np.arange(self.node_count, dtype=np.int64)
        for level, (ax, ay, bx, by) in enumerate(self.spans):
            j, i = np.mgrid[ay : by + 1, ax : bx + 1]
            fine = self.grids[level + 1]
            there = self.first_rows[level + 1] + 2 * (j - ay) * (fine.cells[0] + 1) + 2 * (i - ax)
            border = (i == ax) | (i == bx) | (j == ay) | (j == by)
            own = self.first_rows[level] + j * (self.grids[level].cells[0] + 1) + i
            rows[own] = np.where(border, there, -1)
        return rows

    def special_mask(self) -> NDArray[np.uint8]:
        """1 where points with this nearest row may need a stencil, (node_count,).

        A point elsewhere has the plain 3 x 3 block of its own level, all of it in that level's rows, and keeps it
        while it travels less than a cell.
        """
        masks = []
        for level, grid in enumerate(self.grids):
            mask = np.zeros((grid.cells[1] + 1, grid.cells[0] + 1), dtype=np.uint8)
            if level > 0:
                mask[:2] = mask[-2:] = 1
                mask[:, :2] = mask[:, -2:] = 1
            if level < len(self.spans):
                ax, ay, bx, by = self.spans[level]
                mask[max(ay - 2, 0) : by + 3, max(ax - 2, 0) : bx + 3] = 1
            masks.append(mask.ravel())
        return np.concatenate(masks)

    def level_of(self, position: FloatArray) -> IntArray:
        """Level of the cell around each place, (n,).

        Parameters
        ----------
        position : (n, 2) ndarray
            Places [m].
        """
        position = np.ascontiguousarray(position, dtype=np.float64).reshape(-1, 2)
        level = np.empty(position.shape[0], dtype=np.int64)
        _levels_of(self.arrays, position, level)
        return level


def _at(grid: Grid, axis: int, line: int) -> float:
    return float(grid.origin[axis] + line * grid.cell_size)


def _halved(parent: Grid, span: tuple[int, int, int, int]) -> Grid:
    ax, ay, bx, by = span
    origin = (_at(parent, 0, ax), _at(parent, 1, ay))
    return Grid(origin, 0.5 * parent.cell_size, (2 * (bx - ax), 2 * (by - ay)))


def _line(level: int, name: str, axis: int, value: float, parent: Grid) -> int:
    place = (float(value) - parent.origin[axis]) / parent.cell_size
    least, most = _MARGIN, parent.cells[axis] - _MARGIN
    if not np.isfinite(place):
        raise ValueError(f"HierarchicalGrid level {level}, {name}[{axis}] = {value!r}: a finite length [m] is needed")
    nearest = min(max(round(place), least), most)
    if abs(place - nearest) > _LINE_TOLERANCE:
        raise ValueError(
            f"HierarchicalGrid level {level}, {name}[{axis}] = {value!r} m: must lie on a cell line of level "
            f"{level - 1} (every {parent.cell_size!r} m from {parent.origin[axis]!r} m) and at least {_MARGIN} of its "
            f"cells inside its border; the nearest allowed value is {_at(parent, axis, nearest)!r} m"
        )
    return int(nearest)


@njit(**_OPTIONS)
def locate(grid: HierarchyArrays, x: float, y: float) -> tuple[int, float, float]:
    """Level of the cell around a place [m], and the place in cells of that level."""
    xi = (x - grid.origin_x) * grid.inverse_cell
    eta = (y - grid.origin_y) * grid.inverse_cell
    levels = grid.levels
    level = 0
    while level + 1 < levels.shape[0]:
        ax, ay = levels[level, AX], levels[level, AY]
        if not (ax <= xi < levels[level, BX] and ay <= eta < levels[level, BY]):
            break
        xi = 2.0 * (xi - ax)
        eta = 2.0 * (eta - ay)
        level += 1
    return level, xi, eta


@njit(**_OPTIONS)
def owned_row(levels: IntArray, level: int, i: int, j: int) -> int:
    """Row of node (i, j) of a level; the finer level's where the node lies on its border."""
    ax, ay, bx, by = levels[level, AX], levels[level, AY], levels[level, BX], levels[level, BY]
    if bx > 0 and ax <= i <= bx and ay <= j <= by:
        return levels[level + 1, FIRST] + 2 * (j - ay) * (levels[level + 1, CELLS_X] + 1) + 2 * (i - ax)
    return levels[level, FIRST] + j * (levels[level, CELLS_X] + 1) + i


@njit(**_OPTIONS)
def _levels_of(grid: HierarchyArrays, position: FloatArray, level: IntArray) -> None:
    for p in range(position.shape[0]):
        level[p] = locate(grid, position[p, 0], position[p, 1])[0]


@njit(**_OPTIONS)
def cells_touched(low: float, high: float, cells: int, level: int) -> tuple[int, int]:
    """First and last cell of a level that an interval [cells] overlaps; first > last if none."""
    first = int(np.floor(low))
    last = max(int(np.ceil(high)) - 1, first)
    if level == 0:
        first = min(first, cells - 1)  # a place on the grid's upper border belongs to the last cell
    return max(first, 0), min(last, cells - 1)


@njit(**_OPTIONS)
def fine_edge(levels: IntArray, level: int, i: int, j: int) -> int:
    """Edge of cell (i, j) that a finer level touches: 1 lower, 2 upper, 3 left, 4 right, 0 none."""
    ax, ay, bx, by = levels[level, AX], levels[level, AY], levels[level, BX], levels[level, BY]
    if bx == 0:
        return 0
    if ax <= i < bx:
        if j == by:
            return 1
        if j + 1 == ay:
            return 2
    elif ay <= j < by:
        if i == bx:
            return 3
        if i + 1 == ax:
            return 4
    return 0


@njit(**_OPTIONS)
def middle_row(levels: IntArray, level: int, i: int, j: int, edge: int) -> int:
    """Row of node 5 of cell (i, j), which a finer level touches at an edge."""
    fine_x = 2 * (i - levels[level, AX])
    fine_y = 2 * (j - levels[level, AY])
    if edge == 1:
        fine_x += 1
    elif edge == 2:
        fine_x += 1
        fine_y += 2
    elif edge == 3:
        fine_y += 1
    else:
        fine_x += 2
        fine_y += 1
    return levels[level + 1, FIRST] + fine_y * (levels[level + 1, CELLS_X] + 1) + fine_x
