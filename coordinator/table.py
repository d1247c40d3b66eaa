"""The base of all tables of a scene file, and the kinds of values that several of them hold."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Self

from pydantic import BaseModel, ConfigDict, Field, PrivateAttr

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


class SceneTable(Table):
    """A whole scene file, with what is known of the file itself."""

    _name: str = PrivateAttr(default="")
    _folder: Path = PrivateAttr(default=Path())
    _text: str = PrivateAttr(default="")
    _overrides: tuple[str, ...] = PrivateAttr(default=())

    @property
    def name(self) -> str:
        """Name of the scene: its file name without ending."""
        return self._name

    @property
    def folder(self) -> Path:
        """Folder of the scene file, from which names of files in it count."""
        return self._folder

    @property
    def text(self) -> str:
        """Text of the scene file, without overrides."""
        return self._text

    @property
    def overrides(self) -> tuple[str, ...]:
        """Overrides as they were given, ``key.sub=value``."""
        return self._overrides

    def of_file(self, name: str, text: str = "", overrides: Sequence[str] = (), folder: Path | None = None) -> Self:
        """Note where the scene comes from, and return it."""
        self._name, self._text, self._overrides = name, text, tuple(overrides)
        if folder is not None:
            self._folder = folder
        return self
