"""Passes between points and nodes on a uniform lattice, compiled for each kind of shape function.

A sweep goes over ranges of rows of the point table. Nodal tables have one row per node:

- ``momentum`` (rows, 5): mass, momentum x y, force x y,
- ``motion`` (rows, 4): the velocity that moves the points, then what is added to or becomes their velocity,
- any other velocity table (rows, 2).

Rows are addressed by unsigned numbers: signed ones cost a test for "counted from the end" at each access, a
tenth of the time. All sweeps of a step use the shape functions at the positions of its start; the points move in
the last.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from .material_points import DX, DY, HXX, HXY, HYX, HYY, MASS, SXX, SXY, SYY, VOLUME, VX, VY, X, Y
from .shapes import Shape, row_stretches, shape_1d

FloatArray = NDArray[np.float64]
Ranges = NDArray[np.int64]

_OPTIONS = {"cache": True, "nogil": True, "fastmath": {"contract", "reassoc", "nsz"}}


class Lattice(NamedTuple):
    """One uniform level of the grid in kernel form."""

    origin_x: float
    origin_y: float
    inverse_cell: float
    stride: int
    offset: int
    """Row of the lattice's first node."""
    shape: Shape


@njit(inline="always")
def _place(lattice: Any, rows: FloatArray, p: int) -> tuple[int, Any, Any, Any, Any]:
    """Row of the first node a point touches, weights in x and y, slopes in x and y."""
    xi = (rows[p, X] - lattice.origin_x) * lattice.inverse_cell
    eta = (rows[p, Y] - lattice.origin_y) * lattice.inverse_cell
    stretch_x, stretch_y = row_stretches(lattice.shape, rows[p, HXX], rows[p, HXY], rows[p, HYX], rows[p, HYY])
    i, sx, gx = shape_1d(lattice.shape, xi, stretch_x)
    j, sy, gy = shape_1d(lattice.shape, eta, stretch_y)
    return lattice.offset + j * lattice.stride + i, sx, sy, gx, gy


@njit(**_OPTIONS)
def scatter_state(rows: FloatArray, ranges: Ranges, lattice: Lattice, momentum: FloatArray) -> None:
    """Nodal mass, momentum and internal force (Eqs 11-14)."""
    stride = lattice.stride
    for r in range(ranges.shape[0]):
        for row in range(ranges[r, 0], ranges[r, 1]):
            p = np.uintp(row)
            corner, sx, sy, gx, gy = _place(lattice, rows, p)
            mass = rows[p, MASS]
            px = mass * rows[p, VX]
            py = mass * rows[p, VY]
            scale = -rows[p, VOLUME] * lattice.inverse_cell
            txx = scale * rows[p, SXX]
            tyy = scale * rows[p, SYY]
            txy = scale * rows[p, SXY]
            for j in range(len(sy)):
                n = corner + j * stride
                my = sy[j] * mass
                qx = sy[j] * px
                qy = sy[j] * py
                ax = sy[j] * txx
                ay = sy[j] * txy
                bx = gy[j] * txy
                by = gy[j] * tyy
                for i in range(len(sx)):
                    m = np.uintp(n + i)
                    momentum[m, 0] += sx[i] * my
                    momentum[m, 1] += sx[i] * qx
                    momentum[m, 2] += sx[i] * qy
                    momentum[m, 3] += gx[i] * ax + sx[i] * bx
                    momentum[m, 4] += gx[i] * ay + sx[i] * by


@njit(**_OPTIONS)
def scatter_filtered(rows: FloatArray, ranges: Ranges, lattice: Lattice, field: FloatArray, out: FloatArray) -> None:
    """Momentum that a velocity field has after a way to the points and back: out += S^T m S field."""
    stride = lattice.stride
    for r in range(ranges.shape[0]):
        for row in range(ranges[r, 0], ranges[r, 1]):
            p = np.uintp(row)
            corner, sx, sy, _, _ = _place(lattice, rows, p)
            ux = 0.0
            uy = 0.0
            for j in range(len(sy)):
                n = corner + j * stride
                for i in range(len(sx)):
                    m = np.uintp(n + i)
                    w = sx[i] * sy[j]
                    ux += w * field[m, 0]
                    uy += w * field[m, 1]
            ux *= rows[p, MASS]
            uy *= rows[p, MASS]
            for j in range(len(sy)):
                n = corner + j * stride
                qx = sy[j] * ux
                qy = sy[j] * uy
                for i in range(len(sx)):
                    m = np.uintp(n + i)
                    out[m, 0] += sx[i] * qx
                    out[m, 1] += sx[i] * qy


@njit(inline="always")
def _update(
    rows: FloatArray, p: int, corner: int, stride: int, sx: Any, sy: Any, motion: FloatArray, keep: float, dt: float
) -> float:
    """New velocity and position increment of one point; returns the increment's larger component, infinity for NaN."""
    vx = 0.0
    vy = 0.0
    ax = 0.0
    ay = 0.0
    for j in range(len(sy)):
        n = corner + j * stride
        for i in range(len(sx)):
            m = np.uintp(n + i)
            w = sx[i] * sy[j]
            vx += w * motion[m, 0]
            vy += w * motion[m, 1]
            ax += w * motion[m, 2]
            ay += w * motion[m, 3]
    rows[p, VX] = keep * rows[p, VX] + ax
    rows[p, VY] = keep * rows[p, VY] + ay
    dx = dt * vx
    dy = dt * vy
    rows[p, DX] = dx
    rows[p, DY] = dy
    return max(abs(dx), abs(dy)) if dx == dx and dy == dy else np.inf


