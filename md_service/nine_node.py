"""The nine-node quadratic element that carries atomistic values to the points of a J contour (Eq 78).

Nodes in the order of Eq 78, xi to the right and eta upwards::

    4---7---3
    |       |
    8   9   6
    |       |
    1---5---2

The eighth function is printed with a wrong factor in Eq 78; here ``N_8 = -1/2 xi (1 - xi) (1 - eta) (1 + eta)``.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

#: Local coordinates (xi, eta) of the nodes, shape (9, 2).
NODES: Final = np.array(
    [[-1, -1], [1, -1], [1, 1], [-1, 1], [0, -1], [1, 0], [0, 1], [-1, 0], [0, 0]], dtype=np.float64
)

#: Local coordinates and weights of the three Gauss points of a segment (Eq 77), shape (3,).
GAUSS_POINTS: Final = np.array([-np.sqrt(0.6), 0.0, np.sqrt(0.6)])
GAUSS_WEIGHTS: Final = np.array([5.0, 8.0, 5.0]) / 9.0


def shape_functions(xi: ArrayLike, eta: ArrayLike) -> NDArray[np.float64]:
    """Shape functions (Eq 78).

    Parameters
    ----------
    xi, eta : array_like, shape (...)
        Local coordinates, from -1 to 1.

    Returns
    -------
    ndarray, shape (..., 9)
    """
    along, across = _lagrange(xi), _lagrange(eta)
    return np.stack([along[i] * across[j] for i, j in _COLUMNS], axis=-1)


def shape_gradients(xi: ArrayLike, eta: ArrayLike) -> NDArray[np.float64]:
    """Derivatives of the shape functions by xi and eta.

    Parameters
    ----------
    xi, eta : array_like, shape (...)
        Local coordinates, from -1 to 1.

    Returns
    -------
    ndarray, shape (..., 9, 2)
    """
    along, across = _lagrange(xi), _lagrange(eta)
    d_along, d_across = _lagrange_derivative(xi), _lagrange_derivative(eta)
    return np.stack([np.stack([d_along[i] * across[j], along[i] * d_across[j]], axis=-1) for i, j in _COLUMNS], axis=-2)


# The functions of Eq 78 are products of the quadratic Lagrange polynomials of the places -1, 0 and 1.
_COLUMNS = [(int(xi) + 1, int(eta) + 1) for xi, eta in NODES]


def _lagrange(s: ArrayLike) -> list[NDArray[np.float64]]:
    s = np.asarray(s, dtype=np.float64)
    return [-0.5 * s * (1.0 - s), (1.0 - s) * (1.0 + s), 0.5 * s * (1.0 + s)]


def _lagrange_derivative(s: ArrayLike) -> list[NDArray[np.float64]]:
    s = np.asarray(s, dtype=np.float64)
    return [s - 0.5, -2.0 * s, s + 0.5]
