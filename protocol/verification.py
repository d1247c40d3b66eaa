"""Cases with a known answer, and benchmarks: what a package offers to `scalebridge verify` and `bench`.

Entry points of the group `scalebridge.verification` name lists of `Case`, those of `scalebridge.benchmarks`
name `Benchmark` objects.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

CASES = "scalebridge.verification"
BENCHMARKS = "scalebridge.benchmarks"


@dataclass(frozen=True)
class Check:
    """One quantity of a case, held against its reference.

    Parameters
    ----------
    quantity, unit, source : str
        What it is, its unit, and where the reference comes from.
    value, reference : float
    tolerance : float
        Allowed error: relative where the reference is not zero, else absolute.
    at_most : bool
        The reference is a limit: any smaller value passes, and the error is how far it is exceeded.
    """

    quantity: str
    value: float
    reference: float
    tolerance: float
    source: str
    unit: str = "1"
    at_most: bool = False

    @property
    def error(self) -> float:
        """Relative error, or the absolute one where the reference is zero."""
        difference = self.value - self.reference
        if self.at_most:
            difference = max(difference, 0.0)  # in this order NaN stays NaN
        return float(abs(difference / self.reference) if self.reference else abs(difference))

    @property
    def passed(self) -> bool:
        """Whether the error is within the tolerance; NaN never is."""
        return bool(self.error <= self.tolerance)


class CannotRun(Exception):
    """A case that cannot run here, with the reason."""


@dataclass(frozen=True)
class Case:
    """A case with a known answer.

    Parameters
    ----------
    group, name, summary : str
    run : callable
        Given a folder to work in, returns the checks. Raises `CannotRun` where something is missing.
    slow : bool
        Takes more than about two minutes; left out unless it is asked for by name.
    """

    group: str
    name: str
    summary: str
    run: Callable[[Path], list[Check]]
    slow: bool = False


@dataclass(frozen=True)
class BenchmarkRow:
    """One measured configuration.

    Parameters
    ----------
    label : str
    knobs : dict
        What was set.
    seconds : float
        Median.
    error : float or None
        Its error, where it has one.
    figures : dict of str to float
        Further figures.
    peer : bool
        Whether this is other software, measured beside ours.
    """

    label: str
    knobs: dict[str, str | int | float]
    seconds: float
    error: float | None = None
    figures: dict[str, float] = field(default_factory=dict)
    peer: bool = False


@dataclass(frozen=True)
class Benchmark:
    """A benchmark: given a folder for its pictures, returns its rows and the pictures."""

    name: str
    summary: str
    run: Callable[[Path], tuple[list[BenchmarkRow], list[Path]]]
