"""Subcells that yield: J2 plasticity with linear isotropic hardening inside the generalized method of cells.

Each subcell carries its plastic strain and its equivalent plastic strain (Eq 89 has their macroscopic mean). A step
goes from one macroscopic strain to the next, and is implicit: the stress of every subcell at the end of the step is on
or inside its yield surface (radial return; Simo and Hughes, Computational Inelasticity, 1998, box 3.1 and section 3.3),
and the tractions and strains of the subcells meet the conditions of the cell. Newton's method finds it: with the
consistent tangent of each subcell the cell is a linear one again, with eigenstresses, which `gmc_reduced` solves; a
line search keeps it from overshooting, since the energy of a step is convex.
"""

from __future__ import annotations

from typing import Final

import numba as nb
import numpy as np

from gmc_service.failure import FAILS_AT, MAXIMUM_STRAIN, failure_index
from gmc_service.gmc_reduced import solve_subcells

#: Values of a subcell in the history of a point: plastic strain (engineering shear), equivalent plastic strain.
VALUES: Final = 7
#: Newton iterations of one step, and the largest stress out of balance after them, over the largest yield stress.
_ITERATIONS: Final = 60
_CLOSED: Final = 1e-10
#: Looks along one Newton step, and the part of the slope of the energy that may be left after them.
_SEARCHES: Final = 12
_SLOPE_LEFT: Final = 0.5
#: Hardening over three times the shear modulus that the tangent has at least, since that of ideal plasticity has no
#: inverse. It steers the iteration only; the stresses obey the material's own hardening.
_LEAST_HARDENING: Final = 1e-6


@nb.njit(nogil=True, cache=True)
def return_mapping(stiffness, yield_stress, hardening, elastic, equivalent, stress, tangent):  # type: ignore[no-untyped-def]
    """Stress and tangent of one yielding, elastically isotropic subcell; radial return.

    Parameters
    ----------
    stiffness : ndarray of float, shape (6, 6)
        Pa; isotropic.
    yield_stress, hardening : float
        Pa; at no plastic strain, and its increase per equivalent plastic strain.
    elastic : ndarray of float, shape (6,)
        Strain less free expansion and the plastic strain before the step.
    equivalent : float
        Equivalent plastic strain before the step.
    stress : ndarray of float, shape (6,)
        Filled, Pa.
    tangent : ndarray of float, shape (6, 6)
        Filled: derivative of the stress by the strain, Pa.

    Returns
    -------
    float
        Increment of the equivalent plastic strain. That of the plastic strain is this times 3/2 of the deviatoric
        stress over the equivalent stress.
    """
    for i in range(6):
        total = 0.0
        for j in range(6):
            total += stiffness[i, j] * elastic[j]
            tangent[i, j] = stiffness[i, j]
        stress[i] = total
    pressure = (stress[0] + stress[1] + stress[2]) / 3.0
    square = stress[3] ** 2 + stress[4] ** 2 + stress[5] ** 2
    for i in range(3):
        square += 0.5 * (stress[i] - pressure) ** 2
    trial = np.sqrt(3.0 * square)
    excess = trial - (yield_stress + hardening * equivalent)
    if not excess > 0.0:
        return 0.0
    shear = stiffness[5, 5]
    increment = excess / (3.0 * shear + hardening)
    kept = 1.0 - 3.0 * shear * increment / trial
    least = max(hardening, _LEAST_HARDENING * 3.0 * shear)
    flow = 9.0 * shear * shear * (increment / trial - 1.0 / (3.0 * shear + least)) / (trial * trial)
    bulk_part = shear * (1.0 - kept) * 2.0 / 3.0
    for i in range(6):
        for j in range(6):
            one = (stress[i] - pressure if i < 3 else stress[i]) * (stress[j] - pressure if j < 3 else stress[j])
            tangent[i, j] += flow * one
    for i in range(3):
        for j in range(3):
            tangent[i, j] += bulk_part
        tangent[i, i] -= 2.0 * shear * (1.0 - kept)
        tangent[i + 3, i + 3] -= shear * (1.0 - kept)
        stress[i] = pressure + kept * (stress[i] - pressure)
        stress[i + 3] *= kept
    return increment


