"""Laminates as a client asks for them."""

from __future__ import annotations

from typing import Any

import numpy as np

from protocol import micromechanics as m
from protocol import structure as s
from protocol.conformance_micromechanics import micromechanics_cell


def strong_cell() -> m.RegisterCell:
    """The kit's cell in which nothing can fail."""
    cell = micromechanics_cell()
    return cell.model_copy(update={"materials": [one.model_copy(update={"failures": []}) for one in cell.materials]})


def request(cells: str, cell: m.RegisterCell | None = None, **changes: Any) -> s.StructureConfigure:
    """A cross-ply with a hole, one eighth of it, 24 bricks."""
    cell = cell or micromechanics_cell()
    values: dict[str, Any] = {
        "length": 8e-3, "width": 8e-3, "hole_diameter": 3e-3, "angles": [0.0, np.pi / 2], "ply_thickness": 2.5e-4,
        "quarter": True, "lower_half": True, "mesh": s.PlateMesh(around=4, radial=3, growth=3.0),
        "temperature": 300.0, "final_strain": 1.5e-2, "increments": s.Increments(first=0.1, most=0.1),
        "micromechanics": cells,
    }  # fmt: skip
    fields = {name: getattr(cell, name) for name in m.RegisterCell.model_fields}
    return s.StructureConfigure(**fields, **{**values, **changes})
