"""Random cells for property tests."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

COUPLED = np.array([[(i < 3) != (j < 3) or (i >= 3 and j >= 3 and i != j) for j in range(6)] for i in range(6)])


@dataclass(frozen=True)
class RandomCell:
    """Arguments of a homogenisation."""

    heights: NDArray[np.float64]
    widths: NDArray[np.float64]
    stiffness: NDArray[np.float64]
    expansion: NDArray[np.float64]

    @property
    def arguments(self) -> tuple[NDArray[np.float64], ...]:
        return self.heights, self.widths, self.stiffness, self.expansion

    @property
    def shape(self) -> tuple[int, int]:
        return len(self.heights), len(self.widths)

    @property
    def fractions(self) -> NDArray[np.float64]:
        areas = np.outer(self.heights, self.widths).reshape(-1)
        return areas / areas.sum()


@st.composite
def random_cells(
    draw: st.DrawFn, *, most: int = 4, orthotropic: bool | None = None, contrast: float = 2.0
) -> RandomCell:
    """Cells of up to `most` rows and columns, of materials that differ by up to `contrast` decades."""
    rows, columns = draw(st.integers(1, most)), draw(st.integers(1, most))
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    plain = draw(st.booleans()) if orthotropic is None else orthotropic
    stiffness = np.empty((rows * columns, 6, 6))
    for one in stiffness:
        root = random.normal(size=(6, 6))
        one[:] = (root @ root.T + 0.5 * np.eye(6)) * 1e9 * 10.0 ** random.uniform(0.0, contrast)
        if plain:
            one[COUPLED] = 0.0
    expansion = random.normal(size=(rows * columns, 6)) * 1e-5
    if plain:
        expansion[:, 3:] = 0.0
    return RandomCell(random.uniform(0.1, 1.0, rows), random.uniform(0.1, 1.0, columns), stiffness, expansion)
