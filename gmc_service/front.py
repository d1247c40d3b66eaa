"""One endpoint before many workers: splits a query into contiguous parts, joins the answers in their order.

Since the role is stateless, any worker may answer any part, and a part whose worker died is asked again. The front
keeps the definitions of cells, and so can tell a worker that does not know a cell what it is.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final, TypeVar

from gmc_service.kept_cells import KeptCells, unknown_cell
from protocol import micromechanics as m
from protocol.backend import BackendError
from protocol.errors import ProtocolError
from protocol.messages import Message
from protocol.micromechanics_query import equal_bounds, join_evaluated, join_localised, split
from protocol.service import Capabilities, Service
from protocol.version import package_version

#: A query of fewer points than twice this goes to one worker whole: another's round trip costs more than it spares.
LEAST_POINTS: Final = 4096
#: The same where a point costs fifty times as much and more: cells that soften or flow, and those of many subcells.
LEAST_SLOW_POINTS: Final = 1024
#: Subcells from which a failed cell is computed at each point and not found in a table.
MANY_SUBCELLS: Final = 16
#: Most points of one part, so that a part fits into a message and a lost one costs little.
MOST_POINTS: Final = 250_000

Query = TypeVar("Query", bound=m.LocaliseRequest)
Reply = TypeVar("Reply", bound=Message)


@dataclass
class Job:
    """One request for any one worker.

    Attributes
    ----------
    operation : str
    request, reply : Message, type of Message
    definition : RegisterCell, optional
        Of the cell that the request is about; None where the request defines one itself.
    answer : Message or ProtocolError, optional
        What came of it.
    tries : int
        Workers that ended while they had it.
    """

    operation: str
    request: Message
    reply: type[Message]
    definition: m.RegisterCell | None = None
    answer: Message | ProtocolError | None = None
    tries: int = 0


class Executor(ABC):
    """Workers that answer jobs."""

    @property
    @abstractmethod
    def workers(self) -> int:
        """Number of jobs that can be in work at once."""

    @abstractmethod
    def run(self, jobs: list[Job], look: Callable[[int], None]) -> None:
        """Set the answer of every job.

        Parameters
        ----------
        jobs : list of Job
        look : callable
            Called about ten times a second with the number of jobs that are answered; it may raise to end the wait,
            and then jobs that wait are dropped and those in work ended.
        """

    @abstractmethod
    def capabilities(self) -> Capabilities:
        """What the workers' backend can do."""

    @abstractmethod
    def close(self) -> None:
        """End what was started."""


class Front(Service):
    """The role `micromechanics` over the workers of an executor.

    Parameters
    ----------
    backend : str
        Name of the workers' backend.
    executor : Executor
    """

    role = "micromechanics"
    backend_version = package_version()

    def __init__(self, backend: str, executor: Executor) -> None:
        super().__init__()
        self.backend = backend  # type: ignore[misc]  # that of its workers
        self._executor = executor
        self._definitions: KeptCells[m.RegisterCell] = KeptCells()

    @property
    def step(self) -> int:
        """Always 0: nothing here goes on in time."""
        return 0

    def capabilities(self) -> Capabilities:
        """Those of the workers, and how many there are."""
        return {**self._executor.capabilities(), "workers": self._executor.workers}

    def register(self, request: m.RegisterCell) -> m.CellRegistered:
        """Let one worker make the cell, and keep its definition for all."""
        (answer,) = self._answers([Job("register", request, m.CellRegistered)])
        assert isinstance(answer, m.CellRegistered)
        self._definitions.keep(answer.cell, lambda: request)
        return answer

    def evaluate(self, request: m.EvaluateRequest) -> m.Evaluated:
        """Stress, tangent and new state, the points split over the workers."""
        return join_evaluated(self._split("evaluate", request, m.Evaluated))

    def localise(self, request: m.LocaliseRequest) -> m.Localised:
        """Fields inside the cell, the points split over the workers."""
        return join_localised(self._split("localise", request, m.Localised))

    def properties(self, request: m.CellPropertiesRequest) -> m.CellProperties:
        """Effective constants, by one worker."""
        (answer,) = self._answers([Job("properties", request, m.CellProperties, self._definition(request.cell))])
        assert isinstance(answer, m.CellProperties)
        return answer

    def close(self) -> None:
        """End the workers."""
        self._executor.close()

    def _definition(self, cell: str) -> m.RegisterCell:
        definition = self._definitions.get(cell)
        if definition is None:
            raise unknown_cell(cell)
        return definition

    def _split(self, operation: str, request: Query, reply: type[Reply]) -> list[Reply]:
        """Return the answers to the parts of a query, in the order of its points."""
        definition = self._definition(request.cell)
        points = len(request.strain)
        bounds = equal_bounds(points, parts_of(points, self._executor.workers, slow=is_slow(definition)))
        answers = self._answers([Job(operation, part, reply, definition) for part in split(request, bounds)])
        return [answer for answer in answers if isinstance(answer, reply)]

    def _answers(self, jobs: list[Job]) -> list[Message]:
        """Return the answers of jobs in their order, or raise the first error."""
        self._executor.run(jobs, lambda done: self.activity.progress(done, len(jobs), "parts of the query"))
        answers = []
        for job in jobs:
            if isinstance(job.answer, ProtocolError):
                raise job.answer
            assert job.answer is not None
            answers.append(job.answer)
        return answers


def is_slow(cell: m.RegisterCell) -> bool:
    """Return whether a point of a cell takes tens of microseconds, not tenths of one."""
    bends = any(material.fracture_energy is not None or material.plasticity is not None for material in cell.materials)
    return bends or cell.phase.size > MANY_SUBCELLS


def parts_of(points: int, workers: int, *, slow: bool = False) -> int:
    """Return into how many parts a query is split: as many for each worker, none too large; a small query is one."""
    most = max(1, points // (LEAST_SLOW_POINTS if slow else LEAST_POINTS))
    return min(most, workers * max(1, -(-points // (workers * MOST_POINTS))))


def make_front(name: str, folder: Path, command: list[str], workers: int | None, executor: str | None) -> Front:
    """Return the front of a backend; see `protocol.backend.Backend.make_front`."""
    if executor is not None:
        if workers is not None:
            raise BackendError("--workers are processes of this machine, --executor is a cluster: give one of the two")
        from gmc_service.dask_executor import DaskExecutor

        return Front(name, DaskExecutor(executor, name))
    from gmc_service.workers import WorkerProcesses

    return Front(name, WorkerProcesses(command, folder, workers or 1))
