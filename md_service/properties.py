"""Material properties of a sample, measured one after the other and put into words: a table, a constituent file."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from md_service.atoms import Atoms
from md_service.elastic_tensor import SHEET, SOLID, VOIGT_LABELS, engineering_constants, jackknife
from md_service.force_fields import ForceField
from md_service.force_fields import force_field as profile_of
from md_service.mechanical_tests import StressStrain, uniaxial_tension
from md_service.stiffness import Stiffness, static_stiffness, thermal_stiffness
from md_service.thermal_properties import Expansion, thermal_expansion
from protocol.constituent import KINDS, Constituent, Figure, Strength

WHAT: Final = ("stiffness", "expansion", "tension")
_GIGA: Final = 1e9

# Stage, steps done, steps in all.
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Tension:
    """A tension test to be done: see `md_service.mechanical_tests.uniaxial_tension`."""

    rate: float = 5e9
    axis: str = "x"
    strain: float = 0.2


@dataclass(frozen=True)
class Properties:
    """What was measured of a sample; parts that were not asked for are None."""

    atoms: Atoms
    force_field: str
    temperature: float
    seed: int
    stiffness: Stiffness
    expansion: Expansion | None
    tension: StressStrain | None


@dataclass(frozen=True)
class Row:
    """A line of the table: a quantity with its standard error, NaN where there is none, and its unit."""

    quantity: str
    value: float
    error: float
    unit: str


def measure_properties(
    atoms: Atoms,
    force_field: ForceField | str,
    temperature: float,
    work_dir: Path,
    *,
    what: Sequence[str] = ("stiffness",),
    seed: int = 1,
    isotropic: bool = False,
    tension: Tension | None = None,
    time_step: float | None = None,
    progress: Progress | None = None,
) -> Properties:
    """Measure properties of a periodic sample.

    The stiffness, from which density and zero-stress box come too, is always measured.

    Parameters
    ----------
    atoms : Atoms
    force_field : ForceField or str
        Profile or its name.
    temperature : float
        K; 0 gives the static stiffness, and nothing else is possible then.
    work_dir : Path
        Folder of LAMMPS' files; made if missing.
    what : sequence of str
        Of ``stiffness``, ``expansion``, ``tension``.
    seed : int
        Of velocities and thermostats.
    isotropic : bool
        As `md_service.stiffness.thermal_stiffness`.
    tension : Tension, optional
        Rate, axis and end of the tension test.
    time_step : float, optional
        s; by default the force field's.
    progress : callable, optional
        Called with the stage, its steps done and its steps in all; may raise to stop.

    Returns
    -------
    Properties

    Raises
    ------
    ValueError
        For an unknown property, one that 0 K does not have, or what the measurements refuse.
    EngineError
        If LAMMPS stops.
    """
    for name in what:
        if name not in WHAT:
            raise ValueError(f"what holds {name!r}; known are {', '.join(WHAT)}")
        if temperature == 0.0 and name != "stiffness":
            raise ValueError(f"what holds {name!r}, which needs a temperature above 0 K")
    profile = profile_of(force_field) if isinstance(force_field, str) else force_field

    def stage(name: str) -> Callable[[int, int], None] | None:
        return None if progress is None else lambda done, total: progress(name, done, total)

    if temperature == 0.0:
        stiffness = static_stiffness(atoms, profile, work_dir)
    else:
        stiffness = thermal_stiffness(
            atoms,
            profile,
            temperature,
            work_dir,
            seed=seed,
            isotropic=isotropic,
            time_step=time_step,
            progress=stage("stiffness"),
        )
    expansion = pulled = None
    if "expansion" in what:
        expansion = thermal_expansion(stiffness, profile, work_dir, time_step=time_step, progress=stage("expansion"))
    if "tension" in what:
        test = tension or Tension()
        pulled = uniaxial_tension(
            stiffness.at_rest,
            profile,
            temperature,
            test.rate,
            test.axis,
            test.strain,
            seed,
            work_dir,
            fit_strain=min(0.02, test.strain),
            time_step=time_step,
            progress=stage("tension"),
        )
    return Properties(atoms, profile.name, temperature, seed, stiffness, expansion, pulled)


def rows(properties: Properties) -> list[Row]:
    """Figures of one line each: density, elastic constants, expansion, tension. The tensor is apart."""
    stiffness = properties.stiffness
    table = [Row("density", stiffness.density, stiffness.density_error, "kg/m^3")]
    labels = [VOIGT_LABELS[index] for index in stiffness.components]
    if stiffness.components in (SOLID, SHEET):
        values, errors = stiffness.engineering()
        for name, constant in values.items():
            scale, unit = (1.0, "1") if name.startswith("nu") else (_GIGA, "GPa")
            table.append(Row(name, constant / scale, errors[name] / scale, unit))
        mean, deviation = stiffness.isotropic()
        table += [
            Row("isotropic E", mean.young / _GIGA, deviation.young / _GIGA, "GPa"),
            Row("isotropic nu", mean.poisson, deviation.poisson, "1"),
            Row("isotropic K", mean.bulk / _GIGA, deviation.bulk / _GIGA, "GPa"),
            Row("isotropic G", mean.shear / _GIGA, deviation.shear / _GIGA, "GPa"),
            Row("Voigt less Reuss E", mean.spread / _GIGA, deviation.spread / _GIGA, "GPa"),
        ]
    if properties.expansion is not None:
        growth = properties.expansion
        for label, alpha, spread in zip(labels, growth.coefficient, growth.error, strict=True):
            table.append(Row(f"expansion {label}", 1e6 * float(alpha), 1e6 * float(spread), "1e-6/K"))
        table.append(Row("expansion, mean of axes", 1e6 * growth.mean, 1e6 * growth.mean_error, "1e-6/K"))
    if properties.tension is not None:
        test = properties.tension
        limit = "strength" if test.passed_strength else "largest stress (end of test)"
        table += [
            Row(f"tension {test.axis}: E", test.modulus / _GIGA, test.modulus_error / _GIGA, "GPa"),
            Row(f"tension {test.axis}: nu", test.poisson, test.poisson_error, "1"),
            Row(f"tension {test.axis}: {limit}", test.strength / _GIGA, test.strength_error / _GIGA, "GPa"),
            Row(f"tension {test.axis}: strain there", test.strength_strain, float("nan"), "1"),
        ]
    return table


def tensor_block(stiffness: Stiffness) -> list[str]:
    """Lines of the stiffness tensor, GPa, and of its standard errors if there are any."""
    labels = [VOIGT_LABELS[index] for index in stiffness.components]

    def block(title: str, tensor: NDArray[np.float64]) -> list[str]:
        head = f"{title:<24}" + "".join(f"{label:>10}" for label in labels)
        # Adding zero turns -0.00 into 0.00.
        rounded = np.round(tensor / _GIGA, 2) + 0.0
        return [head] + [
            f"{label:>24}" + "".join(f"{value:10.2f}" for value in row)
            for label, row in zip(labels, rounded, strict=True)
        ]

    lines = block("stiffness tensor, GPa", stiffness.tensor)
    return lines if len(stiffness.replicas) == 1 else [*lines, "", *block("standard errors, GPa", stiffness.error)]


def default_kind(atoms: Atoms) -> str:
    """Kind of constituent: ``plane`` for a sheet, ``orthotropic`` for a crystal, else ``isotropic``."""
    if atoms.thickness is not None:
        return "plane"
    return "isotropic" if atoms.spacing is None else "orthotropic"


def constituent(
    properties: Properties,
    name: str,
    kind: str | None = None,
    provenance: dict[str, str | int | float | bool] | None = None,
) -> Constituent:
    """The constituent of measured properties.

    Parameters
    ----------
    properties : Properties
    name : str
    kind : str, optional
        One of `KINDS`, by default `default_kind`. ``isotropic`` takes Hill's average; ``transversely isotropic`` the
        mean over rotations about axis 1.
    provenance : dict, optional
        Added to force field, seed, strain and rate.

    Returns
    -------
    Constituent

    Raises
    ------
    ValueError
        If the kind is unknown or does not fit the sample, or the material measured is not stable.
    """
    stiffness = properties.stiffness
    kind = default_kind(stiffness.atoms) if kind is None else kind
    if kind not in KINDS:
        raise ValueError(f"kind is {kind!r}; it must be one of {', '.join(KINDS)}")
    wanted = SHEET if kind == "plane" else SOLID
    if stiffness.components != wanted and not (kind == "isotropic" and stiffness.components == SHEET):
        have = ", ".join(VOIGT_LABELS[index] for index in stiffness.components)
        raise ValueError(f"kind is {kind!r}, for which the sample's components ({have}) do not suffice")
    if kind == "isotropic":
        mean, error = stiffness.isotropic()
        constants = {"E": Figure(mean.young, error.young), "nu": Figure(mean.poisson, error.poisson)}
    else:
        average = mean_about_axis_1 if kind == "transversely isotropic" else np.asarray
        names = [each for each in KINDS[kind] if each != "thickness"]
        value, spread = jackknife(
            stiffness.replicas,
            lambda tensor: np.array([engineering_constants(average(tensor))[each] for each in names]),
        )
        constants = {each: Figure(float(v), float(e)) for each, v, e in zip(names, value, spread, strict=True)}
        if kind == "plane":
            constants["thickness"] = Figure(float(stiffness.atoms.thickness or 0.0))
    test = properties.tension
    notes: dict[str, str | int | float | bool] = {
        "force_field": properties.force_field,
        "seed": properties.seed,
        "atoms": len(stiffness.atoms),
        "strain": stiffness.strain,
        "strain_rate_per_s": stiffness.rate,
    }
    if test is not None:
        notes |= {"tension_axis": test.axis, "tension_E_Pa": test.modulus, "tension_E_error_Pa": test.modulus_error}
    return Constituent(
        name=name,
        source="molecular dynamics" if properties.temperature > 0.0 else "molecular statics",
        temperature=Figure(properties.temperature),
        density=Figure(stiffness.density, stiffness.density_error),
        kind=kind,
        elastic=constants,
        expansion={} if properties.expansion is None else _expansion(properties.expansion, kind),
        strength=None
        if test is None
        else Strength(
            tension=Figure(test.strength, test.strength_error),
            strain=Figure(test.strength_strain),
            rate=Figure(test.rate),
            passed=test.passed_strength,
        ),
        provenance=notes | (provenance or {}),
    )


def mean_about_axis_1(tensor: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean of a stiffness (6, 6) over rotations about axis 1."""
    c = 0.5 * (tensor + tensor.T)
    across = 0.125 * (3.0 * (c[1, 1] + c[2, 2]) + 2.0 * c[1, 2] + 4.0 * c[3, 3])
    mixed = 0.125 * (c[1, 1] + c[2, 2] + 6.0 * c[1, 2] - 4.0 * c[3, 3])
    mean = np.zeros((6, 6))
    mean[0, 0] = c[0, 0]
    mean[0, 1] = mean[1, 0] = mean[0, 2] = mean[2, 0] = 0.5 * (c[0, 1] + c[0, 2])
    mean[1, 1] = mean[2, 2] = across
    mean[1, 2] = mean[2, 1] = mixed
    mean[3, 3] = 0.5 * (across - mixed)
    mean[4, 4] = mean[5, 5] = 0.5 * (c[4, 4] + c[5, 5])
    return mean


def _expansion(expansion: Expansion, kind: str) -> dict[str, Figure]:
    axes = [Figure(float(v), float(e)) for v, e in zip(expansion.coefficient, expansion.error, strict=True)]
    if kind == "isotropic":
        return {"alpha": Figure(expansion.mean, expansion.mean_error)}
    if kind == "orthotropic":
        return {f"alpha{i + 1}": axes[i] for i in range(3)}
    if kind == "plane":
        return {f"alpha{i + 1}": axes[i] for i in range(2)}
    across = 0.5 * float(expansion.coefficient[1] + expansion.coefficient[2])
    return {"alpha1": axes[0], "alpha2": Figure(across, 0.5 * float(np.hypot(*expansion.error[1:3])))}
