"""Continuum fields from atoms on a regular grid, averaged over space and time (Hardy, J. Chem. Phys. 76, 622, 1982).

With the localisation function Delta(r) = c (1 - r^2/R^2)^2 inside a radius R, of integral one:

    density      rho(x) = sum_i m_i Delta(r_i - x)
    velocity     rho v(x) = sum_i m_i v_i Delta(r_i - x); displacement alike
    stress       sigma(x) = - sum_pairs (r_i - r_j) (x) f_ij B_ij(x) - sum_i m_i u_i (x) u_i Delta(r_i - x)
    bond         B_ij(x) = integral over s from 0 to 1 of Delta(r_i + s (r_j - r_i) - x)
    temperature  -3 k T(x) sum_i Delta(r_i - x) = trace of the last sum

u is the velocity relative to the linear motion of the atoms around each atom (`md_service.thermal_stress`), where
Hardy takes v(x): that would make a stress of every shear and rotation.

The first sum of the stress needs forces by pairs; its divergence is the density of the forces on the atoms, exactly.
A many-body potential has no such forces that all agree on; there the virial of each atom is spread by Delta instead
(`virial` in `HardyAverage.add`). Both give the same integral over the body and the same value where the stress is
uniform; the spread virial puts half of each bond to either end, so near a face or a steep gradient it differs over
the length of a bond, and its divergence is not the force there: at a relaxed (100) face of a Lennard-Jones crystal,
where the stress across is zero, it tells up to 0.7 of the largest stress along the face.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from md_service.atoms import Box
from md_service.localisation import normalisation, spread_atoms, spread_bonds
from md_service.periodic_images import images_near
from md_service.thermal_stress import thermal_virial
from md_service.units import BOLTZMANN

#: Channels of the sums over atoms: number, mass, momentum, mass times displacement, virial, thermal virial.
_NUMBER, _MASS, _MOMENTUM, _DISPLACED, _VIRIAL, _THERMAL = 0, 1, slice(2, 5), slice(5, 8), slice(8, 14), slice(14, 20)
_CHANNELS = 20


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
        self._scale = normalisation(self._radius, grid.thickness)
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
        spread_atoms(row, image, values, self._low, self._spacing, self._flat, self._radius, self._scale, self._sum)
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
        spread_bonds(
            start,
            np.ascontiguousarray(pairs.separation[bond]),
            np.ascontiguousarray(pairs.force[bond]),
            self._low,
            self._spacing,
            self._flat,
            self._radius,
            self._scale,
            _VIRIAL.start,
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
