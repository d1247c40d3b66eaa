"""Velocity fields at the nodes around cracks: which one material at a given place uses (CRAMP, Eqs 38-39).

The line from a point to a node crosses some of the cracks, or none. Material that crosses none shares the node's
field 0, the row of the grid node itself. Every other crossing pattern at a node gets an extra row behind the
grid's, up to two of them::

        node o  field 0: P           rows:  0 ... grid nodes ... base ... base+capacity ...
         .  /                                                    field 1      field 2
    ----/------ A                    P: {}    Q: {A}    R: {A, B}
      .  /    Q |
    R           | B

With one crack a node sees only one far side, so the two far fields of Eq 38 share one row.

Where a crack (the branch) ends at another one (the main), the pattern is read by regions: from the branch's side,
all material beyond the main is one region, whether or not the line crosses the branch too; from the other side, a
branch that meets the main goes on straight for the sake of telling its two sides apart. So a T has three fields.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from .crack_line import crosses_odd

# A way that passes a tip crosses the crack for a share of its weight, which rises from 0 to 1 over this length along
# the crack and is one half this far short of the tip [cells]. The place that counts is a third of the way from the
# point to the node. A tip that cuts ways sharply acts 0.0 to 0.6 cells (0.3 in the mean) longer than it is, in steps
# as it moves through its cell; this one 0.0 in the mean, within 0.1.
TIP_WIDTH, TIP_BACK = 0.5, 0.25
_PLACE = 1.0 / 3.0
FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


class FieldMap(NamedTuple):
    """Where the extra velocity fields of nodes near cracks live in the nodal tables.

    The row of extra field f (1 to ``extra``) of grid node n is ``base + (f - 1) * capacity + near[n]``.
    """

    near: IntArray
    """(grid rows,) number of a node among those near a crack, or -1; of size 0 without cracks."""
    base: int
    """First extra row, which is the number of grid rows."""
    capacity: int
    """Rows of each extra field."""
    extra: int
    """Extra fields a near node may have: 0, 1 or 2."""


def single_field(grid_rows: int) -> FieldMap:
    """Return the map of a grid without cracks."""
    return FieldMap(np.zeros(0, dtype=np.int64), grid_rows, 0, 0)


class Pairs(NamedTuple):
    """Node-crack pairs, grouped by near node, and what a step needs of each."""

    start: IntArray
    """(near + 1,) first pair of each near node."""
    crack: IntArray
    """(pairs,)"""
    hint: IntArray
    """(pairs,) segment of the marker line near which the node was found."""
    first_vertex: IntArray
    """(pairs,) first vertex of the reference line that a point's way to the node may cross."""
    last_vertex: IntArray
    place: FloatArray
    """(pairs, 2) the node in the crack's reference frame [m]."""
    left: NDArray[np.bool_]
    """(pairs,) is the node left of the crack, seen along it?"""
    normal: FloatArray
    """(pairs, 2) unit normal of the moved crack beside the node, to its left."""
    gap: FloatArray
    """(pairs,) opening of the crack there [m], negative where the faces run into each other."""


@njit(inline="always")
def share_past_tips(tip: FloatArray, px: float, py: float, nx: float, ny: float) -> float:
    """Share of the way from p to n that counts as crossing a crack with the tips (2, 5); see `assign_fields`."""
    share = 1.0
    for end in range(2):
        if tip[end, 4] > 0.0:
            x = px + _PLACE * (nx - px) - tip[end, 0]
            y = py + _PLACE * (ny - py) - tip[end, 1]
            ahead = (x * tip[end, 2] + y * tip[end, 3]) * tip[end, 4]
            share = min(share, max(0.0, 0.5 - (ahead + TIP_BACK) / TIP_WIDTH))
    return share


