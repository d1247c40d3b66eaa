"""The epoxy scenes: what they say, and a few coupling steps of the small one with ReaxFF."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from coordinator.results import Results
from coordinator.run_process import RunProcess
from coordinator.scene import Scene, load_scene
from md_service.atoms import Atoms, CrackCut
from md_service.sample_source import sample_from_bytes, shipped_samples

SCENES = Path(__file__).parents[2] / "scenes"
ANGSTROM = 1e-10


def sample_of(scene: Scene) -> Atoms:
    assert scene.atomistic is not None and scene.atomistic.sample is not None and scene.crack is not None
    data = shipped_samples()[scene.atomistic.sample].read_bytes()
    return sample_from_bytes(data, crack=CrackCut(scene.crack.tip_x, scene.crack.y))


def test_the_full_scene_has_the_sizes_of_the_dissertation() -> None:
    scene = load_scene(SCENES / "epoxy_full.toml")
    body = scene.continuum
    assert np.allclose(np.subtract(body.upper, body.lower), 61440 * ANGSTROM)
    assert scene.crack is not None and np.isclose(scene.crack.tip_x - body.lower[0], 31440 * ANGSTROM)
    assert np.isclose(scene.finest_cell, 5 * ANGSTROM) and np.isclose(body.cell_size, 2560 * ANGSTROM)
    assert scene.handshake is not None and scene.handshake.steps_per_exchange == 10
    assert np.isclose(scene.handshake.width, 10 * ANGSTROM) and scene.run.steps >= 20
    atoms = sample_of(scene)
    assert abs(len(atoms) / 17928 - 1) < 0.05


def test_the_small_scene_has_about_2000_atoms() -> None:
    scene = load_scene(SCENES / "epoxy_small.toml")
    atoms = sample_of(scene)
    assert 2000 < len(atoms) < 2500 and atoms.box.periodic == (False, False, True)
    assert scene.continuum.material is not None
    # The slab is as thick as the continuum, and as heavy.
    assert np.isclose(scene.continuum.material.thickness, (atoms.box.high - atoms.box.low)[2], rtol=1e-3)
    assert np.isclose(scene.continuum.material.density, float(atoms.notes["density"]), rtol=1e-3)


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_a_few_coupling_steps_of_the_small_scene(tmp_path: Path) -> None:
    words = {
        "run.steps": 3, "run.output_every": 1, "atomistic.equilibration": "5 fs", "atomistic.reference": "2 fs",
        "atomistic.hold": "1 fs", "handshake.steps_per_exchange": 4, "atomistic.j.interval": 1,
        "atomistic.fields.interval": 1,
    }  # fmt: skip
    sets = [word for key, value in words.items() for word in ("--set", f"{key}={value}")]
    with RunProcess(SCENES / "epoxy_small.toml", tmp_path / "run", *sets) as run:
        assert run.wait(1100) == 0, run.printed
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert (summary["status"], summary["steps"]) == ("finished", 3)
    with Results(tmp_path / "run" / "results.h5") as results:
        series = results.series
        assert np.isfinite(series["j_contour_0"]).all() and np.isfinite(series["temperature"]).all()
        # Bonds of the network are counted by the distances of their atoms in the sample; few break at once.
        assert series["broken_bonds"].max() < 30
        assert series["force_balance"].max() < 1e-10
        # One anchor in about five atoms other than hydrogen of the ring, none closer than 3 A to another.
        place = results.interface["anchor_position"]
        assert 100 < len(place) < 300
        apart = np.linalg.norm(place[:, None] - place[None], axis=2) + np.eye(len(place))
        assert apart.min() > 3 * ANGSTROM
