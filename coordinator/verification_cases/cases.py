"""All cases `coupling/...` of `scalebridge verify`, and `structure/material-points`."""

from __future__ import annotations

from coordinator.verification_cases import (
    energy_books,
    full_atomistic,
    k_field,
    laminate_points,
    momentum,
    patch,
    phonon,
    rigid,
    stability,
    swap,
    theory_1d,
    wave,
)
from protocol.verification import Case

CASES: list[Case] = [
    case
    for module in (
        theory_1d, patch, rigid, wave, phonon, energy_books, momentum, k_field, stability, full_atomistic, swap,
        laminate_points,
    )
    for case in module.CASES
]  # fmt: skip
