"""What a homogenisation of a cell answers, whichever method made it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Homogenised:
    """Effective constants of a cell, and the mean strain of each subcell.

    The macroscopic stress is ``stiffness @ (strain - expansion * change)`` (Eq 89 without plastic strain), the mean
    strain of a subcell ``concentration[n] @ strain + thermal[n] * change``, with ``change`` the temperature less the
    stress-free one.

    Attributes
    ----------
    stiffness : ndarray of float, shape (6, 6)
        B*, Pa (Eq 90).
    expansion : ndarray of float, shape (6,)
        alpha*, 1/K.
    concentration : ndarray of float, shape (subcells, 6, 6)
        A of each subcell.
    thermal : ndarray of float, shape (subcells, 6)
        Strain of each subcell per kelvin where the macroscopic strain is zero, 1/K.
    """

    stiffness: NDArray[np.float64]
    expansion: NDArray[np.float64]
    concentration: NDArray[np.float64]
    thermal: NDArray[np.float64]


class Homogenise(Protocol):
    """A method of homogenisation: `gmc_dense`, `gmc_reduced`, `high_fidelity` and `mori_tanaka` have one each."""

    def __call__(
        self,
        heights: NDArray[np.float64],
        widths: NDArray[np.float64],
        stiffness: NDArray[np.float64],
        expansion: NDArray[np.float64],
    ) -> Homogenised:
        """Homogenise a cell.

        Parameters
        ----------
        heights, widths : ndarray of float, shape (rows,) and (columns,)
            Extents of the rows along axis 2 and of the columns along axis 3, m.
        stiffness : ndarray of float, shape (subcells, 6, 6)
            Pa; symmetric, positive definite, any anisotropy. Subcell (beta, gamma) is beta * columns + gamma.
        expansion : ndarray of float, shape (subcells, 6)
            1/K.

        Returns
        -------
        Homogenised
        """


def check_sizes(heights: NDArray[np.float64], widths: NDArray[np.float64]) -> None:
    """Refuse sizes of rows or columns that are not finite and greater than 0.

    Raises
    ------
    ValueError
        With the name of the argument.
    """
    for name, sizes in (("heights", heights), ("widths", widths)):
        if not (np.isfinite(sizes).all() and (sizes > 0.0).all()):
            raise ValueError(f"{name} are {sizes} m; every size must be finite and greater than 0")
