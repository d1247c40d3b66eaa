"""The atomistic role on LAMMPS: messages in, engine calls out. The only file that sees both."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np

from md_service.elastic_constants import measure_graphene
from md_service.engine import LammpsEngine
from md_service.errors import EngineError
from md_service.force_fields import CARBON_MASS, FORCE_FIELDS, ForceField
from md_service.graphene import CrackCut, sheet
from md_service.parallel import ParallelEngine, follow
from md_service.ranks import MpiRanks
from protocol import atomistic as messages
from protocol.errors import ProtocolError
from protocol.messages import CheckpointReply, Empty, FieldsReply, FieldsRequest, Restored, RestoreRequest
from protocol.service import Capabilities, Service
from protocol.version import package_version

MATERIALS = ["graphene"]
FIELDS = ["position", "velocity", "stress"]
#: Beyond it a seed is no longer exact as a double, in which states travel.
LARGEST_SEED = 2**53
#: Names of engine arguments as the messages have them.
FIELD_NAMES = {
    "position": "anchor_position",
    "ivc": "anchor_ivc",
    "window": "steps",
    "windows": "windows",
    "damping": "damping_time",
}


class LammpsService(Service):
    """One LAMMPS engine at a time.

    Parameters
    ----------
    folder : Path
        For the LAMMPS log and derived potential files.
    ranks : MpiRanks, optional
        All ranks, where there is more than one; this process is rank 0.
    """

    role = "atomistic"
    backend = "md_service"
    backend_version = package_version()

    def __init__(self, folder: Path, ranks: MpiRanks | None = None) -> None:
        super().__init__()
        self._folder = folder
        self._ranks = ranks
        self._engine: LammpsEngine | ParallelEngine | None = None
        self._has_crack = False
        self._ivcs = 0

    def capabilities(self) -> Capabilities:
        """Return force fields, materials, fields and ranks."""
        return {
            "force_fields": sorted(FORCE_FIELDS),
            "materials": MATERIALS,
            "fields": FIELDS,
            "dimension": 3,
            "ranks": 1 if self._ranks is None else self._ranks.size,
        }

    @property
    def step(self) -> int:
        """MD steps since configure."""
        return 0 if self._engine is None else self._engine.step

    def properties(self, request: messages.PropertiesRequest) -> messages.Properties:
        """Measure lattice constant, E, nu and density of the potential at a temperature."""
        force_field = _force_field(request.force_field)
        _check_material("material", request.material)
        try:
            measured = measure_graphene(
                force_field, request.temperature, seed=request.seed, work_dir=self._folder,
                progress=self.activity.progress,
            )  # fmt: skip
        except EngineError as error:
            raise _failed(error, 0) from error
        return messages.Properties(
            lattice_constant=measured.lattice_constant,
            lattice_constant_error=measured.lattice_constant_error,
            young=measured.young,
            young_error=measured.young_error,
            poisson=measured.poisson,
            poisson_error=measured.poisson_error,
            density=measured.density,
            thickness=measured.thickness,
        )

    def configure(self, request: messages.AtomisticConfigure) -> messages.AtomisticConfigured:
        """Build the sample and hand it to LAMMPS; a request that is refused leaves the old sample as it is."""
        if request.seed > LARGEST_SEED:
            raise ProtocolError("bad_field", f"seed {request.seed} is above {LARGEST_SEED}", field="seed")
        force_field = _force_field(request.force_field)
        sample = request.sample
        _check_material("sample.material", sample.material)
        lattice_constant = sample.lattice_constant or force_field.lattice_constant
        crack = CrackCut(sample.crack.tip_x, sample.crack.y) if sample.crack else None
        try:
            built = sheet(sample.width, sample.height, lattice_constant, crack)
        except ValueError as error:
            raise ProtocolError("bad_field", f"sample: {error}", field="sample") from None
        self.close()
        settings: dict[str, Any] = {
            "temperature": request.temperature,
            "seed": request.seed,
            "time_step": request.time_step,
            "lattice_constant": lattice_constant,
        }
        try:
            if self._ranks is None:
                self._engine = LammpsEngine(self._folder, force_field, built.position, crack=built.crack, **settings)
            else:
                self._engine = ParallelEngine(
                    self._ranks, self._folder, force_field.name, built.position, crack=built.crack, **settings
                )
        except (EngineError, ValueError) as error:
            raise _failed(error, 0) from error
        self._has_crack = crack is not None
        atoms = len(built.position)
        return messages.AtomisticConfigured(
            atom_id=np.arange(atoms, dtype=np.int64),
            position=built.position,
            atom_mass=np.full(atoms, CARBON_MASS),
            warnings=[force_field.cutoff_trap] if self._has_crack and force_field.cutoff_trap else [],
        )

    def register(self, request: messages.AtomisticRegister) -> messages.AtomisticRegistered:
        """Tie atoms to anchors."""
        engine = self._configured()
        damping = CARBON_MASS / request.damping_time if request.damping_time is not None else 0.0
        self._call(
            engine.register_anchors, request.atom_id, request.anchor_position, request.stiffness, request.anchor_ivc,
            np.full(len(request.atom_id), damping),
        )  # fmt: skip
        self._ivcs = int(request.anchor_ivc.max()) + 1 if len(request.anchor_ivc) else 0
        return messages.AtomisticRegistered(ivcs=self._ivcs)

    def equilibrate(self, request: messages.EquilibrateRequest) -> messages.Equilibrated:
        """Bring the sample to temperature, then measure the reference force."""
        engine = self._configured()
        total = request.steps + request.windows * request.window_steps

        def heating(done: int, steps: int) -> None:
            self.activity.progress(done, total, "equilibration")

        def averaging(done: int, windows: int) -> None:
            self.activity.progress(request.steps + done * request.window_steps, total, "reference force")

        if request.steps:
            self._call(engine.equilibrate, request.steps, progress=heating)
        reference = self._call(engine.measure_reference, request.windows, request.window_steps, progress=averaging)
        return messages.Equilibrated(
            reference_ivc_force=reference.ivc_force,
            reference_ivc_error=reference.ivc_standard_error,
            window_ivc_deviation=reference.window_standard_deviation,
            temperature=reference.temperature,
        )

    def advance(self, request: messages.AtomisticAdvance) -> messages.AtomisticAdvanced:
        """One coupling step: anchors held, M steps, averaged reaction."""
        engine = self._configured()
        now = self._call(engine.advance, request.steps, request.anchor_position, request.anchor_velocity)
        bonds = self._call(engine.broken_bonds)
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
            broken_bonds=bonds.broken,
            crack_tip=bonds.tip_x if self._has_crack else None,
            longest_bond=bonds.longest_length,
            warnings=[bonds.warning] if bonds.warning else [],
        )

    def fields(self, request: FieldsRequest) -> FieldsReply:
        """Return fields by name, rows in the order of `configure`."""
        engine = self._configured()
        for index, name in enumerate(request.names):
            if name not in FIELDS:
                raise ProtocolError(
                    "bad_field",
                    f"names.{index}: no field {name!r}; there are {', '.join(FIELDS)}",
                    field=f"names.{index}",
                )
        return FieldsReply(step=engine.step, fields=self._call(engine.fields, request.names))

    def checkpoint(self, request: Empty) -> CheckpointReply:
        """Return the state; the engine goes on from it as a restored one would."""
        engine = self._configured()
        state = self._call(engine.state)
        return CheckpointReply(step=engine.step, state=state)

    def restore(self, request: RestoreRequest) -> Restored:
        """Set the state."""
        engine = self._configured()
        counters = request.state.get("counters")
        if counters is None or counters.size == 0 or int(counters.flat[0]) != request.step:
            raise ProtocolError("bad_field", f"step {request.step} is not the step of the state", field="step")
        self._call(engine.restore, request.state)
        return Restored(step=engine.step)

    def close(self) -> None:
        """Let go of LAMMPS."""
        if self._engine is not None:
            self._engine.close()
            self._engine = None

    def _configured(self) -> LammpsEngine | ParallelEngine:
        if self._engine is None:
            raise ProtocolError("wrong_state", "there is no sample: the last configure failed")
        return self._engine

    def _call(self, method: Any, *arguments: Any, **named: Any) -> Any:
        """Call the engine; its errors become errors of the wire."""
        try:
            return method(*arguments, **named)
        except EngineError as error:
            raise _failed(error, self.step) from error
        except ValueError as error:
            name = re.split(r"[ \[:=]", str(error), maxsplit=1)[0]
            raise ProtocolError("bad_field", str(error), field=FIELD_NAMES.get(name, name)) from None


def make_service(folder: Path) -> LammpsService:
    """Return the service; under mpiexec, ranks other than 0 follow rank 0 and never return."""
    if int(os.environ.get("PMI_SIZE", "1")) == 1:
        return LammpsService(folder)
    ranks = MpiRanks()
    if ranks.rank > 0:
        follow(ranks)
        sys.exit(0)
    return LammpsService(folder, ranks)


def _force_field(name: str) -> ForceField:
    if name not in FORCE_FIELDS:
        raise ProtocolError(
            "bad_field",
            f"no force field {name!r}; there are {', '.join(sorted(FORCE_FIELDS))}",
            field="force_field",
        )
    return FORCE_FIELDS[name]


def _check_material(field: str, name: str) -> None:
    if name not in MATERIALS:
        raise ProtocolError("bad_field", f"no material {name!r}; there are {', '.join(MATERIALS)}", field=field)


def _failed(error: Exception, step: int) -> ProtocolError:
    return ProtocolError("solver_failed", str(error), step=step)
