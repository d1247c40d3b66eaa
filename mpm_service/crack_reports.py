"""What the replies tell of cracks: their tips, what was measured there, and growth and arrest as events."""

from __future__ import annotations

from typing import Any

import numpy as np

from mpm_service.crack_growth import CrackGrowth, GrowthLaw, TipState
from mpm_service.cracks import Tip
from mpm_service.solver import MaterialPointSolver
from protocol import continuum as messages
from protocol.arrays import FloatArray
from protocol.errors import ProtocolError

#: Rules of growth: the message's words and the solver's.
RULES = {"straight": "straight", "max_hoop": "hoop"}
#: What a measurement gives: fields of `CrackTip` and of the solver's `TipState`.
_MEASURED = {
    "j": "release_rate",
    "k_1": "intensity_opening",
    "k_2": "intensity_sliding",
    "g_1": "release_opening",
    "g_2": "release_sliding",
    "hoop_stress": "hoop_stress",
}
#: Columns of the saved table before those: crack, end, step, whether it grew then.
_KEY = 4


def growth_law(crack: messages.CrackLine) -> GrowthLaw | None:
    """Return the growth law of a crack as the solver has it."""
    if crack.growth is None:
        return None
    return GrowthLaw(crack.growth.critical_energy_release_rate, RULES[crack.growth.rule])  # type: ignore[arg-type]


class _Pushed:
    """A solver under interface forces, for `CrackGrowth`, which knows nothing of them."""

    def __init__(self, solver: MaterialPointSolver) -> None:
        self._solver = solver
        self.forces: dict[str, FloatArray | None] = {}

    def __getattr__(self, name: str) -> Any:
        return getattr(self._solver, name)

    def advance(self, steps: int) -> None:
        self._solver.advance(steps, **self.forces)


def outer_borders(request: messages.ContinuumConfigure) -> list[FloatArray]:
    """Return the outer borders of the overlaps of a problem, (k, 2) each [m]."""
    found = [np.array(region.outer) for region in request.overlaps]
    if request.overlap is not None:
        (x0, y0), (x1, y1) = request.overlap.outer.lower, request.overlap.outer.upper
        found.append(np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)]))
    return found


