"""Finite elements on the cell: convergence, a published pair of moduli, and exact axial shear moduli."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from gmc_service.engineering_constants import engineering_constants
from gmc_service.high_fidelity import default_refinement, homogenise, homogenise_with_error, richardson
from gmc_service.homogenised import Homogenised
from gmc_service.material import isotropic_stiffness
from gmc_service.periodic_elements import homogenise_mesh
from gmc_service.round_fibre import Array, round_fibre_mesh
from gmc_service.verification.exact_axial_shear import round_fibres, square_quarter
from protocol.verification import Case, Check

#: IM7 and neat EPON 862 of Tables 6.1 and 6.2, both isotropic.
FIBRE: Final = isotropic_stiffness(276e9, 0.33)
MATRIX: Final = isotropic_stiffness(2.963e9, 0.36)
FRACTION: Final = 0.6
REFINEMENTS: Final = (2, 4, 8, 16)
MODULI: Final = ("E22", "G12", "G23")
_MPA: Final = 1e6
_TOLERANCE: Final = 1e-3
_REFERENCE: Final = {"E22": 17125.36, "G12": 4342.189}
_SOURCE: Final = "periodic finite elements of another code on the same cell"
_COLOURS: Final = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00")


def square_cell(
    fraction: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Heights, widths, stiffness and expansion of a square fibre and its matrix in 2x2 subcells."""
    sizes = np.array([np.sqrt(fraction), 1.0 - np.sqrt(fraction)])
    return sizes, sizes, np.array([FIBRE, MATRIX, MATRIX, MATRIX]), np.zeros((4, 6))


def round_fibre(fraction: float, refinement: int, array: Array) -> Homogenised:
    """A round fibre in a mesh that follows it."""
    mesh = round_fibre_mesh(fraction, refinement, array)
    return homogenise_mesh(mesh, np.array([FIBRE, MATRIX]), np.zeros((2, 6)))


def _finite_elements(folder: Path) -> list[Check]:
    table = np.array([_moduli(homogenise(*square_cell(FRACTION), one)) for one in REFINEMENTS])
    limits, orders = np.transpose([richardson(column[-3:]) for column in table.T])
    used = REFINEMENTS.index(default_refinement(2, 2))
    checks = []
    for k, (name, reference) in enumerate(_REFERENCE.items()):
        checks += [
            Check(f"{name}, default refinement", table[used, k], reference, _TOLERANCE, _SOURCE, "MPa"),
            Check(f"{name}, Richardson's limit", limits[k], reference, _TOLERANCE, _SOURCE, "MPa"),
        ]
    stated = homogenise_with_error(*square_cell(FRACTION), REFINEMENTS[-2])
    fine = np.abs(table[-1] / limits - 1.0).max()
    checks.append(
        Check("error that is stated", fine, stated.error, 0.0, "the code's own estimate, at most", at_most=True)
    )
    contrast = float(FIBRE[5, 5] / MATRIX[5, 5])
    errors = {name: np.abs(table[:, k] / limits[k] - 1.0) for k, name in enumerate(MODULI)}
    exact = square_quarter(contrast)
    found = np.array([homogenise(*square_cell(0.25), one).stiffness[5, 5] / MATRIX[5, 5] for one in REFINEMENTS])
    errors["G12 of a square fibre, fraction 0.25 (exact)"] = np.abs(found / exact - 1.0)
    checks.append(
        Check("G12 over G of the matrix, square fibre, fraction 0.25", found[-1], exact, 1e-4, "Obnosov 1999")
    )
    for array in ("square", "hexagonal"):
        exact = round_fibres(FRACTION, contrast, array)
        found = np.array([round_fibre(FRACTION, one, array).stiffness[5, 5] / MATRIX[5, 5] for one in (1, 2, 4)])
        checks.append(
            Check(f"G12 over G of the matrix, round fibre, {array} array", found[-1], exact, 1e-6,
                  "multipoles, Perrins, McKenzie and McPhedran 1979")
        )  # fmt: skip
    turned = round_fibre(FRACTION, 2, "hexagonal").stiffness
    isotropy = 2.0 * turned[3, 3] / (turned[1, 1] - turned[1, 2])
    checks.append(Check("G23 over (C22 - C23) / 2, hexagonal array", isotropy, 1.0, 1e-6, "symmetry"))
    _write(folder, table, limits, orders)
    _draw(folder / "convergence.png", errors)
    return checks


def _moduli(homogenised: Homogenised) -> list[float]:
    constants = engineering_constants(homogenised.stiffness)
    return [getattr(constants, name) / _MPA for name in MODULI]


def _write(folder: Path, table: NDArray[np.float64], limits: NDArray[np.float64], orders: NDArray[np.float64]) -> None:
    with (folder / "convergence.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["elements along a subcell", *(f"{name} (MPa)" for name in MODULI)])
        writer.writerows([one, *values] for one, values in zip(REFINEMENTS, table.tolist(), strict=True))
        writer.writerow(["Richardson's limit", *limits.tolist()])
        writer.writerow(["order", *orders.tolist()])


def _draw(path: Path, errors: dict[str, NDArray[np.float64]]) -> None:
    figure = Figure(figsize=(6.4, 4.4), layout="constrained")
    panel = figure.subplots()
    for (name, values), colour in zip(errors.items(), _COLOURS, strict=False):
        label = name if "(" in name else f"{name}, fraction {FRACTION} (Richardson's limit)"
        panel.loglog(REFINEMENTS, values, "o-", color=colour, linewidth=1.3, markersize=4.5, label=label)
    steps = np.array(REFINEMENTS[1:])
    panel.loglog(steps, 2e-3 * (steps / steps[0]) ** -3.0, "--", color="#777777", linewidth=1.0, label="third order")
    panel.axhline(_TOLERANCE, color="#bbbbbb", linewidth=0.8)
    panel.set_xticks(REFINEMENTS, [str(one) for one in REFINEMENTS])
    panel.minorticks_off()
    panel.set_xlabel("quadratic elements along a subcell, graded to its edges")
    panel.set_ylabel("relative error")
    panel.set_title("Square fibre, 2x2 subcells, contrast 93", loc="left", fontsize=10)
    panel.spines[["top", "right"]].set_visible(False)
    panel.legend(frameon=False, fontsize=8)
    figure.savefig(path, dpi=150)


CASES: list[Case] = [
    Case("gmc", "high-fidelity", "finite elements on the 2x2 cell, and on round fibres", _finite_elements),
]
