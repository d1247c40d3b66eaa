"""The atoms inside LAMMPS: building them, reading them in the order of their ids, watching over them."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from md_service import units
from md_service.errors import EngineError
from md_service.force_fields import CARBON_MASS, ForceField
from md_service.lammps_library import LammpsSession
from md_service.ranks import Ranks

_LARGEST_STEP = 0.2  # Angstrom moved in one step: a carbon atom of 100 eV at 0.5 fs
_KNOBS = "try a smaller time step, softer anchors, or a force field without an abrupt cut-off"


class AtomSystem:
    """Carbon atoms in a box with free boundaries.

    Positions and velocities that go in and out are SI and ordered by id; rows count from 0.

    Parameters
    ----------
    work_dir : Path
        Folder of log.lammps and of changed potential files.
    force_field : ForceField
        Interatomic potential.
    reference : ndarray, shape (n, 3)
        Positions that set the size of the box, m.
    margin : float
        Free space around the reference positions, m. An atom that leaves the box is lost, which is an error.
    time_step : float
        s.
    ranks : Ranks
        Ranks that share the atoms.
    """

    def __init__(
        self,
        work_dir: Path,
        force_field: ForceField,
        reference: NDArray[np.float64],
        margin: float,
        time_step: float,
        ranks: Ranks,
    ) -> None:
        work_dir.mkdir(parents=True, exist_ok=True)
        self.n_atoms = len(reference)
        self.ranks = ranks
        self._reference = reference
        self._time_step = time_step
        self._force_field_commands = force_field.commands(work_dir)
        low, high = reference.min(axis=0) - margin, reference.max(axis=0) + margin
        bounds = zip((low / units.LENGTH).tolist(), (high / units.LENGTH).tolist(), strict=True)
        self._bounds = " ".join(f"{lo!r} {hi!r}" for lo, hi in bounds)
        self.session = LammpsSession(work_dir / "log.lammps")

    def build(self, position: NDArray[np.float64], velocity: NDArray[np.float64]) -> None:
        """Clear LAMMPS and make the atoms anew, at LAMMPS step 0, with no fix but time integration."""
        self.session.commands(
            [
                "clear",
                "units metal",
                "atom_style atomic",
                # No spatial sorting: atoms of a solid keep their neighbours, and a setup then leaves their order.
                "atom_modify map array sort 0 0",
                "boundary f f f",
                "processors * * 1",
                f"region box block {self._bounds} units box",
                "create_box 1 box",
                *self._force_field_commands,
                "neighbor 2.0 bin",
                "neigh_modify every 1 delay 0 check yes",
                f"timestep {self._time_step / units.TIME!r}",
                "thermo 0",
                "thermo_style custom step pe",
                "thermo_modify lost error flush no",
            ]
        )
        lmp = self.session.lmp
        made = lmp.create_atoms(
            self.n_atoms,
            np.arange(1, self.n_atoms + 1).tolist(),
            np.ones(self.n_atoms, dtype=int).tolist(),
            (position / units.LENGTH).ravel().tolist(),
            (velocity / units.VELOCITY).ravel().tolist(),
        )
        if made != self.n_atoms:
            raise EngineError(f"{self.n_atoms - made} of {self.n_atoms} atoms lie outside of the box")
        self.session.commands(["fix integrate all nve"])

    def local_rows(self) -> NDArray[np.int64]:
        """Rows of the atoms that this rank owns, in LAMMPS' present order."""
        lmp = self.session.lmp
        rows: NDArray[np.int64] = lmp.numpy.extract_atom("id")[: lmp.extract_global("nlocal")].astype(np.int64) - 1
        return rows

    def local(self, name: str) -> NDArray[np.float64]:
        """View of a per-atom array of this rank's atoms, metal units."""
        lmp = self.session.lmp
        view: NDArray[np.float64] = lmp.numpy.extract_atom(name)[: lmp.extract_global("nlocal")]
        return view

    def gather(self, local: NDArray[np.float64]) -> NDArray[np.float64]:
        """Order a per-atom array of this rank's atoms by row and join the ranks' parts, shape (n, ...)."""
        everything = np.zeros((self.n_atoms, *local.shape[1:]))
        everything[self.local_rows()] = local
        return self.ranks.sum(everything)

    def position(self) -> NDArray[np.float64]:
        """Positions, m, shape (n, 3)."""
        return self.gather(self.local("x")) * units.LENGTH

    def velocity(self) -> NDArray[np.float64]:
        """Velocities, m/s, shape (n, 3)."""
        return self.gather(self.local("v")) * units.VELOCITY

    def set_velocity(self, velocity: NDArray[np.float64]) -> None:
        """Overwrite all velocities, m/s, shape (n, 3)."""
        self.local("v")[:] = velocity[self.local_rows()] / units.VELOCITY

    def run(self, steps: int, setup: bool, step: int) -> None:
        """Integrate.

        Parameters
        ----------
        steps : int
            Steps to do.
        setup : bool
            Whether forces and neighbour lists are made anew first, needed after any change of fixes.
        step : int
            Number of the present step, for error messages.

        Raises
        ------
        EngineError
            If LAMMPS stops, or an atom runs away.
        """
        try:
            self.session.commands([f"run {steps} {'post no' if setup else 'pre no post no'}"])
        except EngineError as error:
            raise EngineError(f"{error} (in the steps {step + 1} to {step + steps}; {self._suspect()})") from error
        velocity = self.local("v")
        distance = np.sqrt(np.einsum("ij,ij->i", velocity, velocity).max(initial=0.0)) * self._time_step / units.TIME
        runaway = not distance < _LARGEST_STEP
        if self.ranks.sum(np.array([float(runaway)]))[0] > 0.0:
            raise EngineError(
                f"an atom moves {distance:.3g} A in one step, at most {_LARGEST_STEP} A is believable "
                f"(step {step + steps}; {self._suspect()})"
            )

    def _suspect(self) -> str:
        """Name the local atom that looks worst: lost, not finite, or the fastest."""
        rows, position, velocity = self.local_rows(), self.local("x"), self.local("v")
        missing = np.setdiff1d(np.arange(self.n_atoms), rows)
        if self.ranks.size == 1 and len(missing):
            place = self._reference[missing[0]] / units.LENGTH
            return f"atom {missing[0]}, at the start at {_place(place)}, was lost; {_KNOBS}"
        speed = np.sqrt(np.einsum("ij,ij->i", velocity, velocity))
        speed = np.where(np.isfinite(speed) & np.isfinite(position).all(axis=1), speed, np.inf)
        if len(speed) == 0:
            return _KNOBS
        worst = int(np.argmax(speed))
        return f"fastest is atom {rows[worst]} at {_place(position[worst])} with {speed[worst]:.3g} A/ps; {_KNOBS}"

    def kinetic_energy(self, of: NDArray[np.bool_]) -> tuple[float, float]:
        """Kinetic energy, J, of the atoms in a mask (n,) and of the others, this rank's atoms only."""
        velocity = self.local("v")
        energy = 0.5 * CARBON_MASS * units.VELOCITY**2 * np.einsum("ij,ij->i", velocity, velocity)
        chosen = of[self.local_rows()]
        return float(energy[chosen].sum()), float(energy[~chosen].sum())

    def potential_energy(self) -> float:
        """Potential energy at the end of the last run, J; without the anchors' springs."""
        return float(self.session.lmp.get_thermo("pe")) * units.ENERGY


def _place(angstrom: NDArray[np.float64]) -> str:
    return "(" + ", ".join(f"{value:.2f}" for value in angstrom) + ") A"
