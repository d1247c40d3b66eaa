"""Services as processes: who died and how, and that nothing is left of them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from coordinator.launcher import LONGEST_SOCKET_PATH, ServiceDied, ServiceProcess, Services
from protocol.backend import BackendError
from protocol.errors import ConnectionProblem
from protocol.server import is_gone

pytestmark = pytest.mark.timeout(120)


@pytest.fixture
def spawned() -> Iterator[list[subprocess.Popen[bytes]]]:
    """Processes that are killed at the end of the test, whatever it left."""
    processes: list[subprocess.Popen[bytes]] = []
    yield processes
    for process in processes:
        if process.poll() is None:
            process.kill()
            process.wait()


def service(folder: Path, script: str, spawned: list[subprocess.Popen[bytes]]) -> ServiceProcess:
    """Start a Python script in the place of a service and wait until it has printed a line."""
    with (folder / "log.txt").open("wb") as log:
        process = subprocess.Popen(
            [sys.executable, "-u", "-c", textwrap.dedent(script)], stdout=log, stderr=log, start_new_session=True
        )
    spawned.append(process)
    made = ServiceProcess("continuum", "continuum", "mpm_service", folder, "ipc://none", process)
    wait_for(lambda: process.poll() is not None or b"\n" in made.log_path.read_bytes())
    return made


def wait_for(reached: object, seconds: float = 20.0) -> None:
    assert callable(reached)
    end = time.monotonic() + seconds
    while not reached():
        assert time.monotonic() < end, "what was waited for did not come"
        time.sleep(0.01)


def test_a_process_that_runs_passes_the_check(tmp_path: Path, spawned: list[subprocess.Popen[bytes]]) -> None:
    one = service(tmp_path, "import time; print('up'); time.sleep(60)", spawned)
    one.check()
    one.stop(None)
    assert one.process.returncode == -signal.SIGTERM


def test_a_process_that_ended_is_named_with_exit_code_and_last_lines(
    tmp_path: Path, spawned: list[subprocess.Popen[bytes]]
) -> None:
    one = service(tmp_path, "for n in range(40): print('line', n)\nraise SystemExit(7)", spawned)
    wait_for(lambda: one.process.poll() is not None)
    with pytest.raises(ServiceDied) as died:
        one.check()
    lines = str(died.value).splitlines()
    assert lines[0] == "the continuum service (mpm_service) ended with exit code 7"
    assert str(tmp_path / "log.txt") in lines[1]
    assert [line.strip() for line in lines[2:]] == [f"line {n}" for n in range(28, 40)]


def test_a_process_that_was_killed_is_named_with_its_signal(
    tmp_path: Path, spawned: list[subprocess.Popen[bytes]]
) -> None:
    one = service(tmp_path, "import time; print('up'); time.sleep(60)", spawned)
    one.process.send_signal(signal.SIGSEGV)
    wait_for(lambda: one.process.poll() is not None)
    with pytest.raises(ServiceDied, match="was killed by signal SIGSEGV"):
        one.check()


@pytest.mark.parametrize("stopped", [False, True])
def test_a_process_that_will_not_end_is_killed_with_its_children(
    tmp_path: Path, spawned: list[subprocess.Popen[bytes]], stopped: bool
) -> None:
    script = """
        import signal, subprocess, sys, time
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
        print(child.pid)
        time.sleep(60)
        """
    one = service(tmp_path, script, spawned)
    child = psutil.Process(int(one.log_path.read_text()))
    if stopped:
        one.process.send_signal(signal.SIGSTOP)
    began = time.monotonic()
    one.stop(None)
    assert time.monotonic() - began < 5.0
    assert one.process.returncode == -signal.SIGKILL
    assert is_gone(child)


def test_children_that_outlive_a_killed_process_are_ended(
    tmp_path: Path, spawned: list[subprocess.Popen[bytes]]
) -> None:
    script = """
        import subprocess, sys, time
        command = [sys.executable, "-c", "import time; time.sleep(60)"]
        print(subprocess.Popen(command, start_new_session=True).pid)
        time.sleep(60)
        """
    one = service(tmp_path, script, spawned)
    child = psutil.Process(int(one.log_path.read_text()))
    one.note_family()
    one.process.kill()
    one.process.wait()
    assert not is_gone(child)
    one.stop(None)
    assert is_gone(child)


def test_a_real_service_starts_answers_and_stops_even_in_a_deep_folder(tmp_path: Path) -> None:
    folder = tmp_path / ("d" * 60) / ("e" * 60)
    services = Services(folder, "test")
    try:
        services.start("continuum", "continuum", "mpm_service")
        started = services.processes["continuum"]
        assert len(started.endpoint.removeprefix("ipc://")) <= LONGEST_SOCKET_PATH
        client = services.connect("continuum")
        assert client.welcome is not None and client.welcome.backend == "mpm_service"
        services.check()
    finally:
        services.stop()
    assert started.process.returncode == 0
    assert not Path(started.endpoint.removeprefix("ipc://")).parent.exists()
    assert "listens at" in started.log_path.read_text()


def test_waiting_for_a_service_can_be_ended_by_who_waits(tmp_path: Path) -> None:
    class Enough(Exception):
        pass

    def watch() -> None:
        raise Enough

    services = Services(tmp_path, "test")
    try:
        services.start("continuum", "continuum", "mpm_service")
        process = services.processes["continuum"].process
        with pytest.raises(Enough):
            services.connect("continuum", watch)
    finally:
        services.stop()
    assert process.returncode is not None


def test_waiting_for_a_service_that_dies_at_its_start_names_it(
    tmp_path: Path, spawned: list[subprocess.Popen[bytes]]
) -> None:
    services = Services(tmp_path, "test")
    one = service(tmp_path, "print('no such library'); raise SystemExit(1)", spawned)
    one.endpoint = f"ipc://{tmp_path}/socket"
    services.processes["continuum"] = one
    began = time.monotonic()
    with pytest.raises(ServiceDied, match="ended with exit code 1") as died:
        services.connect("continuum")
    assert "no such library" in str(died.value)
    assert time.monotonic() - began < 5.0
    services.stop()


def test_an_unknown_backend_starts_nothing(tmp_path: Path) -> None:
    services = Services(tmp_path, "test")
    with pytest.raises(BackendError, match="installed for it: mpm_service"):
        services.start("continuum", "continuum", "no_such_backend")
    assert services.processes == {}
    assert psutil.Process(os.getpid()).children() == []


def test_a_backend_of_one_process_refuses_ranks(tmp_path: Path) -> None:
    with pytest.raises(BackendError, match="mpm_service runs as one process, not as 2 ranks"):
        Services(tmp_path, "test").start("continuum", "continuum", "mpm_service", ranks=2)


def test_attaching_to_nobody_is_ended_by_who_waits(tmp_path: Path) -> None:
    looks = 0

    def watch() -> None:
        nonlocal looks
        looks += 1
        if looks == 3:
            raise ConnectionProblem("waited long enough")

    services = Services(tmp_path, "test")
    with pytest.raises(ConnectionProblem, match="long enough"):
        services.attach("atomistic", "atomistic", f"ipc://{tmp_path}/nobody", None, watch)
    assert services.clients == {}
