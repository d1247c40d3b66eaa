"""The whole body of a scene as one sample of atoms: what the coupled run is compared with."""

from __future__ import annotations

import math
import resource
import time
import uuid
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from coordinator.applied_load import STRAIN, load_of
from coordinator.atomistic_request import FEWEST_WINDOWS
from coordinator.continuum_request import continuum_request, elastic_constants, material_of, thickness_of
from coordinator.edge_motion import EdgeMotion, edge_beyond, k_field_displacement
from coordinator.elements import numbers_of
from coordinator.launcher import Services
from coordinator.output import versions
from coordinator.results import ResultsWriter
from coordinator.scene import Scene
from coordinator.table import Point
from coordinator.wave_speed import sub_steps
from protocol import atomistic as a
from protocol import continuum as c
from protocol.arrays import FloatArray
from protocol.client import Client
from protocol.messages import FieldsReply, FieldsRequest

#: Depth of the strips of atoms beyond moved edges, m: beyond the reach of short-ranged potentials.
GRIP: Final = 8e-10
#: Stiffness of the anchors of damped atoms, N/m: they are there for their dampers, not to hold.
SLACK: Final = 1e-9
#: Displacement of every atom at the start of a run is known to the continuum within its body, less this part of a cell.
_INSIDE: Final = 1e-6


class NotComparable(ValueError):
    """A scene whose body cannot be made of atoms alone."""


@dataclass(frozen=True)
class WholeBody:
    """The sample that stands for a body, and its size.

    Attributes
    ----------
    scene : Scene
    lower, upper : tuple of float
        Corners of the sample as it is asked for, with the strips beyond moved edges, m.
    """

    scene: Scene
    lower: Point
    upper: Point

    @property
    def middle(self) -> Point:
        """Origin of the sample in the scene, m."""
        return 0.5 * (self.lower[0] + self.upper[0]), 0.5 * (self.lower[1] + self.upper[1])

    @property
    def size(self) -> Point:
        """Extent along x and y, m."""
        return self.upper[0] - self.lower[0], self.upper[1] - self.lower[1]

    def request(self, lattice_constant: float | None) -> a.AtomisticConfigure:
        """Return the sample as the coupled run's atoms are, but as large as the body."""
        table, crack = self.scene.atomistic, self.scene.crack
        assert table is not None  # held by `whole_body`
        cut = None
        if crack is not None:
            cut = a.CrackCut(tip_x=crack.tip_x - self.middle[0], y=crack.y - self.middle[1])
        own = table.commands
        return a.AtomisticConfigure(
            force_field=table.force_field,
            sample=a.Sample(
                material=table.material, width=self.size[0], height=self.size[1], lattice_constant=lattice_constant,
                crack=cut, layers=table.layers, orientation=table.orientation,
            ),
            temperature=table.temperature,
            time_step=table.time_step,
            seed=self.scene.run.seed,
            commands=None
            if own is None
            else a.ForceFieldCommands(unit_style=own.unit_style, atom_style=own.atom_style, commands=own.lines),
        )  # fmt: skip


def whole_body(scene: Scene) -> WholeBody:
    """Return the body of a scene as a sample of atoms.

    Raises
    ------
    NotComparable
        Names what of the scene atoms alone cannot have.
    """
    body, crack = scene.continuum, scene.crack
    if scene.atomistic is None:
        raise NotComparable("the scene has no [atomistic], so there is nothing to build the body of")
    problem = ""
    if scene.atomistic.sample is not None:
        problem = "atomistic.sample is given: a sample of a file cannot be made larger"
    elif body.cracks:
        problem = "continuum.cracks are given: only the one of [crack] can be cut into atoms"
    elif crack is not None and crack.start_x is not None:
        problem = "crack.start_x is given: only a crack from the left edge can be cut into atoms"
    elif crack is not None and crack.tip_x <= body.lower[0]:
        problem = "crack.tip_x lies left of the body"
    elif body.body_force is not None:
        problem = "continuum.body_force is given: atoms have none"
    elif not any(edge.moves for edge in body.edges):
        problem = "continuum.edges has none whose motion is prescribed: nothing would hold the atoms"
    for edge in body.edges:
        if not edge.moves and edge.kind != "absorbing":
            problem = f"the {edge.edge} edge has a {edge.kind}: atoms beyond an edge can only follow prescribed places"
    if problem:
        raise NotComparable(f"{problem}; the full atomistic run is for a scene without it")
    moved = {edge.edge for edge in body.edges if edge.moves}
    grown = {side: GRIP if side in moved else 0.0 for side in ("left", "right", "bottom", "top")}
    return WholeBody(
        scene,
        (body.lower[0] - grown["left"], body.lower[1] - grown["bottom"]),
        (body.upper[0] + grown["right"], body.upper[1] + grown["top"]),
    )


