"""What the engine answers."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Reference:
    """Long time average with anchors at rest, the value at t_0 that Eq 87 subtracts.

    Attributes
    ----------
    anchor_force : ndarray, shape (k, 3)
        Mean force on the continuum per anchor, N.
    ivc_force : ndarray, shape (m, 3)
        The same summed per interface volume cell, N.
    ivc_standard_error : ndarray, shape (m, 3)
        Standard error of that long mean, N.
    window_standard_deviation : ndarray, shape (m, 3)
        Standard deviation of the means of single windows, N: the standard error of one window's mean.
    temperature, temperature_inner, temperature_handshake : float
        Means over window ends, K; of all atoms, of those without and of those with an anchor.
    """

    anchor_force: NDArray[np.float64]
    ivc_force: NDArray[np.float64]
    ivc_standard_error: NDArray[np.float64]
    window_standard_deviation: NDArray[np.float64]
    temperature: float
    temperature_inner: float
    temperature_handshake: float


@dataclass(frozen=True)
class Energies:
    """Temperatures and energies at the end of a window.

    Attributes
    ----------
    temperature, temperature_inner, temperature_handshake : float
        K; of all atoms, of those without and of those with an anchor. 0 for an empty group.
    potential_energy, kinetic_energy : float
        Of all atoms, J.
    spring_energy : float
        Of the anchors' springs, J.
    anchor_work : float
        Work that springs, dampers and thermostat did on the atoms since the engine was made, J. The work of
        springs is exact, that of dampers and thermostat is LAMMPS' tally, exact to the order of the time step.
    """

    temperature: float
    temperature_inner: float
    temperature_handshake: float
    potential_energy: float
    kinetic_energy: float
    spring_energy: float
    anchor_work: float


@dataclass(frozen=True)
class Advance(Energies):
    """Answer to one coupling step.

    Attributes
    ----------
    step : int
        MD steps done since the engine was made.
    anchor_force : ndarray, shape (k, 3)
        Window mean of k (r - a) - gamma (v_a - v) minus the reference: force on the continuum, N (Eq 87).
    ivc_force : ndarray, shape (m, 3)
        The same summed per interface volume cell, N.
    ivc_standard_error : ndarray, shape (m, 3)
        Standard error of this one window's mean, N. The error of the reference is common to all windows and
        is told by `Reference`.
    """

    step: int
    anchor_force: NDArray[np.float64]
    ivc_force: NDArray[np.float64]
    ivc_standard_error: NDArray[np.float64]
