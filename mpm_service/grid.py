"""Uniform background grid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Grid:
    """Uniform grid of square or cubic cells.

    The grid includes the margin around the body; a point within a cell of its border is lost.

    Parameters
    ----------
    origin : (d,) sequence of float
        Lowest node [m], in 2 or 3 dimensions.
    cell_size : float
        Side of a cell [m].
    cells : (d,) sequence of int
        Number of cells in each direction, at least 3 each.

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
        if len(origin) not in (2, 3) or not np.all(np.isfinite(origin)):
            raise ValueError(f"Grid.origin = {self.origin!r}: two or three finite numbers [m] are needed")
        if not (np.isfinite(self.cell_size) and self.cell_size > 0.0):
            raise ValueError(f"Grid.cell_size = {self.cell_size!r}: a positive length [m] is needed")
        if len(self.cells) != len(origin) or any(int(n) != n or n < 3 for n in self.cells):
            raise ValueError(
                f"Grid.cells = {self.cells!r}: {len(origin)} whole numbers of at least 3 are needed, as many as "
                "origin has"
            )
        object.__setattr__(self, "origin", origin)
        object.__setattr__(self, "cell_size", float(self.cell_size))
        object.__setattr__(self, "cells", tuple(int(n) for n in self.cells))

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return len(self.cells)

    @property
    def node_count(self) -> int:
        """Number of nodes."""
        return int(np.prod([n + 1 for n in self.cells]))

    @property
    def lower(self) -> NDArray[np.float64]:
        """Lowest corner [m], (d,)."""
        return np.array(self.origin, dtype=np.float64)

    @property
    def upper(self) -> NDArray[np.float64]:
        """Highest corner [m], (d,)."""
        return self.lower + self.cell_size * np.array(self.cells, dtype=np.float64)

    def node_positions(self) -> NDArray[np.float64]:
        """Positions of all nodes [m], (node_count, d), x running fastest."""
        lines = [o + self.cell_size * np.arange(n + 1) for o, n in zip(self.origin, self.cells, strict=True)]
        mesh = np.meshgrid(*lines[::-1], indexing="ij")
        return np.ascontiguousarray(np.stack([axis.ravel() for axis in mesh[::-1]], axis=1))
