"""Damping, the seed's force scaling, and dynamic relaxation to rest.

What acts where, per step of length dt:

- mass-proportional on the grid: nodal velocities times ``exp(-c dt)``;
- mass-proportional on points: point velocities times ``exp(-c dt)``, which also takes the motion that the
  grid does not see;
- force scaling (Eq 45): nodal forces times ``1 - c``;
- kinetic: all velocities to zero at each peak of kinetic energy.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numba import njit
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Damping:
    """Damping of a run; the two rates may act together.

    Parameters
    ----------
    grid_rate, point_rate : float
        Mass-proportional damping c of nodal and of point velocities [1/s]. A mode of angular frequency w has
        the damping ratio ``c / (2 w)``.
    force_scaling : float
        c of Eq 45, ``p <- p + (1 - c) dt f``, from 0 up to but not 1. **This is not damping**: it scales every
        force, which is the same as dividing all masses by ``1 - c``. No energy is taken out (what is kept is
        strain energy plus kinetic energy over ``1 - c``); every frequency and wave speed falls by
        ``sqrt(1 - c)``. It is there to reproduce results that were made with it.

    Raises
    ------
    ValueError
        If a value is outside its range.
    """

    grid_rate: float = 0.0
    point_rate: float = 0.0
    force_scaling: float = 0.0

    def __post_init__(self) -> None:
        for name in ("grid_rate", "point_rate"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0.0):
                raise ValueError(f"Damping.{name} = {value!r}: must be finite and not negative [1/s]")
        if not 0.0 <= self.force_scaling < 1.0:
            raise ValueError(f"Damping.force_scaling = {self.force_scaling!r}: from 0 up to but not 1 is allowed")

    def grid_factor(self, time_step: float) -> float:
        """Factor on nodal velocities in a step."""
        return float(np.exp(-self.grid_rate * time_step))

    def point_factor(self, time_step: float) -> float:
        """Factor on point velocities in a step."""
        return float(np.exp(-self.point_rate * time_step))

    @property
    def force_factor(self) -> float:
        """Factor on nodal forces (Eq 45)."""
        return 1.0 - self.force_scaling


@njit(cache=True, nogil=True)
def damp_points(rows: FloatArray, alive: int, dimension: int, mass_column: int, factor: float) -> float:
    """Multiply the velocities of living points by ``factor``; returns the kinetic energy taken out [J].

    ``mass_column`` is that of `material_points.columns`; velocities follow the positions.
    """
    lost = 0.0
    share = 0.5 * (1.0 - factor * factor)
    for p in range(alive):
        square = 0.0
        for a in range(dimension):
            v = rows[p, dimension + a]
            square += v * v
            rows[p, dimension + a] = factor * v
        lost += share * rows[p, mass_column] * square
    return lost


@njit(cache=True, nogil=True)
def scale_forces(listed: IntArray, momentum: FloatArray, factor: float) -> None:
    """Multiply the nodal forces of the listed rows of ``momentum`` (R, 1 + 2 d) by ``factor`` (Eq 45)."""
    dimension = (momentum.shape[1] - 1) // 2
    for i in range(listed.size):
        for a in range(dimension):
            momentum[listed[i], 1 + dimension + a] *= factor


@njit(cache=True, nogil=True)
def _copy_forces(listed: IntArray, momentum: FloatArray, internal: FloatArray) -> None:
    dimension = internal.shape[1]
    for i in range(listed.size):
        for a in range(dimension):
            internal[listed[i], a] = momentum[listed[i], 1 + dimension + a]


@njit(cache=True, nogil=True)
def _balance(
    listed: IntArray,
    momentum: FloatArray,
    motion: FloatArray,
    internal: FloatArray,
    time_step: float,
    force_factor: float,
    squares: FloatArray,
) -> None:
    """Add the squares of unbalanced, internal, external and reaction forces to ``squares`` (4,)."""
    dimension = internal.shape[1]
    for i in range(listed.size):
        n = listed[i]
        mass = momentum[n, 0]
        if not mass > 0.0:
            continue
        for a in range(dimension):
            force = momentum[n, 1 + dimension + a] / force_factor
            unbalanced = mass * motion[n, dimension + a] / (time_step * force_factor)
            squares[0] += unbalanced * unbalanced
            squares[1] += internal[n, a] * internal[n, a]
            squares[2] += (force - internal[n, a]) ** 2
            squares[3] += (unbalanced - force) ** 2


class ForceBalance:
    """Residual of the equilibrium on the nodes, measured in a step.

    With m a the mass times acceleration of a node (its increment of velocity over the step after all boundary
    conditions and contact), f_int and f_ext the internal and the external force on it, and the reaction
    ``r = m a - f_int - f_ext`` that conditions put there,

        residual = |m a| / max(|f_int|, |f_ext|, |r|),

    with the Euclidean norm over all components of all nodes. It is 0 where no force acts at all.
    """

    def __init__(self) -> None:
        self._internal = np.zeros((0, 0))

    def before_loads(self, momentum: FloatArray, listed: Sequence[IntArray]) -> None:
        """Keep the internal forces: called when they alone are in ``momentum`` (R, 1 + 2 d)."""
        shape = (momentum.shape[0], (momentum.shape[1] - 1) // 2)
        if self._internal.shape != shape:
            self._internal = np.zeros(shape)
        for part in listed:
            _copy_forces(part, momentum, self._internal)

    def residual(
        self,
        momentum: FloatArray,
        motion: FloatArray,
        listed: Sequence[IntArray],
        time_step: float,
        force_factor: float = 1.0,
    ) -> float:
        """Return the residual when ``motion`` (R, 2 d) holds the final velocity increments of the step.

        ``force_factor`` is what the forces in ``momentum`` were multiplied by after all of them were there.
        """
        squares = np.zeros(4)
        for part in listed:
            _balance(part, momentum, motion, self._internal, time_step, force_factor, squares)
        scale = float(squares[1:].max())
        return float(np.sqrt(squares[0] / scale)) if scale > 0.0 else 0.0


class Relaxable(Protocol):
    """What `relax` needs of a solver."""

    def advance(self, steps: int) -> None:
        """Advance by a number of steps."""

    @property
    def kinetic_energy(self) -> float:
        """Kinetic energy of the points [J]."""

    @property
    def residual(self) -> float:
        """Residual of the last step; see `ForceBalance`."""

    def stop(self) -> None:
        """Set the velocities of all points to zero and let the forces of the next step count half.

        Velocities lie half a step before positions, so half a step's impulse belongs to a start from rest.
        With a whole one a mode of angular frequency w comes back larger than it was, up to
        ``1 / sqrt(1 - (w dt / 2)^2)`` times, and stops at short intervals can feed it.
        """


@dataclass(frozen=True)
class Relaxation:
    """How a relaxation ended.

    Attributes
    ----------
    residual : float
        Of the last step; see `ForceBalance`.
    steps : int
        Steps made.
    peaks : int
        Times the kinetic energy passed a peak and the velocities were set to zero.
    converged : bool
        Did the residual fall below the tolerance?
    """

    residual: float
    steps: int
    peaks: int
    converged: bool


def relax(solver: Relaxable, tolerance: float = 1e-6, max_steps: int = 100_000) -> Relaxation:
    """Bring a body to rest under its loads by kinetic damping.

    Every time the kinetic energy passes a peak all velocities are set to zero, since most of the elastic
    energy that can be released has just been. The velocities are zero at the end too. Time goes on meanwhile,
    so loads and conditions should have reached their final values. Mass-proportional damping may act beside.

    Parameters
    ----------
    solver : Relaxable
    tolerance : float
        Residual to reach, positive; see `ForceBalance`.
    max_steps : int
        Steps after which to give up.

    Returns
    -------
    Relaxation

    Raises
    ------
    ValueError
        If the tolerance or the number of steps is not positive.

    References
    ----------
    Cundall, Explicit finite difference methods in geomechanics, Proc. 2nd Int. Conf. Numer. Methods Geomech.,
    Blacksburg (1976) 132; Barnes, Int. J. Space Struct. 14 (1999) 89.
    """
    if not (np.isfinite(tolerance) and tolerance > 0.0):
        raise ValueError(f"tolerance = {tolerance!r}: must be positive")
    if int(max_steps) != max_steps or max_steps < 1:
        raise ValueError(f"max_steps = {max_steps!r}: a whole number of at least 1 is needed")
    peaks = 0
    stopped = False
    before = solver.kinetic_energy
    residual = np.inf
    for step in range(1, int(max_steps) + 1):
        solver.advance(1)
        residual = solver.residual
        energy = solver.kinetic_energy
        # The step after a stop is half a step, and so is what it reports of forces: not one to end with.
        if residual <= tolerance and not stopped:
            solver.stop()
            return Relaxation(residual, step, peaks, True)
        stopped = energy < before
        if stopped:
            solver.stop()
            peaks += 1
            before = 0.0
        else:
            before = energy
    solver.stop()
    return Relaxation(float(residual), int(max_steps), peaks, False)
