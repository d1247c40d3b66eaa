"""Case `coupling/energy-books`: 10 ps without thermostat or damping, and no energy is made or lost unseen.

A free body with atoms at 1 K is hit on one side; the wave goes through the atoms again and again. Of continuum, atoms
and interface the change of what they hold is set against work that was measured apart from it (`coordinator.books`).
Energy passed is the largest amount that was on the atoms' side, counted from the start.

Only the filter of the continuum takes energy, and it is told by how much. It must never give any, and without it the
energy of all must not grow. The exchange itself misses by its own order: heat of the atoms' angular frequency Omega
goes through anchors that stand still for a coupling step Dt with an error of (Omega Dt)^2 / 6. So the books are kept
at M = 2 of 1 fs, where that is about 1 % of the heat, and at M = 5 they may miss by 6.25 times as much.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from coordinator.verification_cases.momentum import HIT
from coordinator.verification_cases.runs import run_text, shipped
from protocol.arrays import FloatArray
from protocol.verification import Case, Check

_COLD = ("atomistic.temperature=1 K", "atomistic.equilibration=1 ps", "atomistic.reference=0.5 ps")
_ATOM_STEP = 1e-15
_HIT_OVER, _SETTLED = 0.2e-12, 1e-12
PARTS = ("continuum", "atoms", "interface")
_FILTER = "continuum_filter_loss"


@dataclass(frozen=True)
class Kept:
    """Books of a run, each with a value for each step.

    Attributes
    ----------
    time : float64 array, shape (steps,)
        s.
    residuals : dict of str to float64 array, shape (steps,)
        By part, J.
    given : float64 array, shape (steps,)
        Energy that went to the atoms, J.
    held : float64 array, shape (steps,)
        Of continuum, atoms and springs, with the work of the constant reference forces (Eq 87), J.
    filtered : float64 array, shape (steps,)
        What the filter of the continuum has taken, J.
    """

    time: FloatArray
    residuals: dict[str, FloatArray]
    given: FloatArray
    held: FloatArray
    filtered: FloatArray

    @property
    def passed(self) -> float:
        """Largest amount on the atoms' side, J."""
        return float(np.max(np.abs(self.given - self.given[0])))

    def largest(self, part: str, until: float = np.inf) -> float:
        """Largest residual of a part until a time in s, J."""
        return float(np.max(np.abs(self.residuals[part][self.time <= until])))


def run_books(folder: Path, steps_per_exchange: int, duration: float) -> Kept:
    """Run the free body for a time in s and return its books."""
    text = shipped("free_lattice").replace('damping_time = "0.2 ps"\n', "")
    text += HIT.format(component="x", size=3.0) + HIT.format(component="y", size=1.0)
    steps = round(duration / (steps_per_exchange * _ATOM_STEP))
    overrides = [f"run.{key}={steps}" for key in ("steps", "output_every", "checkpoint_every")]
    overrides.append(f"handshake.steps_per_exchange={steps_per_exchange}")
    with run_text(text, folder, (*overrides, *_COLD)) as results:
        series = results.series
        return Kept(
            np.asarray(series["time"]),
            {part: np.nan_to_num(series[f"residual_{part}"]) for part in PARTS},
            -np.asarray(series["continuum_interface_work"]),
            np.sum([series[name] for name in (
                "continuum_kinetic", "continuum_strain", "atomistic_kinetic", "atomistic_potential", "spring_energy",
                "reference_work",
            )], axis=0),
            np.asarray(series[_FILTER]),
        )  # fmt: skip


def energy_books(folder: Path) -> list[Check]:
    """Residual of each part, what all of it does after the hit, and how the interface's residual goes with M."""
    fine = run_books(folder / "m2", 2, 10e-12)
    coarse = run_books(folder / "m5", 5, 4e-12)
    _draw(folder / "energy_books.png", fine)
    passed, after, settled = fine.passed, fine.time > _HIT_OVER, fine.time > _SETTLED
    held, filtered = fine.held[after], fine.filtered[after]
    slope = float(np.polyfit(fine.time[settled], (fine.held + fine.filtered)[settled], 1)[0])
    ratio = coarse.largest("interface", 4e-12) / fine.largest("interface", 4e-12)
    source, alone = "change of what is held against work that was measured apart", "nothing acts from outside after it"
    return [
        *(
            Check(f"{part}: largest residual over the energy passed", fine.largest(part) / passed, 0.0, 0.01, source)
            for part in PARTS
        ),
        Check("drift over 9 ps of all energy, with what the filter took, over the energy passed",
              slope * 9e-12 / passed, 0.0, 0.01, alone),
        Check("largest rise of all energy, without the filter, after the hit, over the energy passed",
              float(np.max(held - np.minimum.accumulate(held))) / passed, 0.0, 0.01, alone),
        Check("largest amount that the filter gave back, over the energy passed",
              float(np.max(np.maximum.accumulate(filtered) - filtered)) / passed, 0.0, 0.01, "a filter only takes"),
        Check("interface: residual at M = 5 over that at M = 2, 4 ps", ratio, 6.25, 0.0,
              "second order in the coupling step; springs at M = 5 are softer", at_most=True),
    ]  # fmt: skip


def _draw(path: Path, kept: Kept) -> None:
    time = kept.time * 1e12
    figure = Figure(figsize=(10.0, 3.8), layout="constrained")
    (left, right) = figure.subplots(1, 2)
    for part, value in kept.residuals.items():
        left.plot(time, 100.0 * value / kept.passed, lw=0.8, label=part)
    left.set(xlabel="time (ps)", ylabel="residual over energy passed (%)")
    left.legend()
    for value, label in (
        (kept.given, "given to the atoms"),
        (kept.held - kept.held[0], "held by all"),
        (kept.filtered - kept.filtered[0], "taken by the filter"),
        (kept.held + kept.filtered - kept.held[0] - kept.filtered[0], "held and taken"),
    ):
        right.plot(time, value * 1e21, lw=0.8, label=label)
    right.set(xlabel="time (ps)", ylabel="energy (zJ)")
    right.legend()
    figure.savefig(path, dpi=130)


CASES = [Case("coupling", "energy-books", "10 ps at 1 K without thermostat: energies against works", energy_books)]
