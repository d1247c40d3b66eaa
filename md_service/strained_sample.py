"""Stress of a periodic sample under a homogeneous strain, at rest and in thermal motion.

The strain acts along the sample's periodic directions: all six components of a solid, three of a sheet. It is given
as an upper triangular deformation gradient, F_ij = delta_ij + gamma_ij for i < j, which keeps the box in the form
that LAMMPS asks for; the rotation in it is of no consequence where the stress is small.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from md_service.atom_system import AtomSystem
from md_service.atoms import Atoms, Box
from md_service.elastic_tensor import VOIGT
from md_service.force_fields import ForceField

MARGIN = 20e-10  # m of room beyond the atoms where the sample ends
_FORCE_TOLERANCE = 1e-10 * 1.602e-9  # N: 1e-10 eV/Angstrom
_MOST_ITERATIONS = 20000
_CHUNK = 700  # steps between two reports
_SAMPLES = 350  # of the stress in a run, at most about; each costs the virial of one step


class Progress:
    """Steps done of the steps to do, told to a callback, which may raise to stop."""

    def __init__(self, callback: Callable[[int, int], None] | None, total: int) -> None:
        self._callback, self._total, self._done = callback, total, 0

    def add(self, steps: int) -> None:
        """Count steps."""
        self._done += steps
        if self._callback is not None:
            self._callback(min(self._done, self._total), self._total)

    def expect(self, steps: int) -> None:
        """Count steps to do that were not foreseen."""
        self._total += steps


class StrainedSample:
    """A sample in LAMMPS whose box is strained.

    Parameters
    ----------
    work_dir : Path
        Folder of LAMMPS' files; made if missing.
    force_field : ForceField
    atoms : Atoms
        The sample without strain; at least one direction must be periodic.
    time_step : float, optional
        s; by default the force field's.

    Raises
    ------
    ValueError
        If no direction is periodic, or the force field does not know the sample's species.
    """

    def __init__(self, work_dir: Path, force_field: ForceField, atoms: Atoms, time_step: float | None = None) -> None:
        self.components = measurable_components(atoms)
        self.time_step = force_field.time_step if time_step is None else time_step
        self.atoms = replace(atoms, box=roomy_box(atoms))
        self.system = AtomSystem(work_dir, force_field, atoms, self.time_step)

    def deformed(self, strain: NDArray[np.float64]) -> Atoms:
        """The sample under a strain, shape (components,), every atom moved with its box."""
        return deformed(self.atoms, self.components, strain)

    def relax(self) -> None:
        """Minimise the energy in the present box; further strains start from what this leads to."""
        self._minimise(np.zeros(len(self.components)))
        self.atoms = self.atoms.at(self.system.position())

    def adopt_strain(self, strain: NDArray[np.float64]) -> None:
        """Take the strained sample as the one without strain; its spacing grows with the mean of the axes."""
        atoms = self.deformed(strain)
        if atoms.spacing is not None:
            axial = [value for index, value in zip(self.components, strain, strict=True) if index < 3]
            atoms = replace(atoms, spacing=atoms.spacing * (1.0 + float(np.mean(axial))))
        self.atoms = atoms

    def static_stress(self, strain: NDArray[np.float64]) -> NDArray[np.float64]:
        """Stress at 0 K after inner relaxation.

        Parameters
        ----------
        strain : ndarray, shape (components,)
            In Voigt order with engineering shear.

        Returns
        -------
        ndarray, shape (components,)
            True stress, tension positive, Pa; of a sheet with its thickness.
        """
        scale = self._minimise(strain)
        names = [_THERMO_NAMES[component] for component in self.components]
        pressure = [self.system.session.lmp.get_thermo(name) for name in names]
        return scale * np.array(pressure)

    def thermal_stress(
        self,
        strain: NDArray[np.float64],
        temperature: float,
        seed: int,
        steps: tuple[int, int],
        damping_time: float,
        report: Progress,
    ) -> NDArray[np.float64]:
        """Stress under a Langevin thermostat, momentum flux of the thermal motion included.

        Runs of one seed share starting velocities and noise.

        Parameters
        ----------
        strain : ndarray, shape (components,)
            In Voigt order with engineering shear; put on at once.
        temperature : float
            K.
        seed : int
            Of velocities and noise, positive.
        steps : tuple of int
            Settling, then sampling.
        damping_time : float
            Of the thermostat, s.
        report : Progress

        Returns
        -------
        ndarray, shape (samples, components)
            Pa.
        """
        scale = self._build(self.deformed(strain))
        damping = damping_time / self.system.units.time
        # Half of the kinetic energy of the draw goes into the bonds of a perfect crystal.
        drawn = temperature if self.atoms.spacing is None else 2.0 * temperature
        settling, sampling = steps
        columns = " ".join(f"c_thermo_press[{_LAMMPS_ORDER[component]}]" for component in self.components)
        session = self.system.session
        session.commands(
            [
                f"velocity all create {drawn!r} {seed} loop all",
                "fix integrate all nve",
                f"fix thermostat all langevin {temperature!r} {temperature!r} {damping!r} {seed}",
            ]
        )
        self._run(settling, 0, report)
        session.commands([f"fix stress all vector {max(sampling // _SAMPLES, 1)} {columns}"])
        self._run(sampling, settling, report)
        return scale * vector_fix(self.system, "stress", len(self.components))

    def close(self) -> None:
        """Free LAMMPS; calling it again does nothing."""
        self.system.session.close()

    def _build(self, atoms: Atoms) -> float:
        """Put atoms into LAMMPS; returns stress over LAMMPS' pressure, which refers to the whole box."""
        self.system.build(atoms.position, box=atoms.box)
        return -self.system.units.pressure * atoms.box.volume / atoms.volume

    def _minimise(self, strain: NDArray[np.float64]) -> float:
        scale = self._build(self.deformed(strain))
        tolerance = _FORCE_TOLERANCE / self.system.units.force
        self.system.session.commands(
            [
                f"thermo_style custom step pe {' '.join(_THERMO_NAMES)}",
                "thermo_modify lost error flush no",
                f"minimize 0 {tolerance!r} {_MOST_ITERATIONS} {10 * _MOST_ITERATIONS}",
            ]
        )
        return scale

    def _run(self, steps: int, done: int, report: Progress) -> None:
        for start in range(0, steps, _CHUNK):
            chunk = min(_CHUNK, steps - start)
            # With a setup, in which fix vector makes room.
            self.system.run(chunk, setup=True, step=done + start)
            report.add(chunk)


