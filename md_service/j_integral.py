"""J-integral from atoms (Sec 3.5): as a contour with nine-node elements and as a domain integral.

Both evaluate the flux of Eshelby's tensor in the reference configuration (Eq 76),

    J = int (W N_1 - H_i1 P_ij N_j) dA,   H = F - I,

from quantities that atoms have: the displacement, the energy of each atom and its virial. The virial of an atom over
its reference volume is the Kirchhoff stress tau = det(F) sigma, so the first Piola-Kirchhoff stress is
P = tau F^-T without any assumption of small strain; for small strains this is Eq 77.

Energy and virial are those relative to the same atom in the unloaded, cracked reference. With one bulk value for all
atoms the contour would count the energy of the crack's faces, which is wrong by that energy. The reference is not
free of stress: the crack's faces pull or push along their length, and the tip spreads that over the sheet. With its
stress tau_0 the energy holds a part tau_0 : H that is linear in the load and has no place in the quadratic flux of
the added load; it is taken off. What remains is the J of the load alone.

The crack comes from -x. All fields are taken as constant along z, the direction of the crack's front.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from md_service.nine_node import GAUSS_POINTS, GAUSS_WEIGHTS, NODES, shape_functions, shape_gradients
from md_service.weighted_fit import Fit, Slit, fit

#: Length of an element and width of a fit, in mean distances of atoms.
ELEMENT = 3.0
WIDTH = 1.5


class Contour:
    """J along a square around a crack's tip, as a map from atoms' values to a number (Eqs 76-78).

    The square is divided into segments, each the middle line of a nine-node element. The values at the elements'
    nodes are weighted least squares fits to the atoms on the same side of the crack; shape functions and three
    Gauss points a segment do the rest. The square ends at the faces of the crack.

    Parameters
    ----------
    reference : ndarray, shape (n, 2) or (n, 3)
        Atom positions without load, m.
    slit : Slit
        The crack; the square is centred on its tip.
    half_size : float
        Half the edge of the square, m.
    spacing : float
        Mean distance of atoms, m; sets the length of elements and the width of fits.
    without : ndarray of int64, optional
        Rows of atoms that are left out.

    Attributes
    ----------
    half_size : float
        m.

    Raises
    ------
    ValueError
        If the square is too small for elements or reaches beyond the atoms.
    """

    def __init__(
        self,
        reference: NDArray[np.float64],
        slit: Slit,
        half_size: float,
        spacing: float,
        without: NDArray[np.int64] | None = None,
    ) -> None:
        element = ELEMENT * spacing
        if not element + slit.half_gap <= half_size < np.inf:
            raise ValueError(
                f"half_size is {half_size:.4g} m; with elements of {element:.4g} m and a crack of half width "
                f"{slit.half_gap:.4g} m it must be at least {element + slit.half_gap:.4g} m"
            )
        self.half_size = half_size
        start, end = _segments(slit, half_size, element)
        half = 0.5 * np.linalg.norm(end - start, axis=1)
        tangent = (end - start) / (2.0 * half[:, None])
        normal = np.column_stack([tangent[:, 1], -tangent[:, 0]])
        frame = np.stack([half[:, None] * tangent, 0.5 * element * normal], axis=1)  # (segments, local axis, xy)
        nodes = 0.5 * (start + end)[:, None, :] + np.einsum("na,sax->snx", NODES, frame)
        try:
            at_nodes = fit(nodes.reshape(-1, 2), reference[:, :2], WIDTH * spacing, slit, without).value
        except ValueError as error:
            raise ValueError(f"contour of half_size {half_size:.4g} m: {error}") from error

        # Every Gauss point takes its value and gradient from the nine nodes of its element.
        shape = shape_functions(GAUSS_POINTS, np.zeros(3))
        local = shape_gradients(GAUSS_POINTS, np.zeros(3))
        gradient = np.einsum("sxa,gna->sgnx", np.linalg.inv(frame), local)
        everywhere = np.broadcast_to(shape, (len(start), *shape.shape))
        value, by_x, by_y = (_block(part) @ at_nodes for part in (everywhere, gradient[..., 0], gradient[..., 1]))
        self._fit = Fit(value.tocsr(), by_x.tocsr(), by_y.tocsr())
        self._normal = np.repeat(normal, 3, axis=0)
        self._length = (half[:, None] * GAUSS_WEIGHTS).ravel()

    def j(
        self,
        displacement: NDArray[np.float64],
        energy: NDArray[np.float64],
        virial: NDArray[np.float64],
        reference_virial: NDArray[np.float64] | None = None,
    ) -> float:
        """J from densities.

        Parameters
        ----------
        displacement : ndarray, shape (n, 2) or (n, 3)
            m.
        energy : ndarray, shape (n,)
            Of each atom over its reference volume, relative to the reference, J/m^3.
        virial : ndarray, shape (n, 6)
            Of each atom over its reference volume, relative to the reference: xx, yy, zz, xy, xz, yz, tension
            positive, Pa.
        reference_virial : ndarray, shape (n, 6), optional
            Of each atom in the reference, over its volume, Pa; none where the reference is free of stress.

        Returns
        -------
        float
            J/m^2.
        """
        smooth = self._fit
        gradient = np.stack([smooth.by_x @ displacement, smooth.by_y @ displacement], axis=-1)
        initial = None if reference_virial is None else smooth.value @ reference_virial
        flux = eshelby(gradient, smooth.value @ energy, smooth.value @ virial, initial)
        return float(np.einsum("g,gj,gj->", self._length, flux, self._normal))


class Domain:
    """J over a ring around a crack's tip, as a map from atoms' values to a number.

    Green's theorem turns the contour into ``J = -int M_j dq/dx_j dA`` with the flux M of Eq 76 and any q that is 1
    at the tip and 0 outside. Here q falls from 1 to 0 between two circles and the integral is a sum over the atoms
    between them, whose displacement gradients come from one-sided weighted least squares fits. Energy and virial
    enter as they are: a measure that shares no element with `Contour`.

    Parameters
    ----------
    reference : ndarray, shape (n, 2) or (n, 3)
        Atom positions without load, m.
    slit : Slit
        The crack; the circles are centred on its tip.
    inner, outer : float
        Radii, m.
    spacing : float
        Mean distance of atoms, m; sets the width of fits.
    area : float
        Of an atom in the plane, its volume over the thickness, m^2.
    without : ndarray of int64, optional
        Rows of atoms that are left out.

    Raises
    ------
    ValueError
        If the radii are not in order or the ring reaches beyond the atoms.
    """

    def __init__(
        self,
        reference: NDArray[np.float64],
        slit: Slit,
        inner: float,
        outer: float,
        spacing: float,
        area: float,
        without: NDArray[np.int64] | None = None,
    ) -> None:
        if not 0.0 < inner < outer < np.inf:
            raise ValueError(f"inner is {inner:.4g} m and outer {outer:.4g} m; needed is 0 < inner < outer")
        place = reference[:, :2]
        arm = place - [slit.tip_x, slit.y]
        radius = np.hypot(*arm.T)
        inside = (inner < radius) & (radius < outer)
        if without is not None:
            inside[without] = False
        self._rows = np.flatnonzero(inside)
        self._fit = fit(place[self._rows], place, WIDTH * spacing, slit, without)
        arm, radius = arm[self._rows], radius[self._rows]
        # q = cos^2 of a quarter period is smooth at both circles, which keeps the sum over atoms close to the integral.
        phase = np.pi * (radius - inner) / (outer - inner)
        slope = -0.5 * np.pi / (outer - inner) * np.sin(phase)
        self._weight = -area * slope[:, None] * arm / radius[:, None]

    def j(
        self,
        displacement: NDArray[np.float64],
        energy: NDArray[np.float64],
        virial: NDArray[np.float64],
        reference_virial: NDArray[np.float64] | None = None,
    ) -> float:
        """J from densities, J/m^2; arguments as for `Contour.j`."""
        gradient = np.stack([self._fit.by_x @ displacement, self._fit.by_y @ displacement], axis=-1)
        initial = None if reference_virial is None else reference_virial[self._rows]
        flux = eshelby(gradient, energy[self._rows], virial[self._rows], initial)
        return float(np.einsum("gj,gj->", flux, self._weight))


def eshelby(
    gradient: NDArray[np.float64],
    energy: NDArray[np.float64],
    virial: NDArray[np.float64],
    reference_virial: NDArray[np.float64] | None = None,
) -> NDArray[np.float64]:
    """First row of Eshelby's tensor of the added load, in the reference configuration (Eqs 66, 76).

    Parameters
    ----------
    gradient : ndarray, shape (n, 2 or 3, 2)
        Displacement gradient H_ij = du_i/dX_j from the reference.
    energy : ndarray, shape (n,)
        Energy over reference volume, relative to the reference, J/m^3.
    virial : ndarray, shape (n, 6)
        Kirchhoff stress relative to the reference as xx, yy, zz, xy, xz, yz, Pa.
    reference_virial : ndarray, shape (n, 6), optional
        Stress of the reference, Pa.

    Returns
    -------
    ndarray, shape (n, 2)
        ``(W - tau0_ik H_ik) delta_1j - H_i1 P_ij`` for j = 1, 2, J/m^3.
    """
    stretch = np.eye(2) + gradient[:, :2]
    piola = _in_plane(virial, gradient) @ np.swapaxes(np.linalg.inv(stretch), 1, 2)
    flux: NDArray[np.float64] = -np.einsum("ni,nij->nj", gradient[:, :, 0], piola)
    flux[:, 0] += energy
    if reference_virial is not None:
        flux[:, 0] -= np.einsum("nij,nij->n", _in_plane(reference_virial, gradient), gradient)
    return flux


def _in_plane(virial: NDArray[np.float64], gradient: NDArray[np.float64]) -> NDArray[np.float64]:
    """Components ij of a symmetric tensor with i as in the gradient and j = 1, 2."""
    return virial[:, [[0, 3], [3, 1], [4, 5]]][:, : gradient.shape[1]]


def _segments(slit: Slit, half_size: float, element: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Starts and ends of the segments, shape (s, 2), anticlockwise from the lower face of the crack to the upper."""
    c = half_size
    face = max(slit.half_gap, 1e-9 * c)  # a point on the line itself would lie on no side
    tip = np.array([slit.tip_x, slit.y])
    corners = tip + np.array([[-c, -face], [-c, -c], [c, -c], [c, c], [-c, c], [-c, face]])
    starts, ends = [], []
    for here, there in pairwise(corners):
        pieces = max(1, round(float(np.linalg.norm(there - here)) / element))
        fraction = np.linspace(0.0, 1.0, pieces + 1)[:, None]
        line = here + fraction * (there - here)
        starts.append(line[:-1])
        ends.append(line[1:])
    return np.concatenate(starts), np.concatenate(ends)


def _block(parts: NDArray[np.float64]) -> csr_matrix:
    """Block-diagonal matrix (3 s, 9 s) of parts with shape (s, 3, 9)."""
    s, rows, columns = parts.shape
    column = np.arange(s)[:, None, None] * columns + np.arange(columns)
    pointer = np.arange(s * rows + 1) * columns
    indices = np.broadcast_to(column, parts.shape).ravel()
    return csr_matrix((np.ascontiguousarray(parts).ravel(), indices, pointer), shape=(s * rows, s * columns))
