"""Hardy's localisation function c (1 - r^2/R^2)^2, and its integral along a bond, spread over a grid."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


def normalisation(radius: float, thickness: float | None) -> float:
    """The factor c that makes the integral one: over a sphere, or over a disc times a thickness, 1/m^3."""
    if thickness is None:
        return 105.0 / (32.0 * np.pi * radius**3)
    return 3.0 / (np.pi * radius**2 * thickness)


@njit(nogil=True, cache=True)
def _cells_near(near: float, far: float, low: float, spacing: float, count: int, radius: float) -> tuple[int, int]:
    """First and behind the last cell along an axis whose centre lies within a radius of the stretch near to far."""
    first = int(np.ceil((near - radius - low) / spacing - 0.5))
    last = int(np.floor((far + radius - low) / spacing - 0.5))
    return max(first, 0), min(last + 1, count)


@njit(nogil=True, cache=True)
def spread_atoms(
    row: NDArray[np.int64],
    image: NDArray[np.float64],
    values: NDArray[np.float64],
    low: NDArray[np.float64],
    spacing: NDArray[np.float64],
    flat: bool,
    radius: float,
    scale: float,
    total: NDArray[np.float64],
) -> None:
    """Add values times the localisation function to the cells around each image."""
    nx, ny, nz, channels = total.shape
    for i in range(len(row)):
        px, py, pz = image[i]
        x0, x1 = _cells_near(px, px, low[0], spacing[0], nx, radius)
        y0, y1 = _cells_near(py, py, low[1], spacing[1], ny, radius)
        z0, z1 = (0, 1) if flat else _cells_near(pz, pz, low[2], spacing[2], nz, radius)
        for cx in range(x0, x1):
            dx = low[0] + (cx + 0.5) * spacing[0] - px
            for cy in range(y0, y1):
                dy = low[1] + (cy + 0.5) * spacing[1] - py
                for cz in range(z0, z1):
                    dz = 0.0 if flat else low[2] + (cz + 0.5) * spacing[2] - pz
                    q = (dx * dx + dy * dy + dz * dz) / radius**2
                    if q < 1.0:
                        weight = scale * (1.0 - q) ** 2
                        for k in range(channels):
                            total[cx, cy, cz, k] += weight * values[row[i], k]


@njit(nogil=True, cache=True)
def spread_bonds(
    start: NDArray[np.float64],
    separation: NDArray[np.float64],
    force: NDArray[np.float64],
    low: NDArray[np.float64],
    spacing: NDArray[np.float64],
    flat: bool,
    radius: float,
    scale: float,
    first_channel: int,
    total: NDArray[np.float64],
) -> None:
    """Add the virial of each bond, six channels, times its bond function to the cells around it.

    Along a bond the localisation function is a polynomial of degree four between the points where the bond enters
    and leaves the sphere around a cell's centre, so three Gauss points integrate it exactly.
    """
    nx, ny, nz, _ = total.shape
    gauss, weight = np.sqrt(0.6), (5.0 / 18.0, 8.0 / 18.0, 5.0 / 18.0)
    w = np.empty(6)
    for b in range(len(start)):
        px, py, pz = start[b]
        sx, sy, sz = -separation[b, 0], -separation[b, 1], -separation[b, 2]
        fx, fy, fz = force[b]
        w[0], w[1], w[2] = sx * fx, sy * fy, sz * fz
        w[3], w[4], w[5] = 0.5 * (sx * fy + sy * fx), 0.5 * (sx * fz + sz * fx), 0.5 * (sy * fz + sz * fy)
        x0, x1 = _cells_near(min(px, px + sx), max(px, px + sx), low[0], spacing[0], nx, radius)
        y0, y1 = _cells_near(min(py, py + sy), max(py, py + sy), low[1], spacing[1], ny, radius)
        z0, z1 = 0, 1
        if flat:
            pz, sz = 0.0, 0.0
        else:
            z0, z1 = _cells_near(min(pz, pz + sz), max(pz, pz + sz), low[2], spacing[2], nz, radius)
        square = (sx * sx + sy * sy + sz * sz) / radius**2
        for cx in range(x0, x1):
            dx = (px - low[0] - (cx + 0.5) * spacing[0]) / radius
            for cy in range(y0, y1):
                dy = (py - low[1] - (cy + 0.5) * spacing[1]) / radius
                for cz in range(z0, z1):
                    dz = 0.0 if flat else (pz - low[2] - (cz + 0.5) * spacing[2]) / radius
                    # q(s) = here + 2 along s + square s^2 is the squared distance over the bond.
                    here = dx * dx + dy * dy + dz * dz
                    along = (dx * sx + dy * sy + dz * sz) / radius
                    enter, leave = 0.0, 1.0
                    if square > 0.0:
                        root = along * along - square * (here - 1.0)
                        if root <= 0.0:
                            continue
                        root = np.sqrt(root)
                        enter = max((-along - root) / square, 0.0)
                        leave = min((-along + root) / square, 1.0)
                    elif here >= 1.0:
                        continue
                    if leave <= enter:
                        continue
                    share = 0.0
                    for g in range(3):
                        s = 0.5 * (enter + leave) + 0.5 * (leave - enter) * gauss * (g - 1)
                        share += weight[g] * (1.0 - (here + 2.0 * along * s + square * s * s)) ** 2
                    share *= scale * (leave - enter)
                    for k in range(6):
                        total[cx, cy, cz, first_channel + k] += share * w[k]
