"""Minimisation by forces alone: the fast inertial relaxation engine (Bitzek et al., Phys. Rev. Lett. 97, 170201, 2006).

It needs no energies, whose rounding would stop a line search long before the forces vanish.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

_PATIENCE = 5
_GROW, _SHRINK = 1.1, 0.5
_MIXING, _LESS_MIXING = 0.1, 0.99
_LARGEST_RATIO = 20.0  # of the time step to the first one
_GIVE_UP = 500  # iterations without a smaller force: what is left is rounding


def relax(
    position: NDArray[np.float64],
    force: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    iterations: int,
    tolerance: float,
    largest_move: float,
) -> NDArray[np.float64]:
    """Positions at which the forces vanish.

    Parameters
    ----------
    position : ndarray, shape (n, 3)
        Start, m.
    force : callable
        Forces at a position, N, shape (n, 3).
    iterations : int
        The most evaluations of `force`.
    tolerance : float
        Norm of all forces at which to stop, N; it also stops when the forces have long ceased to fall.
    largest_move : float
        The most that a coordinate moves in one iteration, m.

    Returns
    -------
    ndarray, shape (n, 3)
        The best positions seen.
    """
    here = position.copy()
    pull = force(here)
    best, best_norm = here.copy(), float(np.linalg.norm(pull))
    if best_norm <= tolerance:
        return best
    velocity = np.zeros_like(here)  # of unit masses: a time step squared is a compliance, m/N
    # The first guess of the compliance comes from a probe along the force.
    probe = 1e-3 * largest_move / np.abs(pull).max()
    change = float(np.linalg.norm(force(here + probe * pull) - pull))
    first = float(np.sqrt(0.05 * probe * best_norm / change)) if change > 0.0 else float(np.sqrt(probe))
    step, mixing, downhill, stale = first, _MIXING, 0, 0
    for _ in range(max(iterations - 2, 0)):
        power = float(np.sum(pull * velocity))
        if power > 0.0:
            speed, norm = float(np.linalg.norm(velocity)), float(np.linalg.norm(pull))
            velocity = (1.0 - mixing) * velocity + mixing * (speed / norm) * pull
            downhill += 1
            if downhill > _PATIENCE:
                step, mixing = min(step * _GROW, _LARGEST_RATIO * first), mixing * _LESS_MIXING
        else:
            velocity[:] = 0.0
            step, mixing, downhill = max(step * _SHRINK, 0.02 * first), _MIXING, 0
        velocity += step * pull
        move = step * velocity
        here = here + move * min(1.0, largest_move / max(float(np.abs(move).max()), 1e-300))
        pull = force(here)
        norm = float(np.linalg.norm(pull))
        stale += 1
        if norm < best_norm:
            best, best_norm, stale = here.copy(), norm, 0
        if norm <= tolerance or stale > _GIVE_UP:
            break
    return best
