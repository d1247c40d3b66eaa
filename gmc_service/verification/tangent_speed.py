"""How many distinct tangents of damaged cells one core makes in a second."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Final

import numpy as np

from gmc_service.gmc_dense import homogenise
from gmc_service.gmc_reduced import effective_stiffness_many
from gmc_service.material import isotropic_stiffness
from protocol.verification import Case, Check

#: Side of the cell, distinct states in one batch, and tangents per second to reach.
_SIZES: Final = ((7, 20000, 2e5), (26, 2000, 1.5e4))
_BATCHES: Final = 7


def _speed(folder: Path) -> list[Check]:
    random = np.random.default_rng(1)
    fibre, matrix = isotropic_stiffness(276e9, 0.33), isotropic_stiffness(2.963e9, 0.36)
    table = np.array([fibre, matrix, 1e-4 * fibre, 1e-4 * matrix])
    checks = []
    for side, states, wanted in _SIZES:
        # A round fibre in the middle; in each state another tenth of the subcells has failed.
        place = (np.arange(side) + 0.5) / side - 0.5
        phase = (np.hypot(*np.meshgrid(place, place)) > np.sqrt(0.6 / np.pi)).astype(np.int64).reshape(-1)
        choices = np.ascontiguousarray(phase + 2 * (random.random((states, side * side)) < 0.1))
        sizes = np.ones(side)
        made = effective_stiffness_many(sizes, sizes, table, choices[:2])  # compiles
        rates = []
        for _ in range(_BATCHES):
            began = time.thread_time()  # of this core, however many others want it
            made = effective_stiffness_many(sizes, sizes, table, choices)
            rates.append(states / (time.thread_time() - began))
        rate = float(np.median(rates))
        some = 0 if side > 7 else 3
        worst = 0.0
        for state in range(some):
            dense = homogenise(sizes, sizes, table[choices[state]], np.zeros((side * side, 6))).stiffness
            worst = max(worst, float(np.abs(made[state] - dense).max() / np.abs(dense).max()))
        checks.append(
            # What falls short of the rate is the error of 1 / rate, which a limit bounds from above.
            Check(
                f"seconds per distinct tangent, {side}x{side} ({rate:.3g} per second)",
                1.0 / rate,
                1.0 / wanted,
                0.0,
                f"at least {wanted:g} per second and core",
                "s",
                at_most=True,
            )
        )
        if some:
            source = "dense formulation of Paley and Aboudi"
            checks.append(Check(f"their error, {side}x{side}", worst, 0.0, 1e-10, source))
    return checks


CASES: list[Case] = [Case("gmc", "speed-tangents", "new tangents of damaged 7x7 and 26x26 cells", _speed)]
