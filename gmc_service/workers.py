"""Worker processes of this machine behind one front.

Each worker is an ordinary service at a socket of its own, with a thread of the front that hands it one job after
another from a queue that all share. If a worker ends, its job goes back to the head of the queue and it is started
anew; since the role is stateless nothing is lost.
"""

from __future__ import annotations

import contextlib
import logging
import os
import subprocess
import tempfile
import threading
from collections import deque
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Final

from gmc_service.front import Executor, Job
from protocol.client import Client
from protocol.errors import ConnectionProblem, ProtocolError
from protocol.messages import Acknowledged, Message
from protocol.micromechanics import CellRegistered
from protocol.micromechanics_query import ask_or_register
from protocol.service import Capabilities

log = logging.getLogger(__name__)

#: Seconds that a worker has to answer its first hello: it may compile first.
READY_SECONDS: Final = 120.0
#: Workers that one job may cost before it is given up: then the job is what ends them.
MOST_TRIES: Final = 3
#: Starts in a row that may fail before a worker is given up.
MOST_STARTS: Final = 3
LOOK_SECONDS: Final = 0.1
STOP_SECONDS: Final = 2.0
LOG_LINES: Final = 8
#: One thread each for numerical libraries: the workers share the cores.
THREAD_VARIABLES: Final = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


class WorkerEnded(Exception):
    """A worker's process ended while it was needed."""


class _Batch:
    """Jobs that came together."""

    def __init__(self, jobs: list[Job]) -> None:
        self.left = len(jobs)
        self.dropped = False


