"""Checks of cracks that are extended at run time, for a continuum that names `extend_crack` among its operations."""

from __future__ import annotations

import numpy as np

from protocol import continuum as c
from protocol.conformance_kit import NotTried
from protocol.conformance_probe import Refuted, expect_error, read_reply
from protocol.conformance_problems import Problem
from protocol.conformance_solver import REFUSED, SolverChecks
from protocol.frames import Envelope
from protocol.messages import Point2
from protocol.version import Version

_SINCE = Version(1, 3)
# A crack that was extended differs from one that was stated so by round-off alone, in what it makes anchors do [1].
_SAME = 1e-6
# A tip is reported this close to the last corner while nothing has moved yet, in cells.
_CLOSE = 1e-2


class CrackChecks(SolverChecks):
    """Checks of what only the role `continuum` has."""

    def _cracks(self, problem: Problem) -> None:
        assert self._welcome is not None
        if self._welcome.role != "continuum" or Version(*self._welcome.version) < _SINCE:
            return
        offered = self._welcome.capabilities.get("operations", [])
        if not isinstance(offered, list) or "extend_crack" not in offered:
            self._check("extend_crack: is not offered, and refused", self._no_extension)
            return
        self._check("extend_crack: the tip is where it was sent", lambda: self._extended_tip(problem))
        self._check("extend_crack: acts as a crack that was stated so", lambda: self._same_act(problem))
        self._check("extend_crack: a checkpoint holds the new line", lambda: self._kept_line(problem))
        self._check("extend_crack: what makes no sense is refused", lambda: self._wrong_extensions(problem))

    def _no_extension(self) -> str:
        request = c.CrackExtension(crack=0, end=1, points=[(0.0, 0.0)])
        return expect_error(self._work.ask("extend_crack", request), ("unsupported", "unknown_type")).code

    def _set_cracked(self, problem: Problem, *corners: Point2) -> float:
        """Set the problem with a crack of these corners, in the middle of a row of cells; return the cell size."""
        configure = problem.request("configure")
        assert isinstance(configure, c.ContinuumConfigure)
        h = configure.cell_size
        line = c.CrackLine(points=[(x * h, y * h) for x, y in corners])
        answer = self._work.ask("configure", configure.model_copy(update={"cracks": [line]}))
        if answer.kind == "error":
            expect_error(answer, ("unsupported",))
            raise NotTried("a crack of these corners is not supported")
        read_reply(answer, c.ContinuumConfigured)
        self._work.reply("register", problem.request("register"), c.ContinuumRegistered)
        self._exchanges = 0
        return h

    def _extend(self, h: float, *corners: Point2) -> c.CrackExtended:
        request = c.CrackExtension(crack=0, end=1, points=[(x * h, y * h) for x, y in corners])
        return self._work.reply("extend_crack", request, c.CrackExtended)

    def _extended_tip(self, problem: Problem) -> str:
        h = self._set_cracked(problem, (-7, 0.5), (-4, 0.5))
        reply = self._extend(h, (-3, 0.5), (4, 1.5))
        if reply.step != self._status().step:
            raise Refuted(f"the reply has step {reply.step}, status {self._status().step}")
        self._expect_state("ready")
        ends = [tip for tip in reply.tips if tip.crack == 0 and tip.end == 1]
        if len(ends) != 1 or np.hypot(ends[0].position[0] - 4 * h, ends[0].position[1] - 1.5 * h) > _CLOSE * h:
            places = [tip.position for tip in ends]
            raise Refuted(f"tips of crack 0 at end 1 are {places}, must be one at ({4 * h:g}, {1.5 * h:g})")
        length = (4 + 50**0.5) * h
        if abs(ends[0].length - length) > _CLOSE * h:
            raise Refuted(f"the length is {ends[0].length:g} m, the line has {length:g} m")
        return f"at {ends[0].position}"

    def _moved(self, problem: Problem) -> np.ndarray:
        for number in range(3):
            reply = self._work.reply("advance", problem.advance(number), c.ContinuumAdvanced)
        return reply.anchor_displacement

    def _same_act(self, problem: Problem) -> str:
        corners: tuple[Point2, Point2] = ((-4.0, 0.5), (4.0, 0.5))
        h = self._set_cracked(problem, (-7, 0.5), corners[0])
        short = self._moved(problem)
        self._set_cracked(problem, (-7, 0.5), corners[0])
        self._extend(h, corners[1])
        extended = self._moved(problem)
        self._set_cracked(problem, (-7, 0.5), *corners)
        stated = self._moved(problem)
        scale = float(np.abs(stated).max())
        if float(np.abs(extended - stated).max()) > _SAME * scale:
            raise Refuted(f"anchors move by up to {np.abs(extended - stated).max() / scale:.2g} otherwise")
        if float(np.abs(extended - short).max()) <= _SAME * scale:
            raise Refuted("anchors move as with the crack that was not extended")
        return f"differs by {np.abs(extended - stated).max() / scale:.1g} of the largest displacement"

    def _kept_line(self, problem: Problem) -> None:
        h = self._set_cracked(problem, (-7, 0.5), (-4, 0.5))
        self._advance(problem)
        self._extend(h, (4, 0.5))
        first = self._exchanges
        saved = self._checkpoint()
        went_on: list[Envelope] = self._advance_from(problem, first, 2)
        self._set_cracked(problem, (-7, 0.5), (-4, 0.5))
        self._restore(saved)
        self._same(went_on, self._advance_from(problem, first, 2), "after configure, register, restore")

    def _wrong_extensions(self, problem: Problem) -> None:
        h = self._set_cracked(problem, (-7, 0.5), (-4, 0.5))
        right = c.CrackExtension(crack=0, end=1, points=[(-3 * h, 0.5 * h)])
        for label, field, changes in (
            ("a crack that is not there", "crack", {"crack": 1}),
            ("an end outside the body", "end", {"end": 0}),
            ("a corner outside the body", "points", {"points": [(-3 * h, 0.5 * h), (7 * h, 0.5 * h)]}),
            ("a line that meets itself", "points", {"points": [(-3 * h, h), (-4.5 * h, h), (-4.5 * h, 0.0)]}),
        ):
            try:
                expect_error(self._work.ask("extend_crack", right.model_copy(update=changes)), REFUSED, (field,))
            except Refuted as reason:
                raise Refuted(f"{label} {reason}") from None
        self._work.reply("extend_crack", right, c.CrackExtended)


__all__ = ["CrackChecks"]
