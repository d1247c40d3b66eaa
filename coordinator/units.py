"""Quantities with units in scene files, converted to SI floats.

pint takes 0.3 s to import, so it is imported at the first conversion and never by `import`.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, Literal

from pydantic import GetCoreSchemaHandler
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

#: SI unit and an example for each dimension that a scene knows.
DIMENSIONS: dict[str, tuple[str, str]] = {
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
    "energy per area": ("J/m^2", "10 J/m^2"),
    "stress intensity": ("Pa m^0.5", "2 MPa m^0.5"),
}

_NUMBER_AND_UNIT = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(.*?)\s*")


@cache
def _registry() -> Any:
    import pint

    return pint.UnitRegistry()


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
    si_unit, example = DIMENSIONS[dimension]
    wanted = f'must be a {dimension} with its unit, such as "{example}"'
    match = _NUMBER_AND_UNIT.fullmatch(text)
    if match is None:
        raise ValueError(f"{wanted}; this is no number with a unit")
    number, unit = match.groups()
    if not unit:
        raise ValueError(f"{wanted}; the unit is missing")
    if unit.startswith("/"):
        unit = "1" + unit
    registry = _registry()
    try:
        parsed = registry.parse_units(unit)
    except Exception:  # pint raises its own kinds, ValueError, AttributeError and tokenizer errors alike
        raise ValueError(f"{wanted}; the unit {unit!r} is unknown") from None
    try:
        value = float(registry.Quantity(float(number), parsed).to(si_unit).magnitude)
    except Exception:  # DimensionalityError, and OverflowError of an absurd exponent
        hint = " (A is ampere; write angstrom)" if dimension == "length" and re.search(r"\bA\b", unit) else ""
        raise ValueError(f"{wanted}; the unit {unit!r} is none of {dimension}{hint}") from None
    if not math.isfinite(value):
        raise ValueError(f"{wanted}; the number is too large")
    return value


@dataclass(frozen=True)
class Quantity:
    """Field type of a scene: text with a unit, read as an SI float.

    A float is taken as it is only under the validation context ``{"si": True}``, which reads back
    scenes that were resolved before.

    Parameters
    ----------
    dimension : str
        A key of `DIMENSIONS`.
    sign : {"any", "zero", "positive"}
        Lower limit: none, zero allowed, or greater than zero.
    """

    dimension: str
    sign: Literal["any", "zero", "positive"] = "any"

    def wanted(self) -> str:
        """Say what is wanted, with an example."""
        return f'a {self.dimension} with its unit, such as "{DIMENSIONS[self.dimension][1]}"'

    def read(self, value: Any, info: core_schema.ValidationInfo) -> float:
        """Return `value` in SI, or raise a pydantic error that says what is allowed."""
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if is_number and isinstance(info.context, dict) and info.context.get("si"):
            number = float(value)
        elif isinstance(value, str):
            try:
                number = to_si(value, self.dimension)
            except ValueError as error:
                raise PydanticCustomError("quantity", "{problem}", {"problem": str(error)}) from None
        else:
            problem = "; a bare number has no unit" if is_number else ""
            raise PydanticCustomError(
                "quantity", "must be {wanted}{problem}", {"wanted": self.wanted(), "problem": problem}
            )  # fmt: skip
        if self.sign == "positive" and number <= 0.0:
            raise PydanticCustomError("quantity_sign", "must be greater than 0")
        if self.sign == "zero" and number < 0.0:
            raise PydanticCustomError("quantity_sign", "must be 0 or greater")
        return number

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.with_info_plain_validator_function(self.read)


Length = Annotated[float, Quantity("length")]
PositiveLength = Annotated[float, Quantity("length", "positive")]
Time = Annotated[float, Quantity("time", "zero")]
PositiveTime = Annotated[float, Quantity("time", "positive")]
Temperature = Annotated[float, Quantity("temperature", "zero")]
PositivePressure = Annotated[float, Quantity("pressure", "positive")]
PositiveForce = Annotated[float, Quantity("force", "positive")]
PositiveStiffness = Annotated[float, Quantity("stiffness", "positive")]
Rate = Annotated[float, Quantity("rate", "zero")]
PositiveDensity = Annotated[float, Quantity("density", "positive")]
PositiveEnergyPerArea = Annotated[float, Quantity("energy per area", "positive")]
StressIntensity = Annotated[float, Quantity("stress intensity")]
Pressure = Annotated[float, Quantity("pressure")]
ZeroPressure = Annotated[float, Quantity("pressure", "zero")]
Velocity = Annotated[float, Quantity("velocity")]
Acceleration = Annotated[float, Quantity("acceleration")]
Angle = Annotated[float, Quantity("angle")]

#: Units of length and time in which people read numbers, finest first: SI size and name.
LENGTHS = ((1e-10, "angstrom"), (1e-6, "um"), (1e-3, "mm"), (1.0, "m"))
TIMES = ((1e-15, "fs"), (1e-12, "ps"), (1e-9, "ns"), (1e-6, "us"), (1e-3, "ms"), (1.0, "s"))


def readable_unit(size: float, units: tuple[tuple[float, str], ...]) -> tuple[float, str]:
    """Return the coarsest unit, its SI size and name, of which `size` is at least one; else the finest."""
    fitting = [unit for unit in units if abs(size) >= unit[0] * (1 - 1e-9)]
    return fitting[-1] if fitting else units[0]


def readable(value: float, units: tuple[tuple[float, str], ...], digits: int = 6) -> str:
    """Return a value in SI with the unit in which people read it."""
    size, name = readable_unit(value, units) if value else units[-1]
    return f"{value / size:.{digits}g} {name}"
