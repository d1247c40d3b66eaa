"""Linear elastic laws of small strain: isotropic and orthotropic."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray

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
    raise_no_volume,
    reference_volume,
    require_above,
    require_assumption,
)

_IN_PLANE = [0, 1, 5]  # xx, yy, xy among xx, yy, zz, yz, xz, xy


@njit(cache=True, nogil=True)
def _plane_stresses(rows: FloatArray, stiffness: FloatArray, thickness: FloatArray) -> int:
    """Stress of every row; returns the first row without positive volume, -1 if there is none."""
    c00, c01, c02 = stiffness[0, 0], stiffness[0, 1], stiffness[0, 2]
    c11, c12, c22 = stiffness[1, 1], stiffness[1, 2], stiffness[2, 2]
    t0, t1, t2 = thickness[0], thickness[1], thickness[2]
    for row in range(rows.shape[0]):
        hxx = rows[row, GRADIENT_2D]
        hxy = rows[row, GRADIENT_2D + 1]
        hyx = rows[row, GRADIENT_2D + 2]
        hyy = rows[row, GRADIENT_2D + 3]
        shear = hxy + hyx
        ratio = ((1.0 + hxx) * (1.0 + hyy) - hxy * hyx) * (1.0 + t0 * hxx + t1 * hyy + t2 * shear)
        if not ratio > 0.0:
            return row
        rows[row, STRESS_2D] = ratio * (c00 * hxx + c01 * hyy + c02 * shear)
        rows[row, STRESS_2D + 1] = ratio * (c01 * hxx + c11 * hyy + c12 * shear)
        rows[row, STRESS_2D + 2] = ratio * (c02 * hxx + c12 * hyy + c22 * shear)
    return -1


@njit(cache=True, nogil=True)
def _space_stresses(rows: FloatArray, stiffness: FloatArray) -> int:
    """Stress of every row; returns the first row without positive volume, -1 if there is none."""
    strain = np.empty(6)
    for row in range(rows.shape[0]):
        h = rows[row, GRADIENT_3D : GRADIENT_3D + 9]
        ratio = (
            (1.0 + h[0]) * ((1.0 + h[4]) * (1.0 + h[8]) - h[5] * h[7])
            - h[1] * (h[3] * (1.0 + h[8]) - h[5] * h[6])
            + h[2] * (h[3] * h[7] - (1.0 + h[4]) * h[6])
        )
        if not ratio > 0.0:
            return row
        strain[0], strain[1], strain[2] = h[0], h[4], h[8]
        strain[3], strain[4], strain[5] = h[5] + h[7], h[2] + h[6], h[1] + h[3]
        for i in range(6):
            total = 0.0
            for j in range(6):
                total += stiffness[i, j] * strain[j]
            rows[row, STRESS_3D + i] = ratio * total
    return -1


class LinearElastic(Material):
    """What linear elastic laws share: stress is a constant matrix times the small strain (Eq 25).

    The Kirchhoff stress is J times the stress of the linear law. Its strain energy is half of stress times strain,
    so energy is kept to the order of the strain cubed.
    """

    @cached_property
    @abstractmethod
    def stiffness(self) -> FloatArray:
        """Stress of engineering strain [Pa]: (3, 3) xx, yy, xy in the plane; (6, 6) xx, yy, zz, yz, xz, xy."""

    @cached_property
    @abstractmethod
    def thickness_row(self) -> FloatArray:
        """(3,): thickness strain of in-plane strain in plane stress, zz stress [Pa] of it in plane strain."""

    @cached_property
    def _thinning(self) -> FloatArray:
        return self.thickness_row if self.assumption == "plane_stress" else np.zeros(3)

    def update_stress(self, rows: FloatArray, ids: IdArray, history: FloatArray) -> None:
        """Write the Kirchhoff stress of each row (Eqs 25-26); see `Material.update_stress`."""
        if self.assumption == "three_dimensional":
            failed = _space_stresses(rows, self.stiffness)
        else:
            failed = _plane_stresses(rows, self.stiffness, self._thinning)
        if failed >= 0:
            raise_no_volume(type(self).__name__, rows, ids, failed)

    def tangent(self, rows: FloatArray, ids: IdArray, history: FloatArray) -> FloatArray:
        """Return the stiffness, right to the first order of strain; see `Material.tangent`."""
        return np.broadcast_to(self.stiffness, (rows.shape[0], *self.stiffness.shape))

    def _strain(self, rows: FloatArray) -> FloatArray:
        """Engineering strain in the order of `stiffness`."""
        dim = 3 if self.assumption == "three_dimensional" else 2
        h = displacement_gradient(rows, dim)
        pairs = [(0, 0), (1, 1), (0, 1)] if dim == 2 else [(0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1)]
        return np.stack([h[:, i, i] if i == j else h[:, i, j] + h[:, j, i] for i, j in pairs], axis=1)

    def strain_energy(self, rows: FloatArray, ids: IdArray, history: FloatArray) -> FloatArray:
        """Half of stress times strain times reference volume [J], (n,)."""
        strain = self._strain(rows)
        volume = reference_volume(rows, 3 if self.assumption == "three_dimensional" else 2)
        return 0.5 * volume * np.einsum("ni,ni->n", strain @ self.stiffness, strain)

    def thickness_stretch(self, rows: FloatArray, ids: IdArray, history: FloatArray) -> FloatArray:
        """Current over reference thickness, (n,)."""
        if self.assumption != "plane_stress":
            return np.ones(rows.shape[0])
        return 1.0 + self._strain(rows) @ self.thickness_row

    def stress_zz(self, rows: FloatArray, ids: IdArray, history: FloatArray) -> FloatArray:
        """Cauchy stress across the thickness [Pa], (n,)."""
        if self.assumption != "plane_strain":
            return super().stress_zz(rows, ids, history)
        return self._strain(rows) @ self.thickness_row


@dataclass(frozen=True)
class IsotropicElastic(LinearElastic):
    """Small-strain isotropic elasticity with the strain taken from the deformation gradient.

    Strain is ``(F + F^T)/2 - I`` (Eq 25), stress ``lambda tr(strain) I + 2 mu strain`` (Eqs 26-28). Plane
    stress uses its own constant ``lambda* = E nu / (1 - nu^2)``; Eq 27 holds for plane strain and space only.
    The law is not objective: a rigid rotation by an angle ``a`` gives a false strain of ``-a^2/2``. Where points
    rotate by more than a few degrees use `NeoHookean` or `J2Plasticity`.

    Parameters
    ----------
    young : float
        Young's modulus [Pa].
    poisson : float
        Poisson's ratio, above -1 and below 0.5.
    density : float
        Mass density [kg/m^3].
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

    @property
    def shear_modulus(self) -> float:
        """mu [Pa] (Eq 28)."""
        return constants.shear_modulus(self.young, self.poisson)

    @property
    def lame(self) -> float:
        """lambda of the law [Pa]: Eq 27, but ``E nu/(1 - nu^2)`` in plane stress."""
        return constants.lame_modulus(self.young, self.poisson, self.assumption)

    @property
    def wave_modulus(self) -> float:
        """Modulus of the pressure wave, lambda + 2 mu [Pa]; in-plane in plane stress."""
        return constants.wave_modulus(self.young, self.poisson, self.assumption)

    @property
    def pressure_wave_speed(self) -> float:
        """Speed of the pressure wave [m/s]; in-plane in plane stress."""
        return float(np.sqrt(self.wave_modulus / self.density))

    @cached_property
    def stiffness(self) -> FloatArray:
        """Stress of engineering strain [Pa], (3, 3) or (6, 6)."""
        normal = 2 if self.assumption != "three_dimensional" else 3
        matrix = self.shear_modulus * np.diag([2.0] * normal + [1.0] * (2 * normal - 3))
        matrix[:normal, :normal] += self.lame
        return matrix

    @cached_property
    def thickness_row(self) -> FloatArray:
        """(3,): thickness strain of in-plane strain in plane stress, zz stress [Pa] of it in plane strain."""
        if self.assumption == "plane_stress":
            return np.array([1.0, 1.0, 0.0]) * (-self.poisson / (1.0 - self.poisson))
        return np.array([1.0, 1.0, 0.0]) * self.lame


