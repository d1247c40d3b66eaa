"""`summary.json`: the outcome of a run for programs."""

from __future__ import annotations

import json
import math
import os
import re
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, NonNegativeInt

from coordinator.results import Results
from coordinator.series import series_of

Seconds = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Status = Literal["finished", "stopped", "interrupted", "failed"]


class WallTime(BaseModel):
    """Where the coordinator's wall time with one service went, s."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    computing: Seconds = Field(description="the service worked")
    sending: Seconds = Field(description="messages were packed, sent and unpacked")
    waiting: Seconds = Field(description="answers were on their way, or the service had no processor")


class Summary(BaseModel):
    """What a run came to.

    `measures` holds balance and error measures by name, each a number or, where it could not be
    measured, null; `units` has the unit of each.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    scene: str
    title: str
    status: Status
    reason: str = Field(description="why the run ended, in a sentence")
    steps: NonNegativeInt = Field(description="coupling steps done")
    steps_asked: NonNegativeInt
    wall_seconds: Seconds
    services: dict[str, WallTime]
    measures: dict[str, float | None]
    units: dict[str, str]
    warnings: list[str]
    events: list[dict[str, Any]] = Field(
        default=[], description="what the continuum told of: growth and arrest of cracks, lost points; SI"
    )
    versions: dict[str, str]
    seeds: dict[str, int]
    command: str

    def write(self, folder: str | Path) -> Path:
        """Write `summary.json` in one move and return its path. Numbers that are not finite become null."""
        path = Path(folder) / "summary.json"
        values = self.model_dump(mode="json")
        values["measures"] = {name: finite(value) for name, value in self.measures.items()}
        temporary = path.with_name(path.name + ".tmp")
        with temporary.open("w", encoding="utf-8") as handle:
            json.dump(values, handle, indent=2, allow_nan=False)
            handle.write("\n")
            handle.flush()
            os.fsync(handle.fileno())
        os.replace(temporary, path)
        return path

    @classmethod
    def read(cls, folder: str | Path) -> Summary | None:
        """Read the summary of a run; None where there is none or none that can be read."""
        try:
            return cls.model_validate_json((Path(folder) / "summary.json").read_bytes())
        except (OSError, ValueError):
            return None


def finite(value: float | None) -> float | None:
    """Return `value`, or None where it is not finite."""
    return value if value is not None and math.isfinite(value) else None


def measures_of(results: Results) -> tuple[dict[str, float | None], dict[str, str]]:
    """Compute the balance and error measures of a run from its time series.

    Returns
    -------
    measures : dict of str to float or None
        None where the series that a measure needs are missing.
    units : dict of str to str
    """
    series = results.series
    measures: dict[str, float | None] = {}
    units: dict[str, str] = {}

    def add(name: str, unit: str, value: Any) -> None:
        measures[name], units[name] = finite(None if value is None else float(value)), unit

    def clean(name: str) -> Any:
        array = series.get(name)
        if array is None:
            return None
        array = array[[math.isfinite(value) for value in array]]
        return array if len(array) else None

    for name, source, pick in (
        ("force_balance_max", "force_balance", "max"),
        ("courant_max", "courant", "max"),
        ("temperature_mean", "temperature", "mean"),
        ("handshake_temperature_mean", "handshake_temperature", "mean"),
        ("longest_bond_max", "longest_bond", "max"),
    ):
        array = clean(source)
        add(name, series_of(source).unit, None if array is None else getattr(array, pick)())
    for name in ("applied_strain", "j_boundary", "broken_bonds"):
        array = clean(name)
        add(f"{name}_end", series_of(name).unit, None if array is None else array[-1])
    tip = clean("crack_tip")
    lengths = [clean(name) for name in series if re.fullmatch(r"tip_\d+_[01]_length", name)]
    grown = [length[-1] - length[0] for length in lengths if length is not None]
    add("crack_growth", "m", max(grown, default=None) if tip is None else tip[-1] - tip[0])
    error, force = clean("ivc_error_rms"), clean("ivc_force_rms")
    add("ivc_error_rms_mean", "N", None if error is None else error.mean())
    ratio = None if error is None or force is None or force.mean() == 0 else error.mean() / force.mean()
    add("ivc_error_to_force", "1", ratio)
    balance, scale = energy_drift(series)
    add("continuum_energy_drift", "J", balance)
    add("continuum_energy_drift_relative", "1", None if balance is None or not scale else balance / scale)
    given, taken = clean("anchor_work"), clean("continuum_interface_work")
    passed = None if given is None or taken is None else given[-1] + taken[-1]
    # Zero if the reference forces did no work: anchors get what the continuum gives.
    add("interface_energy_mismatch", "J", passed)
    return measures, units


def energy_drift(series: dict[str, Any]) -> tuple[float | None, float]:
    """Return the energy that the continuum gained without work, at the end, and the largest energy passed, J.

    Gained is (kinetic + strain + what damping, plastic flow and friction took) - (work of edges,
    of the interface and of loads), against the start.
    """
    names = (
        "continuum_kinetic",
        "continuum_strain",
        "continuum_damping_loss",
        "continuum_dissipated",
    )
    works = ("continuum_edge_work", "continuum_interface_work", "continuum_load_work")
    if not all(name in series for name in (*names[:2], works[0])):
        return None, 0.0
    zero = 0.0 * series[names[0]]
    held = sum(series.get(name, zero) for name in names)
    work = sum(series.get(name, zero) for name in works)
    gained = (held - work) - (held - work)[0] if len(zero) else zero
    if not len(gained) or not math.isfinite(gained[-1]):
        return None, 0.0
    return float(gained[-1]), float(max(abs(held).max(), abs(work).max()))
