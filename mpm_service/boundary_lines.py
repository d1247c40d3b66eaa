"""The rule that imposes prescribed motion on the nodes across a face.

One grid line across a right face, in cells; ``e`` is where the face is now, ``c`` the node nearest to it::

        f          c    e     c+1
    ----o----------o----|------o----
        |<--- 1+s ----->|
                   |<-s>|

The face moves with ``v_b``. Node ``f`` is free. Every node k from ``c`` outwards follows the straight line
through the face's velocity and that of ``f``,

    v_k = v_b + r_k (v_f - v_b),    r_k = s_k / s_f,

so a point at the face sees the gradient of its neighbours inside (for s = 0: the face node moves with
``v_b``, the next one with ``2 v_b - v_f``). The forces on constrained nodes go to ``f`` by the transposed
rule, which makes the constraint do no work of its own. The same rule completes a quadratic B-spline or a
linear basis at the face, since all of them reproduce a velocity that is linear over the nodes.

A B-spline reaches one and a half cells, so the face cuts that of ``f`` even where it lies on a node, and ``p_f/m_f``
is the velocity of a place further inside than ``f``. With B-splines the free node takes its velocity from the momenta
of its line by the transposed rule too, as its acceleration from the forces,

    v_f = (m_f v_f + sum_k r_k m_k (v_k - (1 - r_k) v_b)) / (m_f + sum_k r_k^2 m_k),

which leaves velocities on the straight line as they are. The functions of linear, uGIMP and cpGIMP grids are cut where
the face is off a node only. There the sum halves errors of uGIMP but makes those of cpGIMP a hundredfold, so they all
keep ``p_f/m_f``.

A face is the set of grid lines across it, so the plane and space differ in the number of lines only. Where its
displacement is a field, each line has a place and a velocity of its own, one for each velocity field of its nodes;
these are the *entries* of a condition, while a face that moves as a whole has one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# A straight line through the domain of a point reaches at most this many nodes beyond the face.
_OUTWARD_NODES = 3
#: Velocity fields that a node may have.
FIELDS = 3


class Faces(NamedTuple):
    """Conditions in kernel form; those on nodes have axis -1, so that numbers stay those of the user's list."""

    axis: IntArray
    sign: IntArray
    component: IntArray
    normal: IntArray
    """Condition that gives the face's normal displacement, or -1."""
    first: IntArray
    """First entry of each condition."""
    lined: IntArray
    """1 where each line has entries of its own, else 0."""
    reference: FloatArray
    """Face coordinate in the reference state [m]."""
    nodes: IntArray
    """(3,) nodes in each direction, 1 for the missing one of the plane."""
    stride: IntArray
    """(3,) row distance of neighbours."""
    held: NDArray[np.uint8]
    """(grid rows, d) 1 where a node condition holds the component; (0, 0) without node conditions."""
    row: IntArray
    """Nodes of node conditions."""
    owner: IntArray
    """Node condition of each of them."""


class Place(NamedTuple):
    """Where the faces are in the current step, and how fast, by entry."""

    nearest: IntArray
    beyond: FloatArray
    before: FloatArray
    """Velocity over the step before [m/s]."""
    after: FloatArray
    """Velocity over the step to make [m/s]."""


class Lines(NamedTuple):
    """Constrained nodes, grid line by grid line; a node of a node condition is a line of its own."""

    condition: IntArray
    free: IntArray
    """Row of the free node, or -1."""
    length: IntArray
    """Constrained nodes of the line."""
    leader: IntArray
    """First line with the same free node and component: faces of two directions share it at their corner."""
    node: IntArray
    """(lines, 3) rows of the constrained nodes."""
    ratio: FloatArray
    """(lines, 3) r_k of each."""
    before: FloatArray
    """Velocity of the face over the step before [m/s]."""
    after: FloatArray
    """Velocity of the face over the step to make [m/s]."""
    force: FloatArray
    """Force on the free node with what its lines carry to it [N], at leaders."""
    inertia: FloatArray
    """Mass that moves with it [kg]."""
    carried: FloatArray
    """Momentum that a jump of the prescribed velocity takes from it [kg m/s]."""
    brought: FloatArray
    """Its momentum with what its lines bring to it [kg m/s]."""


def no_lines(capacity: int) -> Lines:
    condition, free, length, leader = (np.zeros(capacity, dtype=np.int64) for _ in range(4))
    node = np.zeros((capacity, _OUTWARD_NODES), dtype=np.int64)
    ratio = np.zeros((capacity, _OUTWARD_NODES))
    return Lines(condition, free, length, leader, node, ratio, *(np.zeros(capacity) for _ in range(6)))


