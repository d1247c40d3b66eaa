"""From the message `configure` to a solver: grid, points, material, edges, loads, cracks.

Beside `service` the only file that sees both messages and solver.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

import numpy as np

from mpm_service.cell_client import CellClient
from mpm_service.conditions import Approach, EdgeCondition, FieldCondition, symmetry
from mpm_service.crack_line import Crack
from mpm_service.crack_reports import growth_law
from mpm_service.damping import Damping
from mpm_service.elastic import IsotropicElastic, LinearElastic, OrthotropicElastic
from mpm_service.grid import Grid
from mpm_service.hierarchy import HierarchicalGrid
from mpm_service.hierarchy_filling import fill_hierarchy
from mpm_service.holes import Hole, cut_holes
from mpm_service.hyperelastic import NeoHookean
from mpm_service.k_field import CrackTipField
from mpm_service.laminate import Laminate
from mpm_service.loads import AbsorbingEdge, BodyForce, Load, Traction
from mpm_service.material import Material
from mpm_service.material_points import Body, fill_rectangle
from mpm_service.overlap import Overlap, OverlapError, cut_overlaps
from mpm_service.plasticity import J2Plasticity
from mpm_service.scheme import Scheme
from mpm_service.solver import MaterialPointSolver
from mpm_service.time_functions import Constant, Table
from protocol import continuum as messages
from protocol.arrays import FloatArray
from protocol.client import Client
from protocol.continuum_parts import Edge
from protocol.errors import ProtocolError

#: Makes a solver from the arguments of `MaterialPointSolver`.
SolverMaker = Callable[..., MaterialPointSolver]

#: Cells around the body, so that domains of points near an edge stay inside the grid.
MARGIN_CELLS = 3
#: What the solver's complaints begin with, as the messages name it.
CONFIGURE_NAMES = {
    "lower": "body",
    "upper": "body",
    "grid": "body",
    "edge_conditions": "edges",
    "EdgeCondition": "edges",
    "loads": "edges",
    "Traction": "edges",
    "Crack": "cracks",
    "crack": "cracks",
    "interval": "cracks",
    "GrowthLaw": "cracks",
    "Scheme": "scheme",
    "HierarchicalGrid": "refinement",
    "holes": "holes",
}
REGISTER_NAMES = {"position": "anchor_position", "ivc": "anchor_ivc", "interface": "ivc_lower", "lower": "ivc_lower",
                  "upper": "ivc_upper"}  # fmt: skip
_LAWS: dict[str, Callable[..., Material]] = {
    "isotropic": IsotropicElastic,
    "orthotropic": OrthotropicElastic,
    "neo_hookean": NeoHookean,
    "j2_plasticity": J2Plasticity,
}


class Edges:
    """What the entries of `edges` are to the solver, and what it tells of them.

    Parameters
    ----------
    edges : list
        Of the request.
    thickness : float
        [m].
    lower, upper : (2,) sequence of float
        Corners of the body [m].
    frozen : bool
        Everything stays as it is at time zero, and absorbing edges, which bear no load, are left out.
    material : Material, optional
        What absorbing edges are matched to and crack-tip fields belong to.

    Raises
    ------
    ProtocolError
        `bad_field`, where a crack-tip field does not fit the material.
    """

    def __init__(
        self,
        edges: list[messages.AnyEdge],
        thickness: float,
        lower: Sequence[float] | FloatArray,
        upper: Sequence[float] | FloatArray,
        *,
        frozen: bool,
        material: Material | None = None,
    ) -> None:
        size = np.subtract(upper, lower)
        self.conditions: list[EdgeCondition | FieldCondition] = []
        self.loads: list[Load] = []
        #: Row of the condition, or None, and nominal force over time, or None, of each entry.
        self._entries: list[tuple[int | None, tuple[float, Constant | Table] | None]] = []
        #: Largest displacement by a field at any time [m].
        self.farthest = 0.0
        #: Mean normal displacement of a face by a field at a factor of 1 [m], by condition.
        self._mean: dict[int, float] = {}
        for number, edge in enumerate(edges):
            condition, nominal = None, None
            axis = 0 if edge.edge in ("left", "right") else 1
            outward = 1.0 if edge.edge in ("right", "top") else -1.0
            area = thickness * size[1 - axis]
            if isinstance(edge, messages.EdgeAbsorbing):
                assert material is not None
                if not frozen:
                    self.loads.append(_absorbing(edge.edge, axis, material))
            elif isinstance(edge, messages.EdgeTraction):
                function = _over_time(edge.times, edge.tractions, frozen)
                vector = np.zeros(2)
                vector[edge.component] = 1.0
                self.loads.append(Traction(edge.edge, vector, function))
                nominal = (area, function)
            elif isinstance(edge, messages.EdgePressure):
                function = _over_time(edge.times, edge.pressures, frozen)
                vector = np.zeros(2)
                vector[axis] = -outward
                self.loads.append(Traction(edge.edge, vector, function, follower=True))
                nominal = (-outward * area, function)
            elif isinstance(edge, messages.EdgeKField):
                assert material is not None
                field = crack_tip_field(edge.field, material, f"edges.{number}.field")
                factor = _over_time(edge.times, edge.factors, frozen)
                condition = len(self.conditions) + axis
                faces = [FieldCondition(edge.edge, component, field, factor) for component in (0, 1)]
                moved = [face.along_face(lower, upper) for face in faces]
                self.conditions += faces
                self._mean[condition] = float(moved[axis].mean())
                self.farthest = max(self.farthest, float(np.abs(moved).max() * np.abs(edge.factors).max()))
            else:
                condition = len(self.conditions)
                self.conditions.append(_condition(edge, frozen))
            self._entries.append((condition, nominal))

    def state(self, reaction: FloatArray, time: float) -> tuple[FloatArray, FloatArray]:
        """Return force on the body [N] and prescribed displacement [m] of each entry.

        Of a face that follows a crack-tip field these are normal force and mean normal displacement.
        """
        now = np.array([time])
        force, displacement = np.zeros(len(self._entries)), np.zeros(len(self._entries))
        for k, (row, nominal) in enumerate(self._entries):
            if row is not None:
                force[k] = reaction[row]
                condition = self.conditions[row]
                if isinstance(condition, FieldCondition):
                    displacement[k] = self._mean[row] * condition.factor(now)[0]
                else:
                    displacement[k] = condition.displacement(now)[0]
            elif nominal is not None:
                force[k] = nominal[0] * nominal[1](now)[0]
        return force, displacement


def crack_tip_field(field: messages.KField, material: Material, name: str) -> CrackTipField:
    """Return the field of a message in a material.

    Raises
    ------
    ProtocolError
        `bad_field`, where the law of the material is not isotropic.
    """
    try:
        return CrackTipField.in_material(material, field.tip, field.k_1, field.k_2, field.angle)
    except ValueError as error:
        raise ProtocolError("bad_field", f"{name}: {error}", field=name) from None


def _over_time(times: list[float], values: list[float], frozen: bool) -> Constant | Table:
    return Constant(float(np.interp(0.0, times, values))) if frozen else Table(times, values)


def _condition(
    edge: messages.EdgeCondition | messages.EdgeVelocity | messages.EdgeSymmetry, frozen: bool
) -> EdgeCondition:
    if isinstance(edge, messages.EdgeSymmetry):
        return symmetry(edge.edge)
    if isinstance(edge, messages.EdgeCondition):
        return EdgeCondition(
            edge.edge, edge.component, displacements=_over_time(edge.times, edge.displacements, frozen)
        )
    if frozen:
        return EdgeCondition(edge.edge, edge.component, displacements=Constant(0.0))
    return EdgeCondition(edge.edge, edge.component, velocities=Table(edge.times, edge.velocities))


def _absorbing(edge: Edge, axis: int, material: Material) -> AbsorbingEdge:
    """Return an absorbing edge for waves along its normal."""
    if isinstance(material, LinearElastic | Laminate):
        normal, shear = material.stiffness[axis, axis], material.stiffness[2, 2]
    else:
        assert isinstance(material, NeoHookean | J2Plasticity)
        normal = material.density * material.pressure_wave_speed**2
        shear = material.young / (2.0 * (1.0 + material.poisson))
    density = material.density
    return AbsorbingEdge(edge, density, float(np.sqrt(normal / density)), float(np.sqrt(shear / density)))


def make_material(request: messages.ContinuumConfigure, connect: Callable[[str], Client]) -> Material:
    """Return the material of a problem.

    Parameters
    ----------
    request : ContinuumConfigure
    connect : callable
        Returns a new client of the micromechanics service at an endpoint. A `Laminate` holds the client of its cell
        until its `cell` is closed.

    Raises
    ------
    ProtocolError
        `bad_field`, where its constants do not go together, or there is no such service.
    """
    given = request.material
    if isinstance(given, messages.LaminateMaterial):
        if request.assumption != "plane_stress":
            raise ProtocolError(
                "bad_field", f"assumption: is {request.assumption}, a laminate is in plane_stress", field="assumption"
            )
        cell = CellClient(lambda: connect(given.micromechanics), given.cell.request())
        return Laminate(cell, given.angles, given.density, request.points_per_cell)
    constants = {name: value for name, value in given.model_dump().items() if name != "law"}
    try:
        if isinstance(given, messages.OrthotropicMaterial):
            # Moduli out of the plane play no part in it.
            constants |= {"shear_13": given.shear_12, "shear_23": given.shear_12}
        return _LAWS[given.law](**constants, assumption=request.assumption)
    except ValueError as error:
        raise bad_field(error, {name: f"material.{name}" for name in constants}) from None


def make_solver(
    request: messages.ContinuumConfigure, material: Material, make: SolverMaker, start: Approach | None = None
) -> tuple[MaterialPointSolver, Edges]:
    """Return the solver of a problem and its edges.

    With an approach it is the solver of the preload: of the whole body, without holes and with full weight, its loads
    and edges at their values of time zero.

    Raises
    ------
    ValueError
        Where the solver refuses something; the message begins with its name.
    """
    frozen = start is not None
    edges = Edges(
        request.edges, request.thickness, request.body.lower, request.body.upper, frozen=frozen, material=material
    )
    loads = list(edges.loads)
    if request.body_force is not None:
        force = request.body_force
        loads.append(BodyForce(force.acceleration, _over_time(force.times, force.factors, frozen)))
    gradient = request.initial_velocity_gradient
    grid, body = _fill(request, edges)
    further = {"approach": start} if frozen else {}
    solver = make(
        grid,
        body if frozen else _cut(request, body),
        material,
        request.thickness,
        request.time_step,
        edge_conditions=edges.conditions,
        cracks=[Crack(crack.points, crack.contact, crack.friction, growth_law(crack)) for crack in request.cracks],
        damping=Damping(request.damping_rate, request.point_damping_rate, request.force_scaling),
        initial_velocity_gradient=None if gradient is None or frozen else np.reshape(gradient, (2, 2)),
        scheme=Scheme(**request.scheme.model_dump()),
        loads=loads,
        **further,
    )
    return solver, edges


def _fill(request: messages.ContinuumConfigure, edges: Edges) -> tuple[Grid | HierarchicalGrid, Body]:
    """Return the grid, with room for the motion of its edges, and the points of the whole body round its holes."""
    lower, upper = request.body.lower, request.body.upper
    size = np.subtract(upper, lower)
    moves = [abs(value) for edge in request.edges for value in getattr(edge, "displacements", ())]
    margin = MARGIN_CELLS + int(np.ceil(max([edges.farthest, *moves]) / request.cell_size))
    cells = np.round(size / request.cell_size).astype(int) + 2 * margin
    origin = np.asarray(request.body.lower) - margin * request.cell_size
    uniform = Grid(tuple(origin), request.cell_size, (int(cells[0]), int(cells[1])))
    holes = [Hole(hole.centre, hole.radius) for hole in request.holes]
    if not request.refinement:
        return uniform, cut_holes(fill_rectangle(lower, upper, request.cell_size, request.points_per_cell), holes)
    nested = HierarchicalGrid(uniform, [(level.lower, level.upper) for level in request.refinement])
    return nested, cut_holes(fill_hierarchy(nested, lower, upper, request.points_per_cell), holes)


def _cut(request: messages.ContinuumConfigure, body: Body) -> Body:
    """Return the body with the overlaps of a request.

    Raises
    ------
    ProtocolError
        `bad_field`, where there can be no such overlap.
    """
    plain = request.overlap
    names = ["overlap"] if plain else [f"overlaps.{k}" for k in range(len(request.overlaps))]
    rings: list[Overlap] = []
    try:
        if plain:
            inner, outer = plain.inner, plain.outer
            rings.append(Overlap.between((inner.lower, inner.upper), (outer.lower, outer.upper), plain.weight))
        for region in request.overlaps:
            rings.append(
                Overlap(region.inner, region.outer, region.weight, region.profile, region.exponent, region.stiffness)
            )
    except OverlapError as error:
        raise _bad_overlap(error, names[len(rings)]) from None
    try:
        return cut_overlaps(body, rings)
    except OverlapError as error:
        raise _bad_overlap(error, names[error.number]) from None


def _bad_overlap(error: OverlapError, name: str) -> ProtocolError:
    return ProtocolError("bad_field", f"{name}: {error}", field=f"{name}.{error.part}")


def levels_of(request: messages.ContinuumConfigure, solver: MaterialPointSolver) -> list[messages.GridLevel]:
    """Return the levels of the grid with what they hold."""
    grid = solver.grid
    sizes = grid.cell_sizes if isinstance(grid, HierarchicalGrid) else (grid.cell_size,)
    level = np.round(np.log2(0.5 * sizes[0] / request.points_per_cell / solver.points.half)).astype(int)
    counts = np.bincount(level, minlength=len(sizes))
    return [
        messages.GridLevel(cell_size=size, cells=int(count) // request.points_per_cell**2, points=int(count))
        for size, count in zip(sizes, counts, strict=True)
    ]


def bad_field(error: ValueError, names: dict[str, str]) -> ProtocolError:
    """Return the solver's complaint with the field as the messages name it."""
    name = re.split(r"[ \[:=.]", str(error), maxsplit=1)[0]
    return ProtocolError("bad_field", str(error), field=names.get(name, name))
