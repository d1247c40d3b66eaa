"""Loads on a body as a user states them: body force, tractions on its faces, dashpots that let waves leave."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .conditions import FACES, Face, face_axis, face_sign
from .time_functions import Constant, TimeFunction

FloatArray = NDArray[np.float64]
Field = Callable[[FloatArray, float], FloatArray]
"""Acceleration [m/s^2] (n, d) at the current positions [m] (n, d) of points and a time [s]."""
ALWAYS = Constant(1.0)
Box = tuple[Sequence[float], Sequence[float]]


def _vector(name: str, value: ArrayLike) -> FloatArray:
    vector = np.array(value, dtype=np.float64)
    if vector.shape not in ((2,), (3,)) or not np.all(np.isfinite(vector)):
        raise ValueError(f"{name} = {value!r}: two or three finite numbers are needed")
    return vector


def _check_face(owner: str, face: str) -> None:
    if face not in FACES:
        raise ValueError(f"{owner}.face = {face!r}: allowed are {', '.join(FACES)}")


@dataclass(frozen=True, eq=False)
class BodyForce:
    """Force per mass on the whole body.

    Parameters
    ----------
    acceleration : (d,) sequence of float or callable
        [m/s^2]. A callable is a field: it takes the current positions (n, d) [m] of the points and the time
        [s], and returns their accelerations (n, d).
    time_function : TimeFunction
        Factor over time.
    """

    acceleration: Sequence[float] | FloatArray | Field
    time_function: TimeFunction = ALWAYS

    def __post_init__(self) -> None:
        if not callable(self.acceleration):
            object.__setattr__(self, "acceleration", _vector("BodyForce.acceleration", self.acceleration))


@dataclass(frozen=True, eq=False)
class Traction:
    """Traction on the faces of points that form a face of the body at the start.

    A dead load: its force is the traction times the reference area, whatever the body does. As a follower it
    is a pressure: the force on an area is ``J F^-T N A`` times it (Nanson), so it keeps normal to the face and
    grows with it. In the plane the area is that of the reference thickness. Weights of points (`Overlap`) do
    not scale tractions. The force acts on that side of the domain of each point that the face has turned to:
    there the internal forces of a uniform stress end, so it balances them node by node.

    Parameters
    ----------
    face : {"left", "right", "bottom", "top", "back", "front"}
        Face of the body's bounding box.
    vector : (d,) sequence of float
        [Pa]. Along the face's normal for a follower: outward pulls, inward presses.
    time_function : TimeFunction
        Factor over time.
    follower : bool
        Keep normal to the moving face.
    region : (lower, upper), optional
        Box in the reference state [m] that bounds the loaded part; point faces across its surface carry the
        share inside.

    Raises
    ------
    ValueError
        If a value is not allowed, or a follower has a tangential part.
    """

    face: Face
    vector: Sequence[float] | FloatArray
    time_function: TimeFunction = ALWAYS
    follower: bool = False
    region: Box | None = None

    def __post_init__(self) -> None:
        _check_face("Traction", self.face)
        vector = _vector("Traction.vector", self.vector)
        object.__setattr__(self, "vector", vector)
        axis = face_axis(self.face)
        if axis >= vector.size:
            raise ValueError(f"Traction.vector = {self.vector!r}: three numbers are needed on face {self.face!r}")
        if self.follower and np.any(np.delete(vector, axis) != 0.0):
            raise ValueError(
                f"Traction.vector = {vector.tolist()} Pa: a follower is normal to its face, {self.face!r} "
                f"allows component {axis} only"
            )
        if self.region is not None:
            lower, upper = (_vector(f"Traction.region[{i}]", corner) for i, corner in enumerate(self.region))
            if lower.shape != vector.shape or upper.shape != vector.shape or not np.all(lower <= upper):
                raise ValueError(
                    f"Traction.region = {self.region!r}: two corners of {vector.size} numbers with lower <= upper in "
                    "every direction are needed"
                )


class WaveMaterial(Protocol):
    """What an absorbing edge reads of a material."""

    @property
    def density(self) -> float:
        """[kg/m^3]."""

    @property
    def pressure_wave_speed(self) -> float:
        """[m/s]."""

    @property
    def shear_modulus(self) -> float:
        """[Pa]."""


@dataclass(frozen=True)
class AbsorbingEdge:
    """Dashpots on a face that take up waves: traction ``-rho c_p v_n n - rho c_s v_t``.

    Exact for plane waves at normal incidence, but for what the grid disperses. At an angle of incidence of 15,
    30, 45, 60, 75 degrees a pressure wave of unit displacement in a solid of Poisson's ratio 0.3 leaves
    reflected pressure waves of 0.003, 0.001, 0.043, 0.17, 0.44 and shear waves of 0.004, 0.020, 0.072, 0.12, 0.11.
    What the grid leaves of the amplitude at normal incidence, with uGIMP and MUSL at Courant number 0.4, for wave
    packets of 40 and 20 cells: 1.1 and 2.0 % with FMPM(2), 0.5 and 2.0 % with FLIP; about twice that where the
    face lies between grid lines. Normals are those of the reference state. The face drifts under a constant
    force: nothing holds it.

    The force of a step is the mean over that step of dashpots that act on the nodes, in closed form
    (an exponential), so they never limit the time step.

    Parameters
    ----------
    face : {"left", "right", "bottom", "top", "back", "front"}
        Face of the body's bounding box.
    density : float
        [kg/m^3]; where points have a weight it counts here too, as it scales stiffness and mass.
    pressure_wave_speed, shear_wave_speed : float
        [m/s]. For a bar with free sides the speed of its waves is sqrt(E / rho).

    References
    ----------
    Lysmer and Kuhlemeyer, J. Eng. Mech. Div. ASCE 95 (1969) 859.
    """

    face: Face
    density: float
    pressure_wave_speed: float
    shear_wave_speed: float

    def __post_init__(self) -> None:
        _check_face("AbsorbingEdge", self.face)
        for name in ("density", "pressure_wave_speed", "shear_wave_speed"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0.0):
                raise ValueError(f"AbsorbingEdge.{name} = {value!r}: must be finite and not negative")

    @classmethod
    def of(cls, face: Face, material: WaveMaterial) -> AbsorbingEdge:
        """Edge matched to the bulk waves of a material."""
        shear = float(np.sqrt(material.shear_modulus / material.density))
        return cls(face, material.density, material.pressure_wave_speed, shear)

    def impedance(self, dimension: int) -> FloatArray:
        """Impedance in each direction [Pa s/m], (d,)."""
        impedance = np.full(dimension, self.density * self.shear_wave_speed)
        impedance[face_axis(self.face)] = self.density * self.pressure_wave_speed
        return impedance


Load = BodyForce | Traction | AbsorbingEdge


@dataclass(frozen=True)
class FacePlaces:
    """Faces of points that form a face of the body, or the parts of them that are loaded.

    Attributes
    ----------
    ids : (m,) ndarray of int
        Stable id of the point each belongs to.
    reference : (m, d) ndarray
        Centres in the reference state [m].
    half : (m, d) ndarray
        Half sides [m], 0 along the normal.
    area : (m,) ndarray
        Reference areas [m^2].
    axis : (m,) ndarray of int
        Direction of the normal in the reference state.
    """

    ids: NDArray[np.int64]
    reference: FloatArray
    half: FloatArray
    area: FloatArray
    axis: NDArray[np.int64]


# A point face this close to the body's face, in half sides of the point, is part of it.
_FACE_TOLERANCE = 1e-6


def face_places(
    owner: str,
    face: Face,
    position: FloatArray,
    half: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    thickness: float,
    region: Box | None = None,
) -> FacePlaces:
    """Find the point faces on a face of the body.

    Parameters
    ----------
    owner : str
        What an error calls the load.
    face : str
        Face of the body.
    position : (n, d) ndarray
        Reference positions of the points [m].
    half : (n,) ndarray
        Half sides of the points [m].
    lower, upper : (d,) ndarray
        Corners of the body [m].
    thickness : float
        Thickness in the plane [m]; 1 in space.
    region : (lower, upper), optional
        Box the faces are cut to [m].

    Raises
    ------
    ValueError
        If the face does not exist in this dimension, or no point face lies on it and in the region.
    """
    dimension = position.shape[1]
    axis, sign = face_axis(face), face_sign(face)
    if axis >= dimension:
        raise ValueError(f"{owner}.face = {face!r}: allowed in the plane are {', '.join(FACES[:4])}")
    level = float((upper if sign > 0 else lower)[axis])
    on_face = np.abs(position[:, axis] + sign * half - level) <= _FACE_TOLERANCE * half
    ids = np.flatnonzero(on_face)
    low = position[ids] - half[ids, None]
    high = position[ids] + half[ids, None]
    reaches = True
    if region is not None:
        box = np.asarray(region, dtype=np.float64)
        low, high = np.maximum(low, box[0]), np.minimum(high, box[1])
        slack = _FACE_TOLERANCE * float(half.max())
        reaches = bool(box[0, axis] <= level + slack and box[1, axis] >= level - slack)
    along = [b for b in range(dimension) if b != axis]
    inside = reaches & np.all(high[:, along] > low[:, along], axis=1)
    if not np.any(inside):
        where = "" if region is None else f" in region {region!r} m"
        raise ValueError(f"{owner}: no material point has a face on the body's {face} face{where}")
    ids, low, high = ids[inside], low[inside], high[inside]
    area = np.prod(high[:, along] - low[:, along], axis=1) * (thickness if dimension == 2 else 1.0)
    low[:, axis] = high[:, axis] = level
    return FacePlaces(
        ids.astype(np.int64),
        np.ascontiguousarray(0.5 * (low + high)),
        np.ascontiguousarray(0.5 * (high - low)),
        area,
        np.full(ids.size, axis, dtype=np.int64),
    )
