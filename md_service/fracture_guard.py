"""Watch over stretched bonds: what the cut-off of a bond-order potential does to them, and what to do about it.

A potential that switches a bond off over a few tenths of an angstrom multiplies its force there: all that is left of
the bond's energy must be spent within the window. Tip bonds then stick where the window begins, and hold loads far
above those of the material. Profiles with "sharp" in their name cut the bond at the end of the window instead. The cut
is so narrow (1e-12 angstrom) that no time step lands in it; a window of 1e-4 angstrom is hit about once in a hundred
cuts, and a force of 1e4 eV/angstrom then blows the sample up.

What is left of the bond's energy at the cut is not spent by the load: the potential energy jumps up while the atoms
keep their velocity. A sample that is pulled apart thus takes up this energy from nowhere, one `cut_energy` for every
bond, and the load need only do the rest of the face energy (Griffith). Both are figures of the profile, and
`released_energy` keeps the account.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from md_service.atoms import Atoms
from md_service.bonds import BondReport, Bonds
from md_service.cuts import Cut
from md_service.force_fields import ForceField

_ANGSTROM = 1e-10  # m
_ELECTRONVOLT = 1.602176634e-19  # J


class FractureGuard:
    """Bonds with warnings.

    Parameters
    ----------
    force_field : ForceField, optional
        Of the run; nothing is known of bonds without one.
    atoms : Atoms
        The sample, undeformed.

    Attributes
    ----------
    bonds : Bonds
    """

    def __init__(self, force_field: ForceField | None, atoms: Atoms) -> None:
        self.bonds = Bonds(atoms, force_field)
        self._force_field = force_field
        self._broken = 0
        self._text = ""

    @property
    def released_energy(self) -> float:
        """Energy that the cuts gave to the sample up to the last report, J: bonds broken then times `cut_energy`.

        Zero for force fields that do not cut.
        """
        field = self._force_field
        return 0.0 if field is None or field.cut_energy is None else self._broken * field.cut_energy

    def sever(self, cuts: tuple[Cut, ...]) -> None:
        """Take over all cuts through the sample."""
        self.bonds.sever(cuts)

    def report(self, position: NDArray[np.float64]) -> BondReport:
        """State of the bonds, with a warning while one sticks, or once one was cut.

        The warning names the first such bond and stays the same from then on, so that a run that collects warnings
        shows it once.

        Parameters
        ----------
        position : ndarray, shape (n, 3)
            Current positions, m, not wrapped.
        """
        report = self.bonds.report(position)
        # A bond that a cut severed is none that the force field cut.
        self._broken = report.broken - int(np.count_nonzero(self.bonds.severed))
        field = self._force_field
        if field is None or field.switching_start is None:
            return report
        if report.sticking:
            self._text = self._text or self._sticking_text(field, position)
            return replace(report, warning=self._text)
        if self._broken and field.cut_energy is not None:
            self._text = self._text or self._cut_text(field, field.cut_energy, position)
            return replace(report, warning=self._text)
        return report

    def _sticking_text(self, field: ForceField, position: NDArray[np.float64]) -> str:
        length = self.bonds.lengths(position)
        bond = int(np.argmax(np.where(self.bonds.sticking(length), length, 0.0)))
        return (
            f"The bond of {self._named(bond, position)} is stretched to {length[bond] / _ANGSTROM:.3f} A, where "
            f"{field.name} begins to switch it off. {field.cutoff_trap} {field.cure}"
        ).strip()

    def _cut_text(self, field: ForceField, cut_energy: float, position: NDArray[np.float64]) -> str:
        over = self.bonds.lengths(position) - self.bonds.limit
        bond = int(np.argmax(np.where(self.bonds.severed, -np.inf, over)))
        return (
            f"The bond of {self._named(bond, position)} is cut, with {cut_energy / _ELECTRONVOLT:.2f} eV of its energy "
            f"not spent. {field.cutoff_trap} {field.cure}"
        ).strip()

    def _named(self, bond: int, position: NDArray[np.float64]) -> str:
        first, second = self.bonds.pairs[bond]
        place = ", ".join(f"{value / _ANGSTROM:.1f}" for value in self.bonds.middle(position, bond))
        return f"atoms {first} and {second} at ({place}) A"
