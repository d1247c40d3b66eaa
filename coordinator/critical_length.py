"""Critical crack length: below it a crack is no crack in the sense of fracture mechanics (Eq 1)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from coordinator.scene import Scene
from protocol.continuum import IsotropicMaterial

#: Theoretical strength over Young's modulus, where a scene gives none (Orowan's estimate).
STRENGTH_SHARE = 0.1


@dataclass(frozen=True)
class CriticalLength:
    """What Eq 1 says of a scene.

    Attributes
    ----------
    length : float
        a_c, m.
    toughness, strength : float
        What it was computed from, J/m2 and Pa.
    estimated : bool
        Whether the strength is an estimate.
    crack : float
        Length of the scene's crack, from an edge, or half of it with two tips, m.
    """

    length: float
    toughness: float
    strength: float
    estimated: bool
    crack: float

    @property
    def too_short(self) -> bool:
        """Whether the crack is shorter than the critical length."""
        return self.crack < self.length


def critical_crack_length(
    young: float,
    poisson: float,
    toughness: float,
    strength: float,
    assumption: Literal["plane_stress", "plane_strain"],
) -> float:
    """Return a_c = E' G_c / (pi sigma_th^2), m (Eq 1).

    Parameters
    ----------
    young, poisson : float
        Pa, 1. E' is E in plane stress, E / (1 - nu^2) in plane strain.
    toughness : float
        G_c, J/m2.
    strength : float
        Theoretical strength sigma_th, Pa.
    assumption : {"plane_stress", "plane_strain"}
    """
    modulus = young if assumption == "plane_stress" else young / (1.0 - poisson**2)
    return modulus * toughness / (math.pi * strength**2)


def of_scene(scene: Scene, material: IsotropicMaterial) -> CriticalLength | None:
    """Return what Eq 1 says of a scene; None without a crack, or where no toughness is known."""
    crack = scene.crack
    if crack is None:
        return None
    toughness = crack.toughness
    if toughness is None and crack.growth is not None:
        toughness = crack.growth.critical_energy_release_rate
    if toughness is None:
        return None
    strength = crack.strength if crack.strength is not None else STRENGTH_SHARE * material.young
    length = critical_crack_length(
        material.young, material.poisson, toughness, strength, scene.continuum.assumption
    )  # fmt: skip
    own = crack.tip_x - scene.continuum.lower[0] if crack.start_x is None else 0.5 * (crack.tip_x - crack.start_x)
    return CriticalLength(length, toughness, strength, crack.strength is None, own)
