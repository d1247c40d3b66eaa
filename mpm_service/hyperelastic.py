"""Compressible neo-Hookean law."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit

from . import elastic_constants as constants
from .material import (
    GRADIENT_2D,
    GRADIENT_3D,
    STRESS_2D,
    STRESS_3D,
    Assumption,
    FloatArray,
    IdArray,
    Material,
    displacement_gradient,
    embedded_gradient,
    raise_no_volume,
    reference_volume,
    require_above,
    require_at_least,
    volume_change,
    volume_change_beyond_trace,
)


@njit(cache=True, nogil=True)
def _plane_stresses(rows: FloatArray, lame: float, shear: float, thins: bool) -> int:
    """Stress of every row; returns the first row without positive volume, -1 if there is none."""
    for row in range(rows.shape[0]):
        hxx = rows[row, GRADIENT_2D]
        hxy = rows[row, GRADIENT_2D + 1]
        hyx = rows[row, GRADIENT_2D + 2]
        hyy = rows[row, GRADIENT_2D + 3]
        change = hxx + hyy + (hxx * hyy - hxy * hyx)
        if not change > -1.0:
            return row
        squared = change * (2.0 + change)  # J^2 - 1 of the plane
        spherical = 0.5 * lame * squared
        if thins:
            # No stress across fixes F_zz^2; what it leaves of the pressure is -mu (F_zz^2 - 1).
            spherical *= 2.0 * shear / (2.0 * shear + lame * (1.0 + squared))
        rows[row, STRESS_2D] = spherical + shear * (2.0 * hxx + hxx * hxx + hxy * hxy)
        rows[row, STRESS_2D + 1] = spherical + shear * (2.0 * hyy + hyx * hyx + hyy * hyy)
        rows[row, STRESS_2D + 2] = shear * (hxy + hyx + hxx * hyx + hxy * hyy)
    return -1


@njit(cache=True, nogil=True)
def _space_stresses(rows: FloatArray, lame: float, shear: float) -> int:
    """Stress of every row; returns the first row without positive volume, -1 if there is none."""
    for row in range(rows.shape[0]):
        h = rows[row, GRADIENT_3D : GRADIENT_3D + 9]
        minors = h[0] * h[4] - h[1] * h[3] + h[0] * h[8] - h[2] * h[6] + h[4] * h[8] - h[5] * h[7]
        third = (
            h[0] * (h[4] * h[8] - h[5] * h[7]) - h[1] * (h[3] * h[8] - h[5] * h[6]) + h[2] * (h[3] * h[7] - h[4] * h[6])
        )
        change = h[0] + h[4] + h[8] + minors + third
        if not change > -1.0:
            return row
        spherical = 0.5 * lame * change * (2.0 + change)
        tau = rows[row, STRESS_3D : STRESS_3D + 6]
        tau[0] = spherical + shear * (2.0 * h[0] + h[0] * h[0] + h[1] * h[1] + h[2] * h[2])
        tau[1] = spherical + shear * (2.0 * h[4] + h[3] * h[3] + h[4] * h[4] + h[5] * h[5])
        tau[2] = spherical + shear * (2.0 * h[8] + h[6] * h[6] + h[7] * h[7] + h[8] * h[8])
        tau[3] = shear * (h[5] + h[7] + h[3] * h[6] + h[4] * h[7] + h[5] * h[8])
        tau[4] = shear * (h[2] + h[6] + h[0] * h[6] + h[1] * h[7] + h[2] * h[8])
        tau[5] = shear * (h[1] + h[3] + h[0] * h[3] + h[1] * h[4] + h[2] * h[5])
    return -1


def _less_logarithm(x: FloatArray) -> FloatArray:
    """x - log(1 + x), (n,), without losing small x."""
    series = np.zeros_like(x)
    for power in range(10, 1, -1):
        series = x * series + (-1.0) ** power / power
    return np.where(np.abs(x) < 0.01, x * x * series, x - np.log1p(x))


@dataclass(frozen=True)
class NeoHookean(Material):
    """Compressible neo-Hookean solid, for large strains and rotations.

    Energy per reference volume ``W = mu/2 (tr b - 3 - 2 ln J) + lambda/4 (J^2 - 1 - 2 ln J)`` with ``b = F F^T``
    (Ciarlet's form: polyconvex, infinite as J goes to zero), hence ``tau = mu (b - I) + lambda/2 (J^2 - 1) I``.
    For small strains it is `IsotropicElastic` with the same constants. In plane stress the thickness stretch
    follows in closed form: ``F_zz^2 = (2 mu + lambda)/(2 mu + lambda J_plane^2)``.

    Parameters
    ----------
    young : float
        Young's modulus at small strain [Pa].
    poisson : float
        Poisson's ratio at small strain, at least 0 (the energy has no lower bound below) and below 0.5.
    density : float
        Mass density of the undeformed material [kg/m^3].
    assumption : {"plane_stress", "plane_strain", "three_dimensional"}
        What happens across the thickness.

    Raises
    ------
    ValueError
        If a constant is outside its range.
    """

    young: float
    poisson: float
    density: float
    assumption: Assumption = "plane_strain"

    def __post_init__(self) -> None:
        constants.require_isotropic(self.young, self.poisson, self.density, self.assumption)
        require_at_least("poisson", self.poisson, 0.0, "")

    @classmethod
    def from_moduli(
        cls, shear_modulus: float, bulk_modulus: float, density: float, assumption: Assumption = "plane_strain"
    ) -> NeoHookean:
        """Make the law from the small-strain shear and bulk moduli [Pa].

        Raises
        ------
        ValueError
            If a modulus is not positive or ``bulk_modulus`` is below two thirds of ``shear_modulus``.
        """
        require_above("shear_modulus", shear_modulus, 0.0, "Pa")
        require_at_least("bulk_modulus", bulk_modulus, 2.0 * shear_modulus / 3.0, "Pa (two thirds of shear_modulus)")
        poisson = 0.5 * (3.0 * bulk_modulus - 2.0 * shear_modulus) / (3.0 * bulk_modulus + shear_modulus)
        return cls(2.0 * shear_modulus * (1.0 + poisson), poisson, density, assumption)

    @cached_property
    def shear_modulus(self) -> float:
        """mu [Pa] (Eq 28)."""
        return constants.shear_modulus(self.young, self.poisson)

    @cached_property
    def lame(self) -> float:
        """lambda of the energy [Pa] (Eq 27), the same under every assumption."""
        return constants.lame_modulus(self.young, self.poisson)

    @property
    def pressure_wave_speed(self) -> float:
        """Speed of the pressure wave at rest [m/s]; in-plane in plane stress."""
        return float(np.sqrt(constants.wave_modulus(self.young, self.poisson, self.assumption) / self.density))

    def update_stress(self, rows: FloatArray, ids: IdArray, history: FloatArray) -> None:
        """Write the Kirchhoff stress of each row; see `Material.update_stress`."""
        if self.assumption == "three_dimensional":
            failed = _space_stresses(rows, self.lame, self.shear_modulus)
        else:
            failed = _plane_stresses(rows, self.lame, self.shear_modulus, self.assumption == "plane_stress")
        if failed >= 0:
            raise_no_volume("NeoHookean", rows, ids, failed)

    def tangent(self, rows: FloatArray, ids: IdArray, history: FloatArray) -> FloatArray:
        """Return the law's moduli; see `Material.tangent`.

        With ``tau = mu (b - I) + p I`` and p a function of ``J^2 - 1`` they are ``2 J^2 p' I I + 2 (mu - p)`` times
        the symmetric unit tensor.
        """
        dim = 3 if self.assumption == "three_dimensional" else 2
        change = volume_change(displacement_gradient(rows, dim))
        squared = change * (2.0 + change)
        slope = np.full(rows.shape[0], 0.5 * self.lame)
        pressure = 0.5 * self.lame * squared
        if self.assumption == "plane_stress":
            thins = 2.0 * self.shear_modulus / (2.0 * self.shear_modulus + self.lame * (1.0 + squared))
            pressure *= thins
            slope *= thins * thins * (1.0 + self.lame / (2.0 * self.shear_modulus))
        size = 3 if dim == 2 else 6
        moduli = np.zeros((rows.shape[0], size, size))
        moduli[:, :dim, :dim] = (2.0 * (1.0 + squared) * slope)[:, None, None]
        diagonal = np.array([2.0] * dim + [1.0] * (size - dim))
        moduli += (self.shear_modulus - pressure)[:, None, None] * np.diag(diagonal)
        return moduli

    def _thickness_strain(self, rows: FloatArray) -> FloatArray:
        """F_zz - 1 of plane laws, (n,)."""
        if self.assumption != "plane_stress":
            return np.zeros(rows.shape[0])
        change = volume_change(displacement_gradient(rows, 2))
        squared = change * (2.0 + change)
        excess = -self.lame * squared / (2.0 * self.shear_modulus + self.lame * (1.0 + squared))  # F_zz^2 - 1
        return excess / (1.0 + np.sqrt(1.0 + excess))

    def _gradient(self, rows: FloatArray) -> FloatArray:
        """F - I in space, (n, 3, 3)."""
        if self.assumption == "three_dimensional":
            return displacement_gradient(rows, 3)
        return embedded_gradient(displacement_gradient(rows, 2), self._thickness_strain(rows))

    def strain_energy(self, rows: FloatArray, ids: IdArray, history: FloatArray) -> FloatArray:
        """Energy of each point [J], (n,)."""
        gradient = self._gradient(rows)
        change = volume_change(gradient)
        squared = change * (2.0 + change)
        # tr b - 3 - (J^2 - 1) in terms of second order alone, so that the energy of small strains is exact.
        distortion = np.sum(gradient**2, axis=(1, 2)) - 2.0 * volume_change_beyond_trace(gradient) - change**2
        density = 0.5 * self.shear_modulus * distortion
        density += (0.5 * self.shear_modulus + 0.25 * self.lame) * _less_logarithm(squared)
        return reference_volume(rows, 3 if self.assumption == "three_dimensional" else 2) * density

    def thickness_stretch(self, rows: FloatArray, ids: IdArray, history: FloatArray) -> FloatArray:
        """Current over reference thickness, (n,)."""
        return 1.0 + self._thickness_strain(rows)

    def stress_zz(self, rows: FloatArray, ids: IdArray, history: FloatArray) -> FloatArray:
        """Cauchy stress across the thickness [Pa], (n,)."""
        if self.assumption != "plane_strain":
            return super().stress_zz(rows, ids, history)
        change = volume_change(displacement_gradient(rows, 2))
        return 0.5 * self.lame * change * (2.0 + change) / (1.0 + change)
