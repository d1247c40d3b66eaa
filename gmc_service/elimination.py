"""Stress and failure of many points by elimination of subcells: the compiled loop over the points."""

from __future__ import annotations

import numba as nb
import numpy as np

from gmc_service.failure import FAILS_AT, HASHIN, TSAI_HILL, failure_index, maximum_index
from gmc_service.mask_table import find_mask

#: Entry of a point at which something would fail, where there is to be no cascade.
WOULD_FAIL = -1


@nb.njit(nogil=True, cache=True, error_model="numpy")
def query(  # type: ignore[no-untyped-def]
    strain, todo, table, checks, number, cascade, first, failed, stress, entry
):
    """Take points through their cascade of failures as far as the table goes.

    For each point: find the entry of its mask; compute what each check looks at; let all subcells whose index has
    reached one fail together; find the entry of the new mask; and so on until none fails. A point whose mask is not in
    the table waits.

    Parameters
    ----------
    strain : ndarray of float, shape (points, 6)
    todo : ndarray of int64, shape (waiting,)
        Points to treat; on return its beginning holds those that wait for the mask that they have in `failed`.
    table : tuple of ndarray
        Of `mask_table.Snapshot`: slots, masks, stiffness, locked, loads, offsets, alive, used.
    checks : tuple of ndarray
        Subcell, criterion, rates of `failure.Checks`.
    number : int
        Of this query, for `used`.
    cascade : bool
        If not, a point at which anything would fail is left as it is and has entry `WOULD_FAIL`.
    first : int
        Number of the first entry of this table, for `entry`.
    failed : ndarray of uint8, shape (points, bytes)
        Masks, changed in place.
    stress : ndarray of float, shape (points, 6)
        Filled: Pa, after the cascade.
    entry : ndarray of int64, shape (points,)
        Filled: entry of the final mask, counted from `first`.

    Returns
    -------
    waiting : int
    not_finite : int
        Point of which the strain is not finite, at which the loop ended; -1 if there is none.
    """
    slots, masks, stiffness, locked, loads, offsets, alive, used = table
    subcell, criterion, rates = checks
    compact = loads.shape[2] == 12
    waiting = 0
    marks = np.uint8(cascade)
    now = np.int64(-1)
    for place in range(len(todo)):
        point = todo[place]
        e1, e2, e3 = strain[point, 0], strain[point, 1], strain[point, 2]
        e4, e5, e6 = strain[point, 3], strain[point, 4], strain[point, 5]
        if not np.isfinite(e1 + e2 + e3 + e4 + e5 + e6):
            return waiting, point
        now = _entry(failed, point, now, slots, masks)
        any_fails = np.uint8(0)
        while now >= 0:
            any_fails = np.uint8(0)
            for row in range(alive[now, 0]):
                if compact:
                    a1 = loads[now, row, 0] * e1 + loads[now, row, 1] * e2 + loads[now, row, 2] * e3
                    a2 = loads[now, row, 3] * e1 + loads[now, row, 4] * e2 + loads[now, row, 5] * e3
                    a3 = loads[now, row, 6] * e1 + loads[now, row, 7] * e2 + loads[now, row, 8] * e3
                    a4 = loads[now, row, 9] * e4
                    a5 = loads[now, row, 10] * e5
                    a6 = loads[now, row, 11] * e6
                else:
                    a1 = _row(loads, now, row, 0, e1, e2, e3, e4, e5, e6)
                    a2 = _row(loads, now, row, 6, e1, e2, e3, e4, e5, e6)
                    a3 = _row(loads, now, row, 12, e1, e2, e3, e4, e5, e6)
                    a4 = _row(loads, now, row, 18, e1, e2, e3, e4, e5, e6)
                    a5 = _row(loads, now, row, 24, e1, e2, e3, e4, e5, e6)
                    a6 = _row(loads, now, row, 30, e1, e2, e3, e4, e5, e6)
                a1 += offsets[now, row, 0]
                a2 += offsets[now, row, 1]
                a3 += offsets[now, row, 2]
                a4 += offsets[now, row, 3]
                a5 += offsets[now, row, 4]
                a6 += offsets[now, row, 5]
                check = alive[now, row + 1]
                kind = criterion[check]
                if kind in (TSAI_HILL, HASHIN):
                    index = failure_index(kind, a1, a2, a3, a4, a5, a6, rates, check)
                else:
                    index = maximum_index(a1, a2, a3, a4, a5, a6, rates, check)
                # Without a branch: which subcells fail is hard to predict, and a wrong guess costs more than a store.
                fails = np.uint8(index >= FAILS_AT)
                any_fails |= fails
                failed[point, subcell[check] >> 3] |= (fails & marks) << np.uint8(subcell[check] & 7)
            if not any_fails:
                break
            if not cascade:
                entry[point] = WOULD_FAIL
                break
            now = _entry(failed, point, now, slots, masks)
        if now < 0:
            todo[waiting] = point
            waiting += 1
            continue
        if any_fails:
            continue
        entry[point] = first + now
        used[now] = number
        if compact:
            for k in range(3):
                total = stiffness[now, k, 0] * e1 + stiffness[now, k, 1] * e2 + stiffness[now, k, 2] * e3
                stress[point, k] = total - locked[now, k]
            stress[point, 3] = stiffness[now, 3, 3] * e4 - locked[now, 3]
            stress[point, 4] = stiffness[now, 4, 4] * e5 - locked[now, 4]
            stress[point, 5] = stiffness[now, 5, 5] * e6 - locked[now, 5]
        else:
            for k in range(6):
                total = -locked[now, k]
                for j in range(6):
                    total += stiffness[now, k, j] * strain[point, j]
                stress[point, k] = total
    return waiting, -1


@nb.njit(nogil=True, cache=True)
def _row(loads, entry, row, first, e1, e2, e3, e4, e5, e6):  # type: ignore[no-untyped-def]
    return (
        loads[entry, row, first] * e1
        + loads[entry, row, first + 1] * e2
        + loads[entry, row, first + 2] * e3
        + loads[entry, row, first + 3] * e4
        + loads[entry, row, first + 4] * e5
        + loads[entry, row, first + 5] * e6
    )


@nb.njit(nogil=True, cache=True)
def _entry(failed, point, guess, slots, masks):  # type: ignore[no-untyped-def]
    """Entry of a point's mask, or -1; neighbouring points often share one, so the last one is tried first."""
    if guess >= 0:
        same = True
        for k in range(failed.shape[1]):
            if masks[guess, k] != failed[point, k]:
                same = False
                break
        if same:
            return guess
    return find_mask(failed, point, slots, masks)


@nb.njit(nogil=True, cache=True)
def number_by_first_use(entry, entries):  # type: ignore[no-untyped-def]
    """Number the entries in the order in which the points first use them.

    Parameters
    ----------
    entry : ndarray of int64, shape (points,)
        0 or greater; replaced by the numbers.
    entries : int
        All are below it.

    Returns
    -------
    ndarray of int64
        Entry of each number.
    """
    number = np.full(entries, -1, dtype=np.int64)
    order = np.empty(min(entries, len(entry)), dtype=np.int64)
    count = 0
    for point in range(len(entry)):
        one = entry[point]
        if number[one] < 0:
            number[one] = count
            order[count] = one
            count += 1
        entry[point] = number[one]
    return order[:count]
