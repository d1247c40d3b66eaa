"""A laminate scene as a deck for CalculiX and Abaqus."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from coordinator.laminate_request import configure_request
from coordinator.laminate_scene import LaminateScene, load_laminate
from protocol.backend import find
from protocol.micromechanics import CellProperties, CellPropertiesRequest, RegisterCell


def export_laminate(scene_path: Path, file: Path, overrides: Sequence[str] = ()) -> list[str]:
    """Write the part of the laminate that a run would model, pulled to its final strain, with intact cells.

    Parameters
    ----------
    scene_path : Path
    file : Path
        To write.
    overrides : sequence of str
        As of `coordinator.scene.load_scene`.

    Returns
    -------
    list of str
        What to know of the deck, a line each; it says so itself too.

    Raises
    ------
    SceneError
        If the scene has mistakes.
    BackendError
        If a backend is not installed, or that of the structure writes no decks.
    ValueError
        If the cell file has mistakes.
    ProtocolError
        If the plate cannot be meshed as asked.
    """
    scene = load_laminate(scene_path, overrides)
    cell = find("micromechanics", scene.micromechanics.backend).read_cell(scene.cell_file)
    request = configure_request(scene, cell, "")
    notes = _notes(scene, cell)
    text = find("structure", scene.structure.backend).write_deck(request, _properties(scene, cell), notes)
    new = file.with_name(file.name + ".new")
    new.write_text(text, encoding="utf-8")
    os.replace(new, file)
    return notes


def _properties(scene: LaminateScene, cell: RegisterCell) -> CellProperties:
    with tempfile.TemporaryDirectory() as folder:
        service: Any = find("micromechanics", scene.micromechanics.backend).make(Path(folder))
        known = service.register(cell).cell
        temperature = scene.laminate.temperature
        properties: CellProperties = service.properties(CellPropertiesRequest(cell=known, temperature=temperature))
    return properties


def _notes(scene: LaminateScene, cell: RegisterCell) -> list[str]:
    notes = [
        f"scene {scene.name}: {scene.title}",
        f"plies {scene.laminate.layup}, from the lowest up PLY_1, PLY_2, ...",
    ]
    if scene.quarter:
        notes.append("the quarter with x and y above 0, held by its planes of symmetry")
    if scene.lower_half:
        notes.append("the plies below the middle plane, held by it")
    notes.append(f"the ends part by {scene.load.final_strain:g} of the length")
    notes.append("plies have the stiffness of the intact cell: nothing fails")
    if cell.stress_free_temperature != scene.laminate.temperature:
        notes.append("stresses of cooling are left out: displacements and forces count from the laminate at rest")
    if scene.cohesive is not None:
        notes.append("cohesive layers are left out: the plies are tied")
    return notes
