"""What the service tells of cracks: measurements, growth, arrest, and checkpoints between them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mpm_service.service import MaterialPointService, make_service
from protocol import continuum as c
from protocol.errors import ProtocolError
from protocol.messages import Empty, FieldsRequest, RestoreRequest


def advance(service: MaterialPointService, steps: int) -> c.ContinuumAdvanced:
    return service.advance(c.ContinuumAdvance(steps=steps))


def fields(service: MaterialPointService, *names: str) -> dict[str, np.ndarray]:
    return service.fields(FieldsRequest(names=list(names))).fields


def strip(**changes: Any) -> c.ContinuumConfigure:
    """A strip of 40 x 20 cells with a crack from its left edge to its middle, pulled at a constant rate."""
    cell, height, rate = 1e-3, 20e-3, 40.0
    edge = 0.5 * rate * height
    values: dict[str, Any] = {
        "assumption": "plane_strain", "thickness": 1e-3,
        "body": c.Rectangle(lower=(0.0, -0.5 * height), upper=(40e-3, 0.5 * height)),
        "cell_size": cell, "points_per_cell": 2,
        "material": c.IsotropicMaterial(young=2.5e9, poisson=0.3, density=1200.0),
        "edges": [
            c.EdgeVelocity(edge="top", component=1, times=[0.0], velocities=[edge]),
            c.EdgeVelocity(edge="bottom", component=1, times=[0.0], velocities=[-edge]),
            c.EdgeCondition(edge="top", component=0, times=[0.0, 1.0], displacements=[0.0, 0.0]),
            c.EdgeCondition(edge="bottom", component=0, times=[0.0, 1.0], displacements=[0.0, 0.0]),
        ],
        "initial_velocity_gradient": (0.0, 0.0, 0.0, rate),
        "cracks": [c.CrackLine(points=[(-2e-3, 0.1e-3), (20e-3, 0.1e-3)], measure_every=20)],
        "time_step": 2.5e-7,
    }  # fmt: skip
    return c.ContinuumConfigure.model_validate({**values, **changes})


def growing(critical: float, rule: str = "straight") -> dict[str, Any]:
    growth = c.CrackGrowth(critical_energy_release_rate=critical, rule=rule, interval=20)  # type: ignore[arg-type]
    return {"cracks": [c.CrackLine(points=[(-2e-3, 0.1e-3), (20e-3, 0.1e-3)], growth=growth)]}


def test_a_measured_tip_tells_j_of_a_strip() -> None:
    """Rivlin and Thomas: energy density far ahead times height; the strip is short and the load not quite slow."""
    service = make_service(Path())
    service.configure(strip())
    assert advance(service, 19).tips[0].j is None
    reply = advance(service, 1)
    assert reply.tips[0].measured_at == 20
    reply = advance(service, 785)
    (tip,) = reply.tips
    assert tip.measured_at == 800
    strain = 40.0 * 800 * 2.5e-7
    stiff = 2.5e9 * 0.7 / (1.3 * 0.4)
    expected = 0.5 * stiff * strain**2 * 20e-3
    assert tip.j == pytest.approx(expected, rel=0.06)
    assert tip.k_1 is not None and tip.k_2 is not None and abs(tip.k_2) < 0.05 * tip.k_1
    assert tip.k_1 == pytest.approx((tip.j * 2.5e9 / 0.91) ** 0.5, rel=0.06)
    assert tip.g_1 is not None and tip.g_1 == pytest.approx(tip.j, rel=0.15)
    assert reply.events == []


def test_growth_begins_at_the_critical_release_rate_and_is_told() -> None:
    service = make_service(Path())
    service.configure(strip(**growing(200.0)))
    events: list[c.ContinuumEvent] = []
    start = None
    for _ in range(200):
        reply = advance(service, 10)
        start = reply.tips[0].length if start is None else start
        events += reply.events
        if len(events) == 3:
            break
    assert [event.kind for event in events] == ["growth"] * 3
    first = events[0]
    assert first.tip is not None and first.tip.j is not None
    assert 200.0 <= first.tip.j < 225.0 and f"J = {first.tip.j:.4g} J/m2" in first.sentence
    assert all(event.step % 20 == 0 for event in events)
    assert reply.tips[0].length == pytest.approx(start + 3 * 0.5e-3, rel=1e-9)
    assert first.tip.length == pytest.approx(start + 0.5e-3, rel=1e-9)
    np.testing.assert_allclose([t.tip.position[1] for t in events if t.tip], 0.1e-3, atol=0.05e-3)


def test_a_crack_that_is_unloaded_comes_to_rest() -> None:
    pull = c.EdgeVelocity(edge="top", component=1, times=[0.0, 7e-5, 7.5e-5], velocities=[0.4, 0.4, -4.0])
    others = strip().edges[1:]
    service = make_service(Path())
    service.configure(strip(edges=[pull, *others], **growing(200.0)))
    kinds: list[str] = []
    for _ in range(25):
        kinds += [event.kind for event in advance(service, 20).events]
        if "arrest" in kinds:
            break
    assert set(kinds[:-1]) == {"growth"} and kinds[-1] == "arrest"


def test_a_crack_that_runs_into_the_edge_comes_to_rest() -> None:
    service = make_service(Path())
    service.configure(strip(**growing(20.0)))
    events: list[c.ContinuumEvent] = []
    for _ in range(30):
        events += advance(service, 50).events
        if events and events[-1].kind == "arrest":
            break
    assert [event.kind for event in events[:-1]] == ["growth"] * (len(events) - 1)
    assert len(events) > 20 and events[-1].kind == "arrest" and "too near an edge" in events[-1].sentence


def test_step_by_step_measures_what_one_request_measures() -> None:
    """The coordinator advances by single steps; kinetic terms of J must not be lost between requests."""
    one, many = make_service(Path()), make_service(Path())
    moving = strip(initial_velocity_gradient=None)
    one.configure(moving)
    many.configure(moving)
    whole = advance(one, 100)
    for _ in range(100):
        last = advance(many, 1)
    assert last.tips == whole.tips
    assert whole.tips[0].measured_at == 100


@pytest.mark.parametrize("steps", [97, 98, 100, 103])
def test_a_checkpoint_between_measurements_goes_on_the_same(steps: int) -> None:
    problem = strip(**growing(20.0, "max_hoop"))
    service, other = make_service(Path()), make_service(Path())
    service.configure(problem)
    advance(service, 500 + steps)
    saved = service.checkpoint(Empty())
    other.configure(problem)
    other.restore(RestoreRequest(step=saved.step, state={name: a.copy() for name, a in saved.state.items()}))
    for count in (1, 60):
        assert advance(service, count).plain_values() == advance(other, count).plain_values()
    np.testing.assert_array_equal(fields(service, "stress")["stress"], fields(other, "stress")["stress"])
    for name in ("measured_tips", "growth_lost"):
        state = dict(saved.state)
        del state[name]
        with pytest.raises(ProtocolError) as caught:
            other.restore(RestoreRequest(step=saved.step, state=state))
        assert caught.value.report.field == "state"


def test_cracks_are_measured_at_one_interval() -> None:
    lines = [
        c.CrackLine(points=[(-2e-3, 0.1e-3), (10e-3, 0.1e-3)], measure_every=20),
        c.CrackLine(points=[(30e-3, 0.1e-3), (42e-3, 0.1e-3)], measure_every=10),
    ]
    with pytest.raises(ProtocolError) as caught:
        make_service(Path()).configure(strip(cracks=lines))
    assert (caught.value.code, caught.value.report.field) == ("unsupported", "cracks.1.measure_every")
    with pytest.raises(ProtocolError) as caught:
        make_service(Path()).configure(strip(cracks=[lines[0].model_copy(update={"measure_every": 2})]))
    assert (caught.value.code, caught.value.report.field) == ("bad_field", "cracks")
