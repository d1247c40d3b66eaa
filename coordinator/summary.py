"""`summary.json`: the outcome of a run for programs."""

from __future__ import annotations

import json
import math
import os
import re
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
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
    tips = [clean(name) for name in series if name.split("@")[0] == "crack_tip"]
    moved = [abs(tip[-1] - tip[0]) for tip in tips if tip is not None]
    lengths = [clean(name) for name in series if re.fullmatch(r"tip_\d+_[01]_length", name)]
    grown = [length[-1] - length[0] for length in lengths if length is not None]
    add("crack_growth", "m", max(moved or grown, default=None))
    error, force = clean("ivc_error_rms"), clean("ivc_force_rms")
    add("ivc_error_rms_mean", "N", None if error is None else error.mean())
    ratio = None if error is None or force is None or force.mean() == 0 else error.mean() / force.mean()
    add("ivc_error_to_force", "1", ratio)
    scale = energy_passed(series)
    for part in ("continuum", "atoms", "interface"):
        residual = clean(f"residual_{part}")
        if residual is not None:
            add(f"books_{part}", "J", residual[-1])
            add(f"books_{part}_relative", "1", residual[-1] / scale if scale else None)
    for name, value in results.measures.items():
        add(name, "m", value)
    return measures, units


def energy_passed(series: dict[str, Any]) -> float:
    """Return the largest energy that a part of the run held or passed on since the start, J."""
    names = ("continuum_edge_work", "continuum_load_work", "continuum_interface_work", "continuum_kinetic",
             "continuum_strain")  # fmt: skip
    found = [series[name] - series[name][0] for name in names if name in series and len(series[name])]
    return float(max((np.nanmax(np.abs(values)) for values in found), default=0.0))
