"""More than 20,000 mutated or random messages: each is answered or refused, none ends the service or makes it grow.

Most go to the dispatcher directly, the rest through a ZeroMQ socket to a service in a process of its own.
"""

from __future__ import annotations

import random
import socket
import struct
import uuid
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import psutil
import zmq
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from toy_services import TOYS, Toy
from wire_setup import make_ready, process

from protocol import atomistic as a
from protocol import continuum as c
from protocol import micromechanics as m
from protocol.channel import InProcessChannel
from protocol.client import Client
from protocol.conformance_atomistic import atomistic_configure, atomistic_problem
from protocol.conformance_micromechanics import micromechanics_cell, micromechanics_problem
from protocol.conformance_problems import Problem, continuum_problem
from protocol.dispatcher import KEPT_IDS, Host
from protocol.errors import CODES
from protocol.frames import Envelope, Frame, decode, encode
from protocol.messages import CheckpointReply, FieldsRequest, Restored, RestoreRequest

MOST_STEPS = 40
#: Resident memory may grow by this much after the warm-up, bytes.
GROWTH = 24 << 20
MUTATED, GENERATED, THROUGH_SOCKET = 9_500, 1_000, 3_600

Frames = list[bytes]


class Recorder(InProcessChannel):
    """Keeps a copy of what it sends."""

    def __init__(self, host: Host, record: list[Frames]) -> None:
        super().__init__(host)
        self.record = record

    def send(self, frames: list[Frame]) -> None:
        self.record.append([bytes(memoryview(frame)) for frame in frames])
        super().send(frames)


def conversation(role: str) -> tuple[Host, list[Frames], Problem]:
    """Return a service that can be asked and the requests that brought it there, and some more."""
    service: Toy = TOYS[role]()
    host = Host(service, max_message_bytes=1 << 24)
    record: list[Frames] = []
    client = Client(Recorder(host, record), role)
    welcome = client.hello()
    record.append([bytes(f) for f in encode(Envelope("request", "status", "s", {}))])
    service.most_steps = MOST_STEPS
    if role == "micromechanics":
        problem = micromechanics_problem(client.call("register", micromechanics_cell(), m.CellRegistered))
        for (operation, message), reply in zip(
            problem.whole[1:], (m.Evaluated, m.Localised, m.CellProperties), strict=True
        ):
            client.call(operation, message, reply)
        return host, record, problem
    if role == "continuum":
        problem = continuum_problem()
        make_ready(client, problem)
        client.call("advance", problem.advance(0), c.ContinuumAdvanced)
    else:
        configure = atomistic_configure(welcome)
        built = client.call("configure", configure, a.AtomisticConfigured)
        problem = atomistic_problem(configure, built)
        client.call("register", problem.request("register"), a.AtomisticRegistered)
        small = a.EquilibrateRequest(steps=2, windows=8, window_steps=2)
        client.call("equilibrate", small, a.Equilibrated)
        client.call("advance", problem.advance(0), a.AtomisticAdvanced)
        properties = a.PropertiesRequest(force_field="harmonic", material="square", temperature=0, seed=1)
        client.call("properties", properties, a.Properties)
    saved = client.call("checkpoint", None, CheckpointReply)
    client.call("restore", RestoreRequest(step=saved.step, state=saved.state), Restored)
    record.append(
        [bytes(f) for f in encode(Envelope("request", "fields", "f", FieldsRequest(names=["position"]).model_dump()))]
    )
    return host, record, problem


# --- mutations: each takes frames and a source of chance, and returns frames -------------------------------------


def junk(chance: random.Random) -> Any:
    """Return a value that hardly any field wants."""
    depth: Any = None
    for _ in range(chance.choice((3, 60, 300))):
        depth = [depth] if chance.random() < 0.5 else {"x": depth}
    return chance.choice(
        (
            None, True, -1, 0, 1, 2**63, 2**64 - 1, -(2**63), 1e308, float("nan"), float("inf"), -0.0, "", "x" * 3000,
            "\x00", b"\xff\xfe", [], {}, [1, "a", None], {"a": {"b": 1}}, depth, msgpack.ExtType(5, b"x"),
            msgpack.Timestamp(1), [[0.0, 0.0]] * 50,
        )
    )  # fmt: skip


def flip_bits(frames: Frames, chance: random.Random) -> Frames:
    at = chance.randrange(len(frames)) if chance.random() < 0.5 else 0
    changed = bytearray(frames[at])
    for _ in range(chance.randint(1, 6)):
        if changed:
            changed[chance.randrange(len(changed))] ^= 1 << chance.randrange(8)
    return [*frames[:at], bytes(changed), *frames[at + 1 :]]


