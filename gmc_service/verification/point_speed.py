"""How many points one core evaluates in a second, with failure check and cascade."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gmc_service.cell import Cell
from gmc_service.evaluation import Evaluator
from gmc_service.gmc_dense import homogenise
from gmc_service.mask_table import unpack_mask
from gmc_service.verification.failure_events import neat_composite
from protocol.verification import Case, Check

#: Standard deviation of the random strains, by the part of the points at which subcells fail in the query.
_LOADS: Final = {"few": 2.5e-3, "half": 8.5e-3, "nine in ten": 2e-2}
_POINTS: Final = 1_000_000
_QUERIES: Final = 7
_WANTED: Final = 5e6
_COMPARED: Final = 150


def _speed(folder: Path) -> list[Check]:
    random = np.random.default_rng(1)
    cell = neat_composite()
    evaluator = Evaluator(cell)
    none, history = np.zeros((_POINTS, 1), np.uint8), np.zeros((_POINTS, 0))
    checks, worst, differ = [], 0.0, 0
    for part, size in _LOADS.items():
        strain = random.normal(size=(_POINTS, 6)) * size
        answer = evaluator.evaluate(strain, 300.0, none, history)  # compiles, and fills the table
        rates = []
        for _ in range(_QUERIES):
            began = time.thread_time()  # of this core, however many others want it
            evaluator.evaluate(strain, 300.0, none, history)
            rates.append(_POINTS / (time.thread_time() - began))
        rate = float(np.median(rates))
        checks.append(
            Check(
                f"seconds per point, {part} of the points fail ({answer.failed.any(axis=1).mean():.3g}; "
                f"{rate:.3g} points per second)",
                1.0 / rate,
                1.0 / _WANTED,
                0.0,
                f"at least {_WANTED:g} points per second and core",
                "s",
                at_most=True,
            )
        )
        for point in range(_COMPARED):
            stress, failed = _slowly(cell, strain[point])
            found = answer.stress[point]
            worst = max(worst, float(np.abs(found - stress).max() / np.abs(stress).max()))
            differ += not np.array_equal(failed, unpack_mask(answer.failed[point], 4))
    source = f"dense formulation, one point at a time; {_COMPARED * len(_LOADS)} of the points"
    checks.append(Check("error of their stress", worst, 0.0, 1e-9, source))
    checks.append(Check("points with another set of failed subcells", differ, 0.0, 0.0, source))
    return checks


def _slowly(cell: Cell, strain: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Stress and failed subcells of one point of this composite, written out."""
    failed = np.zeros(4, dtype=bool)
    while True:
        stiffness = cell.stiffness_at(300.0) * np.where(failed, cell.knock_down, 1.0)[:, None, None]
        answer = homogenise(cell.heights, cell.widths, stiffness, np.zeros((4, 6)))
        local = answer.concentration @ strain
        stress = np.einsum("nij,nj->ni", stiffness, local)
        limit = cell.materials[1].failures[0]
        at_limit = (stress[:, :3].max(axis=1) >= limit.tension[0]) | (
            np.abs(stress[:, 3:]).max(axis=1) >= limit.shear[0]
        )
        at_limit[0] = local[0, 0] >= cell.materials[0].failures[0].tension[0]
        if not (at_limit & ~failed).any():
            return answer.stiffness @ strain, failed
        failed |= at_limit


CASES: list[Case] = [
    Case("gmc", "speed-points", "points of a failing 2x2 composite from a table of damage masks", _speed)
]
