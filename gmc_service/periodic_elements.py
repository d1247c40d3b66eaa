"""Quadratic finite elements for the fluctuation in a doubly periodic cell, uniform along axis 1.

The displacement is the macroscopic strain's own plus a periodic fluctuation (u1, u2, u3) of x2 and x3, so all six
macroscopic strains are allowed (generalised plane strain). With fully integrated compatible elements the effective
stiffness is an upper bound that decreases to its limit as elements are added to a nested mesh.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array
from scipy.sparse.linalg import splu

from gmc_service.homogenised import Homogenised

#: Component of strain that the derivative of u[i] along (x2, x3)[k] adds to.
_STRAIN: Final = np.array([[5, 4], [1, 3], [3, 2]])
#: u1 meets only strains 13 and 12, u2 and u3 the others, unless the stiffness couples the two sets.
_AXIAL: Final = (4, 5)
_PLANE: Final = (0, 1, 2, 3)


@dataclass(frozen=True, eq=False)
class PeriodicMesh:
    """Nine-node quadrilaterals of a periodic cell.

    Attributes
    ----------
    points : ndarray of float, shape (elements, 9, 2)
        Place (x2, x3) of each element's nodes, m; node 3 i + j has the local coordinates (i - 1, j - 1).
    nodes : ndarray of int64, shape (elements, 9)
        Number of each node; a node and its periodic images have one number.
    subcell : ndarray of int64, shape (elements,)
        Subcell that each element lies in.
    """

    points: NDArray[np.float64]
    nodes: NDArray[np.int64]
    subcell: NDArray[np.int64]


def _gradients(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Derivatives of the shape functions along x2 and x3, (elements, 9 places, 9 nodes, 2), and weights of the places.

    Three by three points of Gauss: exact for the stiffness of rectangles.
    """
    place, weight = np.polynomial.legendre.leggauss(3)
    value = np.stack([0.5 * place * (place - 1.0), 1.0 - place**2, 0.5 * place * (place + 1.0)], axis=1)
    slope = np.stack([place - 0.5, -2.0 * place, place + 0.5], axis=1)
    local = np.stack([np.einsum("pi,qj->pqij", slope, value), np.einsum("pi,qj->pqij", value, slope)], axis=-1)
    local = local.reshape(9, 9, 2)
    jacobian = np.einsum("qak,eam->eqmk", local, points)  # dx_m / d local_k
    measure = np.linalg.det(jacobian)
    if not (measure > 0.0).all():
        raise ValueError("an element is turned inside out")
    return np.einsum("qak,eqkm->eqam", local, np.linalg.inv(jacobian)), measure * np.outer(weight, weight).reshape(-1)


def homogenise_mesh(mesh: PeriodicMesh, stiffness: NDArray[np.float64], expansion: NDArray[np.float64]) -> Homogenised:
    """Effective constants of a periodic cell, and the mean strain of each subcell.

    Parameters
    ----------
    mesh : PeriodicMesh
    stiffness : ndarray, shape (subcells, 6, 6)
        Pa; symmetric, positive definite, any anisotropy.
    expansion : ndarray, shape (subcells, 6)
        1/K.

    Returns
    -------
    Homogenised
        Its stiffness is the mean of twice the strain energy, symmetric and positive semi-definite whatever the
        contrast.
    """
    gradients, weights = _gradients(mesh.points)
    fluctuation = _fluctuations(mesh, gradients, weights, stiffness, expansion)
    elements = len(mesh.nodes)
    slopes = np.einsum("eqak,eail->eqikl", gradients, fluctuation[mesh.nodes], optimize=True)
    strain = np.zeros((elements, 9, 6, 7))  # by element, place, component, load: six macroscopic strains, one kelvin
    for i in range(3):
        for k in range(2):
            strain[:, :, _STRAIN[i, k]] += slopes[:, :, i, k]
    strain[..., :6] += np.eye(6)
    elastic = strain.copy()
    elastic[..., 6] -= expansion[mesh.subcell][:, None]
    stress = np.einsum("enm,eqml->eqnl", stiffness[mesh.subcell], elastic, optimize=True)
    area = weights.sum()
    # In this form an error of the strains enters by its square, which counts where the cell is almost a mechanism.
    work = np.einsum("eq,eqnk,eqnl->kl", weights, strain[..., :6], stress, optimize=True) / area
    effective = 0.5 * (work[:, :6] + work[:, :6].T)
    subcells = len(stiffness)
    sums = np.zeros((subcells, 6, 7))
    np.add.at(sums, mesh.subcell, np.einsum("eq,eqnl->enl", weights, strain))
    areas = np.bincount(mesh.subcell, weights.sum(axis=1), subcells)
    means = sums / areas[:, None, None]
    scale = 1.0 / np.sqrt(np.diag(effective))
    own_expansion = scale * np.linalg.solve(effective * np.outer(scale, scale), -scale * work[:, 6])
    return Homogenised(
        stiffness=effective,
        expansion=own_expansion,
        concentration=np.ascontiguousarray(means[..., :6]),
        thermal=np.ascontiguousarray(means[..., 6]),
    )


def _fluctuations(
    mesh: PeriodicMesh,
    gradients: NDArray[np.float64],
    weights: NDArray[np.float64],
    stiffness: NDArray[np.float64],
    expansion: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Periodic displacement of each node under each load, shape (nodes, 3, 7)."""
    count = int(mesh.nodes.max()) + 1
    pairs = np.einsum("eq,eqak,eqbl->eabkl", weights, gradients, gradients, optimize=True)
    sources = np.einsum("eq,eqak->eak", weights, gradients)
    loads = np.concatenate([-stiffness, (stiffness @ expansion[..., None])], axis=2)
    coupled = stiffness[:, _PLANE][:, :, _AXIAL].any()
    answer = np.zeros((count, 3, 7))
    for parts in [(0, 1, 2)] if coupled else [(0,), (1, 2)]:
        rows = _STRAIN[list(parts)]
        tensor = stiffness[:, rows[:, :, None, None], rows][mesh.subcell]  # (elements, i, k, j, l)
        unknowns = len(parts)
        blocks = np.einsum("eabkl,eikjl->eaibj", pairs, tensor, optimize=True)
        force = np.einsum("eak,eikf->eaif", sources, loads[:, rows][mesh.subcell], optimize=True)
        numbers = (mesh.nodes[:, :, None] * unknowns + np.arange(unknowns)).reshape(len(mesh.nodes), -1)
        total = np.zeros((count * unknowns, 7))
        np.add.at(total, numbers.reshape(-1), force.reshape(-1, 7))
        across = np.broadcast_to(numbers[:, :, None], (*numbers.shape, numbers.shape[1]))
        size = count * unknowns
        matrix = coo_array(
            (blocks.reshape(-1), (across.reshape(-1), across.swapaxes(1, 2).reshape(-1))), shape=(size, size)
        ).tocsc()
        answer[:, list(parts)] = _solve(matrix, total, unknowns).reshape(count, unknowns, 7)
    return answer


def _solve(matrix: csc_array, force: NDArray[np.float64], held: int) -> NDArray[np.float64]:
    """Solve a stiffness equation with the first `held` unknowns at zero: they take the rigid shift away."""
    factors = splu(
        csc_array(matrix[held:, held:]),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    answer = np.zeros_like(force)
    answer[held:] = factors.solve(np.ascontiguousarray(force[held:]))
    return answer
