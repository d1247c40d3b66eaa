"""Functions of time for loads and boundary conditions.

A load or a condition takes any callable that maps an array of times [s] to values of the same shape. Where a
velocity is prescribed the callable also needs ``integral(time)``, its exact integral from time 0, because the
boundary moves by the difference of that integral over a step and never by a running sum.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]

# Steps tabulated at once. A call from Python costs more than the evaluation of a few hundred values, and
# blocks start at multiples of their length, so a value does not depend on where a run was restored.
_BLOCK = 512


class TimeFunction(Protocol):
    """Values at given times: ``f(time (k,)) -> (k,)``."""

    def __call__(self, time: FloatArray, /) -> FloatArray:
        """Values at the times [s]."""


class IntegrableTimeFunction(TimeFunction, Protocol):
    """A time function that knows its integral."""

    def integral(self, time: FloatArray, /) -> FloatArray:
        """Integral from 0 to each time [s]."""


def _finite(owner: object, **values: float) -> None:
    for name, value in values.items():
        if not np.isfinite(value):
            raise ValueError(f"{type(owner).__name__}.{name} = {value!r}: must be finite")


@dataclass(frozen=True)
class Constant:
    """The same value at all times.

    Parameters
    ----------
    value : float
    """

    value: float = 1.0

    def __post_init__(self) -> None:
        _finite(self, value=self.value)

    def __call__(self, time: FloatArray) -> FloatArray:
        """Values at the times [s]."""
        return np.full(np.shape(time), float(self.value))

    def integral(self, time: FloatArray) -> FloatArray:
        """Integral from 0 to each time [s]."""
        return self.value * np.asarray(time, dtype=np.float64)


@dataclass(frozen=True)
class Sine:
    """``amplitude * sin(angular_frequency * time + phase)``.

    Parameters
    ----------
    amplitude : float
    angular_frequency : float
        [rad/s], not zero.
    phase : float
        [rad]; pi/2 makes a cosine.
    """

    amplitude: float
    angular_frequency: float
    phase: float = 0.0

    def __post_init__(self) -> None:
        _finite(self, amplitude=self.amplitude, angular_frequency=self.angular_frequency, phase=self.phase)
        if self.angular_frequency == 0.0:
            raise ValueError("Sine.angular_frequency = 0: must not be zero (use Constant)")

    def __call__(self, time: FloatArray) -> FloatArray:
        """Values at the times [s]."""
        return self.amplitude * np.sin(self.angular_frequency * np.asarray(time) + self.phase)

    def integral(self, time: FloatArray) -> FloatArray:
        """Integral from 0 to each time [s]."""
        # cos(phase) - cos(w t + phase) as a product, which loses no digits while w t is small.
        half = 0.5 * self.angular_frequency * np.asarray(time)
        return 2.0 * self.amplitude / self.angular_frequency * np.sin(half + self.phase) * np.sin(half)


@dataclass(frozen=True)
class Step:
    """0 before ``start``, ``value`` from then on.

    Parameters
    ----------
    value : float
    start : float
        [s].
    """

    value: float = 1.0
    start: float = 0.0

    def __post_init__(self) -> None:
        _finite(self, value=self.value, start=self.start)

    def __call__(self, time: FloatArray) -> FloatArray:
        """Values at the times [s]."""
        return np.where(np.asarray(time) >= self.start, float(self.value), 0.0)

    def integral(self, time: FloatArray) -> FloatArray:
        """Integral from 0 to each time [s]."""
        since = np.maximum(np.asarray(time, dtype=np.float64) - self.start, 0.0)
        return self.value * (since - max(-self.start, 0.0))


@dataclass(frozen=True)
class Ramp:
    """From 0 to ``value`` within ``duration``, then held.

    Parameters
    ----------
    duration : float
        [s], positive.
    value : float
    start : float
        [s].
    smooth : bool
        Rise by half a cosine, without a kink at either end, instead of a straight line.
    """

    duration: float
    value: float = 1.0
    start: float = 0.0
    smooth: bool = False

    def __post_init__(self) -> None:
        _finite(self, duration=self.duration, value=self.value, start=self.start)
        if self.duration <= 0.0:
            raise ValueError(f"Ramp.duration = {self.duration!r} s: must be positive (use Step)")

    def __call__(self, time: FloatArray) -> FloatArray:
        """Values at the times [s]."""
        share = np.clip((np.asarray(time, dtype=np.float64) - self.start) / self.duration, 0.0, 1.0)
        return self.value * (0.5 - 0.5 * np.cos(np.pi * share) if self.smooth else share)

    def integral(self, time: FloatArray) -> FloatArray:
        """Integral from 0 to each time [s]."""
        return self._primitive(np.asarray(time, dtype=np.float64)) - self._primitive(np.zeros(()))

    def _primitive(self, time: FloatArray) -> FloatArray:
        since = (time - self.start) / self.duration
        share = np.clip(since, 0.0, 1.0)
        risen = 0.5 * share - np.sin(np.pi * share) / (2.0 * np.pi) if self.smooth else 0.5 * share**2
        return self.value * self.duration * (risen + np.maximum(since - 1.0, 0.0))


@dataclass(frozen=True, eq=False)
class Table:
    """Straight lines between entries, held before the first and after the last.

    Parameters
    ----------
    times : (k,) sequence of float
        Strictly increasing [s].
    values : (k,) sequence of float
    """

    times: Sequence[float] | FloatArray
    values: Sequence[float] | FloatArray
    _area: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        times = np.array(self.times, dtype=np.float64)
        values = np.array(self.values, dtype=np.float64)
        if times.ndim != 1 or times.size == 0 or times.shape != values.shape:
            raise ValueError(
                "Table.times and values: two lists of equal length with at least one entry are needed, "
                f"got shapes {times.shape} and {values.shape}"
            )
        if not (np.all(np.isfinite(times)) and np.all(np.isfinite(values))):
            raise ValueError("Table.times and values: all entries must be finite")
        if np.any(np.diff(times) <= 0.0):
            raise ValueError("Table.times: must increase strictly")
        area = np.concatenate(([0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(times))))
        for name, value in (("times", times), ("values", values), ("_area", area)):
            object.__setattr__(self, name, value)

    def __call__(self, time: FloatArray) -> FloatArray:
        """Values at the times [s]."""
        return np.asarray(np.interp(time, np.asarray(self.times), np.asarray(self.values)))

    def integral(self, time: FloatArray) -> FloatArray:
        """Integral from 0 to each time [s]."""
        return self._primitive(np.asarray(time, dtype=np.float64)) - self._primitive(np.zeros(()))

    def _primitive(self, time: FloatArray) -> FloatArray:
        times, values = np.asarray(self.times), np.asarray(self.values)
        entry = np.clip(np.searchsorted(times, time, side="right") - 1, 0, times.size - 1)
        mean = np.where(time < times[0], values[0], 0.5 * (values[entry] + self(time)))
        return np.asarray(self._area[entry] + mean * (time - times[entry]))


class Schedule:
    """Values of several time functions at whole steps, tabulated in blocks.

    Parameters
    ----------
    functions : sequence of TimeFunction
    names : sequence of str
        What each is called in an error.
    time_step : float
        [s].

    Attributes
    ----------
    first : int or None
        First step of the tabulated block.
    values : (n, functions) ndarray
        Values from one step before the block to one after it.
    """

    def __init__(self, functions: Sequence[TimeFunction], names: Sequence[str], time_step: float) -> None:
        self._functions = tuple(functions)
        self._names = tuple(names)
        self._time_step = float(time_step)
        self.first: int | None = None
        self.values = np.zeros((_BLOCK + 2, len(self._functions)))

    def window(self, step: int) -> FloatArray:
        """Values one step before, at, and one step after ``step``, (3, functions); times below 0 count as 0.

        Raises
        ------
        ValueError
            If a function returns another shape or a value that is not finite.
        """
        first = step - step % _BLOCK
        if first != self.first:
            self._tabulate(first)
        return self.values[step - first : step - first + 3]

    def now(self, step: int) -> FloatArray:
        """Values at ``step``, (functions,)."""
        return np.asarray(self.window(step)[1])

    def _tabulate(self, first: int) -> None:
        time = np.maximum(self._time_step * np.arange(first - 1, first + _BLOCK + 1, dtype=np.float64), 0.0)
        for k, function in enumerate(self._functions):
            values = np.asarray(function(time), dtype=np.float64)
            if values.shape != time.shape:
                raise ValueError(
                    f"{self._names[k]}: must return one value per time, shape {time.shape}, got {values.shape}"
                )
            if not np.all(np.isfinite(values)):
                bad = int(np.flatnonzero(~np.isfinite(values))[0])
                raise ValueError(f"{self._names[k]} = {values[bad]!r} at time {time[bad]:.9g} s: must be finite")
            self.values[:, k] = values
        self.first = first


def as_time_function(owner: str, name: str, value: TimeFunction | ArrayLike, times: ArrayLike | None) -> TimeFunction:
    """Return ``value`` itself if it is a function of time, else the table of ``value`` over ``times``.

    Raises
    ------
    ValueError
        If the two do not go together; the message calls them ``owner.name`` and ``owner.times``.
    """
    if callable(value):
        if times is not None:
            raise ValueError(f"{owner}.times: not allowed where {name} is a function of time")
        return value
    if times is None:
        raise ValueError(f"{owner}.times: needed where {name} is a list of values")
    try:
        return Table(np.asarray(times, dtype=np.float64), np.asarray(value, dtype=np.float64))
    except ValueError as error:
        text = str(error).replace("Table.times and values", f"{owner}.times and {name}")
        raise ValueError(text.replace("Table.times", f"{owner}.times")) from None
