"""Read scene files: TOML with units, overrides from the command line, every mistake reported at once."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from coordinator.atomistic_tables import Atomistic
from coordinator.continuum_tables import Continuum, Edge, Material
from coordinator.grid_lines import snapped_overlap
from coordinator.scene_checks import cross_checks
from coordinator.scene_file import SceneError, file_text, problem_line, read_table, validated
from coordinator.scene_tables import Crack, Handshake, Place, Run, Scene
from coordinator.table import Corners

__all__ = [
    "Atomistic",
    "Continuum",
    "Corners",
    "Crack",
    "Edge",
    "Handshake",
    "Material",
    "Place",
    "Run",
    "Scene",
    "SceneError",
    "load_scene",
    "read_resolved",
    "read_scene",
    "snapped_overlap",
]


def load_scene(path: str | Path, overrides: Sequence[str] = ()) -> Scene:
    """Read a scene file.

    Parameters
    ----------
    path : str or Path
        A TOML file.
    overrides : sequence of str
        ``"key.sub=value"`` each, applied in order and checked like the file. The value is TOML, or,
        where it is not, taken as text; items of lists are addressed by number, from 0.

    Returns
    -------
    Scene
        All values in SI.

    Raises
    ------
    SceneError
        If the file cannot be read, is not TOML, or anything in it or the overrides is not allowed. Its
        text has one line per mistake, ``FILE: field.path = value: what is allowed``.
    """
    file = Path(path)
    text = file_text(file)
    scene = read_scene(text, file.stem, overrides, str(file))
    scene.of_file(file.stem, text, overrides, file.resolve().parent)
    sample = scene.atomistic.sample if scene.atomistic is not None and scene.atomistic.from_file else None
    if sample is not None and not (scene.folder / sample).is_file():
        raise SceneError([problem_line(str(file), ("atomistic", "sample"), {"atomistic": {"sample": sample}},
                                f"there is no such file in {scene.folder}")])  # fmt: skip
    if scene.micromechanics is not None and not (scene.folder / scene.micromechanics.cell).is_file():
        raise SceneError([problem_line(str(file), ("micromechanics", "cell"),
                                       {"micromechanics": {"cell": scene.micromechanics.cell}},
                                       f"there is no such file in {scene.folder}")])  # fmt: skip
    return scene


def read_scene(text: str, name: str, overrides: Sequence[str] = (), file: str = "scene") -> Scene:
    """Read the text of a scene file; see `load_scene`.

    Parameters
    ----------
    text : str
        TOML.
    name : str
        Name of the scene.
    overrides : sequence of str
        As in `load_scene`.
    file : str
        Name of the file in messages.

    Returns
    -------
    Scene

    Raises
    ------
    SceneError
        As `load_scene`.
    """
    scene = read_table(Scene, cross_checks, text, overrides, file)
    return scene.of_file(name, text, overrides)


def read_resolved(values: dict[str, Any], name: str = "") -> Scene:
    """Read back a scene from ``scene.model_dump(mode="json")``: the same values, already in SI.

    Raises
    ------
    SceneError
        If the values are no scene.
    """
    scene, problems = validated(Scene, cross_checks, values, si=True)
    if scene is None:
        raise SceneError([problem_line("resolved scene", where, values, allowed) for where, allowed in problems])
    return scene.of_file(name)
