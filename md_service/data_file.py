"""LAMMPS data files: samples on disk, readable by LAMMPS, OVITO and every other tool that reads that format.

The first line, a comment to LAMMPS, also holds as JSON what the format has no place for, so that a sample is read back
as it was written. Lengths are moved between m and Angstrom by their decimal exponent, which loses no bit.
"""

from __future__ import annotations

import gzip
import json
import re
import zlib
from collections.abc import Iterable
from dataclasses import asdict
from decimal import Decimal
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from md_service import units
from md_service.atoms import Atoms, Box, CrackCut, Topology
from md_service.chemical_elements import element_of

#: Columns of the section Atoms before the coordinates, for each atom style that is written.
COLUMNS: Final = {"atomic": ("id", "type"), "charge": ("id", "type", "q"), "full": ("id", "mol", "type", "q")}
_READABLE: Final = {**COLUMNS, **dict.fromkeys(("bond", "angle", "molecular"), ("id", "mol", "type"))}
_ANGSTROM: Final = 10  # 1 m is 1e10 Angstrom, in both unit styles
_SPEED: Final = {"metal": -2, "real": -5}  # 1 m/s in Angstrom/ps and Angstrom/fs is one to this power of ten
_MARK: Final = "scalebridge"
_MOST_TYPES: Final = 100_000  # more is a broken header
_PARTS: Final = {"bond": 2, "angle": 3, "dihedral": 4, "improper": 4}  # and the atoms in each
_SECTIONS: Final = re.compile(
    r"(Masses|Atoms|Velocities|Bonds|Angles|Dihedrals|Impropers|Ellipsoids|Lines|Triangles|Bodies"
    r"|(?:Atom|Bond|Angle|Dihedral|Improper) Type Labels"
    r"|(?:Pair|PairIJ|Bond|Angle|Dihedral|Improper|\w+Bond\w*|\w+Angle\w*|\w+Torsion) Coeffs)\s*(?:#\s*(\S+).*)?"
)


def write_data_file(
    path: Path, atoms: Atoms, unit_style: str, atom_style: str, velocity: NDArray[np.float64] | None = None
) -> None:
    """Write a sample as a LAMMPS data file; packed if the name ends in ``.gz``.

    Coordinates are written inside the box with image flags. What the atom style has no place for (charges in
    ``atomic``, bonds in all but ``full``) is left out.

    Parameters
    ----------
    path : Path
        File to write.
    atoms : Atoms
        The sample.
    unit_style : str
        ``metal`` or ``real``.
    atom_style : str
        ``atomic``, ``charge`` or ``full``.
    velocity : ndarray, shape (n, 3), optional
        m/s.

    Raises
    ------
    ValueError
        For an unknown style, an array of the wrong shape or with numbers that are not finite, an atom outside of the
        box in a free direction, or a name that LAMMPS does not take as a type label.
    """
    if unit_style not in _SPEED:
        raise ValueError(f"unit_style is {unit_style!r}; it must be one of {', '.join(_SPEED)}")
    if atom_style not in COLUMNS:
        raise ValueError(f"atom_style is {atom_style!r}; it must be one of {', '.join(COLUMNS)}")
    _check(atoms, velocity)
    topology = atoms.topology if atom_style == "full" else None

    lines = [_first_line(atoms, unit_style, atom_style), "", f"{len(atoms)} atoms", f"{len(atoms.species)} atom types"]
    for part in _PARTS if topology is not None else ():
        lines.append(f"{len(getattr(topology, part + 's'))} {part}s")
        lines.append(f"{len(getattr(topology, part + '_names'))} {part} types")
    low, high = _shifted(atoms.box.low, _ANGSTROM), _shifted(atoms.box.high, _ANGSTROM)
    lines += [f"{low[i]} {high[i]} {axis}lo {axis}hi" for i, axis in enumerate("xyz")]
    if np.any(atoms.box.tilt):
        lines.append(" ".join(_shifted(atoms.box.tilt, _ANGSTROM)) + " xy xz yz")
    lines += _label_section("Atom", atoms.species)
    for part in _PARTS if topology is not None else ():
        lines += _label_section(part.capitalize(), getattr(topology, part + "_names"))

    lines += ["", "Masses", ""]
    weights = (np.asarray(atoms.mass) / units.MASS).tolist()
    lines += [
        f"{i} {weight!r} # {name}" for i, (weight, name) in enumerate(zip(weights, atoms.species, strict=True), 1)
    ]
    lines += ["", f"Atoms # {atom_style}", "", *_atom_lines(atoms, atom_style)]
    if velocity is not None:
        rows = _triples(velocity, _SPEED[unit_style])
        lines += ["", "Velocities", "", *(f"{i} {row}" for i, row in enumerate(rows, 1))]
    for part in _PARTS if topology is not None else ():
        members = getattr(topology, part + "s")
        if len(members):
            lines += ["", part.capitalize() + "s", ""]
            lines += [f"{i} {' '.join(map(str, row))}" for i, row in enumerate((members + 1).tolist(), 1)]

    text = "\n".join(lines) + "\n"
    # No name and no time in the gzip header: the same sample gives the same file.
    if path.suffix == ".gz":
        path.write_bytes(gzip.compress(text.encode(), 9, mtime=0))
    else:
        path.write_text(text, encoding="utf-8")


