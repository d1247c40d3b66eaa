"""Methods that answer the effective stiffness of a fibre composite, timed in turn and held against round fibres."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from benchmarks.gmc_peers import homocompy_stiffness, installed, scikit_fem_stiffness
from gmc_service import gmc_reduced, high_fidelity, mori_tanaka
from gmc_service.architectures import square_pack
from gmc_service.engineering_constants import engineering_constants
from gmc_service.high_fidelity import richardson
from gmc_service.material import isotropic_stiffness
from gmc_service.periodic_elements import homogenise_mesh
from gmc_service.round_fibre import round_fibre_mesh
from protocol.verification import BenchmarkRow

#: The dissertation's IM7 and neat EPON 862 (Tables 6.1 and 6.2), both isotropic; the fibre first, as in the cells.
PHASES: Final = np.array([isotropic_stiffness(276e9, 0.33), isotropic_stiffness(2.963e9, 0.36)])
FRACTION: Final = 0.6
MODULI: Final = ("E22", "G12", "G23")
CELLS: Final[tuple[Literal[2, 7, 26], ...]] = (2, 7, 26)
MANY: Final = {2: 20000, 7: 2000, 26: 200}
REFINEMENTS: Final = {2: (2, 4, 8, 16), 7: (1, 2, 4), 26: (1, 2)}
ROUND: Final = (1, 2)
REFERENCE: Final = (1, 2, 4)
ROUNDS: Final = 5
#: Heights, widths, stiffness and expansion of a cell, as `Homogenise` takes them.
CellArrays = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]
Knobs = dict[str, str | int | float]
_LEAST_TIME: Final = 5e-3  # s; calls shorter than this are repeated in a batch


@dataclass(frozen=True)
class Method:
    """A way to the effective stiffness.

    Attributes
    ----------
    label, family : str
        Name, and that of the line it belongs to.
    stiffness : callable
        Returns it, shape (6, 6), Pa.
    knobs : dict
    answers : int
        Cells that one call answers.
    peer : bool
        Whether it is other software.
    """

    label: str
    family: str
    stiffness: Callable[[], NDArray[np.float64]]
    knobs: Knobs
    answers: int = 1
    peer: bool = False


def cell_of(subcells: Literal[2, 7, 26], fraction: float) -> CellArrays:
    """A cell of `square_pack` with `PHASES`."""
    cell = square_pack(subcells, fraction)
    return cell.heights, cell.widths, PHASES[cell.phase.reshape(-1)], np.zeros((cell.phase.size, 6))


def round_fibre(fraction: float, refinement: int) -> NDArray[np.float64]:
    """Stiffness of round fibres in a square array, by a mesh that follows them."""
    return homogenise_mesh(round_fibre_mesh(fraction, refinement), PHASES, np.zeros((2, 6))).stiffness


def moduli(stiffness: NDArray[np.float64]) -> NDArray[np.float64]:
    """`MODULI` of a stiffness, Pa."""
    constants = engineering_constants(stiffness)
    return np.array([getattr(constants, name) for name in MODULI])


def reference(fraction: float) -> tuple[NDArray[np.float64], float]:
    """`MODULI` of round fibres in a square array by Richardson's limit, and the largest relative step to it."""
    table = np.array([moduli(round_fibre(fraction, one)) for one in REFERENCE])
    limits = np.array([richardson(column)[0] for column in table.T])
    return limits, float(np.abs(table[-1] / limits - 1.0).max())


def methods(fraction: float) -> list[Method]:
    """All methods for a fibre fraction: ours, then the peers that are installed."""
    found = []
    for n in CELLS:
        cell = cell_of(n, fraction)
        name = f"{n}x{n}"
        knobs: Knobs = {"subcells": n, "fraction": fraction}
        found.append(_method(f"GMC {name}", "GMC", partial(gmc_reduced.homogenise, *cell), knobs))
        choices = np.tile(square_pack(n, fraction).phase.reshape(-1), (MANY[n], 1))
        many = partial(gmc_reduced.effective_stiffness_many, cell[0], cell[1], PHASES, choices)
        found.append(
            Method(f"GMC {name}, {MANY[n]} at once", "GMC, many at once", lambda many=many: many()[-1],  # type: ignore[misc]
                   {**knobs, "method": "GMC", "at_once": MANY[n]}, answers=MANY[n])
        )  # fmt: skip
        for one in REFINEMENTS[n]:
            found.append(
                _method(f"high fidelity {name}, refinement {one}", f"high fidelity, {name}",
                        partial(high_fidelity.homogenise, *cell, one), {**knobs, "refinement": one})
            )  # fmt: skip
    cell = cell_of(2, fraction)
    found.append(
        _method("Mori-Tanaka", "Mori-Tanaka", partial(mori_tanaka.homogenise, *cell, matrix=3), {"fraction": fraction})
    )
    for one in ROUND:
        found.append(
            Method(f"elements along a round fibre, refinement {one}", "elements along a round fibre",
                   partial(round_fibre, fraction, one), {"method": "round", "fraction": fraction, "refinement": one})
        )  # fmt: skip
    return found + _peers(fraction)


