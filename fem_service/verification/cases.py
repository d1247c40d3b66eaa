"""The list of cases of this package for `scalebridge verify`."""

from __future__ import annotations

from fem_service.verification import (
    calculix,
    cohesive_beams,
    elements,
    laminate_stiffness,
    oht_mesh,
    oht_quasi_isotropic,
    oht_size,
    oht_speed,
    open_hole_elastic,
)
from protocol.verification import Case

CASES: list[Case] = [
    *elements.CASES,
    *open_hole_elastic.CASES,
    *laminate_stiffness.CASES,
    *cohesive_beams.CASES,
    *calculix.CASES,
    *oht_mesh.CASES,
    *oht_quasi_isotropic.CASES,
    *oht_size.CASES,
    *oht_speed.CASES,
]
