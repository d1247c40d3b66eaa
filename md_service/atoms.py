"""A sample of atoms: what builders make, force fields describe and engines move.

All quantities are SI but charges, which are in elementary charges. Rows of every per-atom array are the atoms' ids,
from 0.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

Note = str | int | float


@dataclass(frozen=True)
class CrackCut:
    """A straight slit in a sheet, along x.

    Attributes
    ----------
    tip_x : float
        Right end of the slit, m: atoms of the cut row with x below this value are removed.
    y : float
        Height of the slit's middle line, m.
    left_x : float, optional
        Left end of a slit inside the sheet, m. Without it the slit starts at the left edge.
    """

    tip_x: float
    y: float = 0.0
    left_x: float | None = None


@dataclass(frozen=True)
class Box:
    """Region that the atoms fill.

    Attributes
    ----------
    low, high : ndarray, shape (3,)
        Corners, m.
    periodic : tuple of bool
        Whether the box repeats along x, y, z. In other directions the boundary is free.
    tilt : ndarray, shape (3,)
        xy, xz and yz of a periodic box that is sheared, m: the second edge is (xy, ly, 0), the third (xz, yz, lz).
    """

    low: NDArray[np.float64]
    high: NDArray[np.float64]
    periodic: tuple[bool, bool, bool] = (False, False, False)
    tilt: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))

    @property
    def edges(self) -> NDArray[np.float64]:
        """Edge vectors as rows, m, shape (3, 3)."""
        xy, xz, yz = self.tilt
        lx, ly, lz = self.high - self.low
        return np.array([[lx, 0.0, 0.0], [xy, ly, 0.0], [xz, yz, lz]])

    @property
    def volume(self) -> float:
        """m^3."""
        return float(np.prod(self.high - self.low))

    def wrapped(self, position: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Positions inside the box and the images (n, 3) they came from: position = inside + images @ edges."""
        fraction = (position - self.low) @ np.linalg.inv(self.edges)
        images = np.floor(fraction).astype(np.int64) * np.array(self.periodic)
        return position - images @ self.edges, images


@dataclass(frozen=True)
class Topology:
    """Bonds of a molecular force field.

    Attributes
    ----------
    bonds, angles, dihedrals, impropers : ndarray of int64, shape (n, 3), (n, 4), (n, 5), (n, 5)
        Index into the names below, then the rows of the atoms.
    bond_names, angle_names, dihedral_names, improper_names : tuple of str
        Type labels, by which a force field finds coefficients, such as ``"CA-CA"``.
    """

    bonds: NDArray[np.int64]
    angles: NDArray[np.int64]
    dihedrals: NDArray[np.int64]
    impropers: NDArray[np.int64]
    bond_names: tuple[str, ...]
    angle_names: tuple[str, ...]
    dihedral_names: tuple[str, ...]
    improper_names: tuple[str, ...]


@dataclass(frozen=True)
class Atoms:
    """Atoms with their box.

    Attributes
    ----------
    position : ndarray, shape (n, 3)
        m; not wrapped, so that molecules are whole.
    kind : ndarray of int64, shape (n,)
        Index of each atom's species.
    species : tuple of str
        Names of the species: elements, or atom types of a molecular force field.
    elements : tuple of str
        Chemical symbol of each species.
    mass : ndarray, shape (species,)
        kg.
    box : Box
    charge : ndarray, shape (n,), optional
        Elementary charges.
    molecule : ndarray of int64, shape (n,), optional
        Number of each atom's molecule, from 1.
    topology : Topology, optional
        Of a molecular force field.
    spacing : float, optional
        Nearest-neighbour distance of a crystal, m.
    thickness : float, optional
        Of a sheet, m; stresses and the volume of an atom refer to it.
    crack : CrackCut, optional
        The slit, from which crack growth is counted.
    site_volume : float, optional
        Volume of a site of a crystal or sheet, m^3; without it an atom has its share of the box.
    notes : dict of str to str, int or float
        Where the sample comes from: command, seed, conversion, density.
    """

    position: NDArray[np.float64]
    kind: NDArray[np.int64]
    species: tuple[str, ...]
    elements: tuple[str, ...]
    mass: NDArray[np.float64]
    box: Box
    charge: NDArray[np.float64] | None = None
    molecule: NDArray[np.int64] | None = None
    topology: Topology | None = None
    spacing: float | None = None
    thickness: float | None = None
    crack: CrackCut | None = None
    site_volume: float | None = None
    notes: dict[str, Note] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.position)

    @property
    def atom_mass(self) -> NDArray[np.float64]:
        """Mass of each atom, kg, shape (n,)."""
        return self.mass[self.kind]

    @property
    def volume(self) -> float:
        """m^3; of a sheet the area of its box times its thickness."""
        if self.thickness is None:
            return self.box.volume
        lx, ly, _ = self.box.high - self.box.low
        return float(lx * ly * self.thickness)

    @property
    def atom_volume(self) -> float:
        """Volume of an atom, m^3, to which stresses refer."""
        return self.volume / len(self) if self.site_volume is None else self.site_volume

    @property
    def density(self) -> float:
        """kg/m^3."""
        return float(self.atom_mass.sum() / self.volume)

    def at(self, position: NDArray[np.float64], box: Box | None = None) -> Atoms:
        """The same atoms at other positions, m, shape (n, 3), and in another box if one is given."""
        return replace(self, position=np.ascontiguousarray(position), box=self.box if box is None else box)
