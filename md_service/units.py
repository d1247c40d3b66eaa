"""Conversion between SI and the LAMMPS unit styles "metal" (Angstrom, eV, ps, g/mol, bar) and "real".

Each constant is the SI value of one metal unit: SI = metal * constant. `UnitSystem` holds the same for a style.
"""

from dataclasses import dataclass
from typing import Final

BOLTZMANN: Final = 1.380649e-23  # J/K
AVOGADRO: Final = 6.02214076e23  # 1/mol

LENGTH: Final = 1e-10  # m per Angstrom
TIME: Final = 1e-12  # s per ps
VELOCITY: Final = LENGTH / TIME  # m/s per Angstrom/ps
ENERGY: Final = 1.602176634e-19  # J per eV
FORCE: Final = ENERGY / LENGTH  # N per eV/Angstrom
MASS: Final = 1e-3 / AVOGADRO  # kg per g/mol
PRESSURE: Final = 1e5  # Pa per bar


@dataclass(frozen=True)
class UnitSystem:
    """A LAMMPS unit style; each number is the SI value of one of its units.

    Attributes
    ----------
    name : str
        Of the LAMMPS command ``units``.
    length, time, velocity, energy, force, mass, pressure : float
        m, s, m/s, J, N, kg, Pa.
    """

    name: str
    length: float
    time: float
    energy: float
    pressure: float
    mass: float = MASS

    @property
    def velocity(self) -> float:
        """m/s."""
        return self.length / self.time

    @property
    def force(self) -> float:
        """N."""
        return self.energy / self.length

    @property
    def stiffness(self) -> float:
        """N/m."""
        return self.energy / self.length**2

    @property
    def volume(self) -> float:
        """m^3."""
        return self.length**3


METAL: Final = UnitSystem("metal", LENGTH, TIME, ENERGY, PRESSURE)
REAL: Final = UnitSystem("real", 1e-10, 1e-15, 4184.0 / AVOGADRO, 101325.0)
UNIT_SYSTEMS: Final = {system.name: system for system in (METAL, REAL)}
