"""The M:1 coupling of one continuum and one atomistic service.

One step::

    continuum   advances one step Dt = M dt under the last reaction forces
        |       anchor displacements and velocities (interpolated from the grid)
        v
    atomistic   sets its anchors there, holds them, integrates M steps
        |       averaged reaction forces minus the reference (Eq 87), with their standard error
        v
    continuum   next step

Nothing filters the forces on their way: any delay in this loop feeds energy in. A scene without atoms is
the same loop without the exchange.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from pydantic import TypeAdapter

from coordinator.atom_measurements import AtomMeasurements, MeasuredFields
from coordinator.atomistic_request import (
    advance_request,
    check_extent,
    configure_request,
    equilibrate_request,
    register_request,
)
from coordinator.continuum_request import continuum_request
from coordinator.handshake import Handshake, choose
from coordinator.interface import Interface, build_interface
from coordinator.scene import Corners, Scene
from coordinator.series import TIP_SERIES
from coordinator.strip import strip_j
from protocol import atomistic as a
from protocol import continuum as c
from protocol.arrays import FloatArray
from protocol.client import Client
from protocol.continuum import Rectangle
from protocol.messages import CheckpointReply, FieldsReply, FieldsRequest, Restored, RestoreRequest


@dataclass(frozen=True)
class StepRecord:
    """What one coupling step gave.

    Attributes
    ----------
    values : dict of str to float
        Time series, named and in units as in `coordinator.results`.
    ivc_force, ivc_error : float64 array, shape (ivcs, 3), or None
        Averaged reaction on the continuum and its standard error, N.
    warnings : list of str
        Of the atomistic service.
    events : list of ContinuumEvent
        Of the continuum.
    tips : list of CrackTip
        Of the continuum.
    measured : MeasuredFields or None
        Fields of the atoms, at steps where the scene asks for them.
    """

    values: dict[str, float]
    ivc_force: FloatArray | None = None
    ivc_error: FloatArray | None = None
    warnings: list[str] = field(default_factory=list)
    events: list[c.ContinuumEvent] = field(default_factory=list)
    tips: list[c.CrackTip] = field(default_factory=list)
    measured: MeasuredFields | None = None


class Coupling:
    """Drives the services of one scene.

    Parameters
    ----------
    scene : Scene
    continuum : Client
    atomistic : Client or None
        None for a scene without atoms.
    properties : Properties, optional
        Constants measured before (of a run that is resumed); measured anew without.
    tell : callable, optional
        Told in words what is being prepared.
    """

    def __init__(
        self,
        scene: Scene,
        continuum: Client,
        atomistic: Client | None,
        properties: a.Properties | None = None,
        tell: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.scene = scene
        self.step = 0
        self.properties = properties
        self.interface: Interface | None = None
        self.handshake: Handshake | None = None
        self.equilibrated: a.Equilibrated | None = None
        self.warnings: list[str] = []
        self.measurements: AtomMeasurements | None = None
        self.atom_id = np.zeros(0, dtype=np.int64)
        self.atom_mass = np.zeros(0)
        self.atom_position = np.zeros((0, 3))
        self._continuum = continuum
        self._atomistic = atomistic
        self._tell = tell
        self._reaction: FloatArray | None = None
        self._start_energy: float | None = None
        self._start_tip: float | None = None
        self._start_length: dict[int, float] = {}

    # --- preparation -------------------------------------------------------------------------------------

    def configure(self) -> None:
        """Measure constants, build both models, place anchors and cells; nothing has moved yet."""
        if self._atomistic is not None and self.properties is None and self.scene.continuum.material is None:
            self._measure_properties()
        if self._atomistic is not None:
            self._configure_atoms(self._atomistic)
        self._configure_continuum()
        if self.interface is not None and self._atomistic is not None:
            self._register(self._atomistic, self.interface)

    def equilibrate(self) -> None:
        """Bring the atoms to temperature and measure the reference forces, anchors at rest."""
        if self._atomistic is None or self.scene.atomistic is None or self.scene.handshake is None:
            return
        self._tell("equilibrate atoms, measure reference forces")
        if self.scene.atomistic.collects:
            # On before the reference is measured: J counts from the energies and stresses without load.
            self._atomistic.call("collect_fields", a.CollectRequest(active=True), a.Collecting)
        self.equilibrated = self._atomistic.call("equilibrate", equilibrate_request(self.scene), a.Equilibrated)
        if self.equilibrated.settled is False:
            self.warnings.append(_unsettled(self.equilibrated))

    def _measure_properties(self) -> None:
        assert self._atomistic is not None and self.scene.atomistic is not None
        atomistic = self.scene.atomistic
        self._tell(f"measure {atomistic.material} constants at {atomistic.temperature:g} K")
        self.properties = self._atomistic.call(
            "properties",
            a.PropertiesRequest(
                force_field=atomistic.force_field, material=atomistic.material, temperature=atomistic.temperature,
                seed=self.scene.run.seed,
            ),
            a.Properties,
        )  # fmt: skip

    def _configure_atoms(self, client: Client) -> None:
        scene = self.scene
        assert scene.atomistic is not None and scene.handshake is not None
        self._tell("build atoms")
        measured = self.properties.lattice_constant if self.properties else None
        built = client.call("configure", configure_request(scene, measured), a.AtomisticConfigured)
        self.atom_id, self.atom_mass, self.atom_position = built.atom_id, built.atom_mass, built.position
        self.measurements = AtomMeasurements(scene, client, built.position)
        self.warnings += built.warnings
        material = self._isotropic
        assert material is not None  # held by the scene's checks
        # The ring ends where the atoms do: continuum of small weight beyond the last atoms would be a soft gap.
        low, high = built.position[:, :2].min(axis=0), built.position[:, :2].max(axis=0)
        if scene.atomistic.sample is not None:
            check_extent(scene.atomistic, scene.continuum.cell_size, low, high)
        corners = scene.overlap(float(high[0] - low[0]), float(high[1] - low[1]))
        assert corners is not None
        inner, outer = _rectangle(corners[0]), Rectangle(lower=tuple(low), upper=tuple(high))
        width = float(np.mean([np.subtract(inner.lower, low), np.subtract(high, inner.upper)]))
        self.handshake = choose(
            material.young,
            material.density,
            width,
            scene.time_step,
            damping_time=scene.handshake.damping_time,
            weight=scene.handshake.weight,
            stiffness_density=self._given_stiffness_density(built.atom_mass),
        )
        self.interface = build_interface(
            built.position,
            inner,
            outer,
            self.handshake.weight,
            scene.handshake.ivc_size,
            scene.crack.y if scene.crack else None,
            scene.handshake.passive_width or 0.0,
            scene.handshake.surface_width or 0.0,
        )
        self._anchor_stiffness = np.full(
            len(self.interface.anchor), self.handshake.stiffness_density * self._volume_per_atom(built.atom_mass)
        )

    def _volume_per_atom(self, mass: FloatArray) -> float:
        return float(mass.mean()) / self.material.density

    def _given_stiffness_density(self, mass: FloatArray) -> float | None:
        """Return the scene's stiffness per anchor as stiffness per volume: every atom of the overlap is anchored."""
        given = self.scene.handshake.stiffness if self.scene.handshake else None
        return None if given is None else given / self._volume_per_atom(mass)

    @property
    def material(self) -> c.Material:
        """Material of the continuum: the scene's, or the constants measured for the potential."""
        given = self.scene.continuum.material
        if given is not None:
            material: c.Material = TypeAdapter(c.Material).validate_python(given.constants())
            return material
        assert self.properties is not None  # held by the scene's checks
        measured = self.properties
        return c.IsotropicMaterial(young=measured.young, poisson=measured.poisson, density=measured.density)

    @property
    def _isotropic(self) -> c.IsotropicMaterial | None:
        """Elastic constants at small strain, where one modulus and one ratio tell them."""
        material = self.material
        if isinstance(material, c.OrthotropicMaterial):
            return None
        return c.IsotropicMaterial(young=material.young, poisson=material.poisson, density=material.density)

    @property
    def thickness(self) -> float:
        """Thickness of the continuum, m."""
        given, measured, atoms = self.scene.continuum.material, self.properties, self.scene.atomistic
        if given is not None:
            return given.thickness
        assert measured is not None and atoms is not None  # held by the scene's checks
        return measured.thickness * atoms.layers

    def _configure_continuum(self) -> None:
        self._tell("relax continuum" if self.scene.continuum.preload else "build continuum")
        request = continuum_request(self.scene, self.material, self.thickness, self.interface)
        self.configured = self._continuum.call("configure", request, c.ContinuumConfigured)
        relaxed = self.configured.relaxation
        if relaxed is not None and not relaxed.converged:
            self.warnings.append(
                f"The preload ended after {relaxed.steps} steps with a residual of {relaxed.residual:.2g}, above"
                " continuum.preload.tolerance: raise its max_steps."
            )

    def _register(self, atomistic: Client, interface: Interface) -> None:
        handshake = self.scene.handshake
        assert handshake is not None
        self._tell("place anchors and interface volume cells")
        self.anchor_reference = np.ascontiguousarray(self.atom_position[interface.anchor])
        self._continuum.call(
            "register",
            c.ContinuumRegister(
                anchor_position=self.anchor_reference,
                anchor_ivc=interface.anchor_ivc,
                ivc_lower=interface.ivc_lower,
                ivc_upper=interface.ivc_upper,
            ),
            c.ContinuumRegistered,
        )
        atomistic.call(
            "register",
            register_request(handshake, self.atom_id, self.anchor_reference, interface, self._anchor_stiffness),
            a.AtomisticRegistered,
        )

    # --- one step ----------------------------------------------------------------------------------------

    def advance(self) -> StepRecord:
        """Make one coupling step."""
        by_ivc = self.scene.handshake is not None and self.scene.handshake.spread == "ivc"
        continuum = self._continuum.call(
            "advance",
            c.ContinuumAdvance(
                steps=1,
                ivc_force=self._reaction if by_ivc else None,
                anchor_force=None if by_ivc else self._reaction,
            ),
            c.ContinuumAdvanced,
            step=self.step + 1,
        )
        values = {
            "continuum_kinetic": continuum.kinetic_energy,
            "continuum_strain": continuum.strain_energy,
            "continuum_edge_work": continuum.edge_work,
            "continuum_interface_work": continuum.interface_work,
            "continuum_damping_loss": continuum.damping_loss,
            "continuum_load_work": continuum.load_work,
            "continuum_dissipated": continuum.dissipated_energy,
            "points_lost": float(continuum.points_lost),
            "courant": self.configured.courant_number,
            **self._load(continuum),
            **_tip_values(continuum.tips),
        }
        self.step += 1
        if self._atomistic is None or self.interface is None or self.scene.handshake is None:
            return StepRecord(values, events=continuum.events, tips=continuum.tips)
        atoms = self._atomistic.call(
            "advance",
            advance_request(
                self.scene.handshake,
                self._anchor_start(continuum),
                continuum.anchor_velocity,
            ),
            a.AtomisticAdvanced,
            step=self.step,
        )
        self._reaction = atoms.ivc_force if by_ivc else atoms.anchor_force
        values.update(self._exchange(atoms))
        assert self.measurements is not None
        frame = self.measurements.take(self.step, values)
        return StepRecord(
            values, atoms.ivc_force, atoms.ivc_standard_error, atoms.warnings, continuum.events, continuum.tips, frame
        )

    def _anchor_start(self, continuum: c.ContinuumAdvanced) -> FloatArray:
        """Where the anchors begin the exchange: the continuum's place now, or one exchange back where they move."""
        place = self.anchor_reference + continuum.anchor_displacement
        if self.scene.handshake is not None and self.scene.handshake.motion == "linear":
            place = place - self.scene.time_step * continuum.anchor_velocity
        return place

    def _load(self, continuum: c.ContinuumAdvanced) -> dict[str, float]:
        """Return load measures of the first edge that pulls the body apart along y."""
        scene = self.scene.continuum
        found: dict[str, float] = {}
        moved = {
            (edge.edge, edge.axis): (continuum.edge_displacement[k], continuum.edge_force[k])
            for k, edge in enumerate(scene.edges)
            if edge.moves
        }
        top, bottom = moved.get(("top", 1)), moved.get(("bottom", 1))
        if top is None or bottom is None:
            return found
        height = scene.upper[1] - scene.lower[1]
        strain = float(top[0] - bottom[0]) / height
        found["applied_strain"] = strain
        found["edge_force"] = float(top[1])
        elastic = self._isotropic
        if self.scene.crack is not None and elastic is not None:
            found["j_boundary"] = strip_j(
                elastic, self.scene.continuum.assumption, strain, height, sideways_free=("top", 0) not in moved
            )
        return found

    def _exchange(self, atoms: a.AtomisticAdvanced) -> dict[str, float]:
        """Return balances and atomistic measures of a step."""
        assert self.interface is not None
        if self._start_energy is None:
            self._start_energy = atoms.potential_energy
        scale = np.abs(atoms.anchor_force).sum()
        # Summed here from the anchors, so that a service's own sums are checked cell by cell.
        cell, cells = self.interface.anchor_ivc, len(atoms.ivc_force)
        by_cell = np.column_stack([np.bincount(cell, atoms.anchor_force[:, k], cells) for k in range(3)])
        imbalance = np.abs(by_cell - atoms.ivc_force).max()
        values = {
            "atomistic_potential": atoms.potential_energy - self._start_energy,
            "atomistic_kinetic": atoms.kinetic_energy,
            "spring_energy": atoms.spring_energy,
            "anchor_work": atoms.anchor_work,
            "temperature": atoms.temperature,
            "handshake_temperature": atoms.handshake_temperature,
            "force_sum_x": float(atoms.ivc_force[:, 0].sum()),
            "force_sum_y": float(atoms.ivc_force[:, 1].sum()),
            "force_balance": float(imbalance / scale) if scale > 0 else 0.0,
            "ivc_force_rms": _rms(atoms.ivc_force[:, :2]),
            "ivc_error_rms": _rms(atoms.ivc_standard_error[:, :2]),
            "broken_bonds": float(atoms.broken_bonds),
            "longest_bond": atoms.longest_bond,
        }
        if atoms.thermostat_work is not None:
            values["thermostat_work"] = atoms.thermostat_work
        if atoms.correlation_time is not None:
            values["correlation_time"] = atoms.correlation_time
        if self.scene.handshake is not None and self.scene.handshake.until_error is not None:
            values["exchange_windows"] = float(atoms.windows)
        if atoms.crack_tip is not None:
            values["crack_tip"] = atoms.crack_tip
            if self._start_tip is None:
                self._start_tip = atoms.crack_tip
        return values

    def crack_growth(self, record: StepRecord) -> float:
        """Return how far a crack tip has moved since the start, m: the atoms', or the continuum's furthest."""
        if self._start_tip is not None and "crack_tip" in record.values:
            return record.values["crack_tip"] - self._start_tip
        grown = [tip.length - self._start_length.setdefault(tip.crack, tip.length) for tip in record.tips]
        return max(grown, default=0.0)

    # --- fields and state --------------------------------------------------------------------------------

    def point_fields(self) -> dict[str, np.ndarray]:
        """Return fields of the material points."""
        names = ["position", "displacement", "velocity", "stress", "weight"]
        return self._continuum.call("fields", FieldsRequest(names=names), FieldsReply).fields

    def atom_fields(self) -> dict[str, np.ndarray]:
        """Return fields of the atoms; empty for a scene without."""
        if self._atomistic is None:
            return {}
        return self._atomistic.call("fields", FieldsRequest(names=["position", "velocity"]), FieldsReply).fields

    def state(self) -> dict[str, np.ndarray]:
        """Return the state of both services and of the loop, as flat named arrays."""
        found: dict[str, np.ndarray] = {"coupling.step": np.array([self.step])}
        for role, client in self._clients():
            reply = client.call("checkpoint", None, CheckpointReply, step=self.step)
            found[f"coupling.{role}_step"] = np.array([reply.step])
            found.update({f"{role}.{name}": array for name, array in reply.state.items()})
        if self._reaction is not None:
            found["coupling.reaction"] = self._reaction
        start = (self._start_energy, self._start_tip)
        found["coupling.start"] = np.array([np.nan if value is None else value for value in start])
        lengths = self._start_length.items()
        found["coupling.start_length"] = np.array([[float(crack), length] for crack, length in lengths]).reshape(-1, 2)
        return found

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Set a state that `state` gave; both models are configured and registered before."""
        self.step = int(state["coupling.step"][0])
        self._reaction = state.get("coupling.reaction")
        energy, tip = (None if np.isnan(value) else float(value) for value in state["coupling.start"])
        self._start_energy, self._start_tip = energy, tip
        self._start_length = {int(crack): float(length) for crack, length in state["coupling.start_length"]}
        for role, client in self._clients():
            own = {name.split(".", 1)[1]: array for name, array in state.items() if name.startswith(role + ".")}
            request = RestoreRequest(step=int(state[f"coupling.{role}_step"][0]), state=own)
            client.call("restore", request, Restored, step=self.step)

    def _clients(self) -> list[tuple[str, Client]]:
        both = (("continuum", self._continuum), ("atomistic", self._atomistic))
        return [(role, client) for role, client in both if client is not None]


def _tip_values(tips: list[c.CrackTip]) -> dict[str, float]:
    """Return time series of the continuum's crack tips, named by crack and end."""
    found: dict[str, float] = {}
    for tip in tips:
        values = {"x": tip.position[0], "y": tip.position[1], **{name: getattr(tip, name) for name in TIP_SERIES}}
        start = f"tip_{tip.crack}_{tip.end}_"
        found.update({start + name: value for name, value in values.items() if value is not None})
    return found


def _unsettled(how: a.Equilibrated) -> str:
    """Say that the atoms were not at rest when the run began."""
    sentence = f"The equilibration ended after {how.steps_done} steps without having settled"
    if how.drifts:
        worst = max(how.drifts, key=lambda item: abs(item.drift) / max(item.standard_error, 1e-300))
        sentence += f": {worst.quantity} drifts by {worst.drift:.3g} with an error of {worst.standard_error:.2g} (SI)"
    return f"{sentence}; raise atomistic.equilibration."


def _rectangle(corners: Corners) -> Rectangle:
    return Rectangle(lower=corners[0], upper=corners[1])


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))
