"""A harmonic lattice as large as a whole body, solved at once: what a coupled run is held against.

Close-packed rows along x with springs between neighbours, at displacements so small that the springs are linear. The
atoms at the border have given displacements, the others are where no force is left on them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import spsolve
from scipy.spatial import cKDTree

from protocol.arrays import FloatArray, IntArray

#: Neighbours are nearer than this many spacings.
_REACH = 1.2


@dataclass(frozen=True)
class Lattice:
    """Places of atoms and the bonds between them.

    Attributes
    ----------
    place : float64 array, shape (atoms, 2)
        m.
    bonds : int64 array, shape (bonds, 2)
        Rows of neighbours.
    """

    place: FloatArray
    bonds: IntArray

    @classmethod
    def of(cls, place: FloatArray, spacing: float) -> Lattice:
        """Tie neighbours at places, shape (atoms, 2), of a lattice of a spacing, m."""
        bonds = cKDTree(place).query_pairs(_REACH * spacing, output_type="ndarray").astype(np.int64)
        return cls(place, bonds)

    @property
    def directions(self) -> FloatArray:
        """Unit vectors along the bonds, shape (bonds, 2)."""
        way = self.place[self.bonds[:, 1]] - self.place[self.bonds[:, 0]]
        return np.asarray(way / np.linalg.norm(way, axis=1)[:, None])

    @property
    def middles(self) -> FloatArray:
        """Middles of the bonds, shape (bonds, 2), m."""
        return np.asarray(0.5 * (self.place[self.bonds[:, 0]] + self.place[self.bonds[:, 1]]))

    def stretches(self, displacement: FloatArray) -> FloatArray:
        """Lengthening of each bond, m, by small displacements of the atoms, shape (atoms, 2), m."""
        way = displacement[self.bonds[:, 1]] - displacement[self.bonds[:, 0]]
        return np.asarray(np.einsum("ij,ij->i", self.directions, way))

    def at_rest(self, given: FloatArray, held: np.ndarray) -> FloatArray:
        """Displacements of all atoms, shape (atoms, 2), where those of `held` are `given`, m.

        Parameters
        ----------
        given : float64 array, shape (atoms, 2)
            m; looked at where held.
        held : bool array, shape (atoms,)
        """
        # Forces are D' D u with D the stretches by the displacements.
        count, n = len(self.bonds), self.directions
        row = np.repeat(np.arange(count), 4)
        column = np.column_stack([2 * self.bonds[:, :1], 2 * self.bonds[:, :1] + 1, 2 * self.bonds[:, 1:],
                                  2 * self.bonds[:, 1:] + 1]).ravel()  # fmt: skip
        stretch = csr_matrix((np.column_stack([-n, n]).ravel(), (row, column)), (count, 2 * len(self.place)))
        stiffness = (stretch.T @ stretch).tocsc()
        fixed = np.repeat(held, 2)
        u = np.where(fixed, given.ravel(), 0.0)
        u[~fixed] = spsolve(stiffness[~fixed][:, ~fixed], -(stiffness[~fixed][:, fixed] @ u[fixed]))
        return u.reshape(-1, 2)


def lengthened(sample: FloatArray, spacing: float, half_size: float, tip_x: float, y: float, rows: int) -> FloatArray:
    """Places of the lattice of a sample with a slit, continued to the edges of a square about the origin.

    Parameters
    ----------
    sample : float64 array, shape (atoms, 2)
        Places of its atoms, m.
    spacing : float
        m.
    half_size : float
        Half the edge of the square, m.
    tip_x, y : float
        Tip and height of the slit, m.
    rows : int
        Rows of atoms that the slit takes out, an odd number.

    Returns
    -------
    float64 array, shape (more atoms, 2)
        The first ones are those of the sample, in their order.

    Raises
    ------
    ValueError
        If the sample is no such lattice.
    """
    height = 0.5 * np.sqrt(3.0) * spacing
    count = int(half_size / height) + 1
    along = int(half_size / spacing) + 2
    row, column = np.meshgrid(np.arange(-count, count + 1), np.arange(-along, along + 1), indexing="ij")
    offset = np.rint((sample[0, 1] - y) / height)
    start = np.remainder(sample[0, 0], spacing)
    x = start + (column + 0.5 * ((row - offset) % 2)) * spacing
    place = np.column_stack([x.ravel(), y + height * row.ravel()])
    place = place[(np.abs(place) <= half_size).all(axis=1)]
    slit = (np.abs(place[:, 1] - y) < 0.5 * rows * height) & (place[:, 0] < tip_x)
    place = place[~slit]
    distance, twin = cKDTree(place).query(sample)
    if distance.max() > 1e-4 * spacing:
        raise ValueError(f"an atom of the sample is {distance.max():.3g} m from all sites of the lattice")
    beside = np.ones(len(place), dtype=bool)
    beside[twin] = False
    return np.concatenate([sample, place[beside]])