def read_data_file(path: Path) -> tuple[Atoms, str | None]:
    """Read a LAMMPS data file of the atom styles atomic, charge, full, molecular, bond or angle.

    Of a file that `write_data_file` did not write, the box is taken as periodic along x, y and z, as LAMMPS does
    unless told otherwise; types without labels are named by their number, and elements are guessed from the masses.
    Coefficients and velocities in the file are not read.

    Parameters
    ----------
    path : Path
        Plain or, with the suffix ``.gz``, packed.

    Returns
    -------
    atoms : Atoms
        Rows in the order of the atom ids.
    unit_style : str or None
        ``metal`` or ``real``, or None if the file does not say. Lengths and masses are the same in both.

    Raises
    ------
    ValueError
        If the file is not such a data file, naming the file and what is wrong.
    """
    try:
        raw = gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes()
        return _parsed(raw.decode("utf-8", errors="replace").splitlines())
    except (ValueError, TypeError, LookupError, ArithmeticError, EOFError, OSError, zlib.error) as error:
        if isinstance(error, FileNotFoundError | PermissionError | IsADirectoryError):
            raise
        reason = str(error) if type(error) is ValueError else f"it is no LAMMPS data file ({error!r})"
        raise ValueError(f"{path}: {reason}") from error


def _check(atoms: Atoms, velocity: NDArray[np.float64] | None) -> None:
    n = len(atoms)
    for name, array in (("position", atoms.position), ("velocity", velocity)):
        if array is not None and (array.shape != (n, 3) or not np.isfinite(array).all()):
            raise ValueError(f"{name} has shape {array.shape}; it must be ({n}, 3) and every number in it finite")
    box = atoms.box
    if not np.all(box.high > box.low):
        raise ValueError(f"box reaches from {box.low} m to {box.high} m; each edge must be longer than zero")
    for axis in np.flatnonzero(~np.array(box.periodic)):
        outside = (atoms.position[:, axis] < box.low[axis]) | (atoms.position[:, axis] > box.high[axis])
        if outside.any():
            atom = int(np.argmax(outside))
            raise ValueError(
                f"atom {atom} at {atoms.position[atom]} m is outside of the box along {'xyz'[axis]}, where it does not "
                f"repeat: {box.low[axis]} m to {box.high[axis]} m"
            )


