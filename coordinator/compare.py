"""The command `compare`: a scene coupled, and its whole body as atoms alone; error and cost beside each other."""

from __future__ import annotations

import json
import math
import shlex
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.spatial import cKDTree

from coordinator.applied_load import load_of
from coordinator.check import AREA_PER_ATOM
from coordinator.checkpoint import read_checkpoint
from coordinator.full_atomistic import (
    Cost,
    FullAtomisticRun,
    Stopwatch,
    WholeBody,
    isotropic_of,
    whole_body,
)
from coordinator.results import Results
from coordinator.run import INTERRUPTED_STATUS, run_scene, set_aside
from coordinator.scene import Scene, load_scene
from coordinator.units import LENGTHS, readable
from protocol.arrays import FloatArray
from protocol.atomistic import Properties
from protocol.backend import find
from protocol.continuum import IsotropicMaterial

COUPLED, ALL_ATOM = "coupled", "all_atom"
#: A full atomistic run that would take longer on an idle core is refused, s.
LONGEST: Final = 3600.0
#: And one of more atoms, where the backend does not say what a step costs.
MOST_ATOMS: Final = 200_000
#: Lattice constant over the distance of neighbours, for the materials where they differ.
LATTICE_CONSTANT: Final = {"graphene": math.sqrt(3.0), "copper": math.sqrt(2.0), "aluminium": math.sqrt(2.0)}


class TooLarge(ValueError):
    """The body has so many atoms that the comparison has to be asked for twice."""


@dataclass(frozen=True)
class Side:
    """What one of the two runs came to; None where it did not happen, or where the scene has no such thing.

    Attributes
    ----------
    atoms : int
    wall_seconds, processor_seconds : float
        Of the whole run, preparation included.
    loop_seconds_per_ps : float
        Wall time of the loop for a picosecond of the run.
    temperature, highest_temperature : float
        Mean over the run, and largest mean of a tenth of it, K.
    load_at_first_break, j_at_first_break : float or None
        Load, and J of that load in J/m2, when the first bond of the unloaded sample was broken.
    load_at_first_growth : float or None
        When the crack tip had moved by half a lattice constant.
    growth : float
        Way of the crack tip at the end, m.
    """

    atoms: int
    wall_seconds: float
    processor_seconds: float
    loop_seconds_per_ps: float
    temperature: float
    highest_temperature: float
    load_at_first_break: float | None
    j_at_first_break: float | None
    load_at_first_growth: float | None
    growth: float


@dataclass(frozen=True)
class Comparison:
    """The two runs beside each other.

    Attributes
    ----------
    scene : str
    load : str
        What the load is: strain applied by the edges, factor of the crack-tip field, or time in s.
    lattice_constant : float
        m.
    growth : float
        Way of the crack tip up to which tips are compared, m.
    coupled, all_atom : Side
    load_error : float or None
        Load of the coupled run at the first broken bond over that of the full atomistic one, less 1.
    tip_difference : float or None
        Largest difference of the two tips at the same load, in lattice constants.
    tip_difference_since_break : float or None
        The same with time counted from the first broken bond of each run.
    tip_load_difference : float or None
        Largest relative difference of the two loads at the same tip.
    time_share, processor_share : float
        Wall and processor time of the coupled run over that of the full atomistic one.
    notes : list of str
        What differs between the two problems.
    """

    scene: str
    load: str
    lattice_constant: float
    growth: float
    coupled: Side
    all_atom: Side
    load_error: float | None
    tip_difference: float | None
    tip_difference_since_break: float | None
    tip_load_difference: float | None
    time_share: float
    processor_share: float
    notes: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Track:
    """Load, J, crack tip and temperature of a run over time; rows as in its results.

    Attributes
    ----------
    name : str
        What the load is called.
    time, load, j, tip, temperature : float64 array, shape (rows,)
        s; as `Comparison.load` says; J/m2; m; K. NaN where there is none.
    broken : float64 array, shape (rows,)
        Broken bonds.
    """

    name: str
    time: FloatArray
    load: FloatArray
    j: FloatArray
    tip: FloatArray
    temperature: FloatArray
    broken: FloatArray

    @property
    def growth(self) -> float:
        """Way of the tip, m; 0 without a crack."""
        return 0.0 if np.isnan(self.tip).all() else float(np.nanmax(self.tip) - self.tip[0])

    def first_break(self) -> int | None:
        """Return the row of the first broken bond; None where none broke."""
        rows = np.flatnonzero(self.broken > 0)
        return int(rows[0]) if len(rows) else None

    def since_break(self) -> Track:
        """Return the run from the row before the first broken bond on; all of it where none broke."""
        start = max((self.first_break() or 0) - 1, 0)
        series = (self.time, self.load, self.j, self.tip, self.temperature, self.broken)
        return Track(self.name, *(values[start:] for values in series))

    def first_beyond(self, growth: float) -> int | None:
        """Return the row at which the tip had first moved by `growth`, m; None where it never did."""
        rows = np.flatnonzero(self.tip - self.tip[0] >= growth)
        return int(rows[0]) if len(rows) else None