@njit(cache=True, nogil=True)
def locate_faces(
    faces: Faces, place: Place, window: FloatArray, origin: FloatArray, inverse_cell: float, time_step: float
) -> None:
    """Node nearest to each moved face, how far the face lies outside of it [cells], and the velocities.

    ``window`` (3, entries) holds the displacements [m] a step ago, now, and after the step.
    """
    for k in range(faces.axis.size):
        last = faces.first[k + 1] if k + 1 < faces.axis.size else window.shape[1]
        for e in range(faces.first[k], last):
            place.before[e] = (window[1, e] - window[0, e]) / time_step
            place.after[e] = (window[2, e] - window[1, e]) / time_step
            axis = faces.axis[k]
            if axis < 0:
                continue
            at = faces.reference[k]
            if faces.normal[k] >= 0:
                at += window[1, faces.first[faces.normal[k]] + e - faces.first[k]]
            xi = (at - origin[axis]) * inverse_cell
            place.nearest[e] = int(np.floor(xi + 0.5))
            place.beyond[e] = faces.sign[k] * (xi - place.nearest[e])


@njit(inline="always")
def _entry(first: IntArray, lined: IntArray, k: int, along: int, which: int) -> int:
    """Entry of condition k for the line through node number `along` of its face and a velocity field."""
    return first[k] + lined[k] * (FIELDS * along + which)


@njit(inline="always")
def _field_row(near: IntArray, base: int, capacity: int, which: int, row: int) -> int:
    """Row of a velocity field of a grid node, or -1 where the node has no such field."""
    if which == 0:
        return row
    k = near[row]
    return base + (which - 1) * capacity + k if k >= 0 else -1


@njit(cache=True, nogil=True)
def draw_lines(
    faces: Faces,
    place: Place,
    near: IntArray,
    base: int,
    capacity: int,
    extra: int,
    momentum: FloatArray,
    lines: Lines,
) -> int:
    """Fill the table of lines with nodes that carry material; returns their number."""
    axis, sign, component, first, lined = faces.axis, faces.sign, faces.component, faces.first, faces.lined
    nodes, stride, held = faces.nodes, faces.stride, faces.held
    nearest, beyond = place.nearest, place.beyond
    condition, frees, counts, node, ratio = lines.condition, lines.free, lines.length, lines.node, lines.ratio
    corner_lines = np.empty(frees.size, dtype=np.int64)
    corners = 0
    some_held = held.size > 0
    index = np.zeros(3, dtype=np.int64)
    made = 0
    for k in range(axis.size):
        across = axis[k]
        if across < 0:
            continue
        step = sign[k]
        comp = component[k]
        low, high = (across + 1) % 3, (across + 2) % 3
        for j in range(nodes[high]):
            index[high] = j
            for i in range(nodes[low]):
                index[low] = i
                along = index[1 - across] if across < 2 else 0
                for which in range(1 + extra):
                    e = _entry(first, lined, k, along, which)
                    inner = nearest[e] - step
                    # Where faces of other directions hold the component too, the last condition has the node.
                    taken = False
                    shared = False
                    corner = False
                    for q in range(axis.size):
                        other = axis[q]
                        if component[q] != comp or other < 0:
                            continue
                        if other == across:
                            if sign[q] != step:
                                # The opposite face of a body two cells wide has the same free node.
                                opposite = nearest[_entry(first, lined, q, along, which)]
                                corner = corner or opposite - sign[q] == inner
                            continue
                        there = min(max(nearest[e], 0), nodes[across] - 1) if across < 2 else 0
                        outside = sign[q] * (index[other] - nearest[_entry(first, lined, q, there, which)])
                        shared = shared or outside >= 0
                        taken = taken or (outside >= 0 and q > k)
                        corner = corner or outside == -1
                    if taken:
                        continue
                    start = i * stride[low] + j * stride[high]
                    free = -1
                    if not shared and 0 <= inner < nodes[across]:
                        row = start + inner * stride[across]
                        if not (some_held and held[row, comp]):
                            free = _field_row(near, base, capacity, which, row)
                            if free >= 0 and not momentum[free, 0] > 0.0:
                                free = -1
                    count = 0
                    for outward in range(_OUTWARD_NODES):
                        at = nearest[e] + outward * step
                        if at < 0 or at >= nodes[across]:
                            continue
                        row = start + at * stride[across]
                        if some_held and held[row, comp]:
                            continue
                        n = _field_row(near, base, capacity, which, row)
                        if n >= 0 and momentum[n, 0] > 0.0:
                            node[made, count] = n
                            ratio[made, count] = (beyond[e] - outward) / (beyond[e] + 1.0) if free >= 0 else 0.0
                            count += 1
                    if count > 0:
                        condition[made] = k
                        frees[made] = free
                        counts[made] = count
                        lines.before[made] = place.before[e]
                        lines.after[made] = place.after[e]
                        lines.leader[made] = made
                        if corner and free >= 0:
                            for earlier in corner_lines[:corners]:
                                if frees[earlier] == free and component[condition[earlier]] == comp:
                                    lines.leader[made] = earlier
                                    break
                            corner_lines[corners] = made
                            corners += 1
                        made += 1
    for i in range(faces.row.size):
        for which in range(1 + extra):
            n = _field_row(near, base, capacity, which, faces.row[i])
            if n >= 0 and momentum[n, 0] > 0.0:
                node[made, 0] = n
                ratio[made, 0] = 0.0
                condition[made] = faces.owner[i]
                frees[made] = -1
                counts[made] = 1
                lines.before[made] = place.before[first[faces.owner[i]]]
                lines.after[made] = place.after[first[faces.owner[i]]]
                lines.leader[made] = made
                made += 1
    return made


