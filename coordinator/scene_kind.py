"""Which kind of scene a file or a folder of a run holds."""

from __future__ import annotations

import tomllib
from pathlib import Path


def is_laminate(scene: Path) -> bool:
    """Whether a scene file has a table ``[laminate]``; a file that cannot be read has not, and its reader says why."""
    try:
        return "laminate" in tomllib.loads(scene.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError):
        return False


def holds_laminate(folder: Path) -> bool:
    """Whether the results in the folder of a run are those of a laminate."""
    import h5py

    try:
        with h5py.File(folder / "results.h5") as file:
            return "new_failures" in file
    except OSError:
        return False
