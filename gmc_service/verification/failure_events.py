"""Failure events of the dissertation's neat composite, fibre strain driven."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from gmc_service.cell import Cell
from gmc_service.evaluation import Evaluator
from gmc_service.failure_path import failure_path
from gmc_service.failure_plots import draw_failure_path
from gmc_service.mask_table import unpack_mask
from gmc_service.material import Failure, constant_material, isotropic_stiffness
from protocol.verification import Case, Check

#: Strains 11 at which matrix, fibre and the last matrix subcell fail, all other strains held at zero.
REFERENCE: Final = (0.0149158383, 0.019, 0.0400444)
_FAILED: Final = ("the two matrix subcells beside the fibre", "the fibre", "the matrix subcell at the corner")
_MASKS: Final = ((1, 2), (0, 1, 2), (0, 1, 2, 3))
_STRENGTH: Final = 118.67e6


def neat_composite() -> Cell:
    """IM7 in neat EPON 862 (Tables 6.1 and 6.2), fibre fraction 0.6, in four subcells, with allowables."""
    none = np.inf
    limit, shear = (_STRENGTH,) * 3, (_STRENGTH / np.sqrt(3.0),) * 3
    fibre = constant_material(
        "IM7", isotropic_stiffness(276e9, 0.33), failures=(Failure("maximum_strain", tension=(0.019, none, none)),)
    )
    matrix = constant_material(
        "EPON 862", isotropic_stiffness(2.963e9, 0.36), failures=(Failure("maximum_stress", limit, shear=shear),)
    )
    side = float(np.sqrt(0.6))
    sizes = np.array([side, 1.0 - side])
    return Cell(sizes, sizes, np.array([[0, 1], [1, 1]]), (fibre, matrix), knock_down=1e-4)


def _events(folder: Path) -> list[Check]:
    cell = neat_composite()
    path = failure_path(cell, "eps11", 0.05)
    draw_failure_path(cell, path, "eps11", folder / "failure_events.png", "IM7 / EPON 862 neat, only strain 11 driven")
    source = "reference of the issue, by a program of its own: only strain 11 driven, the others held"
    checks = [
        Check(f"strain at which {what} fail", event.strain, wanted, 1e-6, source)
        for what, event, wanted in zip(_FAILED, path.events, REFERENCE, strict=True)
    ]
    # The evaluation of points, which takes strains as they come, must fail the same subcells at these strains.
    evaluator = Evaluator(cell)
    for event, subcells in zip(path.events, _MASKS, strict=True):
        wrong = 0
        for factor, wanted in ((1.0 - 1e-8, False), (1.0, True)):
            strain = np.array([[event.strain * factor, 0.0, 0.0, 0.0, 0.0, 0.0]])
            before = np.zeros((1, 1), np.uint8)
            for earlier in path.events:
                if earlier.strain < event.strain:  # loaded through the events, since a jump fails more at once
                    at = np.array([[earlier.strain, 0.0, 0.0, 0.0, 0.0, 0.0]])
                    before = evaluator.evaluate(at, 300.0, before, np.zeros((1, 0))).failed
            failed = evaluator.evaluate(strain, 300.0, before, np.zeros((1, 0))).failed[0]
            there = tuple(np.flatnonzero(unpack_mask(failed, 4))) == subcells
            wrong += there != wanted
        checks.append(
            Check(f"wrong masks at and just below strain {event.strain:.6g}", wrong, 0.0, 0.0, "the events themselves")
        )
    return checks


CASES: list[Case] = [
    Case("gmc", "failure-events", "subcells of a 2x2 composite fail under strain along the fibre", _events)
]
