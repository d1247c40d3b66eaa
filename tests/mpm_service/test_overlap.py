"""Overlaps: weights of points against integrals in closed form, what is refused, what the service makes of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from mpm_service import Grid, HierarchicalGrid, Overlap, OverlapError, cut_overlaps, fill_hierarchy, fill_rectangle
from mpm_service.material_points import Body
from mpm_service.overlap import Profile
from mpm_service.service import MaterialPointService, ReferenceService
from protocol import continuum as c
from protocol.errors import ProtocolError

Corners = list[tuple[float, float]]


def box(left: float, bottom: float, right: float, top: float) -> Corners:
    return [(left, bottom), (right, bottom), (right, top), (left, top)]


def circle(x: float, y: float, radius: float, corners: int = 64) -> Corners:
    angles = 2 * np.pi * np.arange(corners) / corners
    return [(x + radius * np.cos(a), y + radius * np.sin(a)) for a in angles]


def area_of(corners: Corners) -> float:
    x, y = np.array(corners).T
    return 0.5 * abs(float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))))


def plate() -> Body:
    return fill_rectangle((0.0, 0.0), (20.0, 16.0), 1.0)


def nested_plate() -> Body:
    grid = HierarchicalGrid(Grid((-3.0, -3.0), 1.0, (26, 22)), [((4.0, 3.0), (16.0, 13.0)), ((7.0, 6.0), (13.0, 11.0))])
    return fill_hierarchy(grid, (0.0, 0.0), (20.0, 16.0))


BODIES = pytest.mark.parametrize("make", [plate, nested_plate])
SLANTED: Corners = [(5.3, 4.1), (15.2, 3.7), (15.9, 12.4), (9.8, 13.3), (4.6, 11.9)]
NOTCHED: Corners = [(8.0, 6.5), (11.7, 6.2), (10.2, 8.3), (12.1, 10.9), (7.6, 10.4)]


@BODIES
@pytest.mark.parametrize(
    ("inner", "outer"),
    [
        (box(7.3, 6.2, 12.6, 10.1), box(5.4, 4.4, 14.7, 12.2)),
        (NOTCHED, SLANTED),
        (circle(10, 8, 3.3), circle(10, 8, 5)),
    ],
)
def test_weights_add_up_to_the_area_of_the_polygons(make: Callable[[], Body], inner: Corners, outer: Corners) -> None:
    weight = 0.13
    whole = make()
    body = cut_overlaps(whole, [Overlap(inner, outer, weight)])
    carried = float(np.sum(body.weight * 4 * body.half**2))
    expected = 20.0 * 16.0 - area_of(inner) - (1 - weight) * (area_of(outer) - area_of(inner))
    assert carried == pytest.approx(expected, rel=1e-12)
    assert body.count < whole.count
    far = np.any(np.abs(body.position - (10.0, 8.0)) > 6.0, axis=1)
    assert far.sum() > 100 and np.all(body.weight[far] == 1.0)
    assert np.all(body.weight > 0.0) and np.all(body.weight <= 1.0)


def test_a_point_across_a_border_has_the_mean_over_its_domain() -> None:
    """Domains of side 1/2; the ring's left border at 0.1, its hole from 1.2 on, both beyond the body in y."""
    overlap = Overlap(box(1.2, -9.0, 5.0, 9.0), box(0.1, -10.0, 6.0, 10.0), 0.1)
    body = cut_overlaps(fill_rectangle((0.0, 0.0), (10.0, 4.0), 1.0), [overlap])
    column = {round(float(x), 2): w for x, w in zip(body.position[:, 0], body.weight, strict=True)}
    expected = {
        0.25: 0.2 * 1.0 + 0.8 * 0.1,
        0.75: 0.1,
        1.25: 0.1 * 0.2 / 0.5,
        5.25: 0.1,
        5.75: 0.1,
        6.25: 1.0,
    }
    for x, weight in expected.items():
        assert column[x] == pytest.approx(weight, rel=1e-12), x
    # what lies in the hole is left out, and the ring spans the body
    assert min(x for x in column if x > 1.3) == 5.25
    assert np.unique(body.position[:, 1]).size == 8


