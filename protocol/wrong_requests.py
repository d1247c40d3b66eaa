"""Makes a valid request wrong, one field at a time, as its model tells: for the conformance kit."""

from __future__ import annotations

import copy
import math
import types
import typing
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import BaseModel, TypeAdapter, ValidationError
from pydantic.fields import FieldInfo

from protocol.arrays import ArraySpec
from protocol.messages import Message, array_fields, field_version
from protocol.version import NEWEST, Version

Path = tuple[str | int, ...]
_ABSENT = object()


@dataclass(frozen=True)
class WrongRequest:
    """One request with one field wrong.

    Parameters
    ----------
    field : str
        Path of the field without list indices at its end; wrong requests of one field form one check.
    label : str
        What is wrong.
    paths : tuple of str
        Paths of which the error must name one.
    body : dict
    arrays : dict
    """

    field: str
    label: str
    paths: tuple[str, ...]
    body: dict[str, Any]
    arrays: dict[str, np.ndarray]


def wrong_requests(message: Message, sizes: dict[str, int], version: Version = NEWEST) -> Iterator[WrongRequest]:
    """Yield `message` with each field made wrong in turn.

    Parameters
    ----------
    message : Message
        A valid request with every optional field given.
    sizes : dict of str to int
        Named sizes of arrays that earlier messages fixed; an array that differs from them is wrong.
    version : Version
        Version that the other side speaks: it ignores fields that a later one added.
    """
    body, arrays = _lists(message.plain_values()), message.array_values()
    for path, label, value in _plain_faults(type(message), body, (), version):
        text = ".".join(str(part) for part in path)
        yield WrongRequest(without_indices(text), label, (text,), _with(body, path, value), arrays)
    for name, spec in array_fields(type(message)).items():
        if isinstance(spec, ArraySpec) and name in arrays:
            yield from _array_faults(message, name, spec, body, arrays, sizes)


def without_indices(path: str) -> str:
    """Return a path without the list indices at its end: the field that a user would look for."""
    parts = path.split(".")
    while len(parts) > 1 and parts[-1].isdigit():
        parts.pop()
    return ".".join(parts)


def names_field(reported: str, wanted: tuple[str, ...]) -> bool:
    """Return whether the path in an error names one of the wanted fields, or a place inside it."""
    return any(without_indices(reported) == without_indices(path) or reported.startswith(path + ".") for path in wanted)


def _array_faults(
    message: Message,
    name: str,
    spec: ArraySpec,
    body: dict[str, Any],
    arrays: dict[str, np.ndarray],
    sizes: dict[str, int],
) -> Iterator[WrongRequest]:
    array = arrays[name]
    others = {key: other for key, other in arrays.items() if key != name}

    def fault(label: str, value: np.ndarray, paths: tuple[str, ...] = (name,)) -> WrongRequest:
        return WrongRequest(name, label, paths, body, {**others, name: value})

    if type(message).model_fields[name].is_required():
        yield WrongRequest(name, "missing", (name,), body, others)
    yield WrongRequest(name, "in the body", (name,), {**body, name: array.tolist()}, others)
    yield fault("wrong dtype", array.astype("<i8" if spec.dtype == "<f8" else "<f8"))
    yield fault("an axis more", array[..., None])
    if isinstance(spec.shape[-1], int):
        yield fault("a column more", np.concatenate([array, array[..., :1]], axis=-1))
    if spec.dtype == "<f8" and array.size:
        for label, value in (("NaN", math.nan), ("infinity", math.inf)):
            bad = array.copy()
            bad.flat[-1] = value
            yield fault(label, bad)
    size = spec.shape[0]
    specs = array_fields(type(message)).items()
    same = tuple(key for key, other in specs if isinstance(other, ArraySpec) and size in other.shape and key in arrays)
    if isinstance(size, str) and len(array) and (size in sizes or len(same) > 1):
        yield fault("a row more", np.concatenate([array, array[:1]]), same)


