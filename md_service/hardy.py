"""Continuum fields from atoms on a regular grid, averaged over space and time (Hardy, J. Chem. Phys. 76, 622, 1982).

With the localisation function Delta(r) = c (1 - r^2/R^2)^2 inside a radius R, of integral one:

    density      rho(x) = sum_i m_i Delta(r_i - x)
    velocity     rho v(x) = sum_i m_i v_i Delta(r_i - x); displacement alike
    stress       sigma(x) = - sum_pairs (r_i - r_j) (x) f_ij B_ij(x) - sum_i m_i u_i (x) u_i Delta(r_i - x)
    bond         B_ij(x) = integral over s from 0 to 1 of Delta(r_i + s (r_j - r_i) - x)
    temperature  -3 k T(x) sum_i Delta(r_i - x) = trace of the last sum

u is the velocity relative to the linear motion of the atoms around each atom (`md_service.thermal_stress`), where
Hardy takes v(x): that would make a stress of every shear and rotation.

The first sum of the stress needs forces by pairs and satisfies the balance of momentum with rho and v exactly. A
many-body potential has no such forces that all agree on; there the virial of each atom is spread by Delta instead
(`virial` in `HardyAverage.add`). Both give the same integral over the body and the same value where the stress is
uniform; the spread virial puts half of each bond to either end, so near a face or a steep gradient it differs over
the length of a bond, and its divergence is not the force there.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from md_service.atoms import Box
from md_service.periodic_images import images_near
from md_service.thermal_stress import thermal_virial
from md_service.units import BOLTZMANN

#: Channels of the sums over atoms: number, mass, momentum, mass times displacement, virial, thermal virial.
_NUMBER, _MASS, _MOMENTUM, _DISPLACED, _VIRIAL, _THERMAL = 0, 1, slice(2, 5), slice(5, 8), slice(8, 14), slice(14, 20)
_CHANNELS = 20
_FIRST_VIRIAL = _VIRIAL.start  # numba takes no slice from outside


@dataclass(frozen=True)
class HardyGrid:
    """Regular grid of cells; fields are told at their centres.

    Attributes
    ----------
    low : ndarray, shape (d,)
        Corner, m. d = 2 for a sheet in the plane of x and y, d = 3 else.
    spacing : ndarray, shape (d,)
        Edges of a cell, m.
    shape : tuple of int, length d
        Number of cells.
    thickness : float, optional
        Of the sheet, m, with d = 2.
    """

    low: NDArray[np.float64]
    spacing: NDArray[np.float64]
    shape: tuple[int, ...]
    thickness: float | None = None

    def __post_init__(self) -> None:
        d = len(self.shape)
        if d not in (2, 3) or len(self.low) != d or len(self.spacing) != d:
            raise ValueError(f"shape is {self.shape}; low, spacing and shape need 2 or 3 entries each")
        if min(self.shape) < 1 or not (np.isfinite(self.spacing).all() and np.min(self.spacing) > 0.0):
            raise ValueError(f"shape is {self.shape}, spacing {self.spacing} m; all must be positive")
        if (d == 2) != (self.thickness is not None) or (self.thickness is not None and not self.thickness > 0.0):
            raise ValueError(f"thickness is {self.thickness}; a grid of 2 dimensions needs a positive one, of 3 none")

    @property
    def cell_volume(self) -> float:
        """m^3."""
        return float(np.prod(self.spacing) * (1.0 if self.thickness is None else self.thickness))

    def centres(self) -> list[NDArray[np.float64]]:
        """Coordinates of the cells' centres along each axis, m."""
        return [low + h * (np.arange(n) + 0.5) for low, h, n in zip(self.low, self.spacing, self.shape, strict=True)]


def grid_over(box: Box, spacing: float, thickness: float | None = None, margin: float = 0.0) -> HardyGrid:
    """Grid over a box, in the plane of x and y if a thickness is given.

    Parameters
    ----------
    box : Box
        Periodic directions are divided into a whole number of cells.
    spacing : float
        Edge of a cell at most, m.
    thickness : float, optional
        Of a sheet, m.
    margin : float
        Added on either side in free directions, m. With the radius of the localisation no mass is cut off.

    Raises
    ------
    ValueError
        For a spacing that is not positive, or a box without extent.
    """
    if not (np.isfinite(spacing) and spacing > 0.0):
        raise ValueError(f"spacing is {spacing} m; it must be finite and positive")
    d = 3 if thickness is None else 2
    extra = np.where(box.periodic, 0.0, margin)[:d]
    low, high = box.low[:d] - extra, box.high[:d] + extra
    if not (high > low).all():
        raise ValueError(f"box is {box.low} to {box.high} m; it needs an extent along every axis of the grid")
    count = np.maximum(np.ceil((high - low) / spacing * (1.0 - 1e-12)), 1.0).astype(np.int64)
    return HardyGrid(low, (high - low) / count, tuple(int(n) for n in count), thickness)


