"""The generalized method of cells in its tractions, compiled.

What the subcells of a column share is the traction between them (stress 22 and 12), what those of a row share is
stress 33 and 13, and all share stress 23. With these 2 (rows + columns) + 1 tractions as unknowns (Pindera and
Bednarczyk, Composites B 30 (1999) 87-105), instead of the 6 rows columns strains of `gmc_dense`, the conditions on
stresses hold by themselves, and those on strains become a symmetric, positive definite system: that of the least
complementary energy. In a subcell with stiffness C and eigenstress s (stress = C strain + s), let t be the five
components without 11:

    strain_t = S (stress_t - s_t) + q strain_11,    S = C_tt^-1,  q = -S C_t1

Where no normal stress is tied to a shear strain (orthotropic constituents in the axes of the cell), the shears have
closed forms, and the rows + columns normal tractions remain. The longer side of their system is a diagonal block, so a
Cholesky factor of the shorter one is all there is to do.
"""

from __future__ import annotations

from typing import Final

import numba as nb
import numpy as np
from numpy.typing import NDArray

from gmc_service.homogenised import Homogenised

#: Sums may be taken in any order, so that they run in vector registers.
_FAST: Final = {"contract", "reassoc", "nsz"}
#: Entries of a stiffness that tie a normal stress to a shear strain, or one shear to another.
_COUPLED: Final = np.array([[(i < 3) != (j < 3) or (i >= 3 and j >= 3 and i != j) for j in range(6)] for i in range(6)])


def homogenise(
    heights: NDArray[np.float64],
    widths: NDArray[np.float64],
    stiffness: NDArray[np.float64],
    expansion: NDArray[np.float64],
) -> Homogenised:
    """Homogenise a cell; arguments and answer are those of `gmc_service.homogenised.Homogenise`."""
    shares = heights / heights.sum(), widths / widths.sum()
    fractions = np.outer(*shares).reshape(-1)
    if is_orthotropic(stiffness):
        normal, shear = compact(stiffness)
        every = np.arange(len(stiffness), dtype=np.int64)
        effective, concentration = homogenise_orthotropic(*shares, normal, shear, every)
    else:
        macroscopic = np.eye(6)
        unstressed = np.zeros((len(stiffness), 6, 6))
        concentration = solve_subcells(*shares, stiffness, unstressed, macroscopic)
        effective = np.einsum("n,nij,njk->ik", fractions, stiffness, concentration)
    eigenstress = -np.einsum("nij,nj->ni", stiffness, expansion)
    if eigenstress.any():
        thermal = solve_subcells(*shares, stiffness, eigenstress[:, :, None], np.zeros((6, 1)))[:, :, 0]
    else:
        thermal = np.zeros_like(expansion)
    # Levin: the macroscopic eigenstress is the mean of the subcells' own, weighted with the concentration.
    locked = np.einsum("n,nji,nj->i", fractions, concentration, eigenstress)
    return Homogenised(
        stiffness=0.5 * (effective + effective.T),
        expansion=-np.linalg.solve(effective, locked),
        concentration=concentration,
        thermal=thermal,
    )


def effective_stiffness_many(
    heights: NDArray[np.float64],
    widths: NDArray[np.float64],
    stiffness: NDArray[np.float64],
    choices: NDArray[np.int64],
) -> NDArray[np.float64]:
    """Effective stiffness of many states of one cell, for each of which every subcell picks its stiffness from a table.

    Parameters
    ----------
    heights, widths : ndarray of float, shape (rows,) and (columns,)
        m.
    stiffness : ndarray of float, shape (kinds, 6, 6)
        The table, Pa: usually each material intact and knocked down. Orthotropic in the axes of the cell.
    choices : ndarray of int64, shape (states, subcells)
        Index into the table for each subcell.

    Returns
    -------
    ndarray, shape (states, 6, 6)
        B*, Pa.

    Raises
    ------
    ValueError
        If a stiffness of the table ties normal stresses to shear strains, a shape does not fit, or an index is beyond
        the table.
    """
    if not is_orthotropic(stiffness):
        raise ValueError("stiffness must be orthotropic in the axes of the cell; homogenise takes any other")
    if choices.ndim != 2 or choices.shape[1] != len(heights) * len(widths):
        raise ValueError(f"choices has shape {choices.shape}; it must have (states, {len(heights) * len(widths)})")
    if len(choices) and (choices.min() < 0 or choices.max() >= len(stiffness)):
        raise ValueError(f"choices holds {choices.min()} to {choices.max()}; allowed is 0 to {len(stiffness) - 1}")
    return _orthotropic_many(heights / heights.sum(), widths / widths.sum(), *compact(stiffness), choices)


