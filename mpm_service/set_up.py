"""Does what a solver is given fit together?"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .grid import Grid
from .hierarchy import HierarchicalGrid
from .material import Material
from .material_points import Body
from .scheme import Scheme

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


def check_set_up(
    grid: Grid, refined: bool, body: Body, materials: Sequence[Material], thickness: float, scheme: Scheme
) -> None:
    """Raise ValueError, naming field, value and what is allowed, unless all fits.

    Parameters
    ----------
    grid : Grid
        The (coarsest) level.
    refined : bool
        Are there finer levels?
    body : Body
    materials : sequence of Material
    thickness : float
        [m]
    scheme : Scheme
    """
    dimension = body.dimension
    if not (np.isfinite(thickness) and thickness > 0.0):
        raise ValueError(f"thickness = {thickness!r}: a positive length [m] is needed")
    if not materials:
        raise ValueError("material: at least one is needed")
    if dimension != grid.dimension:
        raise ValueError(f"body: has {dimension} dimensions, the grid has {grid.dimension}")
    for k, material in enumerate(materials):
        if (material.assumption == "three_dimensional") != (dimension == 3):
            raise ValueError(
                f"material[{k}].assumption = {material.assumption!r}: does not fit a body in {dimension} dimensions"
            )
    if dimension == 3:
        if thickness != 1.0:
            raise ValueError(f"thickness = {thickness!r}: must be 1 in three dimensions")
        if scheme.interpolation not in ("linear", "ugimp"):
            raise ValueError(
                f"scheme: interpolation {scheme.interpolation!r} is for plane bodies; in three dimensions there are "
                "linear and ugimp"
            )
    if refined and scheme.interpolation == "bspline":
        raise ValueError("scheme: interpolation 'bspline' needs a uniform grid; a refined one takes linear or GIMP")
    top = int(body.material.max(initial=0))
    if top >= len(materials) or int(body.material.min(initial=0)) < 0:
        raise ValueError(f"body.material: {top} is used, but there are {len(materials)} materials")
    _check_margin(grid, body)


def _check_margin(grid: Grid, body: Body) -> None:
    h = grid.cell_size
    if abs(body.cell_size / h - 1.0) > 1e-9:
        raise ValueError(f"body.cell_size = {body.cell_size!r} m: the grid's cell size is {h!r} m")
    for axis in range(body.dimension):
        low = (body.lower[axis] - grid.lower[axis]) / h
        high = (grid.upper[axis] - body.upper[axis]) / h
        if min(low, high) < 1.0 - 1e-6:
            raise ValueError(
                f"grid: needs at least one cell of margin around the body in {'xyz'[axis]}, has {low:.3g} below and "
                f"{high:.3g} above"
            )


def largest_time_step(
    grid: Grid | HierarchicalGrid, material: Material | Sequence[Material], scheme: Scheme | None = None
) -> float:
    """Largest time step a solver accepts [s]: the scheme's Courant limit over the smallest cell (Eq 31).

    Parameters
    ----------
    grid : Grid or HierarchicalGrid
    material : Material or sequence of Material
        The fastest wave at rest counts.
    scheme : Scheme, optional
        The default scheme if not given.
    """
    materials = (material,) if isinstance(material, Material) else tuple(material)
    cells = grid.cell_sizes if isinstance(grid, HierarchicalGrid) else (grid.cell_size,)
    return (scheme or Scheme()).courant_limit * min(cells) / max(m.pressure_wave_speed for m in materials)


def checked_array(name: str, value: ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    """Return a finite float array of a shape; the error names the bad entry."""
    array = np.ascontiguousarray(value, dtype=np.float64)
    if array.shape != shape:
        raise ValueError(f"{name}: shape {shape} is needed, got {array.shape}")
    if not np.all(np.isfinite(array)):
        bad = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise ValueError(f"{name}[{', '.join(map(str, bad))}] = {array[bad]!r}: must be finite")
    return array


def check_cells(ivc: IntArray, cells: Sequence[IntArray]) -> None:
    """Raise ValueError unless each interface cell that anchors name exists and holds points."""
    for k in np.unique(ivc):
        if k >= len(cells):
            raise ValueError(f"ivc = {int(k)}: only {len(cells)} interface cells are registered")
        if cells[k].size == 0:
            raise ValueError(f"interface cell {int(k)}: holds {int(np.sum(ivc == k))} anchors but no material point")