@pytest.mark.parametrize("profile", ["linear", "cubic", "power"])
def test_profiles_are_means_over_domains(profile: Profile) -> None:
    """Between two lines s is linear in x: the means over the domains are integrals of a polynomial."""
    left, width, weight = 2.3, 6.1, 0.07
    overlap = Overlap(box(left + width, -40.0, 60.0, 40.0), box(left, -60.0, 80.0, 60.0), weight, profile, 3.0)
    body = cut_overlaps(fill_rectangle((0.0, 0.0), (12.0, 3.0), 1.0), [overlap])

    def integral(x: float) -> float:
        """Integral of the weight from the outer border to x in the ring, both there."""
        s = 1.0 - np.clip((x - left) / width, 0.0, 1.0)
        quartic = (1 - s**4) / 4
        p = {"linear": (1 - s**2) / 2, "cubic": (1 - s**3) - 2 * quartic, "power": quartic}[profile]
        return float(weight * (1 - s) * width + (1 - weight) * p * width)

    for x, found in zip(body.position[:, 0], body.weight, strict=True):
        low, high = x - 0.25, x + 0.25
        expected = (max(left - low, 0.0) - max(left - high, 0.0) + integral(high) - integral(low)) / 0.5
        # a domain across the hole's border counts what it has there as nothing
        assert found == pytest.approx(expected, rel=1e-12 if profile == "linear" else 1e-4), x
    assert body.position[:, 0].max() == pytest.approx(8.25)


def test_a_profile_falls_from_the_outer_border_to_the_inner_all_around() -> None:
    weights = cut_overlaps(plate(), [Overlap(circle(10, 8, 3), circle(10, 8, 6), 0.2, "linear")])
    radius = np.linalg.norm(weights.position - (10.0, 8.0), axis=1)
    ring = (radius > 3.5) & (radius < 5.6)
    expected = 0.2 + 0.8 * (radius[ring] - 3.0) / 3.0
    np.testing.assert_allclose(weights.weight[ring], expected, atol=5e-3)  # polygons of 64 corners, square domains


def test_several_rings_each_count() -> None:
    rings = [
        Overlap(circle(5, 8, 2), circle(5, 8, 3.5), 0.2),
        Overlap(circle(15, 8, 2), circle(15, 8, 3.5), 0.4, "cubic"),
    ]
    both = cut_overlaps(plate(), rings)
    alone = [cut_overlaps(plate(), [ring]) for ring in rings]
    left = both.position[:, 0] < 10
    for side, one in zip((left, ~left), alone, strict=True):
        mine = (one.position[:, 0] < 10) == (side is left)
        np.testing.assert_array_equal(both.position[side], one.position[mine])
        np.testing.assert_array_equal(both.weight[side], one.weight[mine])


def test_round_off_makes_no_slivers() -> None:
    """Decimal corners on lines of points, in metres of atoms: no point with next to nothing is left, none is cut."""
    unit = 1e-10
    body = fill_rectangle((-60 * unit, -60 * unit), (60 * unit, 60 * unit), 5 * unit)
    inner, outer = 37.5 * unit, 52.5 * unit
    cut = cut_overlaps(body, [Overlap(box(-inner, -inner, inner, inner), box(-outer, -outer, outer, outer), 0.2)])
    assert cut.count == 48**2 - 30**2
    np.testing.assert_allclose(np.unique(cut.weight.round(12)), [0.2, 1.0])


@pytest.mark.parametrize(
    ("make", "part"),
    [
        (lambda: Overlap(box(1, 1, 2, 2), box(0, 0, 3, 3), 0.0), "weight"),
        (lambda: Overlap(box(1, 1, 2, 2), box(0, 0, 3, 3), 1.5), "weight"),
        (lambda: Overlap(box(1, 1, 2, 2), box(0, 0, 3, 3), 0.5, "square"), "profile"),  # type: ignore[arg-type]
        (lambda: Overlap(box(1, 1, 4, 2), box(0, 0, 3, 3), 0.5), "inner"),
        (lambda: Overlap([(1, 1), (2, 2), (2, 1), (1, 2)], box(0, 0, 3, 3), 0.5), "inner"),
        (lambda: Overlap(box(1, 1, 2, 2), [(0, 0), (3, 3), (3, 0), (0, 3)], 0.5), "outer"),
        (lambda: Overlap([(1, 1), (2, 2)], box(0, 0, 3, 3), 0.5), "inner"),
        (lambda: Overlap([(1, 1), (2, float("nan")), (2, 1)], box(0, 0, 3, 3), 0.5), "inner"),
    ],
)
def test_polygons_that_make_no_ring_are_refused(make: Callable[[], Overlap], part: str) -> None:
    with pytest.raises(OverlapError) as caught:
        make()
    assert caught.value.part == part and part in str(caught.value)


