"""The macroscopic strain of a cell under a load of which some components are strains and the others stresses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gmc_service.evaluation import Answer, Evaluator

#: Newton iterations, and the stress out of balance that ends them, over the largest stress.
_ITERATIONS: Final = 50
_CLOSED: Final = 1e-10


@dataclass(frozen=True, eq=False)
class MixedLoad:
    """For each component, order 11, 22, 33, 23, 13, 12, either its strain or its stress.

    Attributes
    ----------
    values : ndarray of float, shape (6,)
        Strain (engineering shear), or stress in Pa.
    is_stress : ndarray of bool, shape (6,)
    """

    values: NDArray[np.float64]
    is_stress: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Held:
    """A cell under a mixed load.

    Attributes
    ----------
    strain : ndarray of float, shape (6,)
        Macroscopic.
    answer : Answer
        To that strain, for the one point.
    """

    strain: NDArray[np.float64]
    answer: Answer


def hold(
    evaluator: Evaluator,
    load: MixedLoad,
    temperature: float,
    failed: NDArray[np.uint8],
    history: NDArray[np.float64],
) -> Held:
    """Find the macroscopic strain at which the given stresses act, by Newton's method with the cell's own tangent.

    Parameters
    ----------
    evaluator : Evaluator
    load : MixedLoad
    temperature : float
        K.
    failed : ndarray of uint8, shape (1, failed_bytes)
    history : ndarray of float, shape (1, history_values)
        State of the point before the load.

    Returns
    -------
    Held

    Raises
    ------
    ValueError
        If a value is not finite, or no strain carries the stresses: they are beyond what the cell can bear.
    """
    if not np.isfinite(load.values).all():
        raise ValueError(f"load is {load.values.tolist()}; every component must be finite")
    strain = np.where(load.is_stress, 0.0, load.values)
    free = np.flatnonzero(load.is_stress)
    for iteration in range(_ITERATIONS):
        try:
            answer = evaluator.evaluate(strain[None], temperature, failed, history)
        except ValueError:
            if iteration == 0:
                raise
            break  # ideal plasticity: the strain ran away
        stress, tangent = answer.stress[0], answer.tangents[answer.tangent_index[0]]
        apart = stress[free] - load.values[free]
        scale = max(np.abs(stress).max(), np.abs(load.values[free]).max(initial=0.0))
        if np.abs(apart).max(initial=0.0) <= _CLOSED * scale:
            return Held(strain, answer)
        strain = strain.copy()
        strain[free] -= np.linalg.solve(tangent[np.ix_(free, free)], apart)
    raise ValueError(
        f"load holds stresses {load.values[free].tolist()} Pa; no strain was found that carries them, so they are "
        "beyond what the cell can bear"
    )
