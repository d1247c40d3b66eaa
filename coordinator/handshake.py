"""Weight of the continuum in the overlap, anchors' springs and dampers that go with it, and what is stable.

The smaller the mean weight m of the overlap, the less a wave is reflected (`coordinator.overlap_theory`); but the
springs grow stiff on a light mass, and the exchange limits them. With Dt the coupling step, W the weight, omega^2 =
kappa / (W rho) and tau the damping time of the atoms against their anchors, the terms

    S = (Dt omega / 2)^2,    D = Dt / (2 W tau),    Q = (Dt Omega)^2 = (2 c Dt / h)^2

are of springs, dampers, and the continuum's own fastest vibration on cells of size h. One step of a light node
against atoms at rest shows where an exchange loses stability:

serial    Anchors stand at u(n) while the atoms move, the mean force acts in the next continuum step:
          v' = v - 4 S u / Dt - 2 D v,  u' = u + Dt v'.  An eigenvalue leaves the unit circle at -1 where S + D = 1.
parallel  Both sides move at once, so the anchors stand where the continuum is predicted to be, u + Dt v + Dt (v - v")
          with v" the velocity one step before, and the damper works against v. Eigenvalues leave at
          exp(i pi/3) where 8 S + 2 D + Q = 1. Without the last term of the prediction it is unstable.

The exchange number is the root of either sum. Without dampers the serial exchange is a symplectic splitting: motion of
the atoms with the anchors frozen, which also kicks the continuum, then motion of the continuum. Below the limit it
conserves a modified energy, so nothing grows, provided that the mean force is that which moved the atoms: velocity
Verlet counts the ends of the window by half. (Counted in full they act as dampers of the wrong sign.) As with all
impulses there may be a resonance with the atoms' fastest vibration Omega_a, where Dt Omega_a + 2 asin(N) > 2 pi;
strong dampers remove it.

Where the continuum makes n steps in one exchange, the force acts as an impulse in the first: v + Dt F / m, then u
drifts, which is the same map. Spread evenly over the steps it reaches the place half a step late: the determinant of
the map is 1 + 2 S (n - 1) / n, above 1, so it is unstable without dampers for any n > 1.

Springs and dampers that follow the weight, kappa W and rho W / tau, have the same S and D everywhere and on any grid,
since what spreads the springs' forces also spreads the mass. Then S^(1/2) = C c Dt / (m L) with C from 0.67 to 0.74
whatever the profile; constant weight has C = 0.85 at 1, 2.4 at 0.2 and 4.8 at 0.1, since there the load passes in a
layer of w^2 L. Hence weight 0.05 rising to 1 with the largest exponent that is stable.

In two dimensions the continuum's stiffness in the overlap also holds the ring along its sides, which no springs can
undo. So, where the exchange bears springs that are stiff enough, the continuum keeps its mass W but only a hundredth
of its stiffness, and the springs have an exchange number of 0.6 instead of being statically exact: the static error,
then the slip in the springs of the first cell, is accepted while it is at most m, which is where it has lowered the
reflection pi |m - d| L / wavelength as far as the mass had raised it. Else stiffness is scaled as mass.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from coordinator.overlap_theory import exact_stiffness, scatter, static_error
from coordinator.weight_profile import Kind, WeightProfile
from protocol.arrays import FloatArray

Scheme = Literal["serial", "parallel"]

#: Largest exchange number that is used. In theory both are 1; without dampers, in one dimension, the serial exchange
#: was measured to hold energy up to 0.9, while the parallel one lets fast vibrations of atoms grow slowly above 0.8.
STABILITY_LIMIT: dict[Scheme, float] = {"serial": 0.9, "parallel": 0.75}
#: Exchange number that the choice by theory stays below: atoms sit unevenly on the nodes.
CHOSEN_NUMBER: dict[Scheme, float] = {"serial": 0.7, "parallel": 0.6}
SMALLEST_WEIGHT = 0.05
#: Steeper profiles gain little: at 8 the mean weight is 0.16, and the first cell holds most of the rise.
LARGEST_EXPONENT = 8
#: Share of the continuum's stiffness that is left where its mass alone carries: enough to hold its nodes together.
SMALL_STIFFNESS = 0.01
#: Exchange number of the springs then, and their largest kappa L^2 / E.
SPRING_NUMBER, LARGEST_STIFFNESS = 0.6, 500.0
#: kappa L^2 / E of springs that count as stiff: a far field of two bars is then 0.48 L too short at full weight.
STIFF = 1000.0
#: Dampers follow the weight in powers of two, since an engine may need a thermostat for each value, and not below this.
SMALLEST_SHARE = 1.0 / 16.0


class HandshakeError(ValueError):
    """The handshake cannot be stable with what the scene asks for."""


@dataclass(frozen=True)
class Handshake:
    """Weight, springs and dampers of a handshake.

    Attributes
    ----------
    profile : WeightProfile
        Of the continuum's stiffness and mass in the overlap.
    stiffness_density : float
        Spring stiffness per volume at the outer border, N/m4.
    exchange_number : float
        Below the `STABILITY_LIMIT` of the scheme the exchange is stable.
    scheme : {"serial", "parallel"}
    static_error : float
        How far the coupled body stretches beyond one whole body, in widths of the overlap times the far strain.
    relative_stiffness : float
        kappa L^2 / E at the outer border.
    cells : int or None
        Of the continuum's grid in the width; None where that does not matter.
    """

    profile: WeightProfile
    stiffness_density: float
    exchange_number: float
    scheme: Scheme
    static_error: float
    relative_stiffness: float
    cells: int | None = None

    @property
    def weight(self) -> float:
        """Weight of the continuum at the inner border."""
        return self.profile.weight

    @property
    def exponent(self) -> float:
        """Exponent of the profile `power`, else 1."""
        return self.profile.exponent

    @property
    def stiffness_share(self) -> float | None:
        """Factor on the continuum's stiffness alone; None: the weight."""
        return self.profile.stiffness

    @property
    def mean_weight(self) -> float:
        """Mean weight of the continuum in the overlap."""
        return self.profile.mean

    def weight_at(self, share: FloatArray) -> FloatArray:
        """Return the weight at shares s = d_inner / (d_inner + d_outer) of the way outwards, any shape."""
        return self.profile.at(share)

    def stiffness_at(self, share: FloatArray) -> FloatArray:
        """Return spring stiffness per volume, N/m4, at shares as of `weight_at`: it follows the weight."""
        return np.asarray(self.stiffness_density * self.profile.at(share) / self.profile.at_border)

    def damping_share_at(self, share: FloatArray) -> FloatArray:
        """Return factors on the damper, at most 1, at shares as of `weight_at`: the weight to a power of two."""
        return damping_share(self.profile, share)

    def reflection(self, wavelength: float, damping: float = 0.0) -> float:
        """Return the reflected amplitude of a wave from the continuum over its own.

        Parameters
        ----------
        wavelength : float
            In widths of the overlap.
        damping : float
            Time of a wave through the overlap over the damping time, L / (c tau).
        """
        return scatter(self.profile, self.relative_stiffness, wavelength, damping, self.cells).reflected


