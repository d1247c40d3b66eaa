"""Ranks of one MPI run: reductions for the engine, and the loop of the ranks that follow rank 0.

Every rank makes the same engine and calls the same methods with the same arguments. Under
``mpiexec -n N python ...`` rank 0 uses `ParallelEngine`, which announces each call before it makes it, and all
other ranks sit in `follow`. Calls travel as JSON and raw arrays; nothing is pickled.
"""

import atexit
import inspect
import json
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from md_service.errors import EngineError
from md_service.force_fields import force_field
from md_service.graphene import CrackCut

FOLLOWED_METHODS: Final = (
    "register_anchors",
    "equilibrate",
    "measure_reference",
    "advance",
    "broken_bonds",
    "collect_fields",
    "fields",
    "state",
    "restore",
    "close",
)


class Ranks(Protocol):
    """What the engine asks of the other ranks."""

    rank: int
    size: int

    def sum(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Sum an array over the ranks; every rank gets the same bits."""

    def agree(self, from_first: bool) -> bool:
        """The answer of rank 0, on every rank."""


class OneRank:
    """A serial run."""

    rank = 0
    size = 1

    def sum(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the array as it is."""
        return values

    def agree(self, from_first: bool) -> bool:
        """Return the answer as it is."""
        return from_first


class MpiRanks:
    """All ranks of ``MPI_COMM_WORLD``, the communicator that LAMMPS uses too.

    Raises
    ------
    EngineError
        If mpi4py is not installed.
    """

    def __init__(self) -> None:
        from md_service.lammps_library import load_lammps

        load_lammps()  # the MPI library of LAMMPS must be there before mpi4py looks for one
        try:
            from mpi4py import MPI
        except ImportError as error:
            raise EngineError("more than one rank needs mpi4py: pip install mpi4py") from error
        self._communicator: Any = MPI.COMM_WORLD
        self.rank: int = self._communicator.Get_rank()
        self.size: int = self._communicator.Get_size()
        self._released = self.rank != 0 or self.size == 1
        # Ranks that wait for a call would keep a finished run alive.
        atexit.register(self.release)

    def release(self) -> None:
        """On rank 0, end the loop of the other ranks; calling it again does nothing."""
        if not self._released:
            self._released = True
            self.broadcast_call("stop", {})

    def sum(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Sum an array over the ranks; every rank gets the same bits."""
        # Reduce and broadcast, since an all-reduce may sum in another order on each rank.
        total = np.empty_like(values)
        self._communicator.Reduce(values, total, root=0)
        self._communicator.Bcast(total, root=0)
        return total

    def agree(self, from_first: bool) -> bool:
        """The answer of rank 0, on every rank."""
        answer = np.array([from_first], dtype=np.int8)
        self._communicator.Bcast(answer, root=0)
        return bool(answer[0])

    def abort(self) -> None:
        """End all ranks at once."""
        self._communicator.Abort(1)

    def broadcast_call(self, method: str, arguments: dict[str, Any]) -> None:
        """Announce a call from rank 0.

        Parameters
        ----------
        method : str
            Name of the method.
        arguments : dict
            By keyword; arrays, dicts of arrays, and whatever JSON holds.
        """
        arrays: list[NDArray[Any]] = []

        def plain(value: Any) -> Any:
            if isinstance(value, np.ndarray):
                arrays.append(np.ascontiguousarray(value))
                return {"array": [value.dtype.str, list(value.shape)]}
            if isinstance(value, dict):
                return {"dict": {key: plain(entry) for key, entry in value.items()}}
            return {"value": value}

        header = json.dumps([method, {name: plain(value) for name, value in arguments.items()}]).encode()
        self._communicator.Bcast(np.array([len(header)], dtype=np.int64), root=0)
        self._communicator.Bcast(np.frombuffer(header, dtype=np.uint8).copy(), root=0)
        for array in arrays:
            self._communicator.Bcast(array.reshape(-1).view(np.uint8), root=0)

    def receive_call(self) -> tuple[str, dict[str, Any]]:
        """Wait for the next call that rank 0 announces; returns method name and arguments."""
        length = np.empty(1, dtype=np.int64)
        self._communicator.Bcast(length, root=0)
        header = np.empty(int(length[0]), dtype=np.uint8)
        self._communicator.Bcast(header, root=0)
        method, arguments = json.loads(header.tobytes())

        def filled(value: Any) -> Any:
            if "array" in value:
                dtype, shape = value["array"]
                array = np.empty(shape, dtype=np.dtype(dtype))
                self._communicator.Bcast(array.reshape(-1).view(np.uint8), root=0)
                return array
            if "dict" in value:
                return {key: filled(entry) for key, entry in value["dict"].items()}
            return value["value"]

        return method, {name: filled(value) for name, value in arguments.items()}


class ParallelEngine:
    """`LammpsEngine` spread over all ranks, for use on rank 0 while the others are in `follow`.

    The methods are those of `md_service.engine.LammpsEngine`, named in `FOLLOWED_METHODS`, with arguments by
    keyword or in order.

    Parameters
    ----------
    ranks : MpiRanks
        The ranks; this one must be rank 0.
    work_dir : Path
        Folder of the LAMMPS log, reachable by all ranks.
    force_field : str
        Name of a profile.
    position : ndarray, shape (n, 3)
        Atom positions, m.
    crack : CrackCut, optional
        Initial slit.
    **settings
        The engine's other arguments, numbers.
    """

    def __init__(
        self,
        ranks: MpiRanks,
        work_dir: Path,
        force_field: str,
        position: NDArray[np.float64],
        crack: CrackCut | None = None,
        **settings: Any,
    ) -> None:
        if ranks.rank != 0:
            raise ValueError(f"ParallelEngine was made on rank {ranks.rank}; it is for rank 0, others call follow")
        description: dict[str, Any] = {
            "work_dir": str(work_dir),
            "force_field": force_field,
            "position": np.ascontiguousarray(position, dtype=np.float64),
            "crack": None if crack is None else [crack.tip_x, crack.y],
            **settings,
        }
        self._ranks = ranks
        ranks.broadcast_call("make", description)
        self._engine = _make(ranks, description)

    @property
    def step(self) -> int:
        """MD steps done so far."""
        return int(self._engine.step)

    @property
    def n_atoms(self) -> int:
        """Number of atoms."""
        return int(self._engine.n_atoms)

    def __getattr__(self, name: str) -> Callable[..., Any]:
        if name not in FOLLOWED_METHODS:
            raise AttributeError(f"the parallel engine has no attribute {name!r}")
        method = getattr(self._engine, name)

        def call(*arguments: Any, **named: Any) -> Any:
            by_name = dict(inspect.signature(method).bind(*arguments, **named).arguments)
            progress = by_name.pop("progress", None)
            for key, value in by_name.items():
                if isinstance(value, (list, tuple)) and not all(isinstance(entry, str) for entry in value):
                    by_name[key] = np.asarray(value)
            self._ranks.broadcast_call(name, by_name)
            if progress is not None:
                by_name["progress"] = progress
            return method(**by_name)

        return call

    def stop(self) -> None:
        """End the loop of the other ranks; the engine is closed first."""
        self.close()
        self._ranks.release()


def follow(ranks: MpiRanks) -> None:
    """Loop of the ranks other than 0: make every call that rank 0 announces, until it says stop.

    An error that a call raises is raised on rank 0 as well, which reports it; this rank goes on listening.
    """
    engine: Any = None
    while True:
        method, arguments = ranks.receive_call()
        if method == "stop":
            return
        try:
            if method == "make":
                engine = _make(ranks, arguments)
            elif method in FOLLOWED_METHODS:
                getattr(engine, method)(**arguments)
            else:
                raise EngineError(f"rank 0 announced the unknown method {method!r}")
        except (EngineError, ValueError):
            continue
        except Exception:
            # Unforeseen and perhaps on this rank alone: rank 0 would wait for this rank without end.
            traceback.print_exc()
            ranks.abort()


def _make(ranks: MpiRanks, description: dict[str, Any]) -> Any:
    from md_service.engine import LammpsEngine

    settings = dict(description)
    crack = settings.pop("crack")
    return LammpsEngine(
        work_dir=Path(settings.pop("work_dir")),
        force_field=force_field(settings.pop("force_field")),
        position=settings.pop("position"),
        crack=None if crack is None else CrackCut(*crack),
        ranks=ranks,
        **settings,
    )
