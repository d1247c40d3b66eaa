"""A service of the role `atomistic`, written from protocol/SPEC.md alone: python foreign_atomistic.py ENDPOINT.

It shares no line with scalebridge and needs only pyzmq, msgpack and numpy, as a third party's service would. The
physics is a hexagonal lattice of strictly harmonic nearest-neighbour springs in the plane: constants are exact at
every temperature, so a coupled run can be held against them.

Units are SI throughout. Arrays of points have three columns on the wire and two inside; the atoms stay in z = 0.
"""

from __future__ import annotations

import ipaddress
import math
import sys
import threading
import time
import traceback
import uuid
from collections import OrderedDict, deque
from collections.abc import Callable
from typing import Any

import msgpack
import numpy as np
import zmq

VERSION = [1, 0]
ROLE = "atomistic"
BACKEND = "foreign_lattice"
BACKEND_VERSION = "1.0"
MAX_MESSAGE = 2**26
MAX_HEADER = 2**24
MAX_ATOMS = 200_000
MAX_IVCS = 1_000_000
KEPT_REPLIES = 4
KEPT_IDS = 4096
BOLTZMANN = 1.380649e-23

SPRING = 60.0  # N/m
BOND = 2.0e-10  # m
MASS = 1.8e-26  # kg
THICKNESS = 3.35e-10  # m
AREA_PER_ATOM = math.sqrt(3) / 2 * BOND**2

CAPABILITIES = {
    "fields": ["position", "displacement", "velocity", "stress"],
    "force_fields": ["harmonic"],
    "materials": ["hexagonal"],
}
DTYPES: dict[str, np.dtype[Any]] = {"<f8": np.dtype("<f8"), "<i8": np.dtype("<i8"), "|u1": np.dtype("|u1")}


class RequestError(Exception):
    """An answer of kind `error`."""

    def __init__(self, code: str, sentence: str, field: str = "", step: int | None = None) -> None:
        super().__init__(sentence)
        self.body: dict[str, Any] = {"code": code, "sentence": sentence, "field": field, "origin": f"{ROLE} {BACKEND}"}
        if step is not None:
            self.body["step"] = step


def dotted(version: list[int]) -> str:
    return f"{version[0]}.{version[1]}"


def bad(field: str, sentence: str) -> RequestError:
    return RequestError("bad_field", f"{field}: {sentence}", field)


# ------------------------------------------------------------------------------------------------------------ physics


