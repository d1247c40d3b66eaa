"""Periodic homogenisation of the same doubly periodic cell by finite elements: what the method of cells leaves out."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from gmc_service.homogenised import Homogenised, check_sizes
from gmc_service.periodic_elements import PeriodicMesh, homogenise_mesh

#: Elements along each side of a square cell where no refinement is given.
LEAST_ELEMENTS: Final = 16
#: Power of the grading towards the edges of a subcell: corners of phases have r^0.6 to r^1 fields, and with it the
#: error falls as fast as in a smooth field.
GRADING: Final = 3.0
#: Least power of the element size that errors are taken to fall with where they are bounded from one change.
SLOWEST_ORDER: Final = 0.5


def grid_mesh(heights: NDArray[np.float64], widths: NDArray[np.float64], refinement: int) -> PeriodicMesh:
    """Divide each subcell into `refinement` by `refinement` elements that are smaller towards its edges.

    Parameters
    ----------
    heights, widths : ndarray, shapes (rows,) and (columns,)
        Sizes of the subcells along axes 2 and 3, m.
    refinement : int

    Returns
    -------
    PeriodicMesh
        Subcell (beta, gamma) has the number beta * columns + gamma.

    Raises
    ------
    ValueError
        If a size or the refinement is not positive.
    """
    check_sizes(heights, widths)
    if refinement < 1:
        raise ValueError(f"refinement is {refinement}; it must be at least 1")
    share = np.arange(refinement + 1) / refinement
    graded = np.where(share < 0.5, 0.5 * (2.0 * share) ** GRADING, 1.0 - 0.5 * (2.0 * (1.0 - share)) ** GRADING)
    lines = []
    for sizes in (heights, widths):
        begin = np.concatenate([[0.0], np.cumsum(sizes)[:-1]])
        places = begin[:, None] + sizes[:, None] * graded
        first, last = places[:, :-1].reshape(-1), places[:, 1:].reshape(-1)
        lines.append(np.stack([first, 0.5 * (first + last), last], axis=1))  # (elements along the side, 3)
    down, along = len(lines[0]), len(lines[1])
    points = np.empty((down, along, 3, 3, 2))
    points[..., 0] = lines[0][:, None, :, None]
    points[..., 1] = lines[1][None, :, None, :]
    row = (2 * np.arange(down)[:, None] + np.arange(3)) % (2 * down)
    column = (2 * np.arange(along)[:, None] + np.arange(3)) % (2 * along)
    nodes = row[:, None, :, None] * (2 * along) + column[None, :, None, :]
    subcell = np.arange(down)[:, None] // refinement * len(widths) + np.arange(along) // refinement
    return PeriodicMesh(
        points=points.reshape(-1, 9, 2),
        nodes=nodes.reshape(-1, 9).astype(np.int64),
        subcell=subcell.reshape(-1).astype(np.int64),
    )


def default_refinement(rows: int, columns: int) -> int:
    """Elements along each side of a subcell where none are given: at least `LEAST_ELEMENTS` squared in the cell."""
    return math.ceil(LEAST_ELEMENTS / math.sqrt(rows * columns))


def homogenise(
    heights: NDArray[np.float64],
    widths: NDArray[np.float64],
    stiffness: NDArray[np.float64],
    expansion: NDArray[np.float64],
    refinement: int | None = None,
) -> Homogenised:
    """Homogenise a cell by finite elements.

    Parameters
    ----------
    heights, widths, stiffness, expansion
        See `gmc_service.homogenised.Homogenise`.
    refinement : int, optional
        Elements along each side of a subcell; `default_refinement` where it is not given.

    Returns
    -------
    Homogenised
        Concentration and thermal strain are the means over each subcell.

    Raises
    ------
    ValueError
        If a size is not positive or the refinement is less than 1.
    """
    if refinement is None:
        refinement = default_refinement(len(heights), len(widths))
    return homogenise_mesh(grid_mesh(heights, widths, refinement), stiffness, expansion)


@dataclass(frozen=True, eq=False)
class Assured:
    """A homogenisation with its own discretisation error.

    Attributes
    ----------
    homogenised : Homogenised
        At twice the refinement that was asked for.
    error : float
        Bound on its relative error in the strain energy of any macroscopic strain: the largest change between the two
        refinements, as if the error fell with `SLOWEST_ORDER`. Corners of a high contrast are that slow before the
        grading resolves them; elsewhere the true error is much smaller.
    """

    homogenised: Homogenised
    error: float


def homogenise_with_error(
    heights: NDArray[np.float64],
    widths: NDArray[np.float64],
    stiffness: NDArray[np.float64],
    expansion: NDArray[np.float64],
    refinement: int | None = None,
) -> Assured:
    """Homogenise at a refinement and at twice that, and state the discretisation error; see `homogenise`."""
    if refinement is None:
        refinement = default_refinement(len(heights), len(widths))
    coarse = homogenise(heights, widths, stiffness, expansion, refinement)
    fine = homogenise(heights, widths, stiffness, expansion, 2 * refinement)
    # Scaled as stiff and soft directions may differ by the knock-down factor.
    scale = 1.0 / np.sqrt(np.diag(fine.stiffness))
    change = (coarse.stiffness - fine.stiffness) * np.outer(scale, scale)
    change_at_most = eigh(change, fine.stiffness * np.outer(scale, scale), eigvals_only=True)[-1]
    return Assured(fine, float(change_at_most) / (2.0**SLOWEST_ORDER - 1.0))


def richardson(values: NDArray[np.float64]) -> tuple[float, float]:
    """Limit and observed order of a value at three refinements, each twice the one before.

    Parameters
    ----------
    values : ndarray, shape (3,)
        From coarse to fine, moving one way by ever smaller steps.

    Returns
    -------
    limit : float
        Where the geometric series of the changes ends.
    order : float
        Power of the element size that the error falls with.

    Raises
    ------
    ValueError
        If the changes do not become smaller in one direction.
    """
    first, second = np.diff(values)
    if not first * second > 0.0 or not abs(second) < abs(first):
        raise ValueError(f"values are {values}; they must move one way by ever smaller steps")
    ratio = float(first / second)
    return float(values[2] + second / (ratio - 1.0)), float(np.log2(ratio))