def damping_share(profile: WeightProfile, share: FloatArray) -> FloatArray:
    """Return factors on the dampers at shares s of the way outwards: 1 at constant weight, else W as a power of two."""
    weight = profile.at(share)
    if profile.kind == "constant":
        return np.ones_like(weight)
    return np.asarray(np.maximum(2.0 ** np.round(np.log2(weight)), SMALLEST_SHARE))


def exchange_number(
    stiffness_density: float,
    profile: WeightProfile,
    density: float,
    coupling_step: float,
    damping_time: float | None = None,
    scheme: Scheme = "serial",
    courant: float = 0.0,
) -> float:
    """Return the root of S + D (serial) or 8 S + 2 D + Q (parallel); see above.

    Parameters
    ----------
    stiffness_density : float
        At the outer border, N/m4.
    profile : WeightProfile
    density : float
        Of the continuum at weight 1, kg/m3.
    coupling_step : float
        Dt, s.
    damping_time : float, optional
        tau, s, at a damping share of 1; None without damper.
    scheme : {"serial", "parallel"}
    courant : float
        c Dt / h, of the parallel scheme.
    """
    spring = 0.25 * coupling_step**2 * stiffness_density / (profile.at_border * density)
    damper = 0.0
    if damping_time is not None:
        across = np.linspace(0.0, 1.0, 201)
        heaviest = float(np.max(damping_share(profile, across) / profile.at(across)))
        damper = 0.5 * coupling_step / damping_time * heaviest
    if scheme == "serial":
        return math.sqrt(spring + damper)
    return math.sqrt(8.0 * spring + 2.0 * damper + 4.0 * courant**2)


