"""Return of a trial state to the von Mises yield surface, in logarithmic strain and principal axes.

Each point carries ``A = C_p^-1 - I``. The trial elastic strain comes from ``b_e - I = F A F^T + H + H^T + H H^T``,
which is exact for small strains; a plastic step that lowers the principal logarithmic strains by d_i lowers b_e by
``b_i (1 - exp(-2 d_i))`` along its axes and A by that pulled back with F^-1, so that round-off is that of the step.
"""

from __future__ import annotations

from math import expm1, log1p, sqrt

import numpy as np
from numba import njit

from .material import GRADIENT_2D, GRADIENT_3D, STRESS_2D, STRESS_3D, FloatArray, IdArray
from .spectral_decomposition import decompose

YieldConstants = tuple[float, float, float, float]  # yield stress, linear hardening, saturation, its rate

_STEPS = 100  # Newton needs five to ten; a trial far outside doubles its way back first
_LAST = 1e-11  # of the stress: the step that follows such a residual squares it, to below round-off


@njit(cache=True, nogil=True)
def _strength(strain: float, constants: YieldConstants) -> tuple[float, float]:
    """Yield strength and its slope."""
    first, linear, saturation, rate = constants
    strength, slope = first + linear * strain, linear
    if saturation > 0.0:
        reached = -expm1(-rate * strain)
        strength += saturation * reached
        slope += saturation * rate * (1.0 - reached)
    return strength, slope


@njit(cache=True, nogil=True)
def _radial_return(trial: float, three_shear: float, strain: float, constants: YieldConstants) -> float:
    """Plastic strain increment that brings the von Mises stress `trial` back.

    The residual is convex and falls, so Newton from zero climbs to the root without passing it.
    """
    increment = 0.0
    for _ in range(_STEPS):
        strength, slope = _strength(strain + increment, constants)
        residual = trial - three_shear * increment - strength
        increment += residual / (three_shear + slope)
        if abs(residual) <= _LAST * trial:
            break
    return increment


@njit(cache=True, nogil=True)
def _plane_stress_return(
    total: float,
    difference: float,
    soft_total: float,
    soft_difference: float,
    strain: float,
    constants: YieldConstants,
) -> tuple[float, float]:
    """Plastic strain over von Mises stress, and the plastic strain increment.

    Sum and difference of the in-plane principal stresses shrink as ``1/(1 + soft k)`` in the unknown k. The residual
    falls with k and flattens, so Newton climbs to the root from zero.
    """
    k, increment = 0.0, 0.0
    for _ in range(_STEPS):
        shrink_total, shrink_difference = 1.0 / (1.0 + soft_total * k), 1.0 / (1.0 + soft_difference * k)
        first = (0.5 * total * shrink_total) ** 2
        second = 0.75 * (difference * shrink_difference) ** 2
        mises = sqrt(first + second)
        increment = k * mises
        strength, slope = _strength(strain + increment, constants)
        residual = mises - strength
        fall = (first * soft_total * shrink_total + second * soft_difference * shrink_difference) / mises
        growth = (first * shrink_total + second * shrink_difference) / mises
        step = residual / (fall + slope * growth)
        k += step
        if abs(residual) <= _LAST * strength:
            break
    return k, increment + step * growth


@njit(cache=True, nogil=True)
def _retract_plane(
    history: FloatArray,
    point: int,
    gradient: tuple[float, float, float, float, float],
    loss: tuple[float, float, float],
) -> None:
    """Lower A of a point by what b_e lost in the plane (xx, yy, xy), pulled back with F^-1."""
    hxx, hxy, hyx, hyy, ratio = gradient
    xx, yy, xy = loss
    a, b, c, d = (1.0 + hyy) / ratio, -hxy / ratio, -hyx / ratio, (1.0 + hxx) / ratio
    history[point, 0] -= a * a * xx + 2.0 * a * b * xy + b * b * yy
    history[point, 1] -= c * c * xx + 2.0 * c * d * xy + d * d * yy
    history[point, 2] -= a * c * xx + (a * d + b * c) * xy + b * d * yy


@njit(cache=True, nogil=True)
def _left_strain_plane(
    rows: FloatArray, row: int, history: FloatArray, point: int
) -> tuple[float, float, float, float, float, float, float, float]:
    """H (4 numbers), det F, and mean, half difference and xy of b_e - I in the plane."""
    hxx = rows[row, GRADIENT_2D]
    hxy = rows[row, GRADIENT_2D + 1]
    hyx = rows[row, GRADIENT_2D + 2]
    hyy = rows[row, GRADIENT_2D + 3]
    axx, ayy, axy = history[point, 0], history[point, 1], history[point, 2]
    fxx, fyy = 1.0 + hxx, 1.0 + hyy
    bxx = 2.0 * hxx + hxx * hxx + hxy * hxy + fxx * fxx * axx + 2.0 * fxx * hxy * axy + hxy * hxy * ayy
    byy = 2.0 * hyy + hyx * hyx + hyy * hyy + hyx * hyx * axx + 2.0 * hyx * fyy * axy + fyy * fyy * ayy
    bxy = hxy + hyx + hxx * hyx + hxy * hyy + fxx * hyx * axx + (fxx * fyy + hxy * hyx) * axy + hxy * fyy * ayy
    return hxx, hxy, hyx, hyy, fxx * fyy - hxy * hyx, 0.5 * (bxx + byy), 0.5 * (bxx - byy), bxy


