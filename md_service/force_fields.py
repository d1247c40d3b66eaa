"""Carbon force fields that the engine knows, as data."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from md_service import units
from md_service.lammps_library import potentials_folder

CARBON_MASS: Final = 12.011 * units.MASS  # kg
RECOMMENDED_TIME_STEP: Final = 0.5e-15  # s

_STICKING = (
    "Tip bonds can stick at {start:.2f} A, where the switching function of this potential sets in: the force there "
    "is an artefact of the cut-off, so a bond may hold far above the physical load."
)


@dataclass(frozen=True)
class ForceField:
    """One force field for carbon.

    Attributes
    ----------
    name : str
        Name in scene files.
    pair_style : str
        Argument of the LAMMPS command ``pair_style``.
    file_name : str
        Potential file in the installed LAMMPS.
    lattice_constant : float
        Carbon-carbon distance of flat graphene at 0 K, m.
    time_step : float
        Recommended time step, s.
    switching_start, switching_end : float
        Distances between which the potential switches a carbon-carbon bond off, m. A bond longer than
        `switching_end` is broken.
    cutoff_trap : str
        What the switching function does to a stretched bond, in plain words.
    replaced_parameters : tuple of (str, float)
        Parameters of the potential file that are changed in a copy of it, in the file's units.
    """

    name: str
    pair_style: str
    file_name: str
    lattice_constant: float
    switching_start: float
    switching_end: float
    cutoff_trap: str
    time_step: float = RECOMMENDED_TIME_STEP
    replaced_parameters: tuple[tuple[str, float], ...] = ()

    def commands(self, work_dir: Path) -> list[str]:
        """LAMMPS commands that set this force field for a system of one atom type.

        Parameters
        ----------
        work_dir : Path
            A changed copy of the potential file is written here if the profile needs one.

        Returns
        -------
        list of str
            Commands from ``mass`` to ``pair_coeff``.

        Raises
        ------
        EngineError
            If the installed LAMMPS has no potential files.
        """
        source = potentials_folder() / self.file_name
        if self.replaced_parameters:
            text = source.read_text(encoding="utf-8")
            for parameter, value in self.replaced_parameters:
                text, count = re.subn(rf"^\S+(\s+{parameter}\s*)$", rf"{value}\1", text, flags=re.MULTILINE)
                if count != 1:
                    raise ValueError(f"{source.name} holds the parameter {parameter} {count} times, needed once")
            source = work_dir / f"{self.name}.{self.file_name}"
            # Every rank writes the same bytes; replacing keeps a reader from seeing half a file.
            unfinished = source.with_name(f"{source.name}.{id(self)}")
            unfinished.write_text(text, encoding="utf-8")
            unfinished.replace(source)
        return [
            f"mass 1 {CARBON_MASS / units.MASS!r}",
            f"pair_style {self.pair_style}",
            f'pair_coeff * * "{source}" C',
        ]


def _profile(
    name: str,
    pair_style: str,
    file_name: str,
    lattice_constant: float,
    switching: tuple[float, float],
    trap: str | None = None,
    replaced: tuple[tuple[str, float], ...] = (),
) -> ForceField:
    start, end = switching
    return ForceField(
        name=name,
        pair_style=pair_style,
        file_name=file_name,
        lattice_constant=lattice_constant * 1e-10,
        switching_start=start * 1e-10,
        switching_end=end * 1e-10,
        cutoff_trap=trap or _STICKING.format(start=start),
        replaced_parameters=replaced,
    )


FORCE_FIELDS: Final[dict[str, ForceField]] = {
    profile.name: profile
    for profile in (
        _profile("tersoff", "tersoff", "BNC.tersoff", 1.438785, (1.80, 2.10)),
        _profile("airebo", "airebo 3.0 0 0", "CH.airebo", 1.397675, (1.70, 2.00)),
        _profile(
            "airebo-sharp",
            "airebo 3.0 0 0",
            "CH.airebo",
            1.397675,
            (2.00 - 1e-8, 2.00),
            trap=(
                "The bond is cut at 2.0 A, before its energy is spent, so fracture starts below the Griffith load: "
                "read J at the first broken bond as that of this potential with this cut."
            ),
            replaced=(("rcmin_CC", 2.0 - 1e-8), ("rcmax_CC", 2.0)),
        ),
        _profile("rebo", "rebo", "CH.rebo", 1.420390, (1.70, 2.00)),
        _profile("lcbop", "lcbop", "C.lcbop", 1.419889, (1.70, 2.20)),
    )
}


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
