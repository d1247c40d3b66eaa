"""Figure and page of a comparison."""

from __future__ import annotations

from html import escape
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from coordinator.compare import ALL_ATOM, COUPLED, Comparison, Track, rows_of
from coordinator.display_units import ANGSTROM, PICOSECOND
from coordinator.figures import BLUE, ORANGE, WIDTH, picture, style
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


def write_page(folder: Path, found: Comparison, runs: dict[str, Track], command: str) -> Path:
    """Write `compare.png` and `compare.html` and return the page."""
    with style():
        figure = draw(found, runs)
        figure.savefig(folder / "compare.png")
        shown = picture(
            figure,
            "Crack, temperature and cost",
            "Way of the crack tip over the load, temperature of all atoms of each run, and what each run took. The two "
            "runs have the same load at the same time.",
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


def draw(found: Comparison, runs: dict[str, Track]) -> Figure:
    """Return the figure: tip over load, temperature of all atoms over time, cost."""
    figure = Figure(figsize=(WIDTH, 6.6), layout="constrained")
    tip, warm, cost = figure.subplots(3, 1, height_ratios=(2.4, 1.2, 0.9))
    for part, side in ((COUPLED, found.coupled), (ALL_ATOM, found.all_atom)):
        run, colour = runs[part], _COLOUR[part]
        tip.step(run.load, (run.tip - run.tip[0]) / ANGSTROM, where="post", color=colour, label=_NAME[part])
        broken = run.first_break()
        if broken is not None:
            tip.axvline(run.load[broken], color=colour, ls=":", lw=1.0)
        warm.plot(run.time / PICOSECOND, _smooth(run.temperature), color=colour)
        cost.barh(_NAME[part], side.wall_seconds, color=colour, height=0.6)
        cost.annotate(f" {side.wall_seconds:.0f} s, {side.atoms} atoms", (side.wall_seconds, _NAME[part]), va="center")
    tip.set(ylabel="growth of the crack (Å)", xlabel=found.load, title="Crack tip; dotted: first broken bond")
    tip.legend(loc="upper left")
    warm.set(ylabel="temperature (K)", xlabel="time (ps)")
    cost.set(xlabel="wall time (s)")
    cost.margins(x=0.5)
    cost.invert_yaxis()
    cost.grid(False)
    return figure


def _smooth(values: FloatArray) -> FloatArray:
    """Return a running mean over a twentieth of the rows."""
    width = max(1, len(values) // 20)
    kernel = np.ones(width)
    weight = np.convolve(np.ones(len(values)), kernel, mode="same")
    return np.asarray(np.convolve(values, kernel, mode="same") / weight)
