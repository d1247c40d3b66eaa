"""Split beams for cohesive layers: double cantilever, end-notched flexure and mixed-mode bending, and beam theory.

The beam is a slice of unit width held against movement across (plane strain). Its two arms lie along x, the crack is
the layer between them from x = 0 to `crack`. The material is AS4/PEEK of Camanho, Davila and De Moura (J. Compos.
Mater. 37 (2003) 1415-1438).

Beam theory is that of the test standards (ISO 15024, ASTM D6671): the arms of length a are longer by chi h, since
what is ahead of the crack tip gives way (Williams, J. Strain Anal. 24 (1989) 207-214):

    chi = sqrt(E1 / (11 G13) (3 - 2 (Gamma / (1 + Gamma))^2)),    Gamma = 1.18 sqrt(E1 E3) / G13
    double cantilever    G_I = 12 P^2 (a + chi h)^2 / (b^2 E1 h^3)
    end-notched flexure  G_II = 9 P^2 (a + 0.42 chi h)^2 / (16 b^2 E1 h^3)
    mixed-mode bending   G_I = 3 P^2 (3 c - L)^2 (a + chi h)^2 / (4 b^2 L^2 E1 h^3),
                         G_II = 9 P^2 (c + L)^2 (a + 0.42 chi h)^2 / (16 b^2 L^2 E1 h^3)
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fem_service.cohesive_law import CohesiveLaw
from fem_service.equilibrium import Equilibrium, Grips
from fem_service.increments import Steps, next_increment
from fem_service.laminate_mesh import LaminateMesh, stack
from fem_service.lever import Lever
from fem_service.plane_mesh import PlaneMesh
from fem_service.point_material import ElasticMaterial
from fem_service.quasi_static import QuasiStatic

ARM: Final = 1.56e-3  # m, thickness h of one arm
WIDTH: Final = 1e-3  # m, of the slice
HALF_SPAN: Final = 51e-3  # m, L of the bending tests
_ALONG, _ACROSS, _SHEAR, _SHEAR_ACROSS, _NU, _NU_ACROSS = 122.7e9, 10.1e9, 5.5e9, 3.7e9, 0.25, 0.45


def stiffness() -> NDArray[np.float64]:
    """Stiffness of AS4/PEEK, shape (6, 6), Pa."""
    return transversely_isotropic(_ALONG, _ACROSS, _NU, _NU_ACROSS, _SHEAR, _SHEAR_ACROSS)


def transversely_isotropic(
    along: float, across: float, poisson: float, poisson_across: float, shear: float, shear_across: float
) -> NDArray[np.float64]:
    """Stiffness, shape (6, 6), Pa, of E1, E2, nu12, nu23, G12, G23; order 11, 22, 33, 23, 13, 12."""
    compliance = np.diag([1 / along, 1 / across, 1 / across, 1 / shear_across, 1 / shear, 1 / shear])
    compliance[0, 1] = compliance[1, 0] = compliance[0, 2] = compliance[2, 0] = -poisson / along
    compliance[1, 2] = compliance[2, 1] = -poisson_across / across
    return np.ascontiguousarray(np.linalg.inv(compliance))


@dataclass(frozen=True)
class BeamTheory:
    """Loads at which a crack of length a grows, N, of a slice of `WIDTH`."""

    law: CohesiveLaw

    @property
    def modulus(self) -> float:
        """E1 in plane strain, Pa."""
        return _ALONG / (1.0 - _NU**2 * _ACROSS / _ALONG)

    @property
    def longer(self) -> float:
        """chi h, m."""
        gamma = 1.18 * np.sqrt(_ALONG * _ACROSS) / _SHEAR
        return float(np.sqrt(_ALONG / (11.0 * _SHEAR) * (3.0 - 2.0 * (gamma / (1.0 + gamma)) ** 2)) * ARM)

    def double_cantilever(self, crack: float) -> float:
        """Load of the double cantilever."""
        stiff = WIDTH**2 * self.modulus * ARM**3
        return float(np.sqrt(self.law.opening_toughness * stiff / 12.0) / (crack + self.longer))

    def end_notched(self, crack: float) -> float:
        """Load of end-notched flexure."""
        stiff = WIDTH**2 * self.modulus * ARM**3
        return float(np.sqrt(16.0 * self.law.sliding_toughness * stiff / 9.0) / (crack + 0.42 * self.longer))

    def mixed(self, crack: float, arm: float) -> tuple[float, float]:
        """Load of mixed-mode bending with a lever of length c, and the share of mode II."""
        stiff = WIDTH**2 * self.modulus * ARM**3 * HALF_SPAN**2
        opening = 0.75 * (3.0 * arm - HALF_SPAN) ** 2 * (crack + self.longer) ** 2 / stiff
        sliding = 9.0 / 16.0 * (arm + HALF_SPAN) ** 2 * (crack + 0.42 * self.longer) ** 2 / stiff
        share = sliding / (opening + sliding)
        return float(np.sqrt(self.law.toughness(share) / (opening + sliding))), float(share)


@dataclass(frozen=True, eq=False)
class Beam:
    """A split beam.

    Attributes
    ----------
    mesh : LaminateMesh
    columns : ndarray of float
        x of the nodes, m.
    crack : float
        m.
    """

    mesh: LaminateMesh
    columns: NDArray[np.float64]
    crack: float

    def nodes_at(self, x: float, z: float) -> NDArray[np.int64]:
        """The pair of nodes nearest to a line across the beam."""
        distance = np.hypot(self.mesh.nodes[:, 0] - x, self.mesh.nodes[:, 2] - z)
        return np.flatnonzero(distance <= distance.min() + 1e-9)

    def begin(self, problem: QuasiStatic) -> Equilibrium:
        """At rest, with the layer of the crack broken; its faces still press on each other."""
        rest = problem.rest()
        middle = self.mesh.nodes[self.mesh.layers][:, :, 0].mean(axis=1)
        layers = rest.layers.copy()
        layers[middle < self.crack] = 1.0
        return replace(rest, layers=layers)

    def crack_length(self, at: Equilibrium) -> float:
        """From x = 0 to where the layer still carries something, m."""
        whole = self.mesh.nodes[self.mesh.layers][:, :4, 0][at.layers[:, :, 0] < 1.0]
        return float(whole.min()) if len(whole) else float(self.columns[-1])


def split_beam(length: float, crack: float, *, coarse: float, fine: float, ahead: float) -> Beam:
    """A split beam with elements `fine` from just behind the crack tip to `ahead` of it, and `coarse` elsewhere."""
    behind, beyond = crack - 4.0 * fine, crack + ahead
    parts = [(0.0, behind, coarse), (behind, crack, fine), (crack, beyond, fine), (beyond, length, coarse)]
    columns = [np.zeros(1)]
    for low, high, size in parts:
        count = max(1, round((high - low) / size))
        columns.append(np.linspace(low, high, count + 1)[1:])
    x = np.concatenate(columns)
    nodes = np.stack(np.meshgrid(x, [0.0, WIDTH], indexing="ij"), axis=-1).reshape(-1, 2)
    first = 2 * np.arange(len(x) - 1)
    plane = PlaneMesh(nodes, np.column_stack([first, first + 2, first + 3, first + 1]))
    # A ply turned by half a turn is the same ply, but a layer parts it from its neighbour.
    mesh = stack(plane, np.array([0.0, np.pi]), ARM, per_ply=2, cohesive=True)
    return Beam(mesh, x, crack)


def held(beam: Beam, points: list[tuple[float, float, int, float]]) -> Grips:
    """Grips that hold a component of the nodes nearest to (x, z), and all nodes across the beam."""
    moves = dict.fromkeys((3 * np.arange(len(beam.mesh.nodes)) + 1).tolist(), 0.0)
    for x, z, axis, per_load in points:
        for node in beam.nodes_at(x, z):
            moves[3 * int(node) + axis] = per_load
    freedoms = np.array(sorted(moves), dtype=np.int64)
    return Grips(freedoms, np.array([moves[int(freedom)] for freedom in freedoms]))


def double_cantilever(beam: Beam, law: CohesiveLaw) -> QuasiStatic:
    """Arms pulled apart at x = 0; the load is the distance that they part by."""
    grips = held(beam, [(0.0, 0.5 * ARM, 2, -0.5), (0.0, 1.5 * ARM, 2, 0.5), (beam.columns[-1], ARM, 0, 0.0)])
    return QuasiStatic(beam.mesh, ElasticMaterial(stiffness()), grips, law=law, tolerance=1e-6, iterations=40)


def end_notched(beam: Beam, law: CohesiveLaw) -> QuasiStatic:
    """Three-point bending; the load is the deflection of the middle."""
    grips = held(
        beam,
        [(0.0, 0.0, 2, 0.0), (2 * HALF_SPAN, 0.0, 2, 0.0), (2 * HALF_SPAN, 0.0, 0, 0.0), (HALF_SPAN, 2 * ARM, 2, -1.0)],
    )
    return QuasiStatic(beam.mesh, ElasticMaterial(stiffness()), grips, law=law, tolerance=1e-6, iterations=40)


def mixed_bending(beam: Beam, law: CohesiveLaw, arm: float, machine: float = 1e9) -> QuasiStatic:
    """Mixed-mode bending; the load is the movement of the end of the lever's arm of length c."""
    ends, middle = beam.nodes_at(0.0, 1.5 * ARM), beam.nodes_at(HALF_SPAN, 2 * ARM)
    weights = np.zeros((len(ends) + len(middle), 3))
    weights[: len(ends), 2] = arm / HALF_SPAN / len(ends)
    weights[len(ends) :, 2] = -(arm + HALF_SPAN) / HALF_SPAN / len(middle)
    lever = Lever(np.concatenate([ends, middle]), weights, machine)
    grips = held(beam, [(0.0, 0.0, 2, 0.0), (2 * HALF_SPAN, 0.0, 2, 0.0), (2 * HALF_SPAN, 0.0, 0, 0.0)])
    material = ElasticMaterial(stiffness())
    return QuasiStatic(beam.mesh, material, grips, law=law, lever=lever, tolerance=1e-6, iterations=40)


def curve(problem: QuasiStatic, start: Equilibrium, end: float, steps: Steps) -> list[Equilibrium]:
    """All equilibria up to a load."""
    found, size = [start], steps.first
    while found[-1].load < end:
        made = next_increment(problem, found[-1], size, end, steps)
        found.append(made.equilibrium)
        size = made.next_size
    return found
