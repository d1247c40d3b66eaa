"""The comparison with the whole body of atoms: what edges prescribe, what the load is, how two runs compare."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest

from coordinator.applied_load import FACTOR, STRAIN, TIME, load_of
from coordinator.compare import TooLarge, Track, compare_scene, estimate, tip_difference, tip_load_difference
from coordinator.continuum_tables import KField
from coordinator.edge_motion import EdgeMotion, k_field_displacement, table_value
from coordinator.full_atomistic import GRIP, NotComparable, whole_body
from coordinator.scene import Scene, read_scene
from protocol.arrays import FloatArray
from protocol.continuum import IsotropicMaterial

MATERIAL = IsotropicMaterial(young=1e12, poisson=0.25, density=2300.0)
EDGE = (
    '[[continuum.edges]]\nedge = "{}"\ncomponent = "{}"\ntimes = ["0 ps", "2 ps"]\ndisplacements = ["0 nm", "{} nm"]\n'
)
K_FIELD = (
    '[[continuum.edges]]\nkind = "k_field"\nedge = "{}"\nfield = {{tip = ["0 nm", "0 nm"], k_1 = "2 MPa m^0.5"}}\n'
    'times = ["0 ps", "1 ps"]\nfactors = [0.0, 1.0]\n'
)
SCENE = """
title = "small"
[run]
steps = 10
[continuum]
assumption = "plane_stress"
lower = ["-10 nm", "-6 nm"]
upper = ["10 nm", "6 nm"]
cell_size = "1 nm"
[atomistic]
backend = "lattice"
force_field = "harmonic"
material = "hexagonal"
width = "8 nm"
height = "8 nm"
temperature = "0 K"
time_step = "1 fs"
[handshake]
width = "2 nm"
steps_per_exchange = 10
ivc_size = "2 nm"
"""
CRACK = '[crack]\ntip_x = "1 nm"\ny = "-0.5 nm"\n'


def scene_of(*edges: str, crack: bool = True) -> Scene:
    return read_scene(SCENE + (CRACK if crack else "") + "".join(edges), "small", file="small.toml")


def affine(place: FloatArray, gradient: FloatArray) -> FloatArray:
    return np.asarray(place[:, :2] @ gradient.T)


# --- edges ----------------------------------------------------------------------------------------------------------


def test_atoms_beyond_edges_that_strain_the_body_evenly_take_its_strain() -> None:
    scene = scene_of(
        EDGE.format("top", "y", 0.12), EDGE.format("bottom", "y", -0.12), EDGE.format("left", "x", 0.05),
        EDGE.format("right", "x", -0.05), crack=False,
    )  # fmt: skip
    rng = np.random.default_rng(3)
    place = np.column_stack([rng.uniform(-10.8e-9, 10.8e-9, 400), rng.uniform(-6.8e-9, 6.8e-9, 400), np.zeros(400)])
    beyond = (np.abs(place[:, 0]) > 10e-9) | (np.abs(place[:, 1]) > 6e-9)
    motion = EdgeMotion(scene.continuum, MATERIAL, place)
    assert np.array_equal(motion.side >= 0, beyond)
    gradient = np.diag([-0.05 / 10, 0.12 / 6])
    found = EdgeMotion(scene.continuum, MATERIAL, place[beyond])
    assert found.held == []
    for share, now in ((0.5, 1e-12), (1.0, 2e-12), (1.0, 5e-12)):
        wanted = share * affine(place[beyond], gradient)
        assert found.displacement(now)[:, :2] == pytest.approx(wanted, abs=1e-18)
        assert not found.displacement(now)[:, 2].any()


def test_a_component_that_nothing_prescribes_is_held_and_said() -> None:
    scene = scene_of(EDGE.format("top", "y", 0.1), EDGE.format("bottom", "y", 0.0))
    place = np.array([[1e-9, 6.5e-9, 0.0], [-3e-9, -6.1e-9, 0.0]])
    motion = EdgeMotion(scene.continuum, MATERIAL, place)
    assert motion.held == ["x of the bottom edge", "x of the top edge"]
    moved = motion.displacement(2e-12)
    assert not moved[:, 0].any()
    assert moved[0, 1] == pytest.approx(1e-10 * (1 + 0.5 / 12))


def test_a_crack_tip_field_is_taken_at_the_place_of_each_atom() -> None:
    scene = scene_of(*(K_FIELD.format(side) for side in ("left", "right", "bottom", "top")))
    place = np.array([[-10.3e-9, 1e-9, 0.0], [-10.3e-9, -1e-9, 0.0], [10.5e-9, 0.0, 0.0], [2e-9, 6.4e-9, 0.0]])
    moved = EdgeMotion(scene.continuum, MATERIAL, place).displacement(0.5e-12)
    field = scene.continuum.edges[0].field
    assert field is not None
    assert moved[:, :2] == pytest.approx(0.5 * k_field_displacement(field, MATERIAL, "plane_stress", place))
    # Symmetric about the crack's line, which opens.
    assert moved[0, 0] == pytest.approx(moved[1, 0])
    assert moved[0, 1] == pytest.approx(-moved[1, 1])
    assert moved[0, 1] > 0 and moved[2, 1] == 0


@pytest.mark.parametrize("assumption", ["plane_stress", "plane_strain"])
@pytest.mark.parametrize("mode", [1, 2])
def test_crack_tip_field_has_the_stress_intensity_ahead_of_the_tip(mode: int, assumption: str) -> None:
    """Stress ahead of the tip, by differences and Hooke's law, is K / sqrt(2 pi r); the faces bear none."""
    k = {1: (2e6, 0.0), 2: (0.0, 2e6)}[mode]
    field = KField.model_validate({"tip": (0.0, 0.0), "k_1": k[0], "k_2": k[1]}, context={"si": True})
    step = 1e-14

    def stress(x: float, y: float) -> FloatArray:
        gradient = np.zeros((2, 2))
        for axis in (0, 1):
            ends = np.array([[x, y, 0.0], [x, y, 0.0]])
            ends[:, axis] += (-step, step)
            u = k_field_displacement(field, MATERIAL, assumption, ends)  # type: ignore[arg-type]
            gradient[:, axis] = (u[1] - u[0]) / (2 * step)
        strain = 0.5 * (gradient + gradient.T)
        nu, e = MATERIAL.poisson, MATERIAL.young
        lame = e * nu / ((1 - nu**2) if assumption == "plane_stress" else (1 + nu) * (1 - 2 * nu))
        return np.asarray(lame * np.trace(strain) * np.eye(2) + e / (1 + nu) * strain)

    r = 3e-9
    ahead = stress(r, 0.0)[1, 2 - mode]
    assert ahead == pytest.approx(2e6 / math.sqrt(2 * math.pi * r), rel=1e-4)
    assert stress(-r, 1e-12)[1] == pytest.approx([0.0, 0.0], abs=2e-3 * ahead)


