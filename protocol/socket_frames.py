"""Frames through a ZeroMQ socket, each the way that costs least for its size."""

from __future__ import annotations

import zmq

from protocol.frames import Frame

#: Below this size a copy costs less than what pyzmq does to avoid it.
SMALL_BYTES = 1 << 16


def send_frames(socket: zmq.Socket[bytes], frames: list[Frame]) -> None:
    """Send one message; large frames are not copied, so their arrays must stay as they are until it is gone."""
    for frame in frames[:-1]:
        socket.send(frame, zmq.SNDMORE, copy=memoryview(frame).nbytes < SMALL_BYTES)
    socket.send(frames[-1], copy=memoryview(frames[-1]).nbytes < SMALL_BYTES)


def receive_frames(socket: zmq.Socket[bytes], copied: int) -> list[Frame]:
    """Return the frames of the next message: the first `copied` ones as bytes, the others without a copy.

    Raises
    ------
    zmq.Again
        Where none comes within the socket's time limit. A message comes whole or not at all.
    """
    frames: list[Frame] = [socket.recv()]
    while socket.getsockopt(zmq.RCVMORE):
        frames.append(socket.recv() if len(frames) < copied else socket.recv(copy=False).buffer)
    return frames
