"""Table of a cell's states of failure at one temperature: for each mask of failed subcells all that a query needs.

A mask is a row of bytes; bit n of byte n // 8, the least significant first, is subcell n.

The arrays of a table only grow at their end and its hash slots are replaced as a whole, so a query reads the `Snapshot`
that it holds without a lock while another extends the table.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from threading import Lock
from typing import Final

import numba as nb
import numpy as np
from numpy.typing import NDArray

from gmc_service.cell import Cell
from gmc_service.failed_cell import FailedCell
from gmc_service.failure import Checks
from gmc_service.gmc_reduced import compact
from gmc_service.homogenised import Homogenised
from gmc_service.mask_filling import fill_entries

#: Bytes of one table; with more masks than fit, the half that has not been used for longest is dropped.
TABLE_BYTES: Final = 256 * 2**20
#: A table holds this many masks whatever their size.
LEAST_ENTRIES: Final = 64
#: Entries of a 6 x 6 matrix that are kept where normal and shear components are not coupled.
COMPACT: Final = (0, 1, 2, 6, 7, 8, 12, 13, 14, 21, 28, 35)

_FNV_START: Final = np.uint64(0xCBF29CE484222325)
_FNV_PRIME: Final = np.uint64(0x100000001B3)
_HALF: Final = np.uint64(32)


def mask_bytes(subcells: int) -> int:
    """Bytes of the mask of a cell."""
    return (subcells + 7) // 8


def pack_mask(failed: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Mask from a flag for each subcell; shape (..., subcells) to (..., bytes)."""
    return np.packbits(failed, axis=-1, bitorder="little")


def unpack_mask(mask: NDArray[np.uint8], subcells: int) -> NDArray[np.bool_]:
    """Flag for each subcell from a mask; shape (..., bytes) to (..., subcells)."""
    return np.unpackbits(mask, axis=-1, count=subcells, bitorder="little").astype(bool)


@nb.njit(nogil=True, cache=True)
def first_slot(masks, row, size):  # type: ignore[no-untyped-def]
    """Slot at which the search for the mask in a row begins, in a hash of `size` slots (a power of two); FNV-1a."""
    digest = _FNV_START
    for k in range(masks.shape[1]):
        digest = (digest ^ np.uint64(masks[row, k])) * _FNV_PRIME
    digest ^= digest >> _HALF
    return np.int64(digest & np.uint64(size - 1))


@nb.njit(nogil=True, cache=True)
def find_mask(failed, point, slots, masks):  # type: ignore[no-untyped-def]
    """Entry of the mask in row `point` of `failed`, or -1; `slots` hold entries of `masks`, or -1 where empty."""
    size = len(slots)
    slot = first_slot(failed, point, size)
    while True:
        entry = slots[slot]
        if entry < 0:
            return np.int64(-1)
        same = True
        for k in range(failed.shape[1]):
            if masks[entry, k] != failed[point, k]:
                same = False
                break
        if same:
            return np.int64(entry)
        slot = (slot + 1) & (size - 1)


@nb.njit(nogil=True, cache=True)
def _fill_slots(slots, masks, first, last):  # type: ignore[no-untyped-def]
    for entry in range(first, last):
        slot = first_slot(masks, entry, len(slots))
        while slots[slot] >= 0:
            slot = (slot + 1) & (len(slots) - 1)
        slots[slot] = entry


@nb.njit(nogil=True, cache=True)
def distinct_masks(failed, points, most):  # type: ignore[no-untyped-def]
    """Distinct masks of some points, in the order in which they come, at most `most` of them.

    Parameters
    ----------
    failed : ndarray of uint8, shape (all points, bytes)
    points : ndarray of int64
    most : int

    Returns
    -------
    ndarray of uint8, shape (masks, bytes)
    """
    room = 16
    while room < 4 * min(most, len(points)):
        room *= 2
    slots = np.full(room, -1, dtype=np.int64)
    masks = np.empty((min(most, len(points)), failed.shape[1]), dtype=np.uint8)
    count = 0
    for point in points:
        if find_mask(failed, point, slots, masks) >= 0:
            continue
        if count == len(masks):
            break
        masks[count] = failed[point]
        _fill_slots(slots, masks, count, count + 1)
        count += 1
    return masks[:count]


