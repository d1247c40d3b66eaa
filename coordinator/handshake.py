"""Weight of the continuum in the overlap, and stiffness of the anchors that goes with it.

Theory of two equal bars that overlap over a length L and are joined by springs of stiffness kappa per
volume, the continuum bar scaled by a weight w in stiffness and mass alike. The far field is exact in
statics where

    lambda w sinh(lambda) = 2 + (w + 1/w) cosh(lambda),    kappa = lambda^2 E / (L^2 (1 + 1/w)).

A small weight reflects waves least, since the continuum is then a light carrier that hands the load
over; but the springs grow stiff on a light mass, and the staggered exchange, which holds the anchors
still over a coupling step Dt and applies the averaged force in the next, is stable only while

    (Dt omega / 2)^2 + Dt / (2 w tau) < 1,    omega^2 = kappa / (w rho),

where tau is the damping time of the atoms against their anchors (the second term is absent without
damper). It follows from the map of one step of the light continuum against atoms at rest,

    v' = v - Dt (kappa u / (w rho) + v / (w tau)),    u' = u + Dt v',

whose eigenvalues leave the unit circle at -1 where the sum above reaches 1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

#: Largest exchange number that is used (theory: 1; without damper, measured in one dimension: 0.9).
STABILITY_LIMIT = 0.9
#: Exchange number that the choice by theory aims at: on a grid the nodes at the border of the overlap carry
#: less mass for their anchors than the mean, and runs at 0.9 were seen to blow up.
CHOSEN_NUMBER = 0.7
SMALLEST_WEIGHT = 0.05


class HandshakeError(ValueError):
    """The handshake cannot be stable with what the scene asks for."""


@dataclass(frozen=True)
class Handshake:
    """Weight and stiffness of a handshake.

    Attributes
    ----------
    weight : float
        Scale of the continuum's stiffness and mass in the overlap.
    stiffness_density : float
        Spring stiffness per volume, N/m4.
    exchange_number : float
        Square root of the sum above; below `STABILITY_LIMIT` the exchange is stable.
    """

    weight: float
    stiffness_density: float
    exchange_number: float


def exact_lambda(weight: float) -> float:
    """Return the root lambda of the equation above, by bisection.

    The left side outgrows the right one for large lambda, since w lambda passes w + 1/w.
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


def exact_stiffness(weight: float) -> float:
    """Return kappa L^2 / E for which the far field is exact in statics: 2.878 at w = 1, 927 at w = 0.1."""
    return exact_lambda(weight) ** 2 / (1.0 + 1.0 / weight)


def exact_weight(stiffness: float) -> float:
    """Return the weight whose statically exact kappa L^2 / E is `stiffness`, or the nearest one allowed."""
    low, high = SMALLEST_WEIGHT, 1.0
    if exact_stiffness(high) >= stiffness:
        return high
    while high - low > 1e-6:
        middle = 0.5 * (low + high)
        if exact_stiffness(middle) > stiffness:
            low = middle
        else:
            high = middle
    return high


def exchange_number(
    stiffness_density: float, weight: float, density: float, coupling_step: float, damping_time: float | None = None
) -> float:
    """Return the square root of (Dt omega / 2)^2 + Dt / (2 w tau).

    Parameters
    ----------
    stiffness_density : float
        N/m4.
    weight, density : float
        Weight of the continuum, and its density at weight 1, kg/m3.
    coupling_step : float
        Dt, s.
    damping_time : float, optional
        tau, s; None without damper.
    """
    spring = 0.25 * coupling_step**2 * stiffness_density / (weight * density)
    damper = 0.0 if damping_time is None else 0.5 * coupling_step / (weight * damping_time)
    return math.sqrt(spring + damper)


def choose(
    young: float,
    density: float,
    width: float,
    coupling_step: float,
    *,
    damping_time: float | None = None,
    weight: float | None = None,
    stiffness_density: float | None = None,
) -> Handshake:
    """Return the smallest weight whose statically exact stiffness is stable at the coupling step.

    Parameters
    ----------
    young, density : float
        Of the continuum, Pa and kg/m3.
    width : float
        L, width of the overlap, m.
    coupling_step : float
        Dt, s.
    damping_time : float, optional
        tau, s; None without damper.
    weight, stiffness_density : float, optional
        Values that the scene gives; the other one follows from theory.

    Raises
    ------
    HandshakeError
        Where the exchange would be unstable; the message names the limit and what to change.
    """

    def made(w: float) -> Handshake:
        kappa = exact_stiffness(w) * young / width**2 if stiffness_density is None else stiffness_density
        return Handshake(w, kappa, exchange_number(kappa, w, density, coupling_step, damping_time))

    if weight is None and stiffness_density is not None:
        weight = exact_weight(stiffness_density * width**2 / young)
    chosen = made(1.0 if weight is None else weight)
    if weight is None and chosen.exchange_number < CHOSEN_NUMBER:
        # The exchange number falls as the weight grows, so the smallest stable weight is a bisection away.
        low, high = SMALLEST_WEIGHT, 1.0
        if made(low).exchange_number < CHOSEN_NUMBER:
            high = low
        while high - low > 1e-3:
            middle = 0.5 * (low + high)
            if made(middle).exchange_number < CHOSEN_NUMBER:
                high = middle
            else:
                low = middle
        chosen = made(high)
    if chosen.exchange_number >= STABILITY_LIMIT:
        raise HandshakeError(
            f"the exchange is unstable: coupling step {coupling_step * 1e15:.3g} fs, weight {chosen.weight:.3g} and "
            f"stiffness {chosen.stiffness_density:.3g} N/m4"
            + (f", damping time {damping_time * 1e15:.3g} fs" if damping_time is not None else "")
            + f" give an exchange number of {chosen.exchange_number:.3g}, allowed is {STABILITY_LIMIT}; take a smaller "
            "handshake.steps_per_exchange or handshake.stiffness, a larger handshake.weight or handshake.damping_time"
        )
    return chosen