def _first_line(atoms: Atoms, unit_style: str, atom_style: str) -> str:
    notes: dict[str, Any] = {
        "elements": atoms.elements,
        "mass": np.asarray(atoms.mass).tolist(),
        "periodic": atoms.box.periodic,
        "spacing": atoms.spacing,
        "thickness": atoms.thickness,
        "site_volume": atoms.site_volume,
        "crack": None if atoms.crack is None else asdict(atoms.crack),
        "charge": atoms.charge is not None and "q" in COLUMNS[atom_style],
        "molecule": atoms.molecule is not None and "mol" in COLUMNS[atom_style],
        "topology": atoms.topology is not None and atom_style == "full",
        "notes": atoms.notes,
    }
    # LAMMPS itself looks for "units = " in this line and warns if they are not those of the run.
    return f"LAMMPS data file, units = {unit_style}, {_MARK} {json.dumps(notes, default=_plain)}"


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    raise ValueError(f"a note is {value!r}; it must be text or a number")


def _shifted(values: Iterable[float], power: int) -> list[str]:
    """Texts of values times a power of ten, exact."""
    return [str(Decimal(repr(value)).scaleb(power)) for value in np.asarray(values, dtype=np.float64).tolist()]


def _triples(values: NDArray[np.float64], power: int) -> list[str]:
    texts = _shifted(values.ravel(), power)
    return [" ".join(texts[i : i + 3]) for i in range(0, len(texts), 3)]


def _unshifted(texts: Iterable[str], power: int) -> NDArray[np.float64]:
    return np.array([float(Decimal(text).scaleb(-power)) for text in texts])


def _numbered(names: tuple[str, ...]) -> bool:
    return names == tuple(str(i) for i in range(1, len(names) + 1))


def _label_section(kind: str, names: tuple[str, ...]) -> list[str]:
    if not names or _numbered(names):
        return []
    for name in names:
        if not re.fullmatch(r"[^\s\d#*][^\s#]*", name) or names.count(name) > 1:
            raise ValueError(
                f"{kind.lower()} type is named {name!r}; names must differ, and start with no digit, '#' or '*' and "
                "hold no space"
            )
    return ["", f"{kind} Type Labels", "", *(f"{i} {name}" for i, name in enumerate(names, 1))]


def _atom_lines(atoms: Atoms, atom_style: str) -> list[str]:
    n = len(atoms)
    inside, images = atoms.box.wrapped(atoms.position)
    charge = np.zeros(n) if atoms.charge is None else atoms.charge
    molecule = np.zeros(n, dtype=np.int64) if atoms.molecule is None else atoms.molecule
    columns = {
        "id": map(str, range(1, n + 1)),
        "type": map(str, (atoms.kind + 1).tolist()),
        "mol": map(str, molecule.tolist()),
        "q": map(repr, np.asarray(charge, dtype=np.float64).tolist()),
    }
    chosen = [columns[name] for name in COLUMNS[atom_style]]
    image_texts = [f"{i} {j} {k}" for i, j, k in images.tolist()]
    return [" ".join(row) for row in zip(*chosen, _triples(inside, _ANGSTROM), image_texts, strict=True)]


class _Section:
    """Lines of a section, split into words, and the style in the comment behind its name."""

    def __init__(self, hint: str | None) -> None:
        self.hint = hint
        self.rows: list[list[str]] = []