def compare_scene(
    scene_path: Path,
    folder: Path,
    *,
    overrides: Sequence[str] = (),
    force: bool = False,
    console: Console | None = None,
) -> Comparison:
    """Run a scene coupled and its whole body all-atom, and write table, `compare.json` and `compare.html`.

    Parameters
    ----------
    scene_path, folder : Path
        Scene file, and folder that takes the runs `coupled` and `all_atom` and the answer.
    overrides : sequence of str
        ``key=value`` changes of the scene.
    force : bool
        Run however large the body is.

    Raises
    ------
    SceneError, BackendError
        As for a run.
    NotComparable, TooLarge
        Before anything has started.
    RuntimeError
        Where the coupled run does not come to its end.
    """
    console = console or Console(stderr=True)
    scene = load_scene(scene_path, overrides)
    body = whole_body(scene)
    atoms, seconds = estimate(body)
    console.print(
        f"full atomistic: {readable(body.size[0], LENGTHS, 4)} x {readable(body.size[1], LENGTHS, 4)}, "
        f"about {atoms:.0f} atoms, about {_duration(seconds)} on one idle core",
        highlight=False,
        soft_wrap=True,
    )
    if not force and (seconds > LONGEST or (math.isnan(seconds) and not atoms <= MOST_ATOMS)):
        raise TooLarge(
            f"the whole body would be about {atoms:.0f} atoms and take about {_duration(seconds)}; allowed are "
            f"{_duration(LONGEST)}, or {MOST_ATOMS} atoms where the cost of a step is not known. Make the body "
            "smaller, the run shorter, or say --force"
        )
    set_aside(folder)
    words = ["scalebridge", "compare", str(scene_path), "--full-atomistic", "--out", str(folder)]
    for override in overrides:
        words += ["--set", override]
    watch = Stopwatch()
    code = run_scene(scene_path, folder / COUPLED, overrides=overrides, console=console)
    coupled_cost = watch.read()
    if code == INTERRUPTED_STATUS:
        raise KeyboardInterrupt
    if code != 0:
        raise RuntimeError(f"the coupled run ended with status {code}; there is nothing to compare with")
    properties = measured_properties(folder / COUPLED)
    material = isotropic_of(scene, properties)
    with Results(folder / COUPLED / "results.h5") as results:
        coupled_atoms = len(results.atoms.atom_id) if results.atoms is not None else 0
        steps = _exchange_steps(scene, results)
    run = FullAtomisticRun(
        body, folder / ALL_ATOM, properties, steps, lambda text: console.print(text, highlight=False)
    )
    cost = run.run(shlex.join(words))
    held = [f"the scene leaves {what} free, the full atomistic run holds it" for what in run.held]
    lattice = _lattice_constant(scene, folder)
    runs = {part: track(scene, material, folder / part) for part in (COUPLED, ALL_ATOM)}
    sides = (
        _side(runs[COUPLED], folder / COUPLED, coupled_atoms, coupled_cost, lattice),
        _side(runs[ALL_ATOM], folder / ALL_ATOM, run.atoms, cost, lattice),
    )
    found = compare_runs(scene, runs[COUPLED], runs[ALL_ATOM], *sides, lattice, held)
    (folder / "compare.json").write_text(json.dumps(asdict(found), indent=2, allow_nan=False) + "\n")
    from coordinator.compare_page import write_page

    page = write_page(folder, found, runs, shlex.join(words))
    console.print(table_of(found))
    for note in found.notes:
        console.print(f"note: {note}", highlight=False)
    console.print(f"page: {page}", markup=False, soft_wrap=True)
    return found


