"""The eight-node brick C3D8 with 2 x 2 x 2 integration points.

Nodes of an element go round the lower face (negative third natural coordinate) and then round the upper one, both
counterclockwise seen from above::

        7 ---- 6
       /|     /|        t  s
      4 ---- 5 |        | /
      | 3 ---|-2        |/
      |/     |/         o --- r
      0 ---- 1

Strains have the order 11, 22, 33, 23, 13, 12 (x, y, z) with engineering shear. With `mean_dilatation` the volumetric
part of the strain is its mean over the element (Hughes, Int. J. Numer. Meth. Eng. 15 (1980) 1413-1418): the element
does not lock where the material hardly changes its volume. This is the selectively reduced integration of the
commercial codes.
"""

from __future__ import annotations

from typing import Final

import numba as nb
import numpy as np
from numpy.typing import NDArray

POINTS: Final = 8
#: Natural coordinates of the nodes, shape (8, 3); those of the integration points are 1 / sqrt 3 of them.
CORNERS: Final = np.array(
    [[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1], [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]],
    dtype=np.float64,
)
_GAUSS: Final = CORNERS / np.sqrt(3.0)


class InvertedElement(ValueError):
    """An element whose volume is not positive at some integration point.

    Attributes
    ----------
    element : int
    """

    def __init__(self, element: int, determinant: float) -> None:
        self.element = element
        super().__init__(
            f"element {element} is inverted or flat: its Jacobian determinant is {determinant:.3g} at an integration "
            "point; its nodes must go counterclockwise round the lower face and then round the upper one"
        )


@nb.njit(nogil=True, cache=True)
def _gradients(nodes, element, corners, point, gradient):  # type: ignore[no-untyped-def]
    """Fill the gradients of the shape functions, (8, 3), at a natural coordinate; return the Jacobian determinant."""
    jacobian = np.zeros((3, 3))
    natural = np.empty((8, 3))
    r, s, t = point
    for a in range(8):
        ra, sa, ta = corners[a]
        natural[a, 0] = 0.125 * ra * (1.0 + sa * s) * (1.0 + ta * t)
        natural[a, 1] = 0.125 * sa * (1.0 + ra * r) * (1.0 + ta * t)
        natural[a, 2] = 0.125 * ta * (1.0 + ra * r) * (1.0 + sa * s)
        for i in range(3):
            for j in range(3):
                jacobian[i, j] += natural[a, i] * nodes[element[a], j]
    c00 = jacobian[1, 1] * jacobian[2, 2] - jacobian[1, 2] * jacobian[2, 1]
    c01 = jacobian[1, 2] * jacobian[2, 0] - jacobian[1, 0] * jacobian[2, 2]
    c02 = jacobian[1, 0] * jacobian[2, 1] - jacobian[1, 1] * jacobian[2, 0]
    determinant = jacobian[0, 0] * c00 + jacobian[0, 1] * c01 + jacobian[0, 2] * c02
    if not determinant > 0.0:
        return determinant
    inverse = np.empty((3, 3))
    inverse[0, 0], inverse[1, 0], inverse[2, 0] = c00, c01, c02
    inverse[0, 1] = jacobian[0, 2] * jacobian[2, 1] - jacobian[0, 1] * jacobian[2, 2]
    inverse[1, 1] = jacobian[0, 0] * jacobian[2, 2] - jacobian[0, 2] * jacobian[2, 0]
    inverse[2, 1] = jacobian[0, 1] * jacobian[2, 0] - jacobian[0, 0] * jacobian[2, 1]
    inverse[0, 2] = jacobian[0, 1] * jacobian[1, 2] - jacobian[0, 2] * jacobian[1, 1]
    inverse[1, 2] = jacobian[0, 2] * jacobian[1, 0] - jacobian[0, 0] * jacobian[1, 2]
    inverse[2, 2] = jacobian[0, 0] * jacobian[1, 1] - jacobian[0, 1] * jacobian[1, 0]
    for a in range(8):
        for i in range(3):
            gradient[a, i] = (
                inverse[i, 0] * natural[a, 0] + inverse[i, 1] * natural[a, 1] + inverse[i, 2] * natural[a, 2]
            ) / determinant
    return determinant