def _method(label: str, family: str, call: Callable[[], object], knobs: Knobs) -> Method:
    return Method(label, family, lambda: call().stiffness, {**knobs, "method": family})  # type: ignore[attr-defined]


def _peers(fraction: float) -> list[Method]:
    found = []
    if installed("homocompy"):
        fibre, matrix = (engineering_constants(one) for one in PHASES)
        for model, name in (("mori_tanaka", "Mori-Tanaka"), ("chamis_model", "Chamis")):
            call = partial(homocompy_stiffness, model, fraction, fibre, matrix)
            knobs: Knobs = {"method": name, "fraction": fraction}
            found.append(Method(f"HomoComPy, {name}", f"HomoComPy, {name}", call, knobs, peer=True))
    if installed("skfem"):
        for n in CELLS[1:]:
            cell = square_pack(n, fraction)
            down, along = (np.concatenate([[0.0], np.cumsum(sizes)]) for sizes in (cell.heights, cell.widths))
            call = partial(scikit_fem_stiffness, (down, along), PHASES[cell.phase])
            knobs = {"method": "elements", "fraction": fraction, "subcells": n, "refinement": 1}
            found.append(Method(f"scikit-fem {n}x{n}, refinement 1", "scikit-fem", call, knobs, peer=True))
    return found


def measure(chosen: Sequence[Method], exact: NDArray[np.float64]) -> list[BenchmarkRow]:
    """Time methods in turn, `ROUNDS` times, and state their errors.

    Parameters
    ----------
    chosen : sequence of Method
    exact : ndarray, shape (3,)
        `MODULI` of the reference, Pa.

    Returns
    -------
    list of BenchmarkRow
        `seconds` is the median for one cell, of processor time, so that other programs on the machine count little;
        `error` the largest of the three, in `figures` with its sign by modulus,
        and ``front_E22`` and so on: 1 where none is faster and at least as good.
    """
    calls, errors = [], []
    for method in chosen:
        errors.append(moduli(method.stiffness()) / exact - 1.0)  # compiles, too
        began = time.process_time()
        method.stiffness()
        calls.append(max(1, round(_LEAST_TIME / (time.process_time() - began))))
    seconds = np.empty((len(chosen), ROUNDS))
    for k in range(ROUNDS):
        for row, (method, count) in enumerate(zip(chosen, calls, strict=True)):
            began = time.process_time()
            for _ in range(count):
                method.stiffness()
            seconds[row, k] = (time.process_time() - began) / (count * method.answers)
    medians = np.median(seconds, axis=1)
    size = np.abs(errors)
    faster = medians[None, :] < medians[:, None]
    as_good = size[None] < size[:, None] * (1.0 + 1e-9)  # in some constants methods agree but for rounding
    front = np.asarray(~np.any(faster[:, :, None] & as_good, axis=1))
    rows = []
    for k, method in enumerate(chosen):
        figures = {name: float(value) for name, value in zip(MODULI, errors[k], strict=True)}
        figures |= {f"front_{name}": float(value) for name, value in zip(MODULI, front[k], strict=True)}
        knobs = {**method.knobs, "family": method.family}
        rows.append(
            BenchmarkRow(method.label, knobs, float(medians[k]), float(size[k].max()), figures, peer=method.peer)
        )
    return rows


def with_steps(row: BenchmarkRow, step: float) -> BenchmarkRow:
    """Add the reference's own discretisation error to the figures of a row."""
    return replace(row, figures={**row.figures, "reference_error": step})
