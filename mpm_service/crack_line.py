"""A crack as a line: what a user states, and the plane geometry of lines of straight segments."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal, get_args

import numpy as np
from numba import njit
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

Contact = Literal["frictionless", "stick", "coulomb"]


@dataclass(frozen=True)
class Crack:
    """A crack along a line of straight segments.

    The faces are free of traction while they are apart. A node exactly on the line counts as left of it, seen
    along it, and a tip exactly on a node as just short of it, which stands for a nudge of the line by less than
    any displacement.

    Parameters
    ----------
    points : (k, 2) sequence of float
        Corners of the line in the reference state [m], k of at least 2. Either end may lie outside the body; an
        end inside is a tip. An end on another crack (to a millionth of a cell) is joined to it.
    contact : {"frictionless", "stick", "coulomb"}
        What closed faces do that are pressed together: share their normal velocity; share all of it; share the
        normal one and slide against friction.
    friction : float
        Coefficient of Coulomb friction, not negative.
    growth : object, optional
        Growth law of the tips (see ``crack_growth``); without one the crack stays as it is.

    Raises
    ------
    ValueError
        If a value is not one of those allowed, or the line crosses itself.
    """

    points: Sequence[Sequence[float]] | FloatArray
    contact: Contact = "frictionless"
    friction: float = 0.0
    growth: Any = None

    def __post_init__(self) -> None:
        line = np.array(self.points, dtype=np.float64) if _is_rectangular(self.points) else np.zeros(0)
        if line.ndim != 2 or line.shape[0] < 2 or line.shape[1] != 2 or not np.all(np.isfinite(line)):
            raise ValueError(f"Crack.points = {self.points!r}: at least two points of two finite numbers are needed")
        if self.contact not in get_args(Contact):
            raise ValueError(f"Crack.contact = {self.contact!r}: allowed are {', '.join(get_args(Contact))}")
        if not (np.isfinite(self.friction) and self.friction >= 0.0):
            raise ValueError(f"Crack.friction = {self.friction!r}: must be finite and not negative")
        if self.friction > 0.0 and self.contact != "coulomb":
            raise ValueError(
                f"Crack.friction = {self.friction!r}: only contact 'coulomb' has friction, not {self.contact!r}"
            )
        check_line(line)

    @property
    def line(self) -> FloatArray:
        """Corners [m], (k, 2), a copy."""
        return np.array(self.points, dtype=np.float64)

    @property
    def length(self) -> float:
        """Length along the line [m]."""
        return float(np.hypot(*np.diff(self.line, axis=0).T).sum())


def _is_rectangular(points: Any) -> bool:
    try:
        np.array(points, dtype=np.float64)
    except (TypeError, ValueError):
        return False
    return True


def check_line(line: FloatArray) -> None:
    """Raise ValueError if a line (k, 2) has a segment without length or meets itself."""
    for g in range(line.shape[0] - 1):
        if not np.hypot(*(line[g + 1] - line[g])) > 0.0:
            raise ValueError(f"Crack.points[{g}] and [{g + 1}] = {line[g].tolist()}: the two points coincide")
    for g in range(line.shape[0] - 2):
        if _turns_back(line[g : g + 3]):
            raise ValueError(f"Crack.points[{g + 1}] = {line[g + 1].tolist()}: the line turns straight back there")
        for h in range(g + 2, line.shape[0] - 1):
            if meeting(line[g], line[g + 1], line[h], line[h + 1]) is not None:
                raise ValueError(f"Crack.points: segments {g} and {h} of the line meet each other")


def _turns_back(three: FloatArray) -> bool:
    a, b = np.diff(three, axis=0)
    return bool(abs(a[0] * b[1] - a[1] * b[0]) <= 1e-12 * np.hypot(*a) * np.hypot(*b) and a @ b < 0.0)


def meeting(a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray) -> float | None:
    """Where segment a-b first meets segment c-d, as a share of a-b, or None; parallel ones do not meet."""
    r, s, w = b - a, d - c, c - a
    across = r[0] * s[1] - r[1] * s[0]
    if across == 0.0:
        return None
    t = (w[0] * s[1] - w[1] * s[0]) / across
    u = (w[0] * r[1] - w[1] * r[0]) / across
    return float(t) if 0.0 <= t <= 1.0 and 0.0 <= u <= 1.0 else None


def meets_line(segment: FloatArray, line: FloatArray, slack: float) -> bool:
    """Does a segment (2, 2) cross a line (k, 2), touch it, or run along it, within ``slack`` [m]?"""
    corners = ((segment, 1, place) for place in line), ((line, line.shape[0] - 1, place) for place in segment)
    if any(nearest_on_line(v, 0, last, place[0], place[1])[2] <= slack for part in corners for v, last, place in part):
        return True
    return any(meeting(segment[0], segment[1], a, b) is not None for a, b in pairwise(line))


@njit(inline="always")
def crosses_odd(vertex: FloatArray, first: int, last: int, px: float, py: float, nx: float, ny: float) -> bool:
    """Does the way from p to n cross the line through vertices ``first`` to ``last`` an odd number of times?

    A way that goes in and out again ends on the side where it began. Ends of segments count as left of the way, so
    a corner that it hits is counted once.
    """
    odd = False
    wx = nx - px
    wy = ny - py
    for g in range(first, last):
        ax = vertex[g, 0]
        ay = vertex[g, 1]
        bx = vertex[g + 1, 0]
        by = vertex[g + 1, 1]
        sp = (bx - ax) * (py - ay) - (by - ay) * (px - ax)
        sn = (bx - ax) * (ny - ay) - (by - ay) * (nx - ax)
        if (sp >= 0.0) == (sn >= 0.0):
            continue
        sa = wx * (ay - py) - wy * (ax - px)
        sb = wx * (by - py) - wy * (bx - px)
        if (sa >= 0.0) != (sb >= 0.0):
            odd = not odd
    return odd


@njit(cache=True, nogil=True)
def nearest_on_line(
    vertex: FloatArray, first: int, last: int, x: float, y: float
) -> tuple[int, float, float, float, float]:
    """Nearest place on the line through vertices ``first`` to ``last``.

    Returns its segment, how far along it (0 to 1), the distance, and the tangent there: that of the segment, or
    the mean of two at a corner, so that the sign of its cross product with the way to (x, y) is the side.
    """
    best = np.inf
    segment = first
    share = 0.0
    for g in range(first, last):
        tx = vertex[g + 1, 0] - vertex[g, 0]
        ty = vertex[g + 1, 1] - vertex[g, 1]
        size = tx * tx + ty * ty
        t = 0.0
        if size > 0.0:
            t = min(max(((x - vertex[g, 0]) * tx + (y - vertex[g, 1]) * ty) / size, 0.0), 1.0)
        dx = x - vertex[g, 0] - t * tx
        dy = y - vertex[g, 1] - t * ty
        far = dx * dx + dy * dy
        if far < best:
            best = far
            segment = g
            share = t
    tx, ty = unit_tangent(vertex, segment)
    neighbour = -1
    if share == 1.0 and segment + 1 < last:
        neighbour = segment + 1
    elif share == 0.0 and segment > first:
        neighbour = segment - 1
    if neighbour >= 0:
        ux, uy = unit_tangent(vertex, neighbour)
        size = np.hypot(tx + ux, ty + uy)
        if size > 0.0:
            tx = (tx + ux) / size
            ty = (ty + uy) / size
    return segment, share, np.sqrt(best), tx, ty


@njit(cache=True, nogil=True)
def unit_tangent(vertex: FloatArray, segment: int) -> tuple[float, float]:
    """Direction of a segment; zero if it has no length."""
    tx = vertex[segment + 1, 0] - vertex[segment, 0]
    ty = vertex[segment + 1, 1] - vertex[segment, 1]
    size = np.hypot(tx, ty)
    if not size > 0.0:
        return 0.0, 0.0
    return tx / size, ty / size


@njit(cache=True, nogil=True)
def push_left(place: FloatArray, vertex: FloatArray, first: int, last: int, distance: float) -> None:
    """Move places (n, 2) that lie on the line to its left, so far that they clear it by ``distance`` [m]."""
    low_x = vertex[first : last + 1, 0].min() - distance
    high_x = vertex[first : last + 1, 0].max() + distance
    low_y = vertex[first : last + 1, 1].min() - distance
    high_y = vertex[first : last + 1, 1].max() + distance
    for p in range(place.shape[0]):
        x = place[p, 0]
        y = place[p, 1]
        if not (low_x <= x <= high_x and low_y <= y <= high_y):
            continue
        g, t, far, tx, ty = nearest_on_line(vertex, first, last, x, y)
        if far < distance:
            place[p, 0] = vertex[g, 0] + t * (vertex[g + 1, 0] - vertex[g, 0]) - distance * ty
            place[p, 1] = vertex[g, 1] + t * (vertex[g + 1, 1] - vertex[g, 1]) + distance * tx
