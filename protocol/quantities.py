"""Quantities as text with a unit, such as ``"52 angstrom"``, converted to SI: one reader for every file and command.

A number without a unit is refused. pint takes 0.3 s to import, so it is imported at the first conversion; this module
needs nothing else outside the standard library.
"""

from __future__ import annotations

import math
import re
from functools import cache
from typing import Any, Final

#: SI unit and an example for each dimension.
DIMENSIONS: Final[dict[str, tuple[str, str]]] = {
    "length": ("m", "5 angstrom"),
    "time": ("s", "0.5 fs"),
    "temperature": ("K", "300 K"),
    "pressure": ("Pa", "800 GPa"),
    "force": ("N", "0.1 nN"),
    "stiffness": ("N/m", "20 eV/angstrom^2"),
    "rate": ("1/s", "0.1 1/ps"),
    "density": ("kg/m^3", "2.2 g/cm^3"),
    "velocity": ("m/s", "10 m/s"),
    "acceleration": ("m/s^2", "-9.81 m/s^2"),
    "angle": ("rad", "30 degree"),
    "energy": ("J", "2 mJ"),
    "energy per area": ("J/m^2", "10 J/m^2"),
    "stress intensity": ("Pa m^0.5", "2 MPa m^0.5"),
    "pressure per length": ("Pa/m", "2.71e8 MPa/mm"),
    "thermal expansion": ("1/K", "45e-6 1/K"),
}

_NUMBER_AND_UNIT = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(.*?)\s*")


@cache
def _registry() -> Any:
    import pint

    return pint.UnitRegistry()


def wanted(dimension: str) -> str:
    """Say what a quantity of a dimension looks like, with an example."""
    return f'a {dimension} with its unit, such as "{DIMENSIONS[dimension][1]}"'


def to_si(text: str, dimension: str) -> float:
    """Convert a number with a unit to SI.

    Parameters
    ----------
    text : str
        A number followed by a unit, for example ``"2.5 angstrom"``.
    dimension : str
        A key of `DIMENSIONS`.

    Returns
    -------
    float
        The value in the SI unit of the dimension.

    Raises
    ------
    ValueError
        If the text is no number with a unit, the unit is unknown, or it is of another dimension.

    Examples
    --------
    >>> to_si("2 ps", "time")
    2e-12
    """
    si_unit = DIMENSIONS[dimension][0]
    must = f"must be {wanted(dimension)}"
    match = _NUMBER_AND_UNIT.fullmatch(text)
    if match is None:
        raise ValueError(f"{must}; this is no number with a unit")
    number, unit = match.groups()
    if not unit:
        raise ValueError(f"{must}; the unit is missing")
    if unit.startswith("/"):
        unit = "1" + unit
    registry = _registry()
    try:
        parsed = registry.parse_units(unit)
    except Exception:  # pint raises its own kinds, ValueError, AttributeError and tokenizer errors alike
        raise ValueError(f"{must}; the unit {unit!r} is unknown") from None
    try:
        value = float(registry.Quantity(float(number), parsed).to(si_unit).magnitude)
    except Exception:  # DimensionalityError, and OverflowError of an absurd exponent
        hint = " (A is ampere; write angstrom)" if dimension == "length" and re.search(r"\bA\b", unit) else ""
        raise ValueError(f"{must}; the unit {unit!r} is none of {dimension}{hint}") from None
    if not math.isfinite(value):
        raise ValueError(f"{must}; the number is too large")
    return value
