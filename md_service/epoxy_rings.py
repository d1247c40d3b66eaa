"""Aromatic rings, and bonds that pass through them.

A bond through a ring ("spearing") is a knot that no dynamics of intact bonds can undo, and that chemistry does not
make. It comes from bonding two atoms over the top of a ring, so it is looked for before and after each reaction.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from md_service.atoms import Atoms, Box
from md_service.epoxy_typing import BondGraph, bonds_of, graph_of

_RING = 6
_REACH = 1.8e-10  # m, farthest that the edge of a ring lies from its centre


def aromatic_rings(graph: BondGraph) -> NDArray[np.int64]:
    """Six-membered rings of planar carbon, atoms in their order along the ring, shape (rings, 6)."""
    rings: list[list[int]] = []

    def extend(path: list[int]) -> None:
        for other in graph.neighbours[path[-1]]:
            if len(path) == _RING:
                if other == path[0] and path[1] < path[-1]:  # each ring is walked both ways, keep one
                    rings.append(path)
            elif other > path[0] and other not in path and graph.is_planar_carbon(other):
                extend([*path, other])

    for atom in range(len(graph.elements)):
        if graph.is_planar_carbon(atom):
            extend([atom])
    return np.array(rings, dtype=np.int64).reshape(-1, _RING)


def speared_rings(atoms: Atoms) -> list[tuple[tuple[int, int], tuple[int, ...]]]:
    """Bonds of a sample that pass through an aromatic ring.

    Returns
    -------
    list of (bond, ring)
        Rows of the two bonded atoms, and of the six atoms of the ring.
    """
    rings = aromatic_rings(graph_of(atoms))
    return crossings(atoms.position, atoms.box, bonds_of(atoms), rings)


def crossings(
    position: NDArray[np.float64], box: Box, segments: NDArray[np.int64], rings: NDArray[np.int64]
) -> list[tuple[tuple[int, int], tuple[int, ...]]]:
    """Straight segments between pairs of atoms that pass through rings.

    A ring is the fan of triangles between its centre and its edges, so it need not be flat. A segment that starts at
    an atom of the ring does not count.

    Parameters
    ----------
    position : ndarray, shape (n, 3)
        m.
    box : Box
        The nearest images are taken along its periodic directions.
    segments : ndarray of int64, shape (m, 2)
        Rows of the atoms at the ends.
    rings : ndarray of int64, shape (k, 6)

    Returns
    -------
    list of (segment, ring)
        Rows of the atoms.
    """
    if not len(segments) or not len(rings):
        return []
    corner = position[rings]
    corner = corner[:, :1] + nearest_image(corner - corner[:, :1], box)
    centre = corner.mean(axis=1)
    start = position[segments[:, 0]]
    along = nearest_image(position[segments[:, 1]] - start, box)
    segment, ring = _near(start + 0.5 * along, np.linalg.norm(along, axis=1).max(), centre, box)
    apart = ~(segments[segment][:, :, None] == rings[ring][:, None, :]).any(axis=(1, 2))
    segment, ring = segment[apart], ring[apart]

    a = centre[ring]
    origin = nearest_image(start[segment] + 0.5 * along[segment] - a, box) - 0.5 * along[segment]
    hit = np.zeros(len(segment), dtype=bool)
    for edge in range(_RING):
        hit |= _through_triangle(origin, along[segment], corner[ring, edge] - a, corner[ring, (edge + 1) % _RING] - a)
    return [
        ((int(segments[s, 0]), int(segments[s, 1])), tuple(rings[r].tolist()))
        for s, r in zip(segment[hit], ring[hit], strict=True)
    ]


def nearest_image(vector: NDArray[np.float64], box: Box) -> NDArray[np.float64]:
    """Vectors (..., 3) shortened by whole edges of a box that is not sheared, m."""
    edge = np.where(box.periodic, box.high - box.low, np.inf)
    return vector - np.where(np.isfinite(edge), edge, 0.0) * np.round(vector / edge)


def _near(
    middle: NDArray[np.float64], length: float, centre: NDArray[np.float64], box: Box
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pairs of segments and rings that are close enough to meet."""
    reach = 0.5 * length + _REACH
    pairs = periodic_tree(middle, box).query_ball_tree(periodic_tree(centre, box), reach)
    segment = np.repeat(np.arange(len(middle)), [len(row) for row in pairs])
    ring = np.array([r for row in pairs for r in row], dtype=np.int64)
    return segment.astype(np.int64), ring


def periodic_tree(points: NDArray[np.float64], box: Box) -> cKDTree:
    """Search tree of points (n, 3), m, that sees the nearest images of a box that is not sheared."""
    period = np.where(box.periodic, box.high - box.low, 0.0)
    inside = box.wrapped(points)[0] - box.low
    # Rounding may put a point on the far face, which the tree does not take.
    inside = np.where(np.array(box.periodic) & (inside >= period), 0.0, inside)
    return cKDTree(np.where(box.periodic, np.maximum(inside, 0.0), inside), boxsize=period)


def _through_triangle(
    origin: NDArray[np.float64], along: NDArray[np.float64], e1: NDArray[np.float64], e2: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Whether segments cross the triangles (0, e1, e2), after Moeller and Trumbore, shape (n,)."""
    h = np.cross(along, e2)
    determinant = np.einsum("ij,ij->i", e1, h)
    parallel = np.abs(determinant) < 1e-12 * np.linalg.norm(along, axis=1) * np.linalg.norm(np.cross(e1, e2), axis=1)
    inverse = 1.0 / np.where(parallel, 1.0, determinant)
    u = inverse * np.einsum("ij,ij->i", origin, h)
    q = np.cross(origin, e1)
    v = inverse * np.einsum("ij,ij->i", along, q)
    t = inverse * np.einsum("ij,ij->i", e2, q)
    inside: NDArray[np.bool_] = ~parallel & (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (t >= 0.0) & (t <= 1.0)
    return inside
