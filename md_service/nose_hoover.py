"""Nose-Hoover chain of thermostats (Martyna, Klein and Tuckerman, J. Chem. Phys. 97, 2635, 1992)."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

CHAIN: Final = 3  # links of the chain


def chain_half_step(
    rate: NDArray[np.float64], kinetic: float, freedoms: int, kt: float, period: float, time_step: float
) -> float:
    """Advance the chain's rates by half a time step; returns the factor for all velocities."""
    masses = kt * period**2 * np.array([freedoms] + [1] * (CHAIN - 1))
    quarter, half = 0.25 * time_step, 0.5 * time_step

    def push(link: int, energy: float) -> None:
        drive = (2.0 * energy - freedoms * kt) if link == 0 else (masses[link - 1] * rate[link - 1] ** 2 - kt)
        brake = np.exp(-0.5 * quarter * rate[link + 1]) if link + 1 < CHAIN else 1.0
        rate[link] = (rate[link] * brake + quarter * drive / masses[link]) * brake

    for link in reversed(range(CHAIN)):
        push(link, kinetic)
    scale = float(np.exp(-half * rate[0]))
    for link in range(CHAIN):
        push(link, kinetic * scale**2)
    return scale
