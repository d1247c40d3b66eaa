"""Whole runs of a laminate of material points: two services, failure sequence, resume bit for bit, report."""

from __future__ import annotations

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
from rich.console import Console

from coordinator.results import Results
from coordinator.run import RunError, run_scene
from coordinator.vtkhdf import FAILED

SCENES = Path(__file__).resolve().parents[2] / "scenes"
#: A plate of 8 x 8 cells that is pulled in a tenth of the time.
SMALL = (
    'continuum.cell_size="0.5 mm"', 'continuum.time_step="40 ns"', "run.steps=280", "run.output_every=70",
    "run.checkpoint_every=100", 'continuum.edges.2.times=["0 us", "11.2 us"]', 'continuum.damping_rate="2 1/us"',
)  # fmt: skip


def run(folder: Path, *overrides: str, resume: bool = False) -> int:
    return run_scene(
        SCENES / "oht_mpm.toml", folder, resume=resume, overrides=(*SMALL, *overrides), console=Console(quiet=True)
    )


def content(folder: Path) -> dict[str, np.ndarray]:
    with h5py.File(folder / "results.h5") as file:
        found = {f"series {name}": values[:] for name, values in file["time_series"].items()}
        found |= {f"points {name}": values[:] for name, values in file["VTKHDF/PointData"].items()}
    with Results(folder / "results.h5") as results:
        found["events"] = np.array([event["sentence"] for event in results.events])
    return {name: values for name, values in found.items() if "seconds" not in name}


def test_plate_fails_and_a_run_that_was_stopped_ends_with_the_same_bits(tmp_path: Path) -> None:
    assert run(tmp_path / "whole") == 0
    assert run(tmp_path / "parts", "run.steps=150") == 0
    assert run(tmp_path / "parts", resume=True) == 0
    whole, parts = content(tmp_path / "whole"), content(tmp_path / "parts")
    shared = {name for name in whole if name.startswith(("series", "events"))}
    assert {name for name in whole if FAILED in name} == {
        f"points {FAILED}{ply} {material}" for ply in (0, 90) for material in ("fibre", "matrix")
    }
    assert shared and all(np.array_equal(whole[name], parts[name]) for name in shared)
    end = len(whole["points Failed 90 matrix"]) // 5  # frames at 0, 70, 140, 210, 280
    for name in whole:
        if name.startswith("points") and "Weight" not in name:
            assert np.array_equal(whole[name][-end:], parts[name][-end:]), name
    summary = json.loads((tmp_path / "whole" / "summary.json").read_text())
    sentences = [event["sentence"] for event in summary["events"]]
    assert any("matrix fails first in the 90 degree plies" in sentence for sentence in sentences)
    assert whole["points Failed 90 matrix"].max() > 0.0
    assert whole["series plies_spared"].sum() > 0.0
    assert abs(summary["measures"]["books_continuum_relative"]) < 1e-2
    page = (tmp_path / "whole" / "report.html").read_text()
    assert "Stress against strain" in page and "What has failed, near the peak" in page
    with pytest.raises(RunError, match=r"micromechanics\.failure"):
        run(tmp_path / "whole", "micromechanics.failure=false", resume=True)


def test_a_changed_cell_file_is_refused_on_resume(tmp_path: Path) -> None:
    cells = SCENES / "cells"
    scene = tmp_path / "scene.toml"
    scene.write_text((SCENES / "oht_mpm.toml").read_text().replace("cells/im7_epon862_neat.toml", "cell.toml"))
    text = (cells / "im7_epon862_neat.toml").read_text()
    (tmp_path / "cell.toml").write_text(text)
    overrides = (*SMALL, "run.steps=5")
    assert run_scene(scene, tmp_path / "run", overrides=overrides, console=Console(quiet=True)) == 0
    (tmp_path / "cell.toml").write_text(text.replace('"118.67 MPa"', '"100 MPa"'))
    with pytest.raises(RunError, match=r"cell file differs .* materials"):
        run_scene(scene, tmp_path / "run", overrides=overrides, resume=True, console=Console(quiet=True))
