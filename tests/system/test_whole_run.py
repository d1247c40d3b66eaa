"""Whole runs that nobody disturbs."""

from __future__ import annotations

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
from small_runs import SHORT, STEPS, StartsRuns

from coordinator.kill_resume import END_SECONDS, RUN_SECONDS, SCENE
from coordinator.results import Results

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.timeout(300)


@pytest.mark.xdist_group("left-alone")
def test_a_run_leaves_results_summary_and_report(left_alone: Path) -> None:
    summary = json.loads((left_alone / "summary.json").read_text())
    assert (summary["status"], summary["steps"], summary["steps_asked"]) == ("finished", STEPS, STEPS)
    assert summary["seeds"] == {"run": 7}
    assert all(spent > 0 for service in summary["services"].values() for spent in service.values())
    report = (left_alone / "report.html").read_text()
    assert "Small sheet in a small body" in report and report.rstrip().endswith("</html>")
    with Results(left_alone / "results.h5") as results:
        assert results.status == "finished"


@pytest.mark.xdist_group("left-alone")
def test_every_step_is_a_row_with_an_integer_counter_and_balanced_forces(left_alone: Path) -> None:
    with Results(left_alone / "results.h5") as results:
        assert results.step.dtype == np.int64
        assert np.array_equal(results.step, np.arange(1, STEPS + 1))
        # Counted, not summed: not even the last bit drifts.
        coupling_step = 10 * results.scene["resolved"]["atomistic"]["time_step"]
        assert coupling_step == pytest.approx(5e-15, rel=1e-12)
        assert np.array_equal(results.series["time"], results.step * coupling_step)
        assert results.series["force_balance"].max() <= 1e-10
        assert results.series["ivc_force_rms"].min() > 0
        # The sum over cells that was sent equals the sum that was recorded, in single precision.
        force = results.interface["force"].sum(axis=1)
        scale = np.abs(results.interface["force"]).sum(axis=(1, 2))
        for axis, name in enumerate(("force_sum_x", "force_sum_y")):
            assert np.all(np.abs(force[:, axis] - results.series[name]) < 1e-6 * scale)


@pytest.mark.xdist_group("left-alone")
def test_frames_are_written_at_the_start_and_every_so_many_steps(left_alone: Path) -> None:
    wanted = [0, *range(8, STEPS + 1, 8)]
    with h5py.File(left_alone / "results.h5") as file:
        assert file["particles/atoms/position/step"][:].tolist() == wanted
        assert len(file["VTKHDF/Steps/Values"]) == len(wanted)


