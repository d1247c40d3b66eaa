"""Energy release rate and stress intensities at a crack tip, from the material points alone.

Everything is taken in the reference state: P the first Piola-Kirchhoff stress, H = F - I, W and T the strain and
kinetic energy per reference volume, rho0 the reference density, a the acceleration. A virtual extension of the
crack, the field ``theta = q e``, has q = 1 around the tip, 0 from the ring's outer radius on, and e along the crack::

    J = int [ (H_jk P_ji - (W + T) delta_ki) theta_k,i + rho0 (a_j H_jk - v_j V_jk) theta_k ] dV0 / thickness

with ``V = dH/dt``. This is the flux of energy into the tip for any hyperelastic material and any rotation, and the
small-strain form where H is small. Only points inside the ring count for the first term, all within it for the
second; the sum over the points is the quadrature, and a smooth q makes it a good one.

Faces without traction add nothing, since theta runs along them. Closed faces that press on each other add nothing
either while nothing slides (the crack is straight there, and the pressure is the same on both); the work of
friction on sliding faces inside the ring is left out, so J is then that of the ring, not of the tip. Body forces
inside the ring, interface cells among them, are left out likewise.
"""

from __future__ import annotations

import warnings
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]

#: Radii of the ring that measures J unless others are stated [cells]. See `verification.edge_crack`.
RING = (2.0, 6.0)
#: Closure length of `vcct` unless another is stated [cells].
CLOSURE = 5.0
# Share of the ring's area, weighted by q, that the points must cover, and how exactly.
_COVER = 0.01
# Points of the ring whose sizes differ by more than this factor belong to different levels.
_SAME_SIZE = 1.5


class PointState(Protocol):
    """What is read of the material points; `PointView` has it."""

    @property
    def alive(self) -> NDArray[np.bool_]: ...
    @property
    def reference_position(self) -> FloatArray: ...
    @property
    def displacement_gradient(self) -> FloatArray: ...
    @property
    def kirchhoff_stress(self) -> FloatArray: ...
    @property
    def strain_energy(self) -> FloatArray: ...
    @property
    def velocity(self) -> FloatArray: ...
    @property
    def mass(self) -> FloatArray: ...
    @property
    def reference_volume(self) -> FloatArray: ...
    @property
    def weight(self) -> FloatArray: ...
    @property
    def stiffness(self) -> FloatArray: ...


class TipFrame(NamedTuple):
    """A crack tip in the reference state."""

    position: FloatArray
    """(2,) [m]"""
    direction: FloatArray
    """(2,) unit vector along the crack, out of it."""

    def local(self, position: FloatArray) -> FloatArray:
        """Coordinates along the crack and to its left, from the tip [m], (n, 2)."""
        return np.ascontiguousarray((position - self.position) @ self.axes.T)

    @property
    def axes(self) -> FloatArray:
        """Rows: the direction, and the normal to its left, (2, 2)."""
        t = self.direction
        return np.array([[t[0], t[1]], [-t[1], t[0]]])


class FractureFields(NamedTuple):
    """Points within reach of a tip, per unit thickness, in the reference state.

    In an overlap a point stands for all the material there, what the atoms carry too: energy, mass and area are those
    of the whole, not the point's share of them.

    Displacements are counted from the body turned by the points' mean rotation R: the gradient is ``R^T F - I``, the
    stress ``R^T P``, and so on. Nothing measured here depends on R, but with a gradient of order one the sums over
    points would lose the small difference that matters.
    """

    position: FloatArray
    """(n, 2) [m]"""
    gradient: FloatArray
    """(n, 2, 2) H = F - I."""
    stress: FloatArray
    """(n, 2, 2) first Piola-Kirchhoff stress P_ji, force component j on the plane normal to i [Pa]."""
    energy: FloatArray
    """(n,) strain energy over thickness [J/m]."""
    velocity: FloatArray
    """(n, 2) [m/s]"""
    mass: FloatArray
    """(n,) mass over thickness [kg/m]."""
    area: FloatArray
    """(n,) reference area [m^2]."""
    rotation: FloatArray
    """(2, 2) mean rotation of the points, which has been taken out of all vectors and tensors above."""


