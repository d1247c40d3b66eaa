"""Cell files: what they mean, and what is said of every mistake."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gmc_service.cell import Cell
from gmc_service.cell_file import NamedCell, read_cell
from gmc_service.engineering_constants import engineering_constants
from gmc_service.toml_table import Mistakes
from protocol.constituent import Constituent, Figure, write_constituent

READY = sorted((Path(__file__).parents[2] / "scenes" / "cells").glob("*.toml"))

PLAIN = """
[cell]
architecture = "square_2x2"
fibre_fraction = 0.6
[materials.fibre]
from = "IM7"
[materials.matrix]
kind = "isotropic"
E = "3 GPa"
nu = 0.35
"""


def read(text: str, folder: Path) -> NamedCell:
    file = folder / "ply.toml"
    file.write_text(text, encoding="utf-8")
    return read_cell(file)


def mistakes(text: str, folder: Path) -> list[str]:
    with pytest.raises(Mistakes) as caught:
        read(text, folder)
    start = f"{folder / 'ply.toml'}: "
    assert all(line.startswith(start) for line in caught.value.lines)
    return [line.removeprefix(start) for line in caught.value.lines]


@pytest.mark.parametrize("file", READY, ids=lambda file: file.stem)
def test_ready_cells_are_read(file: Path) -> None:
    cell = read_cell(file)
    assert isinstance(cell, Cell) and cell.name == file.stem and cell.title
    assert file.read_text(encoding="utf-8").startswith("# ")
    assert cell.phase_fractions().min() > 0.0 and cell.phase_fractions().sum() == pytest.approx(1.0, rel=1e-14)


def test_there_are_ready_cells() -> None:
    assert len(READY) >= 10


def test_a_plain_cell_in_si(tmp_path: Path) -> None:
    cell = read('title = "A ply"\n' + PLAIN, tmp_path)
    assert (cell.name, cell.title) == ("ply", "A ply")
    assert [material.name for material in cell.materials] == ["fibre", "matrix"]
    assert (cell.stress_free_temperature, cell.knock_down, cell.after_failure) == (300.0, 1e-4, "gmc")
    assert cell.phase_fractions()[0] == pytest.approx(0.6, rel=1e-14)
    assert pytest.approx(3e9) == engineering_constants(cell.materials[1].stiffness[0]).E11
    assert cell.materials[0].density == pytest.approx(1770.0) and cell.materials[1].density is None
    assert [material.expansion_known for material in cell.materials] == [True, False]


def test_phases_stand_in_the_order_of_the_architecture_not_of_the_file(tmp_path: Path) -> None:
    head, fibre, matrix = (
        PLAIN.partition("[materials.fibre]")[0],
        '[materials.fibre]\nfrom = "IM7"\n',
        ('[materials.matrix]\nfrom = "8552"\n'),
    )
    one, other = read(head + fibre + matrix, tmp_path), read(head + matrix + fibre, tmp_path)
    assert one.identity() == other.identity()


def test_settings_failure_and_plasticity(tmp_path: Path) -> None:
    text = PLAIN.replace(
        "[materials.fibre]",
        'stress_free_temperature = "180 degC"\nknock_down = 1e-3\nafter_failure = "floor"\nsize = "6 um"\n'
        "[materials.fibre]",
    )
    text += """
