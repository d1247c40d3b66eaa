"""Effective constants of 2x2 cells against printed ones."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gmc_service.homogenised import Homogenised
from gmc_service.material import isotropic_stiffness
from gmc_service.methods import find_method
from protocol.verification import Case, Check

GPA: Final = 1e9
#: The two formulations; both have to give the printed figures.
FORMULATIONS: Final = ("gmc", "gmc_dense")
#: The dissertation's composites (Tables 6.1 and 6.2) at a fibre fraction of 0.6: E11, E22, nu12, nu23, G12, G23 in MPa.
_SEED: Final = {
    "neat": (2.963, (166785.894, 15003.7323, 0.340531864, 0.286246729, 3858.68478, 2681.12315)),
    "graphene": (3.5811, (167033.279, 17910.8032, 0.340536141, 0.287199637, 4632.13729, 3229.97550)),
}


def square_fibre(
    fraction: float,
    fibre: NDArray[np.float64],
    matrix: NDArray[np.float64],
    expansion: tuple[NDArray[np.float64], NDArray[np.float64]] = (np.zeros(6), np.zeros(6)),
    method: str = "gmc",
) -> Homogenised:
    """A cell of one square fibre and three subcells of matrix.

    Parameters
    ----------
    fraction : float
        Of the fibre.
    fibre, matrix : ndarray of float, shape (6, 6)
        Stiffness, Pa.
    expansion : pair of ndarray of float, shape (6,)
        Of fibre and matrix, 1/K.
    method : str
        Of `gmc_service.methods`.
    """
    side = float(np.sqrt(fraction))
    sizes = np.array([side, 1.0 - side])
    phases = [0, 1, 1, 1]
    return find_method(method)(sizes, sizes, np.array([fibre, matrix])[phases], np.array(expansion)[phases])


def manual_example(method: str) -> Homogenised:
    """Example 1a of the manual of MAC/GMC 4.0: graphite and epoxy at a fibre fraction of 0.65."""
    compliance = np.zeros((6, 6))
    along, across, shear, nu_along, nu_across = 388.2, 7.6, 14.9, 0.41, 0.45
    compliance[[0, 1, 2], [0, 1, 2]] = 1.0 / along, 1.0 / across, 1.0 / across
    compliance[[0, 0, 1, 2], [1, 2, 0, 0]] = -nu_along / along
    compliance[[1, 2], [2, 1]] = -nu_across / across
    compliance[[3, 4, 5], [3, 4, 5]] = 2.0 * (1.0 + nu_across) / across, 1.0 / shear, 1.0 / shear
    return square_fibre(
        0.65,
        np.asarray(np.linalg.inv(compliance) * GPA, dtype=np.float64),
        isotropic_stiffness(3.45, 0.35, 1.278) * GPA,
        (np.array([-0.68, 9.74, 9.74, 0, 0, 0]) * 1e-6, np.array([45.0, 45.0, 45.0, 0, 0, 0]) * 1e-6),
        method,
    )


def _example_1a(folder: Path) -> list[Check]:
    printed = {(0, 0): "257.1", (0, 1): "4.500", (1, 1): "7.828", (1, 2): "3.707", (3, 3): "1.916", (4, 4): "4.166"}
    source = "MAC/GMC 4.0 Example Problem Manual, Example 1a; all printed digits"
    return [
        _printed(f"C{i + 1}{j + 1} ({method})", homogenised.stiffness[i, j] / GPA, text, "GPa", source)
        for method in FORMULATIONS
        for homogenised in (manual_example(method),)
        for (i, j), text in printed.items()
    ]


def _example_1a_expansion(folder: Path) -> list[Check]:
    source = "MAC/GMC 4.0 Example Problem Manual, Example 1a; all printed digits"
    return [
        _printed(f"alpha{axis + 1} ({method})", manual_example(method).expansion[axis] * 1e6, text, "1e-6/K", source)
        for method in FORMULATIONS
        for axis, text in ((0, "-0.4724"), (1, "26.63"))
    ]


def _printed(quantity: str, value: float, text: str, unit: str, source: str) -> Check:
    """All printed digits: the value rounds to the text, so it lies within half of the last digit."""
    reference = float(text)
    half = 0.5 * 10.0 ** -len(text.partition(".")[2])
    return Check(quantity, value, reference, half / abs(reference), source, unit)


def _seed(name: str, folder: Path) -> list[Check]:
    young, figures = _SEED[name]
    source = "Tables 6.1 and 6.2 in the equations of Paley and Aboudi 1992, computed apart from this code"
    checks = []
    for method in FORMULATIONS:
        homogenised = square_fibre(
            0.6, isotropic_stiffness(276e3, 0.33) * 1e6, isotropic_stiffness(young * 1e3, 0.36) * 1e6, method=method
        )
        compliance = np.linalg.inv(homogenised.stiffness) * 1e6
        found = (
            1.0 / compliance[0, 0],
            1.0 / compliance[1, 1],
            -compliance[0, 1] / compliance[0, 0],
            -compliance[1, 2] / compliance[1, 1],
            1.0 / compliance[5, 5],
            1.0 / compliance[3, 3],
        )
        names = ("E11", "E22", "nu12", "nu23", "G12", "G23")
        checks += [
            Check(f"{quantity} ({method})", value, figure, 1e-6, source, "1" if "nu" in quantity else "MPa")
            for quantity, value, figure in zip(names, found, figures, strict=True)
        ]
    return checks


CASES: list[Case] = [
    Case("gmc", "example-1a", "effective stiffness of the manual's first example", _example_1a),
    Case("gmc", "example-1a-cte", "its thermal expansion", _example_1a_expansion),
    Case("gmc", "seed-neat", "IM7/EPON 862, square fibre, fraction 0.6", partial(_seed, "neat")),
    Case("gmc", "seed-graphene", "the same with 2 wt% graphene in the matrix", partial(_seed, "graphene")),
]
