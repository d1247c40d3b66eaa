"""The results file: what was written is read, formats follow their specifications, a kill leaves it whole."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest
from fake_run import SMALL_CRACK, write_fake_run

from coordinator import results as results_module
from coordinator.results import Results, ResultsError, ResultsWriter
from coordinator.scene import read_resolved
from coordinator.series import series_of

HEADER = {
    "scene": {"name": "s", "title": "S", "text": "x", "overrides": ["a=1"], "resolved": {"a": 1}},
    "versions": {"scalebridge": "0.1.0"},
    "seeds": {"run": 3},
    "command": "scalebridge run s.toml",
}
HERE = Path(__file__).parent
RNG = np.random.default_rng(3)
ATOMS = RNG.normal(scale=1e-9, size=(5, 3))
POINTS = np.column_stack([RNG.normal(scale=1e-8, size=(7, 2)), np.zeros(7)])


def _writer(folder: Path) -> ResultsWriter:
    writer = ResultsWriter(folder / "results.h5", HEADER)
    writer.atoms(np.arange(10, 15), np.full(5, 6), np.full(5, 1.9944e-26), ATOMS)
    cells = np.zeros((2, 3)), np.ones((2, 3))
    writer.interface(*cells, ATOMS[:3], [0, 1, 1], [[-1, -1], [1, 1]], [[-2, -2], [2, 2]])
    return writer


def _add(writer: ResultsWriter, step: int) -> None:
    t = step * 1e-15
    writer.row(step, {"time": t, "temperature": 300.0 + step, **({"late": 1.0} if step >= 2 else {})})
    writer.ivc_row(step, np.full((2, 3), step * 1e-9), np.full((2, 3), 1e-10))
    writer.atoms_frame(step, t, ATOMS * (1 + step))
    shift = POINTS * 0.01 * step
    writer.points_frame(
        step, t, POINTS + shift, shift, shift / 1e-12, np.full((7, 3), step * 1e9), np.linspace(0.2, 1, 7)
    )


def _snapshot(path: Path) -> dict[str, np.ndarray]:
    found: dict[str, np.ndarray] = {}
    with h5py.File(path) as file:
        file.visititems(lambda name, item: found.update({name: item[()]}) if isinstance(item, h5py.Dataset) else None)
    return found


def test_what_was_written_is_read(tmp_path: Path) -> None:
    writer = _writer(tmp_path)
    for step in range(4):
        _add(writer, step)
        if step in (0, 2):
            writer.flush()
    writer.close("finished")
    with Results(tmp_path / "results.h5") as results:
        assert (results.status, results.command) == ("finished", HEADER["command"])
        assert results.scene == HEADER["scene"]
        assert (results.versions, results.seeds) == (HEADER["versions"], HEADER["seeds"])
        assert results.step.tolist() == [0, 1, 2, 3]
        assert results.series["temperature"].tolist() == [300.0, 301.0, 302.0, 303.0]
        assert np.isnan(results.series["late"][:2]).all() and (results.series["late"][2:] == 1).all()
        assert (results.units["temperature"], results.units["time"], results.units["late"]) == ("K", "s", "")
        np.testing.assert_allclose(results.interface["force"][:, 0, 0], np.arange(4) * 1e-9, rtol=1e-6)
        assert results.interface["anchor_ivc"].tolist() == [0, 1, 1]
        assert results.atoms is not None and results.points is not None
        assert results.atoms.atom_id.tolist() == [10, 11, 12, 13, 14]
        np.testing.assert_allclose(results.atoms.position(3), 4 * ATOMS, rtol=1e-14)
        np.testing.assert_allclose(results.atoms.reference, ATOMS, rtol=1e-14)
        frame = results.points.frame(2)
        np.testing.assert_allclose(frame.position, 1.02 * POINTS, rtol=1e-6)
        np.testing.assert_allclose(frame.displacement, 0.02 * POINTS, rtol=1e-6)
        np.testing.assert_allclose(frame.velocity, 0.02 * POINTS / 1e-12, rtol=1e-6)
        np.testing.assert_allclose(frame.stress, 2e9, rtol=1e-6)
        np.testing.assert_allclose(frame.weight, np.linspace(0.2, 1, 7), rtol=1e-6)
        np.testing.assert_allclose(results.points.time, np.arange(4) * 1e-15, rtol=1e-12)
        with pytest.raises(IndexError):
            results.points.frame(4)


def test_atoms_follow_h5md(tmp_path: Path) -> None:
    writer = _writer(tmp_path)
    for step in (0, 5):
        _add(writer, step)
    writer.close("finished")
    with h5py.File(tmp_path / "results.h5") as file:
        root = file["h5md"]
        assert root.attrs["version"].tolist() == [1, 1]
        for group, names in (("author", ["name"]), ("creator", ["name", "version"])):
            for name in names:
                kind = h5py.check_string_dtype(root[group].attrs.get_id(name).dtype)
                assert kind.length is not None, "H5MD 1.1 asks for strings of fixed length here"
        assert root["modules/units"].attrs["version"].tolist() == [1, 0]
        assert root["modules/units"].attrs["system"] == "SI"
        atoms = file["particles/atoms"]
        assert atoms["box"].attrs["dimension"] == 3
        assert [side.decode() for side in atoms["box"].attrs["boundary"]] == ["none"] * 3
        position = atoms["position"]
        assert position["step"][:].tolist() == [0, 5]
        assert position["step"].dtype.kind == "i"
        assert position["value"].shape == (2, 5, 3)
        assert (position["value"].attrs["unit"], position["time"].attrs["unit"]) == ("nm", "ps")
        np.testing.assert_allclose(position["value"][0], ATOMS / 1e-9, rtol=1e-14)
        np.testing.assert_allclose(position["time"][:], [0.0, 0.005], rtol=1e-12)
        # box edges share the step and time of the positions as hard links
        edges = atoms["box/edges"]
        assert edges["step"] == position["step"] and edges["time"] == position["time"]
        assert edges["value"].shape == (2, 3) and (edges["value"][:] > 0).all()
        assert h5py.check_enum_dtype(atoms["species"].dtype) == {"C": 6}
        assert atoms["id"].shape == atoms["species"].shape == atoms["mass"].shape == (5,)
        np.testing.assert_allclose(atoms["mass"][:], 12.011, rtol=1e-4)


def test_points_follow_vtkhdf(tmp_path: Path) -> None:
    writer = _writer(tmp_path)
    for step in range(3):
        _add(writer, step)
        writer.flush()
    with h5py.File(tmp_path / "results.h5") as file:
        root = file["VTKHDF"]
        assert root.attrs["Version"].tolist() == [2, 0]
        assert root.attrs["Type"] == b"PolyData"
        kind = h5py.check_string_dtype(root.attrs.get_id("Type").dtype)
        assert (kind.encoding, kind.length) == ("ascii", 8)
        assert root["NumberOfPoints"][:].tolist() == [7]
        assert root["Points"].shape == (21, 3)
        for name in ("Vertices", "Lines", "Polygons", "Strips"):
            count = 7 if name == "Vertices" else 0
            assert root[name]["NumberOfCells"][:].tolist() == [count]
            assert root[name]["NumberOfConnectivityIds"][:].tolist() == [count]
            assert root[name]["Offsets"][:].tolist() == list(range(count + 1))
            assert root[name]["Connectivity"][:].tolist() == list(range(count))
        steps = root["Steps"]
        assert steps.attrs["NSteps"] == 3
        np.testing.assert_allclose(steps["Values"][:], [0.0, 1e-3, 2e-3], rtol=1e-12)
        assert steps["PointOffsets"][:].tolist() == [0, 7, 14]
        assert steps["NumberOfParts"][:].tolist() == [1, 1, 1]
        assert steps["PartOffsets"][:].tolist() == [0, 0, 0]
        assert steps["CellOffsets"].shape == steps["ConnectivityIdOffsets"].shape == (3, 4)
        assert not steps["CellOffsets"][:].any() and not steps["ConnectivityIdOffsets"][:].any()
        offsets = {name: array[:].tolist() for name, array in steps["PointDataOffsets"].items()}
        assert offsets.pop("Weight") == [0, 0, 0]
        assert set(offsets) == {"Displacement", "Velocity", "Stress", "VonMises"}
        assert all(value == [0, 7, 14] for value in offsets.values())
        # xx = yy = xy = s gives sqrt(s^2 - s^2 + s^2 + 3 s^2) = 2 s
        np.testing.assert_allclose(root["PointData/VonMises"][14:], 4.0, rtol=1e-6)


def test_resume_gives_the_file_of_a_run_that_was_not_broken(tmp_path: Path) -> None:
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    for folder in (whole, broken):
        folder.mkdir()
    writer = _writer(whole)
    for step in range(6):
        _add(writer, step)
    writer.close("finished")
    writer = _writer(broken)
    for step in range(5):
        _add(writer, step)
    writer.flush()
    writer = ResultsWriter.resume(broken / "results.h5", 2)
    with pytest.raises(ResultsError, match="step 2 must be greater than the last one, 2"):
        _add(writer, 2)
    for step in range(3, 6):
        _add(writer, step)
    writer.close("finished")
    one, other = _snapshot(whole / "results.h5"), _snapshot(broken / "results.h5")
    assert one.keys() == other.keys()
    for name, value in one.items():
        np.testing.assert_array_equal(value, other[name], err_msg=name)


def test_resume_before_the_first_frame(tmp_path: Path) -> None:
    writer = _writer(tmp_path)
    _add(writer, 3)
    writer.flush()
    writer = ResultsWriter.resume(tmp_path / "results.h5", 0)
    with Results(tmp_path / "results.h5") as results:
        assert len(results.step) == 0 and results.points is None
        assert results.status == "running"
    _add(writer, 1)
    writer.flush()
    with Results(tmp_path / "results.h5") as results:
        assert results.points is not None and results.points.step.tolist() == [1]


def test_a_flush_that_is_interrupted_loses_and_doubles_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    writer = _writer(tmp_path)
    _add(writer, 0)
    writer.flush()
    before = (tmp_path / "results.h5").read_bytes()
    _add(writer, 1)

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(results_module.os, "replace", interrupted)
        with pytest.raises(KeyboardInterrupt):
            writer.flush()
    assert (tmp_path / "results.h5").read_bytes() == before
    writer.flush()
    with Results(tmp_path / "results.h5") as results:
        assert results.step.tolist() == [0, 1]
        assert results.points is not None and results.points.step.tolist() == [0, 1]


KILLED = """
import sys
from pathlib import Path
from test_results import _add, _writer
writer = _writer(Path(sys.argv[1]))
step = 0
while True:
    _add(writer, step)
    writer.flush()
    step += 1
    print(step, flush=True)
