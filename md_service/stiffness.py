"""Stiffness tensor of a sample, at 0 K and at a temperature.

Each column is the difference of stress between two opposite strains, over the strain. At 0 K every strained box is
minimised, so that atoms move within the cell as they like. At a temperature the runs of one replica share starting
velocities and thermostat noise, which ties their trajectories together: most of the noise cancels from the
differences, so that picoseconds suffice. Independent replicas give the standard errors by jackknife; blocks of one
run would not, since slow motions of a sample live longer than a run.

A sheet buckles under compression, so its columns compare tension with no strain.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from md_service.atoms import Atoms
from md_service.elastic_tensor import Isotropic, compliance_of, engineering_constants, isotropic_average, jackknife
from md_service.force_fields import ForceField
from md_service.force_fields import force_field as profile_of
from md_service.strained_sample import Progress, StrainedSample, deformed, measurable_components

_STATIC_STRAIN: Final = 1e-3
_STATIC_ROUNDS: Final = 6
_STATIC_REST: Final = 1e-9  # strain: what may be left of the way to zero stress
_FIRST_STEPS: Final = (400, 1000)
_LARGEST_REST: Final = 3e-3  # strain to zero stress beyond which a sample is measured anew


@dataclass(frozen=True)
class Sampling:
    """How the stress at a temperature is sampled.

    Attributes
    ----------
    strain : float
        Of each strained run; shear strains are as large in the tensor's sense, gamma = 2 epsilon.
    settling, sampling : float
        Times before and during the average, s.
    replicas : int
        With independent noise, at least 2.
    damping_time : float
        Of the Langevin thermostat, s. Strong damping keeps trajectories of equal noise together.

    Raises
    ------
    ValueError
        For a number that is not finite and positive, fewer than two replicas, or a strain above 0.05.
    """

    strain: float
    settling: float
    sampling: float
    replicas: int
    damping_time: float

    def __post_init__(self) -> None:
        for name in ("strain", "settling", "sampling", "damping_time"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} is {value}; it must be finite and positive")
        if self.strain > 0.05:
            raise ValueError(f"strain is {self.strain}; at most 0.05 gives a stiffness")
        if self.replicas < 2:
            raise ValueError(f"replicas is {self.replicas}; at least 2 give a standard error")

    def steps(self, time_step: float) -> tuple[int, int]:
        """Whole steps of settling and of sampling."""
        return max(round(self.settling / time_step), 1), max(round(self.sampling / time_step), 10)

    @property
    def rate(self) -> float:
        """Strain over the time from straining to the middle of the average, 1/s."""
        return self.strain / (self.settling + 0.5 * self.sampling)


def crystal_sampling(time_step: float) -> Sampling:
    """How a crystal is sampled.

    Parameters
    ----------
    time_step : float
        Recommended by the force field, s: a measure of how fast the material vibrates, and so of how long it takes
        to answer to a strain. Graphene (0.5 fs) settles for 0.25 ps, argon (5 fs) for 2.5 ps.
    """
    return Sampling(
        strain=4e-3,
        settling=500 * time_step,
        sampling=700 * time_step,
        replicas=4,
        damping_time=max(0.05e-12, 50 * time_step),
    )


GLASS: Final = Sampling(strain=1e-2, settling=1e-12, sampling=2e-12, replicas=3, damping_time=0.05e-12)


@dataclass(frozen=True)
class Stiffness:
    """Stiffness of a sample at zero stress.

    Attributes
    ----------
    atoms : Atoms
        The sample in the box in which it was measured.
    components : tuple of int
        Voigt indices (0 to 5 for 11, 22, 33, 23, 13, 12) of the tensor's rows and columns.
    tensor, error : ndarray, shape (n, n)
        Change of true stress with strain (engineering shear) and its standard error, Pa.
    rest_strain, rest_strain_error : ndarray, shape (n,)
        Strain that leads from `atoms` to zero stress.
    density, density_error : float
        At zero stress, kg/m^3.
    temperature : float
        K.
    strain, rate : float
        Strain of the runs, and strain over time to the middle of their average, 1/s; the rate is 0 at 0 K.
    symmetry : str
        ``none``, or ``isotropic`` where only the direct strains were run and the tensor was made from them.
    replicas, rest_stress : ndarray, shape (r, n, n), (r, n)
        What each replica gave, Pa; one replica at 0 K.
    seeds : tuple of int
        Of the replicas.
    """

    atoms: Atoms
    components: tuple[int, ...]
    tensor: NDArray[np.float64]
    error: NDArray[np.float64]
    rest_strain: NDArray[np.float64]
    rest_strain_error: NDArray[np.float64]
    density: float
    density_error: float
    temperature: float
    strain: float
    rate: float
    symmetry: str
    replicas: NDArray[np.float64]
    rest_stress: NDArray[np.float64]
    seeds: tuple[int, ...]

    @property
    def at_rest(self) -> Atoms:
        """The sample without stress."""
        return deformed(self.atoms, self.components, self.rest_strain)

    def isotropic(self) -> tuple[Isotropic, Isotropic]:
        """Hill's isotropic average and its standard errors; see `isotropic_average`.

        Raises
        ------
        ValueError
            If the sample is neither a solid nor a sheet.
        """

        def figures(tensor: NDArray[np.float64]) -> NDArray[np.float64]:
            average = isotropic_average(tensor)
            return np.array([average.young, average.poisson, average.bulk, average.shear, average.spread])

        value, error = jackknife(self.replicas, figures)
        return Isotropic(*value.tolist()), Isotropic(*error.tolist())

    def engineering(self) -> tuple[dict[str, float], dict[str, float]]:
        """Engineering constants and their standard errors; see `engineering_constants`."""
        names = list(engineering_constants(self.tensor))

        def figures(tensor: NDArray[np.float64]) -> NDArray[np.float64]:
            return np.array(list(engineering_constants(tensor).values()))

        value, error = jackknife(self.replicas, figures)
        return dict(zip(names, value.tolist(), strict=True)), dict(zip(names, error.tolist(), strict=True))


def static_stiffness(
    atoms: Atoms,
    force_field: ForceField | str,
    work_dir: Path,
    *,
    strain: float = _STATIC_STRAIN,
    relax_box: bool = True,
) -> Stiffness:
    """Stiffness at 0 K.

    Parameters
    ----------
    atoms : Atoms
        The sample; periodic directions are strained.
    force_field : ForceField or str
        Profile or its name.
    work_dir : Path
        Folder of LAMMPS' files; made if missing.
    strain : float
        Of each strained box, both ways.
    relax_box : bool
        Whether the box is first brought to zero stress (Newton's method with the stiffness itself).

    Returns
    -------
    Stiffness

    Raises
    ------
    ValueError
        For a strain out of range, an unknown force field, or a sample that is periodic nowhere.
    EngineError
        If LAMMPS stops.
    """
    if not (np.isfinite(strain) and 0.0 < strain <= 0.05):
        raise ValueError(f"strain is {strain}; it must be positive and at most 0.05")
    profile = profile_of(force_field) if isinstance(force_field, str) else force_field
    sample = StrainedSample(work_dir, profile, atoms)
    try:
        return _static(sample, strain, relax_box)
    finally:
        sample.close()


def _static(sample: StrainedSample, strain: float, relax_box: bool) -> Stiffness:
    count = len(sample.components)
    none = np.zeros(count)
    sample.relax()
    tensor, stress = _static_tensor(sample, strain), sample.static_stress(none)
    if relax_box:
        for _ in range(_STATIC_ROUNDS):
            way = -compliance_of(tensor) @ stress
            if np.abs(way).max() < _STATIC_REST:
                break
            if np.abs(way).max() > strain:
                way *= min(1.0, 0.05 / np.abs(way).max())
                sample.adopt_strain(way)
                tensor = _static_tensor(sample, strain)
            else:
                sample.adopt_strain(way)
            sample.relax()
            stress = sample.static_stress(none)
        tensor = _static_tensor(sample, strain)
    return _result(sample, tensor[None], stress[None], 0.0, strain, 0.0, "none", ())


def _static_tensor(sample: StrainedSample, strain: float) -> NDArray[np.float64]:
    return np.column_stack(
        [
            (sample.static_stress(column) - sample.static_stress(-column)) / (2.0 * strain)
            for column in strain * np.eye(len(sample.components))
        ]
    )


def thermal_stiffness(
    atoms: Atoms,
    force_field: ForceField | str,
    temperature: float,
    work_dir: Path,
    *,
    seed: int = 1,
    sampling: Sampling | None = None,
    isotropic: bool = False,
    time_step: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Stiffness:
    """Stiffness at a temperature, with standard errors.

    A crystal (a sample whose `spacing` is known) is first brought to zero stress, on the way of its stiffness at
    0 K. Any other sample is taken to be relaxed at this temperature; if it is more than 0.3 % of strain away from
    zero stress, its box is corrected after the first replica, and that one is measured again.

    Parameters
    ----------
    atoms : Atoms
        The sample; periodic directions are strained.
    force_field : ForceField or str
        Profile or its name.
    temperature : float
        K, positive.
    work_dir : Path
        Folder of LAMMPS' files; made if missing.
    seed : int
        Of velocities and thermostats.
    sampling : Sampling, optional
        By default `crystal_sampling` or, for a sample without `spacing`, `GLASS`.
    isotropic : bool
        Run the direct strains only and return the isotropic tensor made from them: the same standard error for
        fewer runs where the material is known to be isotropic.
    time_step : float, optional
        s; by default the force field's.
    progress : callable, optional
        Called with steps done and steps in all; may raise to stop.

    Returns
    -------
    Stiffness

    Raises
    ------
    ValueError
        For a temperature that is not positive, an unknown force field, a sample that is periodic nowhere or, for
        `isotropic`, neither a solid nor a sheet.
    EngineError
        If LAMMPS stops.
    """
    if not (np.isfinite(temperature) and temperature > 0.0):
        raise ValueError(f"temperature is {temperature} K; it must be finite and positive")
    profile = profile_of(force_field) if isinstance(force_field, str) else force_field
    settings = sampling or default_sampling(atoms, profile)
    if isotropic and len(measurable_components(atoms)) not in (3, 6):
        raise ValueError("isotropic needs a sample that is periodic along x and y, or along x, y and z")
    seeds = replica_seeds(seed, settings.replicas)
    sample = StrainedSample(work_dir, profile, atoms, time_step)
    try:
        measurement = _ThermalMeasurement(sample, temperature, settings, isotropic, progress)
        if atoms.spacing is not None:
            measurement.bring_to_rest(seeds[0])
        replicas = [measurement.replica(seeds[0])]
        way = -compliance_of(replicas[0][0]) @ replicas[0][1]
        if atoms.spacing is None and np.abs(way).max() > _LARGEST_REST:
            sample.adopt_strain(way * min(1.0, 0.05 / np.abs(way).max()))
            replicas = [measurement.replica(seeds[0], again=True)]
        replicas += [measurement.replica(each) for each in seeds[1:]]
    finally:
        sample.close()
    tensors, stresses = (np.array(part) for part in zip(*replicas, strict=True))
    symmetry = "isotropic" if isotropic else "none"
    return _result(sample, tensors, stresses, temperature, settings.strain, settings.rate, symmetry, seeds)


def default_sampling(atoms: Atoms, force_field: ForceField) -> Sampling:
    """`crystal_sampling` of a sample with a known spacing, else `GLASS`."""
    return GLASS if atoms.spacing is None else crystal_sampling(force_field.time_step)


def replica_seeds(seed: int, replicas: int) -> tuple[int, ...]:
    """Seeds for LAMMPS of independent replicas."""
    return tuple(int(each) for each in np.random.SeedSequence(seed).generate_state(replicas) % 900_000_000 + 1)


class _ThermalMeasurement:
    """One replica after the other of the stiffness at a temperature."""

    def __init__(
        self,
        sample: StrainedSample,
        temperature: float,
        settings: Sampling,
        isotropic: bool,
        progress: Callable[[int, int], None] | None,
    ) -> None:
        self._sample, self._temperature, self._settings = sample, temperature, settings
        self._isotropic = isotropic
        self._steps = settings.steps(sample.time_step)
        self._is_sheet = sample.atoms.thickness is not None
        identity = np.eye(len(sample.components))
        columns = [identity[row] for row, index in enumerate(sample.components) if index < 3 or not isotropic]
        self._columns = settings.strain * np.array(columns)
        self._runs = 1 + len(columns) * (1 if self._is_sheet else 2)
        total = settings.replicas * self._runs * sum(self._steps)
        if sample.atoms.spacing is not None:
            total += sum(_FIRST_STEPS)
        self._report = Progress(progress, total)

    def bring_to_rest(self, seed: int) -> None:
        """Adopt the box of zero stress at the temperature, by the stiffness at 0 K and one short run."""
        sample = self._sample
        static = _static(sample, _STATIC_STRAIN, relax_box=True)
        stress = sample.thermal_stress(
            np.zeros(len(sample.components)),
            self._temperature,
            seed,
            _FIRST_STEPS,
            self._settings.damping_time,
            self._report,
        ).mean(axis=0)
        sample.adopt_strain(-compliance_of(static.tensor) @ stress)

    def replica(self, seed: int, again: bool = False) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Stiffness (n, n) and stress without strain (n,) from the runs of one seed, Pa."""
        if again:
            self._report.expect(self._runs * sum(self._steps))
        rest = self._stress(np.zeros(self._columns.shape[1]), seed)
        if self._is_sheet:
            columns = [(self._stress(column, seed) - rest) / self._settings.strain for column in self._columns]
        else:
            columns = [
                (self._stress(column, seed) - self._stress(-column, seed)) / (2.0 * self._settings.strain)
                for column in self._columns
            ]
        tensor = np.column_stack(columns)
        return (_isotropic_tensor(tensor) if self._isotropic else tensor), rest

    def _stress(self, strain: NDArray[np.float64], seed: int) -> NDArray[np.float64]:
        series = self._sample.thermal_stress(
            strain, self._temperature, seed, self._steps, self._settings.damping_time, self._report
        )
        return np.asarray(series.mean(axis=0))


def _isotropic_tensor(columns: NDArray[np.float64]) -> NDArray[np.float64]:
    """Isotropic tensor (n, n) of the columns (n, axes) that direct strains gave."""
    count, axes = columns.shape
    block = columns[:axes]
    direct = np.trace(block) / axes
    cross = (block.sum() - np.trace(block)) / (axes * (axes - 1))
    tensor = np.diag(np.full(count, 0.5 * (direct - cross)))
    tensor[:axes, :axes] = cross
    tensor[range(axes), range(axes)] = direct
    return tensor


def _result(
    sample: StrainedSample,
    tensors: NDArray[np.float64],
    stresses: NDArray[np.float64],
    temperature: float,
    strain: float,
    rate: float,
    symmetry: str,
    seeds: tuple[int, ...],
) -> Stiffness:
    count = len(sample.components)
    here = sample.atoms.density
    axes = sum(index < 3 for index in sample.components)

    def figures(joint: NDArray[np.float64]) -> NDArray[np.float64]:
        rest = -compliance_of(joint[:, :count]) @ joint[:, count]
        return np.append(rest, here / np.prod(1.0 + rest[:axes]))

    value, error = jackknife(np.concatenate([tensors, stresses[:, :, None]], axis=2), figures)
    tensor, tensor_error = jackknife(tensors, lambda mean: mean)
    return Stiffness(
        atoms=sample.atoms,
        components=sample.components,
        tensor=tensor,
        error=tensor_error,
        rest_strain=value[:count],
        rest_strain_error=error[:count],
        density=float(value[count]),
        density_error=float(error[count]),
        temperature=temperature,
        strain=strain,
        rate=rate,
        symmetry=symmetry,
        replicas=tensors,
        rest_stress=stresses,
        seeds=seeds,
    )
