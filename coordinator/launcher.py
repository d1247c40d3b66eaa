"""Starts services as processes of their own, watches them, names the one that failed, stops the rest."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import psutil

from protocol.backend import find
from protocol.client import Client
from protocol.errors import ConnectionProblem, ProtocolError
from protocol.messages import Acknowledged
from protocol.server import is_gone

#: The path of a Unix socket may have 107 characters; libzmq adds none.
LONGEST_SOCKET_PATH = 100
LOG_LINES = 12
READY_SECONDS = 120.0
STOP_SECONDS = 2.0
#: Threads of numerical libraries in a service: two solvers and their libraries share few cores.
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


class ServiceDied(Exception):
    """A service's process ended while it was needed."""


@dataclass
class ServiceProcess:
    """A started service.

    Attributes
    ----------
    name : str
        Of the service in its run: the role, or the region of atoms that it has.
    role, backend : str
    folder : Path
        Its working folder, with `log.txt` and, where the path is short enough, its socket.
    endpoint : str
    process : subprocess.Popen
    """

    name: str
    role: str
    backend: str
    folder: Path
    endpoint: str
    process: subprocess.Popen[bytes]
    _family: set[psutil.Process] = field(default_factory=set)

    @property
    def log_path(self) -> Path:
        """File with what the service printed."""
        return self.folder / "log.txt"

    def check(self) -> None:
        """Raise where the process has ended.

        Raises
        ------
        ServiceDied
            Names the service, its exit code or signal, and the last lines of its log.
        """
        code = self.process.poll()
        if code is None:
            return
        how = f"was killed by signal {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
        raise ServiceDied(f"the {self.name} service ({self.backend}) {how}\n{self.last_lines()}")

    def last_lines(self) -> str:
        """Return the last lines of the log, indented."""
        try:
            lines = self.log_path.read_text(errors="replace").splitlines()[-LOG_LINES:]
        except OSError:
            lines = []
        shown = "\n".join(f"    {line}" for line in lines) or "    (empty)"
        return f"  last lines of {self.log_path}:\n{shown}"

    def stop(self, client: Client | None) -> None:
        """End the process: ask, then terminate, then kill it with all its children."""
        self.note_family()
        if client is not None and self.process.poll() is None:
            with contextlib.suppress(ConnectionProblem, ProtocolError):
                client.control.call("shutdown", None, Acknowledged, deadline=1.0)
                self._wait(STOP_SECONDS)
        for ask in (psutil.Process.terminate, psutil.Process.kill):
            for one in self._alive():
                with contextlib.suppress(psutil.NoSuchProcess):
                    ask(one)
            self._wait(STOP_SECONDS / 2)
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(STOP_SECONDS)

    def note_family(self) -> None:
        """Remember the process and its descendants: ranks outlive a launcher that was killed."""
        self._family.update(_tree(self.process.pid))

    def _alive(self) -> list[psutil.Process]:
        self.process.poll()
        return [one for one in self._family if not is_gone(one)]

    def _wait(self, seconds: float) -> None:
        """Wait until the whole family has ended, at most so long."""
        end = time.monotonic() + seconds
        while self._alive() and time.monotonic() < end:
            time.sleep(0.02)


class Services:
    """The services of one run, by name: the role, or the region of atoms that a service has.

    Parameters
    ----------
    folder : Path
        Folder of the run; each service gets `folder/services/NAME`.
    run : str
        Id of the run.
    """

    def __init__(self, folder: Path, run: str) -> None:
        self._folder = folder
        self._run = run
        self._sockets: list[tempfile.TemporaryDirectory[str]] = []
        self.processes: dict[str, ServiceProcess] = {}
        self.clients: dict[str, Client] = {}

    def start(
        self, name: str, role: str, backend: str, ranks: int = 1, workers: int = 1, link_keys: Path | None = None
    ) -> None:
        """Start a service, or the front of several workers; `connect` waits until it is ready.

        It asks other services with the keys in `link_keys`, if it asks some over TCP.
        """
        folder = self._folder / "services" / name
        folder.mkdir(parents=True, exist_ok=True)
        endpoint = f"ipc://{self._socket_path(folder)}"
        command = [
            *find(role, backend).launch_words(ranks),
            *(sys.executable, "-m", "coordinator.cli", "serve", role, "--backend", backend),
            *("--bind", endpoint, "--folder", str(folder), "--parent", str(os.getpid())),
            *(("--workers", str(workers)) if workers > 1 else ()),
            *(("--link-keys", str(link_keys)) if link_keys is not None else ()),
        ]  # fmt: skip
        environment = {**os.environ, **{name: "1" for name in THREAD_VARIABLES}}
        with (folder / "log.txt").open("ab") as log:
            # A session of its own keeps Ctrl-C away from the services: the coordinator stops them in order.
            process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT, start_new_session=True,
                env=environment,
            )  # fmt: skip
        self.processes[name] = ServiceProcess(name, role, backend, folder, endpoint, process)

    def connect(self, name: str, watch: Callable[[], None] | None = None) -> Client:
        """Wait until a started service answers `hello`.

        Parameters
        ----------
        name : str
        watch : callable, optional
            Called while waiting, in the place of `check`; may raise to end the wait.

        Raises
        ------
        ServiceDied, ConnectionProblem, ProtocolError
        """
        started = self.processes[name]
        client = Client.connect(
            started.endpoint, started.role, run=self._run, watch=watch or self.check, deadline=READY_SECONDS
        )
        started.note_family()
        self.clients[name] = client
        return client

    def attach(
        self, name: str, role: str, endpoint: str, keys: Path | None, watch: Callable[[], None] | None = None
    ) -> Client:
        """Use a service that runs already, here or on another machine; it is not stopped with the run."""
        client = Client.connect(endpoint, role, keys=keys, run=self._run, watch=watch or self.check)
        self.clients[name] = client
        return client

    def check(self) -> None:
        """Raise `ServiceDied` where any started service has ended."""
        for process in self.processes.values():
            process.check()

    def stop(self) -> None:
        """Stop every service that this run started, and let go of the others."""
        for name, process in self.processes.items():
            process.stop(self.clients.get(name))
        for client in self.clients.values():
            client.close()
        for socket in self._sockets:
            socket.cleanup()
        self.processes, self.clients, self._sockets = {}, {}, []

    def _socket_path(self, folder: Path) -> Path:
        path = folder.resolve() / "socket"
        if len(str(path)) + len(".control") <= LONGEST_SOCKET_PATH:
            path.unlink(missing_ok=True)
            return path
        short = tempfile.TemporaryDirectory(prefix="scalebridge-")
        self._sockets.append(short)
        return Path(short.name) / "socket"


def _tree(pid: int) -> list[psutil.Process]:
    """Return a process and all its descendants, the descendants first."""
    try:
        top = psutil.Process(pid)
        return [*top.children(recursive=True), top]
    except psutil.NoSuchProcess:
        return []
