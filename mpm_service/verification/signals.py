"""Figures read off waves and oscillations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Front:
    """A step wave that has travelled some way.

    Attributes
    ----------
    place : float
        Where the wave is at half its height [m].
    rise : float
        Distance between 10 and 90 % of the height [m].
    overshoot : float
        Largest value behind the front over the height, less one.
    undershoot : float
        Lowest value ahead of the front over the height, with its sign turned: ripple that outruns the wave.
    """

    place: float
    rise: float
    overshoot: float
    undershoot: float


def _last_crossing(place: FloatArray, value: FloatArray, level: float) -> float:
    """Furthest place at which a wave that runs towards larger places passes a level."""
    above = np.flatnonzero(value >= level)
    if above.size == 0 or above[-1] + 1 == value.size:
        raise ValueError(f"value: does not fall through the level {level!r} inside the given places")
    i = int(above[-1])
    share = (value[i] - level) / (value[i] - value[i + 1])
    return float(place[i] + share * (place[i + 1] - place[i]))


def read_front(place: FloatArray, value: FloatArray, height: float) -> Front:
    """Read place, rise and overshoot of a step wave that runs towards larger places.

    Parameters
    ----------
    place : (n,) ndarray
        Rising [m].
    value : (n,) ndarray
        The wave.
    height : float
        Height of the step, in the unit of ``value``.

    Returns
    -------
    Front

    Raises
    ------
    ValueError
        If the wave does not fall through half its height, or through 10 or 90 %, inside the given places.
    """
    scaled = value / height
    middle = _last_crossing(place, scaled, 0.5)
    return Front(
        middle,
        _last_crossing(place, scaled, 0.1) - _last_crossing(place, scaled, 0.9),
        float(scaled.max()) - 1.0,
        max(0.0, -float(scaled[place > middle].min())),
    )


def mean_period(time: FloatArray, signal: FloatArray) -> float:
    """Mean period of an oscillation from its first to its last upward passage through zero [s].

    Parameters
    ----------
    time, signal : (n,) ndarray
        Samples; several within each period.

    Raises
    ------
    ValueError
        If there are fewer than two upward passages.
    """
    up = np.flatnonzero((signal[:-1] < 0.0) & (signal[1:] >= 0.0))
    if up.size < 2:
        raise ValueError(f"signal: has {up.size} upward passages through zero, two are needed")
    share = signal[up] / (signal[up] - signal[up + 1])
    crossing = time[up] + share * (time[up + 1] - time[up])
    return float((crossing[-1] - crossing[0]) / (crossing.size - 1))


def observed_order(size: FloatArray, error: FloatArray) -> float:
    """Order of convergence: slope of log error over log size by least squares.

    Parameters
    ----------
    size, error : (n,) ndarray
        At least two pairs of positive numbers.
    """
    return float(np.polyfit(np.log(size), np.log(error), 1)[0])
