"""The cohesive element COH3D8: two faces of four nodes with no thickness between them.

Nodes go round the lower face and then round the upper one, as in the brick. The law is evaluated at the four pairs of
nodes (Newton-Cotes): with stiff layers, integration points between the nodes let tractions oscillate from node to node
(Schellekens and De Borst, Int. J. Numer. Meth. Eng. 36 (1993) 43-66).
"""

from __future__ import annotations

from dataclasses import dataclass

import numba as nb
import numpy as np
from numpy.typing import NDArray

from fem_service.cohesive_law import CohesiveLaw, separate
from fem_service.hexahedron import InvertedElement


@dataclass(frozen=True, eq=False)
class Separation:
    """Answer of cohesive layers to their openings.

    Attributes
    ----------
    traction : ndarray of float, shape (elements, 4, 3)
        On the upper face, against the opening, Pa.
    tangent, secant : ndarray of float, shape (elements, 4, 3, 3)
        Derivative of the traction, and traction = secant times opening; Pa/m.
    damage : ndarray of float, shape (elements, 4, 2)
        Damage and its viscous follower.
    """

    traction: NDArray[np.float64]
    tangent: NDArray[np.float64]
    secant: NDArray[np.float64]
    damage: NDArray[np.float64]


@nb.njit(nogil=True, cache=True)
def _separate_all(law, normals, openings, relaxation, before, after, traction, tangent):  # type: ignore[no-untyped-def]
    for e in range(len(openings)):
        for p in range(4):
            separate(
                law, normals[e, p], openings[e, p], relaxation, before[e, p], after[e, p], traction[e, p], tangent[e, p]
            )


class CohesiveLayers:
    """Cohesive elements of one mesh and one law.

    Parameters
    ----------
    nodes : ndarray of float, shape (nodes, 3)
        m.
    elements : ndarray of int64, shape (elements, 8)
    law : CohesiveLaw

    Attributes
    ----------
    elements : ndarray of int64, shape (elements, 8)
    areas : ndarray of float, shape (elements, 4)
        Share of each pair of nodes, m^2.
    normals : ndarray of float, shape (elements, 4, 3)
        From the lower to the upper face.

    Raises
    ------
    InvertedElement
        If the face of an element is turned over or has no area at a node.
    ValueError
        If a shape does not fit.
    """

    def __init__(self, nodes: NDArray[np.float64], elements: NDArray[np.int64], law: CohesiveLaw) -> None:
        if elements.ndim != 2 or elements.shape[1] != 8:
            raise ValueError(f"elements has shape {elements.shape}; it must have (elements, 8)")
        self.elements = np.ascontiguousarray(elements, dtype=np.int64)
        self.law = law
        middle = 0.5 * (nodes[elements[:, :4]] + nodes[elements[:, 4:]])
        # At a corner of a bilinear face the two tangents are half of its edges there.
        following = 0.5 * (np.roll(middle, -1, axis=1) - middle)
        preceding = 0.5 * (np.roll(middle, 1, axis=1) - middle)
        cross = np.cross(following, preceding)
        self.areas = np.linalg.norm(cross, axis=2)
        flat = np.cross(middle[:, 2] - middle[:, 0], middle[:, 3] - middle[:, 1])
        bad = np.flatnonzero((np.einsum("epi,ei->ep", cross, flat) <= 0.0).any(axis=1))
        if len(bad):
            raise InvertedElement(int(bad[0]), float(-self.areas[bad[0]].min()))
        self.normals = cross / self.areas[:, :, None]

    def openings(self, displacement: NDArray[np.float64]) -> NDArray[np.float64]:
        """Opening at the pairs of nodes, shape (elements, 4, 3), of nodal displacements, shape (nodes, 3), m."""
        return np.ascontiguousarray(displacement[self.elements[:, 4:]] - displacement[self.elements[:, :4]])

    def respond(
        self, openings: NDArray[np.float64], damage: NDArray[np.float64], relaxation: float = 1.0
    ) -> Separation:
        """Tractions and new damage; the arguments stay as they are.

        Parameters
        ----------
        openings : ndarray of float, shape (elements, 4, 3)
            m.
        damage : ndarray of float, shape (elements, 4, 2)
            Before the increment; zeros at first.
        relaxation : float
            See `fem_service.cohesive_law.separate`.
        """
        after, traction = np.empty_like(damage), np.empty_like(openings)
        tangent = np.empty((*openings.shape, 3))
        _separate_all(self.law.constants(), self.normals, openings, relaxation, damage, after, traction, tangent)
        return Separation(traction, tangent, self._secants(openings, after), after)

    def _secants(self, openings: NDArray[np.float64], damage: NDArray[np.float64]) -> NDArray[np.float64]:
        left = 1.0 - damage[:, :, 1, None, None]
        both = self.normals[:, :, :, None] * self.normals[:, :, None, :]
        closed = np.einsum("epi,epi->ep", openings, self.normals)[:, :, None, None] < 0.0
        secant: NDArray[np.float64] = self.law.stiffness * (left * np.eye(3) + np.where(closed, 1.0 - left, 0.0) * both)
        return secant

    def forces(self, traction: NDArray[np.float64]) -> NDArray[np.float64]:
        """Forces with which the layers hold their nodes, shape (elements, 24), N."""
        upper = (self.areas[:, :, None] * traction).reshape(len(self.elements), 12)
        return np.concatenate([-upper, upper], axis=1)

    def stiffnesses(self, tangent: NDArray[np.float64]) -> NDArray[np.float64]:
        """Element stiffness, shape (elements, 24, 24), N/m, of tangents, shape (elements, 4, 3, 3), Pa/m."""
        stiffness = np.zeros((len(self.elements), 24, 24))
        for p in range(4):
            own = self.areas[:, p, None, None] * tangent[:, p]
            low, high = slice(3 * p, 3 * p + 3), slice(12 + 3 * p, 15 + 3 * p)
            stiffness[:, low, low] = stiffness[:, high, high] = own
            stiffness[:, low, high] = stiffness[:, high, low] = -own
        return stiffness

    def overstress(self, openings: NDArray[np.float64], damage: NDArray[np.float64]) -> NDArray[np.float64]:
        """Traction that is there only because damage follows slowly, shape (elements, 4, 3), Pa."""
        along = np.einsum("epi,epi->ep", openings, self.normals)
        acting = openings - np.minimum(along, 0.0)[:, :, None] * self.normals
        late: NDArray[np.float64] = self.law.stiffness * (damage[:, :, 0] - damage[:, :, 1])[:, :, None] * acting
        return late

    def energy(self, separation: Separation, openings: NDArray[np.float64]) -> float:
        """Elastic energy that the layers hold, J."""
        return float(0.5 * np.einsum("ep,epi,epi->", self.areas, separation.traction, openings))