@dataclass(frozen=True)
class PairForces:
    """Forces by pairs of atoms, each pair once.

    Attributes
    ----------
    first : ndarray of int64, shape (p,)
        Row of the atom i.
    separation : ndarray, shape (p, 3)
        r_i - r_j of the nearest images, m.
    force : ndarray, shape (p, 3)
        On i by j, N.
    """

    first: NDArray[np.int64]
    separation: NDArray[np.float64]
    force: NDArray[np.float64]


@dataclass(frozen=True)
class HardyFields:
    """Means over the samples; arrays start with the shape of the grid.

    Attributes
    ----------
    grid : HardyGrid
    samples : int
    density : ndarray, shape (...)
        kg/m^3.
    velocity, displacement : ndarray, shape (..., 3)
        m/s and m; NaN where there are no atoms.
    temperature : ndarray, shape (...)
        K, for three degrees of freedom per atom; NaN where there are no atoms.
    stress, thermal_stress : ndarray, shape (..., 6)
        xx, yy, zz, xy, xz, yz, Pa, tension positive; the whole and its thermal part.
    """

    grid: HardyGrid
    samples: int
    density: NDArray[np.float64]
    velocity: NDArray[np.float64]
    displacement: NDArray[np.float64]
    temperature: NDArray[np.float64]
    stress: NDArray[np.float64]
    thermal_stress: NDArray[np.float64]