def _plain_faults(
    model: type[BaseModel], values: dict[str, Any], start: Path, version: Version
) -> Iterator[tuple[Path, str, Any]]:
    arrays = array_fields(model) if issubclass(model, Message) else {}
    for name, field in model.model_fields.items():
        if name in arrays or field_version(field) > version:
            continue
        path = (*start, name)
        if field.is_required():
            yield path, "missing", _ABSENT
        elif field.get_default(call_default_factory=True) is not None:
            yield path, "nil", None
        yield from _value_faults(field.annotation, _constraints(field.metadata), values[name], path, version)


def _value_faults(
    annotation: Any, limits: list[Any], value: Any, path: Path, version: Version
) -> Iterator[tuple[Path, str, Any]]:
    """Yield (path, label, wrong value) for one value and what is inside it."""
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is typing.Annotated:
        yield from _value_faults(arguments[0], limits + _constraints(arguments[1:]), value, path, version)
    elif origin in (typing.Union, types.UnionType):
        if value is not None:
            yield from _value_faults(_kind_of(arguments, value), limits, value, path, version)
    elif origin is typing.Literal:
        yield path, "a word that is not allowed", "no such word"
        yield path, "a number that is not allowed", 99
    elif origin is list:
        yield path, "a number", 7
        for limit in limits:
            if hasattr(limit, "min_length"):
                yield path, "too short", value[: limit.min_length - 1]
        # One entry stands for all, except where entries are of several kinds.
        entries = value if typing.get_origin(_plain(arguments[0])) in (typing.Union, types.UnionType) else value[:1]
        for index, entry in enumerate(entries):
            yield from _value_faults(arguments[0], [], entry, (*path, index), version)
    elif origin is tuple:
        yield path, "a number", 7
        yield path, "too short", value[:-1]
        yield from _value_faults(arguments[0], [], value[0], (*path, 0), version)
    elif annotation in (str, bool):
        yield path, "a number", 7
    elif annotation in (int, float):
        yield path, "text", "1"
        yield path, "a boolean", True
        yield path, "a map", {}
        if annotation is int:
            yield path, "a fraction", 1.5
        else:
            yield path, "NaN", math.nan
            yield path, "infinity", math.inf
        yield from ((path, f"{wrong:g}", wrong) for wrong in _outside(limits, annotation))
    elif isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield path, "a number", 7
        yield from _plain_faults(annotation, value, path, version)
    else:
        raise TypeError(f"no wrong value known for the type {annotation!r} of {path}")


def _plain(annotation: Any) -> Any:
    return typing.get_args(annotation)[0] if typing.get_origin(annotation) is typing.Annotated else annotation


def _kind_of(kinds: tuple[Any, ...], value: Any) -> Any:
    """Return which of several types of a field its value is."""
    inner = [kind for kind in kinds if kind is not type(None)]
    for kind in inner[:-1]:
        try:
            TypeAdapter(kind).validate_python(value)
        except ValidationError:
            continue
        return kind
    return inner[-1]


def _outside(limits: list[Any], kind: type) -> Iterator[Any]:
    """Yield the nearest number beyond each bound."""
    for limit in limits:
        for attribute, step in (("gt", 0), ("ge", -1), ("lt", 0), ("le", 1)):
            if hasattr(limit, attribute):
                yield kind(getattr(limit, attribute) + step)


def _constraints(metadata: Any) -> list[Any]:
    found: list[Any] = []
    for item in metadata:
        found += list(item.metadata) if isinstance(item, FieldInfo) else [item]
    return found


def _lists(value: Any) -> Any:
    """Return `value` with lists for tuples, as it arrives on the other side."""
    if isinstance(value, dict):
        return {key: _lists(entry) for key, entry in value.items()}
    return [_lists(entry) for entry in value] if isinstance(value, list | tuple) else value


def _with(body: dict[str, Any], path: Path, value: Any) -> dict[str, Any]:
    changed: Any = copy.deepcopy(body)
    place: Any = changed
    for part in path[:-1]:
        place = place[part]
    if value is _ABSENT:
        del place[path[-1]]
    else:
        place[path[-1]] = value
    return typing.cast("dict[str, Any]", changed)
