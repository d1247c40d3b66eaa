"""The role `micromechanics`: rules of its messages, joined answers, requests in flight."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from toy_services import ToyMicromechanics

from protocol import micromechanics as m
from protocol.channel import CONNECTED, DISCONNECTED, Channel, InProcessChannel, ZmqChannel
from protocol.client import IN_FLIGHT, Client
from protocol.conformance_micromechanics import micromechanics_cell, micromechanics_problem
from protocol.dispatcher import Host, bad_field
from protocol.errors import ProtocolError
from protocol.frames import Envelope, Frame, decode, encode
from protocol.micromechanics_query import PART_POINTS, CellQueries, equal_bounds, join_evaluated, split
from protocol.roles import ANY, ROLES
from protocol.server import running
from protocol.tangent_table import join_tables
from protocol.version import Version

CELL = micromechanics_cell()
ROLE = ROLES["micromechanics"]


def arrived(message: Any, operation: str = "register") -> Any:
    """Return a message as it arrives on the other side of a wire."""
    envelope = Envelope("request", operation, "1", message.plain_values(), message.array_values())
    got = decode([bytes(memoryview(frame)) for frame in encode(envelope)])
    return type(message).from_parts(got.body, got.arrays)


def refused(message: Any) -> ProtocolError:
    with pytest.raises(ValidationError) as caught:
        type(message).from_parts(message.plain_values(), message.array_values())
    return bad_field(caught.value, "register")


@pytest.fixture
def client() -> Iterator[Client]:
    made = Client(InProcessChannel(Host(ToyMicromechanics())), "micromechanics")
    made.hello(5.0)
    yield made
    made.close()


def query(registered: m.CellRegistered, points: int, seed: int = 1, size: float = 0.03) -> m.EvaluateRequest:
    strain = np.random.default_rng(seed).uniform(-size, size, (points, 6))
    return m.EvaluateRequest(cell=registered.cell, temperature=310.0, strain=strain)


def test_every_operation_is_free_of_state_and_since_1_4() -> None:
    assert all(operation.allowed == ANY and operation.leads_to is None for operation in ROLE.operations.values())
    own = [operation for name, operation in ROLE.operations.items() if name not in ("hello", "status", "shutdown")]
    assert {operation.since for operation in own} == {Version(1, 4)}


def test_a_cell_arrives_to_the_bit() -> None:
    got = arrived(CELL)
    assert got.plain_values() == CELL.plain_values()
    for name, array in CELL.array_values().items():
        assert getattr(got, name).tobytes() == array.tobytes()
    stiffness = np.array(CELL.materials[1].stiffness)
    assert np.array(got.materials[1].stiffness).tobytes() == stiffness.tobytes()


@pytest.mark.parametrize(
    ("field", "changes"),
    [
        ("knock_down", {"knock_down": 1.5}),
        ("knock_down", {"knock_down": 0.0}),
        ("stress_free_temperature", {"stress_free_temperature": -1.0}),
        ("heights", {"heights": np.array([1.0, np.nan])}),
        ("heights", {"heights": np.array([1.0, -1.0])}),
        ("widths", {"widths": np.ones(2)}),
        ("phase", {"phase": np.full((2, 3), 2)}),
        ("phase", {"phase": np.zeros((2, 3))}),
        ("materials", {"materials": []}),
        ("after_failure", {"after_failure": "vanish"}),
    ],
)
def test_a_wrong_cell_is_refused_by_name(field: str, changes: dict[str, Any]) -> None:
    error = refused(CELL.model_copy(update=changes))
    # Widths that do not fit the phase are a quarrel of two fields; either may be named.
    allowed = {field, "phase"} if field == "widths" else {field}
    assert (error.code, error.report.field in allowed) == ("bad_field", True), error.report


def material(**changes: Any) -> m.RegisterCell:
    wrong = CELL.materials[0].model_copy(update=changes)
    return CELL.model_copy(update={"materials": [wrong, CELL.materials[1]]})


def matrix(**entries: float) -> list[list[float]]:
    found = np.reshape(CELL.materials[0].stiffness[0], (6, 6)).copy()
    for place, value in entries.items():
        found[int(place[1]), int(place[2])] = value
    return [found.reshape(-1).tolist()]


@pytest.mark.parametrize(
    ("field", "changes", "words"),
    [
        ("materials.0.stiffness.0", {"stiffness": [[1.0] * 35]}, "36"),
        ("materials.0.stiffness", {"stiffness": []}, "temperatures has 1"),
        ("materials.0.stiffness", {"stiffness": matrix(e01=1e9)}, "not symmetric"),
        ("materials.0.stiffness", {"stiffness": matrix(e33=0.0)}, "diagonal"),
        ("materials.0.stiffness", {"stiffness": matrix(e01=3e11, e10=3e11)}, "positive definite"),
        ("materials.0.expansion", {"expansion": []}, "temperatures has 1"),
        ("materials.0.expansion.0.5", {"expansion": [[0.0] * 5 + [np.nan]]}, "finite"),
        ("materials.0.fracture_energy", {"fracture_energy": -1.0}, "greater than 0"),
    ],
)
def test_a_wrong_material_is_refused_by_name(field: str, changes: dict[str, Any], words: str) -> None:
    report = refused(material(**changes)).report
    assert (report.code, report.field) == ("bad_field", field), report
    assert words in report.sentence


def test_allowables_are_positive_and_may_be_left_out() -> None:
    failure = m.MaterialFailure(criterion="tsai_hill", tension=(1.0, None, 2.0))
    assert arrived(material(failures=[failure])).materials[0].failures == [failure]
    bad = m.MaterialFailure.model_construct(
        criterion="tsai_hill", tension=(0.0, 1.0, 1.0), compression=(None,) * 3, shear=(None,) * 3
    )
    assert refused(material(failures=[bad])).report.field == "materials.0.failures.0.tension.0"


def test_nearly_dependent_stiffness_is_decided_by_its_scaled_eigenvalue() -> None:
    """A stiffness of extreme contrast is sound; the same diagonal with a full dependence is not."""
    sound = np.diag([1e14, 1.0, 1e-6, 1e3, 1e-3, 1.0]).reshape(-1).tolist()
    assert arrived(material(stiffness=[sound])).materials[0].stiffness == [sound]
    dependent = np.diag([1e14, 1.0, 1.0, 1.0, 1.0, 1.0])
    dependent[0, 1] = dependent[1, 0] = 1e7
    assert "positive definite" in refused(material(stiffness=[dependent.reshape(-1).tolist()])).report.sentence


@pytest.mark.parametrize(
    ("field", "changes"),
    [
        ("strain", {"strain": np.array([[0.0, np.nan, 0, 0, 0, 0]])}),
        ("strain", {"strain": np.zeros((1, 5))}),
        ("strain", {"strain": np.zeros((1, 6), np.int64)}),
        ("failed", {"failed": np.zeros((2, 1), np.uint8)}),
        ("failed", {"failed": np.zeros((1, 2), np.uint8)}),
        ("failed", {"failed": np.full((1, 1), 64, np.uint8)}),
        ("history", {"history": np.zeros((1, 3))}),
        ("element_length", {"element_length": np.zeros(1)}),
        ("temperature", {"temperature": -5.0}),
        ("temperature", {"temperature": float("nan")}),
    ],
)
def test_a_wrong_query_is_refused_and_the_service_goes_on(client: Client, field: str, changes: dict[str, Any]) -> None:
    registered = client.call("register", CELL, m.CellRegistered)
    right = query(registered, 1)
    before = client.call("evaluate", right, m.Evaluated)
    with pytest.raises(ProtocolError) as caught:
        client.call("evaluate", right.model_copy(update=changes), m.Evaluated)
    assert (caught.value.code, caught.value.report.field) == ("bad_field", field)
    after = client.call("evaluate", right, m.Evaluated)
    assert after.stress.tobytes() == before.stress.tobytes()


def test_an_unknown_cell_has_a_code_of_its_own(client: Client) -> None:
    problem = micromechanics_problem(client.call("register", CELL, m.CellRegistered))
    for operation, request in problem.whole[1:]:
        with pytest.raises(ProtocolError) as caught:
            client.call(operation, request.model_copy(update={"cell": "x"}), ROLE.operations[operation].reply)
        assert (caught.value.code, caught.value.report.field) == ("unknown_cell", "cell")


# --- parts -------------------------------------------------------------------------------------------------------


def test_tables_are_joined_by_value_in_the_order_of_first_use() -> None:
    one, two, three = (np.full((6, 6), value) for value in (1.0, 2.0, 3.0))
    first = np.array([0, 1, 0]), np.array([one, two])
    second = np.array([0, 1, 2, 0]), np.array([three, one, two])
    index, tangents = join_tables([first, second])
    assert index.tolist() == [0, 1, 0, 2, 0, 1, 2]
    assert tangents.tolist() == np.array([one, two, three]).tolist()
    # A table with the same tangent under two numbers gets one of them.
    index, tangents = join_tables([(np.array([0, 1, 2]), np.array([one, one, two]))])
    assert index.tolist() == [0, 0, 1] and tangents[:, 0, 0].tolist() == [1.0, 2.0]
    # Zeros of either sign are not the same bits.
    index, _ = join_tables([(np.array([0, 1]), np.array([0.0 * one, -0.0 * one]))])
    assert index.tolist() == [0, 1]
    index, tangents = join_tables([(np.zeros(0, np.int64), np.zeros((0, 6, 6)))])
    assert index.shape == (0,) and tangents.shape == (0, 6, 6)


@pytest.mark.parametrize("parts", [1, 2, 3, 7])
def test_joined_parts_are_the_whole(client: Client, parts: int) -> None:
    registered = client.call("register", CELL, m.CellRegistered)
    request = query(registered, 50)
    whole = client.call("evaluate", request, m.Evaluated)
    assert whole.new_failures > 0 and whole.tangents is not None and len(whole.tangents) > 1
    asked = split(request, equal_bounds(50, parts))
    joined = join_evaluated([client.call("evaluate", part, m.Evaluated) for part in asked])
    assert joined.array_values().keys() == whole.array_values().keys()
    for name, array in whole.array_values().items():
        assert joined.array_values()[name].tobytes() == array.tobytes()
    assert joined.plain_values() == whole.plain_values()


def test_equal_bounds_cover_all_points() -> None:
    for points in (0, 1, 5, 99, 100_001):
        for parts in (1, 2, 3, 8):
            bounds = equal_bounds(points, parts)
            sizes = np.diff(bounds)
            assert bounds[0] == 0 and bounds[-1] == points and len(sizes) == parts
            assert sizes.max() - sizes.min() <= 1


class Forgetful(ToyMicromechanics):
    """Keeps one cell."""

    def register(self, request: m.RegisterCell) -> m.CellRegistered:
        self.cells.clear()
        return super().register(request)


def test_a_forgotten_cell_is_registered_again() -> None:
    client = Client(InProcessChannel(Host(Forgetful())), "micromechanics")
    client.hello(5.0)
    first = CellQueries(client, CELL)
    expected = first.evaluate(query(first.registered, 20))
    second = CellQueries(client, CELL.model_copy(update={"knock_down": 0.5}))
    assert second.registered.cell != first.registered.cell
    again = first.evaluate(query(first.registered, 20))
    assert again.stress.tobytes() == expected.stress.tobytes()
    with pytest.raises(ProtocolError, match="no cell"):
        first.evaluate(query(first.registered, 3).model_copy(update={"cell": "never"}))


class Watched(Channel):
    """A channel that counts what is under way, and may lose its link once."""

    def __init__(self, inner: Channel, lose_at: int = -1) -> None:
        self.inner, self.sent, self.received, self.most = inner, 0, 0, 0
        self.lose_at, self.events = lose_at, list[str]()

    def send(self, frames: list[Frame]) -> None:
        self.sent += 1
        self.most = max(self.most, self.sent - self.received)
        self.inner.send(frames)

    def receive(self, seconds: float) -> list[Frame] | None:
        if self.received == self.lose_at:
            self.lose_at = -1
            while self.inner.receive(0.2) is not None:  # the replies on their way are lost with the link
                pass
            self.events = [DISCONNECTED, CONNECTED]
            return None
        frames = self.inner.receive(seconds)
        self.received += frames is not None
        return frames

    def link_events(self) -> list[str]:
        events, self.events = self.events, []
        return [*self.inner.link_events(), *events]

    def close(self) -> None:
        self.inner.close()

    def control(self, control_endpoint: str) -> Channel:
        return self.inner.control(control_endpoint)


def test_parts_are_under_way_while_one_is_answered(tmp_path: Path) -> None:
    with running(ToyMicromechanics(), f"ipc://{tmp_path}/s") as server:
        channel = Watched(ZmqChannel(server.endpoint))
        client = Client(channel, "micromechanics")
        client.hello(5.0)
        registered = client.call("register", CELL, m.CellRegistered)
        request = query(registered, 90)
        replies = list(client.call_each("evaluate", split(request, equal_bounds(90, 9)), m.Evaluated))
        assert channel.most == IN_FLIGHT
        whole = client.call("evaluate", request, m.Evaluated)
        assert join_evaluated(replies).stress.tobytes() == whole.stress.tobytes()
        client.close()


@pytest.mark.parametrize("points", [60, 60_000], ids=["small", "replies of which one is kept"])
def test_a_link_that_breaks_under_parts_loses_none(points: int, tmp_path: Path) -> None:
    """Replies that were lost are sent again, or, where the service keeps them no more, asked for anew."""

    class Quick(ToyMicromechanics):
        def evaluate(self, request: m.EvaluateRequest) -> m.Evaluated:
            count = len(request.strain)
            return m.Evaluated(
                stress=2.0 * request.strain, failed=np.zeros((count, 1), np.uint8), history=np.zeros((count, 0)),
                new_failures=0,
            )  # fmt: skip

    with running(Quick(), f"ipc://{tmp_path}/s") as server:
        channel = Watched(ZmqChannel(server.endpoint), lose_at=4)
        client = Client(channel, "micromechanics")
        client.hello(5.0)
        registered = client.call("register", CELL, m.CellRegistered)
        request = query(registered, 6 * points)
        replies = list(client.call_each("evaluate", split(request, equal_bounds(6 * points, 6)), m.Evaluated))
        assert channel.lose_at == -1, "the link never broke"
        assert join_evaluated(replies).stress.tobytes() == (2.0 * request.strain).tobytes()
        client.close()


def test_an_error_in_one_part_ends_the_query_and_not_the_client(client: Client) -> None:
    registered = client.call("register", CELL, m.CellRegistered)
    right = query(registered, 4)
    wrong = right.model_copy(update={"cell": "x"})
    with pytest.raises(ProtocolError, match="no cell"):
        list(client.call_each("evaluate", [right, wrong, right, right], m.Evaluated))
    assert client.call("evaluate", right, m.Evaluated).stress.shape == (4, 6)


def test_a_part_is_a_few_megabytes() -> None:
    assert 1 << 20 < PART_POINTS * 6 * 8 < 8 << 20
