"""Requests and replies, the same on every transport: in process, ipc, tcp, tcp with CURVE."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import msgpack
import numpy as np
import pytest
from toy_services import TOYS, ToyContinuum, compute_without_lock, hold_lock
from wire_setup import TRANSPORTS, Wire, make_ready, wire

from protocol import continuum as c
from protocol.client import Client
from protocol.conformance_probe import difference
from protocol.conformance_problems import Problem
from protocol.dispatcher import KEPT_IDS, KEPT_REPLIES, UNKNOWN_ID, Host
from protocol.errors import CODES, DeadlineExpired, ProtocolError
from protocol.frames import Envelope, decode, encode
from protocol.messages import (
    Acknowledged,
    CheckpointReply,
    FieldsReply,
    FieldsRequest,
    Hello,
    Restored,
    RestoreRequest,
    Status,
    VersionRange,
    Welcome,
)
from protocol.version import NEWEST, OLDEST, Version


def ask(made: Wire, envelope: Envelope, count: int = 1) -> list[Envelope]:
    """Send one envelope `count` times over a fresh channel and return the answers."""
    channel = made.channel()
    try:
        answers = []
        for _ in range(count):
            channel.send(encode(envelope))
            end = time.monotonic() + 5
            raw = None
            while raw is None and time.monotonic() < end:
                raw = channel.receive(0.2)
            assert raw is not None, "no answer"
            answers.append(decode(raw))
        return answers
    finally:
        channel.close()


def error_code(made: Wire, envelope: Envelope) -> str:
    answer = ask(made, envelope)[0]
    assert answer.kind == "error"
    return str(answer.body["code"])


def request(kind: str, body: dict | None = None, arrays: dict | None = None, name: str = "r", **more) -> Envelope:
    return Envelope("request", kind, name, body or {}, arrays or {}, **more)


def test_hello_tells_role_state_and_limits(any_wire: Wire) -> None:
    client = any_wire.client()
    welcome = client.welcome
    assert welcome is not None
    assert (welcome.role, welcome.backend, welcome.units, welcome.state) == ("continuum", "toy", "SI", "new")
    assert Version(*welcome.version) == NEWEST
    assert welcome.max_message_bytes == 1 << 24
    assert welcome.capabilities["fields"] == ["position", "displacement", "velocity", "weight"]
    client.close()


def test_versions_that_do_not_meet_name_both_sides(any_wire: Wire) -> None:
    client = Client(any_wire.channel(), "continuum")
    hello = Hello(versions=VersionRange(oldest=(2, 1), newest=(2, 3)), role="continuum", client="future 9")
    with pytest.raises(ProtocolError) as caught:
        client.call("hello", hello, Welcome)
    assert caught.value.code == "version_mismatch"
    for part in ("future 9", "2.1", "2.3", str(OLDEST), str(NEWEST), "continuum toy"):
        assert part in caught.value.report.sentence
    client.close()


def test_a_newer_minor_of_the_same_major_is_met(any_wire: Wire) -> None:
    client = Client(any_wire.channel(), "continuum")
    hello = Hello(versions=VersionRange(oldest=OLDEST, newest=(1, 8)), role="continuum", client="newer")
    assert Version(*client.call("hello", hello, Welcome).version) == NEWEST
    client.close()


def test_another_role_is_refused_with_both_named(any_wire: Wire) -> None:
    with pytest.raises(ProtocolError) as caught:
        any_wire.client("atomistic")
    assert caught.value.code == "role_mismatch"
    assert "atomistic" in caught.value.report.sentence and "continuum" in caught.value.report.sentence


def test_every_code_is_given_and_repeats_the_header(any_wire: Wire, problem: Problem) -> None:
    """Each code of the wire, on each transport; each error repeats id, type, run and step of its request."""
    service = any_wire.service
    client = any_wire.client()
    make_ready(client, problem)
    advance = problem.advance(0)
    many = c.ContinuumAdvance(steps=10**9)
    requests = {
        "malformed_message": request("status", arrays={"x": np.zeros(3)}),
        "version_mismatch": request("status", protocol=Version(7, 0)),
        "unknown_type": request("dance"),
        "bad_field": request("advance", {"steps": -1}),
        "unsupported": request("advance", many.plain_values()),
        "message_too_large": request("status", arrays={"x": np.zeros(1 << 24, np.uint8)}),
        "role_mismatch": request(
            "hello", {"versions": {"oldest": [1, 0], "newest": [1, 0]}, "role": "x", "client": ""}
        ),
    }
    seen = set()
    for number, (code, envelope) in enumerate(requests.items()):
        name = f"code-{number}"
        frames = encode(
            Envelope("request", envelope.type, name, envelope.body, envelope.arrays, "run 1", step=number,
                     protocol=envelope.protocol)
        )  # fmt: skip
        channel = any_wire.channel()
        channel.send(frames[:1] if code == "malformed_message" else frames)
        raw = None
        while raw is None:
            raw = channel.receive(5.0)
        answer = decode(raw)
        channel.close()
        assert (answer.kind, answer.body["code"]) == ("error", code)
        assert (answer.id, answer.type, answer.run, answer.step) == (name, envelope.type, "run 1", number)
        assert answer.session == any_wire.host.session
        seen.add(code)

    ask(any_wire, request("status", name="used"))
    assert error_code(any_wire, request("hello", name="used")) == "request_id_reused"
    for number in range(KEPT_REPLIES):
        ask(any_wire, request("status", name=f"other-{number}"))
    assert error_code(any_wire, request("status", name="used")) == "request_expired"

    def abort(one: ToyContinuum) -> None:
        one.activity.abort.set()

    def divide(one: ToyContinuum) -> None:
        raise ZeroDivisionError("a defect")

    def blow_up(one: ToyContinuum) -> None:
        one.state["velocity"][0, 0] = np.inf

    for hook, code in ((abort, "aborted"), (divide, "internal"), (blow_up, "solver_failed")):
        make_ready(client, problem)
        service.compute_first = hook
        with pytest.raises(ProtocolError) as caught:
            client.call("advance", advance, c.ContinuumAdvanced)
        assert caught.value.code == code
        assert caught.value.report.origin == "continuum toy"
        assert (caught.value.report.traceback_tail != "") == (code == "internal")
        assert client.call("status", None, Status).state == "failed"
        service.compute_first = None
        with pytest.raises(ProtocolError) as caught:
            client.call("advance", advance, c.ContinuumAdvanced)
        assert caught.value.code == "wrong_state"
        seen.add(code)
    # The last one is of a role without state; see test_micromechanics_messages.
    assert seen | {"request_id_reused", "request_expired", "wrong_state", "unknown_cell"} == set(CODES)
    client.close()


def test_an_operation_runs_once_however_often_it_is_sent(any_wire: Wire, problem: Problem) -> None:
    client = any_wire.client()
    make_ready(client, problem)
    message = problem.advance(0)
    envelope = request("advance", message.plain_values(), message.array_values(), name="once", step=1)
    before = any_wire.service.advances
    first, *others = ask(any_wire, envelope, count=4)
    assert any_wire.service.advances == before + 1
    assert first.kind == "reply" and first.body["step"] == message.steps  # type: ignore[attr-defined]
    assert all(difference(first, other) == "" for other in others)
    client.close()


def test_old_ids_are_never_run_again(any_wire: Wire, problem: Problem) -> None:
    client = any_wire.client()
    make_ready(client, problem)
    message = problem.advance(0)
    envelope = request("advance", message.plain_values(), message.array_values(), name="old")
    assert ask(any_wire, envelope)[0].kind == "reply"
    for _ in range(KEPT_REPLIES - 1):
        client.call("status", None, Status)
    assert ask(any_wire, envelope)[0].kind == "reply"
    runs = any_wire.service.advances
    for _ in range(2):
        client.call("status", None, Status)
    assert error_code(any_wire, envelope) == "request_expired"
    assert any_wire.service.advances == runs
    client.close()


def test_ids_are_forgotten_after_their_stated_number() -> None:
    host = Host(TOYS["continuum"]())
    for number in range(KEPT_IDS + 10):
        host.work.handle(encode(request("status", name=f"id-{number}")))
    assert len(host.work._answered) == KEPT_IDS
    assert len(host.work._replies) == KEPT_REPLIES


def test_size_limit_holds_both_ways(any_wire: Wire, problem: Problem) -> None:
    client = any_wire.client()
    make_ready(client, problem)
    limit = 1 << 24
    force = np.zeros((limit // 24 + 1, 3))
    with pytest.raises(ProtocolError, match="at most 16777216") as caught:
        client.call("advance", c.ContinuumAdvance(steps=1, ivc_force=force), c.ContinuumAdvanced)
    assert caught.value.code == "message_too_large"
    any_wire.host.max_message_bytes = 1000
    with pytest.raises(ProtocolError, match="the reply to fields has") as caught:
        client.call("fields", FieldsRequest(names=["position"]), FieldsReply)
    assert caught.value.code == "message_too_large"
    any_wire.host.max_message_bytes = limit
    assert client.call("fields", FieldsRequest(names=["position"]), FieldsReply).fields["position"].shape[1] == 3
    client.close()


def test_arrays_arrive_bit_for_bit(any_wire: Wire) -> None:
    """A large one (2.4 MB), one without rows, one without axes, and bytes; in a state that is sent back and forth."""
    client = any_wire.client()
    configure = c.ContinuumConfigure(
        assumption="plane_strain", thickness=1.0, body=c.Rectangle(lower=(0, 0), upper=(100, 100)), cell_size=1.0,
        points_per_cell=3, material=c.IsotropicMaterial(young=1, poisson=0, density=1), time_step=0.1,
    )  # fmt: skip
    client.call("configure", configure, c.ContinuumConfigured)
    rng = np.random.default_rng(5)
    service = any_wire.service
    service.state = {
        "step": np.array([3]), "big": rng.standard_normal((100_000, 3)), "none": np.zeros((0, 3)),
        "scalar": np.array(2.5), "byte": np.arange(7, dtype=np.uint8), "nan": np.array([np.nan, -0.0]),
    }  # fmt: skip
    saved = client.call("checkpoint", None, CheckpointReply)
    assert saved.state["big"].nbytes == 2_400_000
    client.call("restore", RestoreRequest(step=3, state=saved.state), Restored)
    again = client.call("checkpoint", None, CheckpointReply)
    for name, array in service.state.items():
        for got in (saved.state[name], again.state[name]):
            assert got.shape == array.shape and got.dtype == array.dtype and got.tobytes() == array.tobytes()
    client.close()


def test_unknown_fields_are_ignored_everywhere(any_wire: Wire, problem: Problem) -> None:
    client = any_wire.client()
    make_ready(client, problem)
    message = problem.advance(0)
    body = {**message.plain_values(), "of version 1.9": {"x": [1]}}
    arrays = {**message.array_values(), "of.version.1.9": np.zeros(2)}
    frames = encode(request("advance", body, arrays, name="new"))
    header = {**msgpack.unpackb(frames[0]), "priority": 3}
    header["arrays"] = [{**entry, "compression": "none"} for entry in header["arrays"]]
    answer = decode(any_wire.host.work.handle([msgpack.packb(header), *frames[1:]]))
    assert answer.kind == "reply" and answer.body["step"] == message.steps  # type: ignore[attr-defined]
    client.close()


def test_a_frame_that_is_not_aligned_is_read() -> None:
    values = np.arange(6.0).reshape(2, 3)
    header, frame = encode(request("x", arrays={"a": values}))
    shifted = bytearray(b"!" + bytes(frame))
    array = decode([header, memoryview(shifted)[1:]]).arrays["a"]
    assert array.flags.aligned and not array.flags.writeable
    assert (array == values).all()


def test_an_id_that_cannot_be_read_is_answered_with_a_question_mark(any_wire: Wire) -> None:
    answer = decode(any_wire.host.work.handle([b"\xc1"]))
    assert (answer.kind, answer.id, answer.body["code"]) == ("error", UNKNOWN_ID, "malformed_message")


def test_an_array_in_the_body_is_not_dropped_silently(any_wire: Wire, problem: Problem) -> None:
    """An optional force that comes as a list would otherwise count as absent."""
    client = any_wire.client()
    make_ready(client, problem)
    answer = ask(any_wire, request("advance", {"steps": 1, "ivc_force": [[0.0, 0.0, 0.0]] * 4}))[0]
    assert (answer.body["code"], answer.body["field"]) == ("bad_field", "ivc_force")
    client.close()


def call_and_catch(client: Client, problem: Problem, caught: list[ProtocolError]) -> None:
    try:
        client.call("advance", problem.advance(0), c.ContinuumAdvanced)
    except ProtocolError as error:
        caught.append(error)


def test_status_progress_and_abort_while_the_solver_computes(tmp_path: Path, problem: Problem) -> None:
    """The solver keeps a core busy without the interpreter lock; the control socket answers meanwhile."""
    for transport in TRANSPORTS[1:]:
        folder = tmp_path / transport
        folder.mkdir()
        service = TOYS["continuum"]()
        with wire(transport, folder, service) as made:
            client = made.client()
            make_ready(client, problem)
            service.compute_first = compute_without_lock(30.0)
            caught: list[ProtocolError] = []

            working = threading.Thread(target=call_and_catch, args=(client, problem, caught))
            working.start()
            control = client.control
            slowest, seen = 0.0, set()
            for _ in range(20):
                began = time.monotonic()
                status = control.call("status", None, Status)
                slowest = max(slowest, time.monotonic() - began)
                seen.add((status.operation, status.note))
                time.sleep(0.02)
            assert ("advance", "hashing") in seen
            assert slowest < 1.0
            began = time.monotonic()
            assert control.call("abort", None, Acknowledged).operation == "advance"
            working.join(timeout=5)
            assert time.monotonic() - began < 2.0
            assert [error.code for error in caught] == ["aborted"]
            assert client.call("status", None, Status).state == "failed"
            client.close()


def test_a_solver_that_holds_the_lock_for_two_seconds_raises_no_alarm(tmp_path: Path, problem: Problem) -> None:
    """Heartbeats are answered by libzmq's own thread, in the service's process."""
    from wire_setup import process

    with process(f"ipc://{tmp_path}/s", "--hold", "2") as (_, endpoint):
        client = Client.connect(endpoint, "continuum", deadline=20)
        make_ready(client, problem)
        began = time.monotonic()
        reply = client.call("advance", problem.advance(0), c.ContinuumAdvanced)
        assert time.monotonic() - began > 1.9
        assert reply.step == problem.advance(0).steps  # type: ignore[attr-defined]
        assert client._channel.link_events() == []
        client.close()


def test_hold_lock_really_holds_it() -> None:
    ticks: list[float] = []
    stop = threading.Event()

    def tick() -> None:
        while not stop.is_set():
            ticks.append(time.monotonic())
            time.sleep(0.01)

    thread = threading.Thread(target=tick)
    thread.start()
    time.sleep(0.1)
    hold_lock(1)(TOYS["continuum"]())
    stop.set()
    thread.join()
    assert np.diff(ticks).max() > 0.9


def test_deadline_names_operation_and_time(tmp_path: Path, problem: Problem) -> None:
    service = TOYS["continuum"]()
    with wire("ipc", tmp_path, service) as made:
        client = made.client()
        make_ready(client, problem)
        service.compute_first = compute_without_lock(1.5)
        began = time.monotonic()
        with pytest.raises(DeadlineExpired, match=r"continuum service did not answer advance within 0\.4 s"):
            client.call("advance", problem.advance(0), c.ContinuumAdvanced, deadline=0.4)
        assert 0.3 < time.monotonic() - began < 1.2
        assert client.call("status", None, Status, deadline=10).step == problem.advance(0).steps  # type: ignore[attr-defined]
        client.close()


def test_a_nan_out_of_the_solver_is_a_solver_failure(any_wire: Wire, problem: Problem) -> None:
    client = any_wire.client()
    make_ready(client, problem)
    any_wire.service.omega = np.nan
    with pytest.raises(ProtocolError) as caught:
        client.call("advance", problem.advance(0), c.ContinuumAdvanced)
    assert caught.value.code == "solver_failed" and caught.value.report.step == 5
    client.close()