"""


def test_a_killed_run_leaves_a_readable_file(tmp_path: Path) -> None:
    for delay in (0.013, 0.047):
        folder = tmp_path / str(delay)
        folder.mkdir()
        child = subprocess.Popen(
            [sys.executable, "-c", KILLED, str(folder)],
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": os.pathsep.join((str(HERE), str(HERE.parents[1])))},
        )
        assert child.stdout is not None
        assert child.stdout.readline() == "1\n"
        time.sleep(delay)
        os.kill(child.pid, signal.SIGKILL)
        reported = [1, *map(int, child.stdout.read().split())]
        child.wait()
        with Results(folder / "results.h5") as results:
            rows = len(results.step)
            assert rows in (reported[-1], reported[-1] + 1)
            assert results.step.tolist() == list(range(rows))
            assert results.atoms is not None and len(results.atoms) == rows
            assert results.points is not None and len(results.points) == rows
            assert len(results.interface["force"]) == rows


def test_bad_calls_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ResultsError, match=r"header lacks seeds, scene\.text"):
        scene = {key: value for key, value in HEADER["scene"].items() if key != "text"}  # type: ignore[attr-defined]
        ResultsWriter(tmp_path / "r.h5", {"scene": scene, "versions": {}, "command": ""})
    writer = _writer(tmp_path)
    with pytest.raises(ResultsError, match="row of step 1 has no time"):
        writer.row(1, {"temperature": 1.0})
    _add(writer, 2)
    with pytest.raises(ResultsError, match="atoms_frame: step 2 must be greater than the last one, 2"):
        writer.atoms_frame(2, 0.0, ATOMS)
    with pytest.raises(ResultsError, match="there are no results to go on with"):
        ResultsWriter.resume(tmp_path / "none.h5", 1)
    (tmp_path / "text.h5").write_text("no")
    with pytest.raises(ResultsError, match=r"text\.h5: cannot be read as results"):
        Results(tmp_path / "text.h5")
    h5py.File(tmp_path / "other.h5", "w").close()
    with pytest.raises(ResultsError, match="no results of scalebridge"):
        Results(tmp_path / "other.h5")


def test_the_scene_can_be_read_back_from_results(tmp_path: Path) -> None:
    write_fake_run(tmp_path, overrides=SMALL_CRACK, steps=4, frames=2)
    with Results(tmp_path / "results.h5") as results:
        scene = read_resolved(results.scene["resolved"], results.scene["name"])
    assert scene.model_dump(mode="json") == results.scene["resolved"]
    assert scene.continuum.lower == pytest.approx((-102.5e-10, -92.5e-10))


def _grown(writer: ResultsWriter, step: int, count: int) -> np.ndarray:
    """Add a frame of `count` points; the first ones are those of every frame."""
    place = np.column_stack([np.arange(count), np.full(count, step), np.zeros(count)]) * 1e-9
    writer.row(step, {"time": step * 1e-15})
    writer.points_frame(
        step,
        step * 1e-15,
        place,
        place * 0.1,
        place * 1e12,
        np.full((count, 3), step * 1e9),
        np.arange(1, count + 1) / 10,
    )
    return place


COUNTS = (4, 4, 6, 6, 9)


def test_points_that_are_split_are_written_and_read(tmp_path: Path) -> None:
    writer = ResultsWriter(tmp_path / "results.h5", HEADER)
    places = []
    for step, count in enumerate(COUNTS):
        places.append(_grown(writer, step, count))
        writer.flush()
    with Results(tmp_path / "results.h5") as results:
        assert results.points is not None
        for step, place in enumerate(places):
            frame = results.points.frame(step)
            np.testing.assert_allclose(frame.position, place, rtol=1e-6)
            np.testing.assert_allclose(frame.velocity, place * 1e12, rtol=1e-6)
            np.testing.assert_allclose(frame.weight, np.arange(1, len(place) + 1) / 10, rtol=1e-6)
    with h5py.File(tmp_path / "results.h5") as file:
        # As VTK 9.7 was seen to read it: one part for each number of points, `Offsets` one longer than its cells.
        root, steps = file["VTKHDF"], file["VTKHDF/Steps"]
        assert root["NumberOfPoints"][:].tolist() == [4, 6, 9]
        assert steps["PartOffsets"][:].tolist() == [0, 0, 1, 1, 2]
        assert steps["PointOffsets"][:].tolist() == [0, 4, 8, 14, 20]
        assert steps["CellOffsets"][:, 0].tolist() == [0, 0, 4, 4, 10]
        assert steps["ConnectivityIdOffsets"][:, 0].tolist() == [0, 0, 4, 4, 10]
        assert steps["PointDataOffsets/Weight"][:].tolist() == [0, 0, 4, 4, 10]
        vertices = root["Vertices"]
        assert vertices["Offsets"][:].tolist() == [*range(5), *range(7), *range(10)]
        assert vertices["Connectivity"][:].tolist() == [*range(4), *range(6), *range(9)]
        assert root["Lines/NumberOfCells"][:].tolist() == [0, 0, 0]
    writer = ResultsWriter(tmp_path / "fewer.h5", HEADER)
    _grown(writer, 0, 4)
    _grown(writer, 1, 3)
    with pytest.raises(ValueError, match="step 1 has 3 points, the frame before has 4"):
        writer.flush()


@pytest.mark.parametrize("back_to", [0, 1, 2, 3, 4])
def test_resume_after_points_were_split(tmp_path: Path, back_to: int) -> None:
    whole, broken = tmp_path / "whole.h5", tmp_path / "broken.h5"
    for path in (whole, broken):
        writer = ResultsWriter(path, HEADER)
        for step, count in enumerate(COUNTS):
            _grown(writer, step, count)
            writer.event(step, {"kind": "points_lost", "step": step, "count": count})
        writer.close("finished")
    writer = ResultsWriter.resume(broken, back_to)
    for step in range(back_to + 1, len(COUNTS)):
        _grown(writer, step, COUNTS[step])
        writer.event(step, {"kind": "points_lost", "step": step, "count": COUNTS[step]})
    writer.close("finished")
    one, other = _snapshot(whole), _snapshot(broken)
    assert one.keys() == other.keys()
    for name, value in one.items():
        np.testing.assert_array_equal(value, other[name], err_msg=name)
    with Results(broken) as results:
        assert [event["count"] for event in results.events] == list(COUNTS)


@pytest.mark.parametrize(
    ("extent", "length", "time"),
    [(2e-8, "Angstrom", "ps"), (4e-6, "Angstrom", "ps"), (3e-5, "um", "ns"), (5e-2, "mm", "us"), (40.0, "m", "s")],
)
def test_units_of_the_points_fit_the_body(tmp_path: Path, extent: float, length: str, time: str) -> None:
    writer = ResultsWriter(tmp_path / "results.h5", HEADER)
    place = np.array([[0.0, 0.0, 0.0], [extent, 0.0, 0.0]])
    writer.points_frame(0, 1e-6, place, place, place, np.zeros((2, 3)), np.ones(2))
    writer.close("finished")
    with h5py.File(tmp_path / "results.h5") as file:
        root = file["VTKHDF"]
        assert root["Points"].attrs["unit"] == root["PointData/Displacement"].attrs["unit"] == length
        assert root["PointData/Velocity"].attrs["unit"] == f"{length}/{time}"
        assert root["Steps/Values"].attrs["unit"] == time
    with Results(tmp_path / "results.h5") as results:
        assert results.points is not None
        frame = results.points.frame(0)
        np.testing.assert_allclose(frame.position, place, rtol=1e-6)
        np.testing.assert_allclose(frame.velocity, place, rtol=1e-6)
        assert frame.time == pytest.approx(1e-6, rel=1e-12)


def test_series_of_a_crack_tip_have_unit_and_meaning() -> None:
    known = series_of("tip_1_0_j")
    assert known.unit == "J/m^2"
    assert known.description == "dynamic J-integral, crack 1, first end"
    assert series_of("tip_0_1_x").unit == "m"
    assert series_of("tip_0_2_x").unit == ""
