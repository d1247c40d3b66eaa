"""Subcells that soften: a damage variable with the energy of the crack-band model.

Bazant and Oh, Mat. Struct. 16 (1983) 155; in the generalized method of cells Pineda, Bednarcyk and Arnold,
NASA/TM-2013-217853.

Let r be the failure index of a subcell under the effective stress, that of its intact stiffness at its strain, and let
it have reached one. The subcell's stiffness is multiplied by 1 - d with

    1 - d = (r_f - r) / (r (r_f - 1)),    r_f = G_c / (L U),

for the largest r that has been, never below the knock-down factor. Along a proportional path its stress then falls in a
straight line from the strength, at r = 1, to zero at r = r_f. U is the elastic energy per volume at r = 1, for the load
with which the subcell came there, and L the length over which it smears its crack: so G_c is spent per area of crack.
Under one stress alone U = strength^2 / 2E, and the strain at r_f is 2 G_c / (strength L).

An element of length l holds l / h cells in a row along an axis; of a crack normal to that axis, each takes its part. In
a cell all subcells of one material along a line share the traction on that crack and soften together. So L is l times
the share of the subcell's material in the line of subcells along the crack's normal: 1 for axis 1, its share of the
column for axis 2, of the row for axis 3. A crack then spends G_c once, in a thin layer as in a whole cell, and to
subdivide a subcell changes nothing. The normal is that of the component that is nearest to its allowable when r reaches
one: 1 for 11; 2 for 22 and 12; 3 for 33 and 13; for 23, whose crack is inclined to both, the larger share counts.

An element longer than 2 E G_c / (strength^2 share) stores more than its crack can take. It is refused, or, where the
material reduces its strength, each allowable stress is lowered to sqrt(2 E G_c / (L share)): the energy is then right
and the subcell fails at once (Bazant and Oh 1983, section 7). Under several stresses at once the limit is shorter; the
subcell then fails at once at its own strength.

A point's damages are found by repetition: strains of the subcells with the damages so far, damages from these strains,
and so on until none rises. None falls, so in a large step a subcell may be damaged that in small steps the softening of
another would have unloaded first; elimination has the same property. Where a subcell is about to snap through, rises
hardly change from one round to the next; after many rounds one in a few goes further, towards where they would end.
"""

from __future__ import annotations

from typing import Final

import numba as nb
import numpy as np

from gmc_service.damaged_tractions import (
    add_stress,
    factorise,
    mechanical_strains,
    right_side,
    solve,
    traction_compliances,
)
from gmc_service.failure import FAILS_AT, HASHIN, MAXIMUM_STRAIN, failure_index, hashin_modes

#: Values of a softening subcell in the history of a point: damage d, and r_f once r has reached one (0 before).
VALUES: Final = 2
#: The repetition ends when no damage rises by more than this, and is given up after so many rounds.
_SETTLED: Final = 1e-12
_ROUNDS: Final = 5000
#: After so many rounds one in some goes this part of the way to where the last two rises, in geometric series, end.
_PATIENCE: Final = 100
_ONE_IN: Final = 4
_STRETCH: Final = 0.8


@nb.njit(nogil=True, cache=True)
def kept_stiffness(ratio, ratio_failed, knock_down):  # type: ignore[no-untyped-def]
    """1 - d for an index r and the r_f at which nothing is left; at least the knock-down factor."""
    if ratio >= ratio_failed:
        return knock_down
    return max((ratio_failed - ratio) / (ratio * (ratio_failed - 1.0)), knock_down)


@nb.njit(nogil=True, cache=True)
def crack_component(criterion, load, rates, check):  # type: ignore[no-untyped-def]
    """Component (0 to 5 for 11, 22, 33, 23, 13, 12) nearest to its allowable; of Hashin's in the mode that governs.

    Parameters
    ----------
    criterion : int
        Place in `material.CRITERIA`.
    load : ndarray of float, shape (6,)
    rates : ndarray of float, shape (checks, 9)
    check : int
        Row of `rates`.

    Returns
    -------
    int
    """
    first = 0
    if criterion == HASHIN:
        fibre, matrix = hashin_modes(load[0], load[1], load[2], load[3], load[4], load[5], rates, check)
        if fibre >= matrix:
            return 0
        first = 1
    most, component = -1.0, first
    for i in range(first, 6):
        rate = rates[check, i + 3] if i >= 3 or load[i] < 0.0 else rates[check, i]
        if abs(load[i]) * rate > most:
            most, component = abs(load[i]) * rate, i
    return component


