"""A doubly periodic repeating unit cell: rows along axis 2, columns along axis 3, continuous along axis 1.

Subcell (beta, gamma) lies in row beta and column gamma; in flat arrays its index is beta * columns + gamma.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from gmc_service.material import Material

#: What a cell with failed subcells answers; see `Cell.after_failure`.
AfterFailure = Literal["gmc", "floor", "high_fidelity"]
AFTER_FAILURE: Final[tuple[AfterFailure, ...]] = ("gmc", "floor", "high_fidelity")


@dataclass(frozen=True, eq=False)
class Cell:
    """A repeating unit cell with its materials and its rule of failure.

    Attributes
    ----------
    heights : ndarray of float, shape (rows,)
        Extent of each row along axis 2, m.
    widths : ndarray of float, shape (columns,)
        Extent of each column along axis 3, m.
    phase : ndarray of int64, shape (rows, columns)
        Index into `materials`.
    materials : tuple of Material
    stress_free_temperature : float
        K; at it the unloaded cell has no stress.
    knock_down : float
        Factor on the stiffness of a failed subcell.
    after_failure : str
        One of `AFTER_FAILURE`, see `gmc_service.failed_cell`. ``gmc``: the method itself with the knocked down
        stiffness; in it all subcells share one transverse shear stress, so a single failed subcell takes the whole G23
        down to the knock-down level. ``floor``: G23 stays at or above that of the intact part with pores. With
        ``high_fidelity`` the high-fidelity backend answers for every cell with a failed subcell.

    Raises
    ------
    ValueError
        If a size is not positive, the phase does not fit, or a number is out of range.
    """

    heights: NDArray[np.float64]
    widths: NDArray[np.float64]
    phase: NDArray[np.int64]
    materials: tuple[Material, ...]
    stress_free_temperature: float = 300.0
    knock_down: float = 1e-4
    after_failure: AfterFailure = "gmc"

    def __post_init__(self) -> None:
        for name in ("heights", "widths"):
            values = getattr(self, name)
            if values.ndim != 1 or not len(values):
                raise ValueError(f"{name} has shape {values.shape}; it must be a list of at least one size")
            if not (np.isfinite(values).all() and (values > 0.0).all()):
                bad = values[~(np.isfinite(values) & (values > 0.0))][0]
                raise ValueError(f"{name} holds {bad} m; every size must be finite and greater than 0")
        if self.phase.shape != (self.rows, self.columns):
            raise ValueError(f"phase has shape {self.phase.shape}; it must have {(self.rows, self.columns)}")
        if self.phase.min() < 0 or self.phase.max() >= len(self.materials):
            raise ValueError(
                f"phase holds {self.phase.min()} to {self.phase.max()}; allowed is 0 to {len(self.materials) - 1}"
            )
        if not (np.isfinite(self.stress_free_temperature) and self.stress_free_temperature >= 0.0):
            raise ValueError(f"stress_free_temperature is {self.stress_free_temperature} K; it must be 0 or greater")
        if not 0.0 < self.knock_down <= 1.0:
            raise ValueError(f"knock_down is {self.knock_down}; it must be greater than 0 and at most 1")
        if self.after_failure not in AFTER_FAILURE:
            raise ValueError(f"after_failure is {self.after_failure!r}; it must be one of {', '.join(AFTER_FAILURE)}")

    @property
    def rows(self) -> int:
        """Subcells along axis 2."""
        return len(self.heights)

    @property
    def columns(self) -> int:
        """Subcells along axis 3."""
        return len(self.widths)

    @property
    def subcells(self) -> int:
        """Subcells in all."""
        return self.rows * self.columns

    def volume_fractions(self) -> NDArray[np.float64]:
        """Share of each subcell in the cell, shape (subcells,)."""
        areas = np.outer(self.heights, self.widths)
        return np.asarray((areas / areas.sum()).reshape(-1), dtype=np.float64)

    def phase_fractions(self) -> NDArray[np.float64]:
        """Share of each material in the cell, shape (materials,)."""
        shares = np.zeros(len(self.materials))
        np.add.at(shares, self.phase.reshape(-1), self.volume_fractions())
        return shares

    def stiffness_at(self, temperature: float) -> NDArray[np.float64]:
        """Stiffness of every subcell, intact, at a temperature in K; shape (subcells, 6, 6), Pa."""
        table = np.array([material.stiffness_at(temperature) for material in self.materials])
        return np.ascontiguousarray(table[self.phase.reshape(-1)])

    def expansion_at(self, temperature: float) -> NDArray[np.float64]:
        """Thermal expansion of every subcell at a temperature in K; shape (subcells, 6), 1/K."""
        table = np.array([material.expansion_at(temperature) for material in self.materials])
        return np.ascontiguousarray(table[self.phase.reshape(-1)])

    def thermal_strain_at(self, temperature: float) -> NDArray[np.float64]:
        """Free thermal strain of every subcell at a temperature in K; shape (subcells, 6)."""
        return self.expansion_at(temperature) * (temperature - self.stress_free_temperature)

    def identity(self) -> str:
        """Hexadecimal SHA-256 of all that an answer depends on: equal cells have equal ids, whoever defines them."""
        digest = hashlib.sha256()

        def add(label: str, values: object) -> None:
            data = np.ascontiguousarray(values)
            kind = data.dtype.newbyteorder("<")
            digest.update(f"{label} {kind.str} {data.shape}\n".encode())
            digest.update(data.astype(kind).tobytes())

        add("heights", self.heights)
        add("widths", self.widths)
        add("phase", self.phase)
        add("rule", np.array([self.stress_free_temperature, self.knock_down]))
        digest.update(f"after_failure {self.after_failure}\n".encode())
        for material in self.materials:
            add("temperatures", material.temperatures)
            add("stiffness", material.stiffness)
            add("expansion", material.expansion)
            for failure in material.failures:
                digest.update(f"{failure.criterion}\n".encode())
                add("allowables", np.array([failure.tension, failure.compression, failure.shear]))
            if material.fracture_energy is not None:
                add("fracture_energy", np.array([material.fracture_energy]))
            if material.reduces_strength:
                digest.update(b"reduces_strength\n")
            if material.plasticity is not None:
                add("plasticity", np.array([material.plasticity.yield_stress, material.plasticity.hardening]))
        return digest.hexdigest()
