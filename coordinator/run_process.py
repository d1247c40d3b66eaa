"""A run as a child process that can be looked at, signalled and killed, with every process that it starts."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import psutil

from protocol.channel import ZmqChannel
from protocol.client import Client
from protocol.errors import ConnectionProblem
from protocol.messages import Status
from protocol.server import is_gone

#: The process of the run itself, beside the roles of its services.
COORDINATOR = "coordinator"
LOOK_SECONDS = 0.01
STATUS_SECONDS = 1.0


class RunEnded(RuntimeError):
    """The run ended, or time did, before it came to where it was awaited."""


class RunProcess:
    """`scalebridge run SCENE --out FOLDER` in a session of its own.

    Parameters
    ----------
    scene, folder : Path
        Scene file, and folder of the run.
    *words : str
        Further words of the command line, such as ``"--resume"``.
    """

    def __init__(self, scene: Path, folder: Path, *words: str) -> None:
        self.folder = folder.resolve()
        self._printed = self.folder.with_name(f"{self.folder.name}.printed")
        command = [sys.executable, "-m", "coordinator.cli", "run", str(scene), "--out", str(self.folder), *words]
        with self._printed.open("wb") as printed:
            self.process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=printed, stderr=subprocess.STDOUT, start_new_session=True
            )
        self._family: set[psutil.Process] = set()
        self._controls: dict[str, Client] = {}

    def __enter__(self) -> RunProcess:
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    @property
    def printed(self) -> str:
        """What the run has printed so far."""
        return self._printed.read_text(errors="replace")

    # --- looking -----------------------------------------------------------------------------------------

    def service(self, role: str) -> psutil.Process | None:
        """Return the process that the run started for a role: under MPI, the launcher of the ranks."""
        with contextlib.suppress(psutil.NoSuchProcess):
            for child in psutil.Process(self.process.pid).children():
                with contextlib.suppress(psutil.NoSuchProcess, psutil.AccessDenied):
                    words = child.cmdline()
                    if "serve" in words and role in words:
                        return child
        return None

    def status(self, role: str) -> Status | None:
        """Ask a service of the run what it does; None where it does not answer."""
        control = self._controls.get(role)
        if control is None:
            service = self.service(role)
            if service is None:
                return None
            words = service.cmdline()
            endpoint = words[words.index("--bind") + 1]
            if not Path(f"{endpoint.removeprefix('ipc://')}.control").exists():
                return None
            control = self._controls[role] = Client(ZmqChannel(f"{endpoint}.control"), role)
        with contextlib.suppress(ConnectionProblem):
            return control.call("status", None, Status, deadline=STATUS_SECONDS)
        return None

    def wait_until(self, reached: Callable[[], bool], what: str, seconds: float) -> None:
        """Wait until the run has come so far.

        Raises
        ------
        RunEnded
            Where it ended before, or `seconds` passed.
        """
        end = time.monotonic() + seconds
        while not reached():
            if self.process.poll() is not None:
                raise RunEnded(f"the run ended with {self.process.returncode} before {what}:\n{self.printed}")
            if time.monotonic() > end:
                raise RunEnded(f"the run did not come to {what} within {seconds:g} s:\n{self.printed}")
            time.sleep(LOOK_SECONDS)

    def wait_for_step(self, step: int, seconds: float = 120.0) -> None:
        """Wait until the continuum has made a coupling step."""

        def reached() -> bool:
            status = self.status("continuum")
            return status is not None and status.step >= step

        self.wait_until(reached, f"step {step}", seconds)

    def wait_for_operation(self, role: str, operation: str, seconds: float = 120.0) -> None:
        """Wait until a service is in the midst of an operation."""

        def reached() -> bool:
            status = self.status(role)
            return status is not None and status.operation == operation

        self.wait_until(reached, f"{operation} of {role}", seconds)

    # --- ending ------------------------------------------------------------------------------------------

    def send(self, name: str, number: signal.Signals) -> None:
        """Send a signal to the coordinator or to the service of a role."""
        self._note_family()
        target = psutil.Process(self.process.pid) if name == COORDINATOR else self.service(name)
        if target is None:
            raise RunEnded(f"there is no {name} to send {number.name} to:\n{self.printed}")
        target.send_signal(number)

    def wait(self, seconds: float) -> int:
        """Wait for the end of the run and return its exit status, negative for a signal.

        Raises
        ------
        RunEnded
            Where it goes on.
        """
        try:
            return self.process.wait(seconds)
        except subprocess.TimeoutExpired:
            raise RunEnded(f"the run goes on after {seconds:g} s:\n{self.printed}") from None

    def survivors(self, seconds: float) -> list[psutil.Process]:
        """Return what is left of the run's processes after at most so long, the coordinator's own among them."""
        end = time.monotonic() + seconds
        while (left := self._alive()) and time.monotonic() < end:
            time.sleep(LOOK_SECONDS)
        return left

    def end(self) -> None:
        """Kill whatever is left, and let go of the services."""
        for process in self._alive():
            with contextlib.suppress(psutil.NoSuchProcess):
                process.kill()
        self.process.wait()
        for control in self._controls.values():
            control.close()
        self._controls.clear()

    def _note_family(self) -> None:
        with contextlib.suppress(psutil.NoSuchProcess):
            top = psutil.Process(self.process.pid)
            self._family.update([top, *top.children(recursive=True)])

    def _alive(self) -> list[psutil.Process]:
        """Return the processes noted before, and all that have the folder of the run in their command line."""
        self._note_family()
        services = f"{self.folder}/services/"
        for process in psutil.process_iter():
            with contextlib.suppress(psutil.NoSuchProcess, psutil.AccessDenied):
                if any(services in word for word in process.cmdline()):
                    self._family.add(process)
        return [process for process in self._family if not is_gone(process)]