def cut(frames: Frames, chance: random.Random) -> Frames:
    at = chance.randrange(len(frames))
    return [*frames[:at], frames[at][: chance.randint(0, max(0, len(frames[at]) - 1))], *frames[at + 1 :]]


def lengthen(frames: Frames, chance: random.Random) -> Frames:
    at = chance.randrange(len(frames))
    return [*frames[:at], frames[at] + chance.randbytes(chance.randint(1, 40)), *frames[at + 1 :]]


def duplicate(frames: Frames, chance: random.Random) -> Frames:
    at = chance.randrange(len(frames))
    return frames[: at + 1] + [frames[at]] * chance.choice((1, 1, 1, 300)) + frames[at + 1 :]


def remove(frames: Frames, chance: random.Random) -> Frames:
    at = chance.randrange(len(frames))
    return frames[:at] + frames[at + 1 :] or [b""]


def shuffle(frames: Frames, chance: random.Random) -> Frames:
    return chance.sample(frames, len(frames))


def random_bytes(frames: Frames, chance: random.Random) -> Frames:
    return [chance.randbytes(chance.choice((0, 1, 7, 80, 400))) for _ in range(chance.randint(1, 5))]


def deep(frames: Frames, chance: random.Random) -> Frames:
    """A header nested deeper than any reader's stack likes."""
    opening = chance.choice((b"\x91", b"\x81\xa1x", b"\x81\xa4body", b"\xdd\x00\x00\x00\x01"))
    return [opening * chance.choice((100, 600, 5000, 100_000)) + b"\xc0", *frames[1:]]


def huge_claim(frames: Frames, chance: random.Random) -> Frames:
    """A few bytes that claim to be a container or a text of four billion entries."""
    return [chance.choice((b"\xdd", b"\xdf", b"\xdb", b"\xc6")) + struct.pack(">I", 2**32 - 1) + b"\x01", *frames[1:]]


def edit_header(frames: Frames, chance: random.Random) -> Frames:
    header = msgpack.unpackb(frames[0])
    key = chance.choice(list(header))
    if chance.random() < 0.3:
        del header[key]
    else:
        header[key] = junk(chance)
    return [msgpack.packb(header), *frames[1:]]


def edit_table(frames: Frames, chance: random.Random) -> Frames:
    header = msgpack.unpackb(frames[0])
    if not header["arrays"]:
        header["arrays"] = [{"name": "x", "dtype": "<f8", "shape": [0], "order": "C"}]
        frames = [frames[0], b""]
    entry = chance.choice(header["arrays"])
    key = chance.choice(list(entry))
    words: dict[str, tuple[Any, ...]] = {
        "name": ("", "step", "state.", "state.step", "ivc_force", "x" * 999),
        "dtype": ("|O", ">f8", "<f4", "V8", "", "<U9", "object", "<f8,<f8", "<i8", "<f8", "|u1"),
        "shape": ([2**62, 2**62], [0, 2**63], [-1], [1] * 40, [], [1.5], [0, 2**40], [2**64 - 1], [3, 8], [24]),
        "order": ("F", "", "c", "A"),
    }
    entry[key] = chance.choice(words[key]) if chance.random() < 0.8 else junk(chance)
    return [msgpack.packb(header), *frames[1:]]


def edit_body(frames: Frames, chance: random.Random) -> Frames:
    header = msgpack.unpackb(frames[0])
    place: Any = header
    key: Any = "body"
    while isinstance(place[key], dict | list) and len(place[key]) and (key == "body" or chance.random() < 0.7):
        place = place[key]
        key = chance.choice(list(place)) if isinstance(place, dict) else chance.randrange(len(place))
    what = chance.random()
    if what < 0.2:
        del place[key]
    elif what < 0.3 and isinstance(place, dict):
        place[chance.choice((7, b"k", "new", ""))] = junk(chance)
    else:
        place[key] = junk(chance)
    return [msgpack.packb(header), *frames[1:]]


