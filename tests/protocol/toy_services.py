"""Small real services for the tests, nothing but numpy: harmonic oscillators behind the roles that hold a state, and
a cell of uniform strain behind the one that does not.

`python toy_services.py ROLE ENDPOINT [--noise] [--parent PID] [--limit BYTES]` serves one as a process.
"""

from __future__ import annotations

import argparse
import ctypes
import hashlib
import time
from pathlib import Path
from typing import Any

import numpy as np

from protocol import atomistic as a
from protocol import continuum as c
from protocol import micromechanics as m
from protocol.errors import ProtocolError
from protocol.messages import CheckpointReply, Empty, FieldsReply, FieldsRequest, Restored, RestoreRequest, newer_fields
from protocol.server import Server
from protocol.service import Capabilities, Service
from protocol.version import Version

#: Most steps of one request, so that a fuzzed message cannot keep a test waiting.
MOST_STEPS = 10_000_000
MOST_POINTS = 100_000
#: Steps between two looks at `abort`.
CHUNK = 50


def bad(field: str, problem: str) -> ProtocolError:
    return ProtocolError("bad_field", f"{field}: {problem}", field=field)


def refuse_newer(request: Any) -> None:
    """Refuse what version 1.2 brought; a toy may do without it."""
    for field in newer_fields(request, Version(1, 1)):
        raise ProtocolError("unsupported", f"{field}: this toy knows nothing of it", field=field)


class Toy(Service):
    """What both toys share: a state in named arrays, checkpoint, restore, noise that a checkpoint reseeds."""

    backend = "toy"
    backend_version = "0.1"
    own_fields: tuple[str, ...]

    def __init__(self, noise: float = 0.0) -> None:
        super().__init__()
        self.noise = noise
        self.seed = 1
        self.configured = False
        self.advances = 0
        self.most_steps = MOST_STEPS
        #: What a long computation of one request is made of; a test sets it.
        self.compute_first: Any = None
        self.state: dict[str, np.ndarray] = {"step": np.zeros(1, np.int64)}
        self.random = np.random.default_rng(1)

    @property
    def step(self) -> int:
        return int(self.state["step"][0])

    def reseed(self) -> None:
        self.random = np.random.default_rng([self.seed, self.step])

    def steps(self, count: int, one: Any) -> None:
        if count > self.most_steps:
            raise ProtocolError("unsupported", f"steps: {count} is more than {self.most_steps}", field="steps")
        self.advances += 1
        if self.compute_first is not None:
            self.compute_first(self)
        with np.errstate(all="ignore"):  # a runaway is reported below, once
            for done in range(count):
                if done % CHUNK == 0:
                    self.activity.progress(done, count, "stepping")
                one()
                self.state["step"][0] += 1
        if not all(np.isfinite(array).all() for array in self.state.values()):
            raise ProtocolError("solver_failed", "displacement is not finite; take a smaller time step", step=self.step)

    def field(self, name: str) -> np.ndarray:
        return self.state[name]

    def fields(self, request: FieldsRequest) -> FieldsReply:
        for index, name in enumerate(request.names):
            if name not in self.own_fields:
                raise bad(f"names.{index}", f"no field {name!r}, allowed are {', '.join(self.own_fields)}")
        return FieldsReply(step=self.step, fields={name: self.field(name).copy() for name in request.names})

    def checkpoint(self, request: Empty) -> CheckpointReply:
        self.reseed()
        return CheckpointReply(step=self.step, state={name: array.copy() for name, array in self.state.items()})

    def restore(self, request: RestoreRequest) -> Restored:
        given = request.state
        if set(given) != set(self.state):
            raise bad("state", f"has {sorted(given)}, must have {sorted(self.state)}")
        for name, array in self.state.items():
            if given[name].shape != array.shape or given[name].dtype != array.dtype:
                raise bad(f"state.{name}", f"has shape {given[name].shape}, must have {array.shape}")
        if int(given["step"][0]) != request.step:
            raise bad("step", f"is {request.step}, the state is of step {int(given['step'][0])}")
        self.state = {name: array.copy() for name, array in given.items()}
        self.reseed()
        return Restored(step=self.step)


