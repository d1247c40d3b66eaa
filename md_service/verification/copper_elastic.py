"""Elastic constants of copper at 0 K against those published with its potential."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from md_service.crystals import fcc
from md_service.stiffness import static_stiffness
from protocol.verification import Case, Check

FORCE_FIELD: Final = "eam-copper"
SOURCE: Final = "Mishin, Mehl, Papaconstantopoulos, Voter and Kress, Phys. Rev. B 63, 224106 (2001), Table I (EAM 1)"
CUBE_EDGE: Final = 3.615e-10  # m
#: Voigt rows of the tensor, and the published value, Pa.
CONSTANTS: Final = {"C11": (0, 0, 169.9e9), "C12": (0, 1, 122.6e9), "C44": (3, 3, 76.2e9)}
TOLERANCE: Final = 0.001


def copper_elastic(folder: Path) -> list[Check]:
    """Strain a cell of 32 atoms both ways along each of the six components, and relax its size first."""
    # Two percent too wide, so that the cube edge is found and not put in.
    crystal = fcc("Cu", 1.02 * CUBE_EDGE / 2.0**0.5, (2, 2, 2))
    measured = static_stiffness(crystal, FORCE_FIELD, folder)
    edge = float(measured.at_rest.box.edges[0, 0]) / 2.0
    checks = [Check("cube edge at zero stress", edge, CUBE_EDGE, 1e-4, SOURCE, "m")]
    for name, (row, column, published) in CONSTANTS.items():
        checks.append(Check(name, float(measured.tensor[row, column]), published, TOLERANCE, SOURCE, "Pa"))
    return checks


CASES = [Case("md", "copper-elastic", "elastic constants of an embedded-atom copper at 0 K", copper_elastic)]
