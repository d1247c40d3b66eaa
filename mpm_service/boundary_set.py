"""Prescribed motion of faces and nodes, imposed on the nodal tables of a step; the rule is in `boundary_lines`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .boundary_lines import (
    FIELDS,
    Faces,
    Place,
    accelerate_lines,
    draw_lines,
    hold_halfway,
    impose_lines,
    locate_faces,
    no_lines,
)
from .conditions import FACES, Approach, EdgeCondition, FieldCondition, NodeCondition
from .time_functions import Schedule, TimeFunction
from .velocity_fields import FieldMap, single_field

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Grid lines on either side of a face that its rule may use [cells].
_REACH_CELLS = 3.0
# A node this close to a box counts as inside [cells]: covers round-off of decimal input.
_BOX_TOLERANCE = 1e-6
_NO_FIELDS = single_field(0)
# Rounds in which the material at a node of a face that moves along itself is found.
_ROUNDS = 20

Condition = EdgeCondition | FieldCondition | NodeCondition


class Constraints(NamedTuple):
    """Components of nodes that follow: ``v_node = v + ratio (v_free - v)``, v being the face's."""

    node: IntArray
    component: IntArray
    free: IntArray
    """Row of the free node, or -1."""
    ratio: FloatArray
    motion: FloatArray
    """Of the face in the step [m/s], or, for a step of 1 s, [m]."""


class LatticeGrid(Protocol):
    """What is read of a grid: its level 0, a uniform lattice whose rows come first, x fastest, then y, then z."""

    @property
    def origin(self) -> Sequence[float]:
        """Lowest node [m]."""

    @property
    def cell_size(self) -> float:
        """Side of a cell [m]."""

    @property
    def cells(self) -> Sequence[int]:
        """Cells in each direction."""