fracture_energy = "200 J/m^2"
reduces_strength = true
alpha = "55e-6 1/K"
plasticity = { yield_stress = "60 MPa", hardening = "0.4 GPa" }
[[materials.matrix.failure]]
criterion = "maximum_stress"
tension = "90 MPa"
compression = ["150 MPa", "none", "160 MPa"]
[[materials.matrix.failure]]
criterion = "maximum_strain"
shear = [0.05, 0.06, "none"]
"""
    cell = read(text, tmp_path)
    assert (cell.stress_free_temperature, cell.knock_down, cell.after_failure) == (453.15, 1e-3, "floor")
    assert cell.heights.sum() == pytest.approx(6e-6)
    matrix = cell.materials[1]
    inf = np.inf
    assert matrix.failures[0].tension == (90e6, 90e6, 90e6) and matrix.failures[0].shear == (inf, inf, inf)
    assert matrix.failures[0].compression == (150e6, inf, 160e6)
    assert matrix.failures[1].criterion == "maximum_strain" and matrix.failures[1].shear == (0.05, 0.06, inf)
    assert matrix.fracture_energy == 200.0 and matrix.reduces_strength and matrix.plasticity is not None
    assert (matrix.plasticity.yield_stress, matrix.plasticity.hardening) == (60e6, 0.4e9)
    assert matrix.expansion[0].tolist() == [55e-6, 55e-6, 55e-6, 0.0, 0.0, 0.0]


def test_own_keys_replace_and_complete_an_entry(tmp_path: Path) -> None:
    replaced = PLAIN.replace('from = "IM7"', 'from = "IM7"\nE1 = "276 GPa"\nG23 = "7 GPa"\nfailure = []')
    fibre = read(replaced, tmp_path).materials[0]
    of = engineering_constants(fibre.stiffness[0])
    assert pytest.approx((276e9, 7e9, 18.9e9)) == (of.E11, of.G23, of.G12) and fibre.failures == ()
    assert of.nu23 == pytest.approx(11.8 / 14.0 - 1.0)
    completed = PLAIN.replace('from = "IM7"', 'from = "seed-im7-oht"\nG12 = "20 GPa"\nnu23 = 0.3')
    of = engineering_constants(read(completed, tmp_path).materials[0].stiffness[0])
    assert (of.E11, of.G12, of.nu23, of.nu12) == pytest.approx((276e9, 20e9, 0.3, 0.3))


def test_a_matrix_that_was_measured_goes_into_a_cell(tmp_path: Path) -> None:
    resin = Constituent(
        name="epoxy_8", source="molecular dynamics", temperature=Figure(300.0), density=Figure(1115.0),
        kind="isotropic", elastic={"E": Figure(3.123e9, 0.1e9), "nu": Figure(0.36)},
    )  # fmt: skip
    write_constituent(tmp_path / "epoxy.toml", resin)
    text = PLAIN[: PLAIN.index("[materials.matrix]")] + '[materials.matrix]\nfrom_file = "epoxy.toml"\n'
    matrix = read(text, tmp_path).materials[1]
    assert pytest.approx(3.123e9, rel=1e-9) == engineering_constants(matrix.stiffness[0]).E11
    assert matrix.density == 1115.0 and not matrix.expansion_known and matrix.failures == ()


def test_orthotropic_and_tabulated_materials(tmp_path: Path) -> None:
    text = PLAIN.replace(
        'kind = "isotropic"\nE = "3 GPa"\nnu = 0.35',
        'kind = "orthotropic"\nE1 = "10 GPa"\nE2 = "8 GPa"\nE3 = "6 GPa"\nnu12 = 0.3\nnu13 = 0.25\nnu23 = 0.2\n'
        'G12 = "3 GPa"\nG13 = "2.5 GPa"\nG23 = "2 GPa"\nalpha1 = "1e-6 1/K"\nalpha2 = "2e-6 1/K"\nalpha3 = "3e-6 1/K"',
    )
    matrix = read(text, tmp_path).materials[1]
    of = engineering_constants(matrix.stiffness[0])
    assert (of.E33, of.nu13, of.G13, of.G23) == pytest.approx((6e9, 0.25, 2.5e9, 2e9))
    assert matrix.expansion[0][:3].tolist() == [1e-6, 2e-6, 3e-6]
    table = PLAIN.replace(
        'E = "3 GPa"\nnu = 0.35', 'temperatures = ["300 K", "400 K"]\nE = ["3 GPa", "2 GPa"]\nnu = [0.35, 0.4]'
    )
    cell = read(table, tmp_path)
    of = engineering_constants(cell.stiffness_at(400.0)[1])
    assert (of.E11, of.nu12) == pytest.approx((2e9, 0.4))


def test_an_array_of_named_phases(tmp_path: Path) -> None:
    text = """
