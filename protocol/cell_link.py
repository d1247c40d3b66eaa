"""A solver's link to the cell that answers at its points: registered, asked, and found again where its service died."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

from protocol.client import Client
from protocol.errors import ConnectionProblem, ProtocolError
from protocol.micromechanics import (
    CellProperties,
    CellPropertiesRequest,
    CellRegistered,
    Evaluated,
    EvaluateRequest,
    Localised,
    LocaliseRequest,
    RegisterCell,
)
from protocol.micromechanics_query import CellQueries

Answer = TypeVar("Answer")


class CellLink:
    """A cell of a service of the role `micromechanics`.

    Parameters
    ----------
    connect : callable
        Returns a new client of the service; called again where the service was started anew in between.
    cell : RegisterCell

    Attributes
    ----------
    registered : CellRegistered
    seconds, wire : float
        Spent in queries, and of that not computed by the service [s]. Whoever reads these may set them to zero.

    Raises
    ------
    ProtocolError
        If the service refuses the cell; ``bad_field`` of `micromechanics`, if there is none.
    """

    def __init__(self, connect: Callable[[], Client], cell: RegisterCell) -> None:
        self._connect, self._cell = connect, cell
        try:
            self._client = connect()
        except ConnectionProblem as error:
            raise ProtocolError("bad_field", f"micromechanics: {error}", field="micromechanics") from None
        try:
            self._queries = CellQueries(self._client, cell)
        except BaseException:
            self._client.close()
            raise
        self.seconds = self.wire = 0.0

    @property
    def registered(self) -> CellRegistered:
        """Id and sizes of the cell."""
        return self._queries.registered

    def properties(self, temperature: float) -> CellProperties:
        """Return the constants of the intact cell at a temperature [K]."""
        request = CellPropertiesRequest(cell=self.registered.cell, temperature=temperature)
        return self._client.call("properties", request, CellProperties)

    def evaluate(self, request: EvaluateRequest) -> Evaluated:
        """Return the answer to a query of any size.

        A service that came in the place of one that is gone gives the same bits: it holds no state.

        Raises
        ------
        ProtocolError
            What the service refuses; ``solver_failed`` of `micromechanics`, if it is gone and none comes.
        """
        return self._timed(lambda: self._queries.evaluate(request))

    def localise(self, request: LocaliseRequest) -> Localised:
        """Return the fields inside the cell at a few points; errors as `evaluate`."""
        return self._timed(lambda: self._queries.localise(request))

    def close(self) -> None:
        """Let go of the service."""
        self._client.close()

    def _timed(self, ask: Callable[[], Answer]) -> Answer:
        began, computed = time.perf_counter(), self._client.timing.computing
        try:
            answer = ask()
        except ConnectionProblem as error:
            answer, computed = self._anew(ask, error), 0.0
        spent = time.perf_counter() - began
        self.seconds += spent
        self.wire += max(0.0, spent - (self._client.timing.computing - computed))
        return answer

    def _anew(self, ask: Callable[[], Answer], problem: ConnectionProblem) -> Answer:
        try:
            found = self._connect()
            self._client.close()
            self._client = found
            self._queries = CellQueries(found, self._cell)
            return ask()
        except ConnectionProblem as error:
            raise ProtocolError(
                "solver_failed", f"micromechanics: {problem}; then {error}", field="micromechanics"
            ) from None
