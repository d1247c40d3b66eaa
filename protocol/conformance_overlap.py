"""Checks of overlaps between polygons, and of the energy and momentum that a continuum tells, since 1.3."""

from __future__ import annotations

import math

import numpy as np

from protocol import continuum as c
from protocol.conformance_probe import Refuted, expect_error, read_reply
from protocol.conformance_problems import Problem
from protocol.conformance_solver import REFUSED, SolverChecks
from protocol.messages import Point2
from protocol.version import Version

_SINCE = Version(1, 3)
# Weights of one shape that was stated in two ways, and of another with the same area [1].
_SAME, _ROUND_OFF = 1e-9, 1e-6
# Exchanges over which energies and works must add up, and what may be missing of the largest of them.
_EXCHANGES, _MISSING = 6, 0.1
_TAKEN = "taken"


class OverlapChecks(SolverChecks):
    """Checks of what only the role `continuum` has."""

    def _overlaps(self, problem: Problem) -> None:
        assert self._welcome is not None
        if self._welcome.role != "continuum" or Version(*self._welcome.version) < _SINCE:
            return
        if self._check("overlaps: are taken, or refused as unsupported", lambda: self._taken(problem)) == _TAKEN:
            self._check("overlaps: polygons say the same as rectangles", lambda: self._same_ring(problem))
            self._check("overlaps: weights lie between those of their borders", lambda: self._profiles(problem))
            self._check("overlaps: what makes no ring is refused", lambda: self._no_rings(problem))
        self._check("momentum: goes with the kinetic energy", lambda: self._momentum_of_points(problem))
        self._check("energies: they and the works add up", lambda: self._balance(problem))

    def _with_rings(self, problem: Problem, *regions: c.OverlapRegion) -> c.ContinuumConfigure:
        configure = problem.request("configure")
        assert isinstance(configure, c.ContinuumConfigure)
        return configure.model_copy(update={"overlap": None, "overlaps": list(regions)})

    def _ring(self, problem: Problem, **changes: object) -> c.OverlapRegion:
        """Return the ring of the problem as polygons."""
        configure = problem.request("configure")
        assert isinstance(configure, c.ContinuumConfigure) and configure.overlap is not None
        plain = configure.overlap
        region = c.OverlapRegion(inner=_corners(plain.inner), outer=_corners(plain.outer), weight=plain.weight)
        return region.model_copy(update=changes)

    def _taken(self, problem: Problem) -> str:
        answer = self._work.ask("configure", self._with_rings(problem, self._ring(problem)))
        if answer.kind == "error":
            return f"unsupported: {expect_error(answer, ('unsupported',), ('overlaps',)).field}"
        read_reply(answer, c.ContinuumConfigured)
        return _TAKEN

    def _built(self, request: c.ContinuumConfigure) -> c.ContinuumConfigured:
        return self._work.reply("configure", request, c.ContinuumConfigured)

    def _same_ring(self, problem: Problem) -> None:
        plain = self._work.reply("configure", problem.request("configure"), c.ContinuumConfigured)
        shaped = self._built(self._with_rings(problem, self._ring(problem)))
        for name in ("position", "weight"):
            one, other = getattr(plain, name), getattr(shaped, name)
            if one.shape != other.shape or np.abs(one - other).max() > _SAME * np.abs(one).max():
                raise Refuted(f"{name} differs between overlap and overlaps of the same ring")

    def _profiles(self, problem: Problem) -> str:
        ring = self._ring(problem)
        plain = self._built(self._with_rings(problem, ring)).weight
        sums = []
        for profile in ("constant", "power", "linear"):
            changes = {"profile": profile, "exponent": 3.0}
            built = self._built(self._with_rings(problem, ring.model_copy(update=changes)))
            if built.weight.shape != plain.shape:
                raise Refuted(f"profile {profile} has {len(built.weight)} points, constant has {len(plain)}")
            if not ((built.weight > 0.0) & (built.weight < 1.0 + _ROUND_OFF)).all():
                raise Refuted(f"profile {profile} has weights from {built.weight.min():g} to {built.weight.max():g}")
            if (built.weight < plain - _ROUND_OFF).any():
                raise Refuted(f"profile {profile} is below weight at inner somewhere")
            sums.append(float(built.weight.sum()))
        if not sums[0] < sums[1] < sums[2]:
            raise Refuted(f"sums of weights of constant, s^3 and s are {sums}, must ascend")
        return f"mean weights {', '.join(f'{total / len(plain):.4f}' for total in sums)}"

    def _no_rings(self, problem: Problem) -> str:
        ring = self._ring(problem)
        (x0, y0), (x1, y1) = ring.inner[0], ring.inner[2]
        crossed: list[Point2] = [(x0, y0), (x1, y1), (x1, y0), (x0, y1)]
        far = [(x + 1e3 * (x1 - x0), y) for x, y in ring.outer], [(x + 1e3 * (x1 - x0), y) for x, y in ring.inner]
        wrong = {
            "inner crosses itself": (0, [ring.model_copy(update={"inner": crossed})]),
            "inner reaches beyond outer": (0, [ring.model_copy(update={"inner": ring.outer, "outer": ring.inner})]),
            "two rings meet": (1, [ring, ring]),
            "outside the body": (0, [ring.model_copy(update={"outer": far[0], "inner": far[1]})]),
        }
        for label, (number, regions) in wrong.items():
            answer = self._work.ask("configure", self._with_rings(problem, *regions))
            try:
                expect_error(answer, REFUSED, (f"overlaps.{number}", "overlaps"))
            except Refuted as error:
                raise Refuted(f"{label}: {error}") from None
        return ", ".join(wrong)

    def _momentum_of_points(self, problem: Problem) -> str:
        self._set(problem)
        reply = read_reply(self._advance(problem), c.ContinuumAdvanced)
        if reply.momentum is None:
            return "not told"
        size = math.hypot(*reply.momentum)
        most = math.sqrt(2.0 * _mass(problem) * reply.kinetic_energy)
        if not size <= most * (1.0 + _ROUND_OFF):
            raise Refuted(f"momentum is {size:g} kg m/s, with its kinetic energy the body has at most {most:g}")
        return f"{size:.3g} kg m/s"

    def _balance(self, problem: Problem) -> str:
        self._set(problem)
        left, scale = [], 0.0
        for _ in range(_EXCHANGES):
            reply = read_reply(self._advance(problem), c.ContinuumAdvanced)
            if reply.filter_loss is None:
                return "filter_loss is not told"
            parts = [reply.kinetic_energy, reply.strain_energy, reply.damping_loss, reply.dissipated_energy]
            works = [reply.edge_work, reply.load_work, reply.interface_work]
            left.append(sum(parts) + reply.filter_loss - sum(works))
            scale = max(scale, *parts, *(abs(work) for work in works))
        missing = (max(left) - min(left)) / scale
        if not missing <= _MISSING:
            raise Refuted(f"energies, losses and works leave {missing:.2g} of the largest of them")
        return f"{missing:.2g} of the largest is left"


def _corners(rectangle: c.Rectangle) -> list[Point2]:
    (left, bottom), (right, top) = rectangle.lower, rectangle.upper
    return [(left, bottom), (right, bottom), (right, top), (left, top)]


def _area(rectangle: c.Rectangle) -> float:
    return float(np.prod(np.subtract(rectangle.upper, rectangle.lower)))


def _mass(problem: Problem) -> float:
    """Return the mass of the problem's body, kg, its ring with its weight."""
    configure = problem.request("configure")
    assert isinstance(configure, c.ContinuumConfigure) and configure.overlap is not None
    ring = configure.overlap
    inner, outer = _area(ring.inner), _area(ring.outer)
    area = _area(configure.body) - inner - (1.0 - ring.weight) * (outer - inner)
    return configure.material.density * configure.thickness * area
