"""All that people ask of a cell as one material: engineering constants, expansion, fractions, density."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gmc_service.cell_file import NamedCell
from gmc_service.engineering_constants import EngineeringConstants, coupling, engineering_constants
from gmc_service.methods import find_method


@dataclass(frozen=True, eq=False)
class EffectiveProperties:
    """Effective properties of an intact cell.

    Attributes
    ----------
    method : str
    temperature : float
        K.
    stiffness : ndarray of float, shape (6, 6)
        Pa; order 11, 22, 33, 23, 13, 12.
    constants : EngineeringConstants
    coupling : float
        See `gmc_service.engineering_constants.coupling`; 0 where the constants say all.
    expansion : ndarray of float, shape (6,), optional
        1/K; None if one of the materials has none.
    density : float, optional
        kg/m^3; None if one of the materials has none.
    fractions : dict of str to float
        By name of the material.
    without_expansion, without_density : tuple of str
        Names of the materials that lack them.
    """

    method: str
    temperature: float
    stiffness: NDArray[np.float64]
    constants: EngineeringConstants
    coupling: float
    expansion: NDArray[np.float64] | None
    density: float | None
    fractions: dict[str, float]
    without_expansion: tuple[str, ...]
    without_density: tuple[str, ...]


def effective_properties(cell: NamedCell, method: str = "gmc", temperature: float | None = None) -> EffectiveProperties:
    """Homogenise an intact cell.

    Parameters
    ----------
    cell : NamedCell
    method : str
        A key of `gmc_service.methods.METHODS`.
    temperature : float, optional
        K, at which the constants of the materials are taken; the stress-free temperature where none is given.

    Returns
    -------
    EffectiveProperties

    Raises
    ------
    ValueError
        If the temperature lies outside a table, or the method is unknown.
    """
    at = cell.stress_free_temperature if temperature is None else temperature
    found = find_method(method)(cell.heights, cell.widths, cell.stiffness_at(at), cell.expansion_at(at))
    fractions = [float(fraction) for fraction in cell.phase_fractions()]
    densities = [material.density for material in cell.materials]
    known = [density for density in densities if density is not None]
    complete = len(known) == len(densities)
    without_expansion = tuple(material.name for material in cell.materials if not material.expansion_known)
    return EffectiveProperties(
        method=method,
        temperature=at,
        stiffness=found.stiffness,
        constants=engineering_constants(found.stiffness),
        coupling=coupling(found.stiffness),
        expansion=None if without_expansion else found.expansion,
        density=sum(part * share for part, share in zip(known, fractions, strict=True)) if complete else None,
        fractions={material.name: share for material, share in zip(cell.materials, fractions, strict=True)},
        without_expansion=without_expansion,
        without_density=tuple(material.name for material in cell.materials if material.density is None),
    )
