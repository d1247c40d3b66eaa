"""Scenes of laminates: every mistake is named with its field and what is allowed there."""

from __future__ import annotations

from pathlib import Path

import pytest

from coordinator.laminate_check import describe_laminate, plane_elements
from coordinator.laminate_scene import LaminateScene, load_laminate
from coordinator.scene_file import SceneError
from coordinator.scene_kind import is_laminate

SCENES = Path(__file__).parents[2] / "scenes"
CELL = SCENES / "cells" / "im7_epon862_neat.toml"
SCENE = f"""
title = "cross-ply"
[laminate]
layup = "[0/90]s"
ply_thickness = "0.25 mm"
length = "8 mm"
width = "8 mm"
hole_diameter = "3.175 mm"
[mesh]
around = 8
radial = 6
growth = 3.0
[load]
final_strain = 0.012
[micromechanics]
cell = "{CELL}"
"""
COHESIVE = """
[cohesive]
stiffness = "2.71e8 MPa/mm"
normal_strength = "60 MPa"
shear_strength = "90 MPa"
opening_toughness = "0.2 N/mm"
sliding_toughness = "0.6 kJ/m^2"
"""


def read(folder: Path, text: str = SCENE, *overrides: str) -> LaminateScene:
    file = folder / "plate.toml"
    file.write_text(text)
    return load_laminate(file, overrides)


def problems(folder: Path, text: str, *overrides: str) -> list[str]:
    with pytest.raises(SceneError) as caught:
        read(folder, text, *overrides)
    return [line.removeprefix(f"{folder}/plate.toml: ") for line in caught.value.problems]


def test_values_are_in_si_and_defaults_are_set(tmp_path: Path) -> None:
    scene = read(tmp_path, SCENE + COHESIVE)
    assert scene.name == "plate" and scene.title == "cross-ply"
    assert scene.laminate.ply_thickness == pytest.approx(2.5e-4)
    assert scene.laminate.hole_diameter == pytest.approx(3.175e-3)
    assert scene.laminate.temperature == 300.0
    assert scene.cohesive is not None
    assert scene.cohesive.stiffness == pytest.approx(2.71e17)
    assert scene.cohesive.opening_toughness == pytest.approx(200.0)
    assert scene.cohesive.sliding_toughness == pytest.approx(600.0)
    assert (scene.load.first, scene.load.most, scene.output.fields_every) == (0.02, 0.05, 5)
    assert scene.micromechanics.backend == "gmc_service" and scene.structure.backend == "fem_service"
    assert scene.cell_file == CELL


