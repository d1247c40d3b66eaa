"""Checks of a scene that involve more than one field.

The checks run on drafts too: a draft has None where a value could not be read or is absent, and a
check that needs such a value is left out, so that one mistake does not hide another.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from coordinator.continuum_checks import CELL_TOLERANCE, Problem, continuum_checks, known, length, whole
from coordinator.grid_lines import snapped_overlap
from coordinator.scene_tables import Place
from coordinator.table import Corners


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
        law = None if material is None else material.law
        if coupled and law in ("orthotropic", "laminate"):
            yield (
                ("continuum", "material", "law"),
                "must have one Young's modulus with [atomistic]: the theory of the handshake needs it",
            )
        if law == "laminate" and "micromechanics" not in tables:
            yield ("micromechanics",), 'is missing; a material with law = "laminate" needs this table'
        if law == "laminate" and scene.continuum.assumption == "plane_strain":
            yield ("continuum", "assumption"), 'must be plane_stress with law = "laminate"'
        if law != "laminate" and "micromechanics" in tables:
            yield ("micromechanics",), 'must be left out unless continuum.material has law = "laminate"'
    run = scene.run
    if not coupled and scene.regions:
        yield ("regions",), "must be left out in a scene without [atomistic]"
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
    places = scene.regions or []
    if fields is not None and (len(places) > 1 or any(place.mirrored for place in places)):
        yield ("atomistic", "fields"), "must be left out with several regions, or a mirrored one"
    names = [place.name for place in places]
    for index, name in enumerate(names):
        if name in ("continuum", *names[:index]):
            yield ("regions", index, "name"), "is taken: each region has a name of its own, and none is continuum"
    loaded = scene.continuum is not None and (scene.continuum.preload or scene.continuum.initial_field)
    if atoms.hold and not loaded:
        yield ("atomistic", "hold"), "must be left out without continuum.preload or continuum.initial_field"
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
    if handshake.steps_per_exchange is None and handshake.force_error is None:
        yield ("handshake", "steps_per_exchange"), "is missing; needed: it, or force_error"
    if known(handshake.steps_per_exchange, handshake.force_error):
        yield ("handshake", "force_error"), "must be left out with steps_per_exchange, which it chooses"
    if (handshake.corners is None) == (handshake.shape == "polygon"):
        problem = "is missing; a polygon needs it" if handshake.corners is None else "must be left out unless a polygon"
        yield ("handshake", "corners"), problem
    if handshake.shape not in ("rectangle", None) and len(handshake.sides or []) < 4:
        yield ("handshake", "sides"), "must be left out unless the shape is a rectangle"
    if handshake.scheme == "parallel" and handshake.motion == "linear":
        yield ("handshake", "motion"), 'must be "held" with scheme = "parallel"'
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
    # Atoms lie in the finest level.
    cell = continuum.cell_size / 2 ** len(continuum.refinement or [])
    if known(handshake.ivc_size) and handshake.ivc_size < cell * (1 - CELL_TOLERANCE):
        yield ("handshake", "ivc_size"), f"must not be smaller than a cell of the continuum, {length(cell)}"
    if not known(width):
        return
    if handshake.shape == "rectangle" and not whole(width / cell):
        nearest = max(1, round(width / cell)) * cell
        yield (
            ("handshake", "width"),
            (f"is {width / cell:.6g} cells of {length(cell)}, must be a whole number; nearest: {length(nearest)}"),
        )
        return
    if not known(continuum.lower, atoms.width, atoms.height):
        return
    for place, inner, outer in _rings(scene):
        yield from _room(scene, place, inner, outer, cell)


def _rings(scene: Any) -> Iterator[tuple[Any, Corners, Corners]]:
    """Yield each region with the rectangles around the borders of its ring, in the scene's frame."""
    continuum, atoms, handshake = scene.continuum, scene.atomistic, scene.handshake
    if not known(continuum.lower, continuum.cell_size, atoms.width, atoms.height, handshake.width):
        return
    for place in scene.regions or [Place(name="atomistic")]:
        if place.centre is None:
            continue
        cell = continuum.cell_size / 2 ** len(continuum.refinement or [])
        (x, y), sign = place.centre, -1.0 if place.mirrored else 1.0
        line = (sign * (continuum.lower[0] - x), continuum.lower[1] - y)
        pair = snapped_overlap(line, cell, atoms.width, atoms.height, handshake.width)
        inner, outer = (_placed(corners, x, y, sign) for corners in pair)
        yield place, inner, outer


def _placed(corners: Corners, x: float, y: float, sign: float) -> Corners:
    """Return a sample's rectangle in the scene's frame."""
    (left, bottom), (right, top) = corners
    ends = sorted((x + sign * left, x + sign * right))
    return (ends[0], y + bottom), (ends[1], y + top)


