"""What the tests of the wire share: services on every transport, services as processes, requests."""

from __future__ import annotations

import contextlib
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from toy_services import TOYS, Toy

from protocol import continuum as c
from protocol.channel import Channel, InProcessChannel, ZmqChannel
from protocol.client import Client
from protocol.conformance_problems import Problem, continuum_problem
from protocol.dispatcher import Host
from protocol.security import make_keys
from protocol.server import Server, running

TRANSPORTS = ("in_process", "ipc", "tcp", "tcp_curve")
SCRIPT = Path(__file__).with_name("toy_services.py")


class Wire:
    """A toy service behind one transport, with ways to reach it."""

    def __init__(self, service: Toy, host: Host, connect: Callable[[], Channel], server: Server | None) -> None:
        self.service, self.host, self.channel, self.server = service, host, connect, server

    def client(self, role: str | None = None) -> Client:
        client = Client(self.channel(), role or self.service.role)
        client.hello(5.0)
        return client


@contextlib.contextmanager
def wire(transport: str, folder: Path, service: Toy, **options: Any) -> Iterator[Wire]:
    if transport == "in_process":
        host = Host(service, options.get("max_message_bytes", 1 << 30))
        yield Wire(service, host, lambda: InProcessChannel(host), None)
        return
    endpoint = f"ipc://{folder}/socket" if transport == "ipc" else "tcp://127.0.0.1:*"
    keys = None
    if transport == "tcp_curve":
        keys = folder / "keys"
        make_keys(keys)
    with running(service, endpoint, keys=keys, **options) as server:
        yield Wire(service, server.host, lambda: ZmqChannel(server.endpoint, keys), server)


@pytest.fixture(params=TRANSPORTS)
def any_wire(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Wire]:
    """The continuum toy on each transport in turn."""
    with wire(request.param, tmp_path, TOYS["continuum"](), max_message_bytes=1 << 24) as made:
        yield made


@pytest.fixture
def problem() -> Problem:
    return continuum_problem()


@contextlib.contextmanager
def process(endpoint: str, *arguments: str, role: str = "continuum") -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A toy service as a process of its own; yields it and its endpoint."""
    command = [sys.executable, str(SCRIPT), role, endpoint, *arguments]
    started = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert started.stdout is not None
    try:
        yield started, started.stdout.readline().strip()
    finally:
        started.kill()
        started.wait()
        started.stdout.close()


def make_ready(client: Client, problem: Problem) -> None:
    """Bring a continuum service to the state `ready`."""
    client.call("configure", problem.request("configure"), c.ContinuumConfigured)
    client.call("register", problem.request("register"), c.ContinuumRegistered)
