"""Bricks against exact solutions: patch tests, rigid motion, volumes, near-incompressible bending."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse.linalg

from fem_service.hexahedron import Hexahedra, InvertedElement
from fem_service.ply_axes import strain_to_ply
from fem_service.sparse_assembly import SparsePattern


def isotropic(young: float, poisson: float) -> np.ndarray:
    lame, shear = young * poisson / ((1 + poisson) * (1 - 2 * poisson)), 0.5 * young / (1 + poisson)
    stiffness = np.diag([2 * shear] * 3 + [shear] * 3)
    stiffness[:3, :3] += lame
    return stiffness


def block(counts: tuple[int, int, int], sizes: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and elements of a brick of bricks."""
    axes = [np.linspace(0.0, size, count + 1) for size, count in zip(sizes, counts, strict=True)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.arange(len(nodes)).reshape([count + 1 for count in counts])
    low = [number[i : i + counts[0], j : j + counts[1], :-1] for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))]
    high = [number[i : i + counts[0], j : j + counts[1], 1:] for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))]
    return nodes, np.stack([*low, *high], axis=-1).reshape(-1, 8)


def solve(
    bricks: Hexahedra, nodes: np.ndarray, tangent: np.ndarray, held: np.ndarray, values: np.ndarray, load: np.ndarray
) -> np.ndarray:
    """Displacements, (nodes, 3), where degrees of freedom `held` have values and the others a load."""
    pattern = SparsePattern([bricks.elements], len(nodes))
    index = np.zeros((len(bricks.elements), 8), np.int64)
    matrix = pattern.matrix([bricks.stiffnesses(tangent[None], index)])
    free = np.setdiff1d(np.arange(3 * len(nodes)), held)
    whole = np.zeros(3 * len(nodes))
    whole[held] = values
    right = load[free] - (matrix[free] @ whole)
    whole[free] = scipy.sparse.linalg.spsolve(matrix[free][:, free].tocsc(), right)
    return whole.reshape(-1, 3)


@pytest.mark.parametrize("mean_dilatation", [False, True])
def test_patch_of_distorted_bricks_holds_any_uniform_strain(mean_dilatation: bool) -> None:
    nodes, elements = block((3, 3, 3), (1.0, 2.0, 0.5))
    random = np.random.default_rng(1)
    inside = np.all((nodes > 1e-9) & (nodes < np.array([1.0, 2.0, 0.5]) - 1e-9), axis=1)
    nodes[inside] += random.uniform(-0.04, 0.04, (inside.sum(), 3))
    bricks = Hexahedra(nodes, elements, mean_dilatation=mean_dilatation)
    gradient = random.normal(size=(3, 3)) * 1e-3
    exact = nodes @ gradient.T
    held = np.flatnonzero(np.repeat(~inside, 3))
    tangent = isotropic(70e9, 0.3)
    found = solve(bricks, nodes, tangent, held, exact.reshape(-1)[held], np.zeros(3 * len(nodes)))
    assert np.abs(found - exact).max() < 1e-12 * np.abs(exact).max() * 100
    wanted = np.array(
        [
            *np.diag(gradient), gradient[1, 2] + gradient[2, 1], gradient[0, 2] + gradient[2, 0],
            gradient[0, 1] + gradient[1, 0],
        ]
    )  # fmt: skip
    assert np.abs(bricks.strains(found) - wanted).max() < 1e-12


@pytest.mark.parametrize("mean_dilatation", [False, True])
def test_rigid_motion_costs_nothing_and_nothing_else_is_free(mean_dilatation: bool) -> None:
    nodes, elements = block((1, 1, 1), (1.0, 0.7, 0.4))
    nodes += np.random.default_rng(3).uniform(-0.05, 0.05, nodes.shape)
    bricks = Hexahedra(nodes, elements, mean_dilatation=mean_dilatation)
    stiffness = bricks.stiffnesses(isotropic(1.0, 0.25)[None], np.zeros((1, 8), np.int64))[0]
    values = np.linalg.eigvalsh(stiffness)
    assert np.abs(stiffness - stiffness.T).max() < 1e-14
    assert np.abs(values[:6]).max() < 1e-14 < 1e-4 < values[6]


