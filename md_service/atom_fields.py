"""Per-atom fields: positions, velocities, virial stresses, energies."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from md_service import units
from md_service.atom_system import AtomSystem

INSTANT_FIELDS: Final = ("position", "velocity")
COLLECTED_FIELDS: Final = ("mean_position", "stress", "energy")
FIELD_NAMES: Final = INSTANT_FIELDS + COLLECTED_FIELDS

_COLUMNS: Final = (
    "x y z c_atom_energy c_atom_stress[1] c_atom_stress[2] c_atom_stress[3] c_atom_stress[4] c_atom_stress[5] "
    "c_atom_stress[6]"
)


class FieldCollector:
    """Mean positions, stresses and energies over the ends of windows.

    The virial per atom is tallied in the last step of a window only, so collecting costs little and does not
    disturb the motion.

    Parameters
    ----------
    atoms : AtomSystem
        The atoms.
    atom_volume : float
        Volume of one atom, m^3.
    """

    def __init__(self, atoms: AtomSystem, atom_volume: float) -> None:
        self._atoms = atoms
        self._atom_volume = atom_volume
        self.active = False
        self.sum = np.zeros((atoms.n_atoms, 10))  # this rank's part, metal units
        self.samples = 0

    def reset(self) -> None:
        """Forget all samples."""
        self.sum[:] = 0.0
        self.samples = 0

    def commands(self, window: int) -> list[str]:
        """LAMMPS commands that sample the end of each window of M steps; with M = 1 also the present step."""
        return [
            "compute atom_stress all stress/atom NULL pair",
            "compute atom_energy all pe/atom pair",
            f"fix window_sample all ave/atom {window} 1 {window} {_COLUMNS}",
        ]

    def removal_commands(self) -> list[str]:
        """LAMMPS commands that undo `commands`."""
        return ["unfix window_sample", "uncompute atom_energy", "uncompute atom_stress"]

    def add_sample(self) -> None:
        """Add the sample of the window that has just ended."""
        self.sum[self._atoms.local_rows()] += self._atoms.session.lmp.numpy.extract_fix("window_sample", 1, 2)
        self.samples += 1

    def means(self, names: tuple[str, ...]) -> dict[str, NDArray[np.float64]]:
        """Means over the samples, SI, rows by atom."""
        mean = self._atoms.ranks.sum(self.sum) / self.samples
        fields = {
            "mean_position": mean[:, :3] * units.LENGTH,
            "energy": mean[:, 3] * units.ENERGY,
            "stress": mean[:, 4:] * (units.PRESSURE * units.VOLUME / self._atom_volume),
        }
        return {name: np.ascontiguousarray(fields[name]) for name in names}
