"""Failure events of a cell whose macroscopic strain grows in one component.

Between two events the cell is linear, so the strain at which the next subcell fails follows from the indices along a
straight line: in closed form for maximum stress and strain, by root finding to rounding for the quadratic criteria. No
step size enters.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from gmc_service import component_order
from gmc_service.cell import Cell
from gmc_service.failed_cell import FailedCell
from gmc_service.failure import FAILS_AT, HASHIN, TSAI_HILL, checks_of, failure_index, governing_component
from gmc_service.material import CRITERIA

COMPONENTS: Final = tuple(f"eps{component}" for component in component_order.COMPONENTS)
#: What the other components do: their strains are held at zero, or their stresses are zero.
Others = Literal["held", "free"]
#: Parts of a stretch without change of sign in which a quadratic criterion is looked at before its root is sought.
_PARTS: Final = 32


@dataclass(frozen=True)
class Cause:
    """Why a subcell failed.

    Attributes
    ----------
    subcell : int
        Flat index.
    material, criterion, component : str
        See `failure.governing_component` for the last.
    """

    subcell: int
    material: str
    criterion: str
    component: str


@dataclass(frozen=True, eq=False)
class Event:
    """Subcells that fail at one strain.

    Attributes
    ----------
    strain : float
        In the driven component.
    stages : tuple of tuples of Cause
        The cascade: those of one stage fail together, and their failure leads to the next.
    before, after : ndarray of float, shape (6,)
        Macroscopic stress, Pa.
    """

    strain: float
    stages: tuple[tuple[Cause, ...], ...]
    before: NDArray[np.float64]
    after: NDArray[np.float64]

    @property
    def causes(self) -> tuple[Cause, ...]:
        """Of all stages."""
        return tuple(cause for stage in self.stages for cause in stage)


@dataclass(frozen=True, eq=False)
class FailurePath:
    """Response of a cell along a path.

    Attributes
    ----------
    events : tuple of Event
    strain : ndarray of float, shape (states,)
        In the driven component; two states at each event, before and after.
    macroscopic_strain, stress : ndarray of float, shape (states, 6)
        Stress in Pa.
    subcell_stress : ndarray of float, shape (states, subcells, 6)
        Pa.
    """

    events: tuple[Event, ...]
    strain: NDArray[np.float64]
    macroscopic_strain: NDArray[np.float64]
    stress: NDArray[np.float64]
    subcell_stress: NDArray[np.float64]


class _Stretch:
    """A cell with given failed subcells: everything is linear in the driven strain."""

    def __init__(
        self, states: FailedCell, change: float, failed: NDArray[np.bool_], component: int, others: Others
    ) -> None:
        answer = states.homogenise(failed)
        locked = answer.stiffness @ answer.expansion * change
        # The macroscopic strain is offset + slope * driven.
        self.offset, self.slope = np.zeros(6), np.eye(6)[component]
        if others == "free":
            rest = np.delete(np.arange(6), component)
            inner = answer.stiffness[np.ix_(rest, rest)]
            self.offset[rest] = np.linalg.solve(inner, locked[rest])
            self.slope[rest] = -np.linalg.solve(inner, answer.stiffness[rest, component])
        self._stiffness, self._locked = answer.stiffness, locked
        stiffness = states.stiffness(failed)
        mechanical = (answer.thermal - states.expansion) * change + answer.concentration @ self.offset
        self.strain_at_none, self.strain_slope = mechanical, answer.concentration @ self.slope
        self.stress_at_none = np.einsum("nij,nj->ni", stiffness, mechanical)
        self.stress_slope = np.einsum("nij,nj->ni", stiffness, self.strain_slope)

    def strain(self, driven: float) -> NDArray[np.float64]:
        """Macroscopic strain, shape (6,)."""
        return np.asarray(self.offset + driven * self.slope)

    def stress(self, driven: float) -> NDArray[np.float64]:
        """Macroscopic stress, shape (6,), Pa."""
        return np.asarray(self._stiffness @ self.strain(driven) - self._locked)

    def subcell_stress(self, driven: float) -> NDArray[np.float64]:
        """Stress of every subcell, shape (subcells, 6), Pa."""
        return np.asarray(self.stress_at_none + driven * self.stress_slope)


def failure_path(
    cell: Cell,
    component: str,
    end: float,
    others: Others = "held",
    temperature: float | None = None,
    method: str = "gmc",
) -> FailurePath:
    """Follow a cell along a growing strain and find where its subcells fail.

    Subcells whose index reaches one at the same strain (within `failure.TOLERANCE`) fail together; with the stress that
    follows, at the same driven strain, more may fail.

    Parameters
    ----------
    cell : Cell
        Without softening and plasticity.
    component : str
        One of `COMPONENTS`.
    end : float
        Strain at which the path ends; negative for compression.
    others : str
        ``held``: all other strains are zero. ``free``: all other stresses are zero.
    temperature : float, optional
        K; the stress-free one if not given.
    method : str
        Name from `gmc_service.methods`.

    Returns
    -------
    FailurePath

    Raises
    ------
    ValueError
        If a name is unknown, the end is zero or not finite, or a material softens or yields.
    """
    if component not in COMPONENTS:
        raise ValueError(f"path is {component!r}; it must be one of {', '.join(COMPONENTS)}")
    if others not in ("held", "free"):
        raise ValueError(f"others is {others!r}; it must be held or free")
    if not np.isfinite(end) or end == 0.0:
        raise ValueError(f"to is {end}; the strain at the end of the path must be finite and not 0")
    for material in cell.materials:
        for name in ("fracture_energy", "plasticity"):
            if getattr(material, name) is not None:
                raise ValueError(f"{name} of {material.name} makes the path curved; events are found on straight ones")
    temperature = cell.stress_free_temperature if temperature is None else temperature
    states, change = FailedCell(cell, method, temperature), temperature - cell.stress_free_temperature
    walk = _Walk(cell, states, change, COMPONENTS.index(component), others, float(np.sign(end)))
    return walk.to(abs(end))


class _Walk:
    """The path, stretch by stretch. Distances along it are positive; the driven strain is `sign` times the distance."""

    def __init__(
        self, cell: Cell, states: FailedCell, change: float, component: int, others: Others, sign: float
    ) -> None:
        self.cell = cell
        self.sign = sign
        self._checks = checks_of(cell)
        self._of_strain = self._checks.of_strain()
        self._failed = np.zeros(cell.subcells, dtype=bool)
        self._stretch_of = lambda failed: _Stretch(states, change, failed, component, others)
        self._stretch = self._stretch_of(self._failed)
        self._curve: list[tuple[float, NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]] = []

    def to(self, end: float) -> FailurePath:
        """Walk from zero to a distance."""
        events: list[Event] = []
        at = 0.0
        self._note(at)
        while True:
            at = self._next(at, end)
            if at > end:
                break
            self._note(at)
            before = self._stretch.stress(self.sign * at)
            stages = self._cascade(at)
            self._note(at)
            events.append(Event(self.sign * at, stages, before, self._stretch.stress(self.sign * at)))
        self._note(end)
        driven, strain, stress, subcells = (np.array(values) for values in zip(*self._curve, strict=True))
        return FailurePath(tuple(events), driven, strain, stress, subcells)

    def _note(self, at: float) -> None:
        driven = self.sign * at
        stretch = self._stretch
        self._curve.append((driven, stretch.strain(driven), stretch.stress(driven), stretch.subcell_stress(driven)))

    def _line(self, check: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """What a check looks at, as start and slope along the distance."""
        n, stretch = self._checks.subcell[check], self._stretch
        if self._of_strain[check]:
            return stretch.strain_at_none[n], self.sign * stretch.strain_slope[n]
        return stretch.stress_at_none[n], self.sign * stretch.stress_slope[n]

    def _index(self, check: int, at: float) -> float:
        start, slope = self._line(check)
        criterion = self._checks.criterion[check]
        return float(failure_index(criterion, *(start + at * slope), self._checks.rates, check))

    def _cascade(self, at: float) -> tuple[tuple[Cause, ...], ...]:
        stages: list[tuple[Cause, ...]] = []
        while True:
            stage: dict[int, Cause] = {}
            for check, n in enumerate(self._checks.subcell):
                if self._failed[n] or n in stage or self._index(check, at) < FAILS_AT:
                    continue
                start, slope = self._line(check)
                criterion = int(self._checks.criterion[check])
                component = governing_component(criterion, start + at * slope, self._checks.rates[check])
                material = self.cell.materials[self.cell.phase.reshape(-1)[n]].name
                stage[int(n)] = Cause(int(n), material, CRITERIA[criterion], component)
            if not stage:
                return tuple(stages)
            stages.append(tuple(stage.values()))
            self._failed[list(stage)] = True
            self._stretch = self._stretch_of(self._failed)

    def _next(self, at: float, end: float) -> float:
        """Distance at which the next subcell fails, from one on; ``inf`` if none does before the end."""
        nearest = np.inf
        for check, n in enumerate(self._checks.subcell):
            if not self._failed[n]:
                nearest = min(nearest, self._reached(check, at, min(nearest, end)))
        return nearest

    def _reached(self, check: int, at: float, end: float) -> float:
        """First distance from one to another at which an index is one, or one beyond it."""
        if self._index(check, at) >= FAILS_AT:
            return at
        start, slope = self._line(check)
        rates = self._checks.rates[check]
        if self._checks.criterion[check] in (TSAI_HILL, HASHIN):
            return self._reached_curved(check, at, end)
        limits = 1.0 / rates[rates > 0.0]
        signed = np.concatenate([np.eye(6)[:3], -np.eye(6)[:3], np.eye(6)[3:]])[rates > 0.0]
        rising, level = signed @ slope, signed @ start
        shears = (rates > 0.0)[6:].sum()
        if shears:  # shear reaches its allowable with either sign
            rising = np.concatenate([rising, -rising[-shears:]])
            level = np.concatenate([level, -level[-shears:]])
            limits = np.concatenate([limits, limits[-shears:]])
        grows = rising > 0.0
        found = (limits[grows] - level[grows]) / rising[grows]
        return float(found.min(initial=np.inf))

    def _reached_curved(self, check: int, at: float, end: float) -> float:
        """As `_reached`, for a criterion that is a quadratic form between changes of sign."""
        start, slope = self._line(check)
        lines = [(start[i], slope[i]) for i in range(3)] + [(start[1] + start[2], slope[1] + slope[2])]
        turns = {-level / rise for level, rise in lines if rise != 0.0}
        edges = [at, *sorted(turn for turn in turns if at < turn < end), end]
        for low, high in pairwise(edges):
            points = np.linspace(low, high, _PARTS + 1)
            for one, two in pairwise(points):
                if self._index(check, two) >= 1.0:
                    return self._crossing(check, one, two)
        return np.inf

    def _crossing(self, check: int, low: float, high: float) -> float:
        """Where an index that is one or more at `high` gets there, by bisection to rounding.

        The end at which it is one or more is returned, since an index may jump where a stress changes its sign.
        """
        if self._index(check, low) >= 1.0:
            return low
        while True:
            middle = 0.5 * (low + high)
            if not low < middle < high:
                return high
            if self._index(check, middle) >= 1.0:
                high = middle
            else:
                low = middle
