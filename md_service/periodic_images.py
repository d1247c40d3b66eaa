"""Copies of atoms across periodic boundaries, so that sums over neighbours need to know nothing of periodicity."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from md_service.atoms import Box


def images_near(
    position: NDArray[np.float64], box: Box, margin: float
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Atoms and their periodic copies within the upright box from `low` to `high` and a margin around it.

    The upright box is a cell of the lattice of a sheared box as well, because its edges are triangular. Atoms in free
    directions stay where they are, inside or outside.

    Parameters
    ----------
    position : ndarray, shape (n, 3)
        m.
    box : Box
    margin : float
        m, not negative.

    Returns
    -------
    row : ndarray of int64, shape (m,)
        Atom of each image; the first n are the atoms themselves, moved into the upright box.
    image : ndarray, shape (m, 3)
        m.
    """
    edges = box.edges
    row = np.arange(len(position), dtype=np.int64)
    image = np.array(position, dtype=np.float64)
    # An edge changes no coordinate behind its own, so what an earlier pass settled stays.
    for axis in (2, 1, 0):
        if not box.periodic[axis]:
            continue
        length = edges[axis, axis]
        image -= np.floor((image[:, axis] - box.low[axis]) / length)[:, None] * edges[axis]
        rows, images = [row], [image]
        reach = int(np.ceil(margin / length))
        for shift in [*range(-reach, 0), *range(1, reach + 1)]:
            moved = image + shift * edges[axis]
            near = (moved[:, axis] >= box.low[axis] - margin) & (moved[:, axis] <= box.high[axis] + margin)
            rows.append(row[near])
            images.append(moved[near])
        row, image = np.concatenate(rows), np.concatenate(images)
    return row, image
