"""When an equilibration may end: energy and stress drift less than their standard errors."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from md_service.dynamics import Dynamics
from md_service.results import Equilibration
from md_service.statistics import settled

_BLOCKS: Final = 64  # looks in the longest equilibration
_FEWEST: Final = 32  # looks before the first decision, which the latter half of them makes


class Settler:
    """Watches energy and stress of a sample during an equilibration.

    Parameters
    ----------
    dynamics : Dynamics
        Atoms in motion.
    steps : int
        The most steps.

    Attributes
    ----------
    block : int
        Steps between two looks.
    """

    def __init__(self, dynamics: Dynamics, steps: int) -> None:
        self.block = max(10, steps // _BLOCKS)
        self._dynamics = dynamics
        self._mass = dynamics.atoms.atom_mass
        self._series: list[NDArray[np.float64]] = []
        self._settled = False

    def look(self) -> bool:
        """Take a sample; returns whether the latter half of all samples has settled."""
        virial, energy = self._dynamics.virial_and_energy()
        velocity = self._dynamics.velocity()
        kinetic = 0.5 * float(self._mass @ np.einsum("ij,ij->i", velocity, velocity))
        flux = np.einsum("i,ij,ik->jk", self._mass, velocity, velocity)
        volume = self._dynamics.atoms.atom_volume * len(self._mass)
        stress = (virial.sum(axis=0) - flux[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]) / volume
        self._series.append(np.concatenate([[float(energy.sum()) + kinetic], stress]))
        if len(self._series) < _FEWEST:
            return False
        half = self._half()
        self._settled = settled(half[:, :1]).settled and settled(half[:, 1:]).settled
        return self._settled

    def _half(self) -> NDArray[np.float64]:
        return np.array(self._series[-(len(self._series) // 2) :])

    def result(self, steps: int) -> Equilibration:
        """How it ended, after so many steps in all."""
        if len(self._series) < _FEWEST:
            return Equilibration(steps, False, np.nan, np.nan, np.full(6, np.nan), np.full(6, np.nan))
        drift = settled(self._half())
        return Equilibration(
            steps=steps,
            settled=self._settled,
            energy_drift=float(drift.drift[0]),
            energy_error=float(drift.standard_error[0]),
            stress_drift=drift.drift[1:],
            stress_error=drift.standard_error[1:],
        )
