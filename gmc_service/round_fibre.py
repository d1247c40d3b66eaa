"""Finite element meshes that follow a round fibre, alone in a square or a hexagonal cell: no steps, no corners.

What a grid of rectangular subcells is held against. With curved quadratic elements the error of the effective
constants falls with the fourth power of the element size.
"""

from __future__ import annotations

from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from gmc_service.periodic_elements import PeriodicMesh

Array = Literal["square", "hexagonal"]
#: Sides of the cell of each array; the first faces axis 2.
SIDES: Final[dict[Array, int]] = {"square": 4, "hexagonal": 6}
#: Half the side of the block of squares in the fibre's middle, over the radius.
_BLOCK: Final = 0.45


def largest_fraction(array: Array) -> float:
    """Fraction at which round fibres touch: pi / 4 in a square, pi / (2 sqrt 3) in a hexagonal array."""
    sides = SIDES[array]
    return np.pi / (sides * np.tan(np.pi / sides))


def round_fibre_mesh(fraction: float, refinement: int, array: Array = "square") -> PeriodicMesh:
    """Mesh of one round fibre in a square cell with side 1, or in a hexagonal one with unit distance of its sides.

    Parameters
    ----------
    fraction : float
        Share of the fibre.
    refinement : int
        A 24th of the number of elements around the fibre, half of that through the matrix.
    array : str
        ``square``, rows of fibres along axes 2 and 3; or ``hexagonal``, neighbours along axis 2.

    Returns
    -------
    PeriodicMesh
        Subcell 0 is the fibre, 1 the matrix.

    Raises
    ------
    ValueError
        If the fraction or the refinement is out of range.
    """
    limit = largest_fraction(array)
    if not 0.0 < fraction < limit:
        raise ValueError(f"fraction is {fraction}; in a {array} array it must lie between 0 and {limit:.4f}")
    if refinement < 1:
        raise ValueError(f"refinement is {refinement}; it must be at least 1")
    sides = SIDES[array]
    turn = 2.0 * np.pi / sides
    radius = np.sqrt(fraction * sides * 0.25 * np.tan(0.5 * turn) / np.pi)  # of the cell's area
    around, through = 24 * refinement, 2 * refinement
    # Lines of nodes go outwards from the centre.
    angle = np.pi * np.arange(2 * around) / around
    outward = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    edge = 0.5 / np.cos((angle + 0.5 * turn) % turn - 0.5 * turn)
    block = _BLOCK * radius / np.cos((angle + 0.25 * np.pi) % (0.5 * np.pi) - 0.25 * np.pi)
    step = np.linspace(0.0, 1.0, 2 * through + 1)[:, None, None]
    ring = (block[:, None] + (radius - block[:, None]) * step) * outward
    growth = edge[:, None] / radius
    bounds = radius * growth ** np.linspace(0.0, 1.0, through + 1)[:, None, None]  # as the field decays
    shell = np.empty((2 * through + 1, 2 * around, 2))
    shell[::2] = bounds * outward
    shell[1::2] = 0.5 * (shell[:-1:2] + shell[2::2])
    side = around // 4
    line = _BLOCK * radius * np.tan(0.25 * np.pi * np.linspace(-1.0, 1.0, 2 * side + 1))
    middle = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1)
    fibre = np.concatenate([_elements(middle), _elements(np.concatenate([ring, ring[:, :1]], axis=1))])
    matrix = _elements(np.concatenate([shell, shell[:, :1]], axis=1))
    points = np.concatenate([fibre, matrix])
    subcell = np.repeat(np.array([0, 1]), [len(fibre), len(matrix)])
    return PeriodicMesh(points, _periodic_numbers(points, array), subcell)


def _elements(places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Nodes (elements, 9, 2) of the elements on a patch of (2 a + 1, 2 b + 1, 2) places."""
    rows, columns = (places.shape[0] - 1) // 2, (places.shape[1] - 1) // 2
    i = 2 * np.arange(rows)[:, None, None, None] + np.arange(3)[:, None]
    j = 2 * np.arange(columns)[None, :, None, None] + np.arange(3)[None, :]
    return places[i, j].reshape(-1, 9, 2)


def _periodic_numbers(points: NDArray[np.float64], array: Array) -> NDArray[np.int64]:
    """One number for all nodes that a shift of the array carries onto each other, shape (elements, 9)."""
    second = (0.0, 1.0) if array == "square" else (0.5, np.sqrt(0.75))
    share = points.reshape(-1, 2) @ np.linalg.inv(np.array([(1.0, 0.0), second]))
    grid = np.round(share * 2.0**30).astype(np.int64) % 2**30
    # A place that rounding puts on either side of a grid point would get two numbers: compare on a coarse grid.
    _, numbers = np.unique((grid + 2**9) % 2**30 // 2**10, axis=0, return_inverse=True)
    return numbers.reshape(len(points), 9).astype(np.int64)
