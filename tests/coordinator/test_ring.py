"""Rings of any shape, the anchors in them, and what follows from them."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely

from coordinator.critical_length import critical_crack_length, of_scene
from coordinator.exchange_length import choose_steps_per_exchange
from coordinator.handshake import HandshakeError
from coordinator.interface import build_interface
from coordinator.region import _material_edges
from coordinator.ring import Ring, RingError, rectangle_ring, shaped_ring
from coordinator.scene import Scene, SceneError, load_scene, read_scene
from coordinator.wave_speed import courant_number, sub_steps, wave_speed
from protocol.continuum import IsotropicMaterial

SCENES = Path(__file__).parents[2] / "scenes"
A = 1e-10
HALF = np.array([50 * A, 40 * A])
INNER = ((-35 * A, -25 * A), (35 * A, 25 * A))
ALL = ["left", "right", "bottom", "top"]


def sheet(spacing: float = 1.3 * A) -> np.ndarray:
    x, y = (np.linspace(-h, h, round(2 * h / spacing) + 1) for h in HALF)
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    return np.column_stack([grid, np.zeros(len(grid))])


def circle() -> Ring:
    return shaped_ring("circle", -HALF, HALF, 12 * A, None)


def polygon() -> Ring:
    corners = [(-50 * A, 0.0), (0.0, -40 * A), (50 * A, 0.0), (0.0, 40 * A)]
    return shaped_ring("polygon", -HALF, HALF, 10 * A, corners)


def test_a_rectangle_has_its_ring_on_all_sides_or_on_some() -> None:
    whole = rectangle_ring(INNER, -HALF, HALF, ALL)
    assert whole.plain and whole.width == pytest.approx(15 * A)
    sides = rectangle_ring(INNER, -HALF, HALF, ["left"])
    assert not sides.plain and sides.width == pytest.approx(15 * A)
    place = np.array([[-49.0, 0.0], [-30.0, 39.0], [49.0, 0.0], [0.0, -39.0]]) * A
    np.testing.assert_array_equal(whole.inside(place), False)
    np.testing.assert_array_equal(sides.inside(place), [False, True, True, True])
    np.testing.assert_allclose(whole.share(place[:1]), [14 / 15], rtol=1e-9)


def test_a_circle_touches_the_nearer_sides_and_its_ring_is_as_wide_as_asked() -> None:
    ring = circle()
    outer, inner = shapely.Polygon(ring.outer), shapely.Polygon(ring.inner)
    assert outer.area == pytest.approx(math.pi * (40 * A) ** 2, rel=1e-3)
    assert inner.area == pytest.approx(math.pi * (28 * A) ** 2, rel=2e-3)
    place = np.array([[28.0, 0.0], [34.0, 0.0], [40.0, 0.0], [0.0, 10.0], [45.0, 0.0]]) * A
    np.testing.assert_allclose(ring.share(place), [0.0, 0.5, 1.0, 0.0, 1.0], atol=2e-3)


@pytest.mark.parametrize("ring", [circle(), polygon(), rectangle_ring(INNER, -HALF, HALF, ALL)])
def test_every_atom_of_a_ring_is_anchored_once_in_a_cell_that_the_ring_fills(ring: Ring) -> None:
    atoms = sheet()
    atoms = atoms[ring.within(atoms[:, :2])]
    found = build_interface(atoms, ring, 7 * A)
    expected = np.flatnonzero(~ring.inside(atoms[:, :2]))
    np.testing.assert_array_equal(found.anchor, expected)
    assert set(found.anchor_ivc) == set(range(len(found.ivc_lower)))
    area = shapely.Polygon(ring.outer, [ring.inner])
    boxes = shapely.box(*found.ivc_lower[:, :2].T, *found.ivc_upper[:, :2].T)
    share = shapely.area(shapely.intersection(boxes, area)) / shapely.area(boxes)
    assert share.min() > 0.3 * share.max()  # slivers are joined to their neighbours


def test_a_crack_parts_the_cells_of_a_circle_too() -> None:
    atoms = sheet()
    ring = circle()
    atoms = atoms[ring.within(atoms[:, :2])]
    found = build_interface(atoms, ring, 7 * A, crack_y=1.1 * A)
    for cell in range(len(found.ivc_lower)):
        above = atoms[found.anchor[found.anchor_ivc == cell], 1] > 1.1 * A
        assert above.all() or not above.any()


def test_thinned_anchors_keep_their_distance_and_leave_no_gap() -> None:
    atoms, ring = sheet(), rectangle_ring(INNER, -HALF, HALF, ALL)
    heavy = np.arange(len(atoms)) % 3 > 0
    found = build_interface(atoms, ring, 7 * A, spacing=5 * A, heavy=heavy)
    taken = atoms[found.anchor]
    apart = np.linalg.norm(taken[:, None] - taken[None], axis=-1) + np.eye(len(taken))
    assert apart.min() > 5 * A * (1 - 1e-12) and heavy[found.anchor].all()
    in_ring = atoms[~ring.inside(atoms[:, :2]) & heavy]
    assert np.linalg.norm(in_ring[:, None] - taken[None], axis=-1).min(axis=1).max() <= 5 * A


@pytest.mark.parametrize(
    ("corners", "width", "said"),
    [
        ([(-50.0, 0.0), (50.0, 0.0), (-50.0, 10.0), (50.0, 10.0)], 3.0, "is not simple"),
        ([(-60.0, -40.0), (50.0, -40.0), (0.0, 40.0)], 3.0, "beyond the sample"),
        ([(-50.0, -40.0), (50.0, -40.0), (0.0, 40.0)], 60.0, "left inside the ring"),
    ],
)
def test_rings_that_cannot_be_are_refused(corners: list[tuple[float, float]], width: float, said: str) -> None:
    scaled = [(x * A, y * A) for x, y in corners]
    with pytest.raises(RingError, match=said):
        shaped_ring("polygon", -HALF, HALF, width * A, scaled)


def test_a_side_lies_at_the_mean_of_its_outermost_atoms() -> None:
    """A hexagonal sheet: atoms of every other row stand half a spacing further in; a slit's mouth does not count."""
    a = 3.45 * A
    rows = [(i * a + 0.5 * a * (j % 2), j * a * math.sqrt(3) / 2) for j in range(31) for i in range(30)]
    place = np.array(rows)
    low, high = _material_edges(place)
    # Some strips hold two rows, since rows are closer than atoms: a zigzag is met to within a quarter of its depth.
    np.testing.assert_allclose(low, [0.25 * a, 0.0], atol=0.07 * a)
    np.testing.assert_allclose(high, [29.25 * a, 30 * a * math.sqrt(3) / 2], atol=0.07 * a)
    slit = (np.abs(place[:, 1] - place[:, 1].mean()) < a) & (place[:, 0] < 40 * A)
    np.testing.assert_allclose(_material_edges(place[~slit])[0], low, atol=0.03 * a)


