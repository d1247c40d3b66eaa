"""Any ASE calculator as an engine of the role `atomistic`.

Three are built in: ``lennard-jones`` and ``emt`` of ASE, ``tersoff`` of matscipy with the parameters that LAMMPS has.
Another package adds one by an entry point of the group ``scalebridge.calculators``: its name is that of the force
field, its object a callable that takes the `ase.Atoms` of the sample and returns a calculator.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from md_service import units
from md_service.atoms import Atoms
from md_service.dynamics import Dynamics
from md_service.errors import EngineError
from md_service.force_fields import FORCE_FIELDS, ForceField
from md_service.lennard_jones import PROFILE as LENNARD_JONES
from md_service.lennard_jones import is_flat, lennard_jones_parameters
from md_service.velocity_verlet import VelocityVerlet

if TYPE_CHECKING:
    from md_service.elastic_constants import IsotropicProperties
    from md_service.engines import Progress

CALCULATORS: Final = "scalebridge.calculators"
MakeCalculator = Callable[[Any], Any]

_VIRIAL_COLUMNS: Final = [0, 1, 2, 5, 4, 3]  # ours from ASE's xx, yy, zz, yz, xz, xy
_TIME_STEP: Final = 1e-15  # s, where nothing better is known
#: Nearest-neighbour distance by material, m, measured with `static_constants`.
_EMT_SPACING: Final = {"copper": 2.53839e-10, "aluminium": 2.82438e-10}


class CalculatorForces:
    """Forces of an ASE calculator; implements `md_service.velocity_verlet.Interactions`.

    Parameters
    ----------
    atoms : Atoms
        The sample; its box is the cell.
    make : callable
        Takes `ase.Atoms`, returns the calculator.
    planar : bool
        Whether the motion stays in the plane z = const.

    Raises
    ------
    EngineError
        If ASE is not installed or the calculator cannot be made.
    """

    def __init__(self, atoms: Atoms, make: MakeCalculator, planar: bool = False) -> None:
        self.dimension = 2 if planar else 3
        symbols = [atoms.elements[kind] for kind in atoms.kind]
        self._make = make
        self._ase = _installed("ase").Atoms(
            symbols,
            positions=atoms.position / units.LENGTH,
            masses=atoms.atom_mass / units.MASS,
            cell=atoms.box.edges / units.LENGTH,
            pbc=atoms.box.periodic,
        )
        if atoms.charge is not None:
            self._ase.set_initial_charges(atoms.charge)
        self.reset()

    def forces(self, position: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
        """Forces, N, shape (n, 3), and the energy, J."""
        with _calculating():
            self._ase.positions = position / units.LENGTH
            force = np.array(self._ase.get_forces(), dtype=np.float64, order="C") * units.FORCE
            energy = float(self._ase.get_potential_energy()) * units.ENERGY
        if self.dimension == 2:
            force[:, 2] = 0.0
        return force, energy

    def virial_and_energy(self, position: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Virial, J, shape (n, 6), and energy, J, shape (n,), where the calculator knows them for each atom.

        Raises
        ------
        EngineError
            If it does not.
        """
        calculator = self._ase.calc
        known = getattr(calculator, "implemented_properties", [])
        missing = [name for name in ("stresses", "energies") if name not in known]
        if missing:
            raise EngineError(
                f"the calculator {type(calculator).__name__} has no {' and no '.join(missing)} of single atoms, which "
                "virial, stress and energy fields need; ask for positions and velocities only, or take another engine"
            )
        with _calculating():
            self._ase.positions = position / units.LENGTH
            stress = np.asarray(self._ase.get_stresses(), dtype=np.float64)
            energy = np.asarray(self._ase.get_potential_energies(), dtype=np.float64)
        return np.ascontiguousarray(stress[:, _VIRIAL_COLUMNS]) * (
            self._ase.get_volume() * units.ENERGY
        ), energy * units.ENERGY

    def reset(self) -> None:
        """Make the calculator anew, without the neighbour lists of the old one."""
        with _calculating():
            self._ase.calc = self._make(self._ase)

    def close(self) -> None:
        """Let go of the calculator."""
        self._ase.calc = None