@nb.njit(nogil=True, cache=True)
def _all_gradients(nodes, elements, corners, gauss, gradients, volumes):  # type: ignore[no-untyped-def]
    """Fill both for all elements; return the first bad element and its determinant, or -1."""
    for e in range(len(elements)):
        for p in range(8):
            determinant = _gradients(nodes, elements[e], corners, gauss[p], gradients[e, p])
            if not determinant > 0.0:
                return e, determinant
            volumes[e, p] = determinant  # all weights are one
    return -1, 0.0


@nb.njit(nogil=True, cache=True)
def _strain_operator(gradient, mean, dilated, operator):  # type: ignore[no-untyped-def]
    """Fill B, (6, 24), of one integration point; `mean` is the gradient's mean over the element, used if `dilated`."""
    operator[:] = 0.0
    for a in range(8):
        x, y, z = gradient[a]
        column = 3 * a
        operator[0, column] = x
        operator[1, column + 1] = y
        operator[2, column + 2] = z
        operator[3, column + 1] = z
        operator[3, column + 2] = y
        operator[4, column] = z
        operator[4, column + 2] = x
        operator[5, column] = y
        operator[5, column + 1] = x
        if dilated:
            for j in range(3):
                third = (mean[a, j] - gradient[a, j]) / 3.0
                for i in range(3):
                    operator[i, column + j] += third


@nb.njit(nogil=True, cache=True)
def _strains(gradients, volumes, elements, displacement, dilated, strain):  # type: ignore[no-untyped-def]
    operator, own, mean = np.empty((6, 24)), np.empty(24), np.empty((8, 3))
    for e in range(len(elements)):
        for a in range(8):
            for i in range(3):
                own[3 * a + i] = displacement[elements[e, a], i]
        _mean_gradient(gradients[e], volumes[e], mean)
        for p in range(8):
            _strain_operator(gradients[e, p], mean, dilated, operator)
            for i in range(6):
                total = 0.0
                for j in range(24):
                    total += operator[i, j] * own[j]
                strain[e, p, i] = total


@nb.njit(nogil=True, cache=True)
def _mean_gradient(gradients, volumes, mean):  # type: ignore[no-untyped-def]
    mean[:] = 0.0
    whole = 0.0
    for p in range(8):
        whole += volumes[p]
        for a in range(8):
            for i in range(3):
                mean[a, i] += volumes[p] * gradients[p, a, i]
    mean /= whole


@nb.njit(nogil=True, cache=True)
def _forces(gradients, volumes, dilated, stress, force):  # type: ignore[no-untyped-def]
    operator, mean = np.empty((6, 24)), np.empty((8, 3))
    for e in range(len(volumes)):
        _mean_gradient(gradients[e], volumes[e], mean)
        for j in range(24):
            force[e, j] = 0.0
        for p in range(8):
            _strain_operator(gradients[e, p], mean, dilated, operator)
            for j in range(24):
                total = 0.0
                for i in range(6):
                    total += operator[i, j] * stress[e, p, i]
                force[e, j] += volumes[e, p] * total


@nb.njit(nogil=True, cache=True, fastmath={"contract", "reassoc", "nsz"})
def _stiffnesses(gradients, volumes, dilated, tangents, index, stiffness):  # type: ignore[no-untyped-def]
    operator, mean, product = np.empty((6, 24)), np.empty((8, 3)), np.empty((6, 24))
    for e in range(len(volumes)):
        _mean_gradient(gradients[e], volumes[e], mean)
        stiffness[e] = 0.0
        for p in range(8):
            _strain_operator(gradients[e, p], mean, dilated, operator)
            tangent = tangents[index[e, p]]
            for i in range(6):
                for k in range(24):
                    product[i, k] = 0.0
                for j in range(6):
                    factor = volumes[e, p] * tangent[i, j]
                    for k in range(24):
                        product[i, k] += factor * operator[j, k]
            for j in range(24):
                for i in range(6):
                    factor = operator[i, j]
                    if factor != 0.0:
                        for k in range(24):
                            stiffness[e, j, k] += factor * product[i, k]


