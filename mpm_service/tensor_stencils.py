"""Stencils on one uniform lattice in two or three dimensions, as products of one-dimensional functions.

The hat function of node n is averaged over ``xi - l ... xi + l`` as the area of the two trapezoids that its sides have
there, over 2 l; this holds for domains of any width, also wider than a cell.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from .shapes import SLIVER

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Kinds of functions, as the kernel tells them apart.
LINEAR, UNIFORM, CONVECTED, SPLINE = range(4)
#: Nodes in one direction that a domain may touch.
WIDEST = 6


@njit(inline="always")
def _hat(t: float) -> float:
    return max(1.0 - abs(t), 0.0)


@njit(inline="always")
def _rise_integral(low: float, high: float) -> float:
    """Integral of the rising side of the hat function, a trapezoid: a difference of integrals loses slivers."""
    a = min(max(low, -1.0), 0.0)
    b = min(max(high, -1.0), 0.0)
    return 0.5 * (b - a) * ((1.0 + a) + (1.0 + b))


@njit(cache=True, nogil=True)
def functions_1d(kind: int, xi: float, half: float, weight: FloatArray, slope: FloatArray) -> tuple[int, int]:
    """Weights and slopes [1/cell] at place `xi` [cells]; returns the first node and their number, 0 if too many."""
    if kind == SPLINE:
        centre = int(np.floor(xi + 0.5))
        d = xi - centre
        weight[0] = 0.5 * (0.5 - d) ** 2
        weight[1] = 0.75 - d * d
        weight[2] = 0.5 * (0.5 + d) ** 2
        slope[0] = d - 0.5
        slope[1] = -2.0 * d
        slope[2] = d + 0.5
        return centre - 1, 3
    if not half > 0.0:
        first = int(np.floor(xi))
        d = max(xi - first, SLIVER)
        weight[0] = 1.0 - d
        weight[1] = d
        slope[0] = -1.0
        slope[1] = 1.0
        return first, 2
    first = int(np.floor(xi - half))
    last = int(np.ceil(xi + half))
    count = last - first + 1
    if count > WIDEST:
        return first, 0
    for k in range(count):
        low = xi - half - (first + k)
        high = xi + half - (first + k)
        weight[k] = (_rise_integral(low, high) + _rise_integral(-high, -low)) / (2.0 * half)
        slope[k] = (_hat(high) - _hat(low)) / (2.0 * half)
    return first, count


@njit(cache=True, nogil=True)
def fill_stencils(
    position: FloatArray,
    half: FloatArray,
    kind: int,
    origin: FloatArray,
    inverse_cell: float,
    cells: IntArray,
    node: IntArray,
    weight: FloatArray,
    gradient: FloatArray,
    count: IntArray,
) -> int:
    """Tabulate the stencils of places `position` (m, d) with half widths `half` (m, d) [m].

    Returns the first place whose stencil leaves the grid or is too wide, else -1.
    """
    dim = position.shape[1]
    s = np.zeros((3, WIDEST))
    g = np.zeros((3, WIDEST))
    first = np.zeros(3, dtype=np.int64)
    number = np.ones(3, dtype=np.int64)
    s[2, 0] = 1.0
    for p in range(position.shape[0]):
        for a in range(dim):
            xi = (position[p, a] - origin[a]) * inverse_cell
            first[a], number[a] = functions_1d(kind, xi, half[p, a] * inverse_cell, s[a], g[a])
            if number[a] == 0 or not (first[a] >= 0 and first[a] + number[a] - 1 <= cells[a]):
                return p
        if dim == 2:
            first[2] = 0
            number[2] = 1
        e = 0
        for k in range(number[2]):
            for j in range(number[1]):
                for i in range(number[0]):
                    row = first[0] + i + (cells[0] + 1) * (first[1] + j)
                    if dim == 3:
                        row += (cells[0] + 1) * (cells[1] + 1) * (first[2] + k)
                    w = s[0, i] * s[1, j] * s[2, k]
                    gx = g[0, i] * s[1, j] * s[2, k]
                    gy = s[0, i] * g[1, j] * s[2, k]
                    gz = s[0, i] * s[1, j] * g[2, k]
                    if w == 0.0 and gx == 0.0 and gy == 0.0 and gz == 0.0:
                        continue
                    node[p, e] = row
                    weight[p, e] = w
                    gradient[p, e, 0] = gx * inverse_cell
                    gradient[p, e, 1] = gy * inverse_cell
                    if dim == 3:
                        gradient[p, e, 2] = gz * inverse_cell
                    e += 1
        count[p] = e
    return -1
