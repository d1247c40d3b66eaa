"""Overlaps of continuum and atoms: rings in which points carry part of their mass and stiffness, and holes in them.

A ring lies between two simple polygons. With d the distance to each of them, the weight of a place is::

    outside outer |            in the ring                        | inside inner
    --------------+-----------------------------------------------+-------------
          1       | w + (1 - w) p(s),  s = d_inner/(d_inner+d_outer) |      0       p = 0, s, 3 s^2 - 2 s^3 or s^n

It is the factor on mass, and on stiffness as well unless the ring has a factor of its own for that: continuum that
keeps its stiffness beside that of the atoms makes the ring stiffer along its sides, however it is tied to them.

A point has the mean over its square domain, so a ring may end anywhere: it ends where the atoms do, which is on no
cell line, and a gap of light continuum beyond the last atoms would be soft.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from .material_points import Body, Rectangle

FloatArray = NDArray[np.float64]
Profile = Literal["constant", "linear", "cubic", "power"]
Part = Literal["inner", "outer", "weight", "profile", "exponent", "stiffness"]

#: Share of a domain that is round-off of decimal input: a point with no more than that outside a hole is left out.
_NEARLY = 1e-6
#: How far polygons may cross that should touch, in extents of the outer one.
_TOUCHING = 1e-9
#: Places along each side of a domain, or of what a border leaves of it, at which a profile is read.
_PLACES = 16
#: Domains whose places are held in memory together.
_CHUNK = 1000


class OverlapError(ValueError):
    """An overlap that cannot be.

    Attributes
    ----------
    part : str
        What is wrong with it: ``inner``, ``outer``, ``weight``, ``profile``, ``exponent`` or
        ``stiffness``.
    number : int
        Which of the overlaps, where several were given.
    """

    def __init__(self, part: Part, sentence: str, number: int = 0) -> None:
        super().__init__(f"Overlap.{part}: {sentence}")
        self.part = part
        self.number = number


@dataclass(frozen=True, eq=False)
class Overlap:
    """Ring that the continuum shares with atoms; there is no continuum inside it.

    Parameters
    ----------
    inner, outer : (k, 2) array_like
        Corners of two simple polygons in order [m]; `outer` holds `inner`, and they may touch. Both may reach beyond
        the body: a ring that spans it.
    weight : float
        Factor on mass and stiffness at `inner`, above 0 and at most 1.
    profile : {"constant", "linear", "cubic", "power"}
        How the factor goes on to `outer`: not at all, or to 1.
    exponent : float
        n of the profile ``power``, at least 1.
    stiffness : float, optional
        Factor on the stiffness in all of the ring, above 0 and at most 1; absent: the weight is the factor on both.

    Raises
    ------
    OverlapError
        If a value is outside its range, a polygon is not simple, or `outer` does not hold `inner`.
    """

    inner: ArrayLike
    outer: ArrayLike
    weight: float
    profile: Profile = "constant"
    exponent: float = 1.0
    stiffness: float | None = None

    def __post_init__(self) -> None:
        if not 0.0 < self.weight <= 1.0:
            raise OverlapError("weight", f"is {self.weight!r}, must be above 0 and at most 1")
        if self.profile not in get_args(Profile):
            raise OverlapError("profile", f"is {self.profile!r}, allowed are {', '.join(get_args(Profile))}")
        if not self.exponent >= 1.0:
            raise OverlapError("exponent", f"is {self.exponent!r}, must be at least 1")
        if self.stiffness is not None and not 0.0 < self.stiffness <= 1.0:
            raise OverlapError("stiffness", f"is {self.stiffness!r}, must be above 0 and at most 1")
        inner, outer = _polygon("inner", self.inner), _polygon("outer", self.outer)
        slack = _TOUCHING * float(np.ptp(shapely.get_coordinates(outer), axis=0).max())
        if not outer.buffer(slack, join_style="mitre").covers(inner):
            outside = inner.difference(outer).representative_point()
            raise OverlapError("inner", f"reaches beyond outer, at ({outside.x:.6g}, {outside.y:.6g}) m")

    @classmethod
    def between(cls, inner: Rectangle, outer: Rectangle, weight: float) -> Overlap:
        """Return the ring of constant weight between two rectangles, each (lower, upper) [m]."""
        return cls(_corners(inner), _corners(outer), weight)

    def polygons(self) -> tuple[Any, Any]:
        """Inner and outer polygon as shapely has them, prepared."""
        pair = shapely.Polygon(np.asarray(self.inner)), shapely.Polygon(np.asarray(self.outer))
        shapely.prepare(pair)
        return pair


def cut_overlaps(body: Body, overlaps: Sequence[Overlap]) -> Body:
    """Return a body without the points that lie in holes, with the weights of the rings.

    Parameters
    ----------
    body : Body
        Points of a plane body; of any sizes.
    overlaps : sequence of Overlap
        Rings that share no area.

    Returns
    -------
    Body
        The points that are left, in their order.

    Raises
    ------
    OverlapError
        If two rings meet, the hole of one lies outside the body, or no point is left.
    """
    if not overlaps:
        return body
    if body.dimension != 2:
        raise ValueError(f"overlaps: are for plane bodies, this one has {body.dimension} dimensions")
    _check_places(body, overlaps)
    missing = np.zeros(body.count)
    soft = np.zeros(body.count)
    hole = np.zeros(body.count)
    for overlap in overlaps:
        inner, outer = overlap.polygons()
        near = _near(body, outer)
        inside = share_inside(body, near, inner)
        ring = np.maximum(share_inside(body, near, outer) - inside, 0.0)
        hole[near] += inside
        weight = _mean_weight(body, near, ring, overlap)
        missing[near] += inside + ring * (1.0 - weight)
        soft[near] += inside + ring * (1.0 - (weight if overlap.stiffness is None else overlap.stiffness))
    kept = hole < 1.0 - _NEARLY
    if not kept.any():
        raise OverlapError("inner", "covers the whole body, no material point is left")
    return replace(
        body,
        position=np.ascontiguousarray(body.position[kept]),
        weight=(body.weight * (1.0 - missing))[kept],
        stiffness=(body.stiffness_share * (1.0 - soft))[kept],
        half=body.half[kept],
        material=body.material[kept],
    )


def _polygon(part: Part, corners: ArrayLike) -> Any:
    """Check corners and return their polygon."""
    place = np.asarray(corners, dtype=np.float64)
    if place.ndim != 2 or place.shape[0] < 3 or place.shape[1] != 2:
        raise OverlapError(part, f"has shape {place.shape}, at least three corners x, y are needed")
    if not np.all(np.isfinite(place)):
        raise OverlapError(part, "has corners that are not finite")
    polygon = shapely.Polygon(place)
    if not polygon.is_valid:
        raise OverlapError(part, f"is not a simple polygon: {shapely.is_valid_reason(polygon)} (m)")
    return polygon


def _corners(rectangle: Rectangle) -> FloatArray:
    (left, bottom), (right, top) = rectangle
    return np.array([[left, bottom], [right, bottom], [right, top], [left, top]], dtype=np.float64)


def _check_places(body: Body, overlaps: Sequence[Overlap]) -> None:
    """Refuse holes outside the body and rings that meet."""
    shape = shapely.box(*body.lower, *body.upper)
    least = (_TOUCHING * float(np.max(body.upper - body.lower))) * float(body.half.min())
    outers: list[Any] = []
    for number, overlap in enumerate(overlaps):
        inner, outer = overlap.polygons()
        if not inner.intersection(shape).area > least:
            raise OverlapError("inner", "lies outside the body", number)
        for other, earlier in enumerate(outers):
            if outer.intersection(earlier).area > least:
                raise OverlapError("outer", f"ring {number} meets ring {other}; rings must share no area", number)
        outers.append(outer)


def _near(body: Body, polygon: Any) -> NDArray[np.int64]:
    """Points whose domains reach into the bounding box of a polygon."""
    low, high = np.split(np.asarray(polygon.bounds), 2)
    reach = body.half[:, None]
    return np.flatnonzero(np.all((body.position + reach > low) & (body.position - reach < high), axis=1))


def share_inside(body: Body, points: NDArray[np.int64], polygon: Any) -> FloatArray:
    """Share of each point's domain that lies in a polygon; exactly 0 or 1 within round-off of input."""
    place, half, boxes = body.position[points], body.half[points], _boxes(body, points)
    border = polygon.boundary
    shapely.prepare(border)
    cut = np.flatnonzero(shapely.intersects(border, boxes))
    share = np.asarray(shapely.contains_xy(polygon, place[:, 0], place[:, 1]), dtype=np.float64)
    share[cut] = shapely.area(shapely.intersection(boxes[cut], polygon)) / (2.0 * half[cut]) ** 2
    share[share < _NEARLY] = 0.0
    share[share > 1.0 - _NEARLY] = 1.0
    return share


