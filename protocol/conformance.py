"""Holds a running service against the contract of its role, over the wire alone."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path

from protocol.conformance_atomistic import AtomisticChecks
from protocol.conformance_cracks import CrackChecks
from protocol.conformance_kit import Check
from protocol.conformance_micromechanics import MicromechanicsChecks
from protocol.conformance_overlap import OverlapChecks
from protocol.conformance_problems import Problem
from protocol.conformance_structure import WATCHED, StructureChecks
from protocol.conformance_wire import WireChecks
from protocol.malformed_messages import malformed_messages
from protocol.version import Version


def check_service(
    endpoint: str,
    *,
    role: str | None = None,
    keys: Path | None = None,
    deadline: float = 60.0,
    shutdown: bool = False,
    on_check: Callable[[Check], None] | None = None,
) -> list[Check]:
    """Hold the service at `endpoint` against `SPEC.md` and return what each check found.

    The service is given a small problem; whatever it held before is lost.

    Parameters
    ----------
    endpoint : str
    role : str, optional
        Role that it must have; by default the kit finds it out.
    keys : Path, optional
        Folder with CURVE keys.
    deadline : float
        Seconds to wait for one answer.
    shutdown : bool
        Also check that the service can be shut down, last of all.
    on_check : callable, optional
        Called with each check when it is done.
    """
    kit = Kit(endpoint, role, keys, deadline, on_check)
    try:
        kit.run(shutdown)
    finally:
        kit.close()
    return kit.checks


class Kit(WireChecks, StructureChecks, AtomisticChecks, CrackChecks, OverlapChecks, MicromechanicsChecks):
    """One pass over one service; see `check_service`."""

    def run(self, shutdown: bool) -> None:
        """Make all checks, in an order in which a later one can build on an earlier one."""
        self._check("hello: is answered", self._hello)
        if self._welcome is None:
            return
        self._check("hello: ranges that do not meet are refused", self._no_common_version)
        self._check("hello: the smaller newest version is taken", self._agreed_version)
        self._check("hello: another role is refused", self._other_role)
        self._check("version: another major in the header is refused", self._other_major)
        for label, frames in malformed_messages():
            self._check(f"malformed: {label}", partial(self._malformed, frames))
        self._check("type: an unknown one is refused", self._unknown_type)
        self._check("fields: unknown ones are ignored", self._unknown_fields)
        self._check("frames: an empty delimiter is understood and returned", self._delimiter)
        self._check("frames: two clients get each their own reply", self._two_clients)
        self._check("control: status is answered", self._control_status)
        if self._welcome.role == "micromechanics":
            self._micromechanics()
        elif self._welcome.role == "structure":
            with ExitStack() as stack:
                self._structure(self._serve_cells(stack))
        else:
            self._solver()
        if shutdown:
            self._check("shutdown: the service ends", self._shutdown)

    def _solver(self) -> None:
        """Make the checks of a role that holds a problem and its state."""
        assert self._welcome is not None
        if self._welcome.state == "new":
            self._check("state new: what needs a problem is refused", self._nothing_is_set)
        problem = self._check("problem: is set, every reply has its shape", self._set_problem)
        if problem is None:
            return
        self._check("advance: moves the step counter, replies fit the problem", lambda: self._advance_replies(problem))
        self._check("fields: each named one is answered", lambda: self._fields(problem))
        self._check("fields: an unknown name is refused", self._unknown_field_name)
        self._steps_and_states(problem)
        self._atomistic(problem)
        self._cracks(problem)
        self._overlaps(problem)
        self._wrong_fields(problem)
        self._check("control: status while the solver computes, and abort", lambda: self._status_and_abort(problem))
        self._check("state failed: only configure helps", lambda: self._failed(problem))
        self._check("size: a message beyond the limit is refused", self._too_large)
        self._check("size: arrays without rows are understood", lambda: self._zero_rows(problem))
        self._check("end: the service still answers", self._still_there)

    def _steps_and_states(self, problem: Problem) -> None:
        """Make the checks of a problem that is set: steps are made once, states are kept, every kind of it is taken."""
        self._check("id: a repeated request is answered from its reply, run once", lambda: self._repeated(problem))
        self._check("id: an old one is never run again", lambda: self._old_id(problem))
        self._check("id: one that is used for another request is refused", lambda: self._reused_id(problem))
        self._check("checkpoint: going back to it gives the same bits", lambda: self._go_back(problem))
        self._check("checkpoint: a problem set anew goes on with the same bits", lambda: self._resume(problem))
        self._check("restore: a state that does not fit is refused", self._wrong_states)
        self._kinds(problem)

    def _micromechanics(self) -> None:
        """Make the checks of a role that holds no state."""
        problem = self._check("register: a cell is taken, its reply fits", self._register)
        if problem is None:
            return
        self._check("register: equal cells have equal ids, others not", self._ids)
        self._check("register: each kind of material is taken or unsupported", self._material_kinds)
        self._check("cell: an unknown one is refused, and costs nothing", lambda: self._unknown_cell(problem))
        self._check("evaluate: replies fit the query", lambda: self._evaluations(problem))
        self._check("evaluate: failure is kept, counted and not undone", lambda: self._failures(problem))
        self._check("evaluate: any split of the points gives the same bits", lambda: self._splits(problem))
        self._check("evaluate: absent state is the intact one, tangents only where wanted", lambda: self._bare(problem))
        self._check("properties: a cell of one material has its constants", self._one_material)
        self._check("properties: between temperatures linear, beyond them refused", self._temperatures)
        self._check("properties: stiffness and expansion are those of the stress", lambda: self._elastic(problem))
        self._check("localise: means over the cell are the macroscopic ones", lambda: self._means(problem))
        self._check("id: a repeated request is answered from its reply", lambda: self._repeated(problem))
        self._check("id: an old one is never run again", lambda: self._old_id(problem))
        self._check("id: one that is used for another request is refused", lambda: self._reused_id(problem))
        before = self._check("wrong fields: answers to compare with", lambda: self._two_answers(problem))
        self._each_wrong(problem)
        self._check("wrong fields: none of them changed an answer", lambda: self._as_before(problem, before))
        self._check("control: status while the solver computes, and abort", lambda: self._end_long(problem))
        self._check(
            "state: it is new throughout, and abort changed no answer", lambda: self._as_before(problem, before)
        )
        self._check("size: a message beyond the limit is refused", self._too_large)
        self._check("size: a query without points is answered", lambda: self._no_points(problem))
        self._check("end: the service still answers", self._still_there)

    def _structure(self, cells: str) -> None:
        """Make the checks of a role that asks another service; the kit has that one."""
        assert self._welcome is not None
        if self._welcome.state == "new":
            self._check("state new: what needs a problem is refused", self._nothing_is_set)
        problem = self._check("problem: is set, every reply has its shape", lambda: self._set_laminate(cells))
        if problem is None:
            return
        self._check("advance: increments, loads and strains", lambda: self._increments(problem))
        self._check("fields: each named one is answered", lambda: self._laminate_fields(problem))
        self._check("fields: an unknown name is refused", self._unknown_field_name)
        self._check("cells: are asked, in queries that are counted", lambda: self._asks(problem))
        self._check("force: a ply at an angle is as stiff as it must be", lambda: self._ply_axes(problem))
        self._check("force: is that of the whole plate", lambda: self._symmetries(problem))
        self._check("failure: is counted, kept, and ends with the load", lambda: self._all_fail(problem))
        if Version(*self._welcome.version) >= WATCHED:
            self._check("watched: bricks and their subcells, and the work", lambda: self._watched(problem))
            self._check("mesh: a given one is the made one", lambda: self._given_mesh(problem))
        self._check("problem: is set anew", lambda: self._set(problem))
        self._steps_and_states(problem)
        self._wrong_fields(problem)
        self._check("control: status while it waits for its cells, and abort", lambda: self._abort_in_query(problem))
        self._check("state failed: only configure helps", lambda: self._failed(problem))
        self._check("size: a message beyond the limit is refused", self._too_large)
        self._check("end: the service still answers", self._still_there)


__all__ = ["Check", "check_service"]
