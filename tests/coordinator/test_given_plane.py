"""Scenes whose mesh stands in a file, and scenes as decks for other codes."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from coordinator.cli import cli
from coordinator.given_plane import GivenPlane, read_given_plane
from coordinator.laminate_check import describe_laminate
from coordinator.laminate_request import configure_request
from coordinator.laminate_scene import load_laminate
from coordinator.scene_file import SceneError
from protocol.backend import Backend, BackendError, find

CELL = Path(__file__).parents[2] / "scenes" / "cells" / "im7_epon862_neat.toml"
SCENE = f"""
[laminate]
layup = "[0/90]s"
ply_thickness = "0.25 mm"
length = "8 mm"
width = "6 mm"
[mesh]
file = "plate.inp"
[load]
final_strain = 0.01
[micromechanics]
cell = "{CELL}"
"""


def deck(low: tuple[float, float], high: tuple[float, float], columns: int = 4, rows: int = 3) -> str:
    """Quadrilaterals of a rectangle, counted from 1."""
    x, y = np.meshgrid(np.linspace(low[0], high[0], columns + 1), np.linspace(low[1], high[1], rows + 1), indexing="ij")
    places = zip(x.ravel().tolist(), y.ravel().tolist(), strict=True)
    nodes = [f"{row}, {a!r}, {b!r}" for row, (a, b) in enumerate(places, 1)]
    number = 1 + np.arange(x.size).reshape(x.shape)
    corners = np.stack([number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], axis=-1).reshape(-1, 4)
    quads = [f"{row}, {', '.join(map(str, nodes.tolist()))}" for row, nodes in enumerate(corners, 1)]
    return "\n".join(["*NODE", *nodes, "*ELEMENT, TYPE=CPS4", *quads]) + "\n"


QUARTER, WHOLE = deck((0.0, 0.0), (4.0, 3.0)), deck((-4.0, -3.0), (4.0, 3.0))


def scene_file(folder: Path, mesh: str | None = QUARTER, text: str = SCENE) -> Path:
    if mesh is not None:
        (folder / "plate.inp").write_text(mesh)
    path = folder / "plate.toml"
    path.write_text(text)
    return path


def problems(path: Path, *overrides: str) -> tuple[str, ...]:
    with pytest.raises(SceneError) as caught:
        load_laminate(path, overrides)
    return caught.value.problems


def test_the_file_decides_whether_a_quarter_is_modelled(tmp_path: Path) -> None:
    quarter, whole = load_laminate(scene_file(tmp_path)), load_laminate(scene_file(tmp_path, WHOLE))
    assert quarter.quarter and not whole.quarter
    assert quarter.lower_half and whole.lower_half  # the middle plane is a matter of the layup
    assert quarter.plane is not None and quarter.plane.nodes.max(axis=0) == pytest.approx([4e-3, 3e-3])
    lines = describe_laminate(quarter)
    assert "elements   24 bricks, 192 points" in lines and "mesh       plate.inp" in lines
    request = configure_request(whole, find("micromechanics", "gmc_service").read_cell(CELL), "ipc://x")
    assert whole.plane is not None and request.plane_nodes is not None and request.plane_elements is not None
    np.testing.assert_array_equal(request.plane_nodes, whole.plane.nodes)
    np.testing.assert_array_equal(request.plane_elements, whole.plane.elements)
    assert not request.quarter and request.lower_half


def test_the_unit_is_that_of_the_scene(tmp_path: Path) -> None:
    path = scene_file(tmp_path, deck((0.0, 0.0), (4e-3, 3e-3)))
    assert load_laminate(path, ["mesh.file_unit=m"]).quarter
    (line,) = problems(path)
    assert line == (
        f'{path}: mesh.file = "plate.inp": spans x from 0 m to 4 um and y from 0 m to 3 um; the plate spans x from '
        "-4 mm to 4 mm and y from -3 mm to 3 mm, its quarter x from 0 m to 4 mm and y from 0 m to 3 mm; the file is "
        "read in mm (mesh.file_unit)"
    )
    assert "must be one of 'm', 'cm', 'mm', 'um' or 'inch'" in problems(path, "mesh.file_unit=furlong")[0]


def test_what_the_reader_refuses_is_a_mistake_of_the_scene(tmp_path: Path) -> None:
    path = scene_file(tmp_path, QUARTER.replace("\n5, 6, 10, 11, 7\n", "\n5, 10, 6, 11, 7\n"))
    (line,) = problems(path)
    assert line.startswith(f'{path}: mesh.file = "plate.inp": {tmp_path / "plate.inp"}: element 5 is turned inside out')
    (tmp_path / "plate.inp").unlink()
    assert "plate.inp: cannot be read: No such file or directory" in problems(path)[0]


def test_a_quarter_needs_its_symmetry(tmp_path: Path) -> None:
    path = scene_file(tmp_path)
    for override in ("laminate.symmetry=false", "laminate.layup=[45/-45]s"):
        (line,) = problems(path, override)
        assert line == (
            f'{path}: mesh.file = "plate.inp": is a quarter of the plate: that needs laminate.symmetry and plies along '
            "x or y; a mesh of the whole plate does not"
        )


def test_keys_that_the_file_replaces_must_be_left_out(tmp_path: Path) -> None:
    path = scene_file(tmp_path)
    for key, value in (("mesh.columns", "4"), ("mesh.around", "4"), ("mesh.growth", "2.0"), ("mesh.beyond", "1")):
        assert re.search(r"must be left out: mesh\.file gives the mesh", problems(path, f"{key}={value}")[0])
    for key in ("laminate.hole_diameter", "laminate.notch_diameter"):
        assert "must be left out: mesh.file gives the mesh, holes included" in problems(path, f"{key}=1 mm")[0]
    alone = SCENE.replace('file = "plate.inp"', 'file_unit = "m"\ncolumns = 2\nrows = 2')
    assert 'mesh.file_unit = "m": needs mesh.file' in problems(scene_file(tmp_path, text=alone))[0]


def test_another_mesh_has_another_digest(tmp_path: Path) -> None:
    path = tmp_path / "plate.inp"
    path.write_text(QUARTER)
    one = read_given_plane(path, "mm", "fem_service", 8e-3, 6e-3)
    moved = one.nodes.copy()
    moved[6, 0] = np.nextafter(moved[6, 0], 1.0)
    assert one.digest == GivenPlane(one.nodes.copy(), one.elements.copy(), True).digest
    assert one.digest != replace(one, nodes=moved).digest != replace(one, elements=one.elements[::-1].copy()).digest


def test_a_backend_that_reads_and_writes_nothing_says_so(tmp_path: Path) -> None:
    other = Backend("other", "structure", "of another", "nowhere:make")
    with pytest.raises(BackendError, match="backend other reads no mesh files"):
        other.read_plane(tmp_path / "plate.inp", 1.0)
    scene = load_laminate(scene_file(tmp_path))
    micromechanics = find("micromechanics", "gmc_service")
    request = configure_request(scene, micromechanics.read_cell(CELL), "")
    with pytest.raises(BackendError, match="backend other writes no decks"):
        other.write_deck(request, None, [])  # type: ignore[arg-type]


# --- scenes as decks -------------------------------------------------------------------------------


def exported(folder: Path, path: Path, *overrides: str) -> tuple[str, str]:
    """What the command says, and the deck."""
    words = [word for override in overrides for word in ("--set", override)]
    file = folder / "out.inp"
    told = CliRunner().invoke(cli, ["export", str(path), "--inp", str(file), *words], catch_exceptions=False)
    assert told.exit_code == 0, told.output
    return told.output, file.read_text()


def test_a_deck_says_what_it_is(tmp_path: Path) -> None:
    told, text = exported(tmp_path, scene_file(tmp_path))
    for note in ("plies [0/90]s, from the lowest up PLY_1", "the quarter with x and y above 0", "the plies below the"):
        assert note in told and f"** {note}" in text
    assert text.count("*ELEMENT, TYPE=C3D8") == 2 and "COH" not in text
    # The end at x = 4 mm moves by half of 0.01 of 8 mm.
    assert re.search(r"^GRIP_\d+, 1, 1, 0\.04$", text, flags=re.MULTILINE)
    constants = text[text.index("*ELASTIC, TYPE=ENGINEERING CONSTANTS") :].splitlines()[1].split(",")
    assert float(constants[0]) == pytest.approx(166785.894, rel=1e-8)  # Table 6.1's cell, MPa; see docs/laminates.md


def test_cohesive_layers_are_left_out_and_that_is_said(tmp_path: Path) -> None:
    layers = """[cohesive]
stiffness = "2.71e8 MPa/mm"
normal_strength = "40 MPa"
shear_strength = "60 MPa"
opening_toughness = "0.25 kJ/m^2"
sliding_toughness = "0.8 kJ/m^2"
"""
    tied = exported(tmp_path, scene_file(tmp_path))[1]
    told, text = exported(tmp_path, scene_file(tmp_path, text=SCENE + layers))
    assert "cohesive layers are left out: the plies are tied" in told
    assert [line for line in text.splitlines() if not line.startswith("**")] == [
        line for line in tied.splitlines() if not line.startswith("**")
    ]