def _parsed(lines: list[str]) -> tuple[Atoms, str | None]:
    if not lines:
        raise ValueError("it is empty")
    unit_style, ours = _first_line_parsed(lines[0])
    header, sections = _split(lines[1:])
    counts = {name: int(words[0]) for name, words in header.items() if name in ("atoms", "atom types")}
    if set(counts) != {"atoms", "atom types"} or "Atoms" not in sections:
        raise ValueError("it is no LAMMPS data file: 'atoms', 'atom types' or the section Atoms is missing")
    if "Masses" not in sections:
        raise ValueError("it has no section Masses")

    species = _names(sections, "Atom", counts["atom types"])
    mass = _masses(sections["Masses"], species)
    if ours and not len(ours["elements"]) == len(ours["mass"]) == len(species):
        raise ValueError(f"its first line has {len(ours['elements'])} elements for {len(species)} atom types")
    columns, position, images, ids = _atoms_parsed(sections["Atoms"], "bond types" in header)
    if len(ids) != counts["atoms"] or len(np.unique(ids)) != len(ids):
        raise ValueError(f"it announces {counts['atoms']} atoms, its section Atoms holds {len(np.unique(ids))}")
    kind = _types(columns["type"], species, "atom")
    box = _box(header, tuple(ours["periodic"]) if ours else (True, True, True))
    position = position + images @ box.edges
    topology = _topology(header, sections, ids)

    return (
        Atoms(
            position=np.ascontiguousarray(position),
            kind=kind,
            species=species,
            elements=tuple(ours["elements"]) if ours else tuple(element_of(m / units.MASS) for m in mass),
            mass=np.array(ours["mass"]) if ours else mass,
            box=box,
            charge=np.array(columns["q"], dtype=np.float64) if "q" in columns and ours.get("charge", True) else None,
            molecule=np.array(columns["mol"], dtype=np.int64)
            if "mol" in columns and ours.get("molecule", True)
            else None,
            topology=topology if ours.get("topology", True) else None,
            spacing=ours.get("spacing"),
            thickness=ours.get("thickness"),
            site_volume=ours.get("site_volume"),
            crack=CrackCut(**ours["crack"]) if ours.get("crack") else None,
            notes=ours.get("notes", {}),
        ),
        unit_style,
    )


def _first_line_parsed(line: str) -> tuple[str | None, dict[str, Any]]:
    found = re.search(r"units = (\w+)", line)
    unit_style = found.group(1) if found else None
    if unit_style not in (None, *_SPEED):
        raise ValueError(f"its units are {unit_style!r}; they must be one of {', '.join(_SPEED)}")
    _, mark, notes = line.partition(f", {_MARK} ")
    return unit_style, json.loads(notes) if mark else {}


def _split(lines: list[str]) -> tuple[dict[str, list[str]], dict[str, _Section]]:
    """Header values by keyword, and sections by name."""
    header: dict[str, list[str]] = {}
    sections: dict[str, _Section] = {}
    section: _Section | None = None
    for line in lines:
        if not line.strip():
            continue
        title = _SECTIONS.fullmatch(line.strip())
        if title is not None:
            section = sections[title.group(1)] = _Section(title.group(2))
            continue
        words = line.split("#")[0].split()
        if not words:
            continue
        if section is not None:
            section.rows.append(words)
            continue
        numbers = [word for word in words if re.fullmatch(r"[-+.\deE]+", word)]
        if not numbers or words[: len(numbers)] != numbers:
            raise ValueError(f"it is no LAMMPS data file: line {line.strip()[:80]!r} is not understood")
        header[" ".join(words[len(numbers) :])] = numbers
    if "avec" in header:
        raise ValueError("its box is given by avec, bvec, cvec; only xlo xhi and xy xz yz are read")
    return header, sections


def _names(sections: dict[str, _Section], kind: str, count: int) -> tuple[str, ...]:
    labels = sections.get(f"{kind} Type Labels")
    if count > _MOST_TYPES:
        raise ValueError(f"it announces {count} {kind.lower()} types; at most {_MOST_TYPES} are read")
    if labels is None:
        return tuple(str(i) for i in range(1, count + 1))
    by_number = {int(row[0]): row[1] for row in labels.rows}
    return tuple(by_number[i] for i in range(1, count + 1))


def _types(texts: list[str], names: tuple[str, ...], kind: str) -> NDArray[np.int64]:
    """Indices of types, which a file gives by number or by label."""
    index = {str(i): i - 1 for i in range(1, len(names) + 1)} | {name: i for i, name in enumerate(names)}
    unknown = sorted(set(texts) - set(index))
    if unknown:
        raise ValueError(f"{kind} type {unknown[0]!r} is none of its {len(names)} {kind} types")
    return np.array([index[text] for text in texts], dtype=np.int64)