class ToyContinuum(Toy):
    """Points that swing about their places; an anchor moves with the point nearest to it."""

    role = "continuum"
    own_fields = ("position", "displacement", "velocity", "weight")

    def capabilities(self) -> Capabilities:
        return {"fields": list(self.own_fields), "dimension": 2}

    def configure(self, request: c.ContinuumConfigure) -> c.ContinuumConfigured:
        for field in newer_fields(request, Version(1, 0)):
            if field != "scheme":
                raise ProtocolError("unsupported", f"{field}: this toy knows nothing of it", field=field)
        assert isinstance(request.material, c.IsotropicMaterial)
        lower, upper = np.array(request.body.lower), np.array(request.body.upper)
        with np.errstate(over="ignore"):
            cells = np.round((upper - lower) / request.cell_size)
        if not 1 <= cells.prod() * float(request.points_per_cell) ** 2 <= MOST_POINTS:
            raise bad("cell_size", f"gives {cells.prod():g} cells, allowed are up to {MOST_POINTS} points")
        spacing = request.cell_size / request.points_per_cell
        axes = [lower[k] + spacing * (np.arange(int(cells[k]) * request.points_per_cell) + 0.5) for k in (0, 1)]
        x, y = (grid.ravel() for grid in np.meshgrid(*axes))
        position = np.column_stack([x, y, np.zeros_like(x)])
        weight = np.ones(len(x))
        if request.overlap is not None:
            keep = ~inside(position, request.overlap.inner)
            ring = inside(position, request.overlap.outer)
            weight[ring] = request.overlap.weight
            position, weight = position[keep], weight[keep]
        omega = np.sqrt(request.material.young / request.material.density) / request.cell_size
        if not request.time_step <= 2 / omega:
            raise bad("time_step", f"is {request.time_step:g} s, the largest stable step is {2 / omega:g} s")
        self.omega, self.request = omega, request
        self.position, self.weight = position, weight
        self.mass = request.material.density * request.thickness * spacing**2 * weight
        velocity = np.zeros_like(position)
        if request.initial_velocity_gradient is not None:
            velocity[:, :2] = position[:, :2] @ np.reshape(request.initial_velocity_gradient, (2, 2)).T
        self.state = {
            "step": np.zeros(1, np.int64),
            "displacement": np.zeros_like(position),
            "velocity": velocity,
            "anchor_start": np.zeros((0, 3)),
            "sums": np.zeros(2),
        }
        self.point_of_anchor = np.zeros(0, np.int64)
        self.points_of_ivc: list[np.ndarray] = []
        self.reseed()
        return c.ContinuumConfigured(
            courant_number=request.time_step * omega,
            stable_time_step=2 / omega,
            cells=int(cells.prod()),
            position=position,
            weight=weight,
        )

    def register(self, request: c.ContinuumRegister) -> c.ContinuumRegistered:
        outside = ~inside(request.anchor_position, self.request.body)
        if outside.any():
            raise bad("anchor_position", f"row {np.flatnonzero(outside)[0]} lies outside the body")
        boxes = zip(request.ivc_lower, request.ivc_upper, strict=True)
        points = [np.flatnonzero(inside_box(self.position, lower, upper)) for lower, upper in boxes]
        for ivc in np.unique(request.anchor_ivc):
            if not len(points[ivc]):
                raise bad("ivc_lower", f"IVC {ivc} has anchors but no material point")
        nearest = [int(np.argmin(((self.position - anchor) ** 2).sum(axis=1))) for anchor in request.anchor_position]
        self.point_of_anchor = np.array(nearest, dtype=np.int64)
        self.points_of_ivc = points
        self.state["anchor_start"] = self.state["displacement"][self.point_of_anchor]
        return c.ContinuumRegistered(points_in_ivc=np.array([len(found) for found in points], dtype=np.int64))

    def advance(self, request: c.ContinuumAdvance) -> c.ContinuumAdvanced:
        force = np.zeros_like(self.position)
        if request.ivc_force is not None:
            if len(request.ivc_force) != len(self.points_of_ivc):
                raise bad("ivc_force", f"has {len(request.ivc_force)} rows, registered are {len(self.points_of_ivc)}")
            for total, points in zip(request.ivc_force, self.points_of_ivc, strict=True):
                force[points] += total / max(1, len(points))
        if request.anchor_force is not None:
            if len(request.anchor_force) != len(self.point_of_anchor):
                raise bad("anchor_force", f"has {len(request.anchor_force)} rows, registered are "
                          f"{len(self.point_of_anchor)}")  # fmt: skip
            np.add.at(force, self.point_of_anchor, request.anchor_force)
        force[:, 2] = 0.0
        step, decay = self.request.time_step, np.exp(-self.request.damping_rate * self.request.time_step)
        state, mass = self.state, self.mass[:, None]

        def one() -> None:
            kick = force / mass - self.omega**2 * state["displacement"]
            if self.noise:
                kick[:, :2] += self.noise * self.random.standard_normal((len(kick), 2))
            state["velocity"] += step * kick
            state["velocity"] *= decay
            state["displacement"] += step * state["velocity"]
            state["sums"][0] += step * (force * state["velocity"]).sum()

        self.steps(request.steps, one)
        edges = [edge for edge in self.request.edges if isinstance(edge, c.EdgeCondition)]
        now = self.step * step
        return c.ContinuumAdvanced(
            step=self.step,
            anchor_displacement=state["displacement"][self.point_of_anchor] - state["anchor_start"],
            anchor_velocity=state["velocity"][self.point_of_anchor],
            edge_force=np.zeros(len(edges)),
            edge_displacement=np.array([np.interp(now, edge.times, edge.displacements) for edge in edges]),
            kinetic_energy=float(0.5 * (mass * state["velocity"] ** 2).sum()),
            strain_energy=float(0.5 * self.omega**2 * (mass * state["displacement"] ** 2).sum()),
            edge_work=0.0,
            interface_work=float(state["sums"][0]),
            damping_loss=0.0,
            points_lost=0,
        )

    def field(self, name: str) -> np.ndarray:
        if name == "position":
            return self.position + self.state["displacement"]
        return self.weight if name == "weight" else self.state[name]


