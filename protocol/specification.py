"""The parts of `SPEC.md` that are made from the models: message tables and the worked example.

``python -m protocol.specification`` rewrites what stands between the markers of `SPEC.md`.
"""

from __future__ import annotations

import re
import types
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import annotated_types
import msgpack
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from protocol.arrays import ArrayMapSpec
from protocol.errors import MEANINGS, ErrorReport
from protocol.frames import ArrayEntry, Envelope, Header, encode
from protocol.messages import Hello, Message, Part, VersionRange, Welcome, array_fields, field_version
from protocol.roles import ANY, CONTROL, ROLES, Operation
from protocol.version import NEWEST, OLDEST, Version

SPEC = Path(__file__).with_name("SPEC.md")

STATES: dict[str, str] = {
    "new": "no problem is set",
    "configured": "the problem is built; it has no anchors yet",
    "registered": "role `atomistic` only: the anchors are set, the reference force is not measured",
    "ready": "the service can advance",
    "failed": "the solver stopped or an operation was aborted half way; only `configure` helps",
}

_NAMES = {float: "float", int: "integer", str: "text", bool: "boolean"}
_BOUNDS = {annotated_types.Gt: ("gt", ">"), annotated_types.Ge: ("ge", ">="),
           annotated_types.Lt: ("lt", "<"), annotated_types.Le: ("le", "<=")}  # fmt: skip


def tables() -> str:
    """Return the generated tables as Markdown."""
    parts = ["### Header", "", *_header_table(), ""]
    parts += ["### Error body", "", *_model_table(ErrorReport), ""]
    parts += ["### Error codes", "", "| code | meaning |", "| --- | --- |"]
    parts += [f"| `{code}` | {meaning} |" for code, meaning in MEANINGS.items()]
    parts += ["", "### States", "", "| state | meaning |", "| --- | --- |"]
    parts += [f"| `{state}` | {meaning} |" for state, meaning in STATES.items()]
    for role in ROLES.values():
        parts += ["", f"### Role `{role.name}`: operations of the work socket", "", f"Purpose: {role.purpose}.", ""]
        parts += _operation_table(role.operations)
    parts += ["", "### Every role: operations of the control socket", "", *_operation_table(CONTROL)]
    parts += ["", "### Messages that all roles share"]
    shared = {**CONTROL, **{name: op for name, op in _all_operations() if _is_shared(op)}}
    for name, operation in shared.items():
        parts += _operation_section(name, operation)
    for role in ROLES.values():
        parts += ["", f"### Messages of the role `{role.name}`"]
        for name, operation in role.operations.items():
            if not _is_shared(operation):
                parts += _operation_section(name, operation)
    parts += ["", "### Parts", "", "Maps that stand inside a message as the value of a field."]
    for part in _parts():
        added = f" Since {part.added_in}." if part.added_in > Version(1, 0) else ""
        parts += ["", f"#### `{part.__name__}`", "", _sentence(part) + added, "", *_model_table(part)]
    return "\n".join(parts) + "\n"


def example() -> str:
    """Return the worked `hello` exchange, both frames in hexadecimal and in words, as Markdown."""
    span = VersionRange(oldest=OLDEST, newest=NEWEST)
    hello = Hello(versions=span, role="continuum", client="example 1.0")
    welcome = Welcome(
        versions=span, version=NEWEST, role="continuum", backend="toy", backend_version="0.1",
        capabilities={"fields": ["position"]}, units="SI", state="new", max_message_bytes=1 << 30,
        control_endpoint="tcp://127.0.0.1:5556",
    )  # fmt: skip
    request = Envelope("request", "hello", "7c3e", hello.plain_values(), run="demo")
    reply = Envelope("reply", "hello", "7c3e", welcome.plain_values(), run="demo", session="a1b2", seconds=0.00025)
    lines = []
    for title, envelope in (("Request", request), ("Reply", reply)):
        frame = bytes(encode(envelope)[0])
        lines += [f"{title}, one frame of {len(frame)} bytes:", "", "```text", *_hex_rows(frame), "```", ""]
        lines += ["which is the msgpack map", "", "```text", *_readable(msgpack.unpackb(frame)), "```", ""]
    return "\n".join(lines).rstrip() + "\n"


