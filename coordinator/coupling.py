"""Drives the services of one scene: builds both models, loads them, makes coupling steps.

::

    configure    constants measured for the potential; samples, overlaps, grid; anchors and cells
    equilibrate  atoms to temperature with anchors at rest, reference forces; the preload given to the atoms
    advance      one coupling step (`coordinator.exchange`), its balances, the relay of cracks

A scene without atoms is the same without what concerns them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from coordinator.atom_measurements import AtomMeasurements, MeasuredFields
from coordinator.books import Books
from coordinator.continuum_request import continuum_request, elastic_constants, material_of, thickness_of
from coordinator.crack_passage import CrackPassage
from coordinator.critical_length import CriticalLength, of_scene
from coordinator.exchange import Exchange
from coordinator.exchange_length import choose_steps_per_exchange
from coordinator.laminate_material import failed_by_ply
from coordinator.region import Region
from coordinator.relay import Leg
from coordinator.scene import Scene
from coordinator.series import series_name
from coordinator.step_values import atom_values, boundary_values, continuum_values, regions_values, tip_values
from coordinator.units import LENGTHS, readable
from coordinator.wave_speed import courant_number, sub_steps
from protocol import atomistic as a
from protocol import continuum as c
from protocol.arrays import FloatArray
from protocol.client import Client
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
        Of the atomistic services.
    events : list of ContinuumEvent
        Of the continuum and of the relay.
    tips : list of CrackTip
        Of the continuum.
    measured : list of MeasuredFields or None
        Fields of the atoms of each region, at steps where the scene asks for them.
    """

    values: dict[str, float]
    ivc_force: FloatArray | None = None
    ivc_error: FloatArray | None = None
    warnings: list[str] = field(default_factory=list)
    events: list[c.ContinuumEvent] = field(default_factory=list)
    tips: list[c.CrackTip] = field(default_factory=list)
    measured: list[MeasuredFields | None] = field(default_factory=list)


