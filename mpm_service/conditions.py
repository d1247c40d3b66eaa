"""Prescribed motion as a user states it: of the faces of a body, and of grid nodes inside a box."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, Protocol, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .time_functions import Constant, IntegrableTimeFunction, TimeFunction, as_time_function

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

Face = Literal["left", "right", "bottom", "top", "back", "front"]
FACES: tuple[str, ...] = get_args(Face)


def face_axis(face: str) -> int:
    """Direction of a face's normal: 0 (left, right), 1 (bottom, top) or 2 (back, front)."""
    return FACES.index(face) // 2


def face_sign(face: str) -> int:
    """+1 where the outward normal points along the axis (right, top, front), else -1."""
    return 1 if FACES.index(face) % 2 else -1


def _prescribed(
    owner: str,
    times: ArrayLike | None,
    displacements: TimeFunction | ArrayLike | None,
    velocities: TimeFunction | ArrayLike | None,
) -> TimeFunction:
    """Displacement over time, from either way of prescribing it."""
    if (displacements is None) == (velocities is None):
        raise ValueError(f"{owner}.displacements and {owner}.velocities: give one of the two")
    if displacements is not None:
        return as_time_function(owner, "displacements", displacements, times)
    assert velocities is not None
    velocity = as_time_function(owner, "velocities", velocities, times)
    if not callable(getattr(velocity, "integral", None)):
        raise ValueError(
            f"{owner}.velocities: a function of time needs a method integral(time), its exact integral from time 0"
        )
    exact: IntegrableTimeFunction = velocity  # type: ignore[assignment]
    return exact.integral


@dataclass(frozen=True, eq=False)
class EdgeCondition:
    """Motion of one component on one face of the body.

    The condition acts at the moved face: its place is the reference face plus the normal displacement
    prescribed there, however far that is, while the body stays in the grid. Without a prescribed normal
    displacement on that face it acts at the reference face, which is right while the face moves along its
    normal by less than about half a cell. What is not prescribed stays free: a face on rollers has its normal
    component held (see `symmetry`).

    Parameters
    ----------
    edge : {"left", "right", "bottom", "top", "back", "front"}
        Face of the body's bounding box: low and high side in x, y, z.
    component : {0, 1, 2}
        x, y or z of the motion.
    times : (k,) sequence of float, optional
        Strictly increasing [s], for lists of values; linear between entries, held before and after.
    displacements : (k,) sequence of float or TimeFunction, optional
        [m].
    velocities : (k,) sequence of float or IntegrableTimeFunction, optional
        [m/s], instead of displacements; a step moves the face by their exact integral.

    Raises
    ------
    ValueError
        If a value is not allowed, or not exactly one of displacements and velocities is given.
    """

    edge: Face
    component: int
    times: Sequence[float] | FloatArray | None = None
    displacements: Sequence[float] | FloatArray | TimeFunction | None = None
    velocities: Sequence[float] | FloatArray | TimeFunction | None = None
    _function: TimeFunction = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if self.edge not in FACES:
            raise ValueError(f"EdgeCondition.edge = {self.edge!r}: allowed are {', '.join(FACES)}")
        if self.component not in (0, 1, 2):
            raise ValueError(f"EdgeCondition.component = {self.component!r}: allowed are 0 (x), 1 (y) and 2 (z)")
        function = _prescribed("EdgeCondition", self.times, self.displacements, self.velocities)
        object.__setattr__(self, "_function", function)

    @property
    def axis(self) -> int:
        """Direction of the face's normal."""
        return face_axis(self.edge)

    @property
    def sign(self) -> int:
        """+1 where the outward normal points along the axis, else -1."""
        return face_sign(self.edge)

    def displacement(self, time: FloatArray) -> FloatArray:
        """Displacement [m] at the given times [s]."""
        return self._function(time)


class DisplacementField(Protocol):
    """Displacement of all places, with two values on a crack's line; `k_field.CrackTipField` is one."""

    def side(self, position: FloatArray, /) -> IntArray:
        """+1 or -1, the side of the crack's line that reference places (n, 2) lie on, (n,)."""

    def displacement(self, position: FloatArray, side: IntArray | None = None, /) -> FloatArray:
        """Displacement [m] of material of a side at reference places (n, 2) [m], (n, 2)."""


