"""The request that sets up a laminate, from its scene."""

from __future__ import annotations

from coordinator.laminate_scene import LaminateScene, radians
from protocol import structure as s
from protocol.micromechanics import RegisterCell


def configure_request(scene: LaminateScene, cell: RegisterCell, micromechanics: str) -> s.StructureConfigure:
    """Return the laminate of a scene as the role `structure` takes it.

    Parameters
    ----------
    scene : LaminateScene
    cell : RegisterCell
        That of the scene's cell file.
    micromechanics : str
        Endpoint of the service that answers for the cell.
    """
    plate, mesh, load = scene.laminate, scene.mesh, scene.load
    return s.StructureConfigure(
        **{name: getattr(cell, name) for name in RegisterCell.model_fields},
        length=plate.length,
        width=plate.width,
        hole_diameter=plate.hole_diameter,
        notch_diameter=plate.notch_diameter,
        angles=radians(scene.modelled_angles),
        ply_thickness=plate.ply_thickness,
        quarter=scene.quarter,
        lower_half=scene.lower_half,
        mesh=s.PlateMesh(
            **mesh.model_dump(exclude={"integration", "file", "file_unit"}),
            mean_dilatation=mesh.integration == "selective",
        ),
        plane_nodes=None if scene.plane is None else scene.plane.nodes,
        plane_elements=None if scene.plane is None else scene.plane.elements,
        cohesive=None if scene.cohesive is None else s.CohesiveConstants(**scene.cohesive.model_dump()),
        temperature=plate.temperature,
        final_strain=load.final_strain,
        increments=s.Increments(**load.model_dump(exclude={"final_strain", "stop_below"})),
        damage="elimination" if scene.micromechanics.failure else "none",
        micromechanics=micromechanics,
    )