@dataclass(frozen=True)
class Cost:
    """What a run took.

    Attributes
    ----------
    wall_seconds : float
        From the start of the services to their end.
    processor_seconds : float
        Of the coordinator and of all services.
    """

    wall_seconds: float
    processor_seconds: float


class Stopwatch:
    """Wall and processor time since it was made; services count once they have ended."""

    def __init__(self) -> None:
        self._began, self._used = time.perf_counter(), _processor_seconds()

    def read(self) -> Cost:
        """Return the time since the start."""
        return Cost(time.perf_counter() - self._began, _processor_seconds() - self._used)


def _processor_seconds() -> float:
    both = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(used.ru_utime + used.ru_stime for used in both)


class FullAtomisticRun:
    """The body of a scene as atoms alone, loaded along its edges as the scene says.

    Atoms beyond the edges that the scene moves follow prescribed places (passive anchors). Where the continuum
    of the scene is damped, so are the atoms in its place, by the same rate and against rest, which above 0 K is the
    friction of a Langevin thermostat; a bath that the scene keeps on its atoms is kept here as well. Without either the
    energy of the body is its own once the run has begun.

    Parameters
    ----------
    body : WholeBody
    folder : Path
    properties : Properties or None
        Constants of the potential, as the coupled run measured them; None where the scene gives the material.
    exchange_steps : int
        M of the coupled run: steps between two rows of the results.
    tell : callable
        Told in words what is being done.
    """

    def __init__(
        self,
        body: WholeBody,
        folder: Path,
        properties: a.Properties | None,
        exchange_steps: int,
        tell: Callable[[str], None],
    ) -> None:
        self.scene = body.scene
        self.held: list[str] = []
        self.atoms = 0
        self._body = body
        self._folder = folder
        self._properties = properties
        self._material = isotropic_of(body.scene, properties)
        self._steps = exchange_steps
        self._tell = tell

    @property
    def _damping_rate(self) -> float:
        return self.scene.continuum.damping_rate + self.scene.continuum.point_damping_rate

    @property
    def time_step(self) -> float:
        """Time between two rows, s."""
        assert self.scene.atomistic is not None
        return self._steps * self.scene.atomistic.time_step

    def run(self, command: str) -> Cost:
        """Run to the end, or to the growth at which the scene stops; results are in `results.h5` of the folder."""
        assert self.scene.atomistic is not None
        self._folder.mkdir(parents=True, exist_ok=True)
        watch = Stopwatch()
        services = Services(self._folder, uuid.uuid4().hex[:12])
        writer = ResultsWriter(self._folder / "results.h5", self._header(command))
        status = "failed"
        try:
            services.start("atomistic", "atomistic", self.scene.atomistic.backend, self.scene.atomistic.ranks)
            client = services.connect("atomistic")
            client.watch_with(services.check)
            start = self._prepare(client, services)
            self._loop(client, writer, start)
            status = "finished"
        except KeyboardInterrupt:
            status = "interrupted"
            raise
        finally:
            services.stop()
            writer.close(status)
        return watch.read()

    # --- preparation -------------------------------------------------------------------------------------

    def _prepare(self, client: Client, services: Services) -> _Start:
        scene = self.scene
        table, handshake = scene.atomistic, scene.handshake
        assert table is not None and handshake is not None
        self._tell("build the whole body of atoms")
        lattice = self._properties.lattice_constant if self._properties else None
        built = client.call("configure", self._body.request(lattice), a.AtomisticConfigured)
        place = built.position + np.array([*self._body.middle, 0.0])
        self.atoms = len(place)
        gripped, damped = self._anchored(place)
        motion = EdgeMotion(scene.continuum, self._material, place[gripped])
        self.held = motion.held
        anchor = np.concatenate([gripped, damped])
        rest = np.ascontiguousarray(built.position[anchor])
        client.call(
            "register",
            a.AtomisticRegister(
                atom_id=built.atom_id[anchor],
                anchor_position=rest,
                anchor_ivc=np.concatenate([motion.side, np.full(len(damped), 4, dtype=np.int64)]),
                stiffness=np.where(np.arange(len(anchor)) < len(gripped), 0.0, SLACK),
                damping_time=1.0 / self._damping_rate if len(damped) else None,
                anchor_kind=np.where(np.arange(len(anchor)) < len(gripped), a.PASSIVE, a.SPRING),
                motion="linear",
            ),
            a.AtomisticRegistered,
        )
        start = _Start(built, place, motion, rest, len(gripped))
        preload = scene.continuum.preload is not None or scene.continuum.initial_field is not None
        if not preload:
            self._tell("equilibrate")
            client.call("equilibrate", self._equilibrate(table.equilibration), a.Equilibrated)
            return start
        self._tell("displace the atoms as the preload does the continuum")
        # The load needs a service that is ready; what is measured here is not used.
        client.call(
            "equilibrate", a.EquilibrateRequest(steps=0, windows=FEWEST_WINDOWS, window_steps=1), a.Equilibrated
        )
        moved = self._preload(services, place)
        moved[gripped] = motion.displacement(0.0)
        request = a.DisplaceRequest(displacement=moved, anchor_position=rest + moved[anchor])
        client.call("displace", request, a.Displaced)
        self._tell("equilibrate under the load")
        client.call("equilibrate", self._equilibrate(table.equilibration + table.hold), a.Equilibrated)
        return start

    def _anchored(self, place: FloatArray) -> tuple[np.ndarray, np.ndarray]:
        """Return rows of the atoms beyond moved edges, and of those that are damped as the continuum is."""
        scene = self.scene
        overlap, table = scene.overlap(), scene.atomistic
        assert overlap is not None and table is not None
        beyond = edge_beyond(scene.continuum, place) >= 0
        kept = table.ensemble is not None and table.ensemble.keep
        damped = np.zeros(len(place), dtype=bool)
        if self._damping_rate > 0 and not kept:
            damped = ~beyond
            for region in scene.places:
                offset = place[:, :2] - np.array(region.centre)
                damped &= ~np.all((offset > overlap[0][0]) & (offset < overlap[0][1]), axis=1)
        return np.flatnonzero(beyond), np.flatnonzero(damped)

    def _equilibrate(self, duration: float) -> a.EquilibrateRequest:
        table = self.scene.atomistic
        assert table is not None
        bath = table.ensemble
        return a.EquilibrateRequest(
            steps=max(1, round(duration / table.time_step)),
            windows=FEWEST_WINDOWS,
            window_steps=self._steps,
            ensemble=None
            if bath is None
            else a.Ensemble(
                thermostat=bath.thermostat, damping_time=bath.damping_time, pressure=bath.pressure,
                pressure_time=bath.pressure_time,
            ),
            keep_ensemble=bath is not None and bath.keep,
        )  # fmt: skip

    def _preload(self, services: Services, place: FloatArray) -> FloatArray:
        """Return the displacement of each atom at the start, as a continuum without atoms has it under its preload."""
        body = self.scene.continuum
        if body.preload is None:
            assert body.initial_field is not None
            moved = k_field_displacement(body.initial_field, self._material, body.assumption, place)
            return np.column_stack([moved, np.zeros(len(place))])
        edge = _INSIDE * body.cell_size
        probe = place.copy()
        probe[:, 2] = 0.0
        for axis in (0, 1):
            np.clip(probe[:, axis], body.lower[axis] + edge, body.upper[axis] - edge, out=probe[:, axis])
        services.start("continuum", "continuum", body.backend)
        client = services.connect("continuum")
        request = continuum_request(
            self.scene,
            self._material,
            thickness_of(self.scene, self._properties),
            [],
            sub_steps(self.scene, self._material),
            [probe],
        )
        found = client.call("configure", request, c.ContinuumConfigured)
        assert found.probe_displacement is not None
        return np.ascontiguousarray(found.probe_displacement)

    # --- the run -----------------------------------------------------------------------------------------

    def _loop(self, client: Client, writer: ResultsWriter, start: _Start) -> None:
        scene, run = self.scene, self.scene.run
        built = start.built
        writer.atoms(built.atom_id, numbers_of(built.atom_mass), built.atom_mass, start.place)
        first_energy = first_tip = math.nan
        position, ended_at, computed_before = start.places(0.0), time.perf_counter(), client.timing.computing
        for step in range(1, run.steps + 1):
            now = step * self.time_step
            following = start.places(now)
            atoms = client.call(
                "advance",
                a.AtomisticAdvance(
                    steps=self._steps, anchor_position=position, anchor_velocity=(following - position) / self.time_step
                ),
                a.AtomisticAdvanced,
                step=step,
            )
            position = following
            if step == 1:
                first_energy = atoms.potential_energy
                first_tip = math.nan if atoms.crack_tip is None else atoms.crack_tip
            computed, clock = client.timing.computing, time.perf_counter()
            values = {
                "time": now,
                "atomistic_potential": atoms.potential_energy - first_energy,
                "atomistic_kinetic": atoms.kinetic_energy,
                "temperature": atoms.temperature,
                "broken_bonds": float(atoms.broken_bonds),
                "longest_bond": atoms.longest_bond,
                "seconds_atomistic": computed - computed_before,
                "seconds_exchange": clock - ended_at - (computed - computed_before),
            }
            if atoms.crack_tip is not None:
                values["crack_tip"] = atoms.crack_tip + self._body.middle[0]
            load, strain, j = load_of(scene, self._material, np.array([now]))
            if load == STRAIN:
                values["applied_strain"] = float(strain[0])
            if not math.isnan(j[0]):
                values["j_boundary"] = float(j[0])
            ended_at, computed_before = clock, computed
            writer.row(step, values)
            limit = run.stop_after_crack_growth
            grown = 0.0 if atoms.crack_tip is None else atoms.crack_tip - first_tip
            ended = limit is not None and grown >= limit * (1.0 - 1e-9)
            if step % run.output_every == 0 or ended:
                fields = client.call("fields", FieldsRequest(names=["position"]), FieldsReply).fields
                writer.atoms_frame(step, now, fields["position"] + np.array([*self._body.middle, 0.0]))
                writer.flush()
                self._tell(f"full atomistic run: step {step} of {run.steps}, tip +{grown * 1e10:.0f} A")
            if ended:
                break

    def _header(self, command: str) -> dict[str, object]:
        scene = self.scene
        return {
            "scene": {
                "name": scene.name, "title": scene.title, "text": scene.text, "overrides": list(scene.overrides),
                "resolved": scene.model_dump(mode="json"),
            },
            "versions": versions(),
            "seeds": {"run": scene.run.seed},
            "command": command,
        }  # fmt: skip


@dataclass(frozen=True)
class _Start:
    """Atoms and anchors as they are before the first step; the first `gripped` anchors follow the edges.

    `place` is that of the atoms in the scene, `rest` that of the anchors in the sample, both undeformed, m.
    """

    built: a.AtomisticConfigured
    place: FloatArray
    motion: EdgeMotion
    rest: FloatArray
    gripped: int

    def places(self, now: float) -> FloatArray:
        """Return places of all anchors at a time, s; those of damped atoms stay."""
        found = self.rest.copy()
        found[: self.gripped] += self.motion.displacement(now)
        return found


def isotropic_of(scene: Scene, properties: a.Properties | None) -> c.IsotropicMaterial:
    """Return the material of the continuum: the scene's, or as measured for the potential.

    Raises
    ------
    NotComparable
        For a material that one modulus and one ratio do not tell.
    """
    found = elastic_constants(material_of(scene, properties))
    if found is None:
        raise NotComparable("continuum.material is orthotropic; the comparison is for isotropic ones")
    return found
