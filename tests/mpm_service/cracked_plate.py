"""A plate with a crack, and an overlap with atoms in its middle, behind the service; for tests of cracks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from mpm_service.service import MaterialPointService, make_service
from protocol import continuum as c
from protocol.messages import FieldsRequest

MM = 1e-3
SPEED = 0.4


def advance(service: MaterialPointService, steps: int) -> c.ContinuumAdvanced:
    return service.advance(c.ContinuumAdvance(steps=steps))


def extend(service: MaterialPointService, *points: tuple[float, float], crack: int = 0, end: int = 1) -> Any:
    return service.extend_crack(c.CrackExtension.model_validate({"crack": crack, "end": end, "points": list(points)}))


def field(service: MaterialPointService, name: str) -> np.ndarray:
    return service.fields(FieldsRequest(names=[name])).fields[name]


def plate(**changes: Any) -> c.ContinuumConfigure:
    """A plate of 30 x 20 cells of 1 mm, its top pulled up; a hole of 8 x 6 and a ring 2 wide in its middle."""
    values: dict[str, Any] = {
        "assumption": "plane_strain", "thickness": MM,
        "body": c.Rectangle(lower=(-15 * MM, -10 * MM), upper=(15 * MM, 10 * MM)),
        "cell_size": MM, "points_per_cell": 2,
        "material": c.IsotropicMaterial(young=2.5e9, poisson=0.3, density=1200.0),
        "overlap": c.Overlap(
            inner=c.Rectangle(lower=(-4 * MM, -3 * MM), upper=(4 * MM, 3 * MM)),
            outer=c.Rectangle(lower=(-6 * MM, -5 * MM), upper=(6 * MM, 5 * MM)),
            weight=0.5,
        ),
        "edges": [c.EdgeVelocity(edge="top", component=1, times=[0.0], velocities=[SPEED])],
        "cracks": [c.CrackLine(points=[(-17 * MM, 0.2 * MM), (-11.3 * MM, 0.2 * MM)])],
        "time_step": 2.5e-7,
    }  # fmt: skip
    return c.ContinuumConfigure.model_validate({**values, **changes})


def service_of(**changes: Any) -> MaterialPointService:
    service = make_service(Path())
    service.configure(plate(**changes))
    return service
