"""The atomistic solver: LAMMPS with anchors, advanced in windows of M steps.

All quantities are SI. Atom ids are rows of the position array that the engine was made with, from 0.
"""

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from md_service import anchors as anchor_points
from md_service import units
from md_service.anchors import Anchors, checked_anchors, finite_array
from md_service.atom_fields import COLLECTED_FIELDS, FIELD_NAMES, FieldCollector
from md_service.atom_system import AtomSystem
from md_service.bonds import BondReport, Bonds
from md_service.errors import EngineError
from md_service.force_fields import CARBON_MASS, ForceField
from md_service.force_fields import force_field as profile_of
from md_service.graphene import GRAPHENE_THICKNESS, CrackCut, area_per_atom
from md_service.parallel import OneRank, Ranks
from md_service.results import Advance, Energies, Reference
from md_service.statistics import HISTORY_LENGTH, MINIMUM_WINDOWS, block_standard_error, scatter_about_line

Progress = Callable[[int, int], None]

_CHUNK = 200  # steps between two calls of a progress callback
_STARTING_DAMPING_TIME = 5e-14  # s, all-atom thermostat of the first half of an equilibration
_MINIMISER_TOLERANCE = 1e-8  # eV/Angstrom, norm of all forces


class LammpsEngine:
    """Atoms, anchors and their time integration.

    Parameters
    ----------
    work_dir : Path
        Folder of log.lammps; made if missing.
    force_field : ForceField or str
        Profile or its name.
    position : array_like, shape (n, 3)
        Carbon atoms, undeformed, m.
    temperature : float
        K; 0 for damped motion without noise.
    seed : int
        Of velocities and thermostat, not negative.
    time_step : float, optional
        s; the profile's own without it.
    margin : float
        Free space around the atoms, m; leaving it is an error.
    crack : CrackCut, optional
        Initial slit, from which crack growth is counted.
    lattice_constant : float, optional
        Carbon-carbon distance, m, for the volume of an atom; the profile's at 0 K without it.
    thickness : float
        Of the sheet, m, for the volume of an atom.
    ranks : Ranks, optional
        MPI ranks; every rank makes the engine and calls its methods alike.

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
        force_field: ForceField | str,
        position: ArrayLike,
        *,
        temperature: float,
        seed: int,
        time_step: float | None = None,
        margin: float = 20e-10,
        crack: CrackCut | None = None,
        lattice_constant: float | None = None,
        thickness: float = GRAPHENE_THICKNESS,
        ranks: Ranks | None = None,
    ) -> None:
        self.force_field = profile_of(force_field) if isinstance(force_field, str) else force_field
        n_atoms = np.shape(position)[0] if np.ndim(position) else 0
        reference = finite_array("position", position, (max(n_atoms, 1), 3))
        self.time_step = self.force_field.time_step if time_step is None else float(time_step)
        for name, value, lowest in (
            ("temperature", temperature, 0.0),
            ("seed", seed, 0),
            ("time_step", self.time_step, np.nextafter(0.0, 1.0)),
            ("margin", margin, 1e-10),
            ("thickness", thickness, np.nextafter(0.0, 1.0)),
        ):
            if not (np.isfinite(value) and value >= lowest):
                raise ValueError(f"{name} is {value}; it must be finite and at least {lowest:.3g}")
        self.temperature, self.seed = float(temperature), int(seed)
        self.step = 0
        self.n_atoms = n_atoms
        self.anchors: Anchors | None = None
        self.reference: Reference | None = None
        self._ranks: Ranks = OneRank() if ranks is None else ranks
        self._bonds = Bonds(reference, self.force_field, crack)
        self._atoms = AtomSystem(
            Path(work_dir), self.force_field, reference, float(margin), self.time_step, self._ranks
        )
        a_cc = self.force_field.lattice_constant if lattice_constant is None else float(lattice_constant)
        self._collector = FieldCollector(self._atoms, area_per_atom(a_cc) * float(thickness))
        self._row_of_atom = np.full(n_atoms, -1, dtype=np.int64)
        self._window = 0  # M of the averaging fix that LAMMPS holds, 0 without one
        self._needs_setup = True
        self._history = np.zeros((0, 0, 3))  # means of the latest windows per volume cell, before the reference
        self._history_window = 0
        self._anchor_work = 0.0
        self._tally = 0.0
        self._failure = ""
        self._closed = False
        self._anchored_position: NDArray[np.float64] | None = None  # at the last window's end, m
        self._rebuild(reference, np.zeros_like(reference))

    # Anchors --------------------------------------------------------------------------------------------------

    def register_anchors(
        self,
        atom_id: ArrayLike,
        position: ArrayLike,
        stiffness: ArrayLike,
        ivc: ArrayLike,
        damping: ArrayLike,
    ) -> None:
        """Tie atoms to anchors, at rest until the first `advance`.

        Parameters
        ----------
        atom_id : array_like of int, shape (k,)
            Rows of the anchored atoms, from 0, each once.
        position : array_like, shape (k, 3)
            Anchor positions, m.
        stiffness : array_like, shape (k,)
            Spring constants, N/m, positive.
        ivc : array_like of int, shape (k,)
            Interface volume cell of each anchor, from 0.
        damping : array_like
            Damper constant gamma, kg/s: a number, or k equal ones. The thermostat acts through it; with 0 there
            is none.

        Raises
        ------
        ValueError
            For bad input.
        """
        self._check_alive()
        anchors = checked_anchors(atom_id, position, stiffness, ivc, damping, self.n_atoms)
        self._adopt_anchors(anchors)
        self.reference = None
        self._forget_history()
        self._rebuild(self._atoms.position(), self._atoms.velocity())

    def _adopt_anchors(self, anchors: Anchors) -> None:
        self.anchors = anchors
        self._row_of_atom[:] = -1
        self._row_of_atom[anchors.atom_id] = np.arange(len(anchors.atom_id))

    # Long runs with anchors at rest ---------------------------------------------------------------------------

    def equilibrate(self, steps: int, progress: Progress | None = None) -> None:
        """Bring the atoms to the run's temperature, with anchors at rest.

        The first half couples all atoms to a Langevin thermostat of 0.05 ps, starting from a draw of velocities;
        the second half has the thermostat of the coupled run, on the anchored atoms only. At 0 K the energy is
        minimised instead, with at most `steps` iterations, and no time passes.

        Parameters
        ----------
        steps : int
            MD steps.
        progress : callable, optional
            Called with steps done and steps in all; may raise to stop.

        Raises
        ------
        ValueError
            If no step is asked for.
        EngineError
            If LAMMPS stops or an atom runs away.
        """
        self._check_alive()
        _at_least("steps", steps, 1)
        if self.temperature == 0.0:
            self._minimise(steps)
            self._report(progress, steps, steps)
            return
        self._atoms.set_velocity(self._drawn_velocity())
        first = steps // 2
        self._set_thermostat("all", _STARTING_DAMPING_TIME)
        self._run_in_chunks(first, 0, steps, progress)
        self._set_coupled_thermostat(replace=True)
        self._run_in_chunks(steps - first, first, steps, progress)
        self._reload()

    def measure_reference(self, windows: int, window: int, progress: Progress | None = None) -> Reference:
        """Average the reaction over many windows with anchors at rest: the value at t_0 of Eq 87.

        Parameters
        ----------
        windows : int
            Number of windows, at least 8.
        window : int
            Steps M per window; use that of the coupled run.
        progress : callable, optional
            Called with windows done and windows in all; may raise to stop.

        Returns
        -------
        Reference

        Raises
        ------
        ValueError
            For bad input.
        EngineError
            If there are no anchors, LAMMPS stops or an atom runs away.
        """
        _at_least("windows", windows, MINIMUM_WINDOWS)
        _at_least("window", window, 1)
        anchors = self._anchors_at_hand()
        anchors.velocity[:] = 0.0
        self._write_anchors()
        total = np.zeros_like(anchors.position)
        series = np.zeros((windows, anchors.n_ivc, 3))
        temperatures = np.zeros(3)
        for done in range(windows):
            force, energies = self._run_window(window)
            total += force
            series[done] = anchors.sum_over_ivc(force)
            temperatures += [energies.temperature, energies.temperature_inner, energies.temperature_handshake]
            self._report(progress, done + 1, windows)
        temperatures /= windows
        mean = total / windows
        self.reference = Reference(
            anchor_force=mean,
            ivc_force=anchors.sum_over_ivc(mean),
            ivc_standard_error=block_standard_error(series),
            window_standard_deviation=np.std(series, axis=0, ddof=1),
            temperature=float(temperatures[0]),
            temperature_inner=float(temperatures[1]),
            temperature_handshake=float(temperatures[2]),
        )
        return self.reference

    # The coupling step ----------------------------------------------------------------------------------------

    def advance(self, window: int, anchor_position: ArrayLike, anchor_velocity: ArrayLike) -> Advance:
        """Set the anchors, hold them, integrate M steps and answer the mean reaction (Eq 87).

        Parameters
        ----------
        window : int
            Steps M.
        anchor_position, anchor_velocity : array_like, shape (k, 3)
            m and m/s. Anchors do not move within the window; the velocity serves the damper.

        Returns
        -------
        Advance

        Raises
        ------
        ValueError
            For bad input.
        EngineError
            If there are no anchors or no reference, LAMMPS stops or an atom runs away.
        """
        _at_least("window", window, 1)
        anchors = self._anchors_at_hand()
        reference = self.reference
        if reference is None:
            raise EngineError("there is no reference force yet: call measure_reference before advance")
        shape = anchors.position.shape
        new_position = finite_array("anchor_position", anchor_position, shape)
        new_velocity = finite_array("anchor_velocity", anchor_velocity, shape)
        anchors.position, anchors.velocity = new_position, new_velocity
        self._write_anchors()
        force, energies = self._run_window(window)
        net = force - reference.anchor_force
        return Advance(
            **vars(energies),
            step=self.step,
            anchor_force=net,
            ivc_force=anchors.sum_over_ivc(net),
            ivc_standard_error=self._window_error(),
        )

    def _run_window(self, window: int) -> tuple[NDArray[np.float64], Energies]:
        """Run one window; returns the mean force on the continuum, reference included, and the energies."""
        anchors = self._anchors_at_hand()
        position_before = self._prepare_window(window)
        self._run(window)
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
        packed = self._ranks.sum(packed)
        by_anchor = packed[:-2].reshape(n_anchors, 9)
        position = by_anchor[:, 6:] * units.LENGTH
        force = anchors.force_on_continuum(by_anchor[:, :3] * units.LENGTH, by_anchor[:, 3:6] * units.VELOCITY)
        self._count_work(position_before, position)
        self._anchored_position = position
        if self._collector.active:
            self._collector.add_sample()
        self._history = np.concatenate([self._history, anchors.sum_over_ivc(force)[None]])[-HISTORY_LENGTH:]
        kinetic_handshake, kinetic_inner = float(packed[-2]), float(packed[-1])
        energies = Energies(
            temperature=_temperature(kinetic_handshake + kinetic_inner, self.n_atoms),
            temperature_inner=_temperature(kinetic_inner, self.n_atoms - n_anchors),
            temperature_handshake=_temperature(kinetic_handshake, n_anchors),
            potential_energy=self._atoms.potential_energy(),
            kinetic_energy=kinetic_handshake + kinetic_inner,
            spring_energy=anchors.spring_energy(position),
            anchor_work=self._anchor_work,
        )
        return force, energies

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
        if window != self._history_window:
            self._forget_history()
            self._history_window = window
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
        self._anchor_work += work

    def _window_error(self) -> NDArray[np.float64]:
        if len(self._history) >= MINIMUM_WINDOWS or self.reference is None:
            return scatter_about_line(self._history)
        return self.reference.window_standard_deviation.copy()

    def _forget_history(self) -> None:
        n_ivc = 0 if self.anchors is None else self.anchors.n_ivc
        self._history = np.zeros((0, n_ivc, 3))
        self._history_window = 0

    # What can be looked at ------------------------------------------------------------------------------------

    def broken_bonds(self) -> BondReport:
        """Broken bonds, the crack tip, and bonds that stick at the potential's cut-off."""
        self._check_alive()
        return self._bonds.report(self._atoms.position())

    def collect_fields(self, active: bool) -> None:
        """Start or stop collecting mean positions, stresses and energies at the ends of windows.

        Starting forgets earlier samples.

        Parameters
        ----------
        active : bool
            Whether to collect.
        """
        self._check_alive()
        self._drop_window()
        self._collector.active = active
        if active:
            self._collector.reset()

    def fields(self, names: Iterable[str]) -> dict[str, NDArray[np.float64]]:
        """Per-atom fields in the order of ids.

        Parameters
        ----------
        names : iterable of str
            ``position`` (m) and ``velocity`` (m/s), shape (n, 3), are those of this moment. ``mean_position``
            (m, shape (n, 3)), ``stress`` (Pa, shape (n, 6): xx, yy, zz, xy, xz, yz, the virial of the pair
            potential, tension positive) and ``energy`` (J, shape (n,)) are means over the window ends since
            `collect_fields`; where there are none they are of this moment, which costs a new setup.

        Raises
        ------
        ValueError
            For an unknown name.
        """
        self._check_alive()
        wanted = tuple(names)
        for name in wanted:
            if name not in FIELD_NAMES:
                raise ValueError(f"names holds {name!r}; known fields are {', '.join(FIELD_NAMES)}")
        collected = tuple(name for name in wanted if name in COLLECTED_FIELDS)
        found = self._collected(collected) if collected else {}
        if "position" in wanted:
            found["position"] = self._atoms.position()
        if "velocity" in wanted:
            found["velocity"] = self._atoms.velocity()
        return {name: found[name] for name in wanted}

    def _collected(self, names: tuple[str, ...]) -> dict[str, NDArray[np.float64]]:
        if self._collector.samples:
            return self._collector.means(names)
        self._drop_window()
        self._command(self._collector.commands(1))
        self._needs_setup = True
        self._run(0)
        self._collector.add_sample()
        means = self._collector.means(names)
        self._collector.reset()
        self._command(self._collector.removal_commands())
        self._needs_setup = True
        return means

    def _drop_window(self) -> None:
        if self._window:
            self._command(self._window_removal_commands())
            self._window = 0

    # State ----------------------------------------------------------------------------------------------------

    def state(self) -> dict[str, NDArray[np.float64]]:
        """Everything a run needs to go on, and go on from it.

        The engine itself is rebuilt from the state it returns, with the thermostat seeded anew from seed and
        step. So a run that takes a state and a run that is restored from it do the same, bit by bit, on the same
        number of ranks.

        Returns
        -------
        dict of str to ndarray
            For `restore`, of this engine or of one made with the same arguments.
        """
        self._check_alive()
        state = {
            "position": self._atoms.position(),
            "velocity": self._atoms.velocity(),
            "counters": np.array([self.step, self.seed, self._history_window], dtype=np.float64),
            "history": self._history,
            "anchor_work": np.array([self._anchor_work]),
            "collected_sum": self._ranks.sum(self._collector.sum),
            "collected_samples": np.array([self._collector.samples, self._collector.active], dtype=np.float64),
        }
        if self.anchors is not None:
            for name in _ANCHOR_ARRAYS:
                state[f"anchor_{name}"] = np.array(getattr(self.anchors, name), dtype=np.float64)
        if self.reference is not None:
            for name, value in vars(self.reference).items():
                state[f"reference_{name}"] = np.array(value, dtype=np.float64)
        state = {name: np.array(value, dtype=np.float64) for name, value in state.items()}
        self.restore(state)
        return state

    def restore(self, state: dict[str, NDArray[np.float64]]) -> None:
        """Go back to a state.

        Parameters
        ----------
        state : dict of str to ndarray
            From `state`.

        Raises
        ------
        ValueError
            If the state is of another system.
        """
        if self._closed:
            raise EngineError("the engine is closed")
        missing = [name for name in _STATE_ARRAYS if name not in state]
        if missing:
            raise ValueError(f"state lacks {', '.join(missing)}; only what the method state answers can be restored")
        shape = (self.n_atoms, 3)
        position = finite_array("position", state["position"], shape)
        velocity = finite_array("velocity", state["velocity"], shape)
        self.step, self.seed, self._history_window = (int(value) for value in state["counters"])
        self._history = np.array(state["history"])
        self._anchor_work = float(state["anchor_work"][0])
        # The sum is over ranks already: rank 0 carries it on.
        self._collector.sum = np.array(state["collected_sum"]) * float(self._ranks.rank == 0)
        self._collector.samples = int(state["collected_samples"][0])
        self._collector.active = bool(state["collected_samples"][1])
        self.anchors = None
        if "anchor_atom_id" in state:
            values = {name: np.array(state[f"anchor_{name}"]) for name in _ANCHOR_ARRAYS}
            self._adopt_anchors(
                Anchors(
                    atom_id=values["atom_id"].astype(np.int64),
                    position=values["position"],
                    velocity=values["velocity"],
                    stiffness=values["stiffness"],
                    ivc=values["ivc"].astype(np.int64),
                    damping=float(values["damping"]),
                )
            )
        self.reference = None
        if "reference_anchor_force" in state:
            self.reference = Reference(
                anchor_force=np.array(state["reference_anchor_force"]),
                ivc_force=np.array(state["reference_ivc_force"]),
                ivc_standard_error=np.array(state["reference_ivc_standard_error"]),
                window_standard_deviation=np.array(state["reference_window_standard_deviation"]),
                temperature=float(state["reference_temperature"]),
                temperature_inner=float(state["reference_temperature_inner"]),
                temperature_handshake=float(state["reference_temperature_handshake"]),
            )
        self._failure = ""
        self._rebuild(position, velocity)

    def close(self) -> None:
        """Free LAMMPS; calling it again does nothing."""
        if not self._closed:
            self._closed = True
            self._atoms.session.close()

    # Inside ---------------------------------------------------------------------------------------------------

    def _rebuild(self, position: NDArray[np.float64], velocity: NDArray[np.float64]) -> None:
        """Make everything in LAMMPS anew from positions and velocities; the one path of start and restore."""
        self._atoms.build(position, velocity)
        self._window = 0
        self._anchored_position = None
        if self.anchors is not None:
            self._command(anchor_points.anchor_commands())
            self._write_anchors()
            self._command([*anchor_points.group_commands(), *anchor_points.force_commands()])
        self._set_coupled_thermostat(replace=False)

    def _reload(self) -> None:
        self._rebuild(self._atoms.position(), self._atoms.velocity())

    def _write_anchors(self) -> None:
        anchor_points.write_anchor_arrays(self._atoms.session.lmp, self._anchors_at_hand(), self._row_of_atom)

    def _set_coupled_thermostat(self, replace: bool = True) -> None:
        """Thermostat of the coupled run: through the dampers of the anchored atoms only."""
        if self.anchors is None or self.anchors.damping == 0.0:
            if replace:
                self._command(["unfix thermostat"])
            self._needs_setup = True
            return
        self._set_thermostat(anchor_points.GROUP, CARBON_MASS / self.anchors.damping)

    def _set_thermostat(self, group: str, damping_time: float) -> None:
        entropy = np.random.SeedSequence([self.seed, self.step])
        lammps_seed = int(entropy.generate_state(1)[0]) % 900_000_000 + 1
        self._command([anchor_points.thermostat_command(group, self.temperature, damping_time, lammps_seed)])
        self._tally = 0.0
        self._needs_setup = True

    def _drawn_velocity(self) -> NDArray[np.float64]:
        """Maxwell-Boltzmann velocities without a mean, m/s, shape (n, 3)."""
        spread = np.sqrt(units.BOLTZMANN * self.temperature / (CARBON_MASS))
        velocity = np.random.default_rng([self.seed, self.step]).normal(0.0, spread, (self.n_atoms, 3))
        return np.asarray(velocity - velocity.mean(axis=0))

    def _minimise(self, iterations: int) -> None:
        if self.anchors is not None:
            self._command(["unfix anchor_force", *anchor_points.force_commands(with_energy=True)])
        self._drop_window()
        self._command([f"minimize 0 {_MINIMISER_TOLERANCE} {iterations} {10 * iterations}"])
        position = self._atoms.position()
        self._rebuild(position, np.zeros_like(position))

    def _run_in_chunks(self, steps: int, before: int, total: int, progress: Progress | None) -> None:
        self._drop_window()
        done = 0
        while done < steps:
            chunk = min(_CHUNK, steps - done)
            self._run(chunk)
            done += chunk
            self._report(progress, before + done, total)

    def _run(self, steps: int) -> None:
        try:
            self._atoms.run(steps, self._needs_setup, self.step)
        except EngineError as error:
            self._failure = str(error)
            raise
        self._needs_setup = False
        self._anchored_position = None
        self.step += steps

    def _command(self, lines: list[str]) -> None:
        self._atoms.session.commands(lines)

    def _report(self, progress: Progress | None, done: int, total: int) -> None:
        """Call rank 0's progress callback; if it raises, every rank stops."""
        raised: BaseException | None = None
        if progress is not None:
            try:
                progress(done, total)
            except BaseException as error:
                raised = error
        if self._ranks.agree(raised is not None):
            raise raised if raised is not None else EngineError("rank 0 stopped the run")

    def _anchors_at_hand(self) -> Anchors:
        self._check_alive()
        if self.anchors is None:
            raise EngineError("there are no anchors yet: call register_anchors first")
        return self.anchors

    def _check_alive(self) -> None:
        if self._closed:
            raise EngineError("the engine is closed")
        if self._failure:
            raise EngineError(f"the engine stopped earlier and needs a restore: {self._failure}")


_STATE_ARRAYS = (
    *("position", "velocity", "counters", "history"),
    *("anchor_work", "collected_sum", "collected_samples"),
)
_ANCHOR_ARRAYS = ("atom_id", "position", "velocity", "stiffness", "ivc", "damping")


def _temperature(kinetic_energy: float, n_atoms: int) -> float:
    return 2.0 * kinetic_energy / (3.0 * n_atoms * units.BOLTZMANN) if n_atoms else 0.0


def _at_least(name: str, value: int, lowest: int) -> None:
    if int(value) != value or value < lowest:
        raise ValueError(f"{name} is {value}; a whole number of at least {lowest} is needed")
