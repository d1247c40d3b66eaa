"""LAMMPS as an engine of the role `atomistic`: `md_service.dynamics.Dynamics` on an `AtomSystem`."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from md_service import units
from md_service.anchors import Anchors, finite_array
from md_service.atom_system import AtomSystem
from md_service.atoms import Atoms, Box
from md_service.cuts import Cut
from md_service.dynamics import State, Window
from md_service.ensembles import Ensemble
from md_service.errors import EngineError
from md_service.force_fields import ForceField
from md_service.lammps_anchors import MOBILE, LammpsAnchors, damper_group
from md_service.lammps_ensembles import TALLIED, THERMOSTAT, ensemble_commands, ensemble_removal_commands
from md_service.ranks import Ranks
from md_service.saved_state import cuts_of, packed_state, unpacked_state

_DAMPER: Final = "anchor_damper"  # fix
_TALLY_INTERVAL: Final = 50  # steps at least between two tallies of virials
_MINIMISER_TOLERANCE: Final = 1.6e-17  # N, norm of all forces
_SAMPLE: Final = "c_atom_energy " + " ".join(f"c_atom_stress[{column}]" for column in range(1, 7))


class LammpsDynamics:
    """Atoms in LAMMPS, with anchors on some of them.

    Parameters
    ----------
    work_dir : Path
        Folder of log.lammps; made if missing.
    force_field : ForceField
        Interatomic potential.
    atoms : Atoms
        The sample.
    temperature : float
        Of the anchors' thermostat, K; 0 for damped motion without noise.
    seed : int
        Of velocities and thermostats, not negative.
    time_step : float, optional
        s; the force field's own without it.
    ranks : Ranks, optional
        MPI ranks; every rank makes the object and calls its methods alike.

    Raises
    ------
    ValueError
        For bad input.
    EngineError
        If LAMMPS cannot be loaded or refuses the input.
    """

    def __init__(
        self,
        work_dir: Path,
        force_field: ForceField,
        atoms: Atoms,
        *,
        temperature: float,
        seed: int,
        time_step: float | None = None,
        ranks: Ranks | None = None,
    ) -> None:
        self.time_step = force_field.time_step if time_step is None else float(time_step)
        for name, value, lowest in (
            ("temperature", temperature, 0.0),
            ("seed", seed, 0),
            ("time_step", self.time_step, np.nextafter(0.0, 1.0)),
        ):
            if not (np.isfinite(value) and value >= lowest):
                raise ValueError(f"{name} is {value}; it must be finite and at least {lowest:.3g}")
        if seed > 2**53:
            raise ValueError(f"seed is {seed}; at most {2**53} is allowed, so that a saved state can hold it")
        self.atoms = atoms
        planar = force_field.pairwise and bool(np.ptp(atoms.position[:, 2]) == 0.0)
        self.dimension = 2 if planar else 3
        self.step = 0
        self.anchors: Anchors | None = None
        self.cuts: tuple[Cut, ...] = ()
        self.failure = ""
        self._temperature = float(temperature)
        self._seed = int(seed)
        self._system = AtomSystem(Path(work_dir), force_field, atoms, self.time_step, ranks)
        self._links: LammpsAnchors | None = None
        self._ensemble: Ensemble | None = None
        self._tally_wanted = False
        self._sample_step = -1  # step at whose end the virial was tallied
        self._window = 0  # M of the averaging fixes that LAMMPS holds, 0 without them
        self._tallied = False  # whether they tally the virial too
        self._tally_every = 0  # steps between two tallies
        self._needs_setup = True
        self._last_redraw = 0
        self._other_work = 0.0  # J, of dampers' carrying term, passive atoms and redrawn velocities
        # Of the anchored atoms at the last window's end, m and m/s.
        self._end_position: NDArray[np.float64] | None = None
        self._end_velocity = np.zeros((0, 3))
        self._end_step = -1
        self._pair_force = np.zeros((0, 3))  # on passive atoms in the last window, N
        self._closed = False
        self._rebuild(atoms.position, None, None)

    # Anchors --------------------------------------------------------------------------------------------------

    def adopt(self, anchors: Anchors | None) -> None:
        """Take over anchors, at the atoms' present positions and velocities."""
        self.anchors = anchors
        self._ensemble = None
        self._reload()

    def move_anchors(self) -> None:
        """Take over changed positions and velocities of the anchors."""
        if self._links is not None:
            self._links.write(forces_known=not self._needs_setup)

    def displace(self, displacement: NDArray[np.float64]) -> None:
        """Move all atoms at once; the box grows where they leave it in a free direction."""
        position = self._system.position() + displacement
        self._rebuild(position, self._system.velocity(), self._system.box_around(position))

    def sever(self, cuts: tuple[Cut, ...]) -> None:
        """Sever the atoms across lines, by excluding their pairs from LAMMPS' neighbour lists."""
        if trap := self._system.force_field.severing_trap(self.atoms):
            raise EngineError(trap)
        self.cuts = cuts
        self._reload()

    # Motion ---------------------------------------------------------------------------------------------------

    def hold(self, ensemble: Ensemble | None) -> None:
        """Couple all atoms to an ensemble beside the anchors and their damper; None goes back to these alone."""
        self._command(self._motion_removal_commands())
        self._ensemble = ensemble
        self._set_motion()

    def draw_velocities(self, temperature: float) -> None:
        """Maxwell-Boltzmann velocities (K) without total momentum; passive atoms keep theirs."""
        mass = self.atoms.atom_mass
        spread = np.sqrt(units.BOLTZMANN * temperature / mass)
        random = np.random.default_rng([self._seed, self.step])
        velocity = random.normal(0.0, 1.0, (len(mass), 3)) * spread[:, None]
        velocity -= mass @ velocity / mass.sum()
        velocity[:, self.dimension :] = 0.0
        if self.anchors is not None and self.anchors.passive.any():
            carried = self.anchors.atom_id[self.anchors.passive]
            velocity[carried] = self._system.velocity()[carried]
        self._system.set_velocity(velocity)

    def run(self, steps: int) -> None:
        """Integrate."""
        done = 0
        while done < steps:
            part = min(steps - done, self._redraw())
            self._run(part)
            done += part

    def run_window(self, window: int) -> Window:
        """Integrate one window of M steps with its means."""
        links, anchors = self._links_at_hand(), self._anchors_at_hand()
        self._redraw()
        self._prepare_window(window)
        before = self._end_position
        if self._end_step != self.step or before is None:
            before = self._system.position()[anchors.atom_id]
            self._end_velocity = self._system.velocity()[anchors.atom_id]
        speed_before = self._end_velocity
        self._run(window)
        if self._tallied and self._system.session.lmp.extract_global("ntimestep") % self._tally_every == 0:
            self._sample_step = self.step
        # One reduction for everything: means and present positions of the anchored atoms, energies by group.
        n_anchors = len(anchors.atom_id)
        packed = np.zeros(15 * n_anchors + 6)
        rows, means = links.local_means()
        packed[:-6].reshape(n_anchors, 15)[rows] = means
        packed[-6:-3] = self._system.kinetic_energy(links.group_of_atom, 3)
        packed[-3:] = self._system.local_momentum()
        packed = self._system.ranks.sum(packed)
        by_anchor = packed[:-6].reshape(n_anchors, 15)
        unit = self._system.units
        self._end_position, self._end_step = by_anchor[:, 9:12] * unit.length, self.step
        self._end_velocity = by_anchor[:, 12:] * unit.velocity
        # Springs and dampers pull with c - k r, of which gamma v_a is the part that carries the atoms along.
        self._other_work += float(np.sum(anchors.damping[:, None] * anchors.velocity * (self._end_position - before)))
        pair_force = by_anchor[:, 6:9] * unit.force
        if links.has_passive:
            # Of a jump at the window's start the force before and after it are known.
            felt = pair_force if anchors.moving else 0.5 * (pair_force + self._pair_force)
            way = (self._end_position - before)[anchors.passive]
            self._other_work -= float(np.sum(felt[anchors.passive] * way))
            self._pair_force = pair_force
        return Window(
            # LAMMPS averages over steps 1 to M: half of the last moment makes way for half of the first.
            mean_position=by_anchor[:, :3] * unit.length - (self._end_position - before) / (2 * window),
            mean_velocity=by_anchor[:, 3:6] * unit.velocity - (self._end_velocity - speed_before) / (2 * window),
            mean_pair_force=pair_force,
            position=self._end_position,
            kinetic_handshake=float(packed[-5]),
            kinetic_inner=float(packed[-6]),
            potential_energy=self._system.potential_energy(),
            thermostat_work=self._thermostat_work(),
            momentum=packed[-3:].copy(),
            tallied=self._sample_step == self.step,
        )

    def minimise(self, iterations: int) -> None:
        """Minimise the energy of atoms and springs with anchors at rest; velocities become zero."""
        self._drop_window()
        if self._links is not None:
            self._command(self._links.energy_commands())
        tolerance = _MINIMISER_TOLERANCE / self._system.units.force
        try:
            self._command([f"minimize 0 {tolerance!r} {iterations} {10 * iterations}"])
        except EngineError as error:
            self.failure = str(error)
            raise
        self._rebuild(self._system.position(), None, self._system.box())

    # What can be looked at ------------------------------------------------------------------------------------

    def position(self) -> NDArray[np.float64]:
        """Positions now, not wrapped, m, shape (n, 3)."""
        return self._system.position()

    def velocity(self) -> NDArray[np.float64]:
        """Velocities now, m/s, shape (n, 3)."""
        return self._system.velocity()

    def box(self) -> Box:
        """The box now."""
        return self._system.box()

    def tally(self, active: bool) -> None:
        """Whether windows tally virial and energy of each atom at their ends, so that asking for them is cheap."""
        if active != self._tally_wanted:
            self._drop_window()
            self._tally_wanted = active

    def virial_and_energy(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Virial, J, shape (n, 6) as xx, yy, zz, xy, xz, yz, tension positive, and energy, J, of each atom now."""
        if self._sample_step != self.step or not self._window:
            self._drop_window()
            self._command(self._tally_commands(1))
            self._needs_setup = True
            self._run(0)
            local = np.array(self._system.session.lmp.numpy.extract_fix("window_sample", 1, 2))
            self._command(self._tally_removal_commands())
            self._needs_setup = True
        else:
            local = self._system.session.lmp.numpy.extract_fix("window_sample", 1, 2)
        sample = self._system.gather(local[: len(self._system.local_rows())])
        unit = self._system.units
        return np.ascontiguousarray(sample[:, 1:]) * (unit.pressure * unit.volume), sample[:, 0] * unit.energy

    # State ----------------------------------------------------------------------------------------------------

    def state(self) -> State:
        """What `restore` needs; the dynamics itself goes on as if restored from it.

        The thermostats are seeded anew from seed and step, and a Nose-Hoover thermostat starts with its friction
        at zero, so a run that takes a state and a run that is restored from it do the same, bit by bit, on the
        same number of ranks.
        """
        state = self._collected_state()
        self.restore(state)
        return state

    def _collected_state(self) -> State:
        box = self._system.box()
        position, velocity = self._system.position(), self._system.velocity()
        state = packed_state(position, velocity, (self.step, self._seed), self._ensemble, self.anchors, self.cuts)
        return {**state, "box": np.concatenate([box.low, box.high, box.tilt])}

    def restore(self, state: State) -> None:
        """Go back to a state.

        Raises
        ------
        ValueError
            If the state is of another system.
        """
        position, velocity, counters, ensemble, anchors = unpacked_state(state, len(self.atoms), 2)
        if "box" not in state:
            raise ValueError("state lacks box; only what the method state answers can be restored")
        corners = finite_array("state.box", state["box"], (9,))
        box = Box(corners[:3], corners[3:6], self.atoms.box.periodic, corners[6:])
        self.step, self._seed = counters
        self._ensemble, self.anchors, self.cuts = ensemble, anchors, cuts_of(state)
        self._rebuild(position, velocity, box)

    def close(self) -> None:
        """Free LAMMPS; calling it again does nothing."""
        if not self._closed:
            self._closed = True
            self._system.session.close()

    # Inside ---------------------------------------------------------------------------------------------------

    def _rebuild(self, position: NDArray[np.float64], velocity: NDArray[np.float64] | None, box: Box | None) -> None:
        """Make everything in LAMMPS anew; the one path of start, new anchors and restore."""
        self._system.build(position, velocity, box, self.cuts)
        self._window = 0
        self._needs_setup = True
        self._sample_step = -1
        self._other_work = 0.0
        self._end_position, self._end_step = None, -1
        self._pair_force = np.zeros((0 if self.anchors is None else len(self.anchors.atom_id), 3))
        self._links = None
        if self.anchors is not None:
            self._links = LammpsAnchors(self._system, self.anchors)
            self._links.install()
        self._set_motion()
        self.failure = ""

    def _reload(self) -> None:
        self._rebuild(self._system.position(), self._system.velocity(), self._system.box())

    def _set_motion(self) -> None:
        """Time integration of all atoms that are not passive, and the thermostats."""
        group = "all" if self._links is None else MOBILE
        seed, unit, planar = self._lammps_seed(), self._system.units, self.dimension == 2
        lines = ensemble_commands(self._ensemble, group, seed, unit, self.atoms.box, planar)
        for number, damping_time in enumerate(self._damping_times()):
            kelvin, damp = self._temperature, damping_time / unit.time
            lines.append(
                f"fix {_DAMPER}_{number} {damper_group(number)} langevin {kelvin!r} {kelvin!r} {damp!r}"
                f" {seed + 1 + number} tally yes"
            )
        if planar:
            lines.append("fix plane all setforce NULL NULL 0.0")  # after all other forces
        self._command(lines)
        self._last_redraw = self.step
        self._needs_setup = True

    def _motion_removal_commands(self) -> list[str]:
        planar = self.dimension == 2
        lines = ["unfix plane"] if planar else []
        lines += [f"unfix {_DAMPER}_{number}" for number in range(len(self._damping_times()))]
        return [*lines, *ensemble_removal_commands(self._ensemble, planar)]

    def _damping_times(self) -> list[float]:
        """Of the anchors' dampers, s; none without them."""
        return [] if self._links is None else self._links.damping_times.tolist()

    def _redraw(self) -> int:
        """Draw velocities anew where the Andersen thermostat is due; returns steps until it is due again."""
        if self._ensemble is None or self._ensemble.thermostat != "andersen":
            return 1 << 30
        every = max(1, round(self._ensemble.damping_time / self.time_step))
        if self.step - self._last_redraw >= every:
            before = self._kinetic_energy()
            self.draw_velocities(self._ensemble.temperature)
            self._other_work += self._kinetic_energy() - before
            self._last_redraw = self.step
        return every - (self.step - self._last_redraw)

    def _kinetic_energy(self) -> float:
        everything = np.zeros(len(self.atoms), dtype=np.int64)
        return float(self._system.ranks.sum(self._system.kinetic_energy(everything, 1))[0])

    def _run(self, steps: int) -> None:
        try:
            self._system.run(steps, self._needs_setup, self.step)
        except EngineError as error:
            self.failure = str(error)
            raise
        self._needs_setup = False
        self.step += steps

    def _prepare_window(self, window: int) -> None:
        """Set up averaging over M steps if it is not."""
        if window == self._window:
            return
        links = self._links_at_hand()
        self._drop_window()
        # Averaging fixes end at multiples of M: start counting at 0.
        self._command(["reset_timestep 0", *links.averaging_commands(window)])
        links.write()
        if self._tally_wanted:
            self._tally_every = -(-_TALLY_INTERVAL // window) * window
            self._command(self._tally_commands(self._tally_every))
        self._window = window
        self._tallied = self._tally_wanted
        self._needs_setup = True

    def _drop_window(self) -> None:
        """Take the averaging fixes away, so that runs of any length may follow."""
        if self._window:
            tally = self._tally_removal_commands() if self._tallied else []
            self._command([*tally, *self._links_at_hand().removal_commands()])
            self._window = 0
            self._needs_setup = True

    def _tally_commands(self, every: int) -> list[str]:
        # The virial per atom is tallied in every so many steps only, so it costs little.
        return [
            "compute atom_stress all stress/atom NULL virial",
            "compute atom_energy all pe/atom",
            f"fix window_sample all ave/atom {every} 1 {every} {_SAMPLE}",
        ]

    def _tally_removal_commands(self) -> list[str]:
        return ["unfix window_sample", "uncompute atom_energy", "uncompute atom_stress"]

    def _thermostat_work(self) -> float:
        """Work of dampers and thermostats on the atoms since the last rebuild, J."""
        fixes = [f"{_DAMPER}_{number}" for number in range(len(self._damping_times()))]
        if self._ensemble is not None and self._ensemble.thermostat in TALLIED:
            fixes.append(THERMOSTAT)
        # LAMMPS counts the energy that a thermostat takes out.
        taken = sum(float(self._system.session.lmp.extract_fix(fix, 0, 0)) for fix in fixes)
        return self._other_work - taken * self._system.units.energy

    def _lammps_seed(self) -> int:
        entropy = np.random.SeedSequence([self._seed, self.step])
        return int(entropy.generate_state(1)[0]) % 900_000_000 + 1

    def _command(self, lines: list[str]) -> None:
        self._system.session.commands(lines)

    def _anchors_at_hand(self) -> Anchors:
        if self.anchors is None:
            raise EngineError("there are no anchors yet: call register_anchors first")
        return self.anchors

    def _links_at_hand(self) -> LammpsAnchors:
        if self._links is None:
            raise EngineError("there are no anchors yet: call register_anchors first")
        return self._links