class AseFactory:
    """ASE calculators; see `md_service.engines.EngineFactory`."""

    backend = "ase"
    summary = "molecular dynamics with any ASE calculator"
    ensembles = ("langevin", "nose-hoover", "berendsen", "andersen")
    severs = False

    def force_fields(self) -> list[str]:
        """Built-in calculators and those of other packages."""
        return [*_BUILT_IN, *(name for name in _installed_calculators() if name not in _BUILT_IN)]

    def force_field(self, name: str) -> ForceField | None:
        """The profile of the same name that LAMMPS has, where there is one."""
        self._check(name)
        return FORCE_FIELDS.get(name) if name in _BUILT_IN else None

    def time_step(self, name: str) -> float:
        """The profile's step, else 1 fs; 2 fs for the metals of EMT."""
        profile = self.force_field(name)
        if profile is not None:
            return profile.time_step
        return 2e-15 if name == "emt" else _TIME_STEP

    def materials(self, name: str) -> list[str]:
        """Materials whose spacing is known; none for another package's calculator."""
        profile = self.force_field(name)
        if profile is not None:
            return list(profile.lattice)
        return list(_EMT_SPACING) if name == "emt" else []

    def spacing(self, name: str, material: str) -> float:
        """Nearest-neighbour distance at 0 K, m."""
        profile = self.force_field(name)
        if profile is not None:
            return profile.spacing(material, 0.0)
        if name == "emt" and material in _EMT_SPACING:
            return _EMT_SPACING[material]
        known = ", ".join(self.materials(name)) or "none"
        raise ValueError(f"material is {material!r}; force field {name} has {known}")

    def make(
        self, folder: Path, force_field: str, atoms: Atoms, *, temperature: float, seed: int, time_step: float
    ) -> Dynamics:
        """The calculator with the atoms; nothing is written into the folder by this module."""
        return VelocityVerlet(
            atoms, self.forces(force_field, atoms), temperature=temperature, seed=seed, time_step=time_step
        )

    def properties(
        self, folder: Path, force_field: str, material: str, temperature: float, seed: int, progress: Progress
    ) -> IsotropicProperties:
        """Constants at 0 K from energies; above, this engine measures none."""
        from md_service.static_constants import crystal, require_rest, static_constants

        require_rest(temperature)
        cell = crystal(material, self.spacing(force_field, material))
        return static_constants(lambda atoms: self.forces(force_field, atoms), cell)

    def forces(self, name: str, atoms: Atoms) -> CalculatorForces:
        """Forces of a sample.

        Raises
        ------
        ValueError
            If the force field does not know the atoms.
        EngineError
            If a package is missing or the calculator cannot be made.
        """
        self._check(name)
        profile = FORCE_FIELDS.get(name) if name in _BUILT_IN else None
        known = profile.elements if profile is not None else _EMT_ELEMENTS if name == "emt" else atoms.elements
        unknown = [element for element in atoms.elements if element not in known]
        if unknown:
            raise ValueError(f"force field {name} knows {', '.join(known)}; the sample has {', '.join(unknown)}")
        make = _BUILT_IN[name] if name in _BUILT_IN else _installed_calculators()[name].load()
        return CalculatorForces(atoms, make, planar=name == LENNARD_JONES and is_flat(atoms))

    def _check(self, name: str) -> None:
        if name not in self.force_fields():
            raise ValueError(f"force_field is {name!r}; known are {', '.join(self.force_fields())}")


def _lennard_jones(atoms: Any) -> Any:
    epsilon, sigma, cutoff = lennard_jones_parameters()
    calculators = _installed("ase.calculators.lj")
    return calculators.LennardJones(
        epsilon=epsilon / units.ENERGY, sigma=sigma / units.LENGTH, rc=cutoff / units.LENGTH
    )


def _emt(atoms: Any) -> Any:
    return _installed("ase.calculators.emt").EMT()


def _tersoff(atoms: Any) -> Any:
    """Carbon of LAMMPS' BNC.tersoff in matscipy."""
    from md_service.lammps_library import potentials_folder

    rows = (potentials_folder() / str(FORCE_FIELDS["tersoff"].file_name)).read_text(encoding="utf-8").splitlines()
    values = next(row.split()[3:] for row in rows if row.split()[:3] == ["C", "C", "C"])
    names = ("m", "gamma", "lambda3", "c", "d", "h", "n", "beta", "lambda2", "B", "R", "D", "lambda1", "A")
    p = dict(zip(names, map(float, values), strict=True))
    # matscipy throws away what this warning is about.
    warnings.filterwarnings("ignore", "'where' used without 'out'", UserWarning, module="matscipy")
    form = _installed("matscipy.calculators.manybody.explicit_forms.tersoff_brenner")
    parameters = {
        "style": "Tersoff",
        "el": ["C"],
        "A": [p["A"]],
        "B": [p["B"]],
        "chi": [p["gamma"]],
        "lambda": [p["lambda1"]],
        "mu": [p["lambda2"]],
        "lambda3": [p["lambda3"]],
        "beta": [p["beta"]],
        "n": [p["n"]],
        "c": [p["c"]],
        "d": [p["d"]],
        "h": [p["h"]],
        "r1": [p["R"] - p["D"]],
        "r2": [p["R"] + p["D"]],
    }
    return _installed("matscipy.calculators.manybody").Manybody(**form.TersoffBrenner(parameters))


_BUILT_IN: Final[dict[str, MakeCalculator]] = {LENNARD_JONES: _lennard_jones, "emt": _emt, "tersoff": _tersoff}
_EMT_ELEMENTS: Final = ("Al", "Cu", "Ag", "Au", "Ni", "Pd", "Pt")


def _installed_calculators() -> dict[str, Any]:
    return {point.name: point for point in entry_points(group=CALCULATORS)}


def _installed(module: str) -> Any:
    try:
        return import_module(module)
    except ImportError as error:
        raise EngineError(f"this engine needs {module.split('.')[0]}: pip install 'scalebridge[ase]'") from error


@contextmanager
def _calculating() -> Iterator[None]:
    """Whatever a calculator raises becomes an error of the engine."""
    try:
        yield
    except EngineError:
        raise
    except Exception as error:
        raise EngineError(f"the calculator failed: {type(error).__name__}: {error}") from error


ASE: Final = AseFactory()
