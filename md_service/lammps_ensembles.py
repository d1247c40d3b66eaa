"""Ensembles as LAMMPS fixes: time integration, thermostat, barostat."""

from __future__ import annotations

from typing import Final

from md_service.atoms import Box
from md_service.ensembles import Ensemble
from md_service.units import UnitSystem

#: Fix that couples all atoms to a thermostat; its scalar is the energy that it has taken out.
THERMOSTAT: Final = "thermostat"
TALLIED: Final = ("langevin", "nose-hoover", "berendsen")


def ensemble_commands(
    ensemble: Ensemble | None, group: str, seed: int, units: UnitSystem, box: Box, planar: bool
) -> list[str]:
    """Commands that integrate a group in an ensemble; None and ``none`` are NVE.

    An Andersen thermostat is NVE here: `LammpsDynamics` draws the velocities.

    Parameters
    ----------
    ensemble : Ensemble or None
    group : str
        LAMMPS group of the atoms that move.
    seed : int
        Of the noise.
    units : UnitSystem
    box : Box
        Its periodic directions follow the pressure.
    planar : bool
        Whether atoms move in the plane z = 0 only, so that their temperature has two components.

    Raises
    ------
    ValueError
        If a pressure is asked for and no direction is periodic.
    """
    if ensemble is None:
        return [f"fix integrate {group} nve"]
    kelvin, damp = ensemble.temperature, ensemble.damping_time / units.time
    barostat = ""
    if ensemble.pressure is not None:
        axes = [axis for axis, periodic in zip("xyz", box.periodic, strict=True) if periodic]
        if not axes:
            raise ValueError(f"pressure is {ensemble.pressure} Pa, but the sample is periodic in no direction")
        target, time = ensemble.pressure / units.pressure, ensemble.pressure_time / units.time
        barostat = " ".join(f"{axis} {target!r} {target!r} {time!r}" for axis in axes)
    if ensemble.thermostat == "nose-hoover":
        style = "npt" if barostat else "nvt"
        lines = [f"fix {THERMOSTAT} {group} {style} temp {kelvin!r} {kelvin!r} {damp!r} {barostat}"]
        return [*lines, *_planar_temperature(group)] if planar else lines
    lines = [f"fix integrate {group} nve"]
    if ensemble.thermostat == "langevin":
        lines.append(f"fix {THERMOSTAT} {group} langevin {kelvin!r} {kelvin!r} {damp!r} {seed} tally yes")
    if ensemble.thermostat == "berendsen":
        lines.append(f"fix {THERMOSTAT} {group} temp/berendsen {kelvin!r} {kelvin!r} {damp!r}")
        lines += _planar_temperature(group) if planar else []
    if barostat:
        lines.append(f"fix barostat {group} press/berendsen {barostat}")
    return lines


def ensemble_removal_commands(ensemble: Ensemble | None, planar: bool) -> list[str]:
    """Undo `ensemble_commands`."""
    if ensemble is None:
        return ["unfix integrate"]
    own_temperature = planar and ensemble.thermostat in ("nose-hoover", "berendsen")
    lines = [] if ensemble.thermostat == "nose-hoover" else ["unfix integrate"]
    if ensemble.thermostat in TALLIED:
        lines.append(f"unfix {THERMOSTAT}")
    if ensemble.pressure is not None and ensemble.thermostat != "nose-hoover":
        lines.append("unfix barostat")
    return [*lines, "uncompute planar_temperature"] if own_temperature else lines


def _planar_temperature(group: str) -> list[str]:
    return [
        f"compute planar_temperature {group} temp/partial 1 1 0",
        f"fix_modify {THERMOSTAT} temp planar_temperature",
    ]
