"""Cost of the engine's windows against the same LAMMPS input run without a break."""

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import numpy as np

from md_service import anchors as anchor_points
from md_service.engine import LammpsEngine
from md_service.graphene import sheet


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
        bare = _prepared(Path(folder) / "bare", force_field, size, margin)
        anchors = engine.anchors
        assert anchors is not None
        position, velocity = anchors.position.copy(), anchors.velocity.copy()
        engine.measure_reference(8, window)
        commands = bare._atoms.session.commands
        commands([anchor_points.averaging_command(window), f"run {8 * window} post no"])
        seconds: dict[str, list[float]] = {"engine": [], "bare": []}
        for _ in range(rounds):
            start = time.perf_counter()
            for _ in range(steps // window):
                engine.advance(window, position, velocity)
            seconds["engine"].append((time.perf_counter() - start) / steps)
            start = time.perf_counter()
            commands([f"run {steps} pre no post no"])
            seconds["bare"].append((time.perf_counter() - start) / steps)
        engine.close()
        bare.close()
    return Overhead(median(seconds["engine"]), median(seconds["bare"]))


def _prepared(work_dir: Path, force_field: str, size: float, margin: float) -> LammpsEngine:
    from md_service.force_fields import force_field as profile_of

    position = sheet(size, size, profile_of(force_field).lattice_constant).position
    engine = LammpsEngine(work_dir, force_field, position, temperature=300.0, seed=1)
    inside = np.abs(position[:, :2]) < np.abs(position[:, :2]).max(axis=0) - margin
    frame = np.flatnonzero(~inside.all(axis=1))
    engine.register_anchors(frame, position[frame], np.full(len(frame), 32.0), np.zeros(len(frame), dtype=int), 5e-13)
    engine.equilibrate(100)
    return engine
