"""Benchmark `coupling`: its scenes are valid, errors as defined, front and picture; its runs are not made here."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.coupling_picture import draw
from benchmarks.coupling_runs import STUDIES, Course, _with_front, break_error, stretch_error
from coordinator.applied_load import FACTOR
from coordinator.compare import Track
from coordinator.full_atomistic import whole_body
from coordinator.scene import read_scene
from protocol.verification import BenchmarkRow


def course(rise: float, breaks_at: float = 2.0) -> Course:
    """Ten rows whose load rises to 1; a bond of length 1 stretches by `rise` times the load."""
    load = np.linspace(0.1, 1.0, 10)
    nothing = np.zeros(10)
    track = Track(FACTOR, load, load, load**2, nothing, nothing, (load >= breaks_at).astype(float))
    return Course(track, 1.0 + rise * load, 1.0)


@pytest.mark.parametrize("study", STUDIES, ids=lambda study: study.problem.name)
def test_every_turn_of_a_knob_is_a_valid_scene_that_has_a_whole_body(study) -> None:  # type: ignore[no-untyped-def]
    for knob, values in {"m": (study.problem.m,), **study.knobs, "preset": (True,)}.items():
        for value in values:
            scene = read_scene(study.problem.text(**{knob: value}), "knob", file=f"{knob} {value}")
            assert whole_body(scene).size[0] > 2e-10 * study.problem.half
            assert scene.run.steps * scene.time_step == pytest.approx(1e-12 * study.problem.time, rel=0.03)


def test_error_of_the_stretch_is_relative_and_that_of_the_load_is_at_the_first_broken_bond() -> None:
    assert stretch_error(course(0.11), course(0.10)) == pytest.approx(0.1)
    assert stretch_error(course(0.1), course(0.1)) == pytest.approx(0.0, abs=1e-12)
    assert break_error(course(0.1, 0.6), course(0.1, 0.8)) == pytest.approx(0.25)
    assert break_error(course(0.1), course(0.1, 0.8)) is None


def test_front_is_what_none_beats_in_both_and_the_picture_is_drawn(tmp_path: Path) -> None:
    study = STUDIES[0]

    def row(name: str, seconds: float, error: float | None, **turned: float) -> BenchmarkRow:
        knobs = {
            "m": 10,
            "width": 24,
            "size": 80,
            "weight": "theory",
            "stiffness": "theory",
            "preset": "none",
            **turned,
        }
        return BenchmarkRow(f"lattice: {name}", knobs, seconds, error, {}, peer=name == "full atomistic")

    rows = [
        row("full atomistic", 9.0, None), row("middle", 2.0, 0.01), row("m 5", 4.0, 0.02, m=5),
        row("m 40", 1.0, 0.03, m=40), row("weight 0.2, refused as unstable", 0.0, None),
    ]  # fmt: skip
    marked = [_with_front(one, rows) for one in rows]
    assert [one.figures.get("front") for one in marked] == [None, 1.0, 0.0, 1.0, None]
    draw(study, marked, tmp_path / "p.png")
    assert (tmp_path / "p.png").read_bytes().startswith(b"\x89PNG")
