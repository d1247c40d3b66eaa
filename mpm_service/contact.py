"""Contact of crack faces, on the nodes.

At a node with several velocity fields each pair of them is parted by one crack. Where the fields approach each
other along its normal so fast that the gap between its faces would close within the step, an impulse lets them
come together just so far, and no farther once the faces touch; another one along the crack stops their sliding, or
is limited to the friction coefficient times the first. Both act on the two fields in opposite directions, so
momentum is kept exactly.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from .velocity_fields import Joints, Pairs

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Contact laws by number, in the order of ``crack_line.Contact``.
FRICTIONLESS, STICK, COULOMB = range(3)
# With three fields the pairs act on each other: rounds at most, and the change of velocity, over the largest of
# the first round, at which they end.
_ROUNDS = 50
_SETTLED = 1e-12


class Facing(NamedTuple):
    """Pairs of velocity fields of a node that a crack parts."""

    node: IntArray
    """(m, 2) rows of the left and the right field."""
    normal: FloatArray
    """(m, 2) unit normal of the crack, to its left."""
    gap: FloatArray
    """(m,) [m], not negative."""
    friction: FloatArray
    """(m,) coefficient, infinite where faces stick."""
    mark: IntArray
    """(m,) name of the pair, the same while a crack moves."""


@njit(cache=True, nogil=True)
def _parting_pair(pairs: Pairs, branch: IntArray, main: IntArray, k: int, bits: int) -> int:
    """Node-crack pair of the crack that parts two fields whose patterns differ by ``bits``.

    Where they differ by a branch and its main, the main parts them.
    """
    found = -1
    for q in range(pairs.start[k], pairs.start[k + 1]):
        if not (bits >> pairs.crack[q]) & 1:
            continue
        is_branch = False
        for j in range(branch.size):
            if branch[j] == pairs.crack[q] and (bits >> main[j]) & 1:
                is_branch = True
        if found < 0 or not is_branch:
            found = q
    return found


@njit(cache=True, nogil=True)
def press_faces(
    near_node: IntArray,
    base: int,
    capacity: int,
    pairs: Pairs,
    joints: Joints,
    pattern: IntArray,
    law: IntArray,
    friction: FloatArray,
    momentum: FloatArray,
    velocity: FloatArray,
    time_step: float,
    increment: int,
) -> float:
    """Impose contact on a table of nodal velocities.

    Parameters
    ----------
    near_node : (near,) ndarray of int
        Grid rows of the near nodes.
    law, friction : (cracks,) ndarray
        Contact law and coefficient of friction of each crack.
    momentum : (rows, 5) ndarray
        Nodal mass in column 0 [kg].
    velocity : (rows, 2 or more) ndarray
        Velocity in columns 0 and 1 [m/s].
    time_step : float
        [s]
    increment : int
        First of two columns of ``velocity`` that hold its increment over the step and change alike; 0 if none.

    Returns
    -------
    float
        Work that the impulses along the crack take out [J]: impulse times the mean of the sliding velocities at
        the step's begin and end (both those at the end if there is no increment).
    """
    taken = 0.0
    row = np.zeros(3, dtype=np.int64)
    bits = np.zeros(3, dtype=np.int64)
    for k in range(near_node.size):
        fields = 1
        row[0] = near_node[k]
        bits[0] = 0
        for slot in range(2):
            twin = base + slot * capacity + k
            if pattern[k, slot] != 0 and momentum[twin, 0] > 0.0:
                row[fields] = twin
                bits[fields] = pattern[k, slot]
                fields += 1
        # A node may lie in a gap, with material on the far sides only: its own field is then empty.
        lowest = 0 if momentum[row[0], 0] > 0.0 else 1
        if fields - lowest < 2:
            continue
        first_change = 0.0
        for turn in range(_ROUNDS if fields - lowest > 2 else 1):
            change = 0.0
            for f in range(lowest, fields):
                for g in range(f + 1, fields):
                    q = _parting_pair(pairs, joints.branch, joints.main, k, bits[f] ^ bits[g])
                    if q < 0:
                        continue
                    c = pairs.crack[q]
                    on_left = ((bits[f] >> c) & 1 == 0) == pairs.left[q]
                    left = row[f] if on_left else row[g]
                    right = row[g] if on_left else row[f]
                    nx = pairs.normal[q, 0]
                    ny = pairs.normal[q, 1]
                    dx = velocity[left, 0] - velocity[right, 0]
                    dy = velocity[left, 1] - velocity[right, 1]
                    approach = -(dx * nx + dy * ny) - max(pairs.gap[q], 0.0) / time_step
                    if not approach > 0.0:
                        continue
                    reduced = momentum[left, 0] * momentum[right, 0] / (momentum[left, 0] + momentum[right, 0])
                    press = reduced * approach
                    slide = dx * ny - dy * nx
                    drag = 0.0
                    if law[c] == STICK:
                        drag = reduced * slide
                    elif law[c] == COULOMB:
                        most = friction[c] * press
                        drag = min(max(reduced * slide, -most), most)
                    if drag != 0.0:
                        after = slide - drag / reduced
                        before = slide
                        if increment > 0:
                            before -= (velocity[left, increment] - velocity[right, increment]) * ny
                            before += (velocity[left, increment + 1] - velocity[right, increment + 1]) * nx
                        else:
                            before = after
                        taken += 0.5 * drag * (before + after)
                    ix = press * nx - drag * ny
                    iy = press * ny + drag * nx
                    change = max(change, np.hypot(ix, iy) / reduced)
                    for n, sign in ((left, 1.0 / momentum[left, 0]), (right, -1.0 / momentum[right, 0])):
                        velocity[n, 0] += sign * ix
                        velocity[n, 1] += sign * iy
                        if increment > 0:
                            velocity[n, increment] += sign * ix
                            velocity[n, increment + 1] += sign * iy
            if turn == 0:
                first_change = change
            if change <= _SETTLED * first_change:
                break
    return taken


@njit(cache=True, nogil=True)
def list_facing(
    near_node: IntArray,
    base: int,
    capacity: int,
    pairs: Pairs,
    joints: Joints,
    pattern: IntArray,
    momentum: FloatArray,
    node: IntArray,
    of_pair: IntArray,
    mark: IntArray,
) -> int:
    """List the pairs of velocity fields that a crack parts at a node, for statics; returns their number.

    ``node`` (m, 2) gets the rows of the left and the right field, ``of_pair`` (m,) the node-crack pair that holds
    normal and gap, ``mark`` (m,) a number that stays the same while the near nodes change: nine for each grid node.
    """
    made = 0
    row = np.zeros(3, dtype=np.int64)
    bits = np.zeros(3, dtype=np.int64)
    for k in range(near_node.size):
        row[0] = near_node[k]
        for slot in range(2):
            row[1 + slot] = base + slot * capacity + k
            bits[1 + slot] = pattern[k, slot]
        for f in range(3):
            for g in range(f + 1, 3):
                if (f > 0 and bits[f] == 0) or bits[g] == 0:
                    continue
                if not (momentum[row[f], 0] > 0.0 and momentum[row[g], 0] > 0.0):
                    continue
                q = _parting_pair(pairs, joints.branch, joints.main, k, bits[f] ^ bits[g])
                if q < 0:
                    continue
                on_left = ((bits[f] >> pairs.crack[q]) & 1 == 0) == pairs.left[q]
                node[made, 0] = row[f] if on_left else row[g]
                node[made, 1] = row[g] if on_left else row[f]
                of_pair[made] = q
                mark[made] = 9 * near_node[k] + 3 * f + g
                made += 1
    return made
