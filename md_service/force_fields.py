"""Force fields as data: named profiles from ``data/force_fields.toml``, and a user's own LAMMPS commands.

A user's commands come over the wire from another process, so only commands that describe a force field pass, and only
files of the installed LAMMPS or of a folder that the owner of the service names.
"""

from __future__ import annotations

import re
import tomllib
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from md_service import units
from md_service.errors import EngineError
from md_service.lammps_library import potentials_folder

if TYPE_CHECKING:
    from md_service.atoms import Atoms

_PROFILES: Final = Path(__file__).with_name("data") / "force_fields.toml"
_PER_METRE, _PER_SECOND = 1e10, 1e15  # angstrom, femtoseconds

_ATOM_STYLES: Final = ("atomic", "charge", "full")
_ALLOWED_COMMANDS: Final = (
    *("pair_style", "pair_coeff", "pair_modify", "bond_style", "bond_coeff", "angle_style", "angle_coeff"),
    *("dihedral_style", "dihedral_coeff", "improper_style", "improper_coeff", "special_bonds"),
    *("kspace_style", "kspace_modify", "mass", "set"),
)
# No quotes, $, &, # or line breaks, by which LAMMPS would read more than one plain command.
_PLAIN_WORD: Final = re.compile(r"[\w.,:=+*/@-]+", re.ASCII)
# Styles that run Python code or load pickled objects, and references to variables, computes and fixes.
_REFUSED_WORD: Final = re.compile(r"(?i:python|mliap\w*)|[vcf]_\w*")
_FILE_NAME: Final = re.compile(r"(?=.*[A-Za-z_]).*\..*")
_NUMBER: Final = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
_SET_CHARGE: Final = re.compile(r"set type [\w*]+ charge \S+")

_STICKING = (
    "Tip bonds can stick at {start:.2f} A, where the switching function of this potential sets in: the force there "
    "is an artefact of the cut-off, so a bond may hold far above the physical load."
)


