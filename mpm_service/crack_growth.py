"""Growth of cracks, and what a coordinator needs to hand a crack to the atoms and start it anew behind them.

At every tip the energy release rate is measured at a fixed interval of steps. A tip whose J reaches the toughness
of its crack grows by one increment, straight on or in the direction of the largest hoop stress.

A crack that comes out of the atoms (Fig 4.3) is stated with its first short segment and the hoop stress that was
seen when the crack before them last grew: it sleeps until the stress at its own tip has reached that value, and
then grows as any other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Literal, Protocol, get_args

import numpy as np
from numpy.typing import NDArray

from .crack_line import Crack
from .cracks import Tip
from .fracture import (
    CLOSURE,
    RING,
    FractureFields,
    Intensities,
    TipFrame,
    crack_extension_angle,
    fields_around,
    intensities_from_opening,
    interaction_intensities,
    j_integral,
    rates_between,
    stress_ahead,
    vcct,
)

FloatArray = NDArray[np.float64]

Direction = Literal["hoop", "straight"]

#: Rings tried in turn as a tip comes near the body's surface or another tip [cells].
RINGS = (RING, (1.0, 4.0), (1.0, 3.0))
#: Share of a cell by which a tip grows unless stated.
INCREMENT = 0.5
# Steps over which accelerations and velocity gradients are taken.
_WINDOW = 4
# Distance behind the tip at which opening and sliding tell the modes apart [cells].
_BEHIND = 1.5
# Distance ahead of the tip, and half width, of the hoop stress [cells].
_AHEAD = 1.0
# A crack whose line leaves its tip's direction by less than this angle within the ring is straight [rad].
_STRAIGHT = 0.02


@dataclass(frozen=True)
class GrowthLaw:
    """When and where the tips of a crack grow; the ``growth`` of a `Crack`.

    Parameters
    ----------
    toughness : float
        G_c [J/m^2], positive: a tip grows while J reaches it.
    direction : {"hoop", "straight"}
        Along the largest hoop stress (Erdogan and Sih), or straight on.
    increment : float, optional
        Growth at a time [m]; half a cell if not given.
    start_stress : float, optional
        Hoop stress one cell ahead of the tip [Pa] that wakes the crack; without one it is awake.

    Raises
    ------
    ValueError
        If a value is outside its range.
    """

    toughness: float
    direction: Direction = "hoop"
    increment: float | None = None
    start_stress: float | None = None

    def __post_init__(self) -> None:
        for name, unit in (("toughness", "J/m^2"), ("increment", "m"), ("start_stress", "Pa")):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > 0.0):
                raise ValueError(f"GrowthLaw.{name} = {value!r}: must be finite and above 0 {unit}")
        if self.direction not in get_args(Direction):
            raise ValueError(f"GrowthLaw.direction = {self.direction!r}: allowed are {', '.join(get_args(Direction))}")


@dataclass(frozen=True)
class TipState:
    """A crack tip and what was measured there.

    Attributes
    ----------
    step : int
    time : float
        [s]
    crack, end : int
        Number of the crack and its end, 0 or 1.
    position, reference : tuple of float
        Tip now and in the reference state, before any growth [m].
    length : float
        Reference length of the whole crack [m].
    release_rate : float
        J [J/m^2].
    release_opening, release_sliding : float
        G_I and G_II by virtual crack closure [J/m^2]; NaN where the closure does not fit into the body.
    intensity_opening, intensity_sliding : float
        K_I and K_II [Pa sqrt(m)], for isotropic materials, else NaN.
    angle : float
        Direction of the largest hoop stress [rad], from the tip's direction, positive to the left.
    hoop_stress : float
        Stress across that direction one cell ahead [Pa]. The critical stress to save for a `start_stress`.
    grown : float
        By how much the tip has grown at this step [m].
    woken : bool
        Did the crack's `start_stress` wake it at this step?
    """

    step: int
    time: float
    crack: int
    end: int
    position: tuple[float, float]
    reference: tuple[float, float]
    length: float
    release_rate: float
    release_opening: float
    release_sliding: float
    intensity_opening: float
    intensity_sliding: float
    angle: float
    hoop_stress: float
    grown: float = 0.0
    woken: bool = False


class CrackedSolver(Protocol):
    """What growth needs of a solver; `MaterialPointSolver` with cracks has it."""

    thickness: float
    time_step: float
    cracks: Any
    points: Any
    body: Any
    materials: Any

    @property
    def step(self) -> int:
        """Steps done."""

    def advance(self, steps: int) -> None:
        """Advance by a number of steps."""


class CrackGrowth:
    """Advances a solver and lets its cracks grow.

    Parameters
    ----------
    solver : MaterialPointSolver
        With at least one crack. Cracks with a `GrowthLaw` grow; the others are measured alike.
    interval : int
        Steps between measurements, at least 4. A tip can grow once in an interval, so the interval sets the
        fastest growth: increment over interval times the time step.

    Attributes
    ----------
    tips : list of TipState
        The last measurement of every tip.
    lost : set of (int, int)
        Tips (crack, end) too near the body's surface, another tip or an interface for any ring. They are no
        longer measured and stand still.

    Raises
    ------
    ValueError
        If there is no crack, a growth law is of another type, or the interval is too short.
    """

    def __init__(self, solver: CrackedSolver, interval: int = 20) -> None:
        if not solver.cracks:
            raise ValueError("solver.cracks: there is no crack that could grow")
        if int(interval) != interval or interval < _WINDOW:
            raise ValueError(f"interval = {interval!r}: a whole number of at least {_WINDOW} is needed")
        self._solver = solver
        self.interval = int(interval)
        self._laws: list[GrowthLaw | None] = []
        for number, crack in enumerate(solver.cracks.cracks):
            self._laws.append(_law_of(number, crack))
        self.tips: list[TipState] = []
        self.lost: set[tuple[int, int]] = set()
        self._before: list[FractureFields] | None = None
        self._asleep = {number for number, law in enumerate(self._laws) if law and law.start_stress is not None}

    def advance(self, steps: int) -> list[TipState]:
        """Advance, measuring whenever the solver's step count is a multiple of the interval.

        Returns
        -------
        list of TipState
            Events: tips that grew or woke, in order.

        Raises
        ------
        ValueError
            If the number of steps is not a whole number of at least 0, or a crack would grow into itself.
        SolverError
            As the solver's own ``advance``.
        """
        if int(steps) != steps or steps < 0:
            raise ValueError(f"steps = {steps!r}: a whole number of at least 0 is needed")
        solver, events = self._solver, []
        end = solver.step + int(steps)
        while solver.step < end:
            due = (solver.step // self.interval + 1) * self.interval
            stop = due - _WINDOW if solver.step < due - _WINDOW else due
            solver.advance(min(stop, end) - solver.step)
            if solver.step == due - _WINDOW:
                self._before = [self._gather(tip) for tip in solver.cracks.tips]
            elif solver.step == due:
                events += self._measure(self._before)
                self._before = None
        return events

    def state(self) -> dict[str, NDArray[Any]]:
        """What a restart needs beside the solver's state: which cracks sleep, which tips are lost, fields of before."""
        counts = [fields.position.shape[0] for fields in self._before or ()]
        before = {
            f"growth_before_{name}": np.concatenate([getattr(fields, name) for fields in self._before or ()])
            if counts
            else np.zeros(0)
            for name in FractureFields._fields
        }
        return {
            "growth_before_count": np.array(counts, dtype=np.int64),
            **before,
            "growth_asleep": np.array(sorted(self._asleep), dtype=np.int64),
            "growth_lost": np.array(sorted(self.lost), dtype=np.int64).reshape(-1, 2),
        }

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Take back a state, exactly."""
        counts = state["growth_before_count"]
        ends = np.cumsum(counts)
        self._before = None
        if counts.size:
            parts = {name: np.split(state[f"growth_before_{name}"], ends[:-1]) for name in FractureFields._fields}
            self._before = [
                FractureFields(**{name: part[k] for name, part in parts.items()}) for k in range(counts.size)
            ]
        self._asleep = {int(number) for number in state["growth_asleep"]}
        self.lost = {(int(crack), int(end)) for crack, end in state["growth_lost"]}

    # ---- inner -------------------------------------------------------------------------------------

    def _cell(self, tip: Tip) -> float:
        points = self._solver.points
        near = int(np.argmin(np.sum((points.reference_position - tip.reference) ** 2, axis=1)))
        return float(2.0 * points.half[near] * self._solver.body.points_per_cell)

    def _gather(self, tip: Tip) -> FractureFields:
        radius = max(RING[1], np.sqrt(2.0) * CLOSURE) * self._cell(tip)
        return fields_around(self._solver.points, self._solver.thickness, tip.reference, radius)

    def _measure(self, before: Sequence[FractureFields] | None) -> list[TipState]:
        solver = self._solver
        tips: list[Tip] = solver.cracks.tips
        self.tips = []
        events = []
        for number, tip in enumerate(tips):
            if (tip.crack, tip.end) in self.lost:
                continue
            others = np.array([other.reference for other in tips if other is not tip]).reshape(-1, 2)
            state = self._state_of(tip, None if before is None else before[number], others)
            if state is None:
                self.lost.add((tip.crack, tip.end))
                continue
            event = self._grow(tip, state)
            self.tips.append(event)
            if event.grown > 0.0 or event.woken:
                events.append(event)
        return events

    def _state_of(self, tip: Tip, before: FractureFields | None, others: FloatArray) -> TipState | None:
        solver = self._solver
        fields = self._gather(tip)
        frame = TipFrame(tip.reference, tip.reference_direction)
        cell = self._cell(tip)
        rates = None
        if before is not None and np.array_equal(before.position, fields.position):
            rates = rates_between(before, fields, _WINDOW * solver.time_step)
        line = solver.cracks.line(tip.crack)
        path = line if tip.end == 0 else line[::-1]
        for ring in RINGS:
            inner, outer = (radius * cell for radius in ring)
            straight = is_straight(path, tip.reference_direction, outer)
            try:
                release = j_integral(
                    fields, frame, inner, outer, rates, None if straight else np.ascontiguousarray(path), others
                )
            except ValueError:
                continue
            break
        else:
            return None
        jump = jump_behind(solver.cracks, tip, _BEHIND * cell)
        material = solver.materials[0]
        young, poisson = getattr(material, "young", None), getattr(material, "poisson", None)
        plane_stress = material.assumption == "plane_stress"
        intensities = Intensities(float("nan"), float("nan"))
        if young is not None and poisson is not None:
            if straight:
                intensities = interaction_intensities(
                    fields, frame, inner, outer, young, poisson, plane_stress, rates, others
                )
            elif release > 0.0 and np.any(jump != 0.0):
                intensities = intensities_from_opening(release, jump[0], jump[1], young, poisson, plane_stress)
        # The angle depends on the ratio of the modes alone, which the faces show for any material.
        angle = crack_extension_angle(intensities if np.isfinite(intensities[0]) else Intensities(jump[0], jump[1]))
        closure = CLOSURE * cell if ring == RING and straight else 0.0
        parts = (float("nan"), float("nan"))
        if closure > 0.0:
            opening, sliding = jump_behind(solver.cracks, tip, closure)
            parts = vcct(fields, frame, float(opening), float(sliding), closure)
        return TipState(
            solver.step,
            solver.step * solver.time_step,
            tip.crack,
            tip.end,
            (float(tip.position[0]), float(tip.position[1])),
            (float(tip.reference[0]), float(tip.reference[1])),
            tip.length,
            release,
            *parts,
            *intensities,
            angle,
            float(stress_ahead(fields, frame, _AHEAD * cell, angle, _AHEAD * cell)[0]),
        )

    def _grow(self, tip: Tip, state: TipState) -> TipState:
        law = self._laws[tip.crack]
        if law is None:
            return state
        woken = False
        if tip.crack in self._asleep:
            assert law.start_stress is not None
            if state.hoop_stress < law.start_stress:
                return state
            self._asleep.discard(tip.crack)
            woken = True
        grown = 0.0
        if state.release_rate >= law.toughness:
            grown = law.increment if law.increment is not None else INCREMENT * self._cell(tip)
            angle = state.angle if law.direction == "hoop" else 0.0
            turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
            end = self._solver.cracks.extend(tip.crack, tip.end, grown * (turn @ tip.reference_direction))
            grown = float(np.hypot(*(end - tip.reference)))
        return replace(state, grown=grown, woken=woken)


def _law_of(number: int, crack: Crack) -> GrowthLaw | None:
    if crack.growth is None or isinstance(crack.growth, GrowthLaw):
        return crack.growth
    raise ValueError(f"cracks[{number}].growth = {crack.growth!r}: a GrowthLaw or None is needed")


def is_straight(path: FloatArray, direction: FloatArray, distance: float) -> bool:
    """Does a line (k, 2), from its tip backwards, run against `direction` as far as the distance [m]?"""
    for a, b in pairwise(path):
        along = (a - b) / np.hypot(*(a - b))
        if abs(along[0] * direction[1] - along[1] * direction[0]) > _STRAIGHT or along @ direction < 0.0:
            return False
        if np.hypot(*(b - path[0])) >= distance:
            break
    return True


def jump_behind(cracks: Any, tip: Tip, distance: float) -> FloatArray:
    """Opening and sliding of the faces a distance along the crack behind a tip [m], (2,), in the tip's frame now."""
    place, left, right = cracks.faces(tip.crack)
    if tip.end == 1:
        place, left, right = place[::-1], left[::-1], right[::-1]
        jump = left - right
    else:
        jump = right - left  # seen out of the tip, left and right change places
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(place, axis=0).T))])
    t = tip.direction
    here = np.array([np.interp(distance, arc, jump[:, 0]), np.interp(distance, arc, jump[:, 1])])
    return np.array([-t[1] * here[0] + t[0] * here[1], t[0] * here[0] + t[1] * here[1]])
