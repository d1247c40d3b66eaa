"""The crack relay: a crack of the continuum enters the atoms, and leaves them again (Figs 4.3 to 4.5).

::

                tip at the ring                     tip at the far side
    CONTINUUM -------------------->  ATOMS  ------------------------------>  WAITING
     |     ^   cut through the ring   |   ^                                    |
     +-----+                          +---+                                    |  stress ahead at least
      grows by its law,           tracked by bonds                             |  the saved critical one:
      stress ahead is saved                                                    |  cut through the far ring
                                                                               v
                                                                  BEYOND (grows by its law)

The continuum's crack grows by its own law in CONTINUUM and BEYOND alone (the dissertation's PROPAGATE is true); in
the other two its tip lies where there are atoms only. All places here are along the crack, in the sample's frame,
in which it comes from the left.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from protocol.arrays import FloatArray


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
    continuum_tip : float or None
        Of the continuum's crack, m; None where it has none.
    grew : bool
        Whether it grew in this step.
    atom_tip : float or None
        Of the atoms' crack, m.
    stress_ahead : float or None
        Opening stress in the continuum ahead of where the crack is, or would be, Pa; None where not looked at.
    """

    continuum_tip: float | None
    grew: bool
    atom_tip: float | None
    stress_ahead: float | None


@dataclass(frozen=True)
class Cut:
    """New crack that a step of the relay makes, m along the crack.

    Attributes
    ----------
    atoms_from, atoms_to : float
        Line that severs the atoms.
    continuum_to : float
        New tip of the continuum's crack.
    """

    atoms_from: float
    atoms_to: float
    continuum_to: float


class Relay:
    """Follows one crack tip through one sample.

    Parameters
    ----------
    borders : Borders
    reach : float
        Distance to the ring at which the crack is handed over, m: that of a cell of the continuum.
    leg : Leg
        Where the tip is at the start.
    critical_stress : float or None
        Stress ahead at which the continuum cracks anew, Pa, for a crack that begins among the atoms. One that comes
        from the continuum saves its own.
    """

    def __init__(self, borders: Borders, reach: float, leg: Leg, critical_stress: float | None = None) -> None:
        self.borders = borders
        self.reach = reach
        self.leg = leg
        self.critical_stress = critical_stress

    @property
    def looks_ahead(self) -> bool:
        """Whether the next decision needs the stress ahead of the crack."""
        return self.leg in (Leg.CONTINUUM, Leg.WAITING)

    @property
    def place_ahead(self) -> float | None:
        """Where the continuum would crack anew, m; None where its own tip is meant."""
        return self.borders.far_outer if self.leg is Leg.WAITING else None

    def decide(self, sight: Sight) -> Cut | None:
        """Take in what is seen; returns the cut to make where the leg changes hands.

        Parameters
        ----------
        sight : Sight
        """
        b = self.borders
        if self.leg is Leg.CONTINUUM and sight.continuum_tip is not None:
            if sight.grew and sight.stress_ahead is not None:
                self.critical_stress = sight.stress_ahead
            if sight.continuum_tip >= b.near_outer - self.reach:
                self.leg = Leg.ATOMS
                # From beyond the last atom: the edge of the sample is cut through.
                return Cut(b.near_outer - (b.near_inner - b.near_outer), b.near_inner, b.near_inner)
        elif self.leg is Leg.ATOMS:
            if sight.atom_tip is not None and sight.atom_tip >= b.far_inner - self.reach:
                self.leg = Leg.WAITING
        elif self.leg is Leg.WAITING:
            critical, ahead = self.critical_stress, sight.stress_ahead
            if critical is not None and ahead is not None and ahead >= critical:
                self.leg = Leg.BEYOND
                return Cut(
                    b.far_inner - self.reach, b.far_outer + (b.far_outer - b.far_inner), b.far_outer + self.reach
                )
        return None

    def state(self) -> np.ndarray:
        """Return leg and saved stress as numbers."""
        return np.array([self.leg.value, np.nan if self.critical_stress is None else self.critical_stress])

    def restore(self, state: np.ndarray) -> None:
        """Set what `state` gave."""
        self.leg = Leg(int(state[0]))
        self.critical_stress = None if np.isnan(state[1]) else float(state[1])


def stress_ahead(position: FloatArray, stress: FloatArray, weight: FloatArray, tip: FloatArray, sign: float,
                 size: float) -> float | None:  # fmt: skip
    """Return the mean opening stress in the continuum just ahead of a place, Pa.

    The mean over the material points of full weight in a box two cells long and two high, ahead of it.

    Parameters
    ----------
    position : float64 array, shape (points, 3)
        m.
    stress : float64 array, shape (points, 3)
        xx, yy, xy, Pa.
    weight : float64 array, shape (points,)
    tip : float64 array, shape (2,)
        m.
    sign : float
        1 where the crack goes to +x, -1 where to -x.
    size : float
        Edge of a cell, m.

    Returns
    -------
    float or None
        None where there are no points.
    """
    ahead = sign * (position[:, 0] - tip[0])
    box = (ahead > 0.0) & (ahead < 2.0 * size) & (np.abs(position[:, 1] - tip[1]) < size) & (weight > 1.0 - 1e-9)
    return float(stress[box, 1].mean()) if box.any() else None
