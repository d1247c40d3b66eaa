"""The list of cases of this package for `scalebridge verify`."""

from __future__ import annotations

from md_service.verification import (
    anchors_cases,
    checkpoint,
    copper_elastic,
    energy_drift,
    engines,
    epoxy,
    face_energy,
    graphene_elastic,
    k_field_j,
    overhead,
    standard_error,
)
from protocol.verification import Case

CASES: list[Case] = [
    *anchors_cases.CASES,
    *energy_drift.CASES,
    *graphene_elastic.CASES,
    *copper_elastic.CASES,
    *k_field_j.CASES,
    *standard_error.CASES,
    *checkpoint.CASES,
    *engines.CASES,
    *epoxy.CASES,
    *face_energy.CASES,
    *overhead.CASES,
]
