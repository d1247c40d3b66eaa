"""Molecules as elements, positions and bonds, and the two monomers of the resin.

EPON 862 is the diglycidyl ether of bisphenol F (DGEBF, C19H20O4), cured with diethyltoluenediamine (DETDA, C11H18N2).
"""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from md_service.units import MASS

ELEMENT_MASS: Final = {
    name: value * MASS for name, value in {"H": 1.008, "C": 12.011, "N": 14.007, "O": 15.999}.items()
}
_TABLE = Path(__file__).parent / "data" / "epoxy_monomers.toml"


@dataclass(frozen=True)
class Molecule:
    """Bonded atoms without types.

    Attributes
    ----------
    elements : tuple of str
        Chemical symbols, one per atom.
    position : ndarray, shape (n, 3)
        m.
    bonds : ndarray of int64, shape (m, 2)
        Rows of the bonded atoms.
    """

    elements: tuple[str, ...]
    position: NDArray[np.float64]
    bonds: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.elements)

    @property
    def mass(self) -> float:
        """kg."""
        return float(sum(ELEMENT_MASS[element] for element in self.elements))

    def at(self, position: NDArray[np.float64]) -> Molecule:
        """The same molecule at other positions, m, shape (n, 3)."""
        return Molecule(self.elements, position, self.bonds)


def joined(molecules: Sequence[Molecule]) -> Molecule:
    """One set of atoms of several molecules, in their order."""
    starts = np.cumsum([0, *(len(molecule) for molecule in molecules)])
    return Molecule(
        tuple(element for molecule in molecules for element in molecule.elements),
        np.concatenate([molecule.position for molecule in molecules]),
        np.concatenate([m.bonds + start for m, start in zip(molecules, starts[:-1], strict=True)]).astype(np.int64),
    )


@lru_cache
def monomer(name: str) -> Molecule:
    """``DGEBF`` (43 atoms, two epoxide groups) or ``DETDA`` (31 atoms, two primary amines).

    Raises
    ------
    ValueError
        If there is no such monomer.
    """
    table = tomllib.loads(_TABLE.read_text())
    if name not in table:
        raise ValueError(f"monomer {name!r} is not known, known are {', '.join(table)}")
    row = table[name]
    return Molecule(
        tuple(row["elements"].split()),
        np.array(row["position"]) * 1e-10,
        np.array(row["bonds"], dtype=np.int64),
    )
