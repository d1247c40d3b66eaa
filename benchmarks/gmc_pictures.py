"""Pictures of benchmark `gmc`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from benchmarks.gmc_methods import MODULI
from protocol.verification import BenchmarkRow

# Okabe and Ito's colours, told apart by the colour-blind.
_STYLES: Final = {
    "GMC": ("#0072B2", "o"),
    "GMC, many at once": ("#56B4E9", "o"),
    "Mori-Tanaka": ("#E69F00", "s"),
    "high fidelity, 2x2": ("#009E73", "^"),
    "high fidelity, 7x7": ("#009E73", "v"),
    "high fidelity, 26x26": ("#009E73", "D"),
    "elements along a round fibre": ("#CC79A7", "P"),
    "HomoComPy, Mori-Tanaka": ("#666666", "s"),
    "HomoComPy, Chamis": ("#666666", "X"),
    "scikit-fem": ("#666666", "D"),
}
_FRONT: Final = "#333333"
_COLOURS: Final = {"GMC": "#0072B2", "Mori-Tanaka": "#E69F00", "high fidelity": "#009E73"}
_LINES: Final = {" 2x2": ":", " 7x7": "--", " 26x26": "-"}


def draw_cost(rows: Sequence[BenchmarkRow], title: str, path: Path) -> None:
    """Draw the error of each modulus against seconds, with the front, and write the picture to `path`.

    Parameters
    ----------
    rows : sequence of BenchmarkRow
        As `gmc_methods.measure` returns them.
    title : str
    path : Path
    """
    figure = Figure(figsize=(12.0, 4.6), layout="constrained")
    panels = figure.subplots(1, len(MODULI), sharey=True)
    families = list(dict.fromkeys(str(row.knobs["family"]) for row in rows))
    for name, panel in zip(MODULI, panels, strict=True):
        for family in families:
            colour, marker = _STYLES[family]
            own = [row for row in rows if row.knobs["family"] == family]
            at = [row.seconds for row in own], [100.0 * abs(row.figures[name]) for row in own]
            panel.loglog(*at, color=colour, marker=marker, linewidth=0.9, markersize=5, label=family,
                         markerfacecolor="none" if own[0].peer else colour)  # fmt: skip
            for row, x, y in zip(own, *at, strict=True):
                panel.annotate(_mark(row), (x, y), xytext=(4, 3), textcoords="offset points", fontsize=6.5)
        best = sorted((row for row in rows if row.figures[f"front_{name}"]), key=lambda row: row.seconds)
        corners = [row.seconds for row in best], [100.0 * abs(row.figures[name]) for row in best]
        panel.step(*corners, where="post", color=_FRONT, alpha=0.18, linewidth=8, zorder=0,
                   label="front: none is faster and better")  # fmt: skip
        panel.set_title(name, loc="left", fontsize=10)
        panel.set_xlabel("seconds of a processor for one cell")
        panel.grid(True, which="major", color="#dddddd", linewidth=0.6)
        panel.set_axisbelow(True)
        panel.spines[["top", "right"]].set_visible(False)
    panels[0].set_ylabel("error, %")
    panels[0].yaxis.set_major_formatter("{x:g}")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right upper", frameon=False, fontsize=8,
                  title="numbers: subcells along a side of the cell,\nof elements the refinement",
                  title_fontsize=8, alignment="left")  # fmt: skip
    figure.suptitle(title, x=0.01, ha="left", fontsize=10)
    figure.savefig(path, dpi=150)


def _mark(row: BenchmarkRow) -> str:
    name = "refinement" if str(row.knobs["family"]).startswith(("high", "elements")) else "subcells"
    return str(row.knobs.get(name, ""))


def draw_fractions(
    fractions: NDArray[np.float64],
    errors: dict[str, NDArray[np.float64]],
    own_errors: dict[str, NDArray[np.float64]],
    title: str,
    path: Path,
) -> None:
    """Draw the signed error of each modulus against the fibre fraction, and write the picture to `path`.

    Parameters
    ----------
    fractions : ndarray, shape (fractions,)
    errors : dict of str to ndarray, shape (fractions, 3)
        By method, against round fibres: upper row.
    own_errors : dict of str to ndarray, shape (fractions, 3)
        By method, against finite elements on the same cell: lower row.
    title : str
    path : Path
    """
    figure = Figure(figsize=(12.0, 7.0), layout="constrained")
    panels = figure.subplots(2, len(MODULI), sharex=True, sharey="row")
    for row, family in zip(panels, (errors, own_errors), strict=True):
        for k, (name, panel) in enumerate(zip(MODULI, row, strict=True)):
            for label, values in family.items():
                colour = next(colour for begin, colour in _COLOURS.items() if label.startswith(begin))
                line = next((line for end, line in _LINES.items() if label.endswith(end)), "-")
                panel.plot(fractions, 100.0 * values[:, k], color=colour, linestyle=line, linewidth=1.6, label=label)
            panel.axhline(0.0, color="#333333", linewidth=0.8)
            panel.set_title(name, loc="left", fontsize=10)
            panel.grid(True, color="#dddddd", linewidth=0.6)
            panel.set_axisbelow(True)
            panel.spines[["top", "right"]].set_visible(False)
    for panel in panels[1]:
        panel.set_xlabel("fibre fraction")
    panels[0, 0].set_ylabel("error against round fibres, %")
    panels[1, 0].set_ylabel("error against finite elements\non the same cell, %")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right upper", frameon=False, fontsize=8)
    figure.suptitle(title, x=0.01, ha="left", fontsize=10)
    figure.savefig(path, dpi=150)
