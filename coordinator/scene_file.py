"""Reads a TOML file with units into a model: overrides from the command line, every mistake reported at once."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, TypeAdapter, ValidationError
from pydantic.fields import FieldInfo

from coordinator.scene_checks import Problem
from coordinator.units import Quantity

Path_ = tuple[str | int, ...]
Table = TypeVar("Table", bound=BaseModel)
#: Checks between fields: given a model, or a draft of one, and the paths that the file holds.
CrossChecks = Callable[[Any, set[str]], list[Problem]]


class SceneError(ValueError):
    """A scene with mistakes.

    Parameters
    ----------
    problems : sequence of str
        One line per mistake: where, the value, what is allowed.
    """

    def __init__(self, problems: Sequence[str]) -> None:
        super().__init__("\n".join(problems))
        self.problems = tuple(problems)


def file_text(file: Path) -> str:
    """Return the text of a file.

    Raises
    ------
    SceneError
        If it cannot be read or is no text.
    """
    try:
        return file.read_text(encoding="utf-8")
    except OSError as error:
        raise SceneError([f"{file}: cannot be read: {error.strerror}"]) from None
    except UnicodeDecodeError:
        raise SceneError([f"{file}: is not UTF-8 text"]) from None


def read_table(
    table: type[Table], checks: CrossChecks, text: str, overrides: Sequence[str] = (), file: str = "scene"
) -> Table:
    """Read TOML into a model.

    Parameters
    ----------
    table : type of BaseModel
    checks : callable
    text : str
        TOML.
    overrides : sequence of str
        ``"key.sub=value"`` each, applied in order and checked like the file. The value is TOML, or,
        where it is not, taken as text; items of lists are addressed by number, from 0.
    file : str
        Name of the file in messages.

    Raises
    ------
    SceneError
        If the text is not TOML, or anything in it or the overrides is not allowed. Its text has one line per
        mistake, ``FILE: field.path = value: what is allowed``.
    """
    try:
        raw = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise SceneError([f"{file}: is not TOML: {error}"]) from None
    lines: list[str] = []
    overridden: list[Path_] = []
    for override in overrides:
        try:
            overridden.append(_apply(raw, override))
        except ValueError as error:
            lines.append(f"--set {override}: {error}")
    found, problems = validated(table, checks, raw)
    for where, allowed in problems:
        from_override = any(where[: len(key)] == key[: len(where)] for key in overridden)
        lines.append(problem_line("--set" if from_override else file, where, raw, allowed))
    if lines or found is None:
        raise SceneError(list(dict.fromkeys(lines)))
    return found


def validated(
    table: type[Table], checks: CrossChecks, raw: dict[str, Any], si: bool = False
) -> tuple[Table | None, list[Problem]]:
    """Return the model, or None and every problem in it; with `si` numbers are in SI already."""
    context = {"si": si}
    try:
        found = table.model_validate(raw, context=context)
    except ValidationError as error:
        problems: list[Problem] = [(item["loc"], _allowed(table, dict(item))) for item in error.errors()]
        return None, problems + checks(_draft(table, raw, context), _tables(raw))
    problems = checks(found, _tables(raw))
    return (None if problems else found), problems


def _tables(raw: Any, path: str = "") -> set[str]:
    """Return the paths of everything that the file holds, readable or not."""
    inner = raw.items() if isinstance(raw, dict) else enumerate(raw) if isinstance(raw, list) else ()
    found: set[str] = set()
    for key, value in inner:
        if value is not None:
            here = f"{path}.{key}" if path else str(key)
            found |= {here} | _tables(value, here)
    return found


def _apply(raw: dict[str, Any], override: str) -> Path_:
    """Set one value in `raw` and return its path."""
    key, equals, text = override.partition("=")
    parts = key.strip().split(".")
    if not equals or not all(parts):
        raise ValueError('must be "key.sub=value"')
    try:
        parsed = tomllib.loads(f"value = {text}")
        value = parsed["value"] if set(parsed) == {"value"} else text.strip()
    except tomllib.TOMLDecodeError:
        value = text.strip()
    path: list[str | int] = []
    place: Any = raw
    for depth, part in enumerate(parts):
        last = depth == len(parts) - 1
        if isinstance(place, list):
            if not part.isdecimal() or int(part) >= len(place):
                where = ".".join(str(step) for step in path)
                raise ValueError(f"{where} is a list of {len(place)}; {part!r} must be a number below that, from 0")
            index = int(part)
            path.append(index)
            if last:
                place[index] = value
            place = place[index]
        elif isinstance(place, dict):
            path.append(part)
            if last:
                place[part] = value
            else:
                place = place.setdefault(part, {})
        else:
            raise ValueError(f"{'.'.join(str(step) for step in path)} is a value, not a table")
    return tuple(path)


# --- one line per mistake -------------------------------------------------------------------------


def problem_line(file: str, where: Path_, raw: Any, allowed: str) -> str:
    """Return ``FILE: field.path = value: what is allowed``."""
    path = ".".join(str(part) for part in where)
    value: Any = raw
    for part in where:
        try:
            value = value[part]
        except (KeyError, IndexError, TypeError):
            return f"{file}: {path}: {allowed}"
    if isinstance(value, dict) or (isinstance(value, list) and any(isinstance(item, dict) for item in value)):
        return f"{file}: {path}: {allowed}"
    shown = _toml(value)
    return f"{file}: {path} = {shown if len(shown) <= 80 else shown[:77] + '...'}: {allowed}"


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, list):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    return str(value)


_COMPARISONS = {
    "greater_than": ("gt", "must be greater than {}"),
    "greater_than_equal": ("ge", "must be {} or greater"),
    "less_than": ("lt", "must be less than {}"),
    "less_than_equal": ("le", "must be {} or less"),
}
_KINDS = {
    "int_type": "must be a whole number",
    "float_type": "must be a number",
    "string_type": "must be text",
    "model_type": "must be a table",
    "model_attributes_type": "must be a table",
    "dict_type": "must be a table",
    "list_type": "must be a list",
    "tuple_type": "must be a list",
    "string_too_short": "must not be empty",
}


def _allowed(table: type[BaseModel], item: dict[str, Any]) -> str:
    """Say what is allowed where pydantic found a mistake."""
    kind, context = item["type"], item.get("ctx", {})
    if kind == "missing":
        return f"is missing{_needed(table, item['loc'])}"
    if kind == "extra_forbidden":
        known = list(_table_at(table, item["loc"][:-1]).model_fields)
        near = difflib.get_close_matches(str(item["loc"][-1]), known, 1, 0.5)
        return f"is no key of this table; {f'did you mean {near[0]}?' if near else 'known: ' + ', '.join(known)}"
    if kind in _COMPARISONS:
        name, text = _COMPARISONS[kind]
        return text.format(context[name])
    if kind == "literal_error":
        return f"must be one of {context['expected']}"
    if kind == "too_short":
        return f"has {context['actual_length']} values, must have at least {context['min_length']}"
    if kind == "too_long":
        return f"has {context['actual_length']} values, must have {context['max_length']}"
    return _KINDS.get(kind, item["msg"])


def _needed(table: type[BaseModel], where: Path_) -> str:
    """Describe the field at `where` for a message that it is missing."""
    if isinstance(where[-1], int):
        return "; the list is too short"
    field = _table_at(table, where[:-1]).model_fields[where[-1]]
    for item in field.metadata:
        if isinstance(item, Quantity):
            return f"; needed: {item.wanted()}"
    description = field.description
    return f"; needed: {description.split(',')[0]}" if description else "; it is needed"


def _table_at(table: type[BaseModel], where: Iterable[str | int]) -> type[BaseModel]:
    """Return the model of the table at a path."""
    for part in where:
        if isinstance(part, str):
            found = _table_of(table.model_fields[part])
            assert found is not None, where
            table = found
    return table


def _table_of(field: FieldInfo) -> type[BaseModel] | None:
    """Return the model that a field holds, alone, optional or in a list."""
    for kind in (field.annotation, *get_args(field.annotation)):
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            return kind
    return None


# --- drafts for the checks between fields ---------------------------------------------------------


class _Draft:
    """Stands for a table of which some fields could not be read; those are None."""

    def __init__(self, table: type[BaseModel], values: dict[str, Any]) -> None:
        self.__dict__.update(values)
        self._table = table

    def __getattr__(self, name: str) -> Any:
        # Properties of the table (axis, first_velocity) are computed from the draft's values.
        found = getattr(self._table, name)
        if isinstance(found, property) and found.fget is not None:
            return found.fget(self)
        raise AttributeError(name)


def _draft(table: type[BaseModel], raw: Any, context: dict[str, Any]) -> Any:
    """Read what can be read of a table; None where it is no table."""
    if not isinstance(raw, dict):
        return None
    values: dict[str, Any] = {}
    for name, field in table.model_fields.items():
        inner = _table_of(field)
        if name not in raw:
            values[name] = None if field.is_required() else field.get_default(call_default_factory=True)
        elif inner is not None and not _is_list(field):
            values[name] = _draft(inner, raw[name], context)
        elif inner is not None:
            items = raw[name] if isinstance(raw[name], list) else []
            drafts = [_draft(inner, item, context) for item in items]
            # A list with an item that is no table is left out: numbers of items would no longer fit.
            values[name] = None if any(draft is None for draft in drafts) else drafts
        else:
            try:
                annotated: Any = Annotated[field.annotation, field]
                adapter: TypeAdapter[Any] = TypeAdapter(annotated)
                values[name] = adapter.validate_python(raw[name], context=context)
            except ValidationError:
                values[name] = None
    return _Draft(table, values)


def _is_list(field: FieldInfo) -> bool:
    kinds = get_args(field.annotation) if get_origin(field.annotation) in (Union, UnionType) else ()
    return any(get_origin(kind) is list for kind in (field.annotation, *kinds))
