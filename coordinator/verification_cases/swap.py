"""Case `coupling/swap`: the same scene with other solvers behind the roles.

Runs at 0 K without dampers, in which nothing moves but by the forces. All integrators are velocity Verlet, so two
codes differ by the digits of their forces alone: 1e-7 of conversions of units (LAMMPS), 2e-5 of single precision
(OpenMM), round-off in another order (the two continua), and by where their minimisers end before the load. The motion
of a solid at small strain carries such differences along and hardly multiplies them; the tolerances are a few times
what that leaves. An anchor that jumps half a step late in one engine shows as 16 % here.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.figure import Figure
from scipy.spatial import cKDTree

from coordinator.figures import BLUE, GREEN, INK, ORANGE, WIDTH, style
from coordinator.results import Results
from coordinator.verification_cases.runs import run_text, shipped
from protocol.arrays import FloatArray
from protocol.verification import CannotRun, Case, Check

ANGSTROM: Final = 1e-10
#: Of the springs of the scene `swap_springs`.
SPACING, STIFFNESS = 3.45, 250.0  # angstrom, N/m
_ELECTRONVOLT: Final = 1.602176634e-19  # J
#: What takes the place of the harmonic lattice in its scene: LAMMPS with bonds.
_BONDS: Final = """\
backend = "md_service"
force_field = "bonds"
sample = "lattice.data"
"""
_LATTICE: Final = """\
backend = "lattice"
force_field = "harmonic"
"""


@dataclass(frozen=True)
class Answers:
    """What a run found, in forms that do not depend on the solvers.

    Attributes
    ----------
    time : float64 array, shape (rows,)
        s.
    displacement : float64 array, shape (frames, atoms, 3)
        From where the atoms were at rest before the load, m.
    force : float64 array, shape (rows, ivcs, 3)
        Of the atoms on the continuum in each cell, N.
    """

    time: FloatArray
    displacement: FloatArray
    force: FloatArray

    @classmethod
    def of(cls, results: Results) -> Answers:
        """Read the answers of a run."""
        atoms = results.atoms
        assert atoms is not None
        order = np.lexsort(np.round(atoms.reference / (0.1 * ANGSTROM)).T)
        moved = np.array([atoms.position(frame) - atoms.position(0) for frame in range(1, len(atoms))])
        return cls(results.series["time"], moved[:, order], results.interface["force"].astype(np.float64))

    def difference(self, other: Answers) -> tuple[float, float]:
        """Largest difference of displacements and of forces to another run, each over the largest of that one."""
        found = []
        for mine, theirs in ((self.displacement, other.displacement), (self.force, other.force)):
            found.append(float(np.abs(mine - theirs).max() / np.abs(theirs).max()))
        return found[0], found[1]

    def force_difference(self, other: Answers) -> FloatArray:
        """Largest difference of forces at each step over the largest of the other run, shape (rows,)."""
        return np.asarray(np.abs(self.force - other.force).max(axis=(1, 2)) / np.abs(other.force).max())


def swap(folder: Path) -> list[Check]:
    """Runs with one solver swapped against the run with the default."""
    missing = [name for name in ("ase", "openmm") if find_spec(name) is None]
    if missing:
        raise CannotRun(f"needs {' and '.join(missing)}: pip install 'scalebridge[{','.join(missing)}]'")
    argon, springs = shipped("swap_argon"), shipped("swap_springs")
    lammps = _run(argon, folder / "argon-lammps")
    lattice = _run(springs, folder / "springs-lattice")
    bonds = folder / "springs-lammps"
    bonds.mkdir(parents=True, exist_ok=True)
    with Results(folder / "springs-lattice" / "run" / "results.h5") as results:
        assert results.atoms is not None
        (bonds / "lattice.data").write_text(bonded_lattice(results.atoms.reference), encoding="utf-8")
    # Before the load minimisers end within 2e-6 A of each other, 7e-6 of the largest displacement.
    pairs = [
        ("ASE for LAMMPS, argon", _run(argon, folder / "argon-ase", "atomistic.backend=ase"), lammps, (5e-5, 2e-5),
         "LAMMPS converts units with seven digits; minimisers end 2e-6 A apart"),
        ("OpenMM for LAMMPS, argon", _run(argon, folder / "argon-openmm", "atomistic.backend=openmm"), lammps,
         (2e-4, 1e-4), "OpenMM computes in single precision"),
        ("LAMMPS for the lattice, springs", _run(_with_bonds(springs), bonds), lattice, (1e-6, 2e-6),
         "LAMMPS converts units with seven digits"),
        ("plain numpy for the compiled continuum, springs",
         _run(springs, folder / "springs-reference", "continuum.backend=reference"), lattice, (1e-10, 1e-7),
         "the same method summed in another order; forces are stored in single precision"),
    ]  # fmt: skip
    _draw({name: (one, other) for name, one, other, _, _ in pairs}, folder / "swap.png")
    checks = []
    for name, one, other, allowed, source in pairs:
        quantities = ("displacement of atoms", "force of cells")
        for quantity, value, tolerance in zip(quantities, one.difference(other), allowed, strict=True):
            checks.append(Check(f"{quantity}, {name}", value, 0.0, tolerance, source))
    return checks


def _run(text: str, folder: Path, *overrides: str) -> Answers:
    with run_text(text, folder, overrides) as results:
        return Answers.of(results)


def _with_bonds(text: str) -> str:
    """The scene of the harmonic lattice with LAMMPS, which has the springs as bonds of a file."""
    if _LATTICE not in text:
        raise ValueError("the scene swap_springs does not name the harmonic lattice in the words that are known here")
    # LAMMPS' energy of a bond is K (r - r0)^2.
    strength = 0.5 * STIFFNESS * ANGSTROM**2 / _ELECTRONVOLT
    commands = (
        '[atomistic.commands]\nunit_style = "metal"\natom_style = "full"\n'
        'lines = ["pair_style zero 6.0", "pair_coeff * *", "bond_style harmonic", '
        f'"bond_coeff 1 {strength!r} {SPACING}"]\n\n'
    )
    return text.replace(_LATTICE, _BONDS).replace("[handshake]\n", commands + "[handshake]\n")


def bonded_lattice(place: FloatArray) -> str:
    """LAMMPS data file of argon atoms at places, shape (atoms, 3), m, with bonds between neighbours."""
    place = place / ANGSTROM
    bonds = cKDTree(place).query_pairs(1.2 * SPACING, output_type="ndarray")
    low, high = (place.min(axis=0) - 5.0).tolist(), (place.max(axis=0) + 5.0).tolist()
    lines = [
        "Harmonic lattice with its springs as bonds", "",
        f"{len(place)} atoms", "1 atom types", f"{len(bonds)} bonds", "1 bond types",
        *(f"{low[k]!r} {high[k]!r} {axis}lo {axis}hi" for k, axis in enumerate("xyz")),
        "", "Masses", "", "1 39.95", "", "Atoms # full", "",
        *(f"{row} 1 1 0.0 {x!r} {y!r} {z!r}" for row, (x, y, z) in enumerate(place.tolist(), start=1)),
        "", "Bonds", "",
        *(f"{row} 1 {i + 1} {j + 1}" for row, (i, j) in enumerate(bonds.tolist(), start=1)),
        "",
    ]  # fmt: skip
    return "\n".join(lines)


def _draw(pairs: dict[str, tuple[Answers, Answers]], path: Path) -> None:
    with style():
        figure = Figure(figsize=(WIDTH, 3.2), layout="constrained")
        axes = figure.subplots()
        for (name, (one, other)), colour in zip(pairs.items(), (BLUE, ORANGE, GREEN, INK), strict=True):
            part = one.time / one.time[-1]
            axes.semilogy(part, np.maximum(one.force_difference(other), 1e-12), color=colour, label=name)
        axes.set_xlabel("part of the run")
        axes.set_ylabel("largest difference of a cell's force\nover the largest force")
        axes.set_ylim(1e-12, 1e-1)
        axes.legend()
        figure.savefig(path)


CASES = [Case("coupling", "swap", "the same scene with other engines and another continuum", swap)]
