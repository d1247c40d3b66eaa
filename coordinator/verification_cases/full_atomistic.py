"""Cases `coupling/full-atomistic...`: the coupled run against the same body of atoms alone."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from coordinator.verification_cases.runs import shipped
from protocol.verification import CannotRun, Case, Check

SHIPPED_SCENES: Final = Path(__file__).resolve().parents[2] / "scenes"
#: Seeds of coupled runs beside the first, for the scatter of the load.
OTHER_SEEDS: Final = (2, 3)
#: Shares of the coupled run: at most a fifth of the time.
MOST_TIME: Final = 0.2


def compare(scene: Path, folder: Path, overrides: Sequence[str] = ()) -> dict[str, Any]:
    """Run the command `compare` as a user would and return its answer.

    Raises
    ------
    RuntimeError
        Where it fails; the message is what it printed.
    """
    words = [sys.executable, "-m", "coordinator.cli", "compare", str(scene), "--full-atomistic", "--out", str(folder)]
    for override in overrides:
        words += ["--set", override]
    done = subprocess.run(words, capture_output=True, text=True, stdin=subprocess.DEVNULL, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"the comparison in {folder} ended with status {done.returncode}:\n{done.stderr}")
    found: dict[str, Any] = json.loads((folder / "compare.json").read_text())
    return found


def lattice(folder: Path) -> list[Check]:
    """Brittle lattice at 0 K: load at the first broken bond, and loads at which the tips are equally far."""
    folder.mkdir(parents=True, exist_ok=True)
    scene = folder / "brittle_lattice.toml"
    scene.write_text(shipped("brittle_lattice"), encoding="utf-8")
    found = compare(scene, folder / "run")
    return _loads(found, "the whole body as a lattice, same load, 0 K")
