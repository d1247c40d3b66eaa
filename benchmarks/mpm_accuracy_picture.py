"""Pictures of error against seconds."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from benchmarks.mpm_accuracy import DEFAULT, Study, scheme_text
from protocol.verification import BenchmarkRow

# Okabe and Ito's colours, told apart by the colour-blind: one for each shape function.
SHAPE_COLOURS = {"linear": "#E69F00", "ugimp": "#0072B2", "cpgimp": "#009E73", "bspline": "#CC79A7"}
UPDATE_MARKERS = {"musl": "o", "usl": "v", "usf": "^", "usavg": "s"}
FRONT = "#333333"


def _errors(rows: Sequence[BenchmarkRow]) -> list[float]:
    return [float("nan") if row.error is None else row.error for row in rows]


def transfer_line(transfer: str, order: int) -> str | tuple[int, tuple[int, ...]]:
    """Return the line style that stands for a transfer."""
    if transfer == "fmpm":
        return "-" if order == 2 else (0, (6, 1, 1, 1))
    return {"flip": "--", "xpic": "-.", "pic": ":"}[transfer]


def draw_accuracy(study: Study, rows: Sequence[BenchmarkRow], path: Path) -> None:
    """Draw error against seconds for every scheme of a study, the best front and the default, and write it to `path`.

    Parameters
    ----------
    study : Study
    rows : sequence of BenchmarkRow
        As `measure_accuracy` returns them.
    path : Path
    """
    figure = Figure(figsize=(9.2, 5.2), layout="constrained")
    panel = figure.subplots()
    for name in dict.fromkeys(str(row.knobs["scheme"]) for row in rows):
        own = [row for row in rows if row.knobs["scheme"] == name]
        knobs = own[0].knobs
        panel.plot(
            [row.seconds for row in own],
            _errors(own),
            color=SHAPE_COLOURS[str(knobs["interpolation"])],
            marker=UPDATE_MARKERS[str(knobs["integration"])],
            linestyle=transfer_line(str(knobs["transfer"]), int(knobs["order"])),
            linewidth=1.3,
            markersize=4.5,
            label=name,
        )
    best = sorted((row for row in rows if row.figures["front"]), key=lambda row: row.seconds)
    panel.step(
        [row.seconds for row in best], _errors(best), where="post", color=FRONT, alpha=0.22, linewidth=9,
        solid_capstyle="round", solid_joinstyle="round", zorder=0, label="front: none is faster and better",
    )  # fmt: skip
    default = [row for row in rows if row.knobs["scheme"] == scheme_text(DEFAULT)]
    panel.plot(
        [row.seconds for row in default], _errors(default), linestyle="none", marker="o", markersize=11,
        markerfacecolor="none", markeredgecolor="black", markeredgewidth=1.2, label="default",
    )  # fmt: skip
    for row in default:
        panel.annotate(
            f"{row.knobs['cells']}", (row.seconds, row.error or 0.0), xytext=(0, -15), textcoords="offset points",
            ha="center", fontsize=7.5,
        )  # fmt: skip
    panel.set_xscale("log")
    panel.set_yscale("log")
    panel.xaxis.set_major_formatter("{x:g}")
    panel.xaxis.set_minor_locator(LogLocator(subs=(2.0, 5.0)))
    panel.xaxis.set_minor_formatter("{x:g}")
    panel.set_xlabel("wall time of the steps (s), one thread")
    panel.set_ylabel(study.measure)
    panel.set_title(f"{study.title}\nnumbers: {study.resolution}", loc="left", fontsize=10)
    panel.grid(True, which="major", color="#dddddd", linewidth=0.6)
    panel.set_axisbelow(True)
    panel.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside right upper", frameon=False, fontsize=8)
    figure.savefig(path, dpi=150)