class WorkerProcesses(Executor):
    """A fixed number of worker processes.

    Parameters
    ----------
    command : list of str
        Words of the command that serves one worker; `--bind`, `--folder` and `--parent` follow.
    folder : Path
        Worker k has `folder/workers/k` with its `log.txt`.
    workers : int

    Raises
    ------
    WorkerEnded, ConnectionProblem
        Where a worker does not start.
    """

    def __init__(self, command: list[str], folder: Path, workers: int) -> None:
        self._sockets = tempfile.TemporaryDirectory(prefix="scalebridge-")
        self._jobs: deque[tuple[Job, _Batch]] = deque()
        self._changed = threading.Condition()
        self._closing = False
        self._alive = workers
        self._lost = ""
        self._workers = [
            _Worker(number, command, folder / "workers" / str(number), Path(self._sockets.name))
            for number in range(workers)
        ]
        try:
            for worker in self._workers:
                worker.start()
            for worker in self._workers:
                worker.connect()
        except BaseException:
            self._stop()
            raise
        welcome = self._workers[0].client.welcome if self._workers[0].client else None
        self._capabilities: Capabilities = dict(welcome.capabilities) if welcome else {}
        self._threads = [
            threading.Thread(target=self._serve, args=(worker,), name=f"worker {worker.number}", daemon=True)
            for worker in self._workers
        ]
        for thread in self._threads:
            thread.start()

    @property
    def workers(self) -> int:
        """Workers that have not been given up."""
        return max(1, self._alive)

    def capabilities(self) -> Capabilities:
        """Return what the first worker said."""
        return self._capabilities

    def run(self, jobs: list[Job], look: Callable[[int], None]) -> None:
        """Put jobs into the queue and wait until all have their answers; see `Executor.run`."""
        batch = _Batch(jobs)
        with self._changed:
            self._jobs.extend((job, batch) for job in jobs)
            self._changed.notify_all()
        try:
            while True:
                with self._changed:
                    if self._alive == 0:
                        self._give_up()
                    if batch.left:
                        self._changed.wait(LOOK_SECONDS)
                    if not batch.left:
                        return
                look(len(jobs) - batch.left)
        except BaseException:
            with self._changed:
                batch.dropped = True
                self._jobs = deque(entry for entry in self._jobs if entry[1] is not batch)
            raise

    def _give_up(self) -> None:
        """Answer every job that waits: no worker is left to take it."""
        error = ProtocolError(
            "solver_failed", f"all {len(self._workers)} workers ended and could not be started again; {self._lost}",
            hint="see log.txt of the workers, then start the service anew", step=0,
        )  # fmt: skip
        for job, batch in self._jobs:
            job.answer = error
            batch.left -= 1
        self._jobs.clear()

    def _serve(self, worker: _Worker) -> None:
        """Hand jobs to one worker until the front closes; runs in the worker's thread."""
        while True:
            with self._changed:
                while not self._jobs and not self._closing:
                    self._changed.wait()
                if self._closing:
                    return
                job, batch = self._jobs.popleft()
            try:
                answer: Message | ProtocolError | None = worker.perform(job, batch)
            except (WorkerEnded, ConnectionProblem) as problem:
                job.tries += 1
                answer = None
                if self._closing:
                    return
                log.warning("worker %d: %s; its part goes to another", worker.number, problem)
                if job.tries >= MOST_TRIES:
                    answer = ProtocolError(
                        "solver_failed", f"{job.tries} workers in a row ended in this {job.operation}: {problem}",
                        hint="the query may need more memory than there is; send fewer points at once", step=0,
                    )  # fmt: skip
                self._settle(job, batch, answer)
                if not self._restarted(worker):
                    return
                continue
            except ProtocolError as error:
                answer = error
            except Exception as error:
                log.exception("worker %d: a defect of the front", worker.number)
                answer = ProtocolError("internal", f"{type(error).__name__}: {error}")
            self._settle(job, batch, answer)

    def _settle(self, job: Job, batch: _Batch, answer: Message | ProtocolError | None) -> None:
        """Note the answer of a job; without one it goes back to the head of the queue."""
        with self._changed:
            if answer is None:
                if not batch.dropped:
                    self._jobs.appendleft((job, batch))
            else:
                job.answer = answer
                batch.left -= 1
            self._changed.notify_all()

    def _restarted(self, worker: _Worker) -> bool:
        """Start a worker again; return whether it answers."""
        problem: Exception | None = None
        for _ in range(MOST_STARTS):
            if self._closing:
                return False
            worker.stop()
            try:
                worker.start()
                worker.connect()
            except (WorkerEnded, ConnectionProblem, ProtocolError, OSError) as error:
                problem = error
                continue
            log.info("worker %d is started again, process %d", worker.number, worker.pid)
            return True
        with self._changed:
            self._alive -= 1
            self._lost = str(problem)
            self._changed.notify_all()
        log.error("worker %d is given up after %d starts: %s", worker.number, MOST_STARTS, problem)
        return False

    def close(self) -> None:
        """End all workers."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        self._stop()
        for thread in self._threads:
            thread.join(STOP_SECONDS)
        self._sockets.cleanup()

    def _stop(self) -> None:
        for worker in self._workers:
            worker.end()
        for worker in self._workers:
            worker.stop()


class _Worker:
    """One worker's process and the client that speaks to it; used by one thread at a time."""

    def __init__(self, number: int, command: list[str], folder: Path, sockets: Path) -> None:
        self.number = number
        self.client: Client | None = None
        self._command, self._folder, self._sockets = command, folder, sockets
        self._process: subprocess.Popen[bytes] | None = None
        self._starts = 0
        self._batch: _Batch | None = None

    @property
    def pid(self) -> int:
        return self._process.pid if self._process else 0

    def start(self) -> None:
        """Start the process; `connect` waits until it is ready."""
        self._folder.mkdir(parents=True, exist_ok=True)
        # A socket of its own for every start: the one before may still stand in the folder.
        self._starts += 1
        self._endpoint = f"ipc://{self._sockets}/{self.number}.{self._starts}"
        words = ["--bind", self._endpoint, "--folder", str(self._folder), "--parent", str(os.getpid())]
        environment = {**os.environ, **{name: "1" for name in THREAD_VARIABLES}}
        with (self._folder / "log.txt").open("ab") as file:
            self._process = subprocess.Popen(
                [*self._command, *words], stdin=subprocess.DEVNULL, stdout=file, stderr=subprocess.STDOUT,
                start_new_session=True, env=environment,
            )  # fmt: skip

    def connect(self) -> None:
        self.client = Client.connect(
            self._endpoint, "micromechanics", run="front", watch=self._watch, deadline=READY_SECONDS
        )

    def perform(self, job: Job, batch: _Batch) -> Message:
        """Return the reply to a job; a worker that does not know the cell is told what it is."""
        if self.client is None:
            raise WorkerEnded("it is not connected")
        self._watch()
        self._batch = batch
        ask = partial(self.client.call, job.operation, job.request, job.reply)
        try:
            if job.definition is None:
                return ask()
            return ask_or_register(ask, partial(self.client.call, "register", job.definition, CellRegistered))
        finally:
            self._batch = None

    def _watch(self) -> None:
        """Raise where the process has ended; end the operation in work where nobody waits for it any more."""
        code = self._process.poll() if self._process else None
        if code is not None:
            how = f"was killed by signal {-code}" if code < 0 else f"ended with exit status {code}"
            raise WorkerEnded(f"its process {self.pid} {how}; {self._last_lines()}")
        if self._batch is not None and self._batch.dropped and self.client is not None:
            self._batch = None
            with contextlib.suppress(ConnectionProblem, ProtocolError):
                self.client.control.call("abort", None, Acknowledged)

    def _last_lines(self) -> str:
        with contextlib.suppress(OSError):
            lines = (self._folder / "log.txt").read_text(errors="replace").splitlines()[-LOG_LINES:]
            return f"last lines of its log: {' | '.join(lines)}" if lines else "its log is empty"
        return "it has no log"

    def end(self) -> None:
        """Ask the process to end."""
        if self._process is not None and self._process.poll() is None:
            self._process.terminate()

    def stop(self) -> None:
        """End the process and let go of it."""
        if self.client is not None:
            self.client.close()
            self.client = None
        if self._process is not None:
            self.end()
            try:
                self._process.wait(STOP_SECONDS)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
