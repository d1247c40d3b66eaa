"""J2 plasticity of finite strain with isotropic hardening."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from . import elastic_constants as constants
from .material import (
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
)
from .return_mapping import plane_strain_stresses, plane_stress_stresses, space_stresses

# History of a point: C_p^-1 - I, xx, yy, xy, zz in the plane and xx, yy, zz, yz, xz, xy in space, then the
# equivalent plastic strain.
_PLANE_HISTORY = 5
_SPACE_HISTORY = 7


@dataclass(frozen=True)
class J2Plasticity(Material):
    """Elastic-plastic metal-like solid: logarithmic elasticity, von Mises yield, isotropic hardening.

    ``F = F_e F_p``; the elastic energy is ``K/2 (tr e)^2 + mu |dev e|^2`` of the logarithmic strain
    ``e = 1/2 ln(F_e F_e^T)``, which gives the Kirchhoff stress ``tau = K tr(e) I + 2 mu dev(e)``. The material
    yields where the von Mises stress of tau reaches ``Y(a)``, a being the equivalent plastic strain::

        Y(a) = yield_stress + hardening a + saturation (1 - exp(-saturation_rate a))

    The plastic flow is associated and keeps the volume; a strain update follows it by the exponential map, for
    which the return to the yield surface in principal axes is exact (Simo, Comput. Methods Appl. Mech. Eng. 99,
    1992, 61-112). In plane stress the return keeps tau_zz at zero (Simo and Taylor, Int. J. Numer. Methods Eng. 22,
    1986, 649-670), and the thickness stretch follows from the elastic strain and the preserved plastic volume. The
    law is objective at any strain and rotation.

    Parameters
    ----------
    young : float
        Young's modulus at small strain [Pa].
    poisson : float
        Poisson's ratio at small strain, above -1 and below 0.5.
    density : float
        Mass density of the undeformed material [kg/m^3].
    yield_stress : float
        First yield in tension [Pa].
    hardening : float
        Linear part of the hardening, stress per logarithmic plastic strain [Pa]; 0 is perfect plasticity.
    saturation : float
        Stress that Voce's exponential part adds in the end [Pa].
    saturation_rate : float
        Rate of the exponential part, per unit of plastic strain; above 0 where `saturation` is.
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
    yield_stress: float
    hardening: float = 0.0
    saturation: float = 0.0
    saturation_rate: float = 0.0
    assumption: Assumption = "plane_strain"

    def __post_init__(self) -> None:
        constants.require_isotropic(self.young, self.poisson, self.density, self.assumption)
        require_above("yield_stress", self.yield_stress, 0.0, "Pa")
        require_at_least("hardening", self.hardening, 0.0, "Pa")
        require_at_least("saturation", self.saturation, 0.0, "Pa")
        require_at_least("saturation_rate", self.saturation_rate, 0.0, "")
        if self.saturation > 0.0 and self.saturation_rate == 0.0:
            raise ValueError("saturation_rate = 0: must be above 0 where saturation is")

    @cached_property
    def shear_modulus(self) -> float:
        """mu [Pa] (Eq 28)."""
        return constants.shear_modulus(self.young, self.poisson)

    @cached_property
    def bulk_modulus(self) -> float:
        """K [Pa]."""
        return constants.bulk_modulus(self.young, self.poisson)

    @property
    def pressure_wave_speed(self) -> float:
        """Speed of the elastic pressure wave at rest [m/s]; in-plane in plane stress."""
        return float(np.sqrt(constants.wave_modulus(self.young, self.poisson, self.assumption) / self.density))

    @property
    def history_size(self) -> int:
        """Plastic metric less the identity and the equivalent plastic strain (last): 5 in the plane, 7 in space."""
        return _SPACE_HISTORY if self.assumption == "three_dimensional" else _PLANE_HISTORY

    def yield_strength(self, plastic_strain: FloatArray) -> FloatArray:
        """Return the von Mises stress at yield [Pa] for equivalent plastic strains, both (n,)."""
        saturated = -np.expm1(-self.saturation_rate * plastic_strain)
        return self.yield_stress + self.hardening * plastic_strain + self.saturation * saturated

    @cached_property
    def _yield_constants(self) -> tuple[float, float, float, float]:
        return float(self.yield_stress), float(self.hardening), float(self.saturation), float(self.saturation_rate)

    def update_stress(self, rows: FloatArray, ids: IdArray, history: FloatArray) -> None:
        """Return each row to the yield surface, write its Kirchhoff stress; see `Material.update_stress`."""
        if self.assumption == "three_dimensional":
            failed = space_stresses(rows, ids, history, self.bulk_modulus, self.shear_modulus, self._yield_constants)
        elif self.assumption == "plane_strain":
            failed = plane_strain_stresses(
                rows, ids, history, self.bulk_modulus, self.shear_modulus, self._yield_constants
            )
        else:
            failed = plane_stress_stresses(rows, ids, history, self.young, self.poisson, self._yield_constants)
        if failed >= 0:
            raise_no_volume("J2Plasticity", rows, ids, failed)

    def _left_strain(self, rows: FloatArray, ids: IdArray, history: FloatArray) -> FloatArray:
        """b_e - I = F C_p^-1 F^T - I, (n, 3, 3); in plane stress its zz is that of the plastic part alone."""
        dim = 3 if self.assumption == "three_dimensional" else 2
        h = displacement_gradient(rows, dim)
        plastic = history[ids]
        if dim == 2:
            h = embedded_gradient(h, np.zeros(h.shape[0]))
            columns = [[0, 2, -1], [2, 1, -1], [-1, -1, 3]]
        else:
            columns = [[0, 5, 4], [5, 1, 3], [4, 3, 2]]
        # The equivalent plastic strain stands last; column -1 means an entry that is zero.
        plastic[:, -1] = 0.0
        metric = plastic[:, np.array(columns)]
        forward = np.eye(3) + h
        turned = h.transpose(0, 2, 1)
        return forward @ metric @ forward.transpose(0, 2, 1) + h + turned + h @ turned

    def _elastic_strains(self, rows: FloatArray, ids: IdArray, history: FloatArray) -> FloatArray:
        """Principal logarithmic elastic strains, (n, 3); the last is zz under the plane assumptions."""
        left = self._left_strain(rows, ids, history)
        if self.assumption == "three_dimensional":
            return 0.5 * np.log1p(np.linalg.eigvalsh(left))
        in_plane = 0.5 * np.log1p(np.linalg.eigvalsh(left[:, :2, :2]))
        if self.assumption == "plane_strain":
            across = 0.5 * np.log1p(left[:, 2, 2])
        else:
            across = -self.poisson / (1.0 - self.poisson) * in_plane.sum(axis=1)
        return np.column_stack([in_plane, across])

    def strain_energy(self, rows: FloatArray, ids: IdArray, history: FloatArray) -> FloatArray:
        """Elastic energy of each point [J], (n,)."""
        strain = self._elastic_strains(rows, ids, history)
        trace = strain.sum(axis=1)
        deviator = strain - trace[:, None] / 3.0
        density = 0.5 * self.bulk_modulus * trace**2 + self.shear_modulus * np.sum(deviator**2, axis=1)
        return reference_volume(rows, 3 if self.assumption == "three_dimensional" else 2) * density

    def dissipated(self, rows: FloatArray, ids: IdArray, history: FloatArray) -> FloatArray:
        """Plastic work of each point [J], (n,): the integral of the yield strength over the plastic strain.

        All of it counts as lost, the part that hardening stores in the material too.
        """
        strain = history[ids, -1]
        work = self.yield_stress * strain + 0.5 * self.hardening * strain**2
        if self.saturation > 0.0:
            reached = -np.expm1(-self.saturation_rate * strain) / self.saturation_rate
            work = work + self.saturation * (strain - reached)
        return reference_volume(rows, 3 if self.assumption == "three_dimensional" else 2) * work

    def thickness_stretch(self, rows: FloatArray, ids: IdArray, history: FloatArray) -> FloatArray:
        """Current over reference thickness, (n,): elastic stretch times plastic stretch."""
        if self.assumption != "plane_stress":
            return np.ones(rows.shape[0])
        elastic = self._elastic_strains(rows, ids, history)[:, 2]
        return np.exp(elastic) / np.sqrt(1.0 + history[ids, 3])

    def stress_zz(self, rows: FloatArray, ids: IdArray, history: FloatArray) -> FloatArray:
        """Cauchy stress across the thickness [Pa], (n,)."""
        if self.assumption != "plane_strain":
            return super().stress_zz(rows, ids, history)
        strain = self._elastic_strains(rows, ids, history)
        trace = strain.sum(axis=1)
        tau = self.bulk_modulus * trace + 2.0 * self.shear_modulus * (strain[:, 2] - trace / 3.0)
        return tau / (1.0 + volume_change(displacement_gradient(rows, 2)))