class Rates(NamedTuple):
    """Time derivatives at the points of `FractureFields`."""

    acceleration: FloatArray
    """(n, 2) [m/s^2]"""
    gradient_rate: FloatArray
    """(n, 2, 2) [1/s]"""


class Intensities(NamedTuple):
    """Stress intensity factors [Pa sqrt(m)]."""

    opening: float
    """K_I"""
    sliding: float
    """K_II, positive where the left face moves ahead (along the direction) of the right one."""


def fields_around(points: PointState, thickness: float, centre: ArrayLike, radius: float) -> FractureFields:
    """Gather the points within a radius of a place in the reference state.

    Parameters
    ----------
    points : PointView
        Points of a plane solver.
    thickness : float
        Of the body [m].
    centre : (2,) array_like
        Reference place [m].
    radius : float
        [m]

    Returns
    -------
    FractureFields
        In order of id, so that two gatherings of one place differ by time alone (while no point is split).

    Raises
    ------
    ValueError
        If there is no point.
    """
    place = points.reference_position
    near = np.flatnonzero(points.alive & (np.hypot(*(place - np.asarray(centre, dtype=np.float64)).T) <= radius))
    gradient = points.displacement_gradient[near]
    volume = points.reference_volume[near] / points.stiffness[near]
    if near.size == 0:
        raise ValueError(f"no material point within {radius:.6g} m of {np.asarray(centre).tolist()} m")
    deformation = np.eye(2) + gradient
    rotation = _rotation(np.average(deformation, axis=0, weights=volume))
    tau = points.kirchhoff_stress[near]
    kirchhoff = np.stack([tau[:, [0, 2]], tau[:, [2, 1]]], axis=1)
    # P = tau F^-T
    first = np.linalg.solve(deformation, kirchhoff.transpose(0, 2, 1)).transpose(0, 2, 1)
    back = rotation.T
    return FractureFields(
        np.ascontiguousarray(place[near]),
        back @ gradient + (back - np.eye(2)),
        np.ascontiguousarray(back @ first),
        points.strain_energy[near] / (points.stiffness[near] * thickness),
        np.ascontiguousarray(points.velocity[near] @ rotation),
        points.mass[near] / (points.weight[near] * thickness),
        volume / thickness,
        rotation,
    )


def _rotation(deformation: FloatArray) -> FloatArray:
    """Return the rotation of a plane deformation gradient (2, 2)."""
    angle = np.arctan2(deformation[1, 0] - deformation[0, 1], deformation[0, 0] + deformation[1, 1])
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def rates_between(before: FractureFields, after: FractureFields, seconds: float) -> Rates:
    """Rates from two gatherings of the same points, `seconds` apart.

    Raises
    ------
    ValueError
        If they are not of the same points, or the time is not positive.
    """
    if not seconds > 0.0:
        raise ValueError(f"seconds = {seconds!r}: must be above 0")
    if before.position.shape != after.position.shape or not np.array_equal(before.position, after.position):
        raise ValueError("before and after: gathered from different points")
    turn = after.rotation.T @ before.rotation
    # The rates of R F - 1 are those of F: what the former gradient was counted from is the same body.
    former = turn @ before.gradient + (turn - np.eye(2))
    return Rates((after.velocity - before.velocity @ turn.T) / seconds, (after.gradient - former) / seconds)


def _plateau(distance: FloatArray, inner: float, outer: float) -> tuple[FloatArray, FloatArray]:
    """q and dq/dr of the distance: 1 up to inner, a cubic to 0 at outer."""
    t = np.clip((distance - inner) / (outer - inner), 0.0, 1.0)
    return 1.0 - t * t * (3.0 - 2.0 * t), -6.0 * t * (1.0 - t) / (outer - inner)


