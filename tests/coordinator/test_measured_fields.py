"""Fields of the atoms and J in results, images and report."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from fake_run import write_fake_run

from coordinator.atom_measurements import Grid, MeasuredFields
from coordinator.elements import numbers_of
from coordinator.grid_vtkhdf import write_grid
from coordinator.report import make_report
from coordinator.results import Results, ResultsWriter
from coordinator.series import series_of

U = 1.66053906892e-27
HEADER = {
    "scene": {"name": "s", "title": "S", "text": "", "overrides": [], "resolved": {}},
    "versions": {"scalebridge": "0.1.0"}, "seeds": {"run": 1}, "command": "scalebridge run s.toml",
}  # fmt: skip
HEADING = "<h3>J from the atoms</h3>"
ATOMS = np.arange(12.0).reshape(4, 3) * 1e-10
GRID = Grid((-1e-9, -2e-9, 0.0), 5e-10, (3, 4, 2))


def measured(step: int) -> MeasuredFields:
    x, y, z = np.meshgrid(*[np.arange(n) for n in GRID.counts], indexing="ij")
    number = 100.0 * x + 10.0 * y + z + 1000.0 * step
    return MeasuredFields(
        {"stress": np.full((4, 6), 1e9 * step), "energy": np.full(4, 1e-19 * step)},
        GRID,
        {
            "density": number,
            "stress": number[..., None] * 1e9 * np.arange(1.0, 7.0),
            "temperature": np.full(GRID.counts, np.nan),
            "displacement": number[..., None] * 1e-10 * np.ones(3),
        },
    )


def write(folder: Path) -> Path:
    writer = ResultsWriter(folder / "results.h5", HEADER)
    writer.atoms(np.arange(4), np.full(4, 18), np.full(4, 39.95 * U), ATOMS)
    for step in range(1, 7):
        writer.row(step, {"time": step * 1e-12})
        if step % 2 == 0:
            writer.measured(step, step * 1e-12, measured(step))
        if step == 3:
            writer.flush()
    writer.close("finished")
    return folder / "results.h5"


def test_fields_come_back_as_they_were_measured(tmp_path: Path) -> None:
    with Results(write(tmp_path)) as results:
        assert results.atoms is not None and results.grid is not None
        steps, stress = results.atoms.field("stress")
        assert steps.tolist() == [2, 4, 6] and stress.shape == (3, 4, 6)
        np.testing.assert_allclose(stress[:, 0, 0], [2e9, 4e9, 6e9])
        np.testing.assert_allclose(results.atoms.field("energy")[1][2], 6e-19)
        with pytest.raises(KeyError):
            results.atoms.field("velocity")
        assert sorted(results.grid.names) == ["density", "displacement", "stress", "temperature"]
        np.testing.assert_allclose(results.grid.origin, GRID.origin)
        assert results.grid.spacing == pytest.approx(GRID.spacing)
        steps, density = results.grid.field("density")
        assert steps.tolist() == [2, 4, 6] and density.shape == (3, *GRID.counts)
        assert density[1, 2, 3, 1] == 4231.0
        np.testing.assert_allclose(results.grid.field("displacement")[1][0, 1, 0, 0], 2100e-10)
        assert np.isnan(results.grid.field("temperature")[1]).all()


def test_fields_follow_h5md(tmp_path: Path) -> None:
    with h5py.File(write(tmp_path)) as file:
        for name, unit in (
            ("particles/atoms/stress", "Pa"),
            ("particles/atoms/energy", "J"),
            ("observables/grid/displacement", "nm"),
            ("observables/grid/density", "kg m-3"),
        ):
            element = file[name]
            assert element["step"][:].tolist() == [2, 4, 6] and element["step"].dtype.kind == "i"
            np.testing.assert_allclose(element["time"][:], [2.0, 4.0, 6.0])
            assert (element["time"].attrs["unit"], element["value"].attrs["unit"]) == ("ps", unit)
            assert len(element["value"]) == 3
        assert h5py.check_enum_dtype(file["particles/atoms/species"].dtype) == {"Ar": 18}


def test_a_resumed_file_holds_no_field_of_a_later_step(tmp_path: Path) -> None:
    path = write(tmp_path)
    writer = ResultsWriter.resume(path, 4)
    writer.row(5, {"time": 5e-12})
    writer.measured(6, 6e-12, measured(7))
    writer.close("finished")
    with Results(path) as results:
        assert results.atoms is not None and results.grid is not None
        steps, stress = results.atoms.field("stress")
        assert steps.tolist() == [2, 4, 6]
        np.testing.assert_allclose(stress[:, 0, 0], [2e9, 4e9, 7e9])
        assert results.grid.field("density")[1][2, 0, 0, 0] == 7000.0


def test_images_follow_vtkhdf(tmp_path: Path) -> None:
    write(tmp_path)
    files = sorted((tmp_path / "fields").iterdir())
    assert [path.name for path in files] == [f"grid_{step:08d}.vtkhdf" for step in (2, 4, 6)]
    with h5py.File(files[1]) as file:
        group = file["VTKHDF"]
        assert bytes(group.attrs["Type"]) == b"ImageData"
        kind = h5py.check_string_dtype(group.attrs.get_id("Type").dtype)
        assert (kind.encoding, kind.length) == ("ascii", 9), "VTKHDF asks for a string of fixed length here"
        assert group.attrs["Version"].tolist() == [2, 0]
        assert group.attrs["WholeExtent"].tolist() == [0, 2, 0, 3, 0, 1]
        np.testing.assert_allclose(group.attrs["Origin"], [-10.0, -20.0, 0.0])
        np.testing.assert_allclose(group.attrs["Spacing"], 5.0)
        assert group.attrs["Direction"].tolist() == np.eye(3).ravel().tolist()
        # z first, x last; components behind.
        assert group["PointData/Density"].shape == (2, 4, 3)
        assert group["PointData/Density"][1, 3, 2] == 4231.0
        assert group["PointData/Stress"].shape == (2, 4, 3, 6)
        np.testing.assert_allclose(group["PointData/Stress"][1, 3, 2], 4231.0 * np.arange(1, 7), rtol=1e-6)
        assert group["PointData/Displacement"][0, 0, 1, 0] == pytest.approx(4100.0)


def test_an_image_of_one_layer_has_no_axis_for_it(tmp_path: Path) -> None:
    """VTK 9.6 fails to read it otherwise."""
    flat = Grid((0.0, 0.0, 0.0), 1e-10, (3, 2, 1))
    number = np.arange(6.0).reshape(3, 2, 1)
    write_grid(tmp_path / "flat.vtkhdf", flat, {"density": number, "velocity": number[..., None] * np.ones(3)})
    with h5py.File(tmp_path / "flat.vtkhdf") as file:
        assert file["VTKHDF"].attrs["WholeExtent"].tolist() == [0, 2, 0, 1, 0, 0]
        assert file["VTKHDF/PointData/Density"][:].tolist() == number[..., 0].T.tolist()
        assert file["VTKHDF/PointData/Velocity"].shape == (2, 3, 3)


def test_elements_are_told_by_their_masses() -> None:
    masses = np.array([1.008, 12.011, 14.007, 15.999, 26.98, 39.95, 63.55, 100.0]) * U
    assert numbers_of(masses).tolist() == [1, 6, 7, 8, 13, 18, 29, 0]


def test_series_of_j_have_units_and_words() -> None:
    assert series_of("j_contour_0").unit == series_of("j_domain_error_3").unit == "J/m^2"
    assert series_of("j_contour_error_12").description == "standard error of J along contour 12"
    assert series_of("j_tip").unit == "m"
    assert series_of("j_other_1").unit == ""


def test_the_report_draws_j_over_time(tmp_path: Path) -> None:
    j = ("atomistic.j.interval=10", 'atomistic.j.half_sizes=["15 angstrom", "25 angstrom"]')
    write_fake_run(tmp_path, overrides=j, steps=60)
    with h5py.File(tmp_path / "results.h5", "a") as file:
        table = file["time_series"]
        for name, value in (("j_contour_0", 3.0), ("j_contour_error_0", 0.2), ("j_domain_0", 3.1),
                            ("j_domain_error_0", 0.1)):  # fmt: skip
            there = np.where(np.arange(61) % 10 == 9, value, np.nan)
            table.create_dataset(name, data=there, maxshape=(None,), chunks=(64,))
            table[name].attrs["unit"], table[name].attrs["description"] = "J/m^2", ""
    page = make_report(tmp_path).read_text()
    assert HEADING in page
    assert "over 10 coupling steps" in page
    assert "J from the atoms along contour 0" not in page, "a series that is drawn is not listed as well"


def test_the_report_of_a_run_without_j_has_no_such_figure(tmp_path: Path) -> None:
    write_fake_run(tmp_path, steps=20)
    assert HEADING not in make_report(tmp_path).read_text()
