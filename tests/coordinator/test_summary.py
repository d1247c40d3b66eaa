"""summary.json: strict JSON, and measures against hand calculation."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from fake_run import PEAK_STRAIN, SMALL_CRACK, write_fake_run
from pydantic import ValidationError

from coordinator.results import Results
from coordinator.summary import Summary, energy_passed, measures_of


def _summary(**changes: object) -> Summary:
    values: dict[str, object] = {
        "scene": "s", "title": "S", "status": "finished", "reason": "", "steps": 1, "steps_asked": 2,
        "wall_seconds": 1.0, "services": {"continuum": {"computing": 1.0, "sending": 0.1, "waiting": 0.2}},
        "measures": {"a": 1.5, "b": math.nan, "c": None}, "units": {"a": "N", "b": "1", "c": "1"}, "warnings": [],
        "versions": {}, "seeds": {"run": 1}, "command": "x",
    }  # fmt: skip
    return Summary.model_validate(values | changes)


def test_what_is_not_finite_becomes_null(tmp_path: Path) -> None:
    path = _summary().write(tmp_path)

    def no_constants(name: str) -> None:
        raise AssertionError(f"{name} is no JSON")

    values = json.loads(path.read_text(), parse_constant=no_constants)
    assert values["measures"] == {"a": 1.5, "b": None, "c": None}
    again = Summary.read(tmp_path)
    assert again is not None and again.services["continuum"].computing == 1.0
    assert [p.name for p in tmp_path.iterdir()] == ["summary.json"]


def test_no_summary_or_a_broken_one_reads_as_none(tmp_path: Path) -> None:
    assert Summary.read(tmp_path) is None
    (tmp_path / "summary.json").write_text('{"scene": "s"')
    assert Summary.read(tmp_path) is None


@pytest.mark.parametrize("changes", [{"status": "fine"}, {"wall_seconds": math.nan}, {"steps": -1}])
def test_what_a_summary_refuses(changes: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        _summary(**changes)


def test_measures_of_a_run(tmp_path: Path) -> None:
    write_fake_run(tmp_path, overrides=SMALL_CRACK, steps=40, frames=2)
    with Results(tmp_path / "results.h5") as results:
        measures, units = measures_of(results)
        series = results.series
    assert measures["applied_strain_end"] == pytest.approx(PEAK_STRAIN)
    assert measures["crack_growth"] == pytest.approx(series["crack_tip"][-1])
    assert measures["temperature_mean"] == pytest.approx(series["temperature"].mean())
    assert measures["ivc_error_to_force"] == pytest.approx(1e-10 / series["ivc_force_rms"].mean())
    work = series["continuum_edge_work"]
    assert energy_passed(series) == pytest.approx(work[-1] - work[0])  # the largest of the fake energies
    assert measures["books_interface_relative"] == pytest.approx(0.01)
    assert measures.keys() == units.keys()


def test_energy_passed_is_the_largest_change_of_what_is_held_or_passed_on() -> None:
    series = {
        "continuum_kinetic": np.array([4.0, 2.0]), "continuum_strain": np.array([0.0, 3.0]),
        "continuum_edge_work": np.array([7.0, 5.0]), "continuum_interface_work": np.array([0.0, -3.5]),
    }  # fmt: skip
    assert energy_passed(series) == 3.5
    assert energy_passed({}) == 0.0
