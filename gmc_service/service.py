"""The role `micromechanics` on an evaluator of cells: messages in, messages out."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gmc_service.cell import AFTER_FAILURE, Cell
from gmc_service.cell_file import read_cell
from gmc_service.evaluation import Answer, Evaluator
from gmc_service.kept_cells import MOST_CELLS, KeptCells, unknown_cell
from gmc_service.material import CRITERIA, Failure, Material, Plasticity
from gmc_service.safe_energy import safe_energy
from protocol import micromechanics as m
from protocol.errors import ProtocolError
from protocol.service import Capabilities, Service
from protocol.tangent_table import join_tables
from protocol.version import package_version

#: Largest cell, in subcells.
MOST_SUBCELLS: Final = 64 * 64
#: Points of the first part of a query, times the square of subcells, with the compiled method: it is over in a tenth of
#: a second even where every point has a tangent of its own, and a million points of a small cell are one part.
FIRST_PART: Final = 32_000_000
#: Between two looks at `abort` a query may compute for so long, s.
QUICK_SECONDS, SLOW_SECONDS = 0.1, 0.5
#: Set bits of each byte.
_BITS: Final = np.array([bin(byte).count("1") for byte in range(256)], dtype=np.uint8)


class MicromechanicsService(Service):
    """Evaluators of the cells registered last, by their content.

    Parameters
    ----------
    backend, method : str
        Name on the wire, and one of `gmc_service.methods.METHODS`.
    """

    role = "micromechanics"
    backend_version = package_version()

    def __init__(self, backend: str, method: str) -> None:
        super().__init__()
        self.backend = backend  # type: ignore[misc]  # one class for all methods
        self._method = method
        self._evaluators: KeptCells[Evaluator] = KeptCells()

    @property
    def step(self) -> int:
        """Always 0: nothing here goes on in time."""
        return 0

    def capabilities(self) -> Capabilities:
        """Words and limits of this backend."""
        return {
            "method": self._method,
            "cells": MOST_CELLS,
            "subcells": MOST_SUBCELLS,
            "criteria": list(CRITERIA),
            "after_failure": list(AFTER_FAILURE),
        }

    def register(self, request: m.RegisterCell) -> m.CellRegistered:
        """Keep a cell under its id."""
        subcells = request.phase.size
        if subcells > MOST_SUBCELLS:
            raise ProtocolError(
                "unsupported", f"phase has {subcells} subcells; the most are {MOST_SUBCELLS}", field="phase"
            )
        cell = cell_of(request)
        name = cell.identity()
        try:
            evaluator = self._evaluators.keep(name, lambda: Evaluator(cell, self._method))
        except ValueError as error:
            raise _refused(error, "materials", m.RegisterCell) from None
        return m.CellRegistered(
            cell=name,
            subcells=cell.subcells,
            failed_bytes=evaluator.failed_bytes,
            history_values=evaluator.history_values,
            material_fraction=cell.phase_fractions(),
        )

    def evaluate(self, request: m.EvaluateRequest) -> m.Evaluated:
        """Stress, tangent and new state of many points."""
        evaluator = self._evaluator(request.cell)
        failed, history = _state(evaluator, request)
        answers = list(self._parts(evaluator, request, failed, history))
        now = _joined([answer.failed for answer in answers])
        tables = [(answer.tangent_index, answer.tangents) for answer in answers]
        index, tangents = tables[0] if len(tables) == 1 else join_tables(tables)  # a part's own is distinct already
        return m.Evaluated(
            stress=_joined([answer.stress for answer in answers]),
            failed=now,
            history=_joined([answer.history for answer in answers]),
            tangent_index=index if request.want_tangent else None,
            tangents=tangents if request.want_tangent else None,
            new_failures=_bits(now & ~failed),
        )

    def _parts(
        self,
        evaluator: Evaluator,
        request: m.EvaluateRequest,
        failed: NDArray[np.uint8],
        history: NDArray[np.float64],
    ) -> Iterator[Answer]:
        """Yield the answers to parts of a query, each so large that `abort` is looked for in time."""
        points, start = len(request.strain), 0
        size = max(1, FIRST_PART // evaluator.cell.subcells**2) if self._method == "gmc" else 1
        while start < max(1, points):
            self.activity.progress(start, points, "points")
            rows = slice(start, start + size)
            length = None if request.element_length is None else request.element_length[rows]
            began = time.perf_counter()
            try:
                answer = evaluator.evaluate(
                    request.strain[rows], request.temperature, failed[rows], history[rows], length
                )
            except ValueError as error:
                raise _refused(error, "strain", m.EvaluateRequest) from None
            yield answer
            took = time.perf_counter() - began
            start += size
            if took < QUICK_SECONDS:
                size *= 2
            elif took > SLOW_SECONDS:
                size = max(1, size // 2)

    def localise(self, request: m.LocaliseRequest) -> m.Localised:
        """Stress and strain of every subcell at many points."""
        evaluator = self._evaluator(request.cell)
        failed, history = _state(evaluator, request)
        try:
            stress, strain = evaluator.localise(request.strain, request.temperature, failed, history)
        except ValueError as error:
            raise _refused(error, "strain", m.LocaliseRequest) from None
        return m.Localised(stress=stress, strain=strain)

    def properties(self, request: m.CellPropertiesRequest) -> m.CellProperties:
        """Effective constants of a cell."""
        evaluator = self._evaluator(request.cell)
        failed = np.zeros(evaluator.failed_bytes, np.uint8) if request.failed is None else request.failed
        try:
            found = evaluator.homogenised(request.temperature, failed)
        except ValueError as error:
            raise _refused(error, "temperature", m.CellPropertiesRequest) from None
        return m.CellProperties(
            stiffness=found.stiffness,
            expansion=found.expansion,
            material_fraction=evaluator.cell.phase_fractions(),
            safe_energy=0.0
            if failed.any()
            else min(safe_energy(evaluator.cell, self._method, request.temperature), 1e300),
        )

    def _evaluator(self, cell: str) -> Evaluator:
        evaluator = self._evaluators.get(cell)
        if evaluator is None:
            raise unknown_cell(cell)
        return evaluator


def read_definition(path: Path) -> m.RegisterCell:
    """Return the message that defines the cell of a file; errors are those of `gmc_service.cell_file.read_cell`."""
    return definition_of(read_cell(path))


def definition_of(cell: Cell) -> m.RegisterCell:
    """Return the message that defines a cell."""
    materials = []
    for material in cell.materials:
        flow = material.plasticity
        failures = [
            m.MaterialFailure(
                criterion=one.criterion,
                tension=_allowables(one.tension),
                compression=_allowables(one.compression),
                shear=_allowables(one.shear),
            )
            for one in material.failures
        ]
        materials.append(
            m.CellMaterial(
                name=material.name,
                temperatures=material.temperatures.tolist(),
                stiffness=material.stiffness.reshape(-1, 36).tolist(),
                expansion=material.expansion.tolist(),
                failures=failures,
                fracture_energy=material.fracture_energy,
                reduces_strength=material.reduces_strength,
                plasticity=None
                if flow is None
                else m.MaterialPlasticity(yield_stress=flow.yield_stress, hardening=flow.hardening),
            )
        )
    return m.RegisterCell(
        heights=cell.heights,
        widths=cell.widths,
        phase=cell.phase,
        materials=materials,
        stress_free_temperature=cell.stress_free_temperature,
        knock_down=cell.knock_down,
        after_failure=cell.after_failure,
    )


def _allowables(limits: tuple[float, float, float]) -> tuple[float | None, float | None, float | None]:
    one, two, three = (None if np.isinf(value) else float(value) for value in limits)
    return one, two, three


def cell_of(request: m.RegisterCell) -> Cell:
    """Return the cell of a definition.

    Raises
    ------
    ProtocolError
        `bad_field`, where the solver refuses what the message's own rules let through.
    """
    materials = []
    for number, given in enumerate(request.materials):
        try:
            materials.append(_material(given))
        except ValueError as error:
            raise _refused(error, f"materials.{number}", m.CellMaterial, f"materials.{number}.") from None
    try:
        return Cell(
            heights=request.heights,
            widths=request.widths,
            phase=request.phase,
            materials=tuple(materials),
            stress_free_temperature=request.stress_free_temperature,
            knock_down=request.knock_down,
            after_failure=request.after_failure,
        )
    except ValueError as error:
        raise _refused(error, "phase", m.RegisterCell) from None


def _material(given: m.CellMaterial) -> Material:
    flow = given.plasticity
    return Material(
        name=given.name,
        temperatures=np.array(given.temperatures),
        stiffness=np.array(given.stiffness).reshape(-1, 6, 6),
        expansion=np.array(given.expansion).reshape(-1, 6),
        failures=tuple(
            Failure(one.criterion, _limits(one.tension), _limits(one.compression), _limits(one.shear))
            for one in given.failures
        ),
        fracture_energy=given.fracture_energy,
        reduces_strength=given.reduces_strength,
        plasticity=None if flow is None else Plasticity(flow.yield_stress, flow.hardening),
    )


def _limits(given: tuple[float | None, float | None, float | None]) -> tuple[float, float, float]:
    one, two, three = (np.inf if value is None else value for value in given)
    return one, two, three


def _state(evaluator: Evaluator, request: m.LocaliseRequest) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Return failed bits and history of the points of a query, checked before any of its parts is answered."""
    points = len(request.strain)
    failed = np.zeros((points, evaluator.failed_bytes), np.uint8) if request.failed is None else request.failed
    history = np.zeros((points, evaluator.history_values)) if request.history is None else request.history
    try:
        evaluator.check_state(points, failed, history)
    except ValueError as error:
        raise _refused(error, "failed", type(request)) from None
    return failed, history


