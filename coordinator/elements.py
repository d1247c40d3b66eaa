"""Elements by the mass of their atoms: what files of atoms call them."""

from __future__ import annotations

import numpy as np

from protocol.arrays import FloatArray, IntArray

ATOMIC_MASS = 1.66053906892e-27  # kg
#: Symbol and mass, u, of elements that occur in polymers, composites and crystals, by atomic number.
ELEMENTS: dict[int, tuple[str, float]] = {
    1: ("H", 1.008), 5: ("B", 10.81), 6: ("C", 12.011), 7: ("N", 14.007), 8: ("O", 15.999), 9: ("F", 18.998),
    13: ("Al", 26.982), 14: ("Si", 28.085), 15: ("P", 30.974), 16: ("S", 32.06), 17: ("Cl", 35.45), 18: ("Ar", 39.95),
    28: ("Ni", 58.693), 29: ("Cu", 63.546), 47: ("Ag", 107.868), 79: ("Au", 196.967),
}  # fmt: skip
_NEAR = 0.3  # u


def numbers_of(mass: FloatArray) -> IntArray:
    """Return the atomic number of each atom by its mass, kg; 0 where no element is near, shape (atoms,)."""
    numbers = np.array(list(ELEMENTS))
    masses = np.array([weight for _, weight in ELEMENTS.values()])
    distance = np.abs(mass[:, None] / ATOMIC_MASS - masses)
    nearest = distance.argmin(axis=1)
    found: IntArray = np.where(distance.min(axis=1) < _NEAR, numbers[nearest], 0).astype(np.int64)
    return found
