"""Cost of the engine's windows against the same LAMMPS input run without a break."""

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import numpy as np
from numpy.typing import NDArray

from md_service import anchors as anchor_points
from md_service.engine import LammpsEngine
from md_service.force_fields import CARBON_MASS
from md_service.force_fields import force_field as profile_of
from md_service.graphene import sheet

TEMPERATURE = 300.0  # K
STIFFNESS = 100.0  # N/m
DAMPING_TIME = 2e-13  # s


@dataclass(frozen=True)
class Overhead:
    """Seconds per MD step, medians of interleaved runs.

    Attributes
    ----------
    engine : float
        `LammpsEngine.advance` in windows of M steps, everything included, s.
    bare : float
        The same atoms and fixes in one continuous LAMMPS run, s.
    """

    engine: float
    bare: float

    @property
    def ratio(self) -> float:
        """Engine over bare."""
        return self.engine / self.bare


def measure_overhead(
    window: int,
    steps: int,
    *,
    force_field: str = "airebo",
    size: float = 103e-10,
    margin: float = 15e-10,
    rounds: int = 5,
) -> Overhead:
    """Time windows of M steps against one continuous run with the same fixes.

    Parameters
    ----------
    window : int
        Steps M of a window.
    steps : int
        Steps of each timed run, a multiple of M.
    force_field : str
        Profile name.
    size : float
        Edge of the sheet, m.
    margin : float
        Width of the anchored frame, m.
    rounds : int
        Timed runs of each kind.

    Returns
    -------
    Overhead

    Raises
    ------
    ValueError
        If `steps` is not a multiple of `window`.
    """
    if steps % window:
        raise ValueError(f"steps is {steps}; a multiple of window, {window}, is needed")
    with tempfile.TemporaryDirectory() as folder:
        engine = _prepared(Path(folder) / "engine", force_field, size, margin)
        bare = BareRun(Path(folder) / "bare", window, force_field=force_field, size=size, margin=margin)
        anchors = engine.anchors
        assert anchors is not None
        position, velocity = anchors.position.copy(), anchors.velocity.copy()
        engine.measure_reference(8, window)
        seconds: list[float] = []
        bare_seconds: list[float] = []
        for _ in range(rounds):
            start = time.perf_counter()
            for _ in range(steps // window):
                engine.advance(window, position, velocity)
            seconds.append((time.perf_counter() - start) / steps)
            bare_seconds.append(bare.seconds_per_step(steps))
        engine.close()
        bare.close()
    return Overhead(median(seconds), median(bare_seconds))


class BareRun:
    """The LAMMPS input of the engine, run without a break: what the engine and the service are held against.

    Parameters
    ----------
    work_dir : Path
        Folder of the LAMMPS log.
    window : int
        Steps M of the averaging fix.
    force_field : str
        Profile name.
    size, margin : float
        Edge of the sheet and width of the anchored frame, m.
    """

    def __init__(self, work_dir: Path, window: int, *, force_field: str, size: float, margin: float) -> None:
        self._engine = _prepared(work_dir, force_field, size, margin)
        self._commands = self._engine._atoms.session.commands
        self._commands([anchor_points.averaging_command(window), f"run {8 * window} post no"])

    def seconds_per_step(self, steps: int) -> float:
        """Run on and return the wall time of a step, s."""
        start = time.perf_counter()
        self._commands([f"run {steps} pre no post no"])
        return (time.perf_counter() - start) / steps

    def close(self) -> None:
        """Let go of LAMMPS."""
        self._engine.close()


def framed_sheet(force_field: str, size: float, margin: float) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return positions, (n, 3) in m, of a square sheet and the rows of the atoms in its frame."""
    position = sheet(size, size, profile_of(force_field).lattice_constant).position
    inside = np.abs(position[:, :2]) < np.abs(position[:, :2]).max(axis=0) - margin
    return position, np.flatnonzero(~inside.all(axis=1))


def _prepared(work_dir: Path, force_field: str, size: float, margin: float) -> LammpsEngine:
    position, frame = framed_sheet(force_field, size, margin)
    engine = LammpsEngine(work_dir, force_field, position, temperature=TEMPERATURE, seed=1)
    cells = np.zeros(len(frame), dtype=int)
    engine.register_anchors(frame, position[frame], np.full(len(frame), STIFFNESS), cells, CARBON_MASS / DAMPING_TIME)
    engine.equilibrate(100)
    return engine
