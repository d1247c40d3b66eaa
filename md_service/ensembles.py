"""Ensembles of Sec 3.4: which quantities a run keeps, and by which thermostat or barostat."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal, get_args

import numpy as np

Thermostat = Literal["none", "langevin", "nose-hoover", "berendsen", "andersen"]
THERMOSTATS: Final[tuple[str, ...]] = get_args(Thermostat)


@dataclass(frozen=True)
class Ensemble:
    """NVE, NVT or NPT for the whole sample.

    The thermostat of a coupled run is not among them: it is the damper of the anchored atoms
    (`md_service.anchors`), which works relative to the anchors' velocity and leaves the inner atoms to Newton.

    Attributes
    ----------
    thermostat : str
        ``none`` (NVE), ``langevin``, ``nose-hoover``, ``berendsen`` or ``andersen`` (velocities of all atoms are
        drawn anew every damping time).
    temperature : float
        K.
    damping_time : float
        Relaxation time of the thermostat, s.
    pressure : float, optional
        Pa; with it the periodic directions of the box follow the pressure (NPT), by Nose-Hoover with the
        thermostat ``nose-hoover``, else by Berendsen.
    pressure_time : float
        Relaxation time of the barostat, s.

    Raises
    ------
    ValueError
        For an unknown thermostat or a number that is not finite or out of range.
    """

    thermostat: Thermostat
    temperature: float
    damping_time: float = 1e-13
    pressure: float | None = None
    pressure_time: float = 1e-12

    def __post_init__(self) -> None:
        if self.thermostat not in THERMOSTATS:
            raise ValueError(f"thermostat is {self.thermostat!r}; known are {', '.join(THERMOSTATS)}")
        if not (np.isfinite(self.temperature) and self.temperature >= 0.0):
            raise ValueError(f"temperature is {self.temperature} K; it must be finite and not negative")
        for name in ("damping_time", "pressure_time"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} is {value} s; it must be finite and positive")
        if self.pressure is not None and not np.isfinite(self.pressure):
            raise ValueError(f"pressure is {self.pressure} Pa; it must be finite")
