"""The ring in which continuum and atoms overlap: its borders, as polygons around the middle of a sample."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import shapely
from numpy.typing import NDArray

from coordinator.table import Corners, Point
from protocol.arrays import FloatArray

BoolArray = NDArray[np.bool_]

Shape = Literal["rectangle", "circle", "polygon"]
#: Corners that stand for a circle: the polygon's area is within 0.04 % of it.
_CIRCLE_CORNERS = 128
#: How far a ring reaches beyond the sample on a side where there is none, in extents of the sample.
_BEYOND = 2.0
#: Part of the ring's width by which a place may lie on a border: covers round-off, nothing more.
_ON_BORDER = 1e-9


class RingError(ValueError):
    """A ring that its shape does not allow."""


@dataclass(frozen=True)
class Ring:
    """Borders of an overlap, in the frame of the sample.

    Attributes
    ----------
    inner, outer : float64 array, shape (corners, 2)
        Corners in order, m; the first is not repeated.
    width : float
        Distance between the two, m.
    plain : bool
        Whether both are rectangles, with a ring on all four sides.
    """

    inner: FloatArray
    outer: FloatArray
    width: float
    plain: bool

    def inside(self, place: FloatArray) -> BoolArray:
        """Return whether places, shape (n, 2), m, lie inside the ring, where there are atoms only.

        A place on the lower or left border does, one on the upper or right border does not, as in cells.
        """
        polygon = shapely.Polygon(self.inner)
        shift = _ON_BORDER * self.width
        return np.asarray(shapely.contains_xy(polygon, place[:, 0] + shift, place[:, 1] + shift))

    def within(self, place: FloatArray) -> BoolArray:
        """Return whether places, shape (n, 2), m, lie inside the outer border or on it."""
        polygon = shapely.Polygon(self.outer).buffer(_ON_BORDER * self.width)
        return np.asarray(shapely.contains_xy(polygon, place[:, 0], place[:, 1]))

    def share(self, place: FloatArray) -> FloatArray:
        """Return s = d_inner / (d_inner + d_outer) of places in the ring, shape (n, 2): 0 inside, 1 outside of it."""
        points = shapely.points(place)
        inner, outer = (shapely.Polygon(corners) for corners in (self.inner, self.outer))
        to_inner, to_outer = shapely.distance(inner, points), shapely.distance(outer.exterior, points)
        share = to_inner / (to_inner + to_outer)
        return np.where(shapely.contains(outer, points), share, 1.0)

    def depth(self, place: FloatArray) -> FloatArray:
        """Return distances from places, shape (n, 2), to the outer border, m."""
        border = shapely.Polygon(self.outer).exterior
        return np.asarray(shapely.distance(border, shapely.points(place)), dtype=np.float64)


def rectangle_ring(inner: Corners, low: FloatArray, high: FloatArray, sides: list[str]) -> Ring:
    """Return the ring between a rectangle and the borders of a sample.

    Parameters
    ----------
    inner : Corners
        Where the ring ends inside, m.
    low, high : float64 array, shape (2,)
        Corners of the sample's material, m: where the ring ends outside.
    sides : list of str
        Where there is a ring; on the other sides both borders lie far beyond the sample.
    """
    names = (("left", "bottom"), ("right", "top"))
    beyond = _BEYOND * float(np.max(high - low))
    edges_in, edges_out = np.array(inner, dtype=np.float64), np.array([low, high], dtype=np.float64)
    widths = []
    for end, sign in ((0, -1.0), (1, 1.0)):
        for axis in (0, 1):
            if names[end][axis] in sides:
                widths.append(abs(edges_out[end, axis] - edges_in[end, axis]))
            else:
                edges_in[end, axis] = edges_out[end, axis] + sign * beyond
                edges_out[end, axis] += 2.0 * sign * beyond
    return Ring(_corners(edges_in), _corners(edges_out), float(np.mean(widths)), set(sides) == set(names[0] + names[1]))


def shaped_ring(shape: Shape, low: FloatArray, high: FloatArray, width: float, corners: list[Point] | None) -> Ring:
    """Return a ring around a circle or a polygon; its inner border lies `width` inside the outer one.

    Parameters
    ----------
    shape : {"circle", "polygon"}
    low, high : float64 array, shape (2,)
        Corners of the sample, m. A circle touches the nearest two of its sides.
    width : float
        m.
    corners : list of tuple of float
        Of the outer border of a polygon, m.

    Raises
    ------
    RingError
        Where the polygon crosses itself or reaches beyond the sample, or nothing is left inside the ring.
    """
    if shape == "circle":
        radius = 0.5 * float(np.min(high - low))
        middle = 0.5 * (low + high)
        angle = 2 * math.pi * np.arange(_CIRCLE_CORNERS) / _CIRCLE_CORNERS
        outer = middle + radius * np.column_stack([np.cos(angle), np.sin(angle)])
    else:
        assert corners is not None  # held by the scene's checks
        outer = np.array(corners, dtype=np.float64)
    polygon = shapely.Polygon(outer)
    if not polygon.is_valid:
        raise RingError(f"handshake.corners: the polygon is not simple: {shapely.is_valid_reason(polygon)}")
    over = max(float(np.max(low - outer)), float(np.max(outer - high)), 0.0)
    if over > 1e-6 * width:
        raise RingError(f"handshake.corners: the polygon reaches {over:.3g} m beyond the sample")
    inner = polygon.buffer(-width, join_style="mitre")
    if inner.is_empty or inner.geom_type != "Polygon":
        raise RingError(f"handshake.width = {width:.3g} m: nothing, or more than one piece, is left inside the ring")
    return Ring(np.array(inner.exterior.coords)[:-1], outer, width, plain=False)


def _corners(edges: FloatArray) -> FloatArray:
    (left, bottom), (right, top) = edges
    return np.array([[left, bottom], [right, bottom], [right, top], [left, top]])