def specification(text: str) -> str:
    """Return `text` with what stands between its markers made anew.

    Raises
    ------
    ValueError
        Where a pair of markers is missing.
    """
    for name, content in (("tables", tables()), ("example", example())):
        begin, end = f"<!-- {name} begin -->", f"<!-- {name} end -->"
        if text.count(begin) != 1 or text.count(end) != 1:
            raise ValueError(f"SPEC.md must hold {begin} and {end} once each")
        before, rest = text.split(begin)
        after = rest.split(end)[1]
        text = f"{before}{begin}\n\n{content}\n{end}{after}"
    return text


def unit_and_words(description: str | None) -> tuple[str, str]:
    """Return unit and words of a field's description ``[unit] words``; the unit is empty where none is given."""
    match = re.match(r"\[([^]]+)\] (.*)", description or "", re.DOTALL)
    return (match[1], match[2]) if match else ("", description or "")


def messages() -> list[type[Message]]:
    """Return every message class of every role, each once."""
    found: dict[type[Message], None] = {}
    for operations in (CONTROL, *(role.operations for role in ROLES.values())):
        for operation in operations.values():
            found[operation.request] = found[operation.reply] = None
    return list(found)


def _all_operations() -> Iterator[tuple[str, Operation]]:
    for role in ROLES.values():
        yield from role.operations.items()


def _is_shared(operation: Operation) -> bool:
    return operation.request.__module__ == operation.reply.__module__ == "protocol.messages"


