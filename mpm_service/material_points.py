"""Material points: how a body is filled with them and how their state is read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# Columns of the point table. One row per point keeps all a point needs in two cache lines.
X, Y, VX, VY, HXX, HXY, HYX, HYY, MASS, DX, DY = range(11)
COLUMNS = 11

# How far a rectangle may sit off a cell line, in cells: covers round-off of decimal input, nothing more.
_LINE_TOLERANCE = 1e-6

Rectangle = tuple[Sequence[float], Sequence[float]]


@dataclass(frozen=True)
class Overlap:
    """Square ring that the continuum shares with atoms, and the continuum's share there.

    Parameters
    ----------
    inner_lower, inner_upper : (2,) sequence of float
        Inner rectangle [m]; the ring lies outside it.
    outer_lower, outer_upper : (2,) sequence of float
        Outer rectangle [m]; the ring lies inside it.
    weight : float
        Factor on mass and stiffness of points in the ring, above 0 and at most 1.
    """

    inner_lower: Sequence[float]
    inner_upper: Sequence[float]
    outer_lower: Sequence[float]
    outer_upper: Sequence[float]
    weight: float

    def __post_init__(self) -> None:
        if not 0.0 < self.weight <= 1.0:
            raise ValueError(f"Overlap.weight = {self.weight!r}: must be above 0 and at most 1")
        for axis in range(2):
            if not (
                self.outer_lower[axis] <= self.inner_lower[axis] < self.inner_upper[axis] <= self.outer_upper[axis]
            ):
                raise ValueError(
                    f"Overlap, axis {axis}: outer_lower <= inner_lower < inner_upper <= outer_upper is "
                    f"needed, got {self.outer_lower[axis]!r}, {self.inner_lower[axis]!r}, "
                    f"{self.inner_upper[axis]!r}, {self.outer_upper[axis]!r}"
                )


@dataclass(frozen=True)
class Body:
    """Points of a body in its reference state.

    Attributes
    ----------
    position : (n, 2) ndarray
        Reference positions [m].
    weight : (n,) ndarray
        Share of mass and stiffness the point carries, dimensionless.
    point_size : float
        Side of a point's square domain [m].
    cell_size : float
        Side of the cell it was made for [m].
    lower, upper : (2,) ndarray
        Corners of the body [m]; its edges are these.
    """

    position: NDArray[np.float64]
    weight: NDArray[np.float64]
    point_size: float
    cell_size: float
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]

    @property
    def count(self) -> int:
        """Number of points."""
        return int(self.position.shape[0])


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


def _share_inside(
    position: NDArray[np.float64], size: float, lower: Sequence[float], upper: Sequence[float]
) -> NDArray[np.float64]:
    """Share of each point's square domain that lies inside a rectangle."""
    reach = 0.5 * size
    covered = np.minimum(position + reach, np.asarray(upper)) - np.maximum(position - reach, np.asarray(lower))
    return np.prod(np.clip(covered / size, 0.0, 1.0), axis=1)


def fill_rectangle(
    lower: Sequence[float],
    upper: Sequence[float],
    cell_size: float,
    points_per_cell: int = 2,
    hole: Rectangle | None = None,
    overlap: Overlap | None = None,
) -> Body:
    """Fill a rectangle with points at the centres of equal sub-cells.

    Parameters
    ----------
    lower, upper : (2,) sequence of float
        Corners [m]; both lie on cell lines.
    cell_size : float
        Cell side [m].
    points_per_cell : int
        Points per cell and direction.
    hole : (lower, upper), optional
        Rectangle without points, on cell lines [m].
    overlap : Overlap, optional
        Ring of reduced weight. A point across a border of the ring has the mean weight of its domain: the ring
        ends where the atoms do, which is on no cell line, and a gap of light continuum beyond the last atoms
        would be soft.

    Returns
    -------
    Body

    Raises
    ------
    ValueError
        If a corner is off the cell lines (the nearest allowed value is named) or nothing is left to fill.
    """
    if not (np.isfinite(cell_size) and cell_size > 0.0):
        raise ValueError(f"cell_size = {cell_size!r}: a positive length [m] is needed")
    if int(points_per_cell) != points_per_cell or points_per_cell < 1:
        raise ValueError(f"points_per_cell = {points_per_cell!r}: a whole number of at least 1 is needed")
    points_per_cell = int(points_per_cell)
    cells = []
    for axis in range(2):
        count = _on_line(f"upper[{axis}]", float(upper[axis]), float(lower[axis]), cell_size)
        if count < 1:
            raise ValueError(f"upper[{axis}] = {upper[axis]!r} m: must be at least one cell above lower[{axis}]")
        cells.append(count)
    start = np.array([float(lower[0]), float(lower[1])])
    x = start[0] + cell_size * (np.arange(cells[0] * points_per_cell) + 0.5) / points_per_cell
    y = start[1] + cell_size * (np.arange(cells[1] * points_per_cell) + 0.5) / points_per_cell
    xx, yy = np.meshgrid(x, y)
    position = np.stack([xx.ravel(), yy.ravel()], axis=1)
    if hole is not None:
        corners = np.array(hole, dtype=np.float64)
        for axis in range(2):
            for corner, name in enumerate(("lower", "upper")):
                _on_line(f"hole {name}[{axis}]", float(corners[corner, axis]), start[axis], cell_size)
            if not corners[0, axis] < corners[1, axis]:
                raise ValueError(f"hole upper[{axis}] = {corners[1, axis]!r} m: must lie above hole lower[{axis}]")
        inside = np.all((position > corners[0]) & (position < corners[1]), axis=1)
        position = position[~inside]
    if position.shape[0] == 0:
        raise ValueError("hole: covers the whole rectangle, no material point is left")
    point_size = cell_size / points_per_cell
    weight = np.ones(position.shape[0])
    if overlap is not None:
        shared = _share_inside(position, point_size, overlap.outer_lower, overlap.outer_upper) - _share_inside(
            position, point_size, overlap.inner_lower, overlap.inner_upper
        )
        weight -= (1.0 - overlap.weight) * shared
    return Body(
        np.ascontiguousarray(position),
        weight,
        point_size,
        float(cell_size),
        start,
        start + cell_size * np.array(cells, dtype=np.float64),
    )
