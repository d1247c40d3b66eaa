"""Cells at which formulations break: extreme contrast, everything failed, vanishing subcells, no compressibility."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from gmc_service.cell import Cell
from gmc_service.homogenised import Homogenised
from gmc_service.material import constant_material, isotropic_stiffness
from gmc_service.methods import find_method
from protocol.verification import Case, Check

_STEEL = isotropic_stiffness(200e9, 0.3)


def _cells() -> Iterator[tuple[str, NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]]:
    """Label, heights, widths and stiffness of each subcell."""
    random = np.random.default_rng(11)
    two = np.array([0.7, 0.3])
    for contrast in (1e-8, 1e-4, 1e4, 1e8):
        yield f"contrast {contrast:g}", two, two, np.array([contrast * _STEEL, _STEEL, _STEEL, _STEEL])
    yield "all subcells failed", two, two, np.array([1e-4 * _STEEL] * 4)
    yield "subcells of 1e-12 of the cell", np.array([0.7, 0.3, 1e-12]), two, np.array([_STEEL, 1e-2 * _STEEL] * 3)
    for poisson in (0.4999, 0.499999):
        rubber = isotropic_stiffness(1e6, poisson)
        yield f"matrix with nu {poisson}", two, two, np.array([_STEEL, rubber, rubber, rubber])
    phase = random.integers(0, 2, 64 * 64)
    sizes = random.uniform(0.1, 1.0, (2, 64))
    yield "random 64x64", sizes[0], sizes[1], np.array([_STEEL, 1e-2 * _STEEL])[phase]
    damaged = phase + 2 * (random.random(64 * 64) < 0.3)
    table = np.array([_STEEL, 1e-2 * _STEEL, 1e-4 * _STEEL, 1e-6 * _STEEL])
    yield "random 64x64, three in ten failed", sizes[0], sizes[1], table[damaged]


def _stability(folder: Path) -> list[Check]:
    checks = []
    homogenise = find_method("gmc")
    for label, heights, widths, stiffness in _cells():
        found = homogenise(heights, widths, stiffness, np.full((len(stiffness), 6), 1e-5) * [1, 1, 1, 0, 0, 0])
        checks += _in_bounds(label, heights, widths, stiffness, found)
        # One expansion for all: that of the cell, at any contrast.
        checks.append(
            Check(f"{label}: expansion", float(found.expansion[1]), 1e-5, 1e-6, "equal in all subcells", "1/K")
        )
    checks.append(_vanishing())
    return checks


def _in_bounds(
    label: str,
    heights: NDArray[np.float64],
    widths: NDArray[np.float64],
    stiffness: NDArray[np.float64],
    found: Homogenised,
) -> list[Check]:
    """Finite, symmetric, and in energy between the bounds for every strain; the least above Reuss is above zero."""
    effective = found.stiffness
    finite = all(np.isfinite(part).all() for part in (effective, found.concentration, found.thermal))
    fractions = (np.outer(heights, widths) / (heights.sum() * widths.sum())).reshape(-1)
    voigt = np.einsum("n,nij->ij", fractions, stiffness)
    reuss = np.linalg.inv(np.einsum("n,nij->ij", fractions, np.linalg.inv(stiffness)))
    largest = float(scipy.linalg.eigh(effective, voigt, eigvals_only=True)[-1]) if finite else np.nan
    least = float(scipy.linalg.eigh(effective, reuss, eigvals_only=True)[0]) if finite else np.nan
    asymmetry = float(np.abs(effective - effective.T).max())
    return [
        Check(f"{label}: energy over Voigt", largest, 1.0, 1e-8, "bound of Voigt", at_most=True),
        Check(f"{label}: energy of Reuss over it", 1.0 / least, 1.0, 1e-8, "bound of Reuss", at_most=True),
        Check(f"{label}: asymmetry", asymmetry, 0.0, 0.0, "symmetric", "Pa"),
    ]


def _vanishing() -> Check:
    """A subcell of no size is refused with its name."""
    steel = constant_material("steel", _STEEL)
    try:
        Cell(np.array([1.0, 0.0]), np.array([1.0]), np.zeros((2, 1), np.int64), (steel,))
    except ValueError as error:
        named = float("heights holds 0.0 m" in str(error))
    else:
        named = 0.0
    return Check("a subcell of no size is refused by name", named, 1.0, 0.0, "a clear error")


CASES: list[Case] = [Case("gmc", "stability", "extreme cells: finite, symmetric, within bounds", _stability)]
