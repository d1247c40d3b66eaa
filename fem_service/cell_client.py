"""The microstructure of a laminate, asked over the wire: a `PointMaterial` that is a client of `micromechanics`."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from fem_service.point_material import PointAnswer, PointState
from protocol import micromechanics as m
from protocol.client import Client
from protocol.errors import ProtocolError


class CellClient:
    """A cell of a micromechanics service.

    Points that have neither failed nor flowed, and have too little energy for either, are answered by the intact
    stiffness without a query: below `CellProperties.safe_energy` that is exact.

    Parameters
    ----------
    client : Client
        Of a service of the role `micromechanics`.
    cell : RegisterCell
    temperature : float
        K, of all points.
    spare : bool
        Whether points are spared at all.

    Attributes
    ----------
    registered : CellRegistered
    queried, spared : int
        Points since the last call of `take_counts`.
    seconds : float
        Spent in queries, and of that not computed by the service, `wire`.

    Raises
    ------
    ProtocolError
        If the service refuses the cell or the temperature.
    """

    def __init__(self, client: Client, cell: m.RegisterCell, temperature: float, *, spare: bool = True) -> None:
        self._client = client
        self._cell = cell
        self._temperature = temperature
        self.registered = client.call("register", cell, m.CellRegistered)
        properties = client.call(
            "properties",
            m.CellPropertiesRequest(cell=self.registered.cell, temperature=temperature),
            m.CellProperties,
        )
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
        elastic = strain @ self._stiffness
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
            answer = self._client.call("evaluate", request, m.Evaluated)
        except ProtocolError as error:
            if error.code != "unknown_cell":
                raise
            # Another worker, or one that forgot: the definition makes it the same cell anywhere.
            self._client.call("register", self._cell, m.CellRegistered)
            answer = self._client.call("evaluate", request, m.Evaluated)
        spent = time.perf_counter() - began
        self.seconds += spent
        self.wire += max(0.0, spent - (self._client.timing.computing - computed))
        return answer
