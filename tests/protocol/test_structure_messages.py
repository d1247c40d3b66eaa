"""The role `structure`: rules of its messages, its states, and the cells that the conformance kit serves for it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from protocol import micromechanics as m
from protocol import structure as s
from protocol.channel import InProcessChannel
from protocol.client import Client
from protocol.conformance_cells import OneMaterialCells
from protocol.conformance_structure import KNOCK_DOWN, LIMIT, structure_cell, structure_problem
from protocol.dispatcher import Host, bad_field
from protocol.errors import ProtocolError
from protocol.frames import Envelope, decode, encode
from protocol.messages import newer_fields
from protocol.roles import CONFIGURED, ROLES
from protocol.version import Version

PROBLEM = structure_problem("ipc:///nobody")
CONFIGURE = PROBLEM.request("configure")


def arrived(message: Any) -> Any:
    envelope = Envelope("request", "configure", "1", message.plain_values(), message.array_values())
    got = decode([bytes(memoryview(frame)) for frame in encode(envelope)])
    return type(message).from_parts(got.body, got.arrays)


def refused(message: Any) -> ProtocolError:
    with pytest.raises(ValidationError) as caught:
        type(message).from_parts(message.plain_values(), message.array_values())
    return bad_field(caught.value, "configure")


def test_states_and_versions_of_the_operations() -> None:
    operations = ROLES["structure"].operations
    own = {name: one for name, one in operations.items() if name not in ("hello", "status", "shutdown")}
    assert {one.since for one in own.values()} == {Version(1, 4)}
    assert {name: one.leads_to for name, one in own.items()} == {
        "configure": "configured", "advance": "ready", "fields": None, "checkpoint": "ready", "restore": "ready",
    }  # fmt: skip
    assert all(one.allowed == CONFIGURED for name, one in own.items() if name != "configure")
    assert "failed" in own["configure"].allowed


def test_a_laminate_arrives_to_the_bit() -> None:
    whole = PROBLEM.whole[0][1]
    got = arrived(whole)
    assert got.plain_values() == whole.plain_values()
    for name, array in whole.array_values().items():
        assert getattr(got, name).tobytes() == array.tobytes()


def test_an_older_service_would_not_know_what_came_with_1_4() -> None:
    assert {"mesh", "increments"} <= set(newer_fields(CONFIGURE, Version(1, 3)))
    assert newer_fields(CONFIGURE, Version(1, 4)) == []


def test_an_older_service_would_not_know_what_came_with_1_5() -> None:
    nodes, elements = np.array([[0.0, 0.0], [1e-3, 0.0], [1e-3, 1e-3], [0.0, 1e-3]]), np.array([[0, 1, 2, 3]])
    steps = CONFIGURE.increments.model_copy(update={"viscosity": 1e-3})
    changed = CONFIGURE.model_copy(
        update={"plane_nodes": nodes, "plane_elements": elements, "increments": steps, "notch_diameter": 1e-3}
    )
    assert set(newer_fields(changed, Version(1, 4))) == {
        "plane_nodes", "plane_elements", "increments.viscosity", "notch_diameter",
    }  # fmt: skip
    assert newer_fields(changed, Version(1, 5)) == []
    assert newer_fields(s.StructureAdvance(watched=[3]), Version(1, 4)) == ["watched"]
    assert newer_fields(s.StructureAdvance(), Version(1, 4)) == []


@pytest.mark.parametrize(
    ("field", "changes"),
    [
        ("length", {"length": 0.0}),
        ("width", {"width": float("nan")}),
        ("hole_diameter", {"hole_diameter": -1e-3}),
        ("angles", {"angles": []}),
        ("angles.1", {"angles": [0.0, float("inf")]}),
        ("ply_thickness", {"ply_thickness": 0.0}),
        ("temperature", {"temperature": -1.0}),
        ("final_strain", {"final_strain": 0.0}),
        ("damage", {"damage": "some"}),
        ("mesh.around", {"mesh": s.PlateMesh.model_construct(around=0)}),
        ("mesh.growth", {"mesh": s.PlateMesh.model_construct(growth=0.0)}),
        ("mesh.beyond", {"mesh": s.PlateMesh.model_construct(beyond=-1)}),
        ("increments.least", {"increments": s.Increments.model_construct(least=0.0)}),
        ("increments.first", {"increments": s.Increments.model_construct(first=0.2, most=0.1)}),
        ("increments.first", {"increments": s.Increments.model_construct(first=1e-6)}),
        ("increments.viscosity", {"increments": s.Increments.model_construct(viscosity=-1e-3)}),
        ("increments.dissipation", {"increments": s.Increments.model_construct(dissipation=0.0)}),
        ("increments.dissipation", {"increments": s.Increments.model_construct(dissipation=1.0, viscosity=1e-3)}),
        ("notch_diameter", {"notch_diameter": 1e-3}),  # beside a hole
        ("plane_elements", {"plane_nodes": np.zeros((4, 2))}),
        ("plane_nodes", {"plane_elements": np.zeros((1, 4), np.int64)}),
        ("plane_nodes", {"plane_nodes": np.full((4, 2), np.nan), "plane_elements": np.zeros((1, 4), np.int64)}),
        ("plane_elements", {"plane_nodes": np.zeros((4, 2)), "plane_elements": np.array([[0, 1, 2, 4]])}),
        ("plane_elements", {"plane_nodes": np.zeros((4, 2)), "plane_elements": np.zeros((0, 4), np.int64)}),
        ("increments.tolerance", {"increments": s.Increments.model_construct(tolerance=0.0)}),
        ("heights", {"heights": np.zeros(1)}),
        ("phase", {"phase": np.ones((1, 1), np.int64)}),
    ],
)
def test_what_breaks_a_rule_is_named(field: str, changes: dict[str, Any]) -> None:
    error = refused(CONFIGURE.model_copy(update=changes))
    assert (error.code, error.report.field) == ("bad_field", field)


@pytest.mark.parametrize("largest", [0.0, -0.1, 1.1, float("nan")])
def test_an_increment_is_a_part_of_the_load(largest: float) -> None:
    assert refused(s.StructureAdvance.model_construct(largest=largest)).report.field == "largest"


@pytest.mark.parametrize("rule", PROBLEM.wrong, ids=lambda rule: rule.label)
def test_the_kits_wrong_requests_differ_from_its_right_one(rule: Any) -> None:
    if rule.operation == "configure":
        wrong, right = (
            (one.plain_values(), {name: array.tolist() for name, array in one.array_values().items()})
            for one in (rule.message, CONFIGURE)
        )
        assert wrong != right


# --- the cells that the kit serves -------------------------------------------------------------------------------


def test_the_kits_cells_are_elastic_then_knocked_down_and_keep_the_rules_of_tangents() -> None:
    client = Client(InProcessChannel(Host(OneMaterialCells())), "micromechanics")
    client.hello(5.0)
    name = client.call("register", structure_cell(), m.CellRegistered).cell
    strain = np.zeros((4, 6))
    strain[:, 0] = [0.5 * LIMIT, 2.0 * LIMIT, 0.1 * LIMIT, LIMIT]
    failed = np.array([[0], [0], [1], [0]], dtype=np.uint8)
    request = m.EvaluateRequest(cell=name, temperature=300.0, strain=strain, failed=failed)
    found = client.call("evaluate", request, m.Evaluated)
    stiffness = np.reshape(structure_cell().materials[0].stiffness[0], (6, 6))
    factors = np.array([1.0, KNOCK_DOWN, KNOCK_DOWN, KNOCK_DOWN])
    assert found.stress == pytest.approx(factors[:, None] * (strain @ stiffness), rel=1e-14)
    assert found.failed[:, 0].tolist() == [0, 1, 1, 1] and found.new_failures == 2
    assert found.tangent_index is not None and found.tangents is not None
    assert found.tangent_index.tolist() == [0, 1, 1, 1] and len(found.tangents) == 2
    assert found.tangents[1] == pytest.approx(KNOCK_DOWN * stiffness, rel=1e-14)
    backwards = request.model_copy(update={"strain": strain[::-1].copy(), "failed": failed[::-1].copy()})
    turned = client.call("evaluate", backwards, m.Evaluated)
    assert turned.tangent_index is not None and turned.tangent_index.tolist() == [0, 0, 0, 1]
    with pytest.raises(ProtocolError) as caught:
        client.call("evaluate", request.model_copy(update={"cell": "other"}), m.Evaluated)
    assert caught.value.code == "unknown_cell"
