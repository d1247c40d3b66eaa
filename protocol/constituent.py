"""Constituent files: a material of a composite with errors and origin, as a micromechanics solver reads it.

The file is TOML. Every figure is a table of its value, its standard error where one is known, and its SI unit::

    format = "scalebridge constituent"
    version = 1

    [constituent]
    name = "epoxy_8"
    source = "molecular dynamics"                        # or a handbook, a test
    temperature = { value = 300.0, unit = "K" }
    density = { value = 1191.0, error = 3.0, unit = "kg/m^3" }

    [constituent.elastic]
    kind = "isotropic"                                   # see KINDS
    E = { value = 3.1e9, error = 0.1e9, unit = "Pa" }
    nu = { value = 0.36, error = 0.01, unit = "1" }

    [constituent.expansion]                              # optional; strain per kelvin
    alpha = { value = 6.0e-5, error = 4e-6, unit = "1/K" }

    [constituent.strength]                               # optional; along one axis
    tension = { value = 1.2e8, error = 5e6, unit = "Pa" }
    strain = { value = 0.08, unit = "1" }
    rate = { value = 1e9, unit = "1/s" }
    passed = true                                        # whether the stress fell behind its largest value

    [provenance]                                         # optional; text and numbers

Axis 1 is that of symmetry where the kind is transversely isotropic. The kind ``plane`` is a sheet in plane stress
with its thickness. This module needs nothing but numpy, so a reader of the file may take it as it is.
"""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

FORMAT: Final = "scalebridge constituent"
VERSION: Final = 1

#: Elastic constants of each kind, with their units.
KINDS: Final[dict[str, dict[str, str]]] = {
    "isotropic": {"E": "Pa", "nu": "1"},
    "transversely isotropic": {"E1": "Pa", "E2": "Pa", "nu12": "1", "nu23": "1", "G12": "Pa"},
    "orthotropic": {
        **{"E1": "Pa", "E2": "Pa", "E3": "Pa", "nu12": "1", "nu13": "1", "nu23": "1"},
        **{"G23": "Pa", "G13": "Pa", "G12": "Pa"},
    },
    "plane": {"E1": "Pa", "E2": "Pa", "nu12": "1", "G12": "Pa", "thickness": "m"},
}
#: Coefficients of thermal expansion of each kind, 1/K.
EXPANSIONS: Final[dict[str, tuple[str, ...]]] = {
    "isotropic": ("alpha",),
    "transversely isotropic": ("alpha1", "alpha2"),
    "orthotropic": ("alpha1", "alpha2", "alpha3"),
    "plane": ("alpha1", "alpha2"),
}
_LEAST_STABLE: Final = 1e-12  # eigenvalue of the compliance with ones on its diagonal
_STRENGTH: Final = {"tension": "Pa", "strain": "1", "rate": "1/s"}
_SIGNED: Final = {"nu", "nu12", "nu13", "nu23", "alpha", "alpha1", "alpha2", "alpha3"}
_BARE_KEY: Final = re.compile(r"[A-Za-z0-9_-]+")
_NOTE = str | int | float | bool


@dataclass(frozen=True)
class Figure:
    """A value with its standard error in the same SI unit, None where none is known."""

    value: float
    error: float | None = None


@dataclass(frozen=True)
class Strength:
    """Strength in uniaxial tension.

    Attributes
    ----------
    tension, strain, rate : Figure
        Largest stress, Pa, the strain at it, and the strain rate of the test, 1/s.
    passed : bool
        Whether the stress fell behind it. If not, the strength lies higher.
    """

    tension: Figure
    strain: Figure
    rate: Figure
    passed: bool