[cell]
architecture = "array"
heights = ["1 um", "3 um"]
widths = ["2 um", "2 um"]
phase = [["fibre", "glue"], ["matrix", "matrix"]]
[materials.matrix]
from = "8552"
[materials.glue]
from = "3501-6"
[materials.fibre]
from = "T300"
"""
    cell = read(text, tmp_path)
    names = [[cell.materials[number].name for number in row] for row in cell.phase]
    assert names == [["fibre", "glue"], ["matrix", "matrix"]]
    assert cell.heights.tolist() == pytest.approx([1e-6, 3e-6])
    assert mistakes(text.replace('"glue"]', '"gleu"]'), tmp_path) == [
        'cell.phase.0.1 = "gleu": must be one of materials, matrix, glue, fibre'
    ]
    assert mistakes(text.replace('"glue"]', '"matrix"]'), tmp_path)[0].endswith("has no subcell of the material glue")
    assert "phase has 2 rows; heights has 1" in mistakes(text.replace(', "3 um"]', "]"), tmp_path)[0]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("0.6", "1.2", "cell.fibre_fraction = 1.2: must be greater than 0 and below 1 (at 1 there is no matrix)"),
        ("0.6", '"60 %"', 'cell.fibre_fraction = "60 %": must be a finite number without a unit'),
        ("fibre_fraction = 0.6", "", "cell.fibre_fraction: is missing; it is needed, a number"),
        ("fibre_fraction", "fiber_fraction",
         "cell.fiber_fraction = 0.6: is no key of this table; did you mean fibre_fraction?"),
        ("square_2x2", "square_3x3", 'cell.architecture = "square_3x3": must be one of square_2x2, '),
        ("0.6", "0.6\nseed = 1", "cell.seed = 1: is no key of this table; known here: architecture, fibre_fraction"),
        ("0.6", "0.6\nknock_down = 0", "cell.knock_down = 0: must be greater than 0 and at most 1"),
        ("0.6", "0.6\nstress_free_temperature = 300",
         'cell.stress_free_temperature = 300: must be a temperature with its unit, such as "300 K"; a bare number'),
        ("0.6", '0.6\nafter_failure = "none"', 'cell.after_failure = "none": must be one of gmc, floor'),
        ('"3 GPa"', "3e9", 'materials.matrix.E = 3000000000.0: must be a pressure with its unit, such as "800 GPa"; a'),
        ('"3 GPa"', '"3 GPx"', "the unit 'GPx' is unknown"),
        ('"3 GPa"', '"3 mm"', "the unit 'mm' is none of pressure"),
        ('"3 GPa"', '"-3 GPa"', 'materials.matrix.E = "-3 GPa": must be greater than 0'),
        ("nu = 0.35", "", "materials.matrix.nu: is missing; a material of kind 'isotropic' needs it, a number"),
        ("nu = 0.35", "nu = 0.5", "materials.matrix: nu is 0.5; it must lie between -1 and 0.5"),
        ("nu = 0.35", "nu = 0.35\nG = '1 GPa'", 'materials.matrix.G = "1 GPa": is no key of this table'),
        ("nu = 0.35", "nu = [0.3, 0.4]", "materials.matrix.nu = [0.3, 0.4]: must be one value; a list needs temperatu"),
        ('kind = "isotropic"', 'kind = "isotropik"', "did you mean isotropic?"),
        ('kind = "isotropic"\n', "", "materials.matrix.kind: is missing; it is needed, one of isotropic, cubic"),
        ('"IM7"', '"IM6"', "there is none of that name; did you mean 'IM7'?"),
        ('"IM7"', '"seed-im7-oht"', "materials.fibre.G12: is missing; a material of kind 'transversely isotropic'"),
        ('"IM7"', '"IM7"\nG23 = "7 GPa"\nnu23 = 0.2', "and nu23 are both given"),
        ('"IM7"', '"IM7"\nfrom_file = "x.toml"', "and from are both given; a material has one origin"),
        ('from = "IM7"', 'from_file = "none.toml"', 'materials.fibre.from_file = "none.toml": cannot be read: No such'),
        ("[materials.fibre]", "[materials.fiber]", "materials.fibre: is missing; the architecture has this phase"),
        ("[materials.fibre]", "[materials.coat]\nfrom = 'T300'\n[materials.fibre]",
         "materials.coat: is no phase of the architecture; it has fibre, matrix"),
        ("nu = 0.35", "nu = 0.35\nplasticity = {hardening = '1 GPa'}", "plasticity.yield_stress: is missing"),
        ("nu = 0.35", "nu = 0.35\ndensity = '0 kg/m^3'", "density = \"0 kg/m^3\": must be greater than 0"),
        ("[cell]", "[cell", "is not TOML"),
        ("[cell]", "[cells]", "cell: is missing; it is needed, a table"),
        ("[cell]", "zell = 3\n[cell]", "zell = 3: is no key of this table; did you mean cell?"),
    ],
)  # fmt: skip
def test_a_mistake_names_field_value_and_what_is_allowed(old: str, new: str, said: str, tmp_path: Path) -> None:
    assert old in PLAIN
    assert said in "\n".join(mistakes(PLAIN.replace(old, new, 1), tmp_path))


@pytest.mark.parametrize(
    ("failure", "said"),
    [
        ('criterion = "hashing"\ntension = "1 MPa"', "failure.0.criterion = \"hashing\": must be one of maximum_str"),
        ('criterion = "maximum_stress"', "materials.matrix.failure.0: has no allowable; needed: tension, compression"),
        ('criterion = "maximum_stress"\ntension = 90e6', "failure.0.tension = 90000000.0: must be a pressure with"),
        ('criterion = "maximum_strain"\ntension = "90 MPa"', "failure.0.tension = \"90 MPa\": must be a finite number"),
        ('criterion = "maximum_strain"\ntension = -0.01', "failure.0.tension = -0.01: must be greater than 0"),
        ('criterion = "tsai_hill"\nshear = ["1 MPa", "1 MPa"]', "must be one value, or three in the order 23, 13, 12"),
        ('criterion = "tsai_hill"\nshear = "1 MPa"\nstretch = 1', "failure.0.stretch = 1: is no key of this table"),
    ],
)  # fmt: skip
def test_a_mistake_in_a_criterion_is_told(failure: str, said: str, tmp_path: Path) -> None:
    text = PLAIN + "[[materials.matrix.failure]]\n" + failure + "\n"
    assert said in "\n".join(mistakes(text, tmp_path))


def test_all_mistakes_come_at_once(tmp_path: Path) -> None:
    text = PLAIN.replace("0.6", "2").replace('"3 GPa"', "3").replace('"IM7"', '"nothing"')
    assert len(mistakes(text, tmp_path)) == 3


@pytest.mark.parametrize(
    ("cell", "said"),
    [
        ('architecture = "random"\nfibre_fraction = 0.5\nfibres = 9', "cell.seed: is missing; it is needed, a whole"),
        ('architecture = "random"\nfibre_fraction = 0.8\nfibres = 9\nseed = 1', "must be greater than 0 and at most"),
        ('architecture = "random"\nfibre_fraction = 0.5\nfibres = 2.5\nseed = 1', "cell.fibres = 2.5: must be a whole"),
        ('architecture = "hexagonal"\nfibre_fraction = 0.5\ncolumns = 5', "cell.columns = 5: must be even, and 4 to"),
        ('architecture = "layered"\nfibre_fraction = 0.5\nalong = 1', "cell.along = 1: must be 2 or 3"),
        ('architecture = "square_7x7"\nfibre_fraction = 0.5\nsize = "0 um"', 'cell.size = "0 um": must be greater'),
    ],
)  # fmt: skip
def test_keys_of_an_architecture(cell: str, said: str, tmp_path: Path) -> None:
    text = "[cell]\n" + cell + PLAIN[PLAIN.index("\n[materials.fibre]") :]
    assert said in "\n".join(mistakes(text, tmp_path))


def test_a_temperature_needs_thermal_expansion(tmp_path: Path) -> None:
    cell = read(PLAIN, tmp_path)
    cell.check_temperature(300.0)
    with pytest.raises(ValueError, match="temperature is 350 K; the thermal expansion of matrix is not known"):
        cell.check_temperature(350.0)


def test_a_missing_file_is_told(tmp_path: Path) -> None:
    with pytest.raises(Mistakes, match=r"none\.toml: cannot be read: No such file"):
        read_cell(tmp_path / "none.toml")