@dataclass(frozen=True, eq=False)
class Snapshot:
    """What a query reads.

    Attributes
    ----------
    slots : ndarray of int64, shape (slots,)
        Hash: entry or -1.
    masks : ndarray of uint8, shape (capacity, bytes)
    stiffness : ndarray of float, shape (capacity, 6, 6)
        B*, Pa.
    locked : ndarray of float, shape (capacity, 6)
        B* alpha* times the change of temperature: the stress is ``stiffness @ strain - locked``.
    loads : ndarray of float, shape (capacity, checks, 12 or 36)
        Stress (Pa) or strain that a check looks at, per macroscopic strain; 12 where only `COMPACT` entries are not
        zero. First come the checks of subcells that have not failed; the others are not filled.
    offsets : ndarray of float, shape (capacity, checks, 6)
        The same at no macroscopic strain, from the change of temperature.
    alive : ndarray of int64, shape (capacity, 1 + checks)
        Number of checks of subcells that have not failed, and these.
    used : ndarray of int64, shape (capacity,)
        Number of the last query that used an entry.
    count : int
        Entries that are filled.
    generation : int
        Changes where entries are dropped and the others get new places.
    """

    slots: NDArray[np.int64]
    masks: NDArray[np.uint8]
    stiffness: NDArray[np.float64]
    locked: NDArray[np.float64]
    loads: NDArray[np.float64]
    offsets: NDArray[np.float64]
    alive: NDArray[np.int64]
    used: NDArray[np.int64]
    count: int
    generation: int

    @property
    def arrays(self) -> tuple[NDArray, ...]:
        """As `elimination.query` takes them."""
        return (
            self.slots, self.masks, self.stiffness, self.locked, self.loads, self.offsets, self.alive, self.used,
        )  # fmt: skip


