"""Fields around a crack tip by linear elastic fracture mechanics, isotropic: what a sample is loaded with.

The crack comes from -x and ends at the origin. Modes I and II (opening, sliding); the terms of order sqrt(r) only.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Plane = Literal["stress", "strain"]


@dataclass(frozen=True)
class KField:
    """The singular field of a crack in an isotropic plate (Williams' first term).

    Attributes
    ----------
    k1, k2 : float
        Stress intensity factors of modes I and II, Pa m^0.5.
    young : float
        Young's modulus, Pa.
    poisson : float
    plane : {"stress", "strain"}
        Plane stress is right for a sheet.

    Raises
    ------
    ValueError
        If a number is not finite, `young` not positive, `poisson` not between -1 and 0.5 or `plane` unknown.
    """

    k1: float
    young: float
    poisson: float
    k2: float = 0.0
    plane: Plane = "stress"

    def __post_init__(self) -> None:
        if self.plane not in ("stress", "strain"):
            raise ValueError(f"plane is {self.plane!r}; known are 'stress' and 'strain'")
        if not (np.isfinite(self.k1) and np.isfinite(self.k2)):
            raise ValueError(f"k1 is {self.k1} and k2 {self.k2} Pa m^0.5; both must be finite")
        if not (np.isfinite(self.young) and self.young > 0.0):
            raise ValueError(f"young is {self.young} Pa; it must be positive and finite")
        # In plane stress a Poisson's ratio above 0.5 is sound: it is a two-dimensional constant, below 1.
        highest = 1.0 if self.plane == "stress" else 0.5
        if not -1.0 < self.poisson < highest:
            raise ValueError(f"poisson is {self.poisson}; in plane {self.plane} it must lie between -1 and {highest}")

    @classmethod
    def of_energy_release_rate(cls, rate: float, young: float, poisson: float, plane: Plane = "stress") -> KField:
        """The mode I field of an energy release rate, J/m^2 (Eqs 65, 73).

        Raises
        ------
        ValueError
            If `rate` is negative or another argument is bad.
        """
        if not rate >= 0.0:
            raise ValueError(f"rate is {rate} J/m^2; it must not be negative")
        unit = cls(0.0, young, poisson, plane=plane)
        return cls(float(np.sqrt(rate * unit.plane_modulus)), young, poisson, plane=plane)

    @property
    def plane_modulus(self) -> float:
        """E' in Pa: E in plane stress, E/(1 - nu^2) in plane strain."""
        return self.young if self.plane == "stress" else self.young / (1.0 - self.poisson**2)

    @property
    def shear(self) -> float:
        """Shear modulus, Pa."""
        return self.young / (2.0 * (1.0 + self.poisson))

    @property
    def kolosov(self) -> float:
        """Kolosov's constant: (3 - nu)/(1 + nu) in plane stress, 3 - 4 nu in plane strain."""
        nu = self.poisson
        return (3.0 - nu) / (1.0 + nu) if self.plane == "stress" else 3.0 - 4.0 * nu

    @property
    def energy_release_rate(self) -> float:
        """J of both modes, J/m^2 (Eqs 65, 73, 74)."""
        return (self.k1**2 + self.k2**2) / self.plane_modulus

    def displacement(self, position: NDArray[np.float64]) -> NDArray[np.float64]:
        """Displacement.

        Parameters
        ----------
        position : ndarray, shape (n, 2) or (n, 3)
            Places relative to the tip, m. Those with y = 0 and x < 0 count to the upper face.

        Returns
        -------
        ndarray, shape as `position`
            m; zero along z.
        """
        r, theta = _polar(position)
        half = 0.5 * theta
        c, s, cos, kappa = np.cos(half), np.sin(half), np.cos(theta), self.kolosov
        scale = np.sqrt(r / (2.0 * np.pi)) / (2.0 * self.shear)
        u = np.zeros_like(position, dtype=np.float64)
        u[:, 0] = scale * (self.k1 * c * (kappa - cos) + self.k2 * s * (kappa + 2.0 + cos))
        u[:, 1] = scale * (self.k1 * s * (kappa - cos) - self.k2 * c * (kappa - 2.0 + cos))
        return u

    def stress(self, position: NDArray[np.float64]) -> NDArray[np.float64]:
        """Stress in the plane.

        Parameters
        ----------
        position : ndarray, shape (n, 2) or (n, 3)
            Places relative to the tip, m, none of them at the tip.

        Returns
        -------
        ndarray, shape (n, 3)
            xx, yy and xy, Pa.
        """
        r, theta = _polar(position)
        c, s = np.cos(0.5 * theta), np.sin(0.5 * theta)
        c3, s3 = np.cos(1.5 * theta), np.sin(1.5 * theta)
        one, two = (k / np.sqrt(2.0 * np.pi * r) for k in (self.k1, self.k2))
        return np.column_stack(
            [
                one * c * (1.0 - s * s3) - two * s * (2.0 + c * c3),
                one * c * (1.0 + s * s3) + two * s * c * c3,
                one * s * c * c3 + two * c * (1.0 - s * s3),
            ]
        )

    def energy_density(self, position: NDArray[np.float64]) -> NDArray[np.float64]:
        """Elastic energy over volume, J/m^3, shape (n,), at places as for `stress`."""
        xx, yy, xy = self.stress(position).T
        # Of sigma : epsilon / 2 with the strains of the plane.
        mean, deviation = 0.5 * (xx + yy), 0.5 * (xx - yy)
        return (0.25 * (self.kolosov - 1.0) * mean**2 + 0.5 * (deviation**2 + xy**2)) / self.shear


def _polar(position: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    x, y = position[:, 0], np.abs(position[:, 1]) * np.where(position[:, 1] < 0.0, -1.0, 1.0)
    return np.hypot(x, y), np.arctan2(y + 0.0, x)
