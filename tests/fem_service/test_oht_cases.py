"""The cases of the open-hole cross-ply at a small size: what they answer, write and draw."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fem_service.verification import oht_mesh, oht_speed


def test_mesh_case_on_small_meshes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    meshes = ((4, 2), (6, 3), (8, 4))
    monkeypatch.setattr(oht_mesh, "MESHES", meshes)
    monkeypatch.setattr(oht_mesh, "PULLS", {oht_mesh.CRACK_BAND: (0.02, 2e-3), oht_mesh.ELIMINATION: (0.018, 1e-3)})
    spread, ended = oht_mesh._mesh(tmp_path)
    rows = [line.split() for line in (tmp_path / "oht-mesh.txt").read_text().splitlines()[1:]]
    assert [row[0] for row in rows] == [oht_mesh.CRACK_BAND] * 3 + [oht_mesh.ELIMINATION] * 3
    assert [int(row[1]) for row in rows] == [32, 72, 128] * 2
    peaks = np.array([float(row[3]) for row in rows]).reshape(2, 3)
    assert spread.value == pytest.approx(np.ptp(peaks[0]) / peaks[0].mean(), abs=5e-5)  # as printed
    # Cracks take energy: the plate holds more than where the first elements that fail are the end of it, on any mesh.
    assert (peaks[0] > 1.2 * peaks[1]).all()
    assert np.ptp(peaks[1]) > 4.0 * np.ptp(peaks[0])
    assert ended.passed
    assert (tmp_path / "oht-mesh.png").stat().st_size > 10_000


def test_speed_case_at_a_small_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(oht_speed, "MESH", (4, 2))
    monkeypatch.setattr(oht_speed, "INCREMENTS", 4)
    monkeypatch.setattr(oht_speed, "MESHES", ((4, 2), (6, 3)))
    monkeypatch.setattr(oht_speed, "SIZES", (4e-3, 2e-3))
    seconds, made = oht_speed._speed(tmp_path)
    assert made.passed and made.value == 4
    assert 0.0 < seconds.value < oht_speed.WANTED
    lines = (tmp_path / "oht-speed.txt").read_text().splitlines()
    shares = [float(line.split()[1]) for line in lines[1:6]]
    assert sum(shares) == pytest.approx(seconds.value, abs=0.2 * seconds.value + 0.3)  # the rest configures the plate
    assert len(lines) == 7 + 4
    assert (tmp_path / "oht-speed.png").stat().st_size > 10_000