class Coupling:
    """Drives the services of one scene.

    Parameters
    ----------
    scene : Scene
    continuum : Client
    atomistic : dict of str to Client
        By name of the region; empty for a scene without atoms.
    properties : Properties, optional
        Constants measured before (of a run that is resumed); measured anew without.
    steps_per_exchange : int, optional
        M as it was chosen before (likewise).
    tell : callable, optional
        Told in words what is being prepared.
    laminate : LaminateMaterial, optional
        Material of a scene with that law.

    Attributes
    ----------
    scene : Scene
        With M as chosen, from `configure` on.
    regions : list of Region
    """

    def __init__(
        self,
        scene: Scene,
        continuum: Client,
        atomistic: dict[str, Client],
        properties: a.Properties | None = None,
        steps_per_exchange: int | None = None,
        tell: Callable[[str], None] = lambda _: None,
        laminate: c.LaminateMaterial | None = None,
    ) -> None:
        self.scene = scene if steps_per_exchange is None else scene.with_steps_per_exchange(steps_per_exchange)
        self.step = 0
        self.properties = properties
        self.regions = [Region(self.scene, place, atomistic[place.name]) for place in scene.places]
        self.equilibrated: list[a.Equilibrated] = []
        self.warnings: list[str] = []
        self.measurements: list[AtomMeasurements] = []
        self.critical: CriticalLength | None = None
        self._continuum = continuum
        self._tell = tell
        self._laminate = laminate
        self._books = Books()
        self._passages: list[CrackPassage] = []
        self._start_energy: FloatArray | None = None
        self._start_length: dict[str, float] = {}
        self._reference_force: FloatArray | None = None
        self._probe_displacement: list[FloatArray] = []

    # --- preparation -------------------------------------------------------------------------------------

    def configure(self) -> None:
        """Measure constants, build both models, place anchors and cells; nothing has moved yet."""
        if self.regions and self.properties is None and self.scene.continuum.material is None:
            self._measure_properties()
        if self.regions:
            self._configure_atoms()
        self._configure_continuum()
        self._check_crack()
        if self.regions:
            self._register()

    def equilibrate(self) -> None:
        """Bring the atoms to temperature, measure the reference forces, give them the preload."""
        if not self.regions:
            return
        self._tell("equilibrate atoms, measure reference forces")
        self.equilibrated = [region.equilibrate() for region in self.regions]
        for how in self.equilibrated:
            if how.settled is False:
                self.warnings.append(_unsettled(how))
        self._reference_force = _reference_force(self.equilibrated)
        if self._preloaded:
            self._load_atoms()

    @property
    def material(self) -> c.Material:
        """Material of the continuum: the scene's, or the constants measured for the potential."""
        return self._laminate or material_of(self.scene, self.properties)

    @property
    def thickness(self) -> float:
        """Thickness of the continuum, m."""
        return thickness_of(self.scene, self.properties)

    @property
    def _preloaded(self) -> bool:
        continuum = self.scene.continuum
        return bool(self.regions) and (continuum.preload is not None or continuum.initial_field is not None)

    def _check_crack(self) -> None:
        """Hold the crack against the critical length (Eq 1)."""
        elastic = elastic_constants(self.material)
        self.critical = None if elastic is None else of_scene(self.scene, elastic)
        if self.critical is not None and self.critical.too_short:
            self.warnings.append(
                f"The crack, {readable(self.critical.crack, LENGTHS, 3)} long, is shorter than the critical length of"
                f" Eq 1, {readable(self.critical.length, LENGTHS, 3)}: damage may spread through the body instead of"
                " growing from its tip, and G_c is no property of the material there."
            )

    def _measure_properties(self) -> None:
        atomistic = self.scene.atomistic
        assert atomistic is not None
        self._tell(f"measure {atomistic.material} constants at {atomistic.temperature:g} K")
        self.properties = self.regions[0].client.call(
            "properties",
            a.PropertiesRequest(
                force_field=atomistic.force_field, material=atomistic.material, temperature=atomistic.temperature,
                seed=self.scene.run.seed,
            ),
            a.Properties,
        )  # fmt: skip

    def _configure_atoms(self) -> None:
        self._tell("build atoms")
        measured = self.properties.lattice_constant if self.properties else None
        for region in self.regions:
            self.warnings += region.configure(measured)
            self.measurements.append(AtomMeasurements(self.scene, region, len(self.regions) == 1))
        elastic = elastic_constants(self.material)
        assert elastic is not None and self.scene.handshake is not None  # held by the scene's checks
        if self.scene.handshake.steps_per_exchange is None:
            steps, told = choose_steps_per_exchange(self.scene, self.regions, elastic, self._tell)
            self.warnings += told
            self.scene = self.scene.with_steps_per_exchange(steps)
        for region in self.regions:
            region.scene = self.scene
            region.join(elastic, courant_number(self.scene, elastic))

    def _configure_continuum(self) -> None:
        self._tell("bring continuum to equilibrium" if self.scene.continuum.preload else "build continuum")
        material = self.material
        n = sub_steps(self.scene, material)
        probes = [region.reference for region in self.regions] if self._preloaded else []
        request = continuum_request(self.scene, material, self.thickness, self.regions, n, probes)
        self.configured = self._continuum.call("configure", request, c.ContinuumConfigured)
        relaxed = self.configured.relaxation
        if relaxed is not None and not relaxed.converged:
            self.warnings.append(
                f"The preload ended after {relaxed.steps} steps with a residual of {relaxed.residual:.2g}, above"
                " continuum.preload.tolerance: raise its max_steps."
            )
        if probes and self.configured.probe_displacement is not None:
            ends = np.cumsum([len(rows) for rows in probes])[:-1]
            self._probe_displacement = np.split(self.configured.probe_displacement, ends)
        table = self.scene.handshake
        self._exchange = Exchange(
            self._continuum, self.regions, self.scene.time_step, n,
            spread=table.spread if table is not None else "anchor",
            parallel=table is not None and table.scheme == "parallel",
        )  # fmt: skip
        self._passages = CrackPassage.of_scene(self.scene, self.regions, self._continuum)

    def _register(self) -> None:
        self._tell("place anchors and interface volume cells")
        start = 0
        ivc, lower, upper = [], [], []
        for region in self.regions:
            ivc.append(region.interface.anchor_ivc + start)
            low, high = region.cells()
            start += len(low)
            lower.append(low)
            upper.append(high)
        displaced = None
        if self._probe_displacement:
            pairs = zip(self.regions, self._probe_displacement, strict=True)
            displaced = np.concatenate([moved[region.interface.anchor] for region, moved in pairs])
            self._exchange.start_at(displaced)
        self._continuum.call(
            "register",
            c.ContinuumRegister(
                anchor_position=np.concatenate([region.anchor_reference for region in self.regions]),
                anchor_ivc=np.concatenate(ivc),
                ivc_lower=np.concatenate(lower),
                ivc_upper=np.concatenate(upper),
                anchor_displacement=displaced,
            ),
            c.ContinuumRegistered,
        )
        for region in self.regions:
            region.register()

    def _load_atoms(self) -> None:
        """Give the atoms the displacements of the preload, and let them come to rest under it."""
        self._tell("load atoms")
        for region, moved in zip(self.regions, self._probe_displacement, strict=True):
            region.displace(moved)
        table, handshake = self.scene.atomistic, self.scene.handshake
        assert table is not None and handshake is not None and handshake.steps_per_exchange is not None
        windows = round(table.hold / (handshake.steps_per_exchange * table.time_step))
        for done in range(windows):
            self._tell(f"hold load, {done + 1} of {windows}")
            for reply in self._exchange.hold(0):
                self.warnings += [text for text in reply.warnings if text not in self.warnings]

    # --- one step ----------------------------------------------------------------------------------------

    def advance(self) -> StepRecord:
        """Make one coupling step."""
        found = self._exchange.advance(self.step + 1)
        self.step += 1
        continuum, atoms = found.continuum, found.atoms
        values = {
            **continuum_values(continuum),
            "courant": self.configured.courant_number,
            **boundary_values(self.scene, elastic_constants(self.material), continuum),
            **tip_values(continuum.tips),
        }
        events = list(continuum.events)
        if not atoms:
            values.update(self._books.enter(continuum, atoms, found.moved, None, self.scene.time_step))
            return StepRecord(values, events=events, tips=continuum.tips)
        if self._start_energy is None:
            self._start_energy = np.array([reply.potential_energy for reply in atoms])
        for region, reply, start in zip(self.regions, atoms, self._start_energy, strict=True):
            values.update(atom_values(self.scene, region, reply, float(start), alone=len(atoms) == 1))
        values.update(regions_values(self.regions, atoms, self._start_energy))
        values.update(self._books.enter(continuum, atoms, found.moved, self._reference_force, self.scene.time_step))
        # A sample has a crack to measure J at while the tip is among its atoms.
        legs = [passage.leg for passage in self._passages] or [Leg.ATOMS] * len(atoms)
        pairs = zip(self.measurements, legs, strict=True)
        measured = [one.take(self.step, values, cracked=leg is Leg.ATOMS) for one, leg in pairs]
        for passage, reply in zip(self._passages, atoms, strict=False):
            events += passage.follow(continuum, reply, self.step, values)
        return StepRecord(
            values,
            np.concatenate([reply.ivc_force for reply in atoms]),
            np.concatenate([reply.ivc_standard_error for reply in atoms]),
            [warning for reply in atoms for warning in reply.warnings],
            events,
            continuum.tips,
            measured,
        )

    def crack_growth(self, record: StepRecord) -> float:
        """Return how far a crack tip has moved since the start, m: that of atoms, or the continuum's furthest."""
        tips = {name: record.values[name] for name in record.values if name.split("@")[0] == "crack_tip"}
        if tips and not any(passage.leg.propagate for passage in self._passages):
            alone = len(self.regions) == 1
            signs = {series_name("crack_tip", one.name, alone): one.frame.sign for one in self.regions}
            return max(signs[name] * (x - self._start_length.setdefault(name, x)) for name, x in tips.items())
        grown = [tip.length - self._start_length.setdefault(str(tip.crack), tip.length) for tip in record.tips]
        return max(grown, default=0.0)

    # --- fields and state --------------------------------------------------------------------------------

    def point_fields(self) -> dict[str, np.ndarray]:
        """Return fields of the material points."""
        names = ["position", "displacement", "velocity", "stress", "weight"]
        if self._laminate is not None:
            names.append("failed")
        return self._continuum.call("fields", FieldsRequest(names=names), FieldsReply).fields

    def failed_by_ply(self, fields: dict[str, np.ndarray]) -> dict[str, FloatArray]:
        """Return what has failed of `point_fields`, by the words for plies and material; nothing without a laminate."""
        return {} if self._laminate is None else failed_by_ply(self._laminate, fields["failed"])

    def atom_positions(self) -> FloatArray | None:
        """Return places of all atoms, region by region, shape (atoms, 3), m; None for a scene without."""
        if not self.regions:
            return None
        return np.concatenate([region.positions() for region in self.regions])

    def state(self) -> dict[str, np.ndarray]:
        """Return the state of all services and of the loop, as flat named arrays."""
        found: dict[str, np.ndarray] = {"coupling.step": np.array([self.step])}
        for name, client in self._clients():
            reply = client.call("checkpoint", None, CheckpointReply, step=self.step)
            found[f"coupling.{name}_step"] = np.array([reply.step])
            found.update({f"{name}.{key}": array for key, array in reply.state.items()})
        found.update({f"exchange.{key}": array for key, array in self._exchange.state().items()})
        found.update({f"books.{key}": array for key, array in self._books.state().items()})
        found.update({f"passage.{k}": passage.state() for k, passage in enumerate(self._passages)})
        if self._start_energy is not None:
            found["coupling.start_energy"] = self._start_energy
        if self.regions and self._reference_force is not None:
            found["coupling.reference_force"] = self._reference_force
        for key, value in self._start_length.items():
            found[f"start_length.{key}"] = np.array([value])
        return found

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Set a state that `state` gave; all models are configured and registered before."""
        self.step = int(state["coupling.step"][0])
        self._exchange.restore(_part(state, "exchange"))
        self._books.restore(_part(state, "books"))
        for k, passage in enumerate(self._passages):
            passage.restore(state[f"passage.{k}"])
        self._start_energy = state.get("coupling.start_energy")
        self._reference_force = state.get("coupling.reference_force")
        self._start_length = {key: float(value[0]) for key, value in _part(state, "start_length").items()}
        for name, client in self._clients():
            request = RestoreRequest(step=int(state[f"coupling.{name}_step"][0]), state=_part(state, name))
            client.call("restore", request, Restored, step=self.step)

    def _clients(self) -> list[tuple[str, Client]]:
        return [("continuum", self._continuum), *((region.name, region.client) for region in self.regions)]


def _part(state: dict[str, np.ndarray], name: str) -> dict[str, np.ndarray]:
    return {key.split(".", 1)[1]: array for key, array in state.items() if key.startswith(name + ".")}


def _reference_force(equilibrated: list[a.Equilibrated]) -> FloatArray | None:
    """Return the reference forces on all anchors, N; None where a service does not tell them."""
    found = [how.reference_anchor_force for how in equilibrated]
    known = [force for force in found if force is not None]
    return np.concatenate(known) if len(known) == len(found) else None


def _unsettled(how: a.Equilibrated) -> str:
    """Say that the atoms were not at rest when the run began."""
    sentence = f"The equilibration ended after {how.steps_done} steps without having settled"
    if how.drifts:
        worst = max(how.drifts, key=lambda item: abs(item.drift) / max(item.standard_error, 1e-300))
        sentence += f": {worst.quantity} drifts by {worst.drift:.3g} with an error of {worst.standard_error:.2g} (SI)"
    return f"{sentence}; raise atomistic.equilibration."
