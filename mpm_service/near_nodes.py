"""Grid nodes near cracks: which they are, and where they lie in each crack's reference frame.

Distances along grid axes are in cells of the level that a node or place belongs to. ``reach`` is how far a grid
function's node may be from the material that feels it. A crossing of the way between the two lies within the same
distance of both, so a node needs extra fields only if a crack passes that close.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np
from numba import njit
from numpy.typing import NDArray

from .crack_line import nearest_on_line, unit_tangent
from .velocity_fields import Pairs

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Share of a cell by which a place on a line is moved to its left.
NUDGE = 1e-9
# Segments of the marker line on either side of the last nearest one that are searched for the next.
_SEARCH = 3


class CrackGrid(Protocol):
    """What is read of a ``Grid``; a ``HierarchicalGrid`` has one of these for each level, and ``owner()``."""

    def node_positions(self) -> FloatArray:
        """Places of all nodes [m], (rows, 2), x fastest."""


class Lattices(NamedTuple):
    """Levels of a grid, coarsest first, and whose row holds a node's values."""

    origin: FloatArray
    """(levels, 2) [m]"""
    cell: FloatArray
    """(levels,) [m]"""
    cells: IntArray
    """(levels, 2)"""
    first: IntArray
    """(levels,) first row of each level."""
    owner: IntArray
    """(rows,) row that a node goes by, or -1 if it is not in use."""
    place: FloatArray
    """(rows, 2) [m]"""


def lattices(grid: CrackGrid) -> Lattices:
    """Return the levels of a ``Grid`` or ``HierarchicalGrid``."""
    levels: Any = getattr(grid, "grids", (grid,))
    place = np.ascontiguousarray(grid.node_positions(), dtype=np.float64)
    owner: Any = grid.owner() if hasattr(grid, "owner") else np.arange(place.shape[0])
    counts = [(g.cells[0] + 1) * (g.cells[1] + 1) for g in levels]
    return Lattices(
        np.array([g.origin for g in levels], dtype=np.float64).reshape(-1, 2),
        np.array([g.cell_size for g in levels], dtype=np.float64),
        np.array([g.cells for g in levels], dtype=np.int64).reshape(-1, 2),
        np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(np.int64),
        np.ascontiguousarray(owner, dtype=np.int64),
        place,
    )


@njit(inline="always")
def _level_at(origin: FloatArray, cell: FloatArray, cells: IntArray, x: float, y: float) -> int:
    """Finest level around a place; the coarsest outside the grid."""
    level = cell.size - 1
    while level > 0:
        xi = (x - origin[level, 0]) / cell[level]
        eta = (y - origin[level, 1]) / cell[level]
        if 0.0 <= xi <= cells[level, 0] and 0.0 <= eta <= cells[level, 1]:
            break
        level -= 1
    return level


@njit(cache=True, nogil=True)
def cell_at(grid: Lattices, place: FloatArray) -> FloatArray:
    """Cell size [m] around each place (n, 2)."""
    size = np.empty(place.shape[0])
    for m in range(place.shape[0]):
        size[m] = grid.cell[_level_at(grid.origin, grid.cell, grid.cells, place[m, 0], place[m, 1])]
    return size


@njit(cache=True, nogil=True)
def mark_around(grid: Lattices, place: FloatArray, radius: float, owners: bool, mark: NDArray[np.uint8]) -> None:
    """Set the mark of all nodes within ``radius`` cells along x and y of the places (n, 2).

    Levels more than once coarser than the one around a place are left out: their nodes feel nothing of it. With
    ``owners`` only rows in use are marked, else also those that go by another row.
    """
    for m in range(place.shape[0]):
        x = place[m, 0]
        y = place[m, 1]
        around = _level_at(grid.origin, grid.cell, grid.cells, x, y)
        for level in range(max(around - 1, 0), grid.cell.size):
            xi = (x - grid.origin[level, 0]) / grid.cell[level]
            eta = (y - grid.origin[level, 1]) / grid.cell[level]
            if not (abs(xi) < 1e15 and abs(eta) < 1e15):
                continue
            for j in range(
                max(int(np.ceil(eta - radius)), 0), min(int(np.floor(eta + radius)), grid.cells[level, 1]) + 1
            ):
                for i in range(
                    max(int(np.ceil(xi - radius)), 0), min(int(np.floor(xi + radius)), grid.cells[level, 0]) + 1
                ):
                    row = grid.first[level] + j * (grid.cells[level, 0] + 1) + i
                    if not owners:
                        mark[row] = 1
                    if grid.owner[row] >= 0:
                        mark[grid.owner[row]] = 1


