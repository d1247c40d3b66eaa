"""Whole runs of scenes that a case needs, made as a user would make them."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from coordinator.results import Results

SCENES = Path(__file__).with_name("scenes")


def run_text(text: str, folder: Path, overrides: Sequence[str] = ()) -> Results:
    """Run the scene of a text and return its results, open.

    Parameters
    ----------
    text : str
        TOML of the scene.
    folder : Path
        Takes the scene file and the folder `run` with its results.
    overrides : sequence of str
        ``key.sub=value`` each, as of ``--set``.

    Raises
    ------
    RuntimeError
        Where the run fails; the message is what it printed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    scene = folder / "scene.toml"
    scene.write_text(text, encoding="utf-8")
    words = [sys.executable, "-m", "coordinator.cli", "run", str(scene), "--out", str(folder / "run")]
    for override in overrides:
        words += ["--set", override]
    done = subprocess.run(words, capture_output=True, text=True, stdin=subprocess.DEVNULL, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"the run in {folder} ended with status {done.returncode}:\n{done.stderr}")
    return Results(folder / "run" / "results.h5")


def shipped(name: str) -> str:
    """Return the text of a scene that comes with the cases."""
    return (SCENES / f"{name}.toml").read_text(encoding="utf-8")
