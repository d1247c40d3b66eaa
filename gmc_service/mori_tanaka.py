"""Mori-Tanaka homogenisation of long circular fibres along axis 1: no cell is solved, only shares count.

Benveniste (1987), "A new approach to the application of Mori-Tanaka's theory in composite materials", Mechanics of
Materials 6, 147-157. The matrix and every other phase may have any anisotropy; each other phase counts as circular
cylinders in that matrix.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label

from gmc_service.homogenised import Homogenised, check_sizes

#: Directions around the cylinder: the first is exact where the matrix is isotropic around axis 1.
_FIRST_DIRECTIONS: Final = 16
_MOST_DIRECTIONS: Final = 1 << 16
_ACCURACY: Final = 1e-12
#: Which neighbours of a subcell continue a path through a phase.
SIDES: Final = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], dtype=np.bool_)
CORNERS: Final = np.ones((3, 3), dtype=np.bool_)


def hill_tensor(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Hill's polarisation tensor of a circular cylinder along axis 1; times `matrix` it is Eshelby's tensor.

    The mean over the directions n across the cylinder of D (D^T C D)^-1 D^T, where D u is the strain of the
    displacement gradient u n (Mura, Micromechanics of Defects in Solids, 1987, section 17).

    Parameters
    ----------
    matrix : ndarray, shape (6, 6)
        Stiffness around the cylinder, Pa; symmetric, positive definite.

    Returns
    -------
    ndarray, shape (6, 6)
        1/Pa, from stress to engineering strain.

    Raises
    ------
    ValueError
        If the stiffness across the cylinder varies so much with direction that the mean does not settle.
    """
    count = _FIRST_DIRECTIONS
    before = _mean_over_directions(matrix, 0.0, count)
    while count <= _MOST_DIRECTIONS:
        between = _mean_over_directions(matrix, 0.5, count)
        answer = 0.5 * (before + between)
        if np.abs(answer - before).max() <= _ACCURACY * np.abs(answer).max():
            return answer
        before = answer
        count *= 2
    raise ValueError("stiffness of the matrix varies too much with direction for Eshelby's tensor")


def _mean_over_directions(matrix: NDArray[np.float64], shift: float, count: int) -> NDArray[np.float64]:
    # Half a turn is enough: n and -n give the same.
    angle = np.pi * (np.arange(count) + shift) / count
    cosine, sine = np.cos(angle), np.sin(angle)
    strain = np.zeros((count, 6, 3))
    strain[:, 1, 1] = strain[:, 3, 2] = strain[:, 5, 0] = cosine
    strain[:, 2, 2] = strain[:, 3, 1] = strain[:, 4, 0] = sine
    turned = strain.transpose(0, 2, 1)
    return np.asarray((strain @ np.linalg.solve(turned @ matrix @ strain, turned)).mean(axis=0))


def find_matrix(phase: NDArray[np.int64], fractions: NDArray[np.float64]) -> int:
    """Choose the phase that is the matrix: the one that runs through the cell.

    Parameters
    ----------
    phase : ndarray of int64, shape (rows, columns)
    fractions : ndarray, shape (phases,)

    Returns
    -------
    int
        The phase of which subcells that share sides connect the cell with its images along most axes; of several,
        that of which subcells that touch do so; of several, the one with the largest share.
    """

    def rank(one: int) -> tuple[int, int, float]:
        inside = phase == one
        return _ways_through(inside, SIDES), _ways_through(inside, CORNERS), float(fractions[one])

    return max(range(len(fractions)), key=rank)


def _ways_through(inside: NDArray[np.bool_], neighbours: NDArray[np.bool_]) -> int:
    """Number of axes, 0 to 2, along which a region connects a place in a periodic cell with its image."""
    rows, columns = inside.shape
    parts, _ = label(np.tile(inside, (3, 3)), neighbours)  # a path may lean out of its cell
    here = parts[rows : 2 * rows, columns : 2 * columns]
    below = parts[2 * rows :, columns : 2 * columns]
    beside = parts[rows : 2 * rows, 2 * columns :]
    return sum(bool((here[inside] == image[inside]).any()) for image in (below, beside))


def homogenise(
    heights: NDArray[np.float64],
    widths: NDArray[np.float64],
    stiffness: NDArray[np.float64],
    expansion: NDArray[np.float64],
    matrix: int | None = None,
) -> Homogenised:
    """Homogenise by the shares of the phases of a cell.

    Subcells with equal stiffness and expansion are one phase, so failed ones are phases of their own.

    Parameters
    ----------
    heights, widths, stiffness, expansion
        See `gmc_service.homogenised.Homogenise`.
    matrix : int, optional
        A subcell of the matrix; where it is not given, `find_matrix` chooses.

    Returns
    -------
    Homogenised
        Concentration and thermal strain are those of the phase of each subcell.

    Raises
    ------
    ValueError
        If a size is not positive, there is no such subcell, or see `hill_tensor`.
    """
    check_sizes(heights, widths)
    subcells = len(stiffness)
    if matrix is not None and not 0 <= matrix < subcells:
        raise ValueError(f"matrix is subcell {matrix}; it must lie between 0 and {subcells - 1}")
    constants = np.concatenate([stiffness.reshape(subcells, 36), expansion], axis=1) + 0.0  # no -0.0
    phases: dict[bytes, int] = {}
    phase = np.array([phases.setdefault(one.tobytes(), len(phases)) for one in constants], dtype=np.int64)
    constants = constants[np.unique(phase, return_index=True)[1]]
    areas = np.outer(heights, widths).reshape(-1)
    fractions = np.asarray(np.bincount(phase, areas / areas.sum()), dtype=np.float64)
    own = find_matrix(phase.reshape(len(heights), len(widths)), fractions) if matrix is None else int(phase[matrix])
    stiff = constants[:, :36].reshape(-1, 6, 6)
    locked = (stiff @ constants[:, 36:, None])[..., 0]  # minus the stress of a phase at no strain and one kelvin
    hill = hill_tensor(stiff[own])
    # A fibre alone in a matrix of strain e and temperature change t has the strain dilute (e + push t).
    dilute = np.linalg.inv(np.eye(6) + hill @ (stiff - stiff[own]))
    push = (dilute @ (hill @ (locked - locked[own]).T).T[..., None])[..., 0]
    of_matrix = np.linalg.inv(np.einsum("r,rkl->kl", fractions, dilute))
    concentration = dilute @ of_matrix
    thermal = push - concentration @ (fractions @ push)
    effective = np.einsum("r,rkl,rlm->km", fractions, stiff, concentration)
    effective = 0.5 * (effective + effective.T)
    by_levin = np.einsum("r,rkl,rk->l", fractions, concentration, locked)
    scale = 1.0 / np.sqrt(np.diag(effective))
    return Homogenised(
        stiffness=effective,
        expansion=scale * np.linalg.solve(effective * np.outer(scale, scale), scale * by_levin),
        concentration=np.ascontiguousarray(concentration[phase]),
        thermal=np.ascontiguousarray(thermal[phase]),
    )
