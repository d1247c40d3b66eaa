"""Meshes of quadrilaterals in the plane of a laminate: a rectangle, and a rectangle with a round hole."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.spatial
from numpy.typing import NDArray

#: Nodes nearer to each other than this part of the mesh's extent are one.
_SAME = 1e-9


@dataclass(frozen=True, eq=False)
class PlaneMesh:
    """Quadrilaterals.

    Attributes
    ----------
    nodes : ndarray of float, shape (nodes, 2)
        x and y, m.
    elements : ndarray of int64, shape (elements, 4)
        Nodes of each, counterclockwise.
    """

    nodes: NDArray[np.float64]
    elements: NDArray[np.int64]


def rectangle(length: float, width: float, columns: int, rows: int) -> PlaneMesh:
    """A rectangle from (0, 0) to (length, width) with equal elements.

    Parameters
    ----------
    length, width : float
        Along x and y, m.
    columns, rows : int
        Elements along x and y.
    """
    _check_positive(length=length, width=width)
    _check_count(columns=columns, rows=rows)
    x, y = np.meshgrid(np.linspace(0.0, length, columns + 1), np.linspace(0.0, width, rows + 1), indexing="ij")
    return _block(np.stack([x, y], axis=-1))


def open_hole(
    length: float,
    width: float,
    diameter: float,
    *,
    around: int,
    radial: int,
    growth: float = 1.0,
    beyond: int = 0,
    quadrant: bool = False,
) -> PlaneMesh:
    """A rectangle with a round hole in its middle, which is the origin.

    Rays go from the hole to the square of side `width` around it; outside of that square, where the rectangle is
    longer than wide, are `beyond` columns of elements to each end.

    Parameters
    ----------
    length, width, diameter : float
        m; the length is along x and at least the width.
    around : int
        Elements round a quarter of the hole; even, since one half ends at the side of the square, the other at its top.
    radial : int
        Elements from the hole to the square.
    growth : float
        Size of the outermost element of a ray over that of the one at the hole.
    beyond : int
        Columns of elements between the square and each end; 0 where length and width are equal.
    quadrant : bool
        The quarter with x and y above 0 only.

    Raises
    ------
    ValueError
        If a number is out of range.
    """
    _check_positive(length=length, width=width, diameter=diameter, growth=growth)
    _check_count(around=around, radial=radial)
    if around % 2:
        raise ValueError(f"around is {around}; it must be even")
    if not diameter < width:
        raise ValueError(f"diameter is {diameter:g} m; it must be less than the width, {width:g} m")
    if length < width * (1.0 - _SAME):
        raise ValueError(f"length is {length:g} m; it must be at least the width, {width:g} m")
    longer = length > width * (1.0 + _SAME)
    if longer != (beyond > 0):
        wanted = "at least 1, since the length exceeds the width" if longer else "0, since length and width are equal"
        raise ValueError(f"beyond is {beyond}; it must be {wanted}")
    half, radius = 0.5 * width, 0.5 * diameter
    share = graded(radial, growth)
    side = np.linspace(0.0, half, around // 2 + 1)
    # To the side x = half, and to the top y = half; the angle at the hole goes on evenly.
    parts = []
    for first, border in (
        (0.0, np.stack([np.full_like(side, half), side], axis=-1)),
        (0.25 * np.pi, np.stack([side[::-1], np.full_like(side, half)], axis=-1)),
    ):
        angle = first + np.linspace(0.0, 0.25 * np.pi, len(side))
        hole = radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        parts.append(_block(hole[None] + share[:, None, None] * (border - hole)[None]))
    if longer:
        # The first column beyond is as wide as the last element of a ray, the others grow to the end evenly.
        across = half + (0.5 * length - half) * graded(beyond, _growth_from(beyond, 0.5 * length - half, side[1]))
        x, y = np.meshgrid(across, side, indexing="ij")
        parts.append(_block(np.stack([x, y], axis=-1)))
    quarter = joined(parts)
    if quadrant:
        return quarter
    upper = joined([quarter, mirrored(quarter, 0)])
    return joined([upper, mirrored(upper, 1)])


def graded(count: int, growth: float) -> NDArray[np.float64]:
    """Places from 0 to 1 of `count` intervals in geometric series, the last `growth` times the first."""
    if count == 1:
        return np.array([0.0, 1.0])
    sizes = growth ** (np.arange(count) / (count - 1))
    return np.concatenate([[0.0], np.cumsum(sizes) / sizes.sum()])


def _growth_from(count: int, extent: float, first: float) -> float:
    """Growth for which the first of `count` intervals over an extent has a size, within 1 to 1000."""
    low, high = 1.0, 1000.0
    if count == 1 or extent / count <= first:
        return 1.0
    for _ in range(60):
        middle = np.sqrt(low * high)
        if extent * graded(count, middle)[1] > first:
            low = middle
        else:
            high = middle
    return float(low)


def _block(points: NDArray[np.float64]) -> PlaneMesh:
    """Mesh of a grid of points, shape (first, second, 2), which turns counterclockwise from first to second."""
    number = np.arange(points.shape[0] * points.shape[1]).reshape(points.shape[:2])
    corners = [number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]]
    return PlaneMesh(points.reshape(-1, 2), np.stack(corners, axis=-1).reshape(-1, 4).astype(np.int64))


def mirrored(mesh: PlaneMesh, axis: int) -> PlaneMesh:
    """The mesh with one coordinate turned over, counterclockwise again."""
    nodes = mesh.nodes.copy()
    nodes[:, axis] *= -1.0
    return PlaneMesh(nodes, np.ascontiguousarray(mesh.elements[:, ::-1]))


def joined(meshes: list[PlaneMesh]) -> PlaneMesh:
    """One mesh, in which nodes at the same place are one."""
    nodes = np.concatenate([mesh.nodes for mesh in meshes])
    starts = np.cumsum([0] + [len(mesh.nodes) for mesh in meshes[:-1]])
    elements = np.concatenate([mesh.elements + start for mesh, start in zip(meshes, starts, strict=True)])
    tree = scipy.spatial.cKDTree(nodes)
    near = _SAME * float(np.ptp(nodes, axis=0).max())
    lowest = np.array([min(group) for group in tree.query_ball_point(nodes, near)])
    kept, place = np.unique(lowest, return_inverse=True)
    return PlaneMesh(np.ascontiguousarray(nodes[kept]), place.reshape(-1)[elements].astype(np.int64))


def _check_positive(**values: float) -> None:
    for name, value in values.items():
        if not (np.isfinite(value) and value > 0.0):
            raise ValueError(f"{name} is {value}; it must be finite and greater than 0")


def _check_count(**values: int) -> None:
    for name, value in values.items():
        if value < 1:
            raise ValueError(f"{name} is {value}; it must be at least 1")
