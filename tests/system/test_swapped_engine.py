"""One scene on several codes, with samples from files, with J and fields: what version 1.2 brought, in whole runs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from small_runs import StartsRuns

from coordinator.kill_resume import END_SECONDS, RUN_SECONDS
from coordinator.results import Results
from md_service.data_file import write_data_file
from md_service.sample_source import build_sample

ROOT = Path(__file__).parents[2]
PATCH = ROOT / "scenes" / "lattice_patch.toml"
CLOCK = {"seconds_continuum", "seconds_atomistic", "seconds_exchange"}
pytestmark = pytest.mark.timeout(600)

#: A cracked lattice in a small body that is pulled apart.
CRACKED = """\
title = "Cracked harmonic lattice"

[run]
steps = 24
output_every = 8
checkpoint_every = 10
seed = 5

[continuum]
assumption = "plane_stress"
lower = ["-96 angstrom", "-100 angstrom"]
upper = ["96 angstrom", "100 angstrom"]
cell_size = "8 angstrom"
initial_velocity = "follow_edges"

[[continuum.edges]]
edge = "top"
component = "y"
times = ["0 ps", "5 ps"]
displacements = ["0 angstrom", "1 angstrom"]

[[continuum.edges]]
edge = "bottom"
component = "y"
times = ["0 ps", "5 ps"]
displacements = ["0 angstrom", "-1 angstrom"]

[atomistic]
backend = "lattice"
force_field = "harmonic"
material = "hexagonal"
width = "128 angstrom"
height = "128 angstrom"
temperature = "30 K"
time_step = "1 fs"
equilibration = "0.2 ps"
reference = "0.1 ps"

[atomistic.j]
interval = 4
half_sizes = ["25 angstrom", "35 angstrom"]

[atomistic.fields]
interval = 8
atoms = ["stress"]
spacing = "16 angstrom"

[handshake]
width = "24 angstrom"
steps_per_exchange = 5
ivc_size = "12 angstrom"
damping_time = "0.2 ps"
passive_width = "4 angstrom"

[crack]
tip_x = "0 angstrom"
y = "0 angstrom"
"""


def finished(start: StartsRuns, scene: Path, folder: Path, *words: str) -> Path:
    run = start(scene, folder, *words)
    assert run.wait(RUN_SECONDS) == 0, run.printed
    assert run.survivors(END_SECONDS) == []
    return folder / "results.h5"


@pytest.mark.parametrize("backend", ["md_service", "openmm", "ase"])
def test_a_scene_swaps_its_engine_by_one_line(backend: str, start: StartsRuns, tmp_path: Path) -> None:
    """The same potential in the same scene: interface forces at the end as another code has them."""
    words = [
        "run.steps=12", "run.output_every=12", "atomistic.force_field=lennard-jones", "continuum.cell_size=16 angstrom",
        "continuum.lower=['-128 angstrom', '-128 angstrom']", "continuum.upper=['128 angstrom', '128 angstrom']",
        "handshake.width=32 angstrom", "handshake.ivc_size=32 angstrom", "atomistic.fields.interval=12",
        # The hexagonal layer of this potential at 0 K, measured by each of the three codes alike.
        "continuum.material.young=3.48 GPa", "continuum.material.poisson=0.3333",
        "continuum.material.density=1728 kg/m^3", "continuum.material.thickness=3.09 angstrom",
    ]  # fmt: skip
    found = {}
    for name in ("lattice", backend):
        field = "harmonic" if name == "lattice" else "lennard-jones"
        sets = [*words, f"atomistic.backend={name}", f"atomistic.force_field={field}"]
        path = finished(start, PATCH, tmp_path / name, *[part for word in sets for part in ("--set", word)])
        with Results(path) as results:
            found[name] = results.series
            assert results.status == "finished" and len(results.step) == 12
            assert results.atoms is not None and len(results.atoms.atom_id) > 500
            assert np.isfinite(results.atoms.field("stress")[1]).all()
    assert found[backend]["force_balance"].max() < 1e-10
    # Another potential, so other forces: what ran was not the lattice.
    assert found[backend]["spring_energy"][-1] != found["lattice"]["spring_energy"][-1]
    assert 0.0 <= found[backend]["temperature"][-1] < 1.0


def test_a_sample_from_a_file_gives_the_run_of_the_built_one(start: StartsRuns, tmp_path: Path) -> None:
    atoms = build_sample("hexagonal", 128e-10, 128e-10, spacing=3.45e-10)
    write_data_file(tmp_path / "sheet.data.gz", atoms, "metal", "atomic")
    scene = tmp_path / "patch.toml"
    scene.write_text(PATCH.read_text())
    material = ["young=1000 GPa", "poisson=0.3333", "density=2250 kg/m^3", "thickness=2.82 angstrom"]
    words = ["--set", "run.steps=10", "--set", "atomistic.temperature=30 K"]
    words += [part for value in material for part in ("--set", f"continuum.material.{value}")]
    built = finished(start, scene, tmp_path / "built", *words)
    read = finished(start, scene, tmp_path / "read", *words, "--set", "atomistic.sample=sheet.data.gz")
    with Results(built) as one, Results(read) as other:
        assert one.series.keys() == other.series.keys()
        for name in one.series.keys() - CLOCK:
            assert np.array_equal(one.series[name], other.series[name], equal_nan=True), name
        assert one.atoms is not None and other.atoms is not None
        assert np.array_equal(one.atoms.position(len(one.atoms) - 1), other.atoms.position(len(other.atoms) - 1))


def test_j_and_fields_resume_as_if_the_run_had_not_stopped(start: StartsRuns, tmp_path: Path) -> None:
    scene = tmp_path / "cracked.toml"
    scene.write_text(CRACKED)
    whole = finished(start, scene, tmp_path / "whole")
    finished(start, scene, tmp_path / "parts", "--set", "run.steps=14")
    parts = finished(start, scene, tmp_path / "parts", "--resume")
    with Results(whole) as one, Results(parts) as other:
        for name in one.series.keys() - CLOCK:
            # The second run began at a checkpoint of step 14, where the first has none.
            assert np.array_equal(one.series[name][:14], other.series[name][:14], equal_nan=True), name
            assert other.series[name].shape == one.series[name].shape
        measured = np.flatnonzero(np.isfinite(one.series["j_contour_1"])) + 1
        assert measured.tolist() == [4, 8, 12, 16, 20, 24]
        assert np.array_equal(np.isfinite(one.series["j_contour_1"]), np.isfinite(other.series["j_contour_1"]))
        assert one.units["j_domain_0"] == "J/m^2" and (one.series["j_tip"][measured - 1] == 0.0).all()
        for results in (one, other):
            assert results.atoms is not None and results.grid is not None
            assert results.atoms.field("stress")[0].tolist() == [8, 16, 24]
            density = results.grid.field("density")[1]
            assert density.shape[0] == 3 and density[:, 4, 6, 0] == pytest.approx(2250.0, rel=0.03)
    names = sorted(path.name for path in (tmp_path / "parts" / "fields").iterdir())
    assert names == [f"grid_{step:08d}.vtkhdf" for step in (8, 16, 24)]
    assert "<h3>J from the atoms</h3>" in (tmp_path / "whole" / "report.html").read_text()
