"""What a scene would start, on how many points, with which steps, and what it would cost: the command `check`."""

from __future__ import annotations

import math

from pydantic import TypeAdapter

from coordinator.continuum_request import elastic_constants
from coordinator.continuum_tables import CrackLine
from coordinator.critical_length import of_scene
from coordinator.scene import Corners, Handshake, Scene
from coordinator.units import LENGTHS, TIMES, readable
from coordinator.wave_speed import wave_speed
from protocol import continuum as c
from protocol.backend import Backend, find

#: Area of an atom of a known material, m2; for estimates before anything is built.
AREA_PER_ATOM = {"graphene": 2.6e-20, "hexagonal": 1.1e-19}
_ANGSTROM = 1e-10


def describe(scene: Scene) -> str:
    """Return the answer of `check` for a valid scene.

    Raises
    ------
    BackendError
        Where a backend that the scene names is not installed.
    """
    lines = [f"{scene.title}", ""]
    points = continuum_points(scene)
    step = scene.time_step
    total = 0.0
    continuum = find("continuum", scene.continuum.backend)
    seconds = points * scene.run.steps * _rate(continuum, "")
    total += seconds
    lines += _continuum(scene, continuum.name)
    lines.append(f"             {points} material points, step {_time(step)}, about {_duration(seconds)}")
    if scene.micromechanics is not None:
        backend = find("micromechanics", scene.micromechanics.backend)
        lines.append(
            f"micromechanics  {backend.name}: {scene.micromechanics.cell} in every ply of every point, at each step"
            " where it may fail; its time is not in the estimate"
        )
    if scene.atomistic is None or scene.handshake is None:
        lines.append("atomistic    not started: the scene has no [atomistic]")
    else:
        lines += _atoms(scene)
        total += _atomistic_seconds(scene)
    preload = scene.continuum.preload
    if preload is not None:
        lines.append(
            f"preload      {preload.method}, to a residual of {preload.tolerance:g}; its time is not in the estimate"
        )
    crack = scene.crack
    if crack is not None:
        start = "the left edge" if crack.start_x is None else f"x = {_length(crack.start_x)}"
        grows = "" if crack.growth is None else f", grows at {crack.growth.critical_energy_release_rate:g} J/m2"
        lines.append(f"crack        from {start} to x = {_length(crack.tip_x)}{grows}{_critical(scene)}")
    lines += [_crack(line) for line in scene.continuum.cracks]
    lines += [
        f"run          at most {scene.run.steps} coupling steps, {_time(scene.run.steps * step)}",
        f"estimate     {_duration(total)} on one idle core; another machine or a busy one differs",
    ]
    return "\n".join(lines)


def _critical(scene: Scene) -> str:
    """Return what Eq 1 says of the crack, where material and toughness are known before the run."""
    given = scene.continuum.material
    if given is None or given.law in ("orthotropic", "laminate"):
        return ""
    material: c.Material = TypeAdapter(c.Material).validate_python(given.constants())
    elastic = elastic_constants(material)
    found = None if elastic is None else of_scene(scene, elastic)
    return "" if found is None else f"; critical length {_length(found.length)} (Eq 1)"


def _continuum(scene: Scene, backend: str) -> list[str]:
    body = scene.continuum
    size = [body.upper[k] - body.lower[k] for k in (0, 1)]
    scheme, cells = body.scheme, levels(scene)
    order = f"({scheme.order})" if scheme.transfer in ("xpic", "fmpm") else ""
    every = f" every {scheme.period} steps, FLIP between" if scheme.period > 1 and scheme.transfer != "flip" else ""
    lines = [
        f"continuum    {backend}: {body.assumption.replace('_', ' ')}, {_length(size[0])} x {_length(size[1])}, "
        f"cells of {_length(body.cell_size)}",
        f"             {scheme.interpolation}, {scheme.integration.upper()}, {scheme.transfer.upper()}{order}{every}; "
        + _courant(scene),
    ]
    if len(cells) > 1:
        lines += [
            f"             level {k}: {count} cells of {_length(edge)}, {count * body.points_per_cell**2} points"
            for k, (edge, count) in enumerate(cells)
        ]
    return lines


def _courant(scene: Scene) -> str:
    given = scene.continuum.material
    if given is None:
        return "Courant number known once the material is measured"
    if given.law == "laminate":
        return "Courant number known once the cell has answered"
    material: c.Material = TypeAdapter(c.Material).validate_python(given.constants())
    number = wave_speed(material, scene.continuum.assumption) * scene.time_step / levels(scene)[-1][0]
    return f"Courant number {number:.3g}"


def _crack(crack: CrackLine) -> str:
    place = " to ".join(f"({_length(x)}, {_length(y)})" for x, y in crack.points)
    grows = "does not grow"
    if crack.growth is not None:
        grows = f"grows at {crack.growth.critical_energy_release_rate:g} J/m2 ({crack.growth.rule})"
    return f"crack        {place}, {crack.contact}, {grows}"


