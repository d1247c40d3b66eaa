"""Case 2 of the dissertation's chapter 6: what 2 wt% of graphene does to the open-hole strength of a plate.

The dissertation has one mesh and one sequence of increments, and finds +3.7 % without and +4.1 % with cohesive layers.
With sudden failure the peak depends on both, so here the effect is measured on several meshes with several increments,
each time with the same ones for the neat resin and for the other; beside it stands how far the peak itself spreads.
What carries the effect is asked by giving the neat resin the stiffness alone, and the strength alone, of the other.

The half of [45/0/-45/90]s is modelled: four plies of 0.125 mm, 0.5 mm as in the text. Layers have the constants of
Table 6.6 but for the stiffness, 2.71e8 MPa/mm, with which layers that part hardly find a balance (docs/laminates.md):
theirs is 1e5 MPa/mm, which takes 0.2 % off the stiffness of the plate.

Two limits hold on any mesh, between them lies every notched plate: on its net section it holds no more than the strip
without a hole, and as a plate of a brittle elastic material it would hold the strength of that strip over K_T (Heywood,
isotropic in the plane).
"""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fem_service.verification.open_hole_elastic import heywood
from fem_service.verification.pulled_laminates import Pull, cells, pull, shipped_cell
from protocol import structure as s
from protocol.micromechanics import RegisterCell
from protocol.verification import Case, Check

NEAT: Final = "im7_epon862_oht"
GRAPHENE: Final = "im7_epon862_oht_graphene"
ANGLES: Final = (45.0, 0.0, -45.0, 90.0)
LENGTH, WIDTH, DIAMETER, PLY = 64e-3, 16e-3, 3.175e-3, 0.125e-3  # m
FINAL_STRAIN: Final = 0.012
LAYERS: Final = s.CohesiveConstants(
    stiffness=1e14, normal_strength=60e6, shear_strength=90e6, opening_toughness=200.0, sliding_toughness=1000.0
)
#: Elements round a quarter of the hole, along a ray, columns beyond; and increments of strain near the peak.
MESHES: Final = ((6, 5, 1), (8, 6, 2), (10, 8, 3))
INCREMENTS: Final = (0.06e-2, 0.03e-2)
#: What joins the plies: effect in the dissertation; words, mark and colour; meshes and increments.
SERIES: Final = {
    "tied": (0.037, "plies tied", "o", "#4477aa", tuple(product(range(3), INCREMENTS))),
    "layers": (0.041, "cohesive layers", "s", "#ee6677", tuple(product(range(1), INCREMENTS))),
}


def laminate(
    endpoint: str, cell: RegisterCell, mesh: tuple[int, int, int], increment: float, series: str
) -> s.StructureConfigure:
    """The plate; `increment` is a strain."""
    around, radial, beyond = mesh
    size = increment / FINAL_STRAIN
    return s.StructureConfigure(
        **{name: getattr(cell, name) for name in RegisterCell.model_fields},
        length=LENGTH, width=WIDTH, hole_diameter=DIAMETER, ply_thickness=PLY, angles=np.radians(ANGLES).tolist(),
        lower_half=True, mesh=s.PlateMesh(around=around, radial=radial, growth=6.0, beyond=beyond),
        cohesive=LAYERS if series == "layers" else None, temperature=cell.stress_free_temperature,
        final_strain=FINAL_STRAIN, micromechanics=endpoint,
        increments=s.Increments(first=size, most=size, least=1e-4, tolerance=1e-4),
    )  # fmt: skip


def resins() -> dict[str, RegisterCell]:
    """The cell with four resins: neat, with graphene, and with one of the two that graphene changes."""
    neat, graphene = shipped_cell(NEAT), shipped_cell(GRAPHENE)
    fibre, resin = neat.materials
    other = graphene.materials[1]
    mixed = {
        "neat": resin,
        "graphene": other,
        "stiffness alone": other.model_copy(update={"failures": resin.failures}),
        "strength alone": resin.model_copy(update={"failures": other.failures}),
    }
    return {name: neat.model_copy(update={"materials": [fibre, one]}) for name, one in mixed.items()}


#: By series, resin, number of the mesh and increment.
Runs = dict[tuple[str, str, int, float], Pull]


def _runs(endpoint: str) -> Runs:
    cell = resins()
    found = {}
    for series, (*_, plan) in SERIES.items():
        for number, increment in plan:
            names = tuple(cell) if (series, number) == ("tied", 0) else ("neat", "graphene")
            for name in names:
                asked = laminate(endpoint, cell[name], MESHES[number], increment, series)
                found[series, name, number, increment] = pull(asked, stop_below=0.8)
    return found


def _strip(endpoint: str) -> Pull:
    """The laminate without a hole, to its end; all its points are alike, so any mesh will do."""
    asked = laminate(endpoint, resins()["neat"], MESHES[0], INCREMENTS[0], "tied")
    grown = {"hole_diameter": None, "mesh": s.PlateMesh(columns=4, rows=2), "final_strain": 2.0 * FINAL_STRAIN}
    return pull(asked.model_copy(update=grown), stop_below=0.5)


def effects(runs: Runs, series: str, name: str = "graphene") -> NDArray[np.float64]:
    """Peak with another resin over that with the neat one, less one, for each mesh and increment."""
    return np.array(
        [
            run.peak / runs[series, "neat", number, increment].peak - 1.0
            for (at, resin, number, increment), run in runs.items()
            if (at, resin) == (series, name)
        ]
    )


