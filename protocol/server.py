"""A service behind ZeroMQ: a work socket in the solver's thread, a control socket in a thread of its own.

The work socket is polled by the thread that computes, so a request costs no hop between threads. The
control thread answers status, abort and shutdown while the solver computes (solvers release the
interpreter lock). A third thread ends the process when its parent is gone.
"""

from __future__ import annotations

import contextlib
import logging
import os
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from urllib.parse import urlsplit

import psutil
import zmq
import zmq.auth
from zmq.auth.thread import ThreadAuthenticator

from protocol.dispatcher import Dispatcher, Host
from protocol.frames import MAX_MESSAGE_BYTES
from protocol.security import AUTHORIZED, SERVER, check_binding, is_local, load_pair
from protocol.service import Service
from protocol.socket_frames import receive_frames, send_frames

log = logging.getLogger(__name__)

HEARTBEAT_INTERVAL_MS = 200
HEARTBEAT_TIMEOUT_MS = 800
#: Of the kernel, for each direction on one machine: with its own choice, a frame of 48 MB takes two to five times as
#: long over tcp, and with more than this no less.
BUFFER_BYTES = 1 << 18
POLL_MS = 100
#: Exit status of a service whose parent is gone.
ORPHANED = 3


def set_link(socket: zmq.Socket[bytes], endpoint: str) -> None:
    """Let both ends notice a dead peer within a second, even while Python computes; give frames of megabytes room."""
    socket.setsockopt(zmq.HEARTBEAT_IVL, HEARTBEAT_INTERVAL_MS)
    socket.setsockopt(zmq.HEARTBEAT_TIMEOUT, HEARTBEAT_TIMEOUT_MS)
    socket.setsockopt(zmq.HEARTBEAT_TTL, HEARTBEAT_TIMEOUT_MS)
    if is_local(endpoint):  # between machines the kernel finds a size that fits the distance
        socket.setsockopt(zmq.SNDBUF, BUFFER_BYTES)
        socket.setsockopt(zmq.RCVBUF, BUFFER_BYTES)


class Server:
    """One service at one endpoint.

    Parameters
    ----------
    service : Service
    endpoint : str
        `ipc://PATH` or `tcp://HOST:PORT`; `*` as port takes a free one.
    keys : Path, optional
        Folder made by `scalebridge keys`; turns CURVE on.
    insecure_public : bool
        Allow an address beyond this machine without keys.
    max_message_bytes : int
        Limit of a message, all frames together.
    parent : int, optional
        Process id; when that process is gone, this one exits.

    Raises
    ------
    SecurityError
        Where the address needs keys, or they cannot be read.
    """

    def __init__(
        self,
        service: Service,
        endpoint: str,
        *,
        keys: Path | None = None,
        insecure_public: bool = False,
        max_message_bytes: int = MAX_MESSAGE_BYTES,
        parent: int | None = None,
    ) -> None:
        check_binding(endpoint, keys, insecure_public)
        self.host = Host(service, max_message_bytes)
        if parent is not None:
            end_with(parent)
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._sockets: list[zmq.Socket[bytes]] = []
        self._authenticator: ThreadAuthenticator | None = None
        if keys is not None:
            self._authenticator = ThreadAuthenticator(self._context)
            self._authenticator.start()
            self._authenticator.configure_curve(domain="*", location=str(keys / AUTHORIZED))
        self._keys = load_pair(keys, SERVER) if keys is not None else None
        try:
            self._work = self._bind(endpoint)
            self.endpoint = self._work.getsockopt_string(zmq.LAST_ENDPOINT)
            self._control = self._bind(_control_address(self.endpoint))
            self.host.control_endpoint = self._control.getsockopt_string(zmq.LAST_ENDPOINT)
        except zmq.ZMQError:
            self.close()
            raise

    def _bind(self, endpoint: str) -> zmq.Socket[bytes]:
        socket = self._context.socket(zmq.ROUTER)
        self._sockets.append(socket)
        set_link(socket, endpoint)
        socket.setsockopt(zmq.LINGER, 1000)
        # A client that reconnects under its old identity takes over from its broken connection.
        socket.setsockopt(zmq.ROUTER_HANDOVER, 1)
        # The named error for a large message needs the message; beyond twice the limit libzmq cuts it off.
        socket.setsockopt(zmq.MAXMSGSIZE, 2 * self.host.max_message_bytes)
        if self._keys is not None:
            socket.curve_server = True
            socket.curve_publickey = self._keys.public
            socket.curve_secretkey = self._keys.secret
        socket.bind(endpoint)
        return socket

    def run(self, on_ready: Callable[[str], None] | None = None) -> None:
        """Serve until a client asks to shut down or `stop` is called."""
        control = threading.Thread(target=self._run_control, name="control", daemon=True)
        control.start()
        if on_ready is not None:
            on_ready(self.endpoint)
        try:
            _answer_until(self._work, self.host.work, lambda: self.host.stopping)
        finally:
            self.host.stopping = True
            control.join(timeout=5)
            self.host.service.close()
            self.close()

    def stop(self) -> None:
        """End `run` at its next look; the operation in work is aborted at its next check."""
        self.host.service.activity.abort.set()
        self.host.stopping = True

    def _run_control(self) -> None:
        _answer_until(self._control, self.host.control, lambda: self.host.stopping)

    def close(self) -> None:
        """Close sockets; replies on their way are given a second."""
        for socket in self._sockets:
            socket.close()
        if self._authenticator is not None:
            self._authenticator.stop()
            self._authenticator = None
        self._context.term()


