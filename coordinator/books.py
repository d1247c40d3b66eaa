"""Books of energy and momentum: what was put in, what is stored, what was taken, and what does not add up.

Of each part of a coupled run the change of what it holds is set against the work that was done on it, measured
apart from it::

    continuum   kinetic + strain            = edges + loads + interface - damping - dissipated - filter
    atoms       kinetic + potential         = springs and thermostats
    springs     what the anchors put in     = stored + given to the atoms
    interface   given by the continuum      = put in by the anchors + work against the reference force

    momentum    change of the atoms'     = - (mean reactions + reference forces) M dt

`filter` is the energy that the way from material points to grid and back takes. The reference force of
Eq 87 is subtracted from what the continuum gets, so it works on the anchors all the same. A mean reaction does half of
its work on the way that the anchors came with and half on the next one, which is not made yet: what the continuum gave
is told with the half that is missing. The line of the interface then misses by the difference between the force at
the moment in which the anchors are moved and the mean of the two windows beside it, of the second order of the coupling
step times the atoms' frequencies, and by the work of dampers, whose force is handed over too.
Momentum misses by what the noise of a thermostat gives, which no reaction tells.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from protocol import atomistic as a
from protocol import continuum as c
from protocol.arrays import FloatArray


@dataclass
class Books:
    """Running books of a coupled run.

    Attributes
    ----------
    reference_work : float
        Work of the reference forces on the anchors since the start, J.
    momentum : float64 array, shape (2,), or None
        Of all atoms at the last step, kg m/s; None where a service does not tell it.
    missed : float64 array, shape (2,)
        Momentum of the atoms that no reaction explains, since the start, kg m/s.
    start : dict of str to float
        What each part held at the first step, J.
    """

    reference_work: float = 0.0
    momentum: FloatArray | None = None
    missed: FloatArray = field(default_factory=lambda: np.zeros(2))
    start: dict[str, float] = field(default_factory=dict)

    def enter(
        self,
        continuum: c.ContinuumAdvanced,
        atoms: Sequence[a.AtomisticAdvanced],
        moved: FloatArray,
        reference_force: FloatArray | None,
        time_step: float,
    ) -> dict[str, float]:
        """Enter one step and return its values.

        Parameters
        ----------
        continuum : ContinuumAdvanced
        atoms : sequence of AtomisticAdvanced
            One for each region.
        moved : float64 array, shape (anchors, 3)
            Way of the anchors in this step, m.
        reference_force : float64 array, shape (anchors, 3), or None
            On the continuum, N; None where a service does not tell it.
        time_step : float
            Of the coupling, s.

        Returns
        -------
        dict of str to float
            Residuals, J, from the second step on; the first step is where the books begin.
        """
        if reference_force is not None:
            self.reference_work += float(np.sum(reference_force * moved))
        held = _continuum_held(continuum)
        known = {"continuum": held}
        if atoms:
            work = sum(reply.anchor_work for reply in atoms)
            springs = sum(reply.spring_energy for reply in atoms)
            heat = sum(reply.thermostat_work or 0.0 for reply in atoms)
            known["atoms"] = sum(reply.kinetic_energy + reply.potential_energy for reply in atoms) - work
            # Put in by the anchors: what the springs store and what they gave to the atoms.
            put_in = springs + work - heat
            force = np.concatenate([reply.anchor_force for reply in atoms])
            coming = 0.5 * time_step * float(np.sum(force * continuum.anchor_velocity))
            known["interface"] = put_in + continuum.interface_work + coming + self.reference_work
        values: dict[str, float] = {}
        for name, value in known.items():
            values[f"residual_{name}"] = value - self.start.setdefault(name, value)
        if atoms:
            values["reference_work"] = self.reference_work
            values.update(self._momentum(atoms, reference_force, time_step))
        return values

    def _momentum(
        self, atoms: Sequence[a.AtomisticAdvanced], reference_force: FloatArray | None, time_step: float
    ) -> dict[str, float]:
        """Enter the momentum of the atoms."""
        told = [reply.momentum for reply in atoms if reply.momentum is not None]
        if len(told) < len(atoms) or reference_force is None:
            return {}
        now = np.sum(told, axis=0)[:2]
        if self.momentum is not None:
            # Forces are those on the continuum; an exchange that waits for an error lasts several windows.
            lasted = [reply.windows * time_step for reply in atoms]
            given = sum(dt * reply.anchor_force[:, :2].sum(axis=0) for dt, reply in zip(lasted, atoms, strict=True))
            given = given + lasted[0] * reference_force[:, :2].sum(axis=0)
            self.missed = self.missed + (now - self.momentum) + given
        self.momentum = now
        return {"residual_momentum_x": float(self.missed[0]), "residual_momentum_y": float(self.missed[1])}

    def state(self) -> dict[str, np.ndarray]:
        """Return the books as named arrays."""
        found = {"reference_work": np.array([self.reference_work]), "missed": self.missed}
        if self.momentum is not None:
            found["momentum"] = self.momentum
        return found | {f"start_{name}": np.array([value]) for name, value in self.start.items()}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Set what `state` gave."""
        self.reference_work = float(state["reference_work"][0])
        self.momentum, self.missed = state.get("momentum"), state["missed"]
        self.start = {
            name.removeprefix("start_"): float(value[0]) for name, value in state.items() if name.startswith("start_")
        }


def _continuum_held(reply: c.ContinuumAdvanced) -> float:
    """Return what the continuum holds and has lost, minus what was put in, J."""
    lost = reply.damping_loss + reply.dissipated_energy + (reply.filter_loss or 0.0)
    return reply.kinetic_energy + reply.strain_energy + lost - reply.edge_work - reply.load_work - reply.interface_work
