"""Loads of which some components are strains and others stresses; fields inside the cell under them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from gmc_service.cell import Cell
from gmc_service.commands import micro
from gmc_service.engineering_constants import engineering_constants
from gmc_service.evaluation import Evaluator
from gmc_service.material import Failure, Plasticity, constant_material, isotropic_stiffness
from gmc_service.mixed_load import Held, MixedLoad, hold

SCENES = Path(__file__).resolve().parents[2] / "scenes" / "cells"


def cell_of(plasticity: Plasticity | None = None, failures: tuple[Failure, ...] = ()) -> Cell:
    side = 0.6**0.5
    sizes = np.array([side, 1.0 - side])
    fibre = constant_material("fibre", isotropic_stiffness(276e9, 0.33), (-5e-7,) * 3)
    matrix = constant_material(
        "matrix", isotropic_stiffness(2.963e9, 0.36), (5e-5,) * 3, failures=failures, plasticity=plasticity
    )
    return Cell(sizes, sizes, np.array([[0, 1], [1, 1]]), (fibre, matrix))


def held(cell: Cell, given: dict[int, float], stresses: set[int], temperature: float = 300.0) -> Held:
    evaluator = Evaluator(cell)
    values, is_stress = np.zeros(6), np.ones(6, dtype=bool)
    for component, value in given.items():
        values[component], is_stress[component] = value, component in stresses
    failed = np.zeros((1, evaluator.failed_bytes), np.uint8)
    return hold(evaluator, MixedLoad(values, is_stress), temperature, failed, np.zeros((1, evaluator.history_values)))


def test_uniaxial_stress_gives_the_engineering_constants() -> None:
    cell = cell_of()
    constants = engineering_constants(Evaluator(cell).homogenised(300.0, np.zeros(1, np.uint8)).stiffness)
    found = held(cell, {1: 10e6}, {1})
    assert found.strain[1] == pytest.approx(10e6 / constants.E22, rel=1e-10)
    assert -found.strain[2] / found.strain[1] == pytest.approx(constants.nu23, rel=1e-10)
    sheared = held(cell, {5: 0.002}, set())
    assert sheared.answer.stress[0, 5] == pytest.approx(0.002 * constants.G12, rel=1e-10)
    assert np.abs(np.delete(sheared.answer.stress[0], 5)).max() < 1.0


def test_a_free_cell_that_is_heated_expands_as_it_should() -> None:
    cell = cell_of()
    expansion = Evaluator(cell).homogenised(300.0, np.zeros(1, np.uint8)).expansion
    assert np.allclose(held(cell, {}, set(), 350.0).strain, 50.0 * expansion, rtol=1e-9, atol=1e-12)


def test_a_mix_holds_what_is_given() -> None:
    found = held(cell_of(), {0: 0.003, 1: -20e6, 5: 15e6}, {1, 5}, 330.0)
    assert found.strain[0] == 0.003
    assert np.allclose(found.answer.stress[0, 1:], [-20e6, 0.0, 0.0, 0.0, 15e6], atol=1.0)


def test_yielding_cells_are_held_too() -> None:
    cell = cell_of(Plasticity(40e6, 200e6))
    found = held(cell, {1: 100e6}, {1})
    elastic = held(cell_of(), {1: 100e6}, {1})
    assert np.allclose(found.answer.stress[0], [0.0, 100e6, 0.0, 0.0, 0.0, 0.0], atol=1.0)
    assert found.strain[1] > 1.2 * elastic.strain[1]


def test_what_the_cell_cannot_bear_is_said() -> None:
    with pytest.raises(ValueError, match="beyond what the cell can bear"):
        held(cell_of(Plasticity(40e6)), {1: 500e6}, {1})
    with pytest.raises(ValueError, match="every component must be finite"):
        held(cell_of(), {1: np.nan}, {1})


def test_fields_have_the_macroscopic_mean(tmp_path: Path) -> None:
    words = ["fields", str(SCENES / "im7_epon862_neat.toml"), "--load", "eps22=0.002", "--load", "sig12=10 MPa"]
    done = CliRunner().invoke(micro, [*words, "--json", "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    found = json.loads(done.output)
    share = np.array([0.6, 0.6**0.5 - 0.6, 0.6**0.5 - 0.6, (1 - 0.6**0.5) ** 2])
    assert np.allclose(share @ np.array(found["subcells"]["strain"]), found["strain"], atol=1e-12)
    assert np.allclose(share @ np.array(found["subcells"]["stress"]), found["stress"], atol=1e-3)
    assert found["strain"][1] == 0.002 and found["stress"][5] == pytest.approx(10e6)
    assert len(list(tmp_path.glob("*.png"))) == 6
    table = CliRunner().invoke(micro, words)
    assert "matrix (1, 0) MPa" in table.output


@pytest.mark.parametrize(
    ("load", "problem"),
    [
        ("eps7=1", "it must be such as eps22=0.002"),
        ("sig22=5", "the unit is missing"),
        ("eps22=much", "could not convert"),
    ],
)
def test_mistakes_in_a_load_are_named(load: str, problem: str) -> None:
    done = CliRunner().invoke(micro, ["fields", str(SCENES / "im7_epon862_neat.toml"), "--load", load])
    assert done.exit_code == 2 and load.partition("=")[0] in done.output
    assert " ".join(problem.split()) in " ".join(done.output.split())
    twice = CliRunner().invoke(
        micro, ["fields", str(SCENES / "example_1a.toml"), "--load", "eps22=1", "--load", "sig22=1 MPa"]
    )
    assert "given twice" in twice.output
