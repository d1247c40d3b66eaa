"""The list of cases of this package for `scalebridge verify`."""

from __future__ import annotations

from gmc_service.verification import (
    effective_constants,
    failure_events,
    finite_elements,
    point_speed,
    speed_service,
    stability,
    tangent_speed,
)
from protocol.verification import Case

CASES: list[Case] = [
    *effective_constants.CASES,
    *finite_elements.CASES,
    *stability.CASES,
    *tangent_speed.CASES,
    *failure_events.CASES,
    *point_speed.CASES,
    *speed_service.CASES,
]
