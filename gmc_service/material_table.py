"""A material as a table of a TOML file: elastic constants of a kind, expansion, allowables, plastic law.

The keys that `KINDS` and `EXPANSIONS` list, all with units but Poisson's ratios. With ``temperatures``, a list, each
constant is one value for all of them or a list of as many.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from gmc_service.engineering_constants import EngineeringConstants
from gmc_service.material import CRITERIA, Failure, Material, Plasticity, isotropic_stiffness
from gmc_service.toml_table import Table
from protocol.quantities import wanted

#: Elastic constants of each kind. ``cubic`` has the constants of an isotropic material with a shear modulus given by
#: itself. Of the pairs in `EITHER` one is given.
KINDS: Final[dict[str, tuple[str, ...]]] = {
    "isotropic": ("E", "nu"),
    "cubic": ("E", "nu", "G"),
    "transversely isotropic": ("E1", "E2", "nu12", "nu23", "G12"),
    "orthotropic": ("E1", "E2", "E3", "nu12", "nu13", "nu23", "G12", "G13", "G23"),
}
EITHER: Final[dict[str, tuple[str, str]]] = {"transversely isotropic": ("nu23", "G23")}
#: Coefficients of thermal expansion of each kind; all of them or none.
EXPANSIONS: Final[dict[str, tuple[str, ...]]] = {
    "isotropic": ("alpha",),
    "cubic": ("alpha",),
    "transversely isotropic": ("alpha1", "alpha2"),
    "orthotropic": ("alpha1", "alpha2", "alpha3"),
}
_NONE: Final = "none"


def read_material(table: Table, name: str) -> Material | None:
    """Read a material.

    Parameters
    ----------
    table : Table
        The keys; mistakes are noted there. The caller takes its own keys first.
    name : str

    Returns
    -------
    Material or None
        None if there was a mistake. ``expansion_known`` is False where the table has no coefficient.
    """
    before = len(table.mistakes)
    kind = table.choice("kind", tuple(KINDS))
    temperatures = table.quantities("temperatures", "temperature", "zero", required=False)
    if temperatures is not None and (len(temperatures) < 2 or (np.diff(temperatures) <= 0.0).any()):
        table.refuse("temperatures", "must be two or more, ascending")
        temperatures = None
    constants, expansions = {}, {}
    if kind is not None:
        count = 1 if temperatures is None else len(temperatures)
        constants = {key: _constant(table, key, kind, count) for key in _wanted(table, kind)}
        given = [key for key in EXPANSIONS[kind] if key in table]
        for key in EXPANSIONS[kind]:
            if given:
                expansions[key] = _constant(table, key, kind, count)
            else:
                table.raw(key)  # known, and not given
    density = table.quantity("density", "density", required=False)
    failures = [_failure(one) for one in table.tables("failure")]
    fracture_energy = table.quantity("fracture_energy", "energy per area", required=False)
    reduces_strength = table.truth("reduces_strength")
    plasticity = _plasticity(table.table("plasticity", required=False))
    table.finish()
    if len(table.mistakes) > before or kind is None:
        return None
    known = {key: values for key, values in constants.items() if values is not None}
    try:
        stiffness = np.array([_stiffness(kind, {k: float(v[n]) for k, v in known.items()}) for n in range(count)])
        return Material(
            name=name,
            temperatures=np.array([300.0] if temperatures is None else temperatures),
            stiffness=stiffness,
            expansion=_expansion(kind, {k: v for k, v in expansions.items() if v is not None}, count),
            failures=tuple(one for one in failures if one is not None),
            fracture_energy=fracture_energy,
            reduces_strength=reduces_strength,
            plasticity=plasticity,
            density=density,
            expansion_known=bool(expansions),
        )
    except ValueError as error:
        table.refuse("", str(error))
        return None


def _wanted(table: Table, kind: str) -> tuple[str, ...]:
    """Keys of a kind; of a pair of which one is enough, the one that is given."""
    keys = KINDS[kind]
    if kind not in EITHER:
        return keys
    usual, other = EITHER[kind]
    if other not in table:
        table.raw(other)
        return keys
    if usual in table:
        table.refuse(other, f"and {usual} are both given; one follows from the other, so give one")
    table.raw(usual)
    return tuple(other if key == usual else key for key in keys)


def _constant(table: Table, key: str, kind: str, count: int) -> NDArray[np.float64] | None:
    """One constant at each of `count` temperatures."""
    dimension = "pressure" if key[0] in "EG" else "thermal expansion" if key.startswith("alpha") else ""
    if key not in table:
        other = " (or G23)" if (kind, key) == ("transversely isotropic", "nu23") else ""
        table.raw(key)
        table.refuse(key, f"is missing; a material of kind {kind!r} needs it{other}, "
                          f"{wanted(dimension) if dimension else 'a number'}")  # fmt: skip
        return None
    entry = table.raw(key)
    if isinstance(entry, list):
        if len(entry) != count:
            need = f"must have {count} values, one for each of temperatures" if count > 1 else "must be one value"
            table.refuse(key, f"{need}; a list needs temperatures" if count == 1 else need)
            return None
        if dimension:
            values = table.quantities(key, dimension, "positive" if dimension == "pressure" else "any")
            return None if values is None else np.array(values)
        numbers = [table.checked_number(f"{key}.{n}", one) for n, one in enumerate(entry)]
        return None if None in numbers else np.array(numbers, dtype=np.float64)
    if dimension:
        value = table.quantity(key, dimension, "positive" if dimension == "pressure" else "any")
    else:
        value = table.number(key)
    return None if value is None else np.full(count, value)


def _stiffness(kind: str, constant: dict[str, float]) -> NDArray[np.float64]:
    if kind in ("isotropic", "cubic"):
        return isotropic_stiffness(constant["E"], constant["nu"], constant.get("G"))
    if kind == "transversely isotropic":
        across = constant["E2"]
        if "G23" in constant:
            sliding = constant["G23"]
            constant["nu23"] = 0.5 * across / sliding - 1.0
        else:
            if not constant["nu23"] > -1.0:
                raise ValueError(f"nu23 is {constant['nu23']}; it must be greater than -1")
            sliding = 0.5 * across / (1.0 + constant["nu23"])
        return EngineeringConstants(
            constant["E1"], across, across, constant["nu12"], constant["nu12"], constant["nu23"],
            constant["G12"], constant["G12"], sliding,
        ).stiffness()  # fmt: skip
    return EngineeringConstants(
        constant["E1"], constant["E2"], constant["E3"], constant["nu12"], constant["nu13"], constant["nu23"],
        constant["G12"], constant["G13"], constant["G23"],
    ).stiffness()  # fmt: skip


def _expansion(kind: str, given: dict[str, NDArray[np.float64]], count: int) -> NDArray[np.float64]:
    """Coefficients at each temperature, (count, 6)."""
    expansion = np.zeros((count, 6))
    if given:
        values = list(given.values())
        for axis in range(3):
            expansion[:, axis] = values[min(axis, len(values) - 1)]
    return expansion


def _failure(table: Table) -> Failure | None:
    before = len(table.mistakes)
    criterion = table.choice("criterion", CRITERIA)
    limits = {}
    for key in ("tension", "compression", "shear"):
        entry = table.raw(key)
        if entry is not None and criterion is not None:
            limits[key] = _allowables(table, key, entry, criterion == "maximum_strain")
    table.finish()
    if not limits and criterion is not None:
        table.refuse("", "has no allowable; needed: tension, compression or shear")
    if len(table.mistakes) > before or criterion is None:
        return None
    return Failure(criterion, **{key: value for key, value in limits.items() if value is not None})  # type: ignore[arg-type]


def _allowables(table: Table, key: str, entry: object, strain: bool) -> tuple[float, float, float] | None:
    """One allowable for all three components, or three of which some may be ``"none"``."""
    entries = entry if isinstance(entry, list) else [entry] * 3
    if len(entries) != 3:
        order = "23, 13, 12" if key == "shear" else "1, 2, 3"
        table.refuse(key, f'must be one value, or three in the order {order}, with "{_NONE}" where there is none')
        return None
    paths = [f"{key}.{n}" for n in range(3)] if isinstance(entry, list) else [key]
    values = []
    for path, one in zip(paths, entries, strict=False):
        if one == _NONE:
            values.append(float("inf"))
            continue
        value = table.checked_number(path, one) if strain else table.checked_quantity(path, one, "pressure")
        if value is not None and value <= 0.0:
            table.refuse(path, "must be greater than 0")
        elif value is not None:
            values.append(value)
    if len(values) != len(paths):
        return None
    return (values[0], values[0], values[0]) if len(values) == 1 else (values[0], values[1], values[2])


def _plasticity(table: Table | None) -> Plasticity | None:
    if table is None:
        return None
    yield_stress = table.quantity("yield_stress", "pressure")
    hardening = table.quantity("hardening", "pressure", "zero", required=False)
    table.finish()
    return None if yield_stress is None else Plasticity(yield_stress, hardening or 0.0)
