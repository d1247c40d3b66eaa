"""A small laminate for the conformance kit, and the checks of the role `structure`."""

from __future__ import annotations

import dataclasses
from contextlib import ExitStack

import numpy as np

from protocol import micromechanics as m
from protocol import structure as s
from protocol.arrays import FloatArray, IntArray
from protocol.conformance_cells import OneMaterialCells
from protocol.conformance_probe import Refuted, expect_error
from protocol.conformance_problems import Problem, Wrong
from protocol.conformance_solver import REFUSED, SolverChecks
from protocol.frames import Envelope
from protocol.messages import FieldsReply, FieldsRequest
from protocol.server import running
from protocol.version import Version

#: Relative error of forces that have a closed form.
CLOSE = 1e-6
LIMIT = 0.01  # strain along the fibre at which the cell fails
FINAL = 0.02
KNOCK_DOWN = 1e-2
#: Version that brought watched bricks and meshes that are given.
WATCHED = Version(1, 5)
#: What may differ between two runs that are the same: how long they took.
RUNNING = ("seconds", "factorisations")


def structure_cell() -> m.RegisterCell:
    """Return a cell of one subcell, stiff along the fibre, that fails at a strain along it."""
    compliance = np.diag([1 / 1e11, 1 / 1e10, 1 / 1e10, 1 / 3e9, 1 / 5e9, 1 / 5e9])
    compliance[0, 1:3] = compliance[1:3, 0] = -0.3 / 1e11
    compliance[1, 2] = compliance[2, 1] = -0.4 / 1e10
    stiffness = np.linalg.inv(compliance)
    material = m.CellMaterial(
        name="ply",
        temperatures=[300.0],
        stiffness=[(0.5 * (stiffness + stiffness.T)).reshape(-1).tolist()],
        expansion=[[0.0] * 6],
        failures=[m.MaterialFailure(criterion="maximum_strain", tension=(LIMIT, None, None))],
    )
    return m.RegisterCell(
        heights=np.ones(1), widths=np.ones(1), phase=np.zeros((1, 1), np.int64), materials=[material],
        stress_free_temperature=300.0, knock_down=KNOCK_DOWN,
    )  # fmt: skip


