"""Builder of graphene sheets, whole or with a slit.

The zigzag direction lies along x. Zigzag chains, each of two atom rows half a bond length apart, follow one
another along y at a distance of 1.5 bond lengths::

    row 2   o   o   o      y = 3a/2
            |   |   |
    row 1   o   o   o      y = a/2     \\ one chain
          o   o   o   o    y = 0       /
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

GRAPHENE_THICKNESS = 3.35e-10  # m, by convention the distance of the layers of graphite
NEIGHBOUR_RANGE = 1.2  # bonds of an undeformed sheet are shorter than this many bond lengths


@dataclass(frozen=True)
class CrackCut:
    """A straight slit from the left edge of a sheet.

    Attributes
    ----------
    tip_x : float
        Atoms of the cut chain with x below this value are removed, m.
    y : float
        Height of the slit's middle line, m.
    """

    tip_x: float
    y: float = 0.0


@dataclass(frozen=True)
class Sheet:
    """A graphene sheet in the plane z = 0.

    Attributes
    ----------
    position : ndarray, shape (n, 3)
        Atom positions, m, rows sorted by y, then x.
    width, height : float
        True size, m: number of cells times their size.
    lattice_constant : float
        Carbon-carbon distance, m.
    crack : CrackCut or None
        The slit as cut.
    """

    position: NDArray[np.float64]
    width: float
    height: float
    lattice_constant: float
    crack: CrackCut | None


def bonds_of(position: NDArray[np.float64], lattice_constant: float) -> NDArray[np.int64]:
    """Pairs of neighbours in an undeformed sheet.

    Parameters
    ----------
    position : ndarray, shape (n, 3)
        Atom positions, m.
    lattice_constant : float
        Carbon-carbon distance, m.

    Returns
    -------
    ndarray, shape (n_bonds, 2)
        Rows of `position`, the lower one first, sorted.
    """
    pairs = cKDTree(position).query_pairs(NEIGHBOUR_RANGE * lattice_constant, output_type="ndarray")
    return np.ascontiguousarray(pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))], dtype=np.int64)


def area_per_atom(lattice_constant: float) -> float:
    """Area of the sheet that belongs to one atom, m^2, for a carbon-carbon distance in m."""
    return float(0.75 * np.sqrt(3.0) * lattice_constant**2)


def sheet(width: float, height: float, lattice_constant: float, crack: CrackCut | None = None) -> Sheet:
    """Build a sheet with free edges, centred on the origin.

    With a crack the number of chains is odd and the chain nearest to ``crack.y`` is removed from the left edge
    to the tip; the sheet is then shifted along y until the slit lies exactly on ``crack.y``. The slit's faces are
    zigzag edges 2.5 bond lengths apart, so no potential binds them again. Atoms with one neighbour are removed.

    Parameters
    ----------
    width, height : float
        Wanted size along x and y, m. The nearest number of whole cells is built.
    lattice_constant : float
        Carbon-carbon distance, m.
    crack : CrackCut, optional
        Slit to cut.

    Returns
    -------
    Sheet

    Raises
    ------
    ValueError
        If the sheet is smaller than three cells or the crack's tip or height lie outside of it.
    """
    if not lattice_constant > 0.0:
        raise ValueError(f"lattice_constant is {lattice_constant} m; it must be positive")
    cell_x, chain_y = np.sqrt(3.0) * lattice_constant, 1.5 * lattice_constant
    n_x = round(width / cell_x)
    n_chains = round(height / chain_y) if crack is None else 2 * round((height / chain_y - 1.0) / 2.0) + 1
    if n_x < 3 or n_chains < 3:
        raise ValueError(
            f"width {width} m and height {height} m hold {n_x} x {n_chains} cells of {cell_x:.3e} m x {chain_y:.3e} m; "
            "at least 3 x 3 are needed"
        )

    # Chains alternate: in an even chain the lower row starts at x = 0, in an odd one it is shifted by half a cell.
    chain, upper, column = np.meshgrid(np.arange(n_chains), np.arange(2), np.arange(n_x), indexing="ij")
    x = (column + 0.5 * ((chain + upper) % 2)) * cell_x
    y = chain * chain_y + 0.5 * upper * lattice_constant
    x -= 0.5 * (n_x - 0.5) * cell_x
    y -= 0.5 * ((n_chains - 1) * chain_y + 0.5 * lattice_constant)

    keep = np.ones(chain.shape, dtype=bool)
    if crack is not None:
        centre = (np.arange(n_chains) - 0.5 * (n_chains - 1)) * chain_y
        if not x.min() < crack.tip_x < x.max():
            raise ValueError(f"crack.tip_x is {crack.tip_x} m; the sheet spans {x.min()} to {x.max()} m along x")
        if not centre[0] < crack.y < centre[-1]:
            raise ValueError(f"crack.y is {crack.y} m; the sheet spans {centre[0]} to {centre[-1]} m along y")
        cut = int(np.argmin(np.abs(centre - crack.y)))
        y += crack.y - centre[cut]
        keep[cut] = x[cut] >= crack.tip_x

    position = np.column_stack([x[keep], y[keep], np.zeros(int(keep.sum()))])
    position = _without_dangling_atoms(position, lattice_constant)
    return Sheet(position, n_x * cell_x, n_chains * chain_y, lattice_constant, crack)


def _without_dangling_atoms(position: NDArray[np.float64], lattice_constant: float) -> NDArray[np.float64]:
    while True:
        neighbours = np.bincount(bonds_of(position, lattice_constant).ravel(), minlength=len(position))
        if neighbours.min() >= 2:
            return np.ascontiguousarray(position)
        position = position[neighbours >= 2]
