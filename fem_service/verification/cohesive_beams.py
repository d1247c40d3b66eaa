"""Peak loads of split beams with cohesive layers against beam theory; see `fem_service.verification.beams`.

Beam theory lets the crack grow at a point, the layer over a process zone ahead of it. That of the end-notched beam is
long at the shear strength of the material (100 MPa), so that beam has a layer of 200 MPa, whose zone is short against
the crack. The layers of these two have a viscosity of 3e-5 of the last load or
less, whose energy is checked against what the crack has taken. Mixed-mode bending snaps back as the crack goes from
element to element: it has no viscosity, and past its elastic part increments are of equal dissipation.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.figure import Figure

from fem_service.cohesive_law import CohesiveLaw
from fem_service.dissipation_control import advance_by_dissipation
from fem_service.equilibrium import Equilibrium
from fem_service.increments import Steps
from fem_service.quasi_static import QuasiStatic
from fem_service.verification.beams import (
    HALF_SPAN,
    WIDTH,
    Beam,
    BeamTheory,
    curve,
    double_cantilever,
    end_notched,
    mixed_bending,
    split_beam,
)
from protocol.verification import Case, Check

#: AS4/PEEK: toughness 969 and 1719 J/m^2, strengths 80 and 100 MPa, exponent 2.284.
LAW: Final = CohesiveLaw(1e15, 80e6, 100e6, 969.0, 1719.0, 2.284)
_SHORT: Final = CohesiveLaw(1e15, 80e6, 200e6, 969.0, 1719.0, 2.284)
#: Arm of the lever at which half of the energy goes into each mode, by beam theory without the correction for the tip.
_LEVER: Final = 0.8744 * HALF_SPAN
#: The specimen's real width; loads are printed for it.
_REAL: Final = 25.4e-3 / WIDTH


@dataclass(frozen=True, eq=False)
class _Test:
    """A beam, its load to start from, to go to, and the size of increments between, m; theory's load, N.

    Where there is a dissipation, J, thirty increments of it take the place of those of the load.
    """

    name: str
    beam: Beam
    problem: QuasiStatic
    law: CohesiveLaw
    first: float
    last: float
    size: float
    viscosity: float
    theory: float
    mix: float
    dissipation: float = 0.0


def _tests() -> dict[str, _Test]:
    cantilever = split_beam(55e-3, 32.9e-3, coarse=0.5e-3, fine=0.4e-3, ahead=10e-3)
    notched = split_beam(102e-3, 39.2e-3, coarse=0.7e-3, fine=0.35e-3, ahead=8e-3)
    mixed = split_beam(102e-3, 34.1e-3, coarse=0.7e-3, fine=0.35e-3, ahead=8e-3)
    load, share = BeamTheory(LAW).mixed(34.1e-3, _LEVER)
    return {
        "double cantilever": _Test(
            "double cantilever", cantilever, double_cantilever(cantilever, LAW), LAW,
            3.5e-3, 6e-3, 0.1e-3, 1e-7, BeamTheory(LAW).double_cantilever(32.9e-3), 0.0,
        ),
        "end-notched flexure": _Test(
            "end-notched flexure", notched, end_notched(notched, _SHORT), _SHORT,
            3.2e-3, 4.0e-3, 0.05e-3, 1e-7, BeamTheory(_SHORT).end_notched(39.2e-3), 1.0,
        ),
        "mixed-mode bending": _Test(
            "mixed-mode bending", mixed, mixed_bending(mixed, LAW, _LEVER), LAW,
            5.0e-3, 5.0e-3, 0.05e-3, 0.0, load, share, 1.5e-4,
        ),
    }  # fmt: skip


def _energy_of_crack(test: _Test, at: Equilibrium) -> float:
    """Toughness, of the mix by beam theory, times what the layers have lost, J."""
    damage = at.layers[:, :, 0]
    layers = test.problem.layers
    assert layers is not None  # split beams have some
    law = test.law
    onset = 1.0 / (
        law.stiffness * np.sqrt((1.0 - test.mix) / law.normal_strength**2 + test.mix / law.shear_strength**2)
    )
    final = law.final_opening(test.mix)
    # An opening d with damage D has taken the area under the curve less the elastic rest of it.
    opening = np.where(damage > 0.0, onset * final / (final - damage * (final - onset)), 0.0)
    taken = np.where(damage > 0.0, law.toughness(test.mix) * (opening - onset) / (final - onset), 0.0)
    fresh = test.beam.begin(test.problem).layers[:, :, 0] < 1.0
    return float((layers.areas * taken * fresh).sum())


def _run(names: tuple[str, ...], folder: Path) -> list[Check]:
    checks = []
    every = _tests()
    figure = Figure(figsize=(5 * len(names), 4), layout="constrained")
    axes = figure.subplots(1, len(names), squeeze=False)
    for axis, name in zip(axes[0], names, strict=True):
        test = every[name]
        problem = test.problem
        problem.viscosity = test.viscosity
        rest = test.beam.begin(problem)
        before = test.first / 10.0
        states = curve(problem, rest, test.first, Steps(before, before / 50.0, before))
        states += curve(problem, states[-1], test.last, Steps(test.size, test.size / 200.0, test.size))[1:]
        for _ in range(30 if test.dissipation else 0):
            states.append(advance_by_dissipation(problem, states[-1], test.dissipation))
        loads, forces = np.array([[state.load, state.force] for state in states]).T
        peak = int(forces.argmax())
        last = states[-1]
        taken = _energy_of_crack(test, last)
        work = float(np.trapezoid(forces, loads)) - 0.5 * last.force * last.load
        source = "beam theory with the crack lengthened by chi h (ISO 15024, ASTM D6671)"
        checks += [
            Check(f"{name}: peak load", forces[peak] * _REAL, test.theory * _REAL, 0.03, source, "N"),
            Check(f"{name}: work less what springs back", work, taken + last.viscous_energy, 0.03,
                  "toughness times the area of the crack, and viscosity", "J"),
        ]  # fmt: skip
        if test.viscosity:
            share = last.viscous_energy / taken
            quantity = f"{name}: energy of viscosity over that of the crack"
            checks.append(Check(quantity, share, 0.05, 0.0, "a limit of ours", at_most=True))
        lines = ["load_m force_N crack_m iterations viscous_energy_J"]
        lines += [
            f"{s.load:.6e} {s.force * _REAL:.4f} {test.beam.crack_length(s):.5e} {s.iterations} {s.viscous_energy:.3e}"
            for s in states
        ]
        (folder / f"{name.replace(' ', '_')}.txt").write_text("\n".join(lines) + "\n")
        axis.plot(loads * 1e3, forces * _REAL, "o-", ms=3, label="cohesive layer")
        axis.axhline(test.theory * _REAL, color="k", ls="--", label="beam theory, crack begins to grow")
        axis.set(xlabel="displacement, mm", ylabel="load, N", title=name)
        axis.legend()
    figure.savefig(folder / "load_displacement.png", dpi=120)
    return checks


CASES: list[Case] = [
    Case(
        "structure",
        "cohesive-beams",
        "peak load of a double cantilever and of end-notched flexure with cohesive layers",
        partial(_run, ("double cantilever", "end-notched flexure")),
    ),
    Case(
        "structure",
        "cohesive-beams-mixed",
        "peak load and snap-back of mixed-mode bending with a lever and a cohesive layer",
        partial(_run, ("mixed-mode bending",)),
    ),
]
