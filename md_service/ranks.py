"""Ranks of one MPI run, as the engine sees them: reductions, agreement, and calls announced by rank 0.

Calls travel as JSON and raw arrays; nothing is pickled.
"""

import atexit
import json
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from md_service.errors import EngineError


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
