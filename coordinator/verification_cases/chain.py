"""A chain of atoms that a bar of the continuum, one cell high, goes over into: scenes of one dimension.

The chain is that of backend `lattice`: masses of argon with springs of 250 N/m between neighbours, 3.45 Angstrom
apart. As a bar it has the cross-section A = a^2 / sqrt(2), E = k a / A and rho = m / (a A); the bar of the continuum
has the same E, rho and E A, no contraction, and walls that slide.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from coordinator.weight_profile import WeightProfile
from protocol.arrays import FloatArray

SPACING = 3.45e-10
BOND = 250.0
MASS = 39.948 * 1.66053906892e-27
SECTION = SPACING**2 / math.sqrt(2.0)
YOUNG = BOND * SPACING / SECTION
DENSITY = MASS / (SPACING * SECTION)
SPEED = math.sqrt(YOUNG / DENSITY)
#: Atoms in one width of the overlap, and atoms in one cell: fine enough for the theory of two bars.
ATOMS, ATOMS_OF_CELL = 32, 4
WIDTH = ATOMS * SPACING
CELL = ATOMS_OF_CELL * SPACING


@dataclass(frozen=True)
class Bar:
    """A chain between bars of the continuum, all lengths in widths of the overlap.

    Attributes
    ----------
    left, right : float
        Lengths of continuum beyond the chain; without the right one the chain ends free.
    chain : float
        Length of the chain, overlaps included.
    steps_per_exchange : int
        M.
    time_step : float
        Of the atoms, s.
    """

    left: float
    right: float
    chain: float
    steps_per_exchange: int = 10
    time_step: float = 4e-15

    @property
    def coupling_step(self) -> float:
        """Dt, s."""
        return self.steps_per_exchange * self.time_step

    @property
    def border(self) -> float:
        """Where the left overlap begins, m."""
        return -0.5 * self.chain * WIDTH

    @property
    def extent(self) -> float:
        """Length of the whole, m."""
        return (self.left + self.chain + self.right) * WIDTH

    def text(self, steps: int, every: int, handshake: str, ends: str, damping_rate: float = 0.0) -> str:
        """Return the scene.

        Parameters
        ----------
        steps, every : int
            Coupling steps, and those between frames.
        handshake : str
            Further lines of [handshake].
        ends : str
            [[continuum.edges]] tables of the left and the right end.
        damping_rate : float
            Of the continuum, 1/s.
        """
        low, high = self.border - self.left * WIDTH, (0.5 * self.chain + self.right) * WIDTH
        sides = '["left", "right"]' if self.right else '["left"]'
        return f"""
title = "A bar that goes over into a chain of atoms"

[run]
steps = {steps}
output_every = {every}
checkpoint_every = {steps}

[continuum]
assumption = "plane_stress"
lower = [{length(low)}, {length(-0.5 * CELL)}]
upper = [{length(high)}, {length(0.5 * CELL)}]
cell_size = {length(CELL)}
damping_rate = "{damping_rate:.9e} 1/s"

[continuum.material]
young = "{YOUNG:.12e} Pa"
poisson = 0.0
density = "{DENSITY:.12e} kg/m^3"
thickness = {length(SECTION / CELL)}

[[continuum.edges]]
kind = "symmetry"
edge = "top"

[[continuum.edges]]
kind = "symmetry"
edge = "bottom"
{ends}
[atomistic]
backend = "lattice"
force_field = "harmonic"
material = "chain"
width = {length(self.chain * WIDTH)}
height = {length(CELL)}
temperature = "0 K"
time_step = "{self.time_step:.9e} s"
equilibration = "0 s"
reference = "{8 * self.coupling_step:.9e} s"

[handshake]
width = {length(WIDTH)}
steps_per_exchange = {self.steps_per_exchange}
ivc_size = {length(CELL)}
sides = {sides}
{handshake}
"""


def length(value: float) -> str:
    """Return a length in m as it stands in a scene."""
    return f'"{value:.12e} m"'


def end(edge: str, times: FloatArray, displacements: FloatArray) -> str:
    """Return the table of an end that is moved along x; times in s, displacements in m."""
    rows = ", ".join(f'"{time:.9e} s"' for time in times)
    ways = ", ".join(f'"{way:.12e} m"' for way in displacements)
    return f'\n[[continuum.edges]]\nedge = "{edge}"\ncomponent = "x"\ntimes = [{rows}]\ndisplacements = [{ways}]\n'


def pulled(strain: float) -> str:
    """Return the tables of both ends pulled by a constant traction that strains the bar so."""
    table = """
[[continuum.edges]]
kind = "traction"
edge = "{}"
component = "x"
times = ["0 s"]
tractions = ["{:.12e} Pa"]
"""
    return table.format("left", -YOUNG * strain) + table.format("right", YOUNG * strain)


def pulse(edge: str, width: float, height: float) -> tuple[str, float]:
    """Return the table of an end that makes a bell of displacement, and its duration, s.

    Parameters
    ----------
    edge : str
    width : float
        In widths of the overlap, where the bell has fallen to 1/e.
    height : float
        m.
    """
    unit = width * WIDTH / SPEED
    times = np.linspace(0.0, 8.0 * unit, 241)
    bell = height * np.exp(-((times / unit - 4.0) ** 2))
    return end(edge, times, bell - bell[0]), float(times[-1])


def ring_width(profile: WeightProfile) -> float:
    """Return the width of the ring, m: at constant weight it begins on the outermost atom, not half a layer beyond."""
    return WIDTH - 0.5 * SPACING if profile.kind == "constant" else WIDTH


def springs(profile: WeightProfile, relative: float) -> float:
    """Return the stiffness of an anchor at the outer border, N/m, for kappa L^2 / E."""
    return relative * YOUNG / ring_width(profile) ** 2 * SECTION * SPACING