class BoundarySet:
    """All boundary conditions of a body on the uniform level of a grid, in the plane or in space.

    A step calls `locate`, then `impose` and `accelerate` with masses in ``momentum``.

    Parameters
    ----------
    conditions : sequence of EdgeCondition, FieldCondition or NodeCondition
    grid : LatticeGrid
        The grid; conditions act on its level 0.
    lower, upper : (d,) array_like
        Corners of the body in the reference state [m].
    time_step : float
        [s].
    started_moving : bool
        Faces are taken to have moved with the velocity of their first step before step 0, else to have been
        at rest.
    refined : sequence of (lower, upper)
        Rectangles of the grid that have finer cells [m]: no face may come near them.
    splines : bool
        The grid's functions are B-splines: free nodes next to faces take their velocities by the transposed rule.
    approach : Approach, optional
        Faces go to their displacement at time 0 and stay there.

    Attributes
    ----------
    reaction : (k,) ndarray
        Force each condition put on the body in the last step, along its component [N].

    Raises
    ------
    ValueError
        If two conditions prescribe the same component of the same face or node, a condition does not fit the
        grid's dimension, a box holds no node, or a face or box comes near a refined rectangle.
    """

    def __init__(
        self,
        conditions: Sequence[Condition],
        grid: LatticeGrid,
        lower: ArrayLike,
        upper: ArrayLike,
        time_step: float,
        started_moving: bool = False,
        refined: Sequence[tuple[Sequence[float], Sequence[float]]] = (),
        splines: bool = False,
        approach: Approach | None = None,
    ) -> None:
        self.conditions = tuple(conditions)
        self.reaction = np.zeros(len(self.conditions))
        self._time_step = float(time_step)
        self._started_moving = started_moving
        self._splines = splines
        self._refined = tuple((np.asarray(a, np.float64), np.asarray(b, np.float64)) for a, b in refined)
        self._cell = float(grid.cell_size)
        self._origin = np.array(grid.origin, dtype=np.float64)
        names = [f"edge_conditions[{k}]" for k in range(len(self.conditions))]
        self._schedule = Schedule([_over_time(c) for c in self.conditions], names, time_step)
        self._approach = approach
        self._checked: int | None = None
        corners = np.asarray(lower, np.float64), np.asarray(upper, np.float64)
        self._faces = self._kernel_form(grid, *corners)
        self._widest = [self._widest_move(condition, *corners) for condition in self.conditions]
        count = self._count_entries()
        self._place = Place(np.zeros(count, dtype=np.int64), *(np.zeros(count) for _ in range(3)))
        self._tabulated: tuple[bytes, FloatArray] | None = None
        self._fields: FieldMap = _NO_FIELDS
        self._lines = no_lines(0)
        self._made = -1
        if self.conditions:
            self.locate(0)

    def locate(self, step: int, fields: FieldMap = _NO_FIELDS) -> None:
        """Find the faces at the start of the step from ``step`` to ``step + 1``, and their velocities.

        Parameters
        ----------
        step : int
            Steps made so far.
        fields : FieldMap
            Further velocity fields at cracks, as they are in this step. A line keeps to the field number of its nodes,
            which is one side of a crack that runs out through the face.

        Raises
        ------
        ValueError
            If a time function gives a bad value, or a face comes near a refined rectangle.
        """
        if not self.conditions:
            return
        window = self._schedule.window(step)
        if self._refined and self._checked != self._schedule.first:
            self._check_refined(self._schedule.values)
            self._checked = self._schedule.first
        shares = np.ones(3)
        if self._approach is not None:
            window = np.broadcast_to(self._schedule.now(0), window.shape)
            shares = np.clip(np.array([step - 1, step, step + 1]) / self._approach.steps, 0.0, 1.0)
        if step == 0:
            window, shares = window.copy(), shares.copy()
            window[0] = window[1] - (window[2] - window[1] if self._started_moving else 0.0)
            shares[0] = shares[1]
        self._put(self._entries(window, shares), self._time_step, fields)

    def approach_between(self, before: float, after: float, fields: FieldMap = _NO_FIELDS) -> None:
        """Find the faces when they have gone a share of their approach, and their way to another share, in 1 s."""
        if self.conditions:
            window = np.broadcast_to(self._schedule.now(0), (3, len(self.conditions)))
            self._put(self._entries(window, np.array([before, before, after])), 1.0, fields)

    def _put(self, displacement: FloatArray, time_step: float, fields: FieldMap) -> None:
        self._fields = fields
        self._made = -1
        locate_faces(self._faces, self._place, displacement, self._origin, 1.0 / self._cell, time_step)

    def _entries(self, window: FloatArray, shares: FloatArray) -> FloatArray:
        """Displacement of each entry [m], (3, entries), from the values of the time functions and of the approach."""
        faces = self._faces
        if not np.any(faces.lined):
            return np.ascontiguousarray(shares[:, None] * window)
        key = window.tobytes() + shares.tobytes()
        if self._tabulated is not None and self._tabulated[0] == key:
            return self._tabulated[1]
        found = np.empty((3, self._place.nearest.size))
        for k in np.flatnonzero(faces.lined == 0):
            found[:, faces.first[k]] = shares * window[:, k]
        for edge in FACES[:4]:
            mine = {
                c.component: k
                for k, c in enumerate(self.conditions)
                if not isinstance(c, NodeCondition) and c.edge == edge and faces.lined[k]
            }
            if mine:
                self._fill_lines(mine, window, shares, found)
        self._tabulated = (key, found)
        return found

    def _fill_lines(self, mine: dict[int, int], window: FloatArray, shares: FloatArray, found: FloatArray) -> None:
        """Displacements of the lines of one face, given its conditions by component."""
        some = next(iter(mine.values()))
        axis = int(self._faces.axis[some])
        count = int(self._faces.nodes[1 - axis])
        start = self._approach.start if self._approach is not None else None
        place = np.empty((count * FIELDS, 2))
        place[:, axis] = self._faces.reference[some]
        node = np.repeat(self._origin[1 - axis] + self._cell * np.arange(count), FIELDS)
        place[:, 1 - axis] = node
        other_side = np.tile(np.array([1, -1, -1])[:FIELDS], count)

        def moved(component: int, times: slice) -> FloatArray:
            """(times, entries) at the present `place`."""
            part = np.zeros((window[times].shape[0], place.shape[0]))
            if start is not None:
                sides = start.side(at_node) * other_side
                part += (1.0 - shares[times, None]) * start.displacement(place, sides)[:, component]
            if component not in mine:
                return part
            condition = self.conditions[mine[component]]
            factor = (shares * window[:, mine[component]])[times, None]
            if not isinstance(condition, FieldCondition):
                return part + factor
            sides = condition.field.side(at_node) * other_side
            return part + factor * condition.field.displacement(place, sides)[:, component]

        at_node = place.copy()
        for _ in range(_ROUNDS):
            way = node - moved(1 - axis, slice(1, 2))[0] - place[:, 1 - axis]
            place[:, 1 - axis] += way
            if np.abs(way).max() < 1e-12 * self._cell:
                break
        for component, k in mine.items():
            first = int(self._faces.first[k])
            found[:, first : first + place.shape[0]] = moved(component, slice(0, 3))

    def constraints(self, momentum: FloatArray) -> Constraints:
        """Constrained nodes that carry material, one row for each."""
        if not self.conditions:
            none = np.zeros(0, dtype=np.int64)
            return Constraints(none, none, none, np.zeros(0), np.zeros(0))
        self._draw(momentum)
        lines, made = self._lines, self._made
        length = lines.length[:made]
        valid = np.arange(lines.node.shape[1]) < length[:, None]
        return Constraints(
            lines.node[:made][valid],
            np.repeat(self._faces.component[lines.condition[:made]], length),
            np.repeat(lines.free[:made], length),
            lines.ratio[:made][valid],
            np.repeat(lines.after[:made], length),
        )

    def accelerate(
        self, momentum: FloatArray, motion: FloatArray, keep: float = 1.0, force_factor: float = 1.0
    ) -> tuple[float, float]:
        """Impose the prescribed velocities in the momentum equation; writes ``motion`` and ``reaction``.

        Parameters
        ----------
        momentum : (R, 1 + 2 d) ndarray
            Mass, momentum and force of each row of the nodal tables [kg, kg m/s, N].
        motion : (R, 2 d) ndarray
            New velocity and its increment [m/s], already there for the nodes that no condition reaches.
        keep : float
            Factor of mass-proportional damping in a step.
        force_factor : float
            What the forces in ``momentum`` were multiplied by; the reaction and its work are those of a body
            whose masses were divided by it instead.

        Returns
        -------
        work : float
            Done on the body by the conditions [J].
        not_lost : float
            Damping loss that the update of all nodes counts for constrained nodes but that did not happen [J].
        """
        if not self.conditions:
            return 0.0, 0.0
        self._draw(momentum)
        work, not_lost = accelerate_lines(
            self._lines,
            self._made,
            self._faces.component,
            momentum,
            motion,
            self._time_step,
            keep,
            self._splines,
            self.reaction,
        )
        if force_factor != 1.0:
            self.reaction /= force_factor
            work /= force_factor
        return float(work), float(not_lost)

    def hold_halfway(self, velocity: FloatArray, keep: float) -> None:
        """Mend velocities halfway through the step of `accelerate` (R, d) [m/s] that took all nodes for damped ones."""
        if self.conditions and keep != 1.0:
            hold_halfway(self._lines, self._made, self._faces.component, keep, velocity)

    def impose(self, momentum: FloatArray, velocity: FloatArray, before: bool = False) -> None:
        """Impose the prescribed velocities on a table of nodal velocities.

        Parameters
        ----------
        momentum : (R, 1 + 2 d) ndarray
            Its masses tell which rows carry material, and weigh the velocities of a line with B-splines.
        velocity : (R, >= d) ndarray
            Changed in its first d columns [m/s].
        before : bool
            The velocities belong to the start of the step, not to its end.
        """
        if not self.conditions:
            return
        if self._made < 0:
            self._draw(momentum)
        prescribed = self._lines.before if before else self._lines.after
        impose_lines(self._lines, self._made, self._faces.component, prescribed, momentum, velocity, self._splines)

    def _draw(self, momentum: FloatArray) -> None:
        near, base, capacity, extra = self._fields.near, self._fields.base, self._fields.capacity, self._fields.extra
        size = (1 + extra) * self._most_lines
        if self._lines.free.size < size:
            self._lines = no_lines(size)
        self._made = draw_lines(self._faces, self._place, near, base, capacity, extra, momentum, self._lines)

    def _kernel_form(self, grid: LatticeGrid, lower: FloatArray, upper: FloatArray) -> Faces:
        dimension = len(grid.cells)
        seen: dict[tuple[str, int], int] = {}
        axis = np.full(len(self.conditions), -1, dtype=np.int64)
        sign = np.zeros(len(self.conditions), dtype=np.int64)
        reference = np.zeros(len(self.conditions))
        for k, condition in enumerate(self.conditions):
            if not isinstance(condition, NodeCondition) and condition.axis >= dimension:
                raise ValueError(
                    f"edge_conditions[{k}].edge = {condition.edge!r}: allowed in the plane are {', '.join(FACES[:4])}"
                )
            if condition.component >= dimension:
                raise ValueError(
                    f"edge_conditions[{k}].component = {condition.component}: below {dimension} is needed in "
                    f"{dimension} dimensions"
                )
            if isinstance(condition, NodeCondition):
                continue
            key = (condition.edge, condition.component)
            if key in seen:
                raise ValueError(
                    f"edge_conditions[{k}]: edge {condition.edge!r}, component {condition.component} is "
                    f"already prescribed by edge_conditions[{seen[key]}]"
                )
            seen[key] = k
            axis[k], sign[k] = condition.axis, condition.sign
            reference[k] = (upper if condition.sign > 0 else lower)[condition.axis]
        normal = [-1 if isinstance(c, NodeCondition) else seen.get((c.edge, c.axis), -1) for c in self.conditions]
        lined = [self._is_lined(k, c, seen) for k, c in enumerate(self.conditions)]
        count = np.ones(3, dtype=np.int64)
        count[:dimension] = np.asarray(grid.cells, dtype=np.int64) + 1
        stride = np.array([1, count[0], count[0] * count[1]], dtype=np.int64)
        has_nodes = any(isinstance(c, NodeCondition) for c in self.conditions)
        held = np.zeros((int(count.prod()), dimension) if has_nodes else (0, 0), dtype=np.uint8)
        row, owner = self._find_nodes(count, stride, held)
        across = [int(count.prod() // count[a]) for a in axis if a >= 0]
        self._most_lines = sum(across) + row.size
        component = np.array([c.component for c in self.conditions], dtype=np.int64)
        entries = [FIELDS * int(count[1 - a]) if own else 1 for a, own in zip(axis, lined, strict=True)]
        return Faces(
            axis,
            sign,
            component,
            np.array(normal, dtype=np.int64),
            np.concatenate([np.zeros(1, dtype=np.int64), np.cumsum(entries, dtype=np.int64)])[: len(entries)],
            np.array(lined, dtype=np.int64),
            reference,
            count,
            stride,
            held,
            row,
            owner,
        )

    def _is_lined(self, k: int, condition: Condition, seen: dict[tuple[str, int], int]) -> bool:
        """Does each line of the face move on its own?"""
        if isinstance(condition, NodeCondition):
            return False
        by_field = isinstance(condition, FieldCondition)
        other = seen.get((condition.edge, 1 - condition.component), -1) if condition.component < 2 else -1
        if (other >= 0 and isinstance(self.conditions[other], FieldCondition) != by_field) or (by_field and other < 0):
            raise ValueError(
                f"edge_conditions[{k}]: edge {condition.edge!r} has one component prescribed by a field; fields give "
                "both or none"
            )
        return by_field or (self._approach is not None and self._approach.start is not None)

    def _count_entries(self) -> int:
        faces = self._faces
        if not self.conditions:
            return 0
        last = FIELDS * int(faces.nodes[1 - faces.axis[-1]]) if faces.lined[-1] else 1
        return int(faces.first[-1]) + last

    def _widest_move(self, condition: Condition, lower: FloatArray, upper: FloatArray) -> float:
        """Largest displacement that a field gives a face [m]; 1 where it moves as a whole."""
        if not isinstance(condition, FieldCondition):
            return 1.0
        return float(np.abs(condition.along_face(lower, upper)).max())

    def _find_nodes(self, count: IntArray, stride: IntArray, held: NDArray[np.uint8]) -> tuple[IntArray, IntArray]:
        """Rows of the nodes in boxes and the condition of each; marks them in ``held``."""
        rows = [np.zeros(0, dtype=np.int64)]
        owners = [np.zeros(0, dtype=np.int64)]
        holder = np.full(held.shape, -1, dtype=np.int64)
        dimension = self._origin.size
        line = [self._cell * np.arange(count[b]) + self._origin[b] for b in range(dimension)]
        for k, condition in enumerate(self.conditions):
            if not isinstance(condition, NodeCondition):
                continue
            if len(condition.lower) != dimension:
                raise ValueError(
                    f"edge_conditions[{k}].lower = {condition.lower!r}: {dimension} coordinates are needed"
                )
            low = np.asarray(condition.lower, np.float64) - _BOX_TOLERANCE * self._cell
            high = np.asarray(condition.upper, np.float64) + _BOX_TOLERANCE * self._cell
            self._check_box(k, low, high)
            inside = [np.flatnonzero((line[b] >= low[b]) & (line[b] <= high[b])) for b in range(dimension)]
            found = np.zeros(1, dtype=np.int64)
            for b in reversed(range(dimension)):
                found = (found[:, None] + inside[b] * stride[b]).ravel()
            if found.size == 0:
                raise ValueError(
                    f"edge_conditions[{k}]: no grid node lies between lower = {condition.lower!r} m and "
                    f"upper = {condition.upper!r} m (cell {self._cell:.6g} m)"
                )
            taken = holder[found, condition.component]
            if np.any(taken >= 0):
                raise ValueError(
                    f"edge_conditions[{k}]: component {condition.component} of {int(np.sum(taken >= 0))} of its nodes "
                    f"is already prescribed by edge_conditions[{int(taken.max())}]"
                )
            holder[found, condition.component] = k
            held[found, condition.component] = 1
            rows.append(found.astype(np.int64))
            owners.append(np.full(found.size, k, dtype=np.int64))
        return np.concatenate(rows), np.concatenate(owners)

    def _check_box(self, k: int, low: FloatArray, high: FloatArray) -> None:
        for lower, upper in self._refined:
            if np.all(low < upper) and np.all(high > lower):
                raise ValueError(
                    f"edge_conditions[{k}]: its box overlaps the refined rectangle from {lower.tolist()} to "
                    f"{upper.tolist()} m; conditions act on the coarsest level only"
                )

    def _check_refined(self, displacement: FloatArray) -> None:
        """Refuse a face that comes near a refined rectangle while it moves by ``displacement`` (n, conditions)."""
        reach = _REACH_CELLS * self._cell
        for k, condition in enumerate(self.conditions):
            if isinstance(condition, NodeCondition):
                continue
            normal = int(self._faces.normal[k])
            way = displacement[:, normal] if normal >= 0 else np.zeros(1)
            if isinstance(condition, FieldCondition):
                way = self._widest[normal] * np.concatenate([way, -way])
            low = float(self._faces.reference[k] + way.min()) - reach
            high = float(self._faces.reference[k] + way.max()) + reach
            for lower, upper in self._refined:
                if low < upper[condition.axis] and high > lower[condition.axis]:
                    raise ValueError(
                        f"edge_conditions[{k}]: face {condition.edge!r} comes within {reach:.6g} m of the refined "
                        f"rectangle from {lower.tolist()} to {upper.tolist()} m; refinement must stay clear of "
                        "faces with prescribed motion"
                    )


def _over_time(condition: Condition) -> TimeFunction:
    """Displacement [m] of a condition over time, or the factor on its field."""
    return condition.factor if isinstance(condition, FieldCondition) else condition.displacement
