"""A laminate under growing displacement, in equilibrium at every increment.

An increment ends in equilibrium with all that has failed in it. Within it the equations are solved over and over with
the tangents that the material answers: what fails for good stays failed from one iteration to the next, so a sudden
death of some points unloads onto others, which may fail in turn, until none does. History that can go either way (a
plastic strain, a softening) always starts from the end of the last increment.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse
from numpy.typing import NDArray

from fem_service.cohesive_law import CohesiveLaw
from fem_service.cohesive_layer import CohesiveLayers, Separation
from fem_service.hexahedron import POINTS, Hexahedra
from fem_service.laminate_mesh import LaminateMesh
from fem_service.ply_axes import strain_to_ply
from fem_service.point_material import PointAnswer, PointMaterial, PointState
from fem_service.sparse_assembly import SparsePattern
from fem_service.sparse_solution import HeldSystem


class NotConverged(Exception):
    """An increment that found no equilibrium; a smaller one may."""


@dataclass(frozen=True, eq=False)
class Grips:
    """Degrees of freedom whose displacement is given, in proportion to the load.

    Attributes
    ----------
    freedoms : ndarray of int64, shape (held,)
        3 n + i is component i of node n.
    per_load : ndarray of float, shape (held,)
        Displacement at a load of 1, m.
    """

    freedoms: NDArray[np.int64]
    per_load: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """A laminate in equilibrium.

    Attributes
    ----------
    load : float
    displacement : ndarray of float, shape (nodes, 3)
        m.
    stress : ndarray of float, shape (bricks, 8, 6)
        In the axes of the laminate, Pa.
    points : PointState
        Of all integration points, by brick and point.
    layers : ndarray of float, shape (layers, 4, 2)
        Damage of the cohesive layers.
    force : float
        Work of the grips per load, N: the reaction where all of them move by one metre at a load of 1.
    iterations : int
        Solutions that it took.
    residual : float
        Largest force out of balance at a free node, over the largest at any.
    """

    load: float
    displacement: NDArray[np.float64]
    stress: NDArray[np.float64]
    points: PointState
    layers: NDArray[np.float64]
    force: float
    iterations: int
    residual: float


@dataclass(frozen=True, eq=False)
class _Response:
    """Forces of all elements at one displacement."""

    answer: PointAnswer
    stress: NDArray[np.float64]
    separation: Separation | None
    force: NDArray[np.float64]


class QuasiStatic:
    """A laminate, its material and its grips.

    Parameters
    ----------
    mesh : LaminateMesh
    material : PointMaterial
        Asked in the axes of each ply.
    grips : Grips
    law : CohesiveLaw, optional
        Of the cohesive layers, where the mesh has some.
    mean_dilatation : bool
        See `fem_service.hexahedron`.
    tolerance : float
        On `Equilibrium.residual`.
    iterations : int
        After which an increment is given up.

    Raises
    ------
    ValueError
        If the mesh has cohesive layers and there is no law.
    """

    def __init__(
        self,
        mesh: LaminateMesh,
        material: PointMaterial,
        grips: Grips,
        *,
        law: CohesiveLaw | None = None,
        mean_dilatation: bool = False,
        tolerance: float = 1e-8,
        iterations: int = 100,
    ) -> None:
        if len(mesh.layers) and law is None:
            raise ValueError("law is missing; the mesh has cohesive layers")
        self.mesh = mesh
        self.material = material
        self.grips = grips
        self.tolerance = tolerance
        self.iterations = iterations
        self.bricks = Hexahedra(mesh.nodes, mesh.bricks, mean_dilatation=mean_dilatation)
        self.layers = CohesiveLayers(mesh.nodes, mesh.layers, law) if law is not None and len(mesh.layers) else None
        groups = [mesh.bricks] if self.layers is None else [mesh.bricks, mesh.layers]
        self._pattern = SparsePattern(groups, len(mesh.nodes))
        self._system = HeldSystem(self._pattern.size, grips.freedoms)
        self._turns = np.array([strain_to_ply(angle) for angle in mesh.angles])
        self.element_length = self._lengths()

    @property
    def factorisations(self) -> int:
        """Factorisations made so far."""
        return self._system.factorisations

    def rest(self) -> Equilibrium:
        """The unloaded laminate."""
        count = len(self.mesh.bricks)
        return Equilibrium(
            load=0.0,
            displacement=np.zeros_like(self.mesh.nodes),
            stress=np.zeros((count, POINTS, 6)),
            points=self.material.fresh(count * POINTS),
            layers=np.zeros((len(self.mesh.layers), 4, 2)),
            force=0.0,
            iterations=0,
            residual=0.0,
        )

    def advance(self, start: Equilibrium, load: float) -> Equilibrium:
        """Find the equilibrium at another load; `start` stays as it is.

        Raises
        ------
        NotConverged
            If there is none within the iterations.
        """
        displacement = start.displacement.reshape(-1).copy()
        points = start.points
        target = load * self.grips.per_load
        first = True
        for iteration in range(1, self.iterations + 1):
            response = self._respond(displacement, points, start)
            # What failed for good stays; the rest of the state is that of the last increment.
            points = replace(start.points, failed=response.answer.state.failed)
            out = self._out_of_balance(response.force)
            if not first and out <= self.tolerance:
                return self._equilibrium(load, displacement, response, iteration, out)
            matrix = self._matrix(response)
            right = -response.force
            if first:
                jump = np.zeros_like(displacement)
                jump[self.grips.freedoms] = target - displacement[self.grips.freedoms]
                right -= matrix @ jump
                displacement += jump
            displacement += self._system.solve(matrix, right)
            first = False
            if not np.isfinite(displacement).all():
                break
        raise NotConverged(
            f"no equilibrium at load {load:g} after {self.iterations} iterations; out of balance is {out:.3g} of the "
            "largest force"
        )

    def _respond(self, displacement: NDArray[np.float64], points: PointState, start: Equilibrium) -> _Response:
        nodal = displacement.reshape(-1, 3)
        strain = self.bricks.strains(nodal)
        turns = self._turns[self.mesh.ply]
        local = np.einsum("eij,epj->epi", turns, strain).reshape(-1, 6)
        answer = self.material.respond(np.ascontiguousarray(local), points, self.element_length)
        stress = np.einsum("eji,epj->epi", turns, answer.stress.reshape(strain.shape))
        forces = [self.bricks.forces(stress)]
        separation = None
        if self.layers is not None:
            separation = self.layers.respond(self.layers.openings(nodal), start.layers)
            forces.append(self.layers.forces(separation.traction))
        return _Response(answer, stress, separation, self._pattern.vector(forces))

    def _matrix(self, response: _Response) -> scipy.sparse.csc_matrix:
        table, index = self._turned(response.answer)
        stiffnesses = [self.bricks.stiffnesses(table, index)]
        if self.layers is not None and response.separation is not None:
            stiffnesses.append(self.layers.stiffnesses(response.separation.tangent))
        return self._pattern.matrix(stiffnesses)

    def _turned(self, answer: PointAnswer) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Tangents in the axes of the laminate: a table for each angle, one after the other."""
        count = len(answer.tangents)
        angles, which = np.unique(self.mesh.angles, return_inverse=True)
        turns = np.array([strain_to_ply(angle) for angle in angles])
        table = np.einsum("aji,tjk,akl->atil", turns, answer.tangents, turns).reshape(-1, 6, 6)
        index = answer.index.reshape(-1, POINTS) + count * which[self.mesh.ply][:, None]
        return np.ascontiguousarray(table), np.ascontiguousarray(index)

    def _out_of_balance(self, force: NDArray[np.float64]) -> float:
        largest = float(np.abs(force).max())
        return float(np.abs(force[self._system.free]).max(initial=0.0)) / largest if largest > 0.0 else 0.0

    def _equilibrium(
        self, load: float, displacement: NDArray[np.float64], response: _Response, iterations: int, residual: float
    ) -> Equilibrium:
        separation = response.separation
        return Equilibrium(
            load=load,
            displacement=displacement.reshape(-1, 3).copy(),
            stress=response.stress,
            points=response.answer.state,
            layers=np.zeros((0, 4, 2)) if separation is None else separation.damage,
            force=float(response.force[self.grips.freedoms] @ self.grips.per_load),
            iterations=iterations,
            residual=residual,
        )

    def _lengths(self) -> NDArray[np.float64]:
        """Edge of a square of the area that a brick has in the plane, for each of its points, m.

        Cracks of a ply run through its thickness, so it is the length in the plane over which a brick smears them.
        """
        z = self.mesh.nodes[self.mesh.bricks][:, :, 2]
        heights = z[:, 4:].mean(axis=1) - z[:, :4].mean(axis=1)
        return np.repeat(np.sqrt(self.bricks.volumes.sum(axis=1) / heights), POINTS)
