"""Straight slits in flat samples, cut by removing atoms."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from md_service.atoms import CrackCut


def shift_to_slit(middles: NDArray[np.float64], crack: CrackCut) -> float:
    """How far a lattice moves along y, m, until one of the lines between its rows lies exactly on the crack.

    Parameters
    ----------
    middles : ndarray, shape (k,)
        Heights at which a slit may lie in the lattice, m, ascending.
    crack : CrackCut
        Whose height is wanted.

    Raises
    ------
    ValueError
        If the crack is not between the lowest and the highest of them.
    """
    if not (len(middles) > 0 and middles[0] < crack.y < middles[-1]):
        span = f"from {middles[0]} m to {middles[-1]} m" if len(middles) else "nowhere"
        raise ValueError(f"crack.y is {crack.y} m; in this sample a slit can lie {span} along y")
    return float(crack.y - middles[np.argmin(np.abs(middles - crack.y))])


def in_slit(
    position: NDArray[np.float64], crack: CrackCut, half_height: float, periodic: bool = False
) -> NDArray[np.bool_]:
    """Which atoms a slit removes.

    Parameters
    ----------
    position : ndarray, shape (n, 3)
        m.
    crack : CrackCut
        Ends and height of the slit.
    half_height : float
        Atoms closer than this to the slit's line are removed, m.
    periodic : bool
        Whether the sample repeats along x, where only a slit with two ends can be.

    Returns
    -------
    ndarray of bool, shape (n,)

    Raises
    ------
    ValueError
        If an end of the slit is outside of the sample, the ends are in the wrong order, or no atom is between them.
    """
    x = position[:, 0]
    left = x.min() if crack.left_x is None else crack.left_x
    if crack.left_x is None and periodic:
        raise ValueError("crack.left_x is missing; a sample that repeats along x has no edge at which a slit can start")
    if crack.left_x is not None and not x.min() < left < crack.tip_x:
        raise ValueError(f"crack.left_x is {left} m; it must be between {x.min()} m and the tip at {crack.tip_x} m")
    if not left < crack.tip_x < x.max():
        raise ValueError(f"crack.tip_x is {crack.tip_x} m; the sample spans {x.min()} to {x.max()} m along x")
    removed = (np.abs(position[:, 1] - crack.y) < half_height) & (x < crack.tip_x) & (x >= left)
    if not removed.any():
        raise ValueError(f"crack from x = {left} m to {crack.tip_x} m at y = {crack.y} m holds no atom to remove")
    return removed