class MaskTable:
    """The table of a cell at one temperature.

    Parameters
    ----------
    cell : Cell
    method : str
        Name from `gmc_service.methods`.
    checks : Checks
    temperature : float
        K.
    compact_layout : bool
        Whether normal and shear components are uncoupled in every subcell and every state.
    """

    def __init__(self, cell: Cell, method: str, checks: Checks, temperature: float, compact_layout: bool) -> None:
        self.cell = cell
        self.checks = checks
        self.change = temperature - cell.stress_free_temperature
        self.states = FailedCell(cell, method, temperature)
        self._kept = np.array(COMPACT if compact_layout else range(36))
        entry_bytes = 8 * len(checks.subcell) * (len(self._kept) + 7) + 8 * 44 + mask_bytes(cell.subcells)
        self.limit = max(LEAST_ENTRIES, TABLE_BYTES // entry_bytes)
        # Where the compiled way of filling holds: stiffness of the intact subcells, then of the knocked down ones.
        plain = compact_layout and method == "gmc" and cell.after_failure == "gmc"
        intact = self.states.intact
        self._kinds = np.concatenate([intact, intact * cell.knock_down]) if plain else None
        self._lock = Lock()
        self._query = 0
        self.snapshot = self._empty(16)
        self.extend(np.zeros((1, mask_bytes(cell.subcells)), dtype=np.uint8))

    @property
    def batch(self) -> int:
        """Masks that one call of `extend` takes."""
        return self.limit // 2

    @property
    def bytes(self) -> int:
        """Memory of the table."""
        return sum(array.nbytes for array in self.snapshot.arrays)

    def next_query(self) -> int:
        """Number of a query that begins, for `Snapshot.used`."""
        with self._lock:
            self._query += 1
            return self._query

    def extend(self, masks: NDArray[np.uint8]) -> None:
        """Add distinct masks, shape (masks, bytes), at most `batch` of them; known ones are passed over."""
        with self._lock:
            held = self.snapshot
            new = [mask for row, mask in enumerate(masks) if find_mask(masks, row, held.slots, held.masks) < 0]
            if not new:
                return
            if held.count + len(new) > self.limit:
                held = self._recent_half(held)
            first, last = held.count, held.count + len(new)
            held = self._with_capacity(held, last)
            held.masks[first:last] = new
            held.used[first:last] = self._query
            if self._kinds is None:
                for entry, mask in enumerate(new, start=first):
                    self._fill(held, entry, mask)
            else:
                self._fill_compiled(self._kinds, held, first, last)
            slots = held.slots.copy()
            _fill_slots(slots, held.masks, first, last)
            self.snapshot = replace(held, slots=slots, count=last)

    def _fill(self, held: Snapshot, entry: int, mask: NDArray[np.uint8]) -> None:
        failed = unpack_mask(mask, self.cell.subcells)
        answer = self.states.homogenise(failed)
        alive = np.flatnonzero(~failed[self.checks.subcell])
        loads, offsets = self._loads(answer, failed, alive)
        held.stiffness[entry] = answer.stiffness
        held.locked[entry] = answer.stiffness @ answer.expansion * self.change
        held.loads[entry, : len(alive)] = loads.reshape(-1, 36)[:, self._kept]
        held.offsets[entry, : len(alive)] = offsets
        held.alive[entry, 0] = len(alive)
        held.alive[entry, 1 : 1 + len(alive)] = alive

    def _fill_compiled(self, kinds: NDArray[np.float64], held: Snapshot, first: int, last: int) -> None:
        heights, widths = (sizes / sizes.sum() for sizes in (self.cell.heights, self.cell.widths))
        failed = unpack_mask(held.masks[first:last], self.cell.subcells)
        normal, shear = (np.ascontiguousarray(one) for one in compact(kinds))
        fill_entries(
            heights, widths, normal, shear, kinds, self.states.expansion, self.change, self.checks.arrays, failed,
            held.arrays, first,
        )  # fmt: skip

    def _loads(
        self, answer: Homogenised, failed: NDArray[np.bool_], checks: NDArray[np.int64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """What some checks look at per macroscopic strain, and at none."""
        subcell, strain = self.checks.subcell[checks], self.checks.of_strain()[checks]
        offsets = (answer.thermal - self.states.expansion)[subcell] * self.change
        stiffness = self.states.stiffness(failed)[subcell]
        stiffness[strain] = np.eye(6)
        return stiffness @ answer.concentration[subcell], np.einsum("nij,nj->ni", stiffness, offsets)

    def _empty(self, capacity: int) -> Snapshot:
        checks = len(self.checks.subcell)
        return Snapshot(
            slots=np.full(4 * capacity, -1),
            masks=np.zeros((capacity, mask_bytes(self.cell.subcells)), dtype=np.uint8),
            stiffness=np.empty((capacity, 6, 6)),
            locked=np.empty((capacity, 6)),
            loads=np.empty((capacity, checks, len(self._kept))),
            offsets=np.empty((capacity, checks, 6)),
            alive=np.empty((capacity, 1 + checks), dtype=np.int64),
            used=np.zeros(capacity, dtype=np.int64),
            count=0,
            generation=0,
        )

    def _with_capacity(self, held: Snapshot, count: int) -> Snapshot:
        capacity = len(held.masks)
        if count <= capacity:
            return held
        while capacity < count:
            capacity *= 2
        return self._copied(held, np.arange(held.count), capacity)

    def _recent_half(self, held: Snapshot) -> Snapshot:
        kept = np.argsort(-held.used[: held.count], kind="stable")[: self.limit // 2]
        half = self._copied(held, np.sort(kept), len(held.masks))
        return replace(half, generation=held.generation + 1)

    def _copied(self, held: Snapshot, entries: NDArray[np.int64], capacity: int) -> Snapshot:
        """A table of its own with some entries of another."""
        copy, count = self._empty(capacity), len(entries)
        for name in ("masks", "stiffness", "locked", "loads", "offsets", "alive", "used"):
            getattr(copy, name)[:count] = getattr(held, name)[entries]
        _fill_slots(copy.slots, copy.masks, 0, count)
        return replace(copy, count=count, generation=held.generation)