def estimate(body: WholeBody) -> tuple[float, float]:
    """Return about how many atoms a body has and how many seconds its run takes; NaN where that is not known."""
    table, handshake = body.scene.atomistic, body.scene.handshake
    assert table is not None and handshake is not None
    atoms = body.size[0] * body.size[1] / AREA_PER_ATOM.get(table.material, math.nan) * table.layers
    steps = body.scene.run.steps * body.scene.time_step + table.equilibration + table.hold
    backend = find("atomistic", table.backend)
    rate = backend.seconds_per_unit_step.get(table.force_field, math.nan)
    return atoms, atoms * steps / table.time_step * rate / table.ranks


def compare_runs(
    scene: Scene, coupled: Track, whole: Track, left: Side, right: Side, lattice_constant: float, notes: list[str]
) -> Comparison:
    """Hold two runs against each other, the coupled one first."""
    growth = scene.run.stop_after_crack_growth
    if growth is None:
        growth = min(coupled.growth, whole.growth)
    breaks = left.load_at_first_break, right.load_at_first_break
    return Comparison(
        scene=scene.title,
        load=coupled.name,
        lattice_constant=lattice_constant,
        growth=growth,
        coupled=left,
        all_atom=right,
        load_error=None if breaks[0] is None or not breaks[1] else breaks[0] / breaks[1] - 1.0,
        tip_difference=tip_difference(coupled, whole, growth, lattice_constant),
        tip_difference_since_break=tip_difference(coupled.since_break(), whole.since_break(), growth, lattice_constant),
        tip_load_difference=tip_load_difference(coupled, whole, growth, lattice_constant),
        time_share=left.wall_seconds / right.wall_seconds,
        processor_share=left.processor_seconds / right.processor_seconds,
        notes=notes,
    )


def track(scene: Scene, material: IsotropicMaterial, folder: Path) -> Track:
    """Return the course of the run in a folder."""
    with Results(folder / "results.h5") as results:
        series = results.series
    nothing = np.full(len(series["time"]), math.nan)
    name, load, j = load_of(scene, material, series["time"])
    return Track(
        name, series["time"], load, j, series.get("crack_tip", nothing), series["temperature"], series["broken_bonds"]
    )


def tip_difference(one: Track, other: Track, growth: float, lattice_constant: float) -> float | None:
    """Return the largest difference of two tips in the same row, in lattice constants; None without a crack.

    Both runs have their rows at the same times, so the same row is the same load. It is looked for up to the row at
    which both have grown by `growth`, m: a tip counts as no further than that.
    """
    if np.isnan(one.tip).all() or np.isnan(other.tip).all():
        return None
    rows = max(len(one.time), len(other.time))
    way = []
    for run in (one, other):
        grown = np.maximum.accumulate(np.minimum(run.tip - run.tip[0], growth))
        # A run that has ended early had come as far as is compared.
        way.append(np.append(grown, np.full(rows - len(grown), grown[-1])))
    return float(np.max(np.abs(way[0] - way[1])) / lattice_constant)


def tip_load_difference(one: Track, other: Track, growth: float, lattice_constant: float) -> float | None:
    """Return the largest relative difference of the loads at which two tips have come equally far.

    Looked for at every lattice constant of the way, up to `growth`, m, as far as both came.
    """
    worst = None
    for stage in np.arange(lattice_constant, growth * (1 + 1e-9), lattice_constant):
        rows = one.first_beyond(float(stage)), other.first_beyond(float(stage))
        if rows[0] is None or rows[1] is None:
            break
        difference = abs(float(one.load[rows[0]] / other.load[rows[1]]) - 1.0)
        worst = difference if worst is None else max(worst, difference)
    return worst


def table_of(found: Comparison) -> Table:
    """Return the comparison as a table."""
    table = Table(box=None, pad_edge=False)
    for name in ("", "coupled", "full atomistic", "difference"):
        table.add_column(name, justify="left" if not name else "right")
    for row in rows_of(found):
        table.add_row(*row)
    return table


