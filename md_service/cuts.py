"""Cuts: straight lines across which atoms no longer act on each other.

A cut severs the atoms above its line from those below, of both those between the outermost bonds that the line
crosses. In a crystal these are the very bonds that cross the line; pairs further apart are severed where both atoms are
within those bounds, so around an end of a cut a force of long reach still acts past it. Severed faces do not touch
either: a load that closes them pushes them through each other.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from md_service.atoms import Atoms, CrackCut

#: Lines whose ends are nearer than this are one line, m; an atom this near to a line counts as above it.
_TOUCHING: Final = 1e-13


@dataclass(frozen=True)
class Cut:
    """A line along x in the undeformed sample.

    Attributes
    ----------
    from_x, to_x : float
        Its ends, m.
    y : float
        Its height, m.
    """

    from_x: float
    to_x: float
    y: float


def above(position: NDArray[np.float64], y: float) -> NDArray[np.bool_]:
    """Which atoms lie above a line, shape (n,)."""
    return position[:, 1] > y - _TOUCHING


def crossing(cut: Cut, position: NDArray[np.float64], pairs: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which bonds a line crosses, those at its beginning among them.

    Parameters
    ----------
    cut : Cut
    position : ndarray, shape (n, 3)
        Of the undeformed sample, m.
    pairs : ndarray of int64, shape (b, 2)
        Rows of the bonded atoms.

    Returns
    -------
    ndarray of bool, shape (b,)
    """
    is_above = above(position, cut.y)
    first, second = position[pairs[:, 0]], position[pairs[:, 1]]
    apart = is_above[pairs[:, 0]] != is_above[pairs[:, 1]]
    fraction = (cut.y - first[:, 1]) / np.where(apart, second[:, 1] - first[:, 1], 1.0)
    x = first[:, 0] + np.clip(fraction, 0.0, 1.0) * (second[:, 0] - first[:, 0])
    # A bond at the very end is of the line that goes on from there.
    return np.asarray(apart & (x > cut.from_x - _TOUCHING) & (x < cut.to_x - _TOUCHING))


def sides(cut: Cut, atoms: Atoms, pairs: NDArray[np.int64]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Atoms above and below a cut that it severs from each other.

    Parameters
    ----------
    cut : Cut
    atoms : Atoms
        The undeformed sample.
    pairs : ndarray of int64, shape (b, 2)
        Rows of its bonded atoms.

    Returns
    -------
    above, below : ndarray of bool, shape (n,)
    """
    x, is_above = atoms.position[:, 0], above(atoms.position, cut.y)
    ends = np.unique(pairs[crossing(cut, atoms.position, pairs)])
    found = []
    for side in (is_above, ~is_above):
        x_ends = x[ends[side[ends]]]
        if len(x_ends) == 0:
            return np.zeros_like(is_above), np.zeros_like(is_above)
        # Beyond the outermost atoms, and behind the slit, a cut has no end.
        low = -np.inf if cut.from_x < x.min() or _continues(cut, atoms.crack, atoms) else x_ends.min() - _TOUCHING
        high = np.inf if cut.to_x > x.max() else x_ends.max() + _TOUCHING
        found.append(side & (x >= low) & (x <= high))
    return found[0], found[1]


def severed(cut: Cut, atoms: Atoms, pairs: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which bonds (b, 2) have their atoms on the two `sides` of a cut, shape (b,)."""
    upper, lower = sides(cut, atoms, pairs)
    first, second = pairs.T
    return np.asarray((upper[first] & lower[second]) | (lower[first] & upper[second]))


def joined(cuts: tuple[Cut, ...], new: Cut, atoms: Atoms) -> tuple[Cut, ...]:
    """Cuts with one more, which lengthens those that it touches between the same rows of atoms."""
    is_above = above(atoms.position, new.y)
    rest = []
    for cut in cuts:
        beside = cut.from_x <= new.to_x + _TOUCHING and new.from_x <= cut.to_x + _TOUCHING
        if beside and np.array_equal(above(atoms.position, cut.y), is_above):
            new = Cut(min(cut.from_x, new.from_x), max(cut.to_x, new.to_x), cut.y)
        else:
            rest.append(cut)
    return (*rest, new)


def crack_with(crack: CrackCut | None, cuts: tuple[Cut, ...], atoms: Atoms) -> CrackCut | None:
    """The crack of a sample, lengthened by cuts that go on from it; the first cut is the crack where there is none."""
    low, high = float(atoms.position[:, 0].min()), float(atoms.position[:, 0].max())
    for cut in cuts:
        end = min(cut.to_x, high)
        if crack is None:
            crack = CrackCut(end, cut.y, None if cut.from_x < low else cut.from_x)
        elif _continues(cut, crack, atoms):
            crack = replace(crack, tip_x=max(crack.tip_x, end))
    return crack


def _continues(cut: Cut, crack: CrackCut | None, atoms: Atoms) -> bool:
    """Whether a cut begins at a crack's tip, to a spacing, and lies between its faces."""
    if crack is None:
        return False
    spacing = float(np.cbrt(atoms.atom_volume)) if atoms.spacing is None else atoms.spacing
    behind = atoms.position[atoms.position[:, 0] < crack.tip_x]
    return cut.from_x < crack.tip_x + spacing and np.array_equal(above(behind, cut.y), above(behind, crack.y))
