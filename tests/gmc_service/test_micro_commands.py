"""The commands `scalebridge micro`, against published figures."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from gmc_service.commands import micro

CELLS = Path(__file__).parents[2] / "scenes" / "cells"
#: E11, E22, nu12, nu23, G12, G23 of the cells of the dissertation, MPa.
SEED = {
    "im7_epon862_neat": (166785.894, 15003.7323, 0.340531864, 0.286246729, 3858.68478, 2681.12315),
    "im7_epon862_graphene": (167033.279, 17910.8032, 0.340536141, 0.287199637, 4632.13729, 3229.97550),
}


def run(*arguments: object) -> Result:
    return CliRunner().invoke(micro, [str(argument) for argument in arguments])


def answer(*arguments: object) -> dict[str, float]:
    done = run("properties", *arguments, "--json")
    assert done.exit_code == 0, done.output
    found: dict[str, float] = json.loads(done.output)
    return found


@pytest.mark.parametrize("name", SEED)
@pytest.mark.parametrize("method", ["gmc", "gmc_dense"])
def test_seed_cells_have_their_published_constants(name: str, method: str) -> None:
    found = answer(CELLS / f"{name}.toml", "--method", method)
    values = [found[key] for key in ("E11", "E22", "nu12", "nu23", "G12", "G23")]
    scale = np.array([1e6, 1e6, 1.0, 1.0, 1e6, 1e6])
    np.testing.assert_allclose(values / scale, SEED[name], rtol=1e-8)
    assert found["E22"] == pytest.approx(found["E33"], rel=1e-12)
    assert found["alpha1"] is None and found["density"] is None


def test_example_1a_has_all_printed_digits() -> None:
    found = answer(CELLS / "example_1a.toml")
    stiffness = np.array(found["stiffness"]) / 1e9
    printed = {(0, 0): "257.1", (0, 1): "4.500", (1, 1): "7.828", (1, 2): "3.707", (3, 3): "1.916", (4, 4): "4.166"}
    for place, text in printed.items():
        assert f"{stiffness[place]:.{len(text.split('.')[1])}f}" == text
    assert f"{found['alpha1'] * 1e6:.4f}" == "-0.4724" and f"{found['alpha2'] * 1e6:.2f}" == "26.63"
    assert found["fractions"] == pytest.approx({"fibre": 0.65, "matrix": 0.35}, rel=1e-14)  # type: ignore[comparison-overlap]


def test_the_table_has_every_constant() -> None:
    done = run("properties", CELLS / "im7_8552_26x26.toml", "--temperature", "25 degC")
    assert done.exit_code == 0, done.output
    for name in ("E11", "E22", "E33", "nu12", "nu13", "nu23", "G12", "G13", "G23", "alpha1", "alpha2", "alpha3"):
        assert f"\n  {name} " in done.output
    assert "298.15 K" in done.output and "fraction of fibre: 0.577\n" in done.output
    # Rule of mixtures: 0.577 x 1770 + 0.423 x 1300 kg/m3.
    assert "density        1571.19 kg/m3" in done.output


def test_temperature_changes_what_is_tabulated() -> None:
    cold = answer(CELLS / "boron_aluminium.toml")
    hot = answer(CELLS / "boron_aluminium.toml", "--temperature", "250 degC")
    assert hot["E22"] < 0.95 * cold["E22"] and hot["temperature"] == 523.15
    done = run("properties", CELLS / "boron_aluminium.toml", "--temperature", "400 degC")
    assert done.exit_code == 1 and "temperature is 673.15 K; the table of matrix goes from" in done.output


def test_a_hole_takes_all_transverse_shear_from_gmc_but_not_from_finite_elements() -> None:
    found = answer(CELLS / "porous_epoxy.toml")
    assert found["G23"] < 1e4 < 1e9 < found["E22"]
    assert answer(CELLS / "porous_epoxy.toml", "--method", "high_fidelity")["G23"] > 0.5e9


def test_the_card_holds_the_constants_of_the_table(tmp_path: Path) -> None:
    card = tmp_path / "ply.inp"
    done = run("properties", CELLS / "im7_epon862_neat.toml", "--card", card)
    assert done.exit_code == 0 and f"card: {card}" in done.output
    text = card.read_text()
    assert "** Effective constants of im7_epon862_neat.toml" in text and "166785.89, 15003.732" in text
    assert "*EXPANSION" not in text
    run("properties", CELLS / "example_1a.toml", "--card", card, "--card-units", "m")
    assert "*EXPANSION, TYPE=ORTHO, ZERO=300.\n-4.724" in card.read_text()


def test_a_card_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    done = run("properties", CELLS / "example_1a.toml", "--card", tmp_path / "none" / "ply.inp")
    assert done.exit_code == 1 and "No such file" in done.output and "Traceback" not in done.output


def test_show_draws_the_cell(tmp_path: Path) -> None:
    picture = tmp_path / "cell.png"
    done = run("show", CELLS / "glass_epoxy_random.toml", "--out", picture)
    assert done.exit_code == 0, done.output
    assert picture.read_bytes().startswith(b"\x89PNG") and "fibre: 55 %" in done.output and "64 x 64" in done.output


def test_constituents_are_listed_with_their_sources() -> None:
    every = run("constituents").output
    assert all(f"\n{name}" in f"\n{every}" for name in ("IM7 ", "AS4 ", "seed-epon862-2wt "))
    one = run("constituents", "3501-6").output
    assert "Soden" in one and "maximum_stress: tension 69 MPa" in one and "Incomplete" not in one
    lacking = run("constituents", "seed-im7-oht").output
    assert "Incomplete" in lacking and "seed-im7-oht.G12: is missing" in lacking
    wrong = run("constituents", "IM8")
    assert wrong.exit_code == 1 and "did you mean 'IM7'?" in wrong.output


@pytest.mark.parametrize(
    "command", [["properties"], ["fail", "--path", "eps11"], ["fields"]], ids=lambda words: words[0]
)
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--temperature", "300"], "the unit is missing"),
        (["--temperature", "3 m"], "the unit 'm' is none of temperature"),
        (["--temperature", "-300 degC"], "must be 0 K or greater"),
        (["--method", "voigt"], "'voigt' is not one of"),
    ],
)
def test_wrong_options_are_told(command: list[str], arguments: list[str], said: str) -> None:
    done = run(*command, CELLS / "example_1a.toml", *arguments)
    assert done.exit_code == 2 and said in " ".join(done.output.split())


def test_mistakes_of_a_file_are_told_without_a_traceback(tmp_path: Path) -> None:
    file = tmp_path / "bad.toml"
    file.write_text('[cell]\narchitecture = "square_2x2"\nfibre_fraction = 2\n[materials]\n')
    done = run("properties", file)
    assert done.exit_code == 1 and "cell.fibre_fraction = 2: must be greater than 0 and below 1" in done.output
    assert "materials.fibre: is missing" in done.output and "Traceback" not in done.output


def test_help_lists_all_commands() -> None:
    done = run("--help")
    assert done.exit_code == 0, done.output
    listed = [line.split()[0] for line in done.output.partition("Commands:")[2].splitlines() if line.strip()]
    assert {"constituents", "fail", "properties", "show"} <= set(listed) and listed == sorted(listed)


def test_the_module_of_the_commands_imports_nothing_heavy() -> None:
    heavy = ("numpy", "scipy", "pint", "matplotlib", "numba", "pydantic")
    commands = "gmc_service.commands, gmc_service.fail_command"
    code = f"import sys, {commands}; print([name for name in {heavy!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
