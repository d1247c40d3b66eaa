"""Points that cross into finer cells are split.

A point that is large against the cells around it leaves cells without points as soon as the body stretches, and
carries details of the finer grid badly. So a point that enters a finer level becomes four::

    +-------+-------+
    |   2   |   3   |     Children sit at the centres of the quarters of the parent's (deformed) domain, with a
    |-------x-------|     quarter of its mass and volume each and its velocity, deformation, stress and history.
    |   0   |   1   |     Mass, momentum, kinetic and strain energy stay what they were, and so does angular
    +-------+-------+     momentum: the children lie in opposite pairs.

The other way nothing happens: a small point among large cells is right, only dearer.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from .hierarchy import HierarchyArrays, locate
from .hierarchy_filling import fill_hierarchy
from .material_points import HALF, HXX, HXY, HYX, HYY, MASS, VOLUME, X, Y

__all__ = ["Split", "fill_hierarchy", "find_oversized", "split_points"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# A point is too large for its cells beyond this factor: rests of round-off do not split points.
_SLACK = 1.01
_SIGNS = np.array([[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]])


class Split(NamedTuple):
    """Points that were split into four."""

    parent: IntArray
    """Rows of the parents, (m,)."""
    rows: FloatArray
    """Table rows of the children, (m, 4, columns)."""
    reference_offset: FloatArray
    """Reference positions of the children less that of their parent [m], (m, 4, 2)."""


@njit(cache=True, nogil=True)
def find_oversized(grid: HierarchyArrays, rows: FloatArray, first: int, last: int, points_per_cell: int) -> IntArray:
    """Rows from ``first`` to ``last - 1`` whose points are larger than a cell's ``points_per_cell``-th part.

    All points must lie inside the grid. The size is the reference one, column HALF.
    """
    found = np.empty(last - first, dtype=np.int64)
    count = 0
    allowed = _SLACK / points_per_cell / grid.inverse_cell
    for p in range(first, last):
        level = locate(grid, rows[p, X], rows[p, Y])[0]
        if 2.0 * rows[p, HALF] * (1 << level) > allowed:
            found[count] = p
            count += 1
    return found[:count].copy()


def split_points(rows: FloatArray, parent: IntArray) -> Split:
    """Split points into four each; the table is left as it is.

    Parameters
    ----------
    rows : (capacity, 16) ndarray
        Point table.
    parent : (m,) ndarray of int
        Rows of the points to split, of `find_oversized`.

    Returns
    -------
    Split
        Children 0 to 3 of each parent, in the order of the drawing above. One call halves sizes once; a point that
        is still too large is found again.

    Notes
    -----
    Child c sits at ``x + F (sx, sy) HALF / 2``, F the parent's deformation gradient.
    """
    old = rows[parent]
    reference = 0.5 * old[:, HALF, None, None] * _SIGNS
    children = np.repeat(old[:, None, :], 4, axis=1)
    for place, along_x, along_y in ((X, HXX, HXY), (Y, HYX, HYY)):
        stretched = reference[:, :, place - X] + (
            old[:, along_x, None] * reference[:, :, 0] + old[:, along_y, None] * reference[:, :, 1]
        )
        children[:, :, place] += stretched
    children[:, :, MASS] *= 0.25
    children[:, :, VOLUME] *= 0.25
    children[:, :, HALF] *= 0.5
    return Split(np.asarray(parent, dtype=np.int64), children, reference)
