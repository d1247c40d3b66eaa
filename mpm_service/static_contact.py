"""Closed crack faces in a static solution.

Faces that a solution would push through each other are held by stiff springs between the two velocity fields of a
node. What a spring bears is kept as a force from one iteration to the next, so in the end the springs bear nothing and
no face is pushed through (an augmented Lagrangian). Springs that would pull are let go. Faces that stick have a second
spring along the crack; with Coulomb's friction that one bears at most the coefficient times the pressing force, under
the whole load at once and not along the way it grew.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, csr_matrix

from .contact import Facing

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

# Stiffness of a spring over that of the softer of its nodes.
_STIFF = 1e4
# What counts as pushing through, over the largest displacement.
_TOUCH = 1e-9


class Springs(NamedTuple):
    """Springs between components of nodes, in the order of pairs: along the normals, then along the crack."""

    reach: csr_matrix
    """(2 m, n d) opening and sliding of the faces of nodal displacements."""
    stiffness: FloatArray
    """(2 m,) [N/m], 0 where there is none."""
    force: FloatArray
    """(2 m,) what they bear already [N]."""
    gap: FloatArray
    """(2 m,) by which they may close [m]."""


class ClosedFaces:
    """Which faces are closed, and the forces between them.

    Parameters
    ----------
    facing : Facing
    number : (R,) ndarray of int
        Number of each row of the nodal tables among n nodes.
    count : int
        n.
    before : dict
        Forces of pairs at the end of the iteration before, by `Facing.mark` [N], (2,) each.
    """

    def __init__(self, facing: Facing, number: IntArray, count: int, before: dict[int, FloatArray]) -> None:
        m = facing.mark.size
        self._facing = facing
        self._force = np.array([before.get(int(mark), np.zeros(2)) for mark in facing.mark]).reshape(m, 2)
        self._closed: BoolArray = self._force[:, 0] > 0.0
        self._slips = np.zeros(m, dtype=bool)
        self._left, self._right = number[facing.node[:, 0]], number[facing.node[:, 1]]
        along = np.stack([facing.normal[:, 1], -facing.normal[:, 0]], axis=1)
        direction = np.concatenate([facing.normal, along])  # (2 m, 2)
        spring = np.repeat(np.arange(2 * m), 4)
        left, right = np.tile(2 * self._left, 2), np.tile(2 * self._right, 2)
        place = np.stack([left, left + 1, right, right + 1], axis=1)
        value = np.concatenate([direction, -direction], axis=1)
        self._reach = csr_matrix(coo_matrix((value.ravel(), (spring, place.ravel())), shape=(2 * m, 2 * count)))

    @property
    def push(self) -> FloatArray:
        """Forces of the faces on the nodes [N], (2 n,)."""
        return np.asarray(self._reach.T @ self._force.T.ravel())

    @property
    def forces(self) -> dict[int, FloatArray]:
        """Forces of closed pairs by their marks [N]."""
        return {int(k): f for k, f, c in zip(self._facing.mark, self._force, self._closed, strict=True) if c}

    def springs(self, stiff: FloatArray) -> Springs:
        """Springs of the pairs that are closed now; ``stiff`` (n,) is the stiffness of each node [N/m]."""
        size = _STIFF * np.minimum(stiff[self._left], stiff[self._right])
        holds = self._closed & ~self._slips & (self._facing.friction > 0.0)
        borne = np.where(self._closed[:, None], self._force, 0.0)
        return Springs(
            self._reach,
            np.concatenate([np.where(self._closed, size, 0.0), np.where(holds, size, 0.0)]),
            borne.T.ravel(),
            np.concatenate([self._facing.gap, np.zeros(size.size)]),
        )

    def settle(self, springs: Springs, displacement: FloatArray) -> bool:
        """Judge a solution (2 n,) [m] with these springs: take over its forces, or close and let go others.

        Returns
        -------
        bool
            Was nothing to be changed?
        """
        m = self._closed.size
        way = springs.reach @ displacement
        force = springs.force - springs.stiffness * (way + springs.gap)
        press, drag = force[:m], force[m:]
        sticks = np.isinf(self._facing.friction)
        most = np.where(sticks, np.inf, np.where(sticks, 0.0, self._facing.friction) * np.maximum(press, 0.0))
        through = ~self._closed & (way[:m] + self._facing.gap < -_TOUCH * np.abs(displacement).max(initial=0.0))
        pulls = self._closed & (press < 0.0)
        slips = self._closed & ~self._slips & (np.abs(drag) > most)
        if np.any(through) or np.any(pulls) or np.any(slips):
            self._closed = (self._closed & ~pulls) | through
            self._slips |= slips
            self._force[pulls] = 0.0
            self._force[slips, 1] = np.sign(drag[slips]) * most[slips]
            return False
        self._force = np.where(self._closed[:, None], np.stack([press, drag], axis=1), 0.0)
        self._force[:, 1] = np.clip(self._force[:, 1], -most, most)
        return True
