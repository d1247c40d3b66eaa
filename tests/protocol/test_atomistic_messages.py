"""What version 1.2 brought to the role `atomistic`: rules of its messages, and what an older peer gets of it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from toy_services import TOYS, ToyAtomistic

from protocol import atomistic as a
from protocol.channel import InProcessChannel
from protocol.client import Client
from protocol.conformance_atomistic import atomistic_configure, atomistic_problem, data_file
from protocol.conformance_problems import Problem
from protocol.dispatcher import Host
from protocol.errors import ProtocolError
from protocol.frames import Envelope, decode, encode
from protocol.messages import Message, newer_fields
from protocol.roles import ROLES
from protocol.version import Version
from protocol.wrong_requests import wrong_requests

SAMPLE = a.Sample(material="square", width=1e-9, height=1e-9)
BASE: dict[str, Any] = {"force_field": "harmonic", "temperature": 1.0, "time_step": 1e-15, "seed": 1}
DATA = np.frombuffer(b"some bytes", np.uint8)


def connected(service: ToyAtomistic) -> Client:
    client = Client(InProcessChannel(Host(service)), "atomistic")
    client.hello(5.0)
    return client


@pytest.fixture
def problem() -> Iterator[Problem]:
    service = TOYS["atomistic"]()
    client = connected(service)  # type: ignore[arg-type]
    assert client.welcome is not None
    configure = atomistic_configure(client.welcome)
    yield atomistic_problem(configure, client.call("configure", configure, a.AtomisticConfigured), ("langevin",))


def sent(message: Message) -> Message:
    """Return the message as it arrives on the other side of a wire."""
    arrived = decode(encode(Envelope("request", "any", "1", message.plain_values(), message.array_values())))
    return type(message).from_parts(arrived.body, arrived.arrays)


def refused_field(**values: Any) -> str:
    with pytest.raises(ValidationError) as caught:
        a.AtomisticConfigure(**BASE, **values)
    return str(caught.value.errors()[0]["ctx"]["field"])


def test_there_is_exactly_one_sample() -> None:
    file = a.SampleFile()
    assert refused_field() == "sample"
    assert refused_field(sample=SAMPLE, sample_file=file, sample_data=DATA) == "sample"
    assert refused_field(sample=SAMPLE, sample_data=DATA) == "sample_data"
    assert refused_field(sample_file=file) == "sample_data"
    assert refused_field(sample_file=a.SampleFile(name="epoxy"), sample_data=DATA) == "sample_data"
    for allowed in ({"sample": SAMPLE}, {"sample_file": file, "sample_data": DATA},
                    {"sample_file": a.SampleFile(name="epoxy")}):  # fmt: skip
        arrived = sent(a.AtomisticConfigure(**BASE, **allowed))
        assert isinstance(arrived, a.AtomisticConfigure)
        assert (arrived.sample, arrived.sample_file) == (allowed.get("sample"), allowed.get("sample_file"))
        if "sample_data" in allowed:
            assert arrived.sample_data is not None and arrived.sample_data.tobytes() == b"some bytes"


def test_every_optional_thing_arrives_as_it_was_sent(problem: Problem) -> None:
    seen = set()
    for _, requests in problem.kinds:
        for _, request in requests:
            arrived = sent(request)
            assert arrived.plain_values() == request.plain_values()
            for name, array in request.array_values().items():
                assert np.array_equal(arrived.array_values()[name], array)
            seen |= {field.split(".")[0] for field in newer_fields(request, Version(1, 1))}
    assert seen >= {"sample", "anchor_kind", "motion", "ensemble", "keep_ensemble", "settle", "until_error"}


def test_wrong_kinds_of_anchors_and_nothing_to_keep_are_refused(problem: Problem) -> None:
    register = problem.request("register")
    assert isinstance(register, a.AtomisticRegister)
    for kind in (-1, 3):
        kinds = np.zeros(len(register.atom_id), dtype=np.int64)
        kinds[-1] = kind
        with pytest.raises(ValidationError, match=f"holds {kind}, allowed is 0 to 2"):
            a.AtomisticRegister(**{**dict(register), "anchor_kind": kinds})
    with pytest.raises(ValidationError, match="no ensemble to keep"):
        a.EquilibrateRequest(steps=1, windows=8, window_steps=1, keep_ensemble=True)


def test_each_field_of_1_2_can_be_made_wrong(problem: Problem) -> None:
    """The kit's wrong requests reach every field that the version added, in parts too."""
    found = set()
    for _, message in problem.whole:
        found |= {wrong.field for wrong in wrong_requests(message, problem.sizes)}
    assert found >= {
        "sample.layers", "sample.orientation", "sample_file.periodic_z", "sample_data", "commands.unit_style",
        "commands.commands", "anchor_kind", "motion", "ensemble.thermostat", "ensemble.pressure", "settle",
        "keep_ensemble", "until_error", "most_windows",
    }  # fmt: skip


