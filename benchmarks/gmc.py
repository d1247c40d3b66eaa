"""Benchmark `gmc`: error of the transverse and shear moduli of a fibre composite against seconds, by method."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmarks.gmc_methods import (
    CELLS,
    FRACTION,
    cell_of,
    measure,
    methods,
    moduli,
    reference,
    round_fibre,
    with_steps,
)
from benchmarks.gmc_pictures import draw_cost, draw_fractions
from gmc_service import gmc_reduced, high_fidelity, mori_tanaka
from protocol.verification import Benchmark, BenchmarkRow

#: Round fibres touch at 0.785.
FRACTIONS: Final = np.linspace(0.05, 0.75, 15)
_COMPOSITE: Final = "IM7 and EPON 862 (isotropic, contrast 93), square array"


def run(folder: Path) -> tuple[list[BenchmarkRow], list[Path]]:
    """Measure and draw; the pictures are written into `folder`."""
    exact, step = reference(FRACTION)
    rows = [with_steps(row, step) for row in measure(methods(FRACTION), exact)]
    pictures = [folder / "error_against_seconds.png", folder / "error_against_fraction.png"]
    draw_cost(rows, f"{_COMPOSITE}, fraction {FRACTION}; error against round fibres, known to {step:.0e}", pictures[0])
    draw_fractions(FRACTIONS, *fraction_errors(FRACTIONS), _COMPOSITE, pictures[1])
    return rows, pictures


def fraction_errors(
    fractions: NDArray[np.float64],
) -> tuple[dict[str, NDArray[np.float64]], dict[str, NDArray[np.float64]]]:
    """Signed relative errors of E22, G12 and G23 at each fraction, shape (fractions, 3), by method.

    Returns
    -------
    against_round : dict of str to ndarray
        Against round fibres in a square array: of the method and of its cell.
    against_cell : dict of str to ndarray
        Against finite elements on the same cell: of the method alone.
    """
    against_round: dict[str, list[NDArray[np.float64]]] = {}
    against_cell: dict[str, list[NDArray[np.float64]]] = {}
    for fraction in fractions.tolist():
        exact = moduli(round_fibre(fraction, 2))
        cells = {n: cell_of(n, fraction) for n in CELLS}
        plain = {n: moduli(gmc_reduced.homogenise(*cell).stiffness) for n, cell in cells.items()}
        fine = {n: moduli(high_fidelity.homogenise(*cell).stiffness) for n, cell in cells.items()}
        answers = {
            **{f"GMC {n}x{n}": answer for n, answer in plain.items()},
            **{f"high fidelity {n}x{n}": answer for n, answer in fine.items()},
            "Mori-Tanaka": moduli(mori_tanaka.homogenise(*cells[2], matrix=3).stiffness),
        }
        for label, answer in answers.items():
            against_round.setdefault(label, []).append(answer / exact - 1.0)
        for n in CELLS:
            against_cell.setdefault(f"GMC {n}x{n}", []).append(plain[n] / fine[n] - 1.0)
    return (
        {label: np.array(values) for label, values in against_round.items()},
        {label: np.array(values) for label, values in against_cell.items()},
    )


BENCHMARK = Benchmark("gmc", "fibre composites: error of E22, G12 and G23 against seconds, by method", run)
