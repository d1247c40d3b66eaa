"""Definitions of cells as a client sends them, and queries that make some of them fail."""

from __future__ import annotations

import numpy as np

from gmc_service.material import isotropic_stiffness
from protocol import micromechanics as m

NEAT = {"fibre": (276e9, 0.3), "matrix": (2.963e9, 0.369)}  # Pa; near those of the seed's Tables 6.1 and 6.2
STRENGTH = 118.67e6  # Pa


def material(name: str, strength: float | None = None) -> m.CellMaterial:
    stiffness = isotropic_stiffness(*NEAT[name])
    failures = []
    if strength is not None:
        failures = [
            m.MaterialFailure(
                criterion="maximum_stress", tension=(strength,) * 3, compression=(strength,) * 3,
                shear=(strength / 3**0.5,) * 3,
            )
        ]  # fmt: skip
    return m.CellMaterial(
        name=name, temperatures=[300.0], stiffness=[stiffness.reshape(-1).tolist()], expansion=[[1e-6] * 3 + [0.0] * 3],
        failures=failures,
    )  # fmt: skip


def square_fibre(fraction: float = 0.6) -> m.RegisterCell:
    """Two by two, one of them the fibre."""
    side = fraction**0.5
    sizes = np.array([side, 1.0 - side])
    return m.RegisterCell(
        heights=sizes, widths=sizes, phase=np.array([[0, 1], [1, 1]]),
        materials=[material("fibre"), material("matrix", STRENGTH)],
    )  # fmt: skip


def random_cell(side: int, seed: int = 3) -> m.RegisterCell:
    """Many subcells, so that nearly every point that fails has a tangent of its own."""
    chance = np.random.default_rng(seed)
    return m.RegisterCell(
        heights=chance.uniform(0.5, 1.0, side), widths=chance.uniform(0.5, 1.0, side),
        phase=chance.integers(0, 2, (side, side)), materials=[material("fibre"), material("matrix", STRENGTH)],
    )  # fmt: skip


def query(cell: str, points: int, size: float = 0.02, seed: int = 1) -> m.EvaluateRequest:
    strain = np.random.default_rng(seed).uniform(-size, size, (points, 6))
    return m.EvaluateRequest(cell=cell, temperature=310.0, strain=strain)


def same_bits(first: m.Evaluated, second: m.Evaluated) -> bool:
    arrays, others = first.array_values(), second.array_values()
    return (
        arrays.keys() == others.keys()
        and all(array.shape == others[name].shape for name, array in arrays.items())
        and all(array.tobytes() == others[name].tobytes() for name, array in arrays.items())
        and first.plain_values() == second.plain_values()
    )
