"""Relaxing a periodic sample with another force field than the one it was built with.

A resin at 300 K of OPLS-AA is 500 K too hot for ReaxFF, whose bonds have other lengths, and too thin. A coupled run
has no time to mend this.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np

from md_service.atom_system import AtomSystem
from md_service.atoms import Atoms
from md_service.epoxy import without_topology
from md_service.force_fields import ForceField
from md_service.units import BOLTZMANN

#: Of the thermostat, s: it has to take up the energy of all bonds that find new lengths.
DAMPING_TIME: Final = 2e-14


def relaxed(
    atoms: Atoms,
    force_field: ForceField,
    time: float,
    *,
    temperature: float = 300.0,
    density: float | None = None,
    seed: int = 1,
    time_step: float | None = None,
    work_dir: Path,
    progress: Callable[[str], None] | None = None,
) -> Atoms:
    """Let atoms move under a Langevin thermostat, the box going to a density in the middle half of the time.

    Parameters
    ----------
    atoms : Atoms
        Periodic along x, y and z.
    force_field : ForceField
        It is given elements as species and no bonds where it does not need them; the sample keeps what it had.
    time : float
        s.
    temperature : float
        K.
    density : float, optional
        kg/m^3; the box stays without it.
    seed : int
        Of velocities and thermostat.
    time_step : float, optional
        s; the force field's own without it.
    work_dir : Path
    progress : callable, optional
        Given a line of text after each part.

    Returns
    -------
    Atoms
        With the new positions and box.

    Raises
    ------
    ValueError
        If the sample does not repeat along x, y and z, or a number is not positive.
    EngineError
        If LAMMPS stops.
    """
    if not all(atoms.box.periodic):
        raise ValueError("the sample must repeat along x, y and z; its pressure is that of a box")
    for name, value in (("time", time), ("temperature", temperature), ("density", density or 1.0)):
        if not value > 0.0:
            raise ValueError(f"{name} is {value}; it must be positive")
    bare = atoms if force_field.molecular or atoms.topology is None else without_topology(atoms)
    step = force_field.time_step if time_step is None else time_step
    quarter = max(5, round(0.25 * time / step))
    system = AtomSystem(work_dir, force_field, bare, step)
    tell = progress or (lambda line: None)
    try:
        system.build(bare.position)
        unit = system.units
        number = seed % 900_000_000 + 1
        system.session.commands(
            [
                f"velocity all create {temperature!r} {number} dist gaussian",
                "fix integrate all nve",
                f"fix bath all langevin {temperature!r} {temperature!r} {DAMPING_TIME / unit.time!r} {number}",
            ]
        )
        everything = np.zeros(len(atoms), dtype=np.int64)
        deform = []
        if density is not None:
            scale = repr((bare.density / density) ** (1.0 / 3.0))
            deform = [f"fix squeeze all deform 1 x scale {scale} y scale {scale} z scale {scale} remap x"]
        for part, (steps, before, after) in enumerate(
            ((quarter, [], []), (2 * quarter, deform, ["unfix squeeze"] if deform else []), (quarter, [], []))
        ):
            system.session.commands([*before, f"run {steps}", *after])
            energy = float(system.kinetic_energy(everything, 1)[0])
            tell(f"relaxed {(1, 3, 4)[part]} of 4 parts, {2.0 * energy / (3.0 * BOLTZMANN * len(atoms)):.0f} K")
        return atoms.at(system.position(), system.box())
    finally:
        system.session.close()
