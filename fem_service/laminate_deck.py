"""A laminate as a deck that CalculiX and Abaqus run: bricks, plies, elastic constants, grips, one static step.

Lengths are in mm, forces in N, stresses in MPa. Components of a material are in the order 11, 22, 33, 12, 13, 23 there;
shear strains are engineering ones. CalculiX reads no more than 20 characters of a number.

The type ``C3D8`` is fully integrated in CalculiX (2.20; equal to ours to all digits that it prints), while in Abaqus
its volumetric strain is the mean over the element.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fem_service.equilibrium import Grips
from fem_service.laminate_mesh import LaminateMesh

_LENGTH: Final = 1e-3
_STRESS: Final = 1e6
#: Place in our order of each component in the order of the deck.
_ORDER: Final = (0, 1, 2, 5, 4, 3)
#: Coupling of stretch and shear over the largest stiffness, below which there are engineering constants.
_ORTHOTROPIC: Final = 1e-9
_A_LINE: Final = 8


def laminate_deck(
    mesh: LaminateMesh,
    grips: Grips,
    stiffness: NDArray[np.float64],
    comments: Iterable[str] = (),
) -> str:
    """Write the deck. Node and element numbers are the rows of the mesh plus one; plies are the sets PLY_1, PLY_2, ...

    Parameters
    ----------
    mesh : LaminateMesh
        Without cohesive layers, which CalculiX does not have.
    grips : Grips
        The displacements of the step are those at a load of 1.
    stiffness : ndarray of float, shape (6, 6)
        Of a ply in its own axes, Pa.
    comments : iterable of str
        Lines for the head.

    Raises
    ------
    ValueError
        If the mesh has cohesive layers.
    """
    if len(mesh.layers):
        raise ValueError("the mesh has cohesive layers; a deck has none, so its plies must be tied")
    lines = [
        "*HEADING",
        "Laminate written by scalebridge",
        *(f"** {line}" for line in comments),
        "** Units: mm, N, MPa",
        "** C3D8 is fully integrated in CalculiX; in Abaqus its volumetric strain is the mean over the element",
        "*NODE, NSET=LAMINATE",
    ]
    lines += [f"{label}, {_numbers(place)}" for label, place in enumerate(mesh.nodes / _LENGTH, 1)]
    for ply in range(len(mesh.angles)):
        lines.append(f"*ELEMENT, TYPE=C3D8, ELSET=PLY_{ply + 1}")
        rows = np.flatnonzero(mesh.ply == ply)
        lines += [f"{row + 1}, {', '.join(map(str, mesh.bricks[row] + 1))}" for row in rows.tolist()]
    lines += _material(stiffness)
    for ply, angle in enumerate(mesh.angles.tolist(), 1):
        c, s = np.cos(angle), np.sin(angle)
        lines += [
            f"** {np.degrees(angle):g} degrees from x",
            f"*ORIENTATION, NAME=AXES_{ply}, SYSTEM=RECTANGULAR",
            _numbers([c, s, 0.0, -s, c, 0.0]),
            f"*SOLID SECTION, ELSET=PLY_{ply}, MATERIAL=CELL, ORIENTATION=AXES_{ply}",
        ]
    sets, moves = _grips(grips)
    lines += sets
    lines += ["*STEP", "*STATIC", "*BOUNDARY", *moves]
    lines += ["*NODE PRINT, NSET=LAMINATE", "U, RF", "*NODE FILE", "U, RF", "*EL FILE", "S, E", "*END STEP"]
    return "\n".join(lines) + "\n"


def _material(stiffness: NDArray[np.float64]) -> list[str]:
    coupled = max(np.abs(stiffness[:3, 3:]).max(), np.abs(np.triu(stiffness[3:, 3:], 1)).max())
    lines = ["*MATERIAL, NAME=CELL"]
    if coupled > _ORTHOTROPIC * np.abs(stiffness).max():
        card = stiffness[np.ix_(_ORDER, _ORDER)] / _STRESS
        upper = [card[row, column] for column in range(6) for row in range(column + 1)]
        return [*lines, "*ELASTIC, TYPE=ANISOTROPIC", *_rows(map(_number, upper))]
    s = np.linalg.inv(stiffness)
    moduli, shear = 1.0 / (np.diag(s)[:3] * _STRESS), 1.0 / (np.diag(s)[[5, 4, 3]] * _STRESS)
    ratios = [-s[0, 1] / s[0, 0], -s[0, 2] / s[0, 0], -s[1, 2] / s[1, 1]]
    constants = [*moduli, *ratios, *shear]
    return [
        *lines,
        "** E1, E2, E3, nu12, nu13, nu23, G12, G13, G23",
        "*ELASTIC, TYPE=ENGINEERING CONSTANTS",
        *_rows(map(_number, constants)),
    ]


def _grips(grips: Grips) -> tuple[list[str], list[str]]:
    """Node sets, one for each direction and displacement, and the lines that move them."""
    nodes, axes = grips.freedoms // 3, grips.freedoms % 3
    kinds, kind = np.unique(np.column_stack([axes, grips.per_load]), axis=0, return_inverse=True)
    sets, moves = [], []
    for place, (axis, value) in enumerate(kinds):
        name = f"GRIP_{place + 1}"
        sets += [f"*NSET, NSET={name}", *_rows(str(node + 1) for node in nodes[kind.reshape(-1) == place])]
        direction = int(axis) + 1
        moves.append(f"{name}, {direction}, {direction}, {_number(value / _LENGTH)}")
    return sets, moves


def _rows(texts: Iterable[str]) -> list[str]:
    words = list(texts)
    return [", ".join(words[first : first + _A_LINE]) for first in range(0, len(words), _A_LINE)]


def _numbers(values: Iterable[float]) -> str:
    return ", ".join(map(_number, values))


def _number(value: float) -> str:
    """The shortest text that is the same number, or, where that has more than 20 characters, 14 digits."""
    text = repr(float(value))
    return text if len(text) <= 20 else f"{value:.13e}"
