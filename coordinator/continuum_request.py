"""The `configure` request that a scene makes of the continuum service."""

from __future__ import annotations

from typing import Any

from pydantic import TypeAdapter

from coordinator.continuum_tables import CrackLine
from coordinator.interface import Interface
from coordinator.scene import Scene
from coordinator.table import Table
from protocol import continuum as c


def continuum_request(
    scene: Scene, material: c.Material, thickness: float, interface: Interface | None
) -> c.ContinuumConfigure:
    """Return the whole continuum problem of a scene.

    Parameters
    ----------
    scene : Scene
    material : Material
        The scene's, or that measured for the atoms.
    thickness : float
        m.
    interface : Interface or None
        Where it overlaps with atoms; None for a scene without.
    """
    table = scene.continuum
    return c.ContinuumConfigure(
        assumption=table.assumption,
        thickness=thickness,
        body=c.Rectangle(lower=table.lower, upper=table.upper),
        cell_size=table.cell_size,
        refinement=[c.Rectangle(lower=level.lower, upper=level.upper) for level in table.refinement],
        points_per_cell=table.points_per_cell,
        scheme=c.Scheme.model_validate(_plain(table.scheme)),
        material=material,
        overlap=interface.overlap if interface else None,
        cracks=cracks(scene),
        edges=[TypeAdapter(c.AnyEdge).validate_python(edge.given()) for edge in table.edges],
        body_force=c.BodyForce.model_validate(_plain(table.body_force)) if table.body_force else None,
        initial_velocity_gradient=table.initial_velocity_gradient(),
        damping_rate=table.damping_rate,
        point_damping_rate=table.point_damping_rate,
        force_scaling=table.force_scaling,
        preload=c.Preload.model_validate(_plain(table.preload)) if table.preload else None,
        on_lost_points=table.on_lost_points,
        time_step=scene.time_step,
    )


def cracks(scene: Scene) -> list[c.CrackLine]:
    """Return the cracks of the continuum: that of [crack] first, then those of [[continuum.cracks]]."""
    found = []
    if scene.crack is not None:
        # It starts outside the body so that the left edge is cut through; inside the atoms it is theirs.
        start = (scene.continuum.lower[0] - scene.continuum.cell_size, scene.crack.y)
        found.append(c.CrackLine(points=[start, (scene.crack.tip_x, scene.crack.y)]))
    return found + [_line(crack) for crack in scene.continuum.cracks]


def _line(crack: CrackLine) -> c.CrackLine:
    growth = c.CrackGrowth.model_validate(_plain(crack.growth)) if crack.growth else None
    return c.CrackLine.model_validate({**_plain(crack), "growth": growth})


def _plain(table: Table) -> dict[str, Any]:
    """Return the values of a table whose keys are those of the part of the message."""
    return table.model_dump()
