"""One coupling step of continuum and atoms: who advances when, and what is handed over.

Serial::

    continuum   t -> t + Dt under the reactions of the last step
        |       anchor places and velocities (interpolated from the grid)
        v
    atoms       anchors set there and held, M steps
        |       averaged reactions minus the reference (Eq 87)
        v
    continuum   next step

Parallel: both advance from t to t + Dt at the same time. The atoms' anchors are set to where they are predicted
to be at its end, u + Dt v + Dt (v - v'), with v' the velocity one step before; without the last term it is always
unstable (`coordinator.handshake`).

Where the coupling step Dt is longer than the continuum's own stable step, the continuum makes n sub-steps of
Dt / n, and the reaction acts as an impulse, n times as large, in the first of them. Spread evenly over them it would
act half a step late on average, and any delay in this loop feeds energy in.

Nothing filters the forces on their way, for the same reason.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from coordinator.region import Region
from protocol import atomistic as a
from protocol import continuum as c
from protocol.arrays import FloatArray
from protocol.client import Client


@dataclass(frozen=True)
class Exchanged:
    """What one coupling step gave.

    Attributes
    ----------
    continuum : ContinuumAdvanced
        After the step; its `events` are those of all sub-steps.
    atoms : list of AtomisticAdvanced
        One for each region.
    moved : float64 array, shape (anchors, 3)
        How far the atoms' anchors were moved in this step, m.
    """

    continuum: c.ContinuumAdvanced
    atoms: list[a.AtomisticAdvanced]
    moved: FloatArray


class Exchange:
    """The loop between one continuum and the samples of atoms in it.

    Parameters
    ----------
    continuum : Client
    regions : sequence of Region
        Joined and registered; none for a continuum alone.
    time_step : float
        Dt, s.
    sub_steps : int
        n, of the continuum.
    spread : {"anchor", "ivc"}
        How reactions reach the grid: by the functions that interpolate the anchors' motion, or evenly to the
        points of each volume cell.
    parallel : bool

    Attributes
    ----------
    reaction : float64 array, shape (anchors or ivcs, 3), or None
        On the continuum, of the last step, N.
    anchor_displacement : float64 array, shape (anchors, 3)
        Of the continuum now, m.
    anchor_velocity : float64 array, shape (anchors, 3)
        Displacement of the last coupling step over Dt, m/s.
    """

    def __init__(
        self,
        continuum: Client,
        regions: Sequence[Region],
        time_step: float,
        sub_steps: int,
        spread: str,
        parallel: bool,
    ) -> None:
        self.reaction: FloatArray | None = None
        self._continuum = continuum
        self._regions = list(regions)
        self._time_step = time_step
        self._sub_steps = sub_steps
        self._by_ivc = spread == "ivc"
        # Threads for all services, made once; they wait for replies.
        self._pool = ThreadPoolExecutor(1 + len(self._regions)) if parallel and regions else None
        self._reference = np.concatenate([np.zeros((0, 3)), *(region.anchor_reference for region in regions)])
        self._moving = any(region.scene.handshake.motion == "linear" for region in regions if region.scene.handshake)
        ends = np.cumsum([0, *(len(region.anchor_reference) for region in regions)])
        self._rows = [slice(start, end) for start, end in pairwise(ends)]
        self.anchor_displacement = np.zeros_like(self._reference)
        self.anchor_velocity = np.zeros_like(self._reference)
        self._last_velocity = np.zeros_like(self._reference)
        self._placed = np.zeros_like(self._reference)

    def start_at(self, displacement: FloatArray) -> None:
        """Let the anchors begin displaced, shape (anchors, 3), m, by a load that is there from the start."""
        self.anchor_displacement = displacement.copy()
        self._placed = displacement.copy()

    def hold(self, step: int) -> list[a.AtomisticAdvanced]:
        """Advance the atoms alone, anchors at rest where they are; the next step begins with their reactions."""
        still = np.zeros_like(self._placed)
        atoms = [self._advance_atoms(k, self._placed, still, step) for k in range(len(self._regions))]
        self._take(atoms)
        return atoms

    def advance(self, step: int) -> Exchanged:
        """Make one coupling step; `step` is its number, for errors."""
        before = self._placed
        if self._pool is not None:
            place = self.anchor_displacement + self._time_step * (2.0 * self.anchor_velocity - self._last_velocity)
            velocity = self.anchor_velocity
            at_once = self._pool.submit(self._advance_continuum, step)
            waiting = [
                self._pool.submit(self._advance_atoms, k, place, velocity, step) for k in range(len(self._regions))
            ]
            atoms = [future.result() for future in waiting]
            continuum = at_once.result()
        else:
            continuum = self._advance_continuum(step)
            place = self.anchor_displacement
            atoms = [self._advance_atoms(k, place, self.anchor_velocity, step) for k in range(len(self._regions))]
        self._placed = place.copy()
        self._take(atoms)
        return Exchanged(continuum, atoms, place - before)

    # --- state -------------------------------------------------------------------------------------------

    def state(self) -> dict[str, np.ndarray]:
        """Return what the next step needs, as named arrays."""
        found = {
            "displacement": self.anchor_displacement, "velocity": self.anchor_velocity,
            "last_velocity": self._last_velocity, "placed": self._placed,
        }  # fmt: skip
        return found if self.reaction is None else {**found, "reaction": self.reaction}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Set a state that `state` gave."""
        self.anchor_displacement, self.anchor_velocity = state["displacement"], state["velocity"]
        self._last_velocity, self._placed = state["last_velocity"], state["placed"]
        self.reaction = state.get("reaction")

    # --- inside ------------------------------------------------------------------------------------------

    def _take(self, atoms: list[a.AtomisticAdvanced]) -> None:
        if atoms:
            self.reaction = np.concatenate([reply.ivc_force if self._by_ivc else reply.anchor_force for reply in atoms])

    def _advance_continuum(self, step: int) -> c.ContinuumAdvanced:
        force = None if self.reaction is None else self._sub_steps * self.reaction
        reply = self._call_continuum(1, force, step)
        if self._sub_steps > 1:
            events = reply.events
            reply = self._call_continuum(self._sub_steps - 1, None, step)
            reply = reply.model_copy(update={"events": events + reply.events})
        if self._regions:
            self._last_velocity = self.anchor_velocity
            self.anchor_velocity = (reply.anchor_displacement - self.anchor_displacement) / self._time_step
            self.anchor_displacement = reply.anchor_displacement
        return reply

    def _call_continuum(self, steps: int, force: FloatArray | None, step: int) -> c.ContinuumAdvanced:
        request = c.ContinuumAdvance(
            steps=steps,
            ivc_force=force if self._by_ivc else None,
            anchor_force=None if self._by_ivc else force,
        )
        return self._continuum.call("advance", request, c.ContinuumAdvanced, step=step)

    def _advance_atoms(
        self, region: int, displacement: FloatArray, velocity: FloatArray, step: int
    ) -> a.AtomisticAdvanced:
        rows = self._rows[region]
        place = self._reference[rows] + displacement[rows]
        if self._moving:
            # The anchors go on with their velocity, so they begin one exchange back.
            place = place - self._time_step * velocity[rows]
        return self._regions[region].advance(np.ascontiguousarray(place), velocity[rows], step)
