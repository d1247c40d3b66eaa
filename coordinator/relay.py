"""The crack relay: a crack of the continuum enters the atoms, and leaves them again (Figs 4.3 to 4.5).

::

                  reached the ring                     reached the far side
    CONTINUUM ------------------------>  ATOMS  -------------------------------->  WAITING
     |     ^    cut through the near     |   ^    cut through the far half of        |
     +-----+    half of the ring         +---+    the ring, to its outer border      |
      grows by its law:              tracked by bonds                                |  stress ahead is at
      stress ahead is saved                                                          |  least the saved one
                                                                                     v
                                                                  BEYOND (grows by its law)

The continuum's crack grows by its own law in CONTINUUM and BEYOND alone: there the dissertation's PROPAGATE is true.
In ATOMS the tip lies where there are atoms only, in WAITING on the far border, where the service measures it and
does not let it grow. All places here are along the crack, in the sample's frame, in which it comes from the left.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

#: Part of a cell by which the crack is pushed beyond the far border, from where it grows by its law.
_PUSH = 0.5


class Leg(Enum):
    """Who carries the crack tip."""

    CONTINUUM = 0
    ATOMS = 1
    WAITING = 2
    BEYOND = 3

    @property
    def propagate(self) -> bool:
        """Whether the crack grows by the continuum's law."""
        return self in (Leg.CONTINUUM, Leg.BEYOND)


@dataclass(frozen=True)
class Borders:
    """Where the crack's line crosses the ring, m, ascending: outer, inner, inner, outer border."""

    near_outer: float
    near_inner: float
    far_inner: float
    far_outer: float


@dataclass(frozen=True)
class Sight:
    """What is seen after a coupling step.

    Attributes
    ----------
    grew : bool
        Whether the continuum's crack grew.
    reached : bool
        Whether it came to the ring with a load at which it would go on.
    stress : float or None
        Opening stress ahead of the continuum's tip, Pa; None where it was not measured.
    atom_tip : float or None
        Tip of the atoms' crack, m.
    """

    grew: bool = False
    reached: bool = False
    stress: float | None = None
    atom_tip: float | None = None


@dataclass(frozen=True)
class Cut:
    """New crack that a step of the relay makes, m along the crack.

    Attributes
    ----------
    continuum_to : float
        New tip of the continuum's crack.
    atoms : tuple of float or None
        Ends of the line that severs the atoms; None where they stay.
    """

    continuum_to: float
    atoms: tuple[float, float] | None = None


class Relay:
    """Follows one crack tip through one sample.

    Parameters
    ----------
    borders : Borders
    reach : float
        Distance to the far side at which the atoms' tip counts as there, m: a cell of the continuum.
    leg : Leg
        Where the tip is at the start.
    critical_stress : float, optional
        Stress ahead at which the continuum cracks anew, Pa, for a crack that begins among the atoms. One that comes
        from the continuum saves its own.
    """

    def __init__(self, borders: Borders, reach: float, leg: Leg, critical_stress: float | None = None) -> None:
        self.borders = borders
        self.reach = reach
        self.leg = leg
        self.critical_stress = critical_stress

    def decide(self, sight: Sight) -> Cut | None:
        """Take in what is seen after a step; returns the cut to make where the leg changes."""
        b = self.borders
        through = b.near_inner - b.near_outer  # beyond the last atoms on either side
        if self.leg is Leg.CONTINUUM:
            if (sight.grew or sight.reached) and sight.stress is not None:
                self.critical_stress = sight.stress
            if sight.reached:
                self.leg = Leg.ATOMS
                return Cut(b.near_inner, (b.near_outer - through, b.near_inner))
        elif self.leg is Leg.ATOMS:
            if sight.atom_tip is not None and sight.atom_tip >= b.far_inner - self.reach:
                self.leg = Leg.WAITING
                return Cut(b.far_outer, (min(sight.atom_tip, b.far_inner), b.far_outer + through))
        elif self.leg is Leg.WAITING:
            critical, ahead = self.critical_stress, sight.stress
            if critical is not None and ahead is not None and ahead >= critical:
                self.leg = Leg.BEYOND
                return Cut(b.far_outer + _PUSH * self.reach)
        return None

    def state(self) -> np.ndarray:
        """Return leg and saved stress as numbers."""
        return np.array([self.leg.value, np.nan if self.critical_stress is None else self.critical_stress])

    def restore(self, state: np.ndarray) -> None:
        """Set what `state` gave."""
        self.leg = Leg(int(state[0]))
        self.critical_stress = None if np.isnan(state[1]) else float(state[1])
