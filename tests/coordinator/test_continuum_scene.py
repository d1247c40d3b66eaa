"""What a scene says of its continuum: materials, edges, levels, cracks, and the request that it becomes."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from pydantic import TypeAdapter

from coordinator.check import continuum_points, describe, levels
from coordinator.continuum_request import continuum_request
from coordinator.scene import Scene, SceneError, load_scene, read_resolved, read_scene
from coordinator.wave_speed import wave_speed
from mpm_service.elastic import IsotropicElastic, OrthotropicElastic
from mpm_service.grid import Grid
from mpm_service.hierarchy import HierarchicalGrid
from mpm_service.hierarchy_filling import fill_hierarchy
from protocol import continuum as c
from protocol.messages import newer_fields
from protocol.version import Version

SCENES = Path(__file__).parents[2] / "scenes"

PLATE = """
title = "A plate with everything"
[run]
steps = 10
[continuum]
assumption = "plane_strain"
lower = ["-8 mm", "-4 mm"]
upper = ["8 mm", "4 mm"]
cell_size = "1 mm"
time_step = "50 ns"
point_damping_rate = "2 1/s"
force_scaling = 0.25
on_lost_points = "stop"
[continuum.scheme]
interpolation = "cpgimp"
transfer = "xpic"
order = 3
period = 4
[continuum.material]
law = "j2_plasticity"
young = "70 GPa"
poisson = 0.3
density = "2700 kg/m^3"
thickness = "1 mm"
yield_stress = "300 MPa"
hardening = "1 GPa"
[[continuum.edges]]
edge = "left"
kind = "symmetry"
[[continuum.edges]]
edge = "right"
kind = "velocity"
component = "x"
times = ["0 us"]
velocities = ["2 m/s"]
[[continuum.edges]]
edge = "top"
kind = "traction"
component = "y"
times = ["0 us", "5 us"]
tractions = ["0 MPa", "-3 MPa"]
[[continuum.edges]]
edge = "bottom"
kind = "pressure"
times = ["0 us"]
pressures = ["1 bar"]
[[continuum.edges]]
edge = "bottom"
kind = "absorbing"
[continuum.body_force]
acceleration = ["0 m/s^2", "-9.81 m/s^2"]
[continuum.preload]
tolerance = 1e-3
max_steps = 500
[[continuum.refinement]]
lower = ["-4 mm", "-3 mm"]
upper = ["4 mm", "3 mm"]
[[continuum.refinement]]
lower = ["-2 mm", "-1 mm"]
upper = ["2 mm", "1 mm"]
[[continuum.cracks]]
points = [["-9 mm", "0.25 mm"], ["0 mm", "0.25 mm"]]
contact = "coulomb"
friction = 0.2
growth = {critical_energy_release_rate = "10 J/m^2", rule = "straight", interval = 20}
[[continuum.cracks]]
points = [["1 mm", "-2.5 mm"], ["3 mm", "-2.5 mm"]]
measure_every = 5
"""


def plate(*overrides: str) -> Scene:
    return read_scene(PLATE, "plate", overrides)


def problems(*overrides: str) -> list[str]:
    with pytest.raises(SceneError) as caught:
        plate(*overrides)
    return list(caught.value.problems)


def request(scene: Scene) -> c.ContinuumConfigure:
    material = scene.continuum.material
    assert material is not None
    law: c.Material = TypeAdapter(c.Material).validate_python(material.constants())
    return continuum_request(scene, law, material.thickness, [], 1, [])


def test_every_table_reaches_the_request_in_si() -> None:
    made = request(plate())
    assert made.material == c.J2PlasticityMaterial(
        young=70e9, poisson=0.3, density=2700.0, yield_stress=300e6, hardening=1e9
    )
    assert made.scheme == c.Scheme(interpolation="cpgimp", transfer="xpic", order=3, period=4)
    left, right, top, bottom, absorbing = made.edges
    assert left == c.EdgeSymmetry(edge="left")
    assert right == c.EdgeVelocity(edge="right", component=0, times=[0.0], velocities=[2.0])
    assert isinstance(top, c.EdgeTraction) and (top.edge, top.component) == ("top", 1)
    assert (top.times, top.tractions) == (pytest.approx([0.0, 5e-6]), pytest.approx([0.0, -3e6]))
    assert isinstance(bottom, c.EdgePressure) and math.isclose(bottom.pressures[0], 1e5)
    assert absorbing == c.EdgeAbsorbing(edge="bottom")
    assert made.body_force == c.BodyForce(acceleration=(0.0, -9.81), times=[0.0], factors=[1.0])
    assert made.preload == c.Preload(tolerance=1e-3, max_steps=500)
    np.testing.assert_allclose([level.lower for level in made.refinement], [(-4e-3, -3e-3), (-2e-3, -1e-3)], rtol=1e-14)
    first, second = made.cracks
    assert (first.contact, first.friction, first.measure_every) == ("coulomb", 0.2, 0)
    assert first.growth == c.CrackGrowth(critical_energy_release_rate=10.0, rule="straight", interval=20)
    np.testing.assert_allclose(first.points, [(-9e-3, 0.25e-3), (0.0, 0.25e-3)], rtol=1e-14)
    assert second.growth is None and second.measure_every == 5
    assert (made.point_damping_rate, made.force_scaling, made.on_lost_points) == (2.0, 0.25, "stop")


def test_a_scene_of_before_asks_for_nothing_that_is_new() -> None:
    scene = load_scene(SCENES / "graphene_crack.toml")
    material = c.IsotropicMaterial(young=1e12, poisson=0.2, density=2e3)
    made = continuum_request(scene, material, 3.35e-10, [], 1, [])
    assert newer_fields(made, Version(1, 0)) == []
    assert len(made.cracks) == 1 and made.cracks[0].points[1] == (0.0, 0.0)


def test_resolved_values_read_back_the_same() -> None:
    scene = plate()
    assert read_resolved(scene.model_dump(mode="json")).model_dump() == scene.model_dump()


@pytest.mark.parametrize(
    ("override", "path", "said"),
    [
        ("continuum.material.law=rubber", "continuum.material.law", "'isotropic', 'orthotropic'"),
        ("continuum.material.law=isotropic", "continuum.material.hardening", 'left out with law = "isotropic"'),
        ("continuum.material.law=orthotropic", "continuum.material.young_1", 'law = "orthotropic" needs it'),
        ("continuum.material.hardening=-1 GPa", "continuum.material.hardening", "must be 0 or greater"),
        ("continuum.edges.1.kind=traction", "continuum.edges.1.tractions", 'is missing; kind = "traction" needs it'),
        ("continuum.edges.1.kind=traction", "continuum.edges.1.velocities", 'must be left out with kind = "traction"'),
        ("continuum.edges.1.velocities=['2 m']", "continuum.edges.1.velocities.0", "is none of velocity"),
        ("continuum.edges.1.edge=left", "continuum.edges.1", "left x is prescribed already by continuum.edges.0"),
        ("continuum.edges.2.times=['0 us', '0 us']", "continuum.edges.2.times.1", "must be later"),
        ("continuum.edges.2.tractions=['1 MPa']", "continuum.edges.2.tractions", "has 1 values, must have 2"),
        ("continuum.body_force.factors=[1, 2]", "continuum.body_force.factors", "has 2 values, must have 1"),
        ("continuum.refinement.0.upper.0=3.7 mm", "continuum.refinement.0.upper.0", "nearest: 4 mm"),
        ("continuum.refinement.1.lower.0=-3.5 mm", "continuum.refinement.1.lower.0", "nearest: -3 mm"),
        ("continuum.refinement.0.lower.1=-5 mm", "continuum.refinement.0.lower.1", "from -4 mm to 4 mm"),
        ("continuum.refinement.1.upper.0=-1.5 mm", "continuum.refinement.1.upper.0", "at least two cells of 500 um"),
        ("continuum.cracks.0.contact=stick", "continuum.cracks.0.friction", 'left out unless contact = "coulomb"'),
        ("continuum.cracks.0.growth.interval=0", "continuum.cracks.0.growth.interval", "must be greater than 0"),
        ("continuum.cracks.0.growth.rule=up", "continuum.cracks.0.growth.rule", "'straight' or 'max_hoop'"),
        ("continuum.cracks.0.growth.gc=1", "continuum.cracks.0.growth.gc", "is no key of this table"),
        ("continuum.scheme.order=21", "continuum.scheme.order", "must be 20 or less"),
        ("continuum.force_scaling=1", "continuum.force_scaling", "must be less than 1"),
        ("continuum.preload.tolerance=1", "continuum.preload.tolerance", "must be less than 1"),
    ],
)
def test_what_is_not_allowed(override: str, path: str, said: str) -> None:
    found = problems(override)
    assert any(f"{path} = " in line or f"{path}: " in line for line in found if said in line), found


def test_a_missing_constant_is_said_once() -> None:
    with pytest.raises(SceneError) as caught:
        read_scene(PLATE.replace('yield_stress = "300 MPa"\n', ""), "plate")
    assert caught.value.problems == (
        'scene: continuum.material.yield_stress: is missing; law = "j2_plasticity" needs it',
    )


def test_an_unreadable_constant_is_not_also_missing() -> None:
    assert problems("continuum.material.young=70") == [
        '--set: continuum.material.young = 70: must be a pressure with its unit, such as "800 GPa"; a bare number has'
        " no unit"
    ]


def test_an_orthotropic_body_has_no_handshake() -> None:
    text = (SCENES / "graphene_crack.toml").read_text()
    material = """