def is_orthotropic(stiffness: NDArray[np.float64]) -> bool:
    """Whether no stiffness, shape (..., 6, 6), ties a normal stress to a shear strain, or one shear to another."""
    return not stiffness[..., _COUPLED].any()


def compact(stiffness: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """What the normal system needs of each orthotropic stiffness, and the compliances in shear.

    Parameters
    ----------
    stiffness : ndarray of float, shape (kinds, 6, 6)

    Returns
    -------
    normal : ndarray, shape (kinds, 6)
        S22, S23, S33 of the inverse of C over 22 and 33; q2, q3; and the stiffness along 11 at no traction.
    shear : ndarray, shape (kinds, 3)
        1/C44, 1/C55, 1/C66.
    """
    determinant = stiffness[:, 1, 1] * stiffness[:, 2, 2] - stiffness[:, 1, 2] ** 2
    s22, s33 = stiffness[:, 2, 2] / determinant, stiffness[:, 1, 1] / determinant
    s23 = -stiffness[:, 1, 2] / determinant
    q2 = -(s22 * stiffness[:, 0, 1] + s23 * stiffness[:, 0, 2])
    q3 = -(s23 * stiffness[:, 0, 1] + s33 * stiffness[:, 0, 2])
    along = stiffness[:, 0, 0] + stiffness[:, 0, 1] * q2 + stiffness[:, 0, 2] * q3
    normal = np.stack([s22, s23, s33, q2, q3, along], axis=1)
    return np.ascontiguousarray(normal), 1.0 / stiffness[:, [3, 4, 5], [3, 4, 5]]


@nb.njit(nogil=True, cache=True, fastmath=_FAST)
def _solve_normal(heights, widths, normal, choice, tractions, kept_lines, gone_lines):  # type: ignore[no-untyped-def]
    """Fill `tractions`, shape (rows + columns, 3), for a unit of strains 11, 22, 33; columns first, then rows.

    `heights` and `widths` are shares of their sums. `kept_lines`, shape (shorter, shorter + 3), and `gone_lines`, shape
    (longer, shorter + 3), are room for the system with its three right sides behind it. The longer side has no more
    than its diagonal within itself.
    """
    rows, columns = len(heights), len(widths)
    by_columns = columns <= rows
    kept, gone = (columns, rows) if by_columns else (rows, columns)
    own_kept, own_gone = (0, 2) if by_columns else (2, 0)
    free_kept, free_gone = (3, 4) if by_columns else (4, 3)
    diagonal = np.zeros(gone)
    kept_lines[:] = 0.0
    gone_lines[:, kept:] = 0.0
    for beta in range(rows):
        for gamma in range(columns):
            entry = normal[choice[beta * columns + gamma]]
            area = heights[beta] * widths[gamma]
            at, off = (gamma, beta) if by_columns else (beta, gamma)
            kept_lines[at, at] += area * entry[own_kept]
            diagonal[off] += area * entry[own_gone]
            gone_lines[off, at] = area * entry[1]
            kept_lines[at, kept] -= area * entry[free_kept]
            gone_lines[off, kept] -= area * entry[free_gone]
    for at in range(kept):
        kept_lines[at, kept + (1 if by_columns else 2)] = widths[at] if by_columns else heights[at]
    for off in range(gone):
        gone_lines[off, kept + (2 if by_columns else 1)] = heights[off] if by_columns else widths[off]
    # The matrix is symmetric and positive definite, so no pivot is sought, and only its upper half is kept.
    for off in range(gone):
        diagonal[off] = 1.0 / diagonal[off]
        for i in range(kept):
            ratio = gone_lines[off, i] * diagonal[off]
            for j in range(i, kept + 3):
                kept_lines[i, j] -= ratio * gone_lines[off, j]
    for k in range(kept):
        inverse = 1.0 / kept_lines[k, k]
        for i in range(k + 1, kept):
            ratio = kept_lines[k, i] * inverse
            for j in range(i, kept + 3):
                kept_lines[i, j] -= ratio * kept_lines[k, j]
    first_kept, first_gone = (0, columns) if by_columns else (columns, 0)
    for i in range(kept - 1, -1, -1):
        for load in range(3):
            total = kept_lines[i, kept + load]
            for k in range(i + 1, kept):
                total -= kept_lines[i, k] * tractions[first_kept + k, load]
            tractions[first_kept + i, load] = total / kept_lines[i, i]
    for off in range(gone):
        for load in range(3):
            total = gone_lines[off, kept + load]
            for i in range(kept):
                total -= gone_lines[off, i] * tractions[first_kept + i, load]
            tractions[first_gone + off, load] = total * diagonal[off]


@nb.njit(nogil=True, cache=True, fastmath=_FAST)
def _effective(heights, widths, normal, shear, choice, tractions, effective):  # type: ignore[no-untyped-def]
    """Fill B*, shape (6, 6), from the normal tractions."""
    rows, columns = len(heights), len(widths)
    effective[:] = 0.0
    compliance23 = 0.0
    for beta in range(rows):
        for gamma in range(columns):
            kind = choice[beta * columns + gamma]
            area = heights[beta] * widths[gamma]
            effective[0, 0] += area * normal[kind, 5]
            for load in range(3):
                effective[0, load] -= area * (
                    normal[kind, 3] * tractions[gamma, load] + normal[kind, 4] * tractions[columns + beta, load]
                )
            compliance23 += area * shear[kind, 0]
    for load in range(3):
        for gamma in range(columns):
            effective[1, load] += widths[gamma] * tractions[gamma, load]
        for beta in range(rows):
            effective[2, load] += heights[beta] * tractions[columns + beta, load]
    for i in range(3):
        for j in range(i):
            mean = 0.5 * (effective[i, j] + effective[j, i])
            effective[i, j] = mean
            effective[j, i] = mean
    effective[3, 3] = 1.0 / compliance23
    for beta in range(rows):
        compliance = 0.0
        for gamma in range(columns):
            compliance += widths[gamma] * shear[choice[beta * columns + gamma], 1]
        effective[4, 4] += heights[beta] / compliance
    for gamma in range(columns):
        compliance = 0.0
        for beta in range(rows):
            compliance += heights[beta] * shear[choice[beta * columns + gamma], 2]
        effective[5, 5] += widths[gamma] / compliance


@nb.njit(nogil=True, cache=True)
def _orthotropic_many(heights, widths, normal, shear, choices):  # type: ignore[no-untyped-def]
    rows, columns = len(heights), len(widths)
    kept, gone = min(rows, columns), max(rows, columns)
    kept_lines, gone_lines = np.empty((kept, kept + 3)), np.empty((gone, kept + 3))
    tractions = np.empty((rows + columns, 3))
    effective = np.empty((len(choices), 6, 6))
    for state in range(len(choices)):
        _solve_normal(heights, widths, normal, choices[state], tractions, kept_lines, gone_lines)
        _effective(heights, widths, normal, shear, choices[state], tractions, effective[state])
    return effective


@nb.njit(nogil=True, cache=True)
def homogenise_orthotropic(heights, widths, normal, shear, choice):  # type: ignore[no-untyped-def]
    """B*, shape (6, 6), and the concentration, shape (subcells, 6, 6), of one state.

    `heights` and `widths` are shares of their sums; `normal` and `shear` are those of `compact`, `choice` has the
    row of each subcell in them.
    """
    rows, columns = len(heights), len(widths)
    kept, gone = min(rows, columns), max(rows, columns)
    tractions = np.empty((rows + columns, 3))
    kept_lines, gone_lines = np.empty((kept, kept + 3)), np.empty((gone, kept + 3))
    _solve_normal(heights, widths, normal, choice, tractions, kept_lines, gone_lines)
    effective = np.empty((6, 6))
    _effective(heights, widths, normal, shear, choice, tractions, effective)
    concentration = np.zeros((rows * columns, 6, 6))
    for beta in range(rows):
        compliance13 = 0.0
        for gamma in range(columns):
            compliance13 += widths[gamma] * shear[choice[beta * columns + gamma], 1]
        for gamma in range(columns):
            subcell = beta * columns + gamma
            entry = normal[choice[subcell]]
            own = concentration[subcell]
            own[0, 0] = 1.0
            for load in range(3):
                along2, along3 = tractions[gamma, load], tractions[columns + beta, load]
                own[1, load] = entry[0] * along2 + entry[1] * along3
                own[2, load] = entry[1] * along2 + entry[2] * along3
            own[1, 0] += entry[3]
            own[2, 0] += entry[4]
            own[3, 3] = shear[choice[subcell], 0] * effective[3, 3]
            own[4, 4] = shear[choice[subcell], 1] / compliance13
    for gamma in range(columns):
        compliance12 = 0.0
        for beta in range(rows):
            compliance12 += heights[beta] * shear[choice[beta * columns + gamma], 2]
        for beta in range(rows):
            subcell = beta * columns + gamma
            concentration[subcell, 5, 5] = shear[choice[subcell], 2] / compliance12
    return effective, concentration


@nb.njit(nogil=True, cache=True)
def solve_subcells(heights, widths, stiffness, eigenstress, macroscopic):  # type: ignore[no-untyped-def]
    """Strains of the subcells under macroscopic strains, where each subcell has an eigenstress of its own.

    Parameters
    ----------
    heights, widths : ndarray of float, shape (rows,) and (columns,)
        Shares of their sums.
    stiffness : ndarray of float, shape (subcells, 6, 6)
        Pa; any anisotropy.
    eigenstress : ndarray of float, shape (subcells, 6, loads)
        Stress at no strain, Pa.
    macroscopic : ndarray of float, shape (6, loads)

    Returns
    -------
    ndarray, shape (subcells, 6, loads)
    """
    rows, columns = len(heights), len(widths)
    loads = macroscopic.shape[1]
    unknowns = 2 * (rows + columns) + 1
    system = np.zeros((unknowns, unknowns))
    right = np.zeros((unknowns, loads))
    compliance = np.empty((rows * columns, 5, 5))
    free = np.empty((rows * columns, 5, loads))  # strain_t at no traction
    place = np.empty(5, np.int64)
    for beta in range(rows):
        for gamma in range(columns):
            n = beta * columns + gamma
            area = heights[beta] * widths[gamma]
            compliance[n] = np.linalg.inv(np.ascontiguousarray(stiffness[n, 1:, 1:]))
            places(beta, gamma, rows, columns, place)
            for load in range(loads):
                for i in range(5):
                    total = 0.0
                    for j in range(5):
                        pull = eigenstress[n, j + 1, load] + stiffness[n, j + 1, 0] * macroscopic[0, load]
                        total -= compliance[n, i, j] * pull
                    free[n, i, load] = total
                    right[place[i], load] -= area * total
            for i in range(5):
                for j in range(5):
                    system[place[i], place[j]] += area * compliance[n, i, j]
    for load in range(loads):
        for gamma in range(columns):
            right[gamma, load] += widths[gamma] * macroscopic[1, load]
            right[rows + columns + gamma, load] += widths[gamma] * macroscopic[5, load]
        for beta in range(rows):
            right[columns + beta, load] += heights[beta] * macroscopic[2, load]
            right[rows + 2 * columns + beta, load] += heights[beta] * macroscopic[4, load]
        right[unknowns - 1, load] += macroscopic[3, load]
    # Compliances of failed and intact subcells differ by many orders: with ones on the diagonal the factor stays exact.
    scale = 1.0 / np.sqrt(np.diag(system))
    for i in range(unknowns):
        right[i] *= scale[i]
        for j in range(unknowns):
            system[i, j] *= scale[i] * scale[j]
    tractions = np.linalg.solve(system, right)
    strain = np.empty((rows * columns, 6, loads))
    for beta in range(rows):
        for gamma in range(columns):
            n = beta * columns + gamma
            places(beta, gamma, rows, columns, place)
            for load in range(loads):
                strain[n, 0, load] = macroscopic[0, load]
                for i in range(5):
                    total = free[n, i, load]
                    for j in range(5):
                        total += compliance[n, i, j] * tractions[place[j], load] * scale[place[j]]
                    strain[n, i + 1, load] = total
    return strain


@nb.njit(nogil=True, cache=True)
def places(beta, gamma, rows, columns, place):  # type: ignore[no-untyped-def]
    """Unknowns of the tractions 22, 33, 23, 13, 12 of a subcell: 22 and 12 of its column, 33 and 13 of its row."""
    place[0] = gamma
    place[1] = columns + beta
    place[2] = 2 * (rows + columns)
    place[3] = rows + 2 * columns + beta
    place[4] = rows + columns + gamma
