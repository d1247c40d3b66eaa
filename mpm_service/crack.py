"""One straight crack with two velocity fields at the nodes around it (CRAMP).

A node next to the crack has field 0 for the material on its own side and a second one for material whose
connecting line to the node crosses the crack (Eqs 38-39). With one crack a node sees only one far side, so
fields 1 and 2 of Eq 38 share one row of the nodal tables, placed after the rows of the grid.

The crossing is decided in the crack's reference frame ``(s, d)``: along the line from its first point, and
across it. A point keeps the side it was born on. A node is brought into that frame by the mean
displacement of the two faces, which markers along the crack carry; so the crack moves with the body.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from .grid import Mesh

# Nodes up to this many cells from the crack may need a second field: a point's reach, diagonal, plus slack.
_REACH = 2.7
# A crack end that falls on a node counts as just short of it, so that the tip node stays whole [cells].
_TIP_TOLERANCE = 1e-6
# Markers have moved this far [cells] since the near nodes were found: find them again.
_REFRESH = 0.4


@dataclass(frozen=True)
class Crack:
    """A straight crack.

    The faces are free of traction. Where they touch (the opening carried by the markers is not positive and
    the faces approach) their normal velocity is made common, without friction. A node exactly on the line
    counts as above it (left of the direction of travel), which stands for a nudge of the line by less than
    any displacement. Rotations of the crack plane must stay small.

    Parameters
    ----------
    points : ((x0, y0), (x1, y1))
        Ends [m]. Either may lie outside the body; an end inside is a crack tip.
    """

    points: Sequence[Sequence[float]]

    def __post_init__(self) -> None:
        ends = np.asarray(self.points, dtype=np.float64)
        if ends.shape != (2, 2) or not np.all(np.isfinite(ends)):
            raise ValueError(f"Crack.points = {self.points!r}: two points of two finite numbers are needed")
        if not np.hypot(*(ends[1] - ends[0])) > 0.0:
            raise ValueError("Crack.points: the two ends coincide")

    @property
    def length(self) -> float:
        """Length [m]."""
        return float(np.hypot(*(np.asarray(self.points[1], float) - np.asarray(self.points[0], float))))

    def local(self, position: NDArray[np.float64]) -> NDArray[np.float64]:
        """Coordinates (s, d) along and across the line [m], (n, 2)."""
        start = np.asarray(self.points[0], dtype=np.float64)
        tx, ty = (np.asarray(self.points[1], dtype=np.float64) - start) / self.length
        along = (position[:, 0] - start[0]) * tx + (position[:, 1] - start[1]) * ty
        across = -(position[:, 0] - start[0]) * ty + (position[:, 1] - start[1]) * tx
        return np.ascontiguousarray(np.stack([along, across], axis=1))


class CrackFields(NamedTuple):
    """Crack data in kernel form."""

    on: bool
    start_x: float
    start_y: float
    tangent_x: float
    tangent_y: float
    length: float
    tolerance: float
    base: int
    """First row of second fields in the nodal tables (= number of grid nodes)."""
    near: NDArray[np.int64]
    """(nodes,) position among the near nodes, or -1."""
    block: NDArray[np.uint8]
    """(nodes,) 1 where the 3 x 3 block around the node holds a near node."""
    near_node: NDArray[np.int64]
    """(capacity,) grid node of each near node."""
    near_count: NDArray[np.int64]
    """(1,) number of near nodes."""
    node_local: NDArray[np.float64]
    """(capacity, 2) reference coordinates (s, d) of near nodes."""
    point_local: NDArray[np.float64]
    """(points, 2) reference coordinates (s, d) by point id."""
    marker: NDArray[np.float64]
    """(markers, 4) displacement of the upper and the lower face [m]."""
    marker_found: NDArray[np.float64]
    """(markers, 2) mean displacement when the near nodes were last found [m]."""


def crack_fields(crack: Crack | None, mesh: Mesh, position: NDArray[np.float64]) -> CrackFields:
    """Kernel form of a crack (or of none) for points at the given reference positions."""
    nodes = (mesh.cells_x + 1) * (mesh.cells_y + 1)
    if crack is None:
        return CrackFields(
            False,
            0.0,
            0.0,
            1.0,
            0.0,
            0.0,
            0.0,
            nodes,
            np.zeros(0, np.int64),
            np.zeros(0, np.uint8),
            np.zeros(0, np.int64),
            np.zeros(1, np.int64),
            np.zeros((0, 2)),
            np.zeros((0, 2)),
            np.zeros((0, 4)),
            np.zeros((0, 2)),
        )
    start = np.asarray(crack.points[0], dtype=np.float64)
    tangent = (np.asarray(crack.points[1], dtype=np.float64) - start) / crack.length
    markers = int(np.ceil(2.0 * crack.length * mesh.inverse_cell)) + 1
    reach = 2 * int(np.ceil(_REACH)) + 1
    capacity = min(nodes, int((crack.length * mesh.inverse_cell + reach) * 2 * reach) + reach * reach)
    fields = CrackFields(
        True,
        float(start[0]),
        float(start[1]),
        float(tangent[0]),
        float(tangent[1]),
        crack.length,
        _TIP_TOLERANCE * mesh.cell_size,
        nodes,
        np.full(nodes, -1, np.int64),
        np.zeros(nodes, np.uint8),
        np.zeros(capacity, np.int64),
        np.zeros(1, np.int64),
        np.zeros((capacity, 2)),
        crack.local(position),
        np.zeros((markers, 4)),
        np.zeros((markers, 2)),
    )
    find_near_nodes(fields, mesh)
    place_nodes(fields, mesh)
    return fields


@njit(inline="always")
def crosses(s_p: float, d_p: float, s_i: float, d_i: float, length: float, tolerance: float) -> bool:
    """Does the line from a point to a node cross the crack (Eq 38)?"""
    if (d_p >= 0.0) == (d_i >= 0.0):
        return False
    here = abs(d_p)
    s = s_p + (s_i - s_p) * here / (here + abs(d_i))
    return tolerance < s < length - tolerance


@njit(inline="always")
def field_row(
    near: NDArray[np.int64],
    node_local: NDArray[np.float64],
    base: int,
    length: float,
    tolerance: float,
    node: int,
    s_p: float,
    d_p: float,
) -> int:
    """Row of the nodal tables that material at reference place (s, d) uses at a grid node.

    The first five arguments are those of ``CrackFields``, taken out of it before the loop: reading them from
    the tuple inside a loop costs a reference count each time.
    """
    k = near[node]
    if k >= 0 and crosses(s_p, d_p, node_local[k, 0], node_local[k, 1], length, tolerance):
        return base + k
    return node


@njit(inline="always")
def _marker_value(marker: NDArray[np.float64], length: float, s: float) -> tuple[float, float, float, float]:
    """Face displacements of the crack at ``s``, linear between markers, held beyond the ends."""
    last = marker.shape[0] - 1
    t = min(max(s / length, 0.0), 1.0) * last
    m = min(int(t), last - 1)
    w = t - m
    v = 1.0 - w
    return (
        v * marker[m, 0] + w * marker[m + 1, 0],
        v * marker[m, 1] + w * marker[m + 1, 1],
        v * marker[m, 2] + w * marker[m + 1, 2],
        v * marker[m, 3] + w * marker[m + 1, 3],
    )


@njit(cache=True, nogil=True)
def find_near_nodes(crack: CrackFields, mesh: Mesh) -> None:
    """List the grid nodes that may need a second field, around the crack at ``marker_found``."""
    near = crack.near
    near_node = crack.near_node
    block = crack.block
    marker_found = crack.marker_found
    for k in range(crack.near_count[0]):
        node = near_node[k]
        near[node] = -1
        for j in range(-1, 2):
            for i in range(-1, 2):
                other = node + j * mesh.stride + i
                if 0 <= other < block.size:
                    block[other] = 0
    count = 0
    last = crack.marker.shape[0] - 1
    reach = int(_REACH) + 1
    for m in range(last + 1):
        ux = marker_found[m, 0]
        uy = marker_found[m, 1]
        s = crack.length * m / last
        xi = (crack.start_x + s * crack.tangent_x + ux - mesh.origin_x) * mesh.inverse_cell
        eta = (crack.start_y + s * crack.tangent_y + uy - mesh.origin_y) * mesh.inverse_cell
        for jy in range(int(np.floor(eta)) - reach, int(np.floor(eta)) + reach + 2):
            for ix in range(int(np.floor(xi)) - reach, int(np.floor(xi)) + reach + 2):
                if ix < 0 or jy < 0 or ix > mesh.cells_x or jy > mesh.cells_y:
                    continue
                node = jy * mesh.stride + ix
                if near[node] < 0 and (ix - xi) ** 2 + (jy - eta) ** 2 < _REACH * _REACH and count < near_node.size:
                    near[node] = count
                    near_node[count] = node
                    count += 1
    crack.near_count[0] = count
    for k in range(count):
        for j in range(-1, 2):
            for i in range(-1, 2):
                other = near_node[k] + j * mesh.stride + i
                if 0 <= other < block.size:
                    block[other] = 1


@njit(cache=True, nogil=True)
def place_nodes(crack: CrackFields, mesh: Mesh) -> None:
    """Bring the near nodes into the crack's reference frame."""
    marker = crack.marker
    near_node = crack.near_node
    node_local = crack.node_local
    for k in range(crack.near_count[0]):
        node = near_node[k]
        x = mesh.origin_x + mesh.cell_size * (node % mesh.stride) - crack.start_x
        y = mesh.origin_y + mesh.cell_size * (node // mesh.stride) - crack.start_y
        s = x * crack.tangent_x + y * crack.tangent_y
        a, b, c, d = _marker_value(marker, crack.length, s)
        s -= 0.5 * ((a + c) * crack.tangent_x + (b + d) * crack.tangent_y)
        a, b, c, d = _marker_value(marker, crack.length, s)
        x -= 0.5 * (a + c)
        y -= 0.5 * (b + d)
        node_local[k, 0] = x * crack.tangent_x + y * crack.tangent_y
        node_local[k, 1] = -x * crack.tangent_y + y * crack.tangent_x


@njit(cache=True, nogil=True)
def follow_crack(crack: CrackFields, mesh: Mesh) -> None:
    """Place the near nodes for a new step, listing them again where the crack has moved on."""
    far = 0.0
    for m in range(crack.marker.shape[0]):
        for axis in range(2):
            mean = 0.5 * (crack.marker[m, axis] + crack.marker[m, 2 + axis])
            far = max(far, abs(mean - crack.marker_found[m, axis]))
    if far > _REFRESH * mesh.cell_size:
        for m in range(crack.marker.shape[0]):
            for axis in range(2):
                crack.marker_found[m, axis] = 0.5 * (crack.marker[m, axis] + crack.marker[m, 2 + axis])
        find_near_nodes(crack, mesh)
    place_nodes(crack, mesh)


@njit(cache=True, nogil=True)
def hold_faces_apart(
    crack: CrackFields,
    momentum: NDArray[np.float64],
    velocity: NDArray[np.float64],
    increment_column: int,
) -> None:
    """Make the normal velocity common where closed faces approach (frictionless).

    ``velocity`` has the nodal velocity in its first two columns; the change is added to the two columns from
    ``increment_column`` on as well, unless that is 0.
    """
    marker = crack.marker
    near_node = crack.near_node
    node_local = crack.node_local
    nx = -crack.tangent_y
    ny = crack.tangent_x
    for k in range(crack.near_count[0]):
        node = near_node[k]
        twin = crack.base + k
        m_own = momentum[node, 0]
        m_far = momentum[twin, 0]
        if not (m_own > 0.0 and m_far > 0.0):
            continue
        a, b, c, d = _marker_value(marker, crack.length, node_local[k, 0])
        if (a - c) * nx + (b - d) * ny > 0.0:
            continue
        own = velocity[node, 0] * nx + velocity[node, 1] * ny
        far = velocity[twin, 0] * nx + velocity[twin, 1] * ny
        apart = own - far if node_local[k, 1] >= 0.0 else far - own
        if apart >= 0.0:
            continue
        common = (m_own * own + m_far * far) / (m_own + m_far)
        for row, change in ((node, common - own), (twin, common - far)):
            velocity[row, 0] += change * nx
            velocity[row, 1] += change * ny
            if increment_column > 0:
                velocity[row, increment_column] += change * nx
                velocity[row, increment_column + 1] += change * ny


@njit(cache=True, nogil=True)
def move_crack(
    crack: CrackFields,
    mesh: Mesh,
    momentum: NDArray[np.float64],
    motion: NDArray[np.float64],
    time_step: float,
) -> None:
    """Carry both faces along with the material of their side.

    Each face is sampled where it is itself, so a wide gap does no harm. A marker without material on a side
    (the crack may start outside the body) moves as its neighbour on that face does.
    """
    marker = crack.marker
    near = crack.near
    node_local = crack.node_local
    last = marker.shape[0] - 1
    for side in range(2):
        first_live = -1
        previous_live = -1
        for m in range(last + 1):
            s = crack.length * m / last
            x = crack.start_x + s * crack.tangent_x + marker[m, 2 * side]
            y = crack.start_y + s * crack.tangent_y + marker[m, 2 * side + 1]
            xi = (x - mesh.origin_x) * mesh.inverse_cell
            eta = (y - mesh.origin_y) * mesh.inverse_cell
            total = 0.0
            vx = 0.0
            vy = 0.0
            if 0 <= xi < mesh.cells_x and 0 <= eta < mesh.cells_y:
                ix = int(xi)
                jy = int(eta)
                for k in range(4):
                    row = (jy + k // 2) * mesh.stride + ix + k % 2
                    k_near = near[row]
                    if k_near >= 0:
                        opposite = (node_local[k_near, 1] >= 0.0) != (side == 0)
                        beside = crack.tolerance < node_local[k_near, 0] < crack.length - crack.tolerance
                        if opposite and beside:
                            row = crack.base + k_near
                    if momentum[row, 0] > 0.0:
                        w = (xi - ix if k % 2 else 1.0 - xi + ix) * (eta - jy if k // 2 else 1.0 - eta + jy)
                        total += w
                        vx += w * motion[row, 0]
                        vy += w * motion[row, 1]
            if total > 0.0:
                marker[m, 2 * side] += time_step * vx / total
                marker[m, 2 * side + 1] += time_step * vy / total
                previous_live = m
                if first_live < 0:
                    first_live = m
            elif previous_live >= 0:
                marker[m, 2 * side] = marker[previous_live, 2 * side]
                marker[m, 2 * side + 1] = marker[previous_live, 2 * side + 1]
        for m in range(max(first_live, 0)):
            marker[m, 2 * side] = marker[first_live, 2 * side]
            marker[m, 2 * side + 1] = marker[first_live, 2 * side + 1]
