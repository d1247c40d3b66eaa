"""Stress, failure and tangent of a cell at many points: stateless, the damage of a point travels with it.

Rule of elimination: at the given strain all subcells whose index has reached one (within `failure.TOLERANCE`) fail
together; the stiffness of a failed subcell is multiplied by the knock-down factor; with the stresses after that, again
all that have reached one fail; until none does. The stress that is returned is the one after this cascade.

Subcells with a fracture energy soften instead (`gmc_service.softening`), subcells with plasticity yield
(`gmc_service.plasticity`); their state is the history of a point.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from threading import Lock
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gmc_service.cell import Cell
from gmc_service.elimination import WOULD_FAIL, number_by_first_use, query
from gmc_service.failed_cell import FailedCell
from gmc_service.failure import checks_of
from gmc_service.gmc_reduced import is_orthotropic
from gmc_service.homogenised import Homogenised
from gmc_service.mask_table import TABLE_BYTES, MaskTable, distinct_masks, mask_bytes, pack_mask, unpack_mask
from gmc_service.methods import find_method
from gmc_service.plastic_cell import PlasticCell
from gmc_service.plasticity import VALUES as PLASTIC_VALUES
from gmc_service.softening_cell import SofteningCell
from protocol.tangent_table import join_tables

#: Bytes of all tables of a cell; with more, the temperatures that have not been asked for longest are dropped.
CACHE_BYTES: Final = 2 * TABLE_BYTES


@dataclass(frozen=True, eq=False)
class Answer:
    """Answer to a query.

    Attributes
    ----------
    stress : ndarray of float, shape (points, 6)
        Pa, after the cascade.
    failed : ndarray of uint8, shape (points, bytes)
        Masks of failed subcells after the cascade.
    history : ndarray of float, shape (points, history_values)
        Damage after the query.
    tangent_index : ndarray of int64, shape (points,)
        Row of `tangents` for each point.
    tangents : ndarray of float, shape (tangents, 6, 6)
        The distinct stiffnesses B*, Pa, in the order in which the points first use them.
    """

    stress: NDArray[np.float64]
    failed: NDArray[np.uint8]
    history: NDArray[np.float64]
    tangent_index: NDArray[np.int64]
    tangents: NDArray[np.float64]


class Evaluator:
    """A cell that answers for many points.

    It holds no state but tables that can be rebuilt, so an answer depends on its arguments alone; any number of threads
    may ask at once (the loop over the points releases the interpreter's lock).

    Parameters
    ----------
    cell : Cell
    method : str
        Name from `gmc_service.methods`.

    Attributes
    ----------
    failed_bytes : int
        Bytes of the mask of a point; bit n of byte n // 8, the least significant first, is subcell n.
    history_values : int
        Damage or plastic variables of a point; 0 where subcells are only eliminated.

    Raises
    ------
    ValueError
        If there is no such method, or a criterion, softening or plasticity does not fit the cell.
    """

    def __init__(self, cell: Cell, method: str = "gmc") -> None:
        self.cell = cell
        self.method = method
        self.failed_bytes = mask_bytes(cell.subcells)
        find_method(method)  # an unknown name is an error here, not at the first query
        self._checks = checks_of(cell)
        self._plastic, self._softening, self.history_values = None, None, 0
        if any(material.plasticity is not None for material in cell.materials):
            self._plastic = PlasticCell(cell, method)
            self.history_values = PLASTIC_VALUES * cell.subcells
        elif any(material.fracture_energy is not None for material in cell.materials):
            self._softening = SofteningCell(cell, method, self._checks)
            self.history_values = self._softening.values
        self._spare = np.uint8(0xFF & ~(0xFF >> (8 * self.failed_bytes - cell.subcells)))
        # With orthotropic subcells the generalized method of cells couples no shear to a normal strain; others do.
        self._compact = (
            method in ("gmc", "gmc_dense")
            and cell.after_failure != "high_fidelity"
            and all(is_orthotropic(material.stiffness) for material in cell.materials)
        )
        self._tables: OrderedDict[float, MaskTable] = OrderedDict()
        self._lock = Lock()

    def evaluate(
        self,
        strain: NDArray[np.float64],
        temperature: float,
        failed: NDArray[np.uint8],
        history: NDArray[np.float64],
        element_length: NDArray[np.float64] | None = None,
    ) -> Answer:
        """Answer for many points; the arguments stay as they are.

        Parameters
        ----------
        strain : ndarray of float, shape (points, 6)
            Macroscopic strain.
        temperature : float
            K.
        failed : ndarray of uint8, shape (points, failed_bytes)
            Masks of the subcells that have failed before.
        history : ndarray of float, shape (points, history_values)
        element_length : ndarray of float, shape (points,), optional
            m; needed where a material softens, and not looked at elsewhere.

        Returns
        -------
        Answer

        Raises
        ------
        ValueError
            If a shape does not fit, a strain is not finite, see `check_state`, or a temperature lies outside a
            material's table.
        """
        strain, failed, history = self._checked(strain, failed, history)
        temperature = _checked_temperature(temperature)
        if self._plastic is not None:
            return self._yielded(self._plastic, strain, temperature, failed, history)
        if self._softening is not None:
            lengths = self._softening.checked_length(element_length, len(strain), temperature)
            return self._softened(self._softening, strain, temperature, failed, history, lengths)
        stress, failed, entry, tangents = self._eliminated(strain, temperature, failed, cascade=True)
        return Answer(stress, failed, history.copy(), *_numbered(entry, tangents))

    def _eliminated(
        self, strain: NDArray[np.float64], temperature: float, failed: NDArray[np.uint8], cascade: bool
    ) -> tuple[NDArray[np.float64], NDArray[np.uint8], NDArray[np.int64], NDArray[np.float64]]:
        """Stress, masks, and row of a table of tangents of each point; `WOULD_FAIL` as `elimination.query` says."""
        failed = failed.copy()
        stress, entry = np.empty_like(strain), np.empty(len(strain), dtype=np.int64)
        table = self._table(temperature)
        number = table.next_query()
        todo = np.arange(len(strain))
        generations = [(0, table.snapshot)]
        while len(todo):
            first, held = generations[-1]
            waiting, not_finite = query(
                strain,
                todo,
                held.arrays,
                self._checks.arrays,
                number,
                cascade,
                first,
                failed,
                stress,
                entry,
            )
            if not_finite >= 0:
                raise _not_finite(strain, int(not_finite))
            todo = todo[:waiting]
            if waiting:
                table.extend(distinct_masks(failed, todo, table.batch))
                follow = table.snapshot
                if follow.generation == held.generation:
                    generations[-1] = (first, follow)
                else:
                    generations.append((first + held.count, follow))
        tangents = np.concatenate([held.stiffness[: held.count] for _, held in generations])
        return stress, failed, entry, tangents

    def _softened(
        self,
        cell: SofteningCell,
        strain: NDArray[np.float64],
        temperature: float,
        failed: NDArray[np.uint8],
        history: NDArray[np.float64],
        lengths: NDArray[np.float64],
    ) -> Answer:
        """Take points at which nothing softens from the table, and the others one by one."""
        failed = cell.failed_by_history(failed, history)
        stress, failed, entry, tangents = self._eliminated(strain, temperature, failed, cascade=False)
        history = history.copy()
        begun = (entry == WOULD_FAIL) | history.any(axis=1)
        active = np.flatnonzero(begun | cell.may_soften_early(lengths, temperature))
        flags = unpack_mask(failed[active], self.cell.subcells)
        answer, flags, damaged, own = cell.evaluate(
            strain[active], temperature, flags, history[active], lengths[active]
        )
        # Where nothing has softened after all, the table's answer stands.
        changed = begun[active] | damaged.any(axis=1)
        active, own = active[changed], own[changed]
        stress[active], history[active], failed[active] = answer[changed], damaged[changed], pack_mask(flags[changed])
        entry[active] = len(tangents) + np.arange(len(active))
        return Answer(stress, failed, history, *_numbered(entry, np.concatenate([tangents, own])))

    def _yielded(
        self,
        cell: PlasticCell,
        strain: NDArray[np.float64],
        temperature: float,
        failed: NDArray[np.uint8],
        history: NDArray[np.float64],
    ) -> Answer:
        flags = unpack_mask(failed, self.cell.subcells)
        shaped = history.reshape(len(strain), self.cell.subcells, PLASTIC_VALUES)
        answer = cell.evaluate(strain, temperature, flags, shaped)
        numbered = _numbered(np.arange(len(strain)), answer.tangents)
        return Answer(answer.stress, pack_mask(answer.failed), answer.history.reshape(history.shape), *numbered)

    def localise(
        self,
        strain: NDArray[np.float64],
        temperature: float,
        failed: NDArray[np.uint8],
        history: NDArray[np.float64],
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Mean stress and strain of every subcell at points with the damage that is given; nothing fails here.

        Parameters
        ----------
        strain, temperature, failed, history
            As in `evaluate`.

        Returns
        -------
        stress : ndarray, shape (points, subcells, 6)
            Pa.
        strain : ndarray, shape (points, subcells, 6)

        Raises
        ------
        ValueError
            As `evaluate`.
        """
        strain, failed, history = self._checked(strain, failed, history)
        finite = np.isfinite(strain).all(axis=1)
        if not finite.all():
            raise _not_finite(strain, int(np.argmin(finite)))
        temperature = _checked_temperature(temperature)
        if self._plastic is not None:
            flags = unpack_mask(failed, self.cell.subcells)
            shaped = history.reshape(len(strain), self.cell.subcells, PLASTIC_VALUES)
            return self._plastic.localise(strain, temperature, flags, shaped)
        if self._softening is not None:
            failed = self._softening.failed_by_history(failed, history)
            return self._softening.localise(strain, temperature, unpack_mask(failed, self.cell.subcells), history)
        states = FailedCell(self.cell, self.method, temperature)
        change = temperature - self.cell.stress_free_temperature
        local = np.empty((len(strain), self.cell.subcells, 6))
        stress = np.empty_like(local)
        masks, group = np.unique(failed, axis=0, return_inverse=True)
        for number, mask in enumerate(masks):
            flags = unpack_mask(mask, self.cell.subcells)
            answer, points = states.homogenise(flags), np.flatnonzero(group.reshape(-1) == number)
            local[points] = np.einsum("nij,pj->pni", answer.concentration, strain[points]) + answer.thermal * change
            mechanical = local[points] - states.expansion * change
            stress[points] = np.einsum("nij,pnj->pni", states.stiffness(flags), mechanical)
        return stress, local

    def homogenised(self, temperature: float, failed: NDArray[np.uint8]) -> Homogenised:
        """Constants and concentrations of the cell with the failed subcells of one mask, shape (failed_bytes,).

        Raises
        ------
        ValueError
            If the mask is none of this cell's, see `check_state`, or a temperature lies outside a material's table.
        """
        self.check_state(1, failed[None], np.zeros((1, self.history_values)))
        states = FailedCell(self.cell, self.method, _checked_temperature(temperature))
        return states.homogenise(unpack_mask(failed, self.cell.subcells))

    def _table(self, temperature: float) -> MaskTable:
        key = _checked_temperature(temperature)
        with self._lock:
            if key not in self._tables:
                self._tables[key] = MaskTable(self.cell, self.method, self._checks, key, self._compact)
            self._tables.move_to_end(key)
            while len(self._tables) > 1 and sum(table.bytes for table in self._tables.values()) > CACHE_BYTES:
                self._tables.popitem(last=False)
            return self._tables[key]

    def _checked(
        self, strain: NDArray[np.float64], failed: NDArray[np.uint8], history: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.uint8], NDArray[np.float64]]:
        strain = np.ascontiguousarray(strain, dtype=np.float64)
        if strain.ndim != 2 or strain.shape[1] != 6:
            raise ValueError(f"strain has shape {strain.shape}; it must have (points, 6)")
        self.check_state(len(strain), failed, history)
        return strain, np.ascontiguousarray(failed), np.ascontiguousarray(history, dtype=np.float64)

    def check_state(self, points: int, failed: NDArray[np.uint8], history: NDArray[np.float64]) -> None:
        """Refuse masks and history that cannot be those of so many points of this cell.

        Parameters
        ----------
        points : int
        failed : ndarray of uint8, shape (points, failed_bytes)
        history : ndarray of float, shape (points, history_values)

        Raises
        ------
        ValueError
            If a shape or type does not fit, a mask has a bit beyond the subcells, or the history is not finite.
        """
        if failed.dtype != np.uint8:
            raise ValueError(f"failed has type {failed.dtype}; it must be uint8")
        for name, values, width in (("failed", failed, self.failed_bytes), ("history", history, self.history_values)):
            if values.shape != (points, width):
                raise ValueError(f"{name} has shape {values.shape}; it must have {(points, width)}")
        beyond = failed[:, -1] & self._spare
        if beyond.any():
            point = int(np.argmax(beyond > 0))
            raise ValueError(
                f"failed[{point}] is {failed[point].tolist()}; bits beyond the {self.cell.subcells} subcells must be 0"
            )
        finite = np.isfinite(history)
        if not finite.all():
            point = int(np.argmin(finite.all(axis=1)))
            raise ValueError(f"history[{point}] holds a value that is not finite; it must be one that a query returned")


def _checked_temperature(temperature: float) -> float:
    if not (np.isfinite(temperature) and temperature >= 0.0):
        raise ValueError(f"temperature is {temperature} K; it must be finite and 0 or greater")
    return float(temperature)


def _numbered(entry: NDArray[np.int64], tangents: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Index of each point in the distinct tangents, and these, in the order in which the points first use them.

    Two masks can share a tangent, and a query that has more masks than a table holds may have one twice.
    """
    order = number_by_first_use(entry, len(tangents))
    return join_tables([(entry, tangents[order])])


def _not_finite(strain: NDArray[np.float64], point: int) -> ValueError:
    return ValueError(f"strain[{point}] is {strain[point].tolist()}; every component must be finite")
