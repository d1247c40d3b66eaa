"""A small cell for the conformance kit, and the checks of the role `micromechanics`, which holds no state."""

from __future__ import annotations

from typing import get_args

import numpy as np
from numpy.typing import NDArray

from protocol import micromechanics as m
from protocol.conformance_probe import Refuted, difference, expect_error, read_reply
from protocol.conformance_problems import Problem, Wrong
from protocol.conformance_solver import REFUSED, SolverChecks
from protocol.frames import Envelope
from protocol.messages import Message

POINTS = 7
#: Points of the query that is to last for seconds; with its arrays it stays below 4 MB.
MANY_POINTS = 60_000
#: Rows and columns of its cell: large enough that no compiled solver is done before it is told to stop.
LONG_SIDE = 40
#: Relative error of what must hold for any method.
CLOSE = 1e-6
STRENGTH = 5e7  # Pa, of the matrix
STRAIN = 0.03  # beyond its limits


def micromechanics_cell() -> m.RegisterCell:
    """Return a cell of two rows and three columns with a strong fibre and a matrix that can fail."""
    return m.RegisterCell(
        heights=np.array([3e-6, 2e-6]),
        widths=np.array([3e-6, 1e-6, 1.5e-6]),
        phase=np.array([[0, 1, 1], [1, 1, 0]]),
        materials=[_material("fibre", 2e11, 0.2, 5e-6), _strong(_material("matrix", 3e9, 0.35, 5e-5))],
        stress_free_temperature=300.0,
        knock_down=1e-3,
    )


def micromechanics_problem(registered: m.CellRegistered) -> Problem:
    """Return queries of that cell, and requests to be made wrong.

    Parameters
    ----------
    registered : CellRegistered
        Reply to `register`.
    """
    cell = micromechanics_cell()
    shapes = np.array([[1, 0, 0, 0, 0, 0], [0, 1, 0, 0, 0, 0], [0, 0, 1, 0, 0, 0], [0, 0, 0, 1, 0, 0],
                       [0, 0, 0, 0, 1, 0], [0, 0, 0, 0, 0, 1], [1, -1, 0.5, 1, 0, -1]], dtype=float)  # fmt: skip
    failed = np.zeros((POINTS, registered.failed_bytes), np.uint8)
    failed[3:, 0] = 2
    history = np.zeros((POINTS, registered.history_values))
    query = m.EvaluateRequest(cell=registered.cell, temperature=310.0, strain=STRAIN * shapes)

    def advance(number: int) -> m.EvaluateRequest:
        return query.model_copy(update={"strain": STRAIN * (1 + 0.1 * number) * shapes})

    whole = query.model_copy(
        update={"failed": failed, "history": history, "element_length": np.full(POINTS, 1e-3), "want_tangent": True}
    )
    fields = m.LocaliseRequest(
        cell=registered.cell, temperature=310.0, strain=1e-4 * shapes, failed=failed, history=history
    )
    properties = m.CellPropertiesRequest(cell=registered.cell, temperature=310.0, failed=failed[3])
    flow = m.MaterialPlasticity(yield_stress=4e7, hardening=1e9)
    matrix = cell.materials[1].model_copy(update={"fracture_energy": 100.0, "plasticity": flow})

    def changed(**values: object) -> m.RegisterCell:
        return cell.model_copy(update=values)

    def material(**values: object) -> m.RegisterCell:
        return changed(materials=[cell.materials[0].model_copy(update=values), cell.materials[1]])

    stiffness = np.reshape(cell.materials[0].stiffness[0], (6, 6))
    skew, unstable = stiffness.copy(), stiffness.copy()
    skew[0, 1] *= 1.1
    unstable[:3, :3] = 2e11 * (3.0 * np.ones((3, 3)) - 2.0 * np.eye(3))
    spare = failed.copy()
    spare[0, -1] |= 0x80  # six subcells leave the two highest bits without meaning
    place = "materials.0"
    wrong = [
        Wrong("a row without height", "register", ("heights",), changed(heights=np.array([3e-6, 0.0]))),
        Wrong("a column of negative width", "register", ("widths",), changed(widths=-cell.widths)),
        Wrong("no rows", "register", ("heights", "phase"), changed(heights=np.zeros(0), phase=cell.phase[:0])),
        Wrong("a material that is not there", "register", ("phase",), changed(phase=cell.phase + 1)),
        Wrong("a negative material", "register", ("phase",), changed(phase=cell.phase - 1)),
        Wrong("a stiffness that is not symmetric", "register", (f"{place}.stiffness",),
              material(stiffness=[skew.reshape(-1).tolist()])),
        Wrong("a stiffness that is not positive definite", "register", (f"{place}.stiffness",),
              material(stiffness=[unstable.reshape(-1).tolist()])),
        Wrong("a stiffness too few", "register", (f"{place}.stiffness", f"{place}.temperatures"),
              material(temperatures=[300.0, 400.0], expansion=2 * cell.materials[0].expansion)),
        Wrong("temperatures that descend", "register", (f"{place}.temperatures",),
              material(temperatures=[400.0, 300.0], stiffness=2 * cell.materials[0].stiffness,
                       expansion=2 * cell.materials[0].expansion)),
        Wrong("a byte of bits too many", "evaluate", ("failed",),
              whole.model_copy(update={"failed": np.hstack([failed, failed])})),
        Wrong("a bit beyond the subcells", "evaluate", ("failed",), whole.model_copy(update={"failed": spare})),
        Wrong("a number of history too many", "evaluate", ("history",),
              whole.model_copy(update={"history": np.hstack([history, np.zeros((POINTS, 1))])})),
        Wrong("a length of zero", "evaluate", ("element_length",),
              whole.model_copy(update={"element_length": np.zeros(POINTS)})),
        Wrong("a byte of bits too many", "localise", ("failed",),
              fields.model_copy(update={"failed": np.hstack([failed, failed])})),
        Wrong("a byte of bits too many", "properties", ("failed",),
              properties.model_copy(update={"failed": np.zeros(registered.failed_bytes + 1, np.uint8)})),
    ]  # fmt: skip
    return Problem(
        steps=[("register", cell)],
        advance=advance,
        whole=[
            ("register", changed(materials=[cell.materials[0], matrix])),
            ("evaluate", whole),
            ("localise", fields),
            ("properties", properties),
        ],
        wrong=wrong,
        long=("evaluate", query),
        sizes={"failed_bytes": registered.failed_bytes, "subcells": 6, "materials": 2},
        operation="evaluate",
    )


