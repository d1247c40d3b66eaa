"""Mapping between points and grid: which nodes each point touches, and the sweeps over all points.

The points are kept sorted along the grid. Those whose nodes follow the fixed pattern of a uniform lattice come
first and are swept by the kernels of `sweeps`; those near a crack or a level border, with domains wider than a
cell, and all points in space come behind and are swept over tabulated stencils.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from . import hierarchy_stencils, ordering, stencils, sweeps, tensor_stencils
from .cracks import CrackSet
from .errors import SolverError
from .grid import Grid
from .hierarchy import HierarchicalGrid
from .material_points import columns
from .scheme import Scheme
from .shapes import ConvectedShape, UniformShape, make_shape

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Points that one call of deformation and stress takes: what it writes is still in the cache when it is read.
CHUNK = 4096
#: Rows of nodes in a strip: points of every second strip share no node, even after a cell's travel since sorting.
STRIP = 4
#: Threads share a level with at least this many regular points; with fewer, waiting for each other costs more.
WORTH_SHARING = 20_000
#: Points may travel this share of the smallest cell before they are sorted again.
TRAVEL = 0.5
#: Share of a cell's half from which a convected domain may no longer be swept on the lattice.
_NEARLY_WIDE = 0.45


class Points(NamedTuple):
    """Point table in memory order, with the map to stable ids."""

    rows: FloatArray
    ids: IntArray
    row_of: IntArray


class Mapping:
    """Sorted points of a body and their sweeps over the nodal tables.

    Parameters
    ----------
    grid : Grid or HierarchicalGrid
    points : Points
    scheme : Scheme
    half : float
        Half domain of a point over the cell size of its level.
    table_rows : int
        Rows of the nodal tables, those of extra velocity fields included.
    cracks : CrackSet or None
    threads : int
        Threads that share the sweeps of regular points.
    """

    def __init__(
        self,
        grid: Grid | HierarchicalGrid,
        points: Points,
        scheme: Scheme,
        half: float,
        table_rows: int,
        cracks: CrackSet | None,
        threads: int,
    ) -> None:
        self.grids = grid.grids if isinstance(grid, HierarchicalGrid) else (grid,)
        self.nested = grid.arrays if isinstance(grid, HierarchicalGrid) and len(grid.grids) > 1 else None
        self._nested_mask = grid.special_mask() if isinstance(grid, HierarchicalGrid) and self.nested else None
        self.points = points
        self.alive = points.ids.size
        dimension = len(self.grids[0].cells)
        self.columns = columns(dimension)
        self.half = half
        self.smallest_cell = self.grids[-1].cell_size
        first = np.cumsum([0, *(g.node_count for g in self.grids)])
        self.levels = ordering.Levels(
            np.array([g.origin for g in self.grids], dtype=np.float64),
            np.array([1.0 / g.cell_size for g in self.grids]),
            np.array([g.cells for g in self.grids], dtype=np.int64),
            first.astype(np.int64),
        )
        shape = make_shape(scheme.interpolation, half)
        self._kind = ("linear", "ugimp", "cpgimp", "bspline").index(scheme.interpolation)
        self._lattices = [
            sweeps.Lattice(
                float(g.origin[0]), float(g.origin[1]), 1.0 / g.cell_size, g.cells[0] + 1, int(offset), shape
            )
            for g, offset in zip(self.grids, first, strict=False)
        ]
        self._regular_half = half if isinstance(shape, UniformShape | ConvectedShape) else 0.0
        self._widest = _NEARLY_WIDE if isinstance(shape, ConvectedShape) else 0.0
        # At a crack's tip an entry may be divided between two velocity fields.
        self._stencil_width = self._entries(dimension) * (2 if cracks is not None else 1)
        self._voigt = stencils.VOIGT[dimension]
        self._cracks = cracks
        #: Are all points swept over tabulated stencils, and none on lattices? It takes effect with the next sort.
        self.tabulates_all = dimension == 3
        self._mark = np.zeros(table_rows, dtype=np.uint8)
        self._listed = np.empty(table_rows, dtype=np.int64)
        self._used = 0
        self.begin = np.zeros(len(self.grids) + 1, dtype=np.int64)
        self._strips: list[IntArray] = []
        self.travel = 0.0
        self.threads = threads
        self._pool = ThreadPoolExecutor(threads - 1) if threads > 1 else None
        self._table = self._make_table(0)

    def _entries(self, dimension: int) -> int:
        if self.nested is not None:
            return hierarchy_stencils.STENCIL_NODES
        if self._kind == tensor_stencils.CONVECTED:
            return int(tensor_stencils.WIDEST**dimension)
        return int(3**dimension)

    def _make_table(self, count: int) -> stencils.Stencils:
        k = self._stencil_width
        return stencils.Stencils(
            self.alive - count,
            np.zeros((count, k), dtype=np.int64),
            np.zeros((count, k)),
            np.zeros((count, k, self.columns.dimension)),
            np.zeros(count, dtype=np.int64),
        )

    # ---- order and stencils ----------------------------------------------------------------------------

    @property
    def active(self) -> IntArray:
        """Rows of the nodal tables that points can touch, (m,)."""
        return self._listed[: self._used]

    @property
    def tabulated(self) -> stencils.Stencils:
        """Stencils of the irregular points as `tabulate` has left them."""
        return self._table

    @property
    def regular(self) -> int:
        """Number of points swept on lattices."""
        return int(self.begin[-1])

    def may_sweep(self) -> bool:
        """Is every point still where the nodes that were listed when it was sorted are those that it touches?"""
        if self.travel <= TRAVEL * self.smallest_cell:
            return True
        place = self.points.rows[: self.alive, : self.columns.dimension]
        margin = 0.5 * self.grids[0].cell_size
        low, high = self.grids[0].lower + margin, self.grids[0].upper - margin
        return self.travel < self.smallest_cell and bool(np.all((place > low) & (place < high)))

    def drop_lost(self) -> None:
        """Put points that left the grid behind the living ones."""
        self.alive = ordering.drop_lost(*self.points, self.alive, self.levels)

    def sort(self, tables: Sequence[FloatArray]) -> None:
        """Sort the points, list the nodes they can reach, clear the tables."""
        for table in tables:
            table[self.active] = 0.0
        special = np.zeros(int(self.levels.offset[-1]), dtype=np.uint8)
        if self.tabulates_all:
            special[:] = 1
        if self._nested_mask is not None:
            special |= self._nested_mask
        if self._cracks is not None:
            self._cracks.mark_special(special)
        starts = ordering.sort_points(
            *self.points, self.alive, self.columns, self.levels, special, self._regular_half, self._widest
        )
        self.begin = starts[self.levels.offset].copy()
        self._strips = [self._strip_starts(starts, level) for level in range(len(self.grids))]
        self._mark[:] = 0
        ordering.mark_reachable(self.points.rows, self.alive, self.levels, self._mark)
        found = np.flatnonzero(self._mark)
        self._used = found.size
        self._listed[: self._used] = found
        self._table = self._make_table(self.alive - self.regular)
        self.travel = 0.0

    def _strip_starts(self, starts: IntArray, level: int) -> IntArray:
        """First point of each strip of a level, and the end of the last."""
        low, high = self.levels.offset[level], self.levels.offset[level + 1]
        edges = np.append(np.arange(low, high, STRIP * (self.grids[level].cells[0] + 1)), high)
        return np.ascontiguousarray(starts[edges])

    def tabulate(self, step: int) -> None:
        """Fill the stencils of the irregular points at their present places.

        Raises
        ------
        SolverError
            If a domain has become too wide.
        """
        table = self._table
        if table.entries.size == 0:
            return
        rows = self.points.rows
        first, last = self.regular, self.alive
        if self.nested is not None:
            failed = hierarchy_stencils.fill_stencils(self.nested, rows, self._kind, table)
        else:
            position = np.ascontiguousarray(rows[first:last, : self.columns.dimension])
            failed = self._fill(position, self._half_widths(first, last), self._kind, table)
            failed = failed + first if failed >= 0 else failed
        if failed >= 0:
            place = rows[failed, : self.columns.dimension]
            raise SolverError(
                f"domain of material point {int(self.points.ids[failed])} at {tuple(place.tolist())} m is wider than "
                f"four cells or leaves the grid in step {step}: more points per cell, a larger grid, or ugimp",
                step,
                int(self.points.ids[failed]),
                tuple(place.tolist()),
            )
        if self._cracks is not None:
            self._cracks.assign_fields(
                self.points.ids, first, last, table.node, table.weight, table.gradient, table.entries
            )
        self._list(table.node, table.entries)

    def _half_widths(self, first: int, last: int) -> FloatArray:
        """Half domains of irregular points on a uniform grid [m], held inside the grid, (m, d)."""
        c = self.columns
        rows = self.points.rows[first:last]
        half = np.repeat(rows[:, c.half, None], c.dimension, axis=1)
        if self._kind == tensor_stencils.CONVECTED:
            f = rows[:, c.gradient : c.stress].reshape(-1, c.dimension, c.dimension) + np.eye(c.dimension)
            half *= np.linalg.norm(f, axis=2)
            room = np.minimum(
                rows[:, : c.dimension] - self.grids[0].lower, self.grids[0].upper - rows[:, : c.dimension]
            )
            half = np.minimum(half, room)
        if self._kind == tensor_stencils.UNIFORM:  # round-off beyond a cell would touch more nodes than the table holds
            half = np.minimum(half, 0.5 * self.grids[0].cell_size)
        if self._kind in (tensor_stencils.LINEAR, tensor_stencils.SPLINE):
            half[:] = 0.0
        return np.ascontiguousarray(half)

    def _fill(self, position: FloatArray, half: FloatArray, kind: int, table: stencils.Stencils) -> int:
        return int(
            tensor_stencils.fill_stencils(
                position,
                half,
                kind,
                self.levels.origin[0],
                self.levels.inverse_cell[0],
                self.levels.cells[0],
                table.node,
                table.weight,
                table.gradient,
                table.entries,
            )
        )

    def make_room(self, table_rows: int) -> None:
        """Allow for more rows of the nodal tables; to be sorted next."""
        self._mark = np.zeros(table_rows, dtype=np.uint8)
        self._listed = np.empty(table_rows, dtype=np.int64)
        self._used = 0

    def _list(self, node: IntArray, count: IntArray) -> None:
        self._used = ordering.mark_touched(node, count, self._mark, self._listed, self._used)

    def stencils_at(
        self, position: FloatArray, half: FloatArray | None = None
    ) -> tuple[IntArray, FloatArray, IntArray]:
        """Nodes and weights at places of the grid, before velocity fields are chosen.

        Parameters
        ----------
        position : (m, d) ndarray
            [m]
        half : (m, d) ndarray, optional
            Half sides of boxes over which the functions are averaged [m]; 0 is none. With B-splines the functions
            at the places, not averaged. Absent: linear functions at the places, whatever the scheme.

        Returns
        -------
        node, weight, count : (m, K), (m, K), (m,) ndarray
            A place or box that is not inside the grid has count 0.
        """
        m, dimension = position.shape
        kind = tensor_stencils.LINEAR if half is None else tensor_stencils.UNIFORM
        if half is not None and self._kind == tensor_stencils.SPLINE:
            kind = tensor_stencils.SPLINE
        box = np.zeros_like(position) if half is None or kind == tensor_stencils.SPLINE else half
        widest = 2 if half is None else 3 if kind == tensor_stencils.SPLINE else tensor_stencils.WIDEST
        entries = hierarchy_stencils.STENCIL_NODES if self.nested is not None else widest**dimension
        table = stencils.Stencils(
            0,
            np.zeros((m, entries), dtype=np.int64),
            np.zeros((m, entries)),
            np.zeros((m, entries, dimension)),
            np.zeros(m, dtype=np.int64),
        )
        # A spline reaches a node beyond those of the cell; a place just inside the lower border needs one as well.
        margin = self.grids[0].cell_size if kind == tensor_stencils.SPLINE else 0.0
        low, high = self.grids[0].lower + margin, self.grids[0].upper - margin
        inside = np.all((position - box >= low) & (position + box < high), axis=1)
        place = np.ascontiguousarray(np.where(inside[:, None], position, 0.5 * (low + high)))
        box = np.ascontiguousarray(np.where(inside[:, None], box, 0.0))
        if self.nested is not None:
            hierarchy_stencils.place_stencils(self.nested, place, box, table)
        else:
            self._fill(place, box, kind, table)
        table.entries[~inside] = 0
        table.weight[~inside] = 0.0
        return table.node, table.weight, table.entries

    def list_nodes(self, node: IntArray, count: IntArray) -> None:
        """Add the nodes of stencils to those in use."""
        self._list(node, count)

    # ---- sweeps ----------------------------------------------------------------------------------------

    def _scatter(self, kernel: Callable[..., Any], *arguments: Any) -> list[Any]:
        """Run a sweep that writes to nodes over all regular points; threads never share a strip's neighbour."""
        rows = self.points.rows
        answers = []
        for level, lattice in enumerate(self._lattices):
            begin, end = self.begin[level], self.begin[level + 1]
            if begin == end:
                continue
            if self._pool is None or end - begin < WORTH_SHARING:
                answers.append(kernel(rows, np.array([[begin, end]]), lattice, *arguments))
                continue
            strips = np.stack([self._strips[level][:-1], self._strips[level][1:]], axis=1)
            for parity in range(2):
                parts = _share(strips[parity::2], self.threads)
                answers += self._together([partial(kernel, rows, part, lattice, *arguments) for part in parts])
        return answers

    def _together(self, calls: Sequence[Callable[[], Any]]) -> list[Any]:
        assert self._pool is not None
        others = [self._pool.submit(call) for call in calls[1:]]
        answers = [calls[0]()]
        return answers + [other.result() for other in others]

    def scatter_state(self, momentum: FloatArray) -> None:
        """Add mass, momentum and internal force of the points to the nodes (Eqs 11-14)."""
        self._scatter(sweeps.scatter_state, momentum)
        if self._table.entries.size:
            stencils.scatter_state(self.points.rows, self._table, self.columns, self._voigt, momentum)

    def scatter_filtered(self, field: FloatArray, out: FloatArray) -> None:
        """Add the momentum S^T m S of a nodal velocity field to `out`."""
        self._scatter(sweeps.scatter_filtered, field, out)
        if self._table.entries.size:
            stencils.scatter_filtered(self.points.rows, self._table, self.columns, field, out)

    def scatter_point_forces(self, row: IntArray, force: FloatArray, momentum: FloatArray) -> None:
        """Put forces (k, d) [N] on points, given by their rows (k,), onto the nodes by the points' functions."""
        for level, lattice in enumerate(self._lattices):
            mine = np.flatnonzero((row >= self.begin[level]) & (row < self.begin[level + 1]))
            if mine.size:
                sweeps.scatter_point_forces(self.points.rows, row[mine], force[mine], lattice, momentum)
        mine = np.flatnonzero((row >= self.regular) & (row < self.alive))
        if mine.size:
            stencils.add_forces_of(self._table, row[mine] - self.regular, force[mine], momentum)

    def read_points(self, row: IntArray, velocity: FloatArray) -> FloatArray:
        """Nodal velocities at points, given by their rows (k,), by the points' functions, (k, d) [m/s]."""
        read = np.zeros((row.size, self.columns.dimension))
        for level, lattice in enumerate(self._lattices):
            mine = np.flatnonzero((row >= self.begin[level]) & (row < self.begin[level + 1]))
            if mine.size:
                part = np.empty((mine.size, read.shape[1]))
                sweeps.read_points(self.points.rows, row[mine], lattice, velocity, part)
                read[mine] = part
        mine = np.flatnonzero((row >= self.regular) & (row < self.alive))
        if mine.size:
            part = np.empty((mine.size, read.shape[1]))
            stencils.read_points(self._table, row[mine] - self.regular, velocity, part)
            read[mine] = part
        return read

    def update(self, motion: FloatArray, keep: float, time_step: float) -> float:
        """New velocities and increments of the points (Eqs 19-20); returns the largest increment [m]."""
        sizes = self._scatter(sweeps.update_points, motion, keep, time_step)
        return max([*sizes, self._update_irregular(motion, keep, time_step)])

    def update_remap(self, motion: FloatArray, keep: float, time_step: float, remapped: FloatArray) -> float:
        """`update`, and the new momenta on the nodes (Eq 21)."""
        sizes = self._scatter(sweeps.update_remap_points, motion, keep, time_step, remapped)
        largest = max([*sizes, self._update_irregular(motion, keep, time_step)])
        if self._table.entries.size:
            stencils.scatter_momentum(self.points.rows, self._table, self.columns, remapped)
        return largest

    def _update_irregular(self, motion: FloatArray, keep: float, time_step: float) -> float:
        if not self._table.entries.size:
            return 0.0
        return float(stencils.update_points(self.points.rows, self._table, self.columns, motion, keep, time_step))

    def update_deform(
        self, motion: FloatArray, keep: float, time_step: float, stress: Callable[[slice], None]
    ) -> float:
        """`update`, deformation by the same velocities, the move, then the stress of each chunk of rows."""
        rows = self.points.rows
        sizes = self._by_chunks(
            lambda ranges, lattice: sweeps.update_deform_points(rows, ranges, lattice, motion, keep, time_step), stress
        )
        largest = max([*sizes, self._update_irregular(motion, keep, time_step)])
        self._deform_irregular(motion, time_step, 1.0, stress)
        return largest

    def deform(self, velocity: FloatArray, time_step: float, move: bool, stress: Callable[[slice], None]) -> None:
        """Deformation gradients by nodal velocities (Eqs 22-24), the move if asked, the stress."""
        rows = self.points.rows
        self._by_chunks(
            lambda ranges, lattice: sweeps.deform_points(rows, ranges, lattice, velocity, time_step, float(move)),
            stress,
        )
        self._deform_irregular(velocity, time_step, float(move), stress)

    def move(self) -> None:
        """Add the increments to the positions."""
        c = self.columns
        rows = self.points.rows[: self.alive]
        rows[:, : c.dimension] += rows[:, c.increment : c.increment + c.dimension]

    def _deform_irregular(
        self, velocity: FloatArray, time_step: float, move: float, stress: Callable[[slice], None]
    ) -> None:
        if self._table.entries.size:
            stencils.deform_points(self.points.rows, self._table, self.columns, velocity, time_step, move)
            stress(slice(self.regular, self.alive))

    def _by_chunks(
        self, sweep: Callable[[IntArray, sweeps.Lattice], Any], stress: Callable[[slice], None]
    ) -> list[Any]:
        """Run a sweep that writes to points only, chunk by chunk, each followed by its stress."""
        chunks = []
        for level, lattice in enumerate(self._lattices):
            begin, end = int(self.begin[level]), int(self.begin[level + 1])
            chunks += [(lattice, start, min(start + CHUNK, end)) for start in range(begin, end, CHUNK)]

        def run(part: list[tuple[sweeps.Lattice, int, int]]) -> list[Any]:
            answers = []
            for lattice, start, stop in part:
                answers.append(sweep(np.array([[start, stop]]), lattice))
                stress(slice(start, stop))
            return answers

        if self._pool is None or self.regular < WORTH_SHARING:
            return run(chunks)
        parts = [chunks[k :: self.threads] for k in range(self.threads)]
        found = self._together([partial(run, part) for part in parts])
        return [answer for part in found for answer in part]

    # ---- saving ----------------------------------------------------------------------------------------

    def state(self) -> dict[str, NDArray[Any]]:
        """What sorting has left behind: with the rows it lets a run go on bit for bit."""
        return {
            "begin": self.begin.copy(),
            "active": self.active.copy(),
            "travel": np.array([self.travel]),
            "alive": np.array([self.alive], dtype=np.int64),
            "strips": np.concatenate([np.zeros(0, np.int64), *self._strips]),
        }

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Take back the order of a saved state; the rows are restored by the caller."""
        self.begin = np.array(state["begin"], dtype=np.int64)
        active = np.asarray(state["active"], dtype=np.int64)
        self._mark[:] = 0
        self._mark[active] = 1
        self._used = active.size
        self._listed[: self._used] = active
        self.travel = float(state["travel"][0])
        self.alive = int(state["alive"][0])
        sizes = [-(-(g.cells[1] + 1) // STRIP) + 1 for g in self.grids] if len(state["strips"]) else []
        self._strips = np.split(np.asarray(state["strips"], dtype=np.int64), np.cumsum(sizes)[:-1]) if sizes else []
        self._table = self._make_table(self.alive - self.regular)


def _share(strips: IntArray, parts: int) -> list[IntArray]:
    """Split strips into parts of about equal numbers of points."""
    points = np.cumsum(strips[:, 1] - strips[:, 0])
    total = points[-1] if points.size else 0
    cuts = np.searchsorted(points, [total * k / parts for k in range(1, parts)], side="left")
    return [np.ascontiguousarray(part) for part in np.split(strips, cuts)]
