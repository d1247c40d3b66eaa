"""Edges of a scene that strain or turn a square body uniformly, as text to add to the scene."""

from __future__ import annotations

import numpy as np

from protocol.arrays import FloatArray

ANGSTROM = 1e-10
PICOSECOND = 1e-12
#: Rows of a table: linear pieces between them are short against any wave that the grid carries.
_ROWS = 25


def edge_text(edge: str, component: str, way: float, rise: float = 0.0) -> str:
    """Return a table `[[continuum.edges]]`.

    Parameters
    ----------
    edge : {"left", "right", "bottom", "top"}
    component : {"x", "y"}
    way : float
        Displacement of the edge at last, m.
    rise : float
        Time in which it is reached, without acceleration at either end, s; 0 where it is there from the start.
    """
    s = np.linspace(0.0, 1.0, _ROWS if rise else 2)
    values = way * s**3 * (10.0 - 15.0 * s + 6.0 * s**2) if rise else np.full_like(s, way)
    rows = ", ".join(f'"{time / PICOSECOND:.6g} ps"' for time in s * (rise or PICOSECOND))
    ways = ", ".join(f'"{value / ANGSTROM:.9g} angstrom"' for value in values)
    return (
        f'\n[[continuum.edges]]\nedge = "{edge}"\ncomponent = "{component}"\n'
        f"times = [{rows}]\ndisplacements = [{ways}]\n"
    )


def gradient_text(gradient: FloatArray, half: float, rise: float = 0.0) -> str:
    """Return edges that bring a square body to a uniform displacement gradient, exactly in linear elasticity.

    An edge moves along one of its components only, the other is free. With a stretch it is the normal one; without,
    the tangential one. What is free has no traction in the uniform state: the gradient must be a stretch along the
    axes, or have du_x/dy and du_y/dx alone.

    Parameters
    ----------
    gradient : float64 array, shape (2, 2)
        du_i / dX_j.
    half : float
        Half the side of the body, m.
    rise : float
        As of `edge_text`.
    """
    stretched = gradient[0, 0] != 0.0 or gradient[1, 1] != 0.0
    text = ""
    for edge, axis, sign in (("left", 0, -1.0), ("right", 0, 1.0), ("bottom", 1, -1.0), ("top", 1, 1.0)):
        component = axis if stretched else 1 - axis
        text += edge_text(edge, "xy"[component], sign * half * float(gradient[component, axis]), rise)
    return text
