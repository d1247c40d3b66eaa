"""How a client's frames reach a service: through a ZeroMQ socket, or by a call in the same process."""

from __future__ import annotations

import contextlib
import uuid
from abc import ABC, abstractmethod
from pathlib import Path

import zmq
from zmq.utils.monitor import recv_monitor_message

from protocol.dispatcher import Dispatcher, Host
from protocol.frames import Frame
from protocol.security import CLIENT, SERVER, load_pair, load_public
from protocol.server import set_link
from protocol.socket_frames import receive_frames, send_frames

#: What a channel tells of its link.
CONNECTED = "connected"
DISCONNECTED = "disconnected"
REFUSED = "refused"

#: For so long a reply is waited for before the link is looked at too, ms.
QUICK_MS = 10

#: For so long a send may wait for room, ms.
SEND_MS = 100

_LINK_EVENTS: dict[int, str] = {
    zmq.EVENT_HANDSHAKE_SUCCEEDED: CONNECTED,
    zmq.EVENT_DISCONNECTED: DISCONNECTED,
    zmq.EVENT_HANDSHAKE_FAILED_AUTH: REFUSED,
    zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL: REFUSED,
    zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL: REFUSED,
}


class Channel(ABC):
    """Carries frames to one service and back."""

    @abstractmethod
    def send(self, frames: list[Frame]) -> None:
        """Send a request."""

    @abstractmethod
    def receive(self, seconds: float) -> list[Frame] | None:
        """Return the next reply, or None when `seconds` passed or the link changed."""

    @abstractmethod
    def link_events(self) -> list[str]:
        """Return what happened to the link since the last call, oldest first."""

    @abstractmethod
    def close(self) -> None:
        """Release the channel."""

    @abstractmethod
    def control(self, control_endpoint: str) -> Channel:
        """Return a channel to the control socket that the service named in its `hello`."""


class InProcessChannel(Channel):
    """Calls the dispatcher of a service in this process; same frames, same checks, no socket."""

    def __init__(self, host: Host, dispatcher: Dispatcher | None = None) -> None:
        self._host = host
        self._dispatcher = dispatcher or host.work
        self._replies: list[list[Frame]] = []

    def send(self, frames: list[Frame]) -> None:
        """Answer at once and keep the reply; arrays of the request are never written to."""
        self._replies.append(self._dispatcher.handle(frames))

    def receive(self, seconds: float) -> list[Frame] | None:
        """Return the kept reply."""
        return self._replies.pop(0) if self._replies else None

    def link_events(self) -> list[str]:
        """Return nothing: this link cannot break."""
        return []

    def close(self) -> None:
        """Nothing to release."""

    def control(self, control_endpoint: str) -> Channel:
        """Return a channel to the control operations."""
        return InProcessChannel(self._host, self._host.control)


class ZmqChannel(Channel):
    """A DEALER socket with heartbeats and a monitor.

    Parameters
    ----------
    endpoint : str
    keys : Path, optional
        Folder with the client's key pair and the server's public key; turns CURVE on.
    """

    def __init__(self, endpoint: str, keys: Path | None = None) -> None:
        self.endpoint = endpoint
        self._keys = keys
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context.instance()
        self._socket = self._context.socket(zmq.DEALER)
        set_link(self._socket, endpoint)
        self._socket.setsockopt(zmq.IDENTITY, uuid.uuid4().hex.encode())
        self._socket.setsockopt(zmq.LINGER, 200)
        self._socket.setsockopt(zmq.SNDTIMEO, SEND_MS)
        self._socket.setsockopt(zmq.RECONNECT_IVL, 50)
        self._socket.setsockopt(zmq.RECONNECT_IVL_MAX, 1000)
        if keys is not None:
            pair = load_pair(keys, CLIENT)
            self._socket.curve_publickey = pair.public
            self._socket.curve_secretkey = pair.secret
            self._socket.curve_serverkey = load_public(keys, SERVER)
        self._monitor = self._socket.get_monitor_socket(sum(_LINK_EVENTS))
        self._poller = zmq.Poller()
        self._poller.register(self._socket, zmq.POLLIN)
        self._poller.register(self._monitor, zmq.POLLIN)
        #: Time limit of the socket, ms; None until the first reply has come.
        self._time_limit: int | None = None
        self._socket.connect(endpoint)

    def send(self, frames: list[Frame]) -> None:
        """Send without copying large frames; their arrays must stay as they are until the reply."""
        # After a refused handshake the socket has no pipe left and would wait for one for ever. What could
        # not be sent then needs no error of its own: the events of the link tell why.
        with contextlib.suppress(zmq.Again):
            send_frames(self._socket, frames)

    def receive(self, seconds: float) -> list[Frame] | None:
        """Return the next reply, or None when `seconds` passed or the link changed."""
        milliseconds = max(0, int(seconds * 1000))
        # A quick reply is taken from the socket itself, which costs less than to look at two sockets first.
        # Not before the first one: until then the link is what is waited for.
        if self._time_limit is not None:
            with contextlib.suppress(zmq.Again):
                return self._receive(min(QUICK_MS, milliseconds))
            milliseconds = max(0, milliseconds - QUICK_MS)
        if self._socket in dict(self._poller.poll(milliseconds)):
            with contextlib.suppress(zmq.Again):  # what made the socket ready may be gone with its link
                return self._receive(0)
        return None

    def _receive(self, milliseconds: int) -> list[Frame]:
        if milliseconds != self._time_limit:
            self._socket.setsockopt(zmq.RCVTIMEO, milliseconds)
            self._time_limit = milliseconds
        return receive_frames(self._socket, copied=1)

    def link_events(self) -> list[str]:
        """Return what the monitor saw since the last call."""
        events = []
        while self._monitor.poll(0):
            event = recv_monitor_message(self._monitor)["event"]
            if event in _LINK_EVENTS:
                events.append(_LINK_EVENTS[event])
        return events

    def close(self) -> None:
        """Close the monitor first, then the socket (the other order hangs the context)."""
        self._poller.unregister(self._monitor)
        self._socket.disable_monitor()
        self._monitor.close()
        self._socket.close()

    def control(self, control_endpoint: str) -> Channel:
        """Return a channel to the control socket, at the host under which this client knows the service."""
        if control_endpoint.startswith("tcp://"):
            host = self.endpoint.removeprefix("tcp://").rsplit(":", 1)[0]
            control_endpoint = f"tcp://{host}:{control_endpoint.rsplit(':', 1)[1]}"
        return ZmqChannel(control_endpoint, self._keys)
