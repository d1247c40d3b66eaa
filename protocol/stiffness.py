"""What makes a stiffness that of a stable material: one test for messages and solvers."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

#: Smallest eigenvalue that a stiffness may have after its diagonal was scaled to ones.
LEAST_STABLE: Final = 1e-14
#: Largest difference between a stiffness and its transpose, over its largest entry.
MOST_UNSYMMETRIC: Final = 1e-9


def stiffness_problem(matrix: NDArray[np.float64]) -> str | None:
    """Say what is wrong with a stiffness, as the end of a sentence that begins with its name.

    Parameters
    ----------
    matrix : ndarray of float, shape (6, 6)
        Pa; finite.

    Returns
    -------
    str or None
        None if it is symmetric and positive definite.
    """
    if np.abs(matrix - matrix.T).max() > MOST_UNSYMMETRIC * np.abs(matrix).max():
        return "is not symmetric"
    diagonal = np.diag(matrix)
    if not (diagonal > 0.0).all():
        return f"has {diagonal.min():g} Pa on its diagonal; it must be positive definite"
    scale = 1.0 / np.sqrt(diagonal)
    with np.errstate(over="ignore", invalid="ignore"):
        scaled = matrix * scale[:, None] * scale[None, :]
    if not np.isfinite(scaled).all() or not float(np.linalg.eigvalsh(scaled)[0]) > LEAST_STABLE:
        return "is not positive definite: some strain would release energy"
    return None