@dataclass(frozen=True)
class OrthotropicElastic(LinearElastic):
    """Small-strain orthotropic elasticity, its axes 1 and 2 turned in the xy plane, axis 3 along z.

    ``poisson_ij`` is minus the strain along j over the strain along i under stress along i alone, so the compliance
    holds ``-poisson_ij/young_i``. Strain is ``(F + F^T)/2 - I`` (Eq 25): the law is not objective and its axes do
    not turn with the material. Where points rotate by more than a few degrees use `NeoHookean` or `J2Plasticity`.

    Parameters
    ----------
    young_1, young_2, young_3 : float
        Young's moduli along the axes [Pa].
    poisson_12, poisson_13, poisson_23 : float
        Poisson's ratios; the compliance must be positive definite.
    shear_12, shear_13, shear_23 : float
        Shear moduli [Pa].
    density : float
        Mass density [kg/m^3].
    angle : float
        From x to axis 1, counter-clockwise [rad].
    assumption : {"plane_stress", "plane_strain", "three_dimensional"}
        What happens across the thickness.

    Raises
    ------
    ValueError
        If a constant is outside its range, or the constants together give a negative energy.
    """

    young_1: float
    young_2: float
    young_3: float
    poisson_12: float
    poisson_13: float
    poisson_23: float
    shear_12: float
    shear_13: float
    shear_23: float
    density: float
    angle: float = 0.0
    assumption: Assumption = "plane_strain"

    def __post_init__(self) -> None:
        for name in ("young_1", "young_2", "young_3", "shear_12", "shear_13", "shear_23"):
            require_above(name, getattr(self, name), 0.0, "Pa")
        require_above("density", self.density, 0.0, "kg/m^3")
        if not np.isfinite(self.angle):
            raise ValueError(f"angle = {self.angle!r}: a finite angle [rad] is needed")
        require_assumption(self.assumption)
        for first, second in ("12", "13", "23"):
            name = f"poisson_{first}{second}"
            value = getattr(self, name)
            bound = float(np.sqrt(getattr(self, f"young_{first}") / getattr(self, f"young_{second}")))
            if not abs(value) < bound:
                raise ValueError(
                    f"{name} = {value!r}: its magnitude must be below sqrt(young_{first}/young_{second}) = {bound:.6g}"
                )
        if not np.linalg.eigvalsh(self._scaled_compliance())[0] > 0.0:
            raise ValueError(
                f"poisson_12 = {self.poisson_12!r}, poisson_13 = {self.poisson_13!r}, poisson_23 = "
                f"{self.poisson_23!r}: together they make the compliance not positive definite; lower one of them"
            )

    def _scaled_compliance(self) -> FloatArray:
        """Normal part of the compliance with ones on its diagonal, (3, 3)."""
        young = np.array([self.young_1, self.young_2, self.young_3])
        matrix = np.eye(3)
        for i, j, poisson in ((0, 1, self.poisson_12), (0, 2, self.poisson_13), (1, 2, self.poisson_23)):
            matrix[i, j] = matrix[j, i] = -poisson * np.sqrt(young[j] / young[i])
        return matrix

    @cached_property
    def full_stiffness(self) -> FloatArray:
        """Stress of engineering strain in x, y, z [Pa], (6, 6) xx, yy, zz, yz, xz, xy, whatever the assumption."""
        scale = np.sqrt([self.young_1, self.young_2, self.young_3])
        along_axes = np.zeros((6, 6))
        along_axes[:3, :3] = np.linalg.inv(self._scaled_compliance()) * np.outer(scale, scale)
        along_axes[[3, 4, 5], [3, 4, 5]] = self.shear_23, self.shear_13, self.shear_12
        c, s = np.cos(self.angle), np.sin(self.angle)
        # Strain along the axes of strain in x, y, z; its transpose carries the stress back.
        turn = np.zeros((6, 6))
        turn[0, [0, 1, 5]] = c * c, s * s, c * s
        turn[1, [0, 1, 5]] = s * s, c * c, -c * s
        turn[2, 2] = 1.0
        turn[3, [3, 4]] = c, -s
        turn[4, [3, 4]] = s, c
        turn[5, [0, 1, 5]] = -2.0 * c * s, 2.0 * c * s, c * c - s * s
        turned = turn.T @ along_axes @ turn
        return np.ascontiguousarray(0.5 * (turned + turned.T))

    @cached_property
    def stiffness(self) -> FloatArray:
        """Stress of engineering strain [Pa], (3, 3) or (6, 6); the reduced one in plane stress."""
        full = self.full_stiffness
        if self.assumption == "three_dimensional":
            return full
        in_plane = np.ascontiguousarray(full[np.ix_(_IN_PLANE, _IN_PLANE)])
        if self.assumption == "plane_stress":
            in_plane -= np.outer(full[_IN_PLANE, 2], full[2, _IN_PLANE]) / full[2, 2]
        return in_plane

    @cached_property
    def thickness_row(self) -> FloatArray:
        """(3,): thickness strain of in-plane strain in plane stress, zz stress [Pa] of it in plane strain."""
        row = np.ascontiguousarray(self.full_stiffness[2, _IN_PLANE])
        return -row / self.full_stiffness[2, 2] if self.assumption == "plane_stress" else row

    @cached_property
    def pressure_wave_speed(self) -> float:
        """Speed of the fastest plane wave in any direction the assumption allows [m/s]."""
        if self.assumption == "three_dimensional":
            order, dim = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]]), 3
        else:
            order, dim = np.array([[0, 2], [2, 1]]), 2
        tensor = self.stiffness[order[:, :, None, None], order[None, None, :, :]]
        return float(np.sqrt(largest_acoustic_eigenvalue(tensor, dim) / self.density))


def largest_acoustic_eigenvalue(tensor: NDArray[np.float64], dim: int) -> float:
    """Largest eigenvalue of n.C.n over all unit n [Pa].

    A scan finds the hill; from there m.(n.C.n).m is raised in m and n by turns until it stands.
    """
    turn = np.pi * np.arange(90) / 90.0
    if dim == 2:
        directions = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    else:
        polar, around = np.meshgrid(np.pi * np.arange(46) / 90.0, 2.0 * turn)
        directions = np.stack(
            [np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], axis=-1
        ).reshape(-1, 3)
    values, vectors = np.linalg.eigh(np.einsum("nj,ijkl,nl->nik", directions, tensor, directions))
    best = int(np.argmax(values[:, -1]))
    value, direction = float(values[best, -1]), vectors[best, :, -1]
    for _ in range(200):
        values, vectors = np.linalg.eigh(np.einsum("j,ijkl,l->ik", direction, tensor, direction))
        raised, direction = float(values[-1]), vectors[:, -1]
        if raised <= value * (1.0 + 1e-15):
            break
        value = raised
    return value
