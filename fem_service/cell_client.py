"""The microstructure of a laminate, asked over the wire: a `PointMaterial` that is a client of `micromechanics`."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from fem_service.point_material import PointAnswer, PointState
from protocol import micromechanics as m
from protocol.client import Client
from protocol.errors import ConnectionProblem, ProtocolError
from protocol.micromechanics_query import CellQueries


class CellClient:
    """A cell of a micromechanics service.

    Points that have neither failed nor flowed, and have too little energy for either, are answered by the intact
    stiffness without a query: below `CellProperties.safe_energy` that is exact.

    Parameters
    ----------
    connect : callable
        Returns a new client of the service; called again where the service was started anew in between.
    cell : RegisterCell
    temperature : float
        K, of all points.
    spare : bool
        Whether points are spared at all.

    Attributes
    ----------
    registered : CellRegistered
    queried, spared : int
        Points that were asked for and that were not.
    seconds, wire : float
        Spent in queries, and of that not computed by the service, s. Whoever reads these four may set them to zero.

    Raises
    ------
    ProtocolError
        If the service refuses the cell or the temperature; ``bad_field`` of `micromechanics`, if there is none.
    """

    def __init__(
        self, connect: Callable[[], Client], cell: m.RegisterCell, temperature: float, *, spare: bool = True
    ) -> None:
        self._connect = connect
        self._cell = cell
        self._temperature = temperature
        try:
            self._client = connect()
        except ConnectionProblem as error:
            raise ProtocolError("bad_field", f"micromechanics: {error}", field="micromechanics") from None
        try:
            self._queries = CellQueries(self._client, cell)
            request = m.CellPropertiesRequest(cell=self._queries.registered.cell, temperature=temperature)
            properties = self._client.call("properties", request, m.CellProperties)
        except BaseException:
            self._client.close()
            raise
        self.registered = self._queries.registered
        self._stiffness = properties.stiffness
        self._locked = properties.stiffness @ properties.expansion * (temperature - cell.stress_free_temperature)
        self._safe = properties.safe_energy if spare else 0.0
        self._softens = any(material.fracture_energy is not None for material in cell.materials)
        self.queried = self.spared = 0
        self.seconds = self.wire = 0.0

    def fresh(self, points: int) -> PointState:
        """State of points that have never been loaded."""
        return PointState(
            np.zeros((points, self.registered.failed_bytes), dtype=np.uint8),
            np.zeros((points, self.registered.history_values)),
        )

    def respond(
        self, strain: NDArray[np.float64], state: PointState, element_length: NDArray[np.float64]
    ) -> PointAnswer:
        """Answer to strains; see `fem_service.point_material.PointMaterial`."""
        elastic = self._elastic(strain)
        intact = ~(state.failed.any(axis=1) | state.history.any(axis=1))
        safe = intact & (0.5 * np.einsum("pi,pi->p", strain, elastic) < self._safe)
        asked = np.flatnonzero(~safe)
        self.spared += len(strain) - len(asked)
        self.queried += len(asked)
        stress = elastic - self._locked
        index = np.zeros(len(strain), dtype=np.int64)
        if not len(asked):
            return PointAnswer(stress, state, index, self._stiffness[None])
        answer = self._ask(strain[asked], state, asked, element_length)
        assert answer.tangent_index is not None and answer.tangents is not None  # they were wanted
        failed, history = state.failed.copy(), state.history.copy()
        stress[asked], failed[asked], history[asked] = answer.stress, answer.failed, answer.history
        index[asked] = answer.tangent_index + 1
        return PointAnswer(
            stress, PointState(failed, history), index, np.concatenate([self._stiffness[None], answer.tangents])
        )

    def _elastic(self, strain: NDArray[np.float64]) -> NDArray[np.float64]:
        """Intact stiffness times strain, summed from the first component to the last, as the GMC service does it."""
        found = strain[:, :1] * self._stiffness[:, 0]
        for component in range(1, 6):
            found += strain[:, component, None] * self._stiffness[:, component]
        return found

    def close(self) -> None:
        """Let go of the service."""
        self._client.close()

    def _ask(
        self,
        strain: NDArray[np.float64],
        state: PointState,
        asked: NDArray[np.int64],
        element_length: NDArray[np.float64],
    ) -> m.Evaluated:
        request = m.EvaluateRequest(
            cell=self.registered.cell,
            temperature=self._temperature,
            strain=strain,
            failed=state.failed[asked],
            history=state.history[asked],
            element_length=element_length[asked] if self._softens else None,
        )
        began, computed = time.perf_counter(), self._client.timing.computing
        try:
            answer = self._queries.evaluate(request)
        except ConnectionProblem as error:
            answer, computed = self._asked_anew(request, error), 0.0
        spent = time.perf_counter() - began
        self.seconds += spent
        self.wire += max(0.0, spent - (self._client.timing.computing - computed))
        return answer

    def _asked_anew(self, request: m.EvaluateRequest, problem: ConnectionProblem) -> m.Evaluated:
        """Answer of a service that came in the place of one that is gone: it holds no state, so nothing is lost."""
        try:
            found = self._connect()
            self._client.close()
            self._client = found
            self._queries = CellQueries(found, self._cell)
            return self._queries.evaluate(request)
        except ConnectionProblem as error:
            raise ProtocolError(
                "solver_failed", f"micromechanics: {problem}; then {error}", field="micromechanics"
            ) from None
