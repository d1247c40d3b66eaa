"""From the message that configures a laminate to its mesh, grips and law."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fem_service.cohesive_law import CohesiveLaw
from fem_service.laminate_mesh import LaminateMesh, stack
from fem_service.plane_mesh import PlaneMesh, open_hole, rectangle
from fem_service.quasi_static import Grips
from fem_service.tension import tension_grips
from protocol import structure as s
from protocol.errors import ProtocolError
from protocol.micromechanics import RegisterCell


def mesh_of(request: s.StructureConfigure) -> LaminateMesh:
    """Mesh of the part of the laminate that is modelled.

    Raises
    ------
    ProtocolError
        ``bad_field``, where the plate cannot be meshed as asked.
    """
    try:
        plane = _plane(request)
        return stack(
            plane,
            np.array(request.angles),
            request.ply_thickness,
            per_ply=request.mesh.bricks_per_ply,
            cohesive=request.cohesive is not None,
        )
    except ValueError as error:
        raise ProtocolError("bad_field", f"mesh: {error}", field="mesh") from None


def _plane(request: s.StructureConfigure) -> PlaneMesh:
    mesh = request.mesh
    if request.quarter and any(abs(np.sin(2.0 * angle)) > 1e-9 for angle in request.angles):
        raise ProtocolError(
            "bad_field", "quarter: x = 0 and y = 0 are planes of symmetry of plies along x and y alone", field="quarter"
        )
    if request.hole_diameter is None:
        columns, rows = _needed(mesh, "columns"), _needed(mesh, "rows")
        if not request.quarter:
            plane = rectangle(request.length, request.width, columns, rows)
            return replace(plane, nodes=plane.nodes - 0.5 * np.array([request.length, request.width]))
        return rectangle(0.5 * request.length, 0.5 * request.width, columns, rows)
    return open_hole(
        request.length,
        request.width,
        request.hole_diameter,
        around=_needed(mesh, "around"),
        radial=_needed(mesh, "radial"),
        growth=mesh.growth,
        beyond=mesh.beyond,
        quadrant=request.quarter,
    )


def _needed(mesh: s.PlateMesh, name: str) -> int:
    value: int | None = getattr(mesh, name)
    if value is None:
        raise ProtocolError(
            "bad_field", f"mesh.{name} is missing; a plate {_KIND[name]} needs it", field=f"mesh.{name}"
        )
    return value


_KIND = {"around": "with a hole", "radial": "with a hole", "columns": "without a hole", "rows": "without a hole"}


def grips_of(request: s.StructureConfigure, mesh: LaminateMesh) -> Grips:
    """Grips that have the whole elongation at a load of 1."""
    unit = tension_grips(mesh, quarter=request.quarter, lower_half=request.lower_half)
    return replace(unit, per_load=unit.per_load * request.final_strain * request.length)


def law_of(request: s.StructureConfigure) -> CohesiveLaw | None:
    """Law of the cohesive layers, None where plies are tied.

    Raises
    ------
    ProtocolError
        ``bad_field``, where the constants contradict each other.
    """
    if request.cohesive is None:
        return None
    try:
        return CohesiveLaw(**request.cohesive.model_dump())
    except ValueError as error:
        raise ProtocolError("bad_field", f"cohesive: {error}", field="cohesive") from None


def cell_of(request: s.StructureConfigure) -> RegisterCell:
    """Definition of the cell, as the role `micromechanics` takes it."""
    materials = request.materials
    if request.damage == "none":
        materials = [material.model_copy(update={"failures": [], "fracture_energy": None}) for material in materials]
    fields = {name: getattr(request, name) for name in RegisterCell.model_fields}
    return RegisterCell(**{**fields, "materials": materials})


def shares(request: s.StructureConfigure) -> tuple[float, float]:
    """How many times the force of the model the whole laminate has, and its whole cross section, m^2."""
    halves = 2.0 if request.lower_half else 1.0
    # The quarter's grips work with half of the elongation on half of the width.
    force = halves * (4.0 if request.quarter else 1.0)
    section = halves * request.width * request.ply_thickness * len(request.angles)
    return force, section
