"""Time integration for engines that only know forces: anchors, dampers, thermostats, passive atoms, window means.

One step is a splitting: half a friction step, half a kick, a drift, half a kick, half a friction step. The kicks are
velocity Verlet. The friction steps draw the velocity towards that of the anchor and add the noise that belongs to it;
with x = gamma dt / m they keep 1 / (1 + x/2) of the relative velocity at the end of a step and 1 - x/2 at the start of
the next, so that each hands over exactly gamma dt/2 (v_a - v), v being the velocity at the step's end. So the mean
reaction of `Anchors` gives the continuum the very momentum that the atoms lose. Work of friction and noise is the
change of kinetic energy in those steps, exactly.

All noise comes from a counter-based generator keyed by seed and step, so a state needs no generator in it.
"""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from md_service.anchors import Anchors, finite_array
from md_service.atoms import Atoms, Box
from md_service.cuts import Cut
from md_service.dynamics import State, Window
from md_service.ensembles import Ensemble
from md_service.errors import EngineError
from md_service.fire import relax
from md_service.integration_kernels import add_springs, friction, kick, kick_and_drift, tally
from md_service.nose_hoover import CHAIN, chain_half_step
from md_service.saved_state import cuts_of, packed_state, unpacked_state
from md_service.units import BOLTZMANN, LENGTH

LARGEST_STEP = 0.2e-10  # m moved in one step: beyond it no time step resolves a bond
_FORCE_TOLERANCE = 1.6e-17  # N (1e-8 eV/Angstrom), norm of all forces at a minimum
_BEFORE, _AFTER, _BEFORE_ALL, _AFTER_ALL, _DRAW, _ANDERSEN = range(6)  # streams of noise within a step


