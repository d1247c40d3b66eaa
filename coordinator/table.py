"""The base of all tables of a scene file, and the kinds of values that several of them hold."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Count = Annotated[int, Field(strict=True, gt=0)]
Name = Annotated[str, Field(strict=True, min_length=1)]
#: Number without unit.
Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Point = tuple[float, float]
#: Lower and upper corner of an axis-parallel rectangle, m.
Corners = tuple[Point, Point]


class Table(BaseModel):
    """A table of the scene file; unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True)
