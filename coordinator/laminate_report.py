"""`report.html` of a laminate run, made from its results file and summary alone."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from coordinator.figures import BLUE, GREEN, INK, ORANGE, PALE, PURPLE, RED, SKY, WIDTH, Picture, picture, style
from coordinator.laminate_results import Frame, LaminateResults
from coordinator.report_page import page
from coordinator.summary import Summary
from coordinator.watched_places import WatchedPlaces
from protocol.arrays import FloatArray

_COLOURS = (BLUE, RED, GREEN, ORANGE, PURPLE, SKY)
_STATUS = {"finished": "finished", "interrupted": "interrupted", "failed": "failed", "stopped": "stopped as asked"}
_PARTS = {
    "seconds_solution": "factorisation and solution",
    "seconds_micromechanics": "micromechanics",
    "seconds_assembly": "assembly",
    "seconds_other": "other",
}
_TOOLS = (
    ("ParaView", "File, Open, results.h5, reader VTKHDF: bricks with displacement, stress and failures (SI)"),
    ("Python", "coordinator.laminate_results.LaminateResults.read(path), or h5py: everything"),
)
#: Plies that the maps show; of more, those with the most failures.
_MAPS = 6


def make_laminate_report(folder: Path) -> Path:
    """Write `report.html` from `results.h5` and `summary.json` in a folder, and return its path."""
    results = LaminateResults.read(folder / "results.h5")
    summary = Summary.read(folder)
    path = folder / "report.html"
    temporary = path.with_name(path.name + ".tmp")
    with style():
        text = _report(results, summary)
    temporary.write_text(text, encoding="utf-8")
    os.replace(temporary, path)
    return path


def _report(results: LaminateResults, summary: Summary | None) -> str:
    stress, strain = np.array(results.series["stress"]), np.array(results.series["strain"])
    if not len(stress):
        headline = "No increment was made."
        sections = []
    else:
        peak = int(np.argmax(stress))
        headline = f"It bears {stress[peak] / 1e6:.4g}\u00a0MPa at {100 * strain[peak]:.4g}\u00a0% elongation."
        if peak == len(stress) - 1:
            headline = f"It bears {stress[peak] / 1e6:.4g}\u00a0MPa and has not reached its peak."
        sections = [
            (
                "Pull",
                "Stress is the force over the cross section without the hole.",
                [_curve(results), _failures(results), *_layers(results)],
            ),
            *_microstructure(results),
            ("Plies", "", _maps(results)),
            ("Work", "", [_times(results)]),
        ]
    measures = summary.measures if summary else {}
    units = summary.units if summary else {}
    status = summary.status if summary else "running"
    return page(
        title=results.scene["title"] or results.scene["name"],
        status=status,
        status_text=_STATUS.get(status, "not finished"),
        headline=headline,
        reason=summary.reason if summary else "The run goes on, or was killed; this is what it wrote so far.",
        facts=_facts(results, summary),
        warnings=summary.warnings if summary else [],
        sections=[(title, text, [picture.html() for picture in pictures]) for title, text, pictures in sections],
        events=[event["sentence"] for event in results.events],
        numbers=[_number(name, value, units.get(name, "")) for name, value in measures.items() if value is not None],
        other=[],
        command=results.scene["command"],
        scene_text=results.scene["text"],
        versions=results.versions,
        seeds={},
        tools=_TOOLS,
    )


_NUMBERS = {
    "peak_stress": ("Peak stress", 1e6, "MPa"),
    "strain_at_peak": ("Elongation at the peak", 0.01, "%"),
    "first_failure_strain": ("Elongation at the first failure", 0.01, "%"),
    "first_failure_stress": ("Stress at the first failure", 1e6, "MPa"),
    "initial_stiffness": ("Stiffness at the start, hole included", 1e9, "GPa"),
    "failed_points": ("Subcells that failed, of all points", 1.0, ""),
    "queries_spared": ("Points answered without a query, exact", 0.01, "%"),
    "work": ("Work of the ends", 1.0, "J"),
    "viscous_share": ("Of that taken by the viscosity of cohesive layers", 0.01, "%"),
    "residual_max": ("Largest force out of balance", 1.0, "relative"),
}


def _number(name: str, value: float, unit: str) -> tuple[str, str, str]:
    label, size, shown = _NUMBERS.get(name, (name, 1.0, unit))
    return label, f"{value / size:.5g}", shown


def _facts(results: LaminateResults, summary: Summary | None) -> list[tuple[str, str]]:
    facts = [
        (str(len(results.bricks)), "bricks"),
        (str(8 * len(results.bricks)), "points with a cell"),
        (str(results.increments), "increments"),
        (str(int(sum(results.series["iterations"]))), "solutions"),
    ]
    if summary is not None:
        facts.append((f"{summary.wall_seconds:.3g} s", "wall time"))
    return facts


def _figure(height: float) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    return figure, figure.subplots()


def _curve(results: LaminateResults) -> Picture:
    stress, strain = np.array(results.series["stress"]) / 1e6, 100 * np.array(results.series["strain"])
    figure, axes = _figure(3.4)
    axes.plot(np.r_[0, strain], np.r_[0, stress], color=BLUE, marker="o", markersize=2.5)
    peak = int(np.argmax(stress))
    late = strain[peak] > 0.75 * strain.max()
    axes.annotate(
        f"{stress[peak]:.4g} MPa",
        (strain[peak], stress[peak]),
        textcoords="offset points",
        xytext=(-6 if late else 6, 4),
        ha="right" if late else "left",
        color=INK,
    )
    for place, (event, colour) in enumerate(zip(results.events[:4], _COLOURS[1:], strict=False)):
        # Dashes of one stand in the gaps of another at the same elongation.
        axes.axvline(100 * event["strain"], color=colour, linewidth=1.0, linestyle=(4 * place, (4, 12)),
                     label=f"{event['material']}, ply {event['ply'] + 1}")  # fmt: skip
    if results.events:
        axes.legend(title="first failure of", loc="lower center", handlelength=4.0, frameon=True, framealpha=1.0)
    axes.set_xlabel("elongation over length (%)")
    axes.set_ylabel("mean stress (MPa)")
    axes.set_ylim(bottom=0.0, top=1.15 * max(float(stress.max()), 1e-12))
    length, section = results.scene["resolved"]["laminate"]["length"], results.section
    load = axes.secondary_yaxis("right", functions=_scaled(1e3 * section))
    load.set_ylabel("load (kN)")
    way = axes.secondary_xaxis("top", functions=_scaled(10.0 * length))
    way.set_xlabel("displacement of the ends (mm)")
    return picture(
        figure,
        "Average traction against strain, load against displacement",
        "One point an increment. Displacement is that of one end against the other.",
    )


def _scaled(size: float) -> tuple[Callable[[Any], Any], Callable[[Any], Any]]:
    """A scale and the way back."""
    return (lambda values: size * values), (lambda values: values / size)


def _microstructure(results: LaminateResults) -> list[tuple[str, str, list[Picture]]]:
    if results.watched is None or not results.watched.strain:
        return []
    text = "Stress along the pull of the whole cell and of its subcells, mean of the points of a brick."
    return [
        ("Microstructure", text, [_subcells(results, results.watched, k) for k in range(len(results.watched.bricks))])
    ]


def _subcells(results: LaminateResults, watched: WatchedPlaces, place: int) -> Picture:
    strain = np.r_[0.0, 100 * watched.strain_along_pull(place)]
    macro, subcells = watched.stress_along_pull(place)
    macro = np.r_[0.0, macro / 1e6]
    figure, axes = _figure(3.2)
    for number, (material, colour) in enumerate(zip(results.materials, _COLOURS[1:], strict=False)):
        own = watched.materials == number
        if not own.any():
            continue
        values = np.vstack([np.zeros(own.sum()), subcells[:, own] / 1e6])
        mean = values @ watched.shares[own] / watched.shares[own].sum()
        axes.plot(strain, mean, color=colour, marker="o", markersize=2.0, label=f"{material}, mean")
        if own.sum() > 1:
            axes.plot(strain, values.max(axis=1), color=colour, linewidth=0.7, label=f"{material}, greatest and least")
            axes.plot(strain, values.min(axis=1), color=colour, linewidth=0.7)
    axes.plot(strain, macro, color=BLUE, linewidth=2.2, marker="o", markersize=2.5, label="whole cell")
    # What has failed is drawn out without end: the axis ends where little is left to see.
    borne = np.flatnonzero(np.abs(macro) >= 0.1 * np.abs(macro).max())
    end = 1.25 * float(strain[: borne[-1] + 2].max()) if len(borne) else 0.0
    cut = 0.0 < end < strain.max()
    if cut:
        axes.set_xlim(-0.04 * end, end)
    axes.legend()
    axes.set_xlabel("strain along the pull (%)")
    axes.set_ylabel("stress along the pull (MPa)")
    x, y, _ = 1e3 * watched.centres[place]
    ply = watched.plies[place] + 1
    return picture(
        figure,
        f"Ply {ply} ({watched.angles[place]:g}°) at x = {x:.3g} mm, y = {y:.3g} mm",
        f"Brick {watched.bricks[place]}; one point an increment."
        + (f" It goes on to {strain.max():.3g} %, with next to no stress." if cut else ""),
    )


def _failures(results: LaminateResults) -> Picture:
    strain = 100 * np.array(results.series["strain"])
    total = np.cumsum(results.new_failures, axis=0)
    figure, axes = _figure(3.4)
    shown = 0
    for ply in range(total.shape[1]):
        for material in range(total.shape[2]):
            if total[-1, ply, material] == 0:
                continue
            axes.plot(
                strain, total[:, ply, material], color=_COLOURS[shown % len(_COLOURS)], drawstyle="steps-post",
                linestyle="-" if shown < len(_COLOURS) else "--",
                label=f"ply {ply + 1} ({results.angles[ply]:g}°), {results.materials[material]}",
            )  # fmt: skip
            shown += 1
    if shown:
        axes.legend()
    else:
        axes.text(0.5, 0.5, "nothing failed", transform=axes.transAxes, ha="center", color=PALE)
    axes.set_xlabel("elongation over length (%)")
    axes.set_ylabel("failed subcells, all points")
    return picture(figure, "What has failed", "Subcells of the cells at all points of a ply, by material.")


def _layers(results: LaminateResults) -> list[Picture]:
    damage = np.array(results.layer_damage)
    if not damage.size:
        return []
    strain = 100 * np.array(results.series["strain"])
    figure, axes = _figure(3.4)
    for interface in range(damage.shape[1]):
        lower, upper = results.angles[interface : interface + 2]
        if lower != upper:  # plies of one angle have no layer between them
            axes.plot(
                strain, 100 * damage[:, interface], color=_COLOURS[interface % len(_COLOURS)],
                linestyle="-" if interface < len(_COLOURS) else "--",
                label=f"plies {interface + 1} and {interface + 2} ({lower:g}°, {upper:g}°)",
            )  # fmt: skip
    axes.legend()
    axes.set_xlabel("elongation over length (%)")
    axes.set_ylabel("parted area (%)")
    return [picture(figure, "Plies that came apart", "Share of each interface that has no traction left.")]


def _maps(results: LaminateResults) -> list[Picture]:
    if not results.frames:
        return []
    stress = np.array(results.series["stress"])
    at_peak = int(np.argmax(stress)) + 1
    near = min(results.frames, key=lambda frame: (frame.step > at_peak, abs(frame.step - at_peak)))
    last = results.frames[-1]
    total = np.sum(results.new_failures, axis=0).sum(axis=1)
    plies = sorted(np.argsort(-total, kind="stable")[:_MAPS].tolist())
    pictures = [
        _map(results, plies, near, near.von_mises() / 1e6, "von Mises stress (MPa)", "viridis",
             f"von Mises stress at {100 * near.strain:.3g} %", "Mean of each brick, near the peak."),
    ]  # fmt: skip
    for place, material in enumerate(results.materials):
        if last.failed[:, place].any():
            pictures.append(
                _map(results, plies, last, last.failed[:, place], "failed share", "magma_r",
                     f"Failed {material} at {100 * last.strain:.3g} %", "Share of its subcells at a brick's points.",
                     (0.0, 1.0))
            )  # fmt: skip
    return pictures


def _map(
    results: LaminateResults,
    plies: list[int],
    frame: Frame,
    values: FloatArray,
    label: str,
    colours: str,
    title: str,
    caption: str,
    limits: tuple[float, float] | None = None,
) -> Picture:
    extent = np.ptp(results.nodes[:, :2], axis=0)
    columns = 1 if extent[0] > 2.0 * extent[1] or len(plies) == 1 else 2
    rows = -(-len(plies) // columns)
    low, high = limits if limits is not None else (0.0, float(values.max()) or 1.0)
    height = rows * (WIDTH / columns * 0.86 * extent[1] / extent[0] + 0.6) + 0.85
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    found = figure.subplots(rows, columns)
    places = np.atleast_1d(np.asarray(found, dtype=object)).reshape(-1)
    image = None
    for place, ply in zip(places, plies, strict=False):
        image = _ply(place, results, ply, values, colours, low, high)
    for place in places[len(plies) :]:
        place.set_axis_off()
    if image is not None:
        figure.colorbar(image, ax=places.tolist(), label=label, orientation="horizontal", shrink=0.7, aspect=36)
    return picture(
        figure, title, caption + (" Only the modelled quarter." if _is_quarter(results) else ""), raster=True
    )


def _ply(
    axes: Axes, results: LaminateResults, ply: int, values: FloatArray, colours: str, low: float, high: float
) -> PolyCollection:
    own = np.flatnonzero(results.ply == ply)
    polygons = 1e3 * results.nodes[results.bricks[own, :4]][:, :, :2]
    # Of several bricks through a ply those above hide the ones below: the mean is what is seen.
    count = len(own) // max(1, len(np.unique(np.round(polygons.mean(axis=1), 9), axis=0)))
    mean = values[own].reshape(count, -1).mean(axis=0)
    image = PolyCollection(list(polygons[: len(mean)]), array=mean, cmap=colours, edgecolors="face", linewidths=0.2)
    image.set_clim(low, high)
    axes.add_collection(image)
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.grid(False)
    axes.set_title(f"ply {ply + 1} ({results.angles[ply]:g}°)")
    axes.set_xlabel("x (mm)")
    axes.set_ylabel("y (mm)")
    return image


def _is_quarter(results: LaminateResults) -> bool:
    return bool(results.nodes[:, 0].min() > -1e-9 * results.nodes[:, 0].max())


def _times(results: LaminateResults) -> Picture:
    spent = {label: sum(results.series[name]) for name, label in _PARTS.items()}
    figure, axes = _figure(1.9)
    names = list(spent)
    axes.barh(names, list(spent.values()), color=[BLUE, ORANGE, GREEN, PALE])
    axes.invert_yaxis()
    axes.set_xlabel("seconds")
    axes.grid(axis="y", visible=False)
    wire = sum(results.series["seconds_wire"])
    caption = f"Of the time for micromechanics {wire:.3g} s went to the wire and to waiting for a processor."
    return picture(figure, "Where the time of the structure service went", caption)
