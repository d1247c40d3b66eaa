"""Figure and page of a comparison."""

from __future__ import annotations

from html import escape
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from coordinator.compare import ALL_ATOM, COUPLED, Comparison, rows_of
from coordinator.display_units import ANGSTROM, PICOSECOND
from coordinator.figures import BLUE, ORANGE, PALE, WIDTH, picture, style
from coordinator.results import Results
from protocol.arrays import FloatArray

_CSS = """
body { max-width: 820px; margin: 0 auto; padding: 24px; color: #20262e; font: 16px/1.5 system-ui, sans-serif; }
table { border-collapse: collapse; font-size: 15px; }
th, td { text-align: right; padding: 4px 0 4px 16px; border-bottom: 1px solid #e2e6ea; }
td:first-child { text-align: left; padding-left: 0; }
figure { margin: 24px 0; }
figure img { max-width: 620px; width: 100%; }
pre { background: #f5f7f9; padding: 10px; overflow-x: auto; }
"""
_COLOUR = {COUPLED: BLUE, ALL_ATOM: ORANGE}
_NAME = {COUPLED: "coupled", ALL_ATOM: "full atomistic"}


def write_page(folder: Path, found: Comparison, command: str) -> Path:
    """Write `compare.png` and `compare.html` and return the page."""
    with style():
        figure = draw(folder, found)
        figure.savefig(folder / "compare.png")
        shown = picture(
            figure,
            "Crack, temperature and cost",
            "Growth of the crack over the load, its first lattice constants; temperature of all atoms; what each run "
            "took. The two runs have the same load at the same time.",
        )
    notes = "".join(f"<li>{escape(note)}</li>" for note in found.notes)
    head = "".join(f"<th>{name}</th>" for name in ("", "coupled", "full atomistic", "difference"))
    rows = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in rows_of(found))
    page = folder / "compare.html"
    page.write_text(
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(found.scene)}</title><style>{_CSS}</style></head><body><h1>{escape(found.scene)}</h1>"
        f"<p>Coupled against full atomistic.</p><table><tr>{head}</tr>{rows}</table><ul>{notes}</ul>{shown.html()}"
        f"<p>Do it again:</p><pre>{escape(command)}</pre></body></html>\n",
        encoding="utf-8",
    )
    return page


def draw(folder: Path, found: Comparison) -> Figure:
    """Return the figure: tip and temperature of both runs, and their cost."""
    figure = Figure(figsize=(WIDTH, 6.4), layout="constrained")
    tip, warm, cost = figure.subplots(3, 1, height_ratios=(2.4, 1.2, 0.9))
    for part, side in ((COUPLED, found.coupled), (ALL_ATOM, found.all_atom)):
        with Results(folder / part / "results.h5") as results:
            series = results.series
        time = series["time"] / PICOSECOND
        if "crack_tip" in series:
            grown = (series["crack_tip"] - series["crack_tip"][0]) / ANGSTROM
            tip.step(time, grown, where="post", color=_COLOUR[part], label=_NAME[part])
        warm.plot(time, _smooth(series["temperature"]), color=_COLOUR[part])
        cost.barh(_NAME[part], side.wall_seconds, color=_COLOUR[part], height=0.6)
        cost.annotate(f" {side.wall_seconds:.3g} s, {side.atoms} atoms", (side.wall_seconds, _NAME[part]), va="center")
    tip.set(ylabel="growth of the crack (Å)", xlabel="time (ps)", title="Crack tip")
    tip.legend(loc="upper left")
    _mark_breaks(tip, folder)
    warm.set(ylabel="temperature (K)", xlabel="time (ps)")
    cost.set(xlabel="wall time (s)")
    cost.margins(x=0.35)
    cost.invert_yaxis()
    cost.grid(False)
    return figure


def _mark_breaks(axes: Axes, folder: Path) -> None:
    """Mark the first broken bond of each run."""
    for part in (COUPLED, ALL_ATOM):
        with Results(folder / part / "results.h5") as results:
            rows = np.flatnonzero(results.series["broken_bonds"] > 0)
            if len(rows):
                axes.axvline(results.series["time"][rows[0]] / PICOSECOND, color=_COLOUR[part], ls=":", lw=1.0)
    axes.annotate("dotted: first broken bond", (0.99, 0.02), xycoords="axes fraction", ha="right", color=PALE)


def _smooth(values: FloatArray) -> FloatArray:
    """Return a running mean over a twentieth of the rows."""
    width = max(1, len(values) // 20)
    kernel = np.ones(width)
    weight = np.convolve(np.ones(len(values)), kernel, mode="same")
    return np.asarray(np.convolve(values, kernel, mode="same") / weight)
