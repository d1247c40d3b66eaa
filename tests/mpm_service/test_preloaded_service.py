"""The service: static preloads, crack-tip fields, probes, and anchors that start where a preload has put them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mpm_service.elastic import IsotropicElastic
from mpm_service.fracture import TipFrame, fields_around, j_integral
from mpm_service.k_field import CrackTipField
from mpm_service.service import MaterialPointService, make_service
from protocol import continuum as c
from protocol.errors import ProtocolError
from protocol.messages import CheckpointReply, Empty, FieldsRequest, RestoreRequest

FloatArray = NDArray[np.float64]
YOUNG, POISSON, DENSITY = 1e9, 0.25, 1e3
LAW = IsotropicElastic(YOUNG, POISSON, DENSITY, "plane_stress")
STATIC = c.Preload(tolerance=1e-8, max_steps=20, method="static")
PULL = [
    c.EdgeTraction(edge=edge, component=1, times=[0.0], tractions=[sign * 1e3])
    for edge, sign in (("top", 1.0), ("bottom", -1.0))
]
RING = c.Overlap(
    inner=c.Rectangle(lower=(-2.0, -2.0), upper=(2.0, 2.0)), outer=c.Rectangle(lower=(-4.0, -4.0), upper=(4.0, 4.0)),
    weight=0.2,
)  # fmt: skip


def square(**changes: Any) -> c.ContinuumConfigure:
    """A square of 24 cells of 1 m, around the origin."""
    values: dict[str, Any] = {
        "assumption": "plane_stress", "thickness": 0.5, "body": c.Rectangle(lower=(-12.0, -12.0), upper=(12.0, 12.0)),
        "cell_size": 1.0, "points_per_cell": 2,
        "material": c.IsotropicMaterial(young=YOUNG, poisson=POISSON, density=DENSITY),
        "time_step": 0.4 / LAW.pressure_wave_speed,
    }  # fmt: skip
    return c.ContinuumConfigure.model_validate({**values, **changes})


def configured(tmp_path: Path, **changes: Any) -> tuple[MaterialPointService, c.ContinuumConfigured]:
    service = make_service(tmp_path)
    return service, service.configure(square(**changes))


def with_z(places: FloatArray) -> FloatArray:
    return np.column_stack([places, np.zeros(len(places))])


def fields(service: MaterialPointService, *names: str) -> list[FloatArray]:
    found = service.fields(FieldsRequest(names=list(names))).fields
    return [found[name] for name in names]


def strained(place: FloatArray) -> FloatArray:
    """Displacement of the square under `PULL` without holes or cracks."""
    return place * (-POISSON * 1e-6, 1e-6)


def test_a_body_with_a_hole_starts_from_the_state_of_the_whole_one(tmp_path: Path) -> None:
    probes = np.array([[0.3, -0.2], [1.9, 1.1], [3.2, 0.0], [-11.5, 11.5]])
    service, built = configured(tmp_path, edges=PULL, overlap=RING, preload=STATIC, probe_position=with_z(probes))
    assert built.relaxation is not None and built.relaxation.converged and built.relaxation.steps <= 5
    assert built.probe_displacement is not None
    np.testing.assert_allclose(built.probe_displacement, with_z(strained(probes)), atol=1e-10)
    assert np.min(np.abs(built.position).max(axis=1)) > 2.0
    assert np.isclose(built.weight.min(), 0.2)
    moved, stress, velocity = fields(service, "displacement", "stress", "velocity")
    np.testing.assert_allclose(moved[:, :2], strained(built.position[:, :2]), atol=1e-10)
    np.testing.assert_allclose(stress, np.broadcast_to([0.0, 1e3, 0.0], stress.shape), atol=1e-2)
    assert not velocity.any()


def test_probes_beside_a_crack_move_with_their_side(tmp_path: Path) -> None:
    crack = c.CrackLine(points=[(-13.0, 0.0), (0.0, 0.0)])
    probes = np.array([[-11.9, 0.01], [-11.9, -0.01], [-0.3, 0.01], [-0.3, -0.01]])
    changes: dict[str, Any] = {"edges": PULL, "cracks": [crack], "probe_position": with_z(probes)}
    _, whole = configured(tmp_path, preload=STATIC, **changes)
    _, cut = configured(tmp_path, preload=STATIC, overlap=RING, **changes)
    for built in (whole, cut):
        assert built.probe_displacement is not None
        up, down, near_up, near_down = built.probe_displacement[:, 1]
        # Tada: opening at the mouth of an edge crack of half the width, 4 sigma a V/E; a square plate opens more
        mouth = 4.0 * 1e3 * 12.0 / YOUNG * (1.46 + 3.42 * (1.0 - np.sqrt(0.5))) / 0.5
        assert 1.0 < (up - down) / mouth < 1.4
        np.testing.assert_allclose(up, -down, rtol=0.03)  # the crack lies on a row of nodes, which are on one side
        assert 0.0 < near_up - near_down < 0.5 * (up - down)
    np.testing.assert_array_equal(whole.probe_displacement, cut.probe_displacement)


def test_relaxation_too_is_of_the_whole_body(tmp_path: Path) -> None:
    probes = with_z(np.array([[0.3, -0.2], [3.2, 0.0]]))
    preload = c.Preload(tolerance=1e-3, max_steps=3000)
    scheme = c.Scheme(transfer="flip", integration="usl")
    _, built = configured(tmp_path, edges=PULL, overlap=RING, preload=preload, probe_position=probes, scheme=scheme)
    assert built.relaxation is not None and built.relaxation.converged
    assert built.probe_displacement is not None
    np.testing.assert_allclose(built.probe_displacement, with_z(strained(probes[:, :2])), atol=2e-8)


def test_a_relaxed_body_has_the_displacement_of_its_edges_at_time_zero(tmp_path: Path) -> None:
    edges = [
        c.EdgeSymmetry(edge="bottom"),
        c.EdgeCondition(edge="top", component=1, times=[0.0, 1.0], displacements=[2.4e-5, 2.4e-5]),
    ]
    scheme = c.Scheme(transfer="flip", integration="usl")
    for preload in (c.Preload(tolerance=1e-3, max_steps=5000), STATIC):
        service, built = configured(tmp_path, edges=edges, preload=preload, scheme=scheme)
        assert built.relaxation is not None and built.relaxation.converged
        stress = fields(service, "stress")[0]
        np.testing.assert_allclose(stress[:, 1], 1e3, rtol=0.02)
        reply = service.advance(c.ContinuumAdvance(steps=20))
        assert reply.edge_displacement.tolist() == [0.0, 2.4e-5]
        assert reply.edge_force[1] == pytest.approx(1e3 * 24.0 * 0.5, rel=0.02)


def test_anchors_go_on_from_where_the_preload_has_put_them(tmp_path: Path) -> None:
    anchors = np.array([[3.1, 0.2], [-3.3, 2.9]])
    held = [c.EdgeSymmetry(edge="left"), c.EdgeSymmetry(edge="bottom")]
    pull = [c.EdgeTraction(edge="top", component=1, times=[0.0], tractions=[1e7])]  # a strain of 1 %
    service, built = configured(tmp_path, edges=held + pull, preload=STATIC, probe_position=with_z(anchors))
    assert built.probe_displacement is not None
    assert np.abs(built.probe_displacement).max() > 0.1
    service.register(c.ContinuumRegister(
        anchor_position=with_z(anchors), anchor_ivc=np.array([0, 0]), ivc_lower=np.full((1, 3), -5.0),
        ivc_upper=np.full((1, 3), 5.0), anchor_displacement=built.probe_displacement,
    ))  # fmt: skip
    reply = service.advance(c.ContinuumAdvance(steps=50))
    np.testing.assert_allclose(reply.anchor_displacement, built.probe_displacement, atol=1e-6)
    # a force on an anchor acts where it is now: half a cell further on its moment would be another
    before = fields(service, "velocity")[0]
    force = np.array([[0.0, 1e4, 0.0], [0.0, 0.0, 0.0]])
    service.advance(c.ContinuumAdvance(steps=1, anchor_force=force))
    gained = fields(service, "velocity")[0] - before
    position = fields(service, "position")[0]
    mass = DENSITY * 0.5 * 0.25
    centre = np.sum(gained[:, 1] * position[:, 0]) / np.sum(gained[:, 1])
    assert np.sum(mass * gained[:, 1]) == pytest.approx(1e4 * square().time_step, rel=1e-3)
    assert centre == pytest.approx(anchors[0, 0] + built.probe_displacement[0, 0], abs=1e-3)


def test_a_preloaded_run_is_saved_and_restored_exactly(tmp_path: Path) -> None:
    changes: dict[str, Any] = {
        "edges": PULL, "overlap": RING, "preload": STATIC, "cracks": [c.CrackLine(points=[(-13.0, 0.0), (-1.0, 0.0)])],
    }  # fmt: skip
    service, _ = configured(tmp_path, **changes)
    service.advance(c.ContinuumAdvance(steps=3))
    saved: CheckpointReply = service.checkpoint(Empty())
    service.advance(c.ContinuumAdvance(steps=5))
    once = fields(service, "position", "stress")
    other, _ = configured(tmp_path, **changes)
    other.restore(RestoreRequest(step=saved.step, state=saved.state))
    other.advance(c.ContinuumAdvance(steps=5))
    for a, b in zip(once, fields(other, "position", "stress"), strict=True):
        np.testing.assert_array_equal(a, b)


DAMPING = 0.2 * LAW.pressure_wave_speed / 24.0
FIELD = c.KField(tip=(0.0, 0.5), k_1=1e3, k_2=3e2)
CRACK = c.CrackLine(points=[(-13.0, 0.5), (0.0, 0.5)])


def closed_form() -> CrackTipField:
    return CrackTipField.in_material(LAW, FIELD.tip, FIELD.k_1, FIELD.k_2)


def test_an_initial_field_alone_is_the_closed_form(tmp_path: Path) -> None:
    probes = np.array([[-3.0, 0.6], [-3.0, 0.4], [1.0, 2.0]])
    service, built = configured(
        tmp_path, initial_field=FIELD, cracks=[CRACK], overlap=RING, probe_position=with_z(probes)
    )
    assert built.relaxation is None
    field = closed_form()
    assert built.probe_displacement is not None
    np.testing.assert_array_equal(built.probe_displacement[:, :2], field.displacement(probes))
    place = np.ascontiguousarray(built.position[:, :2])
    moved, stress = fields(service, "displacement", "stress")
    np.testing.assert_allclose(moved[:, :2], field.displacement(place), atol=1e-15)
    gradient = field.gradient(place)
    strain = np.stack([gradient[:, 0, 0], gradient[:, 1, 1], gradient[:, 0, 1] + gradient[:, 1, 0]], axis=1)
    np.testing.assert_allclose(stress, strain @ LAW.stiffness, atol=1e-9 * np.abs(stress).max())


def test_edges_that_follow_a_crack_tip_field_give_its_release_rate(tmp_path: Path) -> None:
    edges = [
        c.EdgeKField(edge=edge, field=FIELD, times=[0.0], factors=[2.0]) for edge in ("left", "right", "bottom", "top")
    ]
    service, built = configured(tmp_path, edges=edges, cracks=[CRACK], preload=STATIC)
    assert built.relaxation is not None and built.relaxation.converged
    solver = service._solver
    assert solver is not None and solver.cracks is not None
    tip = solver.cracks.tips[0]
    around = fields_around(solver.points, solver.thickness, tip.reference, 8.0)
    found = j_integral(around, TipFrame(tip.reference, tip.reference_direction), 1.5, 6.0)
    assert found == pytest.approx(4.0 * (1e3**2 + 3e2**2) / YOUNG, rel=0.02)
    far = np.abs(built.position - (0.0, 0.5, 0.0)).max(axis=1) > 6.0
    exact = 2.0 * closed_form().displacement(np.ascontiguousarray(built.position[far, :2]))
    moved = fields(service, "displacement")[0][far, :2]
    np.testing.assert_allclose(moved, exact, atol=0.01 * np.abs(exact).max())
    strain_energy = solver.energies().strain
    reply = service.advance(c.ContinuumAdvance(steps=100))
    assert reply.kinetic_energy < 1e-12 * strain_energy


def test_edges_that_follow_a_growing_field_move_with_its_rate(tmp_path: Path) -> None:
    """From rest, factors 0 to 1 within a time in which waves cross several times."""
    steps = 200
    time_step = square().time_step
    edges = [
        c.EdgeKField(edge=edge, field=FIELD, times=[0.0, steps * time_step], factors=[0.0, 1.0])
        for edge in ("left", "right", "bottom", "top")
    ]
    service, built = configured(
        tmp_path, edges=edges, cracks=[CRACK], damping_rate=0.2 * LAW.pressure_wave_speed / 24.0
    )
    reply = service.advance(c.ContinuumAdvance(steps=steps))
    near = np.abs(built.position).max(axis=1) > 11.5
    exact = closed_form().displacement(np.ascontiguousarray(built.position[near, :2]))
    moved = fields(service, "displacement")[0][near, :2]
    np.testing.assert_allclose(moved, exact, atol=0.02 * np.abs(exact).max())
    assert reply.edge_work > 0.0


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"initial_field": FIELD}, "initial_field"),
        ({"edges": [c.EdgeKField(edge="left", field=FIELD, times=[0.0], factors=[1.0])]}, "edges.0.field"),
    ],
)
def test_a_field_in_another_material_is_refused(tmp_path: Path, changes: dict[str, Any], field: str) -> None:
    material = c.NeoHookeanMaterial(law="neo_hookean", young=YOUNG, poisson=POISSON, density=DENSITY)
    with pytest.raises(ProtocolError, match="isotropic") as caught:
        configured(tmp_path, material=material, **changes)
    assert caught.value.report.code == "bad_field"
    assert caught.value.report.field == field


def test_a_static_preload_of_a_plastic_body_is_refused(tmp_path: Path) -> None:
    material = c.J2PlasticityMaterial(
        law="j2_plasticity", young=YOUNG, poisson=POISSON, density=DENSITY, yield_stress=1e6
    )
    with pytest.raises(ProtocolError, match="no tangent") as caught:
        configured(tmp_path, material=material, edges=PULL, preload=STATIC)
    assert caught.value.report.field == "material"


def test_a_probe_outside_the_body_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ProtocolError, match="probe_position row 1") as caught:
        configured(tmp_path, probe_position=np.array([[0.0, 0.0, 0.0], [12.5, 0.0, 0.0]]))
    assert caught.value.report.field == "probe_position"


def test_probes_of_a_body_at_rest_do_not_move(tmp_path: Path) -> None:
    _, built = configured(tmp_path, probe_position=np.zeros((2, 3)))
    assert built.probe_displacement is not None
    assert built.probe_displacement.shape == (2, 3)
    assert not built.probe_displacement.any()
