"""Case `whole/md-overhead`: MD through the service against the same LAMMPS input run bare."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path
from statistics import median

import numpy as np

from md_service.backend import mpi_launcher
from md_service.force_fields import force_field as profile_of
from md_service.overhead import DAMPING_TIME, SIZE, SMALLER, STIFFNESS, TEMPERATURE, framed_sheet
from protocol import atomistic as messages
from protocol.client import Client
from protocol.messages import Acknowledged
from protocol.verification import CannotRun, Case, Check

FORCE_FIELD = "airebo"
ROUNDS = 7
STEPS = 200
#: Allowed slowdown by M, from the design of the service.
LIMITS = {10: 1.15, 100: 1.08}

_SERVE = """
import sys
from pathlib import Path
from md_service.service import make_service
from protocol.server import Server
Server(make_service(Path(sys.argv[1])), sys.argv[2], parent=int(sys.argv[3])).run()
"""


def _words(ranks: int) -> list[str]:
    return [*([] if ranks == 1 else mpi_launcher(ranks)), sys.executable]


class ServedSheet:
    """The sheet of `BareSheet` behind a service of its own process.

    Parameters
    ----------
    folder : Path
        Made.
    force_field : str
        Profile name.
    window : int
        Steps M.
    ranks : int
        MPI ranks of the service.
    """

    def __init__(self, folder: Path, force_field: str, window: int, ranks: int = 1) -> None:
        folder.mkdir()
        endpoint = f"ipc://{folder / 'socket'}"
        words = [*_words(ranks), "-c", _SERVE, str(folder), endpoint, str(os.getpid())]
        self._process = subprocess.Popen(words)
        self._client = Client.connect(endpoint, "atomistic")
        self.window = window
        size = SMALLER.get(force_field, SIZE)
        self._client.call(
            "configure",
            messages.AtomisticConfigure(
                force_field=force_field,
                sample=messages.Sample(material="graphene", width=size, height=size),
                temperature=TEMPERATURE,
                time_step=profile_of(force_field).time_step,
                seed=1,
            ),
            messages.AtomisticConfigured,
        )
        atoms, frame = framed_sheet(force_field)
        place = atoms.position[frame]
        self._advance = messages.AtomisticAdvance(
            steps=window, anchor_position=place, anchor_velocity=np.zeros_like(place)
        )
        self._client.call(
            "register",
            messages.AtomisticRegister(
                atom_id=frame,
                anchor_position=place,
                anchor_ivc=np.zeros(len(frame), dtype=np.int64),
                stiffness=np.full(len(frame), STIFFNESS),
                damping_time=DAMPING_TIME,
            ),
            messages.AtomisticRegistered,
        )
        self._client.call(
            "equilibrate",
            messages.EquilibrateRequest(steps=100, windows=8, window_steps=window),
            messages.Equilibrated,
        )

    def seconds_per_step(self, steps: int) -> float:
        """Advance in windows and return the wall time of a step at the client, s."""
        start = time.perf_counter()
        for _ in range(steps // self.window):
            self._client.call("advance", self._advance, messages.AtomisticAdvanced)
        return (time.perf_counter() - start) / steps

    def close(self) -> None:
        """End the service."""
        self._client.control.call("shutdown", None, Acknowledged)
        self._client.close()
        self._process.wait(10)


class BareSheet:
    """`md_service.overhead.BareRun` in processes of its own, so that both sides may have several ranks.

    Parameters
    ----------
    folder : Path
        For the LAMMPS log.
    force_field : str
        Profile name.
    window : int
        Steps M of the averages.
    anchored : bool
        With anchors, or atoms alone.
    ranks : int
        MPI ranks.
    """

    def __init__(self, folder: Path, force_field: str, window: int, anchored: bool = True, ranks: int = 1) -> None:
        kind = "anchored" if anchored else "free"
        words = [*_words(ranks), "-m", "md_service.overhead", str(folder), force_field, str(window), kind]
        self._process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self._process.stdin is not None and self._process.stdout is not None  # asked for above
        self._input, self._output = self._process.stdin, self._process.stdout
        if self._output.readline().strip() != "ready":
            raise CannotRun(f"the bare run of {force_field} ended with status {self._process.wait()}")

    def seconds_per_step(self, steps: int) -> float:
        """Run without a break and return the wall time of a step, s."""
        self._input.write(f"{steps}\n")
        self._input.flush()
        return float(self._output.readline())

    def close(self) -> None:
        """End the processes."""
        self._input.close()
        self._process.wait(10)
        self._output.close()


def overhead(folder: Path) -> list[Check]:
    """Time MD through the service against the same LAMMPS input run bare, in turn in one run."""
    if not hasattr(os, "sched_setaffinity"):
        raise CannotRun("processes cannot be kept on one core here, and cores differ by more than what is measured")
    cores = os.sched_getaffinity(0)
    # Both sides take turns on one core, which their processes inherit.
    os.sched_setaffinity(0, {min(cores)})
    try:
        return _overhead_on_one_core(folder)
    finally:
        os.sched_setaffinity(0, cores)


def _overhead_on_one_core(folder: Path) -> list[Check]:
    checks = []
    for window, limit in LIMITS.items():
        served = ServedSheet(folder / f"M{window}", FORCE_FIELD, window)
        bare = BareSheet(folder / f"bare{window}", FORCE_FIELD, window)
        ratios = [served.seconds_per_step(STEPS) / bare.seconds_per_step(STEPS) for _ in range(ROUNDS)]
        served.close()
        bare.close()
        checks.append(
            Check(
                f"time of a step through the service over bare LAMMPS, M = {window}",
                median(ratios),
                limit,
                0.0,
                f"the same input without a break, {ROUNDS} pairs in turn, {FORCE_FIELD}",
                at_most=True,
            )
        )
    return checks


CASES = [Case("whole", "md-overhead", "MD through the service against the same LAMMPS input run bare", overhead)]
