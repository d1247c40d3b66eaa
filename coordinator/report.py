"""`report.html`: one page on a run, made from its results file and summary alone."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from coordinator.damage_figures import damage_pictures
from coordinator.display_units import ANGSTROM, ATOMIC, ELECTRONVOLT, Units, units_of
from coordinator.field_figures import (
    applied_strain,
    crack_pictures,
    inner_strain,
    scene_pictures,
    strain_pictures,
    stress_pictures,
)
from coordinator.figures import Picture, style
from coordinator.ply_figures import ply_pictures, pull_curve
from coordinator.report_page import page
from coordinator.results import Results
from coordinator.scene import Scene, SceneError, read_resolved
from coordinator.series import series_of
from coordinator.series_figures import series_pictures, shown
from coordinator.summary import Summary, measures_of

#: A tip by connectivity moves by whole rows; less than this is no growth.
LEAST_GROWTH = 0.5 * ANGSTROM

_WHERE = {True: "Where continuum and atoms are and how they overlap.", False: "The body and what moves it."}
_STATUS = {
    "finished": "finished",
    "stopped": "stopped as asked",
    "interrupted": "interrupted",
    "failed": "failed",
    "running": "not finished",
}
#: Measures as the reader's field counts them: label, unit, SI size of that unit.
_MEASURES: dict[str, tuple[str, str, float]] = {
    "applied_strain_end": ("Applied strain at the end", "%", 0.01),
    "j_boundary_end": ("J from the edges at the end", "J/m²", 1.0),
    "crack_growth": ("Crack growth", "Å", ANGSTROM),
    "broken_bonds_end": ("Broken bonds", "", 1.0),
    "longest_bond_max": ("Longest bond", "Å", ANGSTROM),
    "temperature_mean": ("Temperature of all atoms, mean", "K", 1.0),
    "handshake_temperature_mean": ("Temperature of anchored atoms, mean", "K", 1.0),
    "force_balance_max": ("Interface force imbalance, largest", "relative", 1.0),
    "ivc_error_rms_mean": ("Standard error of a cell's force, mean", "nN", 1e-9),
    "ivc_error_to_force": ("Standard error against force", "relative", 1.0),
    "books_continuum": ("Books of the continuum: what no work explains", "eV", ELECTRONVOLT),
    "books_continuum_relative": ("The same, against the largest energy passed", "relative", 1.0),
    "books_interface": ("Books of the interface: what exchange and dampers took", "eV", ELECTRONVOLT),
    "books_interface_relative": ("The same, against the largest energy passed", "relative", 1.0),
    "books_atoms": ("Books of the atoms: what no work explains", "eV", ELECTRONVOLT),
    "books_atoms_relative": ("The same, against the largest energy passed", "relative", 1.0),
    "crack_length": ("Length of the crack at the start", "Å", ANGSTROM),
    "critical_crack_length": ("Critical crack length (Eq 1)", "Å", ANGSTROM),
    "courant_max": ("Courant number", "", 1.0),
}


@dataclass(frozen=True)
class Section:
    """A part of the page: a heading, a sentence, figures."""

    title: str
    text: str
    pictures: list[Picture]


def make_report(folder: str | Path) -> Path:
    """Write `report.html` of a run from its `results.h5` and, where there is one, `summary.json`.

    Parameters
    ----------
    folder : str or Path
        Folder of the run, finished or not.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    ResultsError
        If the folder has no results file.
    """
    path = Path(folder) / "report.html"
    summary = Summary.read(folder)
    with Results(Path(folder) / "results.h5") as results, style():
        if results.status == "running":
            summary = None  # of the run before the one that goes on
        text = _report(results, summary)
    temporary = path.with_name(path.name + ".tmp")
    temporary.write_text(text, encoding="utf-8")
    os.replace(temporary, path)
    return path


def _report(results: Results, summary: Summary | None) -> str:
    scene = _scene(results)
    measures = summary.measures if summary is not None else measures_of(results)[0]
    sections: list[Section] = []
    if scene is not None:
        sections = [
            Section("Scene", _WHERE[scene.atomistic is not None], scene_pictures(results, scene)),
            Section("Crack", "Atoms around the tip.", _crack_pictures(results, scene)),
            Section("Strain", "A uniform strain should pass unchanged.", strain_pictures(results, scene)),
            Section("Stress", "One colour scale for all times.", stress_pictures(results, scene)),
            Section("Plies", "What has failed, by angle of the plies and by material.", ply_pictures(results, scene)),
            Section("Over time", "", series_pictures(results, scene, summary)),
        ]
    status = summary.status if summary is not None else results.status
    reason = summary.reason if summary is not None else "The run goes on, or was killed; this is what it wrote so far."
    return page(
        title=results.scene["title"],
        status=status,
        status_text=_STATUS.get(status, status),
        headline=headline(results, scene, measures),
        reason=reason,
        facts=_facts(results, summary, scene),
        events=[event["sentence"] for event in results.events],
        warnings=_warnings(results, summary, scene),
        sections=[(s.title, s.text, [p.html() for p in s.pictures]) for s in sections if s.pictures],
        numbers=_numbers(results, scene, measures),
        other=_other(results),
        command=results.command,
        scene_text=_scene_text(results),
        versions=results.versions,
        seeds=results.seeds,
    )


def _crack_pictures(results: Results, scene: Scene) -> list[Picture]:
    """Return pictures of the tip: a sample of a file may be a network in space, whose bonds no flat picture tells."""
    of_a_file = scene.atomistic is not None and scene.atomistic.sample is not None
    return damage_pictures(results, scene) if of_a_file else crack_pictures(results, scene)


def _scene(results: Results) -> Scene | None:
    """Return the scene; None where another version wrote one that this version does not know."""
    try:
        return read_resolved(results.scene["resolved"], results.scene["name"])
    except SceneError:
        return None


def headline(results: Results, scene: Scene | None, measures: dict[str, float | None]) -> str:
    """Say in one sentence what happened."""
    if len(results.step) == 0:
        return "No step was made."
    growth, applied = measures.get("crack_growth"), measures.get("applied_strain_end")
    if growth is not None:
        onset = j_at_first_break(results)
        at = f" The first bond broke at J\u00a0=\u00a0{onset:.3g}\u00a0J/m²." if onset is not None else ""
        units = units_of(scene) if scene is not None else ATOMIC
        if growth > LEAST_GROWTH and results.atoms is None:
            size, name = units.length
            return f"The crack grew by {growth / size:.3g}\u00a0{name}."
        if growth > LEAST_GROWTH:
            bonds = measures.get("broken_bonds_end") or 0.0
            return f"The crack grew by {growth / ANGSTROM:.3g}\u00a0Å, {_bonds(bonds)} broke.{at}"
        load = measures.get("j_boundary_end")
        upto = f" up to J\u00a0=\u00a0{load:.3g}\u00a0J/m²" if load is not None else ""
        return f"The crack did not grow{upto}.{at}"
    strain = inner_strain(results) if scene is not None and scene.crack is None else None
    applied_then = applied_strain(results)
    if strain is not None and applied_then:
        applied = applied_then
        error = strain.yy / applied - 1.0
        return (
            f"Of {100 * applied:.3g}\u00a0% applied strain the atoms inside the handshake carry"
            f" {100 * strain.yy:.3g}\u00a0% ({100 * error:+.2g}\u00a0%)."
        )
    if applied is not None:
        curve = pull_curve(results, scene) if scene is not None else None
        if curve is not None and curve[1].max() > 0.0:
            strain_then, stress = curve
            at_peak = 100 * strain_then[int(np.argmax(stress))]
            return f"It bears {stress.max() / 1e6:.4g}\u00a0MPa at {at_peak:.3g}\u00a0% elongation."
        return f"{100 * applied:.3g}\u00a0% strain was reached."
    return f"{int(results.step[-1])} steps were made."


def _bonds(count: float) -> str:
    return "one bond" if count == 1 else f"{count:.0f} bonds"


def j_at_first_break(results: Results) -> float | None:
    """Return J at the first row with more broken bonds than the first row, J/m2; None if none broke."""
    broken, load = results.series.get("broken_bonds"), results.series.get("j_boundary")
    if broken is None or load is None:
        return None
    known = np.flatnonzero(np.isfinite(broken))
    more = known[broken[known] > broken[known[0]]] if len(known) else known
    return float(load[more[0]]) if len(more) and np.isfinite(load[more[0]]) else None


def _facts(results: Results, summary: Summary | None, scene: Scene | None) -> list[tuple[str, str]]:
    """Return the tiles at the head of the page: value, and what it is."""
    units = units_of(scene) if scene is not None else ATOMIC
    steps = int(results.step[-1]) if len(results.step) else 0
    asked = summary.steps_asked if summary is not None else (scene.run.steps if scene is not None else 0)
    found = [(f"{steps:,} of {asked:,}", "coupling steps")]
    if len(results.step) and "time" in results.series:
        found.append((f"{results.series['time'][-1] / units.time[0]:.3g} {units.time[1]}", "simulated"))
    if results.atoms is not None:
        found.append((f"{len(results.atoms.atom_id):,}", "atoms"))
    if results.points is not None and len(results.points):
        found.append((f"{len(results.points.frame(0).weight):,}", "material points"))
    if "ivc_lower" in results.interface:
        found.append((f"{len(results.interface['anchor_ivc']):,}", "anchors"))
        found.append((f"{len(results.interface['ivc_lower']):,}", "interface cells"))
    if summary is not None:
        found.append((_duration(summary.wall_seconds), "wall time"))
    return found


def _duration(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.3g} s"
    return f"{seconds / 60:.3g} min" if seconds < 7200 else f"{seconds / 3600:.3g} h"


def _warnings(results: Results, summary: Summary | None, scene: Scene | None) -> list[str]:
    found = list(summary.warnings) if summary is not None else []
    if scene is None:
        found.append("The scene in this file was written by another version: figures are left out.")
    lost = results.series.get("points_lost")
    if lost is not None and len(lost) and np.nanmax(lost) > 0:
        found.append(f"{np.nanmax(lost):.0f} material points left the grid.")
    force, error = results.series.get("ivc_force_rms"), results.series.get("ivc_error_rms")
    if force is not None and error is not None and len(force) and error[-1] > force[-1]:
        found.append(
            "At the end the standard error of the interface forces is larger than the forces: raise"
            " handshake.steps_per_exchange or lower handshake.stiffness."
        )
    return found


def _numbers(results: Results, scene: Scene | None, measures: dict[str, float | None]) -> list[tuple[str, str, str]]:
    """Return rows of the table of key numbers: what, value, unit."""
    rows: list[tuple[str, str, str]] = []
    units = units_of(scene) if scene is not None else ATOMIC
    onset = j_at_first_break(results)
    if onset is not None:
        rows.append(("J from the edges when the first bond breaks", f"{onset:.4g}", "J/m²"))
    strain = inner_strain(results) if scene is not None and scene.crack is None else None
    if strain is not None:
        rows.append(("Strain along y of the atoms inside the handshake", f"{100 * strain.yy:.4g}", "%"))
        rows.append(("Strain along x of the atoms inside the handshake", f"{100 * strain.xx:.4g}", "%"))
        applied = applied_strain(results)
        if applied:
            rows.append(("Error of the strain along y", f"{100 * (strain.yy / applied - 1):+.3g}", "% of applied"))
    for name in [*_MEASURES, *(name for name in measures if name not in _MEASURES)]:
        label, unit, size = _in_units(_MEASURES.get(name, (name.replace("_", " "), "", 1.0)), units)
        value = measures.get(name)
        if name == "books_continuum" and any(event["kind"] == "growth" for event in results.events):
            label = "Energy of the continuum that no work explains, growing cracks take it"
        if value is not None:
            rows.append((label, f"{value / size:.4g}", unit))
    return rows


def _in_units(measure: tuple[str, str, float], units: Units) -> tuple[str, str, float]:
    """Return a measure in the units of the scene."""
    label, unit, size = measure
    for atomic, own in zip((ATOMIC.length, ATOMIC.energy, ATOMIC.force), (units.length, units.energy, units.force),
                           strict=True):  # fmt: skip
        if unit == atomic[1]:
            return label, own[1], own[0]
    return label, unit, size


def _other(results: Results) -> list[tuple[str, str, str, str]]:
    """Return rows for series that no figure shows: name, meaning, last value, unit."""
    rows = []
    for name, values in results.series.items():
        if not shown(name) and len(values):
            known = series_of(name)
            rows.append((name, known.description, f"{values[-1]:.4g}", results.units[name]))
    return rows


def _scene_text(results: Results) -> str:
    changes = "".join(f"# --set {override}\n" for override in results.scene["overrides"])
    return f"{results.scene['text']}\n{changes}" if changes else str(results.scene["text"])
