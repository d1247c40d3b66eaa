"""Checks of a scene that involve more than one field.

The checks run on drafts too: a draft has None where a value could not be read or is absent, and a
check that needs such a value is left out, so that one mistake does not hide another.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from coordinator.continuum_checks import CELL_TOLERANCE, Problem, continuum_checks, known, length, whole
from coordinator.scene_tables import snapped_overlap


def cross_checks(scene: Any, tables: set[str]) -> list[Problem]:
    """Return the problems between fields.

    Parameters
    ----------
    scene : Scene or draft
        Values in SI; None where absent or unreadable.
    tables : set of str
        Paths of everything that the file holds, readable or not.
    """
    found = list(_which_tables(scene, tables))
    if scene.continuum is not None:
        found += continuum_checks(scene.continuum, tables)
    if scene.atomistic is not None:
        found += _atomistic(scene, tables)
    if scene.atomistic is not None and scene.handshake is not None:
        found += _handshake(scene)
        found += _anchors(scene)
    if scene.crack is not None:
        found += _crack(scene)
    return found


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
        material = scene.continuum.material
        if coupled and material is not None and material.law == "orthotropic":
            yield (
                ("continuum", "material", "law"),
                "must have one Young's modulus with [atomistic]: the theory of the handshake needs it",
            )
    run = scene.run
    if run is not None and run.stop_after_crack_growth is not None and not {"atomistic", "crack"} <= tables:
        cracks = scene.continuum.cracks if scene.continuum is not None else []
        if not any(crack.growth for crack in cracks or []):
            allowed = "must be left out unless there are [atomistic] and [crack], or a crack of the continuum grows"
            yield ("run", "stop_after_crack_growth"), allowed


def _atomistic(scene: Any, tables: set[str]) -> Iterator[Problem]:
    """What of [atomistic] goes with what."""
    atoms = scene.atomistic
    if atoms.sample is not None:
        for name, plain in (("layers", 1), ("orientation", None)):
            if getattr(atoms, name) not in (plain, None):
                yield ("atomistic", name), "must be left out with atomistic.sample, which is built already"
    if atoms.sample is None and "atomistic.sample" not in tables and atoms.periodic_z is not None:
        yield ("atomistic", "periodic_z"), "must be left out without atomistic.sample"
    if (atoms.commands is not None or atoms.sample is not None) and "continuum.material" not in tables:
        which = "atomistic.commands" if atoms.commands is not None else "atomistic.sample"
        yield ("continuum", "material"), f"is missing; with {which} no constants can be measured for it"
    if atoms.commands is not None and atoms.sample is None and "atomistic.sample" not in tables:
        yield ("atomistic", "sample"), "is missing; no sample can be built for a force field of your own"
    fields, j = atoms.fields, atoms.j
    if j is not None and "crack" not in tables:
        yield ("atomistic", "j"), "must be left out without [crack]"
    if fields is not None and not fields.atoms and "atomistic.fields.spacing" not in tables:
        yield ("atomistic", "fields"), "must have spacing, for a grid, or atoms, a list of fields of each atom"
    if fields is not None and fields.radius is not None and fields.spacing is None:
        yield ("atomistic", "fields", "radius"), "must be left out without spacing"
    if fields is not None and j is not None and known(fields.interval, j.interval) and fields.interval % j.interval:
        yield ("atomistic", "fields", "interval"), f"must be a multiple of atomistic.j.interval, {j.interval}"


def _anchors(scene: Any) -> Iterator[Problem]:
    """What of [handshake] goes with what."""
    handshake, atoms = scene.handshake, scene.atomistic
    if handshake.passive_width is not None and handshake.surface_width is not None:
        yield ("handshake", "surface_width"), "must be left out beside passive_width: passive atoms hide the surface"
    for name in ("passive_width", "surface_width"):
        value = getattr(handshake, name)
        if known(value, handshake.width) and value >= handshake.width * (1 - CELL_TOLERANCE):
            yield ("handshake", name), f"must be smaller than handshake.width, {length(handshake.width)}"
    if handshake.until_error is not None and handshake.motion == "linear":
        yield ("handshake", "until_error"), 'must be left out with motion = "linear"'
    if atoms.ensemble is not None and atoms.ensemble.keep and handshake.damping_time is not None:
        yield ("handshake", "damping_time"), "must be left out with atomistic.ensemble.keep: one thermostat at a time"


def _handshake(scene: Any) -> Iterator[Problem]:
    atoms, handshake, continuum = scene.atomistic, scene.handshake, scene.continuum
    width = handshake.width
    step, reference = atoms.time_step, atoms.reference
    if known(step, reference, handshake.steps_per_exchange) and reference < step * handshake.steps_per_exchange:
        yield (
            ("atomistic", "reference"),
            (
                "must hold at least one exchange, handshake.steps_per_exchange * atomistic.time_step"
                f" = {step * handshake.steps_per_exchange / 1e-15:.6g} fs"
            ),
        )
    if known(width, handshake.ivc_size) and handshake.ivc_size > width * (1 + CELL_TOLERANCE):
        yield ("handshake", "ivc_size"), f"must not be larger than handshake.width, {length(width)}"
    if continuum is None or not known(continuum.cell_size):
        return
    cell = continuum.cell_size
    if known(handshake.ivc_size) and handshake.ivc_size < cell * (1 - CELL_TOLERANCE):
        yield ("handshake", "ivc_size"), f"must not be smaller than continuum.cell_size, {length(cell)}"
    if not known(width):
        return
    if not whole(width / cell):
        nearest = max(1, round(width / cell)) * cell
        yield (
            ("handshake", "width"),
            (f"is {width / cell:.6g} cells of {length(cell)}, must be a whole number; nearest: {length(nearest)}"),
        )
        return
    if not known(continuum.lower, atoms.width, atoms.height):
        return
    inner, outer = snapped_overlap(continuum.lower, cell, atoms.width, atoms.height, width)
    for axis, name in ((0, "width"), (1, "height")):
        if inner[1][axis] - inner[0][axis] < cell * (1 - CELL_TOLERANCE):
            yield (
                ("handshake", "width"),
                (
                    f"must be narrower than half the sheet: nothing is left inside it along atomistic.{name},"
                    f" {length(getattr(atoms, name))}"
                ),
            )
        if continuum.upper is None:
            continue
        room = cell * (1 - CELL_TOLERANCE)
        if outer[0][axis] - continuum.lower[axis] < room or continuum.upper[axis] - outer[1][axis] < room:
            yield (
                ("atomistic", name),
                (
                    f"the sheet takes {length(outer[0][axis])} to {length(outer[1][axis])} on the grid, must lie"
                    f" at least one cell inside the body, {length(continuum.lower[axis])} to"
                    f" {length(continuum.upper[axis])}"
                ),
            )


def _crack(scene: Any) -> Iterator[Problem]:
    """The crack lies in the body; with atoms, its tip is where there are atoms only."""
    continuum, atoms, handshake, crack = scene.continuum, scene.atomistic, scene.handshake, scene.crack
    if continuum is None or not known(continuum.lower, continuum.upper):
        return
    corners, region = (continuum.lower, continuum.upper), "the body"
    if (
        atoms is not None
        and handshake is not None
        and known(continuum.cell_size, atoms.width, atoms.height, handshake.width)
    ):
        corners, _ = snapped_overlap(continuum.lower, continuum.cell_size, atoms.width, atoms.height, handshake.width)
        region = "the sheet inside its handshake"
    if atoms is not None and atoms.j is not None and handshake is not None and known(crack.tip_x, crack.y):
        room = min(corners[1][0] - crack.tip_x, crack.tip_x - corners[0][0], corners[1][1] - crack.y,
                   crack.y - corners[0][1])  # fmt: skip
        for index, size in enumerate(atoms.j.half_sizes or []):
            if room > 0 and size > room * (1 + CELL_TOLERANCE):
                yield (
                    ("atomistic", "j", "half_sizes", index),
                    f"must keep clear of the handshake, whose springs act on the atoms: at most {length(room)}",
                )
    for axis, (name, value) in enumerate((("tip_x", crack.tip_x), ("y", crack.y))):
        low, high = corners[0][axis], corners[1][axis]
        if low < high and value is not None and not low < value < high:
            yield ("crack", name), f"must lie inside {region}, {length(low)} to {length(high)}"
