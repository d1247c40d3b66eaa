"""The `configure` request that a scene makes of the continuum service."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from coordinator.continuum_tables import CrackLine
from coordinator.region import Region
from coordinator.scene import Scene
from coordinator.table import Table
from protocol import continuum as c
from protocol.arrays import FloatArray
from protocol.atomistic import Properties


def material_of(scene: Scene, measured: Properties | None) -> c.Material:
    """Return the material of the continuum: the scene's, or the constants measured for the potential.

    A laminate is another's: `coordinator.laminate_material`.
    """
    given = scene.continuum.material
    if given is not None:
        material: c.Material = TypeAdapter(c.Material).validate_python(given.constants())
        return material
    assert measured is not None  # held by the scene's checks
    law = {"isotropic": c.IsotropicMaterial, "neo_hookean": c.NeoHookeanMaterial}[scene.continuum.measured_law]
    return law(young=measured.young, poisson=measured.poisson, density=measured.density)


def thickness_of(scene: Scene, measured: Properties | None) -> float:
    """Return the thickness of the continuum, m: the scene's, or that of the layers of the sample."""
    if scene.continuum.material is not None:
        return scene.continuum.material.whole_thickness
    assert measured is not None and scene.atomistic is not None  # held by the scene's checks
    return measured.thickness * scene.atomistic.layers


def elastic_constants(material: c.Material) -> c.IsotropicMaterial | None:
    """Return the constants at small strain; None where one modulus and one ratio do not tell them."""
    if isinstance(material, c.OrthotropicMaterial | c.LaminateMaterial):
        return None
    return c.IsotropicMaterial(young=material.young, poisson=material.poisson, density=material.density)


def continuum_request(
    scene: Scene,
    material: c.Material,
    thickness: float,
    regions: Sequence[Region],
    sub_steps: int,
    probes: Sequence[FloatArray],
) -> c.ContinuumConfigure:
    """Return the whole continuum problem of a scene.

    Parameters
    ----------
    scene : Scene
    material : Material
        The scene's, or that measured for the atoms.
    thickness : float
        m.
    regions : sequence of Region
        Where it overlaps with atoms, joined; none for a scene without.
    sub_steps : int
        Steps of the continuum in one coupling step.
    probes : sequence of float64 array, shape (n, 3)
        Places whose displacement by the preload is wanted, m.
    """
    table = scene.continuum
    overlaps = [region.overlap() for region in regions]
    plain = _plain_overlap(regions, overlaps)
    return c.ContinuumConfigure(
        assumption=table.assumption,
        thickness=thickness,
        body=c.Rectangle(lower=table.lower, upper=table.upper),
        cell_size=table.cell_size,
        refinement=[c.Rectangle(lower=level.lower, upper=level.upper) for level in table.refinement],
        points_per_cell=table.points_per_cell,
        holes=[c.Hole(centre=hole.centre, radius=0.5 * hole.diameter) for hole in table.holes],
        scheme=c.Scheme.model_validate(_plain(table.scheme)),
        material=material,
        overlap=plain,
        overlaps=[] if plain is not None else overlaps,
        cracks=cracks(scene),
        edges=[TypeAdapter(c.AnyEdge).validate_python(edge.given()) for edge in table.edges],
        body_force=c.BodyForce.model_validate(_plain(table.body_force)) if table.body_force else None,
        initial_velocity_gradient=table.initial_velocity_gradient(),
        damping_rate=table.damping_rate,
        point_damping_rate=table.point_damping_rate,
        force_scaling=table.force_scaling,
        initial_field=None if table.initial_field is None else c.KField.model_validate(_plain(table.initial_field)),
        probe_position=np.concatenate(probes) if probes else None,
        preload=c.Preload.model_validate(_plain(table.preload)) if table.preload else None,
        on_lost_points=table.on_lost_points,
        time_step=scene.time_step / sub_steps,
    )


def _plain_overlap(regions: Sequence[Region], overlaps: Sequence[c.OverlapRegion]) -> c.Overlap | None:
    """Return a single ring between rectangles as every version of the protocol has it; None for others."""
    if (
        len(regions) != 1
        or overlaps[0].profile != "constant"
        or overlaps[0].stiffness
        or not regions[0].interface.ring.plain
    ):
        return None
    inner, outer = (np.array(corners) for corners in (overlaps[0].inner, overlaps[0].outer))
    return c.Overlap(inner=_box(inner), outer=_box(outer), weight=overlaps[0].weight)


def _box(corners: FloatArray) -> c.Rectangle:
    return c.Rectangle(lower=tuple(corners.min(axis=0).tolist()), upper=tuple(corners.max(axis=0).tolist()))


def cracks(scene: Scene) -> list[c.CrackLine]:
    """Return the cracks of the continuum: that of [crack] first, then those of [[continuum.cracks]]."""
    found = []
    if scene.crack is not None:
        # It starts outside the body so that the left edge is cut through; inside the atoms it is theirs.
        crack, growth = scene.crack, scene.crack.growth
        start = scene.continuum.lower[0] - scene.continuum.cell_size if crack.start_x is None else crack.start_x
        found.append(
            c.CrackLine(
                points=[(start, crack.y), (crack.tip_x, crack.y)],
                growth=None if growth is None else c.CrackGrowth.model_validate(_plain(growth)),
            )
        )
    return found + [_line(crack) for crack in scene.continuum.cracks]


def _line(crack: CrackLine) -> c.CrackLine:
    growth = c.CrackGrowth.model_validate(_plain(crack.growth)) if crack.growth else None
    return c.CrackLine.model_validate({**_plain(crack), "growth": growth})


def _plain(table: Table) -> dict[str, Any]:
    """Return the values of a table whose keys are those of the part of the message."""
    return table.model_dump()
