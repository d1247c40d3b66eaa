"""The results file of a laminate: written, read back, cut, and laid out as VTKHDF has it."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from small_laminate import INCREMENTS, small_laminate

from coordinator.laminate_results import SERIES, Frame, LaminateResults
from coordinator.scene_kind import holds_laminate


def same(one: LaminateResults, other: LaminateResults) -> None:
    assert one.scene == other.scene and one.materials == other.materials and one.versions == other.versions
    assert one.section == other.section and one.series == other.series and one.events == other.events
    for name in ("angles", "nodes", "bricks", "ply"):
        first, second = getattr(one, name), getattr(other, name)
        assert first.dtype == second.dtype and first.tobytes() == second.tobytes(), name
    for name in ("new_failures", "layer_damage"):
        assert [row.tolist() for row in getattr(one, name)] == [row.tolist() for row in getattr(other, name)]
    assert (one.watched is None) == (other.watched is None)
    if one.watched is not None and other.watched is not None:
        for name in ("bricks", "centres", "angles", "plies", "materials", "shares", "strain", "stress", "subcells"):
            first, second = getattr(one.watched, name), getattr(other.watched, name)
            assert np.array_equal(np.array(first), np.array(second)), name
    assert len(one.frames) == len(other.frames)
    for first, second in zip(one.frames, other.frames, strict=True):
        assert (first.step, first.strain) == (second.step, second.strain)
        for name in ("displacement", "stress", "failed"):
            assert np.array_equal(getattr(first, name), getattr(second, name)), name


@pytest.mark.parametrize("increments", [0, 1, INCREMENTS])
@pytest.mark.parametrize("cohesive", [False, True], ids=["tied", "cohesive"])
def test_what_is_written_is_read_back(tmp_path: Path, increments: int, cohesive: bool) -> None:
    results = small_laminate(increments, cohesive)
    results.write(tmp_path / "results.h5")
    same(LaminateResults.read(tmp_path / "results.h5"), results)
    assert [path.name for path in tmp_path.iterdir()] == ["results.h5"]
    assert holds_laminate(tmp_path)


def test_a_run_that_watches_nothing_has_no_such_group(tmp_path: Path) -> None:
    results = small_laminate(watched=False)
    results.write(tmp_path / "results.h5")
    with h5py.File(tmp_path / "results.h5") as file:
        assert "watched" not in file
    same(LaminateResults.read(tmp_path / "results.h5"), results)


def test_cut_results_are_those_of_a_shorter_run(tmp_path: Path) -> None:
    whole, short = small_laminate(), small_laminate(3)
    assert len(whole.events) == 2 and len(whole.frames) == 3
    whole.cut(3)
    same(whole, short)
    assert whole.increments == 3 and len(whole.frames) == 1 and len(whole.events) == 1
    whole.cut(0)
    whole.write(tmp_path / "results.h5")
    assert LaminateResults.read(tmp_path / "results.h5").increments == 0


def test_what_is_no_laminate_is_refused_by_name(tmp_path: Path) -> None:
    path = tmp_path / "results.h5"
    with pytest.raises(ValueError, match=r"results\.h5 holds no results of a laminate"):
        LaminateResults.read(path)
    path.write_bytes(b"no HDF5")
    with pytest.raises(ValueError, match="holds no results of a laminate"):
        LaminateResults.read(path)
    with h5py.File(path, "w") as file:
        file["time_series"] = np.zeros(3)
    with pytest.raises(ValueError, match="holds no results of a laminate"):
        LaminateResults.read(path)
    assert not holds_laminate(tmp_path)


def test_every_series_says_its_unit(tmp_path: Path) -> None:
    small_laminate().write(tmp_path / "results.h5")
    with h5py.File(tmp_path / "results.h5") as file:
        assert set(file["series"]) == set(SERIES)
        for name, (unit, meaning) in SERIES.items():
            assert (file["series"][name].attrs["unit"], file["series"][name].attrs["description"]) == (unit, meaning)
            assert file["series"][name].shape == (INCREMENTS,)


def test_von_mises_of_known_states() -> None:
    pure = np.array([[3.0, 0, 0, 0, 0, 0], [2.0, 2.0, 2.0, 0, 0, 0], [0, 0, 0, 1.0, 0, 0], [0, 0, 0, 0, 1.0, 0],
                     [0, 0, 0, 0, 0, 1.0], [1.0, -1.0, 0, 0, 0, 0]])  # fmt: skip
    frame = Frame(1, 0.0, np.zeros((1, 3)), pure, np.zeros((6, 1)))
    root = np.sqrt(3.0)
    assert frame.von_mises() == pytest.approx([3.0, 0.0, root, root, root, root], abs=1e-15)


def test_layout_is_that_of_vtkhdf(tmp_path: Path) -> None:
    """Sizes, offsets and types as the file format of VTK describes a mesh that stays while its fields change."""
    results = small_laminate()
    results.write(tmp_path / "results.h5")
    frames, nodes, cells = len(results.frames), len(results.nodes), len(results.bricks)
    with h5py.File(tmp_path / "results.h5") as file:
        root = file["VTKHDF"]
        assert root.attrs["Type"] == b"UnstructuredGrid" and root.attrs["Version"].tolist() == [2, 0]
        assert h5py.check_string_dtype(root.attrs.get_id("Type").dtype).length == len(b"UnstructuredGrid")
        assert [root[name][:].tolist() for name in ("NumberOfPoints", "NumberOfCells", "NumberOfConnectivityIds")] == [
            [nodes], [cells], [8 * cells],
        ]  # fmt: skip
        assert root["Points"].shape == (nodes, 3)
        assert root["Types"][:].tolist() == [12] * cells and root["Types"].dtype == np.uint8
        assert root["Offsets"][:].tolist() == list(range(0, 8 * cells + 1, 8))
        # Hexahedra of VTK: round the lower face, then round the upper one, with a positive volume.
        corners = root["Points"][:][root["Connectivity"][:].reshape(-1, 8)]
        edges = [corners[:, k] - corners[:, 0] for k in (1, 3, 4)]
        assert (np.einsum("ei,ei->e", np.cross(edges[0], edges[1]), edges[2]) > 0.0).all()
        steps = root["Steps"]
        assert steps.attrs["NSteps"] == frames
        assert steps["Values"][:].tolist() == [frame.strain for frame in results.frames]
        assert steps["NumberOfParts"][:].tolist() == [1] * frames
        for name in ("PartOffsets", "PointOffsets"):
            assert steps[name][:].tolist() == [0] * frames
        for name in ("CellOffsets", "ConnectivityIdOffsets"):
            assert steps[name][:].tolist() == [[0]] * frames
        for place, rows in (("PointData", nodes), ("CellData", cells)):
            assert set(steps[f"{place}Offsets"]) == set(root[place])
            for name, values in root[place].items():
                offsets = steps[f"{place}Offsets"][name][:]
                assert values.shape[0] >= offsets.max() + rows, name
                assert values.shape[0] == (rows if name == "Ply" else frames * rows)
                assert offsets.tolist() == [0 if name == "Ply" else k * rows for k in range(frames)]


def test_stress_has_the_order_of_vtk(tmp_path: Path) -> None:
    """Symmetric tensors of six components are xx, yy, zz, xy, yz, xz there."""
    results = small_laminate(2)
    results.frames[0].stress[:] = [11.0, 22.0, 33.0, 23.0, 13.0, 12.0]
    results.write(tmp_path / "results.h5")
    with h5py.File(tmp_path / "results.h5") as file:
        assert file["VTKHDF/CellData/Stress"][0].tolist() == [11.0, 22.0, 33.0, 12.0, 23.0, 13.0]
    assert LaminateResults.read(tmp_path / "results.h5").frames[0].stress[0].tolist() == [11, 22, 33, 23, 13, 12]


def test_names_of_materials_are_whatever_the_cell_has(tmp_path: Path) -> None:
    """A slash would be a group inside the file."""
    results = small_laminate(2)
    results.materials = ["IM7 fibre", "epoxy/graphene"]
    results.write(tmp_path / "results.h5")
    read = LaminateResults.read(tmp_path / "results.h5")
    assert read.materials == results.materials
    assert np.array_equal(read.frames[0].failed, results.frames[0].failed)
    with h5py.File(tmp_path / "results.h5") as file:
        assert "Failed_epoxy_graphene" in file["VTKHDF/CellData"]