def _along_crack(position: FloatArray, line: FloatArray, direction: FloatArray, blend: float) -> FloatArray:
    """Unit vectors e at the places, (n, 2): tangents of the crack's segments, the nearest ones foremost.

    ``line`` (k, 2) runs from the tip backwards. On a segment e is along it, up to the width ``blend`` of corners.
    """
    total = np.zeros_like(position)
    for g in range(line.shape[0] - 1):
        a, b = line[g], line[g + 1]
        tangent = a - b
        size = np.hypot(*tangent)
        share = np.clip(
            (position - b) @ tangent / size**2, 0.0, None if g == 0 else 1.0
        )  # the first one goes on ahead of the tip
        away = position - b - share[:, None] * tangent
        total += (tangent / size) / (np.sum(away * away, axis=1) + blend**2)[:, None] ** 2
    size = np.hypot(*total.T)
    return np.where(size[:, None] > 0.0, total / np.where(size > 0.0, size, 1.0)[:, None], direction)


def _extension(
    fields: FractureFields, tip: TipFrame, inner: float, outer: float, line: FloatArray | None
) -> tuple[FloatArray, FloatArray]:
    """theta (n, 2) and its gradient theta_k,i (n, 2, 2) [1/m]."""
    away = fields.position - tip.position
    distance = np.hypot(*away.T)
    q, slope = _plateau(distance, inner, outer)
    towards = away / np.where(distance > 0.0, distance, 1.0)[:, None]
    if line is None:
        e = np.broadcast_to(tip.direction, fields.position.shape)
        return q[:, None] * e, slope[:, None, None] * e[:, :, None] * towards[:, None, :]
    blend = 0.5 * float(np.sqrt(np.median(fields.area)))
    e = _along_crack(fields.position, line, tip.direction, blend)
    gradient = slope[:, None, None] * e[:, :, None] * towards[:, None, :]
    step = 1e-3 * blend
    for i, shift in enumerate(step * np.eye(2)):
        ahead = _along_crack(fields.position + shift, line, tip.direction, blend)
        behind = _along_crack(fields.position - shift, line, tip.direction, blend)
        gradient[:, :, i] += q[:, None] * (ahead - behind) / (2.0 * step)
    return q[:, None] * e, gradient


def _check_ring(fields: FractureFields, tip: TipFrame, inner: float, outer: float, others: ArrayLike | None) -> None:
    if not 0.0 <= inner < outer:
        raise ValueError(f"inner = {inner!r}, outer = {outer!r}: 0 <= inner < outer [m] is needed")
    distance = np.hypot(*(fields.position - tip.position).T)
    q, _ = _plateau(distance, inner, outer)
    covered = float(q @ fields.area)
    r = np.linspace(0.0, outer, 2001)
    whole = float(np.trapezoid(_plateau(r, inner, outer)[0] * r, r) * 2.0 * np.pi)
    if not abs(covered / whole - 1.0) <= _COVER:
        raise ValueError(
            f"outer = {outer:.6g} m: the ring around the tip ({tip.position[0]:.9g}, {tip.position[1]:.9g}) m does not "
            f"lie in the body (points fill {covered / whole:.1%} of it); a smaller ring is needed, or smaller cells"
        )
    inside = distance < outer
    size = fields.area[inside]
    if size.max() > _SAME_SIZE * size.min():
        warnings.warn(
            f"the ring of {outer:.6g} m around the tip ({tip.position[0]:.9g}, {tip.position[1]:.9g}) m holds points "
            "of different size: J is less exact across a level border",
            stacklevel=3,
        )
    for place in np.zeros((0, 2)) if others is None else np.asarray(others, dtype=np.float64).reshape(-1, 2):
        if 0.0 < np.hypot(*(place - tip.position)) < outer:
            raise ValueError(
                f"outer = {outer:.6g} m: another crack tip, at ({place[0]:.9g}, {place[1]:.9g}) m, lies in the ring "
                f"around the tip ({tip.position[0]:.9g}, {tip.position[1]:.9g}) m; a smaller ring is needed"
            )


