"""Tables of distinct tangents, joined so that the result does not depend on how the points were split."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray


def join_tables(
    parts: Sequence[tuple[NDArray[np.int64], NDArray[np.float64]]],
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Join the tables of contiguous parts of the points.

    Tangents are the same where their bits are. Each stands once, in the order in which the points first use it; so
    any split of the points gives the same bits, provided that each part's table is in that order too.

    Parameters
    ----------
    parts : sequence of (index, tangents)
        Of shape (points,) and (tangents, 6, 6), Pa.

    Returns
    -------
    index : ndarray of int64, shape (all points,)
    tangents : ndarray of float, shape (all tangents, 6, 6)
    """
    row_of: dict[bytes, int] = {}
    found: list[NDArray[np.float64]] = []
    indices = []
    for index, tangents in parts:
        rows = np.empty(len(tangents), np.int64)
        for number, tangent in enumerate(tangents):
            row = row_of.setdefault(tangent.tobytes(), len(found))
            if row == len(found):
                found.append(tangent)
            rows[number] = row
        same = len(rows) == 0 or (rows[0] == 0 and bool((np.diff(rows) == 1).all()))
        indices.append(index if same else rows[index])
    # Copied only where it must be: an index of a million points has 8 MB.
    index = indices[0] if len(indices) == 1 else np.concatenate(indices)
    if len(parts) == 1 and len(found) == len(parts[0][1]):
        return index, parts[0][1]
    return index, np.array(found).reshape(-1, 6, 6)