@dataclass(frozen=True)
class ForceField:
    """One force field.

    Attributes
    ----------
    name, summary, source : str
        Name in scene files, what it is, and where it was published.
    unit_style, atom_style : str
        Of LAMMPS.
    elements : tuple of str
        Chemical symbols it knows; empty for a user's own commands, of which nothing is known.
    styles : tuple of str
        LAMMPS commands, with ``{file}`` for the potential file and ``{elements}`` for the symbols of the sample's
        species.
    time_step : float
        Recommended, s.
    file_name : str, optional
        Potential file in the installed LAMMPS.
    fixes : tuple of str
        LAMMPS fixes that belong to it, such as charge equilibration.
    molecular : bool
        Whether it needs a topology of bonds, with coefficients by type label.
    pairwise : bool
        Whether forces act between pairs alone; then a flat sheet has no stiffness across, and moves in its plane.
    lattice : dict of str to dict of float to float
        Nearest-neighbour distance, m, of each material by temperature, K; the first is 0 K.
    lattice_error : dict of str to dict of float to float
        Standard errors of these, m.
    switching_start, switching_end : float, optional
        Distances between which the potential switches a bond off, m. A bond longer than `switching_end` is broken.
        None where nothing is switched off within reach of a bond.
    cutoff_trap : str
        What the switching function does to a stretched bond, in plain words.
    cure : str
        What to do about it.
    cut_energy : float, optional
        Energy of a carbon-carbon bond at the cut that is not spent, J, where the potential cuts bonds.
    face_energy : float, optional
        Energy of the two faces of a straight zigzag crack in graphene, J per m^2 of crack (twice the surface energy),
        relaxed, at a thickness of 3.35 angstrom: what a crack must be given to grow if nothing is cut.
    traps : tuple of str
        What else to know before use.
    replaced_parameters : tuple of (str, float)
        Parameters of the potential file that are changed in a copy of it, in the file's units.
    """

    name: str
    summary: str
    source: str
    unit_style: str
    atom_style: str
    elements: tuple[str, ...]
    styles: tuple[str, ...]
    time_step: float
    file_name: str | None = None
    fixes: tuple[str, ...] = ()
    molecular: bool = False
    pairwise: bool = False
    lattice: dict[str, dict[float, float]] = field(default_factory=dict, hash=False)
    lattice_error: dict[str, dict[float, float]] = field(default_factory=dict, hash=False)
    switching_start: float | None = None
    switching_end: float | None = None
    cutoff_trap: str = ""
    cure: str = ""
    cut_energy: float | None = None
    face_energy: float | None = None
    traps: tuple[str, ...] = ()
    replaced_parameters: tuple[tuple[str, float], ...] = ()

    @property
    def units(self) -> units.UnitSystem:
        """What its LAMMPS units are in SI."""
        return units.UNIT_SYSTEMS[self.unit_style]

    @property
    def materials(self) -> tuple[str, ...]:
        """Materials whose lattice is known."""
        return tuple(self.lattice)

    @property
    def lattice_constant(self) -> float:
        """Carbon-carbon distance of flat graphene at 0 K, m."""
        return self.spacing("graphene", 0.0)

    def spacing(self, material: str, temperature: float) -> float:
        """Nearest-neighbour distance of a material without stress.

        Parameters
        ----------
        material : str
            One of `materials`.
        temperature : float
            K; between the temperatures of the table the distance is interpolated, and up to twice the highest one
            it follows the line of the last two. Where only 0 K is known, only 0 K is allowed.

        Returns
        -------
        float
            m.

        Raises
        ------
        ValueError
            If the material is unknown here, or the temperature negative or beyond twice the highest one known.
        """
        if material not in self.lattice:
            known = ", ".join(self.lattice) or "none"
            raise ValueError(f"force field {self.name} has no lattice of material {material!r}; it has {known}")
        kelvin = sorted(self.lattice[material])
        if not 0.0 <= temperature <= 2.0 * kelvin[-1]:
            raise ValueError(
                f"temperature is {temperature} K; the lattice of {material} with force field {self.name} is known up "
                f"to {kelvin[-1]:g} K and used up to twice that"
            )
        if temperature in self.lattice[material]:
            return self.lattice[material][temperature]
        length = [self.lattice[material][known] for known in kelvin]
        upper = min(max(bisect_left(kelvin, temperature), 1), len(kelvin) - 1)
        slope = (length[upper] - length[upper - 1]) / (kelvin[upper] - kelvin[upper - 1])
        return length[upper] + slope * (temperature - kelvin[upper])

    def severing_trap(self, atoms: Atoms) -> str:
        """Why a sample with this force field cannot be severed along a line; empty where it can."""
        if atoms.topology is not None and self.atom_style == "full":
            return f"force field {self.name} holds molecules together by lists of bonds, which a cut does not sever"
        if any(line.startswith("kspace_style") for line in self.styles):
            return f"force field {self.name} has forces by kspace_style, which know no pairs that a cut could sever"
        return ""

    def commands(self, work_dir: Path, atoms: Atoms) -> list[str]:
        """LAMMPS commands that set this force field, once the atoms and their masses are there.

        Parameters
        ----------
        work_dir : Path
            A changed copy of the potential file is written here if the profile needs one.
        atoms : Atoms
            The sample, whose species are the atom types in this order.

        Returns
        -------
        list of str
            From ``pair_style`` to the last coefficient.

        Raises
        ------
        ValueError
            If the sample has an element or lacks bonds that this force field needs.
        EngineError
            If the installed LAMMPS lacks the potential file.
        """
        unknown = [element for element in atoms.elements if element not in self.elements]
        if unknown and self.elements:
            raise ValueError(
                f"force field {self.name} knows {', '.join(self.elements)}; the sample has {', '.join(unknown)}"
            )
        path = "" if self.file_name is None else f'"{self._file(work_dir)}"'
        elements = " ".join(atoms.elements)
        lines = [line.replace("{file}", path).replace("{elements}", elements) for line in self.styles]
        if self.molecular:
            if atoms.topology is None:
                raise ValueError(f"force field {self.name} needs the bonds of the molecules; the sample has none")
            from md_service.opls import coefficient_commands

            lines += coefficient_commands(atoms)
        return lines

    def _file(self, work_dir: Path) -> Path:
        """Path of the potential file, of the changed copy where parameters are replaced."""
        source = potentials_folder() / str(self.file_name)
        if not source.is_file():
            raise EngineError(f"force field {self.name} needs {source.name}, which is not in {source.parent}")
        if not self.replaced_parameters:
            return source
        text = source.read_text(encoding="utf-8")
        for parameter, value in self.replaced_parameters:
            text, count = re.subn(rf"^\S+(\s+{parameter}\s*)$", rf"{value}\1", text, flags=re.MULTILINE)
            if count != 1:
                raise ValueError(f"{source.name} holds the parameter {parameter} {count} times, needed once")
        copy = work_dir / f"{self.name}.{self.file_name}"
        # Every rank writes the same bytes; replacing keeps a reader from seeing half a file.
        unfinished = copy.with_name(f"{copy.name}.{id(self)}")
        unfinished.write_text(text, encoding="utf-8")
        unfinished.replace(copy)
        return copy


def _profile(name: str, entry: dict[str, Any]) -> ForceField:
    start, end = (value / _PER_METRE for value in entry["switching"]) if "switching" in entry else (None, None)
    trap = "" if start is None else _STICKING.format(start=start * _PER_METRE)
    return ForceField(
        name=name,
        summary=entry["summary"],
        source=entry["source"],
        unit_style=entry["unit_style"],
        atom_style=entry["atom_style"],
        elements=tuple(entry["elements"]),
        styles=tuple(entry["styles"]),
        time_step=entry["time_step"] / _PER_SECOND,
        file_name=entry.get("file"),
        fixes=tuple(entry.get("fixes", ())),
        molecular=entry.get("molecular", False),
        pairwise=entry.get("pairwise", False),
        lattice={material: _column(rows, 0) for material, rows in entry.get("lattice", {}).items()},
        lattice_error={material: _column(rows, 1) for material, rows in entry.get("lattice", {}).items()},
        switching_start=start,
        switching_end=end,
        cutoff_trap=entry.get("cutoff_trap", trap),
        cure=entry.get("cure", ""),
        cut_energy=entry["cut_energy"] * units.ENERGY if "cut_energy" in entry else None,
        face_energy=entry.get("face_energy"),
        traps=tuple(entry.get("traps", ())),
        replaced_parameters=tuple(entry.get("replaced", {}).items()),
    )


