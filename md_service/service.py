"""The role `atomistic` on any engine: messages in, engine calls out. The only file that sees both."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from md_service.atoms import Atoms, CrackCut
from md_service.engine import Engine
from md_service.engines import LAMMPS, EngineFactory, LammpsFactory
from md_service.ensembles import Ensemble
from md_service.errors import EngineError
from md_service.field_means import FIELD_NAMES
from md_service.force_fields import ForceField, custom_force_field
from md_service.grid_fields import GRID_FIELDS, NEEDED, grid_fields
from md_service.j_record import J_FIELDS, JRecord
from md_service.kept_atoms import kept_atoms
from md_service.parallel import ParallelEngine, follow
from md_service.ranks import MpiRanks
from md_service.sample_source import FLAT, build_sample, sample_from_bytes, shipped_samples
from protocol import atomistic as messages
from protocol.errors import ProtocolError
from protocol.messages import CheckpointReply, Empty, FieldsReply, FieldsRequest, Point2, Restored, RestoreRequest
from protocol.service import Capabilities, Service
from protocol.version import package_version

#: Beyond it a seed is no longer exact as a double, in which states travel.
LARGEST_SEED: Final = 2**53
#: Names of arguments as the messages have them, where they differ, by operation.
FIELD_OF: Final[dict[str, dict[str, str]]] = {
    "configure": {
        "material": "sample.material", "width": "sample.width", "height": "sample.height", "spacing":
        "sample.lattice_constant", "layers": "sample.layers", "orientation": "sample.orientation",
        "crack": "sample.crack", "crack.tip_x": "sample.crack.tip_x", "crack.y": "sample.crack.y",
    },
    "register": {"position": "anchor_position", "ivc": "anchor_ivc", "kind": "anchor_kind"},
    "equilibrate": {
        "window": "window_steps", "damping_time": "ensemble.damping_time", "pressure": "ensemble.pressure",
    },
    "advance": {"window": "steps"},
    "j_integral": {"half_size": "half_sizes", "contour": "half_sizes", "domain": "half_sizes", "tip_x": "tip"},
}  # fmt: skip
_COMPONENTS: Final = ("xx", "yy", "zz", "xy", "xz", "yz")
_COUNTERS: Final = "engine_counters"  # array of a state whose first entry is the step
_J: Final = "j_"  # before the names of the service's own arrays in a state
_COLLECTED: Final = "engine_collected_samples"  # number of samples, and whether fields are collected


AnyEngine = Engine | ParallelEngine


class AtomisticService(Service):
    """One engine at a time.

    Parameters
    ----------
    folder : Path
        For files of the engine.
    factory : EngineFactory
        The code behind the role.
    ranks : MpiRanks, optional
        All ranks, where there is more than one; this process is rank 0. Of LAMMPS only.
    """

    role = "atomistic"
    backend_version = package_version()

    def __init__(self, folder: Path, factory: EngineFactory = LAMMPS, ranks: MpiRanks | None = None) -> None:
        super().__init__()
        self.backend = factory.backend  # type: ignore[misc]  # one class for all engines
        self._folder = folder
        self._factory = factory
        self._ranks = ranks
        self._engine: AnyEngine | None = None
        self._dimension = 3
        self._temperature = 0.0
        self._damped = False
        self._collecting = False
        self._advanced = False  # whether windows were collected since the means began
        self._own_profile: ForceField | None = None
        self._j: JRecord | None = None

    def capabilities(self) -> Capabilities:
        """Return what this engine can do."""
        names = self._factory.force_fields()
        # Flat ones first: the first of the list stands for a small sample that is quick to try.
        materials = [
            material
            for name in names
            for material in sorted(self._factory.materials(name), key=lambda material: material not in FLAT)
        ]
        return {
            "force_fields": names,
            "materials": list(dict.fromkeys(materials)),
            "fields": list(FIELD_NAMES),
            "grid_fields": list(GRID_FIELDS),
            "samples": list(shipped_samples()),
            "operations": ["collect_fields", "grid_fields", "j_integral", "displace"]
            + (["cut"] if self._factory.severs else []),
            "ensembles": list(self._factory.ensembles),
            # Words of LAMMPS are for LAMMPS only.
            "commands": isinstance(self._factory, LammpsFactory),
            "ranks": 1 if self._ranks is None else self._ranks.size,
        }

    @property
    def step(self) -> int:
        """MD steps since configure."""
        return 0 if self._engine is None else self._engine.step

    # Before the run -------------------------------------------------------------------------------------------

    def properties(self, request: messages.PropertiesRequest) -> messages.Properties:
        """Measure lattice constant, E, nu and density of a material at a temperature."""
        self._check_force_field(request.force_field)
        if request.material not in self._factory.materials(request.force_field):
            raise self._no_material("material", request.force_field, request.material)
        measured = self._call(
            "properties", self._factory.properties, self._folder, request.force_field, request.material,
            request.temperature, request.seed, self.activity.progress,
        )  # fmt: skip
        values = {name: getattr(measured, name) for name in messages.Properties.model_fields}
        if not np.isfinite(values["thickness"]):
            # Of a crystal that repeats along z: the edge of its cube, one layer of a sample.
            values["thickness"] = 2.0**0.5 * measured.lattice_constant
        return messages.Properties(**values)

    def configure(self, request: messages.AtomisticConfigure) -> messages.AtomisticConfigured:
        """Build the sample and the engine; a request that is refused leaves the old ones as they are."""
        if request.seed > LARGEST_SEED:
            raise ProtocolError("bad_field", f"seed {request.seed} is above {LARGEST_SEED}", field="seed")
        profile = self._profile(request)
        atoms = self._sample(request)
        if request.keep:
            atoms = self._call("configure", kept_atoms, atoms, request.keep)
        if profile is not None and profile.elements and not set(atoms.elements) <= set(profile.elements):
            missing = ", ".join(sorted(set(atoms.elements) - set(profile.elements)))
            sentence = f"force field {profile.name} knows {', '.join(profile.elements)}; the sample has {missing}"
            raise ProtocolError("bad_field", sentence, field="force_field")
        engine = self._call("configure", self._make, request, profile, atoms)
        if engine is not self._engine:
            self.close()
        self._engine = engine
        self._temperature, self._collecting, self._damped = request.temperature, False, False
        self._own_profile = profile
        self._j = JRecord(atoms, profile, request.temperature)
        trap = profile.cutoff_trap if profile is not None and atoms.crack is not None else ""
        return messages.AtomisticConfigured(
            atom_id=np.arange(len(atoms), dtype=np.int64),
            position=atoms.position,
            atom_mass=np.ascontiguousarray(atoms.atom_mass),
            warnings=[trap] if trap else [],
        )

    def _profile(self, request: messages.AtomisticConfigure) -> ForceField | None:
        """Profile of the force field: the named one, or one made of the user's commands."""
        given = request.commands
        if given is None:
            self._check_force_field(request.force_field)
            return self._factory.force_field(request.force_field)
        if not isinstance(self._factory, LammpsFactory):
            sentence = f"commands are of LAMMPS; the backend {self.backend} has its force fields by name"
            raise ProtocolError("unsupported", sentence, field="commands")
        try:
            return custom_force_field(
                request.force_field, given.unit_style, given.atom_style, given.commands, request.time_step
            )
        except ValueError as error:
            raise ProtocolError("bad_field", str(error), field="commands") from None

    def _sample(self, request: messages.AtomisticConfigure) -> Atoms:
        sample, file = request.sample, request.sample_file
        cut = sample.crack if sample is not None else file.crack if file is not None else None
        crack = None if cut is None else CrackCut(cut.tip_x, cut.y)
        if sample is None:
            assert file is not None  # held by the message
            return self._sample_of(file, request.sample_data, crack)
        name = request.force_field
        spacing = sample.lattice_constant
        if request.commands is None and sample.material not in self._factory.materials(name):
            raise self._no_material("sample.material", name, sample.material)
        if spacing is None:
            if request.commands is not None:
                sentence = "sample.lattice_constant is missing; nothing is known of a force field of your own"
                raise ProtocolError("bad_field", sentence, field="sample.lattice_constant")
            spacing = self._factory.spacing(name, sample.material)
        return self._call(
            "configure", build_sample, sample.material, sample.width, sample.height, spacing=spacing,
            layers=sample.layers, orientation=sample.orientation, crack=crack,
        )  # fmt: skip

    def _sample_of(self, file: messages.SampleFile, data: NDArray[np.uint8] | None, crack: CrackCut | None) -> Atoms:
        if data is None:
            held = shipped_samples()
            if file.name not in held:
                sentence = f"sample_file.name: no sample {file.name!r}; there are {', '.join(held) or 'none'}"
                raise ProtocolError("bad_field", sentence, field="sample_file.name")
            content, field = held[file.name].read_bytes(), "sample_file.name"
        else:
            content, field = data.tobytes(), "sample_data"
        try:
            return sample_from_bytes(content, file.periodic_z, crack)
        except ValueError as error:
            raise ProtocolError("bad_field", f"{field}: {error}", field=field) from None

    def _make(self, request: messages.AtomisticConfigure, profile: ForceField | None, atoms: Atoms) -> AnyEngine:
        settings: dict[str, Any] = {
            "temperature": request.temperature, "seed": request.seed, "time_step": request.time_step,
        }  # fmt: skip
        if self._ranks is not None:
            assert profile is not None  # LAMMPS has one for each force field
            # The ranks hold one engine.
            self.close()
            self._dimension = 3
            return ParallelEngine(self._ranks, self._folder, profile, atoms, **settings)
        own: Any = request.force_field if request.commands is None else profile
        dynamics = self._factory.make(self._folder, own, atoms, **settings)
        self._dimension = dynamics.dimension
        return Engine(dynamics, temperature=request.temperature, force_field=profile)

    def register(self, request: messages.AtomisticRegister) -> messages.AtomisticRegistered:
        """Tie atoms to anchors."""
        engine = self._configured()
        self._call(
            "register", engine.register_anchors, request.atom_id, request.anchor_position, request.stiffness,
            request.anchor_ivc, request.damping_time, request.anchor_kind, request.motion == "linear",
            request.damping_share,
        )  # fmt: skip
        self._damped = request.damping_time is not None
        return messages.AtomisticRegistered(ivcs=int(request.anchor_ivc.max()) + 1 if len(request.anchor_ivc) else 0)

    def equilibrate(self, request: messages.EquilibrateRequest) -> messages.Equilibrated:
        """Bring the sample to temperature, then measure the reference force."""
        engine = self._configured()
        ensemble = self._ensemble(request)
        total = request.steps + request.windows * request.window_steps

        def heating(done: int, steps: int) -> None:
            self.activity.progress(done, total, "equilibration")

        def averaging(done: int, rounds: int) -> None:
            part = request.windows * request.window_steps * done // rounds
            self.activity.progress(request.steps + part, total, "reference force")

        how = None
        if request.steps:
            how = self._call(
                "equilibrate", engine.equilibrate, request.steps, progress=heating, ensemble=ensemble,
                keep_ensemble=request.keep_ensemble, settle=request.settle,
            )  # fmt: skip
        reference = self._call(
            "equilibrate", engine.measure_reference, request.windows, request.window_steps, progress=averaging
        )
        self._begin()
        self._record().forget_reference()
        return messages.Equilibrated(
            reference_ivc_force=reference.ivc_force,
            reference_ivc_error=reference.ivc_standard_error,
            window_ivc_deviation=reference.window_standard_deviation,
            reference_anchor_force=reference.anchor_force,
            temperature=reference.temperature,
            steps_done=None if how is None else how.steps,
            settled=None if how is None else how.settled,
            drifts=[] if how is None or how.settled is None else _drifts(how),
        )

    def _ensemble(self, request: messages.EquilibrateRequest) -> Ensemble | None:
        given = request.ensemble
        if given is None:
            return None
        if given.thermostat not in self._factory.ensembles:
            known = ", ".join(self._factory.ensembles) or "none"
            sentence = f"thermostat {given.thermostat} is not among those of {self.backend}: {known}"
            raise ProtocolError("unsupported", sentence, field="ensemble.thermostat")
        if request.keep_ensemble and self._damped:
            sentence = "keep_ensemble is set beside damping_time of register; one thermostat at a time"
            raise ProtocolError("bad_field", sentence, field="keep_ensemble")
        if given.pressure is not None and not any(self._configured().atoms.box.periodic):
            sentence = "pressure is given, but the box of this sample repeats nowhere: nothing can follow it"
            raise ProtocolError("unsupported", sentence, field="ensemble.pressure")
        return Ensemble(given.thermostat, self._temperature, given.damping_time, given.pressure, given.pressure_time)

    # The run --------------------------------------------------------------------------------------------------

    def advance(self, request: messages.AtomisticAdvance) -> messages.AtomisticAdvanced:
        """One coupling step: M steps under the anchors, averaged reaction."""
        engine = self._configured()
        now = self._call(
            "advance", engine.advance, request.steps, request.anchor_position, request.anchor_velocity,
            request.until_error, request.most_windows if request.until_error is not None else 1,
        )  # fmt: skip
        self._advanced = self._collecting
        record = self._record()
        if self._collecting and engine.samples > record.samples:
            means = self._call("advance", engine.fields, list(J_FIELDS))
            record.add(means, engine.samples - record.samples)
        bonds = self._call("advance", engine.broken_bonds)
        return messages.AtomisticAdvanced(
            step=now.step,
            anchor_force=now.anchor_force,
            ivc_force=now.ivc_force,
            ivc_standard_error=now.ivc_standard_error,
            temperature=now.temperature,
            handshake_temperature=now.temperature_handshake,
            potential_energy=now.potential_energy,
            kinetic_energy=now.kinetic_energy,
            spring_energy=now.spring_energy,
            anchor_work=now.anchor_work,
            thermostat_work=now.thermostat_work,
            windows=now.windows,
            momentum=tuple(now.momentum.tolist()),
            correlation_time=now.correlation_time if np.isfinite(now.correlation_time) else None,
            broken_bonds=bonds.broken,
            crack_tip=bonds.tip_x if engine.crack is not None else None,
            longest_bond=bonds.longest_length if np.isfinite(bonds.longest_length) else 0.0,
            longest_bond_atoms=(bonds.longest_atoms[0], bonds.longest_atoms[1]) if bonds.longest_atoms else None,
            warnings=[bonds.warning] if bonds.warning else [],
        )

    def displace(self, request: messages.DisplaceRequest) -> messages.Displaced:
        """Move all atoms and anchors at once."""
        engine = self._configured()
        self._call("displace", engine.displace, request.displacement, request.anchor_position)
        return messages.Displaced(step=engine.step)

    def cut(self, request: messages.CutRequest) -> messages.Severed:
        """Sever the atoms along a line."""
        engine, profile = self._configured(), self._own_profile
        trap = "" if profile is None else profile.severing_trap(engine.atoms)
        if not self._factory.severs:
            trap = f"the forces of the backend {self.backend} cannot be severed along a line"
        if trap:
            raise ProtocolError("unsupported", trap, field="type")
        done = self._call("cut", engine.sever, request.from_x, request.to_x, request.y)
        self._record().sever(engine.cuts)
        self._begin_anew("cut")  # a mean over windows before and after it would be of two bodies
        return messages.Severed(step=engine.step, bonds=done.bonds, energy=done.energy)

    # What can be looked at ------------------------------------------------------------------------------------

    def collect_fields(self, request: messages.CollectRequest) -> messages.Collecting:
        """Start or stop to collect fields at the ends of windows."""
        engine = self._configured()
        self._call("collect_fields", engine.collect_fields, request.active)
        self._collecting = request.active
        self._begin()
        return messages.Collecting(step=engine.step)

    def fields(self, request: FieldsRequest) -> FieldsReply:
        """Return fields by name, rows in the order of `configure`."""
        engine = self._configured()
        _check_names(request.names, FIELD_NAMES)
        return FieldsReply(step=engine.step, fields=self._call("fields", engine.fields, request.names))

    def grid_fields(self, request: messages.GridFieldsRequest) -> messages.GridFields:
        """Return averages around the points of a grid."""
        engine = self._configured()
        _check_names(request.names, GRID_FIELDS)
        means = self._call("grid_fields", engine.fields, list(NEEDED))
        found = self._call(
            "grid_fields", grid_fields, engine.atoms, means, np.array(request.origin), request.spacing, request.counts,
            request.radius, self._dimension,
        )  # fmt: skip
        fields = {name: found[name] for name in request.names}
        return messages.GridFields(step=engine.step, samples=self._record().samples, fields=fields)

    def j_integral(self, request: messages.JIntegralRequest) -> messages.JIntegral:
        """Return J of the means collected since the last answer, and begin a new average."""
        engine = self._configured()
        try:
            rest = engine.reference_fields()
        except EngineError as error:
            raise ProtocolError("wrong_state", f"{error}", hint="collect_fields comes before equilibrate") from None
        record = self._record()
        if not self._advanced:
            raise ProtocolError("wrong_state", "no window was collected since the last answer: advance comes before")
        if not record.samples:  # the windows were too short for a sample of their own
            record.add(self._call("j_integral", engine.fields, list(J_FIELDS)), 1)
        tip = self._tip(request.tip)
        place = self._call("j_integral", engine.fields, ["position"])["position"]
        found = self._call("j_integral", record.measure, tip, tuple(request.half_sizes), rest, place)
        reply = messages.JIntegral(
            step=engine.step, samples=record.samples, tip=tip, contour=found.contour,
            standard_error=found.contour_error, domain=found.domain, domain_error=found.domain_error,
        )  # fmt: skip
        self._begin_anew("j_integral")
        return reply

    def _begin_anew(self, operation: str) -> None:
        """Begin new means, here and in the engine."""
        if self._collecting:
            self._call(operation, self._configured().collect_fields, True)
        self._begin()

    def _begin(self) -> None:
        """Begin new means of the fields that J is made of."""
        self._advanced = False
        self._record().begin()

    def _tip(self, given: Point2 | None) -> Point2:
        if given is not None:
            return given
        engine = self._configured()
        crack = engine.crack
        if crack is None:
            raise ProtocolError("bad_field", "tip is missing; this sample has no crack to follow", field="tip")
        return (float(self._call("j_integral", engine.broken_bonds).tip_x), crack.y)

    # State ----------------------------------------------------------------------------------------------------

    def checkpoint(self, request: Empty) -> CheckpointReply:
        """Return the state; the engine goes on from it as a restored one would."""
        engine = self._configured()
        state = self._call("checkpoint", engine.state)
        state.update({_J + name: value for name, value in self._record().state().items()})
        return CheckpointReply(step=engine.step, state=state)

    def restore(self, request: RestoreRequest) -> Restored:
        """Set the state."""
        engine = self._configured()
        counters = request.state.get(_COUNTERS)
        if counters is None or counters.size == 0 or int(counters.flat[0]) != request.step:
            raise ProtocolError("bad_field", f"step {request.step} is not the step of the state", field="step")
        own = {name.removeprefix(_J): value for name, value in request.state.items() if name.startswith(_J)}
        rest = {name: value for name, value in request.state.items() if not name.startswith(_J)}
        record = JRecord(engine.atoms, self._own_profile, self._temperature)
        try:
            record.restore(own)
            self._call("restore", engine.restore, rest)
        except KeyError as error:
            raise ProtocolError("bad_field", f"state lacks {error}", field="state") from None
        except ValueError as error:
            raise ProtocolError("bad_field", str(error), field="state") from None
        record.sever(engine.cuts)
        self._collecting = self._advanced = bool(request.state[_COLLECTED][1])
        self._j = record
        return Restored(step=engine.step)

    def close(self) -> None:
        """Let go of the engine."""
        if self._engine is not None:
            self._engine.close()
            self._engine = None

    # Inside ---------------------------------------------------------------------------------------------------

    def _configured(self) -> AnyEngine:
        if self._engine is None:
            raise ProtocolError("wrong_state", "there is no sample: the last configure failed")
        return self._engine

    def _record(self) -> JRecord:
        self._configured()
        assert self._j is not None  # made with the engine
        return self._j

    def _check_force_field(self, name: str) -> None:
        known = self._factory.force_fields()
        if name not in known:
            sentence = f"no force field {name!r}; there are {', '.join(known)}"
            raise ProtocolError("bad_field", sentence, field="force_field")

    def _no_material(self, field: str, force_field: str, material: str) -> ProtocolError:
        known = ", ".join(self._factory.materials(force_field)) or "none, give a sample_file"
        sentence = f"no material {material!r} for the force field {force_field}; there are {known}"
        return ProtocolError("bad_field", sentence, field=field)

    def _call(self, operation: str, method: Callable[..., Any], *arguments: Any, **named: Any) -> Any:
        """Call the engine; its errors become errors of the wire."""
        try:
            return method(*arguments, **named)
        except EngineError as error:
            raise ProtocolError("solver_failed", str(error), step=self.step) from error
        except ValueError as error:
            name = re.split(r"[ \[:=]", str(error), maxsplit=1)[0]
            # What a material cannot have is no mistake of the number itself.
            code = "unsupported" if name in ("layers", "orientation") or "crack is given" in str(error) else "bad_field"
            field = FIELD_OF.get(operation, {}).get(name, name)
            raise ProtocolError(code, str(error), field=field) from None


