"""Lattice constant and elastic constants of a graphene sheet, which the continuum needs.

At 0 K a periodic sheet is pulled statically by 0.2 % with the lateral stress relaxed to zero. At a temperature
the stress of a periodic sheet is averaged at three strains. All three runs share starting velocities and
thermostat noise, which ties their trajectories together: the noise cancels from the differences of stress, so
a few picoseconds suffice. Four replicas with independent noise give the standard errors; blocks of one run would
not, since ripples of the sheet live longer than a run. Only tension is used, since a sheet under compression buckles.

The temperature matters far more than thermal expansion suggests. REBO-type potentials have a kink in their
angular stiffness exactly at 120 degrees; thermal motion smears it, so airebo's E rises and its Poisson ratio falls
considerably from 0 K to 300 K.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from md_service import units
from md_service.force_fields import CARBON_MASS, ForceField
from md_service.force_fields import force_field as profile_of
from md_service.graphene import GRAPHENE_THICKNESS, area_per_atom
from md_service.lammps_library import LammpsSession

_STATIC_CELLS = (6, 4)
_STATIC_STRAIN = 2e-3
_THERMAL_CELLS = (12, 8)  # 384 atoms, about 29 A x 34 A
_THERMAL_STRAIN = 4e-3
_FIRST_STEPS = (400, 1000)  # settling, sampling
_SETTLING_STEPS = 500
_SAMPLING_STEPS = 700
_REPLICAS = 4
_STEPS_PER_SAMPLE = 2
_DAMPING_TIME = 0.05  # ps; strong, so that trajectories of equal noise stay together
_BOX_HEIGHT = 40.0  # Angstrom
_CHUNK = 700


@dataclass(frozen=True)
class GrapheneProperties:
    """Properties of flat graphene at zero stress, for the continuum.

    Attributes
    ----------
    temperature : float
        K.
    lattice_constant : float
        Carbon-carbon distance, m.
    young : float
        Young's modulus with the given thickness, Pa.
    poisson : float
        Poisson's ratio.
    density : float
        Mass over area and thickness, kg/m^3.
    thickness : float
        m.
    lattice_constant_error, young_error, poisson_error, density_error : float
        Standard errors in the same units; 0 at 0 K.
    """

    temperature: float
    lattice_constant: float
    young: float
    poisson: float
    density: float
    thickness: float
    lattice_constant_error: float = 0.0
    young_error: float = 0.0
    poisson_error: float = 0.0
    density_error: float = 0.0


def measure_graphene(
    force_field: ForceField | str,
    temperature: float,
    work_dir: Path,
    *,
    seed: int = 1,
    thickness: float = GRAPHENE_THICKNESS,
    progress: Callable[[int, int], None] | None = None,
) -> GrapheneProperties:
    """Measure lattice constant, Young's modulus, Poisson's ratio and density.

    Parameters
    ----------
    force_field : ForceField or str
        Profile or its name.
    temperature : float
        K; 0 for the static constants.
    work_dir : Path
        Folder of the LAMMPS log; made if missing.
    seed : int
        Of velocities and thermostat.
    thickness : float
        Of the sheet, m.
    progress : callable, optional
        Called with steps done and steps in all; may raise to stop. Not called at 0 K, which takes less than a
        second.

    Returns
    -------
    GrapheneProperties

    Raises
    ------
    ValueError
        For a negative temperature, a thickness that is not positive, or an unknown force field.
    EngineError
        If LAMMPS stops.
    """
    if not (np.isfinite(temperature) and temperature >= 0.0):
        raise ValueError(f"temperature is {temperature} K; it must be finite and not negative")
    if not thickness > 0.0:
        raise ValueError(f"thickness is {thickness} m; it must be positive")
    profile = profile_of(force_field) if isinstance(force_field, str) else force_field
    work_dir = Path(work_dir)
    work_dir.mkdir(parents=True, exist_ok=True)
    session = LammpsSession(work_dir / "elastic_constants.log", alone=True)
    try:
        sheet = _PeriodicSheet(session, profile.commands(work_dir), thickness)
        if temperature == 0.0:
            return _static(sheet, profile)
        return _thermal(sheet, profile, temperature, seed, progress)
    finally:
        session.close()


def _static(sheet: "_PeriodicSheet", profile: ForceField) -> GrapheneProperties:
    bond = profile.lattice_constant / units.LENGTH
    strain = 1e-4
    for _ in range(3):
        low, high = (sheet.static_stress(bond, sign * strain, sign * strain).mean() for sign in (-1, 1))
        bond *= 1.0 - 0.5 * (low + high) * 2.0 * strain / (high - low)
    lateral, step = 0.0, _STATIC_STRAIN / 10.0
    for _ in range(4):
        here = sheet.static_stress(bond, _STATIC_STRAIN, lateral)[1]
        slope = (sheet.static_stress(bond, _STATIC_STRAIN, lateral - step)[1] - here) / -step
        lateral -= here / slope
    young = sheet.static_stress(bond, _STATIC_STRAIN, lateral)[0] / _STATIC_STRAIN
    return GrapheneProperties(
        temperature=0.0,
        lattice_constant=float(bond * units.LENGTH),
        young=float(young),
        poisson=float(-lateral / _STATIC_STRAIN),
        density=_density(bond, sheet.thickness),
        thickness=sheet.thickness,
    )


def _thermal(
    sheet: "_PeriodicSheet",
    profile: ForceField,
    temperature: float,
    seed: int,
    progress: Callable[[int, int], None] | None,
) -> GrapheneProperties:
    static = _static(sheet, profile)
    bond = static.lattice_constant / units.LENGTH
    per_run = _SETTLING_STEPS + _SAMPLING_STEPS
    report = _Progress(progress, sum(_FIRST_STEPS) + 3 * _REPLICAS * per_run)
    seeds = np.random.SeedSequence(seed).generate_state(_REPLICAS) % 900_000_000 + 1
    # A short run first, so that the elastic constants are taken near zero stress.
    first = sheet.thermal_stress(bond, (0.0, 0.0), temperature, int(seeds[0]), *_FIRST_STEPS, report)
    bond *= 1.0 - first.mean() * (1.0 - static.poisson) / static.young
    e = _THERMAL_STRAIN
    # Mean stress by replica, strain (none, along x, along y) and component.
    stress = np.array(
        [
            [
                sheet.thermal_stress(
                    bond, strain, temperature, int(replica), _SETTLING_STEPS, _SAMPLING_STEPS, report
                ).mean(axis=0)
                for strain in ((0.0, 0.0), (e, 0.0), (0.0, e))
            ]
            for replica in seeds
        ]
    )

    def constants(replicas: NDArray[np.float64]) -> NDArray[np.float64]:
        rest, along_x, along_y = replicas.mean(axis=0)
        stiffness = np.array([along_x - rest, along_y - rest]) / e
        direct = 0.5 * (stiffness[0, 0] + stiffness[1, 1])
        cross = 0.5 * (stiffness[0, 1] + stiffness[1, 0])
        stressless = bond * (1.0 - rest.mean() / (direct + cross))
        return np.array([stressless, direct - cross**2 / direct, cross / direct])

    value = constants(stress)
    left_out = np.array([constants(np.delete(stress, replica, axis=0)) for replica in range(_REPLICAS)])
    # Jackknife over replicas.
    spread = np.sum((left_out - left_out.mean(axis=0)) ** 2, axis=0)
    error = np.sqrt((_REPLICAS - 1) / _REPLICAS * spread)
    density = _density(value[0], sheet.thickness)
    return GrapheneProperties(
        temperature=temperature,
        lattice_constant=float(value[0] * units.LENGTH),
        young=float(value[1]),
        poisson=float(value[2]),
        density=density,
        thickness=sheet.thickness,
        lattice_constant_error=float(error[0] * units.LENGTH),
        young_error=float(error[1]),
        poisson_error=float(error[2]),
        density_error=float(2.0 * density * error[0] / value[0]),
    )


def _density(bond: float, thickness: float) -> float:
    return CARBON_MASS / (area_per_atom(bond * units.LENGTH) * thickness)


class _Progress:
    def __init__(self, callback: Callable[[int, int], None] | None, total: int) -> None:
        self._callback, self._total, self._done = callback, total, 0

    def add(self, steps: int) -> None:
        self._done += steps
        if self._callback is not None:
            self._callback(min(self._done, self._total), self._total)


class _PeriodicSheet:
    """Stress of a periodic sheet under strain, Pa with the sheet's thickness; lengths in Angstrom."""

    def __init__(self, session: LammpsSession, force_field_commands: list[str], thickness: float) -> None:
        self._session = session
        self._force_field_commands = force_field_commands
        self.thickness = thickness
        # LAMMPS' pressure refers to the height of the box, the stress to the thickness of the sheet.
        self._scale = -units.PRESSURE * _BOX_HEIGHT * units.LENGTH / thickness

    def _build(self, bond: float, strain_x: float, strain_y: float, cells: tuple[int, int]) -> int:
        n_x, n_y = cells
        width, height = np.sqrt(3.0) * bond, 3.0 * bond
        basis = np.array([[0.0, 0.0], [0.5 * width, 0.5 * bond], [0.5 * width, 1.5 * bond], [0.0, 2.0 * bond]])
        column, row = (index.ravel() for index in np.meshgrid(np.arange(n_x), np.arange(n_y)))
        corner = np.column_stack([column * width, row * height])
        plane = (corner[:, None, :] + basis).reshape(-1, 2) * [1.0 + strain_x, 1.0 + strain_y]
        position = np.column_stack([plane, np.zeros(len(plane))])
        length_x, length_y = float(n_x * width * (1.0 + strain_x)), float(n_y * height * (1.0 + strain_y))
        self._session.commands(
            [
                "clear",
                "units metal",
                "atom_modify map array sort 0 0",
                "boundary p p p",
                f"region box block 0 {length_x!r} 0 {length_y!r} {-_BOX_HEIGHT / 2} {_BOX_HEIGHT / 2} units box",
                "create_box 1 box",
                *self._force_field_commands,
                "neigh_modify every 1 delay 0 check yes",
                "thermo 0",
            ]
        )
        n_atoms = len(position)
        self._session.lmp.create_atoms(n_atoms, list(range(1, n_atoms + 1)), [1] * n_atoms, position.ravel().tolist())
        return n_atoms

    def static_stress(self, bond: float, strain_x: float, strain_y: float) -> NDArray[np.float64]:
        """Stresses xx and yy of the relaxed sheet, shape (2,)."""
        self._build(bond, strain_x, strain_y, _STATIC_CELLS)
        self._session.commands(["minimize 0 1e-10 1000 10000"])
        return self._scale * np.array([self._session.lmp.get_thermo(name) for name in ("pxx", "pyy")])

    def thermal_stress(
        self,
        bond: float,
        strain: tuple[float, float],
        temperature: float,
        lammps_seed: int,
        settling: int,
        sampling: int,
        report: _Progress,
    ) -> NDArray[np.float64]:
        """Stresses xx and yy, momentum flux of the thermal motion included, shape (samples, 2)."""
        self._build(bond, *strain, _THERMAL_CELLS)
        self._session.commands(
            [
                f"timestep {0.5e-15 / units.TIME!r}",
                # Half of the kinetic energy of the draw goes into the bonds.
                f"velocity all create {2.0 * temperature!r} {lammps_seed} loop all",
                "fix integrate all nve",
                f"fix thermostat all langevin {temperature!r} {temperature!r} {_DAMPING_TIME} {lammps_seed}",
            ]
        )
        self._run(settling, report)
        every = _STEPS_PER_SAMPLE
        self._session.commands([f"fix stress all vector {every} c_thermo_press[1] c_thermo_press[2]"])
        self._run(sampling, report)
        extract = self._session.lmp.extract_fix
        count = sampling // every
        pressure = [[extract("stress", 0, 2, row, axis) for axis in (0, 1)] for row in range(count)]
        return self._scale * np.array(pressure)

    def _run(self, steps: int, report: _Progress) -> None:
        for start in range(0, steps, _CHUNK):
            chunk = min(_CHUNK, steps - start)
            self._session.commands([f"run {chunk} post no"])  # with a setup, in which fix vector makes room
            report.add(chunk)
