"""Error of the coupled runs against the whole body of atoms, and their seconds, over the knobs of the handshake."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.spatial import cKDTree

from benchmarks.coupling_scenes import GRAPHENE, LATTICE, Problem
from coordinator.compare import Track, track
from coordinator.full_atomistic import FullAtomisticRun, isotropic_of, whole_body
from coordinator.results import Results
from coordinator.scene import Scene, load_scene
from coordinator.verification_cases.runs import run_text
from protocol.verification import BenchmarkRow

#: What a run that the coordinator refuses says.
_REFUSED: Final = "unstable"
MIDDLE, SEED = "middle", "preset seed"


@dataclass(frozen=True)
class Study:
    """A problem, its knobs and its error.

    Attributes
    ----------
    problem : Problem
    measure : str
        What the error is, for the axis of a picture.
    knobs : dict of str to tuple
        Values of each knob beside the middle one.
    error : callable
        Of the courses of a coupled run and of the full atomistic one, with their longest bonds, m.
    """

    problem: Problem
    measure: str
    knobs: dict[str, tuple[float, ...]]
    error: Callable[[Course, Course], float | None]


@dataclass(frozen=True)
class Course:
    """A run over time.

    Attributes
    ----------
    track : Track
    longest : float64 array, shape (rows,)
        Longest bond, m.
    spacing : float
        Length of a bond without load, m.
    """

    track: Track
    longest: np.ndarray
    spacing: float


def stretch_error(coupled: Course, whole: Course) -> float | None:
    """Root mean square over the run of the difference in stretch of the longest bond, at the tip, relative to it."""
    time = coupled.track.time
    wanted = np.interp(time, whole.track.time, whole.longest) / whole.spacing - 1.0
    found = coupled.longest / coupled.spacing - 1.0
    return float(np.sqrt(np.mean((found / wanted - 1.0) ** 2)))


def break_error(coupled: Course, whole: Course) -> float | None:
    """Relative difference of the load at the first broken bond; None where none broke."""
    rows = coupled.track.first_break(), whole.track.first_break()
    if rows[0] is None or rows[1] is None:
        return None
    return abs(float(coupled.track.load[rows[0]] / whole.track.load[rows[1]]) - 1.0)


STUDIES: Final = (
    Study(
        LATTICE,
        "error of the stretch at the crack tip, rms over the run",
        {
            "m": (2, 5, 40),
            "width": (8, 16),
            "weight": (0.2, 1.0),
            "stiffness": (2.0, 50.0),
            "size": (64, 112, 160),
        },
        stretch_error,
    ),
    Study(
        GRAPHENE,
        "error of the load at the first broken bond",
        {"m": (5, 40), "width": (5, 10), "weight": (0.5, 1.0), "stiffness": (5.0, 50.0), "size": (53, 93)},
        break_error,
    ),
)


def study_rows(study: Study, folder: Path) -> list[BenchmarkRow]:
    """Rows of a study: the middle, each knob turned alone, the seed's preset, and the full atomistic run as a peer.

    `seconds` is the wall time of the loop for 1 ps, without start and preparation; 0 where the coordinator refuses the
    knobs as unstable. The figures are the number of atoms, the factor of the field at the first broken bond where
    one broke, and whether a row is on the front: none is both faster and better.
    """
    whole, rows = _whole(study, folder / "all_atom")
    rows.append(_coupled(study, folder, MIDDLE, {}, whole))
    for knob, values in study.knobs.items():
        for value in values:
            turned = {knob: int(value) if knob == "m" else value}
            rows.append(_coupled(study, folder, f"{knob} {value:g}", turned, whole))
    rows.append(_coupled(study, folder, SEED, {"preset": True}, whole))
    return [_with_front(row, rows) for row in rows]


def _whole(study: Study, folder: Path) -> tuple[Course, list[BenchmarkRow]]:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "scene.toml"
    path.write_text(study.problem.text(), encoding="utf-8")
    scene = load_scene(path)
    run = FullAtomisticRun(whole_body(scene), folder, None, study.problem.m, lambda _: None)
    run.run("scalebridge bench coupling")
    course, seconds = _course(scene, folder)
    return course, [_row(study, "full atomistic", {}, seconds, None, course, run.atoms, peer=True)]


def _coupled(study: Study, folder: Path, name: str, turned: dict[str, Any], whole: Course) -> BenchmarkRow:
    here = folder / name.replace(" ", "_")
    try:
        results = run_text(study.problem.text(**turned), here)
    except RuntimeError as error:
        if _REFUSED not in str(error):
            raise
        return BenchmarkRow(f"{study.problem.name}: {name}, refused as unstable", _knobs(study, turned), 0.0, None, {})
    with results:
        atoms = len(results.atoms.atom_id) if results.atoms is not None else 0
    course, seconds = _course(load_scene(here / "scene.toml"), here / "run")
    return _row(study, name, turned, seconds, study.error(course, whole), course, atoms)


def _course(scene: Scene, folder: Path) -> tuple[Course, float]:
    """Return the course of the run in a folder, and the wall time of its loop for 1 ps, s."""
    run = track(scene, isotropic_of(scene, None), folder)
    with Results(folder / "results.h5") as results:
        series, atoms = results.series, results.atoms
        assert atoms is not None
        spacing = float(np.median(cKDTree(atoms.reference).query(atoms.reference, k=2)[0][:, 1]))
    seconds = sum(float(np.sum(series[name])) for name in series if name.startswith("seconds_"))
    return Course(run, series["longest_bond"], spacing), seconds / (float(run.time[-1]) * 1e12)


def _row(
    study: Study,
    name: str,
    turned: dict[str, Any],
    seconds: float,
    error: float | None,
    course: Course,
    atoms: int,
    peer: bool = False,
) -> BenchmarkRow:
    figures = {"atoms": float(atoms)}
    broken = course.track.first_break()
    if broken is not None:
        figures["load_at_first_break"] = float(course.track.load[broken])
    return BenchmarkRow(f"{study.problem.name}: {name}", _knobs(study, turned), seconds, error, figures, peer=peer)


def _knobs(study: Study, turned: dict[str, Any]) -> dict[str, str | int | float]:
    """Return all knobs; weight and stiffness by theory where they are not given."""
    problem = study.problem
    middle: dict[str, str | int | float] = {
        "problem": problem.name, "m": problem.m, "width": problem.width, "size": problem.size,
        "weight": "theory", "stiffness": "theory", "preset": "none",
    }  # fmt: skip
    return {**middle, **{name: "seed" if name == "preset" else value for name, value in turned.items()}}


def _with_front(row: BenchmarkRow, rows: list[BenchmarkRow]) -> BenchmarkRow:
    if row.error is None or row.peer:
        return row
    better = any(other.error is not None and other.error < row.error and other.seconds < row.seconds for other in rows)
    return replace(row, figures={**row.figures, "front": 0.0 if better else 1.0})