def test_forces_are_the_stiffness_times_the_displacement() -> None:
    nodes, elements = block((2, 1, 1), (1.0, 0.7, 0.4))
    bricks = Hexahedra(nodes, elements, mean_dilatation=True)
    displacement = np.random.default_rng(5).normal(size=nodes.shape)
    tangent = isotropic(3.0, 0.4)
    force = bricks.forces(bricks.strains(displacement) @ tangent)
    stiffness = bricks.stiffnesses(tangent[None], np.zeros((2, 8), np.int64))
    own = displacement[elements].reshape(2, 24)
    assert np.allclose(force, np.einsum("eij,ej->ei", stiffness, own), atol=1e-13)


def test_volume_and_positions() -> None:
    nodes, elements = block((3, 2, 2), (1.0, 2.0, 0.5))
    bricks = Hexahedra(nodes, elements)
    assert bricks.volumes.sum() == pytest.approx(1.0, rel=1e-14)
    assert np.allclose(bricks.positions(nodes).mean(axis=(0, 1)), [0.5, 1.0, 0.25])


def test_mean_dilatation_does_not_lock() -> None:
    """A thick cylinder under pressure has a closed form (Lame) at any Poisson's ratio; plain bricks lock near 1/2."""
    inner, outer, poisson = 1.0, 2.0, 0.4999
    angles, radii = np.linspace(0.0, 0.5 * np.pi, 13), np.linspace(inner, outer, 9)
    flat, elements = block((8, 12, 1), (1.0, 1.0, 0.1))
    number = np.arange(len(flat)).reshape(9, 13, 2)
    nodes = flat.copy()
    for i in range(9):
        for j in range(13):
            nodes[number[i, j], 0] = radii[i] * np.cos(angles[j])
            nodes[number[i, j], 1] = radii[i] * np.sin(angles[j])
    held = np.unique(
        np.concatenate([3 * number[:, 0].reshape(-1) + 1, 3 * number[:, -1].reshape(-1), 3 * np.arange(len(nodes)) + 2])
    )
    load = np.zeros(3 * len(nodes))
    for j in range(12):  # a pressure of one on the inner face, the same on its four nodes
        first, second = nodes[number[0, j, 0]], nodes[number[0, j + 1, 0]]
        normal = np.array([second[1] - first[1], first[0] - second[0]]) * 0.1
        for node in (*number[0, j], *number[0, j + 1]):
            load[3 * node : 3 * node + 2] += 0.25 * normal
    exact = (1.0 + poisson) * inner**2 / (outer**2 - inner**2) * ((1.0 - 2.0 * poisson) * inner + outer**2 / inner)
    moved = {}
    for mean in (False, True):
        bricks = Hexahedra(nodes, elements, mean_dilatation=mean)
        found = solve(bricks, nodes, isotropic(1.0, poisson), held, np.zeros(len(held)), load)
        moved[mean] = found[number[0, 0, 0], 0]
    assert moved[True] == pytest.approx(exact, rel=0.02)
    assert moved[False] < 0.7 * exact


def test_an_inverted_element_is_named() -> None:
    nodes, elements = block((3, 1, 1), (3.0, 1.0, 1.0))
    elements[1] = elements[1][[4, 5, 6, 7, 0, 1, 2, 3]]
    with pytest.raises(InvertedElement, match="element 1 is inverted") as caught:
        Hexahedra(nodes, elements)
    assert caught.value.element == 1


def test_turning_a_strain_makes_the_same_work() -> None:
    random = np.random.default_rng(7)
    turn = strain_to_ply(0.4)
    strain, stress = random.normal(size=6), random.normal(size=6)
    assert (turn @ strain) @ stress == pytest.approx(strain @ (turn.T @ stress))
    assert np.allclose(strain_to_ply(-0.4) @ turn, np.eye(6))
    # A quarter turn takes x to the ply's axis 2.
    assert np.allclose(strain_to_ply(0.5 * np.pi) @ [1.0, 2.0, 3.0, 4.0, 5.0, 6.0], [2.0, 1.0, 3.0, -5.0, 4.0, -6.0])
    # Turning is an isometry of the tensor: trace and the sum of squares stay.
    turned = turn @ strain
    assert turned[:3].sum() == pytest.approx(strain[:3].sum())
    squares = np.array([1, 1, 1, 0.5, 0.5, 0.5])
    assert squares @ turned**2 == pytest.approx(squares @ strain**2)
