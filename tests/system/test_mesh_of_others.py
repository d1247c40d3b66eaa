"""A laminate run on a mesh from a file is the run on the mesh that it was written from; CalculiX agrees with a run."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from small_runs import StartsRuns

from coordinator.cli import cli
from coordinator.laminate_results import LaminateResults
from fem_service.plane_mesh import PlaneMesh, open_hole
from fem_service.verification.calculix import largest_differences, run_calculix

pytestmark = [pytest.mark.timeout(300), pytest.mark.xdist_group("mesh-of-others")]

SCENES = Path(__file__).parents[2] / "scenes"
SCENE = f"""
[laminate]
layup = "[0/90]s"
ply_thickness = "0.25 mm"
length = "8 mm"
width = "8 mm"
hole_diameter = "3.175 mm"
[mesh]
around = 6
radial = 5
growth = 3.0
[load]
final_strain = 0.006
first = 0.25
most = 0.25
[micromechanics]
cell = "{SCENES / "cells" / "im7_epon862_neat.toml"}"
"""
SECONDS = 200.0
#: One increment in which nothing fails.
ELASTIC = tuple(
    word
    for setting in ("load.final_strain=0.0005", "load.first=1.0", "load.most=1.0", "load.tolerance=1e-11")
    for word in ("--set", setting)
)


def write_inp(mesh: PlaneMesh, path: Path) -> None:
    """In metres, to the last bit."""
    nodes = [f"{row}, {x!r}, {y!r}" for row, (x, y) in enumerate(mesh.nodes.tolist(), 1)]
    quads = [f"{row}, {', '.join(str(node + 1) for node in nodes)}" for row, nodes in enumerate(mesh.elements, 1)]
    path.write_text("\n".join(["*NODE", *nodes, "*ELEMENT, TYPE=CPS4", *quads]) + "\n")


def run(start: StartsRuns, text: str, folder: Path, *words: str) -> LaminateResults:
    scene = folder / "plate.toml"
    scene.write_text(text)
    made = start(scene, folder / "run", *words)
    assert made.wait(SECONDS) == 0, made.printed
    return LaminateResults.read(folder / "run" / "results.h5")


def same(one: LaminateResults, other: LaminateResults) -> None:
    assert np.abs(one.nodes - other.nodes).max() < 1e-18  # nodes on planes of symmetry are put there exactly
    np.testing.assert_array_equal(one.bricks, other.bricks)
    for name in ("load", "iterations", "queried", "spared"):
        assert one.series[name] == other.series[name], name
    np.testing.assert_allclose(one.series["force"], other.series["force"], rtol=1e-12)
    np.testing.assert_array_equal(one.new_failures, other.new_failures)
    assert np.sum(one.new_failures) > 0
    scale = np.abs(one.frames[-1].displacement).max()
    np.testing.assert_allclose(one.frames[-1].displacement, other.frames[-1].displacement, atol=1e-12 * scale)


def from_file(text: str) -> str:
    """The scene with a mesh file in the place of its keys."""
    keys = text[text.index("hole_diameter") : text.index("[load]")]
    return text.replace(keys, '[mesh]\nfile = "plate.inp"\nfile_unit = "m"\n\n')


def test_a_run_on_the_mesh_of_a_file_goes_on_with_that_mesh_only(start: StartsRuns, tmp_path: Path) -> None:
    mesh = open_hole(8e-3, 8e-3, 3.175e-3, around=6, radial=5, growth=3.0, quadrant=True)
    write_inp(mesh, tmp_path / "plate.inp")
    results = run(start, from_file(SCENE), tmp_path, *ELASTIC)
    np.testing.assert_allclose(results.nodes[: len(mesh.nodes), :2], mesh.nodes, atol=1e-18)
    np.testing.assert_array_equal(results.bricks[: len(mesh.elements), :4], mesh.elements)
    write_inp(open_hole(8e-3, 8e-3, 3.0e-3, around=6, radial=5, growth=3.0, quadrant=True), tmp_path / "plate.inp")
    again = start(tmp_path / "plate.toml", tmp_path / "run", "--resume", *ELASTIC)
    assert again.wait(SECONDS) == 1
    assert "the mesh in plate.inp differs from what the checkpoint was made with" in again.printed


@pytest.mark.slow
def test_the_scene_of_the_cross_ply_is_the_same_from_a_file(start: StartsRuns, tmp_path: Path) -> None:
    text = (SCENES / "oht_cross_ply.toml").read_text().replace("cells/", f"{SCENES / 'cells'}/")
    folders = [tmp_path / name for name in ("keys", "file")]
    for folder in folders:
        folder.mkdir()
    assert "around = 16\nradial = 14\ngrowth = 4.0" in text
    write_inp(
        open_hole(8e-3, 8e-3, 3.175e-3, around=16, radial=14, growth=4.0, quadrant=True), folders[1] / "plate.inp"
    )
    same(run(start, text, folders[0]), run(start, from_file(text), folders[1]))


@pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX (ccx) is not installed")
def test_calculix_on_the_exported_deck_finds_the_displacements_and_the_force_of_the_run(
    start: StartsRuns, tmp_path: Path
) -> None:
    results = run(start, SCENE, tmp_path, *ELASTIC)
    deck = tmp_path / "plate.inp"
    told = CliRunner().invoke(cli, ["export", str(tmp_path / "plate.toml"), "--inp", str(deck), *ELASTIC])
    assert told.exit_code == 0, told.output
    assert "the quarter with x and y above 0" in told.output and "the ends part by 0.0005 of the length" in told.output
    displacement, reaction = run_calculix(deck.read_text(), tmp_path)
    frame = results.frames[-1]
    assert max(largest_differences((displacement,) * 2, (frame.displacement,) * 2)) < 1e-6
    end = results.nodes[:, 0] == results.nodes[:, 0].max()
    # A quarter of half of the plies: four times the force over half of the width and thickness.
    assert 4.0 * reaction[end, 0].sum() == pytest.approx(results.series["force"][-1], rel=1e-6)
