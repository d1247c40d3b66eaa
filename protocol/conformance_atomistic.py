"""A small atomistic problem for the conformance kit, and the checks that only this role has."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from protocol import atomistic as a
from protocol.conformance_coupling import CouplingChecks
from protocol.conformance_kit import NotTried
from protocol.conformance_probe import Refuted, error_report, expect_error, read_reply
from protocol.conformance_problems import STEPS, Problem, Requests, Wrong
from protocol.conformance_solver import REFUSED
from protocol.messages import FieldsReply, FieldsRequest, Message, Welcome
from protocol.version import Version

_ATOMIC_MASS = 1.66053906892e-27  # kg
_ANGSTROM = 1e-10
_SINCE, _COUPLING = Version(1, 2), Version(1, 3)
#: Columns of the arrays of `grid_fields`; without entry there are none.
_GRID_COLUMNS = {"velocity": 3, "displacement": 3, "stress": 6}


def atomistic_configure(welcome: Welcome) -> a.AtomisticConfigure:
    """Return a small sample of the first material in the first force field that the service names.

    Raises
    ------
    ValueError
        Where the capabilities do not name them.
    """
    chosen = {}
    for name in ("force_fields", "materials"):
        values = welcome.capabilities.get(name)
        if not isinstance(values, list) or not values:
            raise ValueError(f"capabilities.{name} must be a list of at least one name, is {values!r}")
        chosen[name] = values[0]
    sizes = [welcome.capabilities.get(f"conformance_sample_{side}", 2e-9) for side in ("width", "height")]
    width, height = (float(size) if isinstance(size, int | float) else 2e-9 for size in sizes)
    return a.AtomisticConfigure(
        force_field=chosen["force_fields"],
        sample=a.Sample(material=chosen["materials"], width=width, height=height),
        temperature=100.0,
        time_step=0.5e-15,
        seed=7,
    )


def atomistic_problem(
    configure: a.AtomisticConfigure, built: a.AtomisticConfigured, thermostats: tuple[str, ...] = ()
) -> Problem:
    """Return the rest of the problem, with the atoms near the sample's border anchored in four IVCs.

    Parameters
    ----------
    configure : AtomisticConfigure
    built : AtomisticConfigured
        The answer to it.
    thermostats : tuple of str
        Words that the service takes for `thermostat`.
    """
    assert configure.sample is not None
    half = np.abs(built.position[:, :2]).max(axis=0)
    scaled = built.position[:, :2] / np.where(half > 0, half, 1.0)
    rows = np.flatnonzero(np.abs(scaled).max(axis=1) > 0.7)
    _, ivc = np.unique(2 * (scaled[rows, 0] > 0) + (scaled[rows, 1] > 0), return_inverse=True)
    ivc = ivc.reshape(-1).astype(np.int64)
    register = a.AtomisticRegister(
        atom_id=built.atom_id[rows],
        anchor_position=built.position[rows],
        anchor_ivc=ivc,
        stiffness=np.full(len(rows), 30.0),
        damping_time=1e-13,
    )
    equilibrate = a.EquilibrateRequest(steps=20, windows=8, window_steps=STEPS)

    def advance(number: int) -> a.AtomisticAdvance:
        shift = np.array([1e-13, -0.5e-13, 0.0])
        return a.AtomisticAdvance(
            steps=STEPS,
            anchor_position=register.anchor_position + (number + 1) * shift,
            anchor_velocity=np.broadcast_to(shift / (STEPS * configure.time_step), (len(rows), 3)).copy(),
        )

    crack = a.CrackCut(tip_x=0.0, y=0.0)
    whole_sample = configure.sample.model_copy(update={"lattice_constant": 1.5e-10, "crack": crack})
    # What 1.2 brought stands in requests of its own, so that services of an older minor get the others.
    newer_sample = whole_sample.model_copy(update={"layers": 2, "orientation": "armchair"})
    file = a.SampleFile(periodic_z=False, crack=crack)
    from_file = {"sample": None, "sample_file": file, "sample_data": data_file(built)}
    commands = a.ForceFieldCommands(unit_style="metal", atom_style="atomic", commands=["pair_style zero 5.0"])
    kinds = np.zeros(len(rows), dtype=np.int64)
    kinds[0] = a.PASSIVE
    newer_register = register.model_copy(update={"anchor_kind": kinds, "motion": "linear"})
    ensemble = a.Ensemble(thermostat="langevin", damping_time=1e-13, pressure=0.0, pressure_time=1e-12)
    newer_equilibrate = equilibrate.model_copy(update={"ensemble": ensemble, "settle": True})
    newer_advance = advance(0).model_copy(update={"until_error": 1e-12, "most_windows": 2})
    properties = a.PropertiesRequest(
        force_field=configure.force_field, material=configure.sample.material, temperature=0.0, seed=1
    )
    return Problem(
        steps=[("configure", configure), ("register", register), ("equilibrate", equilibrate)],
        advance=advance,
        whole=[
            ("properties", properties),
            ("configure", configure.model_copy(update={"sample": whole_sample})),
            ("configure", configure.model_copy(update={"sample": newer_sample, "commands": commands})),
            ("configure", configure.model_copy(update=from_file)),
            ("register", register),
            ("register", newer_register),
            ("equilibrate", equilibrate),
            ("equilibrate", newer_equilibrate),
            ("advance", advance(0)),
            ("advance", newer_advance),
        ],
        wrong=_wrong(configure, register, equilibrate, from_file),
        long=("equilibrate", equilibrate.model_copy(update={"steps": 1_000_000})),
        sizes={"atoms": len(built.atom_id), "anchors": len(rows), "ivcs": int(ivc.max()) + 1},
        kinds=_kinds(configure, register, equilibrate, advance, thermostats),
    )


def _wrong(
    configure: a.AtomisticConfigure,
    register: a.AtomisticRegister,
    equilibrate: a.EquilibrateRequest,
    from_file: dict[str, Any],
) -> list[Wrong]:
    assert configure.sample is not None
    twice, unknown = register.atom_id.copy(), register.atom_id.copy()
    twice[1] = twice[0]
    unknown[0] = register.atom_id.max() + 1_000_000
    stiffness = register.stiffness.copy()
    stiffness[0] = -1.0
    kinds = np.zeros(len(twice), dtype=np.int64)
    other_material = configure.sample.model_copy(update={"material": "no such material"})
    letters = np.frombuffer(b"LAMMPS data file\n\nno atoms\n", np.uint8)

    def configured(**values: object) -> Message:
        return configure.model_copy(update=values)

    def commands(*lines: str) -> Message:
        part = a.ForceFieldCommands(unit_style="metal", atom_style="atomic", commands=list(lines))
        return configured(commands=part)

    return [
        Wrong("unknown force field", "configure", ("force_field",), configured(force_field="no such force field")),
        Wrong("unknown material", "configure", ("sample.material",), configured(sample=other_material)),
        Wrong("neither sample nor file", "configure", ("sample",), configured(sample=None)),
        Wrong("sample and file", "configure", ("sample", "sample_file"),
              configured(**{**from_file, "sample": configure.sample})),
        Wrong("a file without its bytes", "configure", ("sample_data", "sample_file"),
              configured(**{**from_file, "sample_data": None})),
        Wrong("bytes that are no sample", "configure", ("sample_data", "sample_file"),
              configured(**{**from_file, "sample_data": letters})),
        Wrong("a file that the service does not hold", "configure", ("sample_file",),
              configured(sample=None, sample_file=a.SampleFile(name="no such sample"))),
        Wrong("a command of the shell", "configure", ("commands",), commands("shell touch conformance")),
        Wrong("a command with a variable", "configure", ("commands",), commands("pair_style zero $(1+1)")),
        Wrong("a file of another folder", "configure", ("commands",),
              commands("pair_style tersoff", "pair_coeff * * ../secret.tersoff C")),
        Wrong("unknown atom", "register", ("atom_id",), register.model_copy(update={"atom_id": unknown})),
        Wrong("an atom twice", "register", ("atom_id",), register.model_copy(update={"atom_id": twice})),
        Wrong("negative stiffness", "register", ("stiffness",), register.model_copy(update={"stiffness": stiffness})),
        Wrong("negative IVC", "register", ("anchor_ivc",),
              register.model_copy(update={"anchor_ivc": register.anchor_ivc - 1})),
        Wrong("a kind of anchor that is not there", "register", ("anchor_kind",),
              register.model_copy(update={"anchor_kind": kinds + 3})),
        Wrong("nothing to keep", "equilibrate", ("keep_ensemble", "ensemble"),
              equilibrate.model_copy(update={"keep_ensemble": True})),
    ]  # fmt: skip


def _kinds(
    configure: a.AtomisticConfigure,
    register: a.AtomisticRegister,
    equilibrate: a.EquilibrateRequest,
    advance: Callable[[int], a.AtomisticAdvance],
    thermostats: tuple[str, ...],
) -> list[tuple[str, Requests]]:
    """Return sequences of requests, each with one thing that not every service can do."""
    assert configure.sample is not None
    outermost = np.abs(register.anchor_position[:, 0]) > 0.95 * np.abs(register.anchor_position[:, 0]).max()

    def sample(**values: object) -> Requests:
        assert configure.sample is not None
        return [("configure", configure.model_copy(update={"sample": configure.sample.model_copy(update=values)}))]

    def run(
        register: a.AtomisticRegister = register, equilibrate: a.EquilibrateRequest = equilibrate, **last: object
    ) -> Requests:
        begin: Requests = [("configure", configure), ("register", register), ("equilibrate", equilibrate)]
        return [*begin, ("advance", advance(0).model_copy(update=last)), ("advance", advance(1))]

    def held(number: int) -> a.AtomisticRegister:
        return register.model_copy(update={"anchor_kind": np.where(outermost, number, a.SPRING).astype(np.int64)})

    def bath(word: str) -> a.EquilibrateRequest:
        return equilibrate.model_copy(update={"ensemble": a.Ensemble.model_construct(thermostat=word)})

    free = register.model_copy(update={"damping_time": None})
    settling = equilibrate.model_copy(update={"steps": 800, "settle": True})
    return [
        ("two layers", sample(layers=2)),
        ("the armchair direction", sample(orientation="armchair")),
        ("passive atoms", run(held(a.PASSIVE))),
        ("surface atoms", run(held(a.SURFACE))),
        ("anchors that move", run(register.model_copy(update={"motion": "linear"}))),
        *((f"thermostat {word}", run(equilibrate=bath(word))) for word in thermostats),
        *(
            (f"thermostat {word} of the whole run",
             run(free, bath(word).model_copy(update={"keep_ensemble": True})))
            for word in thermostats[:1]
        ),
        ("an equilibration that settles", run(equilibrate=settling)),
        ("windows until the error", run(until_error=1e-12, most_windows=3)),
    ]  # fmt: skip


def data_file(built: a.AtomisticConfigured) -> np.ndarray:
    """Return the sample as the bytes of a LAMMPS data file, atom style atomic, shape (bytes,)."""
    masses, kind = np.unique(built.atom_mass, return_inverse=True)
    position = built.position / _ANGSTROM
    low, high = (position.min(axis=0) - 5.0).tolist(), (position.max(axis=0) + 5.0).tolist()
    lines = [
        "LAMMPS data file of the conformance kit", "",
        f"{len(position)} atoms", f"{len(masses)} atom types",
        *(f"{low[k]!r} {high[k]!r} {axis}lo {axis}hi" for k, axis in enumerate("xyz")),
        "", "Masses", "", *(f"{k + 1} {mass / _ATOMIC_MASS!r}" for k, mass in enumerate(masses.tolist())),
        "", "Atoms # atomic", "",
        *(
            f"{k + 1} {species + 1} {x!r} {y!r} {z!r}"
            for k, (species, (x, y, z)) in enumerate(zip(kind.reshape(-1).tolist(), position.tolist(), strict=True))
        ),
        "",
    ]  # fmt: skip
    return np.frombuffer("\n".join(lines).encode(), np.uint8)


class AtomisticChecks(CouplingChecks):
    """Checks of what only the role `atomistic` has."""

    def _atomistic(self, problem: Problem) -> None:
        assert self._welcome is not None
        if self._welcome.role != "atomistic" or Version(*self._welcome.version) < _SINCE:
            return
        self._check("file: a sample comes back as it was sent", lambda: self._sample_from_file(problem))
        if Version(*self._welcome.version) >= _COUPLING:
            self._check("momentum: is that of the velocities", lambda: self._momentum(problem))
            self._check("keep: atoms outside of a polygon are left out", lambda: self._keep(problem))
        offered = self._welcome.capabilities.get("operations", [])
        for name in (name for name, operation in self._role.operations.items() if operation.optional):
            if isinstance(offered, list) and name in offered:
                self._check(f"{name}: is answered", partial(getattr(self, "_" + name), problem))
            else:
                self._check(f"{name}: is not offered, and refused", partial(self._absent, name))

    def _sample_from_file(self, problem: Problem) -> str:
        configure = problem.request("configure")
        assert isinstance(configure, a.AtomisticConfigure)
        built = self._work.reply("configure", configure, a.AtomisticConfigured)
        changed = {"sample": None, "sample_file": a.SampleFile(), "sample_data": data_file(built)}
        answer = self._work.ask("configure", configure.model_copy(update=changed))
        if answer.kind == "error":
            expect_error(answer, ("unsupported",), ("sample_file", "sample_data"))
            return "unsupported"
        again = read_reply(answer, a.AtomisticConfigured)
        if again.position.shape != built.position.shape or np.abs(again.position - built.position).max() > 1e-16:
            raise Refuted("the atoms of the sample are at other places than in the file")
        if not np.allclose(again.atom_mass, built.atom_mass, rtol=1e-9):
            raise Refuted("the atoms of the sample have other masses than in the file")
        return "taken"

    def _absent(self, name: str) -> str:
        return expect_error(self._work.ask(name, {}), ("unsupported", "unknown_type", "bad_field")).code

    def _prepared(self, problem: Problem) -> Problem:
        """Set the problem anew with collecting on, and make three windows."""
        self._set(problem, collect=True)
        for _ in range(3):
            self._advance(problem)
        return problem

    def _collect_fields(self, problem: Problem) -> str:
        self._prepared(problem)
        names = self._welcome.capabilities["fields"] if self._welcome is not None else []
        if not isinstance(names, list) or "energy" not in names:
            raise NotTried("the service lists no field `energy`")
        mean = self._work.reply("fields", FieldsRequest(names=["energy"]), FieldsReply).fields["energy"]
        self._work.reply("collect_fields", a.CollectRequest(active=False), a.Collecting)
        now = self._work.reply("fields", FieldsRequest(names=["energy"]), FieldsReply).fields["energy"]
        if not np.isfinite(mean).all() or not np.isfinite(now).all():
            raise Refuted("energy is not finite")
        # The same bonds, a few steps apart: a mean over samples, not their sum.
        if abs(mean.sum() - now.sum()) > 0.5 * abs(now.sum()):
            raise Refuted(f"the mean of the energy is {mean.sum():g} J, that of this moment {now.sum():g} J")
        return f"means of {len(mean)} atoms"

    def _grid_fields(self, problem: Problem) -> str:
        assert self._welcome is not None
        self._prepared(problem)
        names = self._welcome.capabilities.get("grid_fields")
        if not isinstance(names, list) or not names:
            raise Refuted(f"capabilities.grid_fields must be a list of at least one name, is {names!r}")
        configure = problem.request("configure")
        assert isinstance(configure, a.AtomisticConfigure) and configure.sample is not None
        spacing = configure.sample.width / 8
        request = a.GridFieldsRequest(
            names=list(names), origin=(-spacing, -spacing, 0.0), spacing=spacing, counts=(3, 2, 1), radius=2 * spacing
        )
        reply = self._work.reply("grid_fields", request, a.GridFields)
        if set(reply.fields) != set(names):
            raise Refuted(f"asked for {sorted(names)}, got {sorted(reply.fields)}")
        for name, array in reply.fields.items():
            wanted = (3, 2, 1, _GRID_COLUMNS[name]) if name in _GRID_COLUMNS else (3, 2, 1)
            if array.shape != wanted or not np.isfinite(array).all():
                raise Refuted(f"{name} has shape {array.shape}, must be finite and have {wanted}")
        if "density" in reply.fields and not (reply.fields["density"] > 0).all():
            raise Refuted("density is not positive inside the sample")
        for field, wrong in (("names", {"names": ["no such field"]}), ("radius", {"radius": 0.0}),
                             ("counts", {"counts": (3, 0, 1)})):  # fmt: skip
            expect_error(self._work.ask("grid_fields", request.model_copy(update=wrong)), REFUSED, (field,))
        return ", ".join(names)

    def _j_integral(self, problem: Problem) -> str:
        configure = problem.request("configure")
        assert isinstance(configure, a.AtomisticConfigure) and configure.sample is not None
        request = a.JIntegralRequest(half_sizes=[configure.sample.width / 4], tip=(0.0, 0.0))
        self._set(problem)
        self._advance(problem)
        expect_error(self._work.ask("j_integral", request), ("wrong_state",))
        self._prepared(problem)
        far = request.model_copy(update={"half_sizes": [100 * configure.sample.width]})
        expect_error(self._work.ask("j_integral", far), REFUSED, ("half_sizes",))
        answer = self._work.ask("j_integral", request)
        if answer.kind == "error":
            # A sample of this size may hold too few atoms for the fit.
            if error_report(answer).code not in REFUSED:
                raise Refuted(f"was answered with {error_report(answer).text()}")
            return "refused for this small sample"
        reply = read_reply(answer, a.JIntegral)
        if reply.contour.shape != (1,) or reply.samples < 1 or (reply.standard_error < 0).any():
            raise Refuted(f"{reply.contour.shape[0]} contours of {reply.samples} samples, must be 1 of at least 1")
        return f"J = {reply.contour[0]:.3g} J/m2 of {reply.samples} samples"


__all__ = ["AtomisticChecks", "atomistic_configure", "atomistic_problem", "data_file"]