class Old(ToyAtomistic):
    """A service of protocol 1.1."""


@pytest.fixture
def old_client(monkeypatch: pytest.MonkeyPatch) -> Client:
    client = connected(Old())
    monkeypatch.setattr(client, "_version", Version(1, 1))
    return client


def test_an_older_service_is_never_asked_for_what_it_would_ignore(old_client: Client, problem: Problem) -> None:
    tried = 0
    for _, requests in problem.kinds:
        for operation, request in requests:
            newer = newer_fields(request, Version(1, 1))
            if not newer:
                continue
            tried += 1
            with pytest.raises(ProtocolError, match=r"later version of the protocol than 1\.1") as caught:
                old_client.call(operation, request, ROLES["atomistic"].operations[operation].reply)
            assert caught.value.report.field == newer[0]
    assert tried >= 9
    assert isinstance(old_client.call("configure", problem.request("configure"), a.AtomisticConfigured).position,
                      np.ndarray)  # fmt: skip


def test_optional_operations_are_offered_by_name_only(problem: Problem) -> None:
    class Collects(ToyAtomistic):
        def capabilities(self) -> Any:
            return {**super().capabilities(), "operations": ["collect_fields"]}

        def collect_fields(self, request: a.CollectRequest) -> a.Collecting:
            return a.Collecting(step=self.step)

    plain, client = connected(ToyAtomistic()), connected(Collects())
    assert not plain.offers("collect_fields") and plain.offers("advance")
    assert client.offers("collect_fields") and not client.offers("j_integral")
    client.call("configure", problem.request("configure"), a.AtomisticConfigured)
    assert client.call("collect_fields", a.CollectRequest(active=True), a.Collecting).step == 0
    with pytest.raises(ProtocolError, match="does not have j_integral"):
        client.call("j_integral", a.JIntegralRequest(half_sizes=[1e-9]), a.JIntegral)


def test_a_service_without_an_optional_operation_says_so() -> None:
    host = Host(TOYS["atomistic"]())
    host.state = "ready"
    body = a.JIntegralRequest(half_sizes=[1e-9]).plain_values()
    answer = decode(host.work.handle(encode(Envelope("request", "j_integral", "1", body))))
    assert answer.kind == "error" and answer.body["code"] == "unsupported"
    assert "does not have j_integral" in answer.body["sentence"]
    assert host.state == "ready"


def test_the_data_file_of_the_kit_holds_the_atoms_as_text() -> None:
    position = np.array([[0.1, -2.0, 3.3], [1.0 / 3.0, 0.0, 0.0], [5.0, 5.0, 5.0]]) * 1e-10
    mass = np.array([12.011, 1.008, 12.011]) * 1.66053906892e-27
    built = a.AtomisticConfigured(atom_id=np.arange(3), position=position, atom_mass=mass, warnings=[])
    lines = data_file(built).tobytes().decode().splitlines()
    begin = lines.index("Atoms # atomic") + 2
    rows = [line.split() for line in lines[begin : begin + 3]]
    assert [row[:2] for row in rows] == [["1", "2"], ["2", "1"], ["3", "2"]]
    read = np.array([[float(word) for word in row[2:]] for row in rows]) * 1e-10
    assert np.abs(read - position).max() <= 1e-25
    masses = [float(line.split()[1]) for line in lines[lines.index("Masses") + 2 :][:2]]
    assert masses == pytest.approx([1.008, 12.011], rel=1e-12)
    low, high = (float(word) for word in next(line for line in lines if "xlo" in line).split()[:2])
    assert low < read[:, 0].min() * 1e10 and high > read[:, 0].max() * 1e10
