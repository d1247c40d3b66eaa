"""Deflection of a simply supported beam under a harmonic force: three theories of rising exactness.

The beam lies along x from 0 to L and through its height from 0 to H, thickness one. At both ends the transverse
displacement is zero and the axial traction is zero, so every theory separates into sine series in x. The force
``P0 sin(omega t)`` acts at mid-span from rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray
from scipy.linalg import eigh

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Beam:
    """A simply supported beam in plane stress and its load.

    Parameters
    ----------
    length, height : float
        [m].
    young, poisson, density : float
        [Pa], dimensionless, [kg/m^3].
    force : float
        Amplitude of the force at mid-span per thickness [N/m].
    angular_frequency : float
        Of the force [1/s].
    strip : float
        Length at mid-span, on the top face, over which the force is spread evenly [m].
    """

    length: float
    height: float
    young: float
    poisson: float
    density: float
    force: float
    angular_frequency: float
    strip: float

    @property
    def fundamental(self) -> float:
        """First angular frequency of the Euler-Bernoulli beam [1/s] (below Eq 49)."""
        slender = np.sqrt(self.young * self.height**2 / (12.0 * self.density))
        return float((np.pi / self.length) ** 2 * slender)


def _from_rest(frequency: FloatArray, driven: float, time: FloatArray) -> FloatArray:
    """Response of unit oscillators ``q'' + w^2 q = sin(driven t)`` that start at rest, (modes, times)."""
    w = frequency[:, None]
    return (np.sin(driven * time) - driven / w * np.sin(w * time)) / (w**2 - driven**2)


def bernoulli_deflection(beam: Beam, time: FloatArray, terms: int = 100) -> FloatArray:
    """Mid-span deflection of the Euler-Bernoulli beam under a point force [m] (Eq 49).

    Parameters
    ----------
    beam : Beam
    time : (t,) ndarray
        [s].
    terms : int
        Number of sine terms.

    Returns
    -------
    (t,) ndarray
    """
    n = np.arange(1, terms + 1, 2, dtype=np.float64)
    response = _from_rest(n**2 * beam.fundamental, beam.angular_frequency, time)
    return np.asarray(2.0 * beam.force / (beam.density * beam.height * beam.length) * response.sum(axis=0))


def _harmonic_load(beam: Beam, n: FloatArray) -> FloatArray:
    """Sine coefficients of the strip load per length [N/m^2]."""
    return np.asarray(
        2.0
        * beam.force
        / beam.length
        * np.sin(0.5 * np.pi * n)
        * np.sinc(0.5 * n * beam.strip / beam.length)  # numpy's sinc holds the pi
    )


def timoshenko_deflection(beam: Beam, time: FloatArray, terms: int = 100) -> FloatArray:
    """Mid-span deflection of the Timoshenko beam under the strip load [m].

    Each sine term is an oscillator of two freedoms, deflection and rotation; shear factor
    ``5 (1 + nu)/(6 + 5 nu)`` of a rectangle in plane stress.

    Parameters
    ----------
    beam : Beam
    time : (t,) ndarray
        [s].
    terms : int
        Number of sine terms.

    Returns
    -------
    (t,) ndarray
    """
    shear = beam.young / (2.0 * (1.0 + beam.poisson)) * beam.height
    shear *= 5.0 * (1.0 + beam.poisson) / (6.0 + 5.0 * beam.poisson)
    inertia = beam.height**3 / 12.0
    mass = np.diag([beam.density * beam.height, beam.density * inertia])
    total = np.zeros_like(time)
    harmonics = np.arange(1, terms + 1, 2, dtype=np.float64)
    for n, load in zip(harmonics, _harmonic_load(beam, harmonics), strict=True):
        k = n * np.pi / beam.length
        stiffness = np.array([[shear * k**2, -shear * k], [-shear * k, shear + beam.young * inertia * k**2]])
        squared, mode = eigh(stiffness, mass)
        response = _from_rest(np.sqrt(squared), beam.angular_frequency, time)
        total += load * np.sin(0.5 * n * np.pi) * (mode[0] ** 2 @ response)
    return total


@dataclass(frozen=True)
class Harmonic:
    """Free vibrations of one sine term of the two-dimensional beam.

    ``u = U(y) cos(k x)``, ``w = W(y) sin(k x)`` with U and W expanded in Legendre polynomials through the height.

    Attributes
    ----------
    wave_number : float
        k [1/m].
    frequency : (m,) ndarray
        Angular frequencies, rising [1/s].
    axial, transverse : (p, m) ndarray
        Legendre coefficients of U and W of each mode, mass-normalised.
    """

    wave_number: float
    frequency: FloatArray
    axial: FloatArray
    transverse: FloatArray


def elastic_harmonic(beam: Beam, n: int, degree: int = 20) -> Harmonic:
    """Solve plane stress elasticity for the n-th sine term by a spectral method through the height.

    Parameters
    ----------
    beam : Beam
    n : int
        Number of half waves along the beam.
    degree : int
        Highest Legendre polynomial.
    """
    count = degree + 1
    s, gauss = legendre.leggauss(count + 2)
    gauss = 0.5 * beam.height * gauss
    value: FloatArray = np.asarray(legendre.legvander(s, degree), dtype=np.float64)
    slopes = [legendre.legval(s, legendre.legder(row)) for row in np.eye(count)]
    slope: FloatArray = np.asarray(np.stack(slopes, axis=1) * 2.0 / beam.height, dtype=np.float64)
    k = n * np.pi / beam.length
    c11 = beam.young / (1.0 - beam.poisson**2)
    c12 = beam.poisson * c11
    c33 = 0.5 * beam.young / (1.0 + beam.poisson)

    none = np.zeros_like(value)
    strain_x: FloatArray = np.hstack([-k * value, none])
    strain_y: FloatArray = np.hstack([none, slope])
    shear: FloatArray = np.hstack([slope, k * value])

    def product(a: FloatArray, b: FloatArray) -> FloatArray:
        return np.asarray(a.T @ (gauss[:, None] * b))

    coupled = product(strain_x, strain_y)
    stiffness = c11 * (product(strain_x, strain_x) + product(strain_y, strain_y)) + c12 * (coupled + coupled.T)
    stiffness += c33 * product(shear, shear)
    block = beam.density * product(value, value)
    mass = np.block([[block, np.zeros_like(block)], [np.zeros_like(block), block]])
    squared, mode = eigh(stiffness, mass)
    return Harmonic(float(k), np.sqrt(np.maximum(squared, 0.0)), mode[:count], mode[count:])


def elastic_deflection(
    beam: Beam, position: FloatArray, time: FloatArray, terms: int = 79, degree: int = 20
) -> FloatArray:
    """Transverse displacement of the two-dimensional beam, averaged over given places [m].

    This is the exact solution of the modelled problem, to the truncation of two fast converging series.

    Parameters
    ----------
    beam : Beam
    position : (m, 2) ndarray
        Places over which the displacement is averaged [m].
    time : (t,) ndarray
        [s].
    terms, degree : int
        Sine terms along the beam and Legendre degree through the height.

    Returns
    -------
    (t,) ndarray
    """
    total = np.zeros_like(time)
    through = legendre.legvander(2.0 * position[:, 1] / beam.height - 1.0, degree)
    for n in range(1, terms + 1, 2):
        harmonic = elastic_harmonic(beam, n, degree)
        load = float(_harmonic_load(beam, np.array([float(n)]))[0])
        on_top = harmonic.transverse.sum(axis=0)  # every Legendre polynomial is one at the top face
        seen = (np.sin(harmonic.wave_number * position[:, 0])[:, None] * through).mean(axis=0) @ harmonic.transverse
        total += load * (on_top * seen) @ _from_rest(harmonic.frequency, beam.angular_frequency, time)
    return total
