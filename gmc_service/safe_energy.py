"""The energy density below which nothing in an intact cell can fail, whatever the strain.

Every failure index grows in proportion to the strain. With the strain written as B*^(-1/2) x, the energy per volume is
|x|^2 / 2, so the largest index over all strains of one energy is a matter of vectors and eigenvalues. Points of a
laminate with less energy need no query: their answer is the elastic one, with no error at all.

For maximum stress and maximum strain the bound is sharp: some strain of just this energy brings a subcell to failure.
For Tsai-Hill and Hashin, whose forms change with the signs of the stresses, all signs count at once.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from gmc_service.cell import Cell
from gmc_service.failure import FAILS_AT, HASHIN, MAXIMUM_STRAIN, TSAI_HILL, checks_of
from gmc_service.methods import find_method


def safe_energy(cell: Cell, method: str, temperature: float) -> float:
    """Least energy density at which a subcell of the intact cell can fail or yield.

    Parameters
    ----------
    cell : Cell
    method : str
        Name from `gmc_service.methods`.
    temperature : float
        K.

    Returns
    -------
    float
        J/m^3: half of strain times B* times strain. Infinite where nothing has an allowable, 0 where the cell is
        stressed by itself, since the temperature is not the stress-free one, and where a strength depends on the
        element, since a material reduces it.
    """
    stiffness, expansion = cell.stiffness_at(temperature), cell.expansion_at(temperature)
    if temperature != cell.stress_free_temperature and expansion.any():
        return 0.0
    if any(material.reduces_strength and material.fracture_energy is not None for material in cell.materials):
        return 0.0
    found = find_method(method)(cell.heights, cell.widths, stiffness, expansion)
    # From x, of which half the square is the energy, to the macroscopic strain.
    root = np.linalg.inv(np.linalg.cholesky(found.stiffness)).T
    strain_of = found.concentration @ root
    stress_of = stiffness @ strain_of
    largest = 0.0
    checks = checks_of(cell)
    for subcell, criterion, rates in zip(checks.subcell, checks.criterion, checks.rates, strict=True):
        load = strain_of[subcell] if criterion == MAXIMUM_STRAIN else stress_of[subcell]
        if criterion == TSAI_HILL:
            index = _tsai_hill(load, rates)
        elif criterion == HASHIN:
            index = _hashin(load, rates)
        else:
            both = np.concatenate([np.maximum(rates[:3], rates[3:6]), rates[6:]])
            index = float(np.max(both * np.linalg.norm(load, axis=1)))
        largest = max(largest, index / FAILS_AT)
    for subcell, phase in enumerate(cell.phase.reshape(-1)):
        law = cell.materials[phase].plasticity
        if law is not None:
            largest = max(largest, np.sqrt(_largest(stress_of[subcell], _MISES)) / law.yield_stress)
    return float(0.5 / largest**2) if largest > 0.0 else np.inf


#: Square of the equivalent stress as a form of the six components.
_MISES = np.diag([1.0, 1.0, 1.0, 3.0, 3.0, 3.0])
_MISES[:3, :3] -= 0.5 * (1.0 - np.eye(3))


def _largest(load: NDArray[np.float64], form: NDArray[np.float64]) -> float:
    """Largest value of a quadratic form of the components over all x of length one, at least 0."""
    return max(float(np.linalg.eigvalsh(load.T @ form @ load)[-1]), 0.0)


def _tsai_hill(load: NDArray[np.float64], rates: NDArray[np.float64]) -> float:
    worst = 0.0
    for signs in product((0, 3), repeat=3):
        rate = np.array([rates[axis + sign] for axis, sign in enumerate(signs)])
        square = rate**2
        form = np.diag(np.concatenate([square, rates[6:] ** 2]))
        for i, j, k in ((0, 1, 2), (0, 2, 1), (1, 2, 0)):
            if rate[i] > 0.0 and rate[j] > 0.0:
                form[i, j] = form[j, i] = -0.5 * (square[i] + square[j] - square[k])
        worst = max(worst, _largest(load, form))
    return float(np.sqrt(worst))


def _hashin(load: NDArray[np.float64], rates: NDArray[np.float64]) -> float:
    fibre = np.diag([rates[0] ** 2, 0.0, 0.0, 0.0, rates[7] ** 2, rates[8] ** 2])
    worst = np.sqrt(_largest(load, fibre)) if rates[0] > 0.0 else 0.0
    worst = max(worst, float(rates[3] * np.linalg.norm(load[0])))
    shear = rates[6] ** 2
    common = np.diag([0.0, 0.0, 0.0, shear, rates[7] ** 2, rates[8] ** 2])
    common[1, 2] = common[2, 1] = -0.5 * shear
    across = np.zeros((6, 6))
    across[1:3, 1:3] = 1.0
    worst = max(worst, np.sqrt(_largest(load, common + rates[1] ** 2 * across)))
    linear = 0.0
    if rates[4] > 0.0:
        # e^2 = form + linear e is at most (linear + root of the form)^2 for a linear term of either sign.
        linear = abs(0.25 * shear / rates[4] ** 2 - 1.0) * rates[4] * float(np.linalg.norm(load[1] + load[2]))
    return float(max(worst, linear + np.sqrt(_largest(load, common + 0.25 * shear * across))))
