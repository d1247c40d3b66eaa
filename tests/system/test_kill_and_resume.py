"""A run whose processes are killed goes on, with --resume, as if nothing had happened."""

from __future__ import annotations

import json
import random
from collections.abc import Callable
from pathlib import Path
from signal import SIGKILL

import h5py
import pytest
from small_runs import SHORT, STEPS, StartsRuns

from coordinator.kill_resume import (
    END_SECONDS,
    KILL_RESUME,
    RUN_SECONDS,
    VICTIMS,
    Kill,
    differing_arrays,
    run_and_kill,
    run_through,
)
from coordinator.run_process import COORDINATOR

pytestmark = [pytest.mark.timeout(600), pytest.mark.xdist_group("left-alone")]

#: One kill of each process, at a random step after the first checkpoint and before the last step.
KILLS = dict(zip(VICTIMS, random.Random(11).sample(range(7, STEPS - 2), len(VICTIMS)), strict=True))
SERVICES = {"continuum": "mpm_service", "atomistic": "md_service"}

Killed = Callable[[str], tuple[Path, Kill]]


@pytest.fixture(scope="module")
def killed(small_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Killed:
    """Run the small scene, kill one process of it; each victim once for all tests."""
    found: dict[str, tuple[Path, Kill]] = {}

    def kill(victim: str) -> tuple[Path, Kill]:
        if victim not in found:
            folder = tmp_path_factory.mktemp(f"killed-{victim}") / "run"
            found[victim] = folder, run_and_kill(small_scene, folder, victim, KILLS[victim], *SHORT)
        return found[victim]

    return kill


@pytest.mark.parametrize("victim", SERVICES)
def test_a_killed_service_is_named_with_signal_step_and_log(killed: Killed, victim: str) -> None:
    folder, kill = killed(victim)
    assert kill.code == 1
    assert f"the {victim} service ({SERVICES[victim]}) was killed by signal SIGKILL" in kill.printed
    assert f"last lines of {folder}/services/{victim}/log.txt" in kill.printed
    assert f"{victim} ({SERVICES[victim]}) listens at" in kill.printed
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["status"] == "failed"
    assert f"failed after coupling step {summary['steps']}:" in kill.printed
    assert kill.step - 1 <= summary["steps"] < STEPS
    assert "was killed by signal SIGKILL" in summary["reason"]
    assert (folder / "report.html").exists()


@pytest.mark.parametrize("victim", SERVICES)
def test_results_hold_every_step_made_before_a_service_was_killed(killed: Killed, victim: str) -> None:
    folder, kill = killed(victim)
    done = json.loads((folder / "summary.json").read_text())["steps"]
    with h5py.File(folder / "results.h5") as file:
        assert file["time_series/step"][:].tolist() == list(range(1, done + 1))
    assert kill.orphans == 0


def test_results_are_readable_and_no_process_is_left_when_the_coordinator_was_killed(killed: Killed) -> None:
    folder, kill = killed(COORDINATOR)
    assert kill.code == -SIGKILL
    assert kill.orphans == 0
    with h5py.File(folder / "results.h5") as file:
        steps = file["time_series/step"][:].tolist()
        assert steps == list(range(1, len(steps) + 1))
        assert len(steps) >= KILLS[COORDINATOR] // 6 * 6
    assert kill.lost_rows == 0


@pytest.mark.parametrize("victim", VICTIMS)
def test_a_resumed_run_ends_bit_by_bit_as_one_left_alone(
    killed: Killed, victim: str, left_alone: Path, small_scene: Path
) -> None:
    folder, _ = killed(victim)
    run_through(small_scene, folder, *SHORT, "--resume")
    assert differing_arrays(left_alone, folder) == []
    assert json.loads((folder / "summary.json").read_text())["status"] == "finished"


def test_a_run_killed_before_its_first_checkpoint_starts_anew(
    start: StartsRuns, left_alone: Path, small_scene: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    for victim in ("atomistic", COORDINATOR):
        run = start(small_scene, folder, *SHORT, "--resume")
        run.wait_until(lambda run=run: run.status("atomistic") is not None, "an answer", 120)  # type: ignore[misc]
        run.send(victim, SIGKILL)
        assert run.wait(RUN_SECONDS) == (-SIGKILL if victim == COORDINATOR else 1), run.printed
        assert run.survivors(END_SECONDS) == []
        assert not (folder / "checkpoint.npz").exists()
    run = start(small_scene, folder, *SHORT, "--resume")
    assert run.wait(RUN_SECONDS) == 0, run.printed
    assert "the run starts anew" in run.printed
    assert differing_arrays(left_alone, folder) == []


def test_resume_with_a_changed_scene_is_refused_and_names_the_fields(
    start: StartsRuns, killed: Killed, small_scene: Path
) -> None:
    folder, _ = killed("continuum")
    before = (folder / "results.h5").read_bytes()
    changes = ("--set", "atomistic.temperature=310 K", "--set", "handshake.weight=0.6", "--set", "run.seed=8")
    run = start(small_scene, folder, *SHORT, *changes, "--resume")
    assert run.wait(RUN_SECONDS) == 1
    assert "differs from that of the checkpoint in atomistic.temperature, handshake.weight, run.seed" in run.printed
    assert (folder / "results.h5").read_bytes() == before


def test_a_damaged_checkpoint_is_refused_by_name(start: StartsRuns, small_scene: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "checkpoint.npz").write_bytes(b"PK\x03\x04 cut short")
    run = start(small_scene, folder, "--resume")
    assert run.wait(RUN_SECONDS) == 1
    assert "checkpoint.npz cannot be read" in run.printed
    assert (folder / "checkpoint.npz").exists()


@pytest.mark.slow
def test_twenty_kills_in_turn_change_nothing(tmp_path: Path) -> None:
    for check in KILL_RESUME.run(tmp_path):
        assert check.passed, f"{check.quantity}: {check.value}"