class HarmonicLattice:
    """Atoms, their springs, the anchors that hold some of them, and velocity Verlet."""

    def __init__(self, sample: dict[str, Any], temperature: float, time_step: float, seed: int) -> None:
        spacing = sample["lattice_constant"] or BOND
        row_height = spacing * math.sqrt(3) / 2
        columns = max(1, round(sample["width"] / spacing))
        rows = 2 * max(1, round(sample["height"] / (2 * row_height)))
        row, column = np.divmod(np.arange(rows * columns), columns)
        sites = np.stack([(column + 0.5 * (row % 2)) * spacing, row * row_height], axis=1)
        sites -= sites.mean(axis=0)
        bonds = self._neighbours(rows, columns)
        kept = np.ones(len(sites), dtype=bool)
        self.crack_tip: float | None = None
        if sample["crack"] is not None:
            tip, height = sample["crack"]
            # One row is enough: the rows above and below it are no nearest neighbours.
            kept = ~((sites[:, 0] < tip) & (row == round((height - sites[0, 1]) / row_height)))
            self.crack_tip = float(sites[~kept, 0].max(initial=sites[:, 0].min()))
        renumber = np.cumsum(kept) - 1
        self.bonds = renumber[bonds[kept[bonds].all(axis=1)]]
        self.built = np.ascontiguousarray(sites[kept])
        self.ids = np.flatnonzero(kept).astype(np.int64) + 1
        along = self.built[self.bonds[:, 1]] - self.built[self.bonds[:, 0]]
        self.direction = along / spacing
        self.prestretch = spacing - BOND

        self.temperature, self.time_step = temperature, time_step
        self.noise_key = int(np.random.SeedSequence(seed).generate_state(1, np.uint64)[0])
        self.position = self.built.copy()
        self.velocity = self._thermal_velocities()
        self.step = 0
        self.work = 0.0
        self.anchor([], np.zeros((0, 3)), np.zeros(0, dtype=np.int64), np.zeros(0), None)

    @staticmethod
    def _neighbours(rows: int, columns: int) -> np.ndarray:
        site = np.arange(rows * columns).reshape(rows, columns)
        pairs = [np.stack([site[:, :-1].ravel(), site[:, 1:].ravel()], axis=1)]
        for row in range(rows - 1):
            low, high = site[row], site[row + 1]
            pairs.append(np.stack([low, high], axis=1))
            if row % 2:
                pairs.append(np.stack([low[:-1], high[1:]], axis=1))
            else:
                pairs.append(np.stack([low[1:], high[:-1]], axis=1))
        return np.concatenate(pairs)

    def _thermal_velocities(self) -> np.ndarray:
        # Twice the temperature: half of it goes into the springs, which start unstrained.
        scale = math.sqrt(2 * BOLTZMANN * self.temperature / MASS)
        velocity = scale * np.random.Generator(np.random.Philox(key=[self.noise_key, 2**63])).standard_normal(
            self.built.shape
        )
        return velocity - velocity.mean(axis=0)

    def anchor(
        self, rows: Any, position: np.ndarray, ivc: np.ndarray, stiffness: np.ndarray, damping_time: float | None
    ) -> None:
        """Tie atom `rows[i]` to `position[i]`, instead of all anchors before."""
        self.tied = np.asarray(rows, dtype=np.int64)
        self.held, self.carried = position, np.zeros_like(position)
        self.ivc, self.ivcs = ivc, int(ivc.max()) + 1 if len(ivc) else 0
        self.stiffness = stiffness[:, None]
        self.friction = MASS / damping_time if damping_time else 0.0
        self.reference = np.zeros_like(position)
        self.window_deviation = np.zeros((self.ivcs, 3))
        self.window_steps = 1

    def _lattice_force(self) -> np.ndarray:
        moved = self.position - self.built
        stretch = self.stretch(moved)
        pull = SPRING * stretch[:, None] * self.direction
        first, second, atoms = self.bonds[:, 0], self.bonds[:, 1], len(self.built)
        force = np.empty_like(moved)
        for c in (0, 1):
            force[:, c] = np.bincount(first, pull[:, c], atoms) - np.bincount(second, pull[:, c], atoms)
        return force

    def stretch(self, moved: np.ndarray) -> np.ndarray:
        """Elongation of each spring over its rest length, m: linear in the displacements `moved` (atoms, 2)."""
        relative = moved[self.bonds[:, 1]] - moved[self.bonds[:, 0]]
        return np.einsum("bc,bc->b", relative, self.direction) + self.prestretch

    def _noise(self) -> np.ndarray:
        if not (self.friction and self.temperature):
            return np.zeros((len(self.tied), 2))
        random = np.random.Generator(np.random.Philox(key=[self.noise_key, self.step]))
        scale = math.sqrt(2 * self.friction * BOLTZMANN * self.temperature / self.time_step)
        return scale * random.standard_normal((len(self.tied), 2))

    def reaction(self) -> np.ndarray:
        """Force of springs and dampers on the continuum, (anchors, 3) in N."""
        force = -self.stiffness * self.held - self.friction * self.carried
        force[:, :2] += self.stiffness * self.position[self.tied] + self.friction * self.velocity[self.tied]
        return force

    def integrate(self, steps: int, check: Callable[[], None]) -> np.ndarray:
        """Advance `steps` steps, anchors held; mean reaction over the states that the steps end in."""
        dt, tied, carried = self.time_step, self.tied, self.carried[:, :2]
        total = np.zeros((len(tied), 3))
        external = self._noise() - self.reaction()[:, :2]
        force = self._lattice_force()
        force[tied] += external
        implicit = np.ones((len(self.built), 1))
        implicit[tied] += dt * self.friction / (2 * MASS)
        for _ in range(steps):
            check()
            half = self.velocity + dt / (2 * MASS) * force
            self.position = self.position + dt * half
            self.step += 1
            noise = self._noise()
            force = self._lattice_force()
            force[tied] += self.stiffness * (self.held[:, :2] - self.position[tied]) + self.friction * carried + noise
            # The damper acts on the velocity at the end of the step: solved for, so that it stays of second order.
            self.velocity = (half + dt / (2 * MASS) * force) / implicit
            if not np.isfinite(self.velocity).all():
                raise RequestError(
                    "solver_failed",
                    f"a velocity is not finite at step {self.step}; a smaller time_step or stiffness may help",
                    step=self.step,
                )
            force[tied] -= self.friction * self.velocity[tied]
            reaction = self.reaction()
            after = noise - reaction[:, :2]
            self.work += float(np.sum((external + after) * half[tied])) * dt / 2
            external = after
            total += reaction
        return total / steps

    def by_ivc(self, anchor_force: np.ndarray) -> np.ndarray:
        force = np.zeros((self.ivcs, 3))
        np.add.at(force, self.ivc, anchor_force)
        return force

    def kinetic_temperature(self, rows: np.ndarray | slice = slice(None)) -> float:
        velocity = self.velocity[rows]
        return float(MASS * np.sum(velocity**2) / (velocity.size * BOLTZMANN)) if velocity.size else 0.0

    def potential_energy(self) -> float:
        return float(0.5 * SPRING * np.sum(self.stretch(self.position - self.built) ** 2))

    def field(self, name: str) -> np.ndarray:
        if name == "stress":
            stretch = self.stretch(self.position - self.built)
            n = self.direction
            virial = 0.5 * SPRING * stretch * (BOND + self.prestretch) / (AREA_PER_ATOM * THICKNESS)
            stress = np.zeros((len(self.built), 6))
            for column, component in ((0, n[:, 0] ** 2), (1, n[:, 1] ** 2), (3, n[:, 0] * n[:, 1])):
                for end in (0, 1):
                    stress[:, column] += np.bincount(self.bonds[:, end], virial * component, len(self.built))
            return stress
        plane = {"position": self.position, "velocity": self.velocity, "displacement": self.position - self.built}
        return in_space(plane[name])

    def state(self) -> dict[str, np.ndarray]:
        return {
            "position": self.position,
            "velocity": self.velocity,
            "held": self.held,
            "carried": self.carried,
            "reference": self.reference,
            "window_deviation": self.window_deviation,
            "counters": np.array([self.step, self.window_steps], dtype=np.int64),
            "work": np.array([self.work]),
        }

    def set_state(self, state: dict[str, np.ndarray]) -> None:
        for name in ("position", "velocity", "held", "carried", "reference", "window_deviation"):
            setattr(self, name, state[name].copy())
        self.step, self.window_steps = (int(n) for n in state["counters"])
        self.work = float(state["work"][0])


