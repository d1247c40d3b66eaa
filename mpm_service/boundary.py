"""Prescribed motion of the body's straight edges.

One grid line across a right edge, in cells; ``e`` is where the edge is now, ``c`` the node nearest to it::

        f          c    e     c+1
    ----o----------o----|------o----
        |<--- 1+s ----->|
                   |<-s>|

The edge moves with ``v_b``. Node ``f`` is free. Every node k from ``c`` outwards follows the straight line
through the edge's velocity and that of ``f``,

    v_k = v_b + r_k (v_f - v_b),    r_k = s_k / s_f,

so a point at the edge sees the gradient of its neighbours inside (for s = 0: the edge node moves with
``v_b``, the next one with ``2 v_b - v_f``). The forces on constrained nodes go to ``f`` by the transposed
rule, which makes the constraint do no work of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from .crack import CrackFields
from .grid import Mesh

EDGES = ("left", "right", "bottom", "top")
# A straight line through the domain of a point reaches at most this many nodes beyond the edge.
_OUTWARD_NODES = 3


@dataclass(frozen=True)
class EdgeCondition:
    """Displacement history of one component on one edge of the body, linear between table entries.

    The condition acts at the moved edge: its place is the reference edge plus the normal displacement
    prescribed there, however far that is, while the body stays in the grid. Without a prescribed normal
    displacement on that edge it acts at the reference edge, which is right while the edge moves along its
    normal by less than about half a cell. Before the first and after the last time the displacement is held.

    Parameters
    ----------
    edge : {"left", "right", "bottom", "top"}
        Edge of the body's bounding rectangle.
    component : {0, 1}
        x or y displacement.
    times : (k,) sequence of float
        Strictly increasing [s].
    displacements : (k,) sequence of float
        [m].
    """

    edge: Literal["left", "right", "bottom", "top"]
    component: int
    times: Sequence[float] | NDArray[np.float64]
    displacements: Sequence[float] | NDArray[np.float64]

    def __post_init__(self) -> None:
        if self.edge not in EDGES:
            raise ValueError(f"EdgeCondition.edge = {self.edge!r}: allowed are {', '.join(EDGES)}")
        if self.component not in (0, 1):
            raise ValueError(f"EdgeCondition.component = {self.component!r}: allowed are 0 (x) and 1 (y)")
        times = np.asarray(self.times, dtype=np.float64)
        displacements = np.asarray(self.displacements, dtype=np.float64)
        if times.ndim != 1 or times.size == 0 or times.shape != displacements.shape:
            raise ValueError(
                "EdgeCondition.times and displacements: two lists of equal length with at least one entry "
                f"are needed, got shapes {times.shape} and {displacements.shape}"
            )
        if not (np.all(np.isfinite(times)) and np.all(np.isfinite(displacements))):
            raise ValueError("EdgeCondition.times and displacements: all entries must be finite")
        if np.any(np.diff(times) <= 0.0):
            raise ValueError("EdgeCondition.times: must increase strictly")

    @property
    def axis(self) -> int:
        """Direction of the edge's normal, 0 or 1."""
        return 0 if self.edge in ("left", "right") else 1

    @property
    def sign(self) -> int:
        """+1 where the outward normal points along the axis, else -1."""
        return 1 if self.edge in ("right", "top") else -1

    def displacement(self, time: NDArray[np.float64]) -> NDArray[np.float64]:
        """Displacement [m] at the given times [s]."""
        return np.interp(time, np.asarray(self.times), np.asarray(self.displacements))


class EdgeSet(NamedTuple):
    """All edge conditions in kernel form."""

    axis: NDArray[np.int64]
    sign: NDArray[np.int64]
    component: NDArray[np.int64]
    reference: NDArray[np.float64]
    """Edge coordinate in the reference state [m]."""
    normal: NDArray[np.int64]
    """Condition that gives the edge's normal displacement, or -1."""


