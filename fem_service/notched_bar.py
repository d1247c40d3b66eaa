"""Mesh of a bar with two half-round notches: that of a plate with a round hole, its quarters turned inside out.

A quarter of the plate has the hole at the corner where its two planes of symmetry meet. Turned over in y it has the
notch at the corner of its plane of symmetry x = 0 and its free side, as a quarter of the bar has.
"""

from __future__ import annotations

import numpy as np

from fem_service.plane_mesh import PlaneMesh, joined, mirrored, open_hole


def edge_notches(
    length: float,
    width: float,
    diameter: float,
    *,
    around: int,
    radial: int,
    growth: float = 1.0,
    beyond: int = 0,
    quadrant: bool = False,
) -> PlaneMesh:
    """A rectangle round the origin with half-round notches in the middle of its sides y = -width / 2 and width / 2.

    Parameters
    ----------
    length, width, diameter : float
        m; the length is along x and at least the width, the diameter is that of the notches, twice their depth.
    around : int
        Elements round half of a notch; even.
    radial, growth, beyond : int, float, int
        Along the rays that go out from the notch, as in `fem_service.plane_mesh.open_hole`.
    quadrant : bool
        The quarter with x and y above 0 only.

    Raises
    ------
    ValueError
        If a number is out of range.
    """
    corner = open_hole(
        length, width, diameter, around=around, radial=radial, growth=growth, beyond=beyond, quadrant=True
    )
    over = mirrored(corner, 1)
    quarter = PlaneMesh(over.nodes + np.array([0.0, 0.5 * width]), over.elements)
    if quadrant:
        return quarter
    upper = joined([quarter, mirrored(quarter, 0)])
    return joined([upper, mirrored(upper, 1)])