@pytest.mark.parametrize(
    ("rings", "part", "number"),
    [
        ([Overlap(box(30, 3, 32, 5), box(29, 2, 33, 6), 0.5)], "inner", 0),
        (
            [Overlap(box(3, 3, 5, 5), box(2, 2, 6, 6), 0.5), Overlap(box(6, 3, 8, 5), box(5.9, 2, 9, 6), 0.5)],
            "outer",
            1,
        ),
        ([Overlap(box(-1, -1, 21, 17), box(-2, -2, 22, 18), 0.5)], "inner", 0),
    ],
)
def test_rings_that_do_not_fit_the_body_or_each_other_are_refused(rings: list[Overlap], part: str, number: int) -> None:
    with pytest.raises(OverlapError) as caught:
        cut_overlaps(plate(), rings)
    assert (caught.value.part, caught.value.number) == (part, number)


def test_rings_may_touch() -> None:
    rings = [Overlap(box(3, 3, 5, 5), box(2, 2, 6, 6), 0.5), Overlap(box(7, 3, 9, 5), box(6, 2, 10, 6), 0.5)]
    assert cut_overlaps(plate(), rings).count == 20 * 16 * 4 - 2 * 16


def test_the_stiffness_of_a_ring_may_differ_from_its_weight() -> None:
    inner, outer = box(7.3, 6.2, 12.6, 10.1), box(5.4, 4.4, 14.7, 12.2)
    alike = cut_overlaps(plate(), [Overlap(inner, outer, 0.13, "cubic")])
    soft = cut_overlaps(plate(), [Overlap(inner, outer, 0.13, "cubic", stiffness=0.02)])
    np.testing.assert_array_equal(alike.weight, soft.weight)
    np.testing.assert_array_equal(alike.stiffness_share, alike.weight)
    carried = float(np.sum(soft.stiffness_share * 4 * soft.half**2))
    ring = area_of(outer) - area_of(inner)
    assert carried == pytest.approx(20.0 * 16.0 - area_of(inner) - 0.98 * ring, rel=1e-12)


# --- through the messages --------------------------------------------------------------------------------------------

SIDE = 1e-9


def request(**changes: Any) -> c.ContinuumConfigure:
    values: dict[str, Any] = {
        "assumption": "plane_stress", "thickness": SIDE,
        "body": c.Rectangle(lower=(-10 * SIDE, -6 * SIDE), upper=(10 * SIDE, 6 * SIDE)),
        "cell_size": SIDE, "points_per_cell": 2,
        "material": c.IsotropicMaterial(young=1e9, poisson=0.3, density=1e3),
        "initial_velocity_gradient": (1e7, 2e6, 0.0, -1e7), "time_step": 0.2 * SIDE / 1e3,
    }  # fmt: skip
    return c.ContinuumConfigure.model_validate({**values, **changes})


def region(inner: Corners, outer: Corners, weight: float = 0.3, profile: Profile = "constant") -> c.OverlapRegion:
    def scaled(corners: Corners) -> Corners:
        return [(x * SIDE, y * SIDE) for x, y in corners]

    return c.OverlapRegion(inner=scaled(inner), outer=scaled(outer), weight=weight, profile=profile)


RINGS = [
    region(circle(-5, 0, 2, 24), circle(-5, 0, 3.6, 24), 0.2, "cubic"),
    region([(3.2, -1.9), (6.4, -2.3), (5.8, 2.2)], box(2.1, -3.4, 7.9, 3.3)),
]


def test_a_rectangle_says_the_same_as_its_polygons() -> None:
    low, high = (-2.2 * SIDE, -1.0 * SIDE), (1.5 * SIDE, 1.7 * SIDE)
    far_low, far_high = (-4.2 * SIDE, -3.1 * SIDE), (3.3 * SIDE, 3.0 * SIDE)
    plain = c.Overlap(
        inner=c.Rectangle(lower=low, upper=high), outer=c.Rectangle(lower=far_low, upper=far_high), weight=0.3
    )
    shaped = c.OverlapRegion(inner=box(*low, *high), outer=box(*far_low, *far_high), weight=0.3)
    one = MaterialPointService().configure(request(overlap=plain))
    two = MaterialPointService().configure(request(overlaps=[shaped]))
    np.testing.assert_array_equal(one.position, two.position)
    np.testing.assert_array_equal(one.weight, two.weight)
    assert one.plain_values() == two.plain_values()
    assert 0 < np.sum((one.weight > 0.0) & (one.weight < 1.0)) < len(one.weight)


