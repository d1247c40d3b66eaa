"""Doubly periodic cells of the composites that people model, with their fibre fraction met exactly.

Each function answers an `Architecture`: sizes of rows and columns and the phase of each subcell. Sizes are chosen so
that the fraction of fibre is the one asked for to rounding, whatever the number of subcells.

- `square_pack`: 2 x 2 with a square fibre, and the 7 x 7 and 26 x 26 cells of MAC/GMC, in which a fibre of fixed
  stair-step outline, scaled as a whole, lies in a rim of matrix.
- `hexagonal_pack` and `random_pack`: subcells of an even grid join the fibre in the order of their distance to the
  nearest fibre axis until the fraction is the nearest that the grid gives. Then rows and columns with much fibre are
  widened, or narrowed, by a factor that grows with their share of fibre, until it is exact.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from gmc_service.fibre_placement import place_fibres

FIBRE: Final = 0
MATRIX: Final = 1

#: Rows of the fibre in MAC/GMC's circular cells, sizes relative to each other; the outline has one step per row.
_OUTLINES: Final[dict[int, tuple[float, ...]]] = {
    7: (1.0, 1.0, 4.0, 1.0, 1.0),
    26: (*(_HALF := (2.0, 3.0, 4.0, 3.0, 4.0, 5.0, 5.0, 4.0, 6.0, 9.0, 7.0, 17.0)), *_HALF[::-1]),
}
_HEXAGONAL_LIMIT: Final = math.pi / (2.0 * math.sqrt(3.0))  # circles that touch
_RANDOM_LIMIT: Final = 0.7  # above it circles of one size begin to order
_CROWDED: Final = 0.72  # with gaps, that placement reaches for any seed
_TOO_MANY: Final = 1024  # subcells along one axis
_STEEPEST: Final = 64.0  # tilt beyond which no fraction is looked for
_UNEVEN: Final = 2.0  # largest row or column over the smallest, where they were even before


class OutOfRange(ValueError):
    """A value of an architecture that is not allowed.

    Attributes
    ----------
    field : str
    value : object
    allowed : str
        What it must be.
    """

    def __init__(self, field: str, value: object, allowed: str) -> None:
        super().__init__(f"{field} is {value}; it {allowed}")
        self.field, self.value, self.allowed = field, value, allowed


@dataclass(frozen=True, eq=False)
class Architecture:
    """Geometry of a repeating unit cell.

    Attributes
    ----------
    heights : ndarray of float, shape (rows,)
        Extent of each row along axis 2, m.
    widths : ndarray of float, shape (columns,)
        Extent of each column along axis 3, m.
    phase : ndarray of int64, shape (rows, columns)
        0 is the fibre (the void of `square_void`, the first layer of `layered`), 1 the matrix.
    """

    heights: NDArray[np.float64]
    widths: NDArray[np.float64]
    phase: NDArray[np.int64]

    def fraction(self, phase: int = FIBRE) -> float:
        """Share of a phase in the area of the cell."""
        inside = float(self.heights @ (self.phase == phase) @ self.widths)
        return inside / float(self.heights.sum() * self.widths.sum())


def square_pack(subcells: Literal[2, 7, 26], fraction: float, size: float = 1e-5) -> Architecture:
    """One fibre in a square cell.

    Parameters
    ----------
    subcells : {2, 7, 26}
        Rows and columns. With 2 the fibre is a square in subcell (0, 0); with 7 and 26 it is MAC/GMC's stair-step
        circle of fixed outline.
    fraction : float
        Of fibre; below 1, 52/64 = 0.8125 and 3838/69^2 = 0.80613, where fibres of neighbouring cells touch.
    size : float
        Edge of the cell, m.

    Returns
    -------
    Architecture

    Raises
    ------
    ValueError
        If a value is out of range.

    Notes
    -----
    Outlines: Bednarcyk, Arnold and others, "Practical Micromechanics of Composite Materials" (2021), cells 2, 7, 26.
    """
    if subcells == 2:
        _check_fraction(fraction, 1.0, "at 1 there is no matrix")
        edge = math.sqrt(fraction)
        sizes = _positive("size", size) * np.array([edge, 1.0 - edge])
        return Architecture(sizes, sizes.copy(), np.array([[FIBRE, MATRIX], [MATRIX, MATRIX]], dtype=np.int64))
    if subcells not in _OUTLINES:
        raise OutOfRange("subcells", subcells, "must be 2, 7 or 26")
    outline = np.array(_OUTLINES[subcells])
    outline /= outline.sum()
    from_edge = np.minimum(np.arange(len(outline)), np.arange(len(outline))[::-1])
    is_fibre = from_edge[:, None] + from_edge >= from_edge.max()
    share = float(outline @ is_fibre @ outline)
    _check_fraction(fraction, share, "there the fibres of neighbouring cells touch")
    across = math.sqrt(fraction / share)  # of the fibre, where the cell is 1
    rim = 0.5 * (1.0 - across)
    sizes = _positive("size", size) * np.array([rim, *(across * outline), rim])
    phase = np.full((subcells, subcells), MATRIX, dtype=np.int64)
    phase[1:-1, 1:-1][is_fibre] = FIBRE
    return Architecture(sizes, sizes.copy(), phase)


def hexagonal_pack(fraction: float, columns: int = 26, size: float = 1e-5) -> Architecture:
    """Fibres at the middle and the corners of a rectangle of sqrt(3) : 1, so that each has six neighbours.

    Parameters
    ----------
    fraction : float
        Of fibre; below pi / (2 sqrt(3)) = 0.9069, where circles touch.
    columns : int
        Even number of subcells along axis 3; along axis 2 there are nearly sqrt(3) times as many.
    size : float
        Extent of the cell along axis 3, which is the distance of the fibres, m.

    Returns
    -------
    Architecture

    Raises
    ------
    ValueError
        If a value is out of range.
    """
    _check_fraction(fraction, _HEXAGONAL_LIMIT, "there circles touch")
    if columns < 4 or columns > _TOO_MANY or columns % 2:
        raise OutOfRange("columns", columns, f"must be even, and 4 to {_TOO_MANY}")
    _positive("size", size)
    rows = 2 * round(0.5 * math.sqrt(3.0) * columns)
    height = math.sqrt(3.0) * size
    heights, widths = np.full(rows, height / rows), np.full(columns, size / columns)
    distance = _distance(np.array([[0.0, 0.0], [0.5 * height, 0.5 * size]]), heights, widths)
    return _filled(distance, heights, widths, fraction)


def random_pack(
    fraction: float, fibres: int, seed: int, subcells: int = 64, least_gap: float | None = None, size: float = 4e-5
) -> Architecture:
    """Circular fibres of one size at random places in a square cell that repeats in both directions.

    Parameters
    ----------
    fraction : float
        Of fibre; at most 0.7.
    fibres : int
        1 to 200.
    seed : int
        Of `numpy.random.default_rng`; one seed gives one cell.
    subcells : int
        Rows, and columns.
    least_gap : float, optional
        Smallest distance between the surfaces of two circles, in radii; 0 to 0.3. Where none is given it is a diagonal
        of a subcell, so that there is matrix between any two fibres, but no more than that circles with half of it
        around them fill 0.72 of the cell. Fibres nearer than a diagonal may share an edge in the grid.
    size : float
        Edge of the cell, m.

    Returns
    -------
    Architecture

    Raises
    ------
    ValueError
        If a value is out of range, no such packing was found, or the grid is too coarse for that fraction.
    """
    _check_fraction(fraction, _RANDOM_LIMIT, "denser packings of circles of one size are ordered", inclusive=True)
    for name, value, low, high in (("fibres", fibres, 1, 200), ("subcells", subcells, 4, _TOO_MANY)):
        if not low <= value <= high:
            raise OutOfRange(name, value, f"must be {low} to {high}")
    if seed < 0:
        raise OutOfRange("seed", seed, "must be 0 or greater")
    if least_gap is None:
        radius = math.sqrt(fraction / (fibres * math.pi))
        loose = 2.0 * (math.sqrt(_CROWDED / fraction) - 1.0)
        least_gap = min(1.001 * math.sqrt(2.0) / (subcells * radius), loose, 0.3)
    elif not 0.0 <= least_gap <= 0.3:
        raise OutOfRange("least_gap", least_gap, "must be 0 to 0.3 radii")
    _positive("size", size)
    axes = size * place_fibres(fraction, fibres, seed, least_gap)
    heights, widths = np.full(subcells, size / subcells), np.full(subcells, size / subcells)
    return _filled(_distance(axes, heights, widths), heights, widths, fraction)


def layered(fraction: float, along: Literal[2, 3] = 2, size: float = 1e-5) -> Architecture:
    """Two plane layers, of phase 0 and phase 1.

    Parameters
    ----------
    fraction : float
        Of phase 0; below 1.
    along : {2, 3}
        Axis along which the layers are stacked: 2 gives rows, 3 columns.
    size : float
        Of both layers together, m.

    Returns
    -------
    Architecture

    Raises
    ------
    ValueError
        If a value is out of range.
    """
    _check_fraction(fraction, 1.0, "at 1 there is no second layer")
    if along not in (2, 3):
        raise OutOfRange("along", along, "must be 2 or 3")
    layers = _positive("size", size) * np.array([fraction, 1.0 - fraction])
    phase = np.array([[0], [1]], dtype=np.int64)
    whole = np.array([size])
    return Architecture(layers, whole, phase) if along == 2 else Architecture(whole, layers, phase.T.copy())


def square_void(fraction: float, size: float = 1e-5) -> Architecture:
    """A square hole along axis 1 in the middle of a square cell of matrix, 3 x 3.

    Parameters
    ----------
    fraction : float
        Of the void (phase 0); below 1.
    size : float
        Edge of the cell, m.

    Returns
    -------
    Architecture

    Raises
    ------
    ValueError
        If a value is out of range.
    """
    _check_fraction(fraction, 1.0, "at 1 there is no matrix")
    edge = math.sqrt(fraction)
    sizes = _positive("size", size) * np.array([0.5 * (1.0 - edge), edge, 0.5 * (1.0 - edge)])
    phase = np.full((3, 3), MATRIX, dtype=np.int64)
    phase[1, 1] = 0
    return Architecture(sizes, sizes.copy(), phase)


def user_array(heights: Sequence[float], widths: Sequence[float], phase: Sequence[Sequence[int]]) -> Architecture:
    """Any cell.

    Parameters
    ----------
    heights, widths : sequence of float
        Extents of the rows along axis 2 and of the columns along axis 3, m.
    phase : sequence of sequences of int
        One sequence per row: the index of the material of each subcell.

    Returns
    -------
    Architecture

    Raises
    ------
    ValueError
        If the rows of `phase` are of different lengths or do not fit the sizes.
    """
    for name, sizes in (("heights", heights), ("widths", widths)):
        if not len(sizes):
            raise ValueError(f"{name} is empty; it must have at least one size")
        for value in sizes:
            _positive(name, value)
    if len(phase) != len(heights):
        raise ValueError(f"phase has {len(phase)} rows; heights has {len(heights)}, so it must have as many")
    for number, row in enumerate(phase):
        if len(row) != len(widths):
            raise ValueError(
                f"phase.{number} has {len(row)} subcells; widths has {len(widths)}, so it must have as many"
            )
    return Architecture(
        np.array(heights, dtype=np.float64), np.array(widths, dtype=np.float64), np.array(phase, dtype=np.int64)
    )


def _distance(
    axes: NDArray[np.float64], heights: NDArray[np.float64], widths: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Distance of the middle of each subcell from the nearest fibre axis in the periodic cell, (rows, columns)."""
    middle = [np.cumsum(sizes) - 0.5 * sizes for sizes in (heights, widths)]
    apart = []
    for places, middles, sizes in zip(axes.T, middle, (heights, widths), strict=True):
        period = sizes.sum()
        offset = middles - places[:, None]
        apart.append(offset - period * np.round(offset / period))
    return np.asarray(np.hypot(apart[0][:, :, None], apart[1][:, None, :]).min(axis=0), dtype=np.float64)