def make_service(folder: Path) -> AtomisticService:
    """Return the service on LAMMPS; under mpiexec, ranks other than 0 follow rank 0 and never return."""
    if int(os.environ.get("PMI_SIZE", "1")) == 1:
        return AtomisticService(folder)
    ranks = MpiRanks()
    if ranks.rank > 0:
        follow(ranks)
        sys.exit(0)
    return AtomisticService(folder, LAMMPS, ranks)


def make_lattice(folder: Path) -> AtomisticService:
    """Return the service on the harmonic lattice."""
    from md_service.lattice_dynamics import LATTICE

    return AtomisticService(folder, LATTICE)


def make_ase(folder: Path) -> AtomisticService:
    """Return the service on ASE calculators."""
    from md_service.ase_dynamics import ASE

    return AtomisticService(folder, ASE)


def make_openmm(folder: Path) -> AtomisticService:
    """Return the service on OpenMM."""
    from md_service.openmm_dynamics import OPENMM

    return AtomisticService(folder, OPENMM)


def _check_names(names: list[str], known: tuple[str, ...]) -> None:
    for index, name in enumerate(names):
        if name not in known:
            sentence = f"names.{index}: no field {name!r}; there are {', '.join(known)}"
            raise ProtocolError("bad_field", sentence, field=f"names.{index}")


def _drifts(how: Any) -> list[messages.Drift]:
    values = [("energy", how.energy_drift, how.energy_error)]
    values += [
        (f"stress_{name}", how.stress_drift[k], how.stress_error[k]) for k, name in enumerate(_COMPONENTS)
    ]  # fmt: skip
    # Too few looks tell no drift.
    return [
        messages.Drift(quantity=name, drift=float(drift), standard_error=float(error))
        for name, drift, error in values
        if np.isfinite(drift) and np.isfinite(error)
    ]
