"""Entries of a table of masks, compiled: for orthotropic subcells in the generalized method of cells as it is.

Other cells take the readable way, `mask_table.MaskTable`, which costs some ten times as much for each mask.
"""

from __future__ import annotations

import numba as nb
import numpy as np

from gmc_service.failure import MAXIMUM_STRAIN
from gmc_service.gmc_reduced import homogenise_orthotropic, solve_subcells


@nb.njit(nogil=True, cache=True)
def fill_entries(  # type: ignore[no-untyped-def]
    heights, widths, normal, shear, kinds, expansion, change, checks, failed, table, first
):
    """Fill entries of a table for cells with failed subcells.

    Parameters
    ----------
    heights, widths : ndarray of float, shape (rows,) and (columns,)
        Shares of their sums.
    normal, shear : ndarray of float, shape (2 subcells, 6) and (2 subcells, 3)
        Of `gmc_reduced.compact`, for the intact subcells and then the knocked down ones.
    kinds : ndarray of float, shape (2 subcells, 6, 6)
        Their stiffness, Pa.
    expansion : ndarray of float, shape (subcells, 6)
        1/K.
    change : float
        Of temperature, K.
    checks : tuple of ndarray
        Subcell, criterion, rates of `failure.Checks`.
    failed : ndarray of bool, shape (states, subcells)
    table : tuple of ndarray
        Of `mask_table.Snapshot`; stiffness, locked, loads (compact), offsets and alive are filled.
    first : int
        Entry of the first state.
    """
    _, _, stiffness, locked, loads, offsets, alive, _ = table
    subcell, criterion, _ = checks
    subcells, columns = len(expansion), len(widths)
    choice = np.empty(subcells, dtype=np.int64)
    eigenstress, own = np.zeros((subcells, 6, 1)), np.empty((subcells, 6, 6))
    mechanical = np.zeros((subcells, 6))
    heated = change != 0.0 and np.any(expansion != 0.0)
    still = np.zeros((6, 1))
    for state in range(len(failed)):
        entry = first + state
        for n in range(subcells):
            choice[n] = n + subcells if failed[state, n] else n
        effective, concentration = homogenise_orthotropic(heights, widths, normal, shear, choice)
        for i in range(6):
            locked[entry, i] = 0.0
            for j in range(6):
                stiffness[entry, i, j] = 0.5 * (effective[i, j] + effective[j, i])
        if heated:
            for n in range(subcells):
                for i in range(6):
                    total = 0.0
                    for j in range(6):
                        own[n, i, j] = kinds[choice[n], i, j]
                        total -= own[n, i, j] * expansion[n, j] * change
                    eigenstress[n, i, 0] = total
            strain = solve_subcells(heights, widths, own, eigenstress, still)
            for n in range(subcells):
                area = heights[n // columns] * widths[n % columns]
                for i in range(6):
                    mechanical[n, i] = strain[n, i, 0] - expansion[n, i] * change
                    for j in range(6):  # Levin: the mean eigenstress, weighted with the concentration
                        locked[entry, i] -= area * concentration[n, j, i] * eigenstress[n, j, 0]
        row = 0
        for check in range(len(subcell)):
            n = subcell[check]
            if failed[state, n]:
                continue
            if criterion[check] == MAXIMUM_STRAIN:
                for i in range(3):
                    for j in range(3):
                        loads[entry, row, 3 * i + j] = concentration[n, i, j]
                    loads[entry, row, 9 + i] = concentration[n, 3 + i, 3 + i]
                for i in range(6):
                    offsets[entry, row, i] = mechanical[n, i]
            else:
                for i in range(3):
                    for j in range(3):
                        total = 0.0
                        for k in range(3):
                            total += kinds[n, i, k] * concentration[n, k, j]
                        loads[entry, row, 3 * i + j] = total
                    loads[entry, row, 9 + i] = kinds[n, 3 + i, 3 + i] * concentration[n, 3 + i, 3 + i]
                for i in range(6):
                    total = 0.0
                    for j in range(6):
                        total += kinds[n, i, j] * mechanical[n, j]
                    offsets[entry, row, i] = total
            row += 1
            alive[entry, row] = check
        alive[entry, 0] = row
