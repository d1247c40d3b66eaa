"""Strain, stress and stiffness between the axes of the laminate and those of a ply turned about axis 3 (z).

The ply's axis 1, its fibre, points at `angle` from x towards y. Order 11, 22, 33, 23, 13, 12, engineering shear.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def strain_to_ply(angle: float) -> NDArray[np.float64]:
    """Matrix T with strain in the ply = T strain in the laminate.

    The stress in the laminate is T^T stress in the ply, since both make the same work, and the stiffness there T^T C T.

    Parameters
    ----------
    angle : float
        rad.

    Returns
    -------
    ndarray, shape (6, 6)
    """
    c, s = np.cos(angle), np.sin(angle)
    return np.array(
        [
            [c * c, s * s, 0.0, 0.0, 0.0, c * s],
            [s * s, c * c, 0.0, 0.0, 0.0, -c * s],
            [0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
            [0.0, 0.0, 0.0, c, -s, 0.0],
            [0.0, 0.0, 0.0, s, c, 0.0],
            [-2.0 * c * s, 2.0 * c * s, 0.0, 0.0, 0.0, c * c - s * s],
        ]
    )
