"""A large query of the role `micromechanics` in parts: how its points are split, and how the answers are joined."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from protocol.client import Client
from protocol.errors import ProtocolError
from protocol.micromechanics import CellRegistered, Evaluated, EvaluateRequest, Localised, LocaliseRequest, RegisterCell
from protocol.tangent_table import join_tables

Query = TypeVar("Query", bound=LocaliseRequest)
Answer = TypeVar("Answer")

#: Points of one part of a query: its arrays are a few megabytes, which memory that was used before can hold.
PART_POINTS: Final = 32_768


def split(request: Query, bounds: Sequence[int]) -> Iterator[Query]:
    """Yield the parts of a checked query between bounds; their arrays share its memory and are not checked again."""
    arrays: dict[str, NDArray] = request.array_values()
    for start, end in pairwise(bounds):
        yield request.model_copy(update={name: array[start:end] for name, array in arrays.items()})


def equal_bounds(points: int, parts: int) -> list[int]:
    """Return where so many parts of a query begin, and the end of the last; they are equal to one point."""
    return [points * number // parts for number in range(parts + 1)]


def join_evaluated(parts: Sequence[Evaluated]) -> Evaluated:
    """Return the answer to a query from the answers to its parts: the same bits, however it was split."""
    if len(parts) == 1:
        return parts[0]
    tables = [
        (part.tangent_index, part.tangents)
        for part in parts
        if part.tangent_index is not None and part.tangents is not None
    ]
    index, tangents = join_tables(tables) if tables else (None, None)
    # Each part was checked when it came; the whole needs no second look at every number.
    return Evaluated.model_construct(
        stress=np.concatenate([part.stress for part in parts]),
        failed=np.concatenate([part.failed for part in parts]),
        history=np.concatenate([part.history for part in parts]),
        tangent_index=index,
        tangents=tangents,
        new_failures=sum(part.new_failures for part in parts),
    )


def join_localised(parts: Sequence[Localised]) -> Localised:
    """Return the fields of all points from those of the parts."""
    if len(parts) == 1:
        return parts[0]
    return Localised.model_construct(
        stress=np.concatenate([part.stress for part in parts]), strain=np.concatenate([part.strain for part in parts])
    )


def ask_or_register(ask: Callable[[], Answer], register: Callable[[], object]) -> Answer:
    """Return what `ask` answers; where the service does not know the cell, register it and ask again."""
    try:
        return ask()
    except ProtocolError as error:
        if error.code != "unknown_cell":
            raise
    register()
    return ask()


class CellQueries:
    """Queries of one cell: it is registered first, and again where a service has forgotten it.

    Parameters
    ----------
    client : Client
        Of a service of the role `micromechanics`.
    cell : RegisterCell

    Attributes
    ----------
    registered : CellRegistered
        Id and sizes of the cell.
    """

    def __init__(self, client: Client, cell: RegisterCell) -> None:
        self._client, self._cell = client, cell
        self.registered = self._register()

    def _register(self) -> CellRegistered:
        return self._client.call("register", self._cell, CellRegistered)

    def evaluate(self, request: EvaluateRequest) -> Evaluated:
        """Return the answer to a query of any number of points, sent in parts.

        Raises
        ------
        ProtocolError, ConnectionProblem
            See `protocol.client.Client.call`.
        """
        points = len(request.strain)
        bounds = equal_bounds(points, max(1, -(-points // PART_POINTS)))

        def ask() -> Evaluated:
            return join_evaluated(list(self._client.call_each("evaluate", split(request, bounds), Evaluated)))

        return ask_or_register(ask, self._register)

    def localise(self, request: LocaliseRequest) -> Localised:
        """Return the fields inside the cell at a few points; errors as `evaluate`."""
        return ask_or_register(lambda: self._client.call("localise", request, Localised), self._register)
