"""Pairs of near atoms, images across periodic boundaries included."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from md_service.atoms import Atoms

#: Components of a symmetric tensor in the order of a virial.
VIRIAL_AXES: Final = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


def neighbour_pairs(atoms: Atoms, reach: float) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Pairs of atoms nearer than a distance, each once, in the order of their rows.

    Parameters
    ----------
    atoms : Atoms
        Sample, every atom in its box or less than a cell's width outside.
    reach : float
        m.

    Returns
    -------
    first, second : ndarray of int64, shape (b,)
        Rows of the atoms.
    shift : ndarray, shape (b, 3)
        What to add to the second position to reach its image, m.

    Raises
    ------
    ValueError
        If a periodic edge is shorter than `reach`, so that images beyond the next would count.
    """
    widths = np.diag(atoms.box.edges)
    for axis, periodic in enumerate(atoms.box.periodic):
        if periodic and widths[axis] < reach:
            raise ValueError(
                f"box is {widths[axis]:.4g} m along {'xyz'[axis]}; at least {reach:.4g} m is needed there, the range "
                "of the forces"
            )
    tree = cKDTree(atoms.position)
    first, second, shift = [], [], []
    images = [range(-1, 2) if periodic else range(1) for periodic in atoms.box.periodic]
    for image in np.array(np.meshgrid(*images, indexing="ij")).reshape(3, -1).T:
        if tuple(image) < (0, 0, 0):  # of an image and its opposite one is enough
            continue
        moved = image @ atoms.box.edges
        if image.any():
            found = tree.sparse_distance_matrix(cKDTree(atoms.position + moved), reach, output_type="ndarray")
            pairs = np.column_stack([found["i"], found["j"]]).astype(np.int64)
        else:
            pairs = tree.query_pairs(reach, output_type="ndarray").astype(np.int64)
        first.append(pairs[:, 0])
        second.append(pairs[:, 1])
        shift.append(np.tile(moved, (len(pairs), 1)))
    rows = np.column_stack([np.concatenate(first), np.concatenate(second)])
    shifts = np.concatenate(shift)
    order = np.lexsort((shifts[:, 2], shifts[:, 1], shifts[:, 0], rows[:, 1], rows[:, 0]))
    rows = rows[order]
    return np.ascontiguousarray(rows[:, 0]), np.ascontiguousarray(rows[:, 1]), shifts[order]