def _operation_table(operations: dict[str, Operation]) -> list[str]:
    rows = [
        "| operation | request | reply | allowed in | leads to | deadline, s |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for name, operation in operations.items():
        allowed = "any" if operation.allowed == ANY else ", ".join(s for s in STATES if s in operation.allowed)
        added = f", since {operation.since}" if operation.since > Version(1, 0) else ""
        label = f"`{name}`{' (optional)' if operation.optional else ''}{added}"
        rows.append(
            f"| {label} | {operation.request.__name__} | {operation.reply.__name__} | {allowed} | "
            f"{operation.leads_to or 'the same'} | {operation.deadline:g} |"
        )
    return rows


def _operation_section(name: str, operation: Operation) -> list[str]:
    lines = ["", f"#### `{name}`"]
    for side, model in (("Request", operation.request), ("Reply", operation.reply)):
        lines += ["", f"{side} `{model.__name__}`: {_sentence(model)}"]
        if model.model_fields:
            lines += ["", *_model_table(model)]
    return lines


def _model_table(model: type[BaseModel]) -> list[str]:
    rows = [
        "| field | type | shape | unit | given | allowed | meaning |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    arrays = array_fields(model) if issubclass(model, Message) else {}
    for name, field in model.model_fields.items():
        unit, words = unit_and_words(field.description)
        spec = arrays.get(name)
        if isinstance(spec, ArrayMapSpec):
            kind, shape, unit = "map of arrays", "each its own", unit or spec.unit
        elif spec is not None:
            kind, shape, unit = f"array `{spec.dtype}`", spec.shape_text(), spec.unit
        else:
            kind, shape = _type_text(field.annotation), ""
        given = "required" if field.is_required() else _default_text(field)
        if field_version(field) > Version(1, 0):
            given += f", since {field_version(field)}"
        rows.append(f"| `{name}` | {kind} | {shape} | {unit} | {given} | {'; '.join(_limits(field, spec))} | {words} |")
    return rows


def _header_table() -> list[str]:
    rows = _model_table(Header)
    return [*rows, "", "One entry of `arrays`:", "", *_model_table(ArrayEntry)]


def _type_text(annotation: Any) -> str:
    """Return a type as a reader of another language names it."""
    if isinstance(annotation, type) and annotation in _NAMES:
        return _NAMES[annotation]
    if annotation is Any:
        return "any"
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is typing.Annotated:
        return _type_text(arguments[0])
    if origin in (typing.Union, types.UnionType):
        return " or ".join(_type_text(argument) for argument in arguments if argument is not type(None))
    if origin is list:
        return f"list of {_type_text(arguments[0])}"
    if origin is tuple:
        return f"list of {len(arguments)} {_type_text(arguments[0])}"
    if origin is dict:
        return f"map of {_type_text(arguments[0])} to {_type_text(arguments[1])}"
    if origin is typing.Literal:
        return _type_text(type(arguments[0]))
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return f"map `{annotation.__name__}`"
    raise TypeError(f"no word for the type {annotation!r}")


def _default_text(field: FieldInfo) -> str:
    default = field.get_default(call_default_factory=True)
    if default is None:
        return "optional"
    if isinstance(default, BaseModel):
        return "default: its defaults"
    if typing.get_origin(field.annotation) is typing.Literal and len(typing.get_args(field.annotation)) == 1:
        return "fixed"
    return f"default `{default!r}`" if default != "" else "default empty"


def _limits(field: FieldInfo, spec: Any) -> list[str]:
    """Return the constraints of a field in words."""
    if spec is not None:
        return ["finite"] if getattr(spec, "dtype", "") == "<f8" else []
    found: list[str] = []
    for prefix, metadata, annotation in _annotations(field):
        literal = typing.get_args(annotation) if typing.get_origin(annotation) is typing.Literal else ()
        if literal:
            found.append(prefix + "one of " + ", ".join(f"`{value}`" for value in literal))
        for item in metadata:
            for kind, (attribute, sign) in _BOUNDS.items():
                if isinstance(item, kind):
                    found.append(f"{prefix}{sign} {_number(getattr(item, attribute))}")
            if isinstance(item, annotated_types.MinLen):
                found.append(f"{prefix}length >= {item.min_length}")
            if isinstance(item, annotated_types.MaxLen):
                found.append(f"{prefix}length <= {item.max_length}")
    return list(dict.fromkeys(found))


def _annotations(field: FieldInfo) -> Iterator[tuple[str, list[Any], Any]]:
    """Yield (prefix, constraints, type) of a field and of the entries of its lists."""
    yield "", list(field.metadata), field.annotation
    yield from _inner("", field.annotation)


def _inner(prefix: str, annotation: Any) -> Iterator[tuple[str, list[Any], Any]]:
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is typing.Annotated:
        metadata: list[Any] = []
        for item in arguments[1:]:
            metadata += list(item.metadata) if isinstance(item, FieldInfo) else [item]
        yield prefix, metadata, arguments[0]
        yield from _inner(prefix, arguments[0])
    elif origin in (list, tuple):
        yield from _inner("each ", arguments[0])
    elif origin in (typing.Union, types.UnionType):
        for argument in arguments:
            yield from _inner(prefix, argument)


def _number(value: Any) -> str:
    powers = {2**63: "2^63", -(2**63): "-2^63"}
    return powers.get(value, f"{value:g}")


def _parts() -> list[type[Part]]:
    found: dict[type[Part], None] = {}

    def look(annotation: Any) -> None:
        if isinstance(annotation, type) and issubclass(annotation, Part):
            found[annotation] = None
            for field in annotation.model_fields.values():
                look(field.annotation)
        for argument in typing.get_args(annotation):
            look(argument)

    for message in messages():
        for field in message.model_fields.values():
            look(field.annotation)
    return list(found)


def _sentence(model: type[BaseModel]) -> str:
    paragraphs = (model.__doc__ or "").strip().split("\n\n")
    return " ".join(" ".join(paragraph.split()) for paragraph in paragraphs)


def _hex_rows(frame: bytes) -> list[str]:
    rows = []
    for start in range(0, len(frame), 16):
        piece = frame[start : start + 16]
        text = "".join(chr(byte) if 32 <= byte < 127 else "." for byte in piece)
        rows.append(f"{start:04x}  {piece.hex(' '):<47}  {text}")
    return rows


def _readable(value: dict[str, Any], indent: str = "") -> list[str]:
    lines = []
    for key, entry in value.items():
        if isinstance(entry, dict) and entry:
            lines += [f"{indent}{key}:", *_readable(entry, indent + "  ")]
        else:
            lines.append(f"{indent}{key}: {entry!r}")
    return lines


def main() -> None:
    """Rewrite the generated parts of `SPEC.md`."""
    SPEC.write_text(specification(SPEC.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