@pytest.mark.parametrize(
    ("layup", "symmetry", "quarter", "half", "modelled"),
    [
        ("[0/90]s", True, True, True, (0, 90)),
        ("[0/90]s", False, False, False, (0, 90, 90, 0)),
        ("[0/90]", True, True, False, (0, 90)),
        ("[0/90/0]", True, True, False, (0, 90, 0)),  # the middle ply lies across the plane
        ("[45/0/-45/90]2s", True, False, True, (45, 0, -45, 90, 45, 0, -45, 90)),
        ("[-90]", True, True, False, (-90,)),
    ],
)
def test_planes_of_symmetry_follow_from_the_layup(
    tmp_path: Path, layup: str, symmetry: bool, quarter: bool, half: bool, modelled: tuple[float, ...]
) -> None:
    scene = read(tmp_path, SCENE, f'laminate.layup="{layup}"', f"laminate.symmetry={str(symmetry).lower()}")
    assert (scene.quarter, scene.lower_half, scene.modelled_angles) == (quarter, half, modelled)


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ('layup = "[0/90]s"', 'layup = "[0/x]s"', 'laminate.layup = "[0/x]s": layup is \'[0/x]s\'; character 4 is \'x\''
         " where an angle in degrees or [ must be, such as in [45/0/-45/90]2s"),
        ('layup = "[0/90]s"', "", "laminate.layup: is missing; needed: plies from the lowest up"),
        ('"0.25 mm"', '"0.25 K"', 'laminate.ply_thickness = "0.25 K": must be a length'),
        ('"0.25 mm"', '"-0.25 mm"', 'laminate.ply_thickness = "-0.25 mm": must be '),
        ('"3.175 mm"', '"8 mm"', 'laminate.hole_diameter = "8 mm": must be less than the width'),
        ('length = "8 mm"', 'length = "4 mm"', 'laminate.length = "4 mm": must be at least the width of a'),
        ('length = "8 mm"', 'length = "16 mm"', "mesh.beyond: must be at least 1, since the plate is longer than wide"),
        ("growth = 3.0", "beyond = 2", "mesh.beyond = 2: must be 0, since the plate is square"),
        ("growth = 3.0", "growth = 0", "mesh.growth = 0: must be greater than 0"),
        ("growth = 3.0", "columns = 4", "mesh.columns = 4: a plate with a hole has none"),
        ("around = 8", "", "mesh.around: is missing; a plate with a hole needs it"),
        ("around = 8", "around = 7", "mesh.around = 7: must be even"),
        ("around = 8", "around = 8.0", "mesh.around = 8.0: must be a whole number"),
        ('hole_diameter = "3.175 mm"', "", "mesh.columns: is missing; a plate without a hole needs it"),
        ("growth = 3.0", 'integration = "none"', "mesh.integration = \"none\": must be one of 'full' or 'selective'"),
        ("final_strain = 0.012", "final_strain = 0", "load.final_strain = 0: must be greater than 0"),
        ("final_strain = 0.012", "final_strain = 0.01\nfirst = 0.2", "load.first = 0.2: must lie between load.least"),
        ("final_strain = 0.012", "final_strain = 0.01\nstop_below = 1", "load.stop_below = 1: must be less than 1"),
        ("final_strain = 0.012", "final_strain = 0.01\nviscosity = -1", "load.viscosity = -1: must be "),
        ("final_strain = 0.012", 'final_strain = 0.01\ndissipation = "2 mm"',
         'load.dissipation = "2 mm": must be a'),
        ("final_strain = 0.012", 'final_strain = 0.01\nviscosity = 1e-4\ndissipation = "2 mJ"',
         'load.dissipation = "2 mJ": cannot stand beside load.viscosity'),
        ('hole_diameter = "3.175 mm"', 'hole_diameter = "3.175 mm"\nnotch_diameter = "1 mm"',
         'laminate.notch_diameter = "1 mm": cannot stand beside laminate.hole_diameter'),
        ('hole_diameter = "3.175 mm"', 'notch_diameter = "9 mm"',
         'laminate.notch_diameter = "9 mm": must be less than the width'),
        ("[micromechanics]", "[micromechanics]\nworkers = 0", "micromechanics.workers = 0: must be "),
        ("[micromechanics]", "[micromechanics]\nbackends = 3", "micromechanics.backends: is no key of this table; did"),
        (str(CELL), "no.toml", 'micromechanics.cell = "no.toml": there is no such file in '),
        ('title = "cross-ply"', "title = 3", "title = 3: must be text"),
        ("[load]", "[lode]", "load: is missing"),
    ],
)  # fmt: skip
def test_each_mistake_is_named_with_what_is_allowed(tmp_path: Path, old: str, new: str, line: str) -> None:
    assert old in SCENE
    found = problems(tmp_path, SCENE.replace(old, new))
    assert any(one.replace("backends = 3: ", "backends: ").startswith(line) for one in found), found


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ('"2.71e8 MPa/mm"', '"2.71e8 MPa"', 'cohesive.stiffness = "2.71e8 MPa": must be a pressure per length'),
        ('"60 MPa"', "60e6", "cohesive.normal_strength = 60000000.0: must be "),
        ('opening_toughness = "0.2 N/mm"', "", "cohesive.opening_toughness: is missing"),
        ("[cohesive]", "[cohesive]\nmix_exponent = -1", "cohesive.mix_exponent = -1: must be greater than 0"),
    ],
)
def test_mistakes_of_cohesive_layers(tmp_path: Path, old: str, new: str, line: str) -> None:
    assert old in COHESIVE
    found = problems(tmp_path, SCENE + COHESIVE.replace(old, new))
    assert any(one.startswith(line) for one in found), found


WATCHED = """
[[output.watched]]
x = "-1 mm"
y = "1.7 mm"
ply = 1
[[output.watched]]
x = "0 mm"
y = "-2 mm"
ply = 4
"""


