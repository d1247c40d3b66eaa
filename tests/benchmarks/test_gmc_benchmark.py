"""Benchmark `gmc`: its reference, its peers, its front and its pictures; what takes seconds is not timed here."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.gmc import fraction_errors
from benchmarks.gmc_methods import FRACTION, MODULI, PHASES, cell_of, measure, methods, moduli, reference
from benchmarks.gmc_peers import homocompy_stiffness, scikit_fem_stiffness
from benchmarks.gmc_pictures import draw_cost, draw_fractions
from gmc_service.architectures import square_pack
from gmc_service.engineering_constants import engineering_constants
from gmc_service.high_fidelity import homogenise
from gmc_service.mori_tanaka import homogenise as mori_tanaka
from gmc_service.verification.exact_axial_shear import round_fibres


def test_reference_has_the_exact_axial_shear_within_its_stated_error() -> None:
    found, step = reference(FRACTION)
    exact = PHASES[1, 5, 5] * round_fibres(FRACTION, float(PHASES[0, 5, 5] / PHASES[1, 5, 5]))
    assert abs(found[MODULI.index("G12")] / exact - 1.0) < step < 1e-5


@pytest.mark.parametrize("subcells", [2, 7])
def test_scikit_fem_gives_the_same_finite_elements(subcells: int) -> None:
    pytest.importorskip("skfem")
    cell = square_pack(subcells, FRACTION)
    down, along = (np.concatenate([[0.0], np.cumsum(sizes)]) for sizes in (cell.heights, cell.widths))
    other = scikit_fem_stiffness((down, along), PHASES[cell.phase])
    own = homogenise(*cell_of(subcells, FRACTION), 1).stiffness
    assert np.abs(own - other).max() < 1e-12 * other.max()


def test_scikit_fem_gives_the_same_for_any_anisotropy() -> None:
    pytest.importorskip("skfem")
    random = np.random.default_rng(0)
    factor = random.normal(size=(3, 2, 6, 6))
    stiffness = factor @ factor.swapaxes(-1, -2) + np.eye(6)
    heights, widths = random.uniform(0.2, 1.0, 3), random.uniform(0.2, 1.0, 2)
    lines = np.concatenate([[0.0], np.cumsum(heights)]), np.concatenate([[0.0], np.cumsum(widths)])
    other = scikit_fem_stiffness(lines, stiffness)
    own = homogenise(heights, widths, stiffness.reshape(-1, 6, 6), np.zeros((6, 6)), 1).stiffness
    assert np.abs(own - other).max() < 1e-12 * other.max()


def test_homocompy_gives_the_same_mori_tanaka() -> None:
    pytest.importorskip("homocompy")
    fibre, matrix = (engineering_constants(one) for one in PHASES)
    other = homocompy_stiffness("mori_tanaka", FRACTION, fibre, matrix)
    own = mori_tanaka(*cell_of(2, FRACTION), matrix=3).stiffness
    assert np.abs(own - other).max() < 1e-11 * other.max()


def test_rows_state_signed_errors_front_and_peers_and_are_drawn(tmp_path: Path) -> None:
    some = ("GMC 2x2", "Mori-Tanaka", "HomoComPy, Chamis", "elements along a round fibre, refinement 1")
    chosen = sorted((one for one in methods(FRACTION) if one.label in some), key=lambda one: some.index(one.label))
    rows = measure(chosen, reference(FRACTION)[0])
    errors = {row.label: row.figures for row in rows}
    assert errors["GMC 2x2"]["E22"] == pytest.approx(15003.7323 / 16398.27 - 1.0, abs=1e-5)  # Tables 6.1, 6.2; ours
    best = rows[-1]
    assert best.error is not None and best.error < 1e-3
    assert all(best.figures[f"front_{name}"] for name in MODULI)
    fastest = min(rows, key=lambda row: row.seconds)
    assert all(fastest.figures[f"front_{name}"] for name in MODULI)
    assert all(row.peer == row.label.startswith("HomoComPy") for row in rows)
    draw_cost(rows, "title", tmp_path / "cost.png")
    assert (tmp_path / "cost.png").stat().st_size > 1000


def test_errors_over_the_fraction_are_drawn(tmp_path: Path) -> None:
    fractions = np.array([0.3])
    against_round, against_cell = fraction_errors(fractions)
    assert set(against_cell) == {"GMC 2x2", "GMC 7x7", "GMC 26x26"}
    for label, values in against_round.items():
        assert values.shape == (1, 3), label
    exact = reference(0.3)[0]
    plain = moduli(mori_tanaka(*cell_of(2, 0.3), matrix=3).stiffness)
    assert against_round["Mori-Tanaka"][0] == pytest.approx(plain / exact - 1.0, abs=1e-4)
    draw_fractions(fractions, against_round, against_cell, "title", tmp_path / "fractions.png")
    assert (tmp_path / "fractions.png").stat().st_size > 1000