@njit(inline="always")
def _deform(
    rows: FloatArray, p: int, corner: int, stride: int, sx: Any, sy: Any, gx: Any, gy: Any, v: FloatArray, scale: float
) -> None:
    """Deformation gradient of one point (Eqs 22-24): H += (I + H) applied to the velocity gradient from the left."""
    lxx = 0.0
    lxy = 0.0
    lyx = 0.0
    lyy = 0.0
    for j in range(len(sy)):
        n = corner + j * stride
        for i in range(len(sx)):
            m = np.uintp(n + i)
            wx = gx[i] * sy[j]
            wy = sx[i] * gy[j]
            lxx += wx * v[m, 0]
            lxy += wy * v[m, 0]
            lyx += wx * v[m, 1]
            lyy += wy * v[m, 1]
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


@njit(**_OPTIONS)
def update_points(
    rows: FloatArray, ranges: Ranges, lattice: Lattice, motion: FloatArray, keep: float, time_step: float
) -> float:
    """Velocity ``v <- keep v + S a`` and increment ``dt S v_n`` (Eqs 19-20).

    ``motion`` holds v_n and a. Returns the largest increment [m], infinity where one is NaN.
    """
    largest = 0.0
    for r in range(ranges.shape[0]):
        for row in range(ranges[r, 0], ranges[r, 1]):
            p = np.uintp(row)
            corner, sx, sy, _, _ = _place(lattice, rows, p)
            size = _update(rows, p, corner, lattice.stride, sx, sy, motion, keep, time_step)
            largest = max(largest, size)
    return largest


@njit(**_OPTIONS)
def update_remap_points(
    rows: FloatArray,
    ranges: Ranges,
    lattice: Lattice,
    motion: FloatArray,
    keep: float,
    time_step: float,
    remapped: FloatArray,
) -> float:
    """`update_points`, and the new momenta mapped to the nodes again (Eq 21)."""
    largest = 0.0
    stride = lattice.stride
    for r in range(ranges.shape[0]):
        for row in range(ranges[r, 0], ranges[r, 1]):
            p = np.uintp(row)
            corner, sx, sy, _, _ = _place(lattice, rows, p)
            size = _update(rows, p, corner, stride, sx, sy, motion, keep, time_step)
            largest = max(largest, size)
            px = rows[p, MASS] * rows[p, VX]
            py = rows[p, MASS] * rows[p, VY]
            for j in range(len(sy)):
                n = corner + j * stride
                qx = sy[j] * px
                qy = sy[j] * py
                for i in range(len(sx)):
                    m = np.uintp(n + i)
                    remapped[m, 0] += sx[i] * qx
                    remapped[m, 1] += sx[i] * qy
    return largest


@njit(**_OPTIONS)
def update_deform_points(
    rows: FloatArray, ranges: Ranges, lattice: Lattice, motion: FloatArray, keep: float, time_step: float
) -> float:
    """`update_points`, and the deformation gradient by the same nodal velocities, then the move."""
    largest = 0.0
    scale = time_step * lattice.inverse_cell
    for r in range(ranges.shape[0]):
        for row in range(ranges[r, 0], ranges[r, 1]):
            p = np.uintp(row)
            corner, sx, sy, gx, gy = _place(lattice, rows, p)
            size = _update(rows, p, corner, lattice.stride, sx, sy, motion, keep, time_step)
            largest = max(largest, size)
            _deform(rows, p, corner, lattice.stride, sx, sy, gx, gy, motion, scale)
            rows[p, X] += rows[p, DX]
            rows[p, Y] += rows[p, DY]
    return largest


@njit(**_OPTIONS)
def deform_points(
    rows: FloatArray, ranges: Ranges, lattice: Lattice, velocity: FloatArray, time_step: float, move: float
) -> None:
    """Deformation gradient from nodal velocities (Eqs 22-24), then positions plus ``move`` increments."""
    scale = time_step * lattice.inverse_cell
    for r in range(ranges.shape[0]):
        for row in range(ranges[r, 0], ranges[r, 1]):
            p = np.uintp(row)
            corner, sx, sy, gx, gy = _place(lattice, rows, p)
            _deform(rows, p, corner, lattice.stride, sx, sy, gx, gy, velocity, scale)
            rows[p, X] += move * rows[p, DX]
            rows[p, Y] += move * rows[p, DY]


@njit(**_OPTIONS)
def scatter_point_forces(
    rows: FloatArray, selected: Ranges, force: FloatArray, lattice: Lattice, momentum: FloatArray
) -> None:
    """Put forces (k, 2) [N] on the points of the rows `selected` (k,) onto the nodes."""
    for k in range(selected.size):
        corner, sx, sy, _, _ = _place(lattice, rows, selected[k])
        for j in range(len(sy)):
            n = corner + j * lattice.stride
            for i in range(len(sx)):
                momentum[n + i, 3] += sx[i] * sy[j] * force[k, 0]
                momentum[n + i, 4] += sx[i] * sy[j] * force[k, 1]


@njit(**_OPTIONS)
def read_points(rows: FloatArray, selected: Ranges, lattice: Lattice, velocity: FloatArray, out: FloatArray) -> None:
    """Nodal velocities at the points of the rows `selected` (k,), into `out` (k, 2)."""
    for k in range(selected.size):
        corner, sx, sy, _, _ = _place(lattice, rows, selected[k])
        out[k, 0] = 0.0
        out[k, 1] = 0.0
        for j in range(len(sy)):
            n = corner + j * lattice.stride
            for i in range(len(sx)):
                out[k, 0] += sx[i] * sy[j] * velocity[n + i, 0]
                out[k, 1] += sx[i] * sy[j] * velocity[n + i, 1]
