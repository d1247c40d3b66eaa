"""J from the edges of a strip against the energy released in independent finite elements."""

import numpy as np
import pytest
import scipy.sparse as sparse
from scipy.sparse.linalg import spsolve

from coordinator.strip import strip_j
from protocol.continuum import IsotropicMaterial

NU = 0.205
WIDTH, HEIGHT, CRACK, CELL = 635.0, 425.0, 315.0, 5.0
STRAIN = 0.01


def strain_energy(crack: float, modulus: np.ndarray, *, sideways_free: bool) -> float:
    """Energy per thickness of a strip of bilinear elements, unit modulus, cracked from its left edge."""
    columns, rows = round(WIDTH / CELL), 2 * round(HEIGHT / CELL / 2)
    height = HEIGHT / rows
    node = np.arange((columns + 1) * (rows + 1)).reshape(rows + 1, columns + 1)
    cut = np.flatnonzero(np.arange(columns + 1) * CELL < crack - 1e-9)
    other_face = dict(zip(node[rows // 2, cut], node.size + np.arange(len(cut)), strict=True))
    corner = np.stack([node[:-1, :-1], node[:-1, 1:], node[1:, 1:], node[1:, :-1]], -1).reshape(-1, 4)
    below = np.repeat(np.arange(rows), columns) == rows // 2 - 1
    for k in (2, 3):
        corner[below, k] = [other_face.get(n, n) for n in corner[below, k]]
    stiffness = np.zeros((8, 8))
    for xi, eta in np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) / np.sqrt(3):
        along = np.array([-(1 - eta), 1 - eta, 1 + eta, -(1 + eta)]) / 4 * 2 / CELL
        across = np.array([-(1 - xi), -(1 + xi), 1 + xi, 1 - xi]) / 4 * 2 / height
        b = np.zeros((3, 8))
        b[0, 0::2], b[1, 1::2], b[2, 0::2], b[2, 1::2] = along, across, across, along
        stiffness += b.T @ modulus @ b * CELL * height / 4
    unknown = np.stack([2 * corner, 2 * corner + 1], -1).reshape(-1, 8)
    count = 2 * (node.size + len(cut))
    matrix = sparse.coo_matrix(
        (np.tile(stiffness.ravel(), len(corner)), (np.repeat(unknown, 8, 1).ravel(), np.tile(unknown, (1, 8)).ravel())),
        shape=(count, count),
    ).tocsr()
    top, bottom = node[-1], node[0]
    moved = np.zeros(count)
    moved[2 * top + 1], moved[2 * bottom + 1] = STRAIN * HEIGHT / 2, -STRAIN * HEIGHT / 2
    held = np.r_[2 * top + 1, 2 * bottom + 1]
    held = np.r_[held, 2 * top[-1], 2 * bottom[-1]] if sideways_free else np.r_[held, 2 * top, 2 * bottom]
    free = np.setdiff1d(np.arange(count), held)
    moved[free] = spsolve(matrix[free][:, free].tocsc(), -(matrix[free][:, held] @ moved[held]))
    return float(0.5 * moved @ (matrix @ moved))


@pytest.mark.parametrize("sideways_free", [True, False])
@pytest.mark.parametrize("assumption", ["plane_stress", "plane_strain"])
def test_strip_j_is_the_energy_that_finite_elements_release(assumption: str, sideways_free: bool) -> None:
    if assumption == "plane_stress":
        modulus = np.array([[1, NU, 0], [NU, 1, 0], [0, 0, (1 - NU) / 2]]) / (1 - NU**2)
    else:
        modulus = np.array([[1 - NU, NU, 0], [NU, 1 - NU, 0], [0, 0, 0.5 - NU]]) / ((1 + NU) * (1 - 2 * NU))
    energy = [strain_energy(CRACK + da, modulus, sideways_free=sideways_free) for da in (-CELL, CELL)]
    released = (energy[0] - energy[1]) / (2 * CELL)
    material = IsotropicMaterial(young=1.0, poisson=NU, density=1.0)
    j = strip_j(material, assumption, STRAIN, HEIGHT, sideways_free=sideways_free)
    # What remains is the finite length of crack and ligament, 1.5 half heights each.
    assert j == pytest.approx(released, rel=0.015)
