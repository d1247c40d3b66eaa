"""The thermal part of the virial stress (Eq 79), from velocities relative to the local mean.

u in Eq 79 is the velocity of an atom relative to the motion of the body where the atom is. Here that motion is the
weighted least-squares line through the velocities of the atoms around, so a body that moves, turns or is sheared has
no stress of it, at its edges neither. An atom has a share in that line, which takes some of its own thermal motion
away; the velocities of atoms in equilibrium are independent of each other, so the loss is known, and made good.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.sparse import csr_array

from md_service.atoms import Atoms, Box
from md_service.periodic_images import images_near

NEIGHBOURS: Final = 24  # atoms within the averaging radius
# Neighbours that spread less than this part of the radius along a direction tell no gradient along it: the
# direction off a flat sheet.
_LEAST_SPREAD: Final = 0.01
# An atom that keeps less than this part of its thermal motion is alone, and its motion is the body's.
_LEAST_SHARE: Final = 0.05


def averaging_radius(atoms: Atoms) -> float:
    """Radius of a sphere, for a sheet of a disc, that holds 24 atoms, m."""
    if atoms.thickness is None:
        return float((3.0 * NEIGHBOURS * atoms.volume / (4.0 * np.pi * len(atoms))) ** (1.0 / 3.0))
    return float(np.sqrt(NEIGHBOURS * atoms.volume / (np.pi * len(atoms) * atoms.thickness)))


def thermal_virial(
    position: NDArray[np.float64],
    velocity: NDArray[np.float64],
    mass: NDArray[np.float64],
    box: Box,
    radius: float,
) -> NDArray[np.float64]:
    """-m u (x) u of each atom, u relative to the motion of the atoms around it.

    In equilibrium its mean is -k T on the diagonal for each atom. Divided by the atom's volume and added to the
    virial of the forces it is the stress of Eq 79, tension positive.

    Parameters
    ----------
    position, velocity : ndarray, shape (n, 3)
        m and m/s.
    mass : ndarray, shape (n,)
        kg.
    box : Box
        For its periodic directions.
    radius : float
        Of the weight (1 - r^2/R^2)^2, m; see `averaging_radius`. A periodic box should be two of it wide: in a
        narrower one an atom meets its own images, which the correction for its share does not know.

    Returns
    -------
    ndarray, shape (n, 6)
        xx, yy, zz, xy, xz, yz, J; zero for an atom without neighbours.

    Raises
    ------
    ValueError
        If the radius is not positive or an array's length is wrong.
    """
    local, share = local_motion(position, velocity, mass, box, radius)
    u = velocity - local
    kept = np.divide(mass, share, out=np.zeros_like(mass), where=share > _LEAST_SHARE)
    return _flux(kept, u)


def local_motion(
    position: NDArray[np.float64],
    velocity: NDArray[np.float64],
    mass: NDArray[np.float64],
    box: Box,
    radius: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Velocity of the body at each atom, and the share of the atom's thermal energy that is left relative to it.

    Parameters
    ----------
    position, velocity, mass, box, radius
        As in `thermal_virial`.

    Returns
    -------
    local : ndarray, shape (n, 3)
        m/s.
    share : ndarray, shape (n,)
        Mean of m u^2 / k T per direction if thermal velocities are independent: 0 for an atom alone, towards 1 for
        many neighbours.

    Raises
    ------
    ValueError
        If the radius is not positive or an array's length is wrong.
    """
    if not (np.isfinite(radius) and radius > 0.0):
        raise ValueError(f"radius is {radius} m; it must be finite and positive")
    n = len(position)
    for name, array, shape in (("position", position, (n, 3)), ("velocity", velocity, (n, 3)), ("mass", mass, (n,))):
        if array.shape != shape:
            raise ValueError(f"{name} has shape {array.shape}; {shape} is needed")
        if not np.isfinite(array).all():
            raise ValueError(f"{name} holds values that are not finite")
    stencil = _stencils(position, mass, box, radius)
    return np.ascontiguousarray(stencil @ velocity), _share(stencil, mass)


class ThermalVirial:
    """`thermal_virial` for atoms that stay near their places, with the fits done once at the places given.

    Parameters
    ----------
    atoms : Atoms
        A solid; its positions are the places.
    """

    def __init__(self, atoms: Atoms) -> None:
        mass = atoms.atom_mass
        self._stencil = _stencils(atoms.position, mass, atoms.box, averaging_radius(atoms))
        share = _share(self._stencil, mass)
        self._kept = np.divide(mass, share, out=np.zeros_like(mass), where=share > _LEAST_SHARE)

    def of(self, velocity: NDArray[np.float64]) -> NDArray[np.float64]:
        """-m u (x) u of each atom, J, shape (n, 6), for velocities (n, 3) in m/s."""
        return _flux(self._kept, velocity - self._stencil @ velocity)


def _flux(kept: NDArray[np.float64], u: NDArray[np.float64]) -> NDArray[np.float64]:
    x, y, z = u.T
    return np.ascontiguousarray(-kept[:, None] * np.stack([x * x, y * y, z * z, x * y, x * z, y * z], axis=1))


def _share(stencil: csr_array, mass: NDArray[np.float64]) -> NDArray[np.float64]:
    """What is left of an atom's thermal energy relative to the fit, of independent velocities of variance kT/m."""
    squares = csr_array((stencil.data**2, stencil.indices, stencil.indptr), shape=stencil.shape)
    return np.asarray(1.0 - 2.0 * stencil.diagonal() + mass * (squares @ (1.0 / mass)))