@njit(cache=True, nogil=True)
def _write_plane(rows: FloatArray, row: int, total: float, difference: float, cosine: float, sine: float) -> None:
    """Write in-plane Kirchhoff stress from the sum and difference of its principal values."""
    rows[row, STRESS_2D] = 0.5 * (total + difference * cosine)
    rows[row, STRESS_2D + 1] = 0.5 * (total - difference * cosine)
    rows[row, STRESS_2D + 2] = 0.5 * difference * sine


@njit(cache=True, nogil=True)
def _loss_plane(
    mean: float, radius: float, cosine: float, sine: float, first: float, second: float
) -> tuple[float, float, float]:
    """What b_e loses in the plane (xx, yy, xy) if its principal logarithmic strains fall by first and second."""
    upper = -(1.0 + mean + radius) * expm1(-2.0 * first)
    lower = -(1.0 + mean - radius) * expm1(-2.0 * second)
    half = 0.5 * (upper - lower)
    return 0.5 * (upper + lower) + half * cosine, 0.5 * (upper + lower) - half * cosine, half * sine


@njit(cache=True, nogil=True)
def plane_strain_stresses(
    rows: FloatArray, ids: IdArray, history: FloatArray, bulk: float, shear: float, constants: YieldConstants
) -> int:
    """Update plane strain rows and their history; returns the first row without positive volume, or -1."""
    for row in range(rows.shape[0]):
        point = ids[row]
        hxx, hxy, hyx, hyy, ratio, mean, half, bxy = _left_strain_plane(rows, row, history, point)
        radius = sqrt(half * half + bxy * bxy)
        if not (ratio > 0.0 and 1.0 + mean - radius > 0.0):
            return row
        cosine, sine = (half / radius, bxy / radius) if radius > 0.0 else (1.0, 0.0)
        total = 0.5 * log1p(2.0 * mean + (mean - radius) * (mean + radius))
        difference = 0.5 * log1p(2.0 * radius / (1.0 + mean - radius))
        across = 0.5 * log1p(history[point, 3])
        trace = total + across
        across -= trace / 3.0
        mises = shear * sqrt(9.0 * across * across + 3.0 * difference * difference)
        strength, _ = _strength(history[point, 4], constants)
        if mises > strength:
            increment = _radial_return(mises, 3.0 * shear, history[point, 4], constants)
            share = 3.0 * shear * increment / mises
            flow_across, flow_difference = share * across, share * difference
            across -= flow_across
            difference -= flow_difference
            loss = _loss_plane(
                mean,
                radius,
                cosine,
                sine,
                0.5 * (flow_difference - flow_across),
                -0.5 * (flow_across + flow_difference),
            )
            _retract_plane(history, point, (hxx, hxy, hyx, hyy, ratio), loss)
            history[point, 3] += (1.0 + history[point, 3]) * expm1(-2.0 * flow_across)
            history[point, 4] += increment
        # In-plane deviators add up to minus the one across.
        pressure = 2.0 * bulk * trace - 2.0 * shear * across
        _write_plane(rows, row, pressure, 2.0 * shear * difference, cosine, sine)
    return -1


@njit(cache=True, nogil=True)
def plane_stress_stresses(
    rows: FloatArray, ids: IdArray, history: FloatArray, young: float, poisson: float, constants: YieldConstants
) -> int:
    """Update plane stress rows and their history; returns the first row without positive volume, or -1."""
    total_modulus = young / (1.0 - poisson)  # sum of in-plane stresses over sum of strains
    difference_modulus = young / (1.0 + poisson)
    for row in range(rows.shape[0]):
        point = ids[row]
        hxx, hxy, hyx, hyy, ratio, mean, half, bxy = _left_strain_plane(rows, row, history, point)
        radius = sqrt(half * half + bxy * bxy)
        if not (ratio > 0.0 and 1.0 + mean - radius > 0.0):
            return row
        cosine, sine = (half / radius, bxy / radius) if radius > 0.0 else (1.0, 0.0)
        total = 0.5 * total_modulus * log1p(2.0 * mean + (mean - radius) * (mean + radius))
        difference = 0.5 * difference_modulus * log1p(2.0 * radius / (1.0 + mean - radius))
        strength, _ = _strength(history[point, 4], constants)
        if 0.25 * total * total + 0.75 * difference * difference > strength * strength:
            soft_total, soft_difference = 0.5 * total_modulus, 1.5 * difference_modulus
            k, increment = _plane_stress_return(
                total, difference, soft_total, soft_difference, history[point, 4], constants
            )
            total /= 1.0 + soft_total * k
            difference /= 1.0 + soft_difference * k
            # Associated flow: k (tau_1 - tau_2/2) and k (tau_2 - tau_1/2); volume is kept across the thickness.
            flow_total, flow_difference = 0.5 * k * total, 1.5 * k * difference
            loss = _loss_plane(
                mean, radius, cosine, sine, 0.5 * (flow_total + flow_difference), 0.5 * (flow_total - flow_difference)
            )
            _retract_plane(history, point, (hxx, hxy, hyx, hyy, ratio), loss)
            history[point, 3] += (1.0 + history[point, 3]) * expm1(2.0 * flow_total)
            history[point, 4] += increment
        _write_plane(rows, row, total, difference, cosine, sine)
    return -1


