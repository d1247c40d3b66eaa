"""Stiffness of the grid: how nodal forces follow nodal displacements, assembled from the points' stencils.

With the moduli C of the material and its Kirchhoff stress tau, nodes I and J share

    K_(Ia)(Jc) = sum_p V0 dS_I/dx_b (C_abcd + delta_ac tau_bd) dS_J/dx_d.

The second part is what lets a body that hangs free in tension find its angle, and a slender one its bending.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.sparse import bsr_matrix, csc_matrix, csr_matrix

from .stencils import VOIGT, Stencils

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@njit(cache=True, nogil=True)
def _add_points(
    stencils: Stencils,
    number: IntArray,
    volume: FloatArray,
    moduli: FloatArray,
    stress: FloatArray,
    voigt: IntArray,
    start: IntArray,
    column: IntArray,
    blocks: FloatArray,
) -> None:
    """Add what the points give to the blocks of a sparse matrix with sorted columns."""
    node, gradient, entries = stencils.node, stencils.gradient, stencils.entries
    dim = gradient.shape[2]
    gain = np.empty((node.shape[1], dim, dim, dim))  # of stress (a, b) for a unit displacement c of node f
    for k in range(entries.size):
        for f in range(entries[k]):
            for a in range(dim):
                for b in range(dim):
                    for c in range(dim):
                        total = 0.0
                        for d in range(dim):
                            total += moduli[k, voigt[a, b], voigt[c, d]] * gradient[k, f, d]
                            if a == c:
                                total += stress[k, voigt[b, d]] * gradient[k, f, d]
                        gain[f, a, b, c] = volume[k] * total
        for e in range(entries[k]):
            row = number[node[k, e]]
            if row < 0:
                continue
            for f in range(entries[k]):
                other = number[node[k, f]]
                if other < 0:
                    continue
                low, high = start[row], start[row + 1] - 1
                while low < high:
                    middle = (low + high) // 2
                    if column[middle] < other:
                        low = middle + 1
                    else:
                        high = middle
                for a in range(dim):
                    for c in range(dim):
                        total = 0.0
                        for b in range(dim):
                            total += gradient[k, e, b] * gain[f, a, b, c]
                        blocks[low, a, c] += total


def assemble_stiffness(
    stencils: Stencils, number: IntArray, count: int, volume: FloatArray, moduli: FloatArray, stress: FloatArray
) -> csc_matrix:
    """Return the stiffness of the nodes [N/m], (count d, count d), component a of node i in row ``d i + a``.

    Parameters
    ----------
    stencils : Stencils
        Of m points.
    number : (R,) ndarray of int
        Number of the node in each row of the nodal tables, -1 for one that is left out.
    count : int
        Nodes.
    volume : (m,) ndarray
        Weighted reference volumes [m^3].
    moduli : (m, v, v) ndarray
        As `Material.tangent` gives them [Pa].
    stress : (m, v) ndarray
        Kirchhoff stress [Pa].
    """
    dim = stencils.gradient.shape[2]
    valid = np.arange(stencils.node.shape[1]) < stencils.entries[:, None]
    valid &= number[stencils.node] >= 0
    point = np.broadcast_to(np.arange(stencils.entries.size)[:, None], valid.shape)[valid]
    touched = csr_matrix(
        (np.ones(point.size), (point, number[stencils.node[valid]])), shape=(stencils.entries.size, count)
    )
    pattern = (touched.T @ touched).tocsr()
    pattern.sort_indices()
    blocks = np.zeros((pattern.nnz, dim, dim))
    start, column = pattern.indptr.astype(np.int64), pattern.indices.astype(np.int64)
    moduli, stress = np.ascontiguousarray(moduli), np.ascontiguousarray(stress)
    _add_points(stencils, number, volume, moduli, stress, VOIGT[dim], start, column, blocks)
    size = count * dim
    return bsr_matrix((blocks, pattern.indices, pattern.indptr), shape=(size, size)).tocsc()