def test_watched_places_lie_in_the_part_that_is_modelled(tmp_path: Path) -> None:
    scene = read(tmp_path, SCENE + WATCHED)
    places = [scene.modelled_place(place) for place in scene.output.watched]
    assert places == [(pytest.approx(1e-3), pytest.approx(1.7e-3), 0), (0.0, pytest.approx(2e-3), 0)]
    scene = read(tmp_path, SCENE + WATCHED, "laminate.symmetry=false")
    places = [scene.modelled_place(place) for place in scene.output.watched]
    assert places == [(pytest.approx(-1e-3), pytest.approx(1.7e-3), 0), (0.0, pytest.approx(-2e-3), 3)]


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ("ply = 4", "ply = 5", "output.watched.1.ply = 5: must be 1 to 4"),
        ("ply = 4", "ply = 0", "output.watched.1.ply = 0: must be greater than 0"),
        ("ply = 4", "", "output.watched.1.ply: is missing"),
        ('"-1 mm"', '"-5 mm"', 'output.watched.0.x = "-5 mm": must lie between -4 mm and 4 mm'),
        ('"-1 mm"', "-1", "output.watched.0.x = -1: must be a length with its unit"),
    ],
)
def test_mistakes_of_watched_places(tmp_path: Path, old: str, new: str, line: str) -> None:
    assert old in WATCHED
    found = problems(tmp_path, SCENE + WATCHED.replace(old, new))
    assert any(one.startswith(line) for one in found), found


def test_a_plate_with_notches_is_meshed_as_one_with_a_hole(tmp_path: Path) -> None:
    scene = read(tmp_path, SCENE.replace("hole_diameter", "notch_diameter"))
    assert plane_elements(scene) == 8 * 6
    assert "notches 3.175 mm" in describe_laminate(scene)


def test_all_mistakes_are_told_at_once(tmp_path: Path) -> None:
    wrong = SCENE.replace('"[0/90]s"', '"0/90"').replace("around = 8", "around = 7").replace("0.012", "-1")
    found = problems(tmp_path, wrong)
    assert [line.split(" ")[0] for line in sorted(found)] == ["laminate.layup", "load.final_strain", "mesh.around"]


def test_overrides_are_checked_like_the_file(tmp_path: Path) -> None:
    assert read(tmp_path, SCENE, "load.final_strain=0.02", "laminate.temperature=350 K").load.final_strain == 0.02
    found = problems(tmp_path, SCENE, "mesh.around=5", "laminate.layup=[0/95]")
    assert sorted(line.split(":")[0] for line in found) == ["--set", "--set"]
    assert any("holds the angle 95, allowed is -90 to 90 degrees" in line for line in found)


def test_only_files_with_the_table_are_laminates(tmp_path: Path) -> None:
    for text, expected in ((SCENE, True), ("[continuum]\n", False), ("no toml [", False)):
        (tmp_path / "scene.toml").write_text(text)
        assert is_laminate(tmp_path / "scene.toml") is expected
    assert not is_laminate(tmp_path / "missing.toml")


@pytest.mark.parametrize("file", sorted(filter(is_laminate, SCENES.glob("*.toml"))), ids=lambda file: file.stem)
def test_scenes_of_the_product_are_sound(file: Path) -> None:
    scene = load_laminate(file)
    text = describe_laminate(scene)
    assert scene.title in text and scene.laminate.layup in text and "estimate" in text


def test_the_description_counts_what_will_be_modelled(tmp_path: Path) -> None:
    scene = read(tmp_path)
    assert plane_elements(scene) == 8 * 6
    text = describe_laminate(scene)
    assert "elements   96 bricks, 768 points, plies are tied" in text
    assert "x = 0 and y = 0 and the middle plane" in text
    assert "2 modelled" in text and "2 x 2 subcells of fibre, matrix" in text
    whole = read(tmp_path, SCENE, "laminate.symmetry=false", "laminate.length=16 mm", "mesh.beyond=3")
    assert plane_elements(whole) == 4 * (8 * 6 + 4 * 3)
    assert "symmetry   none used" in describe_laminate(whole)


def test_mistakes_in_the_cell_file_are_named(tmp_path: Path) -> None:
    (tmp_path / "cell.toml").write_text(CELL.read_text().replace("fibre_fraction = 0.6", "fibre_fraction = 1.6"))
    scene = read(tmp_path, SCENE.replace(str(CELL), "cell.toml"))
    with pytest.raises(ValueError, match=r"cell\.toml.*fibre_fraction"):
        describe_laminate(scene)
