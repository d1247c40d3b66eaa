"""Builders of crystals for verification: face-centred cubic, close-packed in two dimensions, and one row of atoms."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from md_service import units
from md_service.atoms import Atoms, Box, CrackCut
from md_service.chemical_elements import ATOMIC_WEIGHT
from md_service.slit import in_slit, shift_to_slit

#: Rows that a slit takes out of a close-packed layer. Its faces are then 3.46 spacings apart, beyond usual cut-offs of
#: Lennard-Jones atoms, which would pull closer faces together.
SLIT_ROWS: Final = 3
_FCC_BASIS: Final = np.array([[0.0, 0.0, 0.0], [0.0, 0.5, 0.5], [0.5, 0.0, 0.5], [0.5, 0.5, 0.0]])


def plane_distance(spacing: float) -> float:
    """Distance of close-packed planes in the fcc crystal of the same nearest-neighbour distance, m.

    It is the thickness of a two-dimensional layer, to which its stresses refer.
    """
    return math.sqrt(2.0 / 3.0) * spacing


def fcc(
    element: str, spacing: float, cells: tuple[int, int, int], periodic: tuple[bool, bool, bool] = (True, True, True)
) -> Atoms:
    """Build a face-centred cubic crystal with its cube edges along x, y and z, centred on the origin.

    Parameters
    ----------
    element : str
        Chemical symbol.
    spacing : float
        Nearest-neighbour distance, m: the cube edge over the square root of two.
    cells : tuple of int
        Cubes of four atoms along x, y, z.
    periodic : tuple of bool
        Directions in which the crystal repeats.

    Returns
    -------
    Atoms
        Cube by cube, x fastest. The box is whole cubes.

    Raises
    ------
    ValueError
        For an unknown element, a spacing that is not positive or fewer than one cube.
    """
    mass = _mass(element, spacing)
    if min(cells) < 1:
        raise ValueError(f"cells is {cells}; at least one is needed along each direction")
    edge = math.sqrt(2.0) * spacing
    corner = np.stack(np.meshgrid(*(np.arange(n) for n in reversed(cells)), indexing="ij")[::-1], axis=-1)
    # A quarter of a cube from the faces, so that the free faces of opposite sides are equal.
    fraction = corner.reshape(-1, 1, 3) + _FCC_BASIS + 0.25
    size = edge * np.array(cells, dtype=np.float64)
    position = np.ascontiguousarray(fraction.reshape(-1, 3) * edge - 0.5 * size)
    return Atoms(
        position=position,
        kind=np.zeros(len(position), dtype=np.int64),
        species=(element,),
        elements=(element,),
        mass=mass,
        box=Box(-0.5 * size, 0.5 * size, periodic),
        spacing=spacing,
        site_volume=0.25 * edge**3,
        notes={"material": f"fcc {element}"},
    )


def hexagonal(
    spacing: float,
    width: float,
    height: float,
    *,
    element: str = "Ar",
    crack: CrackCut | None = None,
    periodic: bool = False,
) -> Atoms:
    """Build one close-packed layer in the plane z = 0, centred on the origin, with close-packed rows along x.

    A slit takes three rows; the lattice is moved along y until the slit lies exactly on ``crack.y``.

    Parameters
    ----------
    spacing : float
        Nearest-neighbour distance, m.
    width, height : float
        Wanted size along x and y, m. The nearest number of whole spacings and rows is built.
    element : str
        Chemical symbol, of which the mass is taken.
    crack : CrackCut, optional
        Slit to cut.
    periodic : bool
        Whether the layer repeats along x and y; then a slit needs both ends inside.

    Returns
    -------
    Atoms
        Rows sorted by y, then x. The box is the true size; the thickness is `plane_distance`.

    Raises
    ------
    ValueError
        For an unknown element, a spacing that is not positive, a layer of fewer than three spacings or rows, or a slit
        that is not inside of it.
    """
    mass = _mass(element, spacing)
    row_distance = 0.5 * math.sqrt(3.0) * spacing
    n_columns = whole_cells(width / spacing)
    n_rows = whole_cells(height / row_distance)
    if periodic:
        n_rows = 2 * whole_cells(height / row_distance / 2.0)  # rows repeat after two
    elif crack is not None:
        n_rows = 2 * whole_cells((height / row_distance - 1.0) / 2.0) + 1  # a row in the middle, for a slit there
    if n_columns < 3 or n_rows < 3:
        raise ValueError(
            f"width {width} m and height {height} m hold {n_columns} atoms by {n_rows} rows; at least 3 x 3 are needed"
        )
    row, column = np.meshgrid(np.arange(n_rows), np.arange(n_columns), indexing="ij")
    x = (column + 0.5 * (row % 2) - 0.5 * (n_columns - 0.5)) * spacing
    height_of_row = (np.arange(n_rows, dtype=np.float64) - 0.5 * (n_rows - 1)) * row_distance
    lift = 0.0 if crack is None else shift_to_slit(height_of_row, crack)
    position = np.column_stack([x.ravel(), (height_of_row[row] + lift).ravel(), np.zeros(row.size)])
    if crack is not None:
        position = position[~in_slit(position, crack, 0.5 * SLIT_ROWS * row_distance, periodic)]
    half = 0.5 * np.array([n_columns * spacing, n_rows * row_distance, plane_distance(spacing)])
    centre = np.array([0.0, lift, 0.0])
    return Atoms(
        position=np.ascontiguousarray(position),
        kind=np.zeros(len(position), dtype=np.int64),
        species=(element,),
        elements=(element,),
        mass=mass,
        box=Box(centre - half, centre + half, (periodic, periodic, False)),
        spacing=spacing,
        thickness=plane_distance(spacing),
        site_volume=spacing * row_distance * plane_distance(spacing),
        crack=crack,
        notes={"material": "hexagonal"},
    )


def chain(spacing: float, length: float, *, element: str = "Ar", periodic: bool = False) -> Atoms:
    """Build one row of atoms along x, centred on the origin: a close-packed row of `hexagonal`.

    An atom has the volume that it has in a sheet. Springs k between neighbours then make a bar of the cross-section
    A = a^2 / sqrt(2) with Young's modulus k a / A = 2 k / (sqrt(3) t), that of the sheet, and its density.

    Parameters
    ----------
    spacing : float
        Nearest-neighbour distance a, m.
    length : float
        Wanted length along x, m; the nearest number of whole spacings is built.
    element : str
        Chemical symbol, of which the mass is taken.
    periodic : bool
        Whether the row repeats along x.

    Returns
    -------
    Atoms
        From left to right. The box is the bar, whose thickness along z is `plane_distance`.

    Raises
    ------
    ValueError
        For an unknown element, a spacing that is not positive, or fewer than three atoms.
    """
    mass = _mass(element, spacing)
    count = whole_cells(length / spacing)
    if count < 3:
        raise ValueError(f"width {length} m holds {count} atoms {spacing:.4g} m apart; at least 3 are needed")
    x = (np.arange(count, dtype=np.float64) - 0.5 * (count - 1)) * spacing
    half = 0.5 * np.array([count * spacing, 0.5 * math.sqrt(3.0) * spacing, plane_distance(spacing)])
    return Atoms(
        position=np.column_stack([x, np.zeros(count), np.zeros(count)]),
        kind=np.zeros(count, dtype=np.int64),
        species=(element,),
        elements=(element,),
        mass=mass,
        box=Box(-half, half, (periodic, False, False)),
        spacing=spacing,
        thickness=plane_distance(spacing),
        site_volume=float(np.prod(2.0 * half)) / count,
        notes={"material": "chain"},
    )


def _mass(element: str, spacing: float) -> NDArray[np.float64]:
    if element not in ATOMIC_WEIGHT:
        raise ValueError(f"element is {element!r}; it must be a chemical symbol such as Cu")
    if not (np.isfinite(spacing) and spacing > 0.0):
        raise ValueError(f"spacing is {spacing} m; it must be positive")
    return np.array([ATOMIC_WEIGHT[element] * units.MASS])


def whole_cells(cells: float) -> int:
    """Nearest whole number; 0 for one that is not finite."""
    return round(cells) if math.isfinite(cells) else 0
