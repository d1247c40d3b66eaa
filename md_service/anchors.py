"""Anchors: points that hold atoms by springs and dampers (Eqs 82, 85-87 of the dissertation).

The force on an anchored atom is k (a - r) + gamma (v_a - v) plus the thermostat's noise. A passive atom has no spring:
it sits at its anchor and moves with it, and what the other atoms pull on it goes to the continuum. A surface atom is
held by a spring until the reference force is known; from then on the mean of what held its cell acts on it as a
constant force instead (f_c of Eq 82), so that the atoms next to the free surface feel no surface.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

SPRING: Final = 0
PASSIVE: Final = 1
SURFACE: Final = 2
KINDS: Final = ("spring", "passive", "surface")


@dataclass
class Anchors:
    """Anchors of the handshake, SI units.

    Attributes
    ----------
    atom_id : ndarray of int64, shape (k,)
        Row of each anchored atom in the sample, from 0.
    position, velocity : ndarray, shape (k, 3)
        Of the anchors, m and m/s.
    stiffness : ndarray, shape (k,)
        Spring constants, N/m; 0 for passive atoms and for released surface atoms.
    ivc : ndarray of int64, shape (k,)
        Interface volume cell of each anchor, from 0.
    damping : ndarray, shape (k,)
        Damper constants gamma, kg/s; 0 for springs alone. gamma is a share of the atom's mass over the damping time.
    kind : ndarray of int64, shape (k,)
        `SPRING`, `PASSIVE` or `SURFACE`.
    force : ndarray, shape (k, 3)
        Constant compensating forces on released surface atoms, N.
    moving : bool
        Whether anchors move with their velocity during a window instead of standing still.
    """

    atom_id: NDArray[np.int64]
    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    stiffness: NDArray[np.float64]
    ivc: NDArray[np.int64]
    damping: NDArray[np.float64]
    kind: NDArray[np.int64]
    force: NDArray[np.float64]
    moving: bool = False

    @property
    def n_ivc(self) -> int:
        """Number of interface volume cells."""
        return int(self.ivc.max()) + 1

    def damping_times(self, mass: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Distinct damping times, s, ascending, and which of them each anchor has, shape (k,); -1 without damper.

        Parameters
        ----------
        mass : ndarray, shape (k,)
            Of the anchored atoms, kg.
        """
        which = np.full(len(mass), -1, dtype=np.int64)
        damped = self.damping > 0.0
        # Round-off of mass / (mass / time) must not tell equal times apart.
        times, rows = np.unique(np.round(np.log(mass[damped] / self.damping[damped]), 9), return_inverse=True)
        which[damped] = rows
        return np.exp(times), which

    @property
    def passive(self) -> NDArray[np.bool_]:
        """Which anchors are passive, shape (k,)."""
        return self.kind == PASSIVE

    def mean_position(self, window: int, time_step: float) -> NDArray[np.float64]:
        """Mean over a window of M steps that starts with the anchors at `position`, m, shape (k, 3)."""
        if not self.moving:
            return self.position
        return self.position + self.velocity * (0.5 * window * time_step)

    def end_position(self, window: int, time_step: float) -> NDArray[np.float64]:
        """Where the anchors are after M steps, m, shape (k, 3)."""
        return self.position + self.velocity * (window * time_step) if self.moving else self.position

    def spring_energy(self, atom_position: NDArray[np.float64], anchor_position: NDArray[np.float64]) -> float:
        """Energy of all springs (Eq 85) and of the compensating forces, J, for positions (k, 3) in m."""
        offset = atom_position - anchor_position
        return float(0.5 * np.sum(self.stiffness[:, None] * offset**2) - np.sum(self.force * offset))

    def force_on_continuum(
        self,
        mean_position: NDArray[np.float64],
        mean_velocity: NDArray[np.float64],
        mean_pair_force: NDArray[np.float64],
        anchor_mean_position: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Mean reaction of spring and damper, or of a passive atom, on each anchor, N, shape (k, 3) (Eq 86).

        Parameters
        ----------
        mean_position, mean_velocity : ndarray, shape (k, 3)
            Window means of the anchored atoms, m and m/s.
        mean_pair_force : ndarray, shape (k, 3)
            Mean force of the other atoms on passive atoms, N.
        anchor_mean_position : ndarray, shape (k, 3)
            Window mean of the anchors, m.
        """
        spring = self.stiffness[:, None] * (mean_position - anchor_mean_position)
        return np.asarray(spring - self.damping[:, None] * (self.velocity - mean_velocity) + mean_pair_force)

    def sum_over_ivc(self, force: NDArray[np.float64]) -> NDArray[np.float64]:
        """Sum a per-anchor array (k, 3) over the anchors of each interface volume cell, (m, 3)."""
        total = np.zeros((self.n_ivc, 3))
        np.add.at(total, self.ivc, force)
        return total

    def release_surface(self, holding_force: NDArray[np.float64]) -> None:
        """Replace the springs of surface atoms by the mean force of each cell that held them (Eq 82).

        Parameters
        ----------
        holding_force : ndarray, shape (k, 3)
            Mean force of each spring on its atom with anchors at rest, N.
        """
        surface = self.kind == SURFACE
        count = np.bincount(self.ivc[surface], minlength=self.n_ivc)
        total = self.sum_over_ivc(np.where(surface[:, None], holding_force, 0.0))
        share = total / np.maximum(count, 1)[:, None]
        self.force[surface] = share[self.ivc[surface]]
        self.stiffness[surface] = 0.0


def checked_anchors(
    atom_id: ArrayLike,
    position: ArrayLike,
    stiffness: ArrayLike,
    ivc: ArrayLike,
    damping_time: float | None,
    atom_mass: NDArray[np.float64],
    kind: ArrayLike | None = None,
    moving: bool = False,
    damping_share: ArrayLike | None = None,
) -> Anchors:
    """Anchors at rest from a user's arrays.

    Parameters
    ----------
    atom_id, position, stiffness, ivc, kind, moving
        As in `Anchors`; without `kind` all are springs. The stiffness of passive atoms is not looked at.
    damping_time : float or None
        s; gamma is the atom's mass over it, times `damping_share`. None: no damper and no thermostat.
    atom_mass : ndarray, shape (n,)
        Mass of each atom of the sample, kg.
    damping_share : array_like, shape (k,), optional
        Factor on each damper, above 0 and at most 1; all 1 without.

    Raises
    ------
    ValueError
        Naming the field, its value and what is allowed.
    """
    n_atoms = len(atom_mass)
    ids = np.asarray(atom_id)
    if ids.ndim != 1 or len(ids) == 0 or not np.issubdtype(ids.dtype, np.integer):
        raise ValueError(f"atom_id has shape {ids.shape} and type {ids.dtype}; a non-empty list of integers is needed")
    ids = np.array(ids, dtype=np.int64)
    outside = ids[(ids < 0) | (ids >= n_atoms)]
    if len(outside):
        raise ValueError(f"atom_id holds {outside[0]}; allowed are 0 to {n_atoms - 1}")
    if len(np.unique(ids)) != len(ids):
        values, count = np.unique(ids, return_counts=True)
        raise ValueError(f"atom_id holds {values[count > 1][0]} more than once; one anchor per atom is allowed")
    kinds = np.zeros(len(ids), dtype=np.int64) if kind is None else np.asarray(kind)
    if kinds.shape != ids.shape or not np.issubdtype(kinds.dtype, np.integer) or not np.isin(kinds, (0, 1, 2)).all():
        raise ValueError(f"kind has shape {kinds.shape}; {len(ids)} of 0 (spring), 1 (passive), 2 (surface) are needed")
    springs = finite_array("stiffness", stiffness, (len(ids),))
    springs[kinds == PASSIVE] = 0.0
    held = springs[kinds != PASSIVE]
    if not (held > 0.0).all():
        raise ValueError(f"stiffness holds {held.min()} N/m; every spring needs a positive stiffness")
    cells = np.asarray(ivc)
    if cells.shape != ids.shape or not np.issubdtype(cells.dtype, np.integer) or cells.min() < 0:
        raise ValueError(f"ivc has shape {cells.shape} and type {cells.dtype}; {len(ids)} integers from 0 are needed")
    if damping_time is not None and not (np.isfinite(damping_time) and damping_time > 0.0):
        raise ValueError(f"damping_time is {damping_time} s; it must be finite and positive, or absent")
    gamma = np.zeros(len(ids)) if damping_time is None else atom_mass[ids] / damping_time
    if damping_share is not None:
        share = finite_array("damping_share", damping_share, (len(ids),))
        if not ((share > 0.0) & (share <= 1.0)).all():
            raise ValueError(f"damping_share holds {share.min()} to {share.max()}; allowed is above 0 to 1")
        gamma *= share
    return Anchors(
        atom_id=ids,
        position=finite_array("position", position, (len(ids), 3)),
        velocity=np.zeros((len(ids), 3)),
        stiffness=springs,
        ivc=np.array(cells, dtype=np.int64),
        damping=np.where(kinds == PASSIVE, 0.0, gamma),
        kind=np.array(kinds, dtype=np.int64),
        force=np.zeros((len(ids), 3)),
        moving=bool(moving),
    )


def finite_array(name: str, value: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """A fresh float64 array of the given shape.

    Raises
    ------
    ValueError
        If the shape differs or a value is not finite.
    """
    array = np.array(value, dtype=np.float64, order="C")
    if array.shape != shape:
        raise ValueError(f"{name} has shape {array.shape}; {shape} is needed")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} holds values that are not finite")
    return array
