"""A manufactured solution: a neo-Hookean square that stretches along its axes.

In the unit square, with reference place (X, Y) and time t,

    u_x = A sin(pi X / a) sin(w t),    u_y = -A sin(pi Y / a) sin(w t),

which leaves the edges in place and free of shear. The acceleration that the body force must give each point follows
from the momentum balance ``rho0 b = rho0 u'' - Div P`` with the first Piola-Kirchhoff stress P of the law. The idea
is Wallstedt and Guilkey's (J. Comput. Phys. 227, 2008, 9628); the law's energy is that of `NeoHookean`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class StretchingSquare:
    """The solution and its body force.

    Parameters
    ----------
    side : float
        Edge length a of the square [m].
    amplitude : float
        A [m].
    angular_frequency : float
        w [1/s].
    lame, shear_modulus : float
        Constants of the energy ``mu/2 (tr b - 3 - 2 ln J) + lambda/4 (J^2 - 1 - 2 ln J)`` [Pa].
    density : float
        [kg/m^3].
    """

    side: float
    amplitude: float
    angular_frequency: float
    lame: float
    shear_modulus: float
    density: float

    def _waves(self, place: FloatArray) -> FloatArray:
        """Shape of the displacement (n, 2), signed."""
        return np.asarray(np.sin(np.pi * place / self.side) * np.array([self.amplitude, -self.amplitude]))

    def displacement(self, place: FloatArray, time: float) -> FloatArray:
        """Displacement of the points with reference places (n, 2) [m], (n, 2)."""
        return np.asarray(self._waves(place) * np.sin(self.angular_frequency * time))

    def velocity(self, place: FloatArray, time: float) -> FloatArray:
        """Velocity [m/s], (n, 2)."""
        return np.asarray(self._waves(place) * self.angular_frequency * np.cos(self.angular_frequency * time))

    def reference(self, position: FloatArray, time: float) -> FloatArray:
        """Reference places of the points that are at ``position`` (n, 2) [m], (n, 2); Newton to round-off."""
        wave = np.pi / self.side
        signed = np.array([self.amplitude, -self.amplitude]) * np.sin(self.angular_frequency * time)
        place = position.copy()
        for _ in range(10):
            off = place + signed * np.sin(wave * place) - position
            if np.abs(off).max() < 1e-14 * self.side:
                break
            place -= off / (1.0 + signed * wave * np.cos(wave * place))
        return place

    def acceleration_at(self, position: FloatArray, time: float) -> FloatArray:
        """`acceleration` of the points that are at ``position`` (n, 2) [m] now, (n, 2)."""
        return self.acceleration(self.reference(position, time), time)

    def acceleration(self, place: FloatArray, time: float) -> FloatArray:
        """Acceleration that the body force gives to the points with reference places (n, 2) [m/s^2], (n, 2)."""
        wave = np.pi / self.side
        swing = np.sin(self.angular_frequency * time)
        signed = np.array([self.amplitude, -self.amplitude]) * swing
        stretch = 1.0 + signed * wave * np.cos(wave * place)
        slope = -signed * wave**2 * np.sin(wave * place)
        other = stretch[:, ::-1]
        tangent = self.shear_modulus * (1.0 + stretch**-2) + 0.5 * self.lame * (other**2 + stretch**-2)
        inertia = -(self.angular_frequency**2) * signed * np.sin(wave * place)
        return np.asarray(inertia - tangent * slope / self.density)
