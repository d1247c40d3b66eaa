"""Displacement around a crack tip in an infinite elastic body: the singular term of Williams' series."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .elastic import IsotropicElastic
from .fracture import plane_constants, tip_gradient
from .material import Material

FloatArray = NDArray[np.float64]
SideArray = NDArray[np.int64]


@dataclass(frozen=True)
class CrackTipField:
    """Williams' singular field of a straight crack with free faces.

    Parameters
    ----------
    tip : (2,) sequence of float
        Place of the tip [m].
    opening, sliding : float
        K_I and K_II [Pa sqrt(m)].
    angle : float
        From x to the direction in which the crack would grow [rad].
    shear : float
        Shear modulus [Pa].
    kappa : float
        Kolosov's constant.

    Notes
    -----
    With z = r exp(i t) in the tip's frame, ``2 mu u = kappa phi - z conj(phi') - conj(psi)``, ``phi = k sqrt(z)``,
    ``psi = (conj(k) - k/2) sqrt(z)``, ``k = (K_I - i K_II)/sqrt(2 pi)`` (Muskhelishvili). Left of the crack, seen
    towards the tip, is side +1, right of it -1. Where a side is given the field of that side goes on smoothly across
    the crack's line, which is what a node that belongs to material beyond the line needs.
    """

    tip: Sequence[float]
    opening: float
    sliding: float
    angle: float
    shear: float
    kappa: float

    @classmethod
    def in_material(
        cls, material: Material, tip: Sequence[float], opening: float, sliding: float = 0.0, angle: float = 0.0
    ) -> CrackTipField:
        """Make the field in a material.

        Raises
        ------
        ValueError
            If the material is not `IsotropicElastic` in the plane: there is no closed form here.
        """
        if not isinstance(material, IsotropicElastic) or material.assumption == "three_dimensional":
            raise ValueError(
                f"material = {type(material).__name__}: a crack-tip field needs the law 'isotropic' in plane stress or "
                "plane strain"
            )
        _, shear, kappa = plane_constants(material.young, material.poisson, material.assumption == "plane_stress")
        return cls(tuple(float(v) for v in tip), float(opening), float(sliding), float(angle), shear, kappa)

    def side(self, position: FloatArray) -> SideArray:
        """+1 for places (n, 2) left of the crack's line or on it, -1 for those right of it, (n,)."""
        return np.where(self._local(position)[1] >= 0.0, 1, -1)

    def displacement(self, position: FloatArray, side: SideArray | None = None) -> FloatArray:
        """Displacement at reference places [m], (n, 2).

        Parameters
        ----------
        position : (n, 2) ndarray
            [m]
        side : (n,) ndarray of int, optional
            Side of the crack that the material belongs to; that of its place if not given.
        """
        along, across = self._local(position)
        turn = np.arctan2(across, along)
        own = np.where(across >= 0.0, 1, -1) if side is None else side
        turn = np.where((own > 0) & (turn < -0.5 * np.pi), turn + 2.0 * np.pi, turn)
        turn = np.where((own < 0) & (turn > 0.5 * np.pi), turn - 2.0 * np.pi, turn)
        distance = np.hypot(along, across)
        root = np.sqrt(distance) * np.exp(0.5j * turn)
        z = distance * np.exp(1j * turn)
        k = (self.opening - 1j * self.sliding) / np.sqrt(2.0 * np.pi)
        # z conj(1/sqrt(z)) = z sqrt(z)/|z|, which is 0 at the tip.
        ratio = np.divide(z * root, distance, out=np.zeros_like(z), where=distance > 0.0)
        moved = self.kappa * k * root - 0.5 * np.conj(k) * ratio - np.conj((np.conj(k) - 0.5 * k) * root)
        moved *= np.exp(1j * self.angle) / (2.0 * self.shear)
        return np.stack([moved.real, moved.imag], axis=1)

    def gradient(self, position: FloatArray) -> FloatArray:
        """Displacement gradient at reference places (n, 2) [m], not the tip itself, (n, 2, 2)."""
        along, across = self._local(position)
        local = tip_gradient(np.stack([along, across], axis=1), self.opening, self.sliding, self.shear, self.kappa)
        c, s = np.cos(self.angle), np.sin(self.angle)
        turn = np.array([[c, -s], [s, c]])
        return np.asarray(turn @ local @ turn.T)

    def _local(self, position: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Places along the crack and to its left, from the tip [m]."""
        c, s = np.cos(self.angle), np.sin(self.angle)
        x, y = position[:, 0] - self.tip[0], position[:, 1] - self.tip[1]
        # A place on the crack's line counts as left of it, whichever zero round-off gave it.
        across = c * y - s * x
        across = np.where(np.abs(across) <= 1e-12 * np.hypot(x, y), 0.0, across)
        return c * x + s * y, across
