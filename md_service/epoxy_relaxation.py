"""Molecular dynamics of a resin while it is being built: compression, pulling new bonds shut, heating and cooling.

The engine of coupled runs keeps one set of atoms for good; here each stage has other bonds, so each stage is a LAMMPS
run of its own that gives its atoms back. Building needs the right states, not the paths between them, and states do
not depend on masses: hydrogens weigh `HYDROGEN_MASS`, which allows for a step of 2 fs of bonded terms and 4 fs of pair
forces (r-RESPA).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from md_service.atoms import Atoms, Box
from md_service.data_file import write_data_file
from md_service.lammps_library import LammpsSession
from md_service.opls import STYLES, coefficient_commands, coefficients, opls_table
from md_service.units import REAL

Progress = Callable[[str], None]

STEP: Final = 4e-15  # s, of the pair forces; bonded terms are integrated with half of it
HYDROGEN_MASS: Final = 4.0  # g/mol, while building
HOT: Final = 600.0  # K, above the resin's glass transition
#: While molecules are brought together and bonded, contacts matter and the rest does not.
CONTACT_STYLES: Final = ("pair_style lj/cut 5.0", "pair_modify mix geometric tail no", *STYLES[2:])
#: While a resin is hot, forces beyond this matter little; the final density is measured with the full reach.
ANNEALING_STYLES: Final = ("pair_style lj/cut/coul/dsf 0.25 7.0", *STYLES[1:])
ATMOSPHERE: Final = 101325.0  # Pa
_BULK_MODULUS = 3e9  # Pa, of the resin; sets only how fast the barostat acts
_PIECE = 50  # steps between two samples of the density


class ResinRun:
    """A LAMMPS run of typed molecules in a periodic box.

    Parameters
    ----------
    work_dir : Path
        Folder of the log and of the data file that LAMMPS reads.
    atoms : Atoms
        From `md_service.epoxy_typing.typed`.
    temperature : float
        Of the first velocities, K.
    seed : int
        Of velocities and thermostats.
    styles : tuple of str
        LAMMPS styles of the force field: all of it, or a cheaper stand-in.
    """

    def __init__(
        self, work_dir: Path, atoms: Atoms, temperature: float, seed: int, styles: tuple[str, ...] = STYLES
    ) -> None:
        work_dir.mkdir(parents=True, exist_ok=True)
        self._source = atoms
        self._seed = seed
        data_file = work_dir / "resin.data"
        write_data_file(data_file, atoms, "real", "full")
        self.session = LammpsSession(work_dir / "log.lammps")
        self.session.commands(
            [
                "units real",
                "atom_style full",
                "atom_modify map array",
                "boundary p p p",
                f"read_data {data_file}",
                *styles,
                *coefficient_commands(atoms),
                *(f"mass {i} {HYDROGEN_MASS!r}" for i, name in enumerate(atoms.elements, start=1) if name == "H"),
                "neighbor 2.0 bin",
                "neigh_modify every 1 delay 2 check yes",
                f"timestep {STEP / REAL.time!r}",
                "run_style respa 2 2 bond 1 angle 1 dihedral 1 improper 1 pair 2",
                f"velocity all create {temperature!r} {seed} dist gaussian",
                f"thermo {_PIECE}",
                "thermo_style custom step temp pe press density",
                "thermo_modify flush yes",
            ]
        )

    def soften(self, bond: str, factor: float) -> None:
        """Scale the stiffness of all bonds of a name, such as ``CT-NT``."""
        number = self._source.topology.bond_names.index(bond) + 1 if self._source.topology else 0
        stiffness, length = coefficients(opls_table().bonds, bond.split("-"))
        self.session.commands([f"bond_coeff {number} {stiffness * factor!r} {length!r}"])

    def damp(self, steps: int, temperature: float) -> None:
        """Run with a strong thermostat and at most 0.1 Angstrom of way a step, to take up the energy of contacts."""
        self._run(
            steps,
            ["fix move all nve/limit 0.1", f"fix bath all langevin {temperature!r} {temperature!r} 100.0 {self._seed}"],
        )

    def hold(self, steps: int, start: float, stop: float, pressure: float | None = None) -> NDArray[np.float64]:
        """Run at a temperature that goes from start to stop, K, at constant volume or at a pressure, Pa.

        The barostat is slow: a melt that shoots over to a low density takes tens of picoseconds to come back.

        Returns
        -------
        ndarray
            Density after every 50 steps, kg/m^3.
        """
        fixes = [f"fix move all nvt temp {start!r} {stop!r} 100.0"]
        if pressure is not None:
            bar, modulus = pressure / REAL.pressure, _BULK_MODULUS / REAL.pressure
            fixes.append(f"fix press all press/berendsen iso {bar!r} {bar!r} 1000.0 modulus {modulus!r}")
        density: list[float] = []
        mass = self._source.atom_mass.sum()
        pieces = max(1, round(steps / _PIECE))
        self.session.commands(["reset_timestep 0", *fixes])
        for _ in range(pieces):
            # The thermostat's ramp goes over all pieces.
            self.session.commands([f"run {_PIECE} start 0 stop {pieces * _PIECE}"])
            density.append(mass / self._box().volume)
        self._unfix(fixes)
        return np.array(density)

    def squeeze(self, steps: int, density: float, temperature: float, aspect: float) -> None:
        """Shrink or stretch the box evenly in time to a density, kg/m^3, and to a width over depth."""
        depth = float(self._source.atom_mass.sum() / density / aspect**2) ** (1.0 / 3.0) / REAL.length
        width = aspect * depth
        ends = " ".join(f"{axis} final 0.0 {edge!r}" for axis, edge in zip("xyz", (width, width, depth), strict=True))
        self._run(
            steps,
            [
                "fix move all nve/limit 0.1",
                f"fix bath all langevin {temperature!r} {temperature!r} 100.0 {self._seed}",
                f"fix box all deform 1 {ends} remap x units box",
            ],
        )

    def atoms(self) -> Atoms:
        """The atoms as they are now, in their present box."""
        lmp = self.session.lmp
        n = len(self._source)
        rows = lmp.numpy.extract_atom("id")[:n].astype(np.int64) - 1
        image = lmp.numpy.extract_atom("image")[:n].astype(np.int64)
        images = np.stack([image & 1023, (image >> 10) & 1023, image >> 20], axis=1) - 512
        box = self._box()
        position = np.empty((n, 3))
        position[rows] = lmp.numpy.extract_atom("x")[:n] * REAL.length + images * (box.high - box.low)
        return self._source.at(position, box)

    def close(self) -> None:
        """Free LAMMPS."""
        self.session.close()

    def _box(self) -> Box:
        low, high, *_ = self.session.lmp.extract_box()
        return Box(np.array(low) * REAL.length, np.array(high) * REAL.length, (True, True, True))

    def _run(self, steps: int, fixes: list[str]) -> None:
        self.session.commands([*fixes, f"run {steps}"])
        self._unfix(fixes)

    def _unfix(self, fixes: list[str]) -> None:
        self.session.commands([f"unfix {fix.split()[1]}" for fix in fixes])


def compress(
    atoms: Atoms,
    density: float,
    temperature: float,
    seed: int,
    work_dir: Path,
    time: float = 6e-12,
    aspect: float = 1.0,
) -> Atoms:
    """Bring packed molecules to the density of a melt by shrinking the box.

    Parameters
    ----------
    atoms : Atoms
        From `md_service.epoxy_packing.pack`.
    density : float
        kg/m^3.
    temperature : float
        K.
    seed : int
    work_dir : Path
    time : float
        That the compression takes, s.
    aspect : float
        Width of the box along x and y over its depth along z.
    """
    run = ResinRun(work_dir, atoms, temperature, seed, CONTACT_STYLES)
    try:
        run.damp(100, temperature)
        run.squeeze(round(time / STEP), density, temperature, aspect)
        return run.atoms()
    finally:
        run.close()


@dataclass(frozen=True)
class Schedule:
    """Times of the relaxation, s.

    Attributes
    ----------
    hot, cooling : float
        At `HOT` and from there to the final temperature, at the density of curing.
    holding : float
        At the final temperature and atmospheric pressure.
    """

    hot: float = 4e-12
    cooling: float = 16e-12
    holding: float = 8e-12


def relax(
    atoms: Atoms, temperature: float, seed: int, work_dir: Path, schedule: Schedule | None = None
) -> tuple[Atoms, NDArray[np.float64]]:
    """Anneal a resin at the density it has, then let the density settle at atmospheric pressure.

    Annealing at constant volume keeps the melt from expanding: on the way back from a low density it would lag.

    Parameters
    ----------
    atoms : Atoms
        Without contacts closer than bonds.
    temperature : float
        Final, K.
    seed : int
    work_dir : Path
    schedule : Schedule, optional

    Returns
    -------
    atoms : Atoms
        In a box of the mean density of the second half of the holding time.
    density : ndarray
        Of the holding time, sampled every 50 steps, kg/m^3.
    """
    plan = schedule or Schedule()
    run = ResinRun(work_dir, atoms, HOT, seed, ANNEALING_STYLES)
    try:
        run.damp(250, HOT)
        run.hold(round(plan.hot / STEP), HOT, HOT)
        run.hold(round(plan.cooling / STEP), HOT, temperature)
        atoms = run.atoms()
    finally:
        run.close()
    run = ResinRun(work_dir, atoms, temperature, seed)
    try:
        density = run.hold(round(plan.holding / STEP), temperature, temperature, ATMOSPHERE)
        edge = atoms.box.high - atoms.box.low
        run.squeeze(100, float(density[len(density) // 2 :].mean()), temperature, float(edge[0] / edge[2]))
        run.hold(100, temperature, temperature)
        return run.atoms(), density
    finally:
        run.close()