def _column(rows: list[list[float]], column: int) -> dict[float, float]:
    """Lengths in m by temperature, from rows of temperature, distance and standard error."""
    return {float(row[0]): row[1 + column] / _PER_METRE for row in rows}


def _read_profiles() -> dict[str, ForceField]:
    with _PROFILES.open("rb") as file:
        return {name: _profile(name, entry) for name, entry in tomllib.load(file).items()}


FORCE_FIELDS: Final[dict[str, ForceField]] = _read_profiles()


def force_field(name: str) -> ForceField:
    """Profile of a force field.

    Parameters
    ----------
    name : str
        One of the keys of `FORCE_FIELDS`.

    Raises
    ------
    ValueError
        If no profile has that name.
    """
    if name not in FORCE_FIELDS:
        raise ValueError(f"force_field is {name!r}; known are {', '.join(sorted(FORCE_FIELDS))}")
    return FORCE_FIELDS[name]


def custom_force_field(
    name: str,
    unit_style: str,
    atom_style: str,
    commands: Sequence[str],
    time_step: float,
    folder: Path | None = None,
) -> ForceField:
    """Force field from a user's own LAMMPS commands.

    Parameters
    ----------
    name : str
        For messages and logs.
    unit_style : str
        ``metal`` or ``real``: the units of all numbers in the commands.
    atom_style : str
        ``atomic``, ``charge`` or ``full``.
    commands : sequence of str
        Commands that set styles and coefficients, one per entry. Allowed are those for pairs, bonds, angles, dihedrals,
        impropers, ``special_bonds``, long-range solvers, ``mass``, and ``set type T charge Q``. A word with a dot that
        is no number is the name of a file, of `folder` or of the installed LAMMPS.
    time_step : float
        s.
    folder : Path, optional
        Folder of the user's own potential files.

    Returns
    -------
    ForceField
        Without lattices, and with no knowledge of where bonds break.

    Raises
    ------
    ValueError
        For a style that is not known, a time step that is not positive, no ``pair_style`` or ``bond_style``, a
        command or word that is not allowed, or a file that is in none of the two folders.
    """
    if unit_style not in units.UNIT_SYSTEMS:
        raise ValueError(f"unit_style is {unit_style!r}; it must be one of {', '.join(units.UNIT_SYSTEMS)}")
    if atom_style not in _ATOM_STYLES:
        raise ValueError(f"atom_style is {atom_style!r}; it must be one of {', '.join(_ATOM_STYLES)}")
    if not 0.0 < time_step < 1e-12:
        raise ValueError(f"time_step is {time_step} s; it must be positive and below 1 ps")
    folders = [potentials_folder()] if folder is None else [folder, potentials_folder()]
    styles = tuple(_checked_command(f"commands[{row}]", line, folders) for row, line in enumerate(commands))
    if not any(line.startswith(("pair_style ", "bond_style ")) for line in styles):
        raise ValueError("commands hold neither pair_style nor bond_style, so no atom would feel a force")
    return ForceField(
        name=name,
        summary="a user's own commands",
        source="not stated",
        unit_style=unit_style,
        atom_style=atom_style,
        elements=(),
        styles=styles,
        time_step=float(time_step),
    )


def _checked_command(where: str, line: str, folders: Sequence[Path]) -> str:
    """Return the command with the paths of its files filled in, or raise ValueError."""
    words = line.split(" ")
    for word in filter(None, words):
        if not _PLAIN_WORD.fullmatch(word) or _REFUSED_WORD.fullmatch(word.split("/")[0]):
            raise ValueError(f"{where} is {line!r}; the word {word!r} is not allowed in a force field")
    words = [word for word in words if word]
    if not words or words[0] not in _ALLOWED_COMMANDS:
        raise ValueError(f"{where} is {line!r}; allowed commands are {', '.join(_ALLOWED_COMMANDS)}")
    if words[0] == "set" and not (_SET_CHARGE.fullmatch(" ".join(words)) and _NUMBER.fullmatch(words[-1])):
        raise ValueError(f"{where} is {line!r}; of set only 'set type T charge Q' is allowed")
    return " ".join([words[0], *(_with_path(f"{where} is {line!r}", word, folders) for word in words[1:])])


def _with_path(where: str, word: str, folders: Sequence[Path]) -> str:
    """Return a file's quoted path in place of its name; other words as they are."""
    if word.startswith("/") or ".." in word:
        raise ValueError(f"{where}; {word!r} is not the plain name of a file, which is all that is allowed")
    for folder in folders:
        path = (folder / word).resolve()
        if path.is_file() and path.is_relative_to(folder.resolve()):
            return f'"{path}"'
    if _FILE_NAME.fullmatch(word) and not _NUMBER.fullmatch(word):
        raise ValueError(f"{where}; there is no file {word!r} in {' or '.join(str(folder) for folder in folders)}")
    return word
