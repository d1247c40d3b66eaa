"""Cells for the law of laminates without a service: the GMC library answers, as it does behind the wire."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gmc_service.cell import Cell
from gmc_service.cell_file import read_cell
from gmc_service.evaluation import Evaluator
from gmc_service.safe_energy import safe_energy
from mpm_service.materials import CellAnswer

CELLS = Path(__file__).resolve().parents[2] / "scenes" / "cells"
CELL_FILE = CELLS / "im7_epon862_neat.toml"


class LibraryCell:
    """A cell of the library; spares no query where `spare` is false."""

    def __init__(self, cell: Cell, *, spare: bool = True) -> None:
        self._evaluator, self._temperature = Evaluator(cell), cell.stress_free_temperature
        intact = np.zeros(self._evaluator.failed_bytes, dtype=np.uint8)
        self.stiffness = self._evaluator.homogenised(self._temperature, intact).stiffness
        self.safe_energy = safe_energy(cell, "gmc", self._temperature) if spare else 0.0
        self.phase = cell.phase.reshape(-1)
        self.failed_bytes = self._evaluator.failed_bytes
        self.history_values = self._evaluator.history_values

    def evaluate(
        self,
        strain: NDArray[np.float64],
        failed: NDArray[np.uint8],
        history: NDArray[np.float64],
        length: NDArray[np.float64],
    ) -> CellAnswer:
        """As `gmc_service.evaluation.Evaluator.evaluate` says."""
        answer = self._evaluator.evaluate(strain, self._temperature, failed, history, length)
        return CellAnswer(answer.stress, answer.failed, answer.history, answer.tangent_index, answer.tangents)


def neat() -> Cell:
    """IM7 in neat EPON 862, 2 x 2 subcells."""
    return read_cell(CELL_FILE)