@nb.njit(nogil=True, cache=True)
def _subcell_stresses(cell, failed, free, before, strain, stress, tangent, after):  # type: ignore[no-untyped-def]
    """Stress, tangent and history of all subcells at their strains."""
    stiffness, yields, hardening, knock_down = cell
    elastic = np.empty(6)
    for n in range(len(strain)):
        factor = knock_down if failed[n] else 1.0
        after[n] = before[n]
        for i in range(6):
            elastic[i] = strain[n, i] - free[n, i] - before[n, i]
        if failed[n] or not np.isfinite(yields[n]):
            for i in range(6):
                total = 0.0
                for j in range(6):
                    tangent[n, i, j] = factor * stiffness[n, i, j]
                    total += tangent[n, i, j] * elastic[j]
                stress[n, i] = total
            continue
        increment = return_mapping(stiffness[n], yields[n], hardening[n], elastic, before[n, 6], stress[n], tangent[n])
        if increment > 0.0:
            after[n, 6] += increment
            pressure = (stress[n, 0] + stress[n, 1] + stress[n, 2]) / 3.0
            ratio = 1.5 * increment / (yields[n] + hardening[n] * after[n, 6])
            for i in range(3):
                after[n, i] += ratio * (stress[n, i] - pressure)
                after[n, i + 3] += 2.0 * ratio * stress[n, i + 3]


