"""Increments of load that are as large as the laminate lets them be."""

from __future__ import annotations

from dataclasses import dataclass

from fem_service.equilibrium import Equilibrium, NotConverged
from fem_service.quasi_static import QuasiStatic

#: Iterations below and above which the next increment is larger and smaller, and by how much.
_FEW, _MANY = 12, 20
_GROWTH, _SHRINKING = 1.5, 0.7


@dataclass(frozen=True)
class Steps:
    """Sizes of increments, in units of the load.

    Attributes
    ----------
    first, least, most : float
        Size of the first one, the size below which a run is given up, and the largest size.
    """

    first: float
    least: float
    most: float

    def __post_init__(self) -> None:
        if not 0.0 < self.least <= self.first <= self.most:
            raise ValueError(
                f"first is {self.first:g}; it must lie between least, {self.least:g}, and most, {self.most:g}"
            )


@dataclass(frozen=True, eq=False)
class Increment:
    """One increment that found its equilibrium.

    Attributes
    ----------
    equilibrium : Equilibrium
    next_size : float
        Size to try next, in units of the load.
    iterations : int
        Those of halved tries included.
    halved : int
        Tries that found no equilibrium.
    """

    equilibrium: Equilibrium
    next_size: float
    iterations: int
    halved: int


def next_increment(laminate: QuasiStatic, start: Equilibrium, size: float, end: float, steps: Steps) -> Increment:
    """Make the next increment; a try that finds no equilibrium is repeated with half the size.

    Parameters
    ----------
    laminate : QuasiStatic
    start : Equilibrium
    size : float
        To try first, in units of the load.
    end : float
        Load beyond which it does not go.
    steps : Steps

    Raises
    ------
    NotConverged
        If not even the least increment finds an equilibrium; the message says at which load, and what may help.
    """
    iterations = halved = 0
    while True:
        # The end is met exactly: a last increment of rounding error's size would be none.
        reaches = start.load + size * (1.0 + 1e-9) >= end
        try:
            found = laminate.advance(start, end if reaches else start.load + size)
        except NotConverged as error:
            iterations += error.iterations
            halved += 1
            size = 0.5 * size
            if size < steps.least:
                raise NotConverged(
                    f"{error}; the increment is below the least, {steps.least:g}: a smaller least increment, a finer "
                    "mesh, softening instead of sudden failure or a viscosity of cohesive layers may help",
                    iterations,
                ) from None
            continue
        iterations += found.iterations
        return Increment(found, size_after(found, size, halved, steps), iterations, halved)


def size_after(found: Equilibrium, size: float, halved: int, steps: Steps) -> float:
    """Size to try after an increment of a size that was found after so many halvings."""
    if halved == 0 and found.iterations <= _FEW:
        return min(size * _GROWTH, steps.most)
    if found.iterations > _MANY:
        return max(size * _SHRINKING, steps.least)
    return size
