"""The microstructure of a laminate, asked over the wire: a `PointMaterial` that is a client of `micromechanics`."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from fem_service.point_material import PointAnswer, PointState
from protocol import micromechanics as m
from protocol.cell_link import CellLink
from protocol.client import Client


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
    link : CellLink
        Knows the seconds that its queries took.
    registered : CellRegistered
    softens : bool
        See `fem_service.point_material.PointMaterial`.
    queried, spared : int
        Points that were asked for and that were not. Whoever reads them may set them to zero.

    Raises
    ------
    ProtocolError
        If the service refuses the cell or the temperature; ``bad_field`` of `micromechanics`, if there is none.
    """

    def __init__(
        self, connect: Callable[[], Client], cell: m.RegisterCell, temperature: float, *, spare: bool = True
    ) -> None:
        self._temperature = temperature
        self.link = CellLink(connect, cell)
        try:
            properties = self.link.properties(temperature)
        except BaseException:
            self.link.close()
            raise
        self.registered = self.link.registered
        self._stiffness = properties.stiffness
        self._locked = properties.stiffness @ properties.expansion * (temperature - cell.stress_free_temperature)
        self._safe = properties.safe_energy if spare else 0.0
        self.softens = any(material.fracture_energy is not None for material in cell.materials)
        self.queried = self.spared = 0

    def fresh(self, points: int) -> PointState:
        """State of points that have never been loaded."""
        return PointState(
            np.zeros((points, self.registered.failed_bytes), dtype=np.uint8),
            np.zeros((points, self.registered.history_values)),
        )

    def intact(self, points: int) -> PointAnswer:
        """Answer without strain of points of which nothing fails; needs no query."""
        stress = np.tile(-self._locked, (points, 1))
        return PointAnswer(stress, self.fresh(points), np.zeros(points, dtype=np.int64), self._stiffness[None])

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
        self.link.close()

    def localise(self, strain: NDArray[np.float64], state: PointState) -> NDArray[np.float64]:
        """Stress in every subcell at points in a state that is kept, shape (points, subcells, 6), Pa."""
        request = m.LocaliseRequest(
            cell=self.registered.cell,
            temperature=self._temperature,
            strain=strain,
            failed=state.failed,
            history=state.history,
        )
        return self.link.localise(request).stress

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
            element_length=element_length[asked] if self.softens else None,
        )
        return self.link.evaluate(request)
