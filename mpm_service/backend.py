"""Announces the material point backends of the continuum role; cheap to import."""

from __future__ import annotations

from protocol.backend import Backend

BACKEND = Backend(
    name="mpm_service",
    role="continuum",
    summary="material point method, plane stress and plane strain, compiled by numba",
    factory="mpm_service.service:make_service",
    # Measured on one core of a common server: uGIMP, MUSL, FMPM(2).
    seconds_per_unit_step={"": 2.2e-7},
    default=True,
)
REFERENCE = Backend(
    name="reference",
    role="continuum",
    summary="the same method in plain numpy: short, slow, to hold the compiled one against",
    factory="mpm_service.service:make_reference_service",
    seconds_per_unit_step={"": 6e-6},
)