def elements(number: int) -> int:
    """Elements in the plane of a mesh."""
    around, radial, beyond = MESHES[number]
    return 2 * around * (2 * radial + beyond)


def _quasi_isotropic(folder: Path) -> list[Check]:
    with cells() as endpoint:
        strip = _strip(endpoint)
        runs = _runs(endpoint)
    lines, checks = [], []
    for series, (theirs, words, *_, plan) in SERIES.items():
        peaks = np.array([run.peak for (at, name, *_), run in runs.items() if (at, name) == (series, "neat")])
        found = effects(runs, series)
        spread = float(np.ptp(peaks) / peaks.mean())
        lines.append(
            f"{words}: 2 wt% change the peak by {found.mean():+.1%} ({found.min():+.1%} to {found.max():+.1%}; the "
            f"dissertation, one mesh, {theirs:+.1%}); meshes: {len({number for number, _ in plan})}, "
            f"increments: {len(INCREMENTS)}, over which it spreads by {spread:.1%}"
        )
        checks += [
            Check(
                f"{lines[-1]}: effect over spread", abs(float(found.mean())) / spread, 1.0, 0.0,
                "an effect below what mesh and increments do is not resolved", at_most=True,
            ),
            Check(
                f"{words}: largest peak on the net section over the strength without a hole",
                float(peaks.max() / (1.0 - DIAMETER / WIDTH)) / strip.peak, 1.0, 0.0, "limit: no notch effect",
                at_most=True,
            ),
            Check(
                f"{words}: strength without a hole over K_T, over the smallest peak",
                strip.peak / heywood(DIAMETER / WIDTH) / float(peaks.min()), 1.0, 0.0, "limit: brittle elastic plate",
                at_most=True,
            ),
        ]  # fmt: skip
    for name in ("stiffness alone", "strength alone", "graphene"):
        one = effects(runs, "tied", name)[: len(INCREMENTS)]
        lines.append(f"{name}, {elements(0)} elements: " + ", ".join(f"{value:+.1%}" for value in one))
    gave_up = sum(not run.passed_its_peak for run in runs.values())
    checks.append(Check(f"runs of {len(runs)} that did not get past their peak", gave_up, 0.0, 0.0, "their own curves"))
    _written(folder / "oht-quasi-isotropic.txt", lines, runs)
    _drawn(folder / "oht-quasi-isotropic.png", runs)
    return checks


def _written(path: Path, lines: list[str], runs: Runs) -> None:
    lines = [*lines, "", "series elements increment_% resin            peak_MPa effect_% increments iterations end"]
    for (series, name, number, increment), run in runs.items():
        effect = 100.0 * (run.peak / runs[series, "neat", number, increment].peak - 1.0)
        iterations = sum(made.iterations for made in run.made)
        lines.append(
            f"{series:6s} {elements(number):8d} {100 * increment:11g} {name:16s} {run.peak / 1e6:8.1f} {effect:+8.2f} "
            f"{len(run.made):10d} {iterations:10d} {run.gave_up or 'past the peak'}"
        )
    path.write_text("\n".join(lines) + "\n")


def _drawn(path: Path, runs: Runs) -> None:
    figure = Figure(figsize=(12, 4.4), layout="constrained")
    curves, peaks, found = figure.subplots(1, 3)
    for series, (theirs, words, mark, colour, plan) in SERIES.items():
        number, increment = plan[0]
        for name, style in (("neat", "-"), ("graphene", "--")):
            run = runs[series, name, number, increment]
            x, y = [0.0, *(100.0 * e for e in run.strain)], [0.0, *(stress / 1e6 for stress in run.stress)]
            curves.plot(x, y, style, color=colour, lw=1.2, label=f"{words}, {'2 wt%' if style == '--' else 'neat'}")
        for number, increment in plan:
            finer = increment == INCREMENTS[1]
            look = {"color": colour, "marker": mark, "ms": 5 if finer else 8, "mfc": colour if finer else "none"}
            neat, other = (runs[series, name, number, increment].peak for name in ("neat", "graphene"))
            label = words if (number, increment) == plan[0] else None
            peaks.plot(elements(number), neat / 1e6, label=label, ls="", **look)
            found.plot(elements(number), 100.0 * (other / neat - 1.0), ls="", **look)
        found.axhline(100.0 * theirs, color=colour, ls=":", lw=1.0)
    found.axhline(0.0, color="black", lw=0.5)
    curves.set(xlabel="elongation, %", ylabel="mean stress, MPa")
    curves.set_title(f"[45/0/-45/90]s, {elements(0)} elements in the plane", fontsize="medium")
    peaks.set(xlabel="elements in the plane", ylabel="peak of the neat plate, MPa")
    coarse, fine = (100.0 * increment for increment in INCREMENTS)
    peaks.set_title(f"increments {coarse:g} % (open), {fine:g} % (full)", fontsize="medium")
    found.set(xlabel="elements in the plane", ylabel="effect of 2 wt%, %")
    found.set_title("dotted: the dissertation, one mesh", fontsize="medium")
    curves.legend(fontsize="x-small")
    peaks.legend(fontsize="x-small")
    figure.savefig(path, dpi=150)


CASES: list[Case] = [
    Case(
        "structure", "oht-quasi-isotropic", "effect of 2 wt% of graphene, and how far the peak spreads",
        _quasi_isotropic, slow=True,
    )
]  # fmt: skip