@dataclass(frozen=True, eq=False)
class FieldCondition:
    """Motion of one component on one face of a plane body, by a field times a factor over time.

    Both components of a face are prescribed by fields, or none: the place of the face, which varies along it, follows
    from both. Where a crack cuts the face each of its sides moves with the field of that side.

    Parameters
    ----------
    edge : {"left", "right", "bottom", "top"}
        Face of the body's bounding box.
    component : {0, 1}
        x or y of the motion.
    field : DisplacementField
        At a factor of 1.
    factor : TimeFunction
        Over time.

    Raises
    ------
    ValueError
        If a value is not allowed.
    """

    edge: Face
    component: int
    field: DisplacementField
    factor: TimeFunction

    def __post_init__(self) -> None:
        if self.edge not in FACES[:4]:
            raise ValueError(f"FieldCondition.edge = {self.edge!r}: allowed are {', '.join(FACES[:4])}")
        if self.component not in (0, 1):
            raise ValueError(f"FieldCondition.component = {self.component!r}: allowed are 0 (x) and 1 (y)")

    @property
    def axis(self) -> int:
        """Direction of the face's normal."""
        return face_axis(self.edge)

    @property
    def sign(self) -> int:
        """+1 where the outward normal points along the axis, else -1."""
        return face_sign(self.edge)

    def along_face(self, lower: ArrayLike, upper: ArrayLike, count: int = 200) -> FloatArray:
        """Displacement of the component at so many places along the face of a body, at a factor of 1 [m], (count,)."""
        low, high = np.asarray(lower, np.float64), np.asarray(upper, np.float64)
        place = low + (high - low) * ((np.arange(count) + 0.5) / count)[:, None]
        place[:, self.axis] = (high if self.sign > 0 else low)[self.axis]
        return np.asarray(self.field.displacement(place)[:, self.component])


@dataclass(frozen=True, eq=False)
class Approach:
    """Faces go from where they start to their displacement at time 0, and stay there: for a body to be preloaded.

    Parameters
    ----------
    steps : int
        Steps to get there.
    start : DisplacementField, optional
        Displacement that the body has at the start; none if not given.
    """

    steps: int
    start: DisplacementField | None = None


def symmetry(edge: Face) -> EdgeCondition:
    """Plane of symmetry: the face's normal component held at zero, the others free."""
    if edge not in FACES:
        raise ValueError(f"symmetry edge = {edge!r}: allowed are {', '.join(FACES)}")
    return EdgeCondition(edge, face_axis(edge), displacements=Constant(0.0))


@dataclass(frozen=True, eq=False)
class NodeCondition:
    """Motion of one component on the grid nodes inside a box that is fixed in space.

    For supports of a beam and the like. The nodes stay where they are and the body moves through them, so the
    condition is meant for displacements much smaller than a cell; nodes without material are ignored.

    Parameters
    ----------
    lower, upper : (d,) sequence of float
        Corners of the box [m], its surface included; infinite where it has no bound.
    component : {0, 1, 2}
        x, y or z of the motion.
    times, displacements, velocities
        As in `EdgeCondition`.

    Raises
    ------
    ValueError
        As for `EdgeCondition`, or if the box is turned inside out.
    """

    lower: Sequence[float]
    upper: Sequence[float]
    component: int
    times: Sequence[float] | FloatArray | None = None
    displacements: Sequence[float] | FloatArray | TimeFunction | None = None
    velocities: Sequence[float] | FloatArray | TimeFunction | None = None
    _function: TimeFunction = field(init=False, repr=False)

    def __post_init__(self) -> None:
        lower, upper = np.asarray(self.lower, dtype=np.float64), np.asarray(self.upper, dtype=np.float64)
        if lower.ndim != 1 or lower.shape != upper.shape or not np.all(lower <= upper):
            raise ValueError(
                f"NodeCondition.lower = {self.lower!r} and upper = {self.upper!r}: two corners with lower <= upper "
                "in every direction are needed"
            )
        if self.component not in (0, 1, 2):
            raise ValueError(f"NodeCondition.component = {self.component!r}: allowed are 0 (x), 1 (y) and 2 (z)")
        function = _prescribed("NodeCondition", self.times, self.displacements, self.velocities)
        object.__setattr__(self, "_function", function)

    def displacement(self, time: FloatArray) -> FloatArray:
        """Displacement [m] at the given times [s]."""
        return self._function(time)
