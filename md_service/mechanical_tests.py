"""Uniaxial tension of a sample at a given rate: stress-strain curve, modulus, Poisson's ratio, strength.

The box is pulled along one axis at a constant speed while the lateral periodic directions follow zero stress
(Nose-Hoover barostat) and a Langevin thermostat keeps the temperature. For the modulus each replica is pulled and
pushed from one state with the same noise: half the difference of the two stresses is fitted by a line through zero,
which takes out the starting stress, the curvature, and much of the noise.

For the modulus alone `md_service.stiffness.thermal_stiffness` has a smaller error in the same time, since all of its
samples are taken at full strain. Tension gives what comes after: yield and strength.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from md_service.atom_system import AtomSystem
from md_service.atoms import Atoms, Box
from md_service.force_fields import ForceField
from md_service.force_fields import force_field as profile_of
from md_service.stiffness import replica_seeds
from md_service.strained_sample import Progress, measurable_components, roomy_box, vector_fix

AXES: Final = ("x", "y", "z")
_DAMPING_TIME: Final = 0.1e-12  # s, of the thermostat
_PRESSURE_TIME: Final = 0.3e-12  # s, of the barostat
_BAROSTAT_TEMPERATURE: Final = 300.0  # K
_DRAG: Final = 5.0  # friction of the box times the relaxation time of the barostat
_SETTLING_TIME: Final = 3e-12  # s, to find the mean box, and again in it
_POINTS: Final = 50  # of the curve
_STEPS_PER_SAMPLE: Final = 5
_BROKEN: Final = 0.2  # of the largest stress: below this the sample has failed


@dataclass(frozen=True)
class StressStrain:
    """A tension test.

    Attributes
    ----------
    strain, stress, standard_error : ndarray, shape (points,)
        Engineering strain, true stress along the axis as mean over the replicas, and its standard error, Pa. The
        curve ends early where a sample has failed.
    modulus, modulus_error : float
        Slope up to `fit_strain`, Pa.
    poisson, poisson_error : float
        Lateral contraction over strain in the same range, mean of the lateral directions; NaN if there are none.
    strength, strength_error : float
        Largest stress of the mean curve, Pa. It is the strength only if the curve falls behind it; else the test
        ended before.
    strength_strain : float
        Where.
    passed_strength : bool
        Whether the curve falls behind it, by more than two standard errors.
    rate, temperature : float
        1/s, K.
    fit_strain : float
    axis : str
    seeds : tuple of int
        Of the replicas.
    """

    strain: NDArray[np.float64]
    stress: NDArray[np.float64]
    standard_error: NDArray[np.float64]
    modulus: float
    modulus_error: float
    poisson: float
    poisson_error: float
    strength: float
    strength_error: float
    strength_strain: float
    passed_strength: bool
    rate: float
    temperature: float
    fit_strain: float
    axis: str
    seeds: tuple[int, ...]


def uniaxial_tension(
    atoms: Atoms,
    force_field: ForceField | str,
    temperature: float,
    rate: float,
    axis: str,
    strain: float,
    seed: int,
    work_dir: Path,
    *,
    fit_strain: float = 0.02,
    replicas: int = 3,
    time_step: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> StressStrain:
    """Pull a sample.

    Parameters
    ----------
    atoms : Atoms
        The sample, relaxed at about this temperature, periodic along `axis`.
    force_field : ForceField or str
        Profile or its name.
    temperature : float
        K, positive.
    rate : float
        Engineering strain rate, 1/s. Sound must cross the sample many times in the test: a 2 nm box needs
        rates below some 1e10.
    axis : str
        ``x``, ``y`` or ``z``.
    strain : float
        At which the test ends.
    seed : int
        Of velocities and thermostats.
    work_dir : Path
        Folder of LAMMPS' files; made if missing.
    fit_strain : float
        Range of the modulus, also pushed as far.
    replicas : int
        With independent noise, at least 2.
    time_step : float, optional
        s; by default the force field's.
    progress : callable, optional
        Called with steps done and steps in all; may raise to stop.

    Returns
    -------
    StressStrain

    Raises
    ------
    ValueError
        For a number out of range, an unknown axis, or one along which the sample is not periodic.
    EngineError
        If LAMMPS stops.
    """
    for name, value in (("temperature", temperature), ("rate", rate), ("strain", strain), ("fit_strain", fit_strain)):
        if not (np.isfinite(value) and value > 0.0):
            raise ValueError(f"{name} is {value}; it must be finite and positive")
    if fit_strain > strain:
        raise ValueError(f"fit_strain is {fit_strain}; it must be at most the strain of the test, {strain}")
    if replicas < 2:
        raise ValueError(f"replicas is {replicas}; at least 2 give a standard error")
    if axis not in AXES:
        raise ValueError(f"axis is {axis!r}; it must be x, y or z")
    along = AXES.index(axis)
    if along not in measurable_components(atoms):
        raise ValueError(f"axis is {axis!r}, along which the sample is not periodic")
    profile = profile_of(force_field) if isinstance(force_field, str) else force_field
    step = profile.time_step if time_step is None else time_step
    per_point = max(round(strain / _POINTS / rate / step), _STEPS_PER_SAMPLE)
    per_point -= per_point % _STEPS_PER_SAMPLE
    points = max(round(strain / rate / step / per_point), 1)
    fit_points = max(round(fit_strain / strain * points), 1)
    machine = _TestingMachine(work_dir, profile, atoms, temperature, along, step, rate)
    report = Progress(progress, replicas * (2 * machine.settling + (points + fit_points) * per_point))
    seeds = replica_seeds(seed, replicas)
    curves, moduli, ratios = [], [], []
    try:
        for each in seeds:
            machine.settle(each, report)
            pulled = machine.pull(1, points, per_point, fit_points, each, report)
            pushed = machine.pull(-1, fit_points, per_point, fit_points, each, report)
            curves.append(pulled[:, :2])
            half = 0.5 * (pulled[:fit_points] - pushed)
            slopes = half[:, 0] @ half[:, 1:] / (half[:, 0] @ half[:, 0])
            moduli.append(slopes[0])
            ratios.append(-slopes[1:].mean() if len(slopes) > 1 else np.nan)
    finally:
        machine.close()
    shortest = min(len(curve) for curve in curves)
    joint = np.array([curve[:shortest] for curve in curves])
    stress, error = joint[:, :, 1].mean(axis=0), _standard_error(joint[:, :, 1])
    peak = int(np.argmax(stress))
    behind = stress[peak + 1 :] + 2.0 * np.hypot(error[peak + 1 :], error[peak])
    return StressStrain(
        strain=joint[0, :, 0],
        stress=stress,
        standard_error=error,
        modulus=float(np.mean(moduli)),
        modulus_error=float(_standard_error(np.array(moduli))),
        poisson=float(np.mean(ratios)),
        poisson_error=float(_standard_error(np.array(ratios))),
        strength=float(stress[peak]),
        strength_error=float(error[peak]),
        strength_strain=float(joint[0, peak, 0]),
        passed_strength=bool((behind < stress[peak]).any()) or shortest < points,
        rate=rate,
        temperature=temperature,
        fit_strain=fit_strain,
        axis=axis,
        seeds=seeds,
    )


def _standard_error(replicas: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.std(replicas, axis=0, ddof=1) / np.sqrt(len(replicas)))


class _TestingMachine:
    """Settles a sample at zero stress and pulls it."""

    def __init__(
        self,
        work_dir: Path,
        force_field: ForceField,
        atoms: Atoms,
        temperature: float,
        along: int,
        time_step: float,
        rate: float,
    ) -> None:
        self._atoms = replace(atoms, box=roomy_box(atoms))
        self._temperature, self._along, self._rate = temperature, along, rate
        self._system = AtomSystem(work_dir, force_field, atoms, time_step)
        axes = [index for index in measurable_components(atoms) if index < 3]
        self._lateral = [index for index in axes if index != along]
        self._axes = axes
        # LAMMPS' pressure refers to the whole box, the stress of a sheet to its thickness.
        height = 1.0 if atoms.thickness is None else self._atoms.box.edges[2, 2] / atoms.thickness
        self._scale = -self._system.units.pressure * height
        steps = round(_SETTLING_TIME / time_step)
        self.settling = steps - steps % (2 * _STEPS_PER_SAMPLE)
        self._settled: tuple[NDArray[np.float64], NDArray[np.float64], Box] | None = None

    def settle(self, seed: int, report: Progress) -> None:
        """Find the box of zero stress as a mean over time, and settle in it."""
        system, unit = self._system, self._system.units
        system.build(self._atoms.position, box=self._atoms.box)
        drawn = self._temperature if self._atoms.spacing is None else 2.0 * self._temperature
        system.session.commands([f"velocity all create {drawn!r} {seed} loop all", *self._motion(self._axes, seed)])
        system.run(self.settling // 2, setup=True, step=0)
        report.add(self.settling // 2)
        lengths = [f"v_length{AXES[axis]}" for axis in self._axes]
        system.session.commands(
            [
                *(f"variable length{AXES[axis]} equal l{AXES[axis]}" for axis in self._axes),
                f"fix box all vector {_STEPS_PER_SAMPLE} {' '.join(lengths)}",
            ]
        )
        system.run(self.settling // 2, setup=True, step=self.settling // 2)
        report.add(self.settling // 2)
        mean = vector_fix(system, "box", len(self._axes)).mean(axis=0) * unit.length
        position, velocity, box = system.position(), system.velocity(), system.box()
        factor = np.ones(3)
        factor[self._axes] = mean / np.diag(box.edges)[self._axes]
        # Stretching along the axes keeps the angles' tangents times the ratio of lengths.
        box = Box(box.low * factor, box.high * factor, box.periodic, box.tilt * factor[[0, 0, 1]])
        system.build(position * factor, velocity, box)
        system.session.commands(self._motion(self._lateral, seed + 1))
        system.run(self.settling, setup=True, step=self.settling)
        report.add(self.settling)
        self._settled = system.position(), system.velocity(), system.box()

    def pull(
        self, sign: int, points: int, per_point: int, unfailing: int, seed: int, report: Progress
    ) -> NDArray[np.float64]:
        """Pull (sign 1) or push (-1) from the settled state; within the unfailing points failure is not looked for.

        Returns
        -------
        ndarray, shape (points, 2 + lateral directions)
            Strain, stress (Pa) and lateral strains as means over each point's steps; fewer points if the sample
            fails.
        """
        assert self._settled is not None
        system, unit = self._system, self._system.units
        position, velocity, box = self._settled
        system.build(position, velocity, box)
        length = np.diag(box.edges)
        speed = float(sign * self._rate * length[self._along] / unit.velocity)
        lengths = [self._along, *self._lateral]
        columns = [f"c_thermo_press[{self._along + 1}]", *(f"v_length{AXES[axis]}" for axis in lengths)]
        system.session.commands(
            [
                *self._motion(self._lateral, seed),
                f"fix pull all deform 1 {AXES[self._along]} vel {speed!r} units box remap x",
                *(f"variable length{AXES[axis]} equal l{AXES[axis]}" for axis in lengths),
            ]
        )
        rows: list[NDArray[np.float64]] = []
        largest = 0.0
        for point in range(points):
            system.session.commands([f"fix sample all vector {_STEPS_PER_SAMPLE} {' '.join(columns)}"])
            system.run(per_point, setup=True, step=point * per_point)
            # The first entry is the end of the point before.
            series = vector_fix(system, "sample", len(columns))[1:]
            system.session.commands(["unfix sample"])
            report.add(per_point)
            mean = series.mean(axis=0)
            stretch = mean[1:] * unit.length / length[lengths] - 1.0
            rows.append(np.concatenate([stretch[:1], [self._scale * mean[0]], stretch[1:]]))
            largest = max(largest, sign * rows[-1][1])
            if point >= unfailing and sign * rows[-1][1] < _BROKEN * largest:
                break
        return np.array(rows)

    def _motion(self, free: list[int], seed: int) -> list[str]:
        """Thermostat, and a barostat that keeps some axes at zero stress."""
        unit = self._system.units
        damping, pressure_time = _DAMPING_TIME / unit.time, _PRESSURE_TIME / unit.time
        targets = " ".join(f"{AXES[axis]} 0 0 {pressure_time!r}" for axis in free)
        heat = self._temperature
        # The barostat's mass grows with this temperature; that of a cold sample would let the box run away. Drag
        # damps the box' own oscillation, which the start of the pull excites.
        weight = f"ptemp {max(heat, _BAROSTAT_TEMPERATURE)!r} drag {_DRAG}"
        integrate = f"fix integrate all nph {targets} {weight}" if free else "fix integrate all nve"
        return [integrate, f"fix thermostat all langevin {heat!r} {heat!r} {damping!r} {seed}"]

    def close(self) -> None:
        """Free LAMMPS."""
        self._system.session.close()
