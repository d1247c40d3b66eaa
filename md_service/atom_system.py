"""The atoms inside LAMMPS: building them, reading them in the order of their ids, watching over them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from md_service.atoms import Atoms, Box
from md_service.bonds import bonded_pairs
from md_service.cuts import Cut, sides
from md_service.data_file import write_data_file
from md_service.errors import EngineError
from md_service.force_fields import ForceField
from md_service.lammps_library import LammpsSession
from md_service.ranks import OneRank, Ranks

_MOST_CUTS = 8  # of two groups each; LAMMPS has 32, of which anchors take five and one a damper
_LARGEST_STEP = 0.2e-10  # m moved in one step: a carbon atom of 100 eV at 0.5 fs
_KNOBS = "try a smaller time step, softer anchors, or a force field without an abrupt cut-off"


class AtomSystem:
    """A sample in LAMMPS.

    Positions and velocities that go in and out are SI and ordered by id; rows count from 0.

    Parameters
    ----------
    work_dir : Path
        Folder of log.lammps, of the data file and of changed potential files; made if missing.
    force_field : ForceField
        Interatomic potential, with its units.
    atoms : Atoms
        The sample; sets the size of the box.
    time_step : float
        s.
    ranks : Ranks, optional
        Ranks that share the atoms.
    margin : float
        Room beyond the atoms in directions that are not periodic, m. An atom that leaves it is lost, which is an
        error.

    Raises
    ------
    ValueError
        If the force field does not know the sample's species.
    EngineError
        If LAMMPS cannot be loaded.
    """

    def __init__(
        self,
        work_dir: Path,
        force_field: ForceField,
        atoms: Atoms,
        time_step: float,
        ranks: Ranks | None = None,
        margin: float = 20e-10,
    ) -> None:
        work_dir.mkdir(parents=True, exist_ok=True)
        self.atoms = atoms
        self.n_atoms = len(atoms)
        self.mass = atoms.atom_mass
        self.units = force_field.units
        self.force_field = force_field
        self.time_step = time_step
        self.ranks: Ranks = OneRank() if ranks is None else ranks
        self._work_dir = work_dir
        self._force_field_commands = force_field.commands(work_dir, atoms)
        self._margin = margin
        free = ~np.array(atoms.box.periodic)
        low, high = atoms.position.min(axis=0) - margin, atoms.position.max(axis=0) + margin
        self._box = Box(
            np.where(free, low, atoms.box.low), np.where(free, high, atoms.box.high), atoms.box.periodic, atoms.box.tilt
        )
        self.session = LammpsSession(work_dir / "log.lammps", alone=self.ranks.size == 1)

    def build(
        self,
        position: NDArray[np.float64],
        velocity: NDArray[np.float64] | None = None,
        box: Box | None = None,
        cuts: tuple[Cut, ...] = (),
    ) -> None:
        """Clear LAMMPS and make the atoms anew, at LAMMPS step 0, with no fix but the force field's own.

        Parameters
        ----------
        position, velocity : ndarray, shape (n, 3)
            m, not wrapped, and m/s; at rest without velocity.
        box : Box, optional
            In place of the sample's, for boxes that have changed.
        cuts : tuple of Cut
            Lines across which the atoms do not act on each other.

        Raises
        ------
        EngineError
            If there are more cuts than LAMMPS has groups for.
        """
        path = self._work_dir / "atoms.data"
        if self.ranks.rank == 0:
            atoms = replace(self.atoms, position=position, box=self._box if box is None else box)
            write_data_file(path, atoms, self.units.name, self.force_field.atom_style, velocity)
        self.ranks.agree(True)  # wait until the file is there
        boundary = " ".join("p" if periodic else "f" for periodic in self.atoms.box.periodic)
        self.session.commands(
            [
                "clear",
                f"units {self.units.name}",
                f"atom_style {self.force_field.atom_style}",
                # No spatial sorting: atoms of a solid keep their neighbours, and a setup then leaves their order.
                "atom_modify map array sort 0 0",
                f"boundary {boundary}",
                *(["processors * * 1"] if self.atoms.thickness is not None else []),
                f'read_data "{path}"',
                *self._force_field_commands,
                "neighbor 2.0 bin",
                "neigh_modify every 1 delay 0 check yes",
                f"timestep {self.time_step / self.units.time!r}",
                "thermo 0",
                "thermo_style custom step pe",
                "thermo_modify lost error flush no",
                *self.force_field.fixes,
            ]
        )
        made = int(self.session.lmp.get_natoms())
        if made != self.n_atoms:
            raise EngineError(f"{self.n_atoms - made} of {self.n_atoms} atoms lie outside of the box")
        if cuts:
            self._sever(cuts)

    def _sever(self, cuts: tuple[Cut, ...]) -> None:
        """Take pairs across cuts out of the neighbour lists, which all that LAMMPS knows of pairs is made of."""
        if len(cuts) > _MOST_CUTS:
            raise EngineError(f"there are {len(cuts)} cuts apart from each other; LAMMPS has groups for {_MOST_CUTS}")
        pairs, _ = bonded_pairs(self.atoms)
        rows = self.local_rows()
        self.session.commands(["fix cut_data all property/atom i_cut_side"])
        for number, cut in enumerate(cuts):
            upper, lower = sides(cut, self.atoms, pairs)
            side = self.session.lmp.numpy.extract_atom("i_cut_side")
            side[: len(rows)] = np.where(upper, 1, np.where(lower, 2, 0))[rows]
            names = [f"cut_{number}_upper", f"cut_{number}_lower"]
            for value, name in enumerate(names, start=1):
                self.session.commands(
                    [
                        f"variable of_side atom i_cut_side=={value}",
                        f"group {name} variable of_side",
                        "variable of_side delete",
                    ]
                )
            self.session.commands([f"neigh_modify exclude group {names[0]} {names[1]}"])
        self.session.commands(["unfix cut_data"])

    def local_rows(self) -> NDArray[np.int64]:
        """Rows of the atoms that this rank owns, in LAMMPS' present order."""
        lmp = self.session.lmp
        rows: NDArray[np.int64] = lmp.numpy.extract_atom("id")[: lmp.extract_global("nlocal")].astype(np.int64) - 1
        return rows

    def local(self, name: str) -> NDArray[np.float64]:
        """View of a per-atom array of this rank's atoms, LAMMPS units."""
        lmp = self.session.lmp
        view: NDArray[np.float64] = lmp.numpy.extract_atom(name)[: lmp.extract_global("nlocal")]
        return view

    def gather(self, local: NDArray[np.float64]) -> NDArray[np.float64]:
        """Order a per-atom array of this rank's atoms by row and join the ranks' parts, shape (n, ...)."""
        everything = np.zeros((self.n_atoms, *local.shape[1:]))
        everything[self.local_rows()] = local
        return self.ranks.sum(everything)

    def box(self) -> Box:
        """The box now, m."""
        low, high, xy, yz, xz, _, _ = self.session.lmp.extract_box()
        unit = self.units.length
        return Box(np.array(low) * unit, np.array(high) * unit, self.atoms.box.periodic, np.array([xy, xz, yz]) * unit)

    def box_around(self, position: NDArray[np.float64]) -> Box:
        """The box now, grown in free directions until it holds positions, m, shape (n, 3), with their margin."""
        box, free = self.box(), ~np.array(self.atoms.box.periodic)
        low = np.minimum(box.low, position.min(axis=0) - self._margin)
        high = np.maximum(box.high, position.max(axis=0) + self._margin)
        return Box(np.where(free, low, box.low), np.where(free, high, box.high), box.periodic, box.tilt)

    def local_position(self) -> NDArray[np.float64]:
        """Positions of this rank's atoms, not wrapped, in LAMMPS units, shape (local, 3)."""
        position = self.local("x")
        if not any(self.atoms.box.periodic):
            return position
        lmp = self.session.lmp
        bits, mask, zero = (lmp.extract_setting(name) for name in ("IMGBITS", "IMGMASK", "IMGMAX"))
        image = self.local("image").astype(np.int64)
        images = np.column_stack([(image >> (axis * bits) & mask) - zero for axis in range(3)])
        return position + images @ (self.box().edges / self.units.length)

    def position(self) -> NDArray[np.float64]:
        """Positions, not wrapped, m, shape (n, 3)."""
        return self.gather(self.local_position()) * self.units.length

    def velocity(self) -> NDArray[np.float64]:
        """Velocities, m/s, shape (n, 3)."""
        return self.gather(self.local("v")) * self.units.velocity

    def set_velocity(self, velocity: NDArray[np.float64]) -> None:
        """Overwrite all velocities, m/s, shape (n, 3)."""
        self.local("v")[:] = velocity[self.local_rows()] / self.units.velocity

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
        speed = np.sqrt(np.einsum("ij,ij->i", velocity, velocity).max(initial=0.0)) * self.units.velocity
        runaway = not speed * self.time_step < _LARGEST_STEP
        if self.ranks.sum(np.array([float(runaway)]))[0] > 0.0:
            raise EngineError(
                f"an atom moves {speed * self.time_step / 1e-10:.3g} A in one step, at most "
                f"{_LARGEST_STEP / 1e-10} A is believable (step {step + steps}; {self._suspect()})"
            )

    def _suspect(self) -> str:
        """Name the local atom that looks worst: lost, not finite, or the fastest."""
        rows, position, velocity = self.local_rows(), self.local("x"), self.local("v")
        missing = np.setdiff1d(np.arange(self.n_atoms), rows)
        if self.ranks.size == 1 and len(missing):
            place = self.atoms.position[missing[0]]
            return f"atom {missing[0]}, at the start at {_place(place)}, was lost; {_KNOBS}"
        speed = np.sqrt(np.einsum("ij,ij->i", velocity, velocity))
        speed = np.where(np.isfinite(speed) & np.isfinite(position).all(axis=1), speed, np.inf)
        if len(speed) == 0:
            return _KNOBS
        worst = int(np.argmax(speed))
        fast = speed[worst] * self.units.velocity
        place = position[worst] * self.units.length
        return f"fastest is atom {rows[worst]} at {_place(place)} with {fast:.3g} m/s; {_KNOBS}"

    def kinetic_energy(self, group: NDArray[np.int64], groups: int) -> NDArray[np.float64]:
        """Kinetic energy of this rank's atoms by group, J, shape (groups,).

        Parameters
        ----------
        group : ndarray of int64, shape (n,)
            Group of each atom, from 0.
        groups : int
            Number of groups.
        """
        velocity = self.local("v")
        rows = self.local_rows()
        energy = 0.5 * self.units.velocity**2 * self.mass[rows] * np.einsum("ij,ij->i", velocity, velocity)
        total: NDArray[np.float64] = np.bincount(group[rows], weights=energy, minlength=groups).astype(np.float64)
        return total

    def local_momentum(self) -> NDArray[np.float64]:
        """Momentum of this rank's atoms, kg m/s, shape (3,)."""
        return np.asarray(self.mass[self.local_rows()] @ self.local("v") * self.units.velocity)

    def potential_energy(self) -> float:
        """Potential energy at the end of the last run, J; without the anchors' springs."""
        return float(self.session.lmp.get_thermo("pe")) * self.units.energy


def _place(position: NDArray[np.float64]) -> str:
    return "(" + ", ".join(f"{value / 1e-10:.2f}" for value in position) + ") A"
