"""Stress intensity of an edge-cracked rectangular plate by boundary collocation: exact, and with no grid.

All plane fields with free faces on a straight crack are Williams' series; with symmetry about the crack,

    phi = sum a_n z^(n/2),   psi = -sum (n/2 + (-1)^n) a_n z^(n/2),   a_n real,
    s_xx + s_yy = 4 Re phi',   s_yy - s_xx + 2 i s_xy = 2 (conj(z) phi'' + psi').

The a_n that meet the tractions on the plate's outer faces best give K_I = sqrt(2 pi) a_1 (Gross, Srawley, Brown 1964).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def edge_crack_factor(share: float, height: float, terms: int = 60, places: int = 200) -> float:
    """K_I over ``stress sqrt(pi length)`` of a plate under uniform tractions on top and bottom.

    Parameters
    ----------
    share : float
        Crack length over width.
    height : float
        Height over width; the crack lies at half of it.
    terms, places : int
        Of the series, and on each outer face.
    """
    part = (np.arange(places) + 0.5) / places
    left, right, half = -share, 1.0 - share, 0.5 * height
    top = left + part + 1j * half
    sides = [(x + 1j * half * part) for x in (left, right)]
    z = np.concatenate([top, *sides])
    is_top = np.arange(z.size) < places
    n = np.arange(1, terms + 1)[None, :]
    reach = np.abs(z).max()
    power = np.exp(0.5 * n * np.log(z / reach)[:, None]) / z[:, None]  # z^(n/2 - 1), scaled
    first = 0.5 * n * power
    second = 0.5 * n * (0.5 * n - 1.0) * power / z[:, None]
    psi = -(0.5 * n + (-1.0) ** n) * 0.5 * n * power
    mean = 2.0 * first.real
    rest = np.conj(z)[:, None] * second + psi
    across = np.where(is_top[:, None], mean + rest.real, mean - rest.real)
    wanted = np.concatenate([is_top.astype(np.float64), np.zeros(z.size)])
    found, *_ = np.linalg.lstsq(np.concatenate([across, rest.imag]), wanted, rcond=1e-13)
    return float(np.sqrt(2.0 * np.pi) * found[0] / np.sqrt(reach) / np.sqrt(np.pi * share))
