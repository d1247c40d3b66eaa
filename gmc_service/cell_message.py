"""From a cell to the message that registers it with a service."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gmc_service.cell import Cell
from gmc_service.cell_file import read_cell
from gmc_service.material import Failure, Material
from protocol import micromechanics as m


def read_cell_message(path: Path) -> m.RegisterCell:
    """Read a cell file into the message of the cell; errors are those of `gmc_service.cell_file.read_cell`."""
    return register_message(read_cell(path))


def register_message(cell: Cell) -> m.RegisterCell:
    """Return the message that defines a cell to a service of the role `micromechanics`."""
    return m.RegisterCell(
        heights=cell.heights,
        widths=cell.widths,
        phase=cell.phase,
        materials=[_material(material) for material in cell.materials],
        stress_free_temperature=cell.stress_free_temperature,
        knock_down=cell.knock_down,
        after_failure=cell.after_failure,
    )


def _material(material: Material) -> m.CellMaterial:
    law = material.plasticity
    return m.CellMaterial(
        name=material.name,
        temperatures=material.temperatures.tolist(),
        stiffness=[one.reshape(-1).tolist() for one in material.stiffness],
        expansion=material.expansion.tolist(),
        failures=[_failure(failure) for failure in material.failures],
        fracture_energy=material.fracture_energy,
        plasticity=None
        if law is None
        else m.MaterialPlasticity(yield_stress=law.yield_stress, hardening=law.hardening),
    )


def _failure(failure: Failure) -> m.MaterialFailure:
    return m.MaterialFailure(
        criterion=failure.criterion,
        tension=_limits(failure.tension),
        compression=_limits(failure.compression),
        shear=_limits(failure.shear),
    )


def _limits(values: tuple[float, float, float]) -> tuple[float | None, float | None, float | None]:
    first, second, third = (value if np.isfinite(value) else None for value in values)
    return first, second, third