def test_a_row_of_atoms_ends_half_a_layer_beyond_its_last() -> None:
    place = np.column_stack([np.arange(11.0), np.zeros(11)]) * A
    low, high = _material_edges(place)
    np.testing.assert_allclose([low, high], np.array([[-0.5, 0.0], [10.5, 0.0]]) * A, atol=1e-20)


# --- scene keys ----------------------------------------------------------------------------------------------------


def scene(*overrides: str, name: str = "graphene_crack") -> Scene:
    return load_scene(SCENES / f"{name}.toml", overrides)


def test_the_preset_is_the_plain_scheme_and_keys_beside_it_win() -> None:
    text = (SCENES / "lattice_patch.toml").read_text()
    plain = read_scene(text, "p", ["handshake.preset=seed"]).handshake
    assert plain is not None and (plain.weight, plain.spread, plain.profile) == (1.0, "ivc", "constant")
    mixed = read_scene(text, "p", ["handshake.preset=seed", "handshake.spread=anchor"]).handshake
    assert mixed is not None and (mixed.weight, mixed.spread) == (1.0, "anchor")


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("handshake.force_error=1 pN", "must be left out with steps_per_exchange"),
        ("handshake.shape=polygon", "handshake.corners: is missing"),
        ('handshake.corners=[["0 nm", "0 nm"], ["1 nm", "0 nm"], ["0 nm", "1 nm"]]', "unless a polygon"),
        ("handshake.alpha=1.0", "must be less than 1"),
        ("atomistic.hold=1 ps", "must be left out without continuum.preload"),
        ("crack.start_x=1 nm", "must be left of crack.tip_x"),
        ("crack.tip_x=-100 angstrom", "must lie inside the sheet inside its handshake"),
        ("handshake.scheme=sideways", "must be one of"),
    ],
)
def test_what_a_handshake_refuses(override: str, said: str) -> None:
    with pytest.raises(SceneError, match=said):
        scene(override)