class ToyAtomistic(Toy):
    """Atoms on a square lattice, each tied to its place; anchors tie some of them once more."""

    role = "atomistic"
    own_fields = ("position", "velocity")
    mass = 2e-26
    own_stiffness = 50.0

    def capabilities(self) -> Capabilities:
        return {
            "fields": list(self.own_fields), "force_fields": ["harmonic"], "materials": ["square"],
            "conformance_sample_width": 1e-9, "conformance_sample_height": 1e-9,
        }  # fmt: skip

    def properties(self, request: a.PropertiesRequest) -> a.Properties:
        self._check_names(request.force_field, "material", request.material)
        return a.Properties(
            lattice_constant=2e-10, lattice_constant_error=0.0, young=1e11, young_error=0.0, poisson=0.0,
            poisson_error=0.0, density=2e3, thickness=1e-10,
        )  # fmt: skip

    def _check_names(self, force_field: str, field: str, material: str) -> None:
        if force_field != "harmonic":
            raise bad("force_field", f"no force field {force_field!r}, allowed is harmonic")
        if material != "square":
            raise bad(field, f"no material {material!r}, allowed is square")

    def configure(self, request: a.AtomisticConfigure) -> a.AtomisticConfigured:
        refuse_newer(request)
        sample = request.sample
        assert sample is not None
        self._check_names(request.force_field, "sample.material", sample.material)
        lattice = sample.lattice_constant or 2e-10
        counts = [round(min(size / lattice, 1e9)) + 1 for size in (sample.width, sample.height)]
        if counts[0] * counts[1] > MOST_POINTS:
            raise bad("sample.width", f"gives {counts[0] * counts[1]} atoms, allowed are {MOST_POINTS}")
        x, y = (grid.ravel() for grid in np.meshgrid(*[lattice * (np.arange(n) - (n - 1) / 2) for n in counts]))
        place = np.column_stack([x, y, np.zeros_like(x)])
        if sample.crack is not None:
            place = place[~((x <= sample.crack.tip_x) & (np.abs(y - sample.crack.y) < 0.6 * lattice))]
        self.request, self.place, self.seed = request, place, request.seed
        self.ids = np.arange(len(place), dtype=np.int64) + 1
        self.state = {
            "step": np.zeros(1, np.int64),
            "position": place.copy(),
            "velocity": np.zeros_like(place),
            "reference": np.zeros((0, 3)),
        }
        self._set_anchors(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros(0, np.int64), np.zeros(0), None)
        self.reseed()
        return a.AtomisticConfigured(
            atom_id=self.ids, position=place, atom_mass=np.full(len(place), self.mass), warnings=[]
        )

    def _set_anchors(self, rows: Any, position: Any, ivc: Any, stiffness: Any, damping_time: float | None) -> None:
        self.rows, self.anchor, self.ivc, self.stiffness = rows, position, ivc, stiffness
        self.gamma = 0.0 if damping_time is None else self.mass / damping_time
        self.ivcs = int(ivc.max()) + 1 if len(ivc) else 0
        self.state["reference"] = np.zeros((len(rows), 3))

    def register(self, request: a.AtomisticRegister) -> a.AtomisticRegistered:
        refuse_newer(request)
        unknown = np.setdiff1d(request.atom_id, self.ids)
        if len(unknown):
            raise bad("atom_id", f"no atom {unknown[0]}")
        if len(request.anchor_ivc) and request.anchor_ivc.max() > MOST_POINTS:
            raise bad("anchor_ivc", f"more than {MOST_POINTS} IVCs")
        self._set_anchors(
            request.atom_id - 1, request.anchor_position, request.anchor_ivc, request.stiffness, request.damping_time
        )
        return a.AtomisticRegistered(ivcs=self.ivcs)

    def window(self, steps: int, anchor: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """Integrate with the anchors held, return the mean reaction on the continuum per anchor."""
        state, step, rows = self.state, self.request.time_step, self.rows
        total = np.zeros_like(anchor)

        def reaction() -> np.ndarray:
            spring = self.stiffness[:, None] * (state["position"][rows] - anchor)
            return spring + self.gamma * (state["velocity"][rows] - velocity)

        def one() -> None:
            force = self.own_stiffness * (self.place - state["position"])
            force[rows] -= reaction()
            if self.noise and self.request.temperature > 0:
                force[rows] += self.noise * self.random.standard_normal((len(rows), 3))
            state["velocity"] += step * force / self.mass
            state["position"] += step * state["velocity"]
            total[...] += reaction()

        self.steps(steps, one)
        return total / steps

    def per_ivc(self, force: np.ndarray) -> np.ndarray:
        summed = np.zeros((self.ivcs, 3))
        np.add.at(summed, self.ivc, force)
        return summed

    def equilibrate(self, request: a.EquilibrateRequest) -> a.Equilibrated:
        refuse_newer(request)
        rest = np.zeros_like(self.anchor)
        if request.steps + request.windows * request.window_steps > self.most_steps:
            raise ProtocolError("unsupported", f"windows: more than {self.most_steps} steps", field="windows")
        if request.steps:
            self.window(request.steps, self.anchor, rest)
        forces = np.array([self.window(request.window_steps, self.anchor, rest) for _ in range(request.windows)])
        self.state["reference"] = forces.mean(axis=0)
        means = np.array([self.per_ivc(force) for force in forces])
        deviation = means.std(axis=0)
        return a.Equilibrated(
            reference_ivc_force=means.mean(axis=0), reference_ivc_error=deviation / np.sqrt(request.windows),
            window_ivc_deviation=deviation, temperature=0.0,
        )  # fmt: skip

    def advance(self, request: a.AtomisticAdvance) -> a.AtomisticAdvanced:
        refuse_newer(request)
        if len(request.anchor_position) != len(self.rows):
            raise bad("anchor_position", f"has {len(request.anchor_position)} rows, registered are {len(self.rows)}")
        force = self.window(request.steps, request.anchor_position, request.anchor_velocity) - self.state["reference"]
        return a.AtomisticAdvanced(
            step=self.step, anchor_force=force, ivc_force=self.per_ivc(force),
            ivc_standard_error=np.zeros((self.ivcs, 3)), temperature=0.0, handshake_temperature=0.0,
            potential_energy=0.0, kinetic_energy=float(0.5 * self.mass * (self.state["velocity"] ** 2).sum()),
            spring_energy=0.0, anchor_work=0.0, broken_bonds=0, crack_tip=None, longest_bond=2e-10, warnings=[],
        )  # fmt: skip


class ToyMicromechanics(Toy):
    """Cells whose subcells all have the macroscopic strain (Voigt); maximum stress alone, along 1, 2 and 3."""

    role = "micromechanics"
    own_fields = ()

    def __init__(self, noise: float = 0.0) -> None:
        super().__init__(noise)
        self.cells: dict[str, m.RegisterCell] = {}

    def capabilities(self) -> Capabilities:
        return {"criteria": ["maximum_stress"], "after_failure": ["gmc"]}

    def register(self, request: m.RegisterCell) -> m.CellRegistered:
        if request.after_failure != "gmc":
            raise ProtocolError("unsupported", "after_failure: this toy knows gmc alone", field="after_failure")
        if request.phase.size > 4096:
            raise ProtocolError("unsupported", "phase: more than 4096 subcells", field="phase")
        for number, material in enumerate(request.materials):
            for name in ("fracture_energy", "plasticity"):
                if getattr(material, name) is not None:
                    field = f"materials.{number}.{name}"
                    raise ProtocolError("unsupported", f"{field}: this toy knows nothing of it", field=field)
            for row, failure in enumerate(material.failures):
                if failure.criterion != "maximum_stress":
                    field = f"materials.{number}.failures.{row}.criterion"
                    raise ProtocolError("unsupported", f"{field}: this toy knows maximum_stress alone", field=field)
        digest = hashlib.sha256(repr(request.plain_values()).encode())
        for array in request.array_values().values():
            digest.update(repr(array.shape).encode() + array.tobytes())
        self.cells[digest.hexdigest()] = request
        subcells = request.phase.size
        return m.CellRegistered(
            cell=digest.hexdigest(), subcells=subcells, failed_bytes=-(-subcells // 8), history_values=0,
            material_fraction=self.fractions(request),
        )  # fmt: skip

    def areas(self, cell: m.RegisterCell) -> np.ndarray:
        with np.errstate(all="ignore"):
            areas = np.outer(cell.heights / cell.heights.sum(), cell.widths / cell.widths.sum()).reshape(-1)
        if not np.isfinite(areas).all():
            raise ProtocolError("solver_failed", "the sizes of the cell are beyond what can be added", step=0)
        return areas

    def fractions(self, cell: m.RegisterCell) -> np.ndarray:
        return np.bincount(cell.phase.reshape(-1), self.areas(cell), len(cell.materials))

    def cell(self, name: str) -> m.RegisterCell:
        if name not in self.cells:
            raise ProtocolError("unknown_cell", f"no cell {name!r}", field="cell")
        return self.cells[name]

    def constants(self, cell: m.RegisterCell, temperature: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Stiffness, expansion and limit along 1, 2, 3 (of tension alone) of every subcell."""
        found = []
        for material in cell.materials:
            table = material.temperatures
            if len(table) > 1 and not table[0] <= temperature <= table[-1]:
                raise bad("temperature", f"is {temperature} K, allowed is {table[0]} to {table[-1]} K")
            columns = np.hstack([np.array(material.stiffness), np.array(material.expansion)])
            row = [np.interp(temperature, table, column) for column in columns.T]
            limits = [np.inf if value is None else value for f in material.failures for value in f.tension]
            limit = np.min([np.reshape(limits, (-1, 3)).min(axis=0), [np.inf] * 3], axis=0) if limits else [np.inf] * 3
            found.append((np.reshape(row[:36], (6, 6)), np.array(row[36:]), np.array(limit)))
        of = cell.phase.reshape(-1)
        return tuple(np.array(part)[of] for part in zip(*found, strict=True))  # type: ignore[return-value]

    def bits(self, cell: m.RegisterCell, failed: np.ndarray | None, points: int) -> np.ndarray:
        size = cell.phase.size
        if failed is None:
            return np.zeros((points, size), bool)
        if failed.shape[1] != -(-size // 8):
            raise bad("failed", f"has {failed.shape[1]} bytes, must have {-(-size // 8)}")
        bits = np.unpackbits(failed, axis=1, bitorder="little").astype(bool)
        if bits[:, size:].any():
            raise bad("failed", "has bits beyond the subcells")
        return bits[:, :size]

    def state_of(self, request: m.LocaliseRequest) -> tuple[m.RegisterCell, np.ndarray]:
        cell = self.cell(request.cell)
        if request.history is not None and request.history.shape[1]:
            raise bad("history", f"has {request.history.shape[1]} values, must have none")
        return cell, self.bits(cell, request.failed, len(request.strain))

    def subcell_stress(self, cell: m.RegisterCell, request: Any, bits: np.ndarray, rows: slice) -> np.ndarray:
        stiffness, expansion, _ = self.constants(cell, request.temperature)
        change = request.temperature - cell.stress_free_temperature
        strain = request.strain[rows, None, :] - expansion * change
        stress = (stiffness @ strain[..., None])[..., 0]
        return stress * np.where(bits[rows], cell.knock_down, 1.0)[..., None]

    def evaluate(self, request: m.EvaluateRequest) -> m.Evaluated:
        cell, bits = self.state_of(request)
        before, shares = bits.sum(), self.areas(cell)
        stiffness, _, limit = self.constants(cell, request.temperature)
        stress, bits = np.zeros_like(request.strain), bits.copy()
        for start in range(0, len(stress), CHUNK):
            self.activity.progress(start, len(stress), "points")
            if self.compute_first is not None:
                self.compute_first(self)
            rows = slice(start, start + CHUNK)
            with np.errstate(all="ignore"):
                bits[rows] |= (self.subcell_stress(cell, request, bits, rows)[..., :3] > limit).any(axis=-1)
                # One point at a time, so that no sum depends on how many there are.
                for point in range(start, min(start + CHUNK, len(stress))):
                    one = self.subcell_stress(cell, request, bits, slice(point, point + 1))[0]
                    stress[point] = (shares[:, None] * one).sum(axis=0)
        if not np.isfinite(stress).all():
            raise ProtocolError("solver_failed", "stress is not finite", step=0)
        rows_of: dict[bytes, int] = {}
        index = np.array([rows_of.setdefault(row.tobytes(), len(rows_of)) for row in bits], np.int64)
        masks = np.array([np.frombuffer(row, bool) for row in rows_of]).reshape(-1, cell.phase.size)
        with np.errstate(all="ignore"):
            tangents = [(shares * np.where(mask, cell.knock_down, 1.0)) for mask in masks]
            table = np.array([(one[:, None, None] * stiffness).sum(axis=0) for one in tangents]).reshape(-1, 6, 6)
        # Masks of subcells with equal shares have equal tangents, of which the table has only one.
        values: dict[bytes, int] = {}
        rename = np.array([values.setdefault(one.tobytes(), len(values)) for one in table], np.int64)
        table = np.array([np.frombuffer(one).reshape(6, 6) for one in values]).reshape(-1, 6, 6)
        return m.Evaluated(
            stress=stress, failed=np.packbits(bits, axis=1, bitorder="little"),
            history=np.zeros((len(bits), 0)), tangent_index=rename[index] if request.want_tangent else None,
            tangents=table if request.want_tangent else None, new_failures=int(bits.sum() - before),
        )  # fmt: skip

    def localise(self, request: m.LocaliseRequest) -> m.Localised:
        cell, bits = self.state_of(request)
        stress = self.subcell_stress(cell, request, bits, slice(None))
        strain = np.broadcast_to(request.strain[:, None, :], stress.shape)
        return m.Localised(stress=stress, strain=strain)

    def properties(self, request: m.CellPropertiesRequest) -> m.CellProperties:
        cell = self.cell(request.cell)
        bits = self.bits(cell, None if request.failed is None else request.failed[None], 1)[0]
        stiffness, expansion, _ = self.constants(cell, request.temperature)
        weighted = (self.areas(cell) * np.where(bits, cell.knock_down, 1.0))[:, None, None] * stiffness
        whole = weighted.sum(axis=0)
        return m.CellProperties(
            stiffness=whole, expansion=np.linalg.solve(whole, np.einsum("nij,nj->i", weighted, expansion)),
            material_fraction=self.fractions(cell),
        )  # fmt: skip


def inside(position: np.ndarray, box: c.Rectangle) -> np.ndarray:
    return inside_box(position, np.array(box.lower), np.array(box.upper))


def inside_box(position: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    return ((position[:, :2] >= lower[:2]) & (position[:, :2] <= upper[:2])).all(axis=1)


def compute_without_lock(seconds: float) -> Any:
    """Return work of about `seconds` that holds one core but not the interpreter lock."""

    def work(service: Service) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            service.activity.progress(0, 1, "hashing")
            hashlib.pbkdf2_hmac("sha256", b"toy", b"salt", 50_000)

    return work


def hold_lock(seconds: int) -> Any:
    """Return work that keeps the interpreter lock for `seconds`: no thread of this process runs meanwhile."""

    def work(service: Service) -> None:
        ctypes.PyDLL(None).sleep(seconds)

    return work


TOYS: dict[str, type[Toy]] = {
    "continuum": ToyContinuum,
    "atomistic": ToyAtomistic,
    "micromechanics": ToyMicromechanics,
}


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("role", choices=sorted(TOYS))
    parser.add_argument("endpoint")
    parser.add_argument("--noise", type=float, default=0.0)
    parser.add_argument("--parent", type=int)
    parser.add_argument("--limit", type=int, default=1 << 30)
    parser.add_argument("--compute", type=float, default=0.0)
    parser.add_argument("--hold", type=int, default=0)
    parser.add_argument("--keys", type=Path)
    parser.add_argument("--most-steps", type=int, default=MOST_STEPS)
    options = parser.parse_args()
    service = TOYS[options.role](options.noise)
    service.most_steps = options.most_steps
    if options.compute:
        service.compute_first = compute_without_lock(options.compute)
    if options.hold:
        service.compute_first = hold_lock(options.hold)
    server = Server(
        service, options.endpoint, keys=options.keys, max_message_bytes=options.limit, parent=options.parent
    )
    server.run(lambda endpoint: print(endpoint, flush=True))


if __name__ == "__main__":
    main()