@dataclass(frozen=True)
class Constituent:
    """A material of a composite.

    Attributes
    ----------
    name, source : str
    temperature, density : Figure
        K and kg/m^3.
    kind : str
        One of `KINDS`.
    elastic : dict of str to Figure
        The constants that `KINDS` lists for the kind, SI.
    expansion : dict of str to Figure
        The coefficients that `EXPANSIONS` lists, 1/K; empty if not known.
    strength : Strength, optional
    provenance : dict
        Sample, force field, seed, command, whatever tells where the figures come from.

    Raises
    ------
    ValueError
        If a figure is missing, unknown, not finite, out of range, or the elastic constants are those of no stable
        material. The message starts with the field as it is called in the file.
    """

    name: str
    source: str
    temperature: Figure
    density: Figure
    kind: str
    elastic: dict[str, Figure]
    expansion: dict[str, Figure] = field(default_factory=dict)
    strength: Strength | None = None
    provenance: dict[str, _NOTE] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ValueError(f"constituent.elastic.kind is {self.kind!r}; it must be one of {', '.join(KINDS)}")
        _check_names("constituent.elastic", self.elastic, KINDS[self.kind])
        if self.expansion:
            _check_names("constituent.expansion", self.expansion, EXPANSIONS[self.kind])
        strength = {} if self.strength is None else {name: getattr(self.strength, name) for name in _STRENGTH}
        figures = {"constituent.temperature": self.temperature, "constituent.density": self.density}
        for table, entries in (("elastic", self.elastic), ("expansion", self.expansion), ("strength", strength)):
            figures |= {f"constituent.{table}.{name}": figure for name, figure in entries.items()}
        for path, figure in figures.items():
            _check_figure(path, figure)
        smallest = float(np.linalg.eigvalsh(_scaled(self.compliance())).min())
        if not smallest > _LEAST_STABLE:
            raise ValueError(
                "constituent.elastic holds constants of no stable material: some strain would release energy. An "
                "isotropic material needs nu between -1 and 0.5"
            )

    def compliance(self) -> NDArray[np.float64]:
        """Compliance in Voigt order 11, 22, 33, 23, 13, 12 with engineering shear, 1/Pa.

        Returns
        -------
        ndarray, shape (6, 6); (3, 3) in the order 11, 22, 12 for the kind ``plane``
        """
        constant = {name: figure.value for name, figure in self.elastic.items()}
        if self.kind == "isotropic":
            young, poisson = constant["E"], constant["nu"]
            shear = 0.5 * young / (1.0 + poisson) if poisson != -1.0 else math.inf
            return _compliance((young,) * 3, (poisson,) * 3, (shear,) * 3)
        if self.kind == "transversely isotropic":
            along, across = constant["E1"], constant["E2"]
            sliding = 0.5 * across / (1.0 + constant["nu23"]) if constant["nu23"] != -1.0 else math.inf
            ratios = (constant["nu12"], constant["nu12"], constant["nu23"])
            return _compliance((along, across, across), ratios, (sliding, constant["G12"], constant["G12"]))
        if self.kind == "plane":
            coupling = -constant["nu12"] / constant["E1"]
            inverse = np.diag([1.0 / constant["E1"], 1.0 / constant["E2"], 1.0 / constant["G12"]])
            inverse[0, 1] = inverse[1, 0] = coupling
            return inverse
        return _compliance(
            (constant["E1"], constant["E2"], constant["E3"]),
            (constant["nu12"], constant["nu13"], constant["nu23"]),
            (constant["G23"], constant["G13"], constant["G12"]),
        )

    def stiffness(self) -> NDArray[np.float64]:
        """Inverse of `compliance`, Pa."""
        return np.asarray(np.linalg.inv(self.compliance()), dtype=np.float64)


def write_constituent(path: Path, constituent: Constituent) -> None:
    """Write a constituent file.

    Parameters
    ----------
    path : Path
        File to write, usually ``*.toml``.
    constituent : Constituent
    """
    lines = [
        "# A material of a composite. Values and standard errors are in the SI units beside them.",
        f"format = {_text(FORMAT)}",
        f"version = {VERSION}",
        "",
        "[constituent]",
        f"name = {_text(constituent.name)}",
        f"source = {_text(constituent.source)}",
        _figure("temperature", constituent.temperature, "K"),
        _figure("density", constituent.density, "kg/m^3"),
        "",
        "[constituent.elastic]",
        f"kind = {_text(constituent.kind)}",
        *(_figure(name, constituent.elastic[name], unit) for name, unit in KINDS[constituent.kind].items()),
    ]
    if constituent.expansion:
        names = EXPANSIONS[constituent.kind]
        lines += ["", "[constituent.expansion]", *(_figure(name, constituent.expansion[name], "1/K") for name in names)]
    if constituent.strength is not None:
        lines += ["", "[constituent.strength]"]
        lines += [_figure(name, getattr(constituent.strength, name), unit) for name, unit in _STRENGTH.items()]
        lines.append(f"passed = {str(constituent.strength.passed).lower()}")
    if constituent.provenance:
        lines += ["", "[provenance]"]
        for key, value in constituent.provenance.items():
            lines.append(f"{key if _BARE_KEY.fullmatch(key) else _text(key)} = {_note(value)}")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def read_constituent(path: Path) -> Constituent:
    """Read and check a constituent file.

    Raises
    ------
    ValueError
        If the file is no constituent file, or a field is missing, unknown or out of range. The message names the
        file and the field.
    OSError
        If the file cannot be read.
    """
    try:
        with path.open("rb") as file:
            return _constituent(tomllib.load(file))
    except (ValueError, tomllib.TOMLDecodeError) as error:
        raise ValueError(f"{path}: {error}") from error


