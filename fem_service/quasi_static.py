"""A laminate under growing displacement, in equilibrium at every increment.

An increment ends in equilibrium with all that has failed in it. Within it the equations are solved over and over with
the tangents that the material answers: what fails for good stays failed from one iteration to the next, so a sudden
death of some points unloads onto others, which may fail in turn, until none does. History that can go either way (a
plastic strain, a softening) always starts from the end of the last increment.

Where plies are joined by cohesive layers, whose openings overshoot on their way to a balance, points fail at a balance
alone: until the forces are in balance to a thousandth, points that would fail anew answer as they stand, for some
iterations at least. Otherwise a laminate would break by strains that it never has.

Where a step goes too far although nothing new has failed for good (cohesive layers, softening), a line search shortens
it until the work of the forces out of balance along the step is small. Iterations with consistent tangents take turns
with iterations with the secant stiffness of the layers: where layers soften at the front of a crack, consistent
tangents alone can go to and fro between growing and resting damage for ever. Points that soften answer secant
stiffnesses, with which steps creep: there the last few steps are mixed (`fem_service.acceleration`). Where they find no
balance for long, as where elements would snap back, damage is kept from one iteration to the next, as sudden failures
are: it can only grow to its end, so the laminate comes to rest.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import scipy.sparse
from numpy.typing import NDArray

from fem_service.acceleration import Acceleration
from fem_service.cohesive_law import CohesiveLaw
from fem_service.cohesive_layer import CohesiveLayers, Separation
from fem_service.equilibrium import Aim, Equilibrium, Grips, NotConverged, Response, held_back
from fem_service.factorisation import Factoriser
from fem_service.hexahedron import POINTS, Hexahedra
from fem_service.laminate_mesh import LaminateMesh
from fem_service.lever import Lever
from fem_service.ply_axes import strain_to_ply
from fem_service.point_material import PointAnswer, PointMaterial, PointState
from fem_service.sparse_assembly import SparsePattern
from fem_service.sparse_solution import HeldSystem

#: A step is shortened, at most so often, while the work along it is above this part of that at its start.
_SLACK, _SHORTENED = 0.5, 4
#: Forces below this part of the largest stiffness times the largest displacement are rounding errors.
_ROUNDING = 1e-14
#: Iterations after which damage is kept from one to the next, and steps are not mixed: they would overshoot for good.
_PATIENCE = 12
#: Iterations with consistent tangents, and then with secant stiffness of the layers, in turn.
_TURN = 6
#: Out of balance, below which points fail in a laminate with cohesive layers, and iterations that they wait for it: a
#: laminate that finds no balance in the meantime is breaking, and goes on breaking.
_STAGE, _WAIT = 1e-3, 4 * _TURN


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
    lever : Lever, optional
        Pulls beside the grips, or where these only hold.
    mean_dilatation : bool
        See `fem_service.hexahedron`.
    tolerance : float
        On `Equilibrium.residual`.
    iterations : int
        After which an increment is given up; with cohesive layers, after so many in which nothing new has failed.
    viscosity : float
        Load over which the damage of the cohesive layers follows its own value: with an increment d of the load it goes
        d / (d + viscosity) of the way. 0 for none. What it takes is `Equilibrium.viscous_energy`.
    factoriser : Factoriser, optional
        SuperLU where none is given.

    Attributes
    ----------
    element_length : ndarray of float, shape (8 bricks,)
        Length over which the brick of each integration point smears a crack, m.
    watch : callable
        Called with the number of each iteration; may raise to end it.
    seconds : dict of str to float
        Spent in assembly and solution; whoever reads it may clear it.

    Raises
    ------
    ValueError
        If the mesh has cohesive layers and there is no law, a number is out of range, the laminate is not held well
        enough, or it has stress at rest and a lever.
    """

    def __init__(
        self,
        mesh: LaminateMesh,
        material: PointMaterial,
        grips: Grips,
        *,
        law: CohesiveLaw | None = None,
        lever: Lever | None = None,
        mean_dilatation: bool = False,
        tolerance: float = 1e-8,
        iterations: int = 100,
        viscosity: float = 0.0,
        factoriser: Factoriser | None = None,
    ) -> None:
        if not viscosity >= 0.0:
            raise ValueError(f"viscosity is {viscosity}; it must be at least 0")
        if iterations < 1:
            raise ValueError(f"iterations is {iterations}; it must be at least 1")
        if len(mesh.layers) and law is None:
            raise ValueError("law is missing; the mesh has cohesive layers")
        self.mesh = mesh
        self.material = material
        self.grips = grips
        self.tolerance = tolerance
        self.iterations = iterations
        self.viscosity = viscosity
        self.bricks = Hexahedra(mesh.nodes, mesh.bricks, mean_dilatation=mean_dilatation)
        self.layers = CohesiveLayers(mesh.nodes, mesh.layers, law) if law is not None and len(mesh.layers) else None
        self.lever = lever
        groups = [mesh.bricks]
        if self.layers is not None:
            groups.append(mesh.layers)
        if lever is not None:
            groups.append(lever.elements())
        self._pattern = SparsePattern(groups, len(mesh.nodes))
        self.system = HeldSystem(self._pattern.size, grips.freedoms, factoriser)
        angles, which = np.unique(mesh.angles, return_inverse=True)
        self._turns = np.array([strain_to_ply(angle) for angle in angles])
        self._angle = which.reshape(-1)[mesh.ply]  # of each brick, its row of the turns
        self._brick_turns = self._turns[self._angle]
        self.element_length = self._lengths()
        self._rest, self._rest_load = self._at_rest()
        self.watch: Callable[[int], None] = lambda iteration: None
        self.seconds: dict[str, float] = {}

    @property
    def unknowns(self) -> int:
        """Degrees of freedom that are solved for."""
        return len(self.system.free)

    @property
    def factorisations(self) -> int:
        """Factorisations made so far."""
        return self.system.factorisations

    def rest(self) -> Equilibrium:
        """The laminate without load, under the stresses that its material has without strain, if any."""
        return self._rest

    def _at_rest(self) -> tuple[Equilibrium, float]:
        """`rest`, where nothing has failed, and the load at which grips would hold it from a laminate without strain.

        A laminate cools before it is gripped: its ends have come nearer, and no force acts on them.
        """
        count = len(self.mesh.bricks) * POINTS
        intact = self.material.intact(count)
        rest = Equilibrium(
            load=0.0,
            displacement=np.zeros_like(self.mesh.nodes),
            stress=np.zeros((len(self.mesh.bricks), POINTS, 6)),
            points=self.material.fresh(count),
            layers=np.zeros((len(self.mesh.layers), 4, 2)),
            force=0.0,
            iterations=0,
            residual=0.0,
        )
        if not intact.stress.any():
            return rest, 0.0
        if self.lever is not None:
            raise ValueError("lever is given; the material has stress without strain, and a lever would feel it")
        aim = Aim(rest, 0.0, 1.0)
        response = self._assembled(intact, self.ply_strains(rest.displacement), rest.displacement, aim)
        matrix = self.stiffness(response, secant=False)
        held, per_load = self.grips.freedoms, self.grips.per_load
        pulled = np.zeros(self._pattern.size)
        pulled[held] = per_load
        cooled = self.system.solve(matrix, -response.force)
        pulled += self.system.solve(matrix, -(matrix @ pulled))
        stiffness = float((matrix @ pulled)[held] @ per_load)
        load = -float((matrix @ cooled + response.force)[held] @ per_load) / stiffness if stiffness > 0.0 else 0.0
        displacement = (cooled + load * pulled).reshape(-1, 3)
        strain = self.ply_strains(displacement)
        answer = replace(intact, stress=intact.stress + np.einsum("pij,pj->pi", intact.tangents[intact.index], strain))
        stress = self._assembled(answer, strain, displacement, aim).stress
        return replace(rest, displacement=displacement, stress=stress), load

    def advance(self, start: Equilibrium, load: float) -> Equilibrium:
        """Find the equilibrium at another load; `start` stays as it is.

        Raises
        ------
        NotConverged
            If there is none within the iterations.
        """
        self.system.begin()
        displacement = start.displacement.reshape(-1).copy()
        points = start.points
        target = (load + self._rest_load) * self.grips.per_load
        aim = Aim(start, load, self._relaxation(load - start.load))
        step: NDArray[np.float64] | None = None
        slope = rounding = 0.0
        before: Response | None = None
        acceleration = Acceleration()
        iteration = since = 0  # since points have failed in a laminate with layers
        while since < self.iterations:
            iteration, since = iteration + 1, since + 1
            self.watch(iteration)
            response = self.respond(displacement, points, aim, before)
            if step is not None and since > 2:
                displacement, response = self._shortened(displacement, step, slope, response, points, aim, before)
            worst, out = self._out_of_balance(response)
            if response.fails_later and (out <= max(_STAGE, self.tolerance) or since > _WAIT):
                points = replace(start.points, failed=response.failed)
                response, since = self.respond(displacement, points, aim), 1
                worst, out = self._out_of_balance(response)
            if not np.array_equal(response.answer.state.failed, points.failed):
                acceleration.forget()
            # What failed for good stays; the rest of the state is that of the last increment.
            points = replace(start.points, failed=response.answer.state.failed)
            if self.material.softens and since > _PATIENCE:
                points = response.answer.state
            if step is not None and not response.fails_later and (out <= self.tolerance or worst <= rounding):
                return self.equilibrium(aim, displacement, response, iteration, out)
            before = response if self.layers is not None else None
            with self._timed("assembly"):
                matrix = self.stiffness(response, secant=(since - 1) // _TURN % 2 == 1)
            rounding = _ROUNDING * float(np.abs(matrix.data).max() * np.abs(displacement).max())
            right = -response.force
            if step is None:
                jump = np.zeros_like(displacement)
                jump[self.grips.freedoms] = target - displacement[self.grips.freedoms]
                right -= matrix @ jump
                displacement += jump
            with self._timed("solution"):
                try:
                    step = self.system.solve(matrix, right)
                except ValueError as error:
                    if iteration == 1 and start.load == 0.0:
                        raise  # not held well enough, whatever the increment
                    raise NotConverged(f"no equilibrium at load {load:g}: {error}", iteration) from None
            if self.material.softens and since <= _PATIENCE:
                step = acceleration.mixed(displacement, step, right)
            slope = -float(step @ right)
            displacement = displacement + step
            if not np.isfinite(displacement).all():
                break
        raise NotConverged(
            f"no equilibrium at load {load:g} after {iteration} iterations; out of balance is {out:.3g} of the "
            "largest force",
            iteration,
        )

    def _out_of_balance(self, response: Response) -> tuple[float, float]:
        """Largest force out of balance, N, and its share of the largest."""
        worst = float(np.abs(response.force[self.system.free]).max(initial=0.0))
        return worst, worst / response.largest if worst > 0.0 else 0.0

    def _relaxation(self, increment: float) -> float:
        return abs(increment) / (abs(increment) + self.viscosity) if self.viscosity else 1.0

    def _shortened(
        self,
        displacement: NDArray[np.float64],
        step: NDArray[np.float64],
        slope: float,
        response: Response,
        points: PointState,
        aim: Aim,
        before: Response | None,
    ) -> tuple[NDArray[np.float64], Response]:
        """The step that led to a displacement, shortened where it went too far; `slope` is the work at its start."""
        whole, low, high = 1.0, 0.0, 1.0
        work_low, work_high = slope, float(step @ response.force)
        for _ in range(_SHORTENED):
            sudden = not np.array_equal(response.answer.state.failed, points.failed)
            if slope >= 0.0 or sudden or abs(work_high) <= _SLACK * abs(slope) or work_high < 0.0:
                break
            # Between `low` and `high` the work changes its sign.
            part = low + (high - low) * min(max(work_low / (work_low - work_high), 0.1), 0.9)
            moved = displacement + (part - whole) * step
            found = self.respond(moved, points, aim, before)
            work = float(step @ found.force)
            displacement, response, whole = moved, found, part
            if work < 0.0:
                if abs(work) <= _SLACK * abs(slope):
                    break
                low, work_low = part, work
            else:
                high, work_high = part, work
        return displacement, response

    @contextlib.contextmanager
    def _timed(self, part: str) -> Iterator[None]:
        began = time.perf_counter()
        yield
        self.seconds[part] = self.seconds.get(part, 0.0) + time.perf_counter() - began

    def respond(
        self, displacement: NDArray[np.float64], points: PointState, aim: Aim, before: Response | None = None
    ) -> Response:
        """Forces of all elements at displacements, shape (3 nodes,), with points that have failed so far.

        Where there is a response `before`, points that would fail anew go on from it with their tangents there.
        """
        nodal = displacement.reshape(-1, 3)
        strain = self.ply_strains(nodal)
        answer = self.material.respond(strain, points, self.element_length)
        failed = answer.state.failed
        if before is not None:
            answer = held_back(answer, strain, points, before)
        return replace(self._assembled(answer, strain, nodal, aim), failed=failed)

    def ply_strains(self, displacement: NDArray[np.float64]) -> NDArray[np.float64]:
        """Strains of all points in the axes of their plies, shape (8 bricks, 6)."""
        local = self.bricks.strains(displacement) @ self._brick_turns.transpose(0, 2, 1)
        return np.ascontiguousarray(local.reshape(-1, 6))

    def _assembled(
        self, answer: PointAnswer, strain: NDArray[np.float64], nodal: NDArray[np.float64], aim: Aim
    ) -> Response:
        """Forces of all elements where the material has answered; `nodal` are displacements, shape (nodes, 3)."""
        stress = answer.stress.reshape(-1, POINTS, 6) @ self._brick_turns
        forces = [self.bricks.forces(stress)]
        separation = None
        if self.layers is not None:
            separation = self.layers.respond(self.layers.openings(nodal), aim.start.layers, aim.relaxation)
            forces.append(self.layers.forces(separation.traction))
        if self.lever is not None:
            forces.append(self.lever.forces(nodal, aim.load))
        force = self._pattern.vector(forces)
        largest = max(float(np.abs(force).max()), 1e-4 * max(float(np.abs(part).max(initial=0.0)) for part in forces))
        if self.lever is not None:
            largest = max(largest, float(np.abs(forces[-1]).max()))
        return Response(strain, answer.state.failed, answer, stress, separation, force, largest)

    def stiffness(self, response: Response, *, secant: bool) -> scipy.sparse.csc_matrix:
        """Derivative of the forces, or with the secant stiffness of the layers."""
        table, index = self._turned(response.answer)
        stiffnesses = [self.bricks.stiffnesses(table, index)]
        if self.layers is not None and response.separation is not None:
            separation = response.separation
            stiffnesses.append(self.layers.stiffnesses(separation.secant if secant else separation.tangent))
        if self.lever is not None:
            stiffnesses.append(self.lever.stiffnesses())
        return self._pattern.matrix(stiffnesses)

    def _turned(self, answer: PointAnswer) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Tangents in the axes of the laminate: a row for each pair of a tangent and an angle that there is."""
        count = len(answer.tangents)
        pairs, index = np.unique(answer.index.reshape(-1, POINTS) + count * self._angle[:, None], return_inverse=True)
        turns = self._turns[pairs // count]
        table = turns.transpose(0, 2, 1) @ answer.tangents[pairs % count] @ turns
        return np.ascontiguousarray(table), np.ascontiguousarray(index.reshape(-1, POINTS).astype(np.int64))

    def work_per_load(self, displacement: NDArray[np.float64], response: Response, load: float) -> float:
        """`Equilibrium.force` of a response."""
        force = float(response.force[self.grips.freedoms] @ self.grips.per_load)
        if self.lever is not None:
            force += self.lever.force(displacement.reshape(-1, 3), load)
        return force

    def equilibrium(
        self,
        aim: Aim,
        displacement: NDArray[np.float64],
        response: Response,
        iterations: int,
        residual: float,
    ) -> Equilibrium:
        """An equilibrium that has been found."""
        separation = response.separation
        nodal = displacement.reshape(-1, 3).copy()
        return Equilibrium(
            load=aim.load,
            displacement=nodal,
            stress=response.stress,
            points=response.answer.state,
            layers=np.zeros((0, 4, 2)) if separation is None else separation.damage,
            force=self.work_per_load(displacement, response, aim.load),
            iterations=iterations,
            residual=residual,
            viscous_energy=aim.start.viscous_energy + self._viscous(aim.start, nodal, separation),
        )

    def _viscous(self, start: Equilibrium, displacement: NDArray[np.float64], separation: Separation | None) -> float:
        """Work of the layers' overstress in an increment, by the trapezoidal rule, J."""
        if self.layers is None or separation is None or not self.viscosity:
            return 0.0
        before, after = self.layers.openings(start.displacement), self.layers.openings(displacement)
        mean = 0.5 * (self.layers.overstress(before, start.layers) + self.layers.overstress(after, separation.damage))
        return float(np.einsum("ep,epi,epi->", self.layers.areas, mean, after - before))

    def _lengths(self) -> NDArray[np.float64]:
        """Edge of a square of the area that a brick has in the plane, for each of its points, m.

        Cracks of a ply run through its thickness, so it is the length in the plane over which a brick smears them.
        """
        z = self.mesh.nodes[self.mesh.bricks][:, :, 2]
        heights = z[:, 4:].mean(axis=1) - z[:, :4].mean(axis=1)
        return np.repeat(np.sqrt(self.bricks.volumes.sum(axis=1) / heights), POINTS)
