"""Case `coupling/energy-books`: 10 ps without thermostat or damping, and no energy is made or lost unseen.

A free body with atoms at 1 K is hit on one side; the wave goes through the atoms again and again. Of continuum, atoms
and interface the change of what they hold is set against work that was measured apart from it (`coordinator.books`).
Energy passed is the largest amount that was on the atoms' side, counted from the start.
"""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from coordinator.results import Results
from coordinator.verification_cases.momentum import HIT
from coordinator.verification_cases.runs import run_text, shipped
from protocol.arrays import FloatArray
from protocol.verification import Case, Check

_OVERRIDES = ("run.steps=2000", "run.output_every=2000", "run.checkpoint_every=2000", "atomistic.temperature=1 K",
              "atomistic.equilibration=1 ps", "atomistic.reference=0.5 ps")  # fmt: skip
PARTS = ("continuum", "atoms", "interface")


def run_books(folder: Path) -> tuple[FloatArray, dict[str, FloatArray], FloatArray, FloatArray]:
    """Return times, s, residuals by part, energy given to the atoms, and the energy of all, J, at each step."""
    text = shipped("free_lattice").replace('damping_time = "0.2 ps"\n', "")
    text += HIT.format(component="x", size=3.0) + HIT.format(component="y", size=1.0)
    with run_text(text, folder, _OVERRIDES) as results:
        series = results.series
        residuals = {part: np.nan_to_num(series[f"residual_{part}"]) for part in PARTS}
        return series["time"], residuals, -series["continuum_interface_work"], _held(results)


def _held(results: Results) -> FloatArray:
    """Energy of continuum, atoms and springs with what the filter of the continuum has taken, J."""
    names = (
        "continuum_kinetic", "continuum_strain", "continuum_filter_loss", "atomistic_kinetic", "atomistic_potential",
        "spring_energy",
    )  # fmt: skip
    return np.asarray(np.sum([results.series[name] for name in names], axis=0))


def energy_books(folder: Path) -> list[Check]:
    """Residual of each part, and the drift of the sum after the hit."""
    time, residuals, given, held = run_books(folder)
    passed = float(np.max(np.abs(given - given[0])))
    figure, (left, right) = plt.subplots(1, 2, figsize=(10.0, 3.8), layout="constrained")
    for part, value in residuals.items():
        left.plot(time * 1e12, 100.0 * value / passed, lw=0.8, label=part)
    left.set(xlabel="time (ps)", ylabel="residual over energy passed (%)")
    left.legend()
    right.plot(time * 1e12, given * 1e21, lw=0.8, label="given to the atoms")
    right.plot(time * 1e12, (held - held[0]) * 1e21, lw=0.8, label="all")
    right.set(xlabel="time (ps)", ylabel="energy (zJ)")
    right.legend()
    figure.savefig(folder / "energy_books.png", dpi=130)
    plt.close(figure)
    after = time > 1e-12
    slope = float(np.polyfit(time[after], held[after], 1)[0])
    source = "change of what is held against work that was measured apart"
    return [
        *(
            Check(f"{part}: largest residual over the energy passed", float(np.max(np.abs(value))) / passed, 0.0, 0.01,
                  source)
            for part, value in residuals.items()
        ),
        Check("drift of all energy over 9 ps over the energy passed", slope * 9e-12 / passed, 0.0, 0.01,
              "nothing acts from outside after the hit"),
    ]  # fmt: skip


CASES = [Case("coupling", "energy-books", "10 ps at 1 K without thermostat: energies against works", energy_books)]
