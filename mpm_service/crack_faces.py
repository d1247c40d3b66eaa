"""Crack faces: markers along the line that move with the material of either side.

A marker's face takes the displacement that a straight-line fit through the material points on its side, within
about a cell of it in the reference state, has at the marker. So the faces are a function of the points alone,
exact for any affine motion, large rotations included, and need no history. At a tip both sides are one material,
and the fit is common.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from .crack_ends import CellAt
from .crack_line import crosses_odd, nearest_on_line

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Largest distance of markers [cells].
SPACING = 0.5
#: Radii of the fit tried in turn [cells], and the points that are enough at all but the last.
_RADII = (1.3, 1.8, 2.3)
_ENOUGH = 6
_LEAST = 3
# Nearest point of a face's fit [cells]: farther off the face lies outside the body.
_REACH = 0.8
#: Points a fit may use.
MOST_POINTS = 32
# How far from the line the side of a marker is probed [cells]. Clear of round-off, within any point's domain.
_PROBE = 1e-3
# Directions in which the points lie this much closer together than in the other are not fitted.
_FLAT = 1e-2


@dataclass
class Markers:
    """Markers of all cracks, one crack behind the other.

    Attributes
    ----------
    start : (cracks + 1,) ndarray of int
        First marker of each crack.
    reference : (m, 2) ndarray
        Reference place [m].
    arc : (m,) ndarray
        Distance along the reference line from the crack's first point [m].
    cell : (m,) ndarray
        Cell size there [m].
    point : (m, 2, MOST_POINTS) ndarray of int
        Ids of the points that the left (0) and right (1) face follow.
    factor : (m, 2, MOST_POINTS) ndarray
        Their factors.
    count : (m, 2) ndarray of int
        How many; 0 where the face has no material.
    lead : (m, 2, 2) ndarray of int
        For a face without material: the marker whose face it is rigidly tied to, and a second one that gives the
        rotation; -1 if the face has no material anywhere.
    """

    start: IntArray
    reference: FloatArray
    arc: FloatArray
    cell: FloatArray
    point: IntArray
    factor: FloatArray
    count: IntArray
    lead: IntArray


def place_markers(line: FloatArray, cell_at: CellAt) -> FloatArray:
    """Reference places (m, 2) of markers along a line, every corner among them, at least two a cell.

    ``cell_at(places)`` gives the cell size around places (n, 2) [m].
    """
    places = [line[0]]
    for a, b in pairwise(line):
        length = float(np.hypot(*(b - a)))
        coarse = SPACING * float(cell_at(np.array([a, 0.5 * (a + b), b])).max())
        pieces = max(int(np.ceil(length / coarse - 1e-9)), 1)
        corners = [a + (b - a) * (k / pieces) for k in range(pieces)] + [b]
        for c, d in pairwise(corners):
            places.extend(_halve(c, d, cell_at))
    return np.array(places)


def _halve(a: FloatArray, b: FloatArray, cell_at: CellAt) -> list[FloatArray]:
    """Ends of equal parts of a-b, halved where the grid is finer; without a, with b."""
    middle = 0.5 * (a + b)
    if np.hypot(*(b - a)) <= SPACING * float(cell_at(np.array([a, middle, b])).min()) * (1.0 + 1e-9):
        return [b]
    return [*_halve(a, middle, cell_at), *_halve(middle, b, cell_at)]


def empty_markers(places: list[FloatArray], cell_at: CellAt) -> Markers:
    """Markers at the given places of each crack, without points to follow."""
    counts = [p.shape[0] for p in places]
    total = sum(counts)
    reference = np.concatenate(places) if places else np.zeros((0, 2))
    arc = [np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(p, axis=0).T))]) for p in places]
    return Markers(
        np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        np.ascontiguousarray(reference),
        np.concatenate(arc) if arc else np.zeros(0),
        cell_at(reference) if total else np.zeros(0),
        np.zeros((total, 2, MOST_POINTS), dtype=np.int64),
        np.zeros((total, 2, MOST_POINTS)),
        np.zeros((total, 2), dtype=np.int64),
        np.full((total, 2, 2), -1, dtype=np.int64),
    )


def fit_faces(
    markers: Markers,
    chosen: IntArray,
    tips: set[int],
    tree: cKDTree,
    points: FloatArray,
    vertices: list[FloatArray],
) -> None:
    """Find the points that the faces of the chosen markers follow, and their factors.

    ``tips`` are markers at tips, ``points`` (n, 2) reference places by id, ``vertices`` the line of each crack.
    """
    for m in chosen:
        crack = int(np.searchsorted(markers.start, m, side="right") - 1)
        place = markers.reference[m]
        cell = markers.cell[m]
        within = np.sort(np.array(tree.query_ball_point(place, _RADII[-1] * cell), dtype=np.int64))
        if m in tips:
            _fit(markers, m, 0, within, points)
            for table in (markers.point, markers.factor, markers.count):
                table[m, 1] = table[m, 0]
            continue
        line = vertices[crack]
        tx, ty = nearest_on_line(line, 0, line.shape[0] - 1, place[0], place[1])[3:]
        left = _are_left(line, points, within)
        for side, sign in ((0, 1.0), (1, -1.0)):
            mine = within[left == (side == 0)]
            probe = place + sign * _PROBE * cell * np.array([-ty, tx])
            if mine.size:
                _drop_hidden(vertices, points, mine, probe)
            _fit(markers, m, side, mine[mine >= 0], points)


@njit(cache=True, nogil=True)
def _are_left(line: FloatArray, points: FloatArray, ids: IntArray) -> NDArray[np.bool_]:
    """Which points lie left of a line?"""
    left = np.zeros(ids.size, dtype=np.bool_)
    for i in range(ids.size):
        x = points[ids[i], 0]
        y = points[ids[i], 1]
        g, t, _, tx, ty = nearest_on_line(line, 0, line.shape[0] - 1, x, y)
        dx = x - line[g, 0] - t * (line[g + 1, 0] - line[g, 0])
        dy = y - line[g, 1] - t * (line[g + 1, 1] - line[g, 1])
        left[i] = tx * dy - ty * dx >= 0.0
    return left


def _drop_hidden(vertices: list[FloatArray], points: FloatArray, ids: IntArray, probe: FloatArray) -> None:
    """Set ids of points behind a crack, seen from the probe, to -1."""
    for line in vertices:
        _hide(line, points, ids, probe[0], probe[1])


@njit(cache=True, nogil=True)
def _hide(line: FloatArray, points: FloatArray, ids: IntArray, x: float, y: float) -> None:
    for i in range(ids.size):
        if ids[i] >= 0 and crosses_odd(line, 0, line.shape[0] - 1, points[ids[i], 0], points[ids[i], 1], x, y):
            ids[i] = -1


def _fit(markers: Markers, m: int, side: int, ids: IntArray, points: FloatArray) -> None:
    """Factors of the points in a weighted fit of a plane, taken at the marker."""
    markers.count[m, side] = 0
    away = (points[ids] - markers.reference[m]) / markers.cell[m]
    far = np.hypot(away[:, 0], away[:, 1])
    if ids.size < _LEAST or far.min() > _REACH:
        return
    for radius in _RADII:
        used = far < radius
        if used.sum() >= _ENOUGH:
            break
    if used.sum() < _LEAST:
        return
    if used.sum() > MOST_POINTS:
        used = np.zeros(ids.size, dtype=bool)
        used[np.argsort(far, kind="stable")[:MOST_POINTS]] = True
        radius = 1.01 * float(far[used].max())
    root = 1.0 - (far[used] / radius) ** 2
    terms = np.column_stack([np.ones(root.size), away[used]])
    factor = np.linalg.pinv(root[:, None] * terms, rcond=_FLAT)[0] * root
    factor /= factor.sum()
    markers.count[m, side] = root.size
    markers.point[m, side, : root.size] = ids[used]
    markers.factor[m, side, : root.size] = factor


def tie_loose_faces(markers: Markers) -> None:
    """Tie faces without material to the nearest face of the same side that has some."""
    markers.lead[:] = -1
    for crack in range(markers.start.size - 1):
        first, last = int(markers.start[crack]), int(markers.start[crack + 1])
        for side in range(2):
            held = first + np.flatnonzero(markers.count[first:last, side])
            if held.size == 0:
                continue
            for m in first + np.flatnonzero(markers.count[first:last, side] == 0):
                lead = held[np.abs(markers.arc[held] - markers.arc[m]).argmin()]
                # The rotation is that of the stretch from the lead on, a cell or two into the material.
                beyond = held[(held - lead) * (lead - m) > 0]
                order = np.abs(beyond - lead).argsort(kind="stable")
                second = int(beyond[order[: int(2 / SPACING)]][-1]) if beyond.size else int(lead)
                markers.lead[m, side] = lead, second


@njit(cache=True, nogil=True)
def move_faces(
    rows: FloatArray,
    row_of: IntArray,
    points: FloatArray,
    reference: FloatArray,
    point: IntArray,
    factor: FloatArray,
    count: IntArray,
    lead: IntArray,
    faces: FloatArray,
) -> None:
    """Displacements (m, 4) of the left and the right face from those of the points [m]."""
    for m in range(reference.shape[0]):
        for side in range(2):
            ux = 0.0
            uy = 0.0
            for i in range(count[m, side]):
                p = point[m, side, i]
                row = row_of[p]
                ux += factor[m, side, i] * (rows[row, 0] - points[p, 0])
                uy += factor[m, side, i] * (rows[row, 1] - points[p, 1])
            faces[m, 2 * side] = ux
            faces[m, 2 * side + 1] = uy
    for m in range(reference.shape[0]):
        for side in range(2):
            a = lead[m, side, 0]
            b = lead[m, side, 1]
            if a < 0:
                continue
            was_x = reference[b, 0] - reference[a, 0]
            was_y = reference[b, 1] - reference[a, 1]
            now_x = was_x + faces[b, 2 * side] - faces[a, 2 * side]
            now_y = was_y + faces[b, 2 * side + 1] - faces[a, 2 * side + 1]
            size = np.hypot(was_x, was_y) * np.hypot(now_x, now_y)
            cosine = 1.0
            sine = 0.0
            if size > 0.0:
                cosine = (was_x * now_x + was_y * now_y) / size
                sine = (was_x * now_y - was_y * now_x) / size
            x = reference[m, 0] - reference[a, 0]
            y = reference[m, 1] - reference[a, 1]
            faces[m, 2 * side] = faces[a, 2 * side] + (cosine - 1.0) * x - sine * y
            faces[m, 2 * side + 1] = faces[a, 2 * side + 1] + sine * x + (cosine - 1.0) * y
    for m in range(reference.shape[0]):
        for side in range(2):
            if count[m, side] == 0 and lead[m, side, 0] < 0:
                faces[m, 2 * side] = faces[m, 2 * (1 - side)]
                faces[m, 2 * side + 1] = faces[m, 2 * (1 - side) + 1]