def j_integral(
    fields: FractureFields,
    tip: TipFrame,
    inner: float,
    outer: float,
    rates: Rates | None = None,
    line: ArrayLike | None = None,
    other_tips: ArrayLike | None = None,
) -> float:
    """Dynamic J-integral over a ring of points.

    Parameters
    ----------
    fields : FractureFields
        All points within `outer` of the tip.
    tip : TipFrame
        Tip in the reference state.
    inner, outer : float
        Radii of the ring [m]. Two cells or more inside, four or more across keep its scatter below 0.5 %.
    rates : Rates, optional
        For the inertia of the ring's inside; left out, the body is taken to be at rest.
    line : (k, 2) array_like, optional
        Corners of the crack from the tip backwards, as far as the ring reaches [m]. Needed where the crack is not
        straight within the ring: theta then follows it.
    other_tips : (m, 2) array_like, optional
        Other tips of the body [m], which the ring must not hold.

    Returns
    -------
    float
        J [J/m^2].

    Raises
    ------
    ValueError
        If the ring is not one, leaves the body, or holds another tip.

    Warns
    -----
    UserWarning
        If the ring holds points of different size.

    Notes
    -----
    Domain form of the contour integral of Eq 68 with the kinetic terms of Freund (Dynamic Fracture Mechanics,
    1990, Sec 5.2), in reference coordinates (Eq 76).
    """
    _check_ring(fields, tip, inner, outer, other_tips)
    path = None if line is None else np.asarray(line, dtype=np.float64)
    theta, slope = _extension(fields, tip, inner, outer, path)
    flux = np.einsum("njk,nji,nki,n->", fields.gradient, fields.stress, slope, fields.area)
    spread = np.trace(slope, axis1=1, axis2=2)
    kinetic = 0.5 * fields.mass * np.sum(fields.velocity**2, axis=1)
    total = flux - float((fields.energy + kinetic) @ spread)
    if rates is not None:
        total += np.einsum("n,nj,njk,nk->", fields.mass, rates.acceleration, fields.gradient, theta)
        total -= np.einsum("n,nj,njk,nk->", fields.mass, fields.velocity, rates.gradient_rate, theta)
    return float(total)


def plane_constants(young: float, poisson: float, plane_stress: bool) -> tuple[float, float, float]:
    """E* (J = K^2/E*), shear modulus [Pa], and Kolosov's kappa of an isotropic material."""
    shear = young / (2.0 * (1.0 + poisson))
    if plane_stress:
        return young, shear, (3.0 - poisson) / (1.0 + poisson)
    return young / (1.0 - poisson**2), shear, 3.0 - 4.0 * poisson


def tip_gradient(place: FloatArray, opening: float, sliding: float, shear: float, kappa: float) -> FloatArray:
    """Displacement gradient of Williams' singular field around a tip, (n, 2, 2), in the tip's frame.

    Parameters
    ----------
    place : (n, 2) ndarray
        Along the crack and to its left, from the tip [m]; not the tip itself.
    opening, sliding : float
        K_I and K_II [Pa sqrt(m)].
    shear, kappa : float
        Shear modulus [Pa] and Kolosov's constant.

    Notes
    -----
    Kolosov-Muskhelishvili: ``2 mu u = kappa phi - z conj(phi') - conj(psi)`` with ``phi = k sqrt(z)``,
    ``psi = (conj(k) - k/2) sqrt(z)``, ``k = (K_I - i K_II)/sqrt(2 pi)``.
    """
    z = place[:, 0] + 1j * place[:, 1]
    k = (opening - 1j * sliding) / np.sqrt(2.0 * np.pi)
    root = np.sqrt(z)
    first = 0.5 * k / root
    second = -0.25 * k / (z * root)
    psi = 0.5 * (np.conj(k) - 0.5 * k) / root
    by_z = (kappa * first - np.conj(first)) / (2.0 * shear)
    by_conjugate = (-z * np.conj(second) - np.conj(psi)) / (2.0 * shear)
    along, across = by_z + by_conjugate, 1j * (by_z - by_conjugate)
    return np.stack([np.stack([along.real, across.real], axis=1), np.stack([along.imag, across.imag], axis=1)], axis=1)


