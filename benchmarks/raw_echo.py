"""The same exchange with pyzmq and msgpack alone: no models, no checks, no link supervision.

`python -m benchmarks.raw_echo ENDPOINT` is its server.
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from pathlib import Path

import msgpack
import numpy as np
import zmq

from benchmarks.lane import DirectLane, helper_process
from protocol.arrays import FloatArray


def header(values: FloatArray, kind: str, identity: str) -> bytes:
    """Pack a header of the size that ours has, about 350 bytes."""
    packed: bytes = msgpack.packb(
        {
            "protocol": [1, 0],
            "kind": kind,
            "type": "advance",
            "id": identity,
            "run": "bench",
            "session": "0123456789abcdef0123456789abcdef",
            "step": 1,
            "seconds": 1e-6,
            "body": {"steps": 1, "kinetic_energy": 1.0, "strain_energy": 1.0, "edge_work": 1.0, "points_lost": 0},
            "arrays": [{"name": "ivc_force", "dtype": "<f8", "shape": list(values.shape), "order": "C"}],
        }
    )
    return packed


def unpacked(head: memoryview, body: memoryview) -> FloatArray:
    """Return the array of a message; it shares memory with the frame."""
    shape = msgpack.unpackb(head)["arrays"][0]["shape"]
    return np.frombuffer(body, dtype=np.float64).reshape(shape)


class RawLane(DirectLane):
    """A DEALER socket, one msgpack header frame and one raw array frame each way, nothing copied that need not be."""

    label = "raw pyzmq, ipc"
    peer = True

    def __init__(self, socket: zmq.Socket[bytes]) -> None:
        self._socket = socket

    def trip(self, values: FloatArray) -> FloatArray:
        """Send the array and return the one that comes back, shape (n, 3)."""
        head = header(values, "request", "0123456789abcdef0123456789abcdef")
        self._socket.send_multipart([head, values.data], copy=False)
        head_frame, frame = self._socket.recv_multipart(copy=False)
        return unpacked(head_frame.buffer, frame.buffer)


@contextlib.contextmanager
def raw_lane(folder: Path) -> Iterator[RawLane]:
    """Start the server as a process of its own, with its socket in `folder`."""
    endpoint = f"ipc://{folder / 'raw'}"
    with (
        helper_process("benchmarks.raw_echo", endpoint),
        zmq.Context() as context,
        context.socket(zmq.DEALER) as socket,
    ):
        socket.setsockopt(zmq.LINGER, 0)
        socket.connect(endpoint)
        yield RawLane(socket)


def serve(endpoint: str) -> None:
    """Send every array back, until the process is ended."""
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    socket = context.socket(zmq.ROUTER)
    socket.bind(endpoint)
    print("ready", flush=True)
    while True:
        identity, head_frame, frame = socket.recv_multipart(copy=False)
        values = unpacked(head_frame.buffer, frame.buffer)
        reply = header(values, "reply", "0123456789abcdef0123456789abcdef")
        socket.send_multipart([identity.bytes, reply, values.data], copy=False)


if __name__ == "__main__":
    serve(sys.argv[1])
