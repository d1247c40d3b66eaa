"""Options of commands that are quantities with a unit, such as ``"52 angstrom"``, read as SI numbers.

The same rule as in scene files: a bare number where a unit is due is an error. pint takes 0.3 s to import, so it is
imported at the first conversion.
"""

from __future__ import annotations

import math
import re
from functools import cache
from typing import Any, Final

import click

#: SI unit and an example for each dimension that a command knows.
DIMENSIONS: Final[dict[str, tuple[str, str]]] = {
    "length": ("m", "52 angstrom"),
    "temperature": ("K", "300 K"),
    "time": ("s", "0.5 fs"),
    "pressure": ("Pa", "1 atm"),
    "rate": ("1/s", "0.1 1/ns"),
    "density": ("kg/m^3", "1.2 g/cm^3"),
}
_NUMBER_AND_UNIT = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(.*?)\s*")


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
        A key of `DIMENSIONS`.
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
        unit, example = DIMENSIONS[self.name]
        wanted = f'it must be a {self.name} with its unit, such as "{example}"'
        match = _NUMBER_AND_UNIT.fullmatch(str(value))
        if match is None or not match.group(2):
            self.fail(f"{value!r}: {wanted}", param, ctx)
        try:
            number = float(_registry().Quantity(float(match.group(1)), match.group(2)).to(unit).magnitude)
        except Exception:  # pint raises its own kinds, ValueError, AttributeError and tokenizer errors alike
            hint = " (A is ampere; write angstrom)" if re.search(r"\bA\b", match.group(2)) else ""
            self.fail(f"{value!r}: the unit {match.group(2)!r} is none of {self.name}{hint}; {wanted}", param, ctx)
        if not (math.isfinite(number) and number > self._least):
            limit = "finite" if self._least == -math.inf else f"greater than {self._least:g} {unit}"
            self.fail(f"{value!r}: it must be {limit}", param, ctx)
        return Value(number, str(value))


@cache
def _registry() -> Any:
    import pint

    # Temperatures are on the absolute scale here; "25 degC" then converts as people mean it.
    return pint.UnitRegistry(autoconvert_offset_to_baseunit=True)
