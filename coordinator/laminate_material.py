"""The law ``laminate`` of a continuum scene: its cell file, and the material that the continuum service is told."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from coordinator.layup import read_layup
from coordinator.scene import Scene
from protocol import continuum as c
from protocol.arrays import FloatArray
from protocol.backend import find
from protocol.laminate_material import CellDefinition
from protocol.micromechanics import RegisterCell


def read_cell(scene: Scene) -> RegisterCell | None:
    """Return the cell of a scene as its material has it; None for a scene without one.

    Raises
    ------
    BackendError
        Where the backend is not installed or reads no cell files.
    ValueError
        Where the cell file has mistakes.
    """
    table = scene.micromechanics
    if table is None:
        return None
    cell = find("micromechanics", table.backend).read_cell(scene.folder / table.cell)
    if table.failure:
        return cell
    plain = [material.model_copy(update={"failures": [], "fracture_energy": None}) for material in cell.materials]
    return cell.model_copy(update={"materials": plain})


def laminate_of(scene: Scene, cell: RegisterCell, endpoint: str) -> c.LaminateMaterial:
    """Return the material of a scene with the law ``laminate``, whose cell a service at `endpoint` answers for."""
    material = scene.continuum.material
    assert material is not None and material.layup is not None  # held by the scene's checks
    return c.LaminateMaterial(
        angles=np.radians(read_layup(material.layup).angles).tolist(),
        density=material.density,
        cell=CellDefinition.of(cell),
        micromechanics=endpoint,
    )


def failed_by_ply(laminate: c.LaminateMaterial, failed: FloatArray) -> dict[str, FloatArray]:
    """Take the field ``failed`` apart.

    Parameters
    ----------
    laminate : LaminateMaterial
    failed : ndarray, shape (points, directions, materials)
        Share of the subcells that has failed.

    Returns
    -------
    dict of str to ndarray, shape (points,)
        By direction and material, such as "90 matrix".
    """
    # -90 and 90 degrees are one direction.
    degrees = [90.0 - round(90.0 - float(np.degrees(angle)), 6) % 180.0 for angle in laminate.angles]
    directions = list(dict.fromkeys(degrees))
    return {
        f"{angle:g} {material.name}": np.ascontiguousarray(failed[:, direction, number])
        for direction, angle in enumerate(directions)
        for number, material in enumerate(laminate.cell.materials)
    }


def plain_cell(cell: RegisterCell) -> dict[str, Any]:
    """Return a cell as it is read back from a checkpoint."""
    found: dict[str, Any] = json.loads(json.dumps(CellDefinition.of(cell).model_dump()))
    return found
