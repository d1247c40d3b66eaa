"""Weight of the continuum across the overlap: one at the outer border, small at the inner one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from protocol.arrays import FloatArray

Kind = Literal["constant", "linear", "cubic", "power"]


@dataclass(frozen=True)
class WeightProfile:
    """A profile W(s) over the share s = d_inner / (d_inner + d_outer), 0 at the inner border, 1 at the outer one.

    With weight w at the inner border, W = w (`constant`) or W = w + (1 - w) p(s) with p = s (`linear`),
    3 s^2 - 2 s^3 (`cubic`), s^exponent (`power`).

    Attributes
    ----------
    kind : {"constant", "linear", "cubic", "power"}
    weight : float
        w, above 0 and at most 1.
    exponent : float
        Of `power`, at least 1.
    stiffness : float or None
        Factor on the continuum's stiffness, the same all over the overlap; None: W, as for its mass.
    """

    kind: Kind
    weight: float
    exponent: float = 1.0
    stiffness: float | None = None

    def __post_init__(self) -> None:
        if not 0.0 < self.weight <= 1.0:
            raise ValueError(f"weight is {self.weight}; it must be above 0 and at most 1")
        if not self.exponent >= 1.0:
            raise ValueError(f"exponent is {self.exponent}; it must be at least 1")
        if self.stiffness is not None and not 0.0 < self.stiffness <= 1.0:
            raise ValueError(f"stiffness is {self.stiffness}; it must be above 0 and at most 1")

    def at(self, share: FloatArray) -> FloatArray:
        """Return W at shares s in [0, 1], any shape."""
        s = np.clip(np.asarray(share, dtype=np.float64), 0.0, 1.0)
        if self.kind == "constant":
            return np.full_like(s, self.weight)
        rise = {"linear": lambda: s, "cubic": lambda: s * s * (3.0 - 2.0 * s), "power": lambda: s**self.exponent}
        return np.asarray(self.weight + (1.0 - self.weight) * rise[self.kind]())

    def stiffness_at(self, share: FloatArray) -> FloatArray:
        """Return the factor on the continuum's stiffness at shares s in [0, 1], any shape."""
        return (
            self.at(share) if self.stiffness is None else np.full_like(np.asarray(share, dtype=float), self.stiffness)
        )

    @property
    def at_border(self) -> float:
        """W at the outer border."""
        return self.weight if self.kind == "constant" else 1.0

    @property
    def mean(self) -> float:
        """Mean of W over s: what the overlap weighs in excess, over the mass of continuum of full weight."""
        rise = {"constant": 0.0, "linear": 0.5, "cubic": 0.5, "power": 1.0 / (self.exponent + 1.0)}[self.kind]
        return self.weight + (1.0 - self.weight) * rise
