"""Places of circular fibres of one size in a periodic square: random, apart from each other, and repeatable."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

_TRIES: Final = 10  # fresh starts of one seed
_SWEEPS: Final = 2000
_MARGIN: Final = 1e-4  # by which circles are pushed further apart than asked, so that the sweeps end


def place_fibres(fraction: float, fibres: int, seed: int, least_gap: float) -> NDArray[np.float64]:
    """Places of fibre axes in a periodic unit square.

    Axes start at random. Circles that overlap then push each other apart, half of the overlap each, sweep by sweep
    until none does. Random sequential placement would end at a fraction of 0.547; this reaches those of real plies.

    Parameters
    ----------
    fraction : float
        Area of the circles in the unit square.
    fibres : int
    seed : int
        Of `numpy.random.default_rng`.
    least_gap : float
        Smallest distance between the surfaces of two circles, in radii.

    Returns
    -------
    ndarray of float, shape (fibres, 2)
        In [0, 1).

    Raises
    ------
    ValueError
        If no packing was found.
    """
    radius = math.sqrt(fraction / (fibres * math.pi))
    least = (2.0 + least_gap) * radius
    generator = np.random.default_rng(seed)
    if least >= 1.0:  # a circle would overlap its own image
        raise ValueError(
            f"fraction {fraction} with {fibres} fibres and a gap of {least_gap} radii does not fit into the cell; "
            "take less of it, or a smaller gap"
        )
    for _ in range(_TRIES):
        axes = generator.random((fibres, 2))
        for _ in range(_SWEEPS):
            apart = axes[:, None] - axes
            apart -= np.round(apart)
            distance = np.hypot(apart[..., 0], apart[..., 1])
            np.fill_diagonal(distance, np.inf)
            if distance.min() >= least:
                return np.asarray(axes % 1.0, dtype=np.float64)
            overlap = np.maximum((1.0 + _MARGIN) * least - distance, 0.0)
            push = 0.5 * overlap / np.maximum(distance, 1e-12 * least)
            axes = axes + (push[..., None] * apart).sum(axis=1)
    raise ValueError(
        f"no packing of {fibres} fibres at fraction {fraction} with a gap of {least_gap} radii was found for seed "
        f"{seed}; take another seed, a smaller gap or fraction, or more fibres"
    )