def rows_of(found: Comparison) -> list[tuple[str, str, str, str]]:
    """Return the rows of the table: what, coupled, full atomistic, difference."""

    def number(value: float | None, scale: float = 1.0, digits: int = 4) -> str:
        return "" if value is None else f"{value * scale:.{digits}g}"

    def percent(one: float | None, other: float | None) -> str:
        return "" if one is None or not other else f"{100 * (one / other - 1):+.2g} %"

    a, b = found.coupled, found.all_atom
    pairs = [
        (f"{found.load} at the first broken bond", a.load_at_first_break, b.load_at_first_break, 1.0),
        ("J of that load (J/m2)", a.j_at_first_break, b.j_at_first_break, 1.0),
        (f"{found.load} at the first growth of the crack", a.load_at_first_growth, b.load_at_first_growth, 1.0),
        ("temperature, mean (K)", a.temperature, b.temperature, 1.0),
        ("temperature, highest (K)", a.highest_temperature, b.highest_temperature, 1.0),
    ]
    rows = [(name, number(x, s), number(y, s), percent(x, y)) for name, x, y, s in pairs]
    rows.append(("growth of the crack (angstrom)", number(a.growth, 1e10), number(b.growth, 1e10), ""))
    rows += [
        ("largest difference of tips at one load (lattice constants)", "", "", number(found.tip_difference, digits=3)),
        ("the same, time counted from the first broken bond", "", "",
         number(found.tip_difference_since_break, digits=3)),
        ("largest difference of loads at one tip", "", "",
         "" if found.tip_load_difference is None else f"{100 * found.tip_load_difference:.2g} %"),
        ("atoms", str(a.atoms), str(b.atoms), f"{a.atoms / b.atoms:.2g} of them"),
        ("wall seconds", number(a.wall_seconds), number(b.wall_seconds), f"{found.time_share:.2g} of it"),
        ("processor seconds", number(a.processor_seconds), number(b.processor_seconds),
         f"{found.processor_share:.2g} of it"),
        ("wall seconds of the loop for 1 ps", number(a.loop_seconds_per_ps), number(b.loop_seconds_per_ps),
         f"{a.loop_seconds_per_ps / b.loop_seconds_per_ps:.2g} of it"),
    ]  # fmt: skip
    return rows


def _side(run: Track, folder: Path, atoms: int, cost: Cost, lattice_constant: float) -> Side:
    with Results(folder / "results.h5") as results:
        series = results.series
        spent = sum(float(np.nansum(series[name])) for name in series if name.startswith("seconds_"))
    broken, grown = run.first_break(), run.first_beyond(0.5 * lattice_constant)
    tenth = max(1, len(run.time) // 10)
    means = [float(np.nanmean(part)) for part in np.array_split(run.temperature, max(1, len(run.time) // tenth))]
    j = None if broken is None else float(run.j[broken])
    return Side(
        atoms=atoms,
        wall_seconds=cost.wall_seconds,
        processor_seconds=cost.processor_seconds,
        loop_seconds_per_ps=spent / (float(run.time[-1]) * 1e12),
        temperature=float(np.nanmean(run.temperature)),
        highest_temperature=max(means),
        load_at_first_break=None if broken is None else float(run.load[broken]),
        j_at_first_break=None if j is None or math.isnan(j) else j,
        load_at_first_growth=None if grown is None else float(run.load[grown]),
        growth=run.growth,
    )


def _duration(seconds: float) -> str:
    if math.isnan(seconds):
        return "an unknown time"
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min"


def measured_properties(folder: Path) -> Properties | None:
    """Return the constants that a run in a folder measured for its potential; None where its scene gives them."""
    header = read_checkpoint(folder)[0]
    return Properties.model_validate(header["properties"]) if header["properties"] else None


def _exchange_steps(scene: Scene, results: Results) -> int:
    """Return M of a coupled run, which may have chosen it itself."""
    assert scene.atomistic is not None
    return round(float(results.series["time"][0]) / int(results.step[0]) / scene.atomistic.time_step)


def _lattice_constant(scene: Scene, folder: Path) -> float:
    """Return the lattice constant of the sample, from the distances of its atoms, m."""
    assert scene.atomistic is not None
    with Results(folder / ALL_ATOM / "results.h5") as results:
        assert results.atoms is not None
        place = results.atoms.reference
    nearest = cKDTree(place).query(place, k=2)[0][:, 1]
    return float(np.median(nearest)) * LATTICE_CONSTANT.get(scene.atomistic.material, 1.0)