class Joints(NamedTuple):
    """Ends of cracks at or just before another crack."""

    branch: IntArray
    main: IntArray
    left: NDArray[np.bool_]
    """Does the branch lie left of the main?"""
    met: NDArray[np.bool_]
    """Does it meet the main, or end just before it?"""
    ghost: FloatArray
    """(joints, 2, 2) the straight line on which the branch would go on [m]."""


@njit(cache=True, nogil=True)
def assign_fields(
    reference: FloatArray,
    ids: IntArray,
    first: int,
    last: int,
    near: IntArray,
    base: int,
    capacity: int,
    vertex: FloatArray,
    tips: FloatArray,
    pairs: Pairs,
    joints: Joints,
    pattern: IntArray,
    stencil_node: IntArray,
    stencil_weight: FloatArray,
    stencil_gradient: FloatArray,
    stencil_count: IntArray,
) -> int:
    """Replace nodes of stencils by the rows of the velocity fields that material uses there.

    Entry ``i - first`` of the stencils belongs to material with the reference place ``reference[ids[i]]``.
    ``tips`` (cracks, 2, 5) holds place, direction and inverse cell size of both ends, zeros for one that is no tip;
    ``vertex`` goes on a cell ahead of a tip. An entry that passes a tip is divided in two, its own field's share put
    behind the others. With ``stencil_weight`` of no columns nothing is divided: the larger share takes it all.
    ``pattern`` (near, 2) holds the crossing patterns of the extra fields in use, 0 where none; new ones are added.
    Returns -1, or the near node that would need a fourth field.
    """
    start = pairs.start
    crack = pairs.crack
    first_vertex = pairs.first_vertex
    last_vertex = pairs.last_vertex
    place = pairs.place
    left = pairs.left
    branch = joints.branch
    main = joints.main
    joint_left = joints.left
    met = joints.met
    ghost = joints.ghost
    divides = stencil_weight.shape[1] > 0
    for i in range(first, last):
        px = reference[ids[i], 0]
        py = reference[ids[i], 1]
        for e in range(stencil_count[i - first]):
            k = near[stencil_node[i - first, e]]
            if k < 0:
                continue
            bits = 0
            share = 1.0
            for q in range(start[k], start[k + 1]):
                if crosses_odd(vertex, first_vertex[q], last_vertex[q], px, py, place[q, 0], place[q, 1]):
                    here = share_past_tips(tips[crack[q]], px, py, place[q, 0], place[q, 1])
                    if here >= (0.5 if not divides else 1e-12):
                        bits |= 1 << crack[q]
                        share = min(share, here)
            if bits == 0:
                continue
            if start[k + 1] - start[k] > 1:
                for j in range(branch.size):
                    if not (bits >> main[j]) & 1:
                        continue
                    beside = -1
                    on_main = -1
                    for q in range(start[k], start[k + 1]):
                        if crack[q] == main[j]:
                            on_main = q
                        elif crack[q] == branch[j]:
                            beside = q
                    if beside < 0 or on_main < 0:
                        continue
                    if left[on_main] == joint_left[j]:
                        bits &= ~(1 << branch[j])
                    elif met[j] and crosses_odd(ghost[j], 0, 1, px, py, place[beside, 0], place[beside, 1]):
                        bits ^= 1 << branch[j]
            slot = 0
            while slot < 2 and pattern[k, slot] != bits and pattern[k, slot] != 0:
                slot += 1
            if slot == 2:
                return k
            pattern[k, slot] = bits
            if divides and share < 1.0:
                rest = stencil_count[i - first]
                stencil_count[i - first] += 1
                stencil_node[i - first, rest] = stencil_node[i - first, e]
                stencil_weight[i - first, rest] = (1.0 - share) * stencil_weight[i - first, e]
                stencil_weight[i - first, e] *= share
                for a in range(2):
                    stencil_gradient[i - first, rest, a] = (1.0 - share) * stencil_gradient[i - first, e, a]
                    stencil_gradient[i - first, e, a] *= share
            stencil_node[i - first, e] = base + slot * capacity + k
    return -1
