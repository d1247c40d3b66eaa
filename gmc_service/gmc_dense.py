"""The generalized method of cells as it is written in the papers: one dense system for the strains of all subcells.

This is the formulation to read and to check others against; `gmc_reduced` gives the same numbers much faster.

A doubly periodic cell has rows beta of height h_beta along axis 2 and columns gamma of width l_gamma along axis 3;
h and l are their sums. The displacement is linear in each subcell, and its jumps and those of the tractions vanish in
the mean over each interface. What follows for the mean strains and stresses of the subcells (Paley and Aboudi,
Mechanics of Materials 14 (1992) 127-139):

    strain 11 equal in all subcells
    sum over beta of h_beta strain 22 = h macroscopic strain 22           in each column, the same for 12
    sum over gamma of l_gamma strain 33 = l macroscopic strain 33         in each row, the same for 13
    sum over both of h_beta l_gamma strain 23 = h l macroscopic strain 23
    stress 22 and stress 12 equal within a column, stress 33 and stress 13 equal within a row
    stress 23 equal in all subcells

These are as many equations as there are strains. Their solution for a unit of each macroscopic strain is the strain
concentration A, and the mean of the stress is Eq 90.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from gmc_service.homogenised import Homogenised

S11, S22, S33, S23, S13, S12 = range(6)


def homogenise(
    heights: NDArray[np.float64],
    widths: NDArray[np.float64],
    stiffness: NDArray[np.float64],
    expansion: NDArray[np.float64],
) -> Homogenised:
    """Homogenise a cell; arguments and answer are those of `gmc_service.homogenised.Homogenise`."""
    conditions, macroscopic, is_stress = _conditions(heights, widths, stiffness)
    # A unit of each macroscopic strain, and one kelvin: there the stress of a subcell is C (strain - expansion), so
    # the part of the expansion goes to the other side of the conditions on stresses, and to no other.
    of_expansion = np.where(is_stress, conditions @ expansion.reshape(-1), 0.0)
    # Rows of stresses and of strains differ by the size of a modulus, and subcells by their contrast.
    scale = 1.0 / np.abs(conditions).max(axis=1)
    solved = np.linalg.solve(
        conditions * scale[:, None], np.column_stack([macroscopic, of_expansion]) * scale[:, None]
    ).reshape(len(stiffness), 6, 7)
    concentration, thermal = np.ascontiguousarray(solved[:, :, :6]), np.ascontiguousarray(solved[:, :, 6])
    fractions = (np.outer(heights, widths) / (heights.sum() * widths.sum())).reshape(-1)
    effective = np.einsum("n,nij,njk->ik", fractions, stiffness, concentration)
    # The stress per kelvin at no macroscopic strain is -B* alpha*.
    locked = np.einsum("n,nij,nj->i", fractions, stiffness, thermal - expansion)
    return Homogenised(
        stiffness=0.5 * (effective + effective.T),
        expansion=-np.linalg.solve(effective, locked),
        concentration=concentration,
        thermal=thermal,
    )


def _conditions(
    heights: NDArray[np.float64], widths: NDArray[np.float64], stiffness: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Matrix of the conditions above, their sides that hold the macroscopic strain, and which are on stresses.

    Returns
    -------
    matrix : ndarray, shape (6 subcells, 6 subcells)
    macroscopic : ndarray, shape (6 subcells, 6)
    is_stress : ndarray of bool, shape (6 subcells,)
    """
    rows, columns = len(heights), len(widths)
    index = np.arange(rows * columns).reshape(rows, columns)
    lines: list[NDArray[np.float64]] = []
    sides: list[tuple[int, float]] = []
    kinds: list[bool] = []

    def mean_strain(cells: NDArray[np.int64], weights: NDArray[np.float64], component: int) -> None:
        line = np.zeros((len(stiffness), 6))
        line[cells, component] = weights
        lines.append(line.reshape(-1))
        sides.append((component, float(weights.sum())))
        kinds.append(False)

    def equal_stress(cells: NDArray[np.int64], component: int) -> None:
        for one, next_one in pairwise(cells):
            line = np.zeros((len(stiffness), 6))
            line[one] = stiffness[one, component]
            line[next_one] = -stiffness[next_one, component]
            lines.append(line.reshape(-1))
            sides.append((component, 0.0))
            kinds.append(True)

    for cell in index.reshape(-1):
        mean_strain(np.array([cell]), np.ones(1), S11)
    for gamma in range(columns):
        for component in (S22, S12):
            mean_strain(index[:, gamma], heights, component)
            equal_stress(index[:, gamma], component)
    for beta in range(rows):
        for component in (S33, S13):
            mean_strain(index[beta], widths, component)
            equal_stress(index[beta], component)
    mean_strain(index.reshape(-1), np.outer(heights, widths).reshape(-1), S23)
    equal_stress(index.reshape(-1), S23)
    macroscopic = np.zeros((len(lines), 6))
    for line_number, (component, value) in enumerate(sides):
        macroscopic[line_number, component] = value
    return np.array(lines), macroscopic, np.array(kinds)
