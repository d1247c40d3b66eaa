"""Kill and resume of a laminate: whatever process is killed in mid-run, the curve ends bit by bit as one left alone."""

from __future__ import annotations

import json
import signal
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from coordinator.kill_resume import RUN_SECONDS, run_through
from coordinator.run_process import COORDINATOR, RunProcess
from protocol.verification import CannotRun, Case, Check

CELL = Path(__file__).resolve().parent.parent / "scenes" / "cells" / "im7_epon862_neat.toml"
#: An eighth of a cross-ply with a hole, 60 bricks, through its first failures and past its peak.
SCENE = f"""
title = "Small cross-ply"
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
final_strain = 0.012
first = 0.1
most = 0.1
[micromechanics]
cell = "{CELL}"
[output]
fields_every = 3
"""
INCREMENTS = 10
#: Increments after which a process is killed: the first failures have come, the peak has not.
KILLED_AFTER = 4
END_SECONDS = 10.0
#: Of a run: what differs from one run of the same scene to the next.
_TIMES = "seconds_"


def wait_for_increment(run: RunProcess, increment: int) -> None:
    """Wait until the laminate has made so many increments."""

    def reached() -> bool:
        status = run.status("structure")
        return status is not None and status.step >= increment

    run.wait_until(reached, f"increment {increment}", RUN_SECONDS)


def kill_worker(run: RunProcess) -> int:
    """Kill one of the workers behind the run's micromechanics service and return its process number.

    Raises
    ------
    RuntimeError
        If the service has not at least two workers.
    """
    front = run.service("micromechanics")
    workers = [] if front is None else [child for child in front.children() if "serve" in child.cmdline()]
    if len(workers) < 2:
        raise RuntimeError(f"micromechanics has {len(workers)} workers; one is to be killed beside another")
    workers[0].kill()
    return workers[0].pid


def differing(one: Path, other: Path) -> list[str]:
    """Names of what the results files of two runs do not share bit by bit, times apart."""
    with h5py.File(one / "results.h5") as mine, h5py.File(other / "results.h5") as theirs:
        found, wanted = _content(mine), _content(theirs)
    return [name for name in sorted(found.keys() | wanted.keys()) if found.get(name) != wanted.get(name)]


def _content(file: h5py.File) -> dict[str, Any]:
    """Bits of all datasets: curve, failures, fields. What differs by rights, such as the folder, is in attributes."""
    found: dict[str, Any] = {}

    def visit(name: str, entry: h5py.Group | h5py.Dataset) -> None:
        if isinstance(entry, h5py.Dataset) and not name.rsplit("/", 1)[-1].startswith(_TIMES):
            values = np.asarray(entry[()])
            bits = values.tolist() if values.dtype == object else values.tobytes()
            found[name] = (str(entry.dtype), entry.shape, bits)

    file.visititems(visit)
    return found


def steps_made(folder: Path) -> int:
    """Increments that the summary of a run tells of."""
    return int(json.loads((folder / "summary.json").read_text())["steps"])


def _worker_killed(scene: Path, folder: Path) -> int:
    """Run to the end with two workers, one of which is killed on the way; return the processes left."""
    with RunProcess(scene, folder, "--set", "micromechanics.workers=2") as run:
        wait_for_increment(run, KILLED_AFTER)
        kill_worker(run)
        code = run.wait(RUN_SECONDS)
        if code != 0:
            raise RuntimeError(f"the run did not outlive a worker; it ended with {code}:\n{run.printed}")
        return len(run.survivors(END_SECONDS))


def _killed_and_resumed(scene: Path, folder: Path, victim: str) -> int:
    """Run, kill a process for good, resume; return the processes left by the kill."""
    with RunProcess(scene, folder) as run:
        wait_for_increment(run, KILLED_AFTER)
        run.send(victim, signal.SIGKILL)
        code = run.wait(RUN_SECONDS)
        left = len(run.survivors(END_SECONDS))
        if code == 0:
            raise RuntimeError(f"the run had ended before {victim} was killed:\n{run.printed}")
    run_through(scene, folder, "--resume")
    return left


def verify(folder: Path) -> list[Check]:
    """Kill a worker, the structure service and the coordinator, each in a run of its own."""
    if not CELL.exists():
        raise CannotRun(f"{CELL} is not there: run from a checkout")
    scene = folder / "small_laminate.toml"
    scene.write_text(SCENE)
    alone = folder / "alone"
    run_through(scene, alone)
    checks = [Check("increments of the run left alone", steps_made(alone), INCREMENTS, 0.0, "the scene's load")]
    for what in ("worker", "structure", COORDINATOR):
        place = folder / what
        after = f"SIGKILL after increment {KILLED_AFTER}"
        if what == "worker":
            left, after = _worker_killed(scene, place), f"{after}, of one of two workers of micromechanics"
        else:
            left, after = _killed_and_resumed(scene, place, what), f"{after}, then --resume"
        changed = differing(alone, place)
        source = f"{after}; bit by bit" + (f"; differ: {', '.join(changed)}" if changed else "")
        checks += [
            Check(f"{what} killed: datasets of results.h5 that differ", float(len(changed)), 0.0, 0.0, source),
            Check(f"{what} killed: largest difference of the curve", _apart(alone, place), 0.0, 0.0, source, "Pa"),
            Check(f"{what} killed: processes left", float(left), 0.0, 0.0, after),
        ]
    return checks


def _apart(one: Path, other: Path) -> float:
    """Largest difference of the stress at any increment; infinite where the increments are not the same."""
    with h5py.File(one / "results.h5") as mine, h5py.File(other / "results.h5") as theirs:
        curves = [np.array([file["series/strain"][:], file["series/stress"][:]]) for file in (mine, theirs)]
    if curves[0].shape != curves[1].shape or (curves[0][0] != curves[1][0]).any():
        return float("inf")
    return float(np.abs(curves[0][1] - curves[1][1]).max())


LAMINATE_KILL_RESUME = Case(
    "structure",
    "kill-resume",
    "a worker, the structure service, the coordinator killed in mid-run: the same curve bit by bit",
    verify,
)
