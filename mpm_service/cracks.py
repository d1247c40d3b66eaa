"""Cracks in a body: all that a step needs of them (CRAMP, seed Sec 2.4).

Whether the way from a point to a node crosses a crack is decided in the reference state: a point keeps the side it
was born on, and a node is brought back by the displacement and the rotation of the crack beside it. So cracks move
and turn with the body, and a rigid motion changes nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from .contact import STICK, Facing, list_facing, press_faces
from .crack_ends import cut_line, end_of, find_joints, has_material_ahead
from .crack_extension import check_extension
from .crack_faces import Markers, empty_markers, fit_faces, move_faces, place_markers, tie_loose_faces
from .crack_line import (
    Contact,
    Crack,
    check_line,
    meeting,
    nearest_on_line,
    push_left,
    unit_tangent,
)
from .errors import SolverError
from .near_nodes import (
    NUDGE,
    CrackGrid,
    Lattices,
    cell_at,
    farthest_move,
    find_windows,
    lattices,
    list_pairs,
    mark_around,
    midline,
    place_nodes,
)
from .velocity_fields import FieldMap, assign_fields, single_field

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Cracks a body may have: a crossing pattern is a whole number with a bit for each.
MOST_CRACKS = 62
# Markers have moved this far since the near nodes were listed: list them again [cells].
_REFRESH = 0.4
# Beyond the reach of grid functions: the refresh above, half the markers' distance, slack for strain [cells].
_SLACK = 1.0
# A point's way between two sorts, and from it to its nearest node [cells].
_TRAVEL = 1.5
# Near nodes at the start, times this, are the room for extra fields, so that a growing crack rarely needs more.
_ROOM = 2.0

_CONTACTS: tuple[Contact, ...] = ("frictionless", "stick", "coulomb")


@dataclass(frozen=True)
class Tip:
    """End of a crack inside the body.

    Attributes
    ----------
    crack : int
        Number of the crack.
    end : {0, 1}
        Its first or last point.
    position, reference : (2,) ndarray
        Place now and in the reference state [m].
    direction, reference_direction : (2,) ndarray
        Unit vector along the line, out of the crack, now and in the reference state.
    length : float
        Reference length of the whole line [m].
    """

    crack: int
    end: int
    position: FloatArray
    reference: FloatArray
    direction: FloatArray
    reference_direction: FloatArray
    length: float


class CrackSet:
    """The cracks of a body: velocity fields at their nodes, contact, faces, tips.

    Parameters
    ----------
    cracks : sequence of Crack
        May be empty: then nothing here costs anything.
    grid : Grid or HierarchicalGrid
        Background grid.
    reference_positions : (n, 2) array_like
        Reference places of the points by id [m].
    reach : float
        How far a grid function's node may lie from a point that feels it, along an axis [cells]: 1.5 for fixed
        domains and quadratic splines, one plus the largest half domain else.

    Attributes
    ----------
    field_map : FieldMap
        Rows of the extra fields.
    extra_rows : (m,) ndarray of int
        Extra rows that may be in use.
    changed : bool
        The near nodes, and so the irregular points and perhaps the number of rows, are others than when this was
        last set to False, which is for the solver to do when it has sorted.

    Raises
    ------
    ValueError
        If two cracks end at the same place, or there are more than 62.
    """

    def __init__(
        self, cracks: Sequence[Crack], grid: CrackGrid, reference_positions: ArrayLike, reach: float = 1.5
    ) -> None:
        self.cracks = tuple(cracks)
        if len(self.cracks) > MOST_CRACKS:
            raise ValueError(f"cracks: {len(self.cracks)} are too many, at most {MOST_CRACKS} are allowed")
        self.reach = float(reach)
        self._grid: Lattices = lattices(grid)
        rows = self._grid.place.shape[0]
        self.field_map: FieldMap = single_field(rows)
        self.extra_rows: IntArray = np.zeros(0, dtype=np.int64)
        self.changed = False
        self._lines: list[FloatArray] = [crack.line for crack in self.cracks]
        self._law = np.array([_CONTACTS.index(crack.contact) for crack in self.cracks], dtype=np.int64)
        self._friction = np.array([crack.friction for crack in self.cracks], dtype=np.float64)
        self._identity = np.zeros(0, dtype=np.int64)
        self._faces: FloatArray = np.zeros((0, 4))
        if self.cracks:
            self._near = np.full(rows, -1, dtype=np.int64)
            self._near_node = np.zeros(0, dtype=np.int64)
            self._capacity = 0
            self.set_points(reference_positions)

    def __bool__(self) -> bool:
        return bool(self.cracks)

    @property
    def row_count(self) -> int:
        """Rows that nodal tables need, those of the grid and all extra ones."""
        return self.field_map.base + self.field_map.extra * self.field_map.capacity

    # ---- set-up --------------------------------------------------------------------------------------

    def set_points(self, reference_positions: ArrayLike) -> None:
        """Take the reference places (n, 2) of all points by id [m], at the start and whenever points were split."""
        if not self.cracks:
            return
        self._stated = np.ascontiguousarray(reference_positions, dtype=np.float64)
        self._tree = cKDTree(self._stated)
        self._shape()
        if self._faces.shape[0] == 0:
            self._faces = np.zeros((self._markers.reference.shape[0], 4))
        self._found = np.empty_like(self._markers.reference)
        midline(self._markers.reference, self._faces, self._found)
        self._list_nodes()

    def _cell_at(self, places: FloatArray) -> FloatArray:
        return cell_at(self._grid, np.ascontiguousarray(places, dtype=np.float64))

    def _shape(self, kept: dict[tuple[int, int], int] | None = None, old: Markers | None = None) -> None:
        """Everything that follows from the lines: joints, tips, cut lines, markers and the points they follow.

        ``kept`` maps (crack, marker in it) to markers of ``old`` whose points are still right.
        """
        lines, cracks = self._lines, range(len(self._lines))
        self._joints, self._met = find_joints(lines, self._cell_at, 4.0 * (self.reach + _SLACK))
        cut = [cut_line(lines[c], [(c, e) not in self._met for e in range(2)], self._cell_at) for c in cracks]
        self._vertex_start = np.concatenate([[0], np.cumsum([c.shape[0] for c in cut])]).astype(np.int64)
        # A point on a line counts as left of it; a copy, since the faces must follow the points as they are.
        self._reference = self._stated.copy()
        ahead = self._find_tips(cut)
        self._vertex = np.ascontiguousarray(np.concatenate(ahead))
        for line in ahead:
            push_left(self._reference, line, 0, line.shape[0] - 1, NUDGE * float(self._cell_at(line).min()))
        markers = empty_markers([place_markers(line, self._cell_at) for line in lines], self._cell_at)
        chosen = np.ones(markers.reference.shape[0], dtype=bool)
        if kept is not None and old is not None:
            for (crack, place), before in kept.items():
                m = int(markers.start[crack]) + place
                chosen[m] = False
                for table, source in (
                    (markers.point, old.point),
                    (markers.factor, old.factor),
                    (markers.count, old.count),
                ):
                    table[m] = source[before]
        self._tip_marker = {(c, e): int(markers.start[c + e]) - e for c, e in self._tip_ends}
        tips = set(self._tip_marker.values())
        fit_faces(markers, np.flatnonzero(chosen), tips, self._tree, self._reference, cut)
        tie_loose_faces(markers)
        self._markers = markers
        self._line = np.empty_like(markers.reference)

    def _find_tips(self, cut: list[FloatArray]) -> list[FloatArray]:
        """Find the ends that are tips; return the cut lines, each going on straight for a cell ahead of its tips."""
        ahead = [line.copy() for line in cut]
        self._tip_ends = [
            (c, e)
            for c, line in enumerate(self._lines)
            for e in range(2)
            if (c, e) not in self._met and has_material_ahead(line, e, self._stated, self._tree, self._cell_at)
        ]
        self._tips = np.zeros((len(cut), 2, 5))
        for c, e in self._tip_ends:
            place, _, out = end_of(self._lines[c], e)
            cell = float(self._cell_at(place[None])[0])
            self._tips[c, e] = (*place, *out, 1.0 / cell)
            ahead[c][-e] = place + cell * out
        return ahead

    def _list_nodes(self) -> None:
        """Find the near nodes around the markers at ``_found``, and their pairs with cracks."""
        start, rows = self._markers.start, self._near.size
        self._near[self._near_node] = -1
        self._near_node, self._pairs = list_pairs(self._grid, self._found, start, self.reach + _SLACK)
        count = self._near_node.size
        self._near[self._near_node] = np.arange(count)
        self._place()
        find_windows(
            self._pairs,
            self._vertex,
            self._vertex_start,
            # Twice the way across a grid function, in the reference state: what a stretched body may need.
            2.0 * np.sqrt(2.0) * (self.reach + 0.5) * self._markers.cell[self._pairs.hint],
        )
        if count > self._capacity:
            self._capacity = int(_ROOM * count) + 1
        self._pattern = np.zeros((count, 2), dtype=np.int64)
        self.field_map = FieldMap(self._near, rows, self._capacity, min(len(self._lines), 2))
        several = np.flatnonzero(np.diff(self._pairs.start) > 1)
        self.extra_rows = np.concatenate([rows + np.arange(count), rows + self._capacity + several]).astype(np.int64)
        self.changed = True

    # ---- in a step -------------------------------------------------------------------------------------

    def follow(self) -> None:
        """Bring the near nodes up to where the cracks are now; first thing in a step, before ``changed`` is read."""
        if not self.cracks:
            return
        midline(self._markers.reference, self._faces, self._line)
        if farthest_move(self._line, self._found, self._markers.cell) > _REFRESH:
            self._found[:] = self._line
            self._list_nodes()
        self._place()
        self._pattern[:] = 0

    def _place(self) -> None:
        midline(self._markers.reference, self._faces, self._line)
        place_nodes(
            self._near_node,
            self._grid.place,
            self._markers.start,
            self._markers.reference,
            self._faces,
            self._line,
            self._markers.cell,
            self._pairs,
        )

    def mark_special(self, mask: NDArray[np.uint8]) -> None:
        """Set 1 at the grid rows whose points may need an extra field before they have moved by a cell.

        Parameters
        ----------
        mask : (grid rows,) ndarray of uint8
        """
        if self.cracks:
            mark_around(self._grid, self._found, self.reach + _SLACK + _TRAVEL, False, mask)

    def assign_fields(
        self,
        ids: IntArray,
        first: int,
        last: int,
        stencil_node: IntArray,
        stencil_weight: FloatArray,
        stencil_gradient: FloatArray,
        stencil_count: IntArray,
    ) -> None:
        """Replace the nodes of points' stencils by the rows of the velocity fields that the points use there.

        Parameters
        ----------
        ids : (capacity,) ndarray of int
            Id of the point in each row of the point table.
        first, last : int
            Rows to do; entry ``i - first`` of the stencils belongs to row i.
        stencil_node, stencil_weight, stencil_gradient : (last - first, K), the same, (last - first, K, 2) ndarray
            With room for twice the nodes of a point: an entry that passes a tip is divided between two fields.
        stencil_count : (last - first,) ndarray of int

        Raises
        ------
        SolverError
            If a node needs more than three velocity fields.
        """
        if self.cracks:
            table = (stencil_node, stencil_weight, stencil_gradient, stencil_count)
            self._assign(self._reference, ids, first, last, *table)

    def assign_fields_at(self, reference: ArrayLike, stencil_node: IntArray, stencil_count: IntArray) -> None:
        """As ``assign_fields``, for material at the reference places (m, 2) [m]: anchors, loads.

        Nothing is divided: at a tip the field with the larger share counts.
        """
        if not self.cracks:
            return
        place = np.ascontiguousarray(reference, dtype=np.float64)
        count = place.shape[0]
        if self._identity.size < count:
            self._identity = np.arange(2 * count, dtype=np.int64)
        whole = np.zeros((count, 0)), np.zeros((count, 0, 2))
        self._assign(place, self._identity, 0, count, stencil_node, *whole, stencil_count)

    def _assign(
        self,
        place: FloatArray,
        ids: IntArray,
        first: int,
        last: int,
        node: IntArray,
        weight: FloatArray,
        gradient: FloatArray,
        count: IntArray,
    ) -> None:
        over = assign_fields(
            place,
            ids,
            first,
            last,
            self._near,
            self.field_map.base,
            self._capacity,
            self._vertex,
            self._tips,
            self._pairs,
            self._joints,
            self._pattern,
            node,
            weight,
            gradient,
            count,
        )
        if over >= 0:
            row = int(self._near_node[over])
            x, y = (float(v) for v in self._grid.place[row])
            span = slice(int(self._pairs.start[over]), int(self._pairs.start[over + 1]))
            cracks = ", ".join(str(int(c)) for c in self._pairs.crack[span])
            raise SolverError(
                f"node {row} at ({x:.9g}, {y:.9g}) m: cracks {cracks} cut the material around it into more than "
                "three parts, which is the most a node can hold; keep cracks from crossing (a crack may end on "
                "another one), or make the cells smaller",
                -1,
                -1,
                (x, y),
            )

    def hold(self, momentum: FloatArray, velocity: FloatArray, time_step: float, increment_column: int = 0) -> float:
        """Keep faces from running into each other, on nodal velocities; returns the energy lost to friction [J].

        Parameters
        ----------
        momentum : (rows, 5) ndarray
            Nodal mass in column 0 [kg].
        velocity : (rows, 2 or more) ndarray
            Velocity in columns 0 and 1 [m/s].
        time_step : float
            [s]
        increment_column : int
            First of two columns that hold the velocity's increment and change alike; 0 if there are none. Only
            with it is the returned energy that of a step.
        """
        if not self.cracks:
            return 0.0
        return float(
            press_faces(
                self._near_node,
                self.field_map.base,
                self._capacity,
                self._pairs,
                self._joints,
                self._pattern,
                self._law,
                self._friction,
                momentum,
                velocity,
                float(time_step),
                increment_column,
            )
        )

    def facing(self, momentum: FloatArray) -> Facing:
        """Pairs of velocity fields that a crack parts at a node, for statics; ``momentum`` as in `hold`."""
        most = 3 * self._near_node.size
        node, pair, mark = np.zeros((most, 2), dtype=np.int64), np.zeros(most, dtype=np.int64), np.zeros(most, np.int64)
        made = list_facing(
            self._near_node,
            self.field_map.base,
            self._capacity,
            self._pairs,
            self._joints,
            self._pattern,
            momentum,
            node,
            pair,
            mark,
        )
        pair = pair[:made]
        crack = self._pairs.crack[pair]
        return Facing(
            node[:made],
            self._pairs.normal[pair],
            np.maximum(self._pairs.gap[pair], 0.0),
            np.where(self._law[crack] == STICK, np.inf, self._friction[crack]),
            mark[:made],
        )

    def move(self, rows: FloatArray, row_of: IntArray) -> None:
        """Move the faces with the points of their side, once these have moved.

        Parameters
        ----------
        rows : (capacity, COLUMNS) ndarray
            Point table, positions in its first two columns [m].
        row_of : (n,) ndarray of int
            Row of each id.
        """
        if not self.cracks:
            return
        m = self._markers
        move_faces(rows, row_of, self._stated, m.reference, m.point, m.factor, m.count, m.lead, self._faces)

    # ---- what a run can ask ----------------------------------------------------------------------------

    def line(self, crack: int) -> FloatArray:
        """Corners of a crack in the reference state, grown parts included [m], (k, 2)."""
        return self._lines[crack].copy()

    def faces(self, crack: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Reference places of a crack's markers, and its left and right face now [m], (m, 2) each."""
        span = self._span(crack)
        place = self._markers.reference[span]
        return place.copy(), place + self._faces[span, :2], place + self._faces[span, 2:]

    def opening(self, crack: int = 0) -> tuple[FloatArray, FloatArray]:
        """Distance from a crack's first point (m,) and relative displacement of its faces (m, 2) [m].

        The columns are opening (along the normal now, positive when open) and sliding (left face relative to the
        right one, along the crack now); left is as seen along the line.
        """
        span = self._span(crack)
        line = np.ascontiguousarray(
            self._markers.reference[span] + 0.5 * (self._faces[span, :2] + self._faces[span, 2:])
        )
        relative = self._faces[span, :2] - self._faces[span, 2:]
        tangent = np.array([nearest_on_line(line, 0, line.shape[0] - 1, x, y)[3:] for x, y in line])
        normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
        return (
            self._markers.arc[span].copy(),
            np.stack([(relative * normal).sum(axis=1), (relative * tangent).sum(axis=1)], axis=1),
        )

    @property
    def tips(self) -> list[Tip]:
        """Ends of cracks inside the body that do not meet another crack, in order of crack and end."""
        found = []
        for (crack, end), m in sorted(self._tip_marker.items()) if self.cracks else ():
            line = self._lines[crack]
            now = self._markers.reference + 0.5 * (self._faces[:, :2] + self._faces[:, 2:])
            sign = -1.0 if end == 0 else 1.0
            segment = m if end == 0 else m - 1
            found.append(
                Tip(
                    crack,
                    end,
                    now[m],
                    (line[0] if end == 0 else line[-1]).copy(),
                    sign * np.array(unit_tangent(now, segment)),
                    sign * np.array(unit_tangent(self._markers.reference, segment)),
                    float(self._markers.arc[int(self._markers.start[crack + 1]) - 1]),
                )
            )
        return found

    def extend(self, crack: int, end: int, vector: ArrayLike) -> FloatArray:
        """Let a tip grow by a straight segment.

        Parameters
        ----------
        crack, end : int
            A tip of ``tips``.
        vector : (2,) array_like
            From the tip to its new place, in the reference state [m]. Where it would cross another crack the
            segment ends there and is joined to it.

        Returns
        -------
        (2,) ndarray
            Reference place of the new end [m].

        Raises
        ------
        ValueError
            If there is no such tip, the vector has no length, or the crack would cross itself.

        Notes
        -----
        Points keep the strain that functions a cell wide gave them before the cut. Measured for growth from 7 to
        10 cells in a pulled strip, against a crack that was that long from the start: stress ahead of the tip 2 %
        low, openings within 2 % of the widest up to two cells before the old tip, from there on off by up to 21 %.
        """
        if (crack, end) not in (self._tip_marker if self.cracks else {}):
            raise ValueError(f"extend: crack {crack} has no tip at its end {end}")
        step = np.array(vector, dtype=np.float64)
        if step.shape != (2,) or not np.all(np.isfinite(step)) or not np.hypot(*step) > 0.0:
            raise ValueError(f"extend: vector = {vector!r}: two finite numbers [m], not both zero, are needed")
        old_line = self._lines[crack]
        place = old_line[0] if end == 0 else old_line[-1]
        share = 1.0
        for other, line in enumerate(self._lines):
            for g in range(line.shape[0] - 1):
                if other != crack:
                    met = meeting(place, place + step, line[g], line[g + 1])
                    share = share if met is None else min(share, met)
        new = place + share * step
        self._grow(crack, end, new[None])
        return new.copy()

    def lengthen(self, crack: int, end: int, points: ArrayLike, body: tuple[FloatArray, FloatArray]) -> None:
        """Let a crack go on along given corners, also where there is no material.

        Parameters
        ----------
        crack, end : int
            An end inside the body that meets no other crack; it may lie in a hole.
        points : (k, 2) array_like
            Corners in the reference state [m], inside the body; the last is the new end.
        body : (lower, upper)
            Corners of the body [m].

        Raises
        ------
        ValueError
            If there is no such end, a corner lies outside the body, or the line would meet another crack or itself;
            the message begins with ``crack``, ``end`` or ``points``.

        Notes
        -----
        As for `extend`.
        """
        corners = check_extension(self._lines, self._met, crack, end, points, body, self._cell_at)
        try:
            self._grow(crack, end, corners)
        except ValueError as error:
            raise ValueError(f"points = {corners.tolist()} m: with them, {error}") from None

    def _grow(self, crack: int, end: int, corners: FloatArray) -> None:
        """Put corners (k, 2) behind an end of a crack; ValueError where the line would meet itself."""
        old, old_faces, old_found = self._markers, self._faces, self._found
        former = self._lines[crack]
        line = np.concatenate([corners[::-1], former] if end == 0 else [former, corners])
        check_line(line)
        added = place_markers(line, self._cell_at).shape[0] - int(old.start[crack + 1] - old.start[crack])
        self._lines[crack] = np.ascontiguousarray(line)
        # Points that a marker follows depend on what lies within its fit's reach only.
        way = np.ascontiguousarray(np.concatenate([former[-end][None], corners]))
        touched = 4.0 * float(self._cell_at(way).max())
        kept = {}
        source: list[int] = []
        for c in range(len(self._lines)):
            count = int(old.start[c + 1] - old.start[c])
            shift = added if c == crack and end == 0 else 0
            here = list(range(int(old.start[c]), int(old.start[c + 1])))
            for i, m in enumerate(here):
                if nearest_on_line(way, 0, way.shape[0] - 1, *old.reference[m])[2] > touched:
                    kept[(c, i + shift)] = m
            if c == crack:
                here = [here[0]] * added + here if end == 0 else here + [here[-1]] * added
            assert len(here) == count + (added if c == crack else 0)
            source += here
        self._shape(kept, old)
        # Until the points move next, the new markers stand as the former tip does: closed, with its displacement.
        self._faces = np.ascontiguousarray(old_faces[source])
        self._found = np.ascontiguousarray(old_found[source] + self._markers.reference - old.reference[source])
        self._list_nodes()

    def _span(self, crack: int) -> slice:
        if not 0 <= crack < len(self.cracks):
            raise ValueError(f"crack = {crack!r}: there are {len(self.cracks)} cracks, numbered from 0")
        return slice(int(self._markers.start[crack]), int(self._markers.start[crack + 1]))

    # ---- saving ----------------------------------------------------------------------------------------

    def state(self) -> dict[str, NDArray[Any]]:
        """Everything that changes during a run, as copies."""
        if not self.cracks:
            return {}
        return {
            "crack_corners": np.concatenate(self._lines),
            "crack_corner_count": np.array([line.shape[0] for line in self._lines], dtype=np.int64),
            "crack_faces": self._faces.copy(),
            "crack_found": self._found.copy(),
            "crack_capacity": np.array([self._capacity], dtype=np.int64),
            "crack_changed": np.array([self.changed]),
        }

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Take back a state of a set of the same cracks, grown or not; call ``set_points`` first if points were split.

        Raises
        ------
        ValueError
            If a field is missing or has another shape.
        """
        if not self.cracks:
            return
        for name in ("corners", "corner_count", "faces", "found", "capacity", "changed"):
            if f"crack_{name}" not in state:
                raise ValueError(f"state: field 'crack_{name}' is missing")
        counts = np.asarray(state["crack_corner_count"], dtype=np.int64)
        corners = np.asarray(state["crack_corners"], dtype=np.float64)
        if counts.shape != (len(self.cracks),) or corners.shape != (int(counts.sum()), 2):
            raise ValueError(
                f"state['crack_corners']: shape {corners.shape} with counts {counts.tolist()} does not fit "
                f"{len(self.cracks)} cracks"
            )
        self._lines = [np.ascontiguousarray(part) for part in np.split(corners, np.cumsum(counts)[:-1])]
        self._shape()
        total = self._markers.reference.shape[0]
        for name, shape in (("faces", (total, 4)), ("found", (total, 2))):
            got = np.shape(state[f"crack_{name}"])
            if got != shape:
                raise ValueError(f"state['crack_{name}']: shape {shape} is needed, got {got}")
        self._faces = np.array(state["crack_faces"], dtype=np.float64)
        self._found = np.array(state["crack_found"], dtype=np.float64)
        self._capacity = int(np.asarray(state["crack_capacity"])[0])
        self._list_nodes()
        self.changed = bool(np.asarray(state["crack_changed"])[0])
