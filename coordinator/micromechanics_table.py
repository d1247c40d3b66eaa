"""The table ``[micromechanics]`` of a scene: the cell at every point of a laminate, and who answers for it."""

from __future__ import annotations

from pydantic import Field

from coordinator.table import Count, Name, Table


class Micromechanics(Table):
    """The cell at every point, and who answers for it."""

    cell: Name = Field(description="cell file, relative to the scene")
    backend: Name = Field(default="gmc_service", description="of the role micromechanics")
    workers: Count = Field(default=1, description="processes that share its work")
    failure: bool = Field(default=True, description="whether subcells fail")
