"""Links that break, services that die, parents that are gone."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import psutil
import pytest
from toy_services import TOYS, compute_without_lock
from wire_setup import SCRIPT, make_ready, process, wire

from protocol import continuum as c
from protocol.channel import DISCONNECTED
from protocol.client import LINK_GRACE_SECONDS, Client
from protocol.conformance_problems import Problem
from protocol.errors import DeadlineExpired, PeerLost, ServiceRestarted
from protocol.messages import Status
from protocol.server import HEARTBEAT_TIMEOUT_MS, ORPHANED


class Proxy:
    """Passes TCP on to a service, until told to cut or to swallow what comes."""

    def __init__(self, port: int) -> None:
        self._target = port
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        self._pairs: list[tuple[socket.socket, socket.socket]] = []
        self._lock = threading.Lock()
        self.connections = 0
        self.drop_replies = False
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while True:
            try:
                near, _ = self._listener.accept()
            except OSError:
                return
            far = socket.create_connection(("127.0.0.1", self._target))
            self.connections += 1
            with self._lock:
                self._pairs.append((near, far))
            threading.Thread(target=self._pump, args=(near, far, False), daemon=True).start()
            threading.Thread(target=self._pump, args=(far, near, True), daemon=True).start()

    def _pump(self, source: socket.socket, sink: socket.socket, is_reply: bool) -> None:
        with contextlib.suppress(OSError):
            while data := source.recv(65536):
                if not (is_reply and self.drop_replies):
                    sink.sendall(data)
        for end in (source, sink):
            with_shutdown(end)

    def cut(self) -> None:
        """Cut every connection; new ones are taken."""
        with self._lock:
            pairs, self._pairs = self._pairs, []
        for pair in pairs:
            for end in pair:
                with_shutdown(end)

    def close(self) -> None:
        # Without shutdown the listener lives on in the thread that waits in accept.
        with_shutdown(self._listener)
        self.cut()


def with_shutdown(end: socket.socket) -> None:
    with contextlib.suppress(OSError):
        end.shutdown(socket.SHUT_RDWR)
    end.close()


def test_link_cut_while_computing_runs_the_request_once(tmp_path: Path, problem: Problem) -> None:
    service = TOYS["continuum"]()
    with wire("tcp", tmp_path, service) as made:
        assert made.server is not None
        proxy = Proxy(int(made.server.endpoint.rsplit(":", 1)[1]))
        client = Client.connect(f"tcp://127.0.0.1:{proxy.port}", "continuum", deadline=5)
        make_ready(client, problem)
        service.compute_first = compute_without_lock(1.0)
        before, connections = service.advances, proxy.connections
        threading.Timer(0.3, proxy.cut).start()
        reply = client.call("advance", problem.advance(0), c.ContinuumAdvanced, deadline=10)
        assert proxy.connections > connections
        assert service.advances == before + 1
        assert reply.step == 5
        assert client.call("status", None, Status).step == 5
        client.close()
        proxy.close()


def test_reply_lost_on_the_way_is_sent_again_from_the_cache(tmp_path: Path, problem: Problem) -> None:
    service = TOYS["continuum"]()
    with wire("tcp", tmp_path, service) as made:
        assert made.server is not None
        proxy = Proxy(int(made.server.endpoint.rsplit(":", 1)[1]))
        client = Client.connect(f"tcp://127.0.0.1:{proxy.port}", "continuum", deadline=5)
        make_ready(client, problem)
        before = service.advances
        proxy.drop_replies = True

        def mend() -> None:
            deadline = time.monotonic() + 5
            while service.advances == before and time.monotonic() < deadline:
                time.sleep(0.01)
            time.sleep(0.1)
            proxy.drop_replies = False
            proxy.cut()

        threading.Thread(target=mend).start()
        reply = client.call("advance", problem.advance(0), c.ContinuumAdvanced, deadline=10)
        assert (reply.step, service.advances) == (5, before + 1)
        client.close()
        proxy.close()


def test_link_that_stays_broken_is_a_lost_peer(tmp_path: Path, problem: Problem) -> None:
    service = TOYS["continuum"]()
    with wire("tcp", tmp_path, service) as made:
        assert made.server is not None
        proxy = Proxy(int(made.server.endpoint.rsplit(":", 1)[1]))
        client = Client.connect(f"tcp://127.0.0.1:{proxy.port}", "continuum", deadline=5)
        make_ready(client, problem)
        service.compute_first = compute_without_lock(0.5)
        threading.Timer(0.2, proxy.close).start()
        began = time.monotonic()
        with pytest.raises(PeerLost, match="link to the continuum service broke during advance"):
            client.call("advance", problem.advance(0), c.ContinuumAdvanced, deadline=60)
        assert LINK_GRACE_SECONDS < time.monotonic() - began < LINK_GRACE_SECONDS + 2
        client.close()


class Died(Exception):
    pass


@pytest.mark.parametrize("transport", ["ipc", "tcp"])
def test_killed_service_is_seen_within_two_seconds(transport: str, tmp_path: Path, problem: Problem) -> None:
    endpoint = f"ipc://{tmp_path}/s" if transport == "ipc" else "tcp://127.0.0.1:*"
    with process(endpoint, "--compute", "30") as (service, bound):
        killed: list[float] = []

        def kill() -> None:
            service.send_signal(signal.SIGKILL)
            killed.append(time.monotonic())

        def watch() -> None:
            if service.poll() is not None:
                raise Died(f"the service ended with {service.returncode}")

        client = Client.connect(bound, "continuum", deadline=20, watch=watch)
        make_ready(client, problem)
        idle = Client.connect(bound, "continuum", deadline=20)
        idle._channel.link_events()
        threading.Timer(0.3, kill).start()
        with pytest.raises(Died, match="-9"):
            client.call("advance", problem.advance(0), c.ContinuumAdvanced)
        assert time.monotonic() - killed[0] < 2.0
        deadline = killed[0] + 2.0
        events: list[str] = []
        while DISCONNECTED not in events and time.monotonic() < deadline:
            events += idle._channel.link_events()
            time.sleep(0.01)
        assert DISCONNECTED in events
        client.close()
        idle.close()


def test_stopped_service_is_seen_by_its_missing_heartbeat(tmp_path: Path) -> None:
    """A process that neither runs nor ends (SIGSTOP) closes no connection; only the heartbeat tells."""
    with process("tcp://127.0.0.1:*") as (service, bound):
        client = Client.connect(bound, "continuum", deadline=20)
        client._channel.link_events()
        service.send_signal(signal.SIGSTOP)
        began = time.monotonic()
        while DISCONNECTED not in client._channel.link_events() and time.monotonic() - began < 5:
            time.sleep(0.01)
        took = time.monotonic() - began
        service.send_signal(signal.SIGCONT)
        client.close()
    assert 0.5 * HEARTBEAT_TIMEOUT_MS / 1e3 < took < 2.0


def test_restarted_service_is_told_from_the_old_one(tmp_path: Path, problem: Problem) -> None:
    endpoint = f"ipc://{tmp_path}/s"
    with process(endpoint) as (first, _):
        client = Client.connect(endpoint, "continuum", deadline=20)
        make_ready(client, problem)
        client.call("advance", problem.advance(0), c.ContinuumAdvanced)
        first.kill()
        first.wait()
        new = pytest.raises(ServiceRestarted, match="continuum service was started anew and has lost its state")
        with process(endpoint), new:
            client.call("advance", problem.advance(1), c.ContinuumAdvanced, deadline=20)
        client.close()


def test_service_that_never_comes_ends_with_a_deadline(tmp_path: Path) -> None:
    with pytest.raises(DeadlineExpired, match=r"did not answer hello within 0\.5 s"):
        Client.connect(f"ipc://{tmp_path}/nobody", "continuum", deadline=0.5)


def test_client_that_starts_first_meets_the_service(tmp_path: Path) -> None:
    endpoint = f"ipc://{tmp_path}/late"
    met: list[Client] = []
    waiting = threading.Thread(target=lambda: met.append(Client.connect(endpoint, "continuum", deadline=20)))
    waiting.start()
    time.sleep(0.3)
    with process(endpoint):
        waiting.join(timeout=20)
        assert met and met[0].welcome is not None and met[0].welcome.state == "new"
        # That the link came up late is no broken link: the next request goes its way.
        assert met[0].call("status", None, Status).state == "new"
        met[0].close()


def test_service_ends_when_its_parent_is_gone(tmp_path: Path) -> None:
    """A parent that is killed cannot tell its services; they notice."""
    code = (
        "import subprocess, sys, os, time\n"
        f"child = subprocess.Popen([sys.executable, {str(SCRIPT)!r}, 'continuum', 'ipc://{tmp_path}/s', "
        "'--parent', str(os.getpid())], stdout=subprocess.PIPE, text=True)\n"
        "child.stdout.readline()\nprint(child.pid, flush=True)\ntime.sleep(60)\n"
    )
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    service = psutil.Process(int(parent.stdout.readline()))
    assert service.is_running()
    os.kill(parent.pid, signal.SIGKILL)
    parent.wait()
    parent.stdout.close()
    deadline = time.monotonic() + 5
    while service.is_running() and service.status() != psutil.STATUS_ZOMBIE and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not service.is_running() or service.status() == psutil.STATUS_ZOMBIE


def test_service_whose_parent_never_lived_says_so(tmp_path: Path) -> None:
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    with process(f"ipc://{tmp_path}/s", "--parent", str(gone.pid)) as (service, bound):
        assert bound == ""
        assert service.wait(timeout=10) == ORPHANED


def test_shutdown_ends_the_process_with_status_zero(tmp_path: Path) -> None:
    from protocol.messages import Acknowledged

    with process(f"ipc://{tmp_path}/s", "--compute", "30") as (service, bound):
        client = Client.connect(bound, "continuum", deadline=20)
        assert client.control.call("shutdown", None, Acknowledged).operation == ""
        assert service.wait(timeout=5) == 0
        client.close()
