"""Quantities with units as fields of scene files, and SI values in the units in which people read them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import GetCoreSchemaHandler
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from protocol.quantities import to_si, wanted


@dataclass(frozen=True)
class Quantity:
    """Field type of a scene: text with a unit, read as an SI float.

    A float is taken as it is only under the validation context ``{"si": True}``, which reads back
    scenes that were resolved before.

    Parameters
    ----------
    dimension : str
        A key of `protocol.quantities.DIMENSIONS`.
    sign : {"any", "zero", "positive"}
        Lower limit: none, zero allowed, or greater than zero.
    """

    dimension: str
    sign: Literal["any", "zero", "positive"] = "any"

    def wanted(self) -> str:
        """Say what is wanted, with an example."""
        return wanted(self.dimension)

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
