"""States of a laminate on the way to an equilibrium, and the equilibrium that an increment ends in."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fem_service.cohesive_layer import Separation
from fem_service.point_material import PointAnswer, PointState


class NotConverged(Exception):
    """An increment that found no equilibrium; a smaller one may.

    Attributes
    ----------
    iterations : int
        That it made.
    """

    def __init__(self, sentence: str, iterations: int) -> None:
        super().__init__(sentence)
        self.iterations = iterations


@dataclass(frozen=True, eq=False)
class Grips:
    """Degrees of freedom whose displacement is given, in proportion to the load.

    Attributes
    ----------
    freedoms : ndarray of int64, shape (held,)
        3 n + i is component i of node n.
    per_load : ndarray of float, shape (held,)
        Displacement at a load of 1, m.
    """

    freedoms: NDArray[np.int64]
    per_load: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """A laminate in equilibrium.

    Attributes
    ----------
    load : float
    displacement : ndarray of float, shape (nodes, 3)
        m.
    stress : ndarray of float, shape (bricks, 8, 6)
        In the axes of the laminate, Pa.
    points : PointState
        Of all integration points, by brick and point.
    layers : ndarray of float, shape (layers, 4, 2)
        Damage of the cohesive layers.
    force : float
        Work of the grips per load, N: the reaction where all of them move by one metre at a load of 1.
    iterations : int
        That it took; the last one finds the balance, so solutions are one fewer.
    residual : float
        Largest force out of balance at a free node, over the largest at any; where grips and levers feel next to
        nothing, over 1e-4 of the largest force of an element.
    viscous_energy : float
        That the viscosity of the cohesive layers has taken so far, J.
    """

    load: float
    displacement: NDArray[np.float64]
    stress: NDArray[np.float64]
    points: PointState
    layers: NDArray[np.float64]
    force: float
    iterations: int
    residual: float
    viscous_energy: float = 0.0


@dataclass(frozen=True, eq=False)
class Aim:
    """Where an increment goes, and from where."""

    start: Equilibrium
    load: float
    relaxation: float


@dataclass(frozen=True, eq=False)
class Response:
    """Forces of all elements at one displacement; `failed` is what fails at its `strain`, held back or not."""

    strain: NDArray[np.float64]  # of the points, in the axes of the plies
    failed: NDArray[np.uint8]
    answer: PointAnswer
    stress: NDArray[np.float64]
    separation: Separation | None
    force: NDArray[np.float64]
    largest: float  # by which a force out of balance is judged

    @property
    def fails_later(self) -> bool:
        """Whether points were held back that fail at this strain."""
        return not np.array_equal(self.failed, self.answer.state.failed)


def held_back(answer: PointAnswer, strain: NDArray[np.float64], points: PointState, before: Response) -> PointAnswer:
    """An answer in which points that fail anew go on as they were in the response before."""
    new = np.flatnonzero((answer.state.failed != points.failed).any(axis=1))
    if not len(new):
        return answer
    stress, failed, index = answer.stress.copy(), answer.state.failed.copy(), answer.index.copy()
    used, place = np.unique(before.answer.index[new], return_inverse=True)
    tangents = before.answer.tangents[used]
    change = strain[new] - before.strain[new]
    stress[new] = before.answer.stress[new] + np.einsum("pij,pj->pi", tangents[place], change)
    failed[new] = points.failed[new]
    index[new] = len(answer.tangents) + place
    return PointAnswer(stress, replace(answer.state, failed=failed), index, np.concatenate([answer.tangents, tangents]))
