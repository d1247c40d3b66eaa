"""Builder of graphene sheets: whole or with a slit, in layers, with free edges or periodic.

With the zigzag direction along x, zigzag chains, each of two atom rows half a bond length apart, follow one another
along y at a distance of 1.5 bond lengths; with the armchair direction along x the picture is turned by 90 degrees::

    row 2   o   o   o      y = 3a/2
            |   |   |
    row 1   o   o   o      y = a/2     \\ one chain
          o   o   o   o    y = 0       /
"""

from __future__ import annotations

import math
from typing import Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from md_service import units
from md_service.atoms import Atoms, Box, CrackCut
from md_service.chemical_elements import ATOMIC_WEIGHT
from md_service.crystals import whole_cells
from md_service.slit import in_slit, shift_to_slit

__all__ = ["CrackCut", "area_per_atom", "bonds_of", "graphene"]

GRAPHENE_THICKNESS: Final = 3.35e-10  # m, by convention the distance of the layers of graphite
NEIGHBOUR_RANGE: Final = 1.2  # bonds of an undeformed sheet are shorter than this many bond lengths

Orientation = Literal["zigzag", "armchair"]
Stacking = Literal["AB", "AA"]

_HALF_SLIT = 0.8  # half height of a slit in bond lengths; it takes one zigzag chain, or two rows of an armchair sheet


def bonds_of(position: NDArray[np.float64], spacing: float, box: Box | None = None) -> NDArray[np.int64]:
    """Pairs of neighbours in an undeformed crystal.

    Parameters
    ----------
    position : ndarray, shape (n, 3)
        Atom positions, m.
    spacing : float
        Distance of nearest neighbours, m.
    box : Box, optional
        Its periodic directions are counted; a tilted one is not known here.

    Returns
    -------
    ndarray, shape (n_bonds, 2)
        Rows of `position`, the lower one first, sorted.
    """
    if box is not None and any(box.periodic):
        repeat = np.where(box.periodic, box.high - box.low, 0.0)
        inside = box.wrapped(position)[0] - box.low
        # A coordinate on the upper face, by round-off, is one on the lower.
        inside = np.where((repeat > 0.0) & (inside >= repeat), 0.0, inside)
        tree = cKDTree(inside, boxsize=repeat)
    else:
        tree = cKDTree(position)
    pairs = tree.query_pairs(NEIGHBOUR_RANGE * spacing, output_type="ndarray")
    return np.ascontiguousarray(pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))], dtype=np.int64)


def area_per_atom(spacing: float) -> float:
    """Area of the sheet that belongs to one atom, m^2, for a carbon-carbon distance in m."""
    return float(0.75 * np.sqrt(3.0) * spacing**2)


def graphene(
    width: float,
    height: float,
    *,
    spacing: float,
    layers: int = 1,
    orientation: Orientation = "zigzag",
    stacking: Stacking = "AB",
    crack: CrackCut | None = None,
    periodic: bool = False,
    layer_distance: float = GRAPHENE_THICKNESS,
) -> Atoms:
    """Build one or more sheets of graphene in the plane z = 0, centred on the origin.

    A slit is one zigzag chain, or two rows of an armchair sheet, wide: its faces are 2.5 or 2.6 bond lengths apart and
    at least 2.65 bond lengths between atoms, beyond the reach of any bond, so no potential binds them again. The
    lattice is moved along y until the slit lies exactly on ``crack.y``. Atoms left with one neighbour are removed. In
    the stacking AB every second layer is moved by one bond vector against the others, half of it each; slits then
    lie up to half a bond length beside ``crack.y``.

    Parameters
    ----------
    width, height : float
        Wanted size along x and y, m. The nearest number of whole cells is built.
    spacing : float
        Carbon-carbon distance, m.
    layers : int
        Number of sheets on top of each other.
    orientation : {"zigzag", "armchair"}
        Direction of the lattice along x, which is also that of a slit's faces.
    stacking : {"AB", "AA"}
        How layers lie on each other.
    crack : CrackCut, optional
        Slit to cut, through all layers.
    periodic : bool
        Whether the sheets repeat along x and y; then a slit needs both ends inside.
    layer_distance : float
        Distance of layers, and the thickness that stresses refer to, of each layer, m.

    Returns
    -------
    Atoms
        Layer by layer, rows sorted by y, then x. The box is the true size: whole cells, and layers times their
        distance.

    Raises
    ------
    ValueError
        If the sheet is smaller than three cells, the slit is not inside of it, or a choice is unknown.
    """
    _check_choices(spacing, layers, orientation, stacking, layer_distance)
    lattice, size, middles = _lattice(width, height, spacing, orientation, crack is not None, periodic)
    lift = 0.0 if crack is None else shift_to_slit(middles, crack)
    box = Box(
        np.array([-0.5 * size[0], -0.5 * size[1] + lift, -0.5 * layers * layer_distance]),
        np.array([0.5 * size[0], 0.5 * size[1] + lift, 0.5 * layers * layer_distance]),
        (periodic, periodic, False),
    )
    stagger = np.zeros(2)
    if layers > 1 and stacking == "AB":
        # Half of a bond vector; the bond is the one that is more along x for zigzag, where edges have more room.
        stagger = 0.25 * spacing * np.array([np.sqrt(3.0), -1.0] if orientation == "zigzag" else [-1.0, np.sqrt(3.0)])

    built = []
    for layer in range(layers):
        shift = np.array([0.0, lift]) + (1.0 if layer % 2 else -1.0) * stagger
        position = np.column_stack([lattice + shift, np.full(len(lattice), (layer - 0.5 * (layers - 1)))])
        position[:, 2] *= layer_distance
        if crack is not None:
            own = CrackCut(crack.tip_x, crack.y + shift[1] - lift, crack.left_x)
            position = position[~in_slit(position, own, _HALF_SLIT * spacing, periodic)]
        built.append(_without_dangling_atoms(position, spacing, box))
    position = np.ascontiguousarray(np.concatenate(built))
    # Layers that are moved against each other may stick out of the cells of the middle one.
    free = ~np.array(box.periodic)
    box = Box(
        np.where(free, np.minimum(box.low, position.min(axis=0)), box.low),
        np.where(free, np.maximum(box.high, position.max(axis=0)), box.high),
        box.periodic,
    )
    return Atoms(
        position=position,
        kind=np.zeros(len(position), dtype=np.int64),
        species=("C",),
        elements=("C",),
        mass=np.array([ATOMIC_WEIGHT["C"] * units.MASS]),
        box=box,
        spacing=spacing,
        thickness=layers * layer_distance,
        site_volume=area_per_atom(spacing) * layer_distance,
        crack=crack,
        notes={"material": "graphene", "orientation": orientation, "layers": layers},
    )


