"""The Lennard-Jones solid of the force field profile of that name, for engines other than LAMMPS."""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from md_service.atoms import Atoms
from md_service.force_fields import force_field
from md_service.neighbour_pairs import VIRIAL_AXES, neighbour_pairs

PROFILE: Final = "lennard-jones"
_FLAT: Final = 1e-13  # m; a sample no higher than this moves in its plane


def lennard_jones_parameters() -> tuple[float, float, float]:
    """Depth epsilon, J, diameter sigma and cut-off, m, of the profile."""
    profile = force_field(PROFILE)
    words = {line.split()[0]: line.split() for line in profile.styles}
    epsilon, sigma = (float(value) for value in words["pair_coeff"][3:5])
    cutoff = float(words["pair_style"][2])
    return epsilon * profile.units.energy, sigma * profile.units.length, cutoff * profile.units.length


def is_flat(atoms: Atoms) -> bool:
    """Whether all atoms lie in a plane z = const.

    A flat sheet of Lennard-Jones atoms has no stiffness across, so engines move it in its plane only.
    """
    return bool(np.ptp(atoms.position[:, 2]) <= _FLAT)


def lennard_jones_virials(
    atoms: Atoms, position: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Virial and energy of each atom, half of each pair's to either.

    Parameters
    ----------
    atoms : Atoms
        Gives the box.
    position : ndarray, shape (n, 3)
        m.

    Returns
    -------
    virial : ndarray, shape (n, 6)
        xx, yy, zz, xy, xz, yz, tension positive, J.
    energy : ndarray, shape (n,)
        J.
    """
    epsilon, sigma, cutoff = lennard_jones_parameters()
    inside, _ = atoms.box.wrapped(position)
    first, second, shift = neighbour_pairs(atoms.at(inside), cutoff)
    virial, energy = np.zeros((len(position), 6)), np.zeros(len(position))
    _pair_virials(inside, first, second, shift, epsilon, sigma, virial, energy)
    return virial, energy


@njit(nogil=True, cache=True)
def _pair_virials(position, first, second, shift, epsilon, sigma, virial, energy):  # type: ignore[no-untyped-def]  # numba
    way = np.empty(3)
    for pair in range(len(first)):
        i, j = first[pair], second[pair]
        square = 0.0
        for axis in range(3):
            way[axis] = position[j, axis] - position[i, axis] + shift[pair, axis]
            square += way[axis] ** 2
        s6 = (sigma * sigma / square) ** 3
        half = 2.0 * epsilon * (s6 * s6 - s6)
        energy[i] += half
        energy[j] += half
        # Half of the pull per length, positive for attraction.
        pull = -12.0 * epsilon * (2.0 * s6 * s6 - s6) / square
        for column in range(6):
            a, b = VIRIAL_AXES[column]
            virial[i, column] += pull * way[a] * way[b]
            virial[j, column] += pull * way[a] * way[b]
