"""Effective constants as a material card of Abaqus and CalculiX.

Both codes take components in the order 11, 22, 33, 12, 13, 23, while this room has 11, 22, 33, 23, 13, 12; shear
strains are engineering ones in both.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gmc_service.engineering_constants import coupling, engineering_constants

#: Place in our order of each component in the order of the card.
_ORDER: Final = (0, 1, 2, 5, 4, 3)
_ORTHOTROPIC: Final = 1e-9  # coupling below which the card has engineering constants
_NEGLIGIBLE: Final = 1e-9  # expansion in shear over the largest coefficient


@dataclass(frozen=True)
class CardUnits:
    """Consistent units of a card.

    Attributes
    ----------
    name : str
        As the comment in the card has it.
    stress, density : float
        Pa and kg/m^3 of one unit.
    """

    name: str
    stress: float
    density: float


#: Unit systems by the name that a user gives.
CARD_UNITS: Final[dict[str, CardUnits]] = {
    "mm": CardUnits("mm, N, MPa, tonne, s, K", 1e6, 1e12),
    "m": CardUnits("m, N, Pa, kg, s, K", 1.0, 1.0),
}


def material_card(
    name: str,
    stiffness: NDArray[np.float64],
    expansion: NDArray[np.float64] | None = None,
    density: float | None = None,
    reference_temperature: float | None = None,
    units: str = "mm",
    comments: Iterable[str] = (),
) -> str:
    """Write a card.

    Parameters
    ----------
    name : str
        Of the material; characters that the codes refuse become underscores.
    stiffness : ndarray of float, shape (6, 6)
        Pa. Where it ties stretch to shear the card is of type ``ANISO``, else of ``ENGINEERING CONSTANTS``.
    expansion : ndarray of float, shape (6,), optional
        1/K; None where it is not known. Expansion in shear, of which the codes' manuals leave open whether it is a
        tensor component, is left out, and a comment says so.
    density : float, optional
        kg/m^3.
    reference_temperature : float, optional
        K, at which the thermal strain is zero.
    units : str
        A key of `CARD_UNITS`.
    comments : iterable of str
        Lines for the head of the card.

    Returns
    -------
    str

    Raises
    ------
    ValueError
        If the units are unknown or a number is not finite.
    """
    if units not in CARD_UNITS:
        raise ValueError(f"units is {units!r}; it must be one of {', '.join(CARD_UNITS)}")
    for label, values in (("stiffness", stiffness), ("expansion", expansion)):
        if values is not None and not np.isfinite(values).all():
            raise ValueError(f"{label} holds a number that is not finite; a card cannot hold it")
    system = CARD_UNITS[units]
    lines = [f"** {line}" for line in (*comments, f"Units: {system.name}", "Axis 1 is the fibre direction")]
    lines.append(f"*MATERIAL, NAME={_card_name(name)}")
    if coupling(stiffness) < _ORTHOTROPIC:
        lines.append("*ELASTIC, TYPE=ENGINEERING CONSTANTS")
        of = engineering_constants(stiffness)
        moduli = np.array([of.E11, of.E22, of.E33]) / system.stress
        shear = np.array([of.G12, of.G13, of.G23]) / system.stress
        lines += _rows((*moduli, of.nu12, of.nu13, of.nu23, *shear))
    else:
        lines.append("*ELASTIC, TYPE=ANISO")
        card = stiffness[np.ix_(_ORDER, _ORDER)] / system.stress
        lines += _rows(card[row, column] for column in range(6) for row in range(column + 1))
    if expansion is not None:
        lines += _expansion_lines(expansion, reference_temperature)
    if density is not None:
        lines += ["*DENSITY", *_rows([density / system.density])]
    return "\n".join(lines) + "\n"


def _expansion_lines(expansion: NDArray[np.float64], reference: float | None) -> list[str]:
    lines = []
    shear = expansion[list(_ORDER[3:])]
    if np.abs(shear).max() > _NEGLIGIBLE * np.abs(expansion).max():
        values = ", ".join(_number(value) for value in shear)
        lines.append(f"** Left out: thermal expansion in shear 12, 13, 23 (engineering, 1/K): {values}")
    zero = "" if reference is None else f", ZERO={_number(reference)}"
    return [*lines, f"*EXPANSION, TYPE=ORTHO{zero}", *_rows(expansion[:3])]


def _rows(values: Iterable[float]) -> list[str]:
    """Eight values a line, as the codes read them."""
    texts = [_number(value) for value in values]
    return [", ".join(texts[first : first + 8]) for first in range(0, len(texts), 8)]


def _number(value: float) -> str:
    text = f"{value:.8g}"
    return text if any(mark in text for mark in ".en") else f"{text}."


def _card_name(name: str) -> str:
    """At most 80 letters, digits and underscores, a letter first."""
    plain = re.sub(r"[^A-Za-z0-9_]+", "_", name).strip("_").upper()
    return (plain if re.match(r"[A-Z]", plain) else f"M_{plain}")[:80]
