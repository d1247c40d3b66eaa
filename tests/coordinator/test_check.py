"""What `check` says about a scene, held against what the services build."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from coordinator.check import continuum_points, describe
from coordinator.kill_resume import SCENE
from coordinator.scene import Scene, read_scene
from md_service.force_fields import FORCE_FIELDS
from md_service.graphene import graphene
from mpm_service.material_points import fill_rectangle
from protocol.backend import BackendError

CONTINUUM_ALONE = SCENE[: SCENE.index("[atomistic]")].replace("[continuum]\n", '[continuum]\ntime_step = "5 fs"\n')


def small(*overrides: str) -> Scene:
    return read_scene(SCENE, "small", overrides)


@pytest.mark.parametrize("overrides", [(), ("continuum.points_per_cell=3",), ("continuum.cell_size=2.5 angstrom",)])
def test_the_number_of_points_is_the_one_that_the_continuum_fills_in(overrides: tuple[str, ...]) -> None:
    scene = small(*overrides)
    overlap = scene.overlap()
    assert overlap is not None
    body = scene.continuum
    points = fill_rectangle(body.lower, body.upper, body.cell_size, body.points_per_cell, hole=overlap[0])
    assert continuum_points(scene) == points.count
    assert f"{points.count} material points" in describe(scene)


def test_a_body_without_atoms_is_full_of_points() -> None:
    scene = read_scene(CONTINUUM_ALONE, "alone")
    assert continuum_points(scene) == 15 * 15 * 4
    text = describe(scene)
    assert "not started: the scene has no [atomistic]" in text
    assert "handshake" not in text


def test_the_number_of_atoms_is_about_right() -> None:
    scene = small()
    assert scene.atomistic is not None
    spacing = FORCE_FIELDS["tersoff"].lattice_constant
    built = graphene(scene.atomistic.width, scene.atomistic.height, spacing=spacing)
    found = re.search(r"about (\d+) atoms, (\d+) of them anchored", describe(scene))
    assert found
    atoms, anchored = (int(number) for number in found.groups())
    assert atoms == pytest.approx(len(built.position), rel=0.06)
    in_ring = np.any(np.abs(built.position[:, :2]) > 12.5e-10, axis=1).sum()
    assert anchored == pytest.approx(in_ring, rel=0.08)


def test_steps_and_times_are_those_of_the_scene() -> None:
    text = describe(small("handshake.steps_per_exchange=20", "run.steps=250"))
    assert re.search(r"material points, step 10 fs", text)
    assert re.search(r"anchored, step 0\.5 fs", text)
    assert "at most 250 coupling steps, 2.5 ps" in text
    assert "M = 20" in text


def test_twice_the_steps_cost_about_twice_the_time() -> None:
    def seconds(steps: int) -> float:
        found = re.search(r"estimate +about (\d+) (s|min|h)|estimate +(\d+(?:\.\d+)?) (s|min|h)",
                          describe(small(f"run.steps={steps}", "atomistic.equilibration=0 ps")))  # fmt: skip
        assert found
        number, unit = [group for group in found.groups() if group]
        return float(number) * {"s": 1, "min": 60, "h": 3600}[unit]

    assert seconds(400_000) == pytest.approx(2 * seconds(200_000), rel=0.06)


def test_crack_ranks_and_the_source_of_the_handshake_are_shown() -> None:
    crack = '\n[crack]\ntip_x = "1 angstrom"\ny = "0 angstrom"\n'
    text = describe(read_scene(SCENE + crack, "cracked", ("atomistic.ranks=2",)))
    assert "from the left edge to x = 1 angstrom" in text
    assert "2 rank(s)" in text
    assert "weight and stiffness by the scene" in text
    assert "weight and stiffness by theory" in describe(read_scene(SCENE.replace("weight = 0.5\n", ""), "free"))


def test_an_unknown_backend_is_refused() -> None:
    with pytest.raises(BackendError, match="no backend 'mpm' for the role 'continuum'"):
        describe(small("continuum.backend=mpm"))


def test_a_force_field_without_stated_cost_is_said_so() -> None:
    assert "unknown time" in describe(small("atomistic.force_field=homemade"))


@pytest.mark.parametrize("name", ["edge_crack", "graphene_crack", "graphene_patch"])
def test_the_shipped_scenes_can_be_described(name: str) -> None:
    from coordinator.scene import load_scene

    path = Path(__file__).parents[2] / "scenes" / f"{name}.toml"
    assert "coupling steps" in describe(load_scene(path))
