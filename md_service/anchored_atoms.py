"""Anchored atoms in LAMMPS: windows of M steps, thermostats, the work that anchors do."""

import numpy as np
from numpy.typing import NDArray

from md_service import anchors as anchor_points
from md_service import units
from md_service.anchors import Anchors
from md_service.atom_fields import FieldCollector
from md_service.atom_system import AtomSystem
from md_service.errors import EngineError
from md_service.force_fields import CARBON_MASS
from md_service.results import Energies

_STARTING_DAMPING_TIME = 5e-14  # s
_MINIMISER_TOLERANCE = 1e-8  # eV/Angstrom, norm of all forces


class AnchoredAtoms:
    """Atoms with anchors on some of them.

    Parameters
    ----------
    atoms : AtomSystem
        The atoms in LAMMPS.
    collector : FieldCollector
        Sampled at the ends of windows while it is active.
    temperature : float
        Of the thermostat, K.
    seed : int
        Of velocities and thermostat.

    Attributes
    ----------
    anchors : Anchors or None
        As adopted.
    step : int
        MD steps done.
    anchor_work : float
        Work of springs, dampers and thermostat on the atoms so far, J.
    failure : str
        Why LAMMPS stopped, empty while it has not.
    """

    def __init__(self, atoms: AtomSystem, collector: FieldCollector, temperature: float, seed: int) -> None:
        self.anchors: Anchors | None = None
        self.step = 0
        self.seed = seed
        self.anchor_work = 0.0
        self.failure = ""
        self._temperature = temperature
        self._atoms = atoms
        self._collector = collector
        self._row_of_atom = np.full(atoms.n_atoms, -1, dtype=np.int64)
        self._window = 0  # M of the averaging fix that LAMMPS holds, 0 without one
        self._needs_setup = True
        self._tally = 0.0
        self._anchored_position: NDArray[np.float64] | None = None  # at the last window's end, m

    def adopt(self, anchors: Anchors | None) -> None:
        """Take over anchors; the next `rebuild` hands them to LAMMPS."""
        self.anchors = anchors
        self._row_of_atom[:] = -1
        if anchors is not None:
            self._row_of_atom[anchors.atom_id] = np.arange(len(anchors.atom_id))

    def rebuild(self, position: NDArray[np.float64], velocity: NDArray[np.float64]) -> None:
        """Make everything in LAMMPS anew from positions and velocities; the one path of start and restore."""
        self._atoms.build(position, velocity)
        self._window = 0
        self._anchored_position = None
        if self.anchors is not None:
            self._command(anchor_points.anchor_commands())
            self.write_anchors()
            self._command([*anchor_points.group_commands(), *anchor_points.force_commands()])
        self._set_coupled_thermostat()
        self.failure = ""

    def reload(self) -> None:
        """Rebuild from the present positions and velocities."""
        self.rebuild(self._atoms.position(), self._atoms.velocity())

    def write_anchors(self) -> None:
        """Hand changed anchor positions and velocities to LAMMPS."""
        anchor_points.write_anchor_arrays(self._atoms.session.lmp, self._anchors_at_hand(), self._row_of_atom)

    def start_heating(self) -> None:
        """Draw velocities and couple all atoms to a thermostat of 0.05 ps."""
        self._atoms.set_velocity(self._drawn_velocity())
        if self._has_thermostat():
            self._command(["unfix thermostat"])
        self._set_thermostat("all", _STARTING_DAMPING_TIME)

    def end_heating(self) -> None:
        """Go over to the thermostat of the coupled run."""
        self._command(["unfix thermostat"])
        self._set_coupled_thermostat()

    def run_window(self, window: int) -> tuple[NDArray[np.float64], Energies]:
        """Run one window; returns the mean force on the continuum, reference included, and the energies."""
        anchors = self._anchors_at_hand()
        position_before = self._prepare_window(window)
        self.run(window)
        lmp = self._atoms.session.lmp
        rows = self._row_of_atom[self._atoms.local_rows()]
        local = np.flatnonzero(rows >= 0)
        rows = rows[local]
        n_anchors = len(anchors.atom_id)
        # One reduction for everything: window means of position and velocity, position now, two energies.
        packed = np.zeros(9 * n_anchors + 2)
        by_anchor = packed[:-2].reshape(n_anchors, 9)
        by_anchor[rows, :6] = lmp.numpy.extract_fix("window_mean", 1, 2)[local]
        by_anchor[rows, 6:] = self._atoms.local("x")[local]
        packed[-2:] = self._atoms.kinetic_energy(self._row_of_atom >= 0)
        packed = self._atoms.ranks.sum(packed)
        by_anchor = packed[:-2].reshape(n_anchors, 9)
        position = by_anchor[:, 6:] * units.LENGTH
        force = anchors.force_on_continuum(by_anchor[:, :3] * units.LENGTH, by_anchor[:, 3:6] * units.VELOCITY)
        self._count_work(position_before, position)
        self._anchored_position = position
        if self._collector.active:
            self._collector.add_sample()
        kinetic_handshake, kinetic_inner = float(packed[-2]), float(packed[-1])
        energies = Energies(
            temperature=_temperature(kinetic_handshake + kinetic_inner, self._atoms.n_atoms),
            temperature_inner=_temperature(kinetic_inner, self._atoms.n_atoms - n_anchors),
            temperature_handshake=_temperature(kinetic_handshake, n_anchors),
            potential_energy=self._atoms.potential_energy(),
            kinetic_energy=kinetic_handshake + kinetic_inner,
            spring_energy=anchors.spring_energy(position),
            anchor_work=self.anchor_work,
        )
        return force, energies

    def run(self, steps: int) -> None:
        """Integrate, with a setup where fixes have changed."""
        try:
            self._atoms.run(steps, self._needs_setup, self.step)
        except EngineError as error:
            self.failure = str(error)
            raise
        self._needs_setup = False
        self._anchored_position = None
        self.step += steps

    def minimise(self, iterations: int) -> None:
        """Minimise the energy of atoms and springs with anchors at rest; velocities become zero."""
        if self.anchors is not None:
            self._command(["unfix anchor_force", *anchor_points.force_commands(with_energy=True)])
        self.drop_window()
        self._command([f"minimize 0 {_MINIMISER_TOLERANCE} {iterations} {10 * iterations}"])
        position = self._atoms.position()
        self.rebuild(position, np.zeros_like(position))

    def drop_window(self) -> None:
        """Take the averaging fixes away, so that runs of any length may follow."""
        if self._window:
            self._command(self._window_removal_commands())
            self._window = 0

    def sample_now(self) -> None:
        """Add a sample of this moment to the collector."""
        self.drop_window()
        self._command(self._collector.commands(1))
        self._needs_setup = True
        self.run(0)
        self._collector.add_sample()
        self._command(self._collector.removal_commands())
        self._needs_setup = True

    def _prepare_window(self, window: int) -> NDArray[np.float64]:
        """Set up averaging over M steps if it is not; returns the anchored atoms' present positions, m."""
        anchors = self._anchors_at_hand()
        if window != self._window:
            commands = [] if self._window == 0 else self._window_removal_commands()
            # Averaging fixes end at multiples of M: start counting at 0.
            commands += ["reset_timestep 0", anchor_points.averaging_command(window)]
            if self._collector.active:
                commands += self._collector.commands(window)
            self._command(commands)
            self._window = window
            self._needs_setup = True
        if self._anchored_position is None:
            return self._atoms.position()[anchors.atom_id]
        return self._anchored_position

    def _window_removal_commands(self) -> list[str]:
        collected = self._collector.removal_commands() if self._collector.active else []
        return [*collected, "unfix window_mean"]

    def _count_work(self, before: NDArray[np.float64], after: NDArray[np.float64]) -> None:
        """Add the work on the atoms in a window, from the anchored atoms' positions at its two ends."""
        anchors = self._anchors_at_hand()
        work = anchors.spring_energy(before) - anchors.spring_energy(after)
        if anchors.damping > 0.0:
            work += anchors.damping * float(np.sum(anchors.velocity * (after - before)))
            tally = float(self._atoms.session.lmp.extract_fix("thermostat", 0, 0)) * units.ENERGY
            work -= tally - self._tally  # LAMMPS counts the energy that a thermostat takes out
            self._tally = tally
        self.anchor_work += work

    def _has_thermostat(self) -> bool:
        return self.anchors is not None and self.anchors.damping > 0.0

    def _set_coupled_thermostat(self) -> None:
        """Thermostat through the dampers of the anchored atoms only."""
        self._needs_setup = True
        if self.anchors is not None and self.anchors.damping > 0.0:
            self._set_thermostat(anchor_points.GROUP, CARBON_MASS / self.anchors.damping)

    def _set_thermostat(self, group: str, damping_time: float) -> None:
        entropy = np.random.SeedSequence([self.seed, self.step])
        lammps_seed = int(entropy.generate_state(1)[0]) % 900_000_000 + 1
        self._command([anchor_points.thermostat_command(group, self._temperature, damping_time, lammps_seed)])
        self._tally = 0.0
        self._needs_setup = True

    def _drawn_velocity(self) -> NDArray[np.float64]:
        """Maxwell-Boltzmann velocities without a mean, m/s, shape (n, 3)."""
        spread = np.sqrt(units.BOLTZMANN * self._temperature / CARBON_MASS)
        velocity = np.random.default_rng([self.seed, self.step]).normal(0.0, spread, (self._atoms.n_atoms, 3))
        return np.asarray(velocity - velocity.mean(axis=0))

    def _command(self, lines: list[str]) -> None:
        self._atoms.session.commands(lines)

    def _anchors_at_hand(self) -> Anchors:
        if self.anchors is None:
            raise EngineError("there are no anchors yet: call register_anchors first")
        return self.anchors


def _temperature(kinetic_energy: float, n_atoms: int) -> float:
    return 2.0 * kinetic_energy / (3.0 * n_atoms * units.BOLTZMANN) if n_atoms else 0.0
