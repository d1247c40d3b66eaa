"""Hardy's fields on a grid from what an engine collected of each atom."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from md_service.atoms import Atoms
from md_service.hardy import HardyAverage, HardyGrid
from md_service.units import BOLTZMANN

GRID_FIELDS: Final = ("density", "velocity", "displacement", "stress", "temperature")
#: Fields of the engine that `grid_fields` needs.
NEEDED: Final = ("mean_position", "mean_velocity", "displacement", "virial", "stress")


def grid_fields(
    atoms: Atoms,
    means: dict[str, NDArray[np.float64]],
    origin: NDArray[np.float64],
    spacing: float,
    counts: tuple[int, int, int],
    radius: float,
    dimension: int = 3,
) -> dict[str, NDArray[np.float64]]:
    """Averages around the points of a grid, from time averages of the atoms.

    The atoms are taken at their mean places: what they wander about them is far below the radius.

    Parameters
    ----------
    atoms : Atoms
        The sample; a sheet (one with a thickness) takes one point along z.
    means : dict of str to ndarray
        The fields `NEEDED`, SI, as `md_service.engine.Engine.fields` gives them.
    origin : ndarray, shape (3,)
        The first point, m.
    spacing : float
        From point to point, m.
    counts : tuple of int
        Points along x, y, z.
    radius : float
        Of the localisation function, m.
    dimension : int
        Directions in which atoms move, for the temperature.

    Returns
    -------
    dict of str to ndarray
        `GRID_FIELDS`, SI; arrays begin with `counts`. Density and stress are 0 where no atom is within reach, the
        others NaN.

    Raises
    ------
    ValueError
        For numbers that are out of range; the first word names the argument.
    """
    flat = atoms.thickness is not None
    if flat and counts[2] != 1:
        raise ValueError(f"counts is {counts}; a sheet has one point along z")
    d = 2 if flat else 3
    grid = HardyGrid(origin[:d] - 0.5 * spacing, np.full(d, spacing), counts[:d], atoms.thickness)
    # The collected stress holds the thermal part of each sample; what the mean velocities add to it is taken out.
    whole = means["stress"] * atoms.atom_volume
    moving = HardyAverage(grid, atoms.box, atoms.atom_mass, radius)
    moving.add(
        means["mean_position"], means["mean_velocity"], virial=whole, displacement=means["displacement"]
    )  # fmt: skip
    found = moving.fields()
    # With a mass of one the density is the number of atoms per volume.
    thermal = HardyAverage(grid, atoms.box, np.ones(len(atoms)), radius)
    thermal.add(means["mean_position"], np.zeros_like(means["mean_velocity"]), virial=whole - means["virial"])
    motion = thermal.fields()
    number = np.where(motion.density > 0.0, motion.density, np.nan)
    values = {
        "density": found.density,
        "velocity": found.velocity,
        "displacement": found.displacement,
        "stress": found.stress - found.thermal_stress,
        "temperature": -motion.stress[..., :3].sum(axis=-1) / (dimension * BOLTZMANN * number),
    }
    return {name: np.ascontiguousarray(value.reshape(*counts, *value.shape[d:])) for name, value in values.items()}
