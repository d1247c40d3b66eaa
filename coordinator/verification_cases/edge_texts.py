"""Edges of a scene whose motion rises smoothly, as text to add to a scene."""

from __future__ import annotations

from typing import Literal

import numpy as np

from protocol.arrays import FloatArray

Edge = Literal["left", "right", "bottom", "top"]

ANGSTROM = 1e-10
PICOSECOND = 1e-12
#: Rows of a table: linear pieces between them are short against any wave that the grid carries.
_ROWS = 25


def smooth_rise(end: float, rise: float) -> tuple[FloatArray, FloatArray]:
    """Return times, s, and values of s^3 (10 - 15 s + 6 s^2), which begins and ends without acceleration.

    Parameters
    ----------
    end : float
        Last value.
    rise : float
        Duration, s.
    """
    s = np.linspace(0.0, 1.0, _ROWS)
    return rise * s, end * s**3 * (10.0 - 15.0 * s + 6.0 * s**2)


def edge_text(edge: Edge, component: Literal["x", "y"], end: float, rise: float) -> str:
    """Return a table `[[continuum.edges]]` that moves an edge by `end`, m, within `rise`, s, and holds it there."""
    times, values = smooth_rise(end, rise)
    rows = ", ".join(f'"{time / PICOSECOND:.6g} ps"' for time in times)
    ways = ", ".join(f'"{value / ANGSTROM:.9g} angstrom"' for value in values)
    return (
        f'\n[[continuum.edges]]\nedge = "{edge}"\ncomponent = "{component}"\n'
        f"times = [{rows}]\ndisplacements = [{ways}]\n"
    )


def gradient_text(gradient: FloatArray, half: float, rise: float) -> str:
    """Return edges that bring a square body to a uniform displacement gradient, exactly in linear elasticity.

    The normal component is prescribed on all edges and, with a gradient dx/dy or dy/dx, the tangential one on the edges
    where that is uniform. What is left free has no traction in the uniform solution: the gradient must be a stretch along
    the axes, or dx/dy or both shears without stretch.

    Parameters
    ----------
    gradient : float64 array, shape (2, 2)
        du_i / dX_j.
    half : float
        Half the side of the body, m.
    rise : float
        s.
    """
    stretched = gradient[0, 0] != 0.0 or gradient[1, 1] != 0.0
    text = ""
    for edge, axis, sign in (("left", 0, -1.0), ("right", 0, 1.0), ("bottom", 1, -1.0), ("top", 1, 1.0)):
        for component in (0, 1):
            way = sign * half * float(gradient[component, axis])
            if (component == axis) == stretched:
                text += edge_text(edge, "xy"[component], way, rise)  # type: ignore[arg-type]
    return text
