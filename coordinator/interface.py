"""The interface: where continuum and atoms overlap, which atoms are anchored, and the volume cells (IVC)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from protocol.arrays import FloatArray, IntArray
from protocol.atomistic import PASSIVE, SPRING, SURFACE
from protocol.continuum import Overlap, Rectangle


@dataclass(frozen=True)
class Interface:
    """Anchored atoms and their cells.

    Attributes
    ----------
    overlap : Overlap
    anchor : int64 array, shape (anchors,)
        Row of each anchored atom among all atoms.
    anchor_ivc : int64 array, shape (anchors,)
        Cell of each anchor.
    anchor_kind : int64 array, shape (anchors,)
        0 spring, 1 passive, 2 surface.
    ivc_lower, ivc_upper : float64 array, shape (ivcs, 3)
        Corners of the cells, m; a flat cell has z = 0.
    """

    overlap: Overlap
    anchor: IntArray
    anchor_ivc: IntArray
    anchor_kind: IntArray
    ivc_lower: FloatArray
    ivc_upper: FloatArray


def build_interface(
    atoms: FloatArray,
    inner: Rectangle,
    outer: Rectangle,
    weight: float,
    ivc_size: float,
    crack_y: float | None,
    passive_width: float = 0.0,
    surface_width: float = 0.0,
) -> Interface:
    """Anchor all atoms outside `inner` and partition the overlap into cells of about `ivc_size`.

    A crack line is always a border between cells, since a cell that held both faces would hand the force
    of one to the other. Atoms nearer than `passive_width` to the edge of `outer` are passive, those nearer than
    `surface_width` are surface atoms, all in m.
    """
    x = _breaks(inner.lower[0], inner.upper[0], outer.lower[0], outer.upper[0], ivc_size)
    y = _breaks(inner.lower[1], inner.upper[1], outer.lower[1], outer.upper[1], ivc_size)
    if crack_y is not None:
        y = _with_border(y, crack_y, fixed=(inner.lower[1], inner.upper[1], y[0], y[-1]))
    centre = np.array([[0.5 * (a + b), 0.5 * (c + d)] for c, d in pairwise(y) for a, b in pairwise(x)])
    in_ring = ~np.all((centre > inner.lower) & (centre < inner.upper), axis=1)
    number = np.full(len(centre), -1, dtype=np.int64)
    number[in_ring] = np.arange(in_ring.sum())

    flat = atoms[:, :2]
    # Half-open as the cells are, so that an atom on a border is either inside or in a cell.
    anchor = np.flatnonzero(~np.all((flat >= inner.lower) & (flat < inner.upper), axis=1)).astype(np.int64)
    # Atoms a little outside the outermost cell line belong to the outermost cells.
    column = np.clip(np.searchsorted(x, flat[anchor, 0], side="right") - 1, 0, len(x) - 2)
    row = np.clip(np.searchsorted(y, flat[anchor, 1], side="right") - 1, 0, len(y) - 2)
    anchor_ivc = number[row * (len(x) - 1) + column]
    depth = np.minimum(flat[anchor] - outer.lower, np.array(outer.upper) - flat[anchor]).min(axis=1)
    kind = np.where(depth < passive_width, PASSIVE, np.where(depth < surface_width, SURFACE, SPRING))
    lower = np.array([[a, c, 0.0] for c, _ in pairwise(y) for a, _ in pairwise(x)])[in_ring]
    upper = np.array([[b, d, 0.0] for _, d in pairwise(y) for _, b in pairwise(x)])[in_ring]
    # A cell without atoms (at the mouth of a crack, say) plays no part.
    used = np.unique(anchor_ivc)
    return Interface(
        overlap=Overlap(inner=inner, outer=outer, weight=weight),
        anchor=anchor,
        anchor_ivc=np.searchsorted(used, anchor_ivc).astype(np.int64),
        anchor_kind=kind.astype(np.int64),
        ivc_lower=lower[used],
        ivc_upper=upper[used],
    )


def _with_border(breaks: FloatArray, place: float, fixed: tuple[float, ...]) -> FloatArray:
    """Move the border nearest to `place` there; where that one is fixed, as the ring's own are, add a border."""
    nearest = int(np.argmin(np.abs(breaks - place)))
    if breaks[nearest] in fixed:
        return np.unique(np.append(breaks, place))
    moved = breaks.copy()
    moved[nearest] = place
    return moved


def _breaks(inner_low: float, inner_high: float, outer_low: float, outer_high: float, size: float) -> FloatArray:
    """Return borders of cells: the overlap on each side, and what lies between, each in equal parts."""

    def parts(low: float, high: float) -> FloatArray:
        return np.linspace(low, high, max(1, round((high - low) / size)) + 1)

    return np.concatenate(
        [parts(outer_low, inner_low)[:-1], parts(inner_low, inner_high)[:-1], parts(inner_high, outer_high)]
    )
