"""Options of commands that are quantities with a unit, such as ``"52 angstrom"``, read as SI numbers.

The same rule as in scene files: a bare number where a unit is due is an error.
"""

from __future__ import annotations

import math
from typing import Any

import click

from protocol.quantities import DIMENSIONS, to_si


class Value(float):
    """A number in SI that remembers how it was written, so that a command can be repeated.

    Attributes
    ----------
    text : str
        As the user gave it.
    """

    text: str

    def __new__(cls, number: float, text: str) -> Value:
        value = super().__new__(cls, number)
        value.text = text
        return value

    def __str__(self) -> str:
        return self.text


class Quantity(click.ParamType):
    """Type of an option that is a quantity.

    Parameters
    ----------
    dimension : str
        A key of `protocol.quantities.DIMENSIONS`.
    least : float
        The value must be greater than this, in SI; ``-inf`` for any.
    """

    def __init__(self, dimension: str, least: float = -math.inf) -> None:
        self.name = dimension
        self._least = least

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Value:
        """Number in SI of a text with a unit; a mistake is told with the name of the option."""
        if isinstance(value, Value):
            return value
        try:
            number = to_si(str(value), self.name)
        except ValueError as error:
            self.fail(f"{value!r}: {error}", param, ctx)
        if not number > self._least:
            self.fail(f"{value!r}: it must be greater than {self._least:g} {DIMENSIONS[self.name][0]}", param, ctx)
        return Value(number, str(value))
