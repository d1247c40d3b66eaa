"""Grips of a tension test, by the symmetries that a laminate has."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fem_service.equilibrium import Grips
from fem_service.laminate_mesh import LaminateMesh

#: Part of the laminate's extent within which a node lies on a face.
_ON = 1e-9


def tension_grips(mesh: LaminateMesh, *, quarter: bool = False, lower_half: bool = False) -> Grips:
    """Pull along x: at a load of 1 the two ends part by one metre.

    Parameters
    ----------
    mesh : LaminateMesh
    quarter : bool
        The mesh is the quarter with x and y above 0, held by its planes of symmetry; its end moves by half a metre.
    lower_half : bool
        The mesh is the half below the middle plane, which holds its upper face.

    Returns
    -------
    Grips
        Ends are free to contract; what could still move as a whole is held at single nodes, which feel no force.
    """
    nodes = mesh.nodes
    low, high = nodes.min(axis=0), nodes.max(axis=0)
    near = _ON * float((high - low).max())

    def on(axis: int, value: float) -> NDArray[np.int64]:
        return np.flatnonzero(np.abs(nodes[:, axis] - value) <= near)

    held: dict[int, float] = {}

    def hold(which: NDArray[np.int64], axis: int, value: float) -> None:
        held.update(dict.fromkeys((3 * which + axis).tolist(), value))

    hold(on(0, high[0]), 0, 0.5)
    hold(on(0, low[0]), 0, 0.0 if quarter else -0.5)
    # Two corners of one end. The straight ends keep the laminate from turning about y and z.
    edge = np.intersect1d(on(0, low[0]), on(2, low[2]))
    first, last = (edge[[place(nodes[edge, 1])]] for place in (np.argmin, np.argmax))
    if quarter:
        hold(on(1, low[1]), 1, 0.0)
    else:
        hold(first, 1, 0.0)
    if lower_half:
        hold(on(2, high[2]), 2, 0.0)
    else:
        hold(first, 2, 0.0)
        if not quarter:  # whose planes of symmetry keep it from turning about x already
            hold(last, 2, 0.0)
    freedoms = np.array(sorted(held), dtype=np.int64)
    return Grips(freedoms, np.array([held[int(freedom)] for freedom in freedoms]))