@dataclass(frozen=True)
class _Exchange:
    """What a choice is made for: a body, a width and a coupling step, all as of `choose`."""

    young: float
    density: float
    width: float
    coupling_step: float
    damping_time: float | None
    scheme: Scheme
    courant: float

    @property
    def aim(self) -> float:
        """Exchange number that the choice stays below."""
        return CHOSEN_NUMBER[self.scheme]

    def number(self, profile: WeightProfile, stiffness_density: float) -> float:
        """Return the exchange number of a profile and its springs."""
        return exchange_number(
            stiffness_density, profile, self.density, self.coupling_step, self.damping_time, self.scheme, self.courant
        )

    def handshake(self, profile: WeightProfile, stiffness_density: float | None) -> Handshake:
        """Return the handshake of a profile, with the statically exact springs where none are given."""
        unit = self.young / self.width**2
        kappa = exact_stiffness(profile) * unit if stiffness_density is None else stiffness_density
        cells = None if profile.stiffness is None else self.cells
        error = static_error(profile, kappa / unit, cells)
        return Handshake(profile, kappa, self.number(profile, kappa), self.scheme, error, kappa / unit, cells)

    def stiffest(self, profile: WeightProfile, relative: float, number: float) -> float:
        """Return springs of kappa L^2 / E = `relative`, or softer ones with the exchange number, N/m4."""
        stiff = relative * self.young / self.width**2
        without, wanted = self.number(profile, 0.0), self.number(profile, stiff)
        left = number**2 - without**2
        return stiff if wanted <= number or left <= 0.0 else stiff * left / (wanted**2 - without**2)

    @property
    def cells(self) -> int | None:
        """Cells of the continuum's grid in the width; None where they are not known."""
        way = self.coupling_step * math.sqrt(self.young / self.density)
        return max(1, round(self.courant * self.width / way)) if self.courant > 0.0 else None


def choose(
    young: float,
    density: float,
    width: float,
    coupling_step: float,
    *,
    damping_time: float | None = None,
    weight: float | None = None,
    stiffness_density: float | None = None,
    profile: Kind | None = None,
    stiffness_share: float | None = None,
    scheme: Scheme = "serial",
    courant: float = 0.0,
    stiff: bool = False,
) -> Handshake:
    """Return the handshake of the smallest mean weight whose statically exact springs are stable.

    Without a profile it is `power` from a weight of 0.05, or `constant` where weight or stiffness are given. For
    `power` the exponent is the largest whole one up to 8 that is stable; else, and where none is, the weight grows.
    Where nothing at all is given, springs of a continuum of small stiffness are taken if they slip little; see above.

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
    weight : float, optional
        At the inner border.
    stiffness_density : float, optional
        At the outer border, N/m4. At constant weight the weight then follows from it, unless that is given.
    profile : {"constant", "linear", "cubic", "power"}, optional
    stiffness_share : float, optional
        Factor on the continuum's stiffness alone, not its mass. Springs are then as stiff as the exchange bears.
    scheme : {"serial", "parallel"}
    courant : float
        c Dt / h with h the size of a cell in the overlap; 0 where it is not known.
    stiff : bool
        Springs as stiff as the exchange bears instead of statically exact ones, as the dissertation has them.

    Raises
    ------
    HandshakeError
        Where the exchange would be unstable; the message names the limit and what to change.
    """
    exchange = _Exchange(young, density, width, coupling_step, damping_time, scheme, courant)
    free = profile is None and weight is None and stiffness_density is None
    kind = profile or ("power" if weight is None and stiffness_density is None else "constant")
    if kind == "constant" and weight is None and stiffness_density is not None:
        weight = exact_weight(stiffness_density * width**2 / young)
    if stiff and stiffness_density is None:
        full = WeightProfile(kind, 1.0 if weight is None else weight)
        chosen = exchange.handshake(full, exchange.stiffest(full, STIFF, exchange.aim))
    elif stiffness_share is not None:
        chosen = _carried_by_mass(exchange, kind, weight, stiffness_density, stiffness_share)
    else:
        chosen = _steepest(exchange, kind, weight, stiffness_density)
        if free and exchange.cells is not None:
            other = _carried_by_mass(exchange, kind, None, None, SMALL_STIFFNESS)
            if other.static_error <= other.mean_weight and other.exchange_number <= exchange.aim:
                chosen = other
    if not chosen.exchange_number < STABILITY_LIMIT[scheme]:
        raise HandshakeError(_refusal(exchange, chosen))
    return chosen


