"""A cell in which some subcells have failed: the constants it answers, by the rule `Cell.after_failure`.

A failed subcell keeps its stiffness times `Cell.knock_down`. What follows from that is a property of the method:

``gmc``
    In the generalized method of cells all subcells of a column share stresses 22 and 12, those of a row 33 and 13, and
    all of the cell share stress 23. So one failed subcell, however small, lowers G23 of the cell to about
    knock_down / (its area share) times its own; E22 and G12 lose one column, E33 and G13 one row.

``floor``
    As long as the intact subcells, edge to edge, connect the cell with its neighbours along axis 2 and along axis 3,
    a real cell carries transverse shear around what has failed. G23 is then at least the lower one of

        G_i (1 - f)^m(G_i)    and    G_0 (1 - c)^m(G_0),    m(G) = 2 (K + G) / K

    with f the area share of the failed subcells, c their share of the cell's shear compliance before they failed, G_i
    and G_0 the series values of C44 over the intact subcells and over all before failure, K = (B22 + 2 B23 + B33) / 4
    of the cell before any failure: the differential scheme for a plane with round pores (McLaughlin, Int. J. Eng. Sci.
    15 (1977) 237; Norris, Mech. Mater. 4 (1985) 1), which is meant for one material. By area it misses that the
    compliant phase does the shearing, by compliance that a failed fibre leaves a large hole. An estimate: with the
    dissertation's 2 x 2 cell it gives 1.13 times the high-fidelity G23 for a failed matrix corner, 1.09 for the matrix
    on one side, 3.5 for the fibre; for a square pore in one material 1.06 at f = 0.05, 1.4 at 0.2, 2.4 at 0.4.

    It is put in through C44 of the failed subcells: all of them keep the one factor x >= knock_down that makes the
    series value of C44 over the cell equal to it (x = 1 at most); all their other constants are knocked down. So every
    subcell and B* stay positive definite, and the subcell strains are those of this cell: their mean is the macroscopic
    strain and they share the stress 23. Where the intact part is cut through along a line (a whole row, a diagonal),
    G23 falls as in ``gmc``.

``high_fidelity``
    Once a subcell has failed, stiffness, expansion and subcell means come from `gmc_service.high_fidelity`; the intact
    cell keeps its method, so the response has a step of that method's model error at the first failure.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from gmc_service.cell import Cell
from gmc_service.homogenised import Homogenised
from gmc_service.methods import find_method

_SHEAR23: Final = 3


class FailedCell:
    """A cell at one temperature, for any set of failed subcells.

    Parameters
    ----------
    cell : Cell
    method : str
        Name from `gmc_service.methods`.
    temperature : float
        K.
    """

    def __init__(self, cell: Cell, method: str, temperature: float) -> None:
        self.cell = cell
        self.intact = cell.stiffness_at(temperature)
        self.expansion = cell.expansion_at(temperature)
        self._homogenise = find_method(method)
        self._after = find_method("high_fidelity") if cell.after_failure == "high_fidelity" else self._homogenise
        self._fractions = cell.volume_fractions()
        self._bulk = 0.0
        if cell.after_failure == "floor":
            whole = self._homogenise(cell.heights, cell.widths, self.intact, self.expansion).stiffness
            self._bulk = 0.25 * float(whole[1, 1] + 2.0 * whole[1, 2] + whole[2, 2])

    def homogenise(self, failed: NDArray[np.bool_]) -> Homogenised:
        """Constants and concentrations; `failed` has shape (subcells,)."""
        method = self._after if failed.any() else self._homogenise
        return method(self.cell.heights, self.cell.widths, self.stiffness(failed), self.expansion)

    def stiffness(self, failed: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Stiffness of every subcell, shape (subcells, 6, 6), Pa; `failed` has shape (subcells,)."""
        stiffness = self.intact * np.where(failed, self.cell.knock_down, 1.0)[:, None, None]
        floor = self.cell.after_failure == "floor" and bool(failed.any())
        if floor and connected(~failed.reshape(self.cell.rows, self.cell.columns)):
            kept = max(self._shear_kept(failed), self.cell.knock_down)
            stiffness[failed, _SHEAR23, _SHEAR23] = kept * self.intact[failed, _SHEAR23, _SHEAR23]
        return stiffness

    def _shear_kept(self, failed: NDArray[np.bool_]) -> float:
        """Factor on C44 of the failed subcells that keeps G23 at the floor, at most 1."""
        compliance = self._fractions / self.intact[:, _SHEAR23, _SHEAR23]
        gone, series = float(compliance[failed].sum()), float(compliance[~failed].sum())
        there = 1.0 - float(self._fractions[failed].sum())
        by_area = self._porous(there / series, there)
        by_compliance = self._porous(1.0 / (gone + series), series / (gone + series))
        return min(gone / (1.0 / min(by_area, by_compliance) - series), 1.0)

    def _porous(self, shear: float, there: float) -> float:
        """Shear stiffness of a medium of which only a share is there."""
        return float(shear * there ** (2.0 * (self._bulk + shear) / self._bulk))


def connected(there: NDArray[np.bool_]) -> bool:
    """Whether subcells, edge to edge in the periodic cell, connect it with its neighbours along both axes.

    Parameters
    ----------
    there : ndarray of bool, shape (rows, columns)

    Returns
    -------
    bool
        True if one connected set of them reaches, from a subcell, its images one or more cells away in two independent
        directions.
    """
    rows, columns = there.shape
    cell_of = np.full((rows, columns, 2), 0, dtype=np.int64)  # the periodic image in which the walk met a subcell
    seen = np.zeros((rows, columns), dtype=bool)
    for start in np.argwhere(there):
        row, column = (int(value) for value in start)
        if seen[row, column]:
            continue
        seen[row, column] = True
        windings: list[tuple[int, int]] = []
        stack = [(row, column)]
        while stack:
            row, column = stack.pop()
            up, across = (int(value) for value in cell_of[row, column])
            for next_row, next_column in ((row + 1, column), (row - 1, column), (row, column + 1), (row, column - 1)):
                image = (up + next_row // rows, across + next_column // columns)
                next_row, next_column = next_row % rows, next_column % columns
                if not there[next_row, next_column]:
                    continue
                if not seen[next_row, next_column]:
                    seen[next_row, next_column] = True
                    cell_of[next_row, next_column] = image
                    stack.append((next_row, next_column))
                else:
                    met = cell_of[next_row, next_column]
                    winding = (image[0] - int(met[0]), image[1] - int(met[1]))
                    if winding != (0, 0):
                        windings.append(winding)
        if windings and any(a * windings[0][1] != b * windings[0][0] for a, b in windings):
            return True
    return False