def in_space(plane: np.ndarray) -> np.ndarray:
    return np.concatenate([plane, np.zeros((len(plane), 1))], axis=1)


# -------------------------------------------------------------------------------------------------- reading of fields


class Fields:
    """Fields of one map of a request; every reader refuses what the tables do not allow."""

    def __init__(self, body: dict[Any, Any], arrays: dict[str, np.ndarray], prefix: str = "") -> None:
        self.body, self.arrays, self.prefix = body, arrays, prefix
        self.sizes: dict[str, tuple[int, str]] = {}

    def _plain(self, name: str, optional: bool) -> Any:
        path = self.prefix + name
        if not self.prefix and any(a == name or a.startswith(name + ".") for a in self.arrays):
            raise bad(path, "is no array, it belongs into the body")
        value = self.body.get(name)
        if value is None and not optional:
            raise bad(path, "is missing")
        return value

    def number(
        self, name: str, *, least: float = -math.inf, above: float = -math.inf, optional: bool = False
    ) -> float | None:
        value, path = self._plain(name, optional), self.prefix + name
        if value is None:
            return None
        try:
            number = math.nan if isinstance(value, bool) or not isinstance(value, int | float) else float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number) or number < least or number <= above:
            rule = f"at least {least}" if least > -math.inf else f"above {above}"
            raise bad(path, f"is {value!r:.80}, must be a finite number {rule}")
        return number

    def real(self, name: str, *, least: float = -math.inf, above: float = -math.inf) -> float:
        value = self.number(name, least=least, above=above)
        assert value is not None
        return value

    def integer(self, name: str, least: int) -> int:
        value = self._plain(name, False)
        if isinstance(value, bool) or not isinstance(value, int) or value < least:
            raise bad(self.prefix + name, f"is {value!r:.80}, must be an integer of at least {least}")
        return value

    def text(self, name: str, allowed: list[str] | None = None) -> str:
        value = self._plain(name, False)
        if not isinstance(value, str) or (allowed is not None and value not in allowed):
            raise bad(self.prefix + name, f"is {value!r:.80}, must be {f'one of {allowed}' if allowed else 'a text'}")
        return value

    def texts(self, name: str, allowed: list[str]) -> list[str]:
        value = self._plain(name, False)
        if not isinstance(value, list) or not value or any(v not in allowed for v in value):
            raise bad(self.prefix + name, f"is {value!r:.80}, must be a list of at least one of {allowed}")
        return value

    def pair(self, name: str) -> list[int]:
        value = self._plain(name, False)
        if (
            not isinstance(value, list)
            or len(value) != 2
            or any(isinstance(v, bool) or not isinstance(v, int) or v < 0 for v in value)
        ):
            raise bad(self.prefix + name, f"is {value!r:.80}, must be a list of two integers of at least 0")
        return value

    def map(self, name: str, optional: bool = False) -> Fields | None:
        value = self._plain(name, optional)
        if value is None:
            return None
        if not isinstance(value, dict):
            raise bad(self.prefix + name, f"is {value!r:.80}, must be a map")
        return Fields(value, {}, f"{self.prefix}{name}.")

    def array(self, name: str, dtype: str, shape: tuple[str | int, ...]) -> np.ndarray:
        if self.body.get(name) is not None:
            raise bad(name, "is an array, it belongs into a frame of its own")
        if name not in self.arrays:
            raise bad(name, "is missing")
        array = self.arrays[name]
        if array.dtype != DTYPES[dtype]:
            raise bad(name, f"has dtype {array.dtype.str}, must be {dtype}")
        if array.ndim != len(shape):
            raise bad(name, f"has {array.ndim} axes, must have {len(shape)}")
        for have, want in zip(array.shape, shape, strict=True):
            size, owner = (want, "its table") if isinstance(want, int) else self.sizes.setdefault(want, (have, name))
            if have != size:
                raise bad(name, f"has shape {list(array.shape)}, must fit {want} = {size} of {owner}")
        if not np.isfinite(array).all():
            raise bad(name, "holds a number that is not finite")
        return array

    def map_of_arrays(self, name: str) -> dict[str, np.ndarray]:
        if self.body.get(name) is not None or name in self.arrays:
            raise bad(name, f"is a map of arrays, each entry belongs into a frame named {name}.ENTRY")
        return {k.removeprefix(name + "."): v for k, v in self.arrays.items() if k.startswith(name + ".")}