def _carried_by_mass(
    exchange: _Exchange, kind: Kind, weight: float | None, stiffness_density: float | None, share: float
) -> Handshake:
    """Return the handshake of a continuum of small stiffness, its springs as stiff as is wise unless they are given."""
    exponent = float(LARGEST_EXPONENT) if kind == "power" else 1.0
    profile = WeightProfile(kind, SMALLEST_WEIGHT if weight is None else weight, exponent, share)
    if stiffness_density is None:
        stiffness_density = exchange.stiffest(profile, LARGEST_STIFFNESS, min(SPRING_NUMBER, exchange.aim))
    return exchange.handshake(profile, stiffness_density)


def _steepest(exchange: _Exchange, kind: Kind, weight: float | None, stiffness_density: float | None) -> Handshake:
    """Return the handshake of least mean weight below the aim, or else that of the smallest number."""

    def made(w: float, exponent: float = 1.0) -> Handshake:
        return exchange.handshake(WeightProfile(kind, w, exponent), stiffness_density)

    least = SMALLEST_WEIGHT if weight is None else weight
    exponents = range(LARGEST_EXPONENT, 0, -1) if kind == "power" else (1,)
    for exponent in exponents:
        chosen = made(least, float(exponent))
        if chosen.exchange_number < exchange.aim:
            return chosen
    if weight is not None:
        return chosen
    heaviest = made(1.0)
    if not heaviest.exchange_number < exchange.aim:
        return min(chosen, heaviest, key=lambda one: one.exchange_number)
    # The exchange number falls as the weight grows, so the smallest stable weight is a bisection away.
    low, high = least, 1.0
    while high - low > 1e-3:
        middle = 0.5 * (low + high)
        if made(middle).exchange_number < exchange.aim:
            high = middle
        else:
            low = middle
    return made(high)


def exact_weight(stiffness: float) -> float:
    """Return the constant weight whose statically exact kappa L^2 / E is `stiffness`, or the nearest one allowed."""
    low, high = SMALLEST_WEIGHT, 1.0
    if exact_stiffness(WeightProfile("constant", high)) >= stiffness:
        return high
    while high - low > 1e-6:
        middle = 0.5 * (low + high)
        if exact_stiffness(WeightProfile("constant", middle)) > stiffness:
            low = middle
        else:
            high = middle
    return high


def _refusal(exchange: _Exchange, tried: Handshake) -> str:
    """Return what is unstable, the limit, and what to change."""
    profile = tried.profile
    bare = replace(exchange, scheme="serial").handshake(profile, tried.stiffness_density).exchange_number
    # Springs alone are linear in the step, dampers and the square of cells too: a safe step by proportion.
    safe = exchange.coupling_step * min(1.0, (exchange.aim / tried.exchange_number) ** 2)
    words = (
        f"the exchange is unstable: coupling step {exchange.coupling_step * 1e15:.3g} fs, weight {profile.weight:.3g} "
        f"({profile.kind}) and stiffness {tried.stiffness_density:.3g} N/m4"
    )
    if exchange.damping_time is not None:
        words += f", damping time {exchange.damping_time * 1e15:.3g} fs"
    words += f" give an exchange number of {tried.exchange_number:.3g}, allowed is {STABILITY_LIMIT[exchange.scheme]}"
    if exchange.scheme == "parallel" and bare < STABILITY_LIMIT["serial"]:
        words += f" (of handshake.scheme = parallel; serial has {bare:.3g})"
    return words + (
        f"; take a smaller handshake.steps_per_exchange (a coupling step of {safe * 1e15:.3g} fs is stable) or "
        "handshake.stiffness, a larger handshake.weight or handshake.damping_time"
    )
