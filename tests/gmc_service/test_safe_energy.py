"""Below the safe energy nothing fails; at it, something does."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gmc_service.cell import Cell
from gmc_service.evaluation import Evaluator
from gmc_service.material import Criterion, Failure, Plasticity, constant_material, isotropic_stiffness
from gmc_service.safe_energy import safe_energy

INF = np.inf


def cell_of(*failures: Failure, **more: object) -> Cell:
    side = 0.6**0.5
    sizes = np.array([side, 1.0 - side])
    fibre = constant_material("fibre", isotropic_stiffness(276e9, 0.33), failures=())
    matrix = dataclasses.replace(
        constant_material("matrix", isotropic_stiffness(2.963e9, 0.36), (5e-5,) * 3, failures=failures), **more
    )
    return Cell(sizes, sizes, np.array([[0, 1], [1, 1]]), (fibre, matrix))


FAILURES: dict[str, Failure] = {
    "maximum_stress": Failure("maximum_stress", (100e6, 80e6, 80e6), (150e6, INF, 200e6), (60e6, 50e6, INF)),
    "maximum_strain": Failure("maximum_strain", (0.03, 0.02, 0.02), (INF, 0.04, 0.04), (0.03, INF, 0.05)),
    "tsai_hill": Failure("tsai_hill", (100e6, 80e6, 80e6), (150e6, 120e6, 120e6), (60e6, 50e6, 50e6)),
    "hashin": Failure("hashin", (100e6, 80e6, 80e6), (150e6, 120e6, 120e6), (60e6, 50e6, 50e6)),
}


def new_failures(cell: Cell, strain: np.ndarray) -> np.ndarray:
    """Whether each strain, shape (points, 6), makes a subcell fail."""
    evaluator = Evaluator(cell)
    points = len(strain)
    answer = evaluator.evaluate(
        strain,
        300.0,
        np.zeros((points, evaluator.failed_bytes), np.uint8),
        np.zeros((points, evaluator.history_values)),
    )
    return answer.failed.any(axis=1)


@pytest.mark.parametrize("criterion", FAILURES)
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=10, deadline=None)
def test_nothing_fails_below(criterion: Criterion, seed: int) -> None:
    cell = cell_of(FAILURES[criterion])
    energy = safe_energy(cell, "gmc", 300.0)
    stiffness = Evaluator(cell).homogenised(300.0, np.zeros(1, np.uint8)).stiffness
    strain = np.random.default_rng(seed).normal(size=(2000, 6))
    strain *= np.sqrt(energy * (1 - 1e-9) / (0.5 * np.einsum("pi,ij,pj->p", strain, stiffness, strain)))[:, None]
    assert not new_failures(cell, strain).any()


@pytest.mark.parametrize("criterion", ["maximum_stress", "maximum_strain"])
def test_something_fails_just_above(criterion: str) -> None:
    cell = cell_of(FAILURES[criterion])
    energy = safe_energy(cell, "gmc", 300.0)
    found = Evaluator(cell).homogenised(300.0, np.zeros(1, np.uint8))
    # Of all strains with this energy, those that load one component of one subcell most.
    stiffness = cell.stiffness_at(300.0)
    rows = found.concentration if criterion == "maximum_strain" else stiffness @ found.concentration
    strain = np.linalg.solve(found.stiffness, rows[1:].reshape(-1, 6).T).T
    strain = np.concatenate([strain, -strain])
    strain *= np.sqrt(energy * (1 + 1e-6) / (0.5 * np.einsum("pi,ij,pj->p", strain, found.stiffness, strain)))[:, None]
    assert new_failures(cell, strain).any()


@pytest.mark.parametrize("criterion", ["tsai_hill", "hashin"])
def test_bound_of_forms_with_signs_is_of_use(criterion: str) -> None:
    cell = cell_of(FAILURES[criterion])
    energy = safe_energy(cell, "gmc", 300.0)
    stiffness = Evaluator(cell).homogenised(300.0, np.zeros(1, np.uint8)).stiffness
    strain = np.random.default_rng(1).normal(size=(20000, 6))
    strain = np.linalg.solve(np.linalg.cholesky(stiffness).T, strain.T).T
    strain *= np.sqrt(9.0 * energy / (0.5 * np.einsum("pi,ij,pj->p", strain, stiffness, strain)))[:, None]
    assert new_failures(cell, strain).any()  # at three times the strain some fail already


def test_yielding_counts() -> None:
    cell = cell_of(plasticity=Plasticity(50e6))
    energy = safe_energy(cell, "gmc", 300.0)
    evaluator = Evaluator(cell)
    stiffness = evaluator.homogenised(300.0, np.zeros(1, np.uint8)).stiffness
    strain = np.random.default_rng(2).normal(size=(500, 6))
    strain *= np.sqrt(energy * (1 - 1e-9) / (0.5 * np.einsum("pi,ij,pj->p", strain, stiffness, strain)))[:, None]
    answer = evaluator.evaluate(strain, 300.0, np.zeros((500, 1), np.uint8), np.zeros((500, evaluator.history_values)))
    assert not answer.history.any()


def test_without_allowables_and_with_stress_of_its_own() -> None:
    assert safe_energy(cell_of(), "gmc", 300.0) == np.inf
    assert safe_energy(cell_of(FAILURES["maximum_stress"]), "gmc", 350.0) == 0.0
