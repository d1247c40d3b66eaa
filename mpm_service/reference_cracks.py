"""Straight cracks of the reference solver: which velocity field material uses at a node, and contact of closed faces.

A node's field is a number with a bit for each crack: set where the way from the material to the node crosses it
(Eqs 38-39). Ways are judged in the reference state. There a point stays where it was, and a node is brought back by
the displacement and rotation of the crack beside it, which markers on both faces carry.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .crack_line import Crack
from .cracks import Tip
from .grid import Grid
from .velocity_fields import TIP_BACK, TIP_WIDTH

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

# Cracks closer to each other than this would meet in one point's reach [cells].
APART = 8.0
# Tips count as this much short of where they are stated; lines are this thin [cells].
SHORT, THIN = 1e-6, 1e-9
# Distance of markers, radii of their fits, and how far the first point of a fit may be [cells].
SPACING, RADII, FARTHEST = 0.5, (1.3, 1.8, 2.3), 0.8
# Points that are enough for all radii but the last, and the most that a fit takes.
ENOUGH, MOST = 6, 32
# Material so far ahead of an end and beside the line makes it a tip [cells].
AHEAD, BESIDE = 1.0, 0.75


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


class _Line:
    """One crack: its ends, its markers, and the points that each face of a marker follows."""

    def __init__(self, crack: Crack, cell: float, points: FloatArray) -> None:
        self.cell = cell
        self.ends = crack.line
        length = float(np.linalg.norm(self.ends[1] - self.ends[0]))
        self.tangent = (self.ends[1] - self.ends[0]) / length
        self.normal = np.array([-self.tangent[1], self.tangent[0]])
        self.cut = self.ends + SHORT * cell * np.outer([1.0, -1.0], self.tangent)
        count = max(int(np.ceil(length / (SPACING * cell) - 1e-9)), 1) + 1
        self.markers = self.ends[0] + np.linspace(0.0, 1.0, count)[:, None] * (self.ends[1] - self.ends[0])
        place = self.clear(points)
        left = (place - self.ends[0]) @ self.normal >= 0.0
        anything = np.ones(left.size, dtype=bool)
        self.tips = [end for end in range(2) if self._is_tip(points, end)]
        for end in self.tips:  # a way past a tip crosses the crack for a share
            self.cut[end] = self.ends[end] + (1.0 if end else -1.0) * cell * self.tangent
        self.factors = np.zeros((2, count, points.shape[0]))
        for m, marker in enumerate(self.markers):
            tip = (m == 0 and 0 in self.tips) or (m == count - 1 and 1 in self.tips)
            for side, mine in enumerate((left, ~left)):
                self.factors[side, m] = self._fit(place, marker, anything if tip else mine)

    def clear(self, place: FloatArray) -> FloatArray:
        """Places (n, 2), those on the line moved a little to its left."""
        along = np.clip((place - self.ends[0]) @ self.tangent, 0.0, np.linalg.norm(self.ends[1] - self.ends[0]))
        foot = self.ends[0] + along[:, None] * self.tangent
        on = np.linalg.norm(place - foot, axis=1) < THIN * self.cell
        return np.where(on[:, None], foot + THIN * self.cell * self.normal, place)

    def _is_tip(self, points: FloatArray, end: int) -> bool:
        away = (points - self.ends[end]) / self.cell
        along = away @ self.tangent * (1.0 if end else -1.0)
        return bool(np.any((along > 0.0) & (along <= AHEAD) & (np.abs(away @ self.normal) <= BESIDE)))

    def _fit(self, points: FloatArray, marker: FloatArray, usable: BoolArray) -> FloatArray:
        """Factors with which displacements of points give that of a marker: a plane fitted to the nearest."""
        away = (points - marker) / self.cell
        far = np.where(usable, np.linalg.norm(away, axis=1), np.inf)
        factor = np.zeros(far.size)
        if np.sum(far <= RADII[-1]) < 3 or far.min() > FARTHEST:
            return factor
        radius = next((r for r in RADII if np.sum(far < r) >= ENOUGH), RADII[-1])
        near = far < radius
        if near.sum() > MOST:
            near = np.isin(np.arange(far.size), far.argsort(kind="stable")[:MOST])
            radius = 1.01 * float(far[near].max())
        root = 1.0 - (far[near] / radius) ** 2
        terms = np.column_stack([np.ones(root.size), away[near]])
        factor[near] = np.linalg.pinv(root[:, None] * terms, rcond=1e-2)[0] * root
        return factor / factor.sum()

    def faces(self, moved: FloatArray) -> FloatArray:
        """Displacements of both faces of all markers, (2, markers, 2), from those of the points (n, 2) [m]."""
        faces = self.factors @ moved
        has = np.any(self.factors != 0.0, axis=2)
        for side in range(2):
            held = np.flatnonzero(has[side])
            for m in np.flatnonzero(~has[side]) if held.size else ():
                lead = int(held[np.abs(held - m).argmin()])
                # The rotation is that of the stretch from the lead on, a cell or two into the material.
                beyond = held[(held - lead) * (lead - m) > 0]
                nearest = beyond[np.abs(beyond - lead).argsort(kind="stable")][: int(2 / SPACING)]
                second = int(nearest[-1]) if nearest.size else lead
                turn = self._rotation(faces[side, second] - faces[side, lead], second - lead)
                faces[side, m] = faces[side, lead] + (turn - np.eye(2)) @ (self.markers[m] - self.markers[lead])
        return np.stack([faces[side] if np.any(has[side]) else faces[1 - side] for side in range(2)])

    def _rotation(self, stretch: FloatArray, steps: int) -> FloatArray:
        """Rotation of the line between two markers whose displacements differ by `stretch`."""
        was = steps * (self.markers[1] - self.markers[0])
        now = was + stretch
        size = np.linalg.norm(was) * np.linalg.norm(now)
        cosine, sine = (was @ now / size, _cross(was, now) / size) if size > 0.0 else (1.0, 0.0)
        return np.array([[cosine, -sine], [sine, cosine]])

    def follow(self, nodes: FloatArray, faces: FloatArray) -> tuple[FloatArray, BoolArray, FloatArray, FloatArray]:
        """Bring nodes (n, 2) back to the reference state.

        Returns their places there, whether they lie left of the crack, the moved crack's normal beside them, and the
        gap of the faces along it [m].
        """
        line = self.markers + faces.mean(axis=0)
        step = np.diff(line, axis=0)
        tangent = step / np.linalg.norm(step, axis=1)[:, None]
        share = np.einsum("nsj,sj->ns", nodes[:, None] - line[:-1], step) / np.sum(step**2, axis=1)
        share = np.clip(share, 0.0, 1.0)
        way = nodes[:, None] - line[:-1] - share[:, :, None] * step
        g = np.sum(way**2, axis=2).argmin(axis=1)
        pick = np.arange(nodes.shape[0])
        t, away = share[pick, g], way[pick, g]
        other = np.clip(g + np.where(t == 1.0, 1, np.where(t == 0.0, -1, 0)), 0, tangent.shape[0] - 1)
        direction = tangent[g] + tangent[other]
        direction /= np.linalg.norm(direction, axis=1)[:, None]
        normal = np.stack([-direction[:, 1], direction[:, 0]], axis=1)
        opening = faces[0] - faces[1]
        gap = np.sum(((1.0 - t)[:, None] * opening[g] + t[:, None] * opening[g + 1]) * normal, axis=1)
        side = np.sum(away * normal, axis=1)
        push = np.where(np.abs(side) < THIN * self.cell, THIN * self.cell - side, 0.0)
        away = away + push[:, None] * normal
        cosine, sine = tangent[g] @ self.tangent, _cross(self.tangent, tangent[g])
        turned = np.stack([cosine * away[:, 0] + sine * away[:, 1], cosine * away[:, 1] - sine * away[:, 0]], axis=1)
        foot = self.markers[g] + t[:, None] * (self.markers[g + 1] - self.markers[g])
        return foot + turned, side > -THIN * self.cell, normal, gap

    def crossed(self, start: FloatArray, end: FloatArray) -> BoolArray:
        """Does the way between two places cross the crack?"""
        a, b = self.cut
        sides = (_cross(b - a, start - a) >= 0.0) != (_cross(b - a, end - a) >= 0.0)
        return sides & ((_cross(end - start, a - start) >= 0.0) != (_cross(end - start, b - start) >= 0.0))

    def share(self, start: FloatArray, end: FloatArray) -> FloatArray:
        """Share of the way between two places that crosses the crack: less than one past a tip."""
        share = np.where(self.crossed(start, end), 1.0, 0.0)
        counts = start + (end - start) / 3.0
        for tip in self.tips:
            ahead = (counts - self.ends[tip]) @ self.tangent * (1.0 if tip else -1.0) / self.cell
            share = np.minimum(share, np.maximum(0.0, 0.5 - (ahead + TIP_BACK) / TIP_WIDTH))
        return share


class StraightCracks:
    """Cracks of one straight segment each, clear of one another, whose faces do not rub.

    Parameters
    ----------
    cracks : sequence of Crack
    grid : Grid
    points : (n, 2) ndarray
        Reference places by id [m].

    Raises
    ------
    ValueError
        If a crack has corners or friction, or two come too close.
    """

    def __init__(self, cracks: Sequence[Crack], grid: Grid, points: FloatArray) -> None:
        for k, crack in enumerate(cracks):
            if crack.line.shape[0] != 2 or crack.contact != "frictionless":
                raise ValueError(f"cracks[{k}]: the reference solver has straight frictionless cracks only")
            for other in cracks[:k]:
                if np.min(np.linalg.norm(_samples(crack)[:, None] - _samples(other), axis=2)) < APART * grid.cell_size:
                    raise ValueError(f"cracks[{k}]: the reference solver needs {APART:g} cells between cracks")
        self.points = points
        self.node_place = grid.node_positions() if cracks else np.zeros((0, 2))
        self.lines = [_Line(crack, grid.cell_size, points) for crack in cracks]
        self.field_count = 2 ** len(cracks)
        self._beside: list[tuple[FloatArray, BoolArray, FloatArray, FloatArray]] = []
        self._faces: list[FloatArray] = []
        self.follow(points)

    def follow(self, position: FloatArray) -> None:
        """Take the present positions of the points [m]."""
        self._faces = [line.faces(position - self.points) for line in self.lines]
        self._beside = [line.follow(self.node_place, f) for line, f in zip(self.lines, self._faces, strict=True)]

    @property
    def tips(self) -> list[Tip]:
        """Ends of cracks inside the body, where they are in the state last followed."""
        found = []
        for number, (line, faces) in enumerate(zip(self.lines, self._faces, strict=True)):
            now = line.markers + faces.mean(axis=0)
            for end in line.tips:
                at, inner, sign = (-1, -2, 1.0) if end else (0, 1, -1.0)
                out = (now[at] - now[inner]) / np.linalg.norm(now[at] - now[inner])
                length = float(np.linalg.norm(line.ends[1] - line.ends[0]))
                found.append(Tip(number, end, now[at], line.ends[end].copy(), out, sign * line.tangent, length))
        return found

    def fields(self, reference: FloatArray, node: IntArray, least: float) -> tuple[IntArray, FloatArray]:
        """Field that material at reference places (n, 2) uses at its nodes (n, k), and the share it has there.

        The rest belongs to field 0. Shares of less than `least` count as none.
        """
        field, rest = np.zeros_like(node), np.ones(node.shape)
        for number, (line, (place, *_)) in enumerate(zip(self.lines, self._beside, strict=True)):
            share = line.share(line.clear(reference)[:, None], place[node])
            field |= (share >= least).astype(np.int64) << number
            rest = np.where(share >= least, np.minimum(rest, share), rest)
        return field, rest

    def press(self, mass: FloatArray, velocity: FloatArray, time_step: float) -> FloatArray:
        """Return velocities (R, 2) under which no gap closes by more than itself within a step.

        Rows of the tables are grid nodes of field 0, then those of field 1 and so on.
        """
        result = velocity.copy()
        count = self.node_place.shape[0]
        for number, (_, left, normal, gap) in enumerate(self._beside):
            outward = np.where(left, 1.0, -1.0)[:, None] * normal  # from the far side's material to the own one's
            for field in range(self.field_count):
                if field >> number & 1:
                    continue
                own, far = field * count + np.arange(count), (field | 1 << number) * count + np.arange(count)
                closing = np.sum((result[far] - result[own]) * outward, axis=1)
                excess = np.maximum(closing - np.maximum(gap, 0.0) / time_step, 0.0)
                both = (mass[own] > 0.0) & (mass[far] > 0.0)
                total = np.where(both, mass[own] + mass[far], 1.0)
                push = np.where(both, excess / total, 0.0)[:, None] * outward
                result[own] += mass[far, None] * push
                result[far] -= mass[own, None] * push
        return result


def _samples(crack: Crack) -> FloatArray:
    """Places along a crack."""
    return crack.line[0] + np.linspace(0.0, 1.0, 200)[:, None] * (crack.line[1] - crack.line[0])
