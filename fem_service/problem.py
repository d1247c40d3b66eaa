"""From the message that configures a laminate to its mesh, grips and law."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fem_service.cohesive_law import CohesiveLaw
from fem_service.equilibrium import Grips
from fem_service.laminate_deck import laminate_deck
from fem_service.laminate_mesh import LaminateMesh, stack
from fem_service.notched_bar import edge_notches
from fem_service.plane_check import check_plane, fitted
from fem_service.plane_mesh import PlaneMesh, open_hole, rectangle
from fem_service.tension import tension_grips
from protocol import structure as s
from protocol.errors import ProtocolError
from protocol.micromechanics import CellProperties, RegisterCell


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
        field = "mesh" if request.plane_nodes is None else "plane_elements"
        raise ProtocolError("bad_field", f"{field}: {error}", field=field) from None


def _plane(request: s.StructureConfigure) -> PlaneMesh:
    if request.quarter and any(abs(np.sin(2.0 * angle)) > 1e-9 for angle in request.angles):
        raise ProtocolError(
            "bad_field", "quarter: x = 0 and y = 0 are planes of symmetry of plies along x and y alone", field="quarter"
        )
    half = 0.5 * np.array([request.length, request.width])
    if request.plane_nodes is not None and request.plane_elements is not None:
        plane = PlaneMesh(request.plane_nodes, request.plane_elements)
        check_plane(plane)
        return fitted(plane, request.length, request.width, quarter=request.quarter)
    mesh = request.mesh
    diameter = request.hole_diameter or request.notch_diameter
    if diameter is None:
        columns, rows = _needed(mesh, "columns"), _needed(mesh, "rows")
        if not request.quarter:
            plane = rectangle(request.length, request.width, columns, rows)
            return replace(plane, nodes=plane.nodes - half)
        return rectangle(float(half[0]), float(half[1]), columns, rows)
    make = open_hole if request.notch_diameter is None else edge_notches
    return make(
        request.length,
        request.width,
        diameter,
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


_KIND = {
    "around": "with a hole or notches",
    "radial": "with a hole or notches",
    "columns": "without a hole",
    "rows": "without a hole",
}


def grips_of(request: s.StructureConfigure, mesh: LaminateMesh) -> Grips:
    """Grips that have the whole elongation at a load of 1."""
    unit = tension_grips(mesh, quarter=request.quarter, lower_half=request.lower_half)
    return replace(unit, per_load=unit.per_load * request.final_strain * request.length)


def deck_of(request: s.StructureConfigure, cell: CellProperties, comments: Sequence[str]) -> str:
    """The laminate, at the end of its load, as a deck that CalculiX and Abaqus run.

    Its plies are tied and have no stress at rest: what the laminate does under load is, as long as nothing fails, the
    same with it.

    Raises
    ------
    ProtocolError
        ``bad_field``, where the plate cannot be meshed as asked.
    """
    mesh = mesh_of(request.model_copy(update={"cohesive": None}))
    return laminate_deck(mesh, grips_of(request, mesh), cell.stiffness, comments)


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


def dissipation_of(request: s.StructureConfigure) -> float | None:
    """Energy that an increment of the part that is modelled takes where it softens, J; None: increments by the load.

    Raises
    ------
    ProtocolError
        ``bad_field``, where what the laminate takes is not that of an increment: where it fails at once, or does not
        unload to the origin.
    """
    whole = request.increments.dissipation
    if whole is None:
        return None
    for place, material in enumerate(request.materials):
        if request.damage != "none" and material.failures and material.fracture_energy is None:
            raise _uncontrolled(f"materials.{place} ({material.name}) has no fracture_energy: what fails at once takes"
                                " what it takes")  # fmt: skip
        if material.plasticity is not None:
            raise _uncontrolled(f"materials.{place} ({material.name}) yields, and so does not unload to the origin")
        if request.temperature != request.stress_free_temperature and np.any(material.expansion):
            raise _uncontrolled("temperature is not stress_free_temperature, so it does not unload to the origin")
    return whole / shares(request)[0]


def _uncontrolled(why: str) -> ProtocolError:
    return ProtocolError(
        "bad_field", f"increments.dissipation cannot be prescribed: {why}", field="increments.dissipation"
    )


def shares(request: s.StructureConfigure) -> tuple[float, float]:
    """How many times the energy of the model the whole laminate has, and its whole cross section, m^2."""
    halves = 2.0 if request.lower_half else 1.0
    energy = halves * (4.0 if request.quarter else 1.0)
    section = halves * request.width * request.ply_thickness * len(request.angles)
    return energy, section
