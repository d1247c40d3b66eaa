"""What happens on the nodes between two sweeps over the points. `listed` are the rows in use."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# A node with less than this share of a full node's mass counts as empty. The share is so small because
# the force on a sliver falls with the root of its mass only: dropping more would visibly lose momentum.
EMPTY = 1e-30


@njit(cache=True, nogil=True)
def clear(listed: IntArray, table: FloatArray) -> None:
    """Set the listed rows to zero."""
    for i in range(listed.size):
        for k in range(table.shape[1]):
            table[listed[i], k] = 0.0


@njit(cache=True, nogil=True)
def divide(listed: IntArray, momentum: FloatArray, first: int, source: FloatArray, out: FloatArray) -> None:
    """Velocity of momenta: columns from `first` on of `source` over the nodal mass."""
    for i in range(listed.size):
        n = listed[i]
        mass = momentum[n, 0]
        inverse = 1.0 / mass if mass > 0.0 else 0.0
        for a in range(out.shape[1]):
            out[n, a] = source[n, first + a] * inverse


@njit(cache=True, nogil=True)
def drop_slivers(listed: IntArray, momentum: FloatArray, least: float) -> None:
    """Nodes of no more than the least mass count as empty."""
    for i in range(listed.size):
        if not momentum[listed[i], 0] > least:
            momentum[listed[i], 0] = 0.0


@njit(cache=True, nogil=True)
def accelerate(listed: IntArray, momentum: FloatArray, time_step: float, keep: float, motion: FloatArray) -> None:
    """Old and new nodal velocity, ``(v + dt f / m) keep`` (Eqs 17-19), as new velocity and its increment."""
    dim = motion.shape[1] // 2
    for i in range(listed.size):
        n = listed[i]
        mass = momentum[n, 0]
        inverse = 1.0 / mass if mass > 0.0 else 0.0
        for a in range(dim):
            old = momentum[n, 1 + a] * inverse
            new = keep * (old + time_step * momentum[n, 1 + dim + a] * inverse)
            motion[n, a] = new
            motion[n, dim + a] = new - old


@njit(cache=True, nogil=True)
def kinetic_energy(listed: IntArray, momentum: FloatArray, motion: FloatArray) -> float:
    """Kinetic energy of the listed nodes after the update [J]."""
    total = 0.0
    for i in range(listed.size):
        n = listed[i]
        for a in range(motion.shape[1] // 2):
            total += 0.5 * momentum[n, 0] * motion[n, a] * motion[n, a]
    return total


@njit(cache=True, nogil=True)
def keep_forces(listed: IntArray, momentum: FloatArray, velocity: FloatArray, internal: FloatArray) -> float:
    """Copy the forces out of `momentum`; returns their power at the velocities in the first columns of a table [W]."""
    dim = internal.shape[1]
    total = 0.0
    for i in range(listed.size):
        n = listed[i]
        for a in range(dim):
            force = momentum[n, 1 + dim + a]
            internal[n, a] = force
            total += force * velocity[n, a]
    return total


@njit(cache=True, nogil=True)
def power(listed: IntArray, force: FloatArray, velocity: FloatArray) -> float:
    """Power of forces (R, d) on nodes that move with the velocities in the first columns of a table [W]."""
    total = 0.0
    for i in range(listed.size):
        n = listed[i]
        for a in range(force.shape[1]):
            total += force[n, a] * velocity[n, a]
    return total


@njit(cache=True, nogil=True)
def halfway(listed: IntArray, momentum: FloatArray, motion: FloatArray, keep: float, out: FloatArray) -> float:
    """Velocities with which forces do their work in a step.

    The work of a force f on a node is ``dt f (v_old + v_new) / 2``, v_new before it is damped by ``keep``. Returns the
    gain of the nodes' kinetic energy [J].
    """
    dim = out.shape[1]
    undamped = 1.0 / keep
    gain = 0.0
    for i in range(listed.size):
        n = listed[i]
        mass = momentum[n, 0]
        for a in range(dim):
            new = motion[n, a]
            change = motion[n, dim + a]
            out[n, a] = 0.5 * (new * undamped + new - change)
            gain += mass * change * (new - 0.5 * change)
    return gain


@njit(cache=True, nogil=True)
def filter_step(
    listed: IntArray, momentum: FloatArray, start: FloatArray, returned: FloatArray, field: FloatArray
) -> None:
    """``u <- u0 + u - S+ S u``, where `returned` holds the momentum of S+ S u; clears `returned`."""
    for i in range(listed.size):
        n = listed[i]
        mass = momentum[n, 0]
        inverse = 1.0 / mass if mass > 0.0 else 0.0
        for a in range(field.shape[1]):
            field[n, a] += start[n, a] - returned[n, a] * inverse
            returned[n, a] = 0.0


@njit(cache=True, nogil=True)
def old_velocity(listed: IntArray, motion: FloatArray, out: FloatArray) -> None:
    """Velocities at the start of the step, on constrained nodes those of the constraint: new ones less increments."""
    dim = out.shape[1]
    for i in range(listed.size):
        n = listed[i]
        for a in range(dim):
            out[n, a] = motion[n, a] - motion[n, dim + a]


@njit(cache=True, nogil=True)
def copy_velocity(listed: IntArray, motion: FloatArray, out: FloatArray) -> None:
    """Copy the new velocities out of `motion`."""
    for i in range(listed.size):
        n = listed[i]
        for a in range(out.shape[1]):
            out[n, a] = motion[n, a]


@njit(cache=True, nogil=True)
def replace_motion(listed: IntArray, velocity: FloatArray, motion: FloatArray) -> None:
    """Let points both move with a velocity and take it over."""
    dim = velocity.shape[1]
    for i in range(listed.size):
        n = listed[i]
        for a in range(dim):
            motion[n, a] = velocity[n, a]
            motion[n, dim + a] = velocity[n, a]


@njit(cache=True, nogil=True)
def add_to_increment(listed: IntArray, velocity: FloatArray, motion: FloatArray) -> None:
    """Add a velocity to the increment in `motion`."""
    dim = velocity.shape[1]
    for i in range(listed.size):
        n = listed[i]
        for a in range(dim):
            motion[n, dim + a] += velocity[n, a]


@njit(cache=True, nogil=True)
def blend(listed: IntArray, other: FloatArray, share: float, velocity: FloatArray) -> None:
    """``velocity <- (1 - share) velocity + share other``."""
    for i in range(listed.size):
        n = listed[i]
        for a in range(other.shape[1]):
            velocity[n, a] = (1.0 - share) * velocity[n, a] + share * other[n, a]