_SIZE_OF_VECTOR, _ROWS_OF_ARRAY = 3, 4  # LAMMPS' numbers for what is asked of a fix
_THERMO_NAMES = ("pxx", "pyy", "pzz", "pyz", "pxz", "pxy")
_LAMMPS_ORDER = (1, 2, 3, 6, 5, 4)  # component of LAMMPS' pressure vector by Voigt index


def vector_fix(system: AtomSystem, name: str, columns: int) -> NDArray[np.float64]:
    """What a ``fix vector`` of more than one column has gathered, in LAMMPS' units, shape (samples, columns)."""
    lmp = system.session.lmp
    if columns == 1:
        length = lmp.extract_fix(name, 0, _SIZE_OF_VECTOR)
        return np.array([[lmp.extract_fix(name, 0, 1, row)] for row in range(length)])
    rows = lmp.extract_fix(name, 0, _ROWS_OF_ARRAY)
    return np.array([[lmp.extract_fix(name, 0, 2, row, column) for column in range(columns)] for row in range(rows)])


def measurable_components(atoms: Atoms) -> tuple[int, ...]:
    """Voigt indices of the strains that a sample's periodic directions allow.

    Raises
    ------
    ValueError
        If no direction is periodic.
    """
    periodic = list(atoms.box.periodic)
    if atoms.thickness is not None:
        periodic[2] = False
    components = tuple(index for index, (i, j) in enumerate(VOIGT) if periodic[i] and periodic[j])
    if not components:
        raise ValueError("the sample's box is periodic in no direction; its stress and strain are not defined")
    return components


def deformed(atoms: Atoms, components: tuple[int, ...], strain: NDArray[np.float64]) -> Atoms:
    """A sample under a homogeneous strain, every atom moved with its box.

    Parameters
    ----------
    atoms : Atoms
    components : tuple of int
        Voigt indices of the strain's entries.
    strain : ndarray, shape (components,)
        With engineering shear.

    Returns
    -------
    Atoms
        The low corner of the box stays.
    """
    gradient = np.eye(3)
    for component, value in zip(components, strain, strict=True):
        i, j = sorted(VOIGT[component])
        gradient[i, j] += value
    box = atoms.box
    edges = box.edges @ gradient.T
    strained = Box(box.low, box.low + np.diag(edges), box.periodic, np.array([edges[1, 0], edges[2, 0], edges[2, 1]]))
    return atoms.at(box.low + (atoms.position - box.low) @ gradient.T, strained)


def roomy_box(atoms: Atoms) -> Box:
    """The box with room for motion where the sample ends."""
    free = ~np.array(atoms.box.periodic)
    low = np.where(free, atoms.position.min(axis=0) - MARGIN, atoms.box.low)
    high = np.where(free, atoms.position.max(axis=0) + MARGIN, atoms.box.high)
    return replace(atoms.box, low=low, high=high)
