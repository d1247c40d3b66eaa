"""Case 1 of the dissertation's chapter 6 on five meshes: what the peak of an open-hole plate owes to the mesh.

[0/90]s, 8 mm x 8 mm x 1 mm, hole 3.175 mm. With the crack band a crack takes the same energy whatever the size of the
elements, so the peak has a limit. With plain elimination it takes the energy of one element and the peak falls for ever
with their size: the stress beside the hole is what it is, and the first element that fails there is the end of it.
Peaks of the dissertation, of a mesh that it does not tell, are in the picture and are no target.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.figure import Figure

from fem_service.verification.pulled_laminates import Pull, cells, pull, shipped_cell
from protocol import structure as s
from protocol.micromechanics import RegisterCell
from protocol.verification import Case, Check

CRACK_BAND: Final = "im7_epon862_crack_band"
ELIMINATION: Final = "im7_epon862_neat"
#: Elements round a quarter of the hole, and from the hole to the side: all meshes are alike, and elements about square,
#: since the length over which one smears its cracks is the edge of a square of its area.
MESHES: Final = ((8, 4), (16, 8), (24, 12), (32, 16), (38, 19))
#: Last strain and increments of strain; those of elimination are smaller: its peak comes at a third of the strain.
PULLS: Final = {CRACK_BAND: (0.024, 0.8e-3), ELIMINATION: (0.012, 0.24e-3)}
#: Peaks of the dissertation, neat and with 2 wt% (Table 6.3), Pa.
THEIRS: Final = {"neat": 712.30e6, "2 wt%": 717.08e6}
#: A force below this part of the peak ends a run. With the crack band what follows is a crack that runs through the
#: plate at once; with elimination the curve is a saw, and a later tooth may be higher.
PAST: Final = {CRACK_BAND: 0.97, ELIMINATION: 0.8}
#: Largest spread of the three finest meshes.
SPREAD: Final = 0.03


def cross_ply(
    endpoint: str, cell: RegisterCell, mesh: tuple[int, int], final_strain: float, increment: float
) -> s.StructureConfigure:
    """One eighth of the plate; all increments of strain are equal."""
    around, radial = mesh
    size = increment / final_strain
    return s.StructureConfigure(
        **{name: getattr(cell, name) for name in RegisterCell.model_fields},
        length=8e-3, width=8e-3, hole_diameter=3.175e-3, ply_thickness=0.25e-3, angles=[0.0, 0.5 * np.pi],
        quarter=True, lower_half=True, mesh=s.PlateMesh(around=around, radial=radial, growth=2.0),
        temperature=cell.stress_free_temperature, final_strain=final_strain, micromechanics=endpoint,
        increments=s.Increments(first=size, most=size, least=size, iterations=600, tolerance=1e-4),
    )  # fmt: skip


def elements(mesh: tuple[int, int]) -> int:
    """Elements in the plane of the whole plate, of which a quarter is modelled."""
    return 4 * mesh[0] * mesh[1]


@dataclass(frozen=True)
class _Run:
    pull: Pull
    seconds: float


def spread(peaks: list[float]) -> float:
    """Largest less smallest over the mean."""
    return float(np.ptp(peaks) / np.mean(peaks))


def _mesh(folder: Path) -> list[Check]:
    runs: dict[str, list[_Run]] = {}
    with cells() as endpoint:
        for name, (final, increment) in PULLS.items():
            for mesh in MESHES:
                began = time.perf_counter()
                found = pull(cross_ply(endpoint, shipped_cell(name), mesh, final, increment), stop_below=PAST[name])
                runs.setdefault(name, []).append(_Run(found, time.perf_counter() - began))
                _written(folder, runs)
    _drawn(folder, runs)
    peaks = {name: [run.pull.peak / 1e6 for run in found] for name, found in runs.items()}
    words = {name: ", ".join(f"{peak:.0f}" for peak in found) for name, found in peaks.items()}
    short = [
        run.pull.gave_up
        for name, found in runs.items()
        for run in found
        if run.pull.stress[-1] >= PAST[name] * run.pull.peak
    ]
    return [
        Check(
            f"crack band: spread of the peaks on the three finest of {len(MESHES)} meshes of {elements(MESHES[0])} to "
            f"{elements(MESHES[-1])} elements ({words[CRACK_BAND]} MPa; plain elimination {words[ELIMINATION]} MPa, "
            f"{spread(peaks[ELIMINATION][-3:]):.1%})",
            spread(peaks[CRACK_BAND][-3:]), SPREAD, 0.0, "mesh independence", at_most=True,
        ),
        Check(
            "runs that did not get past their peak", len(short), 0.0, 0.0,
            f"force below {PAST[CRACK_BAND]:.0%} of the peak, {PAST[ELIMINATION]:.0%} with elimination",
        ),
    ]  # fmt: skip


def _written(folder: Path, runs: dict[str, list[_Run]]) -> None:
    lines = ["cell                    elements increment_%  peak_MPa at_%   increments iterations seconds end"]
    for name, found in runs.items():
        for mesh, run in zip(MESHES, found, strict=False):
            made = run.pull.made
            strain = run.pull.strain[int(np.argmax(run.pull.stress))]
            lines.append(
                f"{name:24s} {elements(mesh):7d} {100 * PULLS[name][1]:11g} {run.pull.peak / 1e6:9.2f} "
                f"{100 * strain:5.3f} {len(made):11d} {sum(one.iterations for one in made):10d} {run.seconds:7.1f} "
                f"{run.pull.gave_up or 'past the peak'}"
            )
    (folder / "oht-mesh.txt").write_text("\n".join(lines) + "\n")


def _drawn(folder: Path, runs: dict[str, list[_Run]]) -> None:
    figure = Figure(figsize=(13, 4.2), layout="constrained")
    peaks, *curves = figure.subplots(1, 3)
    labels = {CRACK_BAND: ("o-", "#4477aa", "crack band"), ELIMINATION: ("s-", "#ee6677", "plain elimination")}
    counts = [elements(mesh) for mesh in MESHES]
    for axes, (name, found) in zip(curves, runs.items(), strict=True):
        style, colour, title = labels[name]
        values = [run.pull.peak / 1e6 for run in found]
        peaks.plot(counts, values, style, color=colour, label=title)
        for count, run, shade in zip(counts, found, np.linspace(0.25, 1.0, len(found)), strict=True):
            axes.plot(
                [0.0, *(100.0 * strain for strain in run.pull.strain)],
                [0.0, *(stress / 1e6 for stress in run.pull.stress)],
                color=colour, alpha=float(shade), lw=1.2, label=f"{count} elements",
            )  # fmt: skip
        axes.set(xlabel="elongation, %", ylabel="mean stress, MPa", title=title, ylim=(0.0, None))
        axes.legend(fontsize="small")
    fine = [run.pull.peak / 1e6 for run in runs[CRACK_BAND][-3:]]
    middle = 0.5 * (min(fine) + max(fine))
    peaks.fill_between(
        [counts[-3], counts[-1]], middle * (1.0 - 0.5 * SPREAD), middle * (1.0 + 0.5 * SPREAD),
        color="#4477aa", alpha=0.2, label=f"{SPREAD:.0%} on the three finest",
    )  # fmt: skip
    for (words, value), style in zip(THEIRS.items(), (":", "--"), strict=True):
        peaks.axhline(value / 1e6, color="black", ls=style, lw=1.0, label=f"dissertation, {words}: {value / 1e6:.2f}")
    peaks.set_xscale("log")
    peaks.set_xticks(counts, [str(count) for count in counts])
    peaks.minorticks_off()
    peaks.set(xlabel="elements in the plane of the plate", ylabel="peak, MPa", ylim=(0.0, None))
    peaks.legend(fontsize="small")
    figure.savefig(folder / "oht-mesh.png", dpi=130)


CASES: list[Case] = [
    Case("structure", "oht-mesh", "peak of an open-hole cross-ply on five meshes, crack band and elimination", _mesh,
         slow=True)
]  # fmt: skip
