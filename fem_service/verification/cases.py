"""The list of cases of this package for `scalebridge verify`."""

from __future__ import annotations

from fem_service.verification import cohesive_beams, elements, laminate_stiffness, open_hole_elastic
from protocol.verification import Case

CASES: list[Case] = [
    *elements.CASES,
    *open_hole_elastic.CASES,
    *laminate_stiffness.CASES,
    *cohesive_beams.CASES,
]