def _filled(
    distance: NDArray[np.float64], heights: NDArray[np.float64], widths: NDArray[np.float64], fraction: float
) -> Architecture:
    """Fill subcells of an even grid in the order of their distance to the nearest fibre, then meet the fraction."""
    # Subcells of equal distance go in together: that keeps the symmetry of the packing.
    ranked, group = np.unique(np.round(distance / heights[0], 9), return_inverse=True)
    filled = np.cumsum(np.bincount(group.reshape(-1), minlength=len(ranked))) / distance.size
    nearest = int(np.argmin(np.abs(filled - fraction)))
    is_fibre = group.reshape(distance.shape) <= nearest
    if is_fibre.all():
        raise _too_coarse(fraction, is_fibre)
    heights, widths = _met(is_fibre, heights, widths, fraction)
    return Architecture(heights, widths, np.where(is_fibre, FIBRE, MATRIX).astype(np.int64))


def _met(
    is_fibre: NDArray[np.bool_], heights: NDArray[np.float64], widths: NDArray[np.float64], fraction: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Widen rows and columns by exp(tilt * their share of fibre), periods kept, until the fraction is met."""
    row_share, column_share = is_fibre.mean(axis=1), is_fibre.mean(axis=0)

    def tilted(tilt: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        rows, columns = (
            sizes * np.exp(tilt * share) for sizes, share in ((heights, row_share), (widths, column_share))
        )
        return rows * (heights.sum() / rows.sum()), columns * (widths.sum() / columns.sum())

    def excess(tilt: float) -> float:
        rows, columns = tilted(tilt)
        return float(rows @ is_fibre @ columns) / float(rows.sum() * columns.sum()) - fraction

    low, high = -1.0, 1.0
    while excess(low) > 0.0 or excess(high) < 0.0:
        low, high = 2.0 * low, 2.0 * high
        if high > _STEEPEST:
            raise _too_coarse(fraction, is_fibre)
    while low < (middle := 0.5 * (low + high)) < high:  # bisection down to neighbouring numbers
        if excess(middle) < 0.0:
            low = middle
        else:
            high = middle
    sizes = tilted(low if abs(excess(low)) < abs(excess(high)) else high)
    if max(one.max() / one.min() for one in sizes) > _UNEVEN:
        raise _too_coarse(fraction, is_fibre)
    return sizes


def _too_coarse(fraction: float, is_fibre: NDArray[np.bool_]) -> ValueError:
    rows, columns = is_fibre.shape
    return ValueError(f"fraction {fraction} needs more than {rows} x {columns} subcells to look like circles")


def _check_fraction(value: float, limit: float, reason: str, inclusive: bool = False) -> None:
    if not (value > 0.0 and (value < limit or (inclusive and value == limit))):
        bound = "at most" if inclusive else "below"
        raise OutOfRange("fraction", value, f"must be greater than 0 and {bound} {limit:.6g} ({reason})")


def _positive(name: str, value: float) -> float:
    if not (math.isfinite(value) and value > 0.0):
        raise OutOfRange(name, value, "must be finite and greater than 0 m")
    return value