def edge_set(conditions: Sequence[EdgeCondition], lower: NDArray[np.float64], upper: NDArray[np.float64]) -> EdgeSet:
    """Bring edge conditions of a body with the given corners into kernel form.

    Raises
    ------
    ValueError
        If two conditions prescribe the same component of the same edge.
    """
    seen: dict[tuple[str, int], int] = {}
    for number, condition in enumerate(conditions):
        key = (condition.edge, condition.component)
        if key in seen:
            raise ValueError(
                f"edge_conditions[{number}]: edge {condition.edge!r}, component {condition.component} is "
                f"already prescribed by edge_conditions[{seen[key]}]"
            )
        seen[key] = number
    reference = [float((upper if c.sign > 0 else lower)[c.axis]) for c in conditions]
    normal = [seen.get((c.edge, c.axis), -1) for c in conditions]
    return EdgeSet(
        np.array([c.axis for c in conditions], dtype=np.int64),
        np.array([c.sign for c in conditions], dtype=np.int64),
        np.array([c.component for c in conditions], dtype=np.int64),
        np.array(reference, dtype=np.float64),
        np.array(normal, dtype=np.int64),
    )


@njit(cache=True, nogil=True)
def locate_edges(
    edges: EdgeSet,
    mesh: Mesh,
    displacement: NDArray[np.float64],
    nearest: NDArray[np.int64],
    beyond: NDArray[np.float64],
) -> None:
    """Node nearest to each moved edge and how far the edge lies outside of it [cells]."""
    for k in range(edges.axis.size):
        place = edges.reference[k]
        if edges.normal[k] >= 0:
            place += displacement[edges.normal[k]]
        origin = mesh.origin_x if edges.axis[k] == 0 else mesh.origin_y
        xi = (place - origin) * mesh.inverse_cell
        nearest[k] = int(np.floor(xi + 0.5))
        beyond[k] = edges.sign[k] * (xi - nearest[k])


@njit(cache=True, nogil=True)
def _held(edges: EdgeSet, nearest: NDArray[np.int64], k: int, first: int, along: int, across: int) -> bool:
    """Does a condition from number ``first`` on, of another edge direction, hold this node's component?"""
    for q in range(first, edges.axis.size):
        if (
            q != k
            and edges.component[q] == edges.component[k]
            and edges.axis[q] != edges.axis[k]
            and edges.sign[q] * (along - nearest[q]) >= 0
        ):
            return True
    return False


@njit(cache=True, nogil=True)
def _stencil(
    edges: EdgeSet,
    mesh: Mesh,
    crack: CrackFields,
    mass: NDArray[np.float64],
    nearest: NDArray[np.int64],
    beyond: NDArray[np.float64],
    k: int,
    along: int,
    second_field: bool,
    node: NDArray[np.int64],
    ratio: NDArray[np.float64],
) -> tuple[int, int]:
    """Constrained nodes of one grid line, their ratios; returns their number and the free node (or -1)."""
    limit = mesh.cells_x if edges.axis[k] == 0 else mesh.cells_y
    step = edges.sign[k]
    free = -1
    across = nearest[k] - step
    if 0 <= across <= limit and not _held(edges, nearest, k, 0, along, across):
        free = across + along * mesh.stride if edges.axis[k] == 0 else along + across * mesh.stride
        if second_field:
            free = crack.base + crack.near[free] if crack.near[free] >= 0 else -1
        if free >= 0 and not mass[free, 0] > 0.0:
            free = -1
    count = 0
    for outward in range(_OUTWARD_NODES):
        across = nearest[k] + outward * step
        if across < 0 or across > limit or _held(edges, nearest, k, k + 1, along, across):
            continue
        n = across + along * mesh.stride if edges.axis[k] == 0 else along + across * mesh.stride
        if second_field:
            if crack.near[n] < 0:
                continue
            n = crack.base + crack.near[n]
        if mass[n, 0] > 0.0:
            node[count] = n
            ratio[count] = (beyond[k] - outward) / (beyond[k] + 1.0) if free >= 0 else 0.0
            count += 1
    return count, free


