"""Cases of the MD service for `scalebridge verify`."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path
from statistics import median

import numpy as np

from md_service.force_fields import force_field as profile_of
from md_service.overhead import DAMPING_TIME, STIFFNESS, TEMPERATURE, BareRun, framed_sheet
from protocol import atomistic as messages
from protocol.client import Client
from protocol.messages import Acknowledged
from protocol.verification import CannotRun, Case, Check

FORCE_FIELD = "airebo"
SIZE = 103e-10  # m, edge of the sheet
MARGIN = 15e-10  # m, width of the anchored frame
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


class _ServedSheet:
    """The sheet of `BareRun` behind a service of its own process."""

    def __init__(self, folder: Path, window: int) -> None:
        folder.mkdir()
        endpoint = f"ipc://{folder / 'socket'}"
        self._process = subprocess.Popen([sys.executable, "-c", _SERVE, str(folder), endpoint, str(os.getpid())])
        self._client = Client.connect(endpoint, "atomistic")
        position, frame = framed_sheet(FORCE_FIELD, SIZE, MARGIN)
        self._window = window
        self._client.call(
            "configure",
            messages.AtomisticConfigure(
                force_field=FORCE_FIELD,
                sample=messages.Sample(material="graphene", width=SIZE, height=SIZE),
                temperature=TEMPERATURE,
                time_step=profile_of(FORCE_FIELD).time_step,
                seed=1,
            ),
            messages.AtomisticConfigured,
        )
        self._advance = messages.AtomisticAdvance(
            steps=window, anchor_position=position[frame], anchor_velocity=np.zeros((len(frame), 3))
        )
        self._client.call(
            "register",
            messages.AtomisticRegister(
                atom_id=frame,
                anchor_position=position[frame],
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
        for _ in range(steps // self._window):
            self._client.call("advance", self._advance, messages.AtomisticAdvanced)
        return (time.perf_counter() - start) / steps

    def close(self) -> None:
        """End the service."""
        self._client.control.call("shutdown", None, Acknowledged)
        self._client.close()
        self._process.wait(10)


def overhead(folder: Path) -> list[Check]:
    """Time MD through the service against the same LAMMPS input run bare, in turn in one run."""
    if not hasattr(os, "sched_setaffinity"):
        raise CannotRun("processes cannot be kept on one core here, and cores differ by more than what is measured")
    cores = os.sched_getaffinity(0)
    # Both sides take turns on one core; the service inherits it.
    os.sched_setaffinity(0, {min(cores)})
    try:
        return _overhead_on_one_core(folder)
    finally:
        os.sched_setaffinity(0, cores)


def _overhead_on_one_core(folder: Path) -> list[Check]:
    checks = []
    for window, limit in LIMITS.items():
        served = _ServedSheet(folder / f"M{window}", window)
        bare = BareRun(folder / f"bare{window}", window, force_field=FORCE_FIELD, size=SIZE, margin=MARGIN)
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
