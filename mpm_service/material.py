"""What the solver asks of a material, and the helpers to write one in plain numpy.

A material of your own is a class with five members; everything else has a default. A complete one, St. Venant and
Kirchhoff's law in plane strain::

    class SaintVenantKirchhoff(Material):
        density, assumption, lame, shear = 1000.0, "plane_strain", 2e9, 1e9
        pressure_wave_speed = ((2e9 + 2 * 1e9) / 1000.0) ** 0.5

        def _strain_and_stress(self, rows):
            gradient = displacement_gradient(rows, 2)
            turned = gradient.transpose(0, 2, 1)
            strain = 0.5 * (gradient + turned + turned @ gradient)  # Green's, without losing small ones in 1 + h
            trace = np.trace(strain, axis1=1, axis2=2)[:, None, None]
            return gradient, strain, self.lame * trace * np.eye(2) + 2.0 * self.shear * strain

        def update_stress(self, rows, ids, history):
            gradient, _, stress = self._strain_and_stress(rows)
            forward = np.eye(2) + gradient
            tau = forward @ stress @ forward.transpose(0, 2, 1)
            set_kirchhoff_stress(rows, np.stack([tau[:, 0, 0], tau[:, 1, 1], tau[:, 0, 1]], axis=1))

        def strain_energy(self, rows, ids, history):
            _, strain, stress = self._strain_and_stress(rows)
            return 0.5 * reference_volume(rows, 2) * np.sum(strain * stress, axis=(1, 2))
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Literal, NoReturn, get_args

import numpy as np
from numpy.typing import NDArray

from .material_points import columns

FloatArray = NDArray[np.float64]
IdArray = NDArray[np.int64]
Assumption = Literal["plane_stress", "plane_strain", "three_dimensional"]

# Plain integers, since kernels read them as constants.
GRADIENT_2D, STRESS_2D, VOLUME_2D = columns(2).gradient, columns(2).stress, columns(2).volume
HALF_2D = columns(2).half
GRADIENT_3D, STRESS_3D, VOLUME_3D = columns(3).gradient, columns(3).stress, columns(3).volume


class MaterialError(RuntimeError):
    """A point whose deformation the law has no stress for.

    Parameters
    ----------
    message : str
        Names law, point and the quantity that is out of range.
    row : int
        Row of the point in the rows that were handed over.
    point : int
        Stable id of the point.
    """

    def __init__(self, message: str, row: int, point: int) -> None:
        super().__init__(message)
        self.row = row
        self.point = point


class Material(ABC):
    """A constitutive law, called by the solver on slices of its point table.

    The law reads the displacement gradient ``H = F - I`` and writes the Kirchhoff stress ``tau = J sigma``, where J
    includes the thickness stretch in plane stress; the internal force is then ``-V0 tau : grad S`` with the
    reference volume V0, and ``tau = (dW/dF) F^T`` for an energy density W per reference volume. Work with H and not
    with F where strains may be small: ``1 + 1e-12`` has lost four digits, 1e-12 has not.

    Arguments that every method shares:

    rows : (n, COLUMNS) ndarray
        C-contiguous slice of the point table, 16 columns in the plane and 27 in space.
    ids : (n,) int64 ndarray
        Stable id of each row.
    history : (points, history_size) ndarray
        Table of the law's own variables for all points; row ``ids[i]`` belongs to ``rows[i]``. Updated in place by
        `update_stress` alone.

    Attributes
    ----------
    density : float
        Mass density of the undeformed material [kg/m^3].
    assumption : {"plane_stress", "plane_strain", "three_dimensional"}
        The kind of point table the law works on.
    """

    density: float
    assumption: Assumption

    @property
    @abstractmethod
    def pressure_wave_speed(self) -> float:
        """Speed of the fastest wave at rest [m/s]; sets the stable time step (Eq 31)."""

    @property
    def history_size(self) -> int:
        """Doubles the law keeps for a point; none unless it says otherwise."""
        return 0

    def start_history(self, count: int) -> FloatArray:
        """Return the history of `count` undeformed points, (count, history_size)."""
        return np.zeros((count, self.history_size))

    @abstractmethod
    def update_stress(self, rows: FloatArray, ids: IdArray, history: FloatArray) -> None:
        """Write the Kirchhoff stress [Pa] of each row's deformation into the row; advance the history.

        Called once for each strain update, on chunks of a few thousand rows.

        Raises
        ------
        MaterialError
            If the law has no stress for a point's deformation.
        """

    def tangent(self, rows: FloatArray, ids: IdArray, history: FloatArray) -> FloatArray:
        """Return the law's moduli at the present deformation, for statics [Pa], (n, 3, 3) or (n, 6, 6).

        What Kirchhoff stress gains with engineering strain of the present place, apart from turning and stretching
        with the material (the moduli of Truesdell's rate); components as those of stress. They need not be exact:
        Newton's method is then slower.

        Raises
        ------
        NotImplementedError
            If the law has none.
        """
        raise NotImplementedError(f"{type(self).__name__} has no tangent")

    @abstractmethod
    def strain_energy(self, rows: FloatArray, ids: IdArray, history: FloatArray) -> FloatArray:
        """Return the recoverable energy of each point [J], (n,)."""

    def dissipated(self, rows: FloatArray, ids: IdArray, history: FloatArray) -> FloatArray:
        """Return the energy each point has dissipated since the start [J], (n,)."""
        return np.zeros(rows.shape[0])

    def thickness_stretch(self, rows: FloatArray, ids: IdArray, history: FloatArray) -> FloatArray:
        """Return current over reference thickness, (n,): one unless in plane stress."""
        if self.assumption == "plane_stress":
            raise NotImplementedError(f"{type(self).__name__} is in plane stress and gives no thickness_stretch")
        return np.ones(rows.shape[0])

    def stress_zz(self, rows: FloatArray, ids: IdArray, history: FloatArray) -> FloatArray:
        """Return the Cauchy stress across the thickness [Pa], (n,), for output; plane laws only."""
        if self.assumption != "plane_stress":
            raise NotImplementedError(f"{type(self).__name__} gives no stress_zz for {self.assumption}")
        return np.zeros(rows.shape[0])


def displacement_gradient(rows: FloatArray, dim: int) -> FloatArray:
    """Return H = F - I of each row as a view, (n, dim, dim)."""
    first = GRADIENT_2D if dim == 2 else GRADIENT_3D
    return rows[:, first : first + dim * dim].reshape(-1, dim, dim)


def kirchhoff_stress(rows: FloatArray, dim: int) -> FloatArray:
    """Return the Kirchhoff stress of each row as a view [Pa], (n, 3) xx, yy, xy or (n, 6) xx, yy, zz, yz, xz, xy."""
    return rows[:, STRESS_2D : STRESS_2D + 3] if dim == 2 else rows[:, STRESS_3D : STRESS_3D + 6]


def set_kirchhoff_stress(rows: FloatArray, values: FloatArray) -> None:
    """Write the Kirchhoff stress of each row.

    Parameters
    ----------
    rows : (n, COLUMNS) ndarray
        Rows of the point table.
    values : (n, 3) or (n, 6) ndarray
        xx, yy, xy in the plane; xx, yy, zz, yz, xz, xy in space [Pa].
    """
    kirchhoff_stress(rows, 2 if values.shape[1] == 3 else 3)[:] = values


def reference_volume(rows: FloatArray, dim: int) -> FloatArray:
    """Return the weighted reference volume of each row as a view [m^3], (n,)."""
    return rows[:, VOLUME_2D if dim == 2 else VOLUME_3D]


def volume_change_beyond_trace(gradient: FloatArray) -> FloatArray:
    """Return det(I + H) - 1 - tr(H) of (n, d, d) gradients, terms of second and third order alone, (n,)."""
    trace = np.trace(gradient, axis1=1, axis2=2)
    minors = 0.5 * (trace**2 - np.einsum("nij,nji->n", gradient, gradient))
    return minors + np.linalg.det(gradient) if gradient.shape[1] == 3 else minors


def volume_change(gradient: FloatArray) -> FloatArray:
    """Return det(I + H) - 1 of (n, d, d) gradients without losing small ones, (n,)."""
    return np.trace(gradient, axis1=1, axis2=2) + volume_change_beyond_trace(gradient)


def embedded_gradient(gradient: FloatArray, thickness_strain: FloatArray) -> FloatArray:
    """Return in-plane gradients (n, 2, 2) and thickness strains (n,) as gradients in space, (n, 3, 3)."""
    full = np.zeros((gradient.shape[0], 3, 3))
    full[:, :2, :2] = gradient
    full[:, 2, 2] = thickness_strain
    return full


def require_above(name: str, value: float, limit: float, unit: str) -> None:
    """Raise ValueError unless `value` is finite and above `limit`."""
    if not (np.isfinite(value) and value > limit):
        raise ValueError(f"{name} = {value!r}: must be finite and above {limit:g} {unit}".rstrip())


def require_at_least(name: str, value: float, limit: float, unit: str) -> None:
    """Raise ValueError unless `value` is finite and not below `limit`."""
    if not (np.isfinite(value) and value >= limit):
        raise ValueError(f"{name} = {value!r}: must be finite and at least {limit:g} {unit}".rstrip())


def require_assumption(value: str) -> None:
    """Raise ValueError unless `value` is one of the three assumptions."""
    allowed = get_args(Assumption)
    if value not in allowed:
        raise ValueError(f"assumption = {value!r}: allowed are {', '.join(map(repr, allowed))}")


def raise_no_volume(law: str, rows: FloatArray, ids: IdArray, row: int) -> NoReturn:
    """Raise the MaterialError of a row whose volume is no longer positive."""
    gradient = displacement_gradient(rows[row : row + 1], 2 if rows.shape[1] == columns(2).width else 3)
    with np.errstate(invalid="ignore"):  # a gradient that is not a number is reported as such
        ratio = float(1.0 + volume_change(gradient)[0])
    raise MaterialError(
        f"{law} has no stress for point {int(ids[row])}: its volume is not positive (det F = {ratio:.6g}, "
        f"F - I = {gradient[0].tolist()}); a smaller time step or a finer grid is the usual cure",
        row,
        int(ids[row]),
    )