@nb.njit(nogil=True, cache=True)
def length_share(component, share2, share3):  # type: ignore[no-untyped-def]
    """Share of an element's length that a subcell's crack is smeared over; see the module.

    Parameters
    ----------
    component : int
        Of `crack_component`.
    share2, share3 : float
        Share of the subcell's material in its column, along axis 2, and in its row, along axis 3.

    Returns
    -------
    float
    """
    if component == 0:
        return 1.0
    if component == 1 or component == 5:
        return share2
    if component == 2 or component == 4:
        return share3
    return max(share2, share3)


@nb.njit(nogil=True, cache=True)
def _look(stiffness, checks, strain, energy, failed, index, governing, load):  # type: ignore[no-untyped-def]
    """Look at every check with the effective stresses: fill the largest index of each softening subcell and its check.

    Returns whether a subcell without fracture energy has failed; `load` is room.
    """
    subcell, criterion, rates = checks
    more = False
    index[:] = 0.0
    for check in range(len(subcell)):
        n = subcell[check]
        if failed[n]:
            continue
        _load(stiffness, strain, criterion[check], n, load)
        one = failure_index(criterion[check], load[0], load[1], load[2], load[3], load[4], load[5], rates, check)
        if not np.isfinite(energy[n]):
            if one >= FAILS_AT:
                failed[n] = True
                more = True
        elif one > index[n]:
            index[n], governing[n] = one, check
    return more


@nb.njit(nogil=True, cache=True)
def _load(stiffness, strain, criterion, n, load):  # type: ignore[no-untyped-def]
    """Mechanical strain or effective stress of a subcell, as a criterion takes it."""
    for i in range(6):
        if criterion == MAXIMUM_STRAIN:
            load[i] = strain[n, i]
        else:
            total = 0.0
            for j in range(6):
                total += stiffness[n, i, j] * strain[n, j]
            load[i] = total


