"""Announces the backend of the structure role; cheap to import."""

from __future__ import annotations

from protocol.backend import Backend

BACKEND = Backend(
    name="fem_service",
    role="structure",
    summary="finite elements of laminates with cohesive layers",
    factory="fem_service.service:make_service",
    plane_reader="fem_service.plane_mesh_file:read_plane_mesh",
    deck_writer="fem_service.problem:deck_of",
    default=True,
)
