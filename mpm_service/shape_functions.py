"""Shape functions at places of a uniform grid, as tables to look at and to compute with.

They are those of the solver: hat functions at the place (classic method) or averaged over a domain around it (GIMP),
or quadratic B-splines; products of one-dimensional functions in two or three dimensions.
"""

from __future__ import annotations

from typing import get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .grid import Grid
from .scheme import Interpolation
from .tensor_stencils import LINEAR, SPLINE, UNIFORM, WIDEST, fill_stencils

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Convected domains are uniform ones of another size.
_KINDS = {"linear": LINEAR, "ugimp": UNIFORM, "cpgimp": UNIFORM, "bspline": SPLINE}


def shape_functions(
    grid: Grid, position: ArrayLike, half: ArrayLike = 0.0, interpolation: Interpolation = "ugimp"
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return the nodes that feel each place, with their weights and gradients.

    Parameters
    ----------
    grid : Grid
        Background grid.
    position : (n, d) array_like
        Centres of the domains [m].
    half : float, (d,) or (n, d) array_like
        Half sides of the domains [m], at most two cells; where zero, the functions are linear. For cpGIMP those that
        the deformation has made of them: reference half sides times the norms of the rows of F. Linear functions and
        B-splines have no domains and ignore it.
    interpolation : {"ugimp", "linear", "cpgimp", "bspline"}

    Returns
    -------
    node : (n, k) ndarray of int
        Node numbers, x running fastest, as in ``grid.node_positions()``. Places with fewer nodes than others
        are filled up with node 0, weight 0.
    weight : (n, k) ndarray
        S_Ip, dimensionless.
    gradient : (n, k, d) ndarray
        Gradient of S_Ip [1/m].

    Raises
    ------
    ValueError
        If a value is not allowed, or nodes that a place needs lie outside the grid.

    References
    ----------
    Bardenhagen and Kober, CMES 5 (2004) 477 (GIMP, constant characteristic function); Steffen, Kirby and Berzins,
    IJNME 76 (2008) 922 (B-splines). Eqs 15, 16, 24 and 29 of the dissertation.
    """
    if interpolation not in get_args(Interpolation):
        raise ValueError(f"interpolation = {interpolation!r}: allowed are {', '.join(get_args(Interpolation))}")
    dimension = grid.dimension
    place = np.ascontiguousarray(position, dtype=np.float64)
    if place.ndim != 2 or place.shape[1] != dimension or not np.all(np.isfinite(place)):
        raise ValueError(f"position: finite numbers of shape (n, {dimension}) are needed, got shape {place.shape}")
    sides = np.asarray(half, dtype=np.float64)
    if sides.shape not in ((), (dimension,), place.shape):
        raise ValueError(f"half: a number or shape ({dimension},) or {place.shape} is needed, got shape {sides.shape}")
    widest = 0.5 * (WIDEST - 2)
    if not np.all((sides >= 0.0) & (sides <= widest * grid.cell_size * (1.0 + 1e-12))):
        raise ValueError(f"half: from 0 to {widest:g} cells ({widest * grid.cell_size!r} m) is allowed, got {half!r} m")
    averaged = interpolation in ("ugimp", "cpgimp")
    count, entries = place.shape[0], (WIDEST if averaged else 3) ** dimension
    node = np.zeros((count, entries), dtype=np.int64)
    weight = np.zeros((count, entries))
    gradient = np.zeros((count, entries, dimension))
    used = np.zeros(count, dtype=np.int64)
    outside = fill_stencils(
        place,
        np.ascontiguousarray(np.broadcast_to(sides if averaged else 0.0, place.shape)),
        _KINDS[interpolation],
        grid.lower,
        1.0 / grid.cell_size,
        np.array(grid.cells, dtype=np.int64),
        node,
        weight,
        gradient,
        used,
    )
    if outside >= 0:
        raise ValueError(
            f"position[{outside}] = {tuple(place[outside].tolist())} m: its {interpolation} functions need nodes "
            f"beyond the grid, which spans {grid.lower.tolist()} to {grid.upper.tolist()} m"
        )
    k = int(used.max(initial=0))
    return node[:, :k].copy(), weight[:, :k].copy(), gradient[:, :k].copy()