def _material(name: str, young: float, poisson: float, expansion: float) -> m.CellMaterial:
    shear, lame = young / (2 + 2 * poisson), young * poisson / ((1 + poisson) * (1 - 2 * poisson))
    stiffness = np.diag([2 * shear] * 3 + [shear] * 3)
    stiffness[:3, :3] += lame
    return m.CellMaterial(
        name=name, temperatures=[300.0], stiffness=[stiffness.reshape(-1).tolist()],
        expansion=[[expansion] * 3 + [0.0] * 3],
    )  # fmt: skip


def _strong(material: m.CellMaterial) -> m.CellMaterial:
    three = (STRENGTH, STRENGTH, STRENGTH)
    failure = m.MaterialFailure(criterion="maximum_stress", tension=three, compression=three, shear=three)
    return material.model_copy(update={"failures": [failure]})


class MicromechanicsChecks(SolverChecks):
    """Checks of the role `micromechanics`."""

    def _register(self) -> Problem:
        cell = micromechanics_cell()
        reply = self._work.reply("register", cell, m.CellRegistered)
        if reply.subcells != cell.phase.size:
            raise Refuted(f"subcells is {reply.subcells}, must be {cell.phase.size}")
        if reply.failed_bytes != -(-reply.subcells // 8):
            raise Refuted(f"failed_bytes is {reply.failed_bytes} for {reply.subcells} subcells")
        areas = np.outer(cell.heights, cell.widths).reshape(-1)
        wanted = np.bincount(cell.phase.reshape(-1), areas / areas.sum(), len(cell.materials))
        _close("material_fraction", reply.material_fraction, wanted.astype(np.float64))
        self._expect_state("new")
        return micromechanics_problem(reply)

    def _ids(self) -> None:
        cell = micromechanics_cell()
        first, again = (self._work.reply("register", cell, m.CellRegistered).cell for _ in range(2))
        if first != again:
            raise Refuted(f"the same cell got the ids {first!r} and {again!r}")
        other = self._work.reply("register", cell.model_copy(update={"knock_down": 1e-2}), m.CellRegistered).cell
        if other == first:
            raise Refuted("a cell with another knock_down got the same id")

    def _material_kinds(self) -> str:
        assert self._welcome is not None
        cell = micromechanics_cell()
        three = (STRENGTH, STRENGTH, STRENGTH)
        tension_alone = m.MaterialFailure(criterion="maximum_stress", tension=(STRENGTH, None, STRENGTH))
        told = self._welcome.capabilities
        taken = []
        kinds: list[tuple[str, str, dict[str, object], dict[str, object]]] = [
            ("", "plasticity", {"plasticity": m.MaterialPlasticity(yield_stress=4e7)}, {}),
            ("", "fracture_energy", {"fracture_energy": 100.0}, {}),
            ("", "limits in part", {"failures": [tension_alone]}, {}),
        ]
        for criterion in get_args(m.MaterialFailure.model_fields["criterion"].annotation):
            failure = m.MaterialFailure(criterion=criterion, tension=three, compression=three, shear=three)
            kinds.append(("criteria", criterion, {"failures": [failure]}, {}))
        for rule in get_args(m.RegisterCell.model_fields["after_failure"].annotation):
            kinds.append(("after_failure", rule, {}, {"after_failure": rule}))
        for capability, word, of_material, of_cell in kinds:
            material = cell.materials[1].model_copy(update=of_material)
            answer = self._work.ask(
                "register", cell.model_copy(update={"materials": [cell.materials[0], material], **of_cell})
            )
            listed = told.get(capability)
            if answer.kind == "error":
                expect_error(answer, REFUSED, ("materials", "after_failure"))
                if isinstance(listed, list) and word in listed:
                    raise Refuted(f"{word} is refused, but capabilities.{capability} lists it")
            else:
                read_reply(answer, m.CellRegistered)
                taken.append(word)
        return ", ".join(taken)

    def _unknown_cell(self, problem: Problem) -> None:
        for operation, request in problem.whole[1:]:
            unknown = request.model_copy(update={"cell": "no-such-cell"})
            report = expect_error(self._work.ask(operation, unknown), ("unknown_cell",), ("cell",))
            if "no-such-cell" not in report.sentence:
                raise Refuted(f"the sentence does not name the cell: {report.sentence}")
        self._register()
        self._evaluated(problem.advance(0))

    def _evaluated(self, request: Message) -> m.Evaluated:
        return self._work.reply("evaluate", request, m.Evaluated)

    def _evaluations(self, problem: Problem) -> None:
        for number in range(3):
            reply = self._evaluated(problem.advance(number))
            self._note_sizes(reply, {**problem.sizes, "points": POINTS})
            if reply.tangent_index is None or reply.tangents is None:
                raise Refuted("the reply has no tangents, which are wanted by default")
            _check_table(reply.tangent_index, reply.tangents)

    def _failures(self, problem: Problem) -> str:
        request = problem.whole[1][1]
        assert isinstance(request, m.EvaluateRequest) and request.failed is not None
        reply = self._evaluated(request)
        if (request.failed & ~reply.failed).any():
            raise Refuted("a subcell that had failed is intact again")
        grown = int(np.unpackbits(reply.failed).sum()) - int(np.unpackbits(request.failed).sum())
        if reply.new_failures != grown:
            raise Refuted(f"new_failures is {reply.new_failures}, the bits grew by {grown}")
        if not grown:
            raise Refuted("nothing failed, though strains go beyond the limits of the matrix")
        if np.unpackbits(reply.failed, bitorder="little", axis=1)[:, 6:].any():
            raise Refuted("failed has bits beyond the subcells")
        again = self._evaluated(request.model_copy(update={"failed": reply.failed, "history": reply.history}))
        if again.new_failures or again.failed.tobytes() != reply.failed.tobytes():
            raise Refuted("the same strain on the new state lets more fail: the cascade did not end in its query")
        return f"{grown} failures"

    def _splits(self, problem: Problem) -> None:
        request = problem.advance(1)
        assert isinstance(request, m.EvaluateRequest)
        whole = self._evaluated(request)
        for at in (1, 4):
            strains = request.strain[:at], request.strain[at:]
            parts = [self._evaluated(request.model_copy(update={"strain": strain})) for strain in strains]
            for name in ("stress", "failed", "history"):
                joined = np.concatenate([getattr(part, name) for part in parts])
                if joined.tobytes() != getattr(whole, name).tobytes():
                    raise Refuted(f"{name} differs when the points are split after {at}")
            tangents = np.concatenate([_tangents(part) for part in parts])
            if tangents.tobytes() != _tangents(whole).tobytes():
                raise Refuted(f"tangents differ when the points are split after {at}")

    def _bare(self, problem: Problem) -> None:
        request = problem.advance(0)
        registered = self._work.reply("register", micromechanics_cell(), m.CellRegistered)
        zeros = {
            "failed": np.zeros((POINTS, registered.failed_bytes), np.uint8),
            "history": np.zeros((POINTS, registered.history_values)),
        }
        first, second = (self._work.ask("evaluate", request.model_copy(update=state)) for state in ({}, zeros))
        if apart := difference(first, second):
            raise Refuted(f"without state and with zeros: {apart}")
        bare = self._evaluated(request.model_copy(update={"want_tangent": False}))
        if bare.tangent_index is not None or bare.tangents is not None:
            raise Refuted("tangents are answered though they are not wanted")

    def _one_material(self) -> None:
        cell = micromechanics_cell()
        for number, material in enumerate(cell.materials):
            found = self._properties(cell.model_copy(update={"phase": np.full((2, 3), number, np.int64)}), 300.0)
            _close("stiffness", found.stiffness, np.reshape(material.stiffness[0], (6, 6)))
            _close("expansion", found.expansion, np.array(material.expansion[0]))

    def _temperatures(self) -> None:
        cell = micromechanics_cell()
        cold, warm = (np.array(material.stiffness[0]) for material in cell.materials)
        table = cell.materials[0].model_copy(
            update={
                "temperatures": [300.0, 400.0],
                "stiffness": [cold.tolist(), warm.tolist()],
                "expansion": [[5e-6] * 3 + [0.0] * 3, [9e-6] * 3 + [0.0] * 3],
            }
        )
        one = cell.model_copy(update={"phase": np.zeros((2, 3), np.int64), "materials": [table]})
        found = self._properties(one, 325.0)
        _close("stiffness at a quarter", found.stiffness, (0.75 * cold + 0.25 * warm).reshape(6, 6))
        _close("expansion at a quarter", found.expansion, np.array([6e-6] * 3 + [0.0] * 3))
        name = self._work.reply("register", one, m.CellRegistered).cell
        beyond = m.CellPropertiesRequest(cell=name, temperature=500.0)
        expect_error(self._work.ask("properties", beyond), REFUSED, ("temperature",))
        query = m.EvaluateRequest(cell=name, temperature=200.0, strain=np.zeros((1, 6)))
        expect_error(self._work.ask("evaluate", query), REFUSED, ("temperature",))

    def _properties(self, cell: m.RegisterCell, temperature: float) -> m.CellProperties:
        name = self._work.reply("register", cell, m.CellRegistered).cell
        request = m.CellPropertiesRequest(cell=name, temperature=temperature)
        return self._work.reply("properties", request, m.CellProperties)

    def _elastic(self, problem: Problem) -> None:
        request = problem.advance(0)
        assert isinstance(request, m.EvaluateRequest)
        small = request.model_copy(update={"strain": 1e-3 * request.strain})
        reply = self._evaluated(small)
        if reply.new_failures:
            raise Refuted("subcells fail under a strain of 3e-5 and a change of 10 K")
        found = self._properties(micromechanics_cell(), request.temperature)
        change = request.temperature - micromechanics_cell().stress_free_temperature
        _close("stress", reply.stress, (small.strain - found.expansion * change) @ found.stiffness.T)
        wanted = np.broadcast_to(found.stiffness, (POINTS, 6, 6))
        _close("tangent", _tangents(reply), wanted)

    def _means(self, problem: Problem) -> None:
        cell, request = micromechanics_cell(), problem.whole[2][1]
        assert isinstance(request, m.LocaliseRequest)
        reply = self._work.reply("localise", request, m.Localised)
        self._note_sizes(reply, {**problem.sizes, "points": POINTS})
        areas = np.outer(cell.heights, cell.widths).reshape(-1)
        _close("mean strain", np.einsum("n,pni->pi", areas / areas.sum(), reply.strain), request.strain)
        plain = m.EvaluateRequest(**{name: getattr(request, name) for name in m.LocaliseRequest.model_fields})
        whole = self._evaluated(plain)
        if whole.new_failures:
            raise Refuted("subcells fail under a strain of 1e-4 and a change of 10 K")
        _close("mean stress", np.einsum("n,pni->pi", areas / areas.sum(), reply.stress), whole.stress)

    def _two_answers(self, problem: Problem) -> list[Envelope]:
        return [self._work.ask("evaluate", problem.advance(number)) for number in (0, 2)]

    def _as_before(self, problem: Problem, before: list[Envelope] | None) -> None:
        self._register()
        self._same(before or [], self._two_answers(problem), "from what it was")
        self._expect_state("new")

    def _end_long(self, problem: Problem) -> str:
        chance = np.random.default_rng(7)
        matrix = micromechanics_cell().materials[1]
        large = micromechanics_cell().model_copy(
            update={
                "heights": chance.uniform(1e-6, 2e-6, LONG_SIDE),
                "widths": chance.uniform(1e-6, 2e-6, LONG_SIDE),
                "phase": chance.integers(0, 2, (LONG_SIDE, LONG_SIDE)),
                "materials": [micromechanics_cell().materials[0], matrix],
            }
        )
        registered = self._work.reply("register", large, m.CellRegistered)
        query = m.EvaluateRequest(
            cell=registered.cell, temperature=300.0, strain=chance.uniform(-0.02, 0.02, (MANY_POINTS, 6))
        )
        return self._status_and_abort(
            Problem(problem.steps, problem.advance, [], [], ("evaluate", query), dict(problem.sizes))
        )

    def _no_points(self, problem: Problem) -> None:
        for operation, request in problem.whole[1:3]:
            arrays = {name: array[:0] for name, array in request.array_values().items()}
            reply = self._work.reply(
                operation, request.model_copy(update=arrays), self._role.operations[operation].reply
            )
            self._note_sizes(reply, {**problem.sizes, "points": 0})


def _tangents(reply: m.Evaluated) -> NDArray[np.float64]:
    """Return the tangent of each point, shape (points, 6, 6)."""
    if reply.tangent_index is None or reply.tangents is None:
        raise Refuted("the reply has no tangents, which are wanted by default")
    _check_table(reply.tangent_index, reply.tangents)
    return np.asarray(reply.tangents[reply.tangent_index])


def _check_table(index: NDArray[np.int64], tangents: NDArray[np.float64]) -> None:
    if len(index) and (index.min() < 0 or index.max() >= len(tangents)):
        raise Refuted(f"tangent_index holds {index.min()} to {index.max()}, there are {len(tangents)} tangents")
    used, first = np.unique(index, return_index=True)
    if len(used) != len(tangents) or (np.diff(first) <= 0).any():
        raise Refuted("tangents are not those that the points use, in the order in which they first use them")
    if len({tangent.tobytes() for tangent in tangents}) != len(tangents):
        raise Refuted("the same tangent stands twice in the table")


def _close(name: str, found: NDArray[np.float64], wanted: NDArray[np.float64]) -> None:
    error = float(np.abs(found - wanted).max(initial=0.0))
    if error > CLOSE * float(np.abs(wanted).max(initial=0.0)):
        raise Refuted(f"{name} is off by {error:g}, the largest of what it must be is {np.abs(wanted).max():g}")