@njit(cache=True, nogil=True)
def move_edges(
    edges: EdgeSet,
    mesh: Mesh,
    crack: CrackFields,
    momentum: NDArray[np.float64],
    motion: NDArray[np.float64],
    nearest: NDArray[np.int64],
    beyond: NDArray[np.float64],
    velocity_before: NDArray[np.float64],
    velocity: NDArray[np.float64],
    time_step: float,
    keep: float,
    reaction: NDArray[np.float64],
) -> tuple[float, float]:
    """Impose the edge velocities in the momentum equation.

    ``momentum`` holds mass, momentum and force of each node, ``motion`` the new velocity and its increment.
    Writes ``motion`` and the reaction [N] of each condition; returns the work done by the edges and the
    damping loss that the general nodal update counts for constrained nodes but that did not happen [J].
    """
    node = np.empty(_OUTWARD_NODES, dtype=np.int64)
    ratio = np.empty(_OUTWARD_NODES)
    work = 0.0
    not_lost = 0.0
    for k in range(edges.axis.size):
        comp = edges.component[k]
        impulse = 0.0
        jump = velocity[k] - velocity_before[k]
        lines = (mesh.cells_y if edges.axis[k] == 0 else mesh.cells_x) + 1
        for along in range(lines):
            for field in range(2 if crack.on else 1):
                count, free = _stencil(edges, mesh, crack, momentum, nearest, beyond, k, along, field == 1, node, ratio)
                if count == 0:
                    continue
                before = velocity_before[k]
                after = velocity[k]
                if free >= 0:
                    before = momentum[free, 1 + comp] / momentum[free, 0]
                    force = momentum[free, 3 + comp]
                    inertia = momentum[free, 0]
                    carried = 0.0
                    for c in range(count):
                        r = ratio[c]
                        force += r * momentum[node[c], 3 + comp]
                        inertia += r * r * momentum[node[c], 0]
                        carried += r * (1.0 - r) * momentum[node[c], 0] * jump
                    after = keep * (before + (time_step * force - carried) / inertia)
                    motion[free, comp] = after
                    motion[free, 2 + comp] = after - before
                for c in range(count):
                    r = ratio[c]
                    n = node[c]
                    old = velocity_before[k] + r * (before - velocity_before[k])
                    new = velocity[k] + r * (after - velocity[k])
                    motion[n, comp] = new
                    motion[n, 2 + comp] = new - old
                    impulse += (1.0 - r) * (momentum[n, 0] * (new - old) - time_step * momentum[n, 3 + comp])
                    not_lost += 0.5 * momentum[n, 0] * new * new * (1.0 / (keep * keep) - 1.0)
        reaction[k] = impulse / time_step
        work += 0.5 * impulse * (velocity[k] + velocity_before[k])
    return work, not_lost


@njit(cache=True, nogil=True)
def impose_edges(
    edges: EdgeSet,
    mesh: Mesh,
    crack: CrackFields,
    momentum: NDArray[np.float64],
    remapped: NDArray[np.float64],
    nearest: NDArray[np.int64],
    beyond: NDArray[np.float64],
    velocity: NDArray[np.float64],
) -> None:
    """Impose the edge velocities on re-mapped nodal velocities."""
    node = np.empty(_OUTWARD_NODES, dtype=np.int64)
    ratio = np.empty(_OUTWARD_NODES)
    for k in range(edges.axis.size):
        comp = edges.component[k]
        lines = (mesh.cells_y if edges.axis[k] == 0 else mesh.cells_x) + 1
        for along in range(lines):
            for field in range(2 if crack.on else 1):
                count, free = _stencil(edges, mesh, crack, momentum, nearest, beyond, k, along, field == 1, node, ratio)
                inner = remapped[free, comp] if free >= 0 else velocity[k]
                for c in range(count):
                    remapped[node[c], comp] = velocity[k] + ratio[c] * (inner - velocity[k])
