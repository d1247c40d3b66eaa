"""Energy of crack faces in graphene, and what a profile that cuts bonds leaves unspent of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from md_service.atom_system import AtomSystem
from md_service.atoms import Atoms, Box
from md_service.force_fields import ForceField, force_field
from md_service.graphene import GRAPHENE_THICKNESS, graphene
from protocol.verification import Case, Check

GRAPHENE: Final = ("tersoff", "airebo", "rebo", "lcbop")
SHARP: Final = ("airebo-sharp", "rebo-sharp")
_ELECTRONVOLT: Final = 1.602176634e-19
_APART: Final = 6e-10  # m, beyond the reach of any bond
_NEXT_TO_CUT: Final = 1e-19  # m
_INTERVALS: Final = 12  # of Simpson's rule


class Strip:
    """A strip of graphene, periodic along x, whose upper half can be lifted off; the bonds across are parallel to y.

    Parameters
    ----------
    folder : Path
        Of LAMMPS' files.
    field : ForceField

    Attributes
    ----------
    width : float
        Along the crack, m.
    bonds : int
        Number of bonds across.
    """

    def __init__(self, folder: Path, field: ForceField) -> None:
        self._spacing = field.lattice_constant
        whole = graphene(12e-10, 33e-10, spacing=self._spacing, periodic=True)
        self.width = float(whole.box.high[0] - whole.box.low[0])
        self.bonds = round(self.width / (np.sqrt(3.0) * self._spacing))
        # Free along y and z: cut where the periodic sheet had its bonds to the next image.
        self._atoms: Atoms = replace(whole, box=Box(whole.box.low, whole.box.high, (True, False, False)))
        self._upper = whole.position[:, 1] > _row_gap(whole.position[:, 1], self._spacing)
        self._system = AtomSystem(folder, field, self._atoms, field.time_step)

    def energy(self, length: float, relaxed: bool = False) -> float:
        """Potential energy, J, with bonds across of a length, m, or after relaxation from there."""
        position = self._atoms.position.copy()
        position[self._upper, 1] += length - self._spacing
        self._system.build(position)
        self._system.session.commands(["minimize 0 1e-8 5000 50000" if relaxed else "run 0 post no"])
        return self._system.potential_energy()

    def pull(self, length: float) -> float:
        """Force that holds the upper half at a length of the bonds, N."""
        self.energy(length)
        force = self._system.gather(self._system.local("f"))[self._upper, 1]
        return -float(force.sum()) * self._system.units.force

    def close(self) -> None:
        """Free LAMMPS."""
        self._system.session.close()


def _row_gap(y: NDArray[np.float64], spacing: float) -> float:
    """Middle of the gap between zigzag chains that is nearest to the middle of a strip."""
    rows = np.unique(np.round(y / spacing, 6)) * spacing
    gaps = np.flatnonzero(np.diff(rows) > 0.75 * spacing)
    middle = 0.5 * (rows[gaps] + rows[gaps + 1])
    return float(middle[np.argmin(np.abs(middle - y.mean()))])


def face_energy_of(folder: Path, name: str) -> float:
    """Energy of two relaxed zigzag faces, J per m^2 of crack at the thickness of graphene."""
    strip = Strip(folder, force_field(name))
    # The strip's own edges are free and relaxed in both states.
    energy = strip.energy(_APART, relaxed=True) - strip.energy(force_field(name).lattice_constant, relaxed=True)
    strip.close()
    return energy / (strip.width * GRAPHENE_THICKNESS)


def parting(folder: Path, name: str) -> tuple[float, float, float]:
    """Part two halves rigidly, by a profile that cuts bonds.

    Returns
    -------
    work, jump, whole : float
        J per bond: integral of the force up to the cut (Simpson's rule), rise of the energy at the cut, and rise of
        the energy from the whole sheet to the parted one.
    """
    field = force_field(name)
    if field.switching_start is None or field.switching_end is None:
        raise ValueError(f"force field {name} cuts no bonds")
    strip = Strip(folder, field)
    length = np.linspace(field.lattice_constant, field.switching_start - _NEXT_TO_CUT, 2 * _INTERVALS + 1)
    weight = np.array([1.0, *([4.0, 2.0] * _INTERVALS)[:-1], 1.0])
    work = weight @ np.array([strip.pull(value) for value in length]) * (length[1] - length[0]) / 3.0
    jump = strip.energy(field.switching_end + _NEXT_TO_CUT) - strip.energy(field.switching_start - _NEXT_TO_CUT)
    whole = strip.energy(_APART) - strip.energy(field.lattice_constant)
    strip.close()
    return float(work) / strip.bonds, jump / strip.bonds, whole / strip.bonds


def face_energy(folder: Path) -> list[Check]:
    """Part sheets by each potential, relaxed for the face energy and rigidly for what a cut leaves unspent."""
    checks = []
    for name in GRAPHENE:
        measured = face_energy_of(folder / name, name)
        stated = force_field(name).face_energy
        checks.append(
            Check(f"{name}: two zigzag faces", measured, stated or np.nan, 0.005, "the profile, regression", "J/m^2")
        )
    for name in SHARP:
        work, jump, whole = parting(folder / name, name)
        stated = force_field(name).cut_energy
        checks += [
            Check(
                f"{name}: work up to the cut and jump at the cut",
                (work + jump) / _ELECTRONVOLT,
                whole / _ELECTRONVOLT,
                1e-5,
                "energy of the parted sheet less that of the whole one",
                "eV",
            ),
            Check(
                f"{name}: energy of a bond at the cut",
                jump / _ELECTRONVOLT,
                (stated or np.nan) / _ELECTRONVOLT,
                1e-3,
                "the profile, regression",
                "eV",
            ),
        ]
    return checks


CASES = [Case("md", "face-energy", "energy of crack faces in graphene, and of bonds at a cut", face_energy)]
