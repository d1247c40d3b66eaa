"""The exchange with MUSCLE3: a macro model calls a micro model, two Python instances under its manager.

`python -m benchmarks.muscle_echo ADDRESS` runs both and takes orders (array, repeats) at a local socket; it
is a process of its own, because MUSCLE3 forks its instances and writes its logs where it runs.
"""

from __future__ import annotations

import contextlib
import importlib.util
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from multiprocessing.connection import Client as Caller
from multiprocessing.connection import Connection
from pathlib import Path

from benchmarks.lane import DirectLane, Lane, timed_trips
from protocol.arrays import FloatArray
from protocol.verification import CannotRun

#: Profiling off and a quiet log, so that the exchange alone is timed.
MODEL = """
ymmsl_version: v0.1
model:
  name: round_trip
  components:
    macro:
      implementation: macro
      ports: {o_i: up, s: back}
    micro:
      implementation: micro
      ports: {f_init: up, o_f: back}
  conduits:
    macro.up: micro.up
    micro.back: macro.back
settings:
  muscle_profile_level: none
  muscle_remote_log_level: WARNING
"""
START_SECONDS = 30.0


class MuscleLane(Lane):
    """Hands each batch to the macro model, which times it in its own process."""

    label = "MUSCLE3, tcp"
    peer = True

    def __init__(self, orders: Connection) -> None:
        self._orders = orders

    def batch(self, values: FloatArray, repeats: int) -> FloatArray:
        """See `Lane.batch`."""
        self._orders.send((values, repeats))
        seconds: FloatArray = self._orders.recv()
        return seconds


@contextlib.contextmanager
def muscle_lane(folder: Path) -> Iterator[MuscleLane]:
    """Start manager and instances, with their logs in `folder`.

    Raises
    ------
    CannotRun
        Where MUSCLE3 is not installed or does not start.
    """
    if importlib.util.find_spec("libmuscle") is None:
        raise CannotRun("muscle3 is not installed (`pip install muscle3`)")
    address = folder / "orders"
    log = folder / "muscle3.log"
    with socket.socket(socket.AF_UNIX) as listener, log.open("w") as output:
        listener.bind(str(address))
        listener.listen()
        process = subprocess.Popen(
            [sys.executable, "-m", "benchmarks.muscle_echo", str(address)],
            cwd=folder, stdout=output, stderr=subprocess.STDOUT,
        )  # fmt: skip
        try:
            with _accepted(listener, process, log) as orders:
                yield MuscleLane(orders)
                orders.send(None)
                process.wait(timeout=START_SECONDS)
        finally:
            if process.poll() is None:
                process.terminate()
                process.wait(timeout=START_SECONDS)


def _accepted(listener: socket.socket, process: subprocess.Popen[bytes], log: Path) -> Connection:
    """Return the connection from the macro model; give up when its process ends or takes too long."""
    listener.settimeout(0.2)
    end = time.monotonic() + START_SECONDS
    while time.monotonic() < end and process.poll() is None:
        with contextlib.suppress(TimeoutError):
            accepted, _ = listener.accept()
            accepted.setblocking(True)
            return Connection(accepted.detach())
    raise CannotRun(f"muscle3 did not start: {log.read_text()[-500:].strip()}")


def run(address: str) -> None:
    """Run the manager and both instances until an order says to end."""
    import ymmsl
    from libmuscle import Instance, Message
    from libmuscle.runner import run_simulation
    from ymmsl import Operator

    class Macro(DirectLane):
        label = MuscleLane.label

        def __init__(self, instance: Instance) -> None:
            self._instance = instance
            self._count = 0

        def trip(self, values: FloatArray) -> FloatArray:
            self._instance.send("up", Message(float(self._count), data=values))
            self._count += 1
            answer: FloatArray = self._instance.receive("back").data.array
            return answer

    def macro() -> None:
        instance = Instance({Operator.O_I: ["up"], Operator.S: ["back"]})
        while instance.reuse_instance():
            lane = Macro(instance)
            with Caller(address, family="AF_UNIX") as orders:
                while (order := orders.recv()) is not None:
                    orders.send(timed_trips(lane, *order))

    def micro() -> None:
        instance = Instance({Operator.F_INIT: ["up"], Operator.O_F: ["back"]})
        while instance.reuse_instance():
            message = instance.receive("up")
            instance.send("back", Message(message.timestamp, data=message.data.array))

    run_simulation(ymmsl.load(MODEL), {"macro": macro, "micro": micro})


if __name__ == "__main__":
    run(sys.argv[1])
