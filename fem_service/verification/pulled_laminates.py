"""Laminates that cases pull: the structure service in this process, the cells behind a socket in a thread of it."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fem_service.service import LaminateService
from protocol import structure as s
from protocol.backend import BackendError, find
from protocol.errors import ProtocolError
from protocol.micromechanics import RegisterCell
from protocol.server import running
from protocol.verification import CannotRun

BACKEND = "gmc_service"
CELLS = Path(__file__).resolve().parents[2] / "scenes" / "cells"


def shipped_cell(name: str) -> RegisterCell:
    """Definition of a cell of ``scenes/cells``.

    Raises
    ------
    CannotRun
        Where the scenes are not beside the package, or nobody reads cell files.
    """
    file = CELLS / f"{name}.toml"
    if not file.exists():
        raise CannotRun(f"{file} is not there: run from a checkout")
    try:
        return find("micromechanics", BACKEND).read_cell(file)
    except BackendError as error:
        raise CannotRun(str(error)) from None


@contextmanager
def cells() -> Iterator[str]:
    """Endpoint of a micromechanics service, for as long as the block lasts.

    Raises
    ------
    CannotRun
        Where the backend is not installed.
    """
    with tempfile.TemporaryDirectory(prefix="scalebridge-") as name:
        try:
            service = find("micromechanics", BACKEND).make(Path(name))
        except BackendError as error:
            raise CannotRun(str(error)) from None
        with running(service, f"ipc://{name}/cells") as server:
            yield server.endpoint


@dataclass
class Pull:
    """What a pulled laminate did.

    Attributes
    ----------
    strain, stress : list of float
        Elongation over length, and force over the whole cross section, Pa, after each increment.
    made : list of StructureAdvanced
        The answers behind them.
    gave_up : str
        Why it ended before its time; empty where it did not.
    """

    strain: list[float] = field(default_factory=list)
    stress: list[float] = field(default_factory=list)
    made: list[s.StructureAdvanced] = field(default_factory=list)
    gave_up: str = ""

    @property
    def peak(self) -> float:
        """Largest stress, Pa."""
        return max(self.stress)

    @property
    def passed_its_peak(self) -> bool:
        """Whether the stress has fallen to 90 % of its largest, so that this is a peak."""
        return self.stress[-1] < 0.9 * self.peak

    def failures(self) -> NDArray[np.int64]:
        """Failed subcells by increment, ply and material."""
        return np.array([made.new_failures for made in self.made])


def pull(
    request: s.StructureConfigure,
    *,
    stop_below: float = 0.5,
    watch: Callable[[s.StructureAdvanced], None] = lambda made: None,
) -> Pull:
    """Pull a laminate to the end of its load, or until the force has fallen below a part of its peak.

    Parameters
    ----------
    request : StructureConfigure
    stop_below : float
    watch : callable
        Called after each increment.
    """
    service = LaminateService()
    found = Pull()
    try:
        section = service.configure(request).section
        while not found.made or found.made[-1].load < 1.0:
            try:
                made = service.advance(s.StructureAdvance())
            except ProtocolError as error:
                if not found.made:
                    raise
                found.gave_up = str(error)
                break
            found.made.append(made)
            found.strain.append(made.strain)
            found.stress.append(made.force / section)
            watch(made)
            if found.stress[-1] < stop_below * found.peak:
                break
    finally:
        service.close()
    return found
