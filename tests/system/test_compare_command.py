"""The command `compare` on a brittle lattice at 0 K: the whole body of atoms is the answer to be met."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from coordinator.results import Results

pytestmark = pytest.mark.timeout(300)

SCENE = """
title = "Crack in a brittle lattice"
[run]
steps = 300
output_every = 100
checkpoint_every = 300
stop_after_crack_growth = "5 angstrom"
[continuum]
assumption = "plane_stress"
lower = ["-120 angstrom", "-88 angstrom"]
upper = ["120 angstrom", "88 angstrom"]
cell_size = "8 angstrom"
damping_rate = "2 1/ps"
initial_velocity = "follow_edges"
[[continuum.edges]]
edge = "top"
component = "y"
times = ["0 ps", "3 ps"]
displacements = ["0 angstrom", "6 angstrom"]
[[continuum.edges]]
edge = "bottom"
component = "y"
times = ["0 ps", "3 ps"]
displacements = ["0 angstrom", "-6 angstrom"]
[[continuum.edges]]
edge = "top"
component = "x"
times = ["0 ps", "3 ps"]
displacements = ["0 angstrom", "0 angstrom"]
[[continuum.edges]]
edge = "bottom"
component = "x"
times = ["0 ps", "3 ps"]
displacements = ["0 angstrom", "0 angstrom"]
[atomistic]
backend = "lattice"
force_field = "harmonic-brittle"
material = "hexagonal"
width = "96 angstrom"
height = "96 angstrom"
temperature = "0 K"
time_step = "1 fs"
equilibration = "0.1 ps"
reference = "0.1 ps"
[handshake]
width = "24 angstrom"
steps_per_exchange = 10
ivc_size = "12 angstrom"
damping_time = "0.2 ps"
[crack]
tip_x = "0 angstrom"
y = "-4 angstrom"
"""


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a comparison."""
    folder = tmp_path_factory.mktemp("compare")
    scene = folder / "brittle.toml"
    scene.write_text(SCENE)
    words = [sys.executable, "-m", "coordinator.cli", "compare", str(scene), "--full-atomistic", "--out"]
    done = subprocess.run([*words, str(folder / "out")], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "at the first broken bond" in done.stderr
    return folder / "out"


def answer(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / "compare.json").read_text())
    return found


@pytest.mark.xdist_group("compared")
def test_the_crack_starts_at_the_load_at_which_it_does_in_atoms_alone(compared: Path) -> None:
    found = answer(compared)
    assert found["load"] == "applied strain"
    assert 0.03 < found["all_atom"]["load_at_first_break"] < 0.07
    assert abs(found["load_error"]) < 0.05
    assert found["tip_load_difference"] < 0.05


@pytest.mark.xdist_group("compared")
def test_both_runs_leave_results_and_the_cost_is_counted(compared: Path) -> None:
    found = answer(compared)
    for part, side in (("coupled", found["coupled"]), ("all_atom", found["all_atom"])):
        with Results(compared / part / "results.h5") as results:
            assert results.status == "finished"
            assert results.atoms is not None
            assert len(results.atoms.atom_id) == side["atoms"]
            broken = np.flatnonzero(results.series["broken_bonds"] > 0)
            assert results.series["applied_strain"][broken[0]] == pytest.approx(side["load_at_first_break"], rel=1e-6)
            grown = results.series["crack_tip"][-1] - results.series["crack_tip"][0]
            assert grown == pytest.approx(side["growth"]) and grown >= 5e-10 * (1 - 1e-9)
        assert side["wall_seconds"] > 0 and side["processor_seconds"] > 0
    assert found["all_atom"]["atoms"] > 5 * found["coupled"]["atoms"]
    assert found["lattice_constant"] == pytest.approx(3.45e-10, rel=1e-3)


@pytest.mark.xdist_group("compared")
def test_atoms_beyond_the_edges_follow_them(compared: Path) -> None:
    with Results(compared / "all_atom" / "results.h5") as results:
        assert results.atoms is not None
        rest = results.atoms.reference
        frame = len(results.atoms) - 1
        moved = results.atoms.position(frame) - rest
        now = float(results.atoms.time[frame])
    up, down = rest[:, 1] > 88e-10, rest[:, 1] < -88e-10
    assert up.sum() > 100 and down.sum() > 100
    strain = 12e-10 * now / 3e-12 / 176e-10
    for beyond in (up, down):
        assert moved[beyond, 1] == pytest.approx(strain * rest[beyond, 1], abs=2e-14)
        assert np.abs(moved[beyond, 0]).max() < 1e-15


@pytest.mark.xdist_group("compared")
def test_table_picture_and_page_are_there(compared: Path) -> None:
    page = (compared / "compare.html").read_text()
    assert "full atomistic" in page and "data:image/svg+xml;base64," in page and "scalebridge compare" in page
    assert (compared / "compare.png").read_bytes().startswith(b"\x89PNG")
