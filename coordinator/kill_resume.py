"""Kill and resume: a run that is killed over and over ends bit by bit as one that is left alone."""

from __future__ import annotations

import random
import shutil
import signal
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from coordinator.checkpoint import NAME as CHECKPOINT
from coordinator.checkpoint import read_checkpoint
from coordinator.run_process import COORDINATOR, RunProcess
from protocol.verification import Case, Check

#: A sheet of about 750 atoms in a small body, pulled along y, with a thermostat's noise.
SCENE = """\
title = "Small sheet in a small body, pulled along y"

[run]
steps = 48
output_every = 8
checkpoint_every = 6
seed = 7

[continuum]
assumption = "plane_stress"
lower = ["-37.5 angstrom", "-37.5 angstrom"]
upper = ["37.5 angstrom", "37.5 angstrom"]
cell_size = "5 angstrom"
initial_velocity = "follow_edges"

[continuum.material]
young = "1054 GPa"
poisson = 0.064
density = "2214 kg/m^3"
thickness = "3.35 angstrom"

[[continuum.edges]]
edge = "top"
component = "y"
times = ["0 ps", "2 ps"]
displacements = ["0 angstrom", "1 angstrom"]

[[continuum.edges]]
edge = "bottom"
component = "y"
times = ["0 ps", "2 ps"]
displacements = ["0 angstrom", "-1 angstrom"]

[[continuum.edges]]
edge = "left"
component = "x"
times = ["0 ps", "2 ps"]
displacements = ["0 angstrom", "0 angstrom"]

[[continuum.edges]]
edge = "right"
component = "x"
times = ["0 ps", "2 ps"]
displacements = ["0 angstrom", "0 angstrom"]

[atomistic]
force_field = "tersoff"
width = "45 angstrom"
height = "45 angstrom"
temperature = "300 K"
time_step = "0.5 fs"
equilibration = "0.02 ps"
reference = "0.05 ps"

[handshake]
width = "10 angstrom"
steps_per_exchange = 10
ivc_size = "5 angstrom"
damping_time = "0.2 ps"
weight = 0.5
spread = "anchor"
"""
STEPS = 48
KILLS = 20
SEED = 20260
VICTIMS = (COORDINATOR, "continuum", "atomistic")
#: Seconds that a run may take to end after a kill: of a service, of the coordinator.
END_SECONDS = 5.0
RUN_SECONDS = 300.0


@dataclass(frozen=True)
class Kill:
    """What a kill left behind.

    Attributes
    ----------
    victim : str
    step : int
        Coupling step at which it was killed, or a little later.
    code : int
        Exit status of the run.
    printed : str
        What the run printed.
    orphans : int
        Processes left `END_SECONDS` after the end of the run.
    lost_rows : int
        Rows of the time series that are missing up to the last checkpoint.
    """

    victim: str
    step: int
    code: int
    printed: str
    orphans: int
    lost_rows: int


def run_through(scene: Path, folder: Path, *words: str) -> None:
    """Run a scene to its end.

    Raises
    ------
    RuntimeError
        Where the run fails; with what it printed.
    """
    with RunProcess(scene, folder, *words) as run:
        code = run.wait(RUN_SECONDS)
        if code != 0:
            raise RuntimeError(f"a run that was left alone ended with {code}:\n{run.printed}")


def run_and_kill(scene: Path, folder: Path, victim: str, step: int, *words: str) -> Kill:
    """Run a scene, kill one of its processes at a coupling step, and see what is left."""
    with RunProcess(scene, folder, *words) as run:
        run.wait_for_step(step, RUN_SECONDS)
        run.send(victim, signal.SIGKILL)
        code = run.wait(RUN_SECONDS)
        orphans = len(run.survivors(END_SECONDS))
        return Kill(victim, step, code, run.printed, orphans, lost_rows(folder))


def lost_rows(folder: Path) -> int:
    """Return how many rows the results lack up to the step of the checkpoint."""
    header, _ = read_checkpoint(folder)
    with h5py.File(folder / "results.h5") as file:
        present = set(file["time_series/step"][:].tolist())
    return len(set(range(1, header["step"] + 1)) - present)


def kill_steps(count: int, last: int, seed: int) -> list[int]:
    """Return ascending random steps, all before the last one."""
    return sorted(random.Random(seed).sample(range(1, last), count))


def differing_arrays(one: Path, other: Path) -> list[str]:
    """Return the names of arrays in which checkpoints and results of two runs differ by any bit.

    Wall times are left out.
    """
    names = []
    with np.load(one / CHECKPOINT) as mine, np.load(other / CHECKPOINT) as theirs:
        found, wanted = dict(mine), dict(theirs)
    with h5py.File(one / "results.h5") as mine, h5py.File(other / "results.h5") as theirs:
        found.update(_datasets(mine))
        wanted.update(_datasets(theirs))
    for name in sorted(found.keys() | wanted.keys()):
        if name not in found or name not in wanted or not _same(found[name], wanted[name]):
            names.append(name)
    return names


def _datasets(file: h5py.File) -> dict[str, np.ndarray]:
    found = {}

    def visit(name: str, entry: h5py.Group | h5py.Dataset) -> None:
        if isinstance(entry, h5py.Dataset) and not name.startswith("time_series/seconds_"):
            found[f"results.h5/{name}"] = np.asarray(entry[()])

    file.visititems(visit)
    return found


def _same(one: np.ndarray, other: np.ndarray) -> bool:
    return one.dtype == other.dtype and one.shape == other.shape and one.tobytes() == other.tobytes()


def kill_and_resume(scene: Path, folder: Path, kills: Sequence[tuple[str, int]]) -> list[Kill]:
    """Run a scene with kills at ascending steps, each followed by `--resume`, then to its end."""
    found = [run_and_kill(scene, folder, victim, step, "--resume") for victim, step in kills]
    run_through(scene, folder, "--resume")
    return found


def verify(folder: Path) -> list[Check]:
    """Kill a run twenty times, each process in turn at random steps; hold the end against a run left alone."""
    scene = folder / "small_sheet.toml"
    scene.write_text(SCENE)
    alone, killed = folder / "alone", folder / "killed"
    run_through(scene, alone)
    victims = [VICTIMS[number % len(VICTIMS)] for number in range(KILLS)]
    kills = kill_and_resume(scene, killed, list(zip(victims, kill_steps(KILLS, STEPS, SEED), strict=True)))
    with h5py.File(alone / "results.h5") as one, h5py.File(killed / "results.h5") as other:
        rows = len(set(one["time_series/step"][:].tolist()) - set(other["time_series/step"][:].tolist()))
    differing = differing_arrays(alone, killed)
    shutil.rmtree(killed, ignore_errors=True)
    after = f"after {KILLS} kills (SIGKILL) of coordinator, continuum and atomistic in turn, seed {SEED}"
    return [
        Check("processes left", float(sum(kill.orphans for kill in kills)), 0.0, 0.0, after),
        Check("rows lost", float(rows + sum(kill.lost_rows for kill in kills)), 0.0, 0.0, after),
        Check(
            "arrays of checkpoint and results that differ from those of a run left alone",
            float(len(differing)),
            0.0,
            0.0,
            after,
        ),
    ]


KILL_RESUME = Case(
    "whole", "kill-resume", f"{KILLS} kills, each followed by --resume: ends as a run left alone", verify, slow=True
)
