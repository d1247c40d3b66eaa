"""Array fields of a message: their type, shape and check.

A field declared as ``Annotated[FloatArray, ArraySpec("<f8", ("anchors", 3))]`` travels as a raw frame of
its own behind the header. A name in the shape is a size that all arrays of that message share.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import GetCoreSchemaHandler
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Types that may travel, all little-endian.
WIRE_TYPES = ("<f8", "<i8", "|u1")
#: Values of one dot product: below this BLAS stays in the calling thread, where waiting for others would cost more.
_FEW = 8192


def all_finite(values: NDArray[Any]) -> bool:
    """Return whether no value is NaN or infinite."""
    flat = values.reshape(-1)
    # A sum of squares is finite only if each square is, and is the fastest pass over an array there is.
    squares = 0.0
    for start in range(0, flat.size, _FEW):
        part = flat[start : start + _FEW]
        squares += float(np.vdot(part, part))
    # If it is not finite, a square may just have overflowed.
    return isfinite(squares) or bool(np.isfinite(flat).all())


@dataclass(frozen=True)
class ArraySpec:
    """Type and shape of an array field.

    Parameters
    ----------
    dtype : str
        One of `WIRE_TYPES`.
    shape : tuple of str or int
        An int is a fixed size; a str is a name, equal over all arrays of the message.
    unit : str
        SI unit, for the specification.
    """

    dtype: str
    shape: tuple[str | int, ...]
    unit: str = "1"

    @cached_property
    def _wanted(self) -> np.dtype[Any]:
        return np.dtype(self.dtype)

    @cached_property
    def _fixed_sizes(self) -> tuple[tuple[int, int], ...]:
        """Axis and size where the size is a number."""
        return tuple((axis, size) for axis, size in enumerate(self.shape) if isinstance(size, int))

    @cached_property
    def named_sizes(self) -> tuple[tuple[int, str], ...]:
        """Axis and name where the size is a name."""
        return tuple((axis, size) for axis, size in enumerate(self.shape) if isinstance(size, str))

    def shape_text(self) -> str:
        """Return the shape as it is written in the specification."""
        return "(" + ", ".join(str(size) for size in self.shape) + ("," if len(self.shape) == 1 else "") + ")"

    def check(self, value: Any) -> NDArray[Any]:
        """Return `value` as a C-contiguous array of this type, or raise a pydantic error."""
        if not isinstance(value, np.ndarray):
            raise PydanticCustomError("array", "must be an array frame, not a {kind}", {"kind": type(value).__name__})
        wanted = self._wanted
        if value.dtype != wanted:
            raise PydanticCustomError(
                "array_dtype",
                "has dtype {got}, must have {wanted}",
                {"got": value.dtype.str, "wanted": self.dtype},
            )
        shape = value.shape
        fits = len(shape) == len(self.shape)
        if fits:
            for axis, size in self._fixed_sizes:
                fits = fits and shape[axis] == size
        if not fits:
            raise PydanticCustomError(
                "array_shape", "has shape {got}, must have {wanted}",
                {"got": str(value.shape), "wanted": self.shape_text()},
            )  # fmt: skip
        if wanted.kind == "f" and not all_finite(value):
            where = np.argwhere(~np.isfinite(value))[0]
            raise PydanticCustomError(
                "array_finite", "holds {bad} at index {where}; every number must be finite",
                {"bad": str(value[tuple(where)]), "where": str(where.tolist())},
            )  # fmt: skip
        return np.asarray(value, order="C")

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(self.check)


@dataclass(frozen=True)
class ArrayMapSpec:
    """A field that holds any number of named arrays; array `a` of field `f` travels as frame `f.a`."""

    unit: str = "SI"

    def check(self, value: Any) -> dict[str, NDArray[Any]]:
        """Return `value` as a dict of arrays of wire types, or raise a pydantic error."""
        if not isinstance(value, dict):
            raise PydanticCustomError("array_map", "must be a map of array frames")
        for name, array in value.items():
            if not isinstance(name, str) or not isinstance(array, np.ndarray) or array.dtype.str not in WIRE_TYPES:
                raise PydanticCustomError(
                    "array_map", "entry {name} must be an array of one of {types}",
                    {"name": str(name), "types": ", ".join(WIRE_TYPES)},
                )  # fmt: skip
        # Unlike ascontiguousarray, asarray leaves an array without axes without axes.
        return {name: np.asarray(array, order="C") for name, array in value.items()}

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(self.check)


ArrayMap = dict[str, NDArray[Any]]
