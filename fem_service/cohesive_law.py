"""The bilinear cohesive law between two plies, for any mix of opening and sliding.

Traction grows with the stiffness K up to the onset and falls in a straight line from there (Eq 91). Onset is that of
the quadratic criterion (Eq 92), the toughness of a mix that of Benzeggagh and Kenane (Eq 93). With one stiffness for
all three directions the mix is B = sliding^2 / opening^2, opening the norm of sliding and positive normal opening
(Camanho, Davila, De Moura, J. Compos. Mater. 37 (2003) 1415-1438), so

    onset     d_i = 1 / (K sqrt((1 - B) / Y_t^2 + B / S^2))
    final     d_f = 2 G_c(B) / (K d_i),    G_c = G_Ic + (G_IIc - G_Ic) B^alpha
    damage    d*  = d_f (d - d_i) / (d (d_f - d_i)), which never falls

Closed faces press against each other with the undamaged stiffness; faces that just touch are free to part.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba as nb
import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class CohesiveLaw:
    """Constants of a cohesive layer.

    Attributes
    ----------
    stiffness : float
        K, Pa/m.
    normal_strength, shear_strength : float
        Y_t and S, Pa.
    opening_toughness, sliding_toughness : float
        G_Ic and G_IIc, J/m^2.
    mix_exponent : float
        alpha of Eq 93.

    Raises
    ------
    ValueError
        If a constant is not positive, or a toughness so small that traction would have to fall to zero before onset.
    """

    stiffness: float
    normal_strength: float
    shear_strength: float
    opening_toughness: float
    sliding_toughness: float
    mix_exponent: float = 1.0

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} is {value}; it must be finite and greater than 0")
        for name, toughness, strength in (
            ("opening_toughness", self.opening_toughness, self.normal_strength),
            ("sliding_toughness", self.sliding_toughness, self.shear_strength),
        ):
            least = 0.5 * strength**2 / self.stiffness
            if not toughness > least:
                raise ValueError(
                    f"{name} is {toughness:g} J/m^2; it must exceed {least:g}, the elastic energy at the strength"
                )

    def final_opening(self, mix: float) -> float:
        """Opening at which no traction is left, m, for a mix from 0 (opening alone) to 1 (sliding alone)."""
        onset = 1.0 / (self.stiffness * np.sqrt((1.0 - mix) / self.normal_strength**2 + mix / self.shear_strength**2))
        return float(2.0 * self.toughness(mix) / (self.stiffness * onset))

    def toughness(self, mix: float) -> float:
        """G_c of Eq 93, J/m^2."""
        return float(
            self.opening_toughness + (self.sliding_toughness - self.opening_toughness) * mix**self.mix_exponent
        )

    def constants(self) -> NDArray[np.float64]:
        """The attributes in their order, shape (6,), for the compiled law."""
        return np.array([getattr(self, name) for name in self.__dataclass_fields__], dtype=np.float64)


@nb.njit(nogil=True, cache=True)
def separate(law, normal, opening, relaxation, before, after, traction, tangent):  # type: ignore[no-untyped-def]
    """Traction, tangent and damage at one point.

    Parameters
    ----------
    law : ndarray of float, shape (6,)
        See `CohesiveLaw.constants`.
    normal : ndarray of float, shape (3,)
        Unit vector from the lower to the upper face.
    opening : ndarray of float, shape (3,)
        Displacement of the upper face less that of the lower one, m.
    relaxation : float
        Part of the way to its own value that damage goes in this increment: dt / (dt + viscosity), 1 without viscosity.
    before, after : ndarray of float, shape (2,)
        Damage and its viscous follower before the increment; filled: after it.
    traction : ndarray of float, shape (3,)
        Filled: on the upper face, against the opening, Pa.
    tangent : ndarray of float, shape (3, 3)
        Filled: derivative of the traction, with the change of the mix, Pa/m. Not symmetric where damage grows.
    """
    stiffness = law[0]
    along = opening[0] * normal[0] + opening[1] * normal[1] + opening[2] * normal[2]
    positive = max(along, 0.0)
    sliding = 0.0
    for i in range(3):
        sliding += (opening[i] - along * normal[i]) ** 2
    size = np.sqrt(positive * positive + sliding)
    mix, damage, slope, by_mix = 0.0, 0.0, 0.0, 0.0
    if size > 0.0:
        mix = sliding / (size * size)
        onset = 1.0 / (stiffness * np.sqrt((1.0 - mix) / law[1] ** 2 + mix / law[2] ** 2))
        toughness = law[3] + (law[4] - law[3]) * mix ** law[5]
        final = 2.0 * toughness / (stiffness * onset)
        if size >= final:
            damage = 1.0
        elif size > onset:
            damage = final * (size - onset) / (size * (final - onset))
            slope = final * onset / (size * size * (final - onset))
            onset_by_mix = -0.5 * stiffness**2 * onset**3 * (1.0 / law[2] ** 2 - 1.0 / law[1] ** 2)
            toughness_by_mix = (law[4] - law[3]) * law[5] * max(mix, 1e-12) ** (law[5] - 1.0)
            final_by_mix = final * (toughness_by_mix / toughness - onset_by_mix / onset)
            by_mix = (onset_by_mix * final * (size - final) - final_by_mix * onset * (size - onset)) / (
                size * (final - onset) ** 2
            )
    if damage < before[0]:  # where it is the same, damage is about to go on
        damage, slope, by_mix = before[0], 0.0, 0.0
    after[0] = damage
    after[1] = before[1] + relaxation * (damage - before[1])
    slope *= relaxation
    by_mix *= relaxation
    left = 1.0 - after[1]
    for i in range(3):
        slide = opening[i] - along * normal[i]
        traction[i] = stiffness * (left * slide + (left * along if along > 0.0 else along) * normal[i])
        for j in range(3):
            both = normal[i] * normal[j]
            tangent[i, j] = stiffness * (
                left * ((1.0 if i == j else 0.0) - both) + (left if along >= 0.0 else 1.0) * both
            )
            if slope > 0.0:
                # Both directions in which damage acts: sliding, and opening if it is positive.
                one = slide + positive * normal[i]
                other_slide = opening[j] - along * normal[j]
                other = other_slide + positive * normal[j]
                mix_by_opening = 2.0 * (other_slide - mix * other) / (size * size)
                tangent[i, j] -= stiffness * one * (slope / size * other + by_mix * mix_by_opening)
