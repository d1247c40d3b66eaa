"""What a scene would start, on how many points, with which steps, and what it would cost: the command `check`."""

from __future__ import annotations

import math

from coordinator.scene import Scene
from protocol.backend import Backend, find

#: Area of an atom of a known material, m2; for estimates before anything is built.
AREA_PER_ATOM = {"graphene": 2.6e-20}
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
    size = [scene.continuum.upper[k] - scene.continuum.lower[k] for k in (0, 1)]
    lines += [
        f"continuum    {continuum.name}: {scene.continuum.assumption.replace('_', ' ')}, "
        f"{size[0] / _ANGSTROM:g} x {size[1] / _ANGSTROM:g} angstrom, cells of "
        f"{scene.continuum.cell_size / _ANGSTROM:g} angstrom",
        f"             {points} material points, step {step * 1e15:g} fs, about {_duration(seconds)}",
    ]
    if scene.atomistic is None or scene.handshake is None:
        lines.append("atomistic    not started: the scene has no [atomistic]")
    else:
        lines += _atoms(scene)
        total += _atomistic_seconds(scene)
    crack = scene.crack
    if crack is not None:
        lines.append(f"crack        from the left edge to x = {crack.tip_x / _ANGSTROM:g} angstrom")
    lines += [
        f"run          at most {scene.run.steps} coupling steps, {scene.run.steps * step * 1e12:g} ps",
        f"estimate     {_duration(total)} on one idle core; another machine or a busy one differs",
    ]
    return "\n".join(lines)


def continuum_points(scene: Scene) -> int:
    """Return the number of material points."""
    body = scene.continuum
    area = (body.upper[0] - body.lower[0]) * (body.upper[1] - body.lower[1])
    overlap = scene.overlap()
    if overlap is not None:
        (low_x, low_y), (high_x, high_y) = overlap[0]
        area -= (high_x - low_x) * (high_y - low_y)
    return round(area / body.cell_size**2) * body.points_per_cell**2


def _atoms(scene: Scene) -> list[str]:
    atomistic, handshake, overlap = scene.atomistic, scene.handshake, scene.overlap()
    assert atomistic is not None and handshake is not None and overlap is not None
    backend = find("atomistic", atomistic.backend)
    area = atomistic.width * atomistic.height
    (low_x, low_y), (high_x, high_y) = overlap[0]
    count = area / AREA_PER_ATOM.get(atomistic.material, math.nan)
    anchored = count * max(0.0, 1 - (high_x - low_x) * (high_y - low_y) / area)
    amount = "" if math.isnan(count) else f"about {count:.0f} atoms, {anchored:.0f} of them anchored, "
    return [
        f"atomistic    {backend.name}: {atomistic.material} by {atomistic.force_field}, "
        f"{atomistic.width / _ANGSTROM:g} x {atomistic.height / _ANGSTROM:g} angstrom, {atomistic.temperature:g} K, "
        f"{atomistic.ranks} rank(s)",
        f"             {amount}step {atomistic.time_step * 1e15:g} fs, about {_duration(_atomistic_seconds(scene))}",
        f"handshake    {handshake.width / _ANGSTROM:g} angstrom wide, M = {handshake.steps_per_exchange}, cells of "
        f"{handshake.ivc_size / _ANGSTROM:g} angstrom, weight and stiffness "
        + ("by theory" if handshake.weight is None and handshake.stiffness is None else "by the scene"),
    ]


def _atomistic_seconds(scene: Scene) -> float:
    atomistic, handshake = scene.atomistic, scene.handshake
    assert atomistic is not None and handshake is not None
    atoms = atomistic.width * atomistic.height / AREA_PER_ATOM.get(atomistic.material, math.nan)
    steps = scene.run.steps * handshake.steps_per_exchange
    steps += round((atomistic.equilibration + atomistic.reference) / atomistic.time_step)
    return atoms * steps * _rate(find("atomistic", atomistic.backend), atomistic.force_field) / atomistic.ranks


def _rate(backend: Backend, name: str) -> float:
    return backend.seconds_per_unit_step.get(name, math.nan)


def _duration(seconds: float) -> str:
    if math.isnan(seconds):
        return "an unknown time (the backend states no cost for this)"
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"
