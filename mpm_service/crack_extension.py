"""Whether a crack may go on along corners that someone outside states."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .crack_ends import CellAt
from .crack_line import meets_line

FloatArray = NDArray[np.float64]

# Places nearer to each other than this are the same [cells].
_SAME_PLACE = 1e-6
# A line that ends on the edge of the body goes on this far, as grid functions do [cells].
_BEYOND = 3.0


def check_extension(
    lines: Sequence[FloatArray],
    joined: set[tuple[int, int]],
    crack: int,
    end: int,
    points: ArrayLike,
    body: tuple[FloatArray, FloatArray],
    cell_at: CellAt,
) -> FloatArray:
    """Return the corners (k, 2) by which an end of a crack may be extended.

    Where the last lies on the edge of the body there is one more, beyond it, so that the body is cut through.

    Parameters
    ----------
    lines : sequence of (n, 2) ndarray
        All cracks.
    joined : set of (int, int)
        Ends (crack, end) that lie on another crack.
    crack, end : int
        What is to be extended. It need not have material ahead: it may lie in a hole.
    points : (k, 2) array_like
        Corners [m].
    body : (lower, upper)
        Corners of the body [m].
    cell_at : callable
        Cell size around places.

    Raises
    ------
    ValueError
        If there is no such end, a corner lies outside the body, or the line to one meets another crack. The message
        begins with ``crack``, ``end`` or ``points``.
    """
    if not 0 <= crack < len(lines):
        raise ValueError(f"crack = {crack!r}: there are {len(lines)} cracks, numbered from 0")
    if end not in (0, 1):
        raise ValueError(f"end = {end!r}: 0 (first point of the line) or 1 (last) is needed")
    lower, upper = body
    tip = lines[crack][-end]
    if (crack, end) in joined:
        raise ValueError(f"end = {end}: crack {crack} ends on another crack there, which is no tip")
    if not np.all((tip > lower) & (tip < upper)):
        raise ValueError(f"end = {end}: crack {crack} ends at {tip.tolist()} m there, which is not inside the body")
    corners = np.array(points, dtype=np.float64)
    if corners.ndim != 2 or corners.shape[0] < 1 or corners.shape[1] != 2 or not np.all(np.isfinite(corners)):
        raise ValueError(f"points = {points!r}: at least one corner of two finite numbers [m] is needed")
    way = np.concatenate([tip[None], corners])
    slack = _SAME_PLACE * float(cell_at(way).min())
    for k, corner in enumerate(corners):
        if np.any((corner < lower) | (corner > upper)):
            raise ValueError(
                f"points[{k}] = {corner.tolist()} m: lies outside the body, which spans {lower.tolist()} to "
                f"{upper.tolist()} m"
            )
        for other, line in enumerate(lines):
            if other != crack and meets_line(way[k : k + 2], line, slack):
                raise ValueError(
                    f"points[{k}] = {corner.tolist()} m: the line to it meets crack {other}; it must end before it"
                )
    if np.any(np.minimum(corners[-1] - lower, upper - corners[-1]) <= slack):
        along = way[-1] - way[-2]
        out = _BEYOND * float(cell_at(way[-1:])[0]) * along / np.hypot(*along)
        return np.concatenate([corners, corners[-1:] + out])
    return corners
