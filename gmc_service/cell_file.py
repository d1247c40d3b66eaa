"""Cell files: a repeating unit cell in TOML, with units.

A file has a table ``[cell]`` and one table ``[materials.NAME]`` for each phase::

    title = "IM7 in EPON 862"

    [cell]
    architecture = "square_2x2"        # see ARCHITECTURES
    fibre_fraction = 0.6
    stress_free_temperature = "450 K"

    [materials.fibre]
    from = "IM7"                       # an entry of the shipped database; further keys replace or complete its own

    [materials.matrix]
    from_file = "epoxy.toml"           # a constituent file, relative to this one
    fracture_energy = "200 J/m^2"
    reduces_strength = true            # in elements too long for that energy, instead of refusing them
    [[materials.matrix.failure]]       # replaces all allowables of the entry
    criterion = "maximum_stress"
    tension = "90 MPa"

A material may also give its constants itself, with ``kind``. Every mistake in the file is reported at once, with the
field, its value and what is allowed.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from gmc_service.architectures import (
    Architecture,
    OutOfRange,
    hexagonal_pack,
    layered,
    random_pack,
    square_pack,
    square_void,
    user_array,
)
from gmc_service.cell import AFTER_FAILURE, Cell
from gmc_service.constituents import constituent_entry, constituent_of_file
from gmc_service.material import Material
from gmc_service.material_table import EITHER, read_material
from gmc_service.toml_table import Mistakes, Table

#: Architectures of a cell file, with the phases that they need. The phases of ``array`` are the file's own.
ARCHITECTURES: Final[dict[str, tuple[str, ...]]] = {
    "square_2x2": ("fibre", "matrix"),
    "square_7x7": ("fibre", "matrix"),
    "square_26x26": ("fibre", "matrix"),
    "hexagonal": ("fibre", "matrix"),
    "random": ("fibre", "matrix"),
    "layered": ("fibre", "matrix"),
    "square_void": ("void", "matrix"),
    "array": (),
}


@dataclass(frozen=True, eq=False)
class NamedCell(Cell):
    """A cell as a file names it.

    Attributes
    ----------
    name : str
        Of the file, without its suffix.
    title : str
        A line for people; empty where the file has none.
    """

    name: str = ""
    title: str = ""

    def check_temperature(self, temperature: float) -> None:
        """Refuse a temperature at which the thermal expansion of a material matters that is not known.

        Parameters
        ----------
        temperature : float
            K.

        Raises
        ------
        ValueError
            If it is not the stress-free one, and a material has no thermal expansion.
        """
        unknown = [material.name for material in self.materials if not material.expansion_known]
        if unknown and temperature != self.stress_free_temperature:
            raise ValueError(
                f"temperature is {temperature:g} K; the thermal expansion of {', '.join(unknown)} is not known, so it "
                f"must be the stress-free temperature, {self.stress_free_temperature:g} K, or the cell file must give "
                "the coefficients"
            )


def read_cell(path: str | Path) -> NamedCell:
    """Read a cell file.

    Parameters
    ----------
    path : str or Path
        TOML, see the module.

    Returns
    -------
    NamedCell
        In SI.

    Raises
    ------
    Mistakes
        If the file cannot be read, is not TOML, or something in it is not allowed: a `ValueError` of which the text
        has one line per mistake, ``FILE: table.key = value: what is allowed``.
    """
    file = Path(path)
    try:
        values = tomllib.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise Mistakes([f"{file}: cannot be read: {error.strerror}"]) from None
    except UnicodeDecodeError:
        raise Mistakes([f"{file}: is not UTF-8 text"]) from None
    except tomllib.TOMLDecodeError as error:
        raise Mistakes([f"{file}: is not TOML: {error}"]) from None
    mistakes: list[str] = []
    whole = Table(str(file), "", values, mistakes)
    title = whole.text("title", required=False) or ""
    materials_table, cell_table = whole.table("materials"), whole.table("cell")
    whole.finish()
    names, materials = _materials(materials_table, file.parent) if materials_table else ([], [])
    settings: dict[str, Any] = {}
    architecture = None
    if cell_table is not None:
        architecture, needed = _architecture(cell_table, names)
        settings = _settings(cell_table)
        if materials_table is not None and needed:
            for phase in needed:
                if phase not in names:
                    materials_table.refuse(phase, "is missing; the architecture has this phase")
            for name in names:
                if name not in needed:
                    materials_table.refuse(name, f"is no phase of the architecture; it has {', '.join(needed)}")
            if set(names) == set(needed):
                materials = [materials[names.index(phase)] for phase in needed]
    found = [material for material in materials if material is not None]
    if mistakes or architecture is None or len(found) < len(materials):
        raise Mistakes(list(dict.fromkeys(mistakes)))
    try:
        return NamedCell(
            heights=architecture.heights,
            widths=architecture.widths,
            phase=architecture.phase,
            materials=tuple(found),
            name=file.stem,
            title=title,
            **settings,
        )
    except ValueError as error:
        raise Mistakes([f"{file}: cell: {error}"]) from None


def _settings(table: Table) -> dict[str, Any]:
    """What `Cell` takes beside geometry and materials; a key that is not given is left to its default."""
    given = {
        "stress_free_temperature": table.quantity("stress_free_temperature", "temperature", "zero", required=False),
        "knock_down": table.number("knock_down", required=False),
        "after_failure": table.choice("after_failure", AFTER_FAILURE, required=False),
    }
    factor = given["knock_down"]
    if isinstance(factor, float) and not 0.0 < factor <= 1.0:
        table.refuse("knock_down", "must be greater than 0 and at most 1")
        given["knock_down"] = None
    table.finish()
    return {key: value for key, value in given.items() if value is not None}


def _materials(table: Table, folder: Path) -> tuple[list[str], list[Material | None]]:
    """Names in the order of the file, and what was read of each."""
    names = list(table.values)
    return names, [_material(table.table(name), name, folder) for name in names]


def _material(table: Table | None, name: str, folder: Path) -> Material | None:
    if table is None:
        return None
    own = {key: value for key, value in table.values.items() if key not in ("from", "from_file")}
    entry: dict[str, Any] = {}
    try:
        if "from" in table and "from_file" in table:
            table.refuse("from_file", "and from are both given; a material has one origin")
            return None
        if "from" in table:
            origin = table.text("from")
            if origin is None:
                return None
            entry = constituent_entry(origin)
        elif "from_file" in table:
            origin = table.text("from_file")
            if origin is None:
                return None
            entry = constituent_of_file(folder / origin)
    except OSError as error:
        table.refuse("from_file", f"cannot be read: {error.strerror}")
        return None
    except ValueError as error:
        table.refuse("from" if "from" in table else "from_file", str(error))
        return None
    for pair in EITHER.values():  # one that the file gives takes the place of the other in the entry
        for one, other in (pair, pair[::-1]):
            if one in own and other not in own:
                entry.pop(other, None)
    for text in ("source", "note"):
        table.text(text, required=False)
        own.pop(text, None)
        entry.pop(text, None)
    return read_material(Table(table.file, table.where, entry | own, table.mistakes), name)


def _architecture(table: Table, names: list[str]) -> tuple[Architecture | None, tuple[str, ...]]:
    """Geometry, and the phases that it needs."""
    kind = table.choice("architecture", tuple(ARCHITECTURES))
    if kind is None:
        for key in table.values:
            table.raw(key)  # without the architecture nobody knows which keys there may be
        return None, ()
    if kind == "array":
        return _array(table, names), ()
    before = len(table.mistakes)
    fraction_key = "void_fraction" if kind == "square_void" else "fibre_fraction"
    given: dict[str, Any] = {
        "fraction": table.number(fraction_key),
        "size": table.quantity("size", "length", required=False),
    }
    build: Callable[..., Architecture]
    if kind.startswith("square_") and kind != "square_void":
        build = square_pack
        given["subcells"] = int(kind.rsplit("x", 1)[1])
    elif kind == "hexagonal":
        build = hexagonal_pack
        given["columns"] = table.whole("columns", required=False)
    elif kind == "random":
        build = random_pack
        given |= {"fibres": table.whole("fibres"), "seed": table.whole("seed")}
        given |= {"subcells": table.whole("subcells", required=False), "least_gap": table.number("least_gap", False)}
    elif kind == "layered":
        build = layered
        given["along"] = table.whole("along", required=False)
    else:
        build = square_void
    if len(table.mistakes) > before:
        return None, ARCHITECTURES[kind]
    try:
        built = build(**{key: value for key, value in given.items() if value is not None})
    except OutOfRange as error:
        table.refuse(fraction_key if error.field == "fraction" else error.field, error.allowed)
    except ValueError as error:
        table.refuse("architecture", str(error))
    else:
        return built, ARCHITECTURES[kind]
    return None, ARCHITECTURES[kind]


def _array(table: Table, names: list[str]) -> Architecture | None:
    heights, widths = table.quantities("heights", "length"), table.quantities("widths", "length")
    rows = table.raw("phase")
    if not (isinstance(rows, list) and rows and all(isinstance(row, list) and row for row in rows)):
        table.refuse("phase", 'must be a list of rows, each a list of names of materials, [["fibre", "matrix"], ...]')
        return None
    phase = []
    for number, row in enumerate(rows):
        for column, name in enumerate(row):
            if name not in names:
                table.refuse(f"phase.{number}.{column}", f"must be one of materials, {', '.join(names)}")
                return None
        phase.append([names.index(name) for name in row])
    for name in names:
        if not any(name in row for row in rows):
            table.refuse("phase", f"has no subcell of the material {name}")
            return None
    if heights is None or widths is None:
        return None
    try:
        return user_array(heights, widths, phase)
    except ValueError as error:
        table.refuse("phase", str(error))
        return None