class CrackReports:
    """Advances a solver, measures its crack tips where that is asked for, and tells of them.

    Parameters
    ----------
    solver : MaterialPointSolver
    request : ContinuumConfigure
        Whose cracks they are.

    Raises
    ------
    ProtocolError
        `unsupported`, where cracks are to be measured at different intervals.
    ValueError
        If the interval is shorter than a measurement takes.
    """

    def __init__(self, solver: MaterialPointSolver, request: messages.ContinuumConfigure) -> None:
        self._solver = _Pushed(solver)
        self._cracks = request.cracks
        #: Last measurement of each tip: step, whether the tip grew then, and the values; NaN where there is none.
        self._measured: dict[tuple[int, int], tuple[int, bool, list[float]]] = {}
        interval = self._interval()
        self._growth = CrackGrowth(self._solver, interval, outer_borders(request)) if interval else None

    def _interval(self) -> int:
        """Return the steps between measurements; 0 where there are none."""
        found = 0
        for k, crack in enumerate(self._cracks):
            field = f"cracks.{k}.growth.interval" if crack.growth else f"cracks.{k}.measure_every"
            interval = crack.growth.interval if crack.growth else crack.measure_every
            if found and interval and interval != found:
                raise ProtocolError(
                    "unsupported",
                    f"{field} is {interval}, an earlier crack has {found}: they must be equal",
                    field=field,
                )
            found = found or interval
        return found

    def next_stop(self, step: int) -> int:
        """Return the steps from `step` to the next measurement; a large number where there is none."""
        return self._growth.interval - step % self._growth.interval if self._growth else 1 << 62

    def advance(
        self, steps: int, ivc_force: FloatArray | None, anchor_force: FloatArray | None
    ) -> list[messages.ContinuumEvent]:
        """Advance, at most to the next measurement, and return growth and arrest."""
        self._solver.forces = {"ivc_force": ivc_force, "anchor_force": anchor_force}
        if self._growth is None:
            self._solver.advance(steps)
            return []
        self._growth.advance(steps)
        if self._solver.step % self._growth.interval:
            return []
        measured = {(state.crack, state.end) for state in self._growth.tips}
        return [event for state in self._growth.tips for event in self._note(state)] + self._gone(measured)

    def extend(self, request: messages.CrackExtension) -> messages.CrackExtended:
        """Let a crack go on as asked; what was measured at its tip before is forgotten.

        Raises
        ------
        ValueError
            As `MaterialPointSolver.extend_crack`.
        """
        self._solver.extend_crack(request.crack, request.end, request.points)
        self._measured.pop((request.crack, request.end), None)
        if self._growth is not None:
            self._growth.forget(request.crack, request.end)
        return messages.CrackExtended(step=self._solver.step, tips=self.tips())

    def _gone(self, measured: set[tuple[int, int]]) -> list[messages.ContinuumEvent]:
        """Return the arrest of tips that grew, but have come too near a border to be measured any more."""
        found = []
        for key, (step, grew, values) in self._measured.items():
            if grew and key not in measured:
                self._measured[key] = (step, False, values)
                sentence = (
                    f"step {self._solver.step}: crack {key[0]} came to rest at its {('first', 'last')[key[1]]} end, "
                    "too near an edge, a level border or another tip to be measured"
                )
                found.append(messages.ContinuumEvent(kind="arrest", step=self._solver.step, sentence=sentence))
        return found

    def _note(self, state: TipState) -> list[messages.ContinuumEvent]:
        """Keep a measurement; return what it means for a crack that may grow."""
        key = (state.crack, state.end)
        _, grew_before, _ = self._measured.get(key, (0, False, []))
        grew = state.grown > 0.0
        # A tip that has reached an overlap is at rest, and that was told.
        goes_on = grew and not state.reached
        self._measured[key] = (state.step, goes_on, [getattr(state, name) for name in _MEASURED.values()])
        told = []
        if grew:
            told.append(("growth", f"grew by {state.grown:.4g} m"))
        if state.reached:
            told.append(("reached_overlap", "came to the border of an overlap"))
        elif grew_before and not grew:
            told.append(("arrest", "came to rest"))
        now = {(tip.crack, tip.end): tip for tip in self._solver.cracks.tips}
        tip = self._tip(now[key]) if key in now else None
        where = f"at its {('first', 'last')[state.end]} end, J = {state.release_rate:.4g} J/m2"
        return [
            messages.ContinuumEvent(
                kind=kind, step=state.step, sentence=f"step {state.step}: crack {state.crack} {what} {where}", tip=tip
            )
            for kind, what in told
        ]

    def tips(self) -> list[messages.CrackTip]:
        """Return the tips inside the body."""
        cracks = getattr(self._solver, "cracks", None)
        return [self._tip(tip) for tip in (cracks.tips if cracks else [])]

    def _tip(self, tip: Tip) -> messages.CrackTip:
        crack = self._cracks[tip.crack]
        values: dict[str, float | int | None] = {}
        if (crack.growth or crack.measure_every) and (tip.crack, tip.end) in self._measured:
            step, _, measured = self._measured[tip.crack, tip.end]
            values = {
                name: value if np.isfinite(value) else None for name, value in zip(_MEASURED, measured, strict=True)
            }
            values["measured_at"] = step
        place = (float(tip.position[0]), float(tip.position[1]))
        return messages.CrackTip.model_validate(
            {"crack": tip.crack, "end": tip.end, "position": place, "length": tip.length, **values}
        )

    def state(self) -> dict[str, np.ndarray]:
        """Return what a restart needs beside the solver's state."""
        if self._growth is None:
            return {}
        rows = [[*key, step, grew, *values] for key, (step, grew, values) in self._measured.items()]
        table = np.array(rows, dtype=np.float64).reshape(-1, _KEY + len(_MEASURED))
        return {"measured_tips": table, **self._growth.state()}

    def check(self, state: dict[str, np.ndarray]) -> None:
        """Raise ValueError where a state does not fit."""
        missing = sorted(set(self.state()) - set(state))
        if missing:
            raise ValueError(f"field {missing[0]!r} is missing")
        if self._growth is not None and state["measured_tips"].shape[1:] != (_KEY + len(_MEASURED),):
            raise ValueError(f"field 'measured_tips' has shape {state['measured_tips'].shape}")

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Set a state that `check` let pass."""
        if self._growth is None:
            return
        self._growth.restore(state)
        self._measured = {
            (int(row[0]), int(row[1])): (int(row[2]), bool(row[3]), row[_KEY:].tolist())
            for row in state["measured_tips"]
        }