def structure_problem(micromechanics: str) -> Problem:
    """Return a quarter of a cross-ply plate with a hole, and requests to be made wrong.

    Parameters
    ----------
    micromechanics : str
        Endpoint of the service that has the cells.
    """
    cell = structure_cell()
    configure = s.StructureConfigure(
        **{name: getattr(cell, name) for name in m.RegisterCell.model_fields},
        length=8e-3,
        width=8e-3,
        hole_diameter=3e-3,
        angles=[0.0, np.pi / 2],
        ply_thickness=2.5e-4,
        quarter=True,
        lower_half=True,
        mesh=s.PlateMesh(around=2, radial=2),
        temperature=300.0,
        final_strain=FINAL,
        increments=s.Increments(first=0.004, least=1e-5, most=0.004, tolerance=1e-9),
        micromechanics=micromechanics,
    )
    cohesive = s.CohesiveConstants(
        stiffness=1e14, normal_strength=6e7, shear_strength=8e7, opening_toughness=200.0, sliding_toughness=600.0
    )

    def advance(number: int) -> s.StructureAdvance:
        return s.StructureAdvance(largest=0.004 - 0.0005 * (number % 2))

    def changed(**values: object) -> s.StructureConfigure:
        return configure.model_copy(update=values)

    plate = s.PlateMesh(columns=2, rows=1)
    nodes, elements = _two_squares()
    given = {"plane_nodes": nodes, "plane_elements": elements}
    by_energy = configure.increments.model_copy(update={"dissipation": 1e-3})
    viscous = configure.increments.model_copy(update={"viscosity": 1e-4})
    both = s.Increments.model_construct(**{**dict(by_energy), "viscosity": 1e-4})
    wrong_order = s.Increments.model_construct(first=0.5, least=1e-5, most=0.1, iterations=100, tolerance=1e-6)
    wrong = [
        Wrong("no count around the hole", "configure", ("mesh.around", "mesh"), changed(mesh=s.PlateMesh(radial=2))),
        Wrong("an odd count around the hole", "configure", ("mesh.around", "mesh"),
              changed(mesh=s.PlateMesh(around=3, radial=2))),
        Wrong("no columns without a hole", "configure", ("mesh.columns", "mesh"), changed(hole_diameter=None)),
        Wrong("a hole wider than the plate", "configure", ("hole_diameter", "mesh"), changed(hole_diameter=9e-3)),
        Wrong("a quarter of plies without its symmetry", "configure", ("quarter", "angles"),
              changed(angles=[0.0, 0.5])),
        Wrong("a first increment above the largest", "configure", ("increments.first", "increments.most"),
              changed(increments=wrong_order)),
        Wrong("an element turned inside out", "configure", ("plane_elements", "plane_nodes", "mesh"),
              changed(plane_nodes=nodes, plane_elements=elements[:, [0, 2, 1, 3]].copy())),
        Wrong("nodes without elements", "configure", ("plane_elements",), changed(plane_nodes=nodes)),
        Wrong("a mesh that does not reach the end", "configure", ("plane_nodes", "plane_elements", "mesh"),
              changed(plane_nodes=0.9 * nodes, plane_elements=elements)),
        Wrong("a hole and notches", "configure", ("notch_diameter", "hole_diameter"), changed(notch_diameter=1e-3)),
        Wrong("two ways to control the increments", "configure", ("increments.dissipation", "increments.viscosity"),
              changed(increments=both)),
        Wrong("the energy of what fails at once", "configure", ("increments.dissipation", "materials", "damage"),
              changed(increments=by_energy)),
        Wrong("a brick that is not there", "advance", ("watched",), s.StructureAdvance(watched=[1000])),
        Wrong("no endpoint", "configure", ("micromechanics",), changed(micromechanics="nowhere")),
        Wrong("no fields", "fields", ("names",), FieldsRequest.model_construct(names=[])),
    ]  # fmt: skip
    whole = changed(
        cohesive=cohesive,
        mesh=s.PlateMesh(around=2, radial=2, growth=2.0, beyond=0, columns=2, rows=1, bricks_per_ply=2,
                         mean_dilatation=True),
    )  # fmt: skip
    return Problem(
        steps=[("configure", configure)],
        advance=advance,
        whole=[
            ("configure", whole),
            ("advance", advance(0)),
            ("configure", whole.model_copy(update={**given, "increments": viscous})),
            ("configure", changed(notch_diameter=3e-3, hole_diameter=None, increments=by_energy, damage="none")),
            ("advance", s.StructureAdvance(largest=0.004, watched=[0, 1])),
        ],
        wrong=wrong,
        long=("advance", advance(0)),
        sizes={},
        kinds=[
            ("cohesive layers", [("configure", changed(cohesive=cohesive)), ("advance", advance(0))]),
            ("a mean dilatation", [("configure", changed(mesh=configure.mesh.model_copy(
                update={"mean_dilatation": True}))), ("advance", advance(0))]),
            ("one ply", [("configure", changed(angles=[0.0], lower_half=False)), ("advance", advance(0))]),
            ("a whole plate", [("configure", changed(quarter=False, lower_half=False)), ("advance", advance(0))]),
            ("no hole", [("configure", changed(hole_diameter=None, mesh=plate)), ("advance", advance(0))]),
            ("notches", [("configure", changed(hole_diameter=None, notch_diameter=3e-3)), ("advance", advance(0))]),
            ("viscosity", [("configure", changed(cohesive=cohesive, increments=viscous)), ("advance", advance(0))]),
            ("increments by energy", [("configure", changed(increments=by_energy, damage="none")),
                                      ("advance", advance(0))]),
        ],
    )  # fmt: skip


