"""Announces the material point backend of the continuum role; cheap to import."""

from __future__ import annotations

from protocol.backend import Backend

BACKEND = Backend(
    name="mpm_service",
    role="continuum",
    summary="material point method, plane stress and plane strain, compiled by numba",
    factory="mpm_service.service:make_service",
    # Measured on one core of a common server: uGIMP, MUSL.
    seconds_per_unit_step={"": 2.0e-7},
)
