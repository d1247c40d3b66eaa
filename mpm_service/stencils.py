"""Passes between points and nodes over tabulated stencils, in two or three dimensions.

Points near a crack or a level border, with domains wider than a cell, and all points in space touch nodes that no
fixed pattern gives. Once a step their nodes, weights and gradients are tabulated; these sweeps do over the table
what `sweeps` does on a lattice, with the same nodal tables.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from .material_points import Columns

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_OPTIONS = {"cache": True, "nogil": True, "fastmath": {"contract", "reassoc", "nsz"}}

#: Column of stress component (i, j) behind the first, by dimension.
VOIGT = {
    2: np.array([[0, 2], [2, 1]], dtype=np.int64),
    3: np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]], dtype=np.int64),
}


class Stencils(NamedTuple):
    """Nodes that the points of the rows from `first` on touch; entry k < `entries` of a point is valid."""

    first: int
    node: IntArray
    """(m, K) rows of the nodal tables."""
    weight: FloatArray
    """(m, K)"""
    gradient: FloatArray
    """(m, K, d) [1/m]"""
    entries: IntArray
    """(m,)"""


@njit(**_OPTIONS)
def scatter_state(
    rows: FloatArray, stencils: Stencils, columns: Columns, voigt: IntArray, momentum: FloatArray
) -> None:
    """Nodal mass, momentum and internal force (Eqs 11-14, 39)."""
    node = stencils.node
    weight = stencils.weight
    gradient = stencils.gradient
    count = stencils.entries
    dim = columns.dimension
    for k in range(count.size):
        p = stencils.first + k
        mass = rows[p, columns.mass]
        volume = rows[p, columns.volume]
        for e in range(count[k]):
            n = node[k, e]
            w = weight[k, e] * mass
            momentum[n, 0] += w
            for a in range(dim):
                momentum[n, 1 + a] += w * rows[p, columns.velocity + a]
                f = 0.0
                for b in range(dim):
                    f += gradient[k, e, b] * rows[p, columns.stress + voigt[a, b]]
                momentum[n, 1 + dim + a] -= f * volume


@njit(**_OPTIONS)
def scatter_filtered(
    rows: FloatArray, stencils: Stencils, columns: Columns, field: FloatArray, out: FloatArray
) -> None:
    """Momentum that a velocity field has after a way to the points and back: out += S^T m S field."""
    node = stencils.node
    weight = stencils.weight
    count = stencils.entries
    for k in range(count.size):
        mass = rows[stencils.first + k, columns.mass]
        for a in range(columns.dimension):
            u = 0.0
            for e in range(count[k]):
                u += weight[k, e] * field[node[k, e], a]
            u *= mass
            for e in range(count[k]):
                out[node[k, e], a] += weight[k, e] * u


@njit(**_OPTIONS)
def scatter_momentum(rows: FloatArray, stencils: Stencils, columns: Columns, out: FloatArray) -> None:
    """Momenta of the points on the nodes: out += S^T m v (Eq 21)."""
    node = stencils.node
    weight = stencils.weight
    count = stencils.entries
    for k in range(count.size):
        p = stencils.first + k
        for e in range(count[k]):
            w = weight[k, e] * rows[p, columns.mass]
            for a in range(columns.dimension):
                out[node[k, e], a] += w * rows[p, columns.velocity + a]


@njit(**_OPTIONS)
def update_points(
    rows: FloatArray, stencils: Stencils, columns: Columns, motion: FloatArray, keep: float, time_step: float
) -> float:
    """Velocity ``v <- keep v + S a`` and increment ``dt S v_n`` (Eqs 19-20); the largest increment [m]."""
    node = stencils.node
    weight = stencils.weight
    count = stencils.entries
    dim = columns.dimension
    largest = 0.0
    for k in range(count.size):
        p = stencils.first + k
        for a in range(dim):
            move = 0.0
            change = 0.0
            for e in range(count[k]):
                move += weight[k, e] * motion[node[k, e], a]
                change += weight[k, e] * motion[node[k, e], dim + a]
            rows[p, columns.velocity + a] = keep * rows[p, columns.velocity + a] + change
            rows[p, columns.increment + a] = time_step * move
            largest = max(largest, abs(time_step * move) if move == move else np.inf)
    return largest


@njit(**_OPTIONS)
def deform_points(
    rows: FloatArray, stencils: Stencils, columns: Columns, velocity: FloatArray, time_step: float, move: float
) -> None:
    """Deformation gradient from nodal velocities (Eqs 22-24), then positions plus ``move`` increments."""
    node = stencils.node
    gradient = stencils.gradient
    count = stencils.entries
    dim = columns.dimension
    rate = np.empty((dim, dim))
    change = np.empty((dim, dim))
    for k in range(count.size):
        p = stencils.first + k
        for a in range(dim):
            for b in range(dim):
                g = 0.0
                for e in range(count[k]):
                    g += gradient[k, e, b] * velocity[node[k, e], a]
                rate[a, b] = time_step * g
        for a in range(dim):
            for b in range(dim):
                change[a, b] = rate[a, b]
                for c in range(dim):
                    change[a, b] += rate[a, c] * rows[p, columns.gradient + c * dim + b]
        for a in range(dim):
            for b in range(dim):
                rows[p, columns.gradient + a * dim + b] += change[a, b]
            rows[p, columns.position + a] += move * rows[p, columns.increment + a]


@njit(cache=True, nogil=True)
def add_forces(node: IntArray, weight: FloatArray, count: IntArray, force: FloatArray, momentum: FloatArray) -> None:
    """Put force k [N] on the nodes of stencil k."""
    dim = force.shape[1]
    for k in range(count.size):
        for e in range(count[k]):
            for a in range(dim):
                momentum[node[k, e], 1 + dim + a] += weight[k, e] * force[k, a]


@njit(cache=True, nogil=True)
def power_of(node: IntArray, weight: FloatArray, count: IntArray, force: FloatArray, velocity: FloatArray) -> float:
    """Power [W] of forces k on the nodes of stencils k."""
    power = 0.0
    for k in range(count.size):
        for e in range(count[k]):
            for a in range(force.shape[1]):
                power += weight[k, e] * force[k, a] * velocity[node[k, e], a]
    return power


@njit(cache=True, nogil=True)
def add_forces_of(stencils: Stencils, selected: IntArray, force: FloatArray, momentum: FloatArray) -> None:
    """Put force k [N] on the nodes of row ``selected[k]`` of a stencil table."""
    node = stencils.node
    weight = stencils.weight
    count = stencils.entries
    dim = force.shape[1]
    for k in range(selected.size):
        p = selected[k]
        for e in range(count[p]):
            for a in range(dim):
                momentum[node[p, e], 1 + dim + a] += weight[p, e] * force[k, a]


@njit(cache=True, nogil=True)
def read_points(stencils: Stencils, selected: IntArray, velocity: FloatArray, out: FloatArray) -> None:
    """Nodal velocities at row ``selected[k]`` of a stencil table, into row k of ``out``."""
    node = stencils.node
    weight = stencils.weight
    count = stencils.entries
    for k in range(selected.size):
        p = selected[k]
        for a in range(out.shape[1]):
            out[k, a] = 0.0
            for e in range(count[p]):
                out[k, a] += weight[p, e] * velocity[node[p, e], a]
