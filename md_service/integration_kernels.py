"""Loops over atoms of `md_service.velocity_verlet`, compiled."""

from __future__ import annotations

from numba import njit


@njit(nogil=True, cache=True)
def kick_and_drift(position, velocity, force, half_kick, time_step, rows, largest):  # type: ignore[no-untyped-def]  # numba
    """Half a kick and a drift; returns the first atom that moves too far or is not finite, else -1."""
    fast = -1
    for i in rows:
        way = 0.0
        for axis in range(3):
            velocity[i, axis] += half_kick[i] * force[i, axis]
            step = time_step * velocity[i, axis]
            position[i, axis] += step
            way += step * step
        if fast < 0 and not way <= largest * largest:
            fast = i
    return fast


@njit(nogil=True, cache=True)
def kick(velocity, force, half_kick, rows):  # type: ignore[no-untyped-def]  # numba
    for i in rows:
        for axis in range(3):
            velocity[i, axis] += half_kick[i] * force[i, axis]


@njit(nogil=True, cache=True)
def add_springs(force, position, rows, stiffness, place, constant):  # type: ignore[no-untyped-def]  # numba
    for a in range(len(rows)):
        for axis in range(3):
            offset = place[a, axis] - position[rows[a], axis]
            force[rows[a], axis] += stiffness[a] * offset + constant[a, axis]


@njit(nogil=True, cache=True)
def friction(velocity, rows, mass, kept, spread, carrier, noise):  # type: ignore[no-untyped-def]  # numba
    """v = v_a + c (v - v_a) + b xi; returns the change of kinetic energy, J."""
    work = 0.0
    for a in range(len(rows)):
        i = rows[a]
        if kept[a] == 1.0:
            continue
        for axis in range(3):
            old = velocity[i, axis]
            new = carrier[a, axis] + kept[a] * (old - carrier[a, axis]) + spread[a] * noise[a, axis]
            velocity[i, axis] = new
            work += 0.5 * mass[i] * (new - old) * (new + old)
    return work


@njit(nogil=True, cache=True)
def tally(position, velocity, rows, start, sums):  # type: ignore[no-untyped-def]  # numba
    for a in range(len(rows)):
        for axis in range(3):
            sums[0, a, axis] += position[rows[a], axis] - start[a, axis]
            sums[1, a, axis] += velocity[rows[a], axis]