class Hexahedra:
    """Bricks of one mesh, with all that does not change while they deform.

    Parameters
    ----------
    nodes : ndarray of float, shape (nodes, 3)
        m.
    elements : ndarray of int64, shape (elements, 8)
        Indices of nodes.
    mean_dilatation : bool
        See the module.

    Attributes
    ----------
    elements : ndarray of int64, shape (elements, 8)
    volumes : ndarray of float, shape (elements, 8)
        Share of each integration point, m^3.

    Raises
    ------
    InvertedElement
        If the Jacobian determinant of an element is not positive at an integration point.
    ValueError
        If a shape does not fit or an index is beyond the nodes.
    """

    def __init__(
        self, nodes: NDArray[np.float64], elements: NDArray[np.int64], *, mean_dilatation: bool = False
    ) -> None:
        if nodes.ndim != 2 or nodes.shape[1] != 3:
            raise ValueError(f"nodes has shape {nodes.shape}; it must have (nodes, 3)")
        if elements.ndim != 2 or elements.shape[1] != 8:
            raise ValueError(f"elements has shape {elements.shape}; it must have (elements, 8)")
        if len(elements) and (elements.min() < 0 or elements.max() >= len(nodes)):
            raise ValueError(f"elements holds {elements.min()} to {elements.max()}; allowed is 0 to {len(nodes) - 1}")
        if not np.isfinite(nodes).all():
            raise ValueError("nodes holds a coordinate that is not finite")
        self.elements = np.ascontiguousarray(elements, dtype=np.int64)
        self.mean_dilatation = mean_dilatation
        self.volumes = np.empty((len(elements), POINTS))
        self._gradients = np.empty((len(elements), POINTS, 8, 3))
        bad, determinant = _all_gradients(
            np.ascontiguousarray(nodes, dtype=np.float64), self.elements, CORNERS, _GAUSS, self._gradients, self.volumes
        )
        if bad >= 0:
            raise InvertedElement(int(bad), float(determinant))

    def strains(self, displacement: NDArray[np.float64]) -> NDArray[np.float64]:
        """Strain at the integration points, shape (elements, 8, 6), of nodal displacements, shape (nodes, 3), m."""
        strain = np.empty((len(self.elements), POINTS, 6))
        _strains(self._gradients, self.volumes, self.elements, displacement, self.mean_dilatation, strain)
        return strain

    def forces(self, stress: NDArray[np.float64]) -> NDArray[np.float64]:
        """Forces with which elements hold their nodes, shape (elements, 24), N; by node, then by axis.

        Parameters
        ----------
        stress : ndarray of float, shape (elements, 8, 6)
            Pa.
        """
        force = np.empty((len(self.elements), 24))
        _forces(self._gradients, self.volumes, self.mean_dilatation, stress, force)
        return force

    def stiffnesses(self, tangents: NDArray[np.float64], index: NDArray[np.int64]) -> NDArray[np.float64]:
        """Element stiffness, shape (elements, 24, 24), N/m.

        Parameters
        ----------
        tangents : ndarray of float, shape (tangents, 6, 6)
            Table of material tangents in the axes of the mesh, Pa.
        index : ndarray of int64, shape (elements, 8)
            Row of the table for each integration point.
        """
        stiffness = np.empty((len(self.elements), 24, 24))
        _stiffnesses(self._gradients, self.volumes, self.mean_dilatation, tangents, index, stiffness)
        return stiffness

    def positions(self, nodes: NDArray[np.float64]) -> NDArray[np.float64]:
        """Positions of the integration points, shape (elements, 8, 3), m."""
        shape = np.prod(1.0 + CORNERS[None] * _GAUSS[:, None], axis=2) / 8.0
        return np.asarray(np.einsum("pa,eai->epi", shape, nodes[self.elements]), dtype=np.float64)
