"""The microstructure of a `Laminate`, asked over the wire."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mpm_service.laminate import CellAnswer
from protocol.arrays import FloatArray
from protocol.cell_link import CellLink
from protocol.client import Client
from protocol.errors import ProtocolError
from protocol.micromechanics import EvaluateRequest, RegisterCell


class CellClient:
    """A cell of a micromechanics service at its stress-free temperature; see `mpm_service.laminate.Microstructure`.

    Parameters
    ----------
    connect : callable
        Returns a new client of the service; called again where the service was started anew in between.
    cell : RegisterCell

    Attributes
    ----------
    materials : list of str
        Names of the constituents.

    Raises
    ------
    ProtocolError
        `bad_field`: the cell yields, the service refuses it, or there is none.
    """

    def __init__(self, connect: Callable[[], Client], cell: RegisterCell) -> None:
        for k, material in enumerate(cell.materials):
            if material.plasticity is not None:
                field = f"material.cell.materials.{k}.plasticity"
                raise ProtocolError(
                    "bad_field", f"{field}: subcells of the law laminate fail or soften; leave it out", field=field
                )
        self._temperature = cell.stress_free_temperature
        try:
            self._link = CellLink(connect, cell)
        except ProtocolError as error:
            if error.report.field != "micromechanics":
                raise
            field = "material.micromechanics"
            raise ProtocolError("bad_field", str(error), field=field) from None
        try:
            properties = self._link.properties(self._temperature)
        except BaseException:
            self._link.close()
            raise
        self.stiffness, self.safe_energy = properties.stiffness, properties.safe_energy
        self.failed_bytes = self._link.registered.failed_bytes
        self.history_values = self._link.registered.history_values
        self.phase = cell.phase.reshape(-1).copy()
        self.materials = [material.name for material in cell.materials]

    def evaluate(
        self, strain: FloatArray, failed: NDArray[np.uint8], history: FloatArray, length: FloatArray
    ) -> CellAnswer:
        """Answer to strains (n, 6) of points with bits (n, bytes), history (n, values) and crack band (n,) [m]."""
        request = EvaluateRequest(
            cell=self._link.registered.cell,
            temperature=self._temperature,
            strain=strain,
            failed=failed,
            history=np.ascontiguousarray(history),
            element_length=length if self.history_values else None,
        )
        answer = self._link.evaluate(request)
        assert answer.tangent_index is not None and answer.tangents is not None  # they are wanted by default
        return CellAnswer(answer.stress, answer.failed, answer.history, answer.tangent_index, answer.tangents)

    def close(self) -> None:
        """Let go of the service."""
        self._link.close()
