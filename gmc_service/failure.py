"""Failure criteria of a subcell, each as an index that reaches one where the material fails.

Every index is the factor by which a load exceeds the failure surface along a proportional path: where the stresses (or
strains) double, it doubles. For a criterion that is printed as a quadratic form equal to one, it is the root of that
form; both reach one together. A component whose allowable is infinite is not checked.

Strains of the maximum strain criterion are mechanical: the total strain less the free thermal expansion.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numba as nb
import numpy as np
from numpy.typing import NDArray

from gmc_service.cell import Cell
from gmc_service.component_order import COMPONENTS
from gmc_service.material import CRITERIA, Failure

#: Subcells whose index is within this of one fail together: rounding must not pick one of two equal subcells.
TOLERANCE: Final = 1e-9
FAILS_AT: Final = 1.0 - TOLERANCE

MAXIMUM_STRESS: Final = CRITERIA.index("maximum_stress")
MAXIMUM_STRAIN: Final = CRITERIA.index("maximum_strain")
TSAI_HILL: Final = CRITERIA.index("tsai_hill")
HASHIN: Final = CRITERIA.index("hashin")

#: Of the largest normal stress: what is smaller has no sign.
_ROUNDING: Final = 1e-9


@nb.njit(nogil=True, cache=True, error_model="numpy")
def maximum_index(a1, a2, a3, a23, a13, a12, rates, check):  # type: ignore[no-untyped-def]
    """Maximum stress or maximum strain: the largest ratio of a component to its allowable of the same sign.

    Parameters
    ----------
    a1, a2, a3, a23, a13, a12 : float
        Stresses in Pa, or strains (engineering shear).
    rates : ndarray of float, shape (checks, 9)
        One over the allowables: tension along 1, 2, 3, compression along 1, 2, 3, shear 23, 13, 12.
    check : int
        Row of `rates`: a whole array and an index are cheaper to hand over than a row of it.

    Returns
    -------
    float
    """
    index = max(a1 * rates[check, 0], -a1 * rates[check, 3])
    index = max(index, max(a2 * rates[check, 1], -a2 * rates[check, 4]))
    index = max(index, max(a3 * rates[check, 2], -a3 * rates[check, 5]))
    index = max(index, abs(a23) * rates[check, 6])
    index = max(index, abs(a13) * rates[check, 7])
    return max(index, abs(a12) * rates[check, 8])


@nb.njit(nogil=True, cache=True, error_model="numpy")
def tsai_hill_index(a1, a2, a3, a23, a13, a12, rates, check):  # type: ignore[no-untyped-def]
    """Tsai-Hill in three dimensions; parameters as in `maximum_index`, with stresses.

    Hill's quadratic form (Hill, Proc. R. Soc. A 193 (1948) 281; Azzi and Tsai, Exp. Mech. 5 (1965) 283)

        s1^2/X^2 + s2^2/Y^2 + s3^2/Z^2 - (1/X^2 + 1/Y^2 - 1/Z^2) s1 s2 - (1/X^2 + 1/Z^2 - 1/Y^2) s1 s3
            - (1/Y^2 + 1/Z^2 - 1/X^2) s2 s3 + s23^2/R^2 + s13^2/S^2 + s12^2/T^2 = 1

    with X, Y, Z the strength in tension or in compression by the sign of each stress. Of stresses 22 and 33, one that
    is zero but for rounding takes the sign of the other, so in plane stress the form is that of a lamina, with
    s1 s2/X^2. A stress without an allowable counts as zero. Strengths of very different size can make the form
    negative; the index is then zero.
    """
    least = _ROUNDING * max(abs(a1), abs(a2), abs(a3))
    sign2 = a2 if abs(a2) > least else a3
    sign3 = a3 if abs(a3) > least else a2
    x = rates[check, 0] if a1 >= 0.0 else rates[check, 3]
    y = rates[check, 1] if sign2 >= 0.0 else rates[check, 4]
    z = rates[check, 2] if sign3 >= 0.0 else rates[check, 5]
    if x == 0.0:
        a1 = 0.0
    if y == 0.0:
        a2 = 0.0
    if z == 0.0:
        a3 = 0.0
    x, y, z = x * x, y * y, z * z
    form = x * a1 * a1 + y * a2 * a2 + z * a3 * a3
    form -= (x + y - z) * a1 * a2 + (x + z - y) * a1 * a3 + (y + z - x) * a2 * a3
    form += (a23 * rates[check, 6]) ** 2 + (a13 * rates[check, 7]) ** 2 + (a12 * rates[check, 8]) ** 2
    return np.sqrt(max(form, 0.0))


@nb.njit(nogil=True, cache=True, error_model="numpy")
def hashin_modes(a1, a2, a3, a23, a13, a12, rates, check):  # type: ignore[no-untyped-def]
    """Fibre and matrix index of Hashin's criterion in three dimensions; parameters as in `maximum_index`, stresses.

    Hashin, J. Appl. Mech. 47 (1980) 329, for a material that is isotropic across axis 1; with X, Y the strengths along
    1 and across, R the shear strength 23 and T those of 12 and 13:

        fibre, s11 > 0     (s11/X)^2 + (s12^2 + s13^2)/T^2 = 1
        fibre, s11 < 0     -s11/X' = 1
        matrix, s22 + s33 > 0     (s22 + s33)^2/Y^2 + (s23^2 - s22 s33)/R^2 + (s12^2 + s13^2)/T^2 = 1
        matrix, s22 + s33 < 0     ((Y'/2R)^2 - 1) (s22 + s33)/Y' + (s22 + s33)^2/4R^2 + (s23^2 - s22 s33)/R^2
                                  + (s12^2 + s13^2)/T^2 = 1

    (primes: compression). The last has a linear term; its index e solves e^2 = quadratic + linear e. Where an
    allowable is infinite its terms are left out.

    Returns
    -------
    fibre, matrix : float
    """
    along = (a13 * rates[check, 7]) ** 2 + (a12 * rates[check, 8]) ** 2
    if a1 >= 0.0:
        fibre = np.sqrt((a1 * rates[check, 0]) ** 2 + along) if rates[check, 0] > 0.0 else 0.0
    else:
        fibre = -a1 * rates[check, 3]
    across = a2 + a3
    shear = rates[check, 6] * rates[check, 6]
    form = (a23 * a23 - a2 * a3) * shear + along
    if across >= 0.0:
        return fibre, np.sqrt(max((across * rates[check, 1]) ** 2 + form, 0.0))
    form += 0.25 * across * across * shear
    linear = 0.0
    if rates[check, 4] > 0.0:
        linear = (0.25 * shear / (rates[check, 4] * rates[check, 4]) - 1.0) * across * rates[check, 4]
    return fibre, max(0.5 * (linear + np.sqrt(max(linear * linear + 4.0 * form, 0.0))), 0.0)


@nb.njit(nogil=True, cache=True, error_model="numpy")
def failure_index(criterion, a1, a2, a3, a23, a13, a12, rates, check):  # type: ignore[no-untyped-def]
    """Index of one criterion, by its place in `material.CRITERIA`; other parameters as in `maximum_index`.

    Returns
    -------
    float
        One or more: failed.
    """
    if criterion == TSAI_HILL:
        return tsai_hill_index(a1, a2, a3, a23, a13, a12, rates, check)
    if criterion == HASHIN:
        fibre, matrix = hashin_modes(a1, a2, a3, a23, a13, a12, rates, check)
        return max(fibre, matrix)
    return maximum_index(a1, a2, a3, a23, a13, a12, rates, check)


def rates_of(failure: Failure) -> NDArray[np.float64]:
    """One over the allowables of a criterion, shape (9,): tension, compression, shear; 0 where there is none.

    Raises
    ------
    ValueError
        If the criterion is Hashin's and the allowables differ across axis 1: it knows one transverse direction only.
    """
    if failure.criterion == "hashin":
        for name in ("tension", "compression", "shear"):
            _, one, other = getattr(failure, name)
            if one != other:
                axes = "13 and 12" if name == "shear" else "2 and 3"
                raise ValueError(
                    f"{name} of hashin is {one:g} and {other:g} for {axes}; they must be equal, "
                    "since the criterion is for materials isotropic across axis 1"
                )
    return 1.0 / np.array([*failure.tension, *failure.compression, *failure.shear], dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Checks:
    """What must be looked at in a cell: one row for each criterion of each subcell that has any allowable.

    Attributes
    ----------
    subcell : ndarray of int64, shape (checks,)
    criterion : ndarray of int64, shape (checks,)
        Place in `material.CRITERIA`.
    rates : ndarray of float, shape (checks, 9)
        See `rates_of`.
    """

    subcell: NDArray[np.int64]
    criterion: NDArray[np.int64]
    rates: NDArray[np.float64]

    @property
    def arrays(self) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
        """Subcell, criterion, rates, as compiled functions take them."""
        return self.subcell, self.criterion, self.rates

    def of_strain(self) -> NDArray[np.bool_]:
        """Which rows look at strains, the others at stresses; shape (checks,)."""
        return np.asarray(self.criterion == MAXIMUM_STRAIN)


def checks_of(cell: Cell) -> Checks:
    """Return the checks of a cell, ordered by subcell; criteria without any allowable are left out."""
    rows = [
        (subcell, CRITERIA.index(failure.criterion), rates)
        for subcell, phase in enumerate(cell.phase.reshape(-1))
        for failure in cell.materials[phase].failures
        if (rates := rates_of(failure)).any()
    ]
    return Checks(
        subcell=np.array([row[0] for row in rows], dtype=np.int64),
        criterion=np.array([row[1] for row in rows], dtype=np.int64),
        rates=np.array([row[2] for row in rows], dtype=np.float64).reshape(-1, 9),
    )


def governing_component(criterion: int, load: NDArray[np.float64], rates: NDArray[np.float64]) -> str:
    """Name the component or mode that brings an index nearest to failure, as ``11 tension`` or ``matrix compression``.

    Parameters
    ----------
    criterion : int
        Place in `material.CRITERIA`.
    load : ndarray of float, shape (6,)
        Stress in Pa or strain, as the criterion takes it.
    rates : ndarray of float, shape (9,)

    Returns
    -------
    str
        Of Tsai-Hill, which has no modes, the component with the largest ratio to its allowable.
    """
    if criterion == HASHIN:
        fibre, matrix = hashin_modes(*load, rates[None], 0)
        if fibre >= matrix:
            return "fibre tension" if load[0] >= 0.0 else "fibre compression"
        return "matrix tension" if load[1] + load[2] >= 0.0 else "matrix compression"
    ratios = np.concatenate([load[:3] * rates[:3], -load[:3] * rates[3:6], np.abs(load[3:]) * rates[6:]])
    most = int(np.argmax(ratios))
    sense = ("tension", "compression", "shear")[most // 3]
    return f"{COMPONENTS[most if most < 3 else most - 3]} {sense}"