class StructureChecks(SolverChecks):
    """Checks of the role `structure`. The kit itself serves the cells that the laminate asks."""

    _cells: OneMaterialCells

    def _serve_cells(self, stack: ExitStack) -> str:
        """Serve the cells until the stack ends; return their endpoint."""
        self._cells = OneMaterialCells()
        return stack.enter_context(running(self._cells, "tcp://127.0.0.1:*")).endpoint

    def _set_laminate(self, endpoint: str) -> Problem:
        problem = structure_problem(endpoint)
        self._set(problem, self._check_allowed)
        built = self._configured(problem)
        if built.bricks.min() < 0 or built.bricks.max() >= len(built.nodes):
            raise Refuted(f"bricks holds {built.bricks.min()} to {built.bricks.max()} of {len(built.nodes)} nodes")
        if set(built.ply.tolist()) != {0, 1}:
            raise Refuted(f"ply holds {sorted(set(built.ply.tolist()))}, must hold 0 and 1")
        self._near("section", built.section, 8e-3 * 4 * 2.5e-4)
        return problem

    def _configured(self, problem: Problem, **changes: object) -> s.StructureConfigured:
        request = problem.request("configure").model_copy(update=changes)
        return self._work.reply("configure", request, s.StructureConfigured)

    def _increments(self, problem: Problem) -> None:
        """Steps, loads and strains of a few increments."""
        before, load = self._status().step, 0.0
        for number in range(3):
            request = problem.advance(number)
            assert isinstance(request, s.StructureAdvance)
            made = self._work.reply("advance", request, s.StructureAdvanced)
            self._exchanges = number + 1
            self._note_sizes(made, problem.sizes)
            if made.step != before + number + 1 or self._status().step != made.step:
                raise Refuted(f"the step is {made.step} after {before} and {number + 1} increments")
            if not load < made.load <= load + request.largest * (1 + 1e-9):
                raise Refuted(f"the load went from {load:g} to {made.load:g}, at most {request.largest:g} were asked")
            load = made.load
            self._near("strain", made.strain, load * FINAL)
            if made.residual > 1e-9:
                raise Refuted(f"the residual is {made.residual:g}, the tolerance 1e-9")
            if made.new_failures.any():
                raise Refuted(f"subcells fail at a strain of {made.strain:g}")

    def _laminate_fields(self, problem: Problem) -> None:
        assert self._welcome is not None
        built = self._configured(problem)
        self._work.reply("advance", problem.advance(0), s.StructureAdvanced)
        names = self._welcome.capabilities["fields"]
        assert isinstance(names, list)
        shapes = {
            "displacement": built.nodes.shape,
            "stress": (len(built.bricks), 6),
            "failed": (len(built.bricks), 1),
            "layer_damage": (len(built.layers),),
        }
        if not shapes.keys() <= set(names):
            raise Refuted(f"capabilities.fields lists {names}, must have {', '.join(shapes)}")
        for name in names:
            found = self._work.reply("fields", FieldsRequest(names=[name]), FieldsReply).fields
            if set(found) != {name}:
                raise Refuted(f"asked for {name}, got {sorted(found)}")
            if name in shapes and found[name].shape != shapes[name]:
                raise Refuted(f"field {name} has shape {found[name].shape}, must have {shapes[name]}")

    def _ply_axes(self, problem: Problem) -> None:
        """A plate of one ply at any angle has the stiffness that its turned compliance tells."""
        compliance = np.linalg.inv(np.reshape(structure_cell().materials[0].stiffness[0], (6, 6)))
        for degrees in (0.0, 30.0, 90.0):
            c2, s2 = np.cos(np.radians(degrees)) ** 2, np.sin(np.radians(degrees)) ** 2
            soft = c2**2 * compliance[0, 0] + s2**2 * compliance[1, 1]
            soft += c2 * s2 * (2.0 * compliance[0, 1] + compliance[5, 5])
            built = self._configured(problem, **_plain(), angles=[np.radians(degrees)])
            made = self._work.reply("advance", problem.advance(0), s.StructureAdvanced)
            self._near(f"force at {degrees:g} degrees", made.force, built.section * made.strain / soft)

    def _symmetries(self, problem: Problem) -> None:
        """The force is that of the whole plate, whichever part is modelled."""
        cross = [0.0, np.pi / 2]
        forces = []
        for quarter in (False, True):
            for half in (False, True):
                angles = cross if half else [*cross, *cross[::-1]]
                built = self._configured(problem, quarter=quarter, lower_half=half, angles=angles)
                self._near("section", built.section, 8e-3 * 4 * 2.5e-4)
                forces.append(self._work.reply("advance", problem.advance(0), s.StructureAdvanced).force)
        for force in forces[1:]:
            self._near("force of a part", force, forces[0])

    def _all_fail(self, problem: Problem) -> str:
        """A plate that fails everywhere at once: counted, kept, and with the stiffness that is left."""
        steps = s.Increments(first=0.4, least=0.01, most=0.4, tolerance=1e-9)
        built = self._configured(problem, **_plain(), angles=[0.0], increments=steps)
        first = self._work.reply("advance", s.StructureAdvance(), s.StructureAdvanced)
        second = self._work.reply("advance", s.StructureAdvance(), s.StructureAdvanced)
        if first.new_failures.any() or second.new_failures.tolist() != [[built.points]]:
            raise Refuted(
                f"new_failures is {first.new_failures.tolist()} and {second.new_failures.tolist()}, must be [[0]] at a "
                f"strain of {first.strain:g} and [[{built.points}]] at {second.strain:g}"
            )
        self._near("force after failure", second.force, KNOCK_DOWN * first.force * second.strain / first.strain)
        failed = self._work.reply("fields", FieldsRequest(names=["failed"]), FieldsReply).fields["failed"]
        if not np.array_equal(failed, np.ones((len(built.bricks), 1))):
            raise Refuted("the field failed is not 1 everywhere")
        saved = self._checkpoint()
        self._configured(problem, **_plain(), angles=[0.0], increments=steps)
        self._restore(saved)
        last = self._work.reply("advance", s.StructureAdvance(), s.StructureAdvanced)
        if last.new_failures.any():
            raise Refuted(f"after a checkpoint new_failures is {last.new_failures.tolist()}, although all have failed")
        if last.load != 1.0:
            raise Refuted(f"the last load is {last.load!r}, must be 1")
        expect_error(self._work.ask("advance", s.StructureAdvance()), REFUSED)
        self._expect_state("ready")
        self._configured(problem, **_plain(), angles=[0.0], increments=steps, damage="none")
        for _ in range(2):
            made = self._work.reply("advance", s.StructureAdvance(), s.StructureAdvanced)
        if made.new_failures.any():
            raise Refuted("subcells fail although damage is none")
        return f"{built.points} points"

    def _watched(self, problem: Problem) -> str:
        """Bricks of a ply along the pull, before and after all has failed."""
        steps = s.Increments(first=0.4, least=0.01, most=0.4, tolerance=1e-9)
        built = self._configured(problem, **_plain(), angles=[0.0], increments=steps)
        bricks = list(range(len(built.bricks)))[::-1]
        for _ in range(2):
            made = self._work.reply("advance", s.StructureAdvance(watched=bricks), s.StructureAdvanced)
            strain, stress, subcells = made.watched_strain, made.watched_stress, made.watched_subcells
            if strain is None or stress is None or subcells is None:
                raise Refuted(
                    "watched_strain, watched_stress or watched_subcells is absent although bricks are watched"
                )
            if strain.shape != (len(bricks), 6) or subcells.shape != (len(bricks), 1, 6):
                raise Refuted(f"watched_strain and _subcells have shapes {strain.shape} and {subcells.shape}")
            for row in range(len(bricks)):
                self._near("watched_strain", strain[row, 0], made.strain)
                self._near("watched_stress", stress[row, 0], made.force / built.section)
            if not np.allclose(subcells[:, 0], stress, rtol=0.0, atol=CLOSE * np.abs(stress).max()):
                raise Refuted("watched_subcells of a cell of one subcell are not watched_stress")
            if not made.new_failures.any():
                self._near("work", made.work, 0.5 * made.force * made.strain * 8e-3)
        plain = self._work.reply("advance", s.StructureAdvance(largest=0.01), s.StructureAdvanced)
        if plain.watched_strain is not None or plain.watched_subcells is not None:
            raise Refuted("watched_strain or watched_subcells is there although nothing is watched")
        return f"{len(bricks)} bricks"

    def _given_mesh(self, problem: Problem) -> None:
        nodes, elements = _two_squares()
        forces = []
        for changes in ({}, {"plane_nodes": nodes, "plane_elements": elements, "mesh": s.PlateMesh()}):
            plain = {"hole_diameter": None, "mesh": s.PlateMesh(columns=2, rows=1), **changes}
            self._configured(problem, **plain)
            forces.append(self._work.reply("advance", problem.advance(0), s.StructureAdvanced).force)
        self._near("force on a given mesh", forces[1], forces[0])

    def _asks(self, problem: Problem) -> str:
        """The cells are asked over the wire: points that are counted as queried were."""
        built = self._configured(problem)
        before = self._cells.queries
        made = self._work.reply("advance", problem.advance(0), s.StructureAdvanced)
        if made.queried < built.points or self._cells.queries == before:
            raise Refuted(f"{made.queried} points were queried in {self._cells.queries - before} queries")
        if made.spared:
            raise Refuted(f"{made.spared} points were spared although no energy is safe")
        return f"{made.queried} points"

    def _abort_in_query(self, problem: Problem) -> str:
        """Status and abort while the laminate waits for its microstructure."""
        self._cells.slow = True
        try:
            return self._status_and_abort(problem)
        finally:
            self._cells.slow = False

    def _same(self, first: list[Envelope], second: list[Envelope], when: str) -> None:
        if self._role.name == "structure":
            first, second = [_timeless(one) for one in first], [_timeless(one) for one in second]
        super()._same(first, second, when)

    def _near(self, name: str, found: float, wanted: float) -> None:
        if not abs(found - wanted) <= CLOSE * abs(wanted):
            raise Refuted(f"{name} is {found:.10g}, must be {wanted:.10g}")


def _two_squares() -> tuple[FloatArray, IntArray]:
    """Nodes and elements of two rectangles on the quarter of the problem's plate."""
    x, y = np.meshgrid([0.0, 2e-3, 4e-3], [0.0, 4e-3])
    elements = np.array([[0, 1, 4, 3], [1, 2, 5, 4]], dtype=np.int64)
    return np.stack([x.ravel(), y.ravel()], axis=-1), elements


def _plain() -> dict[str, object]:
    """Changes that make the problem's plate a whole one without a hole."""
    return {"hole_diameter": None, "mesh": s.PlateMesh(columns=2, rows=1), "quarter": False, "lower_half": False}


def _timeless(answer: Envelope) -> Envelope:
    return dataclasses.replace(answer, body={name: value for name, value in answer.body.items() if name not in RUNNING})
