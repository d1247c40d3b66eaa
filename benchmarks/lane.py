"""A lane: one way to bring an array to another process and an array of the same size back."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator

import numpy as np

from protocol.arrays import FloatArray

#: Trips before the first timed one of a batch, to bring back what other lanes pushed out of the caches.
WARM_UP = 3


class Lane(ABC):
    """One way to exchange arrays.

    Attributes
    ----------
    label : str
        Name in tables and pictures.
    peer : bool
        Whether this is other software.
    """

    label: str
    peer: bool = False

    @abstractmethod
    def batch(self, values: FloatArray, repeats: int) -> FloatArray:
        """Time round trips one after the other.

        Parameters
        ----------
        values : ndarray, shape (n, 3)
            What is sent; equally many values come back.
        repeats : int
            Number of trips.

        Returns
        -------
        ndarray, shape (repeats,)
            Time of each trip, s.

        Raises
        ------
        WrongAnswer
            Where other values came back than were sent.
        """


class WrongAnswer(Exception):
    """Other values came back than were sent."""


class DirectLane(Lane):
    """A lane whose client sits in this process."""

    @abstractmethod
    def trip(self, values: FloatArray) -> FloatArray | tuple[FloatArray, ...]:
        """Send `values` (shape (n, 3)) and return what came back, in one array or in pieces of rows."""

    def batch(self, values: FloatArray, repeats: int) -> FloatArray:
        """Time trips and compare what the last one brought back; see `Lane.batch`."""
        return timed_trips(self, values, repeats)


def timed_trips(lane: DirectLane, values: FloatArray, repeats: int) -> FloatArray:
    """Return the time of each trip (s, shape (repeats,)) after some that are not timed."""
    for _ in range(WARM_UP):
        lane.trip(values)
    seconds = np.empty(repeats)
    for k in range(repeats):
        began = time.perf_counter()
        # The answer is bound before the clock is read and freed by the next trip, as in a coupling loop.
        answer = lane.trip(values)
        seconds[k] = time.perf_counter() - began
    check_answer(lane.label, values, answer)
    return seconds


def check_answer(label: str, values: FloatArray, answer: FloatArray | tuple[FloatArray, ...]) -> None:
    """Raise `WrongAnswer` unless `answer`, its pieces put together, equals `values`."""
    pieces = answer if isinstance(answer, tuple) else (answer,)
    if not np.array_equal(np.concatenate(pieces), values):
        raise WrongAnswer(f"{label}: other values came back than were sent")


@contextlib.contextmanager
def helper_process(module: str, *arguments: str) -> Iterator[str]:
    """Run `python -m module arguments` beside this process and give the first line that it prints.

    The process is ended with the context.

    Raises
    ------
    RuntimeError
        Where the process ends without a line.
    """
    process = subprocess.Popen([sys.executable, "-m", module, *arguments], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None  # asked for above
    try:
        line = process.stdout.readline().strip()
        if not line:
            raise RuntimeError(f"{module} ended with status {process.wait(timeout=5)} before it was ready")
        yield line
    finally:
        process.terminate()
        process.wait(timeout=10)
        process.stdout.close()