def test_a_scene_without_atoms_starts_one_service_and_a_second_run_keeps_the_first(
    start: StartsRuns, continuum_scene: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    steps = ("--set", "run.steps=40000", "--set", "run.checkpoint_every=1000", "--set", "run.output_every=40000")
    with start(continuum_scene, folder, *steps) as run:
        run.wait_for_step(5)
        assert run.service("continuum") is not None
        assert run.service("atomistic") is None
        family = {process.pid for process in run.survivors(0.0)}
        assert len(family) == 2
    code_folder = tmp_path / "whole"
    for _ in range(2):
        run = start(continuum_scene, code_folder, *SHORT)
        assert run.wait(RUN_SECONDS) == 0, run.printed
        assert run.survivors(END_SECONDS) == []
    assert {path.name for path in code_folder.glob("services/*")} == {"continuum"}
    kept = tmp_path / "whole-1"
    for place in (kept, code_folder):
        assert json.loads((place / "summary.json").read_text())["status"] == "finished"
        assert (place / "report.html").exists()
    with Results(kept / "results.h5") as first, Results(code_folder / "results.h5") as second:
        assert first.atoms is None and first.interface == {}
        for name in first.series.keys() - {"seconds_continuum", "seconds_exchange"}:
            assert np.array_equal(first.series[name], second.series[name]), name
        assert first.series["continuum_strain"][-1] > 0


def test_a_folder_too_deep_for_a_socket_still_runs(start: StartsRuns, continuum_scene: Path, tmp_path: Path) -> None:
    folder = tmp_path / ("deep-" + "x" * 60) / ("deeper-" + "y" * 60) / "run"
    folder.parent.mkdir(parents=True)
    run = start(continuum_scene, folder, "--set", "run.steps=3")
    assert run.wait(RUN_SECONDS) == 0, run.printed
    assert run.survivors(END_SECONDS) == []


def _atoms_at_zero_kelvin(start: StartsRuns, scene: Path, folder: Path, ranks: int) -> np.ndarray:
    words = ["--set", "atomistic.temperature=0 K", "--set", f"atomistic.ranks={ranks}", "--set", "run.output_every=30"]
    run = start(scene, folder, *SHORT, *words)
    assert run.wait(RUN_SECONDS) == 0, run.printed
    assert run.survivors(END_SECONDS) == []
    with h5py.File(folder / "results.h5") as file:
        return np.asarray(file["particles/atoms/position/value"][()])


def test_two_ranks_give_the_strain_of_one(start: StartsRuns, small_scene: Path, tmp_path: Path) -> None:
    one = _atoms_at_zero_kelvin(start, small_scene, tmp_path / "one", 1)
    two = _atoms_at_zero_kelvin(start, small_scene, tmp_path / "two", 2)
    moved = one[-1] - one[0]
    # The applied strain has come to the atoms, and both runs agree on it far better than on nothing.
    assert np.abs(moved).max() > 1e-3  # angstrom
    assert np.abs(one - two).max() < 1e-6 * np.abs(moved).max()


@pytest.mark.slow
def test_constants_of_the_continuum_are_measured_where_the_scene_gives_none(start: StartsRuns, tmp_path: Path) -> None:
    scene = tmp_path / "measured.toml"
    material = SCENE[SCENE.index("[continuum.material]") : SCENE.index("[[continuum.edges]]")]
    scene.write_text(SCENE.replace(material, "").replace('temperature = "300 K"', 'temperature = "0 K"'))
    folder = tmp_path / "run"
    run = start(scene, folder, "--set", "run.steps=12")
    assert run.wait(RUN_SECONDS) == 0, run.printed
    header = json.loads(np.load(folder / "checkpoint.npz")["header"].tobytes())
    # Tersoff (BNC) graphene at 0 K, thickness 3.35 angstrom: measured once by hand with LAMMPS alone.
    assert header["properties"]["young"] == pytest.approx(1054e9, rel=5e-3)
    assert header["properties"]["lattice_constant"] == pytest.approx(1.4388e-10, rel=1e-3)


def test_a_crack_of_the_continuum_is_measured_grows_and_resumes_the_same(start: StartsRuns, tmp_path: Path) -> None:
    """The scene with a growing crack, small and fast; cut in two by --resume it gives the same rows and events."""
    small = [
        "continuum.cell_size=1 mm", "continuum.time_step=0.4 us", "run.output_every=50", "run.checkpoint_every=35",
        "continuum.cracks.0.growth.critical_energy_release_rate=2 J/m^2", "run.stop_after_crack_growth=2 mm",
    ]  # fmt: skip
    scene = ROOT / "scenes" / "edge_crack.toml"
    folders = {}
    for name, lengths in (("whole", (150,)), ("parts", (95, 150))):
        folders[name] = tmp_path / name
        for number, steps in enumerate(lengths):
            words = [word for value in (*small, f"run.steps={steps}") for word in ("--set", value)]
            run = start(scene, folders[name], *words, *(["--resume"] if number else []))
            assert run.wait(RUN_SECONDS) == 0, run.printed
    with Results(folders["whole"] / "results.h5") as one, Results(folders["parts"] / "results.h5") as two:
        assert len(one.step) < 150, "the run ends when the crack has grown"
        assert [event["kind"] for event in one.events] == ["growth"] * 4
        assert one.events == two.events
        for name in one.series.keys() - {"seconds_continuum", "seconds_exchange"}:
            assert np.array_equal(one.series[name], two.series[name], equal_nan=True), name
        release = one.series["tip_0_1_j"]
        assert np.isnan(release[:9]).all() and np.isfinite(release[9:]).all()
        assert one.units["tip_0_1_j"] == "J/m^2"
    summary = json.loads((folders["parts"] / "summary.json").read_text())
    assert summary["measures"]["crack_growth"] == pytest.approx(2e-3)
    assert "the crack grew by 2 mm" in summary["reason"] and len(summary["events"]) == 4