class HardyAverage:
    """Sums of Hardy's fields over samples of a run.

    Parameters
    ----------
    grid : HardyGrid
    box : Box
        For its periodic directions.
    mass : array_like, shape (n,)
        kg.
    radius : float
        Of the localisation function, m. The sum over the grid carries the mass to 1 % from 2 cells on and to 0.1 %
        from 4; a radius of three spacings of a crystal smooths its lattice out to a few percent.
    thermal_radius : float, optional
        Of the motion that velocities are taken relative to, m; see `md_service.thermal_stress`. The same radius
        without it.

    Raises
    ------
    ValueError
        If the radius is not positive.
    """

    def __init__(
        self, grid: HardyGrid, box: Box, mass: ArrayLike, radius: float, thermal_radius: float | None = None
    ) -> None:
        if not (np.isfinite(radius) and radius > 0.0):
            raise ValueError(f"radius is {radius} m; it must be finite and positive")
        self.grid = grid
        self.samples = 0
        d = len(grid.shape)
        # Across the plane of a flat grid every atom counts once, however thin a periodic box is.
        self._box = box if d == 3 else replace(box, periodic=(box.periodic[0], box.periodic[1], False))
        self._thermal_box = box
        self._mass = np.array(mass, dtype=np.float64)
        self._radius = float(radius)
        self._thermal_radius = self._radius if thermal_radius is None else float(thermal_radius)
        # A grid in the plane is one layer of cells at height 0, and distances across it do not count.
        self._low, self._spacing, self._shape = np.zeros(3), np.ones(3), np.ones(3, dtype=np.int64)
        self._low[:d], self._spacing[:d], self._shape[:d] = grid.low, grid.spacing, grid.shape
        self._flat = d == 2
        # The integral of (1 - r^2/R^2)^2 over the sphere, or over the disc times the thickness.
        if grid.thickness is None:
            self._scale = 105.0 / (32.0 * np.pi * radius**3)
        else:
            self._scale = 3.0 / (np.pi * radius**2 * grid.thickness)
        self._sum = np.zeros((*self._shape, _CHANNELS))

    def add(
        self,
        position: ArrayLike,
        velocity: ArrayLike,
        *,
        virial: ArrayLike | None = None,
        pairs: PairForces | None = None,
        displacement: ArrayLike | None = None,
        thermal: ArrayLike | None = None,
    ) -> None:
        """Add one sample.

        Parameters
        ----------
        position, velocity : array_like, shape (n, 3)
            m and m/s. The fields are where the positions are; give reference positions for fields of the
            undeformed body.
        virial : array_like, shape (n, 6), optional
            Of each atom, J, tension positive, such as `Dynamics.virial_and_energy` tells, to be spread around it.
        pairs : PairForces, optional
            Forces that are spread along the bonds instead. What pairs do not cover may be given as virial beside.
        displacement : array_like, shape (n, 3), optional
            m; without it the displacement field counts it as zero.
        thermal : array_like, shape (n, 6), optional
            `thermal_virial` of the atoms, or its mean over time, J; without it that of these velocities.

        Raises
        ------
        ValueError
            For an array of the wrong shape, values that are not finite, or if there is neither virial nor pairs.
        """
        n = len(self._mass)
        if virial is None and pairs is None:
            raise ValueError("virial and pairs are both absent; the stress needs one of them")
        at = _rows("position", position, (n, 3))
        moving = _rows("velocity", velocity, (n, 3))
        values = np.zeros((n, _CHANNELS))
        values[:, _NUMBER] = 1.0
        values[:, _MASS] = self._mass
        values[:, _MOMENTUM] = self._mass[:, None] * moving
        if displacement is not None:
            values[:, _DISPLACED] = self._mass[:, None] * _rows("displacement", displacement, (n, 3))
        if virial is not None:
            values[:, _VIRIAL] = _rows("virial", virial, (n, 6))
        if thermal is not None:
            values[:, _THERMAL] = _rows("thermal", thermal, (n, 6))
        else:
            values[:, _THERMAL] = thermal_virial(at, moving, self._mass, self._thermal_box, self._thermal_radius)
        bonds = None if pairs is None else self._checked_pairs(pairs)
        row, image = images_near(at, self._box, self._radius)
        _spread_atoms(row, image, values, self._low, self._spacing, self._flat, self._radius, self._scale, self._sum)
        if bonds is not None:
            self._spread_pairs(at, bonds)
        self.samples += 1

    def _checked_pairs(self, pairs: PairForces) -> PairForces:
        first = np.asarray(pairs.first, dtype=np.int64)
        if first.ndim != 1 or (len(first) and (first.min() < 0 or first.max() >= len(self._mass))):
            raise ValueError(f"pairs.first must be a list of rows from 0 to {len(self._mass) - 1}")
        shape = (len(first), 3)
        return PairForces(
            first, _rows("pairs.separation", pairs.separation, shape), _rows("pairs.force", pairs.force, shape)
        )

    def _spread_pairs(self, position: NDArray[np.float64], pairs: PairForces) -> None:
        reach = np.sqrt(np.max(np.sum(pairs.separation**2, axis=1), initial=0.0))
        bond, start = images_near(position[pairs.first], self._box, self._radius + float(reach))
        _spread_bonds(
            start,
            np.ascontiguousarray(pairs.separation[bond]),
            np.ascontiguousarray(pairs.force[bond]),
            self._low,
            self._spacing,
            self._flat,
            self._radius,
            self._scale,
            self._sum,
        )

    def fields(self) -> HardyFields:
        """Means over the samples so far.

        Raises
        ------
        ValueError
            If there are none.
        """
        if self.samples == 0:
            raise ValueError("there are no samples yet: call add first")
        total = self._sum.reshape(*self.grid.shape, _CHANNELS)
        mean = total / self.samples
        mass = np.where(total[..., _MASS] > 0.0, total[..., _MASS], np.nan)
        number = np.where(total[..., _NUMBER] > 0.0, total[..., _NUMBER], np.nan)
        return HardyFields(
            grid=self.grid,
            samples=self.samples,
            density=mean[..., _MASS],
            velocity=total[..., _MOMENTUM] / mass[..., None],
            displacement=total[..., _DISPLACED] / mass[..., None],
            temperature=-total[..., _THERMAL][..., :3].sum(axis=-1) / (3.0 * BOLTZMANN * number),
            stress=mean[..., _VIRIAL] + mean[..., _THERMAL],
            thermal_stress=mean[..., _THERMAL],
        )


def _rows(name: str, value: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float64]:
    array = np.ascontiguousarray(value, dtype=np.float64)
    if array.shape != shape:
        raise ValueError(f"{name} has shape {array.shape}; {shape} is needed")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} holds values that are not finite")
    return array


@njit(nogil=True, cache=True)
def _cells_near(near: float, far: float, low: float, spacing: float, count: int, radius: float) -> tuple[int, int]:
    """First and behind the last cell along an axis whose centre lies within a radius of the stretch near to far."""
    first = int(np.ceil((near - radius - low) / spacing - 0.5))
    last = int(np.floor((far + radius - low) / spacing - 0.5))
    return max(first, 0), min(last + 1, count)


