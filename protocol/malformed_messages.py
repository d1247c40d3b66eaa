"""Messages that break the framing, each in one way: for the conformance kit."""

from __future__ import annotations

from typing import Any

import msgpack
import numpy as np

from protocol.frames import Envelope, encode

#: Id that a service can read in some of the messages.
MALFORMED_ID = "malformed"


def malformed_messages() -> list[tuple[str, list[bytes]]]:
    """Return messages that are none, each with a word for it."""
    array = np.arange(6.0).reshape(2, 3)
    good = [bytes(frame) for frame in encode(Envelope("request", "status", MALFORMED_ID, {}, {"x": array}))]
    header: dict[str, Any] = msgpack.unpackb(good[0])
    entry = header["arrays"][0]

    def with_header(**values: Any) -> list[bytes]:
        return [msgpack.packb({**header, **values}), good[1]]

    def with_entry(**values: Any) -> list[bytes]:
        return with_header(arrays=[{**entry, **values}])

    without_id = {key: value for key, value in header.items() if key != "id"}
    nested: Any = []
    for _ in range(400):
        nested = [nested]
    return [
        ("an empty frame", [b""]),
        ("bytes that are no msgpack", [b"\xc1 scale"]),
        ("a number", [msgpack.packb(42)]),
        ("a list", [msgpack.packb([1, 2])]),
        ("bytes after the map", [good[0] + b"\x00", good[1]]),
        ("a map cut short", [good[0][:-3], good[1]]),
        ("no id", [msgpack.packb(without_id), good[1]]),
        ("an id that is a number", with_header(id=5)),
        ("an empty id", with_header(id="")),
        ("an id of 65 characters", with_header(id="x" * 65)),
        ("kind reply", with_header(kind="reply")),
        ("protocol as text", with_header(protocol="1.0")),
        ("a body that is a list", with_header(body=[1])),
        ("a body nested 400 deep, as a list", with_header(body=nested)),
        ("a body with a number as key", with_header(body={1: 2})),
        ("a frame too few", good[:1]),
        ("a frame too many", [*good, b""]),
        ("a frame too short", [good[0], good[1][:-8]]),
        ("a frame too long", [good[0], good[1] + bytes(8)]),
        ("a huge shape", with_entry(shape=[1 << 62, 1 << 62])),
        ("a negative size", with_entry(shape=[-2, 3])),
        ("nine axes", with_entry(shape=[1] * 9)),
        ("big-endian numbers", with_entry(dtype=">f8")),
        ("pickled objects", with_entry(dtype="|O")),
        ("Fortran order", with_entry(order="F")),
        ("a name twice", [msgpack.packb({**header, "arrays": [entry, entry]}), good[1], good[1]]),
    ]