def test_table_of_a_velocity_is_the_way() -> None:
    text = EDGE.format("top", "y", 0).replace("displacements", "velocities").replace('"0 nm"', '"10 m/s"')
    text = text.replace('"0 nm"', '"30 m/s"').replace('edge = "top"', 'edge = "top"\nkind = "velocity"')
    edge = scene_of(text.replace('["10 m/s", "10 m/s"]', '["10 m/s", "30 m/s"]')).continuum.edges[0]
    for now, way in ((0.0, 0.0), (1e-12, 15e-12), (2e-12, 40e-12), (3e-12, 70e-12)):
        assert table_value(edge, now) == pytest.approx(way, abs=1e-24)


# --- the sample -----------------------------------------------------------------------------------------------------


def test_the_sample_is_the_body_with_strips_beyond_moved_edges() -> None:
    body = whole_body(scene_of(EDGE.format("top", "y", 0.1), EDGE.format("bottom", "y", 0.0)))
    assert body.size == pytest.approx((20e-9, 12e-9 + 2 * GRIP))
    assert body.middle == pytest.approx((0.0, 0.0))
    one_sided = whole_body(scene_of(EDGE.format("top", "y", 0.1)))
    assert one_sided.middle == pytest.approx((0.0, 0.5 * GRIP))
    crack = one_sided.request(None).sample.crack  # type: ignore[union-attr]
    assert crack is not None
    assert (crack.tip_x, crack.y) == pytest.approx((1e-9, -0.5e-9 - 0.5 * GRIP))


def test_the_cost_is_atoms_times_steps_times_that_of_a_step() -> None:
    body = whole_body(scene_of(EDGE.format("top", "y", 0.1)))
    atoms, seconds = estimate(body)
    assert atoms == pytest.approx(20e-9 * (12e-9 + GRIP) / 1.1e-19)
    # 10 exchanges of 10 steps and 1 ps of equilibration; 0.15 us a step and atom.
    assert seconds == pytest.approx(atoms * 1100 * 1.5e-7)


