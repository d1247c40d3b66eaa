"""The shipped database of constituents, and constituents from files that `scalebridge properties` writes."""

from __future__ import annotations

import difflib
import tomllib
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from gmc_service.material import Material
from gmc_service.material_table import KINDS, read_material
from gmc_service.toml_table import Mistakes, Table
from protocol.constituent import read_constituent

DATABASE = "constituents.toml"


def constituent_names() -> tuple[str, ...]:
    """Names of the shipped constituents, in the order of the file."""
    return tuple(_database())


def constituent_entry(name: str) -> dict[str, Any]:
    """A shipped constituent as it stands in the file: text with units, ``source``, often ``note``.

    Parameters
    ----------
    name : str

    Returns
    -------
    dict
        A copy.

    Raises
    ------
    ValueError
        If there is none of that name.
    """
    entries = _database()
    if name not in entries:
        near = difflib.get_close_matches(name, entries, 1, 0.5)
        hint = f"did you mean {near[0]!r}?" if near else f"known are {', '.join(entries)}"
        raise ValueError(f"constituent is {name!r}; there is none of that name; {hint}")
    return dict(entries[name])


def find_constituent(name: str) -> Material:
    """A shipped constituent.

    Parameters
    ----------
    name : str
        For example ``"IM7"``; all names: `constituent_names`.

    Returns
    -------
    Material
        With the allowables that its source gives.

    Raises
    ------
    ValueError
        If there is none of that name, or its source lacks a constant that its kind needs; the message names it.
    """
    entry = constituent_entry(name)
    mistakes: list[str] = []
    table = Table(DATABASE, name, entry, mistakes)
    table.text("source")
    table.text("note", required=False)
    material = read_material(table, name)
    if material is None:
        raise Mistakes(mistakes)
    return material


def constituent_of_file(path: Path) -> dict[str, Any]:
    """A constituent file as the keys of a material table.

    Parameters
    ----------
    path : Path
        As `protocol.constituent.write_constituent` writes it.

    Returns
    -------
    dict
        Kind, elastic constants, thermal expansion and density, as text with units. Its strength is none of them: it
        was reached at the strain rate of the file, so it becomes an allowable only where someone says so.

    Raises
    ------
    ValueError
        If it is no such file, or its kind is none of a constituent in a cell.
    OSError
        If it cannot be read.
    """
    constituent = read_constituent(path)
    if constituent.kind not in KINDS:
        raise ValueError(f"{path}: constituent.elastic.kind is {constituent.kind!r}; a cell takes {', '.join(KINDS)}")
    entry: dict[str, Any] = {"kind": constituent.kind, "density": f"{constituent.density.value!r} kg/m^3"}
    for key, figure in constituent.elastic.items():
        entry[key] = figure.value if key.startswith("nu") else f"{figure.value!r} Pa"
    for key, figure in constituent.expansion.items():
        entry[key] = f"{figure.value!r} 1/K"
    return entry


@cache
def _database() -> dict[str, dict[str, Any]]:
    return tomllib.loads(files("gmc_service").joinpath("data", DATABASE).read_text(encoding="utf-8"))
