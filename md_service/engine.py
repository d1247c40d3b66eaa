"""The atomistic solver: atoms of any code (`md_service.dynamics`), advanced in windows of M steps.

All quantities are SI. Atom ids are rows of the sample, from 0.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from md_service.anchors import SURFACE, Anchors, checked_anchors, finite_array
from md_service.atoms import CrackCut
from md_service.bonds import BondReport
from md_service.cuts import Cut, joined
from md_service.dynamics import Dynamics, Window
from md_service.ensembles import Ensemble
from md_service.errors import EngineError
from md_service.field_means import FIELD_NAMES, FieldMeans
from md_service.force_fields import ForceField
from md_service.fracture_guard import FractureGuard
from md_service.ranks import OneRank, Ranks
from md_service.results import Advance, Equilibration, Reference, Severing
from md_service.settling import Settler
from md_service.statistics import (
    HISTORY_LENGTH,
    MINIMUM_WINDOWS,
    estimate,
    scatter_about_line,
    windows_needed,
)
from md_service.units import BOLTZMANN

Progress = Callable[[int, int], None]

_CHUNK: Final = 200  # steps between two calls of a progress callback
_STARTING_DAMPING_TIME: Final = 5e-14  # s
_ENGINE: Final = "engine_"  # before the names of the engine's own arrays in a state
_REFERENCE_NUMBERS: Final = ("temperature", "temperature_inner", "temperature_handshake", "temperature_error")


class Engine:
    """Reference forces, standard errors, broken bonds, fields and checkpoints on top of any `Dynamics`.

    Parameters
    ----------
    dynamics : Dynamics
        Atoms in motion.
    temperature : float
        K; 0 for damped motion without noise.
    force_field : ForceField, optional
        Gives the limits of a bond, where they are known.
    ranks : Ranks, optional
        MPI ranks; every rank makes the engine and calls its methods alike.
    """

    def __init__(
        self,
        dynamics: Dynamics,
        *,
        temperature: float,
        force_field: ForceField | None = None,
        ranks: Ranks | None = None,
    ) -> None:
        self.dynamics = dynamics
        self.atoms = dynamics.atoms
        self.n_atoms = len(dynamics.atoms)
        self.time_step = dynamics.time_step
        self.temperature = float(temperature)
        self.reference: Reference | None = None
        self._ranks: Ranks = OneRank() if ranks is None else ranks
        self._guard = FractureGuard(force_field, dynamics.atoms)
        self._means = FieldMeans(dynamics)
        self._anchor_work = 0.0
        self._thermostat_work = 0.0
        self._counted = 0.0  # the dynamics' thermostat work that is in it already
        self._position: NDArray[np.float64] | None = None  # of the anchored atoms at the last window's end, m
        self._history = np.zeros((0, 0, 3))  # means of the latest windows per volume cell, before the reference
        self._history_window = 0
        self._closed = False

    @property
    def step(self) -> int:
        """MD steps done so far."""
        return self.dynamics.step

    @property
    def crack(self) -> CrackCut | None:
        """The sample's crack as cuts lengthened it, in the undeformed sample; None without one."""
        return self._guard.bonds.crack

    @property
    def cuts(self) -> tuple[Cut, ...]:
        """Lines along which atoms were severed."""
        return self.dynamics.cuts

    @property
    def anchors(self) -> Anchors | None:
        """The anchors, once registered."""
        return self.dynamics.anchors

    # Anchors --------------------------------------------------------------------------------------------------

    def register_anchors(
        self,
        atom_id: ArrayLike,
        position: ArrayLike,
        stiffness: ArrayLike,
        ivc: ArrayLike,
        damping_time: float | None = None,
        kind: ArrayLike | None = None,
        moving: bool = False,
        damping_share: ArrayLike | None = None,
    ) -> None:
        """Tie atoms to anchors, at rest until the first `advance`.

        Parameters
        ----------
        atom_id : array_like of int, shape (k,)
            Rows of the anchored atoms, from 0, each once.
        position : array_like, shape (k, 3)
            Anchor positions, m.
        stiffness : array_like, shape (k,)
            Spring constants, N/m, positive; that of passive atoms does not matter.
        ivc : array_like of int, shape (k,)
            Interface volume cell of each anchor, from 0.
        damping_time : float, optional
            Of the dampers, s: gamma is an atom's mass over it. The thermostat acts through them; without it there
            is none.
        kind : array_like of int, shape (k,), optional
            0 spring, 1 passive, 2 surface (`md_service.anchors`); all springs without it.
        moving : bool
            Whether anchors move with their velocity during a window.
        damping_share : array_like, shape (k,), optional
            Factor on each damper, above 0 and at most 1; all 1 without it.

        Raises
        ------
        ValueError
            For bad input.
        """
        self._check_alive()
        anchors = checked_anchors(
            atom_id, position, stiffness, ivc, damping_time, self.atoms.atom_mass, kind, moving, damping_share
        )
        self._adopt(anchors)

    def _adopt(self, anchors: Anchors) -> None:
        self.dynamics.adopt(anchors)
        self.reference = None
        self._begin_after_change()

    # Long runs with anchors at rest ---------------------------------------------------------------------------

    def equilibrate(
        self,
        steps: int,
        progress: Progress | None = None,
        *,
        ensemble: Ensemble | None = None,
        keep_ensemble: bool = False,
        settle: bool = False,
    ) -> Equilibration:
        """Bring the atoms to the run's temperature, with anchors at rest.

        The first half couples all atoms to a thermostat, starting from a draw of velocities at the temperature of
        the run; the second half has the thermostat of the coupled run, on the anchored atoms only. At 0 K the energy
        is minimised instead, with at most `steps` iterations, and no time passes.

        Parameters
        ----------
        steps : int
            MD steps; the most with `settle`.
        progress : callable, optional
            Called with steps done and steps in all; may raise to stop.
        ensemble : Ensemble, optional
            Of the first half; Langevin with 0.05 ps without it.
        keep_ensemble : bool
            Whether the ensemble stays on in the second half and in the coupled run (the seed's option of a global
            NVT).
        settle : bool
            Whether the second half ends as soon as energy and stress drift less than their standard errors.

        Returns
        -------
        Equilibration

        Raises
        ------
        ValueError
            If no step is asked for, or an ensemble is to be kept that is not given.
        EngineError
            If the code stops or an atom runs away.
        """
        self._check_alive()
        _at_least("steps", steps, 1)
        if keep_ensemble and ensemble is None:
            raise ValueError("keep_ensemble is set, but there is no ensemble to keep")
        self._position = None
        if self.temperature == 0.0:
            self.dynamics.minimise(steps)
            self._counted = 0.0
            self._report(progress, steps, steps)
            return Equilibration(steps, None, 0.0, 0.0, np.zeros(6), np.zeros(6))
        first = steps // 2
        start = Ensemble("langevin", self.temperature, _STARTING_DAMPING_TIME) if ensemble is None else ensemble
        self.dynamics.draw_velocities(self.temperature)
        self.dynamics.hold(start)
        self._run_in_chunks(first, 0, steps, progress)
        if not keep_ensemble:
            self.dynamics.hold(None)
        settler = Settler(self.dynamics, steps - first) if settle else None
        done = first
        while done < steps:
            chunk = min(_CHUNK if settler is None else settler.block, steps - done)
            self.dynamics.run(chunk)
            done += chunk
            self._report(progress, done, steps)
            if settler is not None and settler.look():
                break
        if not keep_ensemble:
            self.dynamics.adopt(self.anchors)
        self._counted = 0.0
        if settler is None:
            return Equilibration(done, None, 0.0, 0.0, np.zeros(6), np.zeros(6))
        return settler.result(done)

    def measure_reference(self, windows: int, window: int, progress: Progress | None = None) -> Reference:
        """Average the reaction over many windows with anchors at rest: the value at t_0 of Eq 87.

        Surface atoms lose their springs first: as many windows tell the mean force that held each cell, which from
        then on acts on its atoms as a constant one (Eq 82). The sum over all anchors is set to what the compensating
        forces leave of it, zero without them. While fields are collected, their means over these windows become the
        reference of energies and virials.

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
            If there are no anchors, the code stops or an atom runs away.
        """
        _at_least("windows", windows, MINIMUM_WINDOWS)
        _at_least("window", window, 1)
        anchors = self._anchors_at_hand()
        anchors.velocity[:] = 0.0
        held_surface = (anchors.kind == SURFACE) & (anchors.stiffness > 0.0)
        rounds = 2 if held_surface.any() else 1
        if rounds == 2:
            self.dynamics.move_anchors()
            total = np.zeros_like(anchors.position)
            for done in range(windows):
                total += self._window(window)[0]
                self._report(progress, done + 1, rounds * windows)
            anchors.release_surface(-total / windows)
            self._adopt(anchors)
        self.dynamics.move_anchors()
        self._means.reset()
        total = np.zeros_like(anchors.position)
        series = np.zeros((windows, anchors.n_ivc, 3))
        temperatures = np.zeros((windows, 3))
        for done in range(windows):
            force, last = self._window(window)
            total += force
            series[done] = anchors.sum_over_ivc(force)
            temperatures[done] = self._temperatures(last)
            self._report(progress, (rounds - 1) * windows + done + 1, rounds * windows)
        mean = total / windows
        # The momentum of a sample that is held stays bounded, so reactions and compensating forces are in balance in
        # the long run; what a finite average leaves is noise, and would push the whole body for the whole run.
        mean += (anchors.force.sum(axis=0) - mean.sum(axis=0)) / len(mean)
        # Every window's share in that remainder is noise that the mean no longer has.
        share = np.bincount(anchors.ivc, minlength=anchors.n_ivc) / len(mean)
        balanced = series - share[:, None] * series.sum(axis=1, keepdims=True)
        self._means.keep_as_reference()
        overall = temperatures.mean(axis=0)
        self.reference = Reference(
            anchor_force=mean,
            ivc_force=anchors.sum_over_ivc(mean),
            ivc_standard_error=estimate(balanced, window * self.time_step).standard_error,
            window_standard_deviation=np.std(series, axis=0, ddof=1),
            temperature=float(overall[0]),
            temperature_inner=float(overall[1]),
            temperature_handshake=float(overall[2]),
            temperature_error=float(estimate(temperatures[:, 0], window * self.time_step).standard_error),
        )
        return self.reference

    # The coupling step ----------------------------------------------------------------------------------------

    def advance(
        self,
        window: int,
        anchor_position: ArrayLike,
        anchor_velocity: ArrayLike,
        until_error: float | None = None,
        most_windows: int = 1,
    ) -> Advance:
        """Set the anchors, integrate M steps and answer the mean reaction (Eq 87).

        Parameters
        ----------
        window : int
            Steps M.
        anchor_position, anchor_velocity : array_like, shape (k, 3)
            m and m/s, at the window's start. Held anchors do not move within the window; the velocity serves the
            damper.
        until_error : float, optional
            N. Windows are added, with the anchors held, until no component of `ivc_standard_error` is above it.
        most_windows : int
            The most windows then.

        Returns
        -------
        Advance

        Raises
        ------
        ValueError
            For bad input, or if moving anchors should wait for an error.
        EngineError
            If there are no anchors or no reference, the code stops or an atom runs away.
        """
        _at_least("window", window, 1)
        _at_least("most_windows", most_windows, 1)
        anchors = self._anchors_at_hand()
        reference = self.reference
        if reference is None:
            raise EngineError("there is no reference force yet: call measure_reference before advance")
        if until_error is not None and not (np.isfinite(until_error) and until_error > 0.0):
            raise ValueError(f"until_error is {until_error} N; it must be finite and positive")
        if until_error is not None and anchors.moving:
            raise ValueError("until_error is set, but the anchors move; only held anchors can wait for an error")
        shape = anchors.position.shape
        new_position = finite_array("anchor_position", anchor_position, shape)
        new_velocity = finite_array("anchor_velocity", anchor_velocity, shape)
        anchors.position, anchors.velocity = new_position, new_velocity
        self.dynamics.move_anchors()
        total, last = self._window(window)
        series = [anchors.sum_over_ivc(total)]
        error = self._error_of_mean(series)
        while until_error is not None and len(series) < most_windows and error.max(initial=0.0) > until_error:
            # At most doubled, since the error is itself an estimate.
            wanted = min(most_windows, 2 * len(series), windows_needed(error, len(series), until_error))
            for _ in range(max(1, wanted - len(series))):
                force, last = self._window(window)
                total += force
                series.append(anchors.sum_over_ivc(force))
            error = self._error_of_mean(series)
        net = total / len(series) - reference.anchor_force
        everything, inner, handshake = self._temperatures(last)
        kinetic = last.kinetic_handshake + last.kinetic_inner
        return Advance(
            step=self.step,
            windows=len(series),
            anchor_force=net,
            ivc_force=anchors.sum_over_ivc(net),
            ivc_standard_error=error,
            correlation_time=self._correlation_time(),
            temperature=everything,
            temperature_inner=inner,
            temperature_handshake=handshake,
            potential_energy=last.potential_energy,
            kinetic_energy=kinetic,
            spring_energy=anchors.spring_energy(last.position, anchors.end_position(window, self.time_step)),
            anchor_work=self._anchor_work,
            thermostat_work=self._thermostat_work,
            momentum=last.momentum,
        )

    def displace(self, displacement: ArrayLike, anchor_position: ArrayLike) -> None:
        """Move all atoms and all anchors at once, as a load does that is there from the start.

        Velocities, the reference, fields and counters stay, and no work is counted. The scatter of windows so far,
        which was under another load, is forgotten.

        Parameters
        ----------
        displacement : array_like, shape (n, 3)
            Added to the positions, m.
        anchor_position : array_like, shape (k, 3)
            Of the anchors after it, m.

        Raises
        ------
        ValueError
            For bad input.
        EngineError
            If there are no anchors.
        """
        anchors = self._anchors_at_hand()
        moved = finite_array("displacement", displacement, (self.n_atoms, 3))
        anchors.position = finite_array("anchor_position", anchor_position, anchors.position.shape)
        self.dynamics.displace(moved)
        self._begin_after_change()

    def sever(self, from_x: float, to_x: float, y: float) -> Severing:
        """Sever the atoms along a line: those on one side no longer act on those on the other.

        Severed bonds count as broken, and the crack's tip goes on from the line's end where the line begins at it. A
        line that touches an earlier one lengthens it.

        Parameters
        ----------
        from_x, to_x : float
            Where the line begins and ends in the undeformed sample, m.
        y : float
            Its height, m.

        Returns
        -------
        Severing

        Raises
        ------
        ValueError
            For bad input.
        EngineError
            If the code cannot sever its forces.
        """
        self._check_alive()
        for name, value in (("from_x", from_x), ("to_x", to_x), ("y", y)):
            if not np.isfinite(value):
                raise ValueError(f"{name} is {value} m; it must be finite")
        if not to_x > from_x:
            raise ValueError(f"to_x is {to_x} m; it must be above from_x, {from_x} m")
        low, high = self.atoms.position[:, 1].min(), self.atoms.position[:, 1].max()
        if not low < y < high:
            raise ValueError(f"y is {y} m; the sample spans {low} to {high} m along y")
        cut = Cut(float(from_x), float(to_x), float(y))
        before = float(self.dynamics.virial_and_energy()[1].sum())
        self.dynamics.sever(joined(self.dynamics.cuts, cut, self.atoms))
        self._guard.sever(self.dynamics.cuts)
        self._begin_after_change()
        return Severing(self._guard.bonds.crossed(cut), float(self.dynamics.virial_and_energy()[1].sum()) - before)

    def _begin_after_change(self) -> None:
        """The dynamics counts work anew, and the scatter of windows so far is that of another state."""
        self._counted = 0.0
        self._position = None
        self._forget_history()

    def _window(self, window: int) -> tuple[NDArray[np.float64], Window]:
        """Run one window; count its work and remember its mean force per volume cell."""
        anchors = self._anchors_at_hand()
        before = self.dynamics.position()[anchors.atom_id] if self._position is None else self._position
        last = self.dynamics.run_window(window)
        self._position = last.position
        mean_anchor = anchors.mean_position(window, self.time_step)
        force = anchors.force_on_continuum(
            last.mean_position, last.mean_velocity, last.mean_pair_force, mean_anchor
        )  # fmt: skip
        work = anchors.spring_energy(before, anchors.position)
        work -= anchors.spring_energy(last.position, anchors.end_position(window, self.time_step))
        if anchors.moving:
            spring = anchors.stiffness[:, None] * (last.mean_position - mean_anchor)
            work -= window * self.time_step * float(np.sum(anchors.velocity * (spring - anchors.force)))
        thermostat = last.thermostat_work - self._counted
        self._counted = last.thermostat_work
        self._thermostat_work += thermostat
        self._anchor_work += work + thermostat
        self._means.add(last)
        if window != self._history_window:
            self._forget_history()
            self._history_window = window
        self._history = np.concatenate([self._history, anchors.sum_over_ivc(force)[None]])[-HISTORY_LENGTH:]
        return force, last

    def _error_of_mean(self, series: list[NDArray[np.float64]]) -> NDArray[np.float64]:
        """Standard error of the mean of the latest windows, N, shape (m, 3)."""
        windows = len(series)
        if windows >= MINIMUM_WINDOWS:
            return estimate(np.array(series), self._history_window * self.time_step).standard_error
        single = self._window_error()
        if windows == 1 or len(self._history) < MINIMUM_WINDOWS:
            return single  # a few windows may be one as good as another
        independent = windows * self._history_window * self.time_step / (2.0 * self._correlation_time())
        return single / np.sqrt(min(max(independent, 1.0), float(windows)))

    def _window_error(self) -> NDArray[np.float64]:
        if len(self._history) >= MINIMUM_WINDOWS or self.reference is None:
            return scatter_about_line(self._history)
        return self.reference.window_standard_deviation.copy()

    def _correlation_time(self) -> float:
        if len(self._history) < MINIMUM_WINDOWS:
            return float("nan")
        time = np.arange(len(self._history)) - 0.5 * (len(self._history) - 1)
        flat = self._history.reshape(len(time), -1)
        straight = np.outer(time, time @ flat / (time @ time))
        return float(estimate(flat - straight, self._history_window * self.time_step).correlation_time.max())

    def _forget_history(self) -> None:
        n_ivc = 0 if self.anchors is None else self.anchors.n_ivc
        self._history = np.zeros((0, n_ivc, 3))
        self._history_window = 0

    def _temperatures(self, last: Window) -> tuple[float, float, float]:
        """Of all atoms that are not passive, of the inner and of the anchored ones, K."""
        anchors = self._anchors_at_hand()
        passive = int(np.count_nonzero(anchors.passive))
        handshake = len(anchors.atom_id) - passive
        inner = self.n_atoms - handshake - passive
        kinetic = last.kinetic_handshake + last.kinetic_inner
        freedom = self.dynamics.dimension * BOLTZMANN
        return (
            2.0 * kinetic / (freedom * (inner + handshake)) if inner + handshake else 0.0,
            2.0 * last.kinetic_inner / (freedom * inner) if inner else 0.0,
            2.0 * last.kinetic_handshake / (freedom * handshake) if handshake else 0.0,
        )

    # What can be looked at ------------------------------------------------------------------------------------

    def broken_bonds(self) -> BondReport:
        """Broken bonds, the crack tip, and bonds that stick at the potential's cut-off."""
        self._check_alive()
        return self._guard.report(self.dynamics.position())

    def collect_fields(self, active: bool) -> None:
        """Start or stop collecting mean positions, virials and energies at the ends of windows.

        Starting forgets earlier samples; start before `measure_reference` to have reference means too.

        Parameters
        ----------
        active : bool
            Whether to collect.
        """
        self._check_alive()
        self._means.collect(active)

    def fields(self, names: Iterable[str]) -> dict[str, NDArray[np.float64]]:
        """Per-atom fields in the order of ids; see `md_service.field_means.FIELD_NAMES`.

        Raises
        ------
        ValueError
            For an unknown name.
        EngineError
            If the code does not know virials of atoms.
        """
        self._check_alive()
        wanted = tuple(names)
        for name in wanted:
            if name not in FIELD_NAMES:
                raise ValueError(f"names holds {name!r}; known fields are {', '.join(FIELD_NAMES)}")
        return self._means.fields(wanted)

    @property
    def samples(self) -> int:
        """Samples in the means of `fields`; not every window need have one."""
        return self._means.samples

    def reference_fields(self) -> dict[str, NDArray[np.float64]]:
        """Mean position (m), virial and energy (J) of each atom at rest, against which J is taken.

        Raises
        ------
        EngineError
            If no fields were collected during `measure_reference`.
        """
        reference = self._means.reference
        if len(reference) == 0:
            raise EngineError("there are no reference fields: call collect_fields before measure_reference")
        position, virial, energy = reference[:, :3], reference[:, 3:9], reference[:, 9]
        return {"mean_position": position.copy(), "virial": virial.copy(), "energy": energy.copy()}

    # State ----------------------------------------------------------------------------------------------------

    def state(self) -> dict[str, NDArray[np.float64]]:
        """Everything a run needs to go on, and go on from it.

        The engine itself goes on from the state it returns, so that a run that takes a state and a run that is
        restored from it do the same, bit by bit, on the same number of ranks.

        Returns
        -------
        dict of str to ndarray
            For `restore`, of this engine or of one made with the same arguments.
        """
        self._check_alive()
        own = self._own_state()
        state = {name: np.array(value, dtype=np.float64) for name, value in self.dynamics.state().items()}
        self._counted = 0.0
        self._position = None
        return {**state, **{_ENGINE + name: np.array(value, dtype=np.float64) for name, value in own.items()}}

    def _own_state(self) -> dict[str, Any]:
        own: dict[str, Any] = {
            # The first counter is the step, for all engines.
            "counters": np.array([self.step, self._history_window, self._anchor_work, self._thermostat_work]),
            "history": self._history,
            **self._means.state(),
        }
        if self.reference is not None:
            own.update({f"reference_{name}": value for name, value in vars(self.reference).items()})
        return own

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
        own = {name.removeprefix(_ENGINE): value for name, value in state.items() if name.startswith(_ENGINE)}
        expected = {name: np.shape(value) for name, value in self._means.state().items()}
        missing = [name for name in ("counters", "history", *expected) if name not in own]
        if missing:
            raise ValueError(
                f"state lacks {_ENGINE}{missing[0]}; only what the method state answers can be restored"
            )  # fmt: skip
        for name, shape in expected.items():
            if name != "collected_reference":  # empty before the reference was measured
                finite_array(f"state.{_ENGINE}{name}", own[name], shape)
        counters = finite_array(f"state.{_ENGINE}counters", own["counters"], (4,))
        self.dynamics.restore({name: value for name, value in state.items() if not name.startswith(_ENGINE)})
        self._guard.sever(self.dynamics.cuts)
        self._history_window = int(counters[1])
        self._anchor_work, self._thermostat_work = float(counters[2]), float(counters[3])
        self._history = np.array(own["history"])
        self._counted = 0.0
        self._position = None
        self._means.restore(own)
        self.reference = None
        if "reference_anchor_force" in own:
            values: dict[str, Any] = {
                name.removeprefix("reference_"): value for name, value in own.items() if name.startswith("reference_")
            }
            for name in _REFERENCE_NUMBERS:
                values[name] = float(values[name])
            self.reference = Reference(**values)

    def close(self) -> None:
        """Free the code; calling it again does nothing."""
        if not self._closed:
            self._closed = True
            self.dynamics.close()

    # Inside ---------------------------------------------------------------------------------------------------

    def _run_in_chunks(self, steps: int, before: int, total: int, progress: Progress | None) -> None:
        done = 0
        while done < steps:
            chunk = min(_CHUNK, steps - done)
            self.dynamics.run(chunk)
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
        if self.dynamics.failure:
            raise EngineError(f"the engine stopped earlier and needs a restore: {self.dynamics.failure}")


def _at_least(name: str, value: int, lowest: int) -> None:
    if int(value) != value or value < lowest:
        raise ValueError(f"{name} is {value}; a whole number of at least {lowest} is needed")