@pytest.mark.parametrize("level", [[], [c.Rectangle(lower=(-8 * SIDE, -4 * SIDE), upper=(-2 * SIDE, 4 * SIDE))]])
def test_a_body_with_rings_moves_and_keeps_its_momentum(level: list[c.Rectangle]) -> None:
    service = MaterialPointService()
    built = service.configure(request(overlaps=RINGS, refinement=level, time_step=0.1 * SIDE / 1e3))
    assert len(built.levels) == 1 + len(level)
    first = service.advance(c.ContinuumAdvance(steps=1))
    last = service.advance(c.ContinuumAdvance(steps=200))
    assert last.strain_energy > 0.01 * first.kinetic_energy
    assert first.momentum is not None and last.momentum is not None
    scale = np.sqrt(2 * first.kinetic_energy * 20e-9 * 12e-9 * SIDE * 1e3)
    np.testing.assert_allclose(last.momentum, first.momentum, atol=1e-11 * scale)


@pytest.mark.parametrize("kind", [MaterialPointService, ReferenceService])
def test_strain_energy_is_linear_in_the_stiffness_of_a_ring_and_mass_is_not_touched(
    kind: type[MaterialPointService],
) -> None:
    """Over a time that is short against any wave through a cell, strains are the same whatever the stiffness is."""
    whole = RINGS[1]
    stored, moving = {}, {}
    for share in (None, 0.1, 0.2, 0.4):
        service = kind()
        ring = whole.model_copy(update={"stiffness": share})
        service.configure(request(overlaps=[ring], time_step=1e-4 * SIDE / 1e3))
        told = service.advance(c.ContinuumAdvance(steps=10))
        stored[share], moving[share] = told.strain_energy, told.kinetic_energy
    assert moving[0.4] == pytest.approx(moving[0.1], rel=1e-6)
    assert stored[0.4] > 1.01 * stored[0.1]
    slope = (stored[0.4] - stored[0.1]) / 0.3
    assert stored[0.2] == pytest.approx(stored[0.1] + 0.1 * slope, rel=1e-4)
    assert stored[None] == pytest.approx(stored[0.1] + (whole.weight - 0.1) * slope, rel=1e-4)


def test_both_backends_agree_on_rings() -> None:
    answers = []
    for kind in (MaterialPointService, ReferenceService):
        service = kind()
        built = service.configure(request(overlaps=[RINGS[0], RINGS[1].model_copy(update={"stiffness": 0.02})]))
        answers.append((built, service.advance(c.ContinuumAdvance(steps=40))))
    (one, moved), (two, other) = answers
    np.testing.assert_array_equal(one.position, two.position)
    np.testing.assert_array_equal(one.weight, two.weight)
    for name in ("kinetic_energy", "strain_energy", "filter_loss"):
        assert getattr(moved, name) == pytest.approx(getattr(other, name), rel=1e-10), name
    np.testing.assert_allclose(moved.momentum, other.momentum, rtol=1e-10)


@pytest.mark.parametrize(
    ("overlaps", "field"),
    [
        ([region(box(-1, -1, 1, 3), box(-2, -2, 2, 2))], "overlaps.0.inner"),
        ([RINGS[0], region([(3, -1), (5, 1), (5, -1), (3, 1)], box(2, -2, 6, 2))], "overlaps.1.inner"),
        ([region(box(-1, -1, 1, 1), [(-2, -2), (2, 2), (2, -2), (-2, 2)])], "overlaps.0.outer"),
        ([region(box(-1, -9, 1, -8), box(-2, -10, 2, -7))], "overlaps.0.inner"),
        ([RINGS[0], region(box(-2, -1, 2, 1), box(-3, -2, 3, 2))], "overlaps.1.outer"),
        ([region(box(-11, -7, 11, 7), box(-12, -8, 12, 8))], "overlaps.0.inner"),
    ],
)
def test_a_ring_that_cannot_be_is_a_bad_field(overlaps: list[c.OverlapRegion], field: str) -> None:
    with pytest.raises(ProtocolError) as caught:
        MaterialPointService().configure(request(overlaps=overlaps))
    assert (caught.value.code, caught.value.report.field) == ("bad_field", field)
