"""The atomistic solver: LAMMPS with anchors, advanced in windows of M steps.

All quantities are SI. Atom ids are rows of the position array that the engine was made with, from 0.
"""

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from md_service.anchored_atoms import AnchoredAtoms
from md_service.anchors import Anchors, checked_anchors, finite_array
from md_service.atom_fields import COLLECTED_FIELDS, FIELD_NAMES, FieldCollector
from md_service.atom_system import AtomSystem
from md_service.bonds import BondReport, Bonds
from md_service.errors import EngineError
from md_service.force_fields import ForceField
from md_service.force_fields import force_field as profile_of
from md_service.graphene import GRAPHENE_THICKNESS, CrackCut, area_per_atom
from md_service.ranks import OneRank, Ranks
from md_service.results import Advance, Energies, Reference
from md_service.statistics import HISTORY_LENGTH, MINIMUM_WINDOWS, block_standard_error, scatter_about_line

Progress = Callable[[int, int], None]

_CHUNK = 200  # steps between two calls of a progress callback


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
        if seed > 2**53:
            raise ValueError(f"seed is {seed}; at most {2**53} is allowed, so that a saved state can hold it")
        self.temperature = float(temperature)
        self.n_atoms = n_atoms
        self.reference: Reference | None = None
        self._ranks: Ranks = OneRank() if ranks is None else ranks
        self._bonds = Bonds(reference, self.force_field, crack)
        self._atoms = AtomSystem(
            Path(work_dir), self.force_field, reference, float(margin), self.time_step, self._ranks
        )
        a_cc = self.force_field.lattice_constant if lattice_constant is None else float(lattice_constant)
        self._collector = FieldCollector(self._atoms, area_per_atom(a_cc) * float(thickness))
        self._md = AnchoredAtoms(self._atoms, self._collector, self.temperature, int(seed))
        self._history = np.zeros((0, 0, 3))  # means of the latest windows per volume cell, before the reference
        self._history_window = 0
        self._closed = False
        self._md.rebuild(reference, np.zeros_like(reference))

    @property
    def step(self) -> int:
        """MD steps done so far."""
        return self._md.step

    @property
    def anchors(self) -> Anchors | None:
        """The anchors, once registered."""
        return self._md.anchors

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
        self._md.adopt(anchors)
        self.reference = None
        self._forget_history()
        self._md.reload()

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
            self._md.minimise(steps)
            self._report(progress, steps, steps)
            return
        first = steps // 2
        self._md.drop_window()
        self._md.start_heating()
        try:
            self._run_in_chunks(first, 0, steps, progress)
        finally:
            if not self._md.failure:
                self._md.end_heating()
        self._run_in_chunks(steps - first, first, steps, progress)
        self._md.reload()

    def measure_reference(self, windows: int, window: int, progress: Progress | None = None) -> Reference:
        """Average the reaction over many windows with anchors at rest: the value at t_0 of Eq 87.

        Its sum over all anchors is set to zero.

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
        self._md.write_anchors()
        total = np.zeros_like(anchors.position)
        series = np.zeros((windows, anchors.n_ivc, 3))
        temperatures = np.zeros(3)
        for done in range(windows):
            force, energies = self._window(window)
            total += force
            series[done] = anchors.sum_over_ivc(force)
            temperatures += [energies.temperature, energies.temperature_inner, energies.temperature_handshake]
            self._report(progress, done + 1, windows)
        temperatures /= windows
        mean = total / windows
        # The momentum of a sample that is held stays bounded, so the sum over all anchors is zero in the long
        # run; what a finite average leaves of it is noise, and would push the whole body for the whole run.
        mean -= mean.mean(axis=0)
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
        self._md.write_anchors()
        force, energies = self._window(window)
        net = force - reference.anchor_force
        return Advance(
            **vars(energies),
            step=self.step,
            anchor_force=net,
            ivc_force=anchors.sum_over_ivc(net),
            ivc_standard_error=self._window_error(),
        )

    def _window(self, window: int) -> tuple[NDArray[np.float64], Energies]:
        """Run one window and remember its mean force per volume cell."""
        force, energies = self._md.run_window(window)
        if window != self._history_window:
            self._forget_history()
            self._history_window = window
        by_cell = self._anchors_at_hand().sum_over_ivc(force)
        self._history = np.concatenate([self._history, by_cell[None]])[-HISTORY_LENGTH:]
        return force, energies

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
        self._md.drop_window()
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
        self._md.sample_now()
        means = self._collector.means(names)
        self._collector.reset()
        return means

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
        state = self._collected_state()
        self.restore(state)
        return state

    def _collected_state(self) -> dict[str, NDArray[np.float64]]:
        state = {
            "position": self._atoms.position(),
            "velocity": self._atoms.velocity(),
            "counters": np.array([self.step, self._md.seed, self._history_window], dtype=np.float64),
            "history": self._history,
            "anchor_work": np.array([self._md.anchor_work]),
            "collected_sum": self._ranks.sum(self._collector.sum),
            "collected_samples": np.array([self._collector.samples, self._collector.active], dtype=np.float64),
        }
        if self.anchors is not None:
            for name in _ANCHOR_ARRAYS:
                state[f"anchor_{name}"] = np.array(getattr(self.anchors, name), dtype=np.float64)
        if self.reference is not None:
            for name, value in vars(self.reference).items():
                state[f"reference_{name}"] = np.array(value, dtype=np.float64)
        return {name: np.array(value, dtype=np.float64) for name, value in state.items()}

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
        for name, mine in self._collected_state().items():
            # The history grows with the run; all else has the shape that sample and anchors give it.
            if name != "history" and name in state and np.shape(state[name]) != mine.shape:
                raise ValueError(f"state.{name} has shape {np.shape(state[name])}, must have {mine.shape}")
        shape = (self.n_atoms, 3)
        position = finite_array("position", state["position"], shape)
        velocity = finite_array("velocity", state["velocity"], shape)
        self._md.step, self._md.seed, self._history_window = (int(value) for value in state["counters"])
        self._history = np.array(state["history"])
        self._md.anchor_work = float(state["anchor_work"][0])
        # The sum is over ranks already: rank 0 carries it on.
        self._collector.sum = np.array(state["collected_sum"]) * float(self._ranks.rank == 0)
        self._collector.samples = int(state["collected_samples"][0])
        self._collector.active = bool(state["collected_samples"][1])
        anchors = None
        if "anchor_atom_id" in state:
            values = {name: np.array(state[f"anchor_{name}"]) for name in _ANCHOR_ARRAYS}
            anchors = Anchors(
                atom_id=values["atom_id"].astype(np.int64),
                position=values["position"],
                velocity=values["velocity"],
                stiffness=values["stiffness"],
                ivc=values["ivc"].astype(np.int64),
                damping=float(values["damping"]),
            )
        self._md.adopt(anchors)
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
        self._md.rebuild(position, velocity)

    def close(self) -> None:
        """Free LAMMPS; calling it again does nothing."""
        if not self._closed:
            self._closed = True
            self._atoms.session.close()

    # Inside ---------------------------------------------------------------------------------------------------

    def _run_in_chunks(self, steps: int, before: int, total: int, progress: Progress | None) -> None:
        done = 0
        while done < steps:
            chunk = min(_CHUNK, steps - done)
            self._md.run(chunk)
            done += chunk
            self._report(progress, before + done, total)

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
        if self._md.failure:
            raise EngineError(f"the engine stopped earlier and needs a restore: {self._md.failure}")


_STATE_ARRAYS = (
    *("position", "velocity", "counters", "history"),
    *("anchor_work", "collected_sum", "collected_samples"),
)
_ANCHOR_ARRAYS = ("atom_id", "position", "velocity", "stiffness", "ivc", "damping")


def _at_least(name: str, value: int, lowest: int) -> None:
    if int(value) != value or value < lowest:
        raise ValueError(f"{name} is {value}; a whole number of at least {lowest} is needed")