@njit(cache=True, nogil=True)
def space_stresses(
    rows: FloatArray, ids: IdArray, history: FloatArray, bulk: float, shear: float, constants: YieldConstants
) -> int:
    """Update rows in space and their history; returns the first row without positive volume, or -1."""
    metric = np.empty((3, 3))
    left = np.empty((3, 3))
    axes = np.empty((3, 3))
    forward = np.empty((3, 3))
    backward = np.empty((3, 3))
    strain = np.empty(3)
    loss = np.empty(3)
    for row in range(rows.shape[0]):
        point = ids[row]
        for i in range(3):
            for j in range(3):
                forward[i, j] = rows[row, GRADIENT_3D + 3 * i + j] + (1.0 if i == j else 0.0)
        ratio = _adjugate(forward, backward)
        if not ratio > 0.0:
            return row
        metric[0, 0], metric[1, 1], metric[2, 2] = history[point, 0], history[point, 1], history[point, 2]
        metric[1, 2] = metric[2, 1] = history[point, 3]
        metric[0, 2] = metric[2, 0] = history[point, 4]
        metric[0, 1] = metric[1, 0] = history[point, 5]
        for i in range(3):
            for j in range(i, 3):
                value = rows[row, GRADIENT_3D + 3 * i + j] + rows[row, GRADIENT_3D + 3 * j + i]
                for k in range(3):
                    value += rows[row, GRADIENT_3D + 3 * i + k] * rows[row, GRADIENT_3D + 3 * j + k]
                    for m in range(3):
                        value += forward[i, k] * metric[k, m] * forward[j, m]
                left[i, j] = left[j, i] = value
        decompose(left, axes)
        trace = 0.0
        for i in range(3):
            if not left[i, i] > -1.0:
                return row
            strain[i] = 0.5 * log1p(left[i, i])
            trace += strain[i]
        square = 0.0
        for i in range(3):
            strain[i] -= trace / 3.0
            square += strain[i] * strain[i]
        mises = shear * sqrt(6.0 * square)
        strength, _ = _strength(history[point, 6], constants)
        if mises > strength:
            increment = _radial_return(mises, 3.0 * shear, history[point, 6], constants)
            share = 3.0 * shear * increment / mises
            for i in range(3):
                loss[i] = -(1.0 + left[i, i]) * expm1(-2.0 * share * strain[i])
                strain[i] *= 1.0 - share
            history[point, 6] += increment
            _retract_space(history, point, backward, ratio, axes, loss)
        for i in range(3):
            strain[i] = bulk * trace + 2.0 * shear * strain[i]
        for place, (i, j) in enumerate(((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))):
            rows[row, STRESS_3D + place] = (
                axes[i, 0] * strain[0] * axes[j, 0]
                + axes[i, 1] * strain[1] * axes[j, 1]
                + axes[i, 2] * strain[2] * axes[j, 2]
            )
    return -1


@njit(cache=True, nogil=True)
def _adjugate(matrix: FloatArray, adjugate: FloatArray) -> float:
    """Fill the adjugate (inverse times determinant), return the determinant."""
    for i in range(3):
        for j in range(3):
            p, q, r, s = (j + 1) % 3, (j + 2) % 3, (i + 1) % 3, (i + 2) % 3
            adjugate[i, j] = matrix[p, r] * matrix[q, s] - matrix[p, s] * matrix[q, r]
    return matrix[0, 0] * adjugate[0, 0] + matrix[0, 1] * adjugate[1, 0] + matrix[0, 2] * adjugate[2, 0]


@njit(cache=True, nogil=True)
def _retract_space(
    history: FloatArray, point: int, backward: FloatArray, ratio: float, axes: FloatArray, loss: FloatArray
) -> None:
    """Lower A of a point by what b_e lost along its axes, pulled back with F^-1 = backward / ratio."""
    for axis in range(3):
        x = (backward[0, 0] * axes[0, axis] + backward[0, 1] * axes[1, axis] + backward[0, 2] * axes[2, axis]) / ratio
        y = (backward[1, 0] * axes[0, axis] + backward[1, 1] * axes[1, axis] + backward[1, 2] * axes[2, axis]) / ratio
        z = (backward[2, 0] * axes[0, axis] + backward[2, 1] * axes[1, axis] + backward[2, 2] * axes[2, axis]) / ratio
        history[point, 0] -= loss[axis] * x * x
        history[point, 1] -= loss[axis] * y * y
        history[point, 2] -= loss[axis] * z * z
        history[point, 3] -= loss[axis] * y * z
        history[point, 4] -= loss[axis] * x * z
        history[point, 5] -= loss[axis] * x * y