def _room(scene: Any, place: Any, inner: Corners, outer: Corners, cell: float) -> Iterator[Problem]:
    """Something is left inside the ring, and there is continuum around it, of the finest level."""
    atoms, continuum = scene.atomistic, scene.continuum
    sides = scene.handshake.sides or []
    body, region = (continuum.lower, continuum.upper), "the body"
    if continuum.refinement:
        finest = continuum.refinement[-1]
        body, region = (finest.lower, finest.upper), "the finest level"
    for axis, name in ((0, "width"), (1, "height")):
        low, high = (("left", "right"), ("bottom", "top"))[axis]
        if low in sides and high in sides and inner[1][axis] - inner[0][axis] < cell * (1 - CELL_TOLERANCE):
            yield (
                ("handshake", "width"),
                (
                    f"must be narrower than half the sheet: nothing is left inside it along atomistic.{name},"
                    f" {length(getattr(atoms, name))}"
                ),
            )
        if not known(*body):
            continue
        room = cell * (1 - CELL_TOLERANCE)
        below = low in sides and outer[0][axis] - body[0][axis] < room
        above = high in sides and body[1][axis] - outer[1][axis] < room
        if below or above:
            where = ("atomistic", name) if not scene.regions else ("regions", scene.regions.index(place), "centre")
            yield (
                where,
                (
                    f"the sheet takes {length(outer[0][axis])} to {length(outer[1][axis])} on the grid, must lie"
                    f" at least one cell inside {region}, {length(body[0][axis])} to {length(body[1][axis])}"
                ),
            )


def _crack(scene: Any) -> Iterator[Problem]:
    """The crack lies in the body; with atoms, its tips are where there are atoms only, or may come to them."""
    continuum, atoms, handshake, crack = scene.continuum, scene.atomistic, scene.handshake, scene.crack
    if continuum is None or not known(continuum.lower, continuum.upper):
        return
    tips = [("tip_x", crack.tip_x), ("start_x", crack.start_x)]
    if known(crack.tip_x, crack.start_x) and crack.start_x >= crack.tip_x:
        yield ("crack", "start_x"), f"must be left of crack.tip_x, {length(crack.tip_x)}"
    for axis, name, value in ((0, *tips[0]), (0, *tips[1]), (1, "y", crack.y)):
        low, high = continuum.lower[axis], continuum.upper[axis]
        if low < high and value is not None and not low < value < high:
            yield ("crack", name), f"must lie inside the body, {length(low)} to {length(high)}"
            return
    if atoms is None:
        for name in ("critical_stress",):
            if getattr(crack, name) is not None:
                yield ("crack", name), "must be left out without [atomistic]"
        return
    if handshake is None or continuum.cell_size is None:
        return
    for place, inner, outer in _rings(scene):
        name, tip = tips[1] if place.mirrored else tips[0]
        if not known(tip, crack.y):
            continue
        yield from _tip(scene, name, tip, inner, outer, bool(place.mirrored))


def _tip(scene: Any, name: str, tip: float, inner: Corners, outer: Corners, mirrored: bool) -> Iterator[Problem]:
    """A tip lies inside a ring, or may grow towards it from outside."""
    crack, atoms = scene.crack, scene.atomistic
    sheet = f"{length(inner[0][0])} to {length(inner[1][0])}"
    if not inner[0][1] < crack.y < inner[1][1]:
        yield (
            ("crack", "y"),
            (f"must lie inside the sheet inside its handshake, {length(inner[0][1])} to {length(inner[1][1])}"),
        )
        return
    inside = inner[0][0] < tip < inner[1][0]
    before = tip > outer[1][0] if mirrored else tip < outer[0][0]
    if not inside and crack.growth is None:
        yield ("crack", name), f"must lie inside the sheet inside its handshake, {sheet}"
    elif not inside and not before:
        yield ("crack", name), f"must lie inside the sheet inside its handshake, {sheet}, or in front of it"
    elif inside and crack.growth is not None and crack.critical_stress is None:
        yield (
            ("crack", "critical_stress"),
            ("is missing; a crack that begins among the atoms has saved none for the continuum behind them"),
        )
    if inside and atoms.j is not None:
        room = min(inner[1][0] - tip, tip - inner[0][0], inner[1][1] - crack.y, crack.y - inner[0][1])
        for index, size in enumerate(atoms.j.half_sizes or []):
            if room > 0 and size > room * (1 + CELL_TOLERANCE):
                yield (
                    ("atomistic", "j", "half_sizes", index),
                    f"must keep clear of the handshake, whose springs act on the atoms: at most {length(room)}",
                )
