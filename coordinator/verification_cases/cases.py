"""All cases `coupling/...` of `scalebridge verify`."""

from __future__ import annotations

from coordinator.verification_cases import full_atomistic, k_field, patch, phonon, stability, swap, theory_1d
from protocol.verification import Case

CASES: list[Case] = [
    case for module in (theory_1d, patch, k_field, phonon, stability, swap, full_atomistic) for case in module.CASES
]
