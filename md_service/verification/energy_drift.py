"""Drift of the total energy without a thermostat, over the kinetic energy, by force field and time step."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from md_service.atom_system import AtomSystem
from md_service.atoms import Atoms, Box
from md_service.crystals import fcc
from md_service.epoxy import MELT_DENSITY, UNIT, without_topology
from md_service.epoxy_packing import pack
from md_service.epoxy_relaxation import HOT, compress
from md_service.force_fields import ForceField, force_field
from md_service.graphene import graphene
from protocol.verification import Case, Check

GRAPHENE: Final = ("tersoff", "airebo", "rebo", "lcbop")
GRAPHENE_LIMIT: Final = 1e-5  # of the kinetic energy per ps
REAXFF_LIMIT: Final = 1e-3
#: Temperature in K, duration in ps, and the limit for each step in fs.
TABLE: Final = {
    "tersoff": (300.0, 20.0, {0.25: 1e-5, 1.0: 2e-5, 2.0: 1e-3}),
    "airebo": (300.0, 20.0, {0.25: 1e-5, 1.0: 2e-5, 2.0: 1e-3}),
    "rebo": (300.0, 20.0, {0.25: 1e-5, 1.0: 2e-5, 2.0: 1e-3}),
    "lcbop": (300.0, 20.0, {0.25: 1e-5, 1.0: 2e-5, 2.0: 1e-3}),
    "opls-aa": (300.0, 5.0, {0.25: 2e-4, 0.5: 2e-4, 1.0: 2e-4, 2.0: 1e-3}),
    "lennard-jones": (40.0, 40.0, {2.5: 2e-5, 5.0: 2e-5, 10.0: 2e-4}),
    "eam-copper": (300.0, 20.0, {1.0: 1e-5, 2.0: 1e-5, 5.0: 2e-4}),
    "eam-aluminium": (300.0, 20.0, {1.0: 1e-5, 2.0: 1e-5, 5.0: 2e-4}),
}
_DAMPING_PART: Final = 0.05  # damping time of the thermostat before the run, in parts of that run
# Twice the rate of the fastest vibration is in the energy's error of every step: sample faster, or it shows as noise.
_INTERVAL: Final = 1e-15  # s between two samples of the energy
_BLOCKS: Final = 10
_SOURCE: Final = "energy is conserved; line fitted to the total energy"


def drift(
    folder: Path,
    field: ForceField,
    atoms: Atoms,
    temperature: float,
    time_step: float,
    duration: float,
    settling: float = 1e-12,
) -> tuple[float, float]:
    """Slope of the total energy over the mean kinetic energy.

    Parameters
    ----------
    folder : Path
        Of LAMMPS' files.
    field : ForceField
    atoms : Atoms
        A relaxed sample.
    temperature : float
        K, reached with a thermostat first.
    time_step, duration, settling : float
        s; of the run without a thermostat and of the one with it, before.

    Returns
    -------
    slope, standard_error : float
        1/s; the error by leaving out one tenth of the run at a time.
    """
    system = AtomSystem(folder, field, atoms, time_step)
    system.build(atoms.position)
    every = max(1, round(_INTERVAL / time_step))
    samples = round(duration / (every * time_step))
    second = 1.0 / system.units.time
    noise = f"{temperature!r} {temperature!r} {_DAMPING_PART * settling * second!r} 1"
    system.session.commands(
        [
            f"velocity all create {2.0 * temperature!r} 1 loop all",
            "fix integrate all nve",
            f"fix thermostat all langevin {noise}",
            f"run {round(settling / time_step)} post no",
            "unfix thermostat",
            "velocity all zero linear",
            "variable total equal etotal",
            "variable kinetic equal ke",
            "thermo_style custom step etotal ke",
            f"fix record all vector {every} v_total v_kinetic",
            f"run {samples * every} post no",
        ]
    )
    value = system.session.lmp.extract_fix
    record = np.array([[value("record", 0, 2, row, column) for column in (0, 1)] for row in range(samples)])
    system.session.close()
    time = np.arange(samples) * every * time_step
    energy = (record[:, 0] - record[:, 0].mean()) / record[:, 1].mean()
    slope = _slope(time, energy)
    block = np.arange(samples) * _BLOCKS // samples
    left_out = np.array([_slope(time[block != b], energy[block != b]) for b in range(_BLOCKS)])
    variance = (_BLOCKS - 1) / _BLOCKS * np.sum((left_out - left_out.mean()) ** 2)
    return slope, float(np.sqrt(variance))


def _slope(time: NDArray[Any], energy: NDArray[Any]) -> float:
    return float(np.polyfit(time, energy, 1)[0])


def sheet(field: ForceField) -> Atoms:
    """Periodic graphene of 96 atoms at the lattice of 300 K."""
    return graphene(14.6e-10, 17e-10, spacing=field.spacing("graphene", 300.0), periodic=True)


def small_epoxy(folder: Path, units: int) -> Atoms:
    """Epoxy resin of 117 atoms a unit before cross-linking, periodic, typed for OPLS-AA."""
    return compress(pack(UNIT * units, 1), MELT_DENSITY, HOT, 1, folder)


def drop(atoms: Atoms) -> Atoms:
    """The molecules of a sample in vacuum, elements as species."""
    low, high = atoms.position.min(axis=0), atoms.position.max(axis=0)
    return without_topology(atoms.at(atoms.position, Box(low, high)))


def _limited(name: str, result: tuple[float, float], limit: float) -> list[Check]:
    slope, error = (abs(value) * 1e-12 for value in result)
    return [
        Check(f"{name}: drift over kinetic energy", slope, limit, 0.0, _SOURCE, "1/ps", at_most=True),
        Check(f"{name}: its standard error", error, 0.5 * limit, 0.0, "the run is long enough", "1/ps", at_most=True),
    ]


def energy_drift(folder: Path) -> list[Check]:
    """Graphene for 40 ps at 0.5 fs by each potential, and epoxy resin with ReaxFF at 0.1 fs."""
    checks = []
    for name in GRAPHENE:
        field = force_field(name)
        result = drift(folder / name, field, sheet(field), 300.0, 0.5e-15, 40e-12)
        checks += _limited(f"graphene, {name}, 0.5 fs", result, GRAPHENE_LIMIT)
    epoxy = drop(small_epoxy(folder / "epoxy", 2))
    result = drift(folder / "reaxff", force_field("reaxff"), epoxy, 300.0, 0.1e-15, 0.8e-12, settling=0.2e-12)
    checks += _limited("epoxy resin, 234 atoms, reaxff, 0.1 fs", result, REAXFF_LIMIT)
    return checks


def drift_table(folder: Path) -> list[Check]:
    """Each profile at smaller and larger steps: small ones must conserve energy, large ones show what it costs."""
    epoxy = small_epoxy(folder / "epoxy", 1)
    checks = []
    for name, (kelvin, duration, limits) in TABLE.items():
        field = force_field(name)
        for step, limit in limits.items():
            sample = _sample_of(field, epoxy)
            result = drift(folder / name, field, sample, kelvin, step * 1e-15, duration * 1e-12)
            checks += _limited(f"{name}, {step:g} fs", result, limit)
    return checks


def _sample_of(field: ForceField, epoxy: Atoms) -> Atoms:
    if "graphene" in field.materials:
        return sheet(field)
    if field.molecular:
        return epoxy
    material = field.materials[0]
    (element,) = field.elements
    kelvin = max(field.lattice[material])
    return fcc(element, field.spacing(material, kelvin), (4, 4, 4))


CASES = [
    Case("md", "energy-drift", "energy of graphene and epoxy without a thermostat", energy_drift),
    Case("md", "energy-drift-table", "the same by profile and time step", drift_table, slow=True),
]
