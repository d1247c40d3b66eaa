"""Kinds of parts in the continuum's messages: which is meant, what is said of a mistake, who understands them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError
from test_conformance import failures, held
from toy_services import ToyContinuum
from wire_setup import make_ready

from protocol import continuum as c
from protocol.channel import InProcessChannel
from protocol.client import Client
from protocol.conformance_problems import continuum_problem
from protocol.dispatcher import Host, bad_field
from protocol.errors import ProtocolError
from protocol.frames import Envelope, decode, encode
from protocol.messages import newer_fields
from protocol.version import NEWEST, Version
from protocol.wrong_requests import names_field, wrong_requests

OLD = Version(1, 0)
PROBLEM = continuum_problem()
CONFIGURE = PROBLEM.request("configure")
assert isinstance(CONFIGURE, c.ContinuumConfigure)


def sent(message: c.ContinuumConfigure) -> c.ContinuumConfigure:
    """Return the message as it arrives on the other side of a wire."""
    envelope = Envelope("request", "configure", "1", message.plain_values(), message.array_values())
    arrived = decode([bytes(memoryview(frame)) for frame in encode(envelope)])
    return c.ContinuumConfigure.from_parts(arrived.body, arrived.arrays)


def refused(**changes: Any) -> ProtocolError:
    body = {**CONFIGURE.plain_values(), **changes}
    with pytest.raises(ValidationError) as caught:
        c.ContinuumConfigure.from_parts(body, {})
    return bad_field(caught.value, "configure")


@pytest.mark.parametrize("request_", [steps[0][1] for _, steps in PROBLEM.kinds], ids=[k for k, _ in PROBLEM.kinds])
def test_every_kind_arrives_as_it_was_sent(request_: c.ContinuumConfigure) -> None:
    assert sent(request_) == request_


def test_a_body_of_version_1_0_means_what_it_meant() -> None:
    body = {
        "assumption": "plane_stress", "thickness": 1.0, "body": {"lower": [0.0, 0.0], "upper": [4.0, 4.0]},
        "cell_size": 1.0, "points_per_cell": 2, "material": {"young": 1e9, "poisson": 0.3, "density": 1e3},
        "edges": [{"edge": "top", "component": 1, "times": [0.0, 1.0], "displacements": [0.0, 0.1]}],
        "cracks": [{"points": [[0.0, 1.0], [2.0, 1.0]]}], "time_step": 1e-5,
    }  # fmt: skip
    read = c.ContinuumConfigure.from_parts(body, {})
    assert isinstance(read.material, c.IsotropicMaterial)
    assert isinstance(read.edges[0], c.EdgeCondition)
    assert newer_fields(read, OLD) == []
    assert (read.cracks[0].contact, read.cracks[0].growth, read.on_lost_points) == ("frictionless", None, "continue")
    assert (read.scheme.interpolation, read.scheme.integration) == ("ugimp", "musl")
    assert (read.scheme.transfer, read.scheme.order, read.scheme.period) == ("fmpm", 2, 1)


@pytest.mark.parametrize(
    ("changes", "field", "said"),
    [
        ({"material": {"law": "rubber"}}, "material.law", "isotropic, orthotropic, neo_hookean, j2_plasticity"),
        ({"material": {"law": {}}}, "material.law", "must be one of"),
        ({"material": 7}, "material.law", "must be one of"),
        ({"material": {"law": "neo_hookean", "young": 1e9, "poisson": 0.3}}, "material.density", "required"),
        ({"material": {"young": 1e9, "poisson": 0.6, "density": 1.0}}, "material.poisson", "less than 0.5"),
        ({"edges": [{"kind": "pull"}]}, "edges.0.kind", "displacement, velocity, symmetry"),
        ({"edges": [{"kind": "velocity", "edge": "top", "component": 1, "times": [0.0, 1.0], "velocities": [0.0]}]},
         "edges.0.velocities", "has 1 entries, times has 2"),
        ({"edges": [{"kind": "pressure", "edge": "top", "times": [1.0, 0.0], "pressures": [0.0, 1.0]}]},
         "edges.0.times", "must ascend, but 0 follows 1"),
        ({"cracks": [{"points": [[0.0, 0.0], [1.0, 0.0]], "friction": 0.5}]}, "cracks.0.friction", "must be 0 with"),
        ({"refinement": [{"lower": [-4e-9, -2e-9], "upper": [4e-9, 2e-9]},
                         {"lower": [-2e-9, -1e-9], "upper": [2e-9, 3e-9]}]},
         "refinement.1", "reaches beyond refinement.0"),
        ({"force_scaling": 1.0}, "force_scaling", "less than 1"),
        ({"preload": {"tolerance": 2.0, "max_steps": 5}}, "preload.tolerance", "less than 1"),
        ({"scheme": {"order": 21}}, "scheme.order", "less than or equal to 20"),
    ],
)  # fmt: skip
def test_a_mistake_is_named_by_its_field(changes: dict[str, Any], field: str, said: str) -> None:
    report = refused(**changes).report
    assert report.field == field
    assert said in report.sentence
    assert "<" not in report.sentence.replace("<=", ""), "the mark of a kind is no part of a path"


def test_what_an_older_side_would_ignore() -> None:
    assert newer_fields(CONFIGURE, OLD) == []
    assert newer_fields(CONFIGURE.model_copy(update={"scheme": c.Scheme(order=3)}), OLD) == ["scheme"]
    material = c.NeoHookeanMaterial(young=1.0, poisson=0.0, density=1.0)
    crack = c.CrackLine(points=[(0.0, 0.0), (1.0, 0.0)], measure_every=5)
    changed = CONFIGURE.model_copy(
        update={"material": material, "cracks": [crack], "edges": [*CONFIGURE.edges, c.EdgeSymmetry(edge="top")]}
    )
    assert newer_fields(changed, OLD) == ["material", "cracks.0.measure_every", "edges.2"]
    assert newer_fields(changed, NEWEST) == []


class Older(Host):
    """Speaks 1.0 alone."""

    def _welcome(self, hello: Any) -> Any:
        return super()._welcome(hello).model_copy(update={"version": OLD})


def test_nothing_is_sent_that_an_older_service_would_ignore() -> None:
    client = Client(InProcessChannel(Older(ToyContinuum())), "continuum")
    client.hello()
    make_ready(client, PROBLEM)
    with pytest.raises(ProtocolError) as caught:
        client.call("configure", CONFIGURE.model_copy(update={"force_scaling": 0.5}), c.ContinuumConfigured)
    assert (caught.value.code, caught.value.report.field) == ("unsupported", "force_scaling")
    assert "1.0" in caught.value.report.sentence and "continuum" in caught.value.report.sentence
    client.call("advance", PROBLEM.advance(0), c.ContinuumAdvanced)


def test_wrong_requests_know_every_kind_and_what_is_new() -> None:
    new = {wrong.field for _, message in PROBLEM.whole for wrong in wrong_requests(message, PROBLEM.sizes)}
    for path in (
        "material.young_1", "material.yield_stress", "material.law", "edges.1.velocities", "edges.3.tractions",
        "edges.4.pressures", "edges.5.kind", "cracks.0.growth.interval", "cracks.0.contact", "body_force.acceleration",
        "preload.tolerance", "refinement.0.lower", "scheme.order",
    ):  # fmt: skip
        assert path in new, path
    old = {
        wrong.field
        for _, message in PROBLEM.whole
        if not newer_fields(message, OLD)
        for wrong in wrong_requests(message, PROBLEM.sizes, OLD)
    }
    assert not {path for path in old if path.startswith(("scheme", "preload", "refinement"))}
    assert {"material.young", "edges.0.displacements", "cracks.0.points"} <= old
    assert "cracks.0.contact" not in old and "material.law" not in old


def test_each_wrong_request_is_wrong_and_names_its_field() -> None:
    seen = 0
    for operation, message in PROBLEM.whole:
        if operation != "configure":
            continue
        for wrong in wrong_requests(message, PROBLEM.sizes):
            with pytest.raises(ValidationError) as caught:
                c.ContinuumConfigure.from_parts(wrong.body, wrong.arrays)
            assert names_field(bad_field(caught.value, "").report.field, wrong.paths), (wrong.field, wrong.label)
            seen += 1
    assert seen > 400


def test_the_kit_asks_an_older_service_for_nothing_new(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("protocol.server.Host", Older)
    monkeypatch.setattr("protocol.conformance_wire.WireChecks._agreed_version", lambda self: None)
    checks = held(ToyContinuum(), tmp_path)
    assert failures(checks) == []
    names = {check.name for check in checks}
    assert "wrong field: configure thickness" in names
    assert {name for name in names if name.startswith("kinds:")} == {"kinds: two cracks"}  # 1.0 knew lists of cracks
    assert not any("scheme" in name or "preload" in name for name in names)
