"""Messages that every role shares, and the base that all messages have."""

from __future__ import annotations

from functools import cache
from typing import Annotated, Any, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, NonNegativeInt, PositiveInt, model_validator
from pydantic_core import PydanticCustomError

from protocol.arrays import ArrayMap, ArrayMapSpec, ArraySpec

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Point2 = tuple[Finite, Finite]


class Part(BaseModel):
    """A group of fields inside a message; unknown fields (of a newer minor version) are ignored."""

    model_config = ConfigDict(extra="ignore", frozen=True)


class Message(BaseModel):
    """A request or a reply. Array fields travel as frames of their own, the rest as the body."""

    model_config = ConfigDict(extra="ignore", frozen=True, arbitrary_types_allowed=True)

    @model_validator(mode="after")
    def _named_sizes_agree(self) -> Self:
        sizes: dict[str, tuple[str, int]] = {}
        for name, spec in array_fields(type(self)).items():
            value = getattr(self, name)
            if value is None or isinstance(spec, ArrayMapSpec):
                continue
            for size, length in zip(spec.shape, value.shape, strict=True):
                if not isinstance(size, str):
                    continue
                first, expected = sizes.setdefault(size, (name, length))
                if expected != length:
                    raise PydanticCustomError(
                        "array_sizes", "{name} has {length} {size}, but {first} has {expected}",
                        {"name": name, "length": length, "size": size, "first": first, "expected": expected},
                    )  # fmt: skip
        return self

    def plain_values(self) -> dict[str, Any]:
        """Return the fields that are not arrays, as plain values."""
        return self.model_dump(exclude=set(array_fields(type(self))))

    def array_values(self) -> dict[str, np.ndarray]:
        """Return the arrays by frame name; entry `a` of an array map `f` is named `f.a`."""
        found: dict[str, np.ndarray] = {}
        for name, spec in array_fields(type(self)).items():
            value = getattr(self, name)
            if value is None:
                continue
            if isinstance(spec, ArrayMapSpec):
                found.update({f"{name}.{key}": array for key, array in value.items()})
            else:
                found[name] = value
        return found

    @classmethod
    def from_parts(cls, body: dict[str, Any], arrays: dict[str, np.ndarray]) -> Self:
        """Build the message from its body and its array frames.

        Raises
        ------
        pydantic.ValidationError
            Where a field is missing or not allowed.
        """
        specs = array_fields(cls)
        values = {name: value for name, value in body.items() if name not in specs}
        for name, spec in specs.items():
            if isinstance(spec, ArrayMapSpec):
                start = name + "."
                values[name] = {key[len(start) :]: array for key, array in arrays.items() if key.startswith(start)}
            elif name in arrays:
                values[name] = arrays[name]
        return cls.model_validate(values)


@cache
def array_fields(model: type[BaseModel]) -> dict[str, ArraySpec | ArrayMapSpec]:
    """Return the array fields of a message class with their specifications."""
    found: dict[str, ArraySpec | ArrayMapSpec] = {}
    for name, field in model.model_fields.items():
        # `Annotated[...] | None` keeps the annotation inside the union; a plain one is in the metadata.
        candidates = list(field.metadata)
        for argument in getattr(field.annotation, "__args__", ()):
            candidates.extend(getattr(argument, "__metadata__", ()))
        for item in candidates:
            if isinstance(item, ArraySpec | ArrayMapSpec):
                found[name] = item
    return found


class Empty(Message):
    """No fields."""


class VersionRange(Part):
    """Oldest and newest protocol version that a side speaks."""

    oldest: tuple[NonNegativeInt, NonNegativeInt]
    newest: tuple[NonNegativeInt, NonNegativeInt]


class Hello(Message):
    """First message of a client: who it is, which versions it speaks, which role it wants."""

    versions: VersionRange
    role: str = Field(description="role that the client wants: the service refuses another")
    client: str = Field(description="name and version of the client, for logs")


class Welcome(Message):
    """Answer to `hello`: who the service is and what it can do."""

    versions: VersionRange
    version: tuple[NonNegativeInt, NonNegativeInt] = Field(description="the version that both use from now on")
    role: str
    backend: str
    backend_version: str
    capabilities: dict[str, bool | int | float | str | list[str]] = Field(description="what the backend can do")
    units: str = Field(description="always `SI`")
    state: str
    max_message_bytes: PositiveInt = Field(description="largest message, all frames together")
    control_endpoint: str = Field(description="endpoint of the control socket; empty in process")


class Status(Message):
    """What the service does now; answered on the control socket while the solver computes."""

    state: str
    step: int = Field(description="step counter of the solver")
    operation: str = Field(description="type of the request in work, or empty")
    done: int = Field(description="progress of that operation, in its own units")
    total: int
    note: str = Field(description="progress in words")
    operation_seconds: float = Field(description="time since that operation began")
    requests: int = Field(description="requests answered since start")
    memory_bytes: int = Field(description="resident memory of the service")


class Acknowledged(Message):
    """The order was taken: `abort` ends the operation in work at its next check, `shutdown` the service."""

    operation: str = Field(description="type of the request that was in work, or empty")


class FieldsRequest(Message):
    """Ask for fields by name; `capabilities.fields` lists the names."""

    names: list[str] = Field(min_length=1)


class FieldsReply(Message):
    """One array a name; the first axis counts material points or atoms."""

    step: int
    fields: Annotated[ArrayMap, ArrayMapSpec()]


class CheckpointReply(Message):
    """The whole state. A service that goes on from here and one restored from it give the same bits."""

    step: int
    state: Annotated[ArrayMap, ArrayMapSpec()]


class RestoreRequest(Message):
    """Set the state of an equally configured and registered service."""

    step: int
    state: Annotated[ArrayMap, ArrayMapSpec()]


class Restored(Message):
    """The state is set."""

    step: int