def _check_choices(spacing: float, layers: int, orientation: str, stacking: str, layer_distance: float) -> None:
    for name, length in (("spacing", spacing), ("layer_distance", layer_distance)):
        if not (np.isfinite(length) and length > 0.0):
            raise ValueError(f"{name} is {length} m; it must be positive")
    if layers < 1:
        raise ValueError(f"layers is {layers}; it must be at least 1")
    for name, choice, known in (
        ("orientation", orientation, get_args(Orientation)),
        ("stacking", stacking, get_args(Stacking)),
    ):
        if choice not in known:
            raise ValueError(f"{name} is {choice!r}; it must be one of {', '.join(known)}")


def _lattice(
    width: float, height: float, spacing: float, orientation: Orientation, cracked: bool, periodic: bool
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Centred positions (n, 2), size (2,), and the heights at which a slit may lie."""
    cell, chain_width = math.sqrt(3.0) * spacing, 1.5 * spacing
    zigzag = orientation == "zigzag"
    along, across = (width, height) if zigzag else (height, width)
    n_cells, n_chains = whole_cells(along / cell), whole_cells(across / chain_width)
    if periodic:
        n_chains = 2 * whole_cells(across / chain_width / 2.0)  # chains repeat after two
    elif cracked and zigzag:
        n_chains = 2 * whole_cells((across / chain_width - 1.0) / 2.0) + 1  # a chain in the middle, for a slit there
    if n_cells < 3 or n_chains < 3:
        cells, sizes = (n_cells, n_chains), (cell, chain_width)
        x, y = (0, 1) if zigzag else (1, 0)
        raise ValueError(
            f"width {width} m and height {height} m hold {cells[x]} x {cells[y]} cells of {sizes[x]:.3e} m x "
            f"{sizes[y]:.3e} m; at least 3 x 3 are needed"
        )

    # Chains alternate: in an even chain the lower row starts at zero, in an odd one it is shifted by half a cell.
    chain, upper, column = np.meshgrid(np.arange(n_chains), np.arange(2), np.arange(n_cells), indexing="ij")
    u = (column + 0.5 * ((chain + upper) % 2) - 0.5 * (n_cells - 0.5)) * cell
    v = chain * chain_width + 0.5 * upper * spacing - 0.5 * ((n_chains - 1) * chain_width + 0.5 * spacing)
    size = np.array([n_cells * cell, n_chains * chain_width])
    if zigzag:
        chains = chain_width * (np.arange(n_chains, dtype=np.float64) - 0.5 * (n_chains - 1))
        return np.column_stack([u.ravel(), v.ravel()]), size, chains
    lattice = np.column_stack([v.ravel(), u.ravel()])
    order = np.lexsort((lattice[:, 0], np.round(lattice[:, 1] / (0.25 * cell))))
    rows = 0.5 * cell * (np.arange(2 * n_cells, dtype=np.float64) - 0.5 * (2 * n_cells - 1))
    return lattice[order], size[::-1], 0.5 * (rows[1:] + rows[:-1])


def _without_dangling_atoms(position: NDArray[np.float64], spacing: float, box: Box) -> NDArray[np.float64]:
    while True:
        neighbours = np.bincount(bonds_of(position, spacing, box).ravel(), minlength=len(position))
        if neighbours.min() >= 2:
            return np.ascontiguousarray(position)
        position = position[neighbours >= 2]
