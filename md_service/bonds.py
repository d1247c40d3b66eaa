"""Broken bonds and the crack tip, by connectivity."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from md_service.force_fields import ForceField
from md_service.graphene import CrackCut, bonds_of

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
        Bonds longer than the force field's switching end.
    tip_x : float
        Largest reference x of the middles of broken bonds connected to the initial slit, m; the slit's own tip
        while none is, and nan for a sheet without slit.
    longest_length : float
        Length of the longest unbroken bond, m.
    longest_position : ndarray, shape (3,)
        Middle of that bond now, m.
    sticking : int
        Unbroken bonds within 2 % of the switching start.
    warning : str
        What sticking bonds mean, or empty.
    """

    broken: int
    tip_x: float
    longest_length: float
    longest_position: NDArray[np.float64]
    sticking: int
    warning: str


class Bonds:
    """Bonds of a reference configuration.

    Parameters
    ----------
    reference : ndarray, shape (n, 3)
        Undeformed positions, m.
    force_field : ForceField
        Gives bond length and the limits of a bond.
    crack : CrackCut, optional
        Initial slit, from which crack growth is counted.
    """

    def __init__(self, reference: NDArray[np.float64], force_field: ForceField, crack: CrackCut | None) -> None:
        self.pairs = bonds_of(reference, force_field.lattice_constant)
        self._middle = 0.5 * (reference[self.pairs[:, 0]] + reference[self.pairs[:, 1]])
        self._force_field = force_field
        self._crack = crack

    def report(self, position: NDArray[np.float64]) -> BondReport:
        """State of the bonds at the given positions.

        Parameters
        ----------
        position : ndarray, shape (n, 3)
            Current positions, m, rows as in the reference.
        """
        field = self._force_field
        first, second = position[self.pairs[:, 0]], position[self.pairs[:, 1]]
        length = np.linalg.norm(second - first, axis=1)
        broken = length > field.switching_end
        whole = np.where(broken, 0.0, length)
        longest = int(np.argmax(whole))
        near_switch = np.abs(length / field.switching_start - 1.0) < _STICKING_RANGE
        sticking = int(np.count_nonzero(near_switch & ~broken))
        return BondReport(
            broken=int(np.count_nonzero(broken)),
            tip_x=self._tip_x(broken),
            longest_length=float(whole[longest]),
            longest_position=0.5 * (first[longest] + second[longest]),
            sticking=sticking,
            warning=_sticking_warning(sticking, field),
        )

    def _tip_x(self, broken: NDArray[np.bool_]) -> float:
        if self._crack is None:
            return float("nan")
        tip_x = self._crack.tip_x
        middle = self._middle[broken]
        if len(middle) == 0:
            return tip_x
        bond_length = self._force_field.lattice_constant
        links = cKDTree(middle).query_pairs(_ONE_RING * bond_length, output_type="ndarray")
        graph = coo_array((np.ones(len(links)), (links[:, 0], links[:, 1])), shape=(len(middle), len(middle)))
        _, cluster = connected_components(graph, directed=False)
        beyond = np.maximum(middle[:, 0] - tip_x, 0.0)
        at_slit = np.hypot(beyond, middle[:, 1] - self._crack.y) < _AROUND_SLIT * bond_length
        of_crack = np.isin(cluster, cluster[at_slit])
        return float(max(tip_x, middle[of_crack, 0].max())) if of_crack.any() else tip_x


def _sticking_warning(sticking: int, field: ForceField) -> str:
    """Return why stretched bonds may hold against the load; of a cut-off without a window there is no such danger."""
    if not sticking or field.switching_end - field.switching_start < _SHARPEST_WINDOW:
        return ""
    # The number of bonds stays out of the text, so that a run warns once and not at every step.
    return f"bonds at the crack are stretched to the switching start of {field.name}. {field.cutoff_trap}"
