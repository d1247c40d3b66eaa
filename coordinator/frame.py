"""Where a sample of atoms lies in the scene: moved, and mirrored where its crack comes from the right."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from coordinator.table import Point
from protocol.arrays import FloatArray


@dataclass(frozen=True)
class Frame:
    """Place of a sample's own origin, and whether its x axis points to the left.

    Attributes
    ----------
    centre : tuple of float
        Origin of the sample in the scene, m.
    mirrored : bool
        x of the scene is centre - x of the sample.
    """

    centre: Point = (0.0, 0.0)
    mirrored: bool = False

    @property
    def sign(self) -> float:
        """1, or -1 where the sample is mirrored."""
        return -1.0 if self.mirrored else 1.0

    def to_scene(self, place: FloatArray) -> FloatArray:
        """Return places of the sample, shape (n, 2 or 3), m, in the scene."""
        return self._moved(place, self.sign)

    def to_sample(self, place: FloatArray) -> FloatArray:
        """Return places of the scene, shape (n, 2 or 3), m, in the sample."""
        found = place - self._origin(place)
        found[:, 0] *= self.sign
        return found

    def turn(self, vectors: FloatArray) -> FloatArray:
        """Return vectors, shape (n, 2 or 3), of one frame in the other; both ways are the same."""
        if not self.mirrored:
            return vectors
        found = vectors.copy()
        found[:, 0] *= -1.0
        return found

    def x_to_scene(self, x: float) -> float:
        """Return an x of the sample in the scene, m."""
        return self.centre[0] + self.sign * x

    def x_to_sample(self, x: float) -> float:
        """Return an x of the scene in the sample, m."""
        return self.sign * (x - self.centre[0])

    def grid_corner(self, lower: Point) -> Point:
        """Return a corner of the grid's cells, given one in the scene, in the sample's frame, m."""
        return self.x_to_sample(lower[0]), lower[1] - self.centre[1]

    def _moved(self, place: FloatArray, sign: float) -> FloatArray:
        found = place.copy()
        found[:, 0] *= sign
        return np.asarray(found + self._origin(place))

    def _origin(self, place: FloatArray) -> FloatArray:
        return np.array([*self.centre, 0.0][: place.shape[1]])