def _masses(section: _Section, species: tuple[str, ...]) -> NDArray[np.float64]:
    mass = np.full(len(species), np.nan)
    mass[_types([row[0] for row in section.rows], species, "atom")] = [float(row[1]) for row in section.rows]
    if not np.all(mass > 0.0):
        raise ValueError(f"the mass of atom type {species[int(np.argmin(mass > 0.0))]!r} is missing or not positive")
    return mass * units.MASS


def _atoms_parsed(
    section: _Section, bonded: bool
) -> tuple[dict[str, list[str]], NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Columns before the coordinates, coordinates (m), images and ids, in the order of the ids."""
    lengths = {len(row) for row in section.rows}
    if len(lengths) != 1:
        raise ValueError(f"lines of its section Atoms have {sorted(lengths)} words; all must have the same number")
    width = lengths.pop()
    style = section.hint
    if style is None:
        # Charge and molecular have the same number of words; only the latter has bonds.
        likely = ("molecular", "full") if bonded else ("atomic", "charge", "full")
        style = next((name for name in likely if width - len(_READABLE[name]) in (3, 6)), "unknown")
    if style not in _READABLE or width - len(_READABLE[style]) not in (3, 6):
        raise ValueError(
            f"its atom style is {section.hint or 'not given'} with {width} words in a line; styles that are read are "
            f"{', '.join(_READABLE)}"
        )
    n_columns = len(_READABLE[style])
    rows = sorted(section.rows, key=lambda row: int(row[0]))
    columns = {name: [row[i] for row in rows] for i, name in enumerate(_READABLE[style])}
    position = _unshifted((word for row in rows for word in row[n_columns : n_columns + 3]), _ANGSTROM).reshape(-1, 3)
    if not np.isfinite(position).all():
        raise ValueError("a coordinate in its section Atoms is not finite")
    images = np.zeros((len(rows), 3), dtype=np.int64)
    if width == n_columns + 6:
        images[:] = [[int(word) for word in row[n_columns + 3 :]] for row in rows]
    return columns, position, images, np.array(columns["id"], dtype=np.int64)


def _box(header: dict[str, list[str]], periodic: tuple[bool, ...]) -> Box:
    edges = [header.get(f"{axis}lo {axis}hi", ["-0.5", "0.5"]) for axis in "xyz"]
    low, high = (_unshifted((edge[i] for edge in edges), _ANGSTROM) for i in (0, 1))
    x, y, z = periodic
    return Box(low, high, (x, y, z), _unshifted(header.get("xy xz yz", ["0", "0", "0"]), _ANGSTROM))


def _topology(header: dict[str, list[str]], sections: dict[str, _Section], ids: NDArray[np.int64]) -> Topology | None:
    if not any(f"{part} types" in header for part in _PARTS):
        return None
    found: dict[str, Any] = {}
    for part, width in _PARTS.items():
        names = _names(sections, part.capitalize(), int(header.get(f"{part} types", ["0"])[0]))
        rows = sections[part.capitalize() + "s"].rows if part.capitalize() + "s" in sections else []
        announced = int(header.get(f"{part}s", ["0"])[0])
        if len(rows) != announced:
            raise ValueError(f"it announces {announced} {part}s and holds {len(rows)}")
        rows.sort(key=lambda row: int(row[0]))
        members = np.zeros((len(rows), 1 + width), dtype=np.int64)
        members[:, 0] = _types([row[1] for row in rows], names, part)
        if rows:
            wanted = np.array([row[2 : 2 + width] for row in rows], dtype=np.int64)
            row_of = np.searchsorted(ids, wanted)
            if np.any(row_of >= len(ids)) or np.any(ids[np.minimum(row_of, len(ids) - 1)] != wanted):
                raise ValueError(f"a {part} names an atom that the file does not hold")
            members[:, 1:] = row_of
        found[part + "s"], found[part + "_names"] = members, names
    return Topology(**found)
