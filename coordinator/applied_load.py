"""The load that the moved edges of a scene put on its body, from their tables."""

from __future__ import annotations

import math

import numpy as np

from coordinator.edge_motion import table_value
from coordinator.scene import Scene
from coordinator.strip import strip_j
from protocol.arrays import FloatArray
from protocol.continuum import IsotropicMaterial

#: What the load of a scene is called.
STRAIN, FACTOR, TIME = "applied strain", "factor of the crack-tip field", "time (s)"


def load_of(scene: Scene, material: IsotropicMaterial, time: FloatArray) -> tuple[str, FloatArray, FloatArray]:
    """Return what the load of a scene is, its course and the J that it stands for.

    Parameters
    ----------
    time : float64 array, shape (rows,)
        s.

    Returns
    -------
    name : str
    load, j : float64 array, shape (rows,)
        J in J/m2 is that of a long crack in a strip (Rivlin and Thomas), or K^2 / E* of a crack-tip field; NaN
        where the scene has neither.
    """
    body = scene.continuum
    nothing = np.full(len(time), math.nan)
    for edge in body.edges:
        if edge.kind == "k_field":
            assert edge.field is not None
            factor = np.array([table_value(edge, now) for now in time])
            stiff = material.young
            if body.assumption == "plane_strain":
                stiff /= 1 - material.poisson**2
            intensity = np.hypot(edge.field.k_1, edge.field.k_2) * factor
            return FACTOR, factor, intensity**2 / stiff
    moved = {(edge.edge, edge.axis): edge for edge in body.edges if edge.moves}
    top, bottom = moved.get(("top", 1)), moved.get(("bottom", 1))
    if top is None or bottom is None:
        return TIME, time, nothing
    height = body.upper[1] - body.lower[1]
    strain = np.array([table_value(top, now) - table_value(bottom, now) for now in time]) / height
    if scene.crack is None:
        return STRAIN, strain, nothing
    free = ("top", 0) not in moved
    j = [strip_j(material, body.assumption, float(value), height, sideways_free=free) for value in strain]
    return STRAIN, strain, np.array(j)