def levels(scene: Scene) -> list[tuple[float, int]]:
    """Return edge of a cell, m, and number of cells that hold material, of each level of the grid."""
    body, overlap = scene.continuum, scene.overlap()
    boxes = [(body.lower, body.upper), *((level.lower, level.upper) for level in body.refinement)]
    found = []
    for level, box in enumerate(boxes):
        edge = body.cell_size / 2**level
        area = _area(box) - (_area(boxes[level + 1]) if level + 1 < len(boxes) else 0.0)
        if overlap is not None:
            # What the atoms alone have, of this level and not of the next one.
            area -= _shared(box, overlap[0])
            area += _shared(boxes[level + 1], overlap[0]) if level + 1 < len(boxes) else 0.0
        found.append((edge, round(area / edge**2)))
    return found


def _area(box: Corners) -> float:
    return (box[1][0] - box[0][0]) * (box[1][1] - box[0][1])


def _shared(one: Corners, other: Corners) -> float:
    sides = [min(one[1][k], other[1][k]) - max(one[0][k], other[0][k]) for k in (0, 1)]
    return max(sides[0], 0.0) * max(sides[1], 0.0)


def continuum_points(scene: Scene) -> int:
    """Return the number of material points."""
    return sum(count for _, count in levels(scene)) * scene.continuum.points_per_cell**2


def _length(value: float) -> str:
    return readable(value, LENGTHS)


def _time(value: float) -> str:
    return readable(value, TIMES)


def _atoms(scene: Scene) -> list[str]:
    atomistic, handshake, overlap = scene.atomistic, scene.handshake, scene.overlap()
    assert atomistic is not None and handshake is not None and overlap is not None
    backend = find("atomistic", atomistic.backend)
    area = atomistic.width * atomistic.height
    (low_x, low_y), (high_x, high_y) = overlap[0]
    count = _atoms_per_layer(scene)
    anchored = count * max(0.0, 1 - (high_x - low_x) * (high_y - low_y) / area)
    count *= atomistic.layers
    anchored *= atomistic.layers
    amount = "" if math.isnan(count) else f"about {count:.0f} atoms, {anchored:.0f} of them anchored, "
    what = atomistic.material if atomistic.sample is None else atomistic.sample
    lines = [
        f"atomistic    {backend.name}: {what} by {atomistic.force_field}, "
        f"{atomistic.width / _ANGSTROM:g} x {atomistic.height / _ANGSTROM:g} angstrom, {atomistic.temperature:g} K, "
        f"{atomistic.ranks} rank(s)" + _places(scene),
        f"             {amount}step {atomistic.time_step * 1e15:g} fs, about {_duration(_atomistic_seconds(scene))}",
        f"handshake    {handshake.width / _ANGSTROM:g} angstrom wide, M {_exchange_length(handshake)}, cells of "
        f"{handshake.ivc_size / _ANGSTROM:g} angstrom, weight and stiffness "
        + ("by theory" if handshake.weight is None and handshake.stiffness is None else "by the scene"),
    ]
    if atomistic.j is not None:
        sizes = ", ".join(_length(size) for size in atomistic.j.half_sizes)
        lines.append(f"J            every {atomistic.j.interval} steps on contours of half size {sizes}")
    if atomistic.fields is not None:
        grid = atomistic.fields.spacing
        on = [*atomistic.fields.atoms, *([f"a grid of {_length(grid)}"] if grid is not None else [])]
        lines.append(f"fields       every {atomistic.fields.interval} steps: {', '.join(on)}")
    return lines


def _places(scene: Scene) -> str:
    if not scene.regions:
        return ""
    return ", each of " + ", ".join(
        f"{place.name} at ({_length(place.centre[0])}, {_length(place.centre[1])})" for place in scene.regions
    )


def _exchange_length(handshake: Handshake) -> str:
    if handshake.steps_per_exchange is not None:
        return f"= {handshake.steps_per_exchange}"
    return f"<= {handshake.most_steps_per_exchange}, for errors of at most {handshake.force_error:.3g} N"


def _atoms_per_layer(scene: Scene) -> float:
    """Return about how many atoms the sample has, NaN where that is not known before it is built."""
    atomistic = scene.atomistic
    assert atomistic is not None
    if atomistic.sample is not None:
        return math.nan
    return atomistic.width * atomistic.height / AREA_PER_ATOM.get(atomistic.material, math.nan)


def _atomistic_seconds(scene: Scene) -> float:
    atomistic, handshake = scene.atomistic, scene.handshake
    assert atomistic is not None and handshake is not None
    atoms = _atoms_per_layer(scene) * atomistic.layers
    steps = scene.run.steps * (handshake.steps_per_exchange or handshake.most_steps_per_exchange)
    steps += round((atomistic.equilibration + atomistic.reference + atomistic.hold) / atomistic.time_step)
    rate = _rate(find("atomistic", atomistic.backend), atomistic.force_field)
    return len(scene.places) * atoms * steps * rate / atomistic.ranks


def _rate(backend: Backend, name: str) -> float:
    return backend.seconds_per_unit_step.get(name, math.nan)


def _duration(seconds: float) -> str:
    if math.isnan(seconds):
        return "an unknown time (the backend states no cost for this)"
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"