def interaction_intensities(
    fields: FractureFields,
    tip: TipFrame,
    inner: float,
    outer: float,
    young: float,
    poisson: float,
    plane_stress: bool,
    rates: Rates | None = None,
    other_tips: ArrayLike | None = None,
) -> Intensities:
    """K_I and K_II by the interaction integral with Williams' fields.

    Right for an isotropic, linear elastic material, small strains, and a crack that is straight within the ring.

    Parameters
    ----------
    fields, tip, inner, outer, rates, other_tips
        As for `j_integral`.
    young, poisson : float
        Young's modulus [Pa] and Poisson's ratio.
    plane_stress : bool
        Plane stress, else plane strain.

    Returns
    -------
    Intensities

    Raises
    ------
    ValueError
        As `j_integral`.

    Notes
    -----
    Stern, Becker and Dunham, Int. J. Fract. 12 (1976) 359, as an integral over the ring.
    """
    _check_ring(fields, tip, inner, outer, other_tips)
    effective, shear, kappa = plane_constants(young, poisson, plane_stress)
    # lambda of the plane law, from kappa alone: lambda = mu (3 - kappa)/(kappa - 1)
    lame = shear * (3.0 - kappa) / (kappa - 1.0)
    place = tip.local(fields.position)
    distance = np.hypot(*place.T)
    keep = (distance > 1e-9 * outer) & (distance < outer)
    place, distance, axes = place[keep], distance[keep], tip.axes
    q, slope = _plateau(distance, inner, outer)
    slope = (slope / distance)[:, None] * place
    gradient = axes @ fields.gradient[keep] @ axes.T
    stress = axes @ fields.stress[keep] @ axes.T
    area, mass = fields.area[keep], fields.mass[keep]
    found = []
    for modes in ((1.0, 0.0), (0.0, 1.0)):
        aux = tip_gradient(place, *modes, shear, kappa)
        trace = np.trace(aux, axis1=1, axis2=2)[:, None, None]
        aux_stress = lame * trace * np.eye(2) + shear * (aux + aux.transpose(0, 2, 1))
        energy = np.sum(stress * aux, axis=(1, 2))
        flux = np.einsum("nji,nj->ni", stress, aux[:, :, 0]) + np.einsum("nji,nj->ni", aux_stress, gradient[:, :, 0])
        flux[:, 0] -= energy
        total = float(np.sum(flux * slope, axis=1) @ area)
        if rates is not None:
            acceleration = rates.acceleration[keep] @ axes.T
            total += float((mass * q) @ np.sum(acceleration * aux[:, :, 0], axis=1))
        found.append(0.5 * effective * total)
    return Intensities(*found)


def intensities_from_opening(
    j: float, opening: float, sliding: float, young: float, poisson: float, plane_stress: bool
) -> Intensities:
    """K_I and K_II from J and the displacement of the faces behind the tip.

    In Williams' field the ratio of opening to sliding is that of K_I to K_II, at every place behind the tip.

    Parameters
    ----------
    j : float
        Energy release rate [J/m^2].
    opening, sliding : float
        Relative displacement of the faces a few cells behind the tip [m]; its size does not matter.
    young, poisson, plane_stress
        As for `interaction_intensities`.

    Raises
    ------
    ValueError
        If J is negative, or both displacements are zero while J is not.
    """
    if j < 0.0:
        raise ValueError(f"j = {j!r}: an energy release rate must not be negative")
    size = float(np.hypot(opening, sliding))
    if size == 0.0:
        if j > 0.0:
            raise ValueError("opening and sliding are both 0: they do not tell the modes apart")
        return Intensities(0.0, 0.0)
    total = np.sqrt(j * plane_constants(young, poisson, plane_stress)[0])
    return Intensities(float(total * opening / size), float(total * sliding / size))


