"""Pictures of benchmark `md`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.figure import Figure

from protocol.verification import BenchmarkRow

# Okabe and Ito's colours, told apart by the colour-blind.
_COLOURS: Final = {"LAMMPS": "#999999", "LAMMPS with anchors": "#56B4E9", "service": "#0072B2"}
_KNOBS: Final = {"M": "window M", "time_step_fs": "time step (15 fs windows)", "stiffness": "stiffness of the anchors"}
_KNOB_COLOURS: Final = {"M": "#0072B2", "time_step_fs": "#E69F00", "stiffness": "#009E73"}
_UNITS: Final = {"M": "", "time_step_fs": " fs", "stiffness": " N/m"}


def draw_cost(rows: Sequence[BenchmarkRow], path: Path) -> None:
    """Bars of the time of a step over that of bare LAMMPS without anchors, and write the picture to `path`.

    Parameters
    ----------
    rows : sequence of BenchmarkRow
        As `md_cost.service_rows` returns them; others are left out.
    path : Path
    """
    rows = [row for row in rows if row.label in _COLOURS]
    groups = list(dict.fromkeys(tuple(row.knobs.values()) for row in rows))
    figure = Figure(figsize=(9.2, 4.4), layout="constrained")
    panel = figure.subplots()
    for shift, (label, colour) in enumerate(_COLOURS.items()):
        own = {tuple(row.knobs.values()): row for row in rows if row.label == label}
        height = [own[group].figures.get("over_free", 1.0) for group in groups]
        bars = panel.bar(np.arange(len(groups)) + 0.27 * (shift - 1), height, 0.25, color=colour, label=label)
        texts = [f"{1e3 * own[group].seconds:.3g}" for group in groups]
        panel.bar_label(bars, texts, fontsize=7, rotation=90, padding=3)
    names = [f"{name}\nM = {window}\n{ranks} rank{'' if ranks == 1 else 's'}" for name, window, ranks in groups]
    panel.set_xticks(np.arange(len(groups)), names, fontsize=8)
    panel.set_ylim(0.0, panel.get_ylim()[1] * 1.15)
    panel.axhline(1.0, color="#333333", linewidth=0.6)
    panel.set_ylabel("time of a step over bare LAMMPS")
    panel.set_title("Cost of anchors and of the service (numbers on the bars: ms a step)", fontsize=10)
    panel.legend(frameon=False, fontsize=8, ncols=3, loc="upper left")
    panel.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=130)


def draw_error(rows: Sequence[BenchmarkRow], path: Path) -> None:
    """Error of the mean reaction against seconds, one line for each knob through the middle configuration.

    Parameters
    ----------
    rows : sequence of BenchmarkRow
        As `md_reaction.reaction_rows` returns them, the middle configuration first.
    path : Path
    """
    middle = rows[0]
    figure = Figure(figsize=(9.2, 4.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    for knob, colour in _KNOB_COLOURS.items():
        others = [row for row in rows[1:] if _turned(row, middle) == knob]
        own = sorted([middle, *others], key=lambda row: float(row.knobs[knob]))
        error = [100.0 * (row.error or 0.0) for row in own]
        left.loglog([row.seconds for row in own], error, "o-", color=colour, markersize=4, label=_KNOBS[knob])
        deviation = [row.figures["window_deviation"] for row in own]
        right.loglog([float(row.knobs[knob]) for row in own], deviation, "o-", color=colour, markersize=4)
        for row, height in zip(own, error, strict=True):
            if row is not middle:
                text = f" {row.knobs[knob]:g}{_UNITS[knob]}"
                left.annotate(text, (row.seconds, height), fontsize=7, color=colour)
    left.set_xlabel("seconds for 3 ps")
    left.set_ylabel("standard error of the mean pull, %")
    left.legend(frameon=False, fontsize=8)
    right.set_xlabel("M, fs or N/m")
    right.set_ylabel("deviation of one window over the pull")
    for panel in (left, right):
        panel.spines[["top", "right"]].set_visible(False)
        panel.grid(True, which="both", color="#eeeeee", linewidth=0.6)
    figure.savefig(path, dpi=130)


def _turned(row: BenchmarkRow, middle: BenchmarkRow) -> str:
    """Name of the knob that differs from the middle; the time step counts where the window follows it."""
    for knob in ("time_step_fs", "stiffness", "M"):
        if row.knobs[knob] != middle.knobs[knob]:
            return knob
    return ""
