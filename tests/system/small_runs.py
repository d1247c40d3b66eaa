"""What the tests of whole runs share."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from coordinator.run_process import RunProcess

#: Fewer steps than the case of `verify`; a multiple of the checkpoints.
STEPS = 30
SHORT = ("--set", f"run.steps={STEPS}")


class StartsRuns(Protocol):
    """Starts a run that is ended, with all its processes, when the test ends."""

    def __call__(self, scene: Path, folder: Path, *words: str) -> RunProcess: ...
