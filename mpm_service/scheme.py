"""Which variant of the material point method a run uses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

Interpolation = Literal["linear", "ugimp", "cpgimp", "bspline"]
Integration = Literal["musl", "usl", "usf", "usavg"]
Transfer = Literal["fmpm", "flip", "pic", "xpic"]
#: Highest order of XPIC and FMPM that is accepted: each order costs a pass over the points.
HIGHEST_ORDER = 20


@dataclass(frozen=True)
class Scheme:
    """Interpolation, time integration, and transfer from grid to points.

    Parameters
    ----------
    interpolation : {"ugimp", "linear", "cpgimp", "bspline"}
        Grid functions: linear averaged over fixed point domains (uniform GIMP), linear at the points (the
        classic method), linear averaged over domains that follow the deformation gradient (convected GIMP),
        quadratic B-splines.
    integration : {"musl", "usl", "usf", "usavg"}
        When stress is updated: last with momenta mapped again, last, first, or half first and half last.
    transfer : {"fmpm", "flip", "pic", "xpic"}
        How nodal velocities reach the points.
    order : int
        Order k of XPIC(k) and FMPM(k); the others have none and ignore it.
    period : int
        XPIC, FMPM and PIC act every `period`-th step, FLIP in the steps between.

    Raises
    ------
    ValueError
        If a value is not one of those allowed.

    References
    ----------
    Bardenhagen and Kober, CMES 5 (2004) 477 (GIMP); Nairn, CMES 4 (2003) 649 (USF, USL, USAVG); Hammerquist
    and Nairn, CMAME 318 (2017) 724 (XPIC); Nairn and Hammerquist, CMAME 377 (2021) 113667 (FMPM).
    """

    interpolation: Interpolation = "ugimp"
    integration: Integration = "musl"
    transfer: Transfer = "fmpm"
    order: int = 2
    period: int = 1

    def __post_init__(self) -> None:
        for name, allowed in (
            ("interpolation", get_args(Interpolation)),
            ("integration", get_args(Integration)),
            ("transfer", get_args(Transfer)),
        ):
            value = getattr(self, name)
            if value not in allowed:
                raise ValueError(f"Scheme.{name} = {value!r}: allowed are {', '.join(allowed)}")
        for name, most in (("order", HIGHEST_ORDER), ("period", 1_000_000)):
            value = getattr(self, name)
            if isinstance(value, bool) or int(value) != value or not 1 <= value <= most:
                raise ValueError(f"Scheme.{name} = {value!r}: a whole number from 1 to {most} is needed")

    @property
    def passes(self) -> int:
        """Passes over the points that the filter of a filtered step adds."""
        return self.order - 1 if self.transfer in ("fmpm", "xpic") else 0

    def filters(self, step: int) -> bool:
        """Is the transfer of step number `step` (from 0) a filtered one, not FLIP?"""
        return self.transfer != "flip" and (step + 1) % self.period == 0

    @property
    def courant_limit(self) -> float:
        """Largest allowed Courant number (Eq 31).

        Four fifths or less of what stayed stable in trials with one to three points a cell, random velocities, a hole
        and free faces in two dimensions; tests/mpm_service/test_mpm_stability.py repeats the trials.
        """
        order = self.order if self.transfer == "fmpm" else 1
        if self.integration == "usl":  # nodes with little mass are not smoothed before the stress
            limit = 0.15 if self.interpolation == "linear" else 0.4 if order == 1 else 0.24 if order < 4 else 0.15
        elif self.integration == "usf":
            limit = 0.6 if self.interpolation == "linear" else 0.8
        elif self.interpolation == "linear":
            limit = 0.6 if order == 1 else 0.5 if order < 4 else 0.4
        else:
            limit = 0.8 if order < 3 else 0.6 if order == 3 else 0.5
        if order > 1 and self.period > 1:  # FLIP feeds between the filtered steps what they amplify
            limit = min(limit, 0.35)
        return limit if order < 5 else min(limit, 0.3)
