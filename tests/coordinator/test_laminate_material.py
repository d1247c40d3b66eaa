"""Continuum scenes whose material is a laminate: what they hold, what is refused, what the service is told."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from coordinator.check import describe
from coordinator.continuum_request import continuum_request, elastic_constants
from coordinator.laminate_material import failed_by_ply, laminate_of, plain_cell, read_cell
from coordinator.scene import Scene, SceneError, load_scene
from protocol import continuum as c

SCENE = Path(__file__).resolve().parents[2] / "scenes" / "oht_mpm.toml"


def scene(*overrides: str) -> Scene:
    return load_scene(SCENE, overrides)


def problems(*overrides: str) -> str:
    with pytest.raises(SceneError) as caught:
        scene(*overrides)
    return str(caught.value)


def test_scene_is_read_and_told_to_the_service() -> None:
    found = scene('continuum.material.layup="[45/0/-45/90]2s"')
    cell = read_cell(found)
    assert cell is not None and found.continuum.material is not None
    material = laminate_of(found, cell, "ipc://there")
    assert np.degrees(material.angles) == pytest.approx([45, 0, -45, 90] * 2 + [90, -45, 0, 45] * 2)
    assert material.micromechanics == "ipc://there" and elastic_constants(material) is None
    assert found.continuum.material.whole_thickness == pytest.approx(16 * 0.25e-3)
    request = continuum_request(found, material, found.continuum.material.whole_thickness, [], 1, [])
    assert [(hole.centre, hole.radius) for hole in request.holes] == [((0.0, 0.0), pytest.approx(1.5875e-3))]
    assert request.material == material
    told = describe(found)
    assert "known once the cell has answered" in told
    assert "gmc_service: cells/im7_epon862_neat.toml in every ply" in told


def test_failure_can_be_left_out_and_shows_in_the_cell() -> None:
    with_failure, without = read_cell(scene()), read_cell(scene("micromechanics.failure=false"))
    assert with_failure is not None and without is not None
    assert all(material.failures for material in with_failure.materials)
    assert not any(material.failures for material in without.materials)
    assert plain_cell(with_failure) != plain_cell(without)


def test_what_has_failed_is_named_by_angle_and_material() -> None:
    found = scene('continuum.material.layup="[0/90/-45/-90]"')
    cell = read_cell(found)
    assert cell is not None
    failed = np.arange(2 * 3 * 2, dtype=np.float64).reshape(2, 3, 2)
    named = failed_by_ply(laminate_of(found, cell, "ipc://there"), failed)
    assert list(named) == ["0 fibre", "0 matrix", "90 fibre", "90 matrix", "-45 fibre", "-45 matrix"]
    assert np.array_equal(named["90 matrix"], failed[:, 1, 1])


@pytest.mark.parametrize(
    ("override", "where", "words"),
    [
        ("continuum.assumption=plane_strain", "continuum.assumption", "must be plane_stress"),
        ('continuum.material.layup="[0/91]s"', "continuum.material.layup", "allowed is -90 to 90"),
        ('continuum.material.thickness="1 mm"', "continuum.material.thickness", "must be left out"),
        ('continuum.material.young="1 GPa"', "continuum.material.young", "must be left out"),
        ("continuum.material.law=isotropic", "continuum.material.thickness", "is missing"),
        ("continuum.material.law=isotropic", "micromechanics", "must be left out unless"),
        ("micromechanics.cell=nowhere.toml", "micromechanics.cell", "there is no such file"),
        ('continuum.holes.0.centre=["9 mm", "0 mm"]', "continuum.holes.0.centre", "does not reach it"),
        ('continuum.holes.0.diameter="0 mm"', "continuum.holes.0.diameter", "greater than 0"),
    ],
)
def test_mistakes_are_named(override: str, where: str, words: str) -> None:
    lines = [line for line in problems(override).splitlines() if f": {where}" in line]
    assert any(words in line for line in lines), problems(override)


def test_a_laminate_needs_its_cell(tmp_path: Path) -> None:
    text = SCENE.read_text().split("[micromechanics]")[0]
    (tmp_path / "scene.toml").write_text(text)
    with pytest.raises(SceneError, match='micromechanics: is missing; a material with law = "laminate" needs'):
        load_scene(tmp_path / "scene.toml")


def test_holes_that_meet_are_refused(tmp_path: Path) -> None:
    text = SCENE.read_text() + '\n[[continuum.holes]]\ncentre = ["2 mm", "0 mm"]\ndiameter = "2 mm"\n'
    (tmp_path / "scene.toml").write_text(text)
    with pytest.raises(SceneError, match=r"continuum\.holes\.1: meets continuum\.holes\.0"):
        load_scene(tmp_path / "scene.toml")


def test_pull_axis_is_that_of_edges_that_part() -> None:
    assert scene().continuum.pull_axis == 0
    assert scene("continuum.edges.2.edge=top", "continuum.edges.2.component=y").continuum.pull_axis == 1
    assert scene("continuum.edges.0.kind=absorbing").continuum.pull_axis is None


def test_every_law_of_the_scene_is_one_of_the_wire() -> None:
    assert c.LaminateMaterial.model_fields["law"].default == "laminate"