def _refused(error: ValueError, otherwise: str, request: type, start: str = "") -> ProtocolError:
    """Return what the solver refused as an error that names the field; its sentences begin with the field's name."""
    first = str(error).partition(" ")[0].partition("[")[0]  # also of one point, as in strain[3]
    named = first in request.model_fields  # type: ignore[attr-defined]
    return ProtocolError("bad_field", str(error), field=start + first if named else otherwise)


def _joined(arrays: list[NDArray]) -> NDArray:
    return arrays[0] if len(arrays) == 1 else np.concatenate(arrays)


def _bits(failed: NDArray[np.uint8]) -> int:
    return int(_BITS[failed].sum(dtype=np.int64))


def make_gmc(folder: Path) -> MicromechanicsService:
    """Return the service on the generalized method of cells; it needs no folder."""
    return MicromechanicsService("gmc_service", "gmc")


def make_high_fidelity(folder: Path) -> MicromechanicsService:
    """Return the service on finite elements of the cell; it needs no folder."""
    return MicromechanicsService("high_fidelity", "high_fidelity")


def make_mori_tanaka(folder: Path) -> MicromechanicsService:
    """Return the service on the method of Mori and Tanaka; it needs no folder."""
    return MicromechanicsService("mori_tanaka", "mori_tanaka")
