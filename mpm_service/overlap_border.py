"""Outer borders of overlaps, and where the way of a crack tip enters one.

A tip that lies in an overlap belongs to the atoms: whoever couples the two moves it on. Outside, a tip is the
continuum's own, and its way ends where it would enter.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from .crack_line import meeting, nearest_on_line

FloatArray = NDArray[np.float64]


def distance_outside(border: FloatArray, place: FloatArray) -> float:
    """Distance of a place (2,) from a simple polygon (k, 2) [m]; negative inside, 0 on its border."""
    line = np.concatenate([border, border[:1]])
    far = float(nearest_on_line(line, 0, line.shape[0] - 1, float(place[0]), float(place[1]))[2])
    return -far if _is_inside(border, place) else far


def _is_inside(border: FloatArray, place: FloatArray) -> bool:
    """Does a ray along x from the place cross the polygon an odd number of times?"""
    x, y = place
    a, b = border, np.roll(border, -1, axis=0)
    across = (a[:, 1] > y) != (b[:, 1] > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        at = a[:, 0] + (y - a[:, 1]) * (b[:, 0] - a[:, 0]) / (b[:, 1] - a[:, 1])
    return bool(np.count_nonzero(across & (at > x)) % 2)


def way_before(border: FloatArray, place: FloatArray, step: FloatArray) -> float:
    """Share of a step (2,) from a place (2,) that stays outside a polygon (k, 2) or on its border, from the start."""
    ends = np.roll(border, -1, axis=0)
    met = [meeting(place, place + step, a, b) for a, b in zip(border, ends, strict=True)]
    shares = sorted({0.0, 1.0, *(share for share in met if share is not None)})
    for first, last in pairwise(shares):
        if _is_inside(border, place + 0.5 * (first + last) * step):
            return first
    return 1.0
