"""The units in which people of a scene's scale read its figures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from coordinator.scene import Scene
from coordinator.units import TIMES, readable_unit

ANGSTROM = 1e-10
PICOSECOND = 1e-12
ELECTRONVOLT = 1.602176634e-19
NANONEWTON = 1e-9
GIGAPASCAL = 1e9
#: Bodies at least so wide, m, are read in engineering units.
_LARGE = 1e-6
#: Lengths of larger bodies: SI size and name.
_LENGTHS = ((1e-6, "µm"), (1e-3, "mm"), (1.0, "m"))
#: A body is at least so many units wide.
_FEWEST = 5.0


@dataclass(frozen=True)
class Units:
    """SI size of each unit, and its name."""

    length: tuple[float, str]
    time: tuple[float, str]
    energy: tuple[float, str]
    force: tuple[float, str]
    stress: tuple[float, str]


ATOMIC = Units(
    (ANGSTROM, "Å"), (PICOSECOND, "ps"), (ELECTRONVOLT, "eV"), (NANONEWTON, "nN"), (GIGAPASCAL, "GPa")
)  # fmt: skip


def units_of(scene: Scene) -> Units:
    """Return the units for a scene: of atoms where there are some or the body is small, else engineering ones."""
    extent = float(np.max(np.subtract(scene.continuum.upper, scene.continuum.lower)))
    if scene.atomistic is not None or extent < _LARGE:
        return ATOMIC
    length = [unit for unit in _LENGTHS if extent >= _FEWEST * unit[0]][-1:] or [_LENGTHS[0]]
    size, name = readable_unit(scene.run.steps * scene.time_step, TIMES)
    return Units(length[0], (size, name.replace("us", "µs")), (1.0, "J"), (1.0, "N"), (1e6, "MPa"))
