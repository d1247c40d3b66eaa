"""Checks of a scene that involve more than one field.

The checks run on drafts too: a draft has None where a value could not be read or is absent, and a
check that needs such a value is left out, so that one mistake does not hide another.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from coordinator.scene_tables import CELL_TOLERANCE, Point, snapped_overlap

#: Path of the field, and what is allowed there.
Problem = tuple[tuple[str | int, ...], str]

_ANGSTROM = 1e-10
#: Relative difference below which two edge velocities are the same.
_SAME_VELOCITY = 1e-9


def cross_checks(scene: Any, tables: set[str]) -> list[Problem]:
    """Return the problems between fields.

    Parameters
    ----------
    scene : Scene or draft
        Values in SI; None where absent or unreadable.
    tables : set of str
        Tables that the file holds, readable or not.
    """
    found = list(_which_tables(scene, tables))
    if scene.continuum is not None:
        found += _body(scene.continuum)
        found += _edges(scene.continuum)
        if scene.continuum.initial_velocity == "follow_edges":
            found += _follow_edges(scene.continuum)
    if scene.atomistic is not None and scene.handshake is not None:
        found += _handshake(scene)
    if scene.crack is not None:
        found += _crack(scene)
    return found


def _known(*values: Any) -> bool:
    return all(value is not None for value in values)


def _angstrom(value: float) -> str:
    return f"{value / _ANGSTROM:.6g} angstrom"


def _which_tables(scene: Any, tables: set[str]) -> Iterator[Problem]:
    coupled = "atomistic" in tables
    if coupled and "handshake" not in tables:
        yield ("handshake",), "is missing; a scene with [atomistic] needs this table"
    if not coupled and "handshake" in tables:
        yield ("handshake",), "must be left out in a scene without [atomistic]"
    if scene.continuum is not None:
        step = scene.continuum.time_step
        if coupled and step is not None:
            allowed = "must be left out: with [atomistic] it is handshake.steps_per_exchange * atomistic.time_step"
            yield ("continuum", "time_step"), allowed
        if not coupled and "continuum.time_step" not in tables:
            yield ("continuum", "time_step"), "is missing; a scene without [atomistic] needs it"
        if not coupled and "continuum.material" not in tables:
            yield ("continuum", "material"), "is missing; a scene without [atomistic] needs this table"
    run = scene.run
    if run is not None and run.stop_after_crack_growth is not None and not {"atomistic", "crack"} <= tables:
        yield ("run", "stop_after_crack_growth"), "must be left out unless there are [atomistic] and [crack]"


def _whole(cells: float) -> bool:
    return round(cells) >= 1 and abs(cells - round(cells)) <= CELL_TOLERANCE * max(1.0, abs(cells))


def _body(continuum: Any) -> Iterator[Problem]:
    lower, upper, cell = continuum.lower, continuum.upper, continuum.cell_size
    if not _known(lower, upper):
        return
    for axis, letter in enumerate("xy"):
        extent = upper[axis] - lower[axis]
        where = ("continuum", "upper", axis)
        if extent <= 0.0:
            yield where, f"must be greater than continuum.lower in {letter}, {_angstrom(lower[axis])}"
        elif _known(cell) and not _whole(extent / cell):
            nearest = max(1, round(extent / cell))
            yield (
                where,
                (
                    f"the body is {extent / cell:.6g} cells of {_angstrom(cell)} along {letter}, must be a whole"
                    f" number; nearest: {_angstrom(lower[axis] + nearest * cell)}"
                ),
            )


def _edges(continuum: Any) -> Iterator[Problem]:
    seen: dict[tuple[str, str], int] = {}
    for index, edge in enumerate(continuum.edges or []):
        where = ("continuum", "edges", index)
        if _known(edge.edge, edge.component):
            first = seen.setdefault((edge.edge, edge.component), index)
            if first != index:
                yield where, f"{edge.edge} {edge.component} is prescribed already by continuum.edges.{first}"
        times, displacements = edge.times, edge.displacements
        if times is not None:
            if times[0] != 0.0:
                yield (*where, "times", 0), "must be 0: the tables begin with the run"
            for later in range(1, len(times)):
                if times[later] <= times[later - 1]:
                    yield (*where, "times", later), "must be later than the time before it"
        if displacements is not None and displacements[0] != 0.0:
            yield (*where, "displacements", 0), "must be 0: the body starts undeformed"
        if _known(times, displacements) and len(times) != len(displacements):
            yield (*where, "displacements"), f"has {len(displacements)} values, must have {len(times)} as times has"


def _follow_edges(continuum: Any) -> Iterator[Problem]:
    """Check that a gradient times position gives the first velocity of every edge."""
    where = ("continuum", "initial_velocity")
    edges = continuum.edges
    if not edges:
        yield where, "follow_edges needs continuum.edges to follow"
        return
    if not _known(continuum.lower, continuum.upper) or not all(
        _known(edge.edge, edge.component, edge.times, edge.displacements)
        and len(edge.times) == len(edge.displacements)
        and edge.times[1] > edge.times[0]
        for edge in edges
    ):
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


def _handshake(scene: Any) -> Iterator[Problem]:
    atoms, handshake, continuum = scene.atomistic, scene.handshake, scene.continuum
    width = handshake.width
    step, reference = atoms.time_step, atoms.reference
    if _known(step, reference, handshake.steps_per_exchange) and reference < step * handshake.steps_per_exchange:
        yield (
            ("atomistic", "reference"),
            (
                "must hold at least one exchange, handshake.steps_per_exchange * atomistic.time_step"
                f" = {step * handshake.steps_per_exchange / 1e-15:.6g} fs"
            ),
        )
    if _known(width, handshake.ivc_size) and handshake.ivc_size > width * (1 + CELL_TOLERANCE):
        yield ("handshake", "ivc_size"), f"must not be larger than handshake.width, {_angstrom(width)}"
    if continuum is None or not _known(continuum.cell_size):
        return
    cell = continuum.cell_size
    if _known(handshake.ivc_size) and handshake.ivc_size < cell * (1 - CELL_TOLERANCE):
        yield ("handshake", "ivc_size"), f"must not be smaller than continuum.cell_size, {_angstrom(cell)}"
    if not _known(width):
        return
    if not _whole(width / cell):
        nearest = max(1, round(width / cell)) * cell
        yield (
            ("handshake", "width"),
            (
                f"is {width / cell:.6g} cells of {_angstrom(cell)}, must be a whole number;"
                f" nearest: {_angstrom(nearest)}"
            ),
        )
        return
    if not _known(continuum.lower, atoms.width, atoms.height):
        return
    inner, outer = snapped_overlap(continuum.lower, cell, atoms.width, atoms.height, width)
    for axis, name in ((0, "width"), (1, "height")):
        if inner[1][axis] - inner[0][axis] < cell * (1 - CELL_TOLERANCE):
            yield (
                ("handshake", "width"),
                (
                    f"must be narrower than half the sheet: nothing is left inside it along atomistic.{name},"
                    f" {_angstrom(getattr(atoms, name))}"
                ),
            )
        if continuum.upper is None:
            continue
        room = cell * (1 - CELL_TOLERANCE)
        if outer[0][axis] - continuum.lower[axis] < room or continuum.upper[axis] - outer[1][axis] < room:
            yield (
                ("atomistic", name),
                (
                    f"the sheet takes {_angstrom(outer[0][axis])} to {_angstrom(outer[1][axis])} on the grid, must lie"
                    f" at least one cell inside the body, {_angstrom(continuum.lower[axis])} to"
                    f" {_angstrom(continuum.upper[axis])}"
                ),
            )


def _crack(scene: Any) -> Iterator[Problem]:
    """The crack lies in the body; with atoms, its tip is where there are atoms only."""
    continuum, atoms, handshake, crack = scene.continuum, scene.atomistic, scene.handshake, scene.crack
    if continuum is None or not _known(continuum.lower, continuum.upper):
        return
    corners, region = (continuum.lower, continuum.upper), "the body"
    if (
        atoms is not None
        and handshake is not None
        and _known(continuum.cell_size, atoms.width, atoms.height, handshake.width)
    ):
        corners, _ = snapped_overlap(continuum.lower, continuum.cell_size, atoms.width, atoms.height, handshake.width)
        region = "the sheet inside its handshake"
    for axis, (name, value) in enumerate((("tip_x", crack.tip_x), ("y", crack.y))):
        low, high = corners[0][axis], corners[1][axis]
        if low < high and value is not None and not low < value < high:
            yield ("crack", name), f"must lie inside {region}, {_angstrom(low)} to {_angstrom(high)}"
