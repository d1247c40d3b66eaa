"""A cell with softening subcells at many points: the history of a point holds their damage."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gmc_service.cell import Cell
from gmc_service.component_order import COMPONENTS
from gmc_service.failure import MAXIMUM_STRAIN, Checks
from gmc_service.gmc_reduced import solve_subcells
from gmc_service.mask_table import pack_mask, unpack_mask
from gmc_service.softening import VALUES, length_share, respond


class SofteningCell:
    """A cell of which at least one material has a fracture energy; see `gmc_service.softening` for the law.

    Subcells without fracture energy fail by elimination, in the same repetition. No table can hold the states: the
    damages are continuous, so each point at which something softens has a factorisation for each round of its
    repetition, and a tangent of its own.

    Parameters
    ----------
    cell : Cell
    method : str
        ``gmc``.
    checks : Checks
        Of the cell.

    Attributes
    ----------
    values : int
        History values of a point: for each softening subcell in flat order its damage d and its r_f.
    subcells : ndarray of int64
        The softening ones.

    Raises
    ------
    ValueError
        If the method is another, the rule after failure is not that of the method, or a material has a fracture energy
        and no criterion.
    """

    def __init__(self, cell: Cell, method: str, checks: Checks) -> None:
        if method != "gmc":
            raise ValueError(f"method is {method!r}; a cell with fracture_energy takes gmc")
        if cell.after_failure != "gmc":
            raise ValueError(f"after_failure is {cell.after_failure!r}; a cell with fracture_energy takes gmc")
        energies = [np.inf if one.fracture_energy is None else one.fracture_energy for one in cell.materials]
        self.cell = cell
        self._energy = np.array(energies)[cell.phase.reshape(-1)]
        self._reduces = np.array([one.reduces_strength for one in cell.materials])[cell.phase.reshape(-1)]
        self.subcells = np.flatnonzero(np.isfinite(self._energy))
        self.values = VALUES * len(self.subcells)
        without = np.setdiff1d(self.subcells, checks.subcell)
        if len(without):
            name = cell.materials[cell.phase.reshape(-1)[without[0]]].name
            raise ValueError(f"fracture_energy of {name} is of no use: it has no criterion with an allowable")
        self._checks = checks
        self._heights = cell.heights / cell.heights.sum()
        self._widths = cell.widths / cell.widths.sum()
        same = cell.phase[..., None] == np.arange(len(cell.materials))
        along2 = np.einsum("b,bgm->gm", self._heights, same)[np.arange(cell.columns)[None, :], cell.phase]
        along3 = np.einsum("g,bgm->bm", self._widths, same)[np.arange(cell.rows)[:, None], cell.phase]
        self._known_limits = np.nan, np.empty((0, 9))  # of the temperature asked for last
        self._shares = np.stack([along2.reshape(-1), along3.reshape(-1)], axis=1)

    def evaluate(
        self,
        strain: NDArray[np.float64],
        temperature: float,
        failed: NDArray[np.bool_],
        history: NDArray[np.float64],
        element_length: NDArray[np.float64],
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.float64], NDArray[np.float64]]:
        """Take points to strains; the arguments stay as they are.

        Parameters
        ----------
        strain : ndarray of float, shape (points, 6)
        temperature : float
            K.
        failed : ndarray of bool, shape (points, subcells)
        history : ndarray of float, shape (points, values)
        element_length : ndarray of float, shape (points,)
            m, see `checked_length`.

        Returns
        -------
        stress : ndarray, shape (points, 6)
            Pa.
        failed : ndarray of bool, shape (points, subcells)
        history : ndarray, shape (points, values)
        tangents : ndarray, shape (points, 6, 6)
            Secant stiffness of each point, Pa.

        Raises
        ------
        ValueError
            If the damages of a point do not settle.
        """
        failed, damages = failed.copy(), self._damages(history)
        stress, tangents = np.empty((len(strain), 6)), np.empty((len(strain), 6, 6))
        point = respond(
            self._heights, self._widths, self._shares, self.cell.stiffness_at(temperature),
            self.cell.thermal_strain_at(temperature), self.cell.knock_down, self._energy, self._checks.arrays,
            np.where(self._reduces[self._checks.subcell, None], self._limits(temperature), np.inf),
            strain, element_length, failed, damages, stress, tangents,
        )  # fmt: skip
        if point >= 0:
            raise ValueError(f"strain[{point}] is {strain[point].tolist()}; the damages at it do not settle")
        return stress, failed, damages[:, self.subcells].reshape(len(strain), self.values), tangents

    def localise(
        self,
        strain: NDArray[np.float64],
        temperature: float,
        failed: NDArray[np.bool_],
        history: NDArray[np.float64],
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Stress and strain, shape (points, subcells, 6), of the subcells with the damage that the history holds."""
        stiffness, free = self.cell.stiffness_at(temperature), self.cell.thermal_strain_at(temperature)
        kept = np.where(failed, self.cell.knock_down, 1.0 - self._damages(history)[:, :, 0])
        stress, local = np.empty((len(strain), self.cell.subcells, 6)), np.empty((len(strain), self.cell.subcells, 6))
        for point in range(len(strain)):
            damaged = stiffness * kept[point, :, None, None]
            eigenstress = -np.einsum("nij,nj->ni", damaged, free)
            solved = solve_subcells(
                self._heights, self._widths, damaged, eigenstress[:, :, None], strain[point][:, None].copy()
            )
            local[point] = solved[:, :, 0]
            stress[point] = np.einsum("nij,nj->ni", damaged, local[point]) + eigenstress
        return stress, local

    def failed_by_history(self, failed: NDArray[np.uint8], history: NDArray[np.float64]) -> NDArray[np.uint8]:
        """Masks in which a softening subcell has failed where its damage says so, and nowhere else.

        A solver that looks for an equilibrium keeps what has failed from one try to the next, since elimination is for
        good; a damage that a try has overshot to the end is to come back with the history that the solver starts from.
        """
        flags = unpack_mask(failed, self.cell.subcells)
        flags[:, self.subcells] = self._damages(history)[:, self.subcells, 0] >= 1.0 - self.cell.knock_down
        return pack_mask(flags)

    def checked_length(
        self, element_length: NDArray[np.float64] | None, points: int, temperature: float
    ) -> NDArray[np.float64]:
        """Return the lengths of the elements; refuse those with which a subcell could not soften.

        Under one stress alone an element longer than 2 E G_c / strength^2, divided by `softening.length_share`, stores
        more energy than its crack can take: its stress would have to fall while its strain goes back. A material that
        reduces its strength there sets no limit. Under several stresses at once the limit is lower, and a subcell of a
        longer element then fails at once.

        Raises
        ------
        ValueError
            If the lengths are missing, have another shape, are not positive, or exceed the limit.
        """
        if element_length is None:
            name = self.cell.materials[self.cell.phase.reshape(-1)[self.subcells[0]]].name
            raise ValueError(
                f"element_length is missing; {name} has a fracture_energy, so each point must have one, in m"
            )
        if element_length.shape != (points,):
            raise ValueError(f"element_length has shape {element_length.shape}; it must have {(points,)}")
        good = np.isfinite(element_length) & (element_length > 0.0)
        if not good.all():
            point = int(np.argmin(good))
            raise ValueError(
                f"element_length[{point}] is {element_length[point]} m; it must be finite and greater than 0"
            )
        limit, name, component = self.longest_element(temperature)
        if points and element_length.max() > limit:
            point = int(np.argmax(element_length > limit))
            raise ValueError(
                f"element_length[{point}] is {element_length[point]:g} m; the most is {limit:.6g} m, "
                f"2 E G_c / strength^2 of {name} in {component}: a longer element would snap back"
            )
        return np.ascontiguousarray(element_length, dtype=np.float64)

    def longest_element(self, temperature: float) -> tuple[float, str, str]:
        """Largest element length in m, and the material and component that limit it; see `checked_length`."""
        limits = np.where(self._reduces[self._checks.subcell, None], np.inf, self._limits(temperature))
        if not np.isfinite(limits).any():
            return np.inf, "", ""
        check, place = np.unravel_index(int(np.argmin(limits)), limits.shape)
        sense = ("tension", "compression", "shear")[place // 3]
        name = self.cell.materials[self.cell.phase.reshape(-1)[self._checks.subcell[check]]].name
        return float(limits[check, place]), name, f"{COMPONENTS[_component(place)]} {sense}"

    def may_soften_early(self, element_length: NDArray[np.float64], temperature: float) -> NDArray[np.bool_]:
        """Points whose element is so long that a reduced strength governs there, shape (points,)."""
        limits = self._limits(temperature)[self._reduces[self._checks.subcell]]
        return np.asarray(element_length > limits.min(initial=np.inf))

    def _limits(self, temperature: float) -> NDArray[np.float64]:
        """Element length at which one stress alone stores just the energy of a crack, shape (checks, 9), m."""
        known, limits = self._known_limits
        if known == temperature:
            return limits
        compliance = np.linalg.inv(self.cell.stiffness_at(temperature))
        limits = np.full(self._checks.rates.shape, np.inf)
        for check, n in enumerate(self._checks.subcell):
            if not np.isfinite(self._energy[n]):
                continue
            for place in np.flatnonzero(self._checks.rates[check]):
                component = _component(place)
                flexibility = compliance[n, component, component]
                strength = 1.0 / self._checks.rates[check, place]
                if self._checks.criterion[check] == MAXIMUM_STRAIN:
                    strength /= flexibility
                stored = 0.5 * strength**2 * flexibility
                limits[check, place] = self._energy[n] / (stored * length_share(component, *self._shares[n]))
        self._known_limits = temperature, limits
        return limits

    def _damages(self, history: NDArray[np.float64]) -> NDArray[np.float64]:
        damages = np.zeros((len(history), self.cell.subcells, VALUES))
        damages[:, self.subcells] = history.reshape(len(history), len(self.subcells), VALUES)
        return damages


def _component(place: int | np.integer) -> int:
    """Component of an allowable: tension along 1, 2, 3, compression along 1, 2, 3, shear 23, 13, 12."""
    return int(place) if place < 3 else int(place) - 3