def stress_ahead(fields: FractureFields, tip: TipFrame, distance: float, angle: float, width: float) -> FloatArray:
    """Stress on the line from the tip at an angle, averaged over the points around a place by mass and hats.

    The extrapolation that a grid makes at a node, at a node put where it is needed. Close to a tip it depends on the
    cell size, so compare only values of the same distance and width.

    Parameters
    ----------
    fields : FractureFields
    tip : TipFrame
    distance : float
        From the tip [m].
    angle : float
        From the tip's direction, positive to the left [rad].
    width : float
        Half width of the hat function, one cell [m].

    Returns
    -------
    (2,) ndarray
        Normal and shear stress on the line [Pa]; the normal one is the hoop stress.

    Raises
    ------
    ValueError
        If no point is near the place.
    """
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    ray = TipFrame(tip.position, turn @ tip.direction)
    place, axes = ray.local(fields.position), ray.axes
    share = np.clip(1.0 - np.abs(place[:, 0] - distance) / width, 0.0, None)
    share = share * np.clip(1.0 - np.abs(place[:, 1]) / width, 0.0, None) * fields.mass
    if not share.sum() > 0.0:
        x, y = tip.position + distance * ray.direction
        raise ValueError(f"no material point within {width:.6g} m of ({x:.9g}, {y:.9g}) m")
    stress = np.einsum("n,nji->ji", share, fields.stress) / share.sum()
    found: FloatArray = (axes @ stress @ axes.T)[[1, 0], 1]
    return found


def closure_force(fields: FractureFields, tip: TipFrame, length: float) -> FloatArray:
    """Force per thickness between the faces that a closure of the crack would need, ahead of the tip.

    The integrals of the normal and the shear stress times ``1 - x/length`` over the closure length ahead (the
    stress side of Eqs 40, 41 for the opening of Eq 43), each by virtual work of the points on either side with the
    test function ``(1 - |x|/length)(1 - |y|/length)``, which needs no stress on the line and so loses nothing of
    its singularity.

    Returns
    -------
    (2,) ndarray
        Normal and shear force [N/m].
    """
    axes = tip.axes
    place = tip.local(fields.position)
    x, y = np.abs(place.T) / length
    inside = (x < 1.0) & (y < 1.0)
    x, y, place, area = x[inside], y[inside], place[inside], fields.area[inside]
    stress = axes @ fields.stress[inside] @ axes.T
    left = np.where(place[:, 1] >= 0.0, 1.0, -1.0)
    slope = np.stack([-np.sign(place[:, 0]) * (1.0 - y), -left * (1.0 - x)], axis=1) / length
    force = -0.5 * np.einsum("n,nji,ni,n->j", left, stress, slope, area)
    return np.array([force[1], force[0]])


def vcct(fields: FractureFields, tip: TipFrame, opening: float, sliding: float, length: float) -> tuple[float, float]:
    """G_I and G_II by virtual crack closure (Eqs 40, 41).

    Parameters
    ----------
    fields : FractureFields
        All points within sqrt(2) times the length of the tip.
    tip : TipFrame
        Tip in the reference state; the crack is straight over the length.
    opening, sliding : float
        Relative displacement of the faces one closure length behind the tip (nodes 1 and 1' of Fig 2.4) [m].
    length : float
        Closure length [m]; `CLOSURE` cells.

    Returns
    -------
    tuple of float
        G_I, G_II [J/m^2]; faces that overlap give no G_I.

    Notes
    -----
    With linear stress and opening (Eqs 42, 43) the closure integral is Eq 44. Finite elements get away with it, since
    their nodal forces hold the whole singular stress and their opening is linear. Stresses of material points at the
    tip do not: Eq 44 gave 0.33 J at a closure length of one cell and 0.5 J at three. Here the integral of
    the stress is `closure_force`, and the opening between tip and the place measured is that of Williams' field:
    for ``sigma ~ x^-1/2`` and ``du ~ r^1/2`` the integral of their product is 3 pi/8 times that with Eq 43.
    """
    normal, shear = 3.0 * np.pi / 16.0 * closure_force(fields, tip, length) / length
    return max(0.0, float(opening * normal)), float(sliding * shear)


def crack_extension_angle(intensities: Intensities) -> float:
    """Angle of the largest hoop stress ahead of a tip [rad], positive to the left.

    Erdogan and Sih, J. Basic Eng. 85 (1963) 519: ``K_I sin(t) + K_II (3 cos(t) - 1) = 0``.
    """
    first, second = intensities
    whole = np.hypot(first, np.sqrt(8.0) * second)
    return float(2.0 * np.arctan2(-2.0 * second, first + whole))
