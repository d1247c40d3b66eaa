"""Crack tips beside an overlap with atoms: where growth ends, down to where J is right, the stress that starts anew."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cracked_plate import MM, SPEED, advance, extend, plate

from mpm_service.crack_growth import RINGS
from mpm_service.fracture import FractureFields, TipFrame, j_integral, plane_constants, stress_ahead, tip_gradient
from mpm_service.overlap_border import distance_outside, way_before
from mpm_service.service import MaterialPointService, make_service
from protocol import continuum as c

E, NU, RHO, K = 2.5e9, 0.33, 1200.0, 1.3e6


def growing(critical: float, tip: float, **changes: Any) -> MaterialPointService:
    """The plate with a hole and a ring, its top and bottom pulled apart at a constant rate from a uniform start."""
    edges = [
        c.EdgeVelocity(edge="top", component=1, times=[0.0], velocities=[SPEED]),
        c.EdgeVelocity(edge="bottom", component=1, times=[0.0], velocities=[-SPEED]),
    ]
    growth = c.CrackGrowth(critical_energy_release_rate=critical, rule="straight", interval=10)
    service = make_service(Path())
    service.configure(
        plate(
            edges=edges,
            initial_velocity_gradient=(0.0, 0.0, 0.0, SPEED / (10 * MM)),
            cracks=[c.CrackLine(points=[(-17 * MM, 0.2 * MM), (tip, 0.2 * MM)], growth=growth)],
            **changes,
        )
    )
    return service


def test_a_growing_tip_stops_at_the_outer_border_and_says_so_once() -> None:
    service = growing(20.0, -9 * MM)
    events: list[c.ContinuumEvent] = []
    for _ in range(60):
        events += advance(service, 20).events
    kinds = [event.kind for event in events]
    assert kinds.count("reached_overlap") == 1 and kinds[-1] == "reached_overlap"
    assert set(kinds[:-1]) == {"growth"} and len(kinds) > 3
    assert "border of an overlap" in events[-1].sentence
    (tip,) = advance(service, 1).tips
    assert events[-1].tip is not None and tip.length == events[-1].tip.length
    assert tip.length == pytest.approx(11 * MM, rel=1e-12)
    # It is measured there still: the stress ahead of it is what a coupling needs.
    assert tip.measured_at == service.step // 10 * 10 and tip.hoop_stress is not None and tip.j is not None


def test_a_tip_inside_an_overlap_is_neither_measured_nor_grown_and_beyond_it_is_again() -> None:
    service = growing(20.0, -6 * MM)
    assert [event.kind for event in advance(service, 1200).events] == ["reached_overlap"]
    for x in (-5 * MM, 0.0, 5 * MM):
        extend(service, (x, 0.2 * MM))
        reply = advance(service, 40)
        assert reply.events == [] and all(tip.measured_at is None and tip.j is None for tip in reply.tips)
    # On the far border it is measured, but waits to be moved.
    extend(service, (6 * MM, 0.2 * MM))
    reply = advance(service, 40)
    assert {event.kind for event in reply.events} <= {"reached_overlap"}
    assert reply.tips[0].hoop_stress is not None and reply.tips[0].length == pytest.approx(23 * MM)
    extend(service, (7 * MM, 0.2 * MM))
    reply = advance(service, 200)
    assert "growth" in [event.kind for event in reply.events] and reply.tips[0].length > 24 * MM


def test_the_way_to_a_polygon() -> None:
    corner = np.array([(0.0, 0.0), (2.0, 0.0), (2.0, 1.0), (1.0, 1.0), (1.0, 2.0), (0.0, 2.0)])
    for border in (corner, corner[::-1]):
        assert distance_outside(border, np.array([0.5, 1.5])) == pytest.approx(-0.5)
        assert distance_outside(border, np.array([1.5, 1.75])) == pytest.approx(0.5)
        assert distance_outside(border, np.array([1.0, 1.5])) == pytest.approx(0.0)
        right = np.array([2.0, 0.0])
        assert way_before(border, np.array([-1.0, 0.5]), right) == pytest.approx(0.5)
        assert way_before(border, np.array([-2.5, 0.5]), right) == 1.0
        # From the border inwards nothing, along it or off it everything; into the notch and out again, too.
        assert way_before(border, np.array([0.0, 0.5]), right) == 0.0
        assert way_before(border, np.array([1.0, 1.5]), right) == 1.0
        assert way_before(border, np.array([1.0, 1.0]), right) == 1.0
        assert way_before(border, np.array([1.5, 1.5]), np.array([0.0, -1.0])) == pytest.approx(0.5)


def singular(tip_x: float, hole: float = np.inf) -> tuple[FractureFields, TipFrame]:
    """Points of a unit lattice, 2 x 2 a cell, in Williams' mode I field (plane stress); none beyond x = ``hole``."""
    line = (np.arange(-20, 20) + 0.5) / 2.0
    x, y = (a.ravel() for a in np.meshgrid(line, line, indexing="ij"))
    position = np.stack([x, y], axis=1)[x < hole]
    _, shear, kappa = plane_constants(E, NU, True)
    tip = TipFrame(np.array([tip_x, 0.0]), np.array([1.0, 0.0]))
    gradient = tip_gradient(tip.local(position), K, 0.0, shear, kappa)
    strain = 0.5 * (gradient + gradient.transpose(0, 2, 1))
    lame = shear * (3.0 - kappa) / (kappa - 1.0)
    stress = lame * np.trace(strain, axis1=1, axis2=2)[:, None, None] * np.eye(2) + 2.0 * shear * strain
    area = np.full(position.shape[0], 0.25)
    energy = 0.5 * np.sum(stress * strain, axis=(1, 2)) * area
    return (
        FractureFields(position, gradient, stress, energy, np.zeros_like(position), RHO * area, area, np.eye(2)),
        tip,
    )