def _answer_until(socket: zmq.Socket[bytes], dispatcher: Dispatcher, done: Callable[[], bool]) -> None:
    # A time limit on the socket spares the poll before each message.
    socket.setsockopt(zmq.RCVTIMEO, POLL_MS)
    while not done():
        try:
            identity, *frames = receive_frames(socket, copied=2)
        except zmq.Again:
            continue
        # A DEALER may or may not put an empty delimiter first, as REQ does; its reply then has one too.
        envelope = [identity]
        if len(frames) > 1 and len(frames[0]) == 0:
            frames = frames[1:]
            envelope.append(b"")
        send_frames(socket, [*envelope, *dispatcher.handle(frames)])


def _control_address(endpoint: str) -> str:
    """Return where the control socket binds beside a work socket."""
    parts = urlsplit(endpoint)
    if parts.scheme == "ipc":
        return endpoint + ".control"
    host = endpoint.removeprefix("tcp://").rsplit(":", 1)[0]
    return f"tcp://{host}:*"


def end_with(pid: int) -> None:
    """Let this process exit soon after another one is gone, whatever it does then.

    Parameters
    ----------
    pid : int
        Process id of the other one.
    """
    try:
        other = psutil.Process(pid)
    except psutil.NoSuchProcess:
        os._exit(ORPHANED)

    def watch() -> None:
        while not is_gone(other):
            time.sleep(POLL_MS / 1000)
        log.error("the parent process %d is gone: exit", pid)
        os._exit(ORPHANED)

    threading.Thread(target=watch, name="parent", daemon=True).start()


def is_gone(process: psutil.Process) -> bool:
    """Return whether a process has ended, be it that nobody has asked for its exit status yet (a zombie)."""
    try:
        return not process.is_running() or bool(process.status() == psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:
        return True


@contextlib.contextmanager
def running(service: Service, endpoint: str, **options: object) -> Iterator[Server]:
    """Serve from a thread of this process, for tests and notebooks."""
    server = Server(service, endpoint, **options)  # type: ignore[arg-type]
    thread = threading.Thread(target=server.run, name="server", daemon=True)
    thread.start()
    try:
        yield server
    finally:
        server.stop()
        thread.join(timeout=10)
