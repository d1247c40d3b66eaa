"""How runs end before their last step: interrupts, lost and stopped processes, solvers that fail, wrong scenes."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
import time
from pathlib import Path
from signal import SIGINT, SIGKILL, SIGSTOP, SIGTERM, Signals

import h5py
import pytest
from small_runs import StartsRuns

from coordinator.kill_resume import END_SECONDS, RUN_SECONDS
from coordinator.run_process import COORDINATOR, RunProcess
from protocol.server import is_gone

pytestmark = pytest.mark.timeout(300)

LONG = ("--set", "run.steps=100000", "--set", "run.checkpoint_every=100000", "--set", "run.output_every=100000")
#: A stopped peer is noticed by the heartbeat within a second, and given five to come back.
LINK_SECONDS = 6.0


def ends(run: RunProcess, within: float) -> int:
    """Return the exit status of a run that must end, with all its processes, within so many seconds."""
    end = time.monotonic() + within
    code = run.wait(within)
    assert run.survivors(max(0.0, end - time.monotonic())) == [], run.printed
    return code


def command_to_go_on(run: RunProcess) -> list[str]:
    """Return the words of the command that the run printed for going on."""
    found = re.search(r"go on with: (.+)$", run.printed, re.MULTILINE)
    assert found, run.printed
    words = shlex.split(found.group(1))
    assert words[0] == "scalebridge" and words[-1] == "--resume"
    return [sys.executable, "-m", "coordinator.cli", *words[1:]]


@pytest.mark.parametrize(
    ("number", "to_group"), [(SIGINT, False), (SIGINT, True), (SIGTERM, False)], ids=["ctrl-c", "ctrl-c-group", "term"]
)
def test_a_signal_in_the_loop_saves_the_step_and_says_how_to_go_on(
    start: StartsRuns, small_scene: Path, tmp_path: Path, number: Signals, to_group: bool
) -> None:
    folder = tmp_path / "run"
    run = start(small_scene, folder, *LONG)
    run.wait_for_step(9)
    (os.killpg if to_group else os.kill)(run.process.pid, number)
    assert ends(run, END_SECONDS) == 130, run.printed
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["status"] == "interrupted"
    assert summary["steps"] >= 9
    with h5py.File(folder / "results.h5") as file:
        assert file["time_series/step"][:].tolist() == list(range(1, summary["steps"] + 1))
    words = command_to_go_on(run)
    if to_group or number == SIGTERM:
        return  # one run that goes on is enough
    last = summary["steps"] + 4
    words[words.index("run.steps=100000")] = f"run.steps={last}"
    done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=RUN_SECONDS)
    assert done.returncode == 0, done.stderr
    with h5py.File(folder / "results.h5") as file:
        assert file["time_series/step"][:].tolist() == list(range(1, last + 1))


@pytest.mark.parametrize("to_group", [pytest.param(False, marks=pytest.mark.slow), True])
def test_a_signal_during_equilibration_ends_it(
    start: StartsRuns, small_scene: Path, tmp_path: Path, to_group: bool
) -> None:
    folder = tmp_path / "run"
    run = start(small_scene, folder, "--set", "atomistic.equilibration=500 ps")
    run.wait_for_operation("atomistic", "equilibrate")
    (os.killpg if to_group else os.kill)(run.process.pid, SIGINT)
    assert ends(run, END_SECONDS) == 130, run.printed
    assert json.loads((folder / "summary.json").read_text())["status"] == "interrupted"
    assert command_to_go_on(run)[-1] == "--resume"


def test_a_signal_while_services_start_ends_them(start: StartsRuns, small_scene: Path, tmp_path: Path) -> None:
    run = start(small_scene, tmp_path / "run")
    run.wait_until(lambda: run.service("atomistic") is not None, "start of the services", 60)
    os.kill(run.process.pid, SIGINT)
    assert ends(run, END_SECONDS) == 130, run.printed
    assert "go on with:" in run.printed


@pytest.mark.parametrize("ranks", [1, 2])
def test_services_end_by_themselves_when_the_coordinator_is_killed(
    start: StartsRuns, small_scene: Path, tmp_path: Path, ranks: int
) -> None:
    folder = tmp_path / "run"
    run = start(small_scene, folder, "--set", f"atomistic.ranks={ranks}", *LONG[:2])
    run.wait_for_step(12)
    run.send(COORDINATOR, SIGKILL)
    # Nobody has asked for its exit status yet, so it is a zombie, as under a careless parent.
    assert run.survivors(3.0) == []
    assert run.wait(1.0) == -SIGKILL
    with h5py.File(folder / "results.h5") as file:
        assert file["time_series/step"][:].tolist()[:6] == [1, 2, 3, 4, 5, 6]


def test_services_still_starting_end_when_the_coordinator_is_killed(
    start: StartsRuns, small_scene: Path, tmp_path: Path
) -> None:
    run = start(small_scene, tmp_path / "run")
    run.wait_until(lambda: run.service("atomistic") is not None, "start of the services", 60)
    run.send(COORDINATOR, SIGKILL)
    assert run.survivors(END_SECONDS) == []


@pytest.mark.parametrize("victim", ["rank", pytest.param("launcher", marks=pytest.mark.slow)])
def test_a_killed_process_of_a_parallel_service_ends_all_of_it(
    start: StartsRuns, small_scene: Path, tmp_path: Path, victim: str
) -> None:
    run = start(small_scene, tmp_path / "run", "--set", "atomistic.ranks=2", *LONG)
    run.wait_for_step(5)
    launcher = run.service("atomistic")
    assert launcher is not None
    (proxy,) = launcher.children()
    ranks = proxy.children()
    assert len(ranks) == 2
    run.survivors(0.0)  # so that none is forgotten once its parent is gone
    {"rank": ranks[1], "launcher": launcher}[victim].kill()
    assert run.wait(RUN_SECONDS) == 1, run.printed
    assert run.survivors(END_SECONDS) == []
    assert "the atomistic service (md_service)" in run.printed


@pytest.mark.slow
def test_ranks_that_have_lost_the_proxy_of_their_launcher_end_with_the_run(
    start: StartsRuns, small_scene: Path, tmp_path: Path
) -> None:
    run = start(small_scene, tmp_path / "run", "--set", "atomistic.ranks=2", *LONG)
    run.wait_for_step(5)
    launcher = run.service("atomistic")
    assert launcher is not None
    (proxy,) = launcher.children()
    run.survivors(0.0)  # so that none is forgotten once its parent is gone
    proxy.kill()
    os.kill(run.process.pid, SIGINT)
    assert ends(run, 2 * END_SECONDS) == 130, run.printed


@pytest.mark.parametrize("victim", [pytest.param("continuum", marks=pytest.mark.slow), "atomistic"])
def test_a_stopped_service_is_named_and_killed(
    start: StartsRuns, small_scene: Path, tmp_path: Path, victim: str
) -> None:
    folder = tmp_path / "run"
    run = start(small_scene, folder, *LONG)
    run.wait_for_step(5)
    service = run.service(victim)
    assert service is not None
    service.send_signal(SIGSTOP)
    began = time.monotonic()
    run.wait_until(lambda: is_gone(service), f"the end of {victim}", LINK_SECONDS + END_SECONDS)
    assert time.monotonic() - began > 1.0  # a short stop is forgiven
    assert run.wait(RUN_SECONDS) == 1
    assert run.survivors(END_SECONDS) == []
    assert re.search(rf"failed after coupling step \d+: the link to the {victim} service broke during", run.printed)
    assert json.loads((folder / "summary.json").read_text())["status"] == "failed"


def test_a_short_stop_of_a_service_is_forgiven(start: StartsRuns, continuum_scene: Path, tmp_path: Path) -> None:
    run = start(continuum_scene, tmp_path / "run", *LONG)
    run.wait_for_step(5)
    service = run.service("continuum")
    assert service is not None
    service.suspend()
    time.sleep(2.5)  # beyond the heartbeat's patience, within the grace of the link
    service.resume()
    status = run.status("continuum")
    reached = status.step if status is not None else 5
    run.wait_for_step(reached + 50)


def test_a_time_step_that_is_too_long_ends_in_a_named_error_with_a_hint(
    start: StartsRuns, small_scene: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    # Large cells, light springs and a slow damper, so that it is neither continuum nor handshake that objects.
    words = (
        "atomistic.time_step=20 fs", "atomistic.equilibration=20 ps", "handshake.steps_per_exchange=1",
        "handshake.weight=1.0", "handshake.damping_time=2 ps", "continuum.cell_size=7.5 angstrom",
        "handshake.width=7.5 angstrom", "handshake.ivc_size=7.5 angstrom",
    )  # fmt: skip
    run = start(small_scene, folder, *[part for word in words for part in ("--set", word)])
    assert run.wait(RUN_SECONDS) == 1, run.printed
    assert run.survivors(END_SECONDS) == []
    assert re.search(r"\[solver_failed; atomistic md_service, step \d+\]", run.printed), run.printed
    assert "time step" in run.printed or "time_step" in run.printed
    assert json.loads((folder / "summary.json").read_text())["status"] == "failed"


def test_a_solver_that_fails_in_the_loop_leaves_the_results_up_to_there(
    start: StartsRuns, small_scene: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    pull = []
    for edge, side in ((0, ""), (1, "-")):
        pull += [f"continuum.edges.{edge}.times=['0 ps', '0.05 ps']"]
        pull += [f"continuum.edges.{edge}.displacements=['0 angstrom', '{side}20 angstrom']"]
    run = start(small_scene, folder, *LONG, *[part for word in pull for part in ("--set", word)])
    assert run.wait(RUN_SECONDS) == 1, run.printed
    assert run.survivors(END_SECONDS) == []
    assert re.search(r"\[solver_failed; \w+ \w+, step \d+\]", run.printed), run.printed
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["status"] == "failed" and summary["steps"] > 0
    assert f"results up to step {summary['steps']} are in {folder}" in run.printed
    assert "--resume" not in run.printed  # it would fail again, exactly so
    with h5py.File(folder / "results.h5") as file:
        assert file["time_series/step"][:].tolist() == list(range(1, summary["steps"] + 1))


def test_an_unstable_handshake_is_refused_and_the_summary_says_failed(
    start: StartsRuns, small_scene: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    run = start(small_scene, folder, "--set", "handshake.weight=0.05")
    assert run.wait(RUN_SECONDS) == 1
    assert run.survivors(END_SECONDS) == []
    assert "exchange is unstable" in run.printed and "handshake.weight" in run.printed
    assert "Traceback" not in run.printed
    assert json.loads((folder / "summary.json").read_text())["status"] == "failed"


def test_all_mistakes_of_a_scene_are_reported_before_anything_starts(
    start: StartsRuns, small_scene: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    wrong = ("continuum.cell_size=5", "atomistic.temprature=300 K", "run.steps=-3", "handshake.width=7 angstrom")
    run = start(small_scene, folder, *[part for word in wrong for part in ("--set", word)])
    assert run.wait(RUN_SECONDS) == 1
    for field in ("continuum.cell_size = 5", "atomistic.temprature", "did you mean temperature", "run.steps = -3"):
        assert field in run.printed
    assert not folder.exists()


def test_an_unknown_backend_is_refused_before_anything_starts(
    start: StartsRuns, small_scene: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    run = start(small_scene, folder, "--set", "atomistic.backend=md_servise")
    assert run.wait(RUN_SECONDS) == 1
    assert "no backend 'md_servise' for the role 'atomistic'" in run.printed
    assert "installed for it: ase, lattice, md_service, openmm" in run.printed
    assert not folder.exists()
