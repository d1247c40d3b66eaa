"""Eigenvalues and eigenvectors of a symmetric 3 x 3 matrix, to round-off of its largest entry."""

from __future__ import annotations

from math import sqrt

from numba import njit

from .material import FloatArray

_SWEEPS = 30  # four are usual
_ROUND_OFF = 1e-16  # of the largest entry: what is left off the diagonal


@njit(cache=True, nogil=True)
def decompose(matrix: FloatArray, vectors: FloatArray) -> None:
    """Turn a symmetric matrix into its eigenvalues by Jacobi's rotations.

    Parameters
    ----------
    matrix : (3, 3) ndarray
        Symmetric; overwritten, its diagonal becomes the eigenvalues (in no order).
    vectors : (3, 3) ndarray
        Filled with the eigenvectors as columns.
    """
    for i in range(3):
        for j in range(3):
            vectors[i, j] = 1.0 if i == j else 0.0
    size = 0.0
    for i in range(3):
        for j in range(3):
            size = max(size, abs(matrix[i, j]))
    for _ in range(_SWEEPS):
        turned = False
        for p, q in ((0, 1), (0, 2), (1, 2)):
            off = matrix[p, q]
            if abs(off) <= _ROUND_OFF * size:
                continue
            turned = True
            ratio = (matrix[q, q] - matrix[p, p]) / (2.0 * off)
            t = 1.0 / (abs(ratio) + sqrt(1.0 + ratio * ratio))
            if ratio < 0.0:
                t = -t
            c = 1.0 / sqrt(1.0 + t * t)
            s = t * c
            r = 3 - p - q
            matrix[p, p] -= t * off
            matrix[q, q] += t * off
            matrix[p, q] = matrix[q, p] = 0.0
            rp, rq = matrix[r, p], matrix[r, q]
            matrix[r, p] = matrix[p, r] = c * rp - s * rq
            matrix[r, q] = matrix[q, r] = s * rp + c * rq
            for i in range(3):
                vp, vq = vectors[i, p], vectors[i, q]
                vectors[i, p] = c * vp - s * vq
                vectors[i, q] = s * vp + c * vq
        if not turned:
            return
