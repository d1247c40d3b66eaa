"""Strain of scattered points by least squares over their neighbourhoods."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from protocol.arrays import FloatArray, IntArray

#: Fewest points in a neighbourhood; a plane through three leaves nothing to average.
_FEWEST = 6
#: Smallest spread of a neighbourhood against the size of a bin, below which its gradient is not determined.
_LEAST_SPREAD = 0.25


@dataclass(frozen=True)
class LocalStrain:
    """Displacement gradients on a coarse grid.

    Attributes
    ----------
    centre : float64 array, shape (bins, 2)
        Centre of each bin, m.
    gradient : float64 array, shape (bins, 2, 2)
        du_i / dX_j.
    count : int64 array, shape (bins,)
        Points in each neighbourhood.
    """

    centre: FloatArray
    gradient: FloatArray
    count: IntArray

    @property
    def yy(self) -> FloatArray:
        """Strain along y, shape (bins,)."""
        strain: FloatArray = self.gradient[:, 1, 1]
        return strain


def local_strain(reference: FloatArray, displacement: FloatArray, size: float) -> LocalStrain:
    """Fit a displacement gradient around every bin of a square grid.

    The neighbourhood of a bin is the bin and the eight around it. All sums are taken bin by bin first,
    so the cost grows with the number of points alone.

    Parameters
    ----------
    reference : float64 array, shape (points, 2)
        Positions without load, m.
    displacement : float64 array, shape (points, 2)
        m.
    size : float
        Edge of a bin, m.

    Returns
    -------
    LocalStrain
        Bins that hold a point and whose neighbourhood determines a gradient.
    """
    if len(reference) == 0:
        return LocalStrain(np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros(0, dtype=np.int64))
    # Points of a regular body would lie on the borders of bins; the shift keeps rounding from choosing.
    origin = reference.min(axis=0) - 1e-3 * size
    x = (reference - origin) / size  # sums of squares stay near one
    u = displacement / size
    cell = np.floor(x).astype(np.int64)
    shape = tuple(cell.max(axis=0) + 1)
    flat = cell[:, 0] * shape[1] + cell[:, 1]

    def around(value: FloatArray) -> FloatArray:
        table = np.bincount(flat, weights=value, minlength=shape[0] * shape[1]).reshape(shape)
        padded = np.pad(table, 1)
        total: FloatArray = sum(padded[i : i + shape[0], j : j + shape[1]] for i in range(3) for j in range(3))  # type: ignore[assignment]
        return total.ravel()

    count = around(np.ones(len(x)))
    own = np.bincount(flat, minlength=len(count)) > 0
    safe = np.maximum(count, 1.0)
    mean_x = np.stack([around(x[:, k]) for k in (0, 1)], axis=-1) / safe[:, None]
    mean_u = np.stack([around(u[:, k]) for k in (0, 1)], axis=-1) / safe[:, None]

    def covariance(a: FloatArray, b: FloatArray, mean_a: FloatArray, mean_b: FloatArray) -> FloatArray:
        sums = [[around(a[:, i] * b[:, j]) for j in (0, 1)] for i in (0, 1)]
        products = np.moveaxis(np.array(sums), -1, 0) / safe[:, None, None]
        spread: FloatArray = products - mean_a[:, :, None] * mean_b[:, None, :]
        return spread

    xx = covariance(x, x, mean_x, mean_x)
    ux = covariance(u, x, mean_u, mean_x)
    good = own & (count >= _FEWEST) & (np.linalg.eigvalsh(xx)[:, 0] > _LEAST_SPREAD**2)
    gradient = ux[good] @ np.linalg.inv(xx[good])
    bins = np.stack(np.unravel_index(np.flatnonzero(good), shape), axis=-1)
    return LocalStrain((bins + 0.5) * size + origin, gradient, count[good].astype(np.int64))


def mean_gradient(reference: FloatArray, displacement: FloatArray) -> FloatArray:
    """Return the one displacement gradient that fits all points best, shape (2, 2).

    Raises
    ------
    ValueError
        If fewer than three points are given.
    """
    if len(reference) < 3:
        raise ValueError(f"{len(reference)} points do not determine a gradient, at least 3 are needed")
    x = reference - reference.mean(axis=0)
    u = displacement - displacement.mean(axis=0)
    solution: FloatArray = np.linalg.lstsq(x, u, rcond=None)[0]
    return solution.T
