"""One-dimensional theory of the overlap: static far field, and reflected and transmitted waves.

Two bars of equal modulus E and density rho overlap over a length L: the continuum from the left, its mass scaled by a
weight W and its stiffness by B, which is W or a small constant, and the atoms to the right, at full weight. Springs
kappa W / W(outer) per volume join them, and dampers rho W / (tau W(outer)), so both grow with the weight where it does.
With u and r the displacements, x = 0 at the outer border and x = L at the inner one,

    (E B u')' + kappa W (r - u) = W rho u_tt,    E r'' - kappa W (r - u) = rho r_tt  (W over W(outer) in the springs),
    r'(0) = 0,  u'(L) = 0.

In statics, with B = W, the far field is exact for one kappa. At constant weight w it has the closed form

    lambda w sinh(lambda) = 2 + (w + 1/w) cosh(lambda),    kappa = lambda^2 E / (L^2 (1 + 1/w));

for the other profiles both equations are solved with linear finite elements. They may be as coarse for u as the grid
of the continuum is: with a small B the load enters the springs within (E B / kappa)^(1/2) of the outer border, which a
grid widens to a cell. A wave that is long against L meets a body that is m L rho too heavy, m the mean of W, and
longer by the static error d in units of L, so it is reflected with the amplitude pi |m - d| L / wavelength. Lengths
are in units of L here, moduli of E, speeds of (E / rho)^(1/2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_banded
from scipy.optimize import brentq

from coordinator.weight_profile import WeightProfile
from protocol.arrays import FloatArray

#: Elements of the finest bars, and of the atoms'.
_ELEMENTS = 100


@dataclass(frozen=True)
class Scattering:
    """What becomes of a wave from the continuum, as amplitudes over its own.

    Attributes
    ----------
    reflected, transmitted : float
    """

    reflected: float
    transmitted: float

    @property
    def absorbed(self) -> float:
        """Share of its energy that the dampers take."""
        return 1.0 - self.reflected**2 - self.transmitted**2


def exact_lambda(weight: float) -> float:
    """Return the root lambda of the equation above, by bisection.

    The left side outgrows the right one for large lambda, since lambda w passes w + 1/w.
    """

    def excess(x: float) -> float:
        # divided by cosh, so that nothing overflows for small weights
        return x * weight * math.tanh(x) - 2.0 / math.cosh(min(x, 700.0)) - (weight + 1.0 / weight)

    low, high = 0.0, 2.0 + 2.0 / weight**2
    while high - low > 1e-14 * high:
        middle = 0.5 * (low + high)
        if excess(middle) < 0.0:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


@lru_cache(maxsize=256)
def exact_stiffness(profile: WeightProfile) -> float:
    """Return kappa L^2 / E at the outer border for which the far field is exact in statics.

    2.878 at full weight, 927 at a constant weight of 0.1, 78.8 for the power 8 from 0.05.

    Parameters
    ----------
    profile : WeightProfile
        Of stiffness and mass alike.
    """
    if profile.stiffness is not None:
        raise ValueError(f"profile has a stiffness of its own, {profile.stiffness}: no springs are exact on every grid")
    if profile.kind == "constant":
        return exact_lambda(profile.weight) ** 2 / (1.0 + 1.0 / profile.weight)
    # Between full weight, which takes the softest springs, and more than the steepest profile needs.
    return math.exp(brentq(lambda x: static_error(profile, math.exp(x)), 0.0, math.log(1e6), xtol=1e-10))


def static_error(profile: WeightProfile, stiffness: float, cells: int | None = None) -> float:
    """Return by how much the bars stretch beyond one whole bar, in units of L times the far strain.

    Parameters
    ----------
    profile : WeightProfile
    stiffness : float
        kappa L^2 / E at the outer border.
    cells : int, optional
        Of the continuum's grid in one L; fine ones without.
    """
    if profile.kind == "constant" and profile.stiffness is None and cells is None:
        return _constant_error(profile.weight, stiffness)
    bars = _Bars(profile, stiffness, 0.0, cells)
    # The continuum is held at the outer border, and a unit force pulls the atoms at the inner one.
    bars.continuum, bars.across = bars.continuum[1:, 1:], bars.across[1:]
    _, r = bars.moved(np.zeros(len(bars.continuum)), 1.0)
    return float(r[-1] - 1.0)


def _constant_error(w: float, stiffness: float) -> float:
    """Return the closed form at constant weight.

    The gap g = r - u obeys g'' = lambda^2 g with g' = -1/w at the outer and 1 at the inner border, and w u + r has
    the slope 1.
    """
    rate = math.sqrt(stiffness * (1.0 + 1.0 / w))
    over_sinh, coth = (1.0 / math.sinh(rate), 1.0 / math.tanh(rate)) if rate < 700.0 else (0.0, 1.0)
    outer = (w * over_sinh + coth) / (w * rate)
    inner = (w * coth + over_sinh) / (w * rate)
    return (1.0 + w * inner + outer) / (1.0 + w) - 1.0


def scatter(
    profile: WeightProfile, stiffness: float, wavelength: float, damping: float = 0.0, cells: int | None = None
) -> Scattering:
    """Return what becomes of a wave that comes from the continuum.

    Parameters
    ----------
    profile : WeightProfile
    stiffness : float
        kappa L^2 / E at the outer border.
    wavelength : float
        In units of L.
    damping : float
        L / (c tau) at the outer border, c the wave speed.
    cells : int, optional
        Of the continuum's grid in one L; fine ones without.
    """
    omega = 2.0 * math.pi / wavelength
    bars = _Bars(profile, stiffness + 1j * omega * damping, omega, cells)
    # Half-infinite bars on either side: a force i omega u each, and 2 i omega from the wave of amplitude one.
    bars.continuum[0, 0] += 1j * omega
    bars.atoms[1, -1] += 1j * omega
    force = np.zeros(len(bars.continuum), dtype=np.complex128)
    force[0] = 2j * omega
    u, r = bars.moved(force, 0.0)
    return Scattering(float(abs(u[0] - 1.0)), float(abs(r[-1])))


class _Bars:
    """Stiffness minus omega^2 mass of both bars and their springs.

    Attributes
    ----------
    continuum : array, shape (nodes, nodes)
        Of the continuum, from the outer border inwards.
    across : array, shape (nodes, fine nodes)
        Between continuum and atoms.
    atoms : array, shape (3, fine nodes)
        Of the atoms, as diagonals for `solve_banded`.
    """

    def __init__(self, profile: WeightProfile, spring: complex, omega: float, cells: int | None) -> None:
        elements = _ELEMENTS if cells is None else cells * -(-_ELEMENTS // cells)
        h = 1.0 / elements
        share = np.linspace(1.0 - 0.5 * h, 0.5 * h, elements)
        weight, tie = profile.at(share), spring * profile.at(share) / profile.at_border
        springs = _diagonals(tie * h / 3.0, tie * h / 6.0)

        def bar(stiffness: FloatArray, mass: FloatArray) -> NDArray[Any]:
            inertia = omega**2 * mass * h / 6.0
            return np.asarray(_diagonals(stiffness / h - 2.0 * inertia, -stiffness / h - inertia) + springs)

        # Displacements of the fine nodes from those of the grid: linear functions.
        way = np.arange(elements + 1) * (cells or elements) / elements
        hats = np.maximum(0.0, 1.0 - np.abs(way - np.arange((cells or elements) + 1)[:, None]))
        fine = bar(profile.stiffness_at(share), weight)
        self.continuum = _times(hats, fine) @ hats.T
        self.across = -_times(hats, springs)
        self.atoms = bar(np.ones(elements), np.ones(elements))

    def moved(self, on_continuum: NDArray[Any], on_atoms: float) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return displacements of both bars under forces on the continuum's nodes and on the innermost atom."""
        forces = np.zeros((self.atoms.shape[1], len(self.continuum) + 1), dtype=self.atoms.dtype)
        forces[:, :-1] = self.across.T
        forces[-1, -1] = on_atoms
        solved = solve_banded((1, 1), self.atoms, forces)
        u = np.linalg.solve(self.continuum - self.across @ solved[:, :-1], on_continuum - self.across @ solved[:, -1])
        return u, solved[:, -1] - solved[:, :-1] @ u


def _diagonals(same: NDArray[Any], across: NDArray[Any]) -> NDArray[Any]:
    """Return the sum of 2 x 2 element matrices, `same` on their diagonal and `across` off it, as three diagonals."""
    main = np.append(same, 0.0) + np.append(0.0, same)
    return np.array([np.append(0.0, across), main, np.append(across, 0.0)])


def _times(rows: FloatArray, diagonals: NDArray[Any]) -> NDArray[Any]:
    """Return rows times the symmetric matrix of three diagonals, shape of the rows."""
    found = rows * diagonals[1]
    found[:, 1:] += rows[:, :-1] * diagonals[0, 1:]
    found[:, :-1] += rows[:, 1:] * diagonals[2, :-1]
    return np.asarray(found)
