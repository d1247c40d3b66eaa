"""A microstructure for the conformance kit: the service of the role `micromechanics` that a structure service asks."""

from __future__ import annotations

import hashlib
import time

import numpy as np

from protocol import micromechanics as m
from protocol.errors import ProtocolError
from protocol.service import Capabilities, Service

#: So long a query lasts at most while `slow` is set, s.
SLOW_SECONDS = 30.0


class OneMaterialCells(Service):
    """Cells of one subcell: elastic until the strain along the fibre reaches its limit, then knocked down.

    Attributes
    ----------
    slow : bool
        Whether queries wait until it is unset.
    queries : int
        Answered so far.
    """

    role = "micromechanics"
    backend = "conformance"
    backend_version = "1"

    def __init__(self) -> None:
        super().__init__()
        self.slow = False
        self.queries = 0
        self._cells: dict[str, m.RegisterCell] = {}

    @property
    def step(self) -> int:
        """Always 0."""
        return 0

    def capabilities(self) -> Capabilities:
        """What the kit's laminate needs."""
        return {"criteria": ["maximum_strain"], "after_failure": ["gmc"]}

    def register(self, request: m.RegisterCell) -> m.CellRegistered:
        """Keep a cell of one subcell."""
        if request.phase.size != 1:
            raise ProtocolError("unsupported", "phase has more than one subcell", field="phase")
        name = hashlib.sha256(repr(request).encode()).hexdigest()
        self._cells[name] = request
        return m.CellRegistered(cell=name, subcells=1, failed_bytes=1, history_values=0, material_fraction=np.ones(1))

    def evaluate(self, request: m.EvaluateRequest) -> m.Evaluated:
        """Elastic answer of each point, knocked down where it has failed."""
        end = time.monotonic() + SLOW_SECONDS
        while self.slow and time.monotonic() < end:
            self.activity.progress(0, 1, "slow")
            time.sleep(0.02)
        self.queries += 1
        cell = self._cell(request.cell)
        before = np.zeros((len(request.strain), 1), np.uint8) if request.failed is None else request.failed
        failed = before.copy()
        for failure in cell.materials[0].failures:
            limit = failure.tension[0]
            failed[:, 0] |= np.uint8(1) * (limit is not None and request.strain[:, 0] >= limit)
        stiffness = np.array([1.0, cell.knock_down])[:, None, None] * self._stiffness(cell)
        kinds, first, index = np.unique(failed[:, 0], return_index=True, return_inverse=True)
        order = np.argsort(first)
        return m.Evaluated(
            stress=np.einsum("pij,pj->pi", stiffness[failed[:, 0]], request.strain),
            failed=failed,
            history=np.zeros((len(failed), 0)),
            tangent_index=np.argsort(order)[index.reshape(-1)].astype(np.int64) if request.want_tangent else None,
            tangents=stiffness[kinds[order]] if request.want_tangent else None,
            new_failures=int(failed.sum()) - int(before.sum()),
        )

    def localise(self, request: m.LocaliseRequest) -> m.Localised:
        """The one subcell has the strain of the cell."""
        cell = self._cell(request.cell)
        failed = np.zeros(len(request.strain), np.uint8) if request.failed is None else request.failed[:, 0]
        factor = np.where(failed > 0, cell.knock_down, 1.0)
        stress = factor[:, None] * (request.strain @ self._stiffness(cell))
        return m.Localised(stress=stress[:, None, :].copy(), strain=request.strain[:, None, :].copy())

    def properties(self, request: m.CellPropertiesRequest) -> m.CellProperties:
        """Those of the one material. No energy is said to be safe, so that every point is asked for."""
        return m.CellProperties(
            stiffness=self._stiffness(self._cell(request.cell)),
            expansion=np.zeros(6),
            material_fraction=np.ones(1),
            safe_energy=0.0,
        )

    def _stiffness(self, cell: m.RegisterCell) -> np.ndarray:
        return np.reshape(cell.materials[0].stiffness[0], (6, 6))

    def _cell(self, name: str) -> m.RegisterCell:
        if name not in self._cells:
            raise ProtocolError("unknown_cell", f"no cell {name!r}", field="cell")
        return self._cells[name]
