"""A constituent as the solvers take it: stiffness and thermal expansion over temperature, allowables, plastic law.

Order of components everywhere in this room: 11, 22, 33, 23, 13, 12 with engineering shear strains; axis 1 is the
fibre direction.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from protocol.stiffness import stiffness_problem

Criterion = Literal["maximum_stress", "maximum_strain", "tsai_hill", "hashin"]
CRITERIA: Final[tuple[Criterion, ...]] = ("maximum_stress", "maximum_strain", "tsai_hill", "hashin")
UNLIMITED: Final = (np.inf, np.inf, np.inf)


@dataclass(frozen=True)
class Failure:
    """One failure criterion with its allowables; ``inf`` where a component has none and is not checked.

    Attributes
    ----------
    criterion : str
        One of `CRITERIA`.
    tension, compression : tuple of three floats
        Along 1, 2, 3, positive numbers; Pa, or strain for ``maximum_strain``.
    shear : tuple of three floats
        Of 23, 13, 12; Pa, or engineering strain.
    """

    criterion: Criterion
    tension: tuple[float, float, float] = UNLIMITED
    compression: tuple[float, float, float] = UNLIMITED
    shear: tuple[float, float, float] = UNLIMITED

    def __post_init__(self) -> None:
        if self.criterion not in CRITERIA:
            raise ValueError(f"criterion is {self.criterion!r}; it must be one of {', '.join(CRITERIA)}")
        for name in ("tension", "compression", "shear"):
            values = getattr(self, name)
            if len(values) != 3:
                raise ValueError(f"{name} has {len(values)} values; it must have three")
            for value in values:
                if not value > 0.0:
                    raise ValueError(f"{name} holds {value}; an allowable must be greater than 0, or inf for none")


@dataclass(frozen=True)
class Plasticity:
    """J2 plasticity with linear isotropic hardening.

    Attributes
    ----------
    yield_stress : float
        Pa, in uniaxial tension.
    hardening : float
        Increase of the yield stress per equivalent plastic strain, Pa; 0 is ideal plasticity.
    """

    yield_stress: float
    hardening: float = 0.0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.yield_stress) and self.yield_stress > 0.0):
            raise ValueError(f"yield_stress is {self.yield_stress}; it must be finite and greater than 0")
        if not (np.isfinite(self.hardening) and self.hardening >= 0.0):
            raise ValueError(f"hardening is {self.hardening}; it must be finite and 0 or greater")


@dataclass(frozen=True, eq=False)
class Material:
    """A constituent.

    Attributes
    ----------
    name : str
    temperatures : ndarray of float, shape (temperatures,)
        K, ascending. Between them the table is linear; a temperature outside it is an error.
        One entry: the constants hold at any temperature.
    stiffness : ndarray of float, shape (temperatures, 6, 6)
        Pa; symmetric, positive definite.
    expansion : ndarray of float, shape (temperatures, 6)
        Coefficients of thermal expansion (secant, from the stress-free temperature of the cell), 1/K.
    failures : tuple of Failure
        All are checked; the first that is reached fails the subcell.
    fracture_energy : float, optional
        Energy per area of crack, J/m^2, for softening by the crack-band model.
    plasticity : Plasticity, optional
    density : float, optional
        kg/m^3; no answer depends on it.
    expansion_known : bool
        False where the source gives no thermal expansion; `expansion` is then zero, and good for no temperature but
        the stress-free one.
    reduces_strength : bool
        With a fracture energy: in an element so long that it would store more than its crack can take, the strength is
        lowered (Bazant and Oh 1983). Otherwise such an element is refused.

    Raises
    ------
    ValueError
        If a shape does not fit, a value is not finite, or the stiffness is not symmetric positive definite.
    """

    name: str
    temperatures: NDArray[np.float64]
    stiffness: NDArray[np.float64]
    expansion: NDArray[np.float64]
    failures: tuple[Failure, ...] = ()
    fracture_energy: float | None = None
    plasticity: Plasticity | None = None
    density: float | None = None
    expansion_known: bool = True
    reduces_strength: bool = False

    def __post_init__(self) -> None:
        count = len(self.temperatures)
        if count < 1 or not np.isfinite(self.temperatures).all() or (np.diff(self.temperatures) <= 0.0).any():
            raise ValueError(f"temperatures of {self.name} are {self.temperatures}; they must be finite and ascend")
        for name, shape in (("stiffness", (count, 6, 6)), ("expansion", (count, 6))):
            values = getattr(self, name)
            if values.shape != shape:
                raise ValueError(f"{name} of {self.name} has shape {values.shape}; it must have {shape}")
            if not np.isfinite(values).all():
                raise ValueError(f"{name} of {self.name} holds a number that is not finite")
        for one in self.stiffness:
            problem = stiffness_problem(one)
            if problem is not None:
                raise ValueError(f"stiffness of {self.name} {problem}")
        if self.fracture_energy is not None and not (np.isfinite(self.fracture_energy) and self.fracture_energy > 0.0):
            raise ValueError(f"fracture_energy of {self.name} is {self.fracture_energy}; it must be greater than 0")
        if self.density is not None and not (np.isfinite(self.density) and self.density > 0.0):
            raise ValueError(f"density of {self.name} is {self.density}; it must be finite and greater than 0")

    def stiffness_at(self, temperature: float) -> NDArray[np.float64]:
        """Stiffness at a temperature, Pa.

        Parameters
        ----------
        temperature : float
            K.

        Returns
        -------
        ndarray, shape (6, 6)

        Raises
        ------
        ValueError
            If the temperature lies outside the table.
        """
        return self._at(self.stiffness, temperature)

    def expansion_at(self, temperature: float) -> NDArray[np.float64]:
        """Coefficients of thermal expansion at a temperature, 1/K, shape (6,); see `stiffness_at`."""
        return self._at(self.expansion, temperature)

    def _at(self, values: NDArray[np.float64], temperature: float) -> NDArray[np.float64]:
        table = self.temperatures
        if len(table) == 1:
            return values[0].copy()
        if not table[0] <= temperature <= table[-1]:
            raise ValueError(
                f"temperature is {temperature:g} K; the table of {self.name} goes from {table[0]:g} to {table[-1]:g} K"
            )
        after = int(np.clip(np.searchsorted(table, temperature), 1, len(table) - 1))
        share = (temperature - table[after - 1]) / (table[after] - table[after - 1])
        return np.asarray((1.0 - share) * values[after - 1] + share * values[after], dtype=np.float64)


def isotropic_stiffness(young: float, poisson: float, shear: float | None = None) -> NDArray[np.float64]:
    """Stiffness of an isotropic material, Pa.

    Parameters
    ----------
    young : float
        Pa.
    poisson : float
    shear : float, optional
        Pa, where it is given by itself and differs from E / (2 (1 + nu)).

    Returns
    -------
    ndarray, shape (6, 6)
    """
    if not young > 0.0:
        raise ValueError(f"E is {young}; it must be greater than 0")
    if not -1.0 < poisson < 0.5:
        raise ValueError(f"nu is {poisson}; it must lie between -1 and 0.5")
    lame = young * poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson))
    own = 0.5 * young / (1.0 + poisson)
    stiffness = np.zeros((6, 6))
    stiffness[:3, :3] = lame + 2.0 * own * np.eye(3)
    stiffness[[3, 4, 5], [3, 4, 5]] = own if shear is None else shear
    return stiffness


def constant_material(
    name: str,
    stiffness: NDArray[np.float64],
    expansion: tuple[float, float, float] = (0.0, 0.0, 0.0),
    failures: tuple[Failure, ...] = (),
    fracture_energy: float | None = None,
    plasticity: Plasticity | None = None,
) -> Material:
    """A material whose constants hold at any temperature; `stiffness` has shape (6, 6), see `Material`."""
    return Material(
        name=name,
        temperatures=np.array([300.0]),
        stiffness=np.ascontiguousarray(stiffness, dtype=np.float64)[None],
        expansion=np.array([[*expansion, 0.0, 0.0, 0.0]], dtype=np.float64),
        failures=failures,
        fracture_energy=fracture_energy,
        plasticity=plasticity,
    )
