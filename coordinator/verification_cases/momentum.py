"""Case `coupling/momentum`: what the continuum gains the atoms lose, at every step.

A free body is hit on one side; when the hit is over nothing acts on it from outside. The continuum takes the reactions
of a step in the next one, so with P of the continuum and p of the atoms, P(n) + p(n - 1) is the same for every step n.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from coordinator.verification_cases.runs import run_text, shipped
from protocol.verification import Case, Check

#: Coupling steps of 5 fs after which the hit is over.
_HIT = 40
HIT = """
[[continuum.edges]]
edge = "right"
kind = "traction"
component = "{component}"
times = ["0 ps", "0.05 ps", "0.15 ps", "0.195 ps"]
tractions = ["0 GPa", "{size} GPa", "{size} GPa", "0 GPa"]
"""


def imbalance(folder: Path, overrides: tuple[str, ...] = ()) -> tuple[float, float]:
    """Run the free body and return the worst change of its momentum in a step, and what went through the handshake.

    Returns
    -------
    worst : float
        Over the momentum that the interface forces hand over in that time, added up step by step without sign.
    passed : float
        Momentum of the atoms at the end over that of the whole.
    """
    text = shipped("free_lattice") + HIT.format(component="x", size=1.0) + HIT.format(component="y", size=0.3)
    with run_text(text, folder, overrides) as results:
        series = results.series
        continuum = np.column_stack([series["continuum_momentum_x"], series["continuum_momentum_y"]])
        atoms = np.column_stack([series["atomistic_momentum_x"], series["atomistic_momentum_y"]])
    whole = (continuum[1:] + atoms[:-1])[_HIT:]
    exchanged = float(np.sum(np.linalg.norm(np.diff(atoms, axis=0), axis=1)))
    worst = float(np.max(np.abs(np.diff(whole, axis=0)))) / exchanged
    return worst, float(np.linalg.norm(atoms[-1]) / np.linalg.norm(whole[-1]))


def momentum(folder: Path) -> list[Check]:
    """Both ways to spread the reactions."""
    found = []
    for spread in ("anchor", "ivc"):
        worst, passed = imbalance(folder / spread, (f"handshake.spread={spread}",))
        found += [
            Check(f"{spread}: worst change of the momentum of all", worst, 0.0, 1e-10, "Newton's third law"),
            Check(f"{spread}: share that has reached the atoms, short of 5 %", max(0.0, 0.05 - passed), 0.0, 0.0,
                  "else nothing was tried"),
        ]  # fmt: skip
    return found


CASES = [Case("coupling", "momentum", "force on the continuum plus force on the atoms, each step", momentum)]