def _mean_weight(body: Body, points: NDArray[np.int64], ring: FloatArray, overlap: Overlap) -> FloatArray:
    """Mean weight over that part of each point's domain that lies in the ring; `ring` is its share."""
    mean = np.full(points.size, overlap.weight)
    if overlap.profile == "constant":
        return mean
    inner, outer = overlap.polygons()
    step = (np.arange(_PLACES) + 0.5) / _PLACES
    y, x = (axis.ravel() for axis in np.meshgrid(step, step, indexing="ij"))
    reached = np.flatnonzero(ring > 0.0)
    for some in np.array_split(reached, -(-reached.size // _CHUNK)) if reached.size else ():
        left, bottom, right, top = shapely.bounds(
            shapely.intersection(_boxes(body, points[some]), outer.difference(inner))
        ).T[:, :, None]
        at_x, at_y = left + (right - left) * x, bottom + (top - bottom) * y
        there = shapely.points(at_x, at_y)
        to_inner = np.asarray(shapely.distance(inner, there))  # 0 inside
        to_outer = np.asarray(shapely.distance(outer.exterior, there))
        beyond = ~np.asarray(shapely.contains_xy(outer, at_x, at_y))
        both = to_inner + to_outer
        s = np.divide(to_inner, both, out=np.zeros_like(both), where=both > 0.0)
        s[beyond] = 1.0
        inside = (to_inner > 0.0) & ~beyond
        inside[~inside.any(axis=1)] = True  # a sliver between the places: it lies where s is 0 or 1
        exponent = overlap.exponent if overlap.profile == "power" else 1.0
        value = s * s * (3.0 - 2.0 * s) if overlap.profile == "cubic" else s**exponent
        mean[some] += (1.0 - overlap.weight) * np.average(value, axis=1, weights=inside)
    return mean


def _boxes(body: Body, points: NDArray[np.int64]) -> Any:
    low = body.position[points] - body.half[points, None]
    high = body.position[points] + body.half[points, None]
    return shapely.box(low[:, 0], low[:, 1], high[:, 0], high[:, 1])
