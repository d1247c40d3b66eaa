"""Uniform background grid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Mesh(NamedTuple):
    """Grid numbers in the form the kernels read (lengths in metres, sizes in cells)."""

    origin_x: float
    origin_y: float
    cell_size: float
    inverse_cell: float
    cells_x: int
    cells_y: int
    stride: int
    half_size: float
    """Half side of a point's domain over the cell size."""
    inverse_2l: float
    inverse_4l: float


@dataclass(frozen=True)
class Grid:
    """Uniform rectangular grid of square cells.

    The grid includes the margin around the body; a point whose domain would leave it is lost.

    Parameters
    ----------
    origin : (2,) sequence of float
        Lower left node [m].
    cell_size : float
        Side of a cell [m].
    cells : (2,) sequence of int
        Number of cells in x and y, at least 3 each.

    Raises
    ------
    ValueError
        If a value is not finite, not positive, or of the wrong length.
    """

    origin: Sequence[float]
    cell_size: float
    cells: Sequence[int]

    def __post_init__(self) -> None:
        origin = tuple(float(value) for value in self.origin)
        if len(origin) != 2 or not np.all(np.isfinite(origin)):
            raise ValueError(f"Grid.origin = {self.origin!r}: two finite numbers [m] are needed")
        if not (np.isfinite(self.cell_size) and self.cell_size > 0.0):
            raise ValueError(f"Grid.cell_size = {self.cell_size!r}: a positive length [m] is needed")
        if len(self.cells) != 2 or any(int(n) != n or n < 3 for n in self.cells):
            raise ValueError(f"Grid.cells = {self.cells!r}: two whole numbers of at least 3 are needed")
        object.__setattr__(self, "origin", origin)
        object.__setattr__(self, "cell_size", float(self.cell_size))
        object.__setattr__(self, "cells", tuple(int(n) for n in self.cells))

    @property
    def node_count(self) -> int:
        """Number of nodes."""
        return (self.cells[0] + 1) * (self.cells[1] + 1)

    @property
    def lower(self) -> NDArray[np.float64]:
        """Lower left corner [m], (2,)."""
        return np.array(self.origin, dtype=np.float64)

    @property
    def upper(self) -> NDArray[np.float64]:
        """Upper right corner [m], (2,)."""
        return self.lower + self.cell_size * np.array(self.cells, dtype=np.float64)

    def node_positions(self) -> NDArray[np.float64]:
        """Positions of all nodes [m], (node_count, 2), x running fastest."""
        x = self.origin[0] + self.cell_size * np.arange(self.cells[0] + 1)
        y = self.origin[1] + self.cell_size * np.arange(self.cells[1] + 1)
        xx, yy = np.meshgrid(x, y)
        return np.ascontiguousarray(np.stack([xx.ravel(), yy.ravel()], axis=1))

    def mesh(self, point_size: float) -> Mesh:
        """Kernel form of the grid for points of side ``point_size`` [m]."""
        half = 0.5 * point_size / self.cell_size
        if not 0.0 < half <= 0.5:
            raise ValueError(
                f"point size {point_size!r} m: must be above 0 and at most one cell ({self.cell_size!r} m)"
            )
        return Mesh(
            float(self.origin[0]),
            float(self.origin[1]),
            float(self.cell_size),
            1.0 / self.cell_size,
            int(self.cells[0]),
            int(self.cells[1]),
            int(self.cells[0]) + 1,
            half,
            0.5 / half,
            0.25 / half,
        )
