"""A small laminate as real processes: to its end, killed at every place, stopped, attached, always the same curve."""

from __future__ import annotations

import json
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path
from signal import SIGINT, SIGKILL, Signals

import numpy as np
import psutil
import pytest
from small_runs import StartsRuns

from coordinator.laminate_kill_resume import CELL, INCREMENTS, SCENE, differing, kill_worker, wait_for_increment
from coordinator.laminate_results import LaminateResults
from coordinator.run_process import RunProcess
from protocol.security import make_keys

pytestmark = [pytest.mark.timeout(300), pytest.mark.xdist_group("laminate-run")]

SECONDS = 200.0
WATCHED = """
[[output.watched]]
x = "0 mm"
y = "1.7 mm"
ply = 1
[[output.watched]]
x = "0 mm"
y = "1.7 mm"
ply = 2
"""


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scene") / "small_laminate.toml"
    path.write_text(SCENE + WATCHED)
    return path


@pytest.fixture(scope="module")
def unbroken(scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a run that nobody disturbed."""
    folder = tmp_path_factory.mktemp("alone") / "run"
    with RunProcess(scene, folder) as run:
        assert run.wait(SECONDS) == 0, run.printed
        assert run.survivors(10) == []
    return folder


def summary(folder: Path) -> dict:
    return dict(json.loads((folder / "summary.json").read_text()))


def run_and_send(
    start: StartsRuns, scene: Path, folder: Path, increment: int, process: str, signal: Signals, code: int
) -> tuple[RunProcess, dict]:
    """A run one process of which got a signal after an increment, and what its summary tells."""
    run = start(scene, folder)
    wait_for_increment(run, increment)
    run.send(process, signal)
    assert run.wait(SECONDS) == code, run.printed
    assert run.survivors(10) == []
    return run, summary(folder)


def test_a_run_ends_with_results_summary_and_report(unbroken: Path) -> None:
    results = LaminateResults.read(unbroken / "results.h5")
    assert results.increments == INCREMENTS and results.series["load"][-1] == 1.0
    assert [frame.step for frame in results.frames] == [3, 6, 9, 10]
    told = summary(unbroken)
    assert told["status"] == "finished" and told["reason"] == "the whole elongation is reached"
    assert told["steps"] == INCREMENTS
    assert told["measures"]["peak_stress"] == max(results.series["stress"])
    assert told["measures"]["failed_points"] == np.sum(results.new_failures) > 0
    assert 0.0 < told["measures"]["queries_spared"] < 1.0
    assert "depends on the mesh" in told["warnings"][0]
    assert results.events[0]["material"] == "matrix" and results.events[0]["ply"] == 1  # the ply across the pull
    watched = results.watched
    assert watched is not None and watched.plies.tolist() == [0, 1] and len(watched.subcells) == INCREMENTS
    for stress, subcells in zip(watched.stress, watched.subcells, strict=True):
        assert np.einsum("n,wni->wi", watched.shares, subcells) == pytest.approx(stress, abs=1e-9 * abs(stress).max())
    page = (unbroken / "report.html").read_text()
    assert page.count("<h3>Ply ") == 2
    assert results.events[0]["sentence"] in page and told["warnings"][0] in page


def test_before_anything_fails_the_stress_is_proportional(unbroken: Path) -> None:
    results = LaminateResults.read(unbroken / "results.h5")
    first = results.events[0]["step"] - 1
    stiffness = np.array(results.series["stress"][:first]) / np.array(results.series["strain"][:first])
    assert first >= 2
    assert stiffness == pytest.approx(np.full(first, stiffness[0]), rel=1e-6)


def test_a_killed_structure_service_is_named_and_resume_gives_the_same_bits(
    start: StartsRuns, scene: Path, unbroken: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    run, told = run_and_send(start, scene, folder, 4, "structure", SIGKILL, 1)
    assert told["status"] == "failed"
    assert (
        f"failed after increment {told['steps']}: the structure service (fem_service) was killed by signal SIGKILL"
        in (run.printed)
    )
    assert f"results up to increment {told['steps']} are in {folder}; go on with: " in run.printed
    assert "--resume" in run.printed and 3 <= told["steps"] < INCREMENTS
    assert "not finished" not in (folder / "report.html").read_text()
    again = start(scene, folder, "--resume")
    assert again.wait(SECONDS) == 0, again.printed
    assert differing(unbroken, folder) == []
    assert summary(folder)["measures"] == summary(unbroken)["measures"]


@pytest.mark.slow
def test_a_killed_worker_changes_no_bit(start: StartsRuns, scene: Path, unbroken: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    run = start(scene, folder, "--set", "micromechanics.workers=2")
    wait_for_increment(run, 3)
    killed = kill_worker(run)
    assert run.wait(SECONDS) == 0, run.printed
    assert run.survivors(10) == []
    assert (
        f"its process {killed} was killed by signal 9"
        in (folder / "services" / "micromechanics" / "log.txt").read_text()
    )
    assert differing(unbroken, folder) == []


def test_ctrl_c_keeps_what_was_made_and_resume_ends_it(
    start: StartsRuns, scene: Path, unbroken: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    _, told = run_and_send(start, scene, folder, 3, "coordinator", SIGINT, 130)
    assert told["status"] == "interrupted" and "--resume" in told["reason"]
    assert 2 <= told["steps"] < INCREMENTS
    changed = start(scene, folder, "--resume", "--set", "load.final_strain=0.02")
    assert changed.wait(SECONDS) == 1
    assert "differs from that of the checkpoint in load.final_strain" in changed.printed
    again = start(scene, folder, "--resume")
    assert again.wait(SECONDS) == 0, again.printed
    assert differing(unbroken, folder) == []


@pytest.mark.slow
def test_resume_with_another_cell_is_refused(start: StartsRuns, scene: Path, unbroken: Path, tmp_path: Path) -> None:
    other = tmp_path / "cell.toml"
    other.write_text(CELL.read_text())
    file = tmp_path / "own_cell.toml"
    file.write_text(
        SCENE.replace(str(CELL), "cell.toml")
        .replace("final_strain = 0.012", "final_strain = 0.001")
        .replace("= 0.1", "= 1.0")
    )
    folder = tmp_path / "run"
    first = start(file, folder)
    assert first.wait(SECONDS) == 0, first.printed
    once_more = start(file, folder, "--resume")  # nothing is left to do
    assert once_more.wait(SECONDS) == 0, once_more.printed
    assert LaminateResults.read(folder / "results.h5").increments == 1
    other.write_text(CELL.read_text().replace("fibre_fraction = 0.6", "fibre_fraction = 0.5"))
    before = (folder / "results.h5").read_bytes()
    again = start(file, folder, "--resume")
    assert again.wait(SECONDS) == 1
    assert (folder / "results.h5").read_bytes() == before
    assert "cell.toml differs from what the checkpoint was made with in heights" in again.printed


def test_a_run_that_fails_in_its_first_increment_says_so_and_leaves_a_report(
    start: StartsRuns, scene: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    words = [f"load.{name}" for name in ("first=0.8", "most=0.8", "least=0.8", "iterations=1")]
    run = start(scene, folder, *(word for setting in words for word in ("--set", setting)))
    assert run.wait(SECONDS) == 1, run.printed
    assert "failed after increment 0:" in run.printed and "the increment is below the least" in run.printed
    assert "Traceback" not in run.printed
    told = summary(folder)
    assert told["status"] == "failed" and told["steps"] == 0
    assert "No increment was made." in (folder / "report.html").read_text()
    assert LaminateResults.read(folder / "results.h5").increments == 0


@pytest.mark.slow
def test_attached_services_serve_a_run_and_live_on(
    start: StartsRuns, scene: Path, unbroken: Path, tmp_path: Path
) -> None:
    command = [sys.executable, "-m", "coordinator.cli", "serve", "micromechanics", "--folder", str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as cells:
        try:
            assert cells.stdout is not None
            endpoint = next(line for line in cells.stdout if "listens at" in line).split()[-1]
            run = start(scene, tmp_path / "run", "--attach", f"micromechanics={endpoint}")
            assert run.wait(SECONDS) == 0, run.printed
            assert cells.poll() is None and psutil.pid_exists(cells.pid)
        finally:
            cells.terminate()
    assert differing(unbroken, tmp_path / "run") == []
    wrong = start(scene, tmp_path / "wrong", "--attach", "continuum=ipc:///nowhere")
    assert wrong.wait(SECONDS) == 1
    assert "this scene has the services micromechanics and structure" in wrong.printed


@pytest.mark.slow
@pytest.mark.parametrize("both", [False, True], ids=["structure-started", "both-attached"])
def test_keys_reach_the_link_between_the_services(
    start: StartsRuns, scene: Path, unbroken: Path, tmp_path: Path, both: bool
) -> None:
    """Services over TCP with CURVE on; the structure service, started or attached, asks the cells with the keys."""
    keys = tmp_path / "keys"
    make_keys(keys)
    attached: list[str] = []
    with ExitStack() as stack:
        for role in ("micromechanics", "structure") if both else ("micromechanics",):
            command = [sys.executable, "-m", "coordinator.cli", "serve", role, "--keys", str(keys)]
            folder = tmp_path / role
            folder.mkdir()
            process = stack.enter_context(
                subprocess.Popen([*command, "--folder", str(folder)], stdout=subprocess.PIPE, text=True)
            )
            stack.callback(process.terminate)
            assert process.stdout is not None
            endpoint = next(line for line in process.stdout if "listens at" in line).split()[-1]
            assert endpoint.startswith("tcp://127.0.0.1:")
            attached += ["--attach", f"{role}={endpoint}"]
        run = start(scene, tmp_path / "run", *attached, "--keys", str(keys))
        assert run.wait(SECONDS) == 0, run.printed
        assert differing(unbroken, tmp_path / "run") == []
        refused = start(scene, tmp_path / "refused", *attached)
        assert refused.wait(SECONDS) == 1 and "keys" in refused.printed
