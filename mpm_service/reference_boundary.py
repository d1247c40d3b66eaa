"""Moving edges of the reference solver: which nodes follow which, and the momentum equation under that rule."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .conditions import EdgeCondition

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Nodes outwards of the edge that points inside can touch.
OUTWARD = 3


class StraightLineRule:
    """Nodes near moving edges as functions of edge velocity and one free node each.

    A constrained node follows ``v = v_b + r (v_f - v_b)``: the straight line through the edge's velocity ``v_b`` and
    that of the first node ``f`` inside. In matrix form the nodal velocities are ``v = T v_free + (1 - T 1) v_b``, and
    the free ones obey ``T^T M T dv = T^T (dt f - M d(...)/dt)``: forces and masses go where the velocities come from.
    With B-splines the free velocities themselves come from ``T^T M T v_free = T^T M (v - (1 - T 1) v_b)``, since the
    edge cuts the function of a free node.

    Parameters
    ----------
    edges : sequence of EdgeCondition
    place : (k,) ndarray
        Where each edge is now [cells from the lowest node].
    nodes : (d,) tuple of int
        Grid nodes in each direction.
    mass : (fields, grid nodes) ndarray
        Nodal masses of the velocity fields [kg]; rows without mass are left alone.
    splines : bool
        Are the grid's functions B-splines?
    """

    def __init__(
        self,
        edges: Sequence[EdgeCondition],
        place: FloatArray,
        nodes: tuple[int, ...],
        mass: FloatArray,
        splines: bool,
    ) -> None:
        dimension = len(nodes)
        shape = (dimension, mass.size)
        self.count = len(edges)
        self.mass = mass.ravel()
        self.splines = splines
        self.condition = np.full(shape, -1, dtype=np.int64)
        self.leader = np.full(shape, -1, dtype=np.int64)
        self.ratio = np.zeros(shape)
        lattice = np.arange(mass.shape[1]).reshape(nodes, order="F")
        number = np.indices(nodes).reshape(dimension, -1, order="F")
        nearest = np.floor(place + 0.5).astype(np.int64)
        beyond = [e.sign * (place[k] - nearest[k]) for k, e in enumerate(edges)]
        behind = [e.sign * (number[e.axis] - nearest[k]) >= 0 for k, e in enumerate(edges)]

        def held(k: int, first: int) -> NDArray[np.bool_]:
            result = np.zeros(mass.shape[1], dtype=bool)
            for q in range(first, self.count):
                if edges[q].component == edges[k].component and edges[q].axis != edges[k].axis:
                    result |= behind[q]
            return result

        for k, edge in enumerate(edges):
            inner = nearest[k] - edge.sign
            others, later = held(k, 0), held(k, k + 1)
            for field in range(mass.shape[0]):
                for outward in range(OUTWARD):
                    across = nearest[k] + outward * edge.sign
                    if not 0 <= across < nodes[edge.axis]:
                        continue
                    node = lattice.take(across, edge.axis).ravel()
                    leader = np.full(node.size, -1)
                    if 0 <= inner < nodes[edge.axis]:
                        leader = lattice.take(inner, edge.axis).ravel()
                        leader = np.where((mass[field, leader] > 0.0) & ~others[leader], leader, -1)
                    mine = (mass[field, node] > 0.0) & ~later[node]
                    at = edge.component, field * mass.shape[1] + node[mine]
                    follows = leader[mine] >= 0
                    self.condition[at] = k
                    self.leader[at] = np.where(follows, field * mass.shape[1] + leader[mine], -1)
                    self.ratio[at] = np.where(follows, (beyond[k] - outward) / (beyond[k] + 1.0), 0.0)

    def impose(self, velocity: FloatArray, edge_velocity: FloatArray) -> FloatArray:
        """Return nodal velocities (R, d) that obey the rule for edge velocities (k,) [m/s]."""
        result = velocity.copy()
        for a in range(velocity.shape[1]):
            held = self.condition[a] >= 0
            edge = edge_velocity[self.condition[a, held]]
            leader, ratio = self.leader[a, held], self.ratio[a, held]
            if self.splines:
                mass, follows = self.mass[held], leader >= 0
                free = np.unique(leader[follows])
                inertia, momentum = self.mass.copy(), self.mass * velocity[:, a]
                brought = ratio * mass * (velocity[held, a] - (1.0 - ratio) * edge)
                np.add.at(inertia, leader[follows], (ratio**2 * mass)[follows])
                np.add.at(momentum, leader[follows], brought[follows])
                result[free, a] = momentum[free] / inertia[free]
            result[held, a] = edge + ratio * (result[leader, a] - edge)
        return result

    def hold_halfway(self, velocity: FloatArray, after: FloatArray, keep: float) -> None:
        """Take from velocities halfway (R, d) what undamping gave the prescribed part, which is not damped."""
        for a in range(velocity.shape[1]):
            held = np.flatnonzero(self.condition[a] >= 0)
            prescribed = (1.0 - self.ratio[a, held]) * after[self.condition[a, held]]
            velocity[held, a] -= 0.5 * (1.0 / keep - 1.0) * prescribed

    def accelerate(
        self,
        old: FloatArray,
        force: FloatArray,
        time_step: float,
        keep: float,
        before: FloatArray,
        after: FloatArray,
    ) -> tuple[FloatArray, FloatArray, FloatArray, float, float]:
        """Solve the momentum equation of a step.

        Parameters
        ----------
        old, force : (R, d) ndarray
            Nodal velocity [m/s] and force [N].
        time_step, keep : float
            [s], and the damping factor of a step.
        before, after : (k,) ndarray
            Edge velocities over the last step and this one [m/s].

        Returns
        -------
        new, increment : (R, d) ndarray
            Nodal velocity and what it grew by [m/s].
        reaction : (k,) ndarray
            Force of each edge on the body [N].
        work, loss : float
            Done by the edges, and taken out by damping [J].
        """
        new = np.zeros_like(old)
        start = self.impose(old, before)
        reaction = np.zeros(self.count)
        work = loss = 0.0
        for a in range(old.shape[1]):
            held = np.flatnonzero(self.condition[a] >= 0)
            number, leader, ratio = self.condition[a, held], self.leader[a, held], self.ratio[a, held]
            jump = (after - before)[number]
            follows = leader >= 0
            inertia, impulse = self.mass.copy(), time_step * force[:, a]
            np.add.at(inertia, leader[follows], (ratio**2 * self.mass[held])[follows])
            carried = ratio * impulse[held] - ratio * (1.0 - ratio) * self.mass[held] * jump
            np.add.at(impulse, leader[follows], carried[follows])
            full = inertia > 0.0
            new[:, a] = keep * (start[:, a] + np.divide(impulse, inertia, out=np.zeros_like(impulse), where=full))
            new[held, a] = after[number] + ratio * (new[leader, a] - after[number])
            grown = new[held, a] - start[held, a]
            pulled = (1.0 - ratio) * (self.mass[held] * grown - time_step * force[held, a])
            reaction += np.bincount(number, pulled / time_step, minlength=self.count)
            work += float(0.5 * pulled @ (before + after)[number])
            damped = self.mass * new[:, a] ** 2
            damped[held] = 0.0
            loss += float(0.5 * damped.sum() * (keep**-2 - 1.0))
        return new, new - start, reaction, work, loss
