"""What a mesh of the plane must keep that was made elsewhere, before a laminate is stacked on it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.sparse
import scipy.sparse.csgraph
from numpy.typing import NDArray

from fem_service.plane_mesh import PlaneMesh

#: Part of the extent within which a node lies on a side: files of other codes have six or seven digits.
_ON = 1e-6
#: Sine of the angle at a corner of an element, at least.
_SHARPEST = 1e-3


def corner_sines(plane: PlaneMesh) -> NDArray[np.float64]:
    """Sine of the angle at each corner, shape (elements, 4), positive counterclockwise; -1 where two corners are one.

    The Jacobian determinant of a four-node element is linear in each natural coordinate, so it is positive all over
    the element where it is at the four corners; there it has the sign of these sines.
    """
    corners = plane.nodes[plane.elements]
    before, after = corners - np.roll(corners, 1, axis=1), np.roll(corners, -1, axis=1) - corners
    lengths = np.hypot(*np.moveaxis(before, -1, 0)) * np.hypot(*np.moveaxis(after, -1, 0))
    turns = before[..., 0] * after[..., 1] - before[..., 1] * after[..., 0]
    found: NDArray[np.float64] = np.divide(turns, lengths, out=np.full_like(turns, -1.0), where=lengths > 0.0)
    return found


def check_plane(plane: PlaneMesh, labels: NDArray[np.int64] | None = None) -> None:
    """Refuse a mesh on which finite elements cannot work.

    Parameters
    ----------
    plane : PlaneMesh
    labels : ndarray of int64, shape (elements,), optional
        Numbers by which errors name the elements; absent: their rows, from 0.

    Raises
    ------
    ValueError
        If an element has a corner of 0 or of 180 degrees and more, or goes clockwise; two lie on each other; a node
        belongs to none; or the mesh is of several pieces.
    """
    names = np.arange(len(plane.elements)) if labels is None else labels
    _check_corners(plane, names)
    _check_neighbours(plane, names)
    _check_one_piece(plane, names)


def fitted(plane: PlaneMesh, length: float, width: float, *, quarter: bool) -> PlaneMesh:
    """The mesh with what lies on the sides of the plate exactly on them.

    Parameters
    ----------
    plane : PlaneMesh
        Its origin is the middle of the plate.
    length, width : float
        Of the whole plate along x and y, m.
    quarter : bool
        Whether it is the quarter with x and y above 0.

    Returns
    -------
    PlaneMesh
        With nodes within 1e-6 of the extent of a side on it.

    Raises
    ------
    ValueError
        If a node lies outside of the part that is modelled, or the mesh does not reach its sides.
    """
    high = 0.5 * np.array([length, width])
    low = np.zeros(2) if quarter else -high
    nodes, near = plane.nodes, _ON * float((high - low).max())
    outside = np.flatnonzero(((nodes < low - near) | (nodes > high + near)).any(axis=1))
    if len(outside):
        x, y = nodes[outside[0]]
        raise ValueError(
            f"there is a node at x = {x:g} m, y = {y:g} m; the part that is modelled goes from ({low[0]:g}, {low[1]:g})"
            f" to ({high[0]:g}, {high[1]:g}) m, with the middle of the plate at (0, 0)"
        )
    for side in (low, high):
        nodes = np.where(np.abs(nodes - side) <= near, side, nodes)
    for axis, name in enumerate("xy"):
        for value, end in ((nodes[:, axis].min(), low[axis]), (nodes[:, axis].max(), high[axis])):
            if value != end:
                raise ValueError(f"the mesh ends at {name} = {value:g} m; the part that is modelled ends at {end:g} m")
    pulled = nodes[nodes[:, 0] == high[0], 1]
    if pulled.min() != low[1] or pulled.max() != high[1]:
        raise ValueError(
            f"the end at x = {high[0]:g} m, which is pulled, goes from y = {pulled.min():g} to {pulled.max():g} m;"
            f" the plate from {low[1]:g} to {high[1]:g} m"
        )
    return replace(plane, nodes=np.ascontiguousarray(nodes))


def _check_corners(plane: PlaneMesh, names: NDArray[np.int64]) -> None:
    sines = corner_sines(plane)
    bad = np.flatnonzero((sines < _SHARPEST).any(axis=1))
    if len(bad):
        row = int(bad[0])
        x, y = plane.nodes[plane.elements[row, int(np.argmin(sines[row]))]]
        kind = "goes clockwise" if (sines[row] < 0.0).all() else "is turned inside out or flat"
        raise ValueError(
            f"element {names[row]} {kind} at its corner x = {x:g} m, y = {y:g} m; corners must go counterclockwise, "
            "each with an angle between 0 and 180 degrees"
        )


def _check_neighbours(plane: PlaneMesh, names: NDArray[np.int64]) -> None:
    """Neighbours that both go counterclockwise run along their common edge in opposite directions."""
    edges = np.stack([plane.elements, np.roll(plane.elements, -1, axis=1)], axis=-1).reshape(-1, 2)
    _, where, times = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    if times.max() > 1:
        one, other = np.flatnonzero(where.reshape(-1) == np.argmax(times))[:2] // 4
        raise ValueError(f"elements {names[one]} and {names[other]} lie on each other: they are on one side of an edge")


def _check_one_piece(plane: PlaneMesh, names: NDArray[np.int64]) -> None:
    elements, count = plane.elements, len(plane.nodes)
    lone = np.setdiff1d(np.arange(count), elements)
    if len(lone):
        raise ValueError(f"node {lone[0]} belongs to no element")
    ends = np.roll(elements, -1, axis=1)
    links = scipy.sparse.coo_matrix((np.ones(elements.size), (elements.ravel(), ends.ravel())), shape=(count, count))
    _, piece = scipy.sparse.csgraph.connected_components(links, directed=False)
    if piece.max():
        other = int(np.argmax(piece[elements[:, 0]] != piece[elements[0, 0]]))
        raise ValueError(
            f"the mesh is of {piece.max() + 1} pieces: element {names[other]} does not hang together with element "
            f"{names[0]}; nodes at one place must be one node"
        )
