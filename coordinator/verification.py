"""Cases of `scalebridge verify` that are whole runs, held against known answers."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from coordinator.field_figures import inner_strain
from coordinator.kill_resume import KILL_RESUME
from coordinator.laminate_kill_resume import LAMINATE_KILL_RESUME
from coordinator.results import Results
from protocol.verification import CannotRun, Case, Check

SCENES = Path(__file__).resolve().parent.parent / "scenes"
#: Steps of the crack scene for figures that do not need the crack to grow.
SHORT_SETUP = (
    "--set", "run.steps=50", "--set", "atomistic.equilibration=0.1 ps", "--set", "atomistic.reference=0.15 ps",
)  # fmt: skip
SHORT = ("--set", "run.steps=120")


def run_shipped(name: str, folder: Path, arguments: Sequence[str] = ()) -> dict[str, Any]:
    """Run a shipped scene as a user would and return its summary.

    Raises
    ------
    CannotRun
        Where the scenes are not beside the package.
    RuntimeError
        Where the run fails; the message is what it printed.
    """
    scene = SCENES / f"{name}.toml"
    if not scene.exists():
        raise CannotRun(f"{scene} is not there: run from a checkout")
    command = [sys.executable, "-m", "coordinator.cli", "run", str(scene), "--out", str(folder), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, stdin=subprocess.DEVNULL, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"the run of {name} ended with status {done.returncode}:\n{done.stderr}")
    summary: dict[str, Any] = json.loads((folder / "summary.json").read_text())
    return summary


def patch(folder: Path) -> list[Check]:
    """Strain inside the atoms against the strain applied to the continuum around them."""
    run_shipped("graphene_patch", folder / "run")
    with Results(folder / "run" / "results.h5") as results:
        applied = float(results.series["applied_strain"][-1])
        strain = inner_strain(results)
        balance = _largest_imbalance(results)
    if strain is None:
        raise RuntimeError("the run has no atoms inside the handshake")
    source = "displacement of the edges; a uniform strain passes a perfect handshake unchanged"
    return [
        Check("strain yy inside the atoms", strain.yy, applied, 0.02, source),
        Check("strain xx inside the atoms over applied yy", strain.xx / applied, 0.0, 0.02, source),
        balance,
    ]


def force_balance(folder: Path) -> list[Check]:
    """Sum of the forces of the volume cells against the sum of the anchor forces, at every step."""
    run_shipped("graphene_crack", folder / "run", SHORT_SETUP)
    with Results(folder / "run" / "results.h5") as results:
        return [_largest_imbalance(results)]


def _largest_imbalance(results: Results) -> Check:
    worst = float(np.max(results.series["force_balance"]))
    return Check("largest imbalance over all steps", worst, 0.0, 1e-10, "each anchor's force is in exactly one cell")


def time_outside_solvers(folder: Path) -> list[Check]:
    """Share of the wall time of the coupled loop in which neither solver computed."""
    run_shipped("graphene_crack", folder / "run", SHORT)
    with Results(folder / "run" / "results.h5") as results:
        solvers = sum(float(np.sum(results.series[f"seconds_{role}"])) for role in ("continuum", "atomistic"))
        outside = float(np.sum(results.series["seconds_exchange"]))
    share = outside / (solvers + outside)
    return [Check("share of the loop outside the solvers", share, 0.02, 0.0, "limit set for the product", at_most=True)]


def crack(folder: Path) -> list[Check]:
    """The crack grows in the atoms; J at its first growth is reported beside what is known of the potential."""
    summary = run_shipped("graphene_crack", folder / "run")
    with Results(folder / "run" / "results.h5") as results:
        tip = results.series["crack_tip"]
        grown = tip - tip[0]
        j = results.series["j_boundary"]
        started = np.flatnonzero(grown > 1e-10)
    wanted = 20e-10
    checks = [
        Check("crack growth short of 20 angstrom", max(0.0, wanted - summary["measures"]["crack_growth"]), 0.0, 1e-11,
              "the scene ends when the crack has grown so far", unit="m"),
    ]  # fmt: skip
    if len(started):
        source = (
            "airebo without its switching window, K-field on a sheet at 300 K: 9.1 J/m2; the bond is "
            "cut at 2.0 angstrom, before its energy is spent"
        )
        checks.append(Check("J of the edges at first growth", float(j[started[0]]), 9.1, 0.15, source, unit="J/m2"))
    return checks


CASES = [
    Case("whole", "patch", "uniform strain through the handshake, graphene at 1 K", patch),
    Case("whole", "force-balance", "forces of cells against forces of anchors, each step", force_balance),
    Case("whole", "time-outside-solvers", "share of the run outside the two solvers", time_outside_solvers),
    Case("whole", "crack", "a crack grows in the atoms under the load of the continuum", crack, slow=True),
    KILL_RESUME,
    LAMINATE_KILL_RESUME,
]