def test_regions_have_names_of_their_own_and_room() -> None:
    text = (SCENES / "centre_crack.toml").read_text()
    with pytest.raises(SceneError, match="name of its own"):
        read_scene(text.replace('"left"', '"right"'), "c")
    with pytest.raises(SceneError, match="at least one cell inside the body"):
        read_scene(text.replace('["96 angstrom"', '["190 angstrom"'), "c")


# --- steps -----------------------------------------------------------------------------------------------------------

GRAPHENE = IsotropicMaterial(young=960e9, poisson=0.2, density=2200.0)


def test_the_continuum_makes_as_many_sub_steps_as_are_stable() -> None:
    one = scene()
    assert sub_steps(one, GRAPHENE) == 1
    long = scene("handshake.steps_per_exchange=100", "atomistic.reference=1 ps")
    expected = math.ceil(wave_speed(GRAPHENE, "plane_stress") * 100 * 0.5e-15 / 5e-10 / 0.78)
    assert sub_steps(long, GRAPHENE) == expected > 1
    assert courant_number(long, GRAPHENE) <= 0.78
    assert sub_steps(scene("handshake.continuum_steps=7"), GRAPHENE) == 7


class NoisyRegion:
    """A region whose forces scatter like white noise of a known size, and which bears a largest M."""

    name = "atoms"

    def __init__(self, noise: float, most: int = 10**6) -> None:
        self.noise, self.most = noise, most
        self.scene: Any = None
        self.tried: list[int] = []

    def join(self, material: IsotropicMaterial, courant: float) -> None:
        if self.scene.handshake.steps_per_exchange > self.most:
            raise HandshakeError("the exchange is unstable")

    def register(self) -> None:
        self.tried.append(self.scene.handshake.steps_per_exchange)

    def equilibrate(self) -> Any:
        deviation = self.noise / math.sqrt(self.scene.handshake.steps_per_exchange)
        return type("E", (), {"window_ivc_deviation": np.full((4, 3), deviation)})()


def chosen(region: Any, error: str, most: int = 200) -> tuple[int, list[str]]:
    text = (SCENES / "lattice_patch.toml").read_text()
    text = text.replace("steps_per_exchange = 10", f'force_error = "{error}"\nmost_steps_per_exchange = {most}')
    return choose_steps_per_exchange(read_scene(text, "n"), [region], GRAPHENE)


def test_m_is_the_smallest_that_reaches_the_error() -> None:
    region = NoisyRegion(noise=100e-12)
    assert chosen(region, "10.001 pN") == (100, [])
    assert region.tried == [10, 100]
    assert chosen(NoisyRegion(noise=20e-12), "10 pN") == (10, [])


def test_where_no_m_reaches_the_error_the_largest_is_taken_and_told() -> None:
    steps, told = chosen(NoisyRegion(noise=1e-9), "10 pN", most=50)
    assert steps == 50 and "is not reached" in told[0] and "50" in told[0]
    steps, told = chosen(NoisyRegion(noise=100e-12, most=40), "10 pN")
    assert steps <= 40 and len(told) == 1
    with pytest.raises(HandshakeError):
        chosen(NoisyRegion(noise=1.0, most=2), "10 pN")


# --- critical length -------------------------------------------------------------------------------------------------


def test_the_critical_length_is_that_of_the_dissertation() -> None:
    """Sec 5: 0.382 nm for graphene with 16 J/m2, and 2560 nm for EPON 862 with 325 J/m2 (Eq 1)."""
    strength = math.sqrt(1e12 * 16 / (math.pi * 0.382e-9))
    assert strength == pytest.approx(115e9, rel=0.01)  # a ninth of Young's modulus, as a theoretical strength should be
    assert critical_crack_length(1e12, 0.17, 16.0, strength, "plane_stress") == pytest.approx(0.382e-9)
    stretch = critical_crack_length(1e12, 0.5, 16.0, strength, "plane_strain")
    assert stretch == pytest.approx(0.382e-9 / 0.75)


def test_a_scene_that_knows_a_toughness_is_held_against_it() -> None:
    assert of_scene(scene(), GRAPHENE) is None
    found = of_scene(scene("crack.toughness=16 J/m^2", "crack.strength=10 GPa"), GRAPHENE)
    assert found is not None and found.crack == pytest.approx(317.5 * A)
    assert found.length == pytest.approx(960e9 * 16 / (math.pi * 1e20)) and found.too_short and not found.estimated
    estimated = of_scene(scene("crack.toughness=16 J/m^2"), GRAPHENE)
    assert estimated is not None and estimated.strength == pytest.approx(96e9) and not estimated.too_short
