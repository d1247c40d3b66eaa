"""Layup notation: ``[45/0/-45/90]2s``.

    layup   := "[" item ("/" item)* "]" repeats? "s"?
    item    := angle ("_" count)?          angle in degrees, also "+-45" or "±45": +45 then -45
             | layup

The plies are counted from the lowest (smallest z) up. ``2`` repeats what is in brackets, ``s`` mirrors it afterwards:
``[0/90]2s`` is 0 90 0 90 | 90 0 90 0.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final

_ANGLE: Final = re.compile(r"(\+-|±|[-+]?)(\d+(?:\.\d+)?)(?:_(\d+))?")
_TAIL: Final = re.compile(r"(\d*)(s?)", re.IGNORECASE)
_MOST: Final = 10_000  # plies; more is a slip of the pen


@dataclass(frozen=True)
class Layup:
    """Plies of a laminate.

    Attributes
    ----------
    text : str
        As written.
    angles : tuple of float
        Degrees from x towards y, of each ply from the lowest up.
    """

    text: str
    angles: tuple[float, ...]

    @property
    def is_symmetric(self) -> bool:
        """Whether the upper half mirrors the lower one."""
        return self.angles == self.angles[::-1]

    def half(self) -> tuple[float, ...]:
        """Angles of the plies below the middle plane, from the lowest up, of a symmetric layup of an even count.

        Raises
        ------
        ValueError
            If the layup is not symmetric, or a ply lies across the middle plane.
        """
        if not self.is_symmetric:
            raise ValueError(f"layup is {self.text!r}; only a symmetric one has a plane of symmetry")
        if len(self.angles) % 2:
            raise ValueError(f"layup is {self.text!r}; its middle ply lies across the plane of symmetry")
        return self.angles[: len(self.angles) // 2]


def read_layup(text: str) -> Layup:
    """Read layup notation.

    Raises
    ------
    ValueError
        If the text is no layup. The message says at which character, and what is allowed there.
    """
    reader = _Reader(text)
    angles = reader.brackets()
    reader.blanks()
    if reader.place < len(text):
        raise reader.problem("the end, or a number of repeats and s before it")
    return Layup(text, tuple(angles))


class _Reader:
    def __init__(self, text: str) -> None:
        self.text = text
        self.place = 0

    def blanks(self) -> None:
        while self.place < len(self.text) and self.text[self.place].isspace():
            self.place += 1

    def problem(self, wanted: str) -> ValueError:
        found = repr(self.text[self.place]) if self.place < len(self.text) else "the end"
        return ValueError(
            f"layup is {self.text!r}; character {self.place + 1} is {found} where {wanted} must be, "
            "such as in [45/0/-45/90]2s"
        )

    def take(self, character: str) -> bool:
        self.blanks()
        if self.place < len(self.text) and self.text[self.place] == character:
            self.place += 1
            return True
        return False

    def brackets(self) -> list[float]:
        if not self.take("["):
            raise self.problem("[")
        angles = self.item()
        while self.take("/"):
            angles += self.item()
        if not self.take("]"):
            raise self.problem("/ or ]")
        tail = _TAIL.match(self.text, self.place)
        assert tail is not None  # it may be empty
        self.place = tail.end()
        if tail[1]:
            angles = self.repeated(angles, tail[1])
        if tail[2]:
            angles = angles + angles[::-1]
        if len(angles) > _MOST:
            raise ValueError(f"layup is {self.text!r}; it has more plies than {_MOST}")
        return angles

    def item(self) -> list[float]:
        self.blanks()
        if self.place < len(self.text) and self.text[self.place] == "[":
            return self.brackets()
        match = _ANGLE.match(self.text, self.place)
        if match is None:
            raise self.problem("an angle in degrees or [")
        size = float(match[2])
        if size > 90.0:
            raise ValueError(f"layup is {self.text!r}; it holds the angle {match[0]}, allowed is -90 to 90 degrees")
        self.place = match.end()
        angles = [size, -size] if match[1] in ("+-", "±") else [-size if match[1] == "-" and size else size]
        return self.repeated(angles, match[3]) if match[3] else angles

    def repeated(self, angles: list[float], count: str) -> list[float]:
        if not 1 <= int(count) <= _MOST or len(angles) * int(count) > _MOST:
            raise ValueError(f"layup is {self.text!r}; it repeats {count} times, allowed is 1 to {_MOST} plies in all")
        return angles * int(count)
