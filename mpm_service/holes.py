"""Round holes in a body of material points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely

from .material_points import Body
from .overlap import share_inside

#: Corners of the polygon that stands for a circle; its area is that of the circle.
_CORNERS = 720
#: A point with no more than this share of its domain outside a hole is left out: round-off of decimal input.
_NEARLY = 1e-6


@dataclass(frozen=True)
class Hole:
    """A round hole.

    Parameters
    ----------
    centre : (float, float)
        [m]; the hole may reach beyond the body.
    radius : float
        [m]

    Raises
    ------
    ValueError
        If a number is not finite or the radius not positive.
    """

    centre: tuple[float, float]
    radius: float

    def __post_init__(self) -> None:
        if not np.all(np.isfinite(self.centre)):
            raise ValueError(f"hole centre = {self.centre!r}: two finite numbers [m] are needed")
        if not (np.isfinite(self.radius) and self.radius > 0.0):
            raise ValueError(f"hole radius = {self.radius!r}: a positive length [m] is needed")

    def polygon(self) -> shapely.Polygon:
        """Regular polygon of the circle's area around its centre."""
        turn = 2.0 * np.pi / _CORNERS
        reach = self.radius * np.sqrt(turn / np.sin(turn))
        angle = turn * np.arange(_CORNERS)
        return shapely.Polygon(np.asarray(self.centre) + reach * np.stack([np.cos(angle), np.sin(angle)], axis=1))


def cut_holes(body: Body, holes: Sequence[Hole]) -> Body:
    """Return a body without the points that lie in holes.

    A point whose square domain is cut by a circle keeps the share of mass and stiffness that lies outside.

    Parameters
    ----------
    body : Body
        Points of a plane body, of any sizes.
    holes : sequence of Hole
        They share no area.

    Raises
    ------
    ValueError
        If a hole lies outside the body, two meet, or no point is left.
    """
    if not holes:
        return body
    shape = shapely.box(*body.lower, *body.upper)
    polygons = [hole.polygon() for hole in holes]
    for number, polygon in enumerate(polygons):
        if not polygon.intersection(shape).area > 0.0:
            raise ValueError(f"holes[{number}]: lies outside the body")
        for other in range(number):
            if polygon.intersection(polygons[other]).area > 0.0:
                raise ValueError(f"holes[{number}]: meets holes[{other}]; holes must share no area")
    inside = np.zeros(body.count)
    every = np.arange(body.count)
    for polygon in polygons:
        shapely.prepare(polygon)
        inside += share_inside(body, every, polygon)
    kept = inside < 1.0 - _NEARLY
    if not kept.any():
        raise ValueError("holes: cover the whole body, no material point is left")
    return replace(
        body,
        position=np.ascontiguousarray(body.position[kept]),
        weight=(body.weight * (1.0 - inside))[kept],
        stiffness=None if body.stiffness is None else (body.stiffness * (1.0 - inside))[kept],
        half=body.half[kept],
        material=body.material[kept],
    )
