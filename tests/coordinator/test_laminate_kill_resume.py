"""The comparison of the case `structure/kill-resume` sees a single bit; the runs themselves are in tests/system."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from coordinator.laminate_kill_resume import _apart, differing


def results(folder: Path, change: Callable[[h5py.File], None] = lambda file: None) -> Path:
    folder.mkdir()
    with h5py.File(folder / "results.h5", "w") as file:
        file["series/strain"] = np.array([1e-3, 2e-3])
        file["series/stress"] = np.array([1e8, 2e8])
        file["series/seconds_solution"] = np.random.default_rng().random(2)
        file["VTKHDF/CellData/stress"] = np.ones((3, 6))
        file.create_dataset("events", data=["matrix fails"], dtype=h5py.string_dtype())
        change(file)
    return folder


def _bit_of_the_curve(file: h5py.File) -> None:
    file["series/stress"][1] = np.nextafter(2e8, 3e8)


def _bit_of_a_field(file: h5py.File) -> None:
    file["VTKHDF/CellData/stress"][2, 5] = np.nextafter(1.0, 2.0)


def _event(file: h5py.File) -> None:
    file["events"][0] = "fibre fails"


def _missing(file: h5py.File) -> None:
    del file["VTKHDF/CellData/stress"]


def test_equal_runs_differ_in_times_alone(tmp_path: Path) -> None:
    one, other = results(tmp_path / "one"), results(tmp_path / "other")
    assert differing(one, other) == []
    assert _apart(one, other) == 0.0


@pytest.mark.parametrize(
    ("change", "name"),
    [
        (_bit_of_the_curve, "series/stress"),
        (_bit_of_a_field, "VTKHDF/CellData/stress"),
        (_event, "events"),
        (_missing, "VTKHDF/CellData/stress"),
    ],
)
def test_a_bit_is_seen(tmp_path: Path, change: Callable[[h5py.File], None], name: str) -> None:
    one, other = results(tmp_path / "one"), results(tmp_path / "other", change)
    assert differing(one, other) == [name]
    assert (_apart(one, other) > 0.0) == (name == "series/stress")