def edit_numbers(frames: Frames, chance: random.Random) -> Frames:
    """Sound framing, but numbers in the arrays that no solver can use."""
    if len(frames) == 1:
        return edit_body(frames, chance)
    at = chance.randrange(1, len(frames))
    numbers = np.frombuffer(frames[at][: len(frames[at]) // 8 * 8], "<f8").copy()
    if len(numbers):
        numbers[chance.randrange(len(numbers))] = chance.choice((np.nan, np.inf, -np.inf, 1e308, -1.0, 5e-324))
    return [*frames[:at], numbers.tobytes(), *frames[at + 1 :]]


MUTATIONS: tuple[Callable[[Frames, random.Random], Frames], ...] = (
    flip_bits, flip_bits, cut, lengthen, duplicate, remove, shuffle, random_bytes, deep, huge_claim, edit_header,
    edit_table, edit_table, *[edit_body] * 7, *[edit_numbers] * 3,
)  # fmt: skip


def mutated(record: list[Frames], chance: random.Random) -> Frames:
    """Return one request of the record under a new id, mutated once or twice."""
    frames = chance.choice(record)
    header = msgpack.unpackb(frames[0])
    header["id"] = uuid.UUID(int=chance.getrandbits(128)).hex
    frames = [msgpack.packb(header), *frames[1:]]
    if chance.random() < 0.05:
        frames = [frames[0], *chance.choice(record)[1:]]
    for _ in range(chance.choice((1, 1, 2))):
        try:
            frames = chance.choice(MUTATIONS)(frames, chance)
        except (ValueError, TypeError, KeyError, OverflowError, AttributeError, IndexError):
            frames = flip_bits(frames, chance)  # the first mutation left no header that the second could edit
    return frames


# --- what every answer is held against ---------------------------------------------------------------------------


def check_answer(answer: list[Frame], seen: Counter[str]) -> None:
    envelope = decode(answer)
    if envelope.kind == "error":
        code = envelope.body["code"]
        assert code in CODES and code != "internal", envelope.body
        assert envelope.body["sentence"]
        seen[code] += 1
    else:
        assert envelope.kind == "reply"
        seen["reply"] += 1


def check_still_right(role: str, client: Client, problem: Problem) -> None:
    """A whole right conversation on the service that was fuzzed."""
    client.hello(10.0)
    if role == "micromechanics":
        client.call("register", problem.request("register"), m.CellRegistered)
        stress = client.call("evaluate", problem.advance(0), m.Evaluated).stress
        assert np.isfinite(stress).all() and stress.any()
        return
    if role == "continuum":
        make_ready(client, problem)
        reply: Any = client.call("advance", problem.advance(0), c.ContinuumAdvanced, deadline=10.0)
    else:
        client.call("configure", problem.request("configure"), a.AtomisticConfigured)
        client.call("register", problem.request("register"), a.AtomisticRegistered)
        small = a.EquilibrateRequest(steps=2, windows=8, window_steps=2)
        client.call("equilibrate", small, a.Equilibrated)
        reply = client.call("advance", problem.advance(0), a.AtomisticAdvanced)
    assert reply.step > 0 and np.isfinite(reply.kinetic_energy)


def fuzz_dispatcher(role: str, count: int, seed: int) -> Counter[str]:
    host, record, problem = conversation(role)
    chance = random.Random(seed)
    seen: Counter[str] = Counter()
    own = psutil.Process()
    warm = 0
    for number in range(count):
        if number == KEPT_IDS + 500:  # from here on the table of ids is full
            warm = own.memory_info().rss
        check_answer(host.work.handle(list(mutated(record, chance))), seen)
    assert warm and own.memory_info().rss - warm < GROWTH
    assert seen["malformed_message"] > count // 5 and seen["bad_field"] > count // 20 and seen["reply"] > 0
    check_still_right(role, Client(InProcessChannel(host), role), problem)
    return seen


values = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats() | st.text(max_size=20)
    | st.binary(max_size=20),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=8,
)  # fmt: skip
operations = st.sampled_from(
    [
        "hello",
        "configure",
        "register",
        "advance",
        "evaluate",
        "fields",
        "checkpoint",
        "restore",
        "status",
        "shutdown",
        "x",
        "",
    ]
)
names = st.sampled_from(["steps", "ivc_force", "anchor_force", "anchor_position", "names", "state", "step", "material",
                         "body", "versions", "role", "client", "time_step", "edges", "cell", "strain",
                         "materials"])  # fmt: skip
entries = st.fixed_dictionaries(
    {
        "name": names | st.text(max_size=5),
        "dtype": st.sampled_from(["<f8", "<i8", "|u1", "|O", ">f8", ""]),
        "shape": st.lists(st.integers(-1, 4) | st.integers(0, 2**64 - 1), max_size=3),
        "order": st.sampled_from(["C", "C", "C", "F"]),
    }
)

#: Stands for an id that was never used; an id drawn by hypothesis would come again and again.
FRESH = "fresh"


def mostly(right: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    """Something sound in most cases, else anything: else hardly a message gets beyond its header."""
    return st.integers(0, 19).flatmap(lambda draw: values if draw == 7 else right)


headers = st.fixed_dictionaries(
    {
        "protocol": mostly(st.just([1, 0])),
        "kind": mostly(st.just("request")),
        "type": mostly(operations),
        "id": mostly(st.just(FRESH)),
        "body": mostly(st.dictionaries(names, values, max_size=5)),
        "arrays": st.integers(0, 3).flatmap(lambda draw: st.lists(entries, max_size=3) if draw == 2 else st.just([])),
    },
    optional={"more": values},
)


def pack(header: Any) -> bytes:
    if isinstance(header, bytes):
        return header
    return bytes(msgpack.packb({**header, "id": uuid.uuid4().hex} if header["id"] == FRESH else header))


frames_after = st.integers(0, 3).flatmap(
    lambda draw: st.lists(st.binary(max_size=32), max_size=3) if draw == 2 else st.just([])
)
messages = st.tuples(st.integers(0, 9).flatmap(lambda n: st.binary(max_size=60) if n == 5 else headers), frames_after)


def fuzz_generated(role: str, count: int) -> int:
    """Structures from hypothesis, in batches of ten, so that a failure is shrunk to a small one."""
    host, _, problem = conversation(role)
    seen: Counter[str] = Counter()
    batch = 10

    @settings(
        max_examples=count // batch, deadline=None, database=None, derandomize=True,
        phases=[Phase.generate, Phase.shrink], suppress_health_check=list(HealthCheck),
    )  # fmt: skip
    @given(st.lists(messages, min_size=batch, max_size=batch))
    def run(many: list[tuple[Any, list[bytes]]]) -> None:
        for first, others in many:
            check_answer(host.work.handle([pack(first), *others]), seen)

    run()
    assert len(seen) >= 4, seen
    check_still_right(role, Client(InProcessChannel(host), role), problem)
    return seen.total()


def fuzz_socket(folder: Path, count: int, seed: int) -> Counter[str]:
    """Through ROUTER and DEALER to a process; every message that was sent is answered, one for one."""
    _, record, problem = conversation("continuum")
    chance = random.Random(seed)
    seen: Counter[str] = Counter()
    arguments = ("--most-steps", str(MOST_STEPS), "--limit", str(1 << 24))
    with process("tcp://127.0.0.1:*", *arguments) as (service, endpoint):
        memory = psutil.Process(service.pid).memory_info
        bare = zmq.Context.instance().socket(zmq.DEALER)
        bare.setsockopt(zmq.LINGER, 0)
        bare.connect(endpoint)
        warm = 0
        window = 60
        for start in range(0, count, window):
            for _ in range(window):
                bare.send_multipart(mutated(record, chance))
            for _ in range(window):
                assert bare.poll(10_000), f"a message was not answered; seen so far {seen}"
                answer = bare.recv_multipart()
                check_answer(answer[1:] if answer[0] == b"" else answer, seen)
            assert service.poll() is None
            if start == count // 2 // window * window:
                warm = memory().rss
        assert bare.poll(100) == 0, "more answers than messages"
        host, port = endpoint.removeprefix("tcp://").split(":")
        for _ in range(40):  # no ZMTP at all
            with socket.create_connection((host, int(port))) as line:
                line.sendall(chance.randbytes(chance.choice((1, 10, 64, 500))))
        assert warm and memory().rss - warm < GROWTH
        bare.close()
        client = Client.connect(endpoint, "continuum", deadline=10)
        check_still_right("continuum", client, problem)
        client.close()
        assert service.poll() is None
    return seen


def test_more_than_twenty_thousand_messages(tmp_path: Path) -> None:
    count = 0
    for number, role in enumerate(sorted(TOYS)):
        count += fuzz_dispatcher(role, MUTATED, seed=number).total()
        count += fuzz_generated(role, GENERATED // 2)
    through_socket = fuzz_socket(tmp_path, THROUGH_SOCKET, seed=9).total()
    assert through_socket >= 3_000
    assert count + through_socket >= 20_000


def test_no_frames_at_all_is_answered() -> None:
    host, _, _ = conversation("continuum")
    answer = decode(host.work.handle([]))
    assert (answer.kind, answer.id, answer.body["code"]) == ("error", "?", "malformed_message")