[continuum.material]
law = "orthotropic"
density = "2 g/cm^3"
thickness = "3 angstrom"
young_1 = "1 TPa"
young_2 = "1 TPa"
young_3 = "1 TPa"
poisson_12 = 0.1
poisson_13 = 0.1
poisson_23 = 0.1
shear_12 = "400 GPa"
"""
    with pytest.raises(SceneError) as caught:
        read_scene(text + material, "s")
    assert [line.split(": ", 1)[1] for line in caught.value.problems] == [
        'continuum.material.law = "orthotropic": must have one Young\'s modulus with [atomistic]: the theory of the'
        " handshake needs it"
    ]


def test_follow_edges_takes_velocities() -> None:
    bar = plate("continuum.edges.0.edge=bottom", "continuum.initial_velocity=follow_edges", "run.steps=3")
    gradient = bar.continuum.initial_velocity_gradient()
    assert gradient is not None and gradient == pytest.approx((2.0 / 8e-3, 0.0, 0.0, 0.0))


def test_points_of_each_level_are_those_that_are_filled_in() -> None:
    scene = plate()
    body = scene.continuum
    uniform = Grid((-11e-3, -7e-3), 1e-3, (22, 14))
    nested = HierarchicalGrid(uniform, [(level.lower, level.upper) for level in body.refinement])
    filled = fill_hierarchy(nested, body.lower, body.upper, 2)
    assert continuum_points(scene) == filled.count
    for edge, count in levels(scene):
        assert count * 4 == int(np.isclose(filled.half, edge / 4).sum())
    text = describe(scene)
    assert f"level 2: {levels(scene)[2][1]} cells of 250 um, {4 * levels(scene)[2][1]} points" in text
    assert "cpgimp, MUSL, XPIC(3) every 4 steps, FLIP between" in text
    assert "coulomb, grows at 10 J/m2 (straight)" in text


@pytest.mark.parametrize("assumption", ["plane_stress", "plane_strain"])
def test_the_wave_speed_is_that_of_the_solver_s_materials(assumption: str) -> None:
    isotropic = {"young": 3e9, "poisson": 0.33, "density": 1200.0}
    orthotropic = {
        "young_1": 150e9, "young_2": 9e9, "young_3": 9e9, "poisson_12": 0.3, "poisson_13": 0.3, "poisson_23": 0.45,
        "shear_12": 5e9, "density": 1600.0, "angle": 0.4,
    }  # fmt: skip
    for mine, theirs in (
        (c.IsotropicMaterial(**isotropic), IsotropicElastic(**isotropic, assumption=assumption)),
        (c.OrthotropicMaterial(**orthotropic),
         OrthotropicElastic(**orthotropic, shear_13=5e9, shear_23=3e9, assumption=assumption)),
    ):  # fmt: skip
        speed = wave_speed(mine, assumption)  # type: ignore[arg-type]
        assert speed == pytest.approx(theirs.pressure_wave_speed, rel=1e-4)
    text = describe(plate("continuum.assumption=" + assumption))
    number = re.search(r"Courant number (\d\.\d+)", text)
    assert number
    speed = IsotropicElastic(70e9, 0.3, 2700.0, assumption).pressure_wave_speed  # type: ignore[arg-type]
    assert float(number[1]) == pytest.approx(speed * 50e-9 / 0.25e-3, rel=5e-3)
