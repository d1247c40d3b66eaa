"""Announces the backend of the structure role; cheap to import."""

from __future__ import annotations

from protocol.backend import Backend

BACKEND = Backend(
    name="fem_service",
    role="structure",
    summary="finite elements of laminates with cohesive layers",
    factory="fem_service.service:make_service",
    default=True,
)
