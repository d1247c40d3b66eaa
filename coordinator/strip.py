"""J of a long crack in a strip whose long edges are moved apart, from the displacement of the edges."""

from __future__ import annotations

from typing import Literal

from protocol.continuum import IsotropicMaterial


def strip_j(
    material: IsotropicMaterial,
    assumption: Literal["plane_stress", "plane_strain"],
    strain: float,
    height: float,
    *,
    sideways_free: bool,
) -> float:
    """Return the energy release rate, J/m2 (Rivlin and Thomas 1953).

    As the crack grows, strip far ahead of the tip, strained uniformly, becomes strip far behind it, which is
    unloaded; what is released is the energy density far ahead times the height. Right where crack and ligament
    are longer than half the height, and quasi-static.

    Parameters
    ----------
    material : IsotropicMaterial
    assumption : {"plane_stress", "plane_strain"}
    strain : float
        Displacement between the edges over `height`.
    height : float
        Distance of the edges, m.
    sideways_free : bool
        Whether the material may contract along the strip; False where the edges hold it.
    """
    nu = material.poisson
    if assumption == "plane_stress":
        modulus = material.young if sideways_free else material.young / (1 - nu**2)
    else:
        modulus = material.young / (1 - nu**2) if sideways_free else (
            material.young * (1 - nu) / ((1 + nu) * (1 - 2 * nu))
        )  # fmt: skip
    return 0.5 * modulus * strain**2 * height