def list_pairs(grid: Lattices, line: FloatArray, marker_start: IntArray, radius: float) -> tuple[IntArray, Pairs]:
    """List the rows of the nodes within ``radius`` cells of cracks, and their pairs with the cracks.

    ``line`` (m, 2) holds the places [m] of the markers of all cracks, ``marker_start`` the first of each.
    """
    cracks = range(marker_start.size - 1)
    by_crack = []
    hints = []
    for c in cracks:
        first, last = int(marker_start[c]), int(marker_start[c + 1])
        mark = np.zeros(grid.place.shape[0], dtype=np.uint8)
        mark_around(grid, line[first:last], radius, True, mark)
        rows = np.flatnonzero(mark)
        by_crack.append(rows)
        hints.append(_nearest_segments(grid.place, rows, line, first, last - 1))
    near_node = np.unique(np.concatenate(by_crack))
    node = np.searchsorted(near_node, np.concatenate(by_crack))
    order = np.argsort(node, kind="stable")
    total = node.size
    start = np.concatenate([[0], np.cumsum(np.bincount(node, minlength=near_node.size))]).astype(np.int64)
    crack = np.concatenate([np.full(by_crack[c].size, c, dtype=np.int64) for c in cracks])
    return near_node, Pairs(
        start,
        crack[order],
        np.concatenate(hints)[order],
        np.zeros(total, dtype=np.int64),
        np.zeros(total, dtype=np.int64),
        np.zeros((total, 2)),
        np.zeros(total, dtype=np.bool_),
        np.zeros((total, 2)),
        np.zeros(total),
    )


@njit(cache=True, nogil=True)
def _nearest_segments(place: FloatArray, node: IntArray, line: FloatArray, first: int, last: int) -> IntArray:
    """Segment of a marker line (from ``first`` to ``last``) that is nearest to each grid node."""
    nearest = np.empty(node.size, dtype=np.int64)
    for q in range(node.size):
        nearest[q] = nearest_on_line(line, first, last, place[node[q], 0], place[node[q], 1])[0]
    return nearest


@njit(cache=True, nogil=True)
def find_windows(pairs: Pairs, vertex: FloatArray, vertex_start: IntArray, radius: FloatArray) -> None:
    """For each pair, the corners between which the line comes within ``radius`` (pairs,) [m] of the node's place."""
    for q in range(pairs.crack.size):
        first = vertex_start[pairs.crack[q]]
        last = vertex_start[pairs.crack[q] + 1] - 1
        pairs.first_vertex[q] = first
        pairs.last_vertex[q] = first
        found = False
        for g in range(first, last):
            if nearest_on_line(vertex, g, g + 1, pairs.place[q, 0], pairs.place[q, 1])[2] < radius[q]:
                if not found:
                    pairs.first_vertex[q] = g
                    found = True
                pairs.last_vertex[q] = g + 1


@njit(cache=True, nogil=True)
def midline(reference: FloatArray, faces: FloatArray, line: FloatArray) -> None:
    """Where the cracks run now: the markers moved by the mean displacement of their two faces."""
    for m in range(reference.shape[0]):
        line[m, 0] = reference[m, 0] + 0.5 * (faces[m, 0] + faces[m, 2])
        line[m, 1] = reference[m, 1] + 0.5 * (faces[m, 1] + faces[m, 3])


@njit(cache=True, nogil=True)
def farthest_move(line: FloatArray, found: FloatArray, cell: FloatArray) -> float:
    """Largest way of a marker along an axis since the nodes were listed [cells]."""
    far = 0.0
    for m in range(line.shape[0]):
        for axis in range(2):
            far = max(far, abs(line[m, axis] - found[m, axis]) / cell[m])
    return far


@njit(cache=True, nogil=True)
def place_nodes(
    near_node: IntArray,
    node_place: FloatArray,
    marker_start: IntArray,
    reference: FloatArray,
    faces: FloatArray,
    line: FloatArray,
    cell: FloatArray,
    pairs: Pairs,
) -> None:
    """Bring the near nodes into each crack's reference frame, and find the crack's normal and opening there.

    The way from the nearest place of the moved crack to the node is turned back by the crack's rotation there and
    put at the same place of the reference line.
    """
    start = pairs.start
    crack = pairs.crack
    hint = pairs.hint
    place = pairs.place
    left = pairs.left
    normal = pairs.normal
    gap = pairs.gap
    for k in range(near_node.size):
        x = node_place[near_node[k], 0]
        y = node_place[near_node[k], 1]
        for q in range(start[k], start[k + 1]):
            first = max(hint[q] - _SEARCH, marker_start[crack[q]])
            last = min(hint[q] + 1 + _SEARCH, marker_start[crack[q] + 1] - 1)
            g, t, _, tx, ty = nearest_on_line(line, first, last, x, y)
            gap_x = (1.0 - t) * (faces[g, 0] - faces[g, 2]) + t * (faces[g + 1, 0] - faces[g + 1, 2])
            gap_y = (1.0 - t) * (faces[g, 1] - faces[g, 3]) + t * (faces[g + 1, 1] - faces[g + 1, 3])
            normal[q, 0] = -ty
            normal[q, 1] = tx
            gap[q] = -ty * gap_x + tx * gap_y
            wx = x - line[g, 0] - t * (line[g + 1, 0] - line[g, 0])
            wy = y - line[g, 1] - t * (line[g + 1, 1] - line[g, 1])
            now_x, now_y = unit_tangent(line, g)
            was_x, was_y = unit_tangent(reference, g)
            cosine = now_x * was_x + now_y * was_y
            sine = was_x * now_y - was_y * now_x
            side = tx * wy - ty * wx
            left[q] = side > -NUDGE * cell[g]
            if abs(side) < NUDGE * cell[g]:
                push = NUDGE * cell[g] - side
                wx -= push * ty
                wy += push * tx
            place[q, 0] = reference[g, 0] + t * (reference[g + 1, 0] - reference[g, 0]) + cosine * wx + sine * wy
            place[q, 1] = reference[g, 1] + t * (reference[g + 1, 1] - reference[g, 1]) - sine * wx + cosine * wy
