"""Smooth fields through atoms: weighted least squares fits of a polynomial, as sparse matrices.

Around each point a quadratic polynomial is fitted to the values of the near atoms, with Gaussian weights. The fitted
value and gradient are linear in the atoms' values, so they are matrices that depend on the reference positions only.
Any quadratic field comes back exactly, whatever the places of the atoms.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

_REACH = 2.5  # widths; the weight is down to 0.2 % there
_TERMS = 6
_WORST_CONDITION = 1e8
_CHUNK = 512  # points fitted at once


@dataclass(frozen=True)
class Slit:
    """A straight crack that comes from -x.

    Attributes
    ----------
    tip_x, y : float
        Its tip, m.
    half_gap : float
        Distance from the middle line to the edge of the material on either side, m.
    """

    tip_x: float
    y: float
    half_gap: float = 0.0

    def hides(self, points: NDArray[np.float64], others: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Whether the line from each point to each other, shape (..., 2), crosses the slit."""
        from_y, to_y = points[..., 1] - self.y, others[..., 1] - self.y
        opposite = from_y * to_y < 0.0
        fraction = from_y / np.where(opposite, from_y - to_y, 1.0)
        crossing = points[..., 0] + fraction * (others[..., 0] - points[..., 0])
        return opposite & (crossing < self.tip_x)


@dataclass(frozen=True)
class Fit:
    """Matrices from values at atoms to fitted values and gradients at points.

    Attributes
    ----------
    value, by_x, by_y : csr_matrix, shape (points, atoms)
        The derivatives in 1/m.
    """

    value: csr_matrix
    by_x: csr_matrix
    by_y: csr_matrix


def fit(
    points: NDArray[np.float64],
    atoms: NDArray[np.float64],
    width: float,
    slit: Slit | None = None,
    without: NDArray[np.int64] | None = None,
) -> Fit:
    """Fit polynomials around points.

    Parameters
    ----------
    points, atoms : ndarray, shape (p, 2), (n, 2)
        Places in the reference configuration, m. Atoms above each other in z share a place.
    width : float
        Length over which the Gaussian weight ``exp(-(r/width)^2)`` falls by e, m.
    slit : Slit, optional
        Atoms on its other side have no part in a fit, so that fits next to a crack are one-sided.
    without : ndarray of int64, optional
        Rows of atoms that have no part in any fit.

    Returns
    -------
    Fit

    Raises
    ------
    ValueError
        If a point has too few atoms around it.
    """
    if not (np.isfinite(width) and width > 0.0):
        raise ValueError(f"width is {width} m; it must be positive and finite")
    used = np.ones(len(atoms), dtype=bool)
    if without is not None:
        used[without] = False
    rows = np.flatnonzero(used)
    lists = cKDTree(atoms[rows]).query_ball_point(points, _REACH * width)
    entries, columns, owners = [], [], []
    for start in range(0, len(points), _CHUNK):
        part = lists[start : start + _CHUNK]
        place = points[start : start + _CHUNK, None, :]
        counts = np.array([len(near) for near in part])
        filled = np.arange(counts.max(initial=1)) < counts[:, None]
        near = np.zeros(filled.shape, dtype=np.int64)
        near[filled] = rows[np.concatenate([np.asarray(one, dtype=np.int64) for one in part])]
        if slit is not None:
            filled &= ~slit.hides(place, atoms[near])
        entries.append(_coefficients((atoms[near] - place) / width, filled, place[:, 0])[:, filled])
        columns.append(near[filled])
        owners.append(start + np.nonzero(filled)[0])
    owner, column = np.concatenate(owners), np.concatenate(columns)
    value, by_x, by_y = (
        csr_matrix((entry, (owner, column)), shape=(len(points), len(atoms)))
        for entry in np.concatenate(entries, axis=1)
    )
    return Fit(value, by_x / width, by_y / width)


def _coefficients(
    offset: NDArray[np.float64], filled: NDArray[np.bool_], place: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Coefficients (3, p, k) of value and derivatives for atoms at offsets (p, k, 2) in widths."""
    x, y = offset[..., 0], offset[..., 1]
    basis = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)
    weighted = basis * (filled * np.exp(-(x * x + y * y)))[..., None]
    normal = np.swapaxes(weighted, 1, 2) @ basis
    with np.errstate(divide="ignore"):
        bad = ~(np.linalg.cond(normal) < _WORST_CONDITION)
    if bad.any():
        worst = int(np.argmax(bad))
        raise ValueError(
            f"the {int(filled[worst].sum())} atoms around the point ({place[worst, 0]:.4g}, {place[worst, 1]:.4g}) m "
            f"do not suffice for a fit with {_TERMS} terms; keep contours inside of the atoms or take a larger width"
        )
    # The normal matrix is symmetric, so the first rows of its inverse are the first columns.
    first = np.linalg.solve(normal, np.broadcast_to(np.eye(_TERMS, 3), (len(normal), _TERMS, 3)))
    return np.ascontiguousarray(np.moveaxis(weighted @ first, 2, 0))
