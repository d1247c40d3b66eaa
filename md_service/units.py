"""Conversion between SI and the LAMMPS unit style "metal" (Angstrom, eV, ps, g/mol, bar).

Each constant is the SI value of one metal unit: SI = metal * constant.
"""

from typing import Final

BOLTZMANN: Final = 1.380649e-23  # J/K
AVOGADRO: Final = 6.02214076e23  # 1/mol

LENGTH: Final = 1e-10  # m per Angstrom
TIME: Final = 1e-12  # s per ps
VELOCITY: Final = LENGTH / TIME  # m/s per Angstrom/ps
ENERGY: Final = 1.602176634e-19  # J per eV
FORCE: Final = ENERGY / LENGTH  # N per eV/Angstrom
STIFFNESS: Final = ENERGY / LENGTH**2  # N/m per eV/Angstrom^2
DAMPING: Final = FORCE / VELOCITY  # kg/s per eV ps/Angstrom^2
MASS: Final = 1e-3 / AVOGADRO  # kg per g/mol
PRESSURE: Final = 1e5  # Pa per bar
VOLUME: Final = LENGTH**3  # m^3 per Angstrom^3
