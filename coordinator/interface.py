"""The interface of one sample: which atoms are anchored, and the volume cells (IVC) that they belong to."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import shapely
from scipy.spatial import cKDTree

from coordinator.ring import BoolArray, Ring
from protocol.arrays import FloatArray, IntArray
from protocol.atomistic import PASSIVE, SPRING, SURFACE

#: Share of a cell that the ring must cover; what is smaller joins the nearest cell that has as much.
_LEAST_SHARE = 0.3


@dataclass(frozen=True)
class Interface:
    """Anchored atoms and their cells, in the frame of the sample.

    Attributes
    ----------
    ring : Ring
    anchor : int64 array, shape (anchors,)
        Row of each anchored atom among all atoms.
    anchor_ivc : int64 array, shape (anchors,)
        Cell of each anchor.
    anchor_kind : int64 array, shape (anchors,)
        0 spring, 1 passive, 2 surface.
    ivc_lower, ivc_upper : float64 array, shape (ivcs, 3)
        Corners of the cells, m; a flat cell has z = 0.
    """

    ring: Ring
    anchor: IntArray
    anchor_ivc: IntArray
    anchor_kind: IntArray
    ivc_lower: FloatArray
    ivc_upper: FloatArray


def build_interface(
    atoms: FloatArray,
    ring: Ring,
    ivc_size: float,
    crack_y: float | None = None,
    passive_width: float = 0.0,
    surface_width: float = 0.0,
    spacing: float | None = None,
    heavy: BoolArray | None = None,
) -> Interface:
    """Anchor atoms in the ring and partition it into cells of about `ivc_size`.

    All of them are anchored, or, with `spacing`, those that are `heavy` and have no anchor before them within
    that distance, m; passive and surface atoms are always all of theirs.

    A crack line is always a border between cells, since a cell that held both faces would hand the force
    of one to the other. Atoms nearer than `passive_width` to the outer border are passive, those nearer than
    `surface_width` are surface atoms, all in m.

    Raises
    ------
    ValueError
        Where no atom lies in the ring.
    """
    flat = atoms[:, :2]
    anchor = np.flatnonzero(~ring.inside(flat)).astype(np.int64)
    if not len(anchor):
        raise ValueError("there is no atom in the ring of the handshake")
    depth = ring.depth(flat[anchor])
    kind = np.where(depth < passive_width, PASSIVE, np.where(depth < surface_width, SURFACE, SPRING))
    if spacing is not None:
        thinned = _thinned(atoms, anchor[(kind == SPRING) & (heavy is None or heavy[anchor])], spacing)
        keep = (kind != SPRING) | np.isin(anchor, thinned)
        anchor, kind = anchor[keep], kind[keep]
    low, high = _extent(flat, ivc_size)
    inner_low, inner_high = ring.inner.min(axis=0), ring.inner.max(axis=0)
    x = _breaks(low[0], high[0], (inner_low[0], inner_high[0]), ivc_size)
    y = _breaks(low[1], high[1], (inner_low[1], inner_high[1]), ivc_size)
    if crack_y is not None and y[0] < crack_y < y[-1]:
        y = _with_border(y, crack_y, fixed=(inner_low[1], inner_high[1], y[0], y[-1]))
    lower = np.array([[a, c, 0.0] for c, _ in pairwise(y) for a, _ in pairwise(x)])
    upper = np.array([[b, d, 0.0] for _, d in pairwise(y) for _, b in pairwise(x)])
    column = np.clip(np.searchsorted(x, flat[anchor, 0], side="right") - 1, 0, len(x) - 2)
    row = np.clip(np.searchsorted(y, flat[anchor, 1], side="right") - 1, 0, len(y) - 2)
    cell = row * (len(x) - 1) + column
    cell = _joined(cell, lower, upper, ring, crack_y)
    # A cell without atoms (at the mouth of a crack, say) plays no part.
    used = np.unique(cell)
    return Interface(
        ring=ring,
        anchor=anchor,
        anchor_ivc=np.searchsorted(used, cell).astype(np.int64),
        anchor_kind=kind.astype(np.int64),
        ivc_lower=lower[used],
        ivc_upper=upper[used],
    )


def _extent(flat: FloatArray, size: float) -> tuple[FloatArray, FloatArray]:
    """Return corners of the cells' area: that of the sample, one cell wide where the sample is but a row."""
    low, high = flat.min(axis=0), flat.max(axis=0)
    pad = np.maximum(0.5 * (size - (high - low)), 0.0)
    return low - pad, high + pad


def _thinned(atoms: FloatArray, rows: IntArray, spacing: float) -> IntArray:
    """Return rows, in their order, of atoms that have none of those taken before within `spacing`."""
    near = cKDTree(atoms[rows]).query_ball_point(atoms[rows], spacing)
    free = np.ones(len(rows), dtype=bool)
    taken = []
    for index, others in enumerate(near):
        if free[index]:
            taken.append(index)
            free[others] = False
    return rows[taken]


def _joined(cell: IntArray, lower: FloatArray, upper: FloatArray, ring: Ring, crack_y: float | None) -> IntArray:
    """Return cells of anchors, with cells of which the ring has but a sliver joined to neighbours.

    A neighbour across the crack does not count.
    """
    used = np.unique(cell)
    area = shapely.Polygon(ring.outer, [ring.inner])
    boxes = shapely.box(lower[used, 0], lower[used, 1], upper[used, 0], upper[used, 1])
    share = shapely.area(shapely.intersection(boxes, area)) / shapely.area(boxes)
    share /= share.max()
    small = share < _LEAST_SHARE
    if not small.any():
        return cell
    middle = 0.5 * (lower[used, :2] + upper[used, :2])
    above = np.zeros(len(used), dtype=bool) if crack_y is None else middle[:, 1] > crack_y
    target = used.copy()
    for side in (False, True):
        good = ~small & (above == side)
        lone = small & (above == side)
        if good.any() and lone.any():
            _, nearest = cKDTree(middle[good]).query(middle[lone])
            target[lone] = used[good][nearest]
    return np.asarray(target[np.searchsorted(used, cell)], dtype=np.int64)


def _with_border(breaks: FloatArray, place: float, fixed: tuple[float, ...]) -> FloatArray:
    """Move the border nearest to `place` there; where that one is fixed, as the ring's own are, add a border."""
    nearest = int(np.argmin(np.abs(breaks - place)))
    if breaks[nearest] in fixed:
        return np.unique(np.append(breaks, place))
    moved = breaks.copy()
    moved[nearest] = place
    return moved


def _breaks(low: float, high: float, inside: tuple[float, float], size: float) -> FloatArray:
    """Return borders of cells along an axis: the ring on each side, and what lies between, each in equal parts."""
    borders = [low, *(place for place in inside if low < place < high), high]
    parts = [np.linspace(a, b, max(1, round((b - a) / size)) + 1) for a, b in pairwise(borders)]
    return np.concatenate([*(part[:-1] for part in parts), parts[-1][-1:]])