# --------------------------------------------------------------------------------------------------------- the service

Reply = tuple[dict[str, Any], dict[str, np.ndarray]]
RUNNING = ("configured", "registered", "ready")
ANY = ("new", *RUNNING, "failed")
Operations = dict[str, tuple[tuple[str, ...], str]]
# type: states in which it is allowed, state to which it leads ("" is the same)
WORK: Operations = {
    "hello": (ANY, ""),
    "properties": (ANY, ""),
    "configure": (ANY, "configured"),
    "register": (RUNNING, "registered"),
    "equilibrate": (("registered", "ready"), "ready"),
    "advance": (("ready",), "ready"),
    "fields": (RUNNING, ""),
    "checkpoint": (("ready",), "ready"),
    "restore": (("registered", "ready"), "ready"),
    "status": (ANY, ""),
    "shutdown": (ANY, ""),
}
CONTROL: Operations = {name: (ANY, "") for name in ("hello", "status", "abort", "shutdown")}


class Service:
    """The problem in work, and one method `do_TYPE` and one `read_TYPE` for each operation."""

    def __init__(self) -> None:
        self.session = uuid.uuid4().hex
        self.control_endpoint = ""
        self.state = "new"
        self.solver: HarmonicLattice | None = None
        self.lock = threading.Lock()
        self.operation, self.began = "", 0.0
        self.done, self.total = 0, 0
        self.requests = 0
        self.aborting = False
        self.stopping = threading.Event()

    @property
    def problem(self) -> HarmonicLattice:
        assert self.solver is not None
        return self.solver

    def begin(self, name: str) -> None:
        with self.lock:
            self.operation, self.began, self.done, self.total = name, time.monotonic(), 0, 0
            self.aborting = self.stopping.is_set()

    def end(self) -> None:
        with self.lock:
            self.operation = ""

    def check(self) -> None:
        self.done += 1
        if self.aborting:
            raise RequestError("aborted", f"the operation was ended at step {self.problem.step}")

    # Each read_TYPE returns the arguments of do_TYPE and must not change the service.

    def read_hello(self, fields: Fields) -> dict[str, Any]:
        versions = fields.map("versions")
        assert versions is not None
        oldest, newest = versions.pair("oldest"), versions.pair("newest")
        role = fields.text("role")
        fields.text("client")
        version = min(newest, VERSION)
        if version < oldest or version < VERSION:
            raise RequestError(
                "version_mismatch",
                f"the client speaks {dotted(oldest)} to {dotted(newest)}, this service speaks {dotted(VERSION)} only",
                "versions",
            )
        if role != ROLE:
            raise RequestError("role_mismatch", f"the client wants role {role!r}, this service is {ROLE!r}", "role")
        return {"version": version}

    def do_hello(self, version: list[int]) -> Reply:
        return {
            "versions": {"oldest": VERSION, "newest": VERSION},
            "version": version,
            "role": ROLE,
            "backend": BACKEND,
            "backend_version": BACKEND_VERSION,
            "capabilities": CAPABILITIES,
            "units": "SI",
            "state": self.state,
            "max_message_bytes": MAX_MESSAGE,
            "control_endpoint": self.control_endpoint,
        }, {}

    def read_properties(self, fields: Fields) -> dict[str, Any]:
        fields.text("force_field", CAPABILITIES["force_fields"])
        fields.text("material", CAPABILITIES["materials"])
        fields.number("temperature", least=0)
        fields.integer("seed", 0)
        return {}

    def do_properties(self) -> Reply:
        # Closed form: the lattice is strictly harmonic, so nothing depends on temperature.
        constants = {"lattice_constant": BOND, "young": 2 / math.sqrt(3) * SPRING / THICKNESS, "poisson": 1 / 3}
        body = constants | {f"{name}_error": 0.0 for name in constants}
        return body | {"density": MASS / (AREA_PER_ATOM * THICKNESS), "thickness": THICKNESS}, {}

    def read_configure(self, fields: Fields) -> dict[str, Any]:
        fields.text("force_field", CAPABILITIES["force_fields"])
        part = fields.map("sample")
        assert part is not None
        part.text("material", CAPABILITIES["materials"])
        sample: dict[str, Any] = {name: part.real(name, above=0) for name in ("width", "height")}
        sample["lattice_constant"] = part.number("lattice_constant", above=0, optional=True)
        cut = part.map("crack", optional=True)
        sample["crack"] = cut and (cut.real("tip_x"), cut.real("y"))
        return {
            "sample": sample,
            "temperature": fields.real("temperature", least=0),
            "time_step": fields.real("time_step", above=0),
            "seed": fields.integer("seed", 0),
        }

    def can_configure(self, sample: dict[str, Any], time_step: float, **_: Any) -> None:
        spacing = sample["lattice_constant"] or BOND
        if not sample["width"] / spacing * (sample["height"] / spacing) < MAX_ATOMS:
            raise RequestError("unsupported", f"sample.width: more than about {MAX_ATOMS} atoms", "sample.width")
        limit = 2 / math.sqrt(6 * SPRING / MASS)  # largest frequency of the lattice: omega^2 = 6 k / m
        if time_step > limit:
            raise bad("time_step", f"is {time_step} s, must be at most {limit:.3g} s, the stable step of the lattice")

    def do_configure(self, sample: dict[str, Any], temperature: float, time_step: float, seed: int) -> Reply:
        self.solver = solver = HarmonicLattice(sample, temperature, time_step, seed)
        arrays = {"atom_id": solver.ids, "position": in_space(solver.built)}
        return {"warnings": []}, arrays | {"atom_mass": np.full(len(solver.ids), MASS)}

    def read_register(self, fields: Fields) -> dict[str, Any]:
        arguments: dict[str, Any] = {
            "atom_id": fields.array("atom_id", "<i8", ("anchors",)),
            "anchor_position": fields.array("anchor_position", "<f8", ("anchors", 3)),
            "anchor_ivc": fields.array("anchor_ivc", "<i8", ("anchors",)),
            "stiffness": fields.array("stiffness", "<f8", ("anchors",)),
            "damping_time": fields.number("damping_time", above=0, optional=True),
        }
        if (arguments["anchor_ivc"] < 0).any():
            raise bad("anchor_ivc", "must not be negative")
        if (arguments["stiffness"] < 0).any():
            raise bad("stiffness", "must not be negative")
        if len(np.unique(arguments["atom_id"])) < len(arguments["atom_id"]):
            raise bad("atom_id", "an atom has at most one anchor")
        return arguments

    def can_register(self, atom_id: np.ndarray, anchor_ivc: np.ndarray, **_: Any) -> None:
        unknown = atom_id[~np.isin(atom_id, self.problem.ids)]
        if len(unknown):
            raise bad("atom_id", f"{unknown[0]} is no atom of the sample, whose ids are in the reply to configure")
        if len(anchor_ivc) and anchor_ivc.max() >= MAX_IVCS:
            raise RequestError("unsupported", f"anchor_ivc: must be below {MAX_IVCS}", "anchor_ivc")

    def do_register(
        self,
        atom_id: np.ndarray,
        anchor_position: np.ndarray,
        anchor_ivc: np.ndarray,
        stiffness: np.ndarray,
        damping_time: float | None,
    ) -> Reply:
        rows = np.searchsorted(self.problem.ids, atom_id)
        self.problem.anchor(rows, anchor_position, anchor_ivc, stiffness, damping_time)
        return {"ivcs": self.problem.ivcs}, {}

    def read_equilibrate(self, fields: Fields) -> dict[str, Any]:
        return {
            name: fields.integer(name, least) for name, least in (("steps", 0), ("windows", 1), ("window_steps", 1))
        }

    def do_equilibrate(self, steps: int, windows: int, window_steps: int) -> Reply:
        solver = self.problem
        self.total = steps + windows * window_steps
        solver.carried = np.zeros_like(solver.held)
        if steps:
            solver.integrate(steps, self.check)
        mean, temperature = np.zeros_like(solver.held), 0.0
        ivc_mean, spread = np.zeros((solver.ivcs, 3)), np.zeros((solver.ivcs, 3))
        for window in range(1, windows + 1):
            force = solver.integrate(window_steps, self.check)
            mean += (force - mean) / window
            ivc_force = solver.by_ivc(force)
            change = ivc_force - ivc_mean
            ivc_mean += change / window
            spread += change * (ivc_force - ivc_mean)
            temperature += (solver.kinetic_temperature() - temperature) / window
        deviation = np.sqrt(spread / max(1, windows - 1))
        solver.reference, solver.window_deviation, solver.window_steps = mean, deviation, window_steps
        return {"temperature": temperature}, {
            "reference_ivc_force": solver.by_ivc(mean),
            "reference_ivc_error": deviation / math.sqrt(windows),
            "window_ivc_deviation": deviation,
        }

    def read_advance(self, fields: Fields) -> dict[str, Any]:
        if self.solver is not None and self.state in ("registered", "ready"):
            fields.sizes["anchors"] = (len(self.solver.tied), "register")
        return {
            "steps": fields.integer("steps", 1),
            "anchor_position": fields.array("anchor_position", "<f8", ("anchors", 3)),
            "anchor_velocity": fields.array("anchor_velocity", "<f8", ("anchors", 3)),
        }

    def do_advance(self, steps: int, anchor_position: np.ndarray, anchor_velocity: np.ndarray) -> Reply:
        solver = self.problem
        self.total = steps
        solver.held, solver.carried = anchor_position, anchor_velocity
        force = solver.integrate(steps, self.check) - solver.reference
        stretched = anchor_position - in_space(solver.position[solver.tied])
        along = solver.position[solver.bonds[:, 1]] - solver.position[solver.bonds[:, 0]]
        body: dict[str, Any] = {
            "step": solver.step,
            "temperature": solver.kinetic_temperature(),
            "handshake_temperature": solver.kinetic_temperature(solver.tied),
            "potential_energy": solver.potential_energy(),
            "kinetic_energy": float(0.5 * MASS * np.sum(solver.velocity**2)),
            "spring_energy": float(0.5 * np.sum(solver.stiffness * stretched**2)),
            "anchor_work": solver.work,
            "broken_bonds": 0,
            "crack_tip": solver.crack_tip,
            "longest_bond": float(np.linalg.norm(along, axis=1).max(initial=0.0)),
            "warnings": [],
        }
        return body, {
            "anchor_force": force,
            "ivc_force": solver.by_ivc(force),
            "ivc_standard_error": solver.window_deviation * math.sqrt(solver.window_steps / steps),
        }

    def read_fields(self, fields: Fields) -> dict[str, Any]:
        return {"names": fields.texts("names", CAPABILITIES["fields"])}

    def do_fields(self, names: list[str]) -> Reply:
        return {"step": self.problem.step}, {f"fields.{name}": self.problem.field(name) for name in names}

    def do_checkpoint(self) -> Reply:
        return {"step": self.problem.step}, {f"state.{k}": v for k, v in self.problem.state().items()}

    def read_restore(self, fields: Fields) -> dict[str, Any]:
        return {"step": fields.integer("step", 0), "state": fields.map_of_arrays("state")}

    def can_restore(self, step: int, state: dict[str, np.ndarray]) -> None:
        present = self.problem.state()
        if set(state) != set(present):
            raise bad("state", f"has the entries {sorted(state)}, must have {sorted(present)}")
        for name, array in present.items():
            given = state[name]
            if (given.dtype, given.shape) != (array.dtype, array.shape):
                raise bad(
                    f"state.{name}", f"is {given.dtype.str} {given.shape}, must be {array.dtype.str} {array.shape}"
                )
        if step != state["counters"][0]:
            raise bad("step", f"is {step}, must be {state['counters'][0]}, the step of the checkpoint")

    def do_restore(self, step: int, state: dict[str, np.ndarray]) -> Reply:
        self.problem.set_state(state)
        return {"step": step}, {}

    def do_status(self) -> Reply:
        with self.lock:
            operation, seconds = self.operation, time.monotonic() - self.began
        with open("/proc/self/statm") as file:
            memory = int(file.read().split()[1]) * 4096
        return {
            "state": self.state,
            "step": self.solver.step if self.solver else 0,
            "operation": operation,
            "done": self.done if operation else 0,
            "total": self.total if operation else 0,
            "note": f"{operation}: step {self.done} of {self.total}" if operation else "idle",
            "operation_seconds": seconds if operation else 0.0,
            "requests": self.requests,
            "memory_bytes": memory,
        }, {}

    def do_abort(self) -> Reply:
        with self.lock:
            self.aborting = bool(self.operation)
            return {"operation": self.operation}, {}

    def do_shutdown(self) -> Reply:
        with self.lock:
            self.stopping.set()
            self.aborting = True
            return {"operation": "" if self.operation == "shutdown" else self.operation}, {}

    def run(self, name: str, leads_to: str, states: tuple[str, ...], fields: Fields) -> Reply:
        """Check a request in the order of section 6 and run it."""
        read: Callable[[Fields], dict[str, Any]] = getattr(self, f"read_{name}", lambda fields: {})
        arguments = read(fields)
        if self.state not in states:
            raise RequestError(
                "wrong_state", f"{name}: the service is {self.state!r}, this is allowed when {' or '.join(states)}"
            )
        getattr(self, f"can_{name}", lambda **arguments: None)(**arguments)
        try:
            with np.errstate(all="ignore"):
                reply = getattr(self, f"do_{name}")(**arguments)
            if name not in ("fields", "checkpoint"):
                numbers = [v for v in reply[0].values() if isinstance(v, float)]
                if not (np.isfinite(numbers).all() and all(np.isfinite(a).all() for a in reply[1].values())):
                    raise RequestError("solver_failed", f"a result of {name} is not finite", step=self.problem.step)
        except Exception as error:
            refused = isinstance(error, RequestError) and error.body["code"] == "bad_field"
            if leads_to and not refused:
                self.state = "new" if name == "configure" else "failed"
            raise
        self.state = leads_to or self.state
        return reply