@nb.njit(nogil=True, cache=True)
def respond(  # type: ignore[no-untyped-def]
    heights,
    widths,
    shares,
    stiffness,
    free,
    knock_down,
    energy,
    checks,
    limits,
    strains,
    lengths,
    failed,
    damages,
    stresses,
    tangents,
):
    """Take points to their strains; subcells soften, or fail where they have no fracture energy.

    Parameters
    ----------
    heights, widths : ndarray of float, shape (rows,) and (columns,)
        Shares of their sums.
    shares : ndarray of float, shape (subcells, 2)
        For `length_share`.
    stiffness : ndarray of float, shape (subcells, 6, 6)
        Intact, Pa.
    free : ndarray of float, shape (subcells, 6)
        Thermal strain.
    knock_down : float
    energy : ndarray of float, shape (subcells,)
        Fracture energy, J/m^2; ``inf`` where a subcell does not soften.
    checks : tuple of ndarray
        Subcell, criterion, rates of `failure.Checks`.
    limits : ndarray of float, shape (checks, 9)
        Length of an element beyond which the allowable is lowered, m.
    strains : ndarray of float, shape (points, 6)
    lengths : ndarray of float, shape (points,)
        Of the elements, m.
    failed : ndarray of bool, shape (points, subcells)
        Changed in place; a softening subcell has failed once its knock-down is reached.
    damages : ndarray of float, shape (points, subcells, 2)
        d and r_f, changed in place.
    stresses, tangents : ndarray of float, shape (points, 6) and (points, 6, 6)
        Filled, Pa; the tangents are secant stiffnesses.

    Returns
    -------
    int
        Point whose damages did not settle, or -1.
    """
    count, rows, columns = len(stiffness), len(heights), len(widths)
    unknowns = 2 * (rows + columns) + 1
    kept, index = np.empty(count), np.empty(count)
    governing = np.zeros(count, dtype=np.int64)
    compliance, coupling = traction_compliances(stiffness)
    factor, scale = np.empty((unknowns, unknowns)), np.empty(unknowns)
    first = np.empty(unknowns, dtype=np.int64)
    right, tractions = np.empty(unknowns), np.empty(unknowns)
    strain, load, unit, of_unit = np.empty((count, 6)), np.empty(6), np.zeros(6), np.empty(6)
    none = np.zeros((count, 6))
    subcell, criterion, whole_rates = checks
    rates = whole_rates.copy()
    own_checks = (subcell, criterion, rates)
    for point in range(len(strains)):
        for check in range(len(rates)):
            for i in range(9):
                beyond = lengths[point] / limits[check, i]
                rates[check, i] = whole_rates[check, i] * (np.sqrt(beyond) if beyond > 1.0 else 1.0)
        right_side(heights, widths, coupling, free, strains[point], right)
        settled, stretch, before = False, 1.0, np.inf
        for number in range(_ROUNDS):
            for n in range(count):
                kept[n] = knock_down if failed[point, n] else 1.0 - damages[point, n, 0]
            factorise(heights, widths, compliance, kept, factor, first, scale)
            tractions[:] = right
            solve(factor, first, scale, tractions)
            mechanical_strains(
                rows, columns, compliance, coupling, free, kept, strains[point, 0], tractions, strain
            )  # fmt: skip
            more = _look(stiffness, own_checks, strain, energy, failed[point], index, governing, load)
            rise = 0.0
            for n in range(count):
                damage = damages[point, n]
                if failed[point, n] or not np.isfinite(energy[n]):
                    continue
                if damage[1] == 0.0:
                    if index[n] < FAILS_AT:
                        continue
                    spent = energy[n] / lengths[point]
                    damage[1] = _ratio_failed(
                        stiffness, own_checks, strain, n, governing[n], index[n], load, spent, shares[n]
                    )
                now = 1.0 - kept_stiffness(max(index[n], 1.0), damage[1], knock_down)
                if now > damage[0] + _SETTLED:
                    rise = max(rise, now - damage[0])
                    damage[0] = min(damage[0] + stretch * (now - damage[0]), 1.0 - knock_down)
                    more = True
                    if damage[0] == 1.0 - knock_down:
                        failed[point, n] = True
            if not more:
                settled = True
                break
            ratio = rise / before if before > 0.0 else np.inf  # only what fails at once has moved
            before, stretch = rise, 1.0
            if number >= _PATIENCE and number % _ONE_IN == 0 and ratio < 1.0:
                stretch = max(1.0, _STRETCH / (1.0 - ratio))
        if not settled:
            return point
        stresses[point] = 0.0
        add_stress(heights, widths, stiffness, kept, strain, stresses[point])
        for k in range(6):
            unit[k] = 1.0
            right_side(heights, widths, coupling, none, unit, tractions)
            solve(factor, first, scale, tractions)
            mechanical_strains(rows, columns, compliance, coupling, none, kept, unit[0], tractions, strain)
            unit[k] = 0.0
            of_unit[:] = 0.0
            add_stress(heights, widths, stiffness, kept, strain, of_unit)
            tangents[point, :, k] = of_unit
    return -1


@nb.njit(nogil=True, cache=True)
def _ratio_failed(  # type: ignore[no-untyped-def]
    stiffness, checks, strain, n, check, index, load, energy_per_length, shares
):
    """r_f of a subcell whose index has reached one: the energy of its crack over the elastic energy at that moment.

    One where the energy that is stored is larger than the crack can take: the subcell then fails at once.
    """
    criterion = checks[1][check]
    stored = 0.0
    _load(stiffness, strain, -1, n, load)
    for i in range(6):
        stored += 0.5 * load[i] * strain[n, i]
    stored /= index * index
    _load(stiffness, strain, criterion, n, load)
    share = length_share(crack_component(criterion, load, checks[2], check), shares[0], shares[1])
    return max(energy_per_length / (share * stored), 1.0)
