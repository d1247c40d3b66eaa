"""The explicit MUSL step (Eqs 17-24) and the loop over steps."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from .anchors import move_anchors, scatter_anchor_forces, weigh_anchors
from .boundary import EdgeSet, impose_edges, locate_edges, move_edges
from .crack import CrackFields, follow_crack, hold_faces_apart, move_crack
from .grid import Mesh
from .material_points import DX, DY
from .materials import Law
from .ordering import drop_lost, reachable_nodes, sort_points
from .transfer import deform_points, scatter_momentum, scatter_point_forces, update_points

# A node with less than this share of a full node's mass counts as empty. The share is so small because
# the force on a sliver falls with the root of its mass only: dropping more would visibly lose momentum.
_EMPTY = 1e-30


class Points(NamedTuple):
    """Point table in memory order, with the map to stable ids."""

    rows: NDArray[np.float64]
    ids: NDArray[np.int64]
    row_of: NDArray[np.int64]


class Nodes(NamedTuple):
    """Nodal tables; see ``transfer``."""

    momentum: NDArray[np.float64]
    motion: NDArray[np.float64]
    remapped: NDArray[np.float64]


class Anchors(NamedTuple):
    """Anchor tables."""

    position: NDArray[np.float64]
    local: NDArray[np.float64]
    displacement: NDArray[np.float64]
    velocity: NDArray[np.float64]
    force: NDArray[np.float64]
    node: NDArray[np.int64]
    weight: NDArray[np.float64]


class PointForces(NamedTuple):
    """Forces on material points by stable id [N]."""

    ids: NDArray[np.int64]
    force: NDArray[np.float64]


class Totals(NamedTuple):
    """Numbers that live on between calls, one-entry arrays."""

    alive: NDArray[np.int64]
    travel: NDArray[np.float64]
    """Upper bound of any point's way since the last sort [m]."""
    edge_work: NDArray[np.float64]
    interface_work: NDArray[np.float64]
    damping_loss: NDArray[np.float64]


@njit(cache=True, nogil=True)
def _clear(
    listed: NDArray[np.int64],
    momentum: NDArray[np.float64],
    motion: NDArray[np.float64],
    remapped: NDArray[np.float64],
) -> None:
    for i in range(listed.size):
        n = listed[i]
        for k in range(5):
            momentum[n, k] = 0.0
        for k in range(4):
            motion[n, k] = 0.0
        for k in range(2):
            remapped[n, k] = 0.0


@njit(cache=True, nogil=True)
def _accelerate(
    listed: NDArray[np.int64],
    momentum: NDArray[np.float64],
    motion: NDArray[np.float64],
    least: float,
    time_step: float,
    keep: float,
) -> None:
    """Old and new nodal velocity: ``(v + dt f / m) exp(-c dt)`` (Eqs 17-19)."""
    for i in range(listed.size):
        n = listed[i]
        mass = momentum[n, 0]
        if mass > least:
            inverse = 1.0 / mass
            for axis in range(2):
                old = momentum[n, 1 + axis] * inverse
                new = keep * (old + time_step * momentum[n, 3 + axis] * inverse)
                motion[n, axis] = new
                motion[n, 2 + axis] = new - old
        else:
            momentum[n, 0] = 0.0


@njit(cache=True, nogil=True)
def _divide(listed: NDArray[np.int64], momentum: NDArray[np.float64], remapped: NDArray[np.float64]) -> None:
    """Re-mapped momentum to velocity (Eq 21)."""
    for i in range(listed.size):
        n = listed[i]
        mass = momentum[n, 0]
        inverse = 1.0 / mass if mass > 0.0 else 0.0
        remapped[n, 0] *= inverse
        remapped[n, 1] *= inverse


@njit(cache=True, nogil=True)
def _kinetic(listed: NDArray[np.int64], momentum: NDArray[np.float64], motion: NDArray[np.float64]) -> float:
    """Kinetic energy of the listed nodes after the update [J]."""
    total = 0.0
    for i in range(listed.size):
        n = listed[i]
        total += 0.5 * momentum[n, 0] * (motion[n, 0] ** 2 + motion[n, 1] ** 2)
    return total


