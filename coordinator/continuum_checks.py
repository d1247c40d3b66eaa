"""Checks of [continuum] that involve more than one field; see `coordinator.scene_checks`."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from coordinator.continuum_tables import EDGE_KINDS, LAWS
from coordinator.layup import read_layup
from coordinator.table import Point
from coordinator.units import LENGTHS, readable

#: Path of the field, and what is allowed there.
Problem = tuple[tuple[str | int, ...], str]

#: Part of a cell by which a length may miss a whole number of cells.
CELL_TOLERANCE = 1e-6
#: Cells of a level between its border and that of the next finer one.
LEVEL_MARGIN = 2
#: Relative difference below which two edge velocities are the same.
_SAME_VELOCITY = 1e-9


def continuum_checks(continuum: Any, tables: set[str]) -> list[Problem]:
    """Return the problems within [continuum]; arguments as those of `cross_checks`."""
    found = list(_body(continuum))
    if continuum.material is not None:
        found += _material(continuum.material, tables)
    found += _edges(continuum, tables)
    if continuum.initial_velocity == "follow_edges":
        found += _follow_edges(continuum)
    if continuum.body_force is not None:
        where = ("continuum", "body_force")
        found += _table(where, continuum.body_force.times, "factors", continuum.body_force.factors)
    found += _holes(continuum)
    found += _refinement(continuum)
    found += _cracks(continuum)
    return found


def known(*values: Any) -> bool:
    """Return whether all values could be read."""
    return all(value is not None for value in values)


def length(value: float) -> str:
    """Return a length in the unit in which people read it."""
    return readable(value, LENGTHS)


def whole(cells: float) -> bool:
    """Return whether a length, in cells, is a whole number of at least one."""
    return round(cells) >= 1 and abs(cells - round(cells)) <= CELL_TOLERANCE * max(1.0, abs(cells))


def _body(continuum: Any) -> Iterator[Problem]:
    lower, upper, cell = continuum.lower, continuum.upper, continuum.cell_size
    if not known(lower, upper):
        return
    for axis, letter in enumerate("xy"):
        extent = upper[axis] - lower[axis]
        where = ("continuum", "upper", axis)
        if extent <= 0.0:
            yield where, f"must be greater than continuum.lower in {letter}, {length(lower[axis])}"
        elif known(cell) and not whole(extent / cell):
            nearest = max(1, round(extent / cell))
            yield (
                where,
                (
                    f"the body is {extent / cell:.6g} cells of {length(cell)} along {letter}, must be a whole"
                    f" number; nearest: {length(lower[axis] + nearest * cell)}"
                ),
            )


def _named(
    where: tuple[str | int, ...], what: str, word: str, needed: tuple[str, ...], every: set[str], present: set[str]
) -> Iterator[Problem]:
    """Check that a table holds the keys that its kind needs, and none of another kind.

    Parameters
    ----------
    where : tuple
        Path of the table.
    what, word : str
        Key that names the kind, and the kind.
    needed : tuple of str
        Keys that it needs.
    every : set of str
        Keys that belong to other kinds alone.
    present : set of str
        Keys that the table holds.
    """
    for name in needed:
        if name not in present:
            yield (*where, name), f'is missing; {what} = "{word}" needs it'
    for name in sorted(every & present):
        yield (*where, name), f'must be left out with {what} = "{word}"'


def _keys(where: tuple[str | int, ...], tables: set[str]) -> set[str]:
    start = ".".join(str(part) for part in where) + "."
    return {path[len(start) :] for path in tables if path.startswith(start) and "." not in path[len(start) :]}


def _material(material: Any, tables: set[str]) -> Iterator[Problem]:
    if material.law is None:
        return
    where = ("continuum", "material")
    needed, possible = LAWS[material.law]
    every = {name for pair in LAWS.values() for names in pair for name in names}
    present = _keys(where, tables)
    yield from _named(where, "law", material.law, needed, every - {*needed, *possible}, present)
    laminate = material.law == "laminate"
    if laminate and "thickness" in present:
        yield (*where, "thickness"), 'must be left out with law = "laminate": it is that of all plies'
    if not laminate and "thickness" not in present:
        yield (*where, "thickness"), 'is missing; needed: a length with its unit, such as "52 angstrom"'
    if laminate and material.layup is not None:
        try:
            read_layup(material.layup)
        except ValueError as error:
            yield (*where, "layup"), str(error)


def _table(where: tuple[str | int, ...], times: Any, name: str, values: Any) -> Iterator[Problem]:
    """Check a table over time that begins with the run."""
    if times is not None:
        if times[0] != 0.0:
            yield (*where, "times", 0), "must be 0: the tables begin with the run"
        for later in range(1, len(times)):
            if times[later] <= times[later - 1]:
                yield (*where, "times", later), "must be later than the time before it"
    if known(times, values) and len(times) != len(values):
        yield (*where, name), f"has {len(values)} values, must have {len(times)} as times has"


def _edges(continuum: Any, tables: set[str]) -> Iterator[Problem]:
    seen: dict[tuple[str, int], int] = {}
    every = {name for names in EDGE_KINDS.values() for name in names}
    for index, edge in enumerate(continuum.edges or []):
        where = ("continuum", "edges", index)
        if edge.kind is None:
            continue
        needed = EDGE_KINDS[edge.kind]
        yield from _named(where, "kind", edge.kind, needed, every - set(needed), _keys(where, tables))
        if edge.moves and edge.edge is not None and ("component" not in needed or edge.component is not None):
            first = seen.setdefault((edge.edge, edge.axis), index)
            if first != index:
                yield where, f"{edge.edge} {'xy'[edge.axis]} is prescribed already by continuum.edges.{first}"
        loaded = continuum.preload is not None or continuum.initial_field is not None
        if edge.displacements is not None and edge.displacements[0] != 0.0 and not loaded:
            yield (*where, "displacements", 0), "must be 0 without continuum.preload: the body starts undeformed"
        if "times" in needed:
            yield from _table(where, edge.times, needed[-1], getattr(edge, needed[-1]))


def _follow_edges(continuum: Any) -> Iterator[Problem]:
    """Check that a gradient times position gives the first velocity of every edge."""
    where = ("continuum", "initial_velocity")
    edges = continuum.edges
    if not edges or not any(edge.moves for edge in edges if edge.kind is not None):
        yield where, "follow_edges needs continuum.edges to follow"
        return
    edges = [edge for edge in edges if edge.kind is None or edge.moves]
    if not known(continuum.lower, continuum.upper) or not all(map(_has_first_velocity, edges)):
        return
    for axis, letter in enumerate("xy"):
        rates: dict[int, list[tuple[str, float]]] = {0: [], 1: []}
        for edge in (edge for edge in edges if edge.axis == axis):
            corner: Point = (continuum.lower, continuum.upper)[edge.edge in ("right", "top")]
            place = corner[edge.normal_axis]
            if place == 0.0:
                if edge.first_velocity != 0.0:
                    yield where, f"follow_edges cannot move the {edge.edge} edge: it lies on the origin's line"
                continue
            rates[edge.normal_axis].append((edge.edge, edge.first_velocity / place))
        for pair in rates.values():
            if len(pair) == 2 and abs(pair[0][1] - pair[1][1]) > _SAME_VELOCITY * max(abs(r) for _, r in pair):
                yield (
                    where,
                    (
                        f"follow_edges needs one {letter} velocity gradient, but {pair[0][0]} gives {pair[0][1]:.6g}"
                        f" 1/s and {pair[1][0]} {pair[1][1]:.6g} 1/s"
                    ),
                )
        for normal, other in ((0, 1), (1, 0)):
            moving = [name for name, rate in rates[normal] if rate != 0.0]
            if moving and rates[other]:
                yield (
                    where,
                    (
                        f"follow_edges: the {letter} velocity of {moving[0]} varies along {rates[other][0][0]},"
                        f" which prescribes one value of {letter}"
                    ),
                )


def _has_first_velocity(edge: Any) -> bool:
    """Return whether an edge that may be a draft tells its velocity at the start."""
    if not known(edge.kind, edge.edge):
        return False
    if edge.kind == "symmetry":
        return True
    if edge.kind == "velocity":
        return known(edge.component, edge.velocities)
    return (
        known(edge.component, edge.times, edge.displacements)
        and len(edge.times) == len(edge.displacements)
        and bool(edge.times[1] > edge.times[0])
    )


def _holes(continuum: Any) -> Iterator[Problem]:
    """Each hole reaches into the body and does not meet another."""
    lower, upper = continuum.lower, continuum.upper
    found: list[tuple[Point, float]] = []
    for index, hole in enumerate(continuum.holes or []):
        where = ("continuum", "holes", index)
        if not known(lower, upper, hole.centre, hole.diameter):
            continue
        radius = 0.5 * hole.diameter
        beyond = [max(lower[k] - hole.centre[k], hole.centre[k] - upper[k], 0.0) for k in (0, 1)]
        if math.hypot(*beyond) >= radius:
            yield (*where, "centre"), "lies so far outside the body that the hole does not reach it"
        for other, (centre, size) in enumerate(found):
            if math.dist(centre, hole.centre) < radius + size:
                yield where, f"meets continuum.holes.{other}; holes must share no area"
        found.append((hole.centre, radius))


def _refinement(continuum: Any) -> Iterator[Problem]:
    """Each level lies on cell lines of the one before, inside it with room between the borders."""
    if not continuum.refinement or not known(continuum.lower, continuum.upper, continuum.cell_size):
        return
    outer, cell, margin, what = (continuum.lower, continuum.upper), continuum.cell_size, 0, "the body"
    for level, inner in enumerate(continuum.refinement):
        if not known(inner.lower, inner.upper):
            return
        for axis in (0, 1):
            low, high = outer[0][axis] + margin * cell, outer[1][axis] - margin * cell
            for name, value in (("lower", inner.lower[axis]), ("upper", inner.upper[axis])):
                line = outer[0][axis] + round((value - outer[0][axis]) / cell) * cell
                nearest = min(max(line, low), high)
                if abs(value - nearest) > CELL_TOLERANCE * cell:
                    yield (
                        ("continuum", "refinement", level, name, axis),
                        (
                            f"must lie on a cell line of {what} (every {length(cell)}), from {length(low)} to"
                            f" {length(high)}; nearest: {length(nearest)}"
                        ),
                    )
            if inner.upper[axis] - inner.lower[axis] < 2 * cell * (1 - CELL_TOLERANCE):
                yield (
                    ("continuum", "refinement", level, "upper", axis),
                    f"must be at least two cells of {length(cell)} above lower, {length(inner.lower[axis])}",
                )
        outer, cell, margin = (inner.lower, inner.upper), cell / 2, LEVEL_MARGIN
        what = f"continuum.refinement.{level}"


def _cracks(continuum: Any) -> Iterator[Problem]:
    for index, crack in enumerate(continuum.cracks or []):
        if known(crack.contact, crack.friction) and crack.friction > 0 and crack.contact != "coulomb":
            yield ("continuum", "cracks", index, "friction"), 'must be left out unless contact = "coulomb"'
        if crack.points is not None and any(a == b for a, b in zip(crack.points, crack.points[1:], strict=False)):
            yield ("continuum", "cracks", index, "points"), "has two equal corners in a row"
