"""Messages that every role shares, and the base that all messages have."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from itertools import pairwise
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator
from pydantic.fields import FieldInfo
from pydantic_core import PydanticCustomError

from protocol.arrays import ArrayMap, ArrayMapSpec, ArraySpec
from protocol.version import Version


def _plain_integer(value: Any) -> Any:
    """Return an integer of numpy as one of Python; the strict check that follows knows only the latter."""
    return int(value) if isinstance(value, np.integer) else value


# On the wire a text or a boolean is no number (strict), and every number is finite.
Integer = Annotated[int, BeforeValidator(_plain_integer)]
Natural = Annotated[int, BeforeValidator(_plain_integer), Field(ge=0)]
Count = Annotated[int, BeforeValidator(_plain_integer), Field(ge=1)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
# msgpack has lists only, so a tuple alone is not strict about its kind.
Point2 = Annotated[tuple[Finite, Finite], Field(strict=False)]
Point3 = Annotated[tuple[Finite, Finite, Finite], Field(strict=False)]
VersionPair = Annotated[tuple[Natural, Natural], Field(strict=False)]


#: Kind of a validation error that a rule between several fields raises; its context names the field.
FIELD_RULE = "field_rule"


def wrong(name: str, problem: str) -> PydanticCustomError:
    """Return the error of a rule that field `name` breaks, for a validator to raise."""
    return PydanticCustomError(FIELD_RULE, "{problem}", {"field": name, "problem": problem})


def check_ascending(name: str, values: Sequence[float]) -> None:
    """Raise the error of field `name` unless each value is above the one before it."""
    for before, after in pairwise(values):
        if not before < after:
            raise wrong(name, f"must ascend, but {after:g} follows {before:g}")


def check_indices(name: str, values: NDArray[np.int64], end: int | None) -> None:
    """Raise the error of field `name` unless each value lies in 0 ... end - 1 (no upper end where None)."""
    if len(values) and (values.min() < 0 or (end is not None and values.max() >= end)):
        bad = values[(values < 0) | (values >= end if end is not None else False)][0]
        raise wrong(name, f"holds {bad}, allowed is 0 to {end - 1}" if end else f"holds {bad}, allowed is 0 and above")


def since(major: int, minor: int) -> dict[str, Any]:
    """Return the `json_schema_extra` of a field that this version of the protocol added."""
    return {"since": [major, minor]}


def field_version(field: FieldInfo) -> Version:
    """Return the version of the protocol that added a field."""
    extra = field.json_schema_extra
    found = extra.get("since") if isinstance(extra, dict) else None
    return Version(*found) if isinstance(found, list) else Version(1, 0)  # type: ignore[arg-type]


class Part(BaseModel):
    """A group of fields inside a message; unknown fields (of a newer minor version) are ignored."""

    #: Version of the protocol that brought this part.
    added_in: ClassVar[Version] = Version(1, 0)

    model_config = ConfigDict(extra="ignore", frozen=True, strict=True, allow_inf_nan=False)


class Message(BaseModel):
    """A request or a reply. Array fields travel as frames of their own, the rest as the body."""

    model_config = ConfigDict(
        extra="ignore", frozen=True, strict=True, allow_inf_nan=False, arbitrary_types_allowed=True
    )

    @model_validator(mode="after")
    def _named_sizes_agree(self) -> Self:
        sizes: dict[str, tuple[str, int]] = {}
        for name, spec in array_fields(type(self)).items():
            value = getattr(self, name)
            if value is None or isinstance(spec, ArrayMapSpec):
                continue
            for axis, size in spec.named_sizes:
                length = value.shape[axis]
                first, expected = sizes.setdefault(size, (name, length))
                if expected != length:
                    raise wrong(name, f"has {length} {size}, but {first} has {expected}")
        return self

    def plain_values(self) -> dict[str, Any]:
        """Return the fields that are not arrays, as plain values."""
        return self.model_dump(exclude=_array_names(type(self)))

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
        # An array given in the body, or a plain field given as a frame, is left for the model to refuse: an
        # optional field must not be dropped without a word because it came the wrong way.
        known = _field_names(cls)
        values = {**body, **{name: array for name, array in arrays.items() if name in known}}
        for name, spec in specs.items():
            if isinstance(spec, ArrayMapSpec):
                start = name + "."
                values[name] = {key[len(start) :]: array for key, array in arrays.items() if key.startswith(start)}
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


def newer_fields(value: Any, version: Version, path: str = "") -> list[str]:
    """Return the paths of what a side that speaks only `version` would not understand, and so ignore.

    A field that a later version added counts where it is not at its default.
    """
    found: list[str] = []
    if isinstance(value, Part) and value.added_in > version:
        return [path]
    if isinstance(value, BaseModel):
        for name, field in type(value).model_fields.items():
            entry, place = getattr(value, name), f"{path}.{name}" if path else name
            if field_version(field) <= version:
                found += newer_fields(entry, version, place)
            # No default is an array, and arrays do not compare to one truth value.
            elif (
                field.is_required()
                or isinstance(entry, np.ndarray)
                or entry != field.get_default(call_default_factory=True)
            ):
                found.append(place)
    elif isinstance(value, list | tuple):
        for index, entry in enumerate(value):
            found += newer_fields(entry, version, f"{path}.{index}")
    return found


@cache
def _array_names(model: type[BaseModel]) -> set[str]:
    return set(array_fields(model))


@cache
def _field_names(model: type[BaseModel]) -> frozenset[str]:
    return frozenset(model.model_fields)


class Empty(Message):
    """No fields."""


class VersionRange(Part):
    """Oldest and newest protocol version that a side speaks."""

    oldest: VersionPair = Field(description="major, minor")
    newest: VersionPair = Field(description="major, minor")


class Hello(Message):
    """First message of a client: who it is, which versions it speaks, which role it wants."""

    versions: VersionRange = Field(description="what the client speaks")
    role: str = Field(description="role that the client wants: the service refuses another")
    client: str = Field(description="name and version of the client, for logs")


class Welcome(Message):
    """Answer to `hello`: who the service is and what it can do."""

    versions: VersionRange = Field(description="what the service speaks")
    version: VersionPair = Field(description="the version that both use from now on")
    role: str = Field(description="role of the service")
    backend: str = Field(description="name of the solver, such as `md_service`")
    backend_version: str = Field(description="version of the solver, in its own counting")
    capabilities: dict[str, bool | int | float | str | list[str]] = Field(description="what the backend can do")
    units: str = Field(description="always `SI`")
    state: str = Field(description="state of the service, see the state table")
    max_message_bytes: Count = Field(description="[byte] largest message, all frames together")
    control_endpoint: str = Field(description="endpoint of the control socket; empty in process")


class Status(Message):
    """What the service does now; answered on the control socket while the solver computes."""

    state: str = Field(description="state of the service, see the state table")
    step: Integer = Field(description="step counter of the solver")
    operation: str = Field(description="type of the request in work, or empty")
    done: Integer = Field(description="progress of that operation, in its own units")
    total: Integer = Field(description="where `done` ends; 0 where that is not known")
    note: str = Field(description="progress in words")
    operation_seconds: float = Field(description="[s] time since that operation began; 0 when idle")
    requests: Integer = Field(description="requests answered since start")
    memory_bytes: Integer = Field(description="[byte] resident memory of the service")


class Acknowledged(Message):
    """The order was taken: `abort` ends the operation in work at its next check, `shutdown` the service."""

    operation: str = Field(description="type of the request that was in work, or empty")


class FieldsRequest(Message):
    """Ask for fields by name; `capabilities.fields` lists the names."""

    names: list[str] = Field(min_length=1, description="each one of `capabilities.fields`")


class FieldsReply(Message):
    """One array a name; the first axis counts material points or atoms."""

    step: Integer = Field(description="step counter of the solver")
    fields: Annotated[ArrayMap, ArrayMapSpec()] = Field(
        description="frame `fields.NAME` for each name asked for; the first axis counts material points or atoms"
    )


class CheckpointReply(Message):
    """The whole state. A service that goes on from here and one restored from it give the same bits."""

    step: Integer = Field(description="step counter of the solver")
    state: Annotated[ArrayMap, ArrayMapSpec()] = Field(
        description="frames `state.NAME`; names and contents are the backend's own"
    )


class RestoreRequest(Message):
    """Set the state of an equally configured and registered service."""

    step: Natural = Field(description="`step` of the checkpoint")
    state: Annotated[ArrayMap, ArrayMapSpec()] = Field(
        description="the frames `state.NAME` of the checkpoint, unchanged"
    )


class Restored(Message):
    """The state is set."""

    step: Integer = Field(description="step counter of the solver, equal to that of the request")
