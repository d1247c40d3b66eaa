"""Failure events along a path, and the command that prints them."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from failing_cells import INF, random_cell, two_by_two
from matplotlib.image import imread

from gmc_service.cell import Cell
from gmc_service.commands import micro
from gmc_service.evaluation import Evaluator
from gmc_service.failure_path import COMPONENTS, failure_path
from gmc_service.mask_table import unpack_mask
from gmc_service.material import Failure, constant_material, isotropic_stiffness

NEAT = Path(__file__).resolve().parents[2] / "scenes" / "cells" / "im7_epon862_neat.toml"


def test_events_of_the_seeds_composite() -> None:
    path = failure_path(two_by_two(), "eps11", 0.05)
    assert [event.strain for event in path.events] == pytest.approx([0.0149158383, 0.019, 0.0400444], rel=1e-6)
    assert [[cause.subcell for cause in event.causes] for event in path.events] == [[1, 2], [0], [3]]
    assert [event.causes[0].component for event in path.events] == ["33 tension", "11 tension", "11 tension"]
    assert [event.causes[0].criterion for event in path.events] == [
        "maximum_stress",
        "maximum_strain",
        "maximum_stress",
    ]


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
@pytest.mark.parametrize("component", ["eps11", "eps22", "eps12"])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_events_are_where_the_evaluation_of_points_has_them(seed: int, component: str, sign: float) -> None:
    """All four criteria, with thermal stress: just below an event nothing fails, at it the same subcells do."""
    cell, temperature = random_cell(seed, 2, 3), 330.0
    path = failure_path(cell, component, sign * 0.08, temperature=temperature)
    evaluator = Evaluator(cell)
    failed, none = np.zeros((1, evaluator.failed_bytes), np.uint8), np.zeros((1, 0))
    direction = np.eye(6)[[COMPONENTS.index(component)]]
    assert path.events
    for event in path.events:
        before = evaluator.evaluate(direction * event.strain * (1.0 - 1e-7), temperature, failed, none)
        assert np.array_equal(before.failed, failed)
        assert event.before == pytest.approx(before.stress[0], rel=1e-6, abs=100.0)
        at = evaluator.evaluate(direction * event.strain, temperature, failed, none)
        new = unpack_mask(at.failed, cell.subcells)[0] & ~unpack_mask(failed, cell.subcells)[0]
        assert np.flatnonzero(new).tolist() == sorted(cause.subcell for cause in event.causes)
        assert event.after == pytest.approx(at.stress[0], rel=1e-9, abs=1.0)
        failed = at.failed
    end = evaluator.evaluate(direction * sign * 0.08, temperature, failed, none)
    assert np.array_equal(end.failed, failed)
    assert path.stress[-1] == pytest.approx(end.stress[0], rel=1e-9, abs=1.0)
    assert path.subcell_stress[-1].mean() == pytest.approx(
        evaluator.localise(direction * sign * 0.08, temperature, failed, none)[0].mean(), rel=1e-9
    )


def test_a_free_path_has_one_stress() -> None:
    cell = random_cell(2, 2, 3)
    path = failure_path(cell, "eps22", 0.08, "free", temperature=330.0)
    assert path.events
    others = np.delete(path.stress, 1, axis=1)
    assert np.abs(others).max() < 1e-9 * np.abs(path.stress[:, 1]).max()
    assert np.allclose(path.macroscopic_strain[:, 1], path.strain)


def test_a_homogeneous_bar_breaks_at_its_strength() -> None:
    young, strength = 3e9, 60e6
    limit = Failure("maximum_stress", tension=(strength, INF, INF), compression=(2.0 * strength, INF, INF))
    resin = constant_material("resin", isotropic_stiffness(young, 0.35), failures=(limit,))
    cell = Cell(np.ones(2), np.ones(3), np.zeros((2, 3), dtype=np.int64), (resin,))
    (event,) = failure_path(cell, "eps11", 0.1, "free").events
    assert event.strain == pytest.approx(strength / young, rel=1e-12)
    assert event.before[0] == pytest.approx(strength, rel=1e-12)
    assert event.after[0] == pytest.approx(1e-4 * strength, rel=1e-9)
    assert len(event.causes) == 6 and len(event.stages) == 1
    (event,) = failure_path(cell, "eps11", -0.1, "free").events
    assert event.strain == pytest.approx(-2.0 * strength / young, rel=1e-12)
    assert failure_path(cell, "eps23", 0.1).events == ()


def test_stress_that_is_there_already_fails_at_no_strain() -> None:
    path = failure_path(two_by_two(heated=True), "eps22", 0.001, temperature=2.0)
    assert path.events[0].strain == 0.0 and path.events[0].before[1] > 0.0


def test_a_cascade_is_told_in_stages() -> None:
    cell = random_cell(4, 2, 3)
    event = failure_path(cell, "eps22", 0.08, temperature=330.0).events[0]
    assert [[cause.subcell for cause in stage] for stage in event.stages] == [[0], [2]]
    evaluator = Evaluator(cell)
    strain = np.eye(6)[[1]] * event.strain
    # Before the first subcell has failed the second one is not at its limit: a hair below, none fails.
    failed = np.zeros((1, 1), np.uint8)
    assert not evaluator.evaluate(strain * (1.0 - 1e-7), 330.0, failed, np.zeros((1, 0))).failed.any()
    first = np.array([[0b001]], np.uint8)
    assert evaluator.evaluate(strain, 330.0, first, np.zeros((1, 0))).failed.tolist() == [[0b101]]


def test_layers_in_series_and_side_by_side() -> None:
    weak, strong = (
        constant_material(name, isotropic_stiffness(1e9, 0.0), failures=(Failure("maximum_stress", (s, s, s)),))
        for name, s in (("weak", 10e6), ("strong", 15e6))
    )
    cell = Cell(np.array([0.5, 0.5]), np.ones(1), np.array([[0], [1]]), (weak, strong))
    # In series along 2 both have one stress: when the weak one fails the strong one is unloaded.
    (event,) = failure_path(cell, "eps22", 0.02).events
    assert [cause.material for cause in event.causes] == ["weak"]
    # Under a common strain 11 there is none to take over: they fail at their own strains.
    assert [event.strain for event in failure_path(cell, "eps11", 0.02).events] == pytest.approx([0.01, 0.015])


def test_command_prints_events_and_draws(tmp_path: Path) -> None:
    written = tmp_path / "events.json"
    done = CliRunner().invoke(
        micro, ["fail", str(NEAT), "--path", "eps11", "--out", str(tmp_path), "--json", str(written)]
    )
    assert done.exit_code == 0, done.output
    assert "eps11 = 0.01491583825: stress 2562.66 before, 2472.32 after" in done.output
    assert "fibre, maximum_strain, 11 tension: (0,0)" in done.output
    events = json.loads(written.read_text())["events"]
    assert [event["strain"] for event in events] == pytest.approx([0.0149158383, 0.019, 0.0400444], rel=1e-6)
    assert events[1]["stages"][0][0]["subcell"] == [0, 0]
    picture = imread(tmp_path / "im7_epon862_neat_eps11.png")
    assert picture.shape[1] > 1000
    assert (picture[..., :3].max(axis=2) < 0.4).mean() > 0.003  # lines and letters


def test_command_refuses_what_cannot_be(tmp_path: Path) -> None:
    runner = CliRunner()
    zero = runner.invoke(micro, ["fail", str(NEAT), "--path", "eps11", "--to", "0"])
    assert (
        zero.exit_code != 0 and "to is 0.0; the strain at the end of the path must be finite and not 0" in zero.output
    )
    cold = runner.invoke(micro, ["fail", str(NEAT), "--path", "eps11", "--temperature", "5 m"])
    assert cold.exit_code != 0 and "5 m" in cold.output
    broken = tmp_path / "broken.toml"
    shutil.copy(NEAT, broken)
    broken.write_text(broken.read_text().replace("fibre_fraction = 0.6", "fibre_fraction = 1.6"))
    bad = runner.invoke(micro, ["fail", str(broken), "--path", "eps11"])
    assert bad.exit_code != 0 and "fibre_fraction" in bad.output and "Traceback" not in bad.output


def test_paths_that_are_not_straight_are_refused() -> None:
    limit = Failure("maximum_stress", (1e7, 1e7, 1e7))
    soft = constant_material("soft", isotropic_stiffness(3e9, 0.3), failures=(limit,), fracture_energy=100.0)
    cell = Cell(np.ones(1), np.ones(1), np.array([[0]]), (soft,))
    with pytest.raises(ValueError, match="fracture_energy of soft makes the path curved"):
        failure_path(cell, "eps11", 0.1)
    with pytest.raises(ValueError, match="path is 'eps44'; it must be one of eps11, eps22"):
        failure_path(two_by_two(), "eps44", 0.1)