@pytest.mark.parametrize("tip_x", [0.0, 0.25, 0.6])
@pytest.mark.parametrize("room", [2.0, 3.0, 4.0, 6.0])
def test_j_is_right_as_long_as_the_smallest_ring_fits_before_the_hole(tip_x: float, room: float) -> None:
    """Of the exact field; J = K^2/E. The largest ring that fits is taken, as growth does."""
    fields, tip = singular(tip_x, hole=np.ceil(tip_x + room))
    found = []
    for inner, outer in RINGS:
        try:
            found.append(j_integral(fields, tip, inner, outer))
        except ValueError:
            continue
    assert found[0] == pytest.approx(K**2 / E, rel=0.03)


def test_no_ring_fits_nearer_to_the_hole() -> None:
    fields, tip = singular(0.0, hole=1.0)
    for inner, outer in RINGS:
        with pytest.raises(ValueError, match="does not lie in the body"):
            j_integral(fields, tip, inner, outer)


@pytest.mark.parametrize("tip_x", [0.0, 0.25, 0.5])
def test_stress_one_cell_ahead_is_the_singular_field_s_mean_there(tip_x: float) -> None:
    """Closed form: K_I/sqrt(2 pi r) cos(t/2) (1 + sin(t/2) sin(3t/2)), in the mean over the hat, by fine quadrature.

    Behind the far border of an overlap, with its hole where the tip comes from, and in front of the near one, where
    the ring is two cells wide: points of the hole play no part in either.
    """
    line = (np.arange(800) + 0.5) / 400.0 - 1.0
    x, y = np.meshgrid(line, line, indexing="ij")
    share = (1.0 - np.abs(x)) * (1.0 - np.abs(y))
    r, t = np.hypot(x + 1.0, y), np.arctan2(y, x + 1.0)
    exact = K / np.sqrt(2.0 * np.pi * r) * np.cos(0.5 * t) * (1.0 + np.sin(0.5 * t) * np.sin(1.5 * t))
    mean = float((share * exact).sum() / share.sum())
    for hole in (np.inf, np.floor(tip_x) + 2.5):
        fields, tip = singular(tip_x, hole)
        assert stress_ahead(fields, tip, 1.0, 0.0, 1.0)[0] == pytest.approx(mean, rel=0.03)
