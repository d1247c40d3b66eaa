"""Announces the backends of the micromechanics role; cheap to import."""

from __future__ import annotations

from protocol.backend import Backend

FRONT = "gmc_service.front:make_front"
CELL_READER = "gmc_service.service:read_definition"

BACKEND = Backend(
    name="gmc_service",
    role="micromechanics",
    summary="generalized method of cells, compiled by numba",
    factory="gmc_service.service:make_gmc",
    front=FRONT,
    cell_reader=CELL_READER,
    default=True,
)
HIGH_FIDELITY = Backend(
    name="high_fidelity",
    role="micromechanics",
    summary="periodic finite elements of the same cell",
    factory="gmc_service.service:make_high_fidelity",
    front=FRONT,
    cell_reader=CELL_READER,
)
MORI_TANAKA = Backend(
    name="mori_tanaka",
    role="micromechanics",
    summary="mean field of Mori and Tanaka",
    factory="gmc_service.service:make_mori_tanaka",
    front=FRONT,
    cell_reader=CELL_READER,
)
