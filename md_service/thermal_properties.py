"""Thermal expansion of a sample.

Two runs at temperatures on both sides of the wanted one share box, starting velocities (up to their scale) and
thermostat noise. The change of stress between them, divided by the stiffness, is the expansion at zero stress:
alpha = -S (sigma(T + dT) - sigma(T - dT)) / (2 dT). This is an identity of thermodynamics, and much less noisy
than the mean box of a run at constant pressure, whose volume fluctuates.

Atoms move classically here: below the Debye temperature a real material expands less.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from md_service.elastic_tensor import compliance_of, jackknife
from md_service.force_fields import ForceField
from md_service.force_fields import force_field as profile_of
from md_service.stiffness import Sampling, Stiffness, default_sampling
from md_service.strained_sample import Progress, StrainedSample

_LARGEST_HALF_SPAN: Final = 50.0  # K
_LONGER: Final = 3  # times the sampling of a stiffness, whose runs are many more


@dataclass(frozen=True)
class Expansion:
    """Linear thermal expansion at zero stress.

    Attributes
    ----------
    components : tuple of int
        Voigt indices of the entries below.
    coefficient, error : ndarray, shape (n,)
        Strain (engineering shear) over temperature and its standard error, 1/K.
    mean, mean_error : float
        Over the axes, 1/K.
    temperatures : tuple of float
        Of the two sets of runs, K.
    """

    components: tuple[int, ...]
    coefficient: NDArray[np.float64]
    error: NDArray[np.float64]
    mean: float
    mean_error: float
    temperatures: tuple[float, float]


def thermal_expansion(
    stiffness: Stiffness,
    force_field: ForceField | str,
    work_dir: Path,
    *,
    half_span: float | None = None,
    sampling: Sampling | None = None,
    time_step: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Expansion:
    """Measure the thermal expansion about the temperature of a measured stiffness.

    Parameters
    ----------
    stiffness : Stiffness
        Of the sample at the temperature; its replicas' seeds are used again, so that errors of stiffness and
        stress are counted together.
    force_field : ForceField or str
        Profile or its name.
    work_dir : Path
        Folder of LAMMPS' files; made if missing.
    half_span : float, optional
        The two temperatures lie this far below and above, K; by default 50 K, at most half of the temperature.
    sampling : Sampling, optional
        Times and thermostat; by default three times the averages of a stiffness.
    time_step : float, optional
        s; by default the force field's.
    progress : callable, optional
        Called with steps done and steps in all; may raise to stop.

    Returns
    -------
    Expansion

    Raises
    ------
    ValueError
        If the stiffness is one of 0 K, or the half span leads below 0 K.
    EngineError
        If LAMMPS stops.
    """
    middle = stiffness.temperature
    if not stiffness.seeds:
        raise ValueError("stiffness is that of 0 K; thermal expansion needs one at a temperature")
    reach = min(_LARGEST_HALF_SPAN, 0.5 * middle) if half_span is None else half_span
    if not (np.isfinite(reach) and 0.0 < reach < middle):
        raise ValueError(f"half_span is {reach} K; it must be positive and less than the temperature, {middle} K")
    profile = profile_of(force_field) if isinstance(force_field, str) else force_field
    settings = sampling or _longer(default_sampling(stiffness.atoms, profile))
    sample = StrainedSample(work_dir, profile, stiffness.at_rest, time_step)
    steps = settings.steps(sample.time_step)
    report = Progress(progress, 2 * len(stiffness.seeds) * sum(steps))
    none = np.zeros(len(stiffness.components))
    try:
        stress = np.array(
            [
                [
                    sample.thermal_stress(none, temperature, seed, steps, settings.damping_time, report).mean(axis=0)
                    for temperature in (middle - reach, middle + reach)
                ]
                for seed in stiffness.seeds
            ]
        )
    finally:
        sample.close()
    slope = (stress[:, 1] - stress[:, 0]) / (2.0 * reach)
    count = len(none)
    axes = sum(index < 3 for index in stiffness.components)

    def figures(joint: NDArray[np.float64]) -> NDArray[np.float64]:
        alpha = -compliance_of(joint[:, :count]) @ joint[:, count]
        return np.append(alpha, alpha[:axes].mean())

    value, error = jackknife(np.concatenate([stiffness.replicas, slope[:, :, None]], axis=2), figures)
    return Expansion(
        components=stiffness.components,
        coefficient=value[:count],
        error=error[:count],
        mean=float(value[count]),
        mean_error=float(error[count]),
        temperatures=(middle - reach, middle + reach),
    )


def _longer(settings: Sampling) -> Sampling:
    return Sampling(
        strain=settings.strain,
        settling=settings.settling,
        sampling=_LONGER * settings.sampling,
        replicas=settings.replicas,
        damping_time=settings.damping_time,
    )
