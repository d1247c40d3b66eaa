"""Failure of a running material point computation."""

from __future__ import annotations


class SolverError(RuntimeError):
    """A run that cannot go on: a velocity that is not finite or runs away.

    Parameters
    ----------
    message : str
        Names quantity, particle, place, step and the likely knob.
    step : int
        Step during which the failure was seen.
    point : int
        Stable id of the material point.
    position : tuple of float
        Place of the point at the start of that step [m].
    """

    def __init__(self, message: str, step: int, point: int, position: tuple[float, float]) -> None:
        super().__init__(message)
        self.step = step
        self.point = point
        self.position = position
