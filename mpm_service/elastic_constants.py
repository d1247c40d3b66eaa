"""Constants of isotropic elasticity."""

from __future__ import annotations

from .material import Assumption, require_above, require_assumption


def require_isotropic(young: float, poisson: float, density: float, assumption: Assumption) -> None:
    """Raise ValueError unless these are an isotropic elastic material."""
    require_above("young", young, 0.0, "Pa")
    if not (-1.0 < poisson < 0.5):
        raise ValueError(f"poisson = {poisson!r}: must be above -1 and below 0.5")
    require_above("density", density, 0.0, "kg/m^3")
    require_assumption(assumption)


def shear_modulus(young: float, poisson: float) -> float:
    """mu [Pa] (Eq 28)."""
    return young / (2.0 * (1.0 + poisson))


def lame_modulus(young: float, poisson: float, assumption: Assumption = "three_dimensional") -> float:
    """lambda [Pa]: Eq 27, but ``E nu/(1 - nu^2)`` for the in-plane law of plane stress."""
    if assumption == "plane_stress":
        return young * poisson / (1.0 - poisson**2)
    return young * poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson))


def bulk_modulus(young: float, poisson: float) -> float:
    """K [Pa]."""
    return young / (3.0 * (1.0 - 2.0 * poisson))


def wave_modulus(young: float, poisson: float, assumption: Assumption) -> float:
    """Modulus of the pressure wave at rest, lambda + 2 mu [Pa]; the in-plane one in plane stress."""
    return lame_modulus(young, poisson, assumption) + 2.0 * shear_modulus(young, poisson)