@nb.njit(nogil=True, cache=True)
def step(heights, widths, cell, failed, free, before, macroscopic, strain, stress, tangent, after):  # type: ignore[no-untyped-def]
    """Take one point to a macroscopic strain.

    Parameters
    ----------
    heights, widths : ndarray of float, shape (rows,) and (columns,)
        Shares of their sums.
    cell : tuple
        Stiffness of the intact subcells (subcells, 6, 6), yield stress (subcells,) with ``inf`` where a subcell does
        not yield, hardening (subcells,), knock-down factor.
    failed : ndarray of bool, shape (subcells,)
        A failed subcell is elastic, knocked down, about the plastic strain it had.
    free : ndarray of float, shape (subcells, 6)
        Thermal strain.
    before, after : ndarray of float, shape (subcells, 7)
        History before the step, and filled: after it.
    macroscopic : ndarray of float, shape (6,)
    strain : ndarray of float, shape (subcells, 6)
        Guess, and filled.
    stress : ndarray of float, shape (subcells, 6)
        Filled, Pa.
    tangent : ndarray of float, shape (subcells, 6, 6)
        Filled, Pa.

    Returns
    -------
    bool
        Whether the iteration closed.
    """
    count, columns = len(strain), len(widths)
    load = macroscopic.reshape(6, 1).copy()
    eigenstress = np.empty((count, 6, 1))
    start, way, predicted = np.empty((count, 6)), np.empty((count, 6)), np.empty((count, 6))
    scale = 0.0
    for n in range(count):
        if np.isfinite(cell[1][n]):
            scale = max(scale, cell[1][n])
    _subcell_stresses(cell, failed, free, before, strain, stress, tangent, after)
    for _ in range(_ITERATIONS):
        for n in range(count):
            for i in range(6):
                total = stress[n, i]
                for j in range(6):
                    total -= tangent[n, i, j] * strain[n, j]
                eigenstress[n, i, 0] = total
        solved = solve_subcells(heights, widths, tangent, eigenstress, load)
        slope = 0.0
        for n in range(count):
            area = heights[n // columns] * widths[n % columns]
            for i in range(6):
                start[n, i] = strain[n, i]
                way[n, i] = solved[n, i, 0] - strain[n, i]
                slope += area * stress[n, i] * way[n, i]
            for i in range(6):
                total = stress[n, i]
                for j in range(6):
                    total += tangent[n, i, j] * way[n, j]
                predicted[n, i] = total
        # The energy of the step is convex along the way; its slope shows whether a whole Newton step goes too far.
        share, below, above, slope_below, slope_above = 1.0, 0.0, 1.0, slope, 0.0
        for search in range(_SEARCHES):
            for n in range(count):
                for i in range(6):
                    strain[n, i] = start[n, i] + share * way[n, i]
            _subcell_stresses(cell, failed, free, before, strain, stress, tangent, after)
            if search == 0:
                largest, apart = scale, 0.0
                for n in range(count):
                    for i in range(6):
                        largest = max(largest, abs(stress[n, i]))
                        apart = max(apart, abs(stress[n, i] - predicted[n, i]))
                # The prediction is in equilibrium; once the stresses are the predicted ones, they are too.
                if apart <= _CLOSED * largest:
                    return True
            here = 0.0
            for n in range(count):
                area = heights[n // columns] * widths[n % columns]
                for i in range(6):
                    here += area * stress[n, i] * way[n, i]
            if abs(here) <= _SLOPE_LEFT * abs(slope):
                break
            if here < 0.0 and share == 1.0:
                break
            if here > 0.0:
                above, slope_above = share, here
            else:
                below, slope_below = share, here
            # Between bisection and the secant: the slope bends where subcells begin to yield.
            secant = below + (above - below) * slope_below / (slope_below - slope_above)
            share = 0.5 * (secant + 0.5 * (below + above))
    return False


@nb.njit(nogil=True, cache=True)
def respond(  # type: ignore[no-untyped-def]
    heights, widths, cell, free, checks, strains, failed, histories, stresses, tangents, unclosed
):
    """Take many points to their macroscopic strains; subcells fail until none does.

    Parameters
    ----------
    heights, widths, cell
        As in `step`.
    free : ndarray of float, shape (subcells, 6)
        Thermal strain.
    checks : tuple of ndarray
        Subcell, criterion, rates of `failure.Checks`.
    strains : ndarray of float, shape (points, 6)
    failed : ndarray of bool, shape (points, subcells)
        Before, and filled: after.
    histories : ndarray of float, shape (points, subcells, 7)
        Before, and filled: after.
    stresses, tangents : ndarray of float, shape (points, 6) and (points, 6, 6)
        Filled, Pa.
    unclosed : ndarray of int64, shape (points,)
        Room for the points of which the iteration did not close.

    Returns
    -------
    int
        Number of points whose iteration did not close; what they hold is not to be used.
    """
    count = len(free)
    rows, columns = len(heights), len(widths)
    strain, stress = np.zeros((count, 6)), np.empty((count, 6))
    tangent, after = np.empty((count, 6, 6)), np.empty((count, 7))
    unit, none = np.eye(6), np.zeros((count, 6, 6))
    open_points = 0
    for point in range(len(strains)):
        before = histories[point].copy()
        while True:
            for n in range(count):
                strain[n] = strains[point]
            closed = step(
                heights, widths, cell, failed[point], free, before, strains[point], strain, stress, tangent, after
            )
            if not closed:
                break
            more = False
            for check in range(len(checks[0])):
                n = checks[0][check]
                if failed[point, n]:
                    continue
                load = strain[n] - free[n] if checks[1][check] == MAXIMUM_STRAIN else stress[n]
                index = failure_index(
                    checks[1][check], load[0], load[1], load[2], load[3], load[4], load[5], checks[2], check
                )
                if index >= FAILS_AT:
                    failed[point, n] = True
                    more = True
            if not more:
                break
        if not closed:
            unclosed[open_points] = point
            open_points += 1
            continue
        histories[point] = after
        concentration = solve_subcells(heights, widths, tangent, none, unit)
        stresses[point] = 0.0
        tangents[point] = 0.0
        for beta in range(rows):
            for gamma in range(columns):
                n = beta * columns + gamma
                area = heights[beta] * widths[gamma]
                tangents[point] += area * (np.ascontiguousarray(tangent[n]) @ np.ascontiguousarray(concentration[n]))
                stresses[point] += area * stress[n]
    return open_points


@nb.njit(nogil=True, cache=True)
def strains_at_rest(heights, widths, cell, free, strains, failed, histories):  # type: ignore[no-untyped-def]
    """Stress and strain of all subcells with the plastic strain they have; parameters as in `respond`.

    Returns
    -------
    stress, strain : ndarray, shape (points, subcells, 6)
    """
    count = len(free)
    stress, strain = np.empty((len(strains), count, 6)), np.empty((len(strains), count, 6))
    stiffness, eigenstress = np.empty((count, 6, 6)), np.empty((count, 6, 1))
    for point in range(len(strains)):
        for n in range(count):
            factor = cell[3] if failed[point, n] else 1.0
            for i in range(6):
                total = 0.0
                for j in range(6):
                    stiffness[n, i, j] = factor * cell[0][n, i, j]
                    total -= stiffness[n, i, j] * (free[n, j] + histories[point, n, j])
                eigenstress[n, i, 0] = total
        solved = solve_subcells(heights, widths, stiffness, eigenstress, strains[point].reshape(6, 1).copy())
        for n in range(count):
            for i in range(6):
                strain[point, n, i] = solved[n, i, 0]
            for i in range(6):
                total = eigenstress[n, i, 0]
                for j in range(6):
                    total += stiffness[n, i, j] * strain[point, n, j]
                stress[point, n, i] = total
    return stress, strain
