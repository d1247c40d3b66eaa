"""Envelope: a msgpack header frame, then one raw frame per array."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from math import isfinite, prod
from typing import Any

import msgpack
import numpy as np
from pydantic import BaseModel, ConfigDict, Field, NonNegativeInt, ValidationError

from protocol.arrays import WIRE_TYPES
from protocol.errors import ProtocolError
from protocol.version import NEWEST, Version

#: Default limit of a message, all frames together.
MAX_MESSAGE_BYTES = 1 << 30
#: A header larger than this is refused before it is read.
MAX_HEADER_BYTES = 1 << 24

Frame = Any  # bytes, memoryview or zmq.Frame buffer

#: One packer for all: a new one takes a large buffer each time. The lock keeps two threads out of it at once.
_PACKER = msgpack.Packer()
_PACKING = threading.Lock()
_DTYPES = {name: np.dtype(name) for name in WIRE_TYPES}


class ArrayEntry(BaseModel):
    """Row of the array table: frame k + 1 holds the array of row k."""

    model_config = ConfigDict(extra="ignore", strict=True)

    name: str = Field(description="field of the message; `f.a` for entry `a` of a map of arrays `f`; no name twice")
    dtype: str = Field(description="`<f8` (float64), `<i8` (int64) or `|u1` (byte), little-endian")
    shape: list[NonNegativeInt] = Field(max_length=8, description="sizes, slowest axis first; a size may be 0")
    order: str = Field(description="always `C`: the last axis is contiguous")


class Header(BaseModel):
    """First frame of every message."""

    model_config = ConfigDict(extra="ignore", strict=True)

    protocol: list[NonNegativeInt] = Field(
        min_length=2, max_length=2, description="version in use; of a `hello`, the newest of the sender"
    )
    kind: str = Field(pattern="^(request|reply|error)$", description="`request`, `reply` or `error`")
    type: str = Field(max_length=64, description="operation, such as `advance`; a reply repeats it")
    id: str = Field(min_length=1, max_length=64, description="id of the request; a reply repeats it")
    run: str = Field(default="", max_length=128, description="id of the run, for logs")
    session: str = Field(default="", max_length=64, description="of replies: changes when a service starts anew")
    step: int = Field(
        default=0, ge=-(2**63), lt=2**63, description="step counter of the coordinator; a reply repeats it"
    )
    seconds: float = Field(default=0.0, allow_inf_nan=False, description="[s] of replies: time spent computing")
    body: dict[str, Any] = Field(default_factory=dict, description="fields that are not arrays")
    arrays: list[ArrayEntry] = Field(default_factory=list, max_length=256, description="table of the array frames")


_HEADER_KEYS = frozenset(Header.model_fields)
_TABLE_KEYS = frozenset(ArrayEntry.model_fields)


@dataclass(slots=True)
class Envelope:
    """A message as it travels, with its arrays."""

    kind: str
    type: str
    id: str
    body: dict[str, Any]
    arrays: dict[str, np.ndarray] = field(default_factory=dict)
    run: str = ""
    session: str = ""
    step: int = 0
    seconds: float = 0.0
    protocol: Version = NEWEST


def encode(envelope: Envelope) -> list[Frame]:
    """Return the frames of a message; array frames share memory with the arrays.

    Raises
    ------
    ProtocolError
        `malformed_message` where an array is not of a wire type or the body cannot be packed.
    """
    table = []
    frames: list[Frame] = [b""]
    for name, array in envelope.arrays.items():
        dtype = array.dtype.str
        if dtype not in WIRE_TYPES:
            raise ProtocolError(
                "malformed_message",
                f"array {name} has dtype {dtype}, allowed are {', '.join(WIRE_TYPES)}",
            )
        contiguous = np.ascontiguousarray(array)
        table.append({"name": name, "dtype": dtype, "shape": list(array.shape), "order": "C"})
        # A memoryview cannot be cast where a size is zero; such a frame is empty.
        frames.append(contiguous.data.cast("B") if contiguous.size else b"")
    header = {
        "protocol": list(envelope.protocol),
        "kind": envelope.kind,
        "type": envelope.type,
        "id": envelope.id,
        "run": envelope.run,
        "session": envelope.session,
        "step": envelope.step,
        "seconds": envelope.seconds,
        "body": envelope.body,
        "arrays": table,
    }
    try:
        with _PACKING:
            frames[0] = _PACKER.pack(header)
    except (TypeError, ValueError, OverflowError) as error:
        raise ProtocolError("malformed_message", f"the body of {envelope.type} cannot be packed: {error}") from error
    return frames


def size_of(frames: list[Frame]) -> int:
    """Return the bytes of all frames together."""
    return sum([memoryview(frame).nbytes for frame in frames])


def decode(frames: list[Frame]) -> Envelope:
    """Return the message that the frames hold; arrays share memory with their frames and are read-only.

    Raises
    ------
    ProtocolError
        `malformed_message`, with a sentence that says what is wrong.
    """
    if not frames:
        raise ProtocolError("malformed_message", "a message needs a header frame, got none")
    first = memoryview(frames[0])
    if first.nbytes > MAX_HEADER_BYTES:
        raise ProtocolError("malformed_message", f"the header has {first.nbytes} bytes, at most {MAX_HEADER_BYTES}")
    try:
        raw = msgpack.unpackb(first, strict_map_key=True)
    except Exception as error:  # msgpack raises ValueError, its own kinds and UnicodeDecodeError alike
        raise ProtocolError("malformed_message", f"the header frame is not msgpack: {error}") from None
    header = raw if plainly_valid(raw) else _validated(raw)
    table = header["arrays"]
    if len(frames) != len(table) + 1:
        raise ProtocolError(
            "malformed_message",
            f"the array table lists {len(table)} arrays, but {len(frames) - 1} frames follow",
        )
    arrays: dict[str, np.ndarray] = {}
    for entry, frame in zip(table, frames[1:], strict=True):
        arrays[entry["name"]] = _array(entry, frame)
    if len(arrays) != len(table):
        raise ProtocolError("malformed_message", "the array table lists a name twice", field="header.arrays")
    return Envelope(
        kind=header["kind"], type=header["type"], id=header["id"], body=header["body"], arrays=arrays,
        run=header["run"], session=header["session"], step=header["step"], seconds=header["seconds"],
        protocol=Version(*header["protocol"]),
    )  # fmt: skip


def plainly_valid(raw: Any) -> bool:
    """Return whether a header has every key in its plainest legal form.

    Nearly every header has; this costs a tenth of the model's check, which decides on all others and says
    what is wrong.
    """
    if type(raw) is not dict or raw.keys() != _HEADER_KEYS:
        return False
    protocol, table, seconds, step = raw["protocol"], raw["arrays"], raw["seconds"], raw["step"]
    return (
        type(protocol) is list
        and len(protocol) == 2
        and _natural(protocol[0])
        and _natural(protocol[1])
        and raw["kind"] in ("request", "reply", "error")
        and _short_text(raw["type"])
        and _short_text(raw["id"])
        and raw["id"] != ""
        and _short_text(raw["run"])
        and _short_text(raw["session"])
        and type(step) is int
        and abs(step) < 1 << 62
        and type(seconds) is float
        and isfinite(seconds)
        and type(raw["body"]) is dict
        and all([type(key) is str for key in raw["body"]])
        and type(table) is list
        and len(table) < 256
        and all(
            type(row) is dict
            and row.keys() == _TABLE_KEYS
            and type(row["name"]) is str
            and type(row["dtype"]) is str
            and type(row["order"]) is str
            and type(row["shape"]) is list
            and len(row["shape"]) < 8
            and all([_natural(size) for size in row["shape"]])
            for row in table
        )
    )


def _natural(value: Any) -> bool:
    return type(value) is int and 0 <= value < 1 << 62


def _short_text(value: Any) -> bool:
    return type(value) is str and len(value) <= 64


def _validated(raw: Any) -> dict[str, Any]:
    """Return the header with its defaults, by the rules of the model."""
    try:
        return Header.model_validate(raw).model_dump()
    except ValidationError as error:
        problem = error.errors()[0]
        path = ".".join(str(part) for part in problem["loc"]) or "header"
        raise ProtocolError(
            "malformed_message", f"header field {path}: {problem['msg']}", field=f"header.{path}"
        ) from None


def _array(entry: dict[str, Any], frame: Frame) -> np.ndarray:
    """Return the array of one frame, checked against its row of the table."""
    shape, dtype = entry["shape"], _DTYPES.get(entry["dtype"])
    if dtype is None:
        raise _malformed_row(entry, f"dtype {entry['dtype']!r} is none of {', '.join(WIRE_TYPES)}")
    if entry["order"] != "C":
        raise _malformed_row(entry, f"order {entry['order']!r} is not C")
    count = prod(shape)
    view = memoryview(frame)
    if view.nbytes != count * dtype.itemsize:
        raise _malformed_row(
            entry,
            f"shape {shape} of {entry['dtype']} needs {count * dtype.itemsize} bytes, the frame has {view.nbytes}",
        )
    try:
        array = np.frombuffer(view, dtype=dtype).reshape(shape) if count else np.empty(shape, dtype)
    except ValueError as error:  # a shape with a zero and sizes beyond what numpy can index
        raise _malformed_row(entry, f"shape {shape}: {error}") from None
    if not array.flags.aligned:
        array = array.copy()  # compiled solvers need aligned memory; large frames always are
    array.setflags(write=False)
    return array


def _malformed_row(entry: dict[str, Any], sentence: str) -> ProtocolError:
    return ProtocolError("malformed_message", sentence, field=f"header.arrays.{entry['name']}")
