"""Checkpoints of a run on disk: one file, replaced whole, so that a kill leaves the old or the new one."""

from __future__ import annotations

import json
import os
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

NAME = "checkpoint.npz"
_HEADER = "header"


class CheckpointError(Exception):
    """There is no checkpoint to go on from, or it cannot be read."""


def write_checkpoint(folder: Path, header: dict[str, Any], state: dict[str, np.ndarray]) -> None:
    """Replace the checkpoint of a run.

    Parameters
    ----------
    folder : Path
        Folder of the run.
    header : dict
        Plain values, kept as JSON.
    state : dict of str to array
        Named arrays.
    """
    new = folder / (NAME + ".new")
    packed = np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)
    arrays: dict[str, Any] = {_HEADER: packed, **state}
    with new.open("wb") as file:
        np.savez(file, allow_pickle=False, **arrays)
        file.flush()
        os.fsync(file.fileno())
    os.replace(new, folder / NAME)


def read_checkpoint(folder: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Return header and arrays of the checkpoint of a run.

    Raises
    ------
    CheckpointError
        Where there is none, or the file is damaged.
    """
    path = folder / NAME
    try:
        with np.load(path, allow_pickle=False) as file:
            state = {name: file[name] for name in file.files}
        header: dict[str, Any] = json.loads(state.pop(_HEADER).tobytes())
    except FileNotFoundError:
        raise CheckpointError(f"{folder} holds no checkpoint to go on from") from None
    except (OSError, EOFError, KeyError, ValueError, zipfile.BadZipFile) as error:
        raise CheckpointError(f"{path} cannot be read: {error}") from None
    return header, state
