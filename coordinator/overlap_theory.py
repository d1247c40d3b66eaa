"""One-dimensional theory of the overlap: static far field, and reflected and transmitted waves.

Two bars of equal modulus E and density rho overlap over a length L: the continuum from the left, scaled by a
weight W in stiffness and mass alike, and the atoms to the right, at full weight. Springs kappa W / W(outer) per
volume join them, and dampers rho W / (tau W(outer)), so both grow with the weight where it does. With u and r the
displacements, x = 0 at the outer border and x = L at the inner one,

    (E W u')' + kappa W (r - u) = W rho u_tt,    E r'' - kappa W (r - u) = rho r_tt  (W over W(outer) in the springs),
    r'(0) = 0,  u'(L) = 0.

In statics the far field is exact for one kappa. At constant weight w it has the closed form

    lambda w sinh(lambda) = 2 + (w + 1/w) cosh(lambda),    kappa = lambda^2 E / (L^2 (1 + 1/w));

for the other profiles both equations are solved with linear finite elements. A wave that is long against L meets,
with that kappa, a body of the right compliance and of the mass m rho L too much, m the mean of W, so it is
reflected with the amplitude pi m L / wavelength. Lengths are in units of L here, moduli of E, speeds of
(E / rho)^(1/2).
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

_ELEMENTS = 400
_BAND = 3  # unknowns alternate between the bars, u0 r0 u1 r1 ...


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
    """
    if profile.kind == "constant":
        return exact_lambda(profile.weight) ** 2 / (1.0 + 1.0 / profile.weight)
    # Between full weight, which takes the softest springs, and more than the steepest profile needs.
    return math.exp(brentq(lambda x: static_error(profile, math.exp(x)), 0.0, math.log(1e6), xtol=1e-10))


def static_error(profile: WeightProfile, stiffness: float) -> float:
    """Return by how much the bars stretch beyond one whole bar, in units of L times the far strain.

    Parameters
    ----------
    profile : WeightProfile
    stiffness : float
        kappa L^2 / E at the outer border.
    """
    if profile.kind == "constant":
        return _constant_error(profile.weight, stiffness)
    matrix = _bars(profile, stiffness, 0.0)[:, 1:]  # without its first unknown: the continuum is held at x = 0
    load = np.zeros(matrix.shape[1])
    load[-1] = 1.0  # unit pull on the atoms at the inner border
    return float(solve_banded((_BAND, _BAND), matrix, load)[-1] - 1.0)


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


def scatter(profile: WeightProfile, stiffness: float, wavelength: float, damping: float = 0.0) -> Scattering:
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
    """
    omega = 2.0 * math.pi / wavelength
    matrix = _bars(profile, stiffness + 1j * omega * damping, omega)
    # Half-infinite bars on either side: a force i omega u each, and 2 i omega from the wave of amplitude one.
    matrix[_BAND, 0] += 1j * omega
    matrix[_BAND, -1] += 1j * omega
    load = np.zeros(matrix.shape[1], dtype=np.complex128)
    load[0] = 2j * omega
    moved = solve_banded((_BAND, _BAND), matrix, load)
    return Scattering(float(abs(moved[0] - 1.0)), float(abs(moved[-1])))


def _bars(profile: WeightProfile, spring: complex, omega: float) -> NDArray[Any]:
    """Return stiffness minus omega^2 mass of both bars and their springs, as diagonals for `solve_banded`."""
    h = 1.0 / _ELEMENTS
    weight = profile.at(np.linspace(1.0 - 0.5 * h, 0.5 * h, _ELEMENTS))
    tie = spring * weight / profile.at_border
    matrix = np.zeros((2 * _BAND + 1, 2 * (_ELEMENTS + 1)), dtype=np.complex128 if omega else np.float64)

    def add(bar: int, other: int, same: NDArray[Any], across: NDArray[Any]) -> None:
        """Add a 2 x 2 element matrix with `same` on its diagonal, `across` off it, between two bars."""
        near, far = slice(None, -1), slice(1, None)
        rows = matrix.reshape(2 * _BAND + 1, _ELEMENTS + 1, 2)  # entry (row i, column j) lies at [BAND + i - j, j]
        shift = bar - other
        rows[_BAND + shift, near, other] += same
        rows[_BAND + shift, far, other] += same
        rows[_BAND + shift + 2, near, other] += across
        rows[_BAND + shift - 2, far, other] += across

    for bar, scale in ((0, weight), (1, np.ones(_ELEMENTS))):
        inertia = omega**2 * scale * h / 6.0
        add(bar, bar, scale / h - 2.0 * inertia + tie * h / 3.0, -scale / h - inertia + tie * h / 6.0)
    for bar in (0, 1):
        add(bar, 1 - bar, -tie * h / 3.0, -tie * h / 6.0)
    return matrix
