"""The service: what each part of a request does to the body, told by the replies alone."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mpm_service.service import MaterialPointService, ReferenceService, make_service
from protocol import continuum as c
from protocol.conformance_problems import continuum_problem
from protocol.errors import ProtocolError
from protocol.messages import Empty, FieldsRequest, RestoreRequest

YOUNG, DENSITY, THICKNESS = 1e9, 1e3, 0.01
SPEED = (YOUNG / DENSITY) ** 0.5
CELL = 0.1


def bar(**changes: Any) -> c.ContinuumConfigure:
    """A bar of 20 x 2 cells without contraction, held at its left end."""
    values: dict[str, Any] = {
        "assumption": "plane_stress", "thickness": THICKNESS, "body": c.Rectangle(lower=(0.0, 0.0), upper=(2.0, 0.2)),
        "cell_size": CELL, "points_per_cell": 2,
        "material": c.IsotropicMaterial(young=YOUNG, poisson=0.0, density=DENSITY),
        "edges": [c.EdgeSymmetry(edge="left")], "time_step": 0.4 * CELL / SPEED,
    }  # fmt: skip
    return c.ContinuumConfigure.model_validate({**values, **changes})


Configured = Callable[..., tuple[MaterialPointService, c.ContinuumConfigured]]


@pytest.fixture
def configured(tmp_path: Path) -> Configured:
    def configure(**changes: Any) -> tuple[MaterialPointService, c.ContinuumConfigured]:
        service = make_service(tmp_path)
        return service, service.configure(bar(**changes))

    return configure


def advance(service: MaterialPointService, steps: int) -> c.ContinuumAdvanced:
    return service.advance(c.ContinuumAdvance(steps=steps))


def fields(service: MaterialPointService, *names: str) -> dict[str, np.ndarray]:
    return service.fields(FieldsRequest(names=list(names))).fields


PULL = c.EdgeTraction(edge="right", component=0, times=[0.0], tractions=[1e4])


def test_a_preload_by_tractions_gives_the_static_stress(configured: Configured) -> None:
    preload = c.Preload(tolerance=1e-8, max_steps=5000)
    service, built = configured(edges=[c.EdgeSymmetry(edge="left"), PULL], preload=preload)
    assert built.relaxation is not None and built.relaxation.converged
    assert 0 < built.relaxation.residual <= 1e-8 and 0 < built.relaxation.steps < 5000
    assert service.step == 0
    stress = fields(service, "stress")["stress"]
    np.testing.assert_allclose(stress[:, 0], 1e4, rtol=1e-5)
    np.testing.assert_allclose(stress[:, 1:], 0.0, atol=1e-1)
    moved = fields(service, "position", "displacement")
    # points near the loaded edge are shifted against each other by what the nodes cannot see
    np.testing.assert_allclose(moved["displacement"][:, 0], 1e4 / YOUNG * moved["position"][:, 0], rtol=0.02)
    # it stays in balance, and the symmetric edge holds against the pull
    reply = advance(service, 50)
    force = 1e4 * 0.2 * THICKNESS
    np.testing.assert_allclose(reply.edge_force, [-force, force], rtol=1e-4)
    assert reply.step == 50
    assert reply.kinetic_energy < 1e-9 * reply.strain_energy
    assert reply.strain_energy == pytest.approx(0.5 * force * 1e4 / YOUNG * 2.0, rel=1e-4)
    # works count from the first step, not from the preload
    assert abs(reply.load_work) < 1e-3 * reply.strain_energy


def test_a_preload_that_does_not_end_says_so(configured: Configured) -> None:
    preload = c.Preload(tolerance=1e-9, max_steps=7)
    _, built = configured(edges=[c.EdgeSymmetry(edge="left"), PULL], preload=preload)
    assert built.relaxation is not None
    assert (built.relaxation.converged, built.relaxation.steps) == (False, 7)
    assert built.relaxation.residual > 1e-9


def test_after_a_preload_the_body_starts_with_the_velocity_asked_for(configured: Configured) -> None:
    service, _ = configured(
        preload=c.Preload(tolerance=1e-6, max_steps=5), initial_velocity_gradient=(2.0, 0.0, 0.0, 0.0)
    )
    found = fields(service, "position", "velocity")
    np.testing.assert_allclose(found["velocity"][:, 0], 2.0 * found["position"][:, 0], rtol=1e-9)


def test_energy_is_what_the_loads_gave(configured: Configured) -> None:
    service, _ = configured(
        edges=[c.EdgeSymmetry(edge="left"), PULL], body_force=c.BodyForce(acceleration=(3.0, 0.0)),
        scheme=c.Scheme(transfer="flip"), time_step=0.05 * CELL / SPEED,
    )  # fmt: skip
    reply = advance(service, 200)
    held = reply.kinetic_energy + reply.strain_energy
    assert reply.load_work > 0 and reply.edge_work == pytest.approx(0.0, abs=1e-12)
    assert held == pytest.approx(reply.load_work, rel=0.02)


def test_pressure_pushes_and_traction_pulls(configured: Configured) -> None:
    ends = {}
    for edge in (PULL, c.EdgePressure(edge="right", times=[0.0], pressures=[1e4])):
        service, _ = configured(edges=[c.EdgeSymmetry(edge="left"), edge])
        reply = advance(service, 20)
        ends[edge.kind] = fields(service, "displacement")["displacement"][:, 0].max(), reply.edge_force[1]
        ends[edge.kind + " low"] = fields(service, "displacement")["displacement"][:, 0].min(), 0.0
    force = 1e4 * 0.2 * THICKNESS
    assert ends["traction"][1] == pytest.approx(force) and ends["pressure"][1] == pytest.approx(-force)
    assert ends["traction"][0] == pytest.approx(-ends["pressure low"][0], rel=1e-4)
    assert ends["traction"][0] > 0.0


def test_an_absorbing_edge_lets_the_wave_leave(configured: Configured) -> None:
    """A bar that moves as a whole is stopped by matched ends: its energy goes into the dashpots."""
    left = {}
    for kind, edges in (("free", []), ("absorbing", [c.EdgeAbsorbing(edge="left"), c.EdgeAbsorbing(edge="right")])):
        service, _ = configured(edges=edges, initial_velocity_gradient=(5.0, 0.0, 0.0, 0.0))
        before = advance(service, 1)
        after = advance(service, 200)
        start = before.kinetic_energy + before.strain_energy
        left[kind] = (after.kinetic_energy + after.strain_energy) / start, after.load_work / start
    assert left["free"][0] > 0.9 and left["free"][1] == 0.0
    # what is left moves as a whole: matched dashpots stop the waves, then the rigid motion fades
    assert left["absorbing"][0] < 0.02
    assert left["absorbing"][1] < -0.9


def test_an_edge_with_a_velocity_moves_with_it(configured: Configured) -> None:
    velocity = c.EdgeVelocity(edge="right", component=0, times=[0.0, 1e-3], velocities=[0.0, 1.0])
    service, _ = configured(edges=[c.EdgeSymmetry(edge="left"), velocity])
    reply = advance(service, 100)
    time = 100 * 0.4 * CELL / SPEED
    assert time > 1e-3
    expected = 0.5 * 1e-3 + (time - 1e-3)
    np.testing.assert_allclose(reply.edge_displacement, [0.0, expected], rtol=1e-12)
    assert fields(service, "displacement")["displacement"][:, 0].max() == pytest.approx(expected, rel=0.05)


def test_damping_of_points_is_that_of_the_grid(configured: Configured) -> None:
    """Both rates stop a free body as exp(-c t)."""
    kept = {}
    for name in ("damping_rate", "point_damping_rate"):
        service, _ = configured(edges=[], initial_velocity_gradient=(1.0, 0.0, 0.0, 0.0), **{name: 100.0})
        one = advance(service, 1)
        first = one.kinetic_energy + one.strain_energy + one.damping_loss
        many = advance(service, 99)
        kept[name] = many.damping_loss / first
    assert kept["damping_rate"] == pytest.approx(kept["point_damping_rate"], rel=0.05)
    assert 0.1 < kept["damping_rate"] < 0.9


def test_force_scaling_slows_a_vibration(configured: Configured) -> None:
    """A quarter of the force is half the frequency: half the time, the same place."""
    shapes = []
    for scaling, steps in ((0.0, 500), (0.75, 1000)):
        service, _ = configured(
            edges=[c.EdgeSymmetry(edge="left"), PULL], force_scaling=scaling, scheme=c.Scheme(transfer="flip"),
            time_step=0.02 * CELL / SPEED,
        )  # fmt: skip
        advance(service, steps)
        shapes.append(fields(service, "displacement")["displacement"][:, 0])
    np.testing.assert_allclose(shapes[1], shapes[0], atol=0.01 * shapes[0].max())


def test_levels_are_told_and_split_points_are_appended(configured: Configured) -> None:
    """A body slides into its finer level: points are split, the first rows stay those of configure."""
    kick = c.BodyForce(acceleration=(20.0 / (0.4 * CELL / SPEED), 0.0), times=[0.0, 1e-12], factors=[1.0, 0.0])
    sliding: dict[str, Any] = {
        "body": c.Rectangle(lower=(0.0, -0.2), upper=(2.0, 0.4)), "edges": [], "body_force": kick,
        "refinement": [c.Rectangle(lower=(0.8, 0.0), upper=(1.6, 0.2))], "time_step": 0.2 * CELL / SPEED,
    }  # fmt: skip
    service, built = configured(**sliding)
    assert [level.cell_size for level in built.levels] == [CELL, CELL / 2]
    assert [level.cells for level in built.levels] == [20 * 6 - 8 * 2, 16 * 4]
    assert sum(level.points for level in built.levels) == len(built.position) == 4 * built.cells
    mass = DENSITY * THICKNESS * 2.0 * 0.6
    steps = 0
    while len(found := fields(service, "position", "weight", "velocity")["position"]) == len(built.position):
        reply = advance(service, 20)
        steps += 20
        assert steps < 2000, "no point was ever split"
    assert (len(found) - len(built.position)) % 3 == 0
    moved = found[: len(built.position)] - built.position
    np.testing.assert_allclose(moved[:, 0], moved[:, 0].mean(), atol=0.6 * CELL / 2)
    momentum_energy = 0.5 * mass * fields(service, "velocity")["velocity"][:, 0].mean() ** 2
    assert reply.kinetic_energy == pytest.approx(momentum_energy, rel=1e-6)
    saved = service.checkpoint(Empty())
    other = MaterialPointService()
    other.configure(bar(**sliding))
    other.restore(RestoreRequest(step=saved.step, state=saved.state))
    one, two = advance(service, 30), advance(other, 30)
    assert one.plain_values() == two.plain_values()
    np.testing.assert_array_equal(fields(service, "stress")["stress"], fields(other, "stress")["stress"])


@pytest.mark.parametrize("word", ["continue", "stop"])
def test_points_that_leave_the_grid(configured: Configured, word: str) -> None:
    """A bar thrown out of its grid: the run goes on and tells of it, or ends, as asked."""
    service, _ = configured(
        edges=[], on_lost_points=word, time_step=0.1 * CELL / SPEED, body_force=c.BodyForce(acceleration=(1e6, 0.0))
    )  # fmt: skip
    if word == "stop":
        with pytest.raises(ProtocolError, match="on_lost_points is stop") as caught:
            advance(service, 2000)
        assert caught.value.code == "solver_failed" and caught.value.report.step == service.step > 0
        return
    events = []
    for _ in range(40):
        reply = advance(service, 25)
        events += reply.events
        if reply.points_lost:
            break
    assert reply.points_lost > 0
    assert [event.kind for event in events] == ["points_lost"]
    assert sum(event.count or 0 for event in events) == reply.points_lost
    assert "left the grid" in events[0].sentence


def test_tips_of_several_cracks(configured: Configured) -> None:
    cracks = [
        c.CrackLine(points=[(-0.5, 0.11), (0.52, 0.11)]),
        c.CrackLine(points=[(1.13, 0.09), (1.4, 0.12), (1.62, 0.12)], contact="stick"),
    ]
    service, _ = configured(cracks=cracks)
    tips = advance(service, 3).tips
    assert [(tip.crack, tip.end) for tip in tips] == [(0, 1), (1, 0), (1, 1)]
    np.testing.assert_allclose([tip.position for tip in tips], [(0.52, 0.11), (1.13, 0.09), (1.62, 0.12)], atol=1e-9)
    assert tips[0].length == pytest.approx(1.02)
    assert tips[1].length == tips[2].length == pytest.approx(np.hypot(0.27, 0.03) + 0.22)
    assert all(tip.j is None and tip.measured_at is None for tip in tips)


@pytest.mark.parametrize(
    ("changes", "code", "field", "said"),
    [
        ({"time_step": 1.0}, "bad_field", "time_step", "at most"),
        ({"cell_size": 0.15}, "bad_field", "body", "cell line"),
        ({"refinement": [c.Rectangle(lower=(0.33, 0.0), upper=(1.0, 0.2))]}, "bad_field", "refinement", "cell line"),
        ({"cracks": [c.CrackLine(points=[(0.0, 0.1), (0.5, 0.1), (0.2, 0.1)])]}, "bad_field", "cracks", "turns"),
        ({"edges": [c.EdgeSymmetry(edge="left"), c.EdgeSymmetry(edge="left")]}, "bad_field", "edges", "already"),
        ({"scheme": c.Scheme(interpolation="bspline"),
          "refinement": [c.Rectangle(lower=(0.4, 0.0), upper=(1.0, 0.2))]}, "bad_field", "scheme", "uniform grid"),
        ({"material": c.OrthotropicMaterial(
            young_1=1e9, young_2=1e9, young_3=1e9, poisson_12=1.5, poisson_13=0.0, poisson_23=0.0, shear_12=1e8,
            density=1e3)}, "bad_field", "material.poisson_12", "magnitude"),
    ],
)  # fmt: skip
def test_what_the_solver_refuses_names_the_field_of_the_message(
    configured: Configured, changes: dict[str, Any], code: str, field: str, said: str
) -> None:
    with pytest.raises(ProtocolError) as caught:
        configured(**changes)
    assert (caught.value.code, caught.value.report.field) == (code, field), caught.value
    assert said in caught.value.report.sentence


def test_an_aborted_preload_ends_soon(configured: Configured) -> None:
    service = MaterialPointService()
    service.activity.begin("configure")
    service.activity.abort.set()
    with pytest.raises(ProtocolError) as caught:
        service.configure(bar(edges=[PULL], preload=c.Preload(tolerance=1e-12, max_steps=10**9)))
    assert caught.value.code == "aborted"


@pytest.mark.parametrize("kind", [MaterialPointService, ReferenceService])
def test_a_refused_register_changes_nothing(kind: type[MaterialPointService]) -> None:
    """The anchors are right, one cell is empty: the anchors of before stay, and so does what comes of their forces."""
    replies = []
    for wrong in (False, True):
        service = kind()
        service.configure(bar())
        good = c.ContinuumRegister(
            anchor_position=np.array([[0.5, 0.1, 0.0]]), anchor_ivc=np.zeros(1, np.int64),
            ivc_lower=np.array([[0.3, 0.0, 0.0]]), ivc_upper=np.array([[0.7, 0.2, 0.0]]),
        )  # fmt: skip
        service.register(good)
        if wrong:
            shifted = good.model_copy(
                update={"anchor_position": good.anchor_position + np.array([0.7, 0.0, 0.0]),
                        "ivc_lower": good.ivc_lower + 5.0, "ivc_upper": good.ivc_upper + 5.0}
            )  # fmt: skip
            with pytest.raises(ProtocolError) as caught:
                service.register(shifted)
            assert caught.value.report.field == "ivc_lower"
        replies.append(service.advance(c.ContinuumAdvance(steps=5, anchor_force=np.array([[1.0, 0.0, 0.0]]))))
    np.testing.assert_array_equal(replies[0].anchor_displacement, replies[1].anchor_displacement)
    assert replies[0].anchor_displacement[0, 0] > 0
    assert replies[0].plain_values() == replies[1].plain_values()


def test_both_backends_answer_the_same() -> None:
    """The conformance problem: a hole, a ring of weight, anchors, cells, moving edges, damping; over the messages."""
    problem = continuum_problem()
    replies = []
    for kind in (MaterialPointService, ReferenceService):
        service = kind()
        service.configure(problem.request("configure"))
        service.register(problem.request("register"))
        for number in range(6):
            reply = service.advance(problem.advance(number))
        replies.append((reply, fields(service, "position", "stress", "velocity", "weight")))
    (one, points), (two, others) = replies
    for name, array in one.array_values().items():
        np.testing.assert_allclose(array, getattr(two, name), atol=1e-12 * np.abs(array).max(initial=0.0), err_msg=name)
    for name, value in points.items():
        np.testing.assert_allclose(value, others[name], atol=1e-12 * np.abs(value).max(), err_msg=name)
    for name in ("kinetic_energy", "strain_energy", "edge_work", "interface_work", "damping_loss"):
        assert getattr(one, name) == pytest.approx(getattr(two, name), rel=1e-11), name


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"refinement": [c.Rectangle(lower=(0.4, 0.0), upper=(1.0, 0.2))]}, "refinement"),
        ({"edges": [PULL]}, "edges.0.kind"),
        ({"cracks": [c.CrackLine(points=[(-0.5, 0.1), (0.5, 0.1)], contact="stick")]}, "cracks.0.contact"),
        ({"cracks": [c.CrackLine(points=[(-0.5, 0.1), (0.5, 0.1)], measure_every=5)]}, "cracks.0.measure_every"),
        ({"body_force": c.BodyForce(acceleration=(1.0, 0.0))}, "body_force"),
        ({"preload": c.Preload(tolerance=0.1, max_steps=5)}, "preload"),
    ],
)
def test_the_reference_says_what_it_does_not_have(changes: dict[str, Any], field: str) -> None:
    with pytest.raises(ProtocolError) as caught:
        ReferenceService().configure(bar(**changes))
    assert (caught.value.code, caught.value.report.field) == ("unsupported", field)


def test_a_checkpoint_of_a_cracked_body_travels_and_goes_on_the_same(configured: Configured) -> None:
    crack = c.CrackLine(points=[(0.93, -0.1), (0.93, 0.11)], contact="coulomb", friction=0.3)
    service, _ = configured(cracks=[crack], edges=[c.EdgeSymmetry(edge="left"), PULL])
    advance(service, 20)
    saved = service.checkpoint(Empty())  # refuses what is no array of the wire
    request = RestoreRequest.from_parts(
        {"step": saved.step}, {name: array.copy() for name, array in saved.array_values().items()}
    )
    went_on = advance(service, 30)
    other = make_service(Path())
    other.configure(bar(cracks=[crack], edges=[c.EdgeSymmetry(edge="left"), PULL]))
    other.restore(request)
    again = advance(other, 30)
    assert again.plain_values() == went_on.plain_values()
    for name, array in fields(service, "position", "stress", "velocity").items():
        np.testing.assert_array_equal(array, fields(other, name)[name], err_msg=name)
