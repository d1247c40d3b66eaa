"""What the engine answers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Equilibration:
    """How an equilibration ended.

    Attributes
    ----------
    steps : int
        MD steps done, or iterations of the minimiser at 0 K.
    settled : bool or None
        Whether energy and stress drifted less than their standard errors; None if that was not asked for.
    energy_drift, energy_error : float
        Rise of the total energy over the last part and its standard error, J; 0 where not asked for.
    stress_drift, stress_error : ndarray, shape (6,)
        The same of the mean stress of the sample, Pa, as xx, yy, zz, xy, xz, yz.
    """

    steps: int
    settled: bool | None
    energy_drift: float
    energy_error: float
    stress_drift: NDArray[np.float64]
    stress_error: NDArray[np.float64]


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
    temperature_error : float
        Standard error of `temperature`, K.
    """

    anchor_force: NDArray[np.float64]
    ivc_force: NDArray[np.float64]
    ivc_standard_error: NDArray[np.float64]
    window_standard_deviation: NDArray[np.float64]
    temperature: float
    temperature_inner: float
    temperature_handshake: float
    temperature_error: float


@dataclass(frozen=True)
class Advance:
    """Answer to one coupling step.

    Attributes
    ----------
    step : int
        MD steps done since the engine was made.
    windows : int
        Windows of M steps that the means are over.
    anchor_force : ndarray, shape (k, 3)
        Mean of k (r - a) - gamma (v_a - v) minus the reference: force on the continuum, N (Eq 87).
    ivc_force : ndarray, shape (m, 3)
        The same summed per interface volume cell, N.
    ivc_standard_error : ndarray, shape (m, 3)
        Standard error of that mean, N. The error of the reference is common to all windows and is told by
        `Reference`.
    correlation_time : float
        Integrated correlation time of the cells' forces, the longest, s, from the latest windows: what is shorter
        than half a window shows as half a window. nan where there are too few windows.
    temperature, temperature_inner, temperature_handshake : float
        At the end, K; of all atoms, of those without and of those with an anchor. 0 for an empty group.
    potential_energy, kinetic_energy : float
        At the end, of all atoms, J.
    spring_energy : float
        At the end, of the anchors' springs and of the compensating forces of surface atoms, J.
    anchor_work : float
        Work that springs, dampers, passive atoms and thermostats did on the atoms since the engine was made, J. The
        work of springs that stand still is exact, all else is exact to the order of the time step.
    thermostat_work : float
        The part of it that is none of the springs'.
    momentum : ndarray, shape (3,)
        Of all atoms at the end, kg m/s.
    """

    step: int
    windows: int
    anchor_force: NDArray[np.float64]
    ivc_force: NDArray[np.float64]
    ivc_standard_error: NDArray[np.float64]
    correlation_time: float
    temperature: float
    temperature_inner: float
    temperature_handshake: float
    potential_energy: float
    kinetic_energy: float
    spring_energy: float
    anchor_work: float
    thermostat_work: float
    momentum: NDArray[np.float64]


@dataclass(frozen=True)
class Severing:
    """What a cut did.

    Attributes
    ----------
    bonds : int
        Bonds of the undeformed sample that its line crosses.
    energy : float
        Change of the potential energy, J.
    """

    bonds: int
    energy: float
