"""Growth of cracks, and what a coordinator needs to hand a crack to the atoms and start it anew behind them.

At every tip the energy release rate is measured at a fixed interval of steps. A tip whose J reaches the toughness
of its crack grows by one increment, straight on or in the direction of the largest hoop stress.

A crack that comes out of the atoms (Fig 4.3) is stated with its first short segment and the hoop stress that was
seen when the crack before them last grew: it sleeps until the stress at its own tip has reached that value, and
then grows as any other.

Next to an overlap with atoms a tip is the continuum's as long as it is outside::

      hole |   ring   |            inside: neither measured nor grown, whoever couples the two moves it
           |          |            on the border: measured, but it does not grow
     ------+--x-------x----x--     outside: measured and grown, by no piece that would enter

J is that of the ring around the tip that fits between it and the hole, where a point of the overlap stands for all
the material there. Where not even the smallest ring fits, the last J counts.
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
from .overlap_border import distance_outside, way_before

FloatArray = NDArray[np.float64]

Direction = Literal["hoop", "straight"]

#: Rings tried in turn as a tip comes near the body's surface, an overlap's hole or another tip [cells]. J of an edge
#: crack of ten cells by these, tip anywhere in its cell: -2.5 to +0.1, -2.7 to -0.2, -2.4 to +0.9, -2.5 to +1.3 %.
RINGS = (RING, (1.0, 4.0), (1.0, 3.0), (0.5, 2.0))
#: Share of a cell by which a tip grows unless stated.
INCREMENT = 0.5
# Steps over which accelerations and velocity gradients are taken.
_WINDOW = 4
# Distance behind the tip at which opening and sliding tell the modes apart [cells].
_BEHIND = 1.5
# Distance ahead of the tip, and half width, of the hoop stress [cells].
_AHEAD = 1.0
# Nearer to an overlap's border than this a tip is on it [cells].
_ON_BORDER = 1e-6
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
        J [J/m^2]; NaN where no ring around the tip fits beside an overlap and none did before.
    release_opening, release_sliding : float
        G_I and G_II by virtual crack closure [J/m^2]; NaN where the closure does not fit into the body.
    intensity_opening, intensity_sliding : float
        K_I and K_II [Pa sqrt(m)], for isotropic materials, else NaN.
    angle : float
        Direction of the largest hoop stress [rad], from the tip's direction, positive to the left.
    hoop_stress : float
        Stress across that direction one cell ahead [Pa]. The critical stress to save for a `start_stress`. NaN where
        there is no material.
    grown : float
        By how much the tip has grown at this step [m].
    woken : bool
        Did the crack's `start_stress` wake it at this step?
    reached : bool
        Did it come to the border of an overlap, which it will not enter?
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
    reached: bool = False


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
    overlaps : sequence of (k, 2) ndarray
        Outer borders of overlaps with atoms, simple polygons [m].

    Attributes
    ----------
    tips : list of TipState
        The last measurement of every tip.
    lost : set of (int, int)
        Tips (crack, end) too near the body's surface or another tip for any ring. They are no longer measured and
        stand still.

    Raises
    ------
    ValueError
        If there is no crack, a growth law is of another type, or the interval is too short.
    """

    def __init__(self, solver: CrackedSolver, interval: int = 20, overlaps: Sequence[FloatArray] = ()) -> None:
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
        self._overlaps = tuple(overlaps)
        self._before: dict[tuple[int, int], FractureFields] = {}
        #: Last J of the tips that were measured by a ring, and those that wait at the border of an overlap.
        self._last: dict[tuple[int, int], float] = {}
        self._waiting: set[tuple[int, int]] = set()
        self._asleep = {number for number, law in enumerate(self._laws) if law and law.start_stress is not None}

    def advance(self, steps: int) -> list[TipState]:
        """Advance, measuring whenever the solver's step count is a multiple of the interval.

        Returns
        -------
        list of TipState
            Events: tips that grew, woke or came to an overlap, in order.

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
                self._before = {(tip.crack, tip.end): self._gather(tip) for tip in solver.cracks.tips}
            elif solver.step == due:
                events += self._measure()
                self._before = {}
        return events

    def forget(self, crack: int, end: int) -> None:
        """Take a tip for a new one, since someone has moved it."""
        self.lost.discard((crack, end))
        self._last.pop((crack, end), None)
        self._waiting.discard((crack, end))

    def state(self) -> dict[str, NDArray[Any]]:
        """What a restart needs beside the solver's state: which cracks sleep, which tips are lost, fields of before."""
        gathered = list(self._before.values())
        before = {
            f"growth_before_{name}": np.concatenate([getattr(fields, name) for fields in gathered])
            if gathered
            else np.zeros(0)
            for name in FractureFields._fields
        }
        return {
            "growth_before_tip": np.array(list(self._before), dtype=np.int64).reshape(-1, 2),
            "growth_before_count": np.array([fields.position.shape[0] for fields in gathered], dtype=np.int64),
            **before,
            "growth_asleep": np.array(sorted(self._asleep), dtype=np.int64),
            "growth_lost": np.array(sorted(self.lost), dtype=np.int64).reshape(-1, 2),
            "growth_waiting": np.array(sorted(self._waiting), dtype=np.int64).reshape(-1, 2),
            "growth_last_tip": np.array(list(self._last), dtype=np.int64).reshape(-1, 2),
            "growth_last_j": np.array(list(self._last.values()), dtype=np.float64),
        }

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Take back a state, exactly."""
        counts = state["growth_before_count"]
        self._before = {}
        if counts.size:
            ends = np.cumsum(counts)[:-1]
            parts = {
                name: state[f"growth_before_{name}"].reshape(counts.size, 2, 2)
                if name == "rotation"
                else np.split(state[f"growth_before_{name}"], ends)
                for name in FractureFields._fields
            }
            for k, key in enumerate(_keys(state["growth_before_tip"])):
                self._before[key] = FractureFields(**{name: part[k] for name, part in parts.items()})
        self._asleep = {int(number) for number in state["growth_asleep"]}
        self.lost = set(_keys(state["growth_lost"]))
        self._waiting = set(_keys(state["growth_waiting"]))
        self._last = dict(zip(_keys(state["growth_last_tip"]), map(float, state["growth_last_j"]), strict=True))

    # ---- inner -------------------------------------------------------------------------------------

    def _cell(self, tip: Tip) -> float:
        points = self._solver.points
        near = int(np.argmin(np.sum((points.reference_position - tip.reference) ** 2, axis=1)))
        return float(2.0 * points.half[near] * self._solver.body.points_per_cell)

    def _gather(self, tip: Tip) -> FractureFields:
        radius = max(RING[1], np.sqrt(2.0) * CLOSURE) * self._cell(tip)
        return fields_around(self._solver.points, self._solver.thickness, tip.reference, radius)

    def _outside(self, tip: Tip) -> float:
        """Distance of a tip from the nearest overlap [m], negative inside one."""
        return min((distance_outside(border, tip.reference) for border in self._overlaps), default=np.inf)

    def _measure(self) -> list[TipState]:
        tips: list[Tip] = self._solver.cracks.tips
        self.tips = []
        events = []
        for tip in tips:
            key = (tip.crack, tip.end)
            if key in self.lost or self._outside(tip) < -_ON_BORDER * self._cell(tip):
                continue
            others = np.array([other.reference for other in tips if other is not tip]).reshape(-1, 2)
            state = self._state_of(tip, self._before.get(key), others)
            if state is None:
                self.lost.add(key)
                continue
            event = self._grow(tip, state)
            self.tips.append(event)
            if event.grown > 0.0 or event.woken or event.reached:
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
        outer_most = RINGS[0][1] * cell
        for ring in RINGS:
            inner, outer = (radius * cell for radius in ring)
            straight = is_straight(path, tip.reference_direction, outer)
            try:
                release = j_integral(
                    fields, frame, inner, outer, rates, None if straight else np.ascontiguousarray(path), others
                )
            except ValueError:
                continue
            self._last[tip.crack, tip.end] = release
            fits = True
            break
        else:
            if self._outside(tip) > outer_most:
                return None
            release, fits = self._last.get((tip.crack, tip.end), float("nan")), False
        jump = jump_behind(solver.cracks, tip, _BEHIND * cell)
        material = solver.materials[0]
        young, poisson = getattr(material, "young", None), getattr(material, "poisson", None)
        plane_stress = material.assumption == "plane_stress"
        intensities = Intensities(float("nan"), float("nan"))
        if young is not None and poisson is not None:
            if straight and fits:
                intensities = interaction_intensities(
                    fields, frame, inner, outer, young, poisson, plane_stress, rates, others
                )
            elif release > 0.0 and np.any(jump != 0.0):
                intensities = intensities_from_opening(release, jump[0], jump[1], young, poisson, plane_stress)
        # The angle depends on the ratio of the modes alone, which the faces show for any material.
        angle = crack_extension_angle(intensities if np.isfinite(intensities[0]) else Intensities(jump[0], jump[1]))
        closure = CLOSURE * cell if fits and ring == RING and straight else 0.0
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
            self._hoop_stress(fields, frame, angle, cell),
        )

    @staticmethod
    def _hoop_stress(fields: FractureFields, frame: TipFrame, angle: float, cell: float) -> float:
        """Stress across a direction, one cell ahead [Pa]; NaN where there is no material."""
        try:
            return float(stress_ahead(fields, frame, _AHEAD * cell, angle, _AHEAD * cell)[0])
        except ValueError:
            return float("nan")

    def _grow(self, tip: Tip, state: TipState) -> TipState:
        law = self._laws[tip.crack]
        if law is None:
            return state
        woken = False
        if tip.crack in self._asleep:
            assert law.start_stress is not None
            if not state.hoop_stress >= law.start_stress:
                return state
            self._asleep.discard(tip.crack)
            woken = True
        if not state.release_rate >= law.toughness:
            return replace(state, woken=woken)
        cell = self._cell(tip)
        length = law.increment if law.increment is not None else INCREMENT * cell
        angle = state.angle if law.direction == "hoop" else 0.0
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        step = length * (turn @ tip.reference_direction)
        share = min((way_before(border, tip.reference, step) for border in self._overlaps), default=1.0)
        grown = 0.0
        if abs(self._outside(tip)) <= _ON_BORDER * cell:
            share = 0.0
        elif share > 0.0:
            end = self._solver.cracks.extend(tip.crack, tip.end, share * step)
            grown = float(np.hypot(*(end - tip.reference)))
        reached = share < 1.0 and (tip.crack, tip.end) not in self._waiting
        if reached:
            self._waiting.add((tip.crack, tip.end))
        return replace(state, grown=grown, woken=woken, reached=reached)


def _keys(table: NDArray[Any]) -> list[tuple[int, int]]:
    return [(int(crack), int(end)) for crack, end in table]


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
