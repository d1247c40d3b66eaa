"""Loads put on the nodal tables, and the work they do.

A traction acts on the faces of points, with the grid functions of the point itself along the face and those of
the grid across it::

         domain of point p
      +-----------+
      |           #    f_I += t A N_I
      |     p     #    N_I: average of the function of node I over the side of the domain
      |           #
      +-----------+

The internal force that a uniform stress puts on the nodes is, by the divergence theorem, the same stress on the
sides of the domains. So a traction that acts there balances it on every node. Placed where the face of the body is
when a domain that does not follow the deformation has fallen behind it, it would leave forces without balance on
nodes that a sliver of a domain reaches, and these have next to no mass.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from .dashpots import Dashpots
from .loads import AbsorbingEdge, BodyForce, FacePlaces, Load, Traction, face_places
from .material_points import columns
from .scheme import Interpolation
from .stencils import add_forces, power_of
from .time_functions import Constant, Schedule, TimeFunction

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

StencilsAt = Callable[[FloatArray, FloatArray, FloatArray], tuple[IntArray, FloatArray, IntArray]]
"""``(position (m, d), half (m, d), reference_position (m, d)) -> node (m, K), weight (m, K), count (m,)``.

Functions of the grid averaged over boxes of the given half sides [m], which may be 0: quadratic B-splines (always
with 0) where the points have them, else linear. A box outside the grid has count 0, and its force is lost.
"""
ScatterPoints = Callable[[IntArray, FloatArray], None]
"""``(rows (m,), force (m, d))``: spread forces on points [N] over the nodes by the points' own functions."""
ReadPoints = Callable[[IntArray, FloatArray], FloatArray]
"""``(rows (m,), velocity (R, d)) -> (m, d)``: nodal velocities read at points by the same functions."""

# A node with less than this share of the heaviest node of a stencil is empty. It is so small because the internal
# force on a sliver falls with the root of its mass only, and the load has to balance it.
_EMPTY = 1e-30


@njit(inline="always")
def _cofactor(f: FloatArray, a: int, b: int) -> float:
    """Entry (a, b) of J F^-T."""
    p, q = (a + 1) % 3, (a + 2) % 3
    r, s = (b + 1) % 3, (b + 2) % 3
    return f[p, r] * f[q, s] - f[p, s] * f[q, r]


@njit(inline="always")
def _read_gradient(rows: FloatArray, row: int, dimension: int, f: FloatArray) -> None:
    for a in range(dimension):
        for b in range(dimension):
            f[a, b] = rows[row, 2 * dimension + a * dimension + b] + (1.0 if a == b else 0.0)


@njit(cache=True, nogil=True)
def place_on_faces(
    rows: FloatArray,
    row_of: IntArray,
    alive: int,
    ids: IntArray,
    reference: FloatArray,
    axis: IntArray,
    point_reference: FloatArray,
    convected: bool,
    reference_half: FloatArray,
    position: FloatArray,
    half: FloatArray,
) -> None:
    """Current centres and half sides of faces on the sides of domains [m]; the reference where a point is lost.

    The side is that whose normal is nearest to the current normal of the face. Domains keep their size, or
    stretch by the norms of the rows of F where they are ``convected``.
    """
    dimension = reference.shape[1]
    f = np.eye(3)
    for i in range(ids.size):
        row = row_of[ids[i]]
        if row >= alive:
            position[i] = reference[i]
            half[i] = reference_half[i]
            continue
        _read_gradient(rows, row, dimension, f)
        normal = axis[i]
        side = 0
        for a in range(1, dimension):
            if abs(_cofactor(f, a, normal)) > abs(_cofactor(f, side, normal)):
                side = a
        for b in range(dimension):
            offset = reference[i, b] - point_reference[ids[i], b]
            if b == normal:
                a = side
                offset *= 1.0 if _cofactor(f, side, normal) > 0.0 else -1.0
            else:
                a = normal if b == side else b
                offset *= 1.0 if f[a, b] >= 0.0 else -1.0
            stretch = 1.0
            if convected:
                stretch = np.sqrt(f[a, 0] ** 2 + f[a, 1] ** 2 + (f[a, 2] ** 2 if dimension == 3 else 0.0))
            position[i, a] = rows[row, a] + stretch * offset
            half[i, a] = stretch * reference_half[i, b]


@njit(cache=True, nogil=True)
def area_vectors(
    rows: FloatArray,
    row_of: IntArray,
    alive: int,
    ids: IntArray,
    axis: IntArray,
    area: FloatArray,
    out: FloatArray,
) -> None:
    """Current area vectors ``J F^-T N A`` [m^2] of reference faces with the normal N along +axis (Nanson)."""
    dimension = out.shape[1]
    f = np.eye(3)
    for i in range(ids.size):
        row = row_of[ids[i]]
        if row >= alive:
            out[i, :] = 0.0
            continue
        _read_gradient(rows, row, dimension, f)
        for a in range(dimension):
            out[i, a] = area[i] * _cofactor(f, a, axis[i])