def _constituent(content: dict[str, Any]) -> Constituent:
    if content.get("format") != FORMAT:
        raise ValueError(f"format is {content.get('format')!r}; a constituent file has {FORMAT!r}")
    if content.get("version") != VERSION:
        raise ValueError(f"version is {content.get('version')!r}; this reader knows {VERSION}")
    _check_names("file", content, ("format", "version", "constituent"), ("provenance",))
    table = _table("constituent", content["constituent"])
    _check_names(
        "constituent", table, ("name", "source", "temperature", "density", "elastic"), ("expansion", "strength")
    )
    elastic = _table("constituent.elastic", table["elastic"])
    kind = elastic.get("kind")
    if kind not in KINDS:
        raise ValueError(f"constituent.elastic.kind is {kind!r}; it must be one of {', '.join(KINDS)}")
    constants = {name: value for name, value in elastic.items() if name != "kind"}
    _check_names("constituent.elastic", constants, KINDS[kind])
    expansion = _table("constituent.expansion", table.get("expansion", {}))
    strength = None
    if "strength" in table:
        entries = _table("constituent.strength", table["strength"])
        _check_names("constituent.strength", entries, (*_STRENGTH, "passed"))
        if not isinstance(entries["passed"], bool):
            raise ValueError(f"constituent.strength.passed is {entries['passed']!r}; it must be true or false")
        parts = {
            name: _read_figure(f"constituent.strength.{name}", entries[name], _STRENGTH[name]) for name in _STRENGTH
        }
        strength = Strength(**parts, passed=entries["passed"])
    for key in ("name", "source"):
        if not isinstance(table[key], str) or not table[key]:
            raise ValueError(f"constituent.{key} is {table[key]!r}; it must be a text")
    return Constituent(
        name=table["name"],
        source=table["source"],
        temperature=_read_figure("constituent.temperature", table["temperature"], "K"),
        density=_read_figure("constituent.density", table["density"], "kg/m^3"),
        kind=kind,
        elastic={
            name: _read_figure(f"constituent.elastic.{name}", constants[name], unit)
            for name, unit in KINDS[kind].items()
        },
        expansion={
            name: _read_figure(f"constituent.expansion.{name}", entry, "1/K") for name, entry in expansion.items()
        },
        strength=strength,
        provenance=_table("provenance", content.get("provenance", {})),
    )


def _table(path: str, entry: Any) -> dict[str, Any]:
    if not isinstance(entry, dict):
        raise ValueError(f"{path} is {entry!r}; it must be a table")
    return entry


def _check_names(path: str, entries: Mapping[str, Any], wanted: Any, optional: tuple[str, ...] = ()) -> None:
    for name in wanted:
        if name not in entries:
            raise ValueError(f"{path}.{name} is missing")
    known = (*wanted, *optional)
    for name in entries:
        if name not in known:
            raise ValueError(f"{path}.{name} is unknown; known are {', '.join(known)}")


def _read_figure(path: str, entry: Any, unit: str) -> Figure:
    wanted = f"it must be a table such as {{ value = 1.0, error = 0.1, unit = {_text(unit)} }}"
    if not isinstance(entry, dict):
        raise ValueError(f"{path} is {entry!r}; {wanted}")
    _check_names(path, entry, ("value", "unit"), ("error",))
    if entry["unit"] != unit:
        raise ValueError(f"{path}.unit is {entry['unit']!r}; it must be {unit!r}")
    for part in ("value", "error"):
        number = entry.get(part, 0.0)
        if isinstance(number, bool) or not isinstance(number, int | float):
            raise ValueError(f"{path}.{part} is {number!r}; it must be a number")
    return Figure(float(entry["value"]), None if "error" not in entry else float(entry["error"]))


def _check_figure(path: str, figure: Figure) -> None:
    name = path.rsplit(".", 1)[1]
    if not math.isfinite(figure.value):
        raise ValueError(f"{path} is {figure.value}; it must be finite")
    if name == "temperature":
        if figure.value < 0.0:
            raise ValueError(f"{path} is {figure.value} K; it must not be negative")
    elif name not in _SIGNED and not figure.value > 0.0:
        raise ValueError(f"{path} is {figure.value}; it must be positive")
    if figure.error is not None and not (math.isfinite(figure.error) and figure.error >= 0.0):
        raise ValueError(f"{path}.error is {figure.error}; it must be finite and not negative")


def _compliance(
    young: tuple[float, float, float], ratio: tuple[float, float, float], shear: tuple[float, float, float]
) -> NDArray[np.float64]:
    """Of moduli along 1, 2, 3, of nu12, nu13, nu23, and of G23, G13, G12."""
    inverse = np.diag([1.0 / modulus for modulus in (*young, *shear)])
    for (i, j), nu in zip(((0, 1), (0, 2), (1, 2)), ratio, strict=True):
        inverse[i, j] = inverse[j, i] = -nu / young[i]
    return inverse


def _scaled(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """A symmetric matrix with ones on its diagonal, which is as definite as the one given."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
    return matrix * np.outer(scale, scale)


def _figure(name: str, figure: Figure, unit: str) -> str:
    error = "" if figure.error is None else f", error = {_number(figure.error)}"
    return f"{name} = {{ value = {_number(figure.value)}{error}, unit = {_text(unit)} }}"


def _number(value: float) -> str:
    """A TOML float of nine digits, far below any standard error."""
    return repr(float(f"{value:.9g}"))


def _text(value: str) -> str:
    # TOML takes JSON's strings, but for the one control character that JSON does not escape.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _note(value: _NOTE) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return _text(value) if isinstance(value, str) else repr(value)
