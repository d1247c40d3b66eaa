"""Dashpots on the nodes of a body's faces, which take up the waves that arrive there."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from .loads import FacePlaces

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@njit(cache=True, nogil=True)
def add_dashpots(
    node: IntArray,
    weight: FloatArray,
    count: IntArray,
    damper: FloatArray,
    momentum: FloatArray,
    time_step: float,
    table: FloatArray,
    touched: IntArray,
) -> int:
    """Add the mean force of nodal dashpots over the step, after all other forces; returns the nodes touched.

    ``damper`` (m, d) holds the coefficient of each place [N s/m]. A node with dashpot C and mass m under the
    force f moves as ``m v' = f - C v``, so with e = exp(-C dt / m)

        v(dt) = v(0) e + (f / C) (1 - e),

    and the force is what makes the explicit update end there. ``table`` (R, d) must be zero; on the nodes
    ``touched[:n]`` it is left with the mean force of the dashpot over C, which is minus the mean velocity [m/s].
    """
    dimension = damper.shape[1]
    found = 0
    for i in range(node.shape[0]):
        for k in range(count[i]):
            n = node[i, k]
            if weight[i, k] > 0.0:
                fresh = True
                for a in range(dimension):
                    fresh = fresh and table[n, a] == 0.0
                if fresh:
                    touched[found] = n
                    found += 1
                for a in range(dimension):
                    table[n, a] += weight[i, k] * damper[i, a]
    for i in range(found):
        n = touched[i]
        mass = momentum[n, 0]
        for a in range(dimension):
            c = table[n, a]
            if c > 0.0 and mass > 0.0:
                v = momentum[n, 1 + a] / mass
                f = momentum[n, 1 + dimension + a]
                change = -np.expm1(-c * time_step / mass) * (f / c - v)
                pull = mass * change / time_step - f
                momentum[n, 1 + dimension + a] += pull
                table[n, a] = pull / c
            else:
                table[n, a] = 0.0
    return found


@njit(cache=True, nogil=True)
def _dashpot_power(
    node: IntArray,
    weight: FloatArray,
    count: IntArray,
    damper: FloatArray,
    table: FloatArray,
    velocity: FloatArray,
    first: int,
    last: int,
) -> float:
    power = 0.0
    for i in range(first, last):
        for k in range(count[i]):
            n = node[i, k]
            for a in range(damper.shape[1]):
                power += weight[i, k] * damper[i, a] * table[n, a] * velocity[n, a]
    return power


class Dashpots:
    """Absorbing edges together: where two meet, their dashpots act on the same nodes."""

    def __init__(self, edges: list[FacePlaces], dampers: list[FloatArray]) -> None:
        self.places = FacePlaces(
            np.concatenate([p.ids for p in edges]),
            np.concatenate([p.reference for p in edges]),
            np.concatenate([p.half for p in edges]),
            np.concatenate([p.area for p in edges]),
            np.concatenate([p.axis for p in edges]),
        )
        self._damper = np.ascontiguousarray(np.concatenate(dampers))
        self._ends = np.concatenate(([0], np.cumsum([p.ids.size for p in edges])))
        self._table = np.zeros((0, self._damper.shape[1]))
        self._touched = np.zeros(0, dtype=np.int64)
        self._found = 0
        self._stencils: tuple[IntArray, FloatArray, IntArray] | None = None

    def apply(self, stencils: tuple[IntArray, FloatArray, IntArray], momentum: FloatArray, time_step: float) -> None:
        node, weight, count = stencils
        if self._table.shape[0] != momentum.shape[0]:
            self._table = np.zeros((momentum.shape[0], self._damper.shape[1]))
        else:
            self._table[self._touched[: self._found]] = 0.0
        if self._touched.size < node.size:
            self._touched = np.zeros(node.size, dtype=np.int64)
        self._found = add_dashpots(node, weight, count, self._damper, momentum, time_step, self._table, self._touched)
        self._stencils = stencils

    def power(self, edge: int, velocity: FloatArray) -> float:
        if self._stencils is None:
            return 0.0
        first, last = int(self._ends[edge]), int(self._ends[edge + 1])
        return float(_dashpot_power(*self._stencils, self._damper, self._table, velocity, first, last))
