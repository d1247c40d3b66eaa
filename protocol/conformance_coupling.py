"""Checks of what the coupling asks of atoms: moved at once, severed, left out of a sample, with their momentum told."""

from __future__ import annotations

import numpy as np

from protocol import atomistic as a
from protocol.conformance_probe import Refuted, error_report, expect_error, read_reply
from protocol.conformance_problems import Problem
from protocol.conformance_solver import REFUSED, SolverChecks
from protocol.messages import FieldsReply, FieldsRequest, Message
from protocol.version import Version
from protocol.wrong_requests import wrong_requests


class CouplingChecks(SolverChecks):
    """Checks of the role `atomistic` since 1.3."""

    def _configured_atoms(self, problem: Problem) -> tuple[a.AtomisticConfigure, a.AtomisticConfigured]:
        request = problem.request("configure")
        assert isinstance(request, a.AtomisticConfigure)
        return request, self._work.reply("configure", request, a.AtomisticConfigured)

    def _read(self, *names: str) -> list[np.ndarray]:
        found = self._work.reply("fields", FieldsRequest(names=list(names)), FieldsReply).fields
        return [found[name] for name in names]

    def _each_wrong_field(self, operation: str, request: Message, problem: Problem) -> None:
        assert self._welcome is not None
        for wrong in wrong_requests(request, problem.sizes, Version(*self._welcome.version)):
            self._refused(operation, [wrong])

    def _momentum(self, problem: Problem) -> str:
        _, built = self._configured_atoms(problem)
        self._set(problem)
        told = read_reply(self._advance(problem), a.AtomisticAdvanced).momentum
        if told is None:
            return "not told"
        (velocity,) = self._read("velocity")
        wanted = built.atom_mass @ velocity
        scale = float(built.atom_mass @ np.linalg.norm(velocity, axis=1))
        if np.abs(np.array(told) - wanted).max() > 1e-9 * scale:
            raise Refuted(f"momentum is {told} kg m/s, that of the velocities {tuple(wanted)}")
        return f"{np.linalg.norm(told):.3g} kg m/s"

    def _keep(self, problem: Problem) -> str:
        request, built = self._configured_atoms(problem)
        low, high = built.position.min(axis=0), built.position.max(axis=0)
        # The border falls between atoms, and half of the sample is on either side of it.
        line = _between(built.position[:, 0], 0.5 * (low[0] + high[0]))
        far = float((high - low).max())
        corners = [(line, low[1] - far), (high[0] + far, low[1] - far), (high[0] + far, high[1] + far),
                   (line, high[1] + far)]  # fmt: skip
        answer = self._work.ask("configure", request.model_copy(update={"keep": corners}))
        if answer.kind == "error":
            expect_error(answer, ("unsupported",), ("keep",))
            return "unsupported"
        kept = read_reply(answer, a.AtomisticConfigured)
        wanted = built.position[built.position[:, 0] > line]
        if kept.position.shape != wanted.shape or np.abs(kept.position - wanted).max() > 1e-16:
            raise Refuted(f"{len(kept.position)} atoms are there, {len(wanted)} lie in the polygon")
        for wrong in (corners[:2], [corners[0], corners[2], corners[1], corners[3]]):
            expect_error(self._work.ask("configure", request.model_copy(update={"keep": wrong})), REFUSED, ("keep",))
        self._each_wrong_field("configure", request.model_copy(update={"keep": corners}), problem)
        return f"{len(wanted)} of {len(built.position)} atoms"

    def _displace(self, problem: Problem) -> str:
        self._set(problem)
        before = read_reply(self._advance(problem), a.AtomisticAdvanced)
        register = problem.request("register")
        assert isinstance(register, a.AtomisticRegister)
        position, velocity = self._read("position", "velocity")
        row = {int(name): index for index, name in enumerate(self._atom_id(problem))}
        way = np.column_stack([1e-3 * position[:, 1], 2e-3 * position[:, 1], np.zeros(len(position))])
        place = register.anchor_position + way[[row[int(name)] for name in register.atom_id]]
        request = a.DisplaceRequest(displacement=way, anchor_position=place)
        self._each_wrong_field("displace", request, problem)
        if self._work.reply("displace", request, a.Displaced).step != before.step:
            raise Refuted("the step counter moved with the atoms")
        moved, speed = self._read("position", "velocity")
        if np.abs(moved - position - way).max() > 1e-6 * np.abs(way).max():
            raise Refuted("the atoms did not move by the displacement")
        if np.abs(speed - velocity).max() > 1e-9 * np.abs(velocity).max():
            raise Refuted("the velocities changed")
        saved = self._checkpoint()
        answers = []
        for again in (False, True):
            if again:
                self._restore(saved)
            still = a.AtomisticAdvance(steps=5, anchor_position=place, anchor_velocity=np.zeros_like(place))
            answers.append([self._work.ask("advance", still), self._all_fields()])
        self._same(answers[0], answers[1], "after a displacement, a checkpoint and restore")
        after = read_reply(answers[0][0], a.AtomisticAdvanced)
        if after.step != before.step + 5:
            raise Refuted(f"the step is {after.step}, must be {before.step + 5}")
        return f"{len(way)} atoms"

    def _atom_id(self, problem: Problem) -> np.ndarray:
        """Ids of the atoms; the problem is set anew."""
        _, built = self._configured_atoms(problem)
        self._set(problem)
        self._advance(problem)
        return built.atom_id

    def _cut(self, problem: Problem) -> str:
        _, built = self._configured_atoms(problem)
        x, y = built.position[:, 0], built.position[:, 1]
        width = float(np.ptp(x))
        self._set(problem)
        before = read_reply(self._advance(problem), a.AtomisticAdvanced)
        request = a.CutRequest(from_x=float(x.min()) - width, to_x=0.0, y=_between(y, 0.0))
        answer = self._work.ask("cut", request)
        if answer.kind == "error":
            if error_report(answer).code != "unsupported":
                raise Refuted(f"was answered with {error_report(answer).text()}")
            return f"unsupported: {error_report(answer).sentence}"
        done = read_reply(answer, a.Severed)
        if done.step != before.step or done.bonds < 1 or done.energy == 0.0:
            raise Refuted(f"{done.bonds} bonds at step {done.step} changed the energy by {done.energy:g} J")
        cut = read_reply(self._advance(problem), a.AtomisticAdvanced)
        if cut.broken_bonds < before.broken_bonds + done.bonds:
            raise Refuted(f"{done.bonds} bonds were severed, {cut.broken_bonds} count as broken")
        if cut.crack_tip is None or abs(cut.crack_tip) > 0.25 * width:
            raise Refuted(f"the crack's tip is at {cut.crack_tip}, the cut ended at 0")
        ahead = a.CutRequest(from_x=0.0, to_x=0.25 * width, y=request.y)
        longer = self._work.reply("cut", ahead, a.Severed)
        self._go_back(problem)
        self._resume(problem)
        last = read_reply(self._advance(problem), a.AtomisticAdvanced)
        if last.broken_bonds < cut.broken_bonds + longer.bonds or not (last.crack_tip or 0.0) > cut.crack_tip:
            raise Refuted(f"after a longer cut {last.broken_bonds} bonds are broken, the tip is at {last.crack_tip}")
        for values in ({"to_x": request.from_x}, {"to_x": request.from_x - width}):
            expect_error(
                self._work.ask("cut", request.model_copy(update=values)), REFUSED, ("to_x", "from_x")
            )  # fmt: skip
        self._each_wrong_field("cut", request, problem)
        return f"{done.bonds} and {longer.bonds} bonds"


def _between(values: np.ndarray, near: float) -> float:
    """Return the middle of the gap between different values that is nearest to a number."""
    sorted_values = np.unique(values)
    gaps = np.diff(sorted_values)
    middles = (sorted_values[1:] + sorted_values[:-1])[gaps > 0.3 * gaps.max()] / 2.0
    return float(middles[np.argmin(np.abs(middles - near))])
