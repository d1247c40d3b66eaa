"""A material of the role `continuum` with a microstructure behind it: plies whose cell another service answers for."""

from __future__ import annotations

from typing import ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from protocol.messages import Finite, Natural, NonNegative, Part, Positive, wrong
from protocol.micromechanics import CellMaterial, RegisterCell
from protocol.version import Version


class CellDefinition(Part):
    """A repeating unit cell inside another message; fields mean what they do in `register` of `micromechanics`."""

    added_in: ClassVar[Version] = Version(1, 5)

    heights: list[Positive] = Field(min_length=1, description="[m] extent of each row along axis 2")
    widths: list[Positive] = Field(min_length=1, description="[m] extent of each column along axis 3")
    phase: list[list[Natural]] = Field(description="material of each subcell, a list for each row")
    materials: list[CellMaterial] = Field(min_length=1, description="constituents")
    stress_free_temperature: NonNegative = Field(default=300.0, description="[K] without stress in the unloaded cell")
    knock_down: Positive = Field(default=1e-4, le=1, description="[1] factor on the stiffness of a failed subcell")
    after_failure: Literal["gmc", "floor", "high_fidelity"] = Field(
        default="gmc", description="what answers for a cell with failed subcells, where methods differ"
    )

    @classmethod
    def of(cls, cell: RegisterCell) -> Self:
        """Return the definition that a `register` request holds."""
        arrays = {name: value.tolist() for name, value in cell.array_values().items()}
        plain = {name: getattr(cell, name) for name in RegisterCell.model_fields if name not in arrays}
        return cls(**arrays, **plain)

    @model_validator(mode="after")
    def _phases_fit(self) -> Self:
        if len(self.phase) != len(self.heights) or any(len(row) != len(self.widths) for row in self.phase):
            raise wrong("phase", f"must have {len(self.heights)} rows of {len(self.widths)}, as heights and widths say")
        largest = max(max(row) for row in self.phase)
        if largest >= len(self.materials):
            raise wrong("phase", f"holds {largest}, allowed is 0 to {len(self.materials) - 1}")
        return self

    def request(self) -> RegisterCell:
        """Return the request that registers the cell."""
        plain = {name: getattr(self, name) for name in type(self).model_fields}
        arrays = {
            "heights": np.array(self.heights),
            "widths": np.array(self.widths),
            "phase": np.array(self.phase, dtype=np.int64),
        }
        return RegisterCell(**{**plain, **arrays})


class LaminateMaterial(Part):
    """Plies of equal thickness that share the strain in the plane, with a cell at every material point and ply.

    In plane stress: each ply has no stress across the thickness. The continuum service registers the cell with the
    service at `micromechanics`, asks it for stress and failure at the cell's stress-free temperature, and carries the
    state of every ply of every point.
    """

    added_in: ClassVar[Version] = Version(1, 5)

    law: Literal["laminate"] = Field(default="laminate", description="the law")
    angles: list[Finite] = Field(min_length=1, description="[rad] of each ply from x towards y, from the lowest up")
    density: Positive = Field(description="[kg/m3] mass per volume")
    cell: CellDefinition = Field(description="cell of every ply, axis 1 along its fibres")
    micromechanics: str = Field(description="endpoint of a service of the role `micromechanics`")
