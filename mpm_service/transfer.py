"""Passes between points and nodes: the three sweeps of a MUSL step.

Nodal tables have one row per grid node, followed by one row per second velocity field at a crack:

- ``momentum`` (rows, 5): mass, momentum x y, force x y,
- ``motion`` (rows, 4): new velocity x y, velocity increment x y,
- ``remapped`` (rows, 2): momentum, then velocity, mapped again from the updated points.

All three sweeps of a step use the shape functions at the positions of its start; the points move in the last.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from .crack import CrackFields, field_row
from .grid import Mesh
from .material_points import DX, DY, HXX, HXY, HYX, HYY, MASS, VX, VY, X, Y
from .materials import Law
from .shape_functions import Triple, gimp_1d

_OPTIONS = {"cache": True, "nogil": True, "fastmath": {"contract", "reassoc", "nsz"}}


@njit(inline="always")
def _weights(mesh: Mesh, x: float, y: float) -> tuple[int, int, Triple, Triple, Triple, Triple]:
    cx, sx, gx = gimp_1d((x - mesh.origin_x) * mesh.inverse_cell, mesh.half_size, mesh.inverse_2l, mesh.inverse_4l)
    cy, sy, gy = gimp_1d((y - mesh.origin_y) * mesh.inverse_cell, mesh.half_size, mesh.inverse_2l, mesh.inverse_4l)
    return cx, cy, sx, sy, gx, gy


@njit(inline="always")
def stress_and_volume(
    law: Law, hxx: float, hxy: float, hyx: float, hyy: float, mass: float
) -> tuple[float, float, float, float]:
    """Stress xx, yy, xy [Pa] (Eqs 25-28) and weighted current volume [m^3] (Eq 29) of a point.

    In plane stress the thickness follows the Poisson strain, so the volume does too.
    """
    exy = 0.5 * (hxy + hyx)
    trace = hxx + hyy
    jacobian = ((1.0 + hxx) * (1.0 + hyy) - hxy * hyx) * (1.0 - law.contraction * trace)
    return (
        law.c11 * hxx + law.c12 * hyy,
        law.c12 * hxx + law.c11 * hyy,
        law.c33 * exy,
        mass * law.inverse_density * jacobian,
    )


@njit(**_OPTIONS)
def scatter_momentum(
    rows: NDArray[np.float64],
    count: int,
    ids: NDArray[np.int64],
    mesh: Mesh,
    law: Law,
    crack: CrackFields,
    momentum: NDArray[np.float64],
) -> None:
    """Nodal mass, momentum and internal force (Eqs 11-14 with uGIMP functions)."""
    near = crack.near
    block = crack.block
    node_local = crack.node_local
    point_local = crack.point_local
    base = crack.base
    length = crack.length
    tolerance = crack.tolerance
    for p in range(count):
        cx, cy, sx, sy, gx, gy = _weights(mesh, rows[p, X], rows[p, Y])
        mass = rows[p, MASS]
        txx, tyy, txy, volume = stress_and_volume(law, rows[p, HXX], rows[p, HXY], rows[p, HYX], rows[p, HYY], mass)
        scale = -volume * mesh.inverse_cell
        fxx = scale * txx
        fyy = scale * tyy
        fxy = scale * txy
        px = mass * rows[p, VX]
        py = mass * rows[p, VY]
        corner = (cy - 1) * mesh.stride + cx - 1
        if crack.on and block[corner + mesh.stride + 1]:
            s = point_local[ids[p], 0]
            d = point_local[ids[p], 1]
            for j in range(3):
                for i in range(3):
                    n = field_row(near, node_local, base, length, tolerance, corner + j * mesh.stride + i, s, d)
                    w = sx[i] * sy[j]
                    wx = gx[i] * sy[j]
                    wy = sx[i] * gy[j]
                    momentum[n, 0] += w * mass
                    momentum[n, 1] += w * px
                    momentum[n, 2] += w * py
                    momentum[n, 3] += wx * fxx + wy * fxy
                    momentum[n, 4] += wx * fxy + wy * fyy
            continue
        for j in range(3):
            n = corner + j * mesh.stride
            my = sy[j] * mass
            pxy = sy[j] * px
            pyy = sy[j] * py
            ax = sy[j] * fxx
            ay = sy[j] * fxy
            bx = gy[j] * fxy
            by = gy[j] * fyy
            for i in range(3):
                momentum[n + i, 0] += sx[i] * my
                momentum[n + i, 1] += sx[i] * pxy
                momentum[n + i, 2] += sx[i] * pyy
                momentum[n + i, 3] += gx[i] * ax + sx[i] * bx
                momentum[n + i, 4] += gx[i] * ay + sx[i] * by


@njit(**_OPTIONS)
def scatter_point_forces(
    rows: NDArray[np.float64],
    ids: NDArray[np.int64],
    selected: NDArray[np.int64],
    force: NDArray[np.float64],
    mesh: Mesh,
    crack: CrackFields,
    momentum: NDArray[np.float64],
) -> None:
    """Spread forces on the points in rows ``selected`` [N] onto the nodes."""
    near = crack.near
    block = crack.block
    node_local = crack.node_local
    point_local = crack.point_local
    base = crack.base
    length = crack.length
    tolerance = crack.tolerance
    for k in range(selected.size):
        p = selected[k]
        cx, cy, sx, sy, _, _ = _weights(mesh, rows[p, X], rows[p, Y])
        corner = (cy - 1) * mesh.stride + cx - 1
        split = crack.on and block[corner + mesh.stride + 1]
        for j in range(3):
            for i in range(3):
                n = corner + j * mesh.stride + i
                if split:
                    n = field_row(
                        near,
                        node_local,
                        base,
                        length,
                        tolerance,
                        n,
                        point_local[ids[p], 0],
                        point_local[ids[p], 1],
                    )
                w = sx[i] * sy[j]
                momentum[n, 3] += w * force[k, 0]
                momentum[n, 4] += w * force[k, 1]


@njit(**_OPTIONS)
def update_points(
    rows: NDArray[np.float64],
    count: int,
    ids: NDArray[np.int64],
    mesh: Mesh,
    crack: CrackFields,
    motion: NDArray[np.float64],
    remapped: NDArray[np.float64],
    time_step: float,
) -> tuple[int, float]:
    """FLIP velocity (Eq 19), position increment (Eq 20) and re-mapped momentum (Eq 21).

    Returns the row of the first point that runs away (more than a cell in a step, or not finite), or -1, and
    the largest position increment [m].
    """
    near = crack.near
    block = crack.block
    node_local = crack.node_local
    point_local = crack.point_local
    base = crack.base
    length = crack.length
    tolerance = crack.tolerance
    largest = 0.0
    for p in range(count):
        cx, cy, sx, sy, _, _ = _weights(mesh, rows[p, X], rows[p, Y])
        corner = (cy - 1) * mesh.stride + cx - 1
        split = crack.on and block[corner + mesh.stride + 1]
        vx = 0.0
        vy = 0.0
        ax = 0.0
        ay = 0.0
        if split:
            s = point_local[ids[p], 0]
            d = point_local[ids[p], 1]
            for j in range(3):
                for i in range(3):
                    n = field_row(near, node_local, base, length, tolerance, corner + j * mesh.stride + i, s, d)
                    w = sx[i] * sy[j]
                    vx += w * motion[n, 0]
                    vy += w * motion[n, 1]
                    ax += w * motion[n, 2]
                    ay += w * motion[n, 3]
        else:
            for j in range(3):
                n = corner + j * mesh.stride
                vx += sy[j] * (sx[0] * motion[n, 0] + sx[1] * motion[n + 1, 0] + sx[2] * motion[n + 2, 0])
                vy += sy[j] * (sx[0] * motion[n, 1] + sx[1] * motion[n + 1, 1] + sx[2] * motion[n + 2, 1])
                ax += sy[j] * (sx[0] * motion[n, 2] + sx[1] * motion[n + 1, 2] + sx[2] * motion[n + 2, 2])
                ay += sy[j] * (sx[0] * motion[n, 3] + sx[1] * motion[n + 1, 3] + sx[2] * motion[n + 2, 3])
        dx = time_step * vx
        dy = time_step * vy
        size = max(abs(dx), abs(dy))
        if not (abs(dx) < mesh.cell_size and abs(dy) < mesh.cell_size):
            return p, size
        largest = max(largest, size)
        vx = rows[p, VX] + ax
        vy = rows[p, VY] + ay
        rows[p, VX] = vx
        rows[p, VY] = vy
        rows[p, DX] = dx
        rows[p, DY] = dy
        mass = rows[p, MASS]
        px = mass * vx
        py = mass * vy
        if split:
            s = point_local[ids[p], 0]
            d = point_local[ids[p], 1]
            for j in range(3):
                for i in range(3):
                    n = field_row(near, node_local, base, length, tolerance, corner + j * mesh.stride + i, s, d)
                    w = sx[i] * sy[j]
                    remapped[n, 0] += w * px
                    remapped[n, 1] += w * py
        else:
            for j in range(3):
                n = corner + j * mesh.stride
                pxy = sy[j] * px
                pyy = sy[j] * py
                for i in range(3):
                    remapped[n + i, 0] += sx[i] * pxy
                    remapped[n + i, 1] += sx[i] * pyy
    return -1, largest


@njit(**_OPTIONS)
def deform_points(
    rows: NDArray[np.float64],
    count: int,
    ids: NDArray[np.int64],
    mesh: Mesh,
    crack: CrackFields,
    remapped: NDArray[np.float64],
    time_step: float,
) -> int:
    """Deformation gradient from re-mapped velocities (Eqs 22-24), then the move; returns points that left."""
    near = crack.near
    block = crack.block
    node_local = crack.node_local
    point_local = crack.point_local
    base = crack.base
    length = crack.length
    tolerance = crack.tolerance
    scale = time_step * mesh.inverse_cell
    high_x = mesh.cells_x - 0.5
    high_y = mesh.cells_y - 0.5
    left = 0
    for p in range(count):
        cx, cy, sx, sy, gx, gy = _weights(mesh, rows[p, X], rows[p, Y])
        corner = (cy - 1) * mesh.stride + cx - 1
        lxx = 0.0
        lxy = 0.0
        lyx = 0.0
        lyy = 0.0
        if crack.on and block[corner + mesh.stride + 1]:
            s = point_local[ids[p], 0]
            d = point_local[ids[p], 1]
            for j in range(3):
                for i in range(3):
                    n = field_row(near, node_local, base, length, tolerance, corner + j * mesh.stride + i, s, d)
                    wx = gx[i] * sy[j]
                    wy = sx[i] * gy[j]
                    lxx += wx * remapped[n, 0]
                    lxy += wy * remapped[n, 0]
                    lyx += wx * remapped[n, 1]
                    lyy += wy * remapped[n, 1]
        else:
            for j in range(3):
                n = corner + j * mesh.stride
                ux = remapped[n, 0]
                vx = remapped[n + 1, 0]
                wx = remapped[n + 2, 0]
                uy = remapped[n, 1]
                vy = remapped[n + 1, 1]
                wy = remapped[n + 2, 1]
                lxx += sy[j] * (gx[0] * ux + gx[1] * vx + gx[2] * wx)
                lyx += sy[j] * (gx[0] * uy + gx[1] * vy + gx[2] * wy)
                lxy += gy[j] * (sx[0] * ux + sx[1] * vx + sx[2] * wx)
                lyy += gy[j] * (sx[0] * uy + sx[1] * vy + sx[2] * wy)
        lxx *= scale
        lxy *= scale
        lyx *= scale
        lyy *= scale
        hxx = rows[p, HXX]
        hxy = rows[p, HXY]
        hyx = rows[p, HYX]
        hyy = rows[p, HYY]
        rows[p, HXX] = hxx + (lxx + lxx * hxx + lxy * hyx)
        rows[p, HXY] = hxy + (lxy + lxx * hxy + lxy * hyy)
        rows[p, HYX] = hyx + (lyx + lyx * hxx + lyy * hyx)
        rows[p, HYY] = hyy + (lyy + lyx * hxy + lyy * hyy)
        rows[p, X] += rows[p, DX]
        rows[p, Y] += rows[p, DY]
        xi = (rows[p, X] - mesh.origin_x) * mesh.inverse_cell
        eta = (rows[p, Y] - mesh.origin_y) * mesh.inverse_cell
        if not (0.5 <= xi < high_x and 0.5 <= eta < high_y):
            left += 1
    return left


@njit(**_OPTIONS)
def point_energies(rows: NDArray[np.float64], count: int, law: Law) -> tuple[float, float]:
    """Kinetic energy and strain energy ``w V0 stress : strain / 2`` of the points [J]."""
    kinetic = 0.0
    strain = 0.0
    for p in range(count):
        mass = rows[p, MASS]
        kinetic += 0.5 * mass * (rows[p, VX] * rows[p, VX] + rows[p, VY] * rows[p, VY])
        txx, tyy, txy, _ = stress_and_volume(law, rows[p, HXX], rows[p, HXY], rows[p, HYX], rows[p, HYY], mass)
        exy = 0.5 * (rows[p, HXY] + rows[p, HYX])
        strain += 0.5 * mass * law.inverse_density * (txx * rows[p, HXX] + tyy * rows[p, HYY] + 2.0 * txy * exy)
    return kinetic, strain
