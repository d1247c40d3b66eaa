"""Places of a laminate where the microstructure is watched: strain, stress and the stress of each subcell."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import h5py
import numpy as np

from protocol.arrays import FloatArray, IntArray
from protocol.micromechanics import RegisterCell
from protocol.structure import StructureAdvanced, StructureConfigured


@dataclass(eq=False)
class WatchedPlaces:
    """What was seen in some bricks after every increment, mean of the points of each brick.

    Attributes
    ----------
    bricks : int64 array, shape (watched,)
    centres : float64 array, shape (watched, 3)
        Middle of each brick, m.
    angles : float64 array, shape (watched,)
        Of the plies they lie in, degrees.
    plies : int64 array, shape (watched,)
        From 0.
    materials : int64 array, shape (subcells,)
        Material of each subcell.
    shares : float64 array, shape (subcells,)
        Of each subcell in the area of the cell.
    strain, stress : list of float64 array, shape (watched, 6)
        After each increment in the axes of the ply, 11, 22, 33, 23, 13, 12; Pa.
    subcells : list of float64 array, shape (watched, subcells, 6)
        Stress, Pa.
    """

    bricks: IntArray
    centres: FloatArray
    angles: FloatArray
    plies: IntArray
    materials: IntArray
    shares: FloatArray
    strain: list[FloatArray] = field(default_factory=list)
    stress: list[FloatArray] = field(default_factory=list)
    subcells: list[FloatArray] = field(default_factory=list)

    @classmethod
    def near(
        cls,
        places: list[tuple[float, float, int]],
        built: StructureConfigured,
        angles: FloatArray,
        cell: RegisterCell,
    ) -> WatchedPlaces:
        """Take the bricks nearest to places.

        Parameters
        ----------
        places : list of (x, y, ply)
            m, and the ply from 0.
        built : StructureConfigured
        angles : float64 array, shape (plies,)
            degrees.
        cell : RegisterCell
        """
        centres = built.nodes[built.bricks].mean(axis=1)
        bricks = []
        for x, y, ply in places:
            own = np.flatnonzero(built.ply == ply)
            # Of several bricks through a ply the lowest.
            bricks.append(int(own[np.argmin(np.hypot(centres[own, 0] - x, centres[own, 1] - y))]))
        chosen = np.array(bricks, dtype=np.int64)
        area = np.outer(cell.heights, cell.widths).reshape(-1)
        return cls(
            bricks=chosen,
            centres=centres[chosen],
            angles=angles[built.ply[chosen]],
            plies=built.ply[chosen],
            materials=cell.phase.reshape(-1).copy(),
            shares=area / area.sum(),
        )

    def note(self, made: StructureAdvanced) -> None:
        """Take what an increment has answered."""
        if made.watched_strain is None or made.watched_stress is None or made.watched_subcells is None:
            return
        self.strain.append(made.watched_strain)
        self.stress.append(made.watched_stress)
        self.subcells.append(made.watched_subcells)

    def cut(self, increments: int) -> None:
        """Drop what lies after so many increments."""
        for values in (self.strain, self.stress, self.subcells):
            del values[increments:]

    def strain_along_pull(self, place: int) -> FloatArray:
        """Strain along x at one of the places, shape (increments,)."""
        c, s = _direction(self.angles[place])
        return np.array([e[place] @ [c * c, s * s, 0.0, 0.0, 0.0, -c * s] for e in self.strain])

    def stress_along_pull(self, place: int) -> tuple[FloatArray, FloatArray]:
        """Stress along x at one of the places: macroscopic, shape (increments,), and (increments, subcells); Pa."""
        c, s = _direction(self.angles[place])
        turn = np.array([c * c, s * s, 0.0, 0.0, 0.0, -2.0 * c * s])
        macro = np.array([row[place] @ turn for row in self.stress])
        return macro, np.array([row[place] @ turn for row in self.subcells]).reshape(len(macro), -1)

    def write(self, group: h5py.Group) -> None:
        """Write into a group of the results file."""
        for name in _FIXED:
            group[name] = getattr(self, name)
        for name in _GROWING:
            rows = getattr(self, name)
            group[name] = np.stack(rows) if rows else np.zeros((0, 0))

    @classmethod
    def read(cls, group: h5py.Group) -> WatchedPlaces:
        """Read what `write` wrote."""
        values: dict[str, Any] = {name: group[name][:] for name in _FIXED}
        values |= {name: list(group[name][:]) for name in _GROWING}
        return cls(**values)


_FIXED = ("bricks", "centres", "angles", "plies", "materials", "shares")
_GROWING = ("strain", "stress", "subcells")


def _direction(angle: float) -> tuple[float, float]:
    """Cosine and sine of an angle in degrees."""
    return float(np.cos(np.radians(angle))), float(np.sin(np.radians(angle)))
