"""Material points: how a body is filled with them and how their state is read."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

# Columns of the plane point table. One row per point keeps all a point needs in two cache lines: position,
# velocity, H = F - I, Kirchhoff stress, weighted mass, weighted reference volume, reference half side of the
# domain, position increment of the last step.
X, Y, VX, VY, HXX, HXY, HYX, HYY, SXX, SYY, SXY, MASS, VOLUME, HALF, DX, DY = range(16)
COLUMNS = 16


class Columns(NamedTuple):
    """First columns of what a point table holds, for a dimension; see above for what each is."""

    dimension: int
    position: int
    velocity: int
    gradient: int
    stress: int
    """xx, yy, xy in the plane; xx, yy, zz, yz, xz, xy in space."""
    mass: int
    volume: int
    half: int
    increment: int
    width: int


def columns(dimension: int) -> Columns:
    """Return the columns of a point table in 2 or 3 dimensions."""
    stress = 2 * dimension + dimension * dimension
    mass = stress + (3 if dimension == 2 else 6)
    return Columns(
        dimension, 0, dimension, 2 * dimension, stress, mass, mass + 1, mass + 2, mass + 3, mass + 3 + dimension
    )


# How far a rectangle may sit off a cell line, in cells: covers round-off of decimal input, nothing more.
_LINE_TOLERANCE = 1e-6

Rectangle = tuple[Sequence[float], Sequence[float]]


@dataclass(frozen=True)
class Body:
    """Points of a body in its reference state.

    Attributes
    ----------
    position : (n, d) ndarray
        Reference positions [m].
    weight : (n,) ndarray
        Share of mass and stiffness the point carries, dimensionless.
    stiffness : (n,) ndarray
        Share of stiffness where that is another; absent: the weight.
    half : (n,) ndarray
        Half side of each point's square domain [m].
    cell_size : float
        Side of the (coarsest) cells it was made for [m].
    points_per_cell : int
        Points per cell and direction.
    lower, upper : (d,) ndarray
        Corners of the body [m]; its faces are these.
    material : (n,) ndarray of int
        Number of each point's material among those of the solver.
    """

    position: NDArray[np.float64]
    weight: NDArray[np.float64]
    half: NDArray[np.float64]
    cell_size: float
    points_per_cell: int
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    material: NDArray[np.int64]
    stiffness: NDArray[np.float64] | None = None

    @property
    def stiffness_share(self) -> NDArray[np.float64]:
        """Share of stiffness of each point, (n,)."""
        return self.weight if self.stiffness is None else self.stiffness

    @property
    def count(self) -> int:
        """Number of points."""
        return int(self.position.shape[0])

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return int(self.position.shape[1])

    def with_material(self, inside: Callable[[NDArray[np.float64]], NDArray[np.bool_]], number: int) -> Body:
        """Return the body with another material where `inside` of the positions (n, d) is true.

        Parameters
        ----------
        inside : callable
            From positions (n, d) [m] to (n,) of bool.
        number : int
            Which of the solver's materials, from 0.
        """
        return replace(self, material=np.where(inside(self.position), np.int64(number), self.material))


def _on_line(name: str, value: float, origin: float, cell_size: float) -> int:
    value, origin, cell_size = float(value), float(origin), float(cell_size)
    cells = (value - origin) / cell_size
    nearest = round(cells)
    if not np.isfinite(cells) or abs(cells - nearest) > _LINE_TOLERANCE:
        allowed = origin + nearest * cell_size if np.isfinite(cells) else origin
        raise ValueError(
            f"{name} = {value!r} m does not lie on a cell line; the nearest allowed value is {allowed!r} m "
            f"(lines every {cell_size!r} m from {origin!r} m)"
        )
    return int(nearest)


def _cell_counts(lower: Sequence[float], upper: Sequence[float], cell_size: float, points_per_cell: int) -> list[int]:
    """Check a box and return its numbers of cells."""
    if not (np.isfinite(cell_size) and cell_size > 0.0):
        raise ValueError(f"cell_size = {cell_size!r}: a positive length [m] is needed")
    if int(points_per_cell) != points_per_cell or points_per_cell < 1:
        raise ValueError(f"points_per_cell = {points_per_cell!r}: a whole number of at least 1 is needed")
    if len(lower) not in (2, 3) or len(upper) != len(lower):
        raise ValueError(f"upper = {upper!r}: as many numbers as lower = {lower!r} are needed, two or three")
    cells = []
    for axis in range(len(lower)):
        count = _on_line(f"upper[{axis}]", float(upper[axis]), float(lower[axis]), cell_size)
        if count < 1:
            raise ValueError(f"upper[{axis}] = {upper[axis]!r} m: must be at least one cell above lower[{axis}]")
        cells.append(count)
    return cells


def _sub_cell_centres(
    start: NDArray[np.float64], cells: Sequence[int], cell_size: float, n: int
) -> NDArray[np.float64]:
    """Centres of equal sub-cells, x running fastest."""
    lines = [low + cell_size * (np.arange(count * n) + 0.5) / n for low, count in zip(start, cells, strict=True)]
    mesh = np.meshgrid(*lines[::-1], indexing="ij")
    return np.stack([axis.ravel() for axis in mesh[::-1]], axis=1)


def _body(
    position: NDArray[np.float64],
    cell_size: float,
    points_per_cell: int,
    start: NDArray[np.float64],
    cells: Sequence[int],
) -> Body:
    return Body(
        np.ascontiguousarray(position),
        np.ones(position.shape[0]),
        np.full(position.shape[0], 0.5 * cell_size / points_per_cell),
        float(cell_size),
        int(points_per_cell),
        start,
        start + cell_size * np.array(cells, dtype=np.float64),
        np.zeros(position.shape[0], dtype=np.int64),
    )


def fill_region(
    lower: Sequence[float],
    upper: Sequence[float],
    cell_size: float,
    inside: Callable[[NDArray[np.float64]], NDArray[np.bool_]],
    points_per_cell: int = 2,
) -> Body:
    """Fill the part of a rectangle or box that a function tells with points at centres of equal sub-cells.

    Parameters
    ----------
    lower, upper : (d,) sequence of float
        Corners of the box [m]; both lie on cell lines.
    cell_size : float
        Cell side [m].
    inside : callable
        From positions (n, d) [m] to (n,) of bool: whether there is material.
    points_per_cell : int
        Points per cell and direction.

    Returns
    -------
    Body

    Raises
    ------
    ValueError
        If the box is off the cell lines, or nothing is inside.
    """
    cells = _cell_counts(lower, upper, cell_size, points_per_cell)
    start = np.array([float(value) for value in lower])
    position = _sub_cell_centres(start, cells, cell_size, int(points_per_cell))
    kept = np.asarray(inside(position), dtype=bool)
    if kept.shape != (position.shape[0],):
        raise ValueError(f"inside: must return shape ({position.shape[0]},), got {kept.shape}")
    if not kept.any():
        raise ValueError("inside: is false everywhere, no material point is left")
    position = position[kept]
    return _body(position, cell_size, points_per_cell, start, cells)


def fill_rectangle(
    lower: Sequence[float],
    upper: Sequence[float],
    cell_size: float,
    points_per_cell: int = 2,
    hole: Rectangle | None = None,
) -> Body:
    """Fill a rectangle with points at the centres of equal sub-cells.

    Parameters
    ----------
    lower, upper : (d,) sequence of float
        Corners [m], in 2 or 3 dimensions; both lie on cell lines.
    cell_size : float
        Cell side [m].
    points_per_cell : int
        Points per cell and direction.
    hole : (lower, upper), optional
        Rectangle without points, on cell lines [m].

    Returns
    -------
    Body

    Raises
    ------
    ValueError
        If a corner is off the cell lines (the nearest allowed value is named) or nothing is left to fill.
    """
    cells = _cell_counts(lower, upper, cell_size, points_per_cell)
    start = np.array([float(value) for value in lower])
    position = _sub_cell_centres(start, cells, cell_size, int(points_per_cell))
    if hole is not None:
        corners = np.array(hole, dtype=np.float64)
        for axis in range(start.size):
            for corner, name in enumerate(("lower", "upper")):
                _on_line(f"hole {name}[{axis}]", float(corners[corner, axis]), start[axis], cell_size)
            if not corners[0, axis] < corners[1, axis]:
                raise ValueError(f"hole upper[{axis}] = {corners[1, axis]!r} m: must lie above hole lower[{axis}]")
        inside = np.all((position > corners[0]) & (position < corners[1]), axis=1)
        position = position[~inside]
    if position.shape[0] == 0:
        raise ValueError("hole: covers the whole rectangle, no material point is left")
    return _body(position, cell_size, points_per_cell, start, cells)
