"""The contract of an engine: atoms that move, with anchors on some of them.

`md_service.engine.Engine` does on top of it, once for all engines, what the role `atomistic` needs: reference
forces, standard errors, broken bonds, fields, checkpoints. To bring another code behind the role, write this class.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from md_service.anchors import Anchors
from md_service.atoms import Atoms, Box
from md_service.cuts import Cut
from md_service.ensembles import Ensemble

State = dict[str, NDArray[np.float64]]


@dataclass(frozen=True)
class Window:
    """Means over the M steps of a window, and the state at its end. SI units.

    The means of the anchored atoms follow the trapezoidal rule: the moments at the window's start, with the anchors
    in their new places, and at its end count half. So the mean force of a spring is what the kicks of a Verlet
    integrator hand to its atom, step by step; a mean over steps 1 to M is half a step late, and feeds energy into
    the exchange at any M.

    Attributes
    ----------
    mean_position, mean_velocity : ndarray, shape (k, 3)
        Of the anchored atoms, positions not wrapped, m and m/s.
    mean_pair_force : ndarray, shape (k, 3)
        Mean force that the other atoms exert on each passive atom, over steps 1 to M, N; zero rows for other anchors.
    position : ndarray, shape (k, 3)
        Of the anchored atoms at the end, m.
    kinetic_handshake, kinetic_inner : float
        Kinetic energy at the end of the anchored atoms and of all others, J; passive atoms count to neither.
    potential_energy : float
        At the end, J, without the springs.
    thermostat_work : float
        Work on the atoms since the last `adopt`, `minimise`, `displace`, `sever` or `restore` of everything that is not
        a conservative force of spring or atoms: friction and noise of thermostats and dampers, dampers' carrying term,
        and what passive atoms do as they move, J.
    momentum : ndarray, shape (3,)
        Of all atoms at the end, kg m/s.
    tallied : bool
        Whether the window's end is one at which `virial_and_energy` is at hand, if `tally` asked for it.
    """

    mean_position: NDArray[np.float64]
    mean_velocity: NDArray[np.float64]
    mean_pair_force: NDArray[np.float64]
    position: NDArray[np.float64]
    kinetic_handshake: float
    kinetic_inner: float
    potential_energy: float
    thermostat_work: float
    momentum: NDArray[np.float64]
    tallied: bool = True


class Dynamics(Protocol):
    """Atoms in motion.

    Attributes
    ----------
    atoms : Atoms
        The sample as given: reference positions, masses, box.
    dimension : int
        Degrees of freedom of an atom: 3, 2 where atoms stay in a plane, 1 where they stay on a line along x.
    time_step : float
        s.
    step : int
        Steps done.
    anchors : Anchors or None
        As adopted; `Engine` changes the anchors' position and velocity in place, then calls `move_anchors`.
    cuts : tuple of Cut
        Lines across which the atoms do not act on each other.
    failure : str
        Why the code stopped, empty while it has not; only `restore` clears it.
    """

    atoms: Atoms
    dimension: int
    time_step: float
    step: int
    anchors: Anchors | None
    cuts: tuple[Cut, ...]
    failure: str

    def adopt(self, anchors: Anchors | None) -> None:
        """Take over anchors, at the atoms' present positions and velocities. Ends any ensemble of `hold`."""

    def move_anchors(self) -> None:
        """Take over changed positions and velocities of the anchors, from the next step on.

        Held anchors (``anchors.moving`` false) stay for the window; passive atoms are put to their places. Moving
        ones start a window at ``anchors.position`` and move with ``anchors.velocity``.
        """

    def displace(self, displacement: NDArray[np.float64]) -> None:
        """Move all atoms at once, by (n, 3) in m, with the anchors where `anchors` has them now.

        Velocities and counters stay. Passive atoms are put to their anchors.
        """

    def sever(self, cuts: tuple[Cut, ...]) -> None:
        """Sever the atoms across these lines, and no others.

        Raises
        ------
        EngineError
            If the code cannot.
        """

    def hold(self, ensemble: Ensemble | None) -> None:
        """Couple all atoms to an ensemble beside the anchors and their damper; None goes back to these alone."""

    def draw_velocities(self, temperature: float) -> None:
        """Maxwell-Boltzmann velocities (K) without total momentum; from seed and step."""

    def run(self, steps: int) -> None:
        """Integrate.

        Raises
        ------
        EngineError
            If the code stops or an atom runs away; names the atom, the step and the likely cause.
        """

    def run_window(self, window: int) -> Window:
        """Integrate one window of M steps with its means.

        Raises
        ------
        EngineError
            As `run`.
        """

    def minimise(self, iterations: int) -> None:
        """Minimise the energy of atoms and springs; velocities become zero and no step is counted."""

    def position(self) -> NDArray[np.float64]:
        """Positions now, not wrapped, m, shape (n, 3)."""

    def velocity(self) -> NDArray[np.float64]:
        """Velocities now, m/s, shape (n, 3)."""

    def box(self) -> Box:
        """The box now."""

    def tally(self, active: bool) -> None:
        """Whether `virial_and_energy` will be asked for at the ends of windows, so that a code can prepare for it.

        A code may have them at some windows' ends only, and says so by `Window.tallied`.
        """

    def virial_and_energy(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Virial of each atom now, J, shape (n, 6) as xx, yy, zz, xy, xz, yz, tension positive (Eq 79 without the
        motion and without the division by volume), and its potential energy, J, shape (n,). Springs excluded."""

    def state(self) -> State:
        """What `restore` needs to go on bit by bit; the engine itself goes on as if restored from it."""

    def restore(self, state: State) -> None:
        """Go back to a state.

        Raises
        ------
        ValueError
            If the state is of another system.
        """

    def close(self) -> None:
        """Free the code; calling it again does nothing."""