@njit(cache=True, nogil=True)
def keep_to_material(
    row_of: IntArray,
    alive: int,
    ids: IntArray,
    node: IntArray,
    weight: FloatArray,
    count: IntArray,
    momentum: FloatArray,
) -> None:
    """Give the weights of empty nodes to the others, and no node to places on lost points."""
    for i in range(node.shape[0]):
        if row_of[ids[i]] >= alive:
            count[i] = 0
        heaviest = 0.0
        for k in range(count[i]):
            if weight[i, k] > 0.0:
                heaviest = max(heaviest, momentum[node[i, k], 0])
        total = 0.0
        for k in range(count[i]):
            if not momentum[node[i, k], 0] > _EMPTY * heaviest:
                weight[i, k] = 0.0
            total += weight[i, k]
        for k in range(count[i]):
            weight[i, k] = weight[i, k] / total if total > 0.0 else 0.0


@njit(cache=True, nogil=True)
def _add_weight(listed: IntArray, acceleration: FloatArray, momentum: FloatArray) -> None:
    """Nodal force of a uniform acceleration: ``sum_p m_p a S_Ip = m_I a``."""
    dimension = acceleration.size
    for i in range(listed.size):
        n = listed[i]
        for a in range(dimension):
            momentum[n, 1 + dimension + a] += momentum[n, 0] * acceleration[a]


@njit(cache=True, nogil=True)
def _weight_power(listed: IntArray, acceleration: FloatArray, momentum: FloatArray, velocity: FloatArray) -> float:
    power = 0.0
    for i in range(listed.size):
        n = listed[i]
        for a in range(acceleration.size):
            power += momentum[n, 0] * acceleration[a] * velocity[n, a]
    return power


