"""Bricks of a laminate: a mesh in the plane, stacked by plies, with or without cohesive layers between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fem_service.plane_mesh import PlaneMesh


@dataclass(frozen=True, eq=False)
class LaminateMesh:
    """A laminate of bricks.

    Attributes
    ----------
    nodes : ndarray of float, shape (nodes, 3)
        m; z is 0 at the lower face.
    bricks : ndarray of int64, shape (bricks, 8)
        See `fem_service.hexahedron`.
    ply : ndarray of int64, shape (bricks,)
        Ply of each brick, from the lowest up.
    layers : ndarray of int64, shape (layers, 8)
        Cohesive elements: four nodes of the lower face, then the four of the upper one at the same places.
    interface : ndarray of int64, shape (layers,)
        Interface of each, that above ply 0 is 0.
    angles : ndarray of float, shape (plies,)
        rad.
    """

    nodes: NDArray[np.float64]
    bricks: NDArray[np.int64]
    ply: NDArray[np.int64]
    layers: NDArray[np.int64]
    interface: NDArray[np.int64]
    angles: NDArray[np.float64]


def stack(
    plane: PlaneMesh,
    angles: NDArray[np.float64],
    thickness: float,
    *,
    per_ply: int = 1,
    cohesive: bool = False,
) -> LaminateMesh:
    """Stack plies of equal thickness.

    Parameters
    ----------
    plane : PlaneMesh
    angles : ndarray of float, shape (plies,)
        rad, from the lowest ply up.
    thickness : float
        Of one ply, m.
    per_ply : int
        Bricks through a ply.
    cohesive : bool
        Whether plies of different angle are joined by cohesive elements of no thickness; others share their nodes.

    Returns
    -------
    LaminateMesh

    Raises
    ------
    ValueError
        If the thickness is not positive or a count is below one.
    """
    if not (np.isfinite(thickness) and thickness > 0.0):
        raise ValueError(f"thickness is {thickness}; it must be finite and greater than 0")
    if per_ply < 1 or not len(angles):
        raise ValueError(f"per_ply is {per_ply} and there are {len(angles)} plies; both must be at least 1")
    count = len(plane.nodes)
    levels: list[float] = [0.0]
    bricks, ply, layers, interface = [], [], [], []
    for number, angle in enumerate(angles):
        if number and cohesive and angle != angles[number - 1]:
            below = plane.elements + (len(levels) - 1) * count
            levels.append(levels[-1])
            layers.append(np.concatenate([below, below + count], axis=1))
            interface.append(np.full(len(below), number - 1))
        for part in range(per_ply):
            below = plane.elements + (len(levels) - 1) * count
            levels.append((number + (part + 1) / per_ply) * thickness)
            bricks.append(np.concatenate([below, below + count], axis=1))
            ply.append(np.full(len(below), number))
    nodes = np.concatenate([np.column_stack([plane.nodes, np.full(count, level)]) for level in levels])
    return LaminateMesh(
        nodes=nodes,
        bricks=np.concatenate(bricks),
        ply=np.concatenate(ply),
        layers=np.concatenate(layers) if layers else np.zeros((0, 8), dtype=np.int64),
        interface=np.concatenate(interface) if interface else np.zeros(0, dtype=np.int64),
        angles=np.asarray(angles, dtype=np.float64),
    )