def _stencils(position: NDArray[np.float64], mass: NDArray[np.float64], box: Box, radius: float) -> csr_array:
    """Matrix (n, n) that takes velocities to the velocity of the body at each atom."""
    n = len(position)
    if n == 0:
        return csr_array((0, 0))
    row, image = images_near(position, box, radius)
    low = image.min(axis=0)
    shape3 = np.maximum(np.floor((image.max(axis=0) - low) / radius).astype(np.int64), 0) + 1
    # Far fewer cells than atoms are of no harm, far more would be: a lone atom far out must not cost memory.
    size = radius
    while np.prod(shape3) > 8 * len(image) + 64:
        size *= 2.0
        shape3 = np.maximum(np.floor((image.max(axis=0) - low) / size).astype(np.int64), 0) + 1
    count = np.zeros(n, dtype=np.int64)
    arguments = (row, image, mass, radius, low, size, shape3, n)
    _fit_around_atoms(*arguments, count, np.zeros(0, dtype=np.int64), np.zeros(0))
    behind = np.cumsum(count)
    column, share = np.zeros(behind[-1], dtype=np.int64), np.zeros(behind[-1])
    _fit_around_atoms(*arguments, behind - count, column, share)
    stencil = csr_array((share, column, np.concatenate([[0], behind])), shape=(n, n))
    stencil.sum_duplicates()  # several images of one atom
    return stencil


@njit(nogil=True, cache=True)
def _fit_around_atoms(
    row: NDArray[np.int64],
    image: NDArray[np.float64],
    mass: NDArray[np.float64],
    radius: float,
    low: NDArray[np.float64],
    size: float,
    shape: NDArray[np.int64],
    n: int,
    place: NDArray[np.int64],
    column: NDArray[np.int64],
    share: NDArray[np.float64],
) -> None:
    """Shares of the atoms around in a linear fit at each atom; images sorted into cells of at least one radius.

    Atom i writes its columns and shares from `place[i]` on; where there is no room for any, it counts them there.
    """
    n_images, n_cells = len(image), shape[0] * shape[1] * shape[2]
    cell = np.empty((n_images, 3), dtype=np.int64)
    start = np.zeros(n_cells + 1, dtype=np.int64)
    for i in range(n_images):
        for a in range(3):
            cell[i, a] = min(int((image[i, a] - low[a]) / size), shape[a] - 1)
        start[(cell[i, 0] * shape[1] + cell[i, 1]) * shape[2] + cell[i, 2] + 1] += 1
    for c in range(n_cells):
        start[c + 1] += start[c]
    filled = start[:-1].copy()
    order = np.empty(n_images, dtype=np.int64)
    for i in range(n_images):
        c = (cell[i, 0] * shape[1] + cell[i, 1]) * shape[2] + cell[i, 2]
        order[filled[c]] = i
        filled[c] += 1

    near = np.empty(n_images, dtype=np.int64)
    offset = np.empty((n_images, 3))
    weight = np.empty(n_images)
    spread, lever = np.empty((3, 3)), np.empty(3)
    inverse = 1.0 / radius
    for i in range(n):
        found = 0
        total = mx = my = mz = xx = yy = zz = xy = xz = yz = 0.0
        for cx in range(max(cell[i, 0] - 1, 0), min(cell[i, 0] + 2, shape[0])):
            for cy in range(max(cell[i, 1] - 1, 0), min(cell[i, 1] + 2, shape[1])):
                # Cells along z follow each other.
                first = (cx * shape[1] + cy) * shape[2]
                behind = first + min(cell[i, 2] + 2, shape[2])
                for s in range(start[first + max(cell[i, 2] - 1, 0)], start[behind]):
                    j = order[s]
                    x = (image[j, 0] - image[i, 0]) * inverse
                    y = (image[j, 1] - image[i, 1]) * inverse
                    z = (image[j, 2] - image[i, 2]) * inverse
                    q = x * x + y * y + z * z
                    if q >= 1.0:
                        continue
                    w = mass[row[j]] * (1.0 - q) ** 2
                    near[found], weight[found] = row[j], w
                    offset[found, 0], offset[found, 1], offset[found, 2] = x, y, z
                    total += w
                    mx, my, mz = mx + w * x, my + w * y, mz + w * z
                    xx, yy, zz = xx + w * x * x, yy + w * y * y, zz + w * z * z
                    xy, xz, yz = xy + w * x * y, xz + w * x * z, yz + w * y * z
                    found += 1
        if len(column) == 0:
            place[i] = found
            continue
        mx, my, mz = mx / total, my / total, mz / total
        spread[0, 0], spread[1, 1], spread[2, 2] = xx / total - mx * mx, yy / total - my * my, zz / total - mz * mz
        spread[0, 1] = spread[1, 0] = xy / total - mx * my
        spread[0, 2] = spread[2, 0] = xz / total - mx * mz
        spread[1, 2] = spread[2, 1] = yz / total - my * mz
        # An atom at offset d adds its velocity to the line's value here with weight (1 + (d - mean) . lever).
        lever[:] = 0.0
        value, vector = np.linalg.eigh(spread)
        for k in range(3):
            if value[k] > _LEAST_SPREAD**2:
                along = -(vector[0, k] * mx + vector[1, k] * my + vector[2, k] * mz) / value[k]
                for a in range(3):
                    lever[a] += along * vector[a, k]
        base = 1.0 - (mx * lever[0] + my * lever[1] + mz * lever[2])
        for f in range(found):
            lean = offset[f, 0] * lever[0] + offset[f, 1] * lever[1] + offset[f, 2] * lever[2]
            column[place[i] + f] = near[f]
            share[place[i] + f] = weight[f] / total * (base + lean)