class LoadSet:
    """All loads of a body.

    A step calls `apply` when internal forces and all other external ones are on the nodes, and `work` when
    the points' new velocities are known. Without loads both return at once.

    Parameters
    ----------
    loads : sequence of Load
    reference_position : (n, d) ndarray
        Reference positions of the points by id [m].
    half : (n,) ndarray
        Half sides of the points by id [m].
    weight : (n,) ndarray
        Share of mass and stiffness of the points by id.
    lower, upper : (d,) ndarray
        Corners of the body [m].
    thickness : float
        Thickness in the plane [m]; 1 in space.
    time_step : float
        [s].
    interpolation : {"ugimp", "linear", "cpgimp", "bspline"}
        Of the scheme: tells how far the domains of points reach.

    Raises
    ------
    ValueError
        If a load does not fit the dimension or finds no point face.
    """

    def __init__(
        self,
        loads: Sequence[Load],
        reference_position: FloatArray,
        half: FloatArray,
        weight: FloatArray,
        lower: FloatArray,
        upper: FloatArray,
        thickness: float,
        time_step: float,
        interpolation: Interpolation = "ugimp",
    ) -> None:
        self.loads = tuple(loads)
        self._dimension = reference_position.shape[1]
        self._reference = reference_position
        self._time_step = float(time_step)
        self._interpolation = interpolation
        functions: list[TimeFunction] = []
        self._places: list[FacePlaces | None] = []
        dampers = []
        for k, load in enumerate(self.loads):
            name = f"loads[{k}]"
            functions.append(Constant(1.0) if isinstance(load, AbsorbingEdge) else load.time_function)
            if isinstance(load, BodyForce):
                if not callable(load.acceleration):
                    self._check_vector(f"{name}.acceleration", np.asarray(load.acceleration))
                self._places.append(None)
                continue
            region = None
            if isinstance(load, Traction):
                self._check_vector(f"{name}.vector", np.asarray(load.vector))
                region = load.region
            places = face_places(name, load.face, reference_position, half, lower, upper, thickness, region)
            self._places.append(places)
            if isinstance(load, AbsorbingEdge):
                share = places.area * weight[places.ids]
                dampers.append(share[:, None] * load.impedance(self._dimension))
        self._schedule = Schedule(functions, [f"loads[{k}].time_function" for k in range(len(self.loads))], time_step)
        absorbing = [p for p, load in zip(self._places, self.loads, strict=True) if isinstance(load, AbsorbingEdge)]
        self._dashpots = Dashpots([p for p in absorbing if p is not None], dampers) if absorbing else None
        self._acting: list[tuple[IntArray, FloatArray, IntArray, FloatArray] | FloatArray | None] = []

    def set_points(self, reference_position: FloatArray) -> None:
        """Take over the reference positions by id [m] after points were split.

        The piece that keeps the id of its parent also keeps the loaded face: its place follows from the
        reference position of the piece.
        """
        self._reference = reference_position

    def apply(
        self,
        step: int,
        rows: FloatArray,
        row_of: IntArray,
        alive: int,
        momentum: FloatArray,
        listed: Sequence[IntArray],
        stencils_at: StencilsAt,
        scatter_points: ScatterPoints,
    ) -> None:
        """Add the loads at the start of a step to the nodal forces.

        Parameters
        ----------
        step : int
            Steps made so far.
        rows, row_of, alive
            Point table, row of each id, rows that live.
        momentum : (R, 1 + 2 d) ndarray
            Nodal mass, momentum, force; the forces are added to.
        listed : sequence of (m,) ndarray of int
            Rows of nodes that may carry mass: of the grid, of extra velocity fields.
        stencils_at : callable
            See `StencilsAt`.
        scatter_points : callable
            Spreads forces on points; used by body forces that are fields.

        Raises
        ------
        ValueError
            If a field or a time function gives a bad value, or points were split without `set_points`.
        """
        if not self.loads:
            return
        if row_of.size != self._reference.shape[0]:
            raise ValueError(f"loads know of {self._reference.shape[0]} points, there are {row_of.size}: set_points")
        factor = self._schedule.now(step)
        self._acting = []
        for k, load in enumerate(self.loads):
            places = self._places[k]
            if isinstance(load, BodyForce):
                self._acting.append(
                    self._apply_field(load, factor[k], step, rows, alive, scatter_points)
                    if callable(load.acceleration)
                    else self._apply_weight(load, factor[k], momentum, listed)
                )
            elif isinstance(load, Traction) and places is not None and factor[k] != 0.0:
                node, weight, count = self._stencils(places, rows, row_of, alive, momentum, stencils_at)
                if load.follower:
                    force = np.empty_like(places.reference)
                    area_vectors(rows, row_of, alive, places.ids, places.axis, places.area, force)
                    force *= factor[k] * float(np.asarray(load.vector)[places.axis[0]])
                else:
                    force = places.area[:, None] * (factor[k] * np.asarray(load.vector))
                add_forces(node, weight, count, force, momentum)
                self._acting.append((node, weight, count, force))
            else:
                self._acting.append(None)
        if self._dashpots is not None:
            stencils = self._stencils(self._dashpots.places, rows, row_of, alive, momentum, stencils_at)
            self._dashpots.apply(stencils, momentum, self._time_step)

    def power(
        self, velocity: FloatArray, momentum: FloatArray, listed: Sequence[IntArray], read_points: ReadPoints
    ) -> FloatArray:
        """Power of each load on nodes of given velocities [W], (loads,).

        Parameters
        ----------
        velocity : (R, d) ndarray
            [m/s]; with the means of old and new ones, power times the time step is the work of the step.
        momentum, listed
            As in `apply`.
        read_points : callable
            Reads nodal velocities at points; used by body forces that are fields.
        """
        power = np.zeros(len(self.loads))
        edge = 0
        for k, load in enumerate(self.loads):
            if isinstance(load, AbsorbingEdge):
                assert self._dashpots is not None
                power[k] = self._dashpots.power(edge, velocity)
                edge += 1
                continue
            acting = self._acting[k]
            if isinstance(acting, tuple):
                node, weight, count, force = acting
                power[k] = power_of(node, weight, count, force, velocity)
            elif acting is not None and acting.ndim == 1:
                power[k] = sum(_weight_power(part, acting, momentum, velocity) for part in listed)
            elif acting is not None:
                power[k] = float(np.sum(acting * read_points(np.arange(len(acting)), velocity)))
        return power

    def _check_vector(self, name: str, vector: FloatArray) -> None:
        if vector.shape != (self._dimension,):
            raise ValueError(f"{name} = {vector.tolist()}: {self._dimension} numbers are needed")

    def _apply_weight(
        self, load: BodyForce, factor: float, momentum: FloatArray, listed: Sequence[IntArray]
    ) -> FloatArray:
        acceleration = factor * np.asarray(load.acceleration, dtype=np.float64)
        for part in listed:
            _add_weight(part, acceleration, momentum)
        return acceleration

    def _apply_field(
        self,
        load: BodyForce,
        factor: float,
        step: int,
        rows: FloatArray,
        alive: int,
        scatter_points: ScatterPoints,
    ) -> FloatArray:
        assert callable(load.acceleration)
        position = np.ascontiguousarray(rows[:alive, : self._dimension])
        acceleration = np.asarray(load.acceleration(position, step * self._time_step), dtype=np.float64)
        if acceleration.shape != position.shape or not np.all(np.isfinite(acceleration)):
            raise ValueError(
                f"BodyForce.acceleration: a field must return finite values of shape {position.shape}, got shape "
                f"{acceleration.shape}"
            )
        force = factor * acceleration * rows[:alive, columns(self._dimension).mass, None]
        scatter_points(np.arange(alive, dtype=np.int64), force)
        return force

    def _stencils(
        self,
        places: FacePlaces,
        rows: FloatArray,
        row_of: IntArray,
        alive: int,
        momentum: FloatArray,
        stencils_at: StencilsAt,
    ) -> tuple[IntArray, FloatArray, IntArray]:
        position = np.empty_like(places.reference)
        half = np.empty_like(places.half)
        place_on_faces(
            rows,
            row_of,
            alive,
            places.ids,
            places.reference,
            places.axis,
            self._reference,
            self._interpolation == "cpgimp",
            places.half,
            position,
            half,
        )
        if self._interpolation in ("linear", "bspline"):
            half[:] = 0.0
        node, weight, count = stencils_at(position, half, places.reference)
        keep_to_material(row_of, alive, places.ids, node, weight, count, momentum)
        return node, weight, count
