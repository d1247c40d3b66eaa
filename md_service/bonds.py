"""Bonds of a sample: which exist, which are broken, where the crack's tip is, by connectivity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from md_service.atoms import Atoms, CrackCut
from md_service.cuts import Cut, crack_with, crossing, severed
from md_service.force_fields import ForceField
from md_service.neighbour_pairs import neighbour_pairs

#: Covalent radii, m (Cordero et al., Dalton Trans. 2008, 2832; sp3 carbon).
COVALENT_RADIUS: Final = {
    "H": 0.31e-10, "B": 0.84e-10, "C": 0.76e-10, "N": 0.71e-10, "O": 0.66e-10, "F": 0.57e-10, "Si": 1.11e-10,
    "P": 1.07e-10, "S": 1.05e-10, "Cl": 1.02e-10,
}  # fmt: skip
#: Atoms closer than this many neighbour distances, or sums of covalent radii, are bonded in the reference.
REACH: Final = 1.2
#: A bond without a switching function is broken at this many times its length in the reference.
BROKEN: Final = 1.4
# Middles of two bonds of one hexagon are at most sqrt(3) bond lengths apart: such bonds belong to one crack.
_ONE_RING = 1.8
# The faces of the slit and its tip are this many bond lengths from the line of the slit, at most.
_AROUND_SLIT = 2.0
_STICKING_RANGE = 0.02
_SHARPEST_WINDOW = 1e-13  # m; no bond stays in a window narrower than this


@dataclass(frozen=True)
class BondReport:
    """State of the bonds that existed in the reference configuration.

    Attributes
    ----------
    broken : int
        Bonds longer than the force field's switching end; where it switches nothing off, longer than `BROKEN` times
        their length in the reference; and those that a cut severed.
    tip_x : float
        Largest reference x of the middles of broken bonds connected to the initial slit, m, and the end of a cut that
        is connected to it; the slit's own tip while none is, and nan for a sample without slit or cut.
    longest_length : float
        Length of the longest unbroken bond, m; nan in a sample without bonds.
    longest_atoms : tuple of int
        Rows of that bond's atoms, empty in a sample without bonds.
    longest_position : ndarray, shape (3,)
        Middle of that bond now, m.
    sticking : int
        Unbroken bonds within 2 % of the switching start.
    warning : str
        What a user should know about the bonds now, or empty; `FractureGuard` writes it.
    """

    broken: int
    tip_x: float
    longest_length: float
    longest_atoms: tuple[int, ...]
    longest_position: NDArray[np.float64]
    sticking: int
    warning: str = ""


class Bonds:
    """Bonds of a sample's reference configuration.

    They are the topology's if there is one; else pairs of atoms within `REACH` neighbour distances of a crystal; else
    pairs within `REACH` sums of covalent radii. Bonds across the faces of a periodic box count; the box is not to
    change.

    Parameters
    ----------
    atoms : Atoms
        The sample, undeformed.
    force_field : ForceField, optional
        Where carbon bonds are switched off; nothing is known of other bonds.

    Attributes
    ----------
    pairs : ndarray of int64, shape (b, 2)
        Rows of the bonded atoms, the lower one first, sorted.
    limit : ndarray, shape (b,)
        Length above which each bond is broken, m.
    severed : ndarray of bool, shape (b,)
        Bonds that cuts severed, which are broken at any length.
    crack : CrackCut or None
        The slit, as cuts lengthened it; of a sample without slit its first cut.
    """

    def __init__(self, atoms: Atoms, force_field: ForceField | None) -> None:
        self._atoms = atoms
        self.pairs, shift = bonded_pairs(atoms)
        self._first, self._second = self.pairs.T.copy()
        # Positions are not wrapped, so the image in which a neighbour was found stays the one it is bonded to.
        self._shift = shift.T.copy() if shift.any() else None
        length = self.lengths(atoms.position)
        self._middle = 0.5 * (atoms.position[self._first] + atoms.position[self._second] + shift)
        self.limit = BROKEN * length
        self._sticking_from = np.full(len(length), np.inf)
        self._sticking_to = np.full(len(length), -np.inf)
        start, end = (None, None) if force_field is None else (force_field.switching_start, force_field.switching_end)
        if start is not None and end is not None:
            carbon = np.array([element == "C" for element in atoms.elements])[atoms.kind]
            switched = carbon[self._first] & carbon[self._second]
            self.limit[switched] = end
            if end - start > _SHARPEST_WINDOW:
                self._sticking_from[switched] = (1.0 - _STICKING_RANGE) * start
                self._sticking_to[switched] = (1.0 + _STICKING_RANGE) * start
        self._spacing = float(np.median(length)) if atoms.spacing is None and len(length) else atoms.spacing or 0.0
        self._links = csr_array((len(length), len(length)))  # bonds of one ring of atoms
        self.sever(())

    def __len__(self) -> int:
        return len(self.pairs)

    def sever(self, cuts: tuple[Cut, ...]) -> None:
        """Take over all cuts through the sample."""
        self.severed = np.zeros(len(self), dtype=bool)
        self._end = self._middle[:, 0].copy()  # where a broken bond brings the tip
        for cut in cuts:
            of_cut = severed(cut, self._atoms, self.pairs)
            self.severed |= of_cut
            self._end[of_cut] = min(cut.to_x, self._atoms.position[:, 0].max())
        self.crack = crack_with(self._atoms.crack, cuts, self._atoms)
        self._find_slit(self.crack)

    def _find_slit(self, crack: CrackCut | None) -> None:
        """Which bonds are at the slit, from where the tip's way is followed from bond to bond."""
        self._broken_before = np.zeros(len(self), dtype=bool)
        self._tip_before = np.nan if crack is None else crack.tip_x
        self._at_slit = np.zeros(len(self), dtype=bool)
        if crack is None or not len(self):
            return
        if not self._links.nnz:
            links = cKDTree(self._middle).query_pairs(_ONE_RING * self._spacing, output_type="ndarray")
            self._links = csr_array((np.ones(len(links)), (links[:, 0], links[:, 1])), shape=self._links.shape)
        x, y = self._middle[:, 0], self._middle[:, 1]
        left = -np.inf if crack.left_x is None else crack.left_x
        beyond = np.maximum(np.maximum(x - crack.tip_x, left - x), 0.0)
        self._at_slit = np.hypot(beyond, y - crack.y) < _AROUND_SLIT * self._spacing

    def crossed(self, cut: Cut) -> int:
        """Number of bonds that a line crosses."""
        return int(np.count_nonzero(crossing(cut, self._atoms.position, self.pairs)))

    def broken(self, length: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which bonds of these lengths, m, shape (b,), are broken."""
        return (length > self.limit) | self.severed

    def lengths(self, position: NDArray[np.float64]) -> NDArray[np.float64]:
        """Lengths of all bonds, m, shape (b,), for positions (n, 3) in m that are not wrapped."""
        square = np.zeros(len(self.pairs))
        # Column by column: half the time of gathering rows.
        for axis in range(3):
            column = np.ascontiguousarray(position[:, axis])
            difference = column[self._second] - column[self._first]
            if self._shift is not None:
                difference += self._shift[axis]
            square += difference * difference
        return np.sqrt(square)

    def report(self, position: NDArray[np.float64]) -> BondReport:
        """State of the bonds at the given positions.

        Parameters
        ----------
        position : ndarray, shape (n, 3)
            Current positions, m, not wrapped, rows as in the reference.
        """
        length = self.lengths(position)
        broken = self.broken(length)
        whole = np.where(broken, 0.0, length)
        if not whole.any():
            return BondReport(int(broken.sum()), self._tip_x(broken), np.nan, (), np.full(3, np.nan), 0)
        longest = int(np.argmax(whole))
        return BondReport(
            broken=int(np.count_nonzero(broken)),
            tip_x=self._tip_x(broken),
            longest_length=float(whole[longest]),
            longest_atoms=(int(self._first[longest]), int(self._second[longest])),
            longest_position=self.middle(position, longest),
            sticking=int(np.count_nonzero(self.sticking(length))),
        )

    def sticking(self, length: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which unbroken bonds, shape (b,), are stretched to the start of the switching function."""
        return (length > self._sticking_from) & (length < self._sticking_to) & ~self.severed

    def middle(self, position: NDArray[np.float64], bond: int) -> NDArray[np.float64]:
        """Middle of a bond, m, shape (3,)."""
        shift = 0.0 if self._shift is None else self._shift[:, bond]
        return 0.5 * (position[self._first[bond]] + position[self._second[bond]] + shift)

    def _tip_x(self, broken: NDArray[np.bool_]) -> float:
        if self.crack is None:
            return float("nan")
        if not np.array_equal(broken, self._broken_before):
            self._broken_before, self._tip_before = broken, self._tip_of(broken, self.crack.tip_x)
        return self._tip_before

    def _tip_of(self, broken: NDArray[np.bool_], tip_x: float) -> float:
        rows = np.flatnonzero(broken)
        if len(rows) == 0:
            return tip_x
        _, cluster = connected_components(self._links[rows][:, rows], directed=False)
        of_crack = rows[np.isin(cluster, cluster[self._at_slit[rows]])]
        return max(tip_x, float(self._end[of_crack].max(initial=tip_x)))


def bonded_pairs(atoms: Atoms) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return pairs of bonded rows (b, 2), and what to add to the second position to reach its partner, m, (b, 3)."""
    box = atoms.box
    if atoms.topology is not None:
        pairs = np.sort(atoms.topology.bonds[:, 1:3], axis=1)
        if not any(box.periodic):
            return _sorted(pairs, np.zeros((len(pairs), 3)))
        vector = atoms.position[pairs[:, 1]] - atoms.position[pairs[:, 0]]
        images = np.rint(vector @ np.linalg.inv(box.edges)) * np.array(box.periodic)
        return _sorted(pairs, -images @ box.edges)
    if atoms.spacing is not None:
        return _pairs_within(atoms, REACH * atoms.spacing)
    radius = np.array([COVALENT_RADIUS.get(element, 0.0) for element in atoms.elements])[atoms.kind]
    if not radius.any():
        return np.empty((0, 2), dtype=np.int64), np.empty((0, 3))
    pairs, shift = _pairs_within(atoms, 2.0 * REACH * radius.max())
    vector = atoms.position[pairs[:, 1]] + shift - atoms.position[pairs[:, 0]]
    first, second = radius[pairs[:, 0]], radius[pairs[:, 1]]
    bonded = (np.linalg.norm(vector, axis=1) < REACH * (first + second)) & (first > 0.0) & (second > 0.0)
    return pairs[bonded], shift[bonded]


def _pairs_within(atoms: Atoms, reach: float) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Like `bonded_pairs`, by distance; positions need not be wrapped."""
    if not any(atoms.box.periodic):
        first, second, shift = neighbour_pairs(atoms, reach)
        return _sorted(np.column_stack([first, second]), shift)
    inside, image = atoms.box.wrapped(atoms.position)
    first, second, shift = neighbour_pairs(atoms.at(inside), reach)
    return _sorted(np.column_stack([first, second]), shift + (image[first] - image[second]) @ atoms.box.edges)


def _sorted(pairs: NDArray[np.int64], shift: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    turned = pairs[:, 0] > pairs[:, 1]
    pairs, shift = np.where(turned[:, None], pairs[:, ::-1], pairs), np.where(turned[:, None], -shift, shift)
    order = np.lexsort((pairs[:, 1], pairs[:, 0]))
    return pairs[order], shift[order]