class Interactions(Protocol):
    """Forces between atoms, SI units.

    Attributes
    ----------
    dimension : int
        2 where all motion stays in the plane z = const, 1 where it stays on a line along x, else 3: degrees of freedom
        of an atom.
    """

    dimension: int

    def forces(self, position: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
        """Forces, N, shape (n, 3), as an array of the caller's own, and the potential energy, J."""

    def virial_and_energy(self, position: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """As `md_service.dynamics.Dynamics.virial_and_energy`."""

    def reset(self) -> None:
        """Forget everything that depends on earlier positions, such as neighbour lists."""

    def close(self) -> None:
        """Free what there is to free; calling it again does nothing."""


@runtime_checkable
class Severable(Protocol):
    """Forces that can be severed along lines."""

    def sever(self, cuts: tuple[Cut, ...]) -> None:
        """Let no forces act across these lines, and across no others."""


class VelocityVerlet:
    """Atoms in motion under given interactions; implements `md_service.dynamics.Dynamics`.

    Parameters
    ----------
    atoms : Atoms
        The sample.
    interactions : Interactions
        Forces.
    temperature : float
        Of the anchors' thermostat, K.
    seed : int
        Of velocities and noise, not negative.
    time_step : float
        s.

    Raises
    ------
    ValueError
        For a number out of range.
    """

    def __init__(
        self, atoms: Atoms, interactions: Interactions, *, temperature: float, seed: int, time_step: float
    ) -> None:
        for name, value, lowest in (
            ("temperature", temperature, 0.0),
            ("seed", seed, 0),
            ("time_step", time_step, np.nextafter(0.0, 1.0)),
        ):
            if not (np.isfinite(value) and value >= lowest):
                raise ValueError(f"{name} is {value}; it must be finite and at least {lowest:.3g}")
        self.atoms = atoms
        self.time_step = float(time_step)
        self.step = 0
        self.anchors: Anchors | None = None
        self.cuts: tuple[Cut, ...] = ()
        self.failure = ""
        self.dimension = interactions.dimension
        self._interactions = interactions
        self._temperature = float(temperature)
        self._seed = int(seed)
        self._mass = np.ascontiguousarray(atoms.atom_mass)
        self._position = np.array(atoms.position, dtype=np.float64, order="C")
        self._velocity = np.zeros_like(self._position)
        self._half_kick = 0.5 * self.time_step / self._mass
        self._ensemble: Ensemble | None = None
        self._chain = np.zeros(CHAIN)  # rates of the Nose-Hoover chain, 1/s
        self._work = 0.0
        self._elapsed = 0  # steps since the anchors were moved
        self._pair_force: NDArray[np.float64] | None = None  # None where positions have changed since
        self._potential_energy = 0.0
        self.adopt(None)

    # Anchors --------------------------------------------------------------------------------------------------

    def adopt(self, anchors: Anchors | None) -> None:
        """Take over anchors; see `Dynamics`.

        Raises
        ------
        ValueError
            If a damping time is shorter than the time step.
        """
        if anchors is not None and (anchors.damping * self.time_step > self._mass[anchors.atom_id]).any():
            shortest = float((self._mass[anchors.atom_id] / np.maximum(anchors.damping, 1e-300)).min())
            raise ValueError(f"damping_time is {shortest:.3g} s; it must be at least the time step {self.time_step} s")
        self._take_over(anchors)
        self.hold(None)
        self.move_anchors()
        self._work = 0.0

    def _take_over(self, anchors: Anchors | None) -> None:
        self.anchors = anchors
        self._rows = np.zeros(0, dtype=np.int64) if anchors is None else anchors.atom_id
        self._passive = np.zeros(0, dtype=np.int64) if anchors is None else np.flatnonzero(anchors.passive)
        self._free = np.ones(len(self._mass), dtype=np.bool_)
        self._free[self._rows[self._passive]] = False
        self._free_rows = np.flatnonzero(self._free)

    def move_anchors(self) -> None:
        """Take over changed anchors; see `Dynamics`."""
        self._elapsed = 0
        anchors = self.anchors
        if anchors is None or len(self._passive) == 0:
            return
        rows = self._rows[self._passive]
        place = anchors.position[self._passive]
        self._velocity[rows] = anchors.velocity[self._passive] if anchors.moving else 0.0
        if not np.array_equal(self._position[rows], place):
            # What moves passive atoms does work on all others.
            before = self._interaction_energy()
            self._position[rows] = place
            self._pair_force = None
            self._work += self._interaction_energy() - before

    def displace(self, displacement: NDArray[np.float64]) -> None:
        """Move all atoms at once; see `Dynamics`."""
        self._position += displacement
        if self.anchors is not None:
            self._position[self._rows[self._passive]] = self.anchors.position[self._passive]
        self._pair_force = None
        self.move_anchors()
        self._work = 0.0

    def sever(self, cuts: tuple[Cut, ...]) -> None:
        """Sever the atoms across lines; see `Dynamics`."""
        if isinstance(self._interactions, Severable):
            self._interactions.sever(cuts)
        elif cuts:
            raise EngineError("the forces of this engine cannot be severed along a line")
        self.cuts = cuts
        self._pair_force = None
        self._work = 0.0

    # Ensembles ------------------------------------------------------------------------------------------------

    def hold(self, ensemble: Ensemble | None) -> None:
        """Couple all atoms to an ensemble; see `Dynamics`.

        Raises
        ------
        ValueError
            For a pressure, which this integrator cannot hold, a damping time shorter than the time step, and a
            Nose-Hoover thermostat at 0 K.
        """
        if ensemble is not None and ensemble.pressure is not None:
            raise ValueError(f"pressure is {ensemble.pressure} Pa; this engine keeps its box, so none is allowed")
        if ensemble is not None and ensemble.damping_time < self.time_step:
            raise ValueError(
                f"damping_time is {ensemble.damping_time} s; it must be at least the time step {self.time_step} s"
            )
        if ensemble is not None and ensemble.thermostat == "nose-hoover" and ensemble.temperature == 0.0:
            raise ValueError("temperature is 0 K; the thermostat nose-hoover needs a positive one")
        self._ensemble = ensemble
        self._chain[:] = 0.0

    def draw_velocities(self, temperature: float) -> None:
        """Maxwell-Boltzmann velocities without total momentum; see `Dynamics`."""
        rows = self._free_rows
        mass = self._mass[rows, None]
        drawn = self._noise(_DRAW, len(rows)) * np.sqrt(BOLTZMANN * temperature / mass)
        drawn -= np.sum(mass * drawn, axis=0) / mass.sum()
        self._velocity[rows] = drawn

    # Integration ----------------------------------------------------------------------------------------------

    def run(self, steps: int) -> None:
        """Integrate; see `Dynamics`."""
        for _ in range(steps):
            self._advance()

    def run_window(self, window: int) -> Window:
        """Integrate one window with its means; see `Dynamics`."""
        rows, passive = self._rows, self._rows[self._passive]
        sums = np.zeros((2, len(rows), 3))
        pair_force = np.zeros((len(rows), 3))
        # Offsets from the start: a long sum of positions would lose digits that the reaction needs.
        start, start_velocity = self._position[rows], self._velocity[rows]
        for _ in range(window):
            self._advance()
            tally(self._position, self._velocity, rows, start, sums)
            if len(passive):
                pair_force[self._passive] += self._pair_forces()[passive]
        # The first and the last moment count half, as the integrator's kicks weigh them.
        sums[0] -= 0.5 * (self._position[rows] - start)
        sums[1] -= 0.5 * (self._velocity[rows] - start_velocity)
        kinetic = 0.5 * self._mass * np.einsum("ij,ij->i", self._velocity, self._velocity)
        handshake = float(kinetic[rows[self._free[rows]]].sum())
        return Window(
            mean_position=start + sums[0] / window,
            mean_velocity=sums[1] / window,
            mean_pair_force=pair_force / window,
            position=self._position[rows],
            kinetic_handshake=handshake,
            kinetic_inner=float(kinetic[self._free_rows].sum()) - handshake,
            potential_energy=self._interaction_energy(),
            thermostat_work=self._work,
            momentum=self._mass @ self._velocity,
        )

    def minimise(self, iterations: int) -> None:
        """Minimise the energy of atoms and springs; see `Dynamics`."""
        start = self._position.copy()

        def force(position: NDArray[np.float64]) -> NDArray[np.float64]:
            self._position[self._free_rows] = position
            self._pair_force = None
            return self._total_force()[self._free_rows]

        found = relax(start[self._free_rows], force, iterations, _FORCE_TOLERANCE, 0.5 * LARGEST_STEP)
        self._position[self._free_rows] = found
        self._velocity[:] = 0.0
        self._pair_force = None

    def _advance(self) -> None:
        """One step."""
        self._friction(_BEFORE)
        force = self._total_force()
        fast = kick_and_drift(
            self._position, self._velocity, force, self._half_kick, self.time_step, self._free_rows, LARGEST_STEP
        )
        if fast >= 0:
            self._fail(fast)
        self._elapsed += 1
        before = self._carry_passive()
        self._pair_force = None
        force = self._total_force()
        if before is not None:
            rows, moved, pulled = before
            self._work -= 0.5 * float(np.sum(moved * (pulled + self._pair_forces()[rows])))
        kick(self._velocity, force, self._half_kick, self._free_rows)
        self.step += 1
        self._friction(_AFTER)
        self._rescale()

    def _carry_passive(self) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]] | None:
        """Move passive atoms with their anchors; returns their rows, way, and the force on them before it."""
        anchors = self.anchors
        if anchors is None or not anchors.moving or len(self._passive) == 0:
            return None
        rows = self._rows[self._passive]
        pulled = self._pair_forces()[rows]
        place = anchors.end_position(self._elapsed, self.time_step)[self._passive]
        moved = place - self._position[rows]
        self._position[rows] = place
        return rows, moved, pulled

    def _friction(self, stream: int) -> None:
        """Half a friction step of the anchors' dampers and of a Langevin thermostat, with the ensemble's own half."""
        held = self._ensemble
        if stream == _BEFORE and held is not None and held.thermostat == "nose-hoover":
            self._rescale_by_chain(held)
        anchors = self.anchors
        if anchors is not None and anchors.damping.any():
            self._damp(stream, self._rows, anchors.damping, anchors.velocity, self._temperature)
        if held is not None and held.thermostat == "langevin":
            rows = self._free_rows
            damping = self._mass[rows] / held.damping_time
            self._damp(stream + _BEFORE_ALL - _BEFORE, rows, damping, np.zeros((len(rows), 3)), held.temperature)

    def _damp(
        self,
        stream: int,
        rows: NDArray[np.int64],
        damping: NDArray[np.float64],
        carrier: NDArray[np.float64],
        temperature: float,
    ) -> None:
        half = 0.5 * damping * self.time_step / self._mass[rows]
        kept = 1.0 - half if stream in (_BEFORE, _BEFORE_ALL) else 1.0 / (1.0 + half)
        spread = np.sqrt(np.maximum(1.0 - kept**2, 0.0) * (BOLTZMANN * temperature / self._mass[rows]))
        noise = self._noise(stream, len(rows)) if temperature > 0.0 else np.zeros((len(rows), 3))
        self._work += friction(self._velocity, rows, self._mass, kept, spread, carrier, noise)

    def _rescale(self) -> None:
        """What thermostats of the whole sample do at the end of a step."""
        held = self._ensemble
        if held is None or held.thermostat in ("none", "langevin"):
            return
        if held.thermostat == "nose-hoover":
            self._rescale_by_chain(held)
            return
        kinetic = self._kinetic_energy()
        if held.thermostat == "andersen":
            period = max(1, round(held.damping_time / self.time_step))
            if self.step % period == 0:
                rows = self._free_rows
                spread = np.sqrt(BOLTZMANN * held.temperature / self._mass[rows, None])
                self._velocity[rows] = self._noise(_ANDERSEN, len(rows)) * spread
        elif kinetic > 0.0:
            target = 0.5 * self._freedoms() * BOLTZMANN * held.temperature
            rate = self.time_step / held.damping_time
            self._velocity[self._free_rows] *= np.sqrt(max(0.0, 1.0 + rate * (target / kinetic - 1.0)))
        self._work += self._kinetic_energy() - kinetic

    def _rescale_by_chain(self, held: Ensemble) -> None:
        """Half a step of a Nose-Hoover chain (Martyna, Klein and Tuckerman, J. Chem. Phys. 97, 2635, 1992)."""
        kinetic = self._kinetic_energy()
        scale = chain_half_step(
            self._chain, kinetic, self._freedoms(), BOLTZMANN * held.temperature, held.damping_time, self.time_step
        )
        self._velocity[self._free_rows] *= scale
        self._work += kinetic * (scale**2 - 1.0)

    def _freedoms(self) -> int:
        """Degrees of freedom in motion; without anchors the total momentum is kept and is none of them."""
        bodies = len(self._free_rows) - (1 if self.anchors is None else 0)
        return self.dimension * max(bodies, 1)

    def _kinetic_energy(self) -> float:
        velocity = self._velocity[self._free_rows]
        return float(0.5 * self._mass[self._free_rows] @ np.einsum("ij,ij->i", velocity, velocity))

    def _noise(self, stream: int, rows: int) -> NDArray[np.float64]:
        """Normal deviates, shape (rows, 3), zero along z in a plane and along y and z on a line."""
        generator = np.random.Generator(np.random.Philox(key=[self._seed, 8 * self.step + stream]))
        if self.dimension == 3:
            return generator.standard_normal((rows, 3))
        noise = np.zeros((rows, 3))
        noise[:, : self.dimension] = generator.standard_normal((rows, self.dimension))
        return noise

    # Forces ---------------------------------------------------------------------------------------------------

    def _pair_forces(self) -> NDArray[np.float64]:
        if self._pair_force is None:
            self._pair_force, self._potential_energy = self._interactions.forces(self._position)
        return self._pair_force

    def _interaction_energy(self) -> float:
        self._pair_forces()
        return self._potential_energy

    def _total_force(self) -> NDArray[np.float64]:
        """Forces of atoms, springs and compensation, N, shape (n, 3)."""
        force = self._pair_forces()
        anchors = self.anchors
        if anchors is None:
            return force
        total = force.copy()
        place = anchors.end_position(self._elapsed, self.time_step)
        add_springs(total, self._position, self._rows, anchors.stiffness, place, anchors.force)
        return total

    def _fail(self, row: int) -> None:
        place = ", ".join(f"{value:.2f}" for value in self._position[row] / LENGTH)
        distance = float(np.linalg.norm(self._velocity[row])) * self.time_step / LENGTH
        self.failure = (
            f"atom {row} at ({place}) A moves {distance:.3g} A in one step, at most {LARGEST_STEP / LENGTH} A is "
            f"believable (step {self.step + 1}); try a smaller time step, softer anchors, or a force field without "
            "an abrupt cut-off"
        )
        raise EngineError(self.failure)

    # What can be looked at ------------------------------------------------------------------------------------

    def position(self) -> NDArray[np.float64]:
        """Positions now, m, shape (n, 3)."""
        return self._position.copy()

    def velocity(self) -> NDArray[np.float64]:
        """Velocities now, m/s, shape (n, 3)."""
        return self._velocity.copy()

    def box(self) -> Box:
        """The box, which stays as it is."""
        return self.atoms.box

    def tally(self, active: bool) -> None:
        """Nothing to prepare: `virial_and_energy` costs the same at any time."""

    def virial_and_energy(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Virial and energy of each atom; see `Dynamics`."""
        return self._interactions.virial_and_energy(self._position)

    def state(self) -> State:
        """What `restore` needs; see `Dynamics`. Anchors and an ensemble are in it."""
        counters = (self.step, self._seed, self._elapsed)
        state = packed_state(self._position, self._velocity, counters, self._ensemble, self.anchors, self.cuts)
        state["chain"] = self._chain.copy()
        self.restore(state)
        return state

    def restore(self, state: State) -> None:
        """Go back to a state; see `Dynamics`."""
        position, velocity, counters, ensemble, anchors = unpacked_state(state, len(self._mass), 3)
        if "chain" not in state:
            raise ValueError("state lacks chain; only what the method state answers can be restored")
        chain = finite_array("state.chain", state["chain"], (CHAIN,))
        self.sever(cuts_of(state))
        self._position[:], self._velocity[:], self._chain[:] = position, velocity, chain
        self._take_over(anchors)
        self.step, self._seed, self._elapsed = counters
        self._ensemble = ensemble
        self._work = 0.0
        self.failure = ""
        self._interactions.reset()
        self._pair_force = None

    def close(self) -> None:
        """Free the engine; see `Dynamics`."""
        self._interactions.close()