# ------------------------------------------------------------------------------------------------------------- wire


def read_header(frame: bytes) -> dict[str, Any]:
    try:
        header = msgpack.unpackb(frame, strict_map_key=False, ext_hook=_refuse_extension)
    except Exception as error:
        raise RequestError("malformed_message", f"the header is no msgpack map: {error!r:.200}") from None
    if not isinstance(header, dict):
        raise RequestError("malformed_message", f"the header is a {type(header).__name__}, must be a map")
    return header


def _refuse_extension(code: int, data: bytes) -> None:
    raise ValueError(f"extension type {code}")


def is_count(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


def is_step(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and -(2**63) <= value < 2**63


HEADER: dict[str, tuple[Callable[[Any], bool], Any]] = {
    "protocol": (lambda v: isinstance(v, list) and len(v) == 2 and all(map(is_count, v)), None),
    "kind": (lambda v: v == "request", None),
    "type": (lambda v: isinstance(v, str) and len(v) <= 64, None),
    "id": (lambda v: isinstance(v, str) and 1 <= len(v) <= 64, None),
    "run": (lambda v: isinstance(v, str) and len(v) <= 128, ""),
    "session": (lambda v: isinstance(v, str) and len(v) <= 64, ""),
    "step": (is_step, 0),
    "seconds": (lambda v: isinstance(v, int | float) and not isinstance(v, bool) and math.isfinite(v), 0.0),
    "body": (lambda v: isinstance(v, dict) and all(isinstance(k, str) for k in v), {}),
    "arrays": (lambda v: isinstance(v, list) and len(v) <= 256, []),
}


def readable(header: dict[str, Any]) -> dict[str, Any]:
    """What a reply repeats, as far as the header lets it be read."""
    echo = {"type": "", "id": "?", "run": "", "step": 0}
    return {name: header[name] if name in header and HEADER[name][0](header[name]) else echo[name] for name in echo}


def check_header(header: dict[str, Any]) -> dict[str, Any]:
    whole = {}
    for name, (allowed, default) in HEADER.items():
        value = header.get(name, default)
        if value is None or not allowed(value):
            raise RequestError("malformed_message", f"header key {name} is {value!r:.80}", name)
        whole[name] = value
    return whole


def read_arrays(table: list[Any], frames: list[bytes]) -> dict[str, np.ndarray]:
    if len(table) != len(frames):
        raise RequestError("malformed_message", f"the table has {len(table)} arrays, {len(frames)} frames follow")
    arrays: dict[str, np.ndarray] = {}
    for k, (entry, frame) in enumerate(zip(table, frames, strict=True)):
        name, dtype, shape, order = (
            entry.get(key) if isinstance(entry, dict) else None for key in ("name", "dtype", "shape", "order")
        )
        if not isinstance(name, str) or name in arrays:
            raise RequestError("malformed_message", f"arrays.{k}.name is {name!r:.80}, must be a text used once")
        if not isinstance(dtype, str) or dtype not in DTYPES or order != "C":
            raise RequestError("malformed_message", f"{name} has dtype {dtype!r:.80}, order {order!r:.80}")
        if not isinstance(shape, list) or len(shape) > 8 or not all(map(is_count, shape)):
            raise RequestError("malformed_message", f"{name} has shape {shape!r:.80}")
        if math.prod(shape) * DTYPES[dtype].itemsize != len(frame):
            raise RequestError("malformed_message", f"{name} of shape {shape} has a frame of {len(frame)} bytes")
        arrays[name] = np.frombuffer(frame, DTYPES[dtype]).reshape(shape).copy()
    return arrays


def write(service: Service, echo: dict[str, Any], kind: str, seconds: float, reply: Reply) -> list[bytes]:
    body, arrays = reply
    table, frames = [], []
    for name, array in arrays.items():
        table.append({"name": name, "dtype": array.dtype.str, "shape": list(array.shape), "order": "C"})
        frames.append(np.ascontiguousarray(array).tobytes())
    header = {"protocol": VERSION, "kind": kind, "session": service.session, "seconds": seconds, **echo}
    return [msgpack.packb({**header, "body": body, "arrays": table}), *frames]


class Memory:
    """Exactly once: the last replies and ids of one socket."""

    def __init__(self) -> None:
        self.ids: OrderedDict[str, tuple[str, int]] = OrderedDict()
        self.replies: deque[tuple[str, list[bytes]]] = deque(maxlen=KEPT_REPLIES)

    def recall(self, echo: dict[str, Any]) -> list[bytes] | None:
        known = self.ids.get(echo["id"])
        if known is None:
            return None
        if known != (echo["type"], echo["step"]):
            raise RequestError("request_id_reused", f"id {echo['id']!r} was a {known[0]} of step {known[1]}", "id")
        for request_id, frames in self.replies:
            if request_id == echo["id"]:
                return frames
        raise RequestError("request_expired", f"id {echo['id']!r} was answered before, the answer is gone", "id")

    def keep(self, echo: dict[str, Any], frames: list[bytes]) -> None:
        self.ids[echo["id"]] = (echo["type"], echo["step"])
        self.replies.append((echo["id"], frames))
        if len(self.ids) > KEPT_IDS:
            self.ids.popitem(last=False)


class Endpoint:
    """Answers the requests of one socket, one at a time."""

    def __init__(self, service: Service, operations: Operations, works: bool) -> None:
        self.service, self.operations, self.works = service, operations, works
        self.memory = Memory()

    def answer(self, frames: list[bytes]) -> list[bytes]:
        began = time.monotonic()
        echo, remember, header = readable({}), False, {}
        try:
            if frames and len(frames[0]) <= MAX_HEADER:
                header = read_header(frames[0])
                echo = readable(header)
            if sum(map(len, frames)) > MAX_MESSAGE:
                raise RequestError("message_too_large", f"the message is larger than {MAX_MESSAGE} bytes")
            if not frames or len(frames[0]) > MAX_HEADER:
                raise RequestError("malformed_message", f"the message has no header of at most {MAX_HEADER} bytes")
            header = check_header(header)
            arrays = read_arrays(header["arrays"], frames[1:])
            if header["type"] != "hello" and header["protocol"][0] != VERSION[0]:
                raise RequestError(
                    "version_mismatch",
                    f"the message is of {dotted(header['protocol'])}, this service speaks {dotted(VERSION)}",
                    "protocol",
                )
            kept = self.memory.recall(echo)
            if kept is not None:
                return kept
            remember = True
            if header["type"] not in self.operations:
                raise RequestError("unknown_type", f"no operation {header['type']!r} here, but {list(self.operations)}")
            reply = self.run(header["type"], Fields(header["body"], arrays))
            kind = "reply"
            if sum(a.nbytes for a in reply[1].values()) + 4096 > MAX_MESSAGE:
                raise RequestError("message_too_large", f"the reply is larger than {MAX_MESSAGE} bytes")
        except RequestError as error:
            kind, reply = "error", (error.body, {})
        except Exception as error:
            tail = "".join(traceback.format_exc().splitlines(keepends=True)[-8:])
            body = RequestError("internal", f"a defect of the service: {error!r:.200}").body
            kind, reply = "error", (body | {"traceback_tail": tail}, {})
        self.service.requests += 1
        answer = write(self.service, echo, kind, time.monotonic() - began, reply)
        if remember:
            self.memory.keep(echo, answer)
        return answer

    def run(self, name: str, fields: Fields) -> Reply:
        states, leads_to = self.operations[name]
        if not self.works or name == "status":  # a status is no work
            return self.service.run(name, leads_to, states, fields)
        self.service.begin(name)
        try:
            return self.service.run(name, leads_to, states, fields)
        finally:
            self.service.end()

    def serve(self, socket: zmq.Socket[bytes]) -> None:
        while not self.service.stopping.is_set():
            if not socket.poll(50):
                continue
            route, *frames = socket.recv_multipart()
            delimiter = [b""] if len(frames) > 1 and not frames[0] else []
            socket.send_multipart([route, *delimiter, *self.answer(frames[len(delimiter) :])])
        socket.close(linger=2000)


def bind(context: zmq.Context[zmq.Socket[bytes]], endpoint: str) -> zmq.Socket[bytes]:
    scheme, _, address = endpoint.partition("://")
    host = address.rpartition(":")[0].strip("[]")
    if scheme != "ipc" and not (scheme == "tcp" and (host == "localhost" or ipaddress.ip_address(host).is_loopback)):
        raise SystemExit(f"{endpoint}: only ipc and loopback addresses, this service has no keys")
    socket = context.socket(zmq.ROUTER)
    for option, value in (
        (zmq.ROUTER_HANDOVER, 1),
        (zmq.HEARTBEAT_IVL, 200),
        (zmq.HEARTBEAT_TIMEOUT, 800),
        (zmq.HEARTBEAT_TTL, 800),
        (zmq.MAXMSGSIZE, 2 * MAX_MESSAGE),
    ):
        socket.setsockopt(option, value)
    socket.bind(endpoint)
    return socket


def main(endpoint: str) -> None:
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    service = Service()
    control = bind(context, f"{endpoint}.control" if endpoint.startswith("ipc") else f"{endpoint.rpartition(':')[0]}:*")
    service.control_endpoint = control.getsockopt_string(zmq.LAST_ENDPOINT)
    work = bind(context, endpoint)
    control_thread = threading.Thread(target=Endpoint(service, CONTROL, works=False).serve, args=(control,))
    control_thread.start()
    Endpoint(service, WORK, works=True).serve(work)
    control_thread.join()
    context.term()


if __name__ == "__main__":
    if len(sys.argv) != 2:
        raise SystemExit("usage: python foreign_atomistic.py ENDPOINT")
    main(sys.argv[1])