ALONE = """
[continuum.material]
young = "1 TPa"
poisson = 0.25
density = "2.3 g/cm^3"
thickness = "3 angstrom"
"""
PRESSURE = """
[[continuum.edges]]
kind = "pressure"
edge = "left"
times = ["0 ps"]
pressures = ["1 GPa"]
"""
BODY_FORCE = '[continuum.body_force]\nacceleration = ["0 m/s^2", "1 m/s^2"]\n'


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (SCENE[: SCENE.index("[atomistic]")] + 'time_step = "5 fs"' + ALONE, "no [atomistic]"),
        (SCENE + '[crack]\ntip_x = "1 nm"\nstart_x = "-2 nm"\ny = "0 nm"\n', "crack.start_x"),
        (SCENE + PRESSURE, "left edge has a pressure"),
        (SCENE + BODY_FORCE, "continuum.body_force"),
        (SCENE, "continuum.edges"),
    ],
)
def test_what_atoms_alone_cannot_have_is_named(text: str, words: str) -> None:
    scene = read_scene(text, "small", file="small.toml")
    with pytest.raises(NotComparable, match=re.escape(words)):
        whole_body(scene)


def test_a_body_that_would_take_hours_is_refused_before_anything_starts(tmp_path: Path) -> None:
    path = tmp_path / "large.toml"
    path.write_text(
        SCENE.replace("nm", "um").replace("steps = 10\n", "steps = 1000000\n") + EDGE.format("top", "y", 0.1)
    )

    with pytest.raises(TooLarge, match="--force"):
        compare_scene(path, tmp_path / "out")
    assert not (tmp_path / "out").exists()


# --- load and tips --------------------------------------------------------------------------------------------------


def test_load_is_strain_factor_or_time() -> None:
    time = np.array([0.0, 0.5e-12, 1e-12])
    name, load, j = load_of(scene_of(EDGE.format("top", "y", 0.12), EDGE.format("bottom", "y", -0.12)), MATERIAL, time)
    assert name == STRAIN
    assert load == pytest.approx([0.0, 0.005, 0.01])
    assert j[-1] == pytest.approx(0.5 * 1e12 * 0.01**2 * 12e-9)  # x is free: E, not E / (1 - nu^2)
    name, load, j = load_of(scene_of(K_FIELD.format("top")), MATERIAL, time)
    assert name == FACTOR
    assert load == pytest.approx([0.0, 0.5, 1.0])
    assert j == pytest.approx(np.array([0.0, 0.25, 1.0]) * (2e6) ** 2 / 1e12)
    name, load, j = load_of(scene_of(EDGE.format("top", "x", 0.1)), MATERIAL, time)
    assert name == TIME and np.array_equal(load, time) and np.isnan(j).all()


def tips(*rows: tuple[int, float]) -> Track:
    """A run of 100 rows whose load rises evenly to 1; its tip is at the last place given up to each row."""
    tip = np.zeros(100)
    for row, place in rows:
        tip[row:] = place
    rising = np.linspace(0.01, 1.0, 100)
    return Track(STRAIN, rising, rising, rising**2, tip, np.full(100, 300.0), (tip > 0).astype(float))


def test_tips_are_compared_at_one_load_and_loads_at_one_tip() -> None:
    one, other = tips((49, 2.0), (69, 4.0)), tips((49, 1.0), (59, 2.0), (79, 4.0))
    assert tip_difference(one, other, 4.0, 1.0) == pytest.approx(2.0)  # rows 69 to 78
    # Both have come 1 at load 0.5, 2 at 0.5 and 0.6, 3 and 4 at 0.7 and 0.8.
    assert tip_load_difference(one, other, 4.0, 1.0) == pytest.approx(1 / 6)
    assert tip_difference(one, other, 1.0, 1.0) == 0.0
    assert one.first_break() == 49 and one.first_beyond(3.0) == 69 and one.first_beyond(5.0) is None
    assert tip_difference(one, one, 4.0, 1.0) == 0.0
    late = tips((59, 2.0), (79, 4.0))
    assert tip_difference(one, late, 4.0, 1.0) == pytest.approx(2.0)
    # 10 rows later from the first bond to the second: rows 69 and 79 of the two.
    assert tip_difference(one.since_break(), late.since_break(), 4.0, 1.0) == 0.0


def test_a_run_that_ended_at_its_growth_is_held_there() -> None:
    whole = tips((49, 4.0))
    short = Track(
        STRAIN, *(getattr(whole, name)[:50] for name in ("time", "load", "j", "tip", "temperature", "broken"))
    )
    assert tip_difference(short, whole, 4.0, 1.0) == 0.0
