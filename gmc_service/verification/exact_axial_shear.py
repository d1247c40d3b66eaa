"""Exact axial shear moduli of periodic arrays of isotropic phases; the axial problem is that of conduction.

Each takes the ratio of the fibre's shear modulus to the matrix's and answers the effective one over the matrix's.
"""

from __future__ import annotations

from math import comb, factorial
from typing import Final

import numpy as np
from scipy.special import zeta

from gmc_service.round_fibre import Array

_ROWS: Final = 12  # of the lattice sums: they fall as exp(-2 pi rows)
_TERMS: Final = 80
_MULTIPOLES: Final = 24


def checkerboard(ratio: float) -> float:
    """Squares of two phases in turn: the geometric mean (Keller 1964, Dykhne 1970)."""
    return float(np.sqrt(ratio))


def square_quarter(ratio: float) -> float:
    """Square fibres of a quarter of the cell in a square array (Obnosov, SIAM J. Appl. Math. 59 (1999) 1267)."""
    return float(np.sqrt((1.0 + 3.0 * ratio) / (3.0 + ratio)))


def _lattice_sum(power: int, second: complex) -> float:
    """Sum of z^-power over the lattice of 1 and `second` without 0, row by row (Lipschitz's formula)."""
    rows = np.arange(1, _ROWS)[:, None]
    terms = np.arange(1, _TERMS)
    waves = (terms ** (power - 1.0) * np.exp(2j * np.pi * second * rows * terms)).sum()
    sum_of_rows = 2.0 * (-1) ** (power // 2) * (2.0 * np.pi) ** power / factorial(power - 1) * waves
    return float((2.0 * zeta(power) + sum_of_rows).real)


def round_fibres(fraction: float, ratio: float, array: Array = "square") -> float:
    """Round fibres in a square or hexagonal array by multipoles.

    Rayleigh, Philosophical Magazine 34 (1892) 481; Perrins, McKenzie and McPhedran, Proceedings of the Royal Society A
    369 (1979) 207. Outside a fibre at 0 the field is the sum over odd n of (A_n r^n + B_n r^-n) cos n theta; at its
    surface A_n = T B_n / radius^2n, T = (1 + ratio) / (1 - ratio); the A_n are the mean field and what all other
    fibres send.
    """
    second, area = (1j, 1.0) if array == "square" else (np.exp(1j * np.pi / 3.0), np.sqrt(0.75))
    radius = np.sqrt(fraction * area / np.pi)
    orders = range(1, 2 * _MULTIPOLES, 2)
    contrast = (1.0 + ratio) / (1.0 - ratio)
    # Unknowns B_n / radius^n keep the system well scaled.
    system = contrast * np.eye(_MULTIPOLES)
    for row, n in enumerate(orders):
        for column, m in enumerate(orders):
            system[row, column] += comb(m + n - 1, n) * _lattice_sum(m + n, second) * radius ** (m + n)
    field = np.zeros(_MULTIPOLES)
    field[0] = radius
    dipole = np.linalg.solve(system, field)[0] * radius
    return float(1.0 - 2.0 * np.pi * dipole / area)