@njit(cache=True, nogil=True)
def accelerate_lines(
    lines: Lines,
    made: int,
    component: IntArray,
    momentum: FloatArray,
    motion: FloatArray,
    time_step: float,
    keep: float,
    splines: bool,
    reaction: FloatArray,
) -> tuple[float, float]:
    """Momentum equation of the constrained and the free nodes, with reactions; returns work and loss kept."""
    dimension = motion.shape[1] // 2
    before, after = lines.before, lines.after
    reaction[:] = 0.0
    work = 0.0
    not_lost = 0.0
    for i in range(made):
        k = lines.condition[i]
        free = lines.free[i]
        if free < 0:
            continue
        pull = 1 + dimension + component[k]
        leader = lines.leader[i]
        if leader == i:
            lines.force[i] = momentum[free, pull]
            lines.inertia[i] = momentum[free, 0]
            lines.carried[i] = 0.0
            lines.brought[i] = momentum[free, 1 + component[k]]
        for c in range(lines.length[i]):
            r = lines.ratio[i, c]
            mass = momentum[lines.node[i, c], 0]
            lines.force[leader] += r * momentum[lines.node[i, c], pull]
            lines.inertia[leader] += r * r * mass
            lines.carried[leader] += r * (1.0 - r) * mass * (after[i] - before[i])
            lines.brought[leader] += r * (momentum[lines.node[i, c], 1 + component[k]] - (1.0 - r) * mass * before[i])
    for i in range(made):
        k = lines.condition[i]
        free = lines.free[i]
        comp = component[k]
        pull = 1 + dimension + comp
        old_free = before[i]
        new_free = after[i]
        if free >= 0:
            leader = lines.leader[i]
            if splines:
                old_free = lines.brought[leader] / lines.inertia[leader]
            else:
                old_free = momentum[free, 1 + comp] / momentum[free, 0]
            gain = (time_step * lines.force[leader] - lines.carried[leader]) / lines.inertia[leader]
            new_free = keep * (old_free + gain)
            motion[free, comp] = new_free
            motion[free, dimension + comp] = new_free - old_free
        for c in range(lines.length[i]):
            r = lines.ratio[i, c]
            n = lines.node[i, c]
            old = before[i] + r * (old_free - before[i])
            new = after[i] + r * (new_free - after[i])
            motion[n, comp] = new
            motion[n, dimension + comp] = new - old
            impulse = (1.0 - r) * (momentum[n, 0] * (new - old) - time_step * momentum[n, pull])
            reaction[k] += impulse
            work += 0.5 * impulse * (after[i] + before[i])
            not_lost += 0.5 * momentum[n, 0] * new * new * (1.0 / (keep * keep) - 1.0)
    reaction /= time_step
    return work, not_lost


@njit(cache=True, nogil=True)
def hold_halfway(lines: Lines, made: int, component: IntArray, keep: float, velocity: FloatArray) -> None:
    """Take from velocities halfway through a step what undamping gave the prescribed part, which is not damped."""
    share = 0.5 * (1.0 / keep - 1.0)
    for i in range(made):
        comp = component[lines.condition[i]]
        for c in range(lines.length[i]):
            velocity[lines.node[i, c], comp] -= share * (1.0 - lines.ratio[i, c]) * lines.after[i]


@njit(cache=True, nogil=True)
def _set_free(
    lines: Lines, made: int, component: IntArray, prescribed: FloatArray, momentum: FloatArray, velocity: FloatArray
) -> None:
    """Velocities of free nodes by the transposed rule, with the masses in `momentum`."""
    for i in range(made):
        k = lines.condition[i]
        free = lines.free[i]
        if free < 0:
            continue
        comp = component[k]
        leader = lines.leader[i]
        if leader == i:
            lines.inertia[i] = momentum[free, 0]
            lines.brought[i] = momentum[free, 0] * velocity[free, comp]
        for c in range(lines.length[i]):
            r = lines.ratio[i, c]
            n = lines.node[i, c]
            mass = momentum[n, 0]
            lines.inertia[leader] += r * r * mass
            lines.brought[leader] += r * mass * (velocity[n, comp] - (1.0 - r) * prescribed[i])
    for i in range(made):
        if lines.free[i] >= 0 and lines.leader[i] == i:
            velocity[lines.free[i], component[lines.condition[i]]] = lines.brought[i] / lines.inertia[i]


@njit(cache=True, nogil=True)
def impose_lines(
    lines: Lines,
    made: int,
    component: IntArray,
    prescribed: FloatArray,
    momentum: FloatArray,
    velocity: FloatArray,
    splines: bool,
) -> None:
    """Nodal velocities on the straight lines through the prescribed ones."""
    if splines:
        _set_free(lines, made, component, prescribed, momentum, velocity)
    for i in range(made):
        k = lines.condition[i]
        comp = component[k]
        inner = velocity[lines.free[i], comp] if lines.free[i] >= 0 else prescribed[i]
        for c in range(lines.length[i]):
            velocity[lines.node[i, c], comp] = prescribed[i] + lines.ratio[i, c] * (inner - prescribed[i])
