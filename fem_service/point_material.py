"""What a laminate asks of its material: stress, new state and tangent at many points, all in the axes of the ply."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class PointState:
    """Damage and history of points; the laminate carries it, whoever answers.

    Attributes
    ----------
    failed : ndarray of uint8, shape (points, bytes)
        What has failed for good; bits are only ever added.
    history : ndarray of float, shape (points, values)
    """

    failed: NDArray[np.uint8]
    history: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PointAnswer:
    """Answer for many points.

    Attributes
    ----------
    stress : ndarray of float, shape (points, 6)
        Pa.
    state : PointState
        After the step.
    index : ndarray of int64, shape (points,)
        Row of `tangents` for each point.
    tangents : ndarray of float, shape (tangents, 6, 6)
        Pa.
    """

    stress: NDArray[np.float64]
    state: PointState
    index: NDArray[np.int64]
    tangents: NDArray[np.float64]


class PointMaterial(Protocol):
    """A material at many points.

    Attributes
    ----------
    softens : bool
        Whether its history is damage that only grows, and its tangents are secant stiffnesses where it does.
    """

    @property
    def softens(self) -> bool:
        """See the class."""

    def fresh(self, points: int) -> PointState:
        """State of points that have never been loaded."""

    def intact(self, points: int) -> PointAnswer:
        """Answer without strain of points that have never been loaded and of which nothing fails."""

    def respond(
        self, strain: NDArray[np.float64], state: PointState, element_length: NDArray[np.float64]
    ) -> PointAnswer:
        """Answer to strains, shape (points, 6), from a state; `element_length`, shape (points,), is in m."""


class ElasticMaterial:
    """A linear elastic material.

    Parameters
    ----------
    stiffness : ndarray of float, shape (6, 6)
        Pa; order 11, 22, 33, 23, 13, 12, engineering shear, axis 1 along the fibre.
    """

    softens = False

    def __init__(self, stiffness: NDArray[np.float64]) -> None:
        self.stiffness = np.ascontiguousarray(stiffness, dtype=np.float64)

    def fresh(self, points: int) -> PointState:
        """No state at all."""
        return PointState(np.zeros((points, 0), dtype=np.uint8), np.zeros((points, 0)))

    def intact(self, points: int) -> PointAnswer:
        """No stress."""
        return self.respond(np.zeros((points, 6)), self.fresh(points), np.zeros(points))

    def respond(
        self, strain: NDArray[np.float64], state: PointState, element_length: NDArray[np.float64]
    ) -> PointAnswer:
        """Hooke's law."""
        index = np.zeros(len(strain), dtype=np.int64)
        return PointAnswer(strain @ self.stiffness, state, index, self.stiffness[None])
