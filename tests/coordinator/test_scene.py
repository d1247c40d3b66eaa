"""Scene files: values, overrides, and what is said about every mistake."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest

from coordinator.scene import Scene, SceneError, load_scene, read_resolved, read_scene, snapped_overlap

SCENES = Path(__file__).parents[2] / "scenes"
A = 1e-10

ALONE = """
title = "A bar"
[run]
steps = 10
[continuum]
assumption = "plane_strain"
lower = ["0 m", "0 m"]
upper = ["1 m", "0.5 m"]
cell_size = "0.25 m"
time_step = "1 us"
[continuum.material]
young = "1 GPa"
poisson = 0.25
density = "1000 kg/m^3"
thickness = "1 m"
"""


def _problems(*overrides: str, scene: str = "graphene_crack") -> list[str]:
    with pytest.raises(SceneError) as caught:
        load_scene(SCENES / f"{scene}.toml", overrides)
    assert str(caught.value).splitlines() == list(caught.value.problems)
    return list(caught.value.problems)


def _one(said: str, *overrides: str, scene: str = "graphene_crack") -> None:
    problems = _problems(*overrides, scene=scene)
    assert len(problems) == 1, problems
    assert said in problems[0]


def test_the_crack_scene_in_si() -> None:
    scene = load_scene(SCENES / "graphene_crack.toml", ["atomistic.temperature=10 K"])
    assert scene.name == "graphene_crack"
    assert scene.text == (SCENES / "graphene_crack.toml").read_text()
    assert scene.overrides == ("atomistic.temperature=10 K",)
    assert scene.atomistic is not None and scene.atomistic.temperature == 10.0
    assert math.isclose(scene.continuum.cell_size, 5 * A, rel_tol=1e-14)
    assert scene.handshake is not None
    assert math.isclose(scene.time_step, scene.handshake.steps_per_exchange * 0.5e-15, rel_tol=1e-14)
    inner, outer = scene.overlap() or ((), ())
    assert [round(x / A, 9) for corner in (*inner, *outer) for x in corner] == [
        -37.5, -37.5, 37.5, 37.5, -52.5, -52.5, 52.5, 52.5,
    ]  # fmt: skip


def test_follow_edges_gives_the_gradient_of_the_load() -> None:
    scene = load_scene(SCENES / "graphene_crack.toml")
    gradient = scene.continuum.initial_velocity_gradient()
    assert gradient is not None
    # the edges part along y alone
    top, height = scene.continuum.edges[0], scene.continuum.upper[1] - scene.continuum.lower[1]
    rate = 2 * top.displacements[1] / height / top.times[1]
    assert gradient[:3] == (0.0, 0.0, 0.0)
    assert math.isclose(gradient[3], rate, rel_tol=1e-12)


def test_a_scene_without_atoms() -> None:
    scene = read_scene(ALONE, "bar")
    assert scene.atomistic is None and scene.overlap() is None
    assert math.isclose(scene.time_step, 1e-6, rel_tol=1e-14)
    assert scene.continuum.initial_velocity_gradient() is None


def test_resolved_values_read_back_the_same() -> None:
    scene = load_scene(SCENES / "graphene_crack.toml")
    again = read_resolved(scene.model_dump(mode="json"), scene.name)
    assert isinstance(again, Scene)
    assert again.model_dump() == scene.model_dump()


def test_overlap_lies_on_the_nearest_grid_lines() -> None:
    (inner_low, inner_high), (low, high) = snapped_overlap((-20.0, -21.0), 2.0, 11.0, 10.0, 4.0)
    assert (low, high) == ((-6.0, -5.0), (6.0, 5.0))  # nearest lines: even in x, odd in y
    assert (inner_low, inner_high) == ((-2.0, -1.0), (2.0, 1.0))


def test_every_mistake_is_reported_at_once(tmp_path: Path) -> None:
    file = tmp_path / "bad.toml"
    text = (SCENES / "graphene_crack.toml").read_text()
    text = text.replace('cell_size = "5 angstrom"', "cell_size = 5").replace("tip_x", "tipx")
    text = text.replace('width = "15 angstrom"', 'width = "60 angstrom"')
    file.write_text(text)
    with pytest.raises(SceneError) as caught:
        load_scene(file, ["run.steps=-1", "nonsense"])
    assert caught.value.problems == (
        '--set nonsense: must be "key.sub=value"',
        "--set: run.steps = -1: must be greater than 0",
        f'{file}: continuum.cell_size = 5: must be a length with its unit, such as "5 angstrom";'
        " a bare number has no unit",
        f'{file}: crack.tip_x: is missing; needed: a length with its unit, such as "5 angstrom"',
        f'{file}: crack.tipx = "0 angstrom": is no key of this table; did you mean tip_x?',
    )


def test_one_mistake_does_not_hide_a_check_between_other_fields() -> None:
    problems = _problems("run.steps=0", "handshake.ivc_size=4 angstrom", "crack.y=60 angstrom")
    assert [line.split(":")[1].split("=")[0].strip() for line in problems] == [
        "run.steps", "handshake.ivc_size", "crack.y",
    ]  # fmt: skip


def test_toml_errors_name_the_line(tmp_path: Path) -> None:
    file = tmp_path / "broken.toml"
    file.write_text('title = "x"\nrun = = 1\n')
    with pytest.raises(SceneError, match=r"broken\.toml: is not TOML: .*line 2"):
        load_scene(file)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"none\.toml: cannot be read: No such file"):
        load_scene(tmp_path / "none.toml")


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("atomistic.ranks=true", "must be a whole number"),
        ("run.steps=10.5", "must be a whole number"),
        ("run.steps.deep=1", "run.steps is a value, not a table"),
        ("continuum.edges.5.edge=top", "is a list of 2"),
        ("handshake.weight=1.5", "must be 1.0 or less"),
        ("handshake.weight=0", "must be greater than 0"),
        ("atomistic.temperature=-1 K", "must be 0 or greater"),
        ("atomistic.time_step=1 kg", "is none of time"),
        ("continuum.assumption=3d", "'plane_stress' or 'plane_strain'"),
        ("continuum.upper.0=-400 angstrom", "must be greater than continuum.lower in x, -317.5 angstrom"),
        ("continuum.upper.0=318 angstrom", "nearest: 317.5 angstrom"),
        ("continuum.time_step=1 fs", "must be left out"),
        ("continuum.edges.1.edge=top", "top y is prescribed already by continuum.edges.0"),
        ('continuum.edges.0.times=["0 ps", "0 ps"]', "must be later"),
        ('continuum.edges.0.times=["1 ps", "2 ps"]', "must be 0: the tables begin"),
        ('continuum.edges.0.displacements=["0 nm", "1 nm", "2 nm"]', "has 3 values, must have 2"),
        ("continuum.edges.0.displacements.0=1 angstrom", "must be 0 without continuum.preload"),
        ("atomistic.width=650 angstrom", "at least one cell inside the body"),
        ("atomistic.reference=1 fs", "at least one exchange"),
        ("handshake.width=14 angstrom", "is 2.8 cells of 5 angstrom"),
        ("handshake.width=55 angstrom", "narrower than half the sheet"),
        ("handshake.ivc_size=16 angstrom", "must not be larger than handshake.width"),
        ("handshake.ivc_size=4 angstrom", "must not be smaller than a cell of the continuum"),
        ("crack.tip_x=45 angstrom", "inside the sheet inside its handshake"),
        ("crack.y=1 m", "must lie inside the body"),
        ("crack.y=60 angstrom", "inside the sheet inside its handshake"),
        ("handshake=1", "must be a table"),
    ],
)
def test_what_is_not_allowed(override: str, said: str) -> None:
    problems = _problems(override)
    assert any(said in line for line in problems), problems
    assert all(line.startswith("--set") for line in problems if said in line)


def test_tables_that_need_each_other() -> None:
    for removed, path in (("atomistic", "handshake"), ("handshake", "handshake"), ("crack", "run.stop_after")):
        text = re.sub(r"\[atomistic\.j\][^[]*\[[^[]*\n\n", "", (SCENES / "graphene_crack.toml").read_text())
        lines = text.split(f"[{removed}]")
        rest = lines[1][lines[1].index("\n[") :] if "\n[" in lines[1] else ""
        with pytest.raises(SceneError) as caught:
            read_scene(lines[0] + rest, "cut")
        assert any(line.startswith(f"scene: {path}") for line in caught.value.problems), caught.value.problems
    with pytest.raises(SceneError) as caught:
        read_scene(ALONE.split("[continuum.material]")[0].replace('time_step = "1 us"', ""), "bar")
    assert [line.split(": ")[1] for line in caught.value.problems] == ["continuum.time_step", "continuum.material"]


def test_follow_edges_refuses_what_no_gradient_gives() -> None:
    _one("needs one y velocity gradient", "continuum.edges.0.displacements.1=6 angstrom")
    shear = ("continuum.edges.0.component=x", "continuum.edges.1.component=x")
    follow = "continuum.initial_velocity=follow_edges"
    _one("the x velocity of top varies along left", *shear, follow, scene="graphene_patch")
    load_scene(SCENES / "graphene_patch.toml", [*shear, "continuum.initial_velocity=rest"])