@njit(nogil=True, cache=True)
def _spread_atoms(
    row: NDArray[np.int64],
    image: NDArray[np.float64],
    values: NDArray[np.float64],
    low: NDArray[np.float64],
    spacing: NDArray[np.float64],
    flat: bool,
    radius: float,
    scale: float,
    total: NDArray[np.float64],
) -> None:
    """Add values times the localisation function to the cells around each image."""
    nx, ny, nz, channels = total.shape
    for i in range(len(row)):
        px, py, pz = image[i]
        x0, x1 = _cells_near(px, px, low[0], spacing[0], nx, radius)
        y0, y1 = _cells_near(py, py, low[1], spacing[1], ny, radius)
        z0, z1 = (0, 1) if flat else _cells_near(pz, pz, low[2], spacing[2], nz, radius)
        for cx in range(x0, x1):
            dx = low[0] + (cx + 0.5) * spacing[0] - px
            for cy in range(y0, y1):
                dy = low[1] + (cy + 0.5) * spacing[1] - py
                for cz in range(z0, z1):
                    dz = 0.0 if flat else low[2] + (cz + 0.5) * spacing[2] - pz
                    q = (dx * dx + dy * dy + dz * dz) / radius**2
                    if q < 1.0:
                        weight = scale * (1.0 - q) ** 2
                        for k in range(channels):
                            total[cx, cy, cz, k] += weight * values[row[i], k]


@njit(nogil=True, cache=True)
def _spread_bonds(
    start: NDArray[np.float64],
    separation: NDArray[np.float64],
    force: NDArray[np.float64],
    low: NDArray[np.float64],
    spacing: NDArray[np.float64],
    flat: bool,
    radius: float,
    scale: float,
    total: NDArray[np.float64],
) -> None:
    """Add the virial of each bond times its bond function to the cells around it.

    Along a bond the localisation function is a polynomial of degree four between the points where the bond enters
    and leaves the sphere around a cell's centre, so three Gauss points integrate it exactly.
    """
    nx, ny, nz, _ = total.shape
    gauss, weight = np.sqrt(0.6), (5.0 / 18.0, 8.0 / 18.0, 5.0 / 18.0)
    w = np.empty(6)
    for b in range(len(start)):
        px, py, pz = start[b]
        sx, sy, sz = -separation[b, 0], -separation[b, 1], -separation[b, 2]
        fx, fy, fz = force[b]
        w[0], w[1], w[2] = sx * fx, sy * fy, sz * fz
        w[3], w[4], w[5] = 0.5 * (sx * fy + sy * fx), 0.5 * (sx * fz + sz * fx), 0.5 * (sy * fz + sz * fy)
        x0, x1 = _cells_near(min(px, px + sx), max(px, px + sx), low[0], spacing[0], nx, radius)
        y0, y1 = _cells_near(min(py, py + sy), max(py, py + sy), low[1], spacing[1], ny, radius)
        z0, z1 = 0, 1
        if flat:
            pz, sz = 0.0, 0.0
        else:
            z0, z1 = _cells_near(min(pz, pz + sz), max(pz, pz + sz), low[2], spacing[2], nz, radius)
        square = (sx * sx + sy * sy + sz * sz) / radius**2
        for cx in range(x0, x1):
            dx = (px - low[0] - (cx + 0.5) * spacing[0]) / radius
            for cy in range(y0, y1):
                dy = (py - low[1] - (cy + 0.5) * spacing[1]) / radius
                for cz in range(z0, z1):
                    dz = 0.0 if flat else (pz - low[2] - (cz + 0.5) * spacing[2]) / radius
                    # q(s) = here + 2 along s + square s^2 is the squared distance over the bond.
                    here = dx * dx + dy * dy + dz * dz
                    along = (dx * sx + dy * sy + dz * sz) / radius
                    enter, leave = 0.0, 1.0
                    if square > 0.0:
                        root = along * along - square * (here - 1.0)
                        if root <= 0.0:
                            continue
                        root = np.sqrt(root)
                        enter = max((-along - root) / square, 0.0)
                        leave = min((-along + root) / square, 1.0)
                    elif here >= 1.0:
                        continue
                    if leave <= enter:
                        continue
                    share = 0.0
                    for g in range(3):
                        s = 0.5 * (enter + leave) + 0.5 * (leave - enter) * gauss * (g - 1)
                        share += weight[g] * (1.0 - (here + 2.0 * along * s + square * s * s)) ** 2
                    share *= scale * (leave - enter)
                    for k in range(6):
                        total[cx, cy, cz, _FIRST_VIRIAL + k] += share * w[k]