@njit(cache=True, nogil=True)
def advance_steps(
    steps: int,
    time_step: float,
    keep: float,
    full_mass: float,
    mesh: Mesh,
    law: Law,
    points: Points,
    nodes: Nodes,
    active: NDArray[np.int64],
    crack: CrackFields,
    edges: EdgeSet,
    edge_displacement: NDArray[np.float64],
    reaction: NDArray[np.float64],
    anchors: Anchors,
    loads: PointForces,
    totals: Totals,
) -> tuple[int, int, NDArray[np.int64]]:
    """Run steps; returns the steps done, the row of a runaway point or -1, and the reachable nodes.

    ``edge_displacement`` (steps + 2, conditions) begins one step before the first and ends at the end of the
    last one [m]. ``keep`` is the damping factor of a step.
    """
    rows = points.rows
    ids = points.ids
    row_of = points.row_of
    load_ids = loads.ids
    load_force = loads.force
    least = _EMPTY * full_mass
    conditions = edges.axis.size
    nearest = np.zeros(conditions, dtype=np.int64)
    beyond = np.zeros(conditions)
    velocity = np.zeros(conditions)
    velocity_before = np.zeros(conditions)
    selected = np.empty(loads.ids.size, dtype=np.int64)
    force = np.empty((loads.ids.size, 2))
    for step in range(steps):
        count = totals.alive[0]
        if totals.travel[0] >= mesh.cell_size:
            sort_points(rows, ids, row_of, count, mesh)
            active = reachable_nodes(rows, count, mesh)
            totals.travel[0] = 0.0
        if crack.on:
            follow_crack(crack, mesh)
        twins = crack.base + np.arange(crack.near_count[0])
        _clear(active, nodes.momentum, nodes.motion, nodes.remapped)
        _clear(twins, nodes.momentum, nodes.motion, nodes.remapped)

        scatter_momentum(rows, count, ids, mesh, law, crack, nodes.momentum)
        loaded = 0
        for k in range(load_ids.size):
            row = row_of[load_ids[k]]
            if row < count:
                selected[loaded] = row
                force[loaded, 0] = load_force[k, 0]
                force[loaded, 1] = load_force[k, 1]
                loaded += 1
        scatter_point_forces(rows, ids, selected[:loaded], force[:loaded], mesh, crack, nodes.momentum)
        weigh_anchors(
            anchors.position,
            anchors.displacement,
            anchors.local,
            mesh,
            crack,
            nodes.momentum,
            anchors.node,
            anchors.weight,
        )
        scatter_anchor_forces(anchors.node, anchors.weight, anchors.force, nodes.momentum)

        _accelerate(active, nodes.momentum, nodes.motion, least, time_step, keep)
        _accelerate(twins, nodes.momentum, nodes.motion, least, time_step, keep)
        for k in range(conditions):
            velocity_before[k] = (edge_displacement[step + 1, k] - edge_displacement[step, k]) / time_step
            velocity[k] = (edge_displacement[step + 2, k] - edge_displacement[step + 1, k]) / time_step
        locate_edges(edges, mesh, edge_displacement[step + 1], nearest, beyond)
        work, not_lost = move_edges(
            edges,
            mesh,
            crack,
            nodes.momentum,
            nodes.motion,
            nearest,
            beyond,
            velocity_before,
            velocity,
            time_step,
            keep,
            reaction,
        )
        totals.edge_work[0] += work
        if crack.on:
            hold_faces_apart(crack, nodes.momentum, nodes.motion, 2)
        if keep < 1.0:
            # A node's kinetic energy before damping is its energy after it over keep^2.
            after = _kinetic(active, nodes.momentum, nodes.motion)
            after += _kinetic(twins, nodes.momentum, nodes.motion)
            totals.damping_loss[0] += after * (1.0 / (keep * keep) - 1.0) - not_lost
        totals.interface_work[0] += move_anchors(
            anchors.node,
            anchors.weight,
            anchors.force,
            nodes.motion,
            time_step,
            anchors.displacement,
            anchors.velocity,
        )
        if crack.on:
            move_crack(crack, mesh, nodes.momentum, nodes.motion, time_step)

        runaway, largest = update_points(rows, count, ids, mesh, crack, nodes.motion, nodes.remapped, time_step)
        if runaway >= 0:
            return step, runaway, active
        work = 0.0
        for k in range(loaded):
            work += force[k, 0] * rows[selected[k], DX] + force[k, 1] * rows[selected[k], DY]
        totals.interface_work[0] += work
        totals.travel[0] += largest
        _divide(active, nodes.momentum, nodes.remapped)
        _divide(twins, nodes.momentum, nodes.remapped)
        impose_edges(edges, mesh, crack, nodes.momentum, nodes.remapped, nearest, beyond, velocity)
        if crack.on:
            hold_faces_apart(crack, nodes.momentum, nodes.remapped, 0)
        if deform_points(rows, count, ids, mesh, crack, nodes.remapped, time_step) > 0:
            totals.alive[0] = drop_lost(rows, ids, row_of, count, mesh)
    return steps, -1, active
