"""Picture of benchmark `coupling`: error against seconds, one line for each knob."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from benchmarks.coupling_runs import Study
from protocol.verification import BenchmarkRow

# Okabe and Ito's colours, told apart by the colour-blind.
_COLOURS: Final = {
    "m": "#0072B2", "width": "#E69F00", "weight": "#009E73", "stiffness": "#CC79A7", "size": "#56B4E9",
}  # fmt: skip
_NAMES: Final = {
    "m": "M, steps of an exchange",
    "width": "width of the handshake (Å)",
    "weight": "weight, constant",
    "stiffness": "stiffness of an anchor (N/m)",
    "size": "size of the sample (Å)",
}
_SEED: Final = "#D55E00"


def draw(study: Study, rows: Sequence[BenchmarkRow], path: Path) -> None:
    """Draw the rows of a study and write the picture to `path`."""
    figure = Figure(figsize=(9.2, 5.2), layout="constrained")
    panel = figure.subplots()
    done = [row for row in rows if row.error is not None]
    middle = next(row for row in done if not _turned(row))
    for knob, colour in _COLOURS.items():
        own = [row for row in done if _turned(row) == knob]
        line = [*own, middle] if knob in ("m", "width", "size") else own
        line = sorted(line, key=lambda row: float(row.knobs[knob]))
        panel.plot([row.seconds for row in line], [_percent(row) for row in line], "o-", color=colour, markersize=4.5,
                   linewidth=1.2, label=_NAMES[knob])  # fmt: skip
        for row in own:
            panel.annotate(f" {row.knobs[knob]:g}", (row.seconds, _percent(row)), fontsize=7.5, color=colour)
    for row in done:
        if row.knobs["preset"] == "seed":
            panel.plot([row.seconds], [_percent(row)], "*", color=_SEED, markersize=13, label="preset seed")
    panel.plot([middle.seconds], [_percent(middle)], "o", markersize=11, markerfacecolor="none", color="black",
               label="middle of all knobs, by theory")  # fmt: skip
    best = sorted((row for row in done if row.figures.get("front")), key=lambda row: row.seconds)
    panel.step([row.seconds for row in best], [_percent(row) for row in best], where="post", color="#333333",
               alpha=0.2, linewidth=9, zorder=0, label="front: none is faster and better")  # fmt: skip
    peer = next(row for row in rows if row.peer)
    panel.axvline(peer.seconds, color="#777777", linestyle=":", linewidth=1.2, label="full atomistic run")
    refused = [row.label.split(": ")[1] for row in rows if "refused" in row.label]
    title = f"{study.problem.name}: {study.measure}"
    panel.set_title("\n".join([title, *refused]), loc="left", fontsize=9.5)
    panel.set(xscale="log", yscale="log", xlabel="wall time of the loop for 1 ps (s)", ylabel="error (%)")
    for axis in (panel.xaxis, panel.yaxis):
        axis.set_minor_locator(LogLocator(subs=(2.0, 5.0)))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter("{x:g}")
    panel.grid(True, which="both", color="#eeeeee", linewidth=0.6)
    panel.set_axisbelow(True)
    panel.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside right upper", frameon=False, fontsize=8)
    figure.savefig(path, dpi=150)


def _percent(row: BenchmarkRow) -> float:
    # A load is known to the exchange; a logarithm needs more than nothing.
    return max(100.0 * (row.error or 0.0), 0.01)


def _turned(row: BenchmarkRow) -> str:
    """Return the knob that is turned; empty for the middle."""
    words = row.label.split(": ")[1].split(" ")[0]
    return words if words in _COLOURS else ("" if words == "middle" else words)
