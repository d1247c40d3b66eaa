"""All cases `coupling/...` of `scalebridge verify`."""

from __future__ import annotations

from coordinator.verification_cases import full_atomistic, k_field, patch, stability, theory_1d
from protocol.verification import Case

CASES: list[Case] = [
    case for module in (theory_1d, patch, k_field, stability, full_atomistic) for case in module.CASES
]
