"""Tractions of a cell whose subcells keep parts of their stiffness, solved over and over with other parts.

The generalized method of cells in tractions, as in `gmc_reduced.solve_subcells`. A subcell that keeps a part k of its
stiffness has a compliance S / k, with S the inverse of the block of the tractions 22, 33, 23, 13, 12 in its intact
stiffness. Its strains of these components are

    free_t + c (free_1 - strain_1) + S t / k,    c = S C_t1,

t its tractions, C_t1 the column of the stiffness that strain 11 moves. So S and c are found once for all points, the
right side once for a point, and only the sum of the S / k has to be factorised again where something has softened.
"""

from __future__ import annotations

import numba as nb
import numpy as np

from gmc_service.gmc_reduced import places


@nb.njit(nogil=True, cache=True)
def traction_compliances(stiffness):  # type: ignore[no-untyped-def]
    """S and c of subcells, shape (subcells, 5, 5) and (subcells, 5), of stiffnesses, shape (subcells, 6, 6), Pa."""
    compliance, coupling = np.empty((len(stiffness), 5, 5)), np.zeros((len(stiffness), 5))
    for n in range(len(stiffness)):
        compliance[n] = np.linalg.inv(np.ascontiguousarray(stiffness[n, 1:, 1:]))
        for i in range(5):
            for j in range(5):
                coupling[n, i] += compliance[n, i, j] * stiffness[n, j + 1, 0]
    return compliance, coupling


@nb.njit(nogil=True, cache=True)
def factorise(heights, widths, compliance, kept, factor, first, scale):  # type: ignore[no-untyped-def]
    """Fill the Cholesky factor of the system of tractions, and the scale of its unknowns.

    Parameters
    ----------
    heights, widths : ndarray of float, shape (rows,) and (columns,)
        Shares of their sums.
    compliance : ndarray of float, shape (subcells, 5, 5)
        Of `traction_compliances`.
    kept : ndarray of float, shape (subcells,)
    factor : ndarray of float, shape (unknowns, unknowns)
        Filled at and below its diagonal.
    first : ndarray of int64, shape (unknowns,)
        Filled: the first column of each row that is not zero. Orthotropic subcells tie no shear to another traction.
    scale : ndarray of float, shape (unknowns,)
        Filled. Compliances of failed and intact subcells differ by many orders: with ones on the diagonal the factor
        stays exact.
    """
    rows, columns, unknowns = len(heights), len(widths), len(scale)
    place = np.empty(5, np.int64)
    factor[:] = 0.0
    for beta in range(rows):
        for gamma in range(columns):
            n = beta * columns + gamma
            weight = heights[beta] * widths[gamma] / kept[n]
            places(beta, gamma, rows, columns, place)
            for i in range(5):
                for j in range(5):
                    if place[i] >= place[j]:
                        factor[place[i], place[j]] += weight * compliance[n, i, j]
    for i in range(unknowns):
        scale[i] = 1.0 / np.sqrt(factor[i, i])
        first[i] = 0
        while factor[i, first[i]] == 0.0:
            first[i] += 1
    for i in range(unknowns):
        for j in range(first[i], i + 1):
            total = factor[i, j] * scale[i] * scale[j]
            for k in range(max(first[i], first[j]), j):
                total -= factor[i, k] * factor[j, k]
            factor[i, j] = np.sqrt(total) if i == j else total / factor[j, j]


@nb.njit(nogil=True, cache=True)
def solve(factor, first, scale, tractions):  # type: ignore[no-untyped-def]
    """Solve in place with what `factorise` has filled: from the right side to the tractions, shape (unknowns,)."""
    unknowns = len(scale)
    for i in range(unknowns):
        total = tractions[i] * scale[i]
        for k in range(first[i], i):
            total -= factor[i, k] * tractions[k]
        tractions[i] = total / factor[i, i]
    for i in range(unknowns - 1, -1, -1):
        tractions[i] /= factor[i, i]
        for k in range(first[i], i):
            tractions[k] -= factor[i, k] * tractions[i]
    for i in range(unknowns):
        tractions[i] *= scale[i]


@nb.njit(nogil=True, cache=True)
def right_side(heights, widths, coupling, free, macroscopic, right):  # type: ignore[no-untyped-def]
    """Fill the right side of a macroscopic strain, shape (6,); `free` is the free strain of subcells, (subcells, 6)."""
    rows, columns = len(heights), len(widths)
    place = np.empty(5, np.int64)
    right[:] = 0.0
    for beta in range(rows):
        for gamma in range(columns):
            n = beta * columns + gamma
            area = heights[beta] * widths[gamma]
            places(beta, gamma, rows, columns, place)
            for i in range(5):
                right[place[i]] -= area * (free[n, i + 1] + coupling[n, i] * (free[n, 0] - macroscopic[0]))
    for gamma in range(columns):
        right[gamma] += widths[gamma] * macroscopic[1]
        right[rows + columns + gamma] += widths[gamma] * macroscopic[5]
    for beta in range(rows):
        right[columns + beta] += heights[beta] * macroscopic[2]
        right[rows + 2 * columns + beta] += heights[beta] * macroscopic[4]
    right[2 * (rows + columns)] += macroscopic[3]


@nb.njit(nogil=True, cache=True)
def mechanical_strains(rows, columns, compliance, coupling, free, kept, along, tractions, strain):  # type: ignore[no-untyped-def]
    """Fill the strains of the subcells less their free strains, shape (subcells, 6); `along` is macroscopic strain 11.

    With them the stress of a subcell is what it keeps of its stiffness times them, and its effective stress is that of
    the whole stiffness.
    """
    place = np.empty(5, np.int64)
    for beta in range(rows):
        for gamma in range(columns):
            n = beta * columns + gamma
            places(beta, gamma, rows, columns, place)
            own = along - free[n, 0]
            strain[n, 0] = own
            for i in range(5):
                total = 0.0
                for j in range(5):
                    total += compliance[n, i, j] * tractions[place[j]]
                strain[n, i + 1] = total / kept[n] - coupling[n, i] * own


@nb.njit(nogil=True, cache=True)
def add_stress(heights, widths, stiffness, kept, strain, stress):  # type: ignore[no-untyped-def]
    """Add the mean stress of the cell to `stress`, shape (6,), of mechanical strains of the subcells."""
    columns = len(widths)
    for n in range(len(kept)):
        weight = heights[n // columns] * widths[n % columns] * kept[n]
        for i in range(6):
            total = 0.0
            for j in range(6):
                total += stiffness[n, i, j] * strain[n, j]
            stress[i] += weight * total
