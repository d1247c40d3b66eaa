"""Shape functions: uniform GIMP for material points, linear for massless tracers.

One direction of uGIMP, lengths in cells. The point sits at ``xi``, its domain is ``xi - l ... xi + l``
with ``l <= 1/2``; ``c`` is the nearest node and ``d = xi - c``::

        c-1            c            c+1
    -----o-------------o--+----------o-----
                       |--d    [  domain 2l  ]

Only these three nodes can see the point. With ``a = min(max(d, -l), l)`` the hat function averaged over
the domain is, without a branch,

    S(c+1) = (l + a)^2 / 4l + max(d - l, 0),   S(c-1) = (l - a)^2 / 4l + max(-d - l, 0),
    S(c) = 1 - S(c-1) - S(c+1).
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from .grid import Grid, Mesh

Triple = tuple[float, float, float]


@njit(inline="always")
def gimp_1d(xi: float, half: float, inverse_2l: float, inverse_4l: float) -> tuple[int, Triple, Triple]:
    """Nearest node, three weights and three slopes [1/cell] of nodes c-1, c, c+1."""
    centre = int(xi + 0.5)
    d = xi - centre
    a = min(max(d, -half), half)
    excess = d - a
    up = half + a
    down = half - a
    right = up * up * inverse_4l + max(excess, 0.0)
    left = down * down * inverse_4l + max(-excess, 0.0)
    slope_right = up * inverse_2l
    slope_left = -down * inverse_2l
    return (
        centre,
        (left, 1.0 - left - right, right),
        (slope_left, -slope_left - slope_right, slope_right),
    )


@njit(cache=True, nogil=True)
def _evaluate(
    position: NDArray[np.float64],
    mesh: Mesh,
    node: NDArray[np.int64],
    weight: NDArray[np.float64],
    gradient: NDArray[np.float64],
) -> None:
    for p in range(position.shape[0]):
        cx, sx, gx = gimp_1d(
            (position[p, 0] - mesh.origin_x) * mesh.inverse_cell,
            mesh.half_size,
            mesh.inverse_2l,
            mesh.inverse_4l,
        )
        cy, sy, gy = gimp_1d(
            (position[p, 1] - mesh.origin_y) * mesh.inverse_cell,
            mesh.half_size,
            mesh.inverse_2l,
            mesh.inverse_4l,
        )
        for j in range(3):
            for i in range(3):
                k = 3 * j + i
                node[p, k] = (cy + j - 1) * mesh.stride + cx + i - 1
                weight[p, k] = sx[i] * sy[j]
                gradient[p, k, 0] = gx[i] * sy[j] * mesh.inverse_cell
                gradient[p, k, 1] = sx[i] * gy[j] * mesh.inverse_cell


def gimp_shape_functions(
    grid: Grid, position: NDArray[np.float64], point_size: float
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Weights and gradients of uniform GIMP, the functions the solver itself uses.

    Parameters
    ----------
    grid : Grid
        Background grid.
    position : (n, 2) ndarray
        Centres of the point domains [m].
    point_size : float
        Side of the square domain [m], at most one cell.

    Returns
    -------
    node : (n, 9) ndarray of int
        Node numbers, x running fastest.
    weight : (n, 9) ndarray
        S_Ip, dimensionless.
    gradient : (n, 9, 2) ndarray
        Gradient of S_Ip [1/m].

    Raises
    ------
    ValueError
        If a domain leaves the grid or the size is not allowed.

    Notes
    -----
    Bardenhagen and Kober, CMES 5 (2004) 477, with constant characteristic function.
    """
    position = np.ascontiguousarray(position, dtype=np.float64).reshape(-1, 2)
    mesh = grid.mesh(point_size)
    index = (position - grid.lower) / grid.cell_size
    if np.any(index < 0.5) or np.any(index >= np.array(grid.cells) - 0.5):
        raise ValueError("position: a point lies within half a cell of the grid's border or outside it")
    count = position.shape[0]
    node = np.empty((count, 9), dtype=np.int64)
    weight = np.empty((count, 9))
    gradient = np.empty((count, 9, 2))
    _evaluate(position, mesh, node, weight, gradient)
    return node, weight, gradient
