"""What the run of a laminate scene would be, before it runs."""

from __future__ import annotations

from coordinator.laminate_scene import LaminateScene
from coordinator.units import LENGTHS, readable
from protocol.backend import find

#: Seconds of one solution for each point (assembly, factorisation, micromechanics, on one core) with so many points,
#: and the power with which they grow: factorisation grows faster than the points. Measured with 3584 and 7680 points.
_SECONDS_PER_POINT, _AT_POINTS, _GROWTH = 1.5e-5, 3584, 0.4
#: Solutions of an increment, before and while it fails.
_SOLUTIONS = (2, 10)


def describe_laminate(scene: LaminateScene) -> str:
    """Return sizes, services and the estimated cost of a laminate scene, in lines.

    Raises
    ------
    BackendError
        If a backend is not installed.
    ValueError
        If the cell file has mistakes.
    """
    plate, micro = scene.laminate, scene.micromechanics
    cell = find("micromechanics", micro.backend).read_cell(scene.cell_file)
    find("structure", scene.structure.backend)
    plies = len(scene.modelled_angles)
    bricks = plane_elements(scene) * plies * scene.mesh.bricks_per_ply
    increments = round(1.0 / scene.load.most)
    points = 8 * bricks
    solution = _SECONDS_PER_POINT * points * (points / _AT_POINTS) ** _GROWTH
    low, high = (solution * increments * count for count in _SOLUTIONS)
    symmetry = [
        name for name, used in (("x = 0 and y = 0", scene.quarter), ("the middle plane", scene.lower_half)) if used
    ]
    hole = "" if plate.hole_diameter is None else f", hole {readable(plate.hole_diameter, LENGTHS)}"
    if plate.notch_diameter is not None:
        hole = f", notches {readable(plate.notch_diameter, LENGTHS)}"
    lines = [
        scene.title or scene.name,
        f"plate      {readable(plate.length, LENGTHS)} x {readable(plate.width, LENGTHS)}{hole}",
        f"plies      {plate.layup}: {len(scene.layup.angles)} of {readable(plate.ply_thickness, LENGTHS)}, "
        f"{plies} modelled",
        f"symmetry   {' and '.join(symmetry) or 'none used'}",
        *([] if scene.plane is None else [f"mesh       {scene.mesh.file}"]),
        f"elements   {bricks} bricks, {points} points"
        + (", cohesive layers between plies of different angle" if scene.cohesive else ", plies are tied"),
        f"cell       {cell.phase.shape[0]} x {cell.phase.shape[1]} subcells of "
        f"{', '.join(material.name for material in cell.materials)}",
        f"load       to {100 * scene.load.final_strain:g} % in at least {increments} increments",
        f"services   micromechanics ({micro.backend}, {micro.workers} worker{'s' if micro.workers > 1 else ''}), "
        f"structure ({scene.structure.backend})",
        f"estimate   {low:.2g} to {high:.2g} s",
    ]
    return "\n".join(lines)


def plane_elements(scene: LaminateScene) -> int:
    """Elements in the plane of the part that is modelled."""
    mesh = scene.mesh
    if scene.plane is not None:
        return len(scene.plane.elements)
    if scene.laminate.hole_diameter is None and scene.laminate.notch_diameter is None:
        return (mesh.columns or 0) * (mesh.rows or 0)
    quarter = (mesh.around or 0) * (mesh.radial or 0) + (mesh.around or 0) // 2 * mesh.beyond
    return quarter if scene.quarter else 4 * quarter
