"""Ends of cracks: which are tips, which lie on or before another crack, and where each end counts in crossings."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from .crack_line import meeting, nearest_on_line
from .velocity_fields import Joints

FloatArray = NDArray[np.float64]
#: Cell size [m] around places (n, 2).
CellAt = Callable[[FloatArray], FloatArray]

# A tip ends this much short of where it is stated, and an end this close to another crack is on it [cells].
_END = 1e-6
# An end nearer to another crack than this is before it, even if it does not meet it [cells].
_BEFORE = 3.0
# Material this close in front of an end, along and across the line, makes it a tip [cells].
_AHEAD = (1.0, 0.75)


def end_of(line: FloatArray, end: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Place of an end (0 or 1), the corner before it, and the unit vector out of the crack."""
    place, inner = (line[0], line[1]) if end == 0 else (line[-1], line[-2])
    return place, inner, (place - inner) / np.hypot(*(place - inner))


def find_joints(
    lines: Sequence[FloatArray], cell_at: CellAt, ghost_length: float
) -> tuple[Joints, set[tuple[int, int]]]:
    """Ends of cracks on or just before other cracks, and those (crack, end) that are on one.

    ``ghost_length`` is how far [cells] a branch goes on in thought beyond its main.

    Raises
    ------
    ValueError
        If two cracks end at the same place.
    """
    branches, mains, lefts, mets, ghosts = [], [], [], [], []
    on_another = set()
    for branch, line in enumerate(lines):
        for end in range(2):
            place, inner, out = end_of(line, end)
            cell = float(cell_at(place[None])[0])
            back = inner if np.hypot(*(place - inner)) < 0.5 * cell else place - 0.5 * cell * out
            for main, other in enumerate(lines):
                if main == branch:
                    continue
                last = other.shape[0] - 1
                if min(np.hypot(*(place - other[0])), np.hypot(*(place - other[-1]))) <= _END * cell:
                    raise ValueError(
                        f"cracks {branch} and {main}: both end at ({place[0]:.9g}, {place[1]:.9g}) m; "
                        "join them to one line of several segments"
                    )
                far = nearest_on_line(other, 0, last, place[0], place[1])[2]
                met = far <= _END * cell
                through = any(meeting(place, inner, other[g], other[g + 1]) is not None for g in range(last))
                if not met and (far > _BEFORE * cell or through):
                    continue
                g, t, _, tx, ty = nearest_on_line(other, 0, last, back[0], back[1])
                way = back - other[g] - t * (other[g + 1] - other[g])
                branches.append(branch)
                mains.append(main)
                lefts.append(bool(tx * way[1] - ty * way[0] >= 0.0))
                mets.append(met)
                ghosts.append([place, place + ghost_length * cell * out])
                if met:
                    on_another.add((branch, end))
    joints = Joints(
        np.array(branches, dtype=np.int64),
        np.array(mains, dtype=np.int64),
        np.array(lefts, dtype=np.bool_),
        np.array(mets, dtype=np.bool_),
        np.array(ghosts, dtype=np.float64).reshape(-1, 2, 2),
    )
    return joints, on_another


def cut_line(line: FloatArray, free: Sequence[bool], cell_at: CellAt) -> FloatArray:
    """Return the line as it counts in crossings: a little short of its free ends."""
    cut = line.copy()
    for end in range(2):
        place, _, out = end_of(line, end)
        if free[end]:
            cut[-end] -= _END * float(cell_at(place[None])[0]) * out
    return cut


def has_material_ahead(line: FloatArray, end: int, points: FloatArray, tree: cKDTree, cell_at: CellAt) -> bool:
    """Is there material, given by points (n, 2) and their tree, right in front of an end?"""
    place, _, out = end_of(line, end)
    cell = float(cell_at(place[None])[0])
    near = points[tree.query_ball_point(place, np.hypot(*_AHEAD) * cell)] - place
    along = near @ out
    across = near @ np.array([-out[1], out[0]])
    return bool(np.any((along > 0.0) & (along <= _AHEAD[0] * cell) & (np.abs(across) <= _AHEAD[1] * cell)))
