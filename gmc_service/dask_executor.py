"""A Dask distributed cluster as the workers behind one front, where one machine is too small.

Parts of a query are sent straight to the cluster's workers; the definition of a cell is one task of the cluster, whose
result each worker fetches once and which the cluster makes again where it was lost. Inside its cluster Dask has its
own serialisation, which can run code: whoever reaches the scheduler commands the workers. So an address beyond this
machine is taken only where Dask's configuration has certificates (``distributed.comm.tls``).
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Final

from pydantic import ValidationError

from gmc_service.front import Executor, Job
from gmc_service.kept_cells import KeptCells
from protocol.backend import BackendError, find
from protocol.dispatcher import bad_field
from protocol.errors import ErrorReport, ProtocolError, traceback_tail
from protocol.messages import Message
from protocol.micromechanics import RegisterCell
from protocol.micromechanics_query import ask_or_register
from protocol.security import is_local
from protocol.service import Capabilities, Service

log = logging.getLogger(__name__)

SCHEME: Final = "dask://"
#: Seconds in which the scheduler, and then a worker, must answer.
READY_SECONDS: Final = 60.0
#: Workers that one job may cost before it is given up.
MOST_TRIES: Final = 3
LOOK_SECONDS: Final = 0.1


class DaskExecutor(Executor):
    """The workers of a running cluster; it is not started here and goes on afterwards.

    Parameters
    ----------
    address : str
        ``dask://HOST:PORT`` of the scheduler.
    backend : str
        Backend that its workers use; scalebridge must be installed there.

    Raises
    ------
    BackendError
        Where `distributed` is not installed, the address is wrong, or nobody answers there.
    """

    def __init__(self, address: str, backend: str) -> None:
        try:
            import distributed
        except ImportError:
            raise BackendError("the package distributed is not installed: pip install 'scalebridge[dask]'") from None
        self._backend = backend
        self._definitions: KeptCells[Any] = KeptCells()
        try:
            self._client = distributed.Client(
                scheduler_address(address), timeout=READY_SECONDS, set_as_default=False, direct_to_workers=True
            )
        except (OSError, TimeoutError) as error:
            raise BackendError(f"no Dask scheduler answers at {address}: {error}") from None
        try:
            found = self._client.submit(_capabilities, backend, pure=False).result(timeout=READY_SECONDS)
        except TimeoutError:
            self._client.close()
            raise BackendError(f"no worker of the cluster at {address} answered in {READY_SECONDS:g} s") from None
        self._capabilities: Capabilities = found

    @property
    def workers(self) -> int:
        """Threads of all workers that the cluster has now."""
        return max(1, sum(self._client.nthreads().values()))

    def capabilities(self) -> Capabilities:
        """Return what a worker said."""
        return self._capabilities

    def run(self, jobs: list[Job], look: Callable[[int], None]) -> None:
        """Hand jobs to the cluster and wait for all answers; see `Executor.run`."""
        changed = threading.Event()
        waiting = {self._submitted(job, changed): job for job in jobs}
        try:
            while waiting:
                changed.wait(LOOK_SECONDS)
                changed.clear()
                for future in [future for future in waiting if future.done()]:
                    job = waiting.pop(future)
                    if not self._settled(job, future):
                        waiting[self._submitted(job, changed)] = job
                look(len(jobs) - len(waiting))
        except BaseException:
            self._client.cancel(list(waiting), force=True)
            raise

    def _submitted(self, job: Job, changed: threading.Event) -> Any:
        """Return the future of a job that was sent to one worker, past the scheduler."""
        definition = None if job.definition is None else self._defined(job.request.cell, job.definition)  # type: ignore[attr-defined]
        request = self._client.scatter(job.request, direct=True, hash=False)
        future = self._client.submit(answer_job, self._backend, job.operation, request, definition, pure=False)
        future.add_done_callback(lambda _: changed.set())
        return future

    def _defined(self, cell: str, definition: RegisterCell) -> Any:
        return self._definitions.keep(
            cell, lambda: self._client.submit(_same, definition, key=f"scalebridge-{self._backend}-{cell}")
        )

    def _settled(self, job: Job, future: Any) -> bool:
        """Note what came of a job; return False where its worker was lost and it must be asked again."""
        try:
            found = future.result(timeout=READY_SECONDS)
        except Exception as problem:  # whatever Dask raises where a worker, or what it held, is gone
            job.tries += 1
            if job.tries < MOST_TRIES:
                log.warning("a worker of the cluster was lost (%s); its part goes to another", type(problem).__name__)
                return False
            job.answer = ProtocolError(
                "solver_failed", f"{job.tries} workers of the cluster were lost in this {job.operation}: {problem}",
                hint="the query may need more memory than there is; send fewer points at once", step=0,
            )  # fmt: skip
            return True
        job.answer = ProtocolError(**found.model_dump()) if isinstance(found, ErrorReport) else found
        return True

    def close(self) -> None:
        """Leave the cluster."""
        self._client.close()


def scheduler_address(address: str) -> str:
    """Return the address of a scheduler as Dask writes it: plain on this machine, with TLS beyond it.

    Raises
    ------
    BackendError
        Where it is not of the form ``dask://HOST:PORT``, or needs certificates that are not configured.
    """
    host, _, port = address.removeprefix(SCHEME).rpartition(":")
    if not (address.startswith(SCHEME) and host and port.isdecimal()):
        raise BackendError(f"executor is {address!r}; it must be of the form dask://HOST:PORT")
    plain = f"tcp://{host}:{port}"
    if is_local(plain):
        return plain
    from distributed.security import Security

    if not Security().get_connection_args("client").get("ssl_context"):
        raise BackendError(
            f"executor {address} is beyond this machine and Dask has no certificates: set distributed.comm.tls in its "
            "configuration (ca-file, client.cert, client.key), since whoever reaches a scheduler commands its workers"
        )
    return f"tls://{host}:{port}"


#: Services of a worker's process, by backend.
_services: dict[str, Service] = {}
_making = threading.Lock()


def answer_job(
    backend: str, operation: str, request: Message, definition: RegisterCell | None
) -> Message | ErrorReport:
    """Answer one job in the process of a worker; an error comes back as its report."""
    try:
        service = _service(backend)
        ask: Callable[[], Message] = partial(getattr(service, operation), request)
        if definition is None:
            return ask()
        return ask_or_register(ask, partial(service.register, definition))  # type: ignore[attr-defined]
    except ProtocolError as error:
        return error.report
    except ValidationError as error:  # of a reply with a NaN, as `protocol.dispatcher` has it
        problem = bad_field(error, f"reply to {operation}").report
        return ProtocolError("solver_failed", problem.sentence, field=problem.field, step=0).report
    except Exception as error:  # a defect: left to Dask it would pass for a lost worker, and be asked again
        log.exception("a defect of backend %s", backend)
        return ProtocolError(
            "internal", f"{type(error).__name__}: {error}", traceback_tail=traceback_tail(error)
        ).report


def _service(backend: str) -> Service:
    with _making:
        if backend not in _services:
            _services[backend] = find("micromechanics", backend).make(Path.cwd())
        return _services[backend]


def _capabilities(backend: str) -> Capabilities:
    return _service(backend).capabilities()


def _same(definition: RegisterCell) -> RegisterCell:
    return definition
