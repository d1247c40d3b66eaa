"""A table of a TOML file, read strictly: units where they are due, no unknown keys, every mistake in one go."""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal

from protocol.quantities import to_si, wanted

Sign = Literal["any", "zero", "positive"]


class Mistakes(ValueError):
    """Mistakes in a file.

    Parameters
    ----------
    lines : sequence of str
        One per mistake, ``FILE: table.key = value: what is allowed``.
    """

    def __init__(self, lines: Sequence[str]) -> None:
        super().__init__("\n".join(lines))
        self.lines = tuple(lines)


class Table:
    """A table, of which each key is taken once; what is wrong is added to a list, and read as None.

    Parameters
    ----------
    file : str
        Name of the file in messages.
    where : str
        Path of the table in the file, empty for the whole.
    values : mapping
        As the TOML reader gave it.
    mistakes : list of str
        Shared by all tables of a file.
    """

    def __init__(self, file: str, where: str, values: Mapping[str, Any], mistakes: list[str]) -> None:
        self.file, self.where, self.values, self.mistakes = file, where, values, mistakes
        self._known: list[str] = []

    def __contains__(self, key: str) -> bool:
        return key in self.values

    def refuse(self, key: str, allowed: str) -> None:
        """Note a mistake at a key, or at the table itself where `key` is empty."""
        path = ".".join(part for part in (self.where, key) if part)
        value: Any = self.values
        for part in key.split(".") if key else ():
            try:
                value = value[int(part)] if isinstance(value, list) else value[part]
            except (KeyError, IndexError, TypeError, ValueError):
                value = {}  # a missing one has no value to show
        shown = "" if isinstance(value, Mapping) or (value and _has_tables(value)) else f" = {_toml(value)}"
        self.mistakes.append(f"{self.file}: {path}{shown}: {allowed}")

    def quantity(self, key: str, dimension: str, sign: Sign = "positive", required: bool = True) -> float | None:
        """A quantity in SI."""
        if not self._has(key, f"it is needed, {wanted(dimension)}" if required else None):
            return None
        return self.checked_quantity(key, self.values[key], dimension, sign)

    def quantities(
        self, key: str, dimension: str, sign: Sign = "positive", required: bool = True
    ) -> list[float] | None:
        """A list of quantities in SI."""
        if not self._has(key, f'it is needed, a list such as ["{wanted(dimension)}"]' if required else None):
            return None
        entries = self.values[key]
        if not isinstance(entries, list) or not entries:
            self.refuse(key, f"must be a list, each {wanted(dimension)}")
            return None
        read = [self.checked_quantity(f"{key}.{n}", entry, dimension, sign) for n, entry in enumerate(entries)]
        return [value for value in read if value is not None] if None not in read else None

    def number(self, key: str, required: bool = True) -> float | None:
        """A finite number without a unit."""
        if not self._has(key, "it is needed, a number" if required else None):
            return None
        return self.checked_number(key, self.values[key])

    def whole(self, key: str, required: bool = True) -> int | None:
        """A whole number."""
        if not self._has(key, "it is needed, a whole number" if required else None):
            return None
        value = self.values[key]
        if isinstance(value, bool) or not isinstance(value, int):
            self.refuse(key, "must be a whole number")
            return None
        return value

    def text(self, key: str, required: bool = True) -> str | None:
        """A text that is not empty."""
        if not self._has(key, "it is needed, a text" if required else None):
            return None
        value = self.values[key]
        if not isinstance(value, str) or not value:
            self.refuse(key, "must be a text")
            return None
        return value

    def choice(self, key: str, choices: Sequence[str], required: bool = True) -> str | None:
        """One of some words."""
        if not self._has(key, f"it is needed, one of {', '.join(choices)}" if required else None):
            return None
        value = self.values[key]
        if value not in choices:
            near = difflib.get_close_matches(str(value), choices, 1, 0.6)
            self.refuse(key, f"must be one of {', '.join(choices)}" + (f"; did you mean {near[0]}?" if near else ""))
            return None
        return str(value)

    def truth(self, key: str) -> bool:
        """Whether a key is true; false where it is missing."""
        if not self._has(key, None):
            return False
        value = self.values[key]
        if not isinstance(value, bool):
            self.refuse(key, "must be true or false")
            return False
        return value

    def raw(self, key: str) -> Any:
        """A value as it is, None where there is none; the caller checks it."""
        self._known.append(key)
        return self.values.get(key)

    def table(self, key: str, required: bool = True) -> Table | None:
        """A table inside."""
        if not self._has(key, "it is needed, a table" if required else None):
            return None
        value = self.values[key]
        if not isinstance(value, Mapping):
            self.refuse(key, "must be a table")
            return None
        return Table(self.file, self._path(key), value, self.mistakes)

    def tables(self, key: str) -> list[Table]:
        """A list of tables inside; empty where the key is missing."""
        if not self._has(key, None):
            return []
        value = self.values[key]
        if not isinstance(value, list) or not all(isinstance(item, Mapping) for item in value):
            self.refuse(key, f"must be a list of tables, [[{self._path(key)}]]")
            return []
        return [Table(self.file, self._path(f"{key}.{n}"), item, self.mistakes) for n, item in enumerate(value)]

    def finish(self) -> None:
        """Note every key that nobody took."""
        for key in self.values:
            if key not in self._known:
                near = difflib.get_close_matches(key, self._known, 1, 0.6)
                known = list(dict.fromkeys(self._known))
                hint = f"did you mean {near[0]}?" if near else f"known here: {', '.join(known)}"
                self.refuse(key, f"is no key of this table; {hint}")

    def _has(self, key: str, needed: str | None) -> bool:
        self._known.append(key)
        if key in self.values:
            return True
        if needed is not None:
            self.refuse(key, f"is missing; {needed}")
        return False

    def _path(self, key: str) -> str:
        return f"{self.where}.{key}" if self.where else key

    def checked_quantity(self, key: str, value: Any, dimension: str, sign: Sign = "positive") -> float | None:
        """A quantity that was taken from the table already, such as an item of a list."""
        if not isinstance(value, str):
            bare = "; a bare number has no unit" if _is_number(value) else ""
            self.refuse(key, f"must be {wanted(dimension)}{bare}")
            return None
        try:
            number = to_si(value, dimension)
        except ValueError as error:
            self.refuse(key, str(error))
            return None
        if sign == "positive" and number <= 0.0:
            self.refuse(key, "must be greater than 0")
            return None
        if sign == "zero" and number < 0.0:
            self.refuse(key, "must be 0 or greater")
            return None
        return number

    def checked_number(self, key: str, value: Any) -> float | None:
        """A number that was taken from the table already."""
        if not _is_number(value) or not math.isfinite(value):
            self.refuse(key, "must be a finite number without a unit")
            return None
        return float(value)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _has_tables(value: Any) -> bool:
    return isinstance(value, list) and any(isinstance(item, Mapping) for item in value)


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        text = "true" if value else "false"
    elif isinstance(value, str):
        text = f'"{value}"'
    elif isinstance(value, list):
        text = "[" + ", ".join(_toml(item) for item in value) + "]"
    else:
        text = str(value)
    return text if len(text) <= 80 else text[:77] + "..."
