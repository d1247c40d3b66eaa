"""Fields of each atom: of this moment, or means over the ends of windows, with those at rest kept as a reference."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from md_service.dynamics import Dynamics, State, Window
from md_service.thermal_stress import ThermalVirial

#: Field, number of columns and unit.
FIELDS: Final[dict[str, tuple[int, str]]] = {
    "position": (3, "m"),
    "velocity": (3, "m/s"),
    "displacement": (3, "m"),
    "mean_position": (3, "m"),
    "mean_velocity": (3, "m/s"),
    "virial": (6, "J"),
    "energy": (1, "J"),
    "stress": (6, "Pa"),
}
FIELD_NAMES: Final = tuple(FIELDS)
_COLUMNS: Final = 19  # position, velocity, virial, energy, thermal virial
_NEEDS_VIRIAL: Final = ("virial", "energy", "stress")


class FieldMeans:
    """Sums over window ends, while they are wanted.

    ``position`` and ``velocity`` are always those of this moment. All others are means over the window ends since
    `collect` or `reset`; where there are none they are of this moment. ``displacement`` is relative to the sample as
    it was given. ``virial`` and ``energy`` are those of the interatomic forces; ``stress`` is Eq 79: virial and thermal
    motion about the local mean velocity over the volume of an atom. Tension is positive; components are xx, yy, zz, xy,
    xz, yz.

    Parameters
    ----------
    dynamics : Dynamics
        Atoms in motion.
    """

    def __init__(self, dynamics: Dynamics) -> None:
        self._dynamics = dynamics
        self._atoms = dynamics.atoms
        self._thermal: ThermalVirial | None = None
        self._active = False
        self._sum = np.zeros((len(dynamics.atoms), _COLUMNS))
        self.samples = 0
        #: Mean position (m), virial and energy (J) at rest, shape (n, 10); empty while there are none.
        self.reference = np.zeros((0, 10))

    def collect(self, active: bool) -> None:
        """Start or stop; starting forgets what there is."""
        self._dynamics.tally(active)
        self._active = active
        if active:
            self.reset()

    def reset(self) -> None:
        """Forget all samples but the reference."""
        self._sum = np.zeros_like(self._sum)
        self.samples = 0

    def add(self, window: Window) -> None:
        """Take a sample at the end of a window, if fields are collected and the code has tallied them."""
        if self._active and window.tallied:
            self._sum += self._sample()
            self.samples += 1

    def keep_as_reference(self) -> None:
        """Keep the means so far as those at rest and start anew, if fields are collected.

        Where no window was long enough for a sample, one is taken now.
        """
        if not self._active:
            return
        if self.samples == 0:
            self._sum += self._sample()
            self.samples = 1
        mean = self._sum / self.samples
        self.reference = np.ascontiguousarray(np.hstack([mean[:, :3], mean[:, 6:13]]))
        self.reset()

    def fields(self, names: tuple[str, ...]) -> dict[str, NDArray[np.float64]]:
        """The named fields, SI, rows by atom."""
        found: dict[str, NDArray[np.float64]] = {}
        if "position" in names:
            found["position"] = self._dynamics.position()
        if "velocity" in names:
            found["velocity"] = self._dynamics.velocity()
        if not set(names) - set(found):
            return {name: found[name] for name in names}
        mean = self._sum / self.samples if self.samples else self._sample(any(name in _NEEDS_VIRIAL for name in names))
        found["mean_position"] = mean[:, :3]
        found["displacement"] = mean[:, :3] - self._atoms.position
        found["mean_velocity"] = mean[:, 3:6]
        found["virial"] = mean[:, 6:12]
        found["energy"] = mean[:, 12]
        found["stress"] = (mean[:, 6:12] + mean[:, 13:]) / self._atoms.atom_volume
        return {name: np.ascontiguousarray(found[name]) for name in names}

    def _sample(self, with_virial: bool = True) -> NDArray[np.float64]:
        """Position, velocity, virial, energy and thermal virial now, shape (n, 19)."""
        velocity = self._dynamics.velocity()
        sample = np.zeros_like(self._sum)
        sample[:, :3] = self._dynamics.position()
        sample[:, 3:6] = velocity
        if with_virial:
            if self._thermal is None:
                self._thermal = ThermalVirial(self._atoms)
            sample[:, 6:12], sample[:, 12] = self._dynamics.virial_and_energy()
            sample[:, 13:] = self._thermal.of(velocity)
        return sample

    def state(self) -> State:
        """Everything `restore` needs."""
        return {
            "collected_sum": self._sum,
            "collected_samples": np.array([self.samples, self._active], dtype=np.float64),
            "collected_reference": self.reference.copy(),
        }

    def restore(self, state: State) -> None:
        """Go back to a state."""
        self._sum = np.array(state["collected_sum"])
        self.samples = int(state["collected_samples"][0])
        self._active = bool(state["collected_samples"][1])
        self.reference = np.array(state["collected_reference"])
        self._dynamics.tally(self._active)
