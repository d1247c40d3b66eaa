"""The built-in materials and the contract for one of your own."""

from __future__ import annotations

from .elastic import IsotropicElastic, LinearElastic, OrthotropicElastic
from .hyperelastic import NeoHookean
from .laminate import CellAnswer, Laminate, Microstructure
from .material import (
    Assumption,
    Material,
    MaterialError,
    displacement_gradient,
    kirchhoff_stress,
    reference_volume,
    set_kirchhoff_stress,
)
from .plasticity import J2Plasticity

__all__ = [
    "Assumption",
    "CellAnswer",
    "IsotropicElastic",
    "J2Plasticity",
    "Laminate",
    "LinearElastic",
    "Material",
    "MaterialError",
    "Microstructure",
    "NeoHookean",
    "OrthotropicElastic",
    "displacement_gradient",
    "kirchhoff_stress",
    "reference_volume",
    "set_kirchhoff_stress",
]
