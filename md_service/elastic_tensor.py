"""Stiffness tensors in Voigt notation: isotropic averages, engineering constants, errors by jackknife.

Voigt order is 11, 22, 33, 23, 13, 12 with engineering shear (gamma = 2 epsilon). A sheet knows the components 11, 22
and 12 only, in plane stress.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

VOIGT: Final[tuple[tuple[int, int], ...]] = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))
VOIGT_LABELS: Final = ("11", "22", "33", "23", "13", "12")
SOLID: Final = (0, 1, 2, 3, 4, 5)
SHEET: Final = (0, 1, 5)


@dataclass(frozen=True)
class Isotropic:
    """Constants of the isotropic material nearest to a tensor (Hill's mean); of a sheet, in plane stress.

    Attributes
    ----------
    young, poisson, bulk, shear : float
        Pa, 1, Pa, Pa. The bulk modulus of a sheet is that of its area, E / (2 (1 - nu)).
    spread : float
        Upper (Voigt) less lower (Reuss) Young's modulus, Pa: zero for an isotropic tensor.
    """

    young: float
    poisson: float
    bulk: float
    shear: float
    spread: float


def isotropic_average(tensor: NDArray[np.float64]) -> Isotropic:
    """Voigt-Reuss-Hill average of a stiffness tensor (Hill, Proc. Phys. Soc. A 65, 349, 1952).

    Parameters
    ----------
    tensor : ndarray, shape (6, 6) or (3, 3)
        Stiffness of a solid, or of a sheet in the order 11, 22, 12, Pa.

    Returns
    -------
    Isotropic

    Raises
    ------
    ValueError
        If the tensor has another shape, or is singular.
    """
    stiffness = symmetric(tensor)
    compliance = compliance_of(stiffness)
    if len(stiffness) == 3:
        voigt = _area_moduli(stiffness)
        bulk = 1.0 / (compliance[0, 0] + compliance[1, 1] + 2.0 * compliance[0, 1])
        shear = 2.0 / (compliance[0, 0] + compliance[1, 1] - 2.0 * compliance[0, 1] + compliance[2, 2])
        reuss = (bulk, shear)
    else:
        voigt = _volume_moduli(stiffness)
        direct, cross, sliding = _invariants(compliance)
        reuss = (1.0 / (direct + 2.0 * cross), 15.0 / (4.0 * direct - 4.0 * cross + 3.0 * sliding))
    bulk, shear = 0.5 * (voigt[0] + reuss[0]), 0.5 * (voigt[1] + reuss[1])
    dimensions = 2 if len(stiffness) == 3 else 3
    return Isotropic(
        young=_young(bulk, shear, dimensions),
        poisson=_poisson(bulk, shear, dimensions),
        bulk=bulk,
        shear=shear,
        spread=_young(*voigt, dimensions) - _young(*reuss, dimensions),
    )


def _invariants(tensor: NDArray[np.float64]) -> tuple[float, float, float]:
    """Sums over the three direct, the three mixed and the three shear components."""
    return (
        float(np.trace(tensor[:3, :3])),
        float(tensor[0, 1] + tensor[0, 2] + tensor[1, 2]),
        float(np.trace(tensor[3:, 3:])),
    )


def _volume_moduli(stiffness: NDArray[np.float64]) -> tuple[float, float]:
    direct, cross, sliding = _invariants(stiffness)
    return (direct + 2.0 * cross) / 9.0, (direct - cross + 3.0 * sliding) / 15.0


def _area_moduli(stiffness: NDArray[np.float64]) -> tuple[float, float]:
    direct, cross, sliding = float(stiffness[0, 0] + stiffness[1, 1]), float(stiffness[0, 1]), float(stiffness[2, 2])
    return (direct + 2.0 * cross) / 4.0, (direct - 2.0 * cross + 4.0 * sliding) / 8.0


def _young(bulk: float, shear: float, dimensions: int) -> float:
    if dimensions == 2:
        return 4.0 * bulk * shear / (bulk + shear)
    return 9.0 * bulk * shear / (3.0 * bulk + shear)


def _poisson(bulk: float, shear: float, dimensions: int) -> float:
    if dimensions == 2:
        return (bulk - shear) / (bulk + shear)
    return (3.0 * bulk - 2.0 * shear) / (2.0 * (3.0 * bulk + shear))


def engineering_constants(tensor: NDArray[np.float64]) -> dict[str, float]:
    """Young's moduli, Poisson's ratios and shear moduli along the axes, from the compliance.

    Parameters
    ----------
    tensor : ndarray, shape (6, 6) or (3, 3)
        Stiffness of a solid, or of a sheet in the order 11, 22, 12, Pa.

    Returns
    -------
    dict of str to float
        ``E1``, ``E2``, ``E3``, ``nu12``, ``nu13``, ``nu23``, ``G23``, ``G13``, ``G12``, Pa; of a sheet ``E1``,
        ``E2``, ``nu12``, ``G12``. ``nu12`` is the contraction along 2 under tension along 1.

    Raises
    ------
    ValueError
        As `isotropic_average`.
    """
    compliance = compliance_of(symmetric(tensor))
    axes = 2 if len(compliance) == 3 else 3
    constants = {f"E{i + 1}": 1.0 / compliance[i, i] for i in range(axes)}
    for i in range(axes):
        for j in range(i + 1, axes):
            constants[f"nu{i + 1}{j + 1}"] = -compliance[i, j] / compliance[i, i]
    labels = [VOIGT_LABELS[index] for index in (SHEET if axes == 2 else SOLID)]
    constants |= {f"G{label}": 1.0 / compliance[row, row] for row, label in enumerate(labels) if row >= axes}
    return {name: float(value) for name, value in constants.items()}


def symmetric(tensor: NDArray[np.float64]) -> NDArray[np.float64]:
    """The symmetric part of a tensor of 6 x 6 or 3 x 3 components.

    Raises
    ------
    ValueError
        For another shape or a number that is not finite.
    """
    tensor = np.asarray(tensor, dtype=np.float64)
    if tensor.shape not in ((6, 6), (3, 3)):
        raise ValueError(f"tensor has the shape {tensor.shape}; a solid has (6, 6), a sheet (3, 3)")
    if not np.isfinite(tensor).all():
        raise ValueError("tensor holds a number that is not finite")
    return np.asarray(0.5 * (tensor + tensor.T))


def compliance_of(stiffness: NDArray[np.float64]) -> NDArray[np.float64]:
    """Inverse of a stiffness tensor, 1/Pa.

    Raises
    ------
    ValueError
        If the tensor is singular.
    """
    try:
        return np.asarray(np.linalg.inv(stiffness), dtype=np.float64)
    except np.linalg.LinAlgError as error:
        raise ValueError("the stiffness tensor is singular: the material resists some strain with no stress") from error


def jackknife(
    replicas: NDArray[np.float64], figures: Callable[[NDArray[np.float64]], NDArray[np.float64]]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Figures of the mean over replicas, with standard errors (Quenouille and Tukey's jackknife).

    Parameters
    ----------
    replicas : ndarray, shape (r, ...)
        Independent measurements.
    figures : callable
        Takes the mean over replicas, shape (...), and returns figures, any shape.

    Returns
    -------
    value, standard_error : ndarray
        Of the shape that `figures` returns; errors are zero with one replica, which is taken for exact.
    """
    value = np.asarray(figures(replicas.mean(axis=0)), dtype=np.float64)
    count = len(replicas)
    if count == 1:
        return value, np.zeros_like(value)
    left_out = np.array([figures(np.delete(replicas, row, axis=0).mean(axis=0)) for row in range(count)])
    spread = np.sum((left_out - left_out.mean(axis=0)) ** 2, axis=0)
    return value, np.sqrt((count - 1) / count * spread)
