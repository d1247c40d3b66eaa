"""Isotropic linear elastic law in two dimensions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray


class Law(NamedTuple):
    """Constants the kernels read: stress = C strain [Pa], thickness strain = -contraction * trace."""

    c11: float
    c12: float
    c33: float
    contraction: float
    inverse_density: float


@dataclass(frozen=True)
class IsotropicElastic:
    """Small-strain isotropic elasticity with the strain taken from the deformation gradient.

    Strain is ``(F + F^T)/2 - I`` (Eq 25), stress ``lambda tr(strain) I + 2 mu strain`` (Eqs 26-28). Plane
    stress uses its own constant ``lambda* = E nu / (1 - nu^2)``; Eq 27 holds for plane strain only.
    The law is not objective: a rigid rotation by an angle ``a`` gives a false strain of ``-a^2/2``.

    Parameters
    ----------
    young : float
        Young's modulus [Pa].
    poisson : float
        Poisson's ratio, above -1 and below 0.5.
    density : float
        Mass density [kg/m^3].
    assumption : {"plane_stress", "plane_strain"}
        What happens across the thickness.

    Raises
    ------
    ValueError
        If a constant is outside its range.
    """

    young: float
    poisson: float
    density: float
    assumption: Literal["plane_stress", "plane_strain"] = "plane_strain"

    def __post_init__(self) -> None:
        if not (np.isfinite(self.young) and self.young > 0.0):
            raise ValueError(f"young = {self.young!r}: a positive modulus [Pa] is needed")
        if not (-1.0 < self.poisson < 0.5):
            raise ValueError(f"poisson = {self.poisson!r}: must be above -1 and below 0.5")
        if not (np.isfinite(self.density) and self.density > 0.0):
            raise ValueError(f"density = {self.density!r}: a positive density [kg/m^3] is needed")
        if self.assumption not in ("plane_stress", "plane_strain"):
            raise ValueError(f"assumption = {self.assumption!r}: allowed are 'plane_stress' and 'plane_strain'")

    @property
    def shear_modulus(self) -> float:
        """mu [Pa] (Eq 28)."""
        return self.young / (2.0 * (1.0 + self.poisson))

    @property
    def lame(self) -> float:
        """lambda of the in-plane law [Pa]: Eq 27 in plane strain, ``E nu/(1 - nu^2)`` in plane stress."""
        if self.assumption == "plane_stress":
            return self.young * self.poisson / (1.0 - self.poisson**2)
        return self.young * self.poisson / ((1.0 + self.poisson) * (1.0 - 2.0 * self.poisson))

    @property
    def wave_modulus(self) -> float:
        """Modulus of the in-plane pressure wave, lambda + 2 mu [Pa]."""
        return self.lame + 2.0 * self.shear_modulus

    @property
    def pressure_wave_speed(self) -> float:
        """Speed of the in-plane pressure wave [m/s]."""
        return float(np.sqrt(self.wave_modulus / self.density))

    def stress(self, strain: NDArray[np.float64]) -> NDArray[np.float64]:
        """In-plane stress of in-plane strain.

        Parameters
        ----------
        strain : (n, 3) ndarray
            xx, yy and tensor xy (half the engineering shear).

        Returns
        -------
        (n, 3) ndarray
            xx, yy, xy [Pa].
        """
        trace = self.lame * (strain[:, 0] + strain[:, 1])
        return np.ascontiguousarray(
            np.stack([trace, trace, np.zeros_like(trace)], axis=1) + 2.0 * self.shear_modulus * strain
        )

    def stress_zz(self, strain: NDArray[np.float64]) -> NDArray[np.float64]:
        """Stress across the thickness [Pa], (n,): zero in plane stress."""
        if self.assumption == "plane_stress":
            return np.zeros(strain.shape[0])
        return self.lame * (strain[:, 0] + strain[:, 1])

    def law(self) -> Law:
        """Kernel form of the law."""
        thins = self.assumption == "plane_stress"
        return Law(
            self.wave_modulus,
            self.lame,
            2.0 * self.shear_modulus,
            self.poisson / (1.0 - self.poisson) if thins else 0.0,
            1.0 / self.density,
        )
