"""The picture of the particle-step's time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from benchmarks.mpm_speed import size_text
from protocol.verification import BenchmarkRow

# Okabe and Ito's colours, told apart by the colour-blind; one thread in shades, light for few points.
SHADES = ("#9ecae9", "#4a98c9", "#08519c")
TWO_THREADS, BOUND = "#E69F00", "#D55E00"
BAR = 0.2
TEXT_SIZE = 8.0


def draw_speed(rows: Sequence[BenchmarkRow], bandwidth: dict[int, float], path: Path) -> None:
    """Draw a group of bars for each configuration, its target and its bound by bandwidth, and write it to `path`.

    Parameters
    ----------
    rows : sequence of BenchmarkRow
        As `measure_speed` returns them.
    bandwidth : dict of int to float
        Of memory with so many threads [bytes/s], for the caption.
    path : Path
    """
    names = list(dict.fromkeys(str(row.knobs["configuration"]) for row in rows))
    sizes = sorted({int(row.knobs["size"]) for row in rows})
    figure = Figure(figsize=(8.8, 6.4), layout="constrained")
    panel = figure.subplots()
    for group, name in enumerate(names):
        here = [row for row in rows if row.knobs["configuration"] == name]
        for k, row in enumerate(here):
            threads = int(row.knobs["threads"])
            colour = TWO_THREADS if threads > 1 else SHADES[sizes.index(int(row.knobs["size"])) % len(SHADES)]
            place = group + (k - 0.5 * (len(here) - 1)) * BAR
            median = row.figures["ns"]
            panel.barh(place, median, color=colour, height=0.92 * BAR)
            bound = row.figures["bound"]
            panel.plot([bound, bound], [place - 0.46 * BAR, place + 0.46 * BAR], color=BOUND, linewidth=2.2)
            panel.plot(row.figures["least"], place, marker="|", color="black", markersize=5.5, markeredgewidth=1.0)
            more = f"  ({row.figures['speed-up']:.2f} times as fast)" if "speed-up" in row.figures else ""
            panel.annotate(
                f"{median:.0f}{more}", (median, place), xytext=(4, 0), textcoords="offset points", va="center",
                fontsize=TEXT_SIZE, bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6, "alpha": 0.85},
            )  # fmt: skip
        target = next((row.figures["target"] for row in here if "target" in row.figures), None)
        if target is not None:
            reach = 0.5 * len(here) * BAR + 0.03
            panel.plot([target, target], [group - reach, group + reach], color="black", linewidth=1.1, linestyle="--")
    panel.set_yticks(np.arange(len(names)), [name.replace(", ", " ").replace(" (", "\n(") for name in names])
    panel.tick_params(axis="y", length=0)
    panel.invert_yaxis()
    panel.set_xlim(0, 1.25 * max(row.figures["ns"] for row in rows))
    panel.set_xlabel("time of a particle-step (ns): median, tick at the least")
    panel.grid(True, axis="x", color="#dddddd", linewidth=0.6)
    panel.set_axisbelow(True)
    panel.spines[["top", "right", "left"]].set_visible(False)
    share = float(np.median([row.figures["core share"] for row in rows if row.knobs["threads"] == 1]))
    load = float(np.median([row.figures["load"] for row in rows]))
    panel.set_title("Plane strain, doubles, 4 particles a cell", loc="left", fontsize=10, fontweight="bold")
    panel.set_title(f"one thread had {share:.0%} of a core; load {load:.1f}", loc="right", fontsize=TEXT_SIZE)
    _legend(panel, rows, sizes, bandwidth)
    figure.savefig(path, dpi=150)


def _legend(panel: object, rows: Sequence[BenchmarkRow], sizes: Sequence[int], bandwidth: dict[int, float]) -> None:
    rates = " / ".join(f"{1e-9 * rate:.1f}" for rate in bandwidth.values())
    with_two = next((row for row in rows if int(row.knobs["threads"]) > 1), None)
    entries = [
        *(
            Line2D([], [], color=shade, linewidth=6, label=f"{size_text(size)} particles")
            for size, shade in zip(sizes, SHADES, strict=False)
        ),
        *(
            [Line2D([], [], color=TWO_THREADS, linewidth=6,
                    label=f"{size_text(int(with_two.knobs['size']))} particles, {with_two.knobs['threads']} threads")]
            if with_two else []
        ),
        Line2D([], [], color="black", linewidth=1.1, linestyle="--", label="target, one idle core"),
        Line2D([], [], color=BOUND, linewidth=2.2,
               label=f"bound by memory bandwidth ({rates} GB/s, {' / '.join(map(str, bandwidth))} threads)"),
    ]  # fmt: skip
    panel.figure.legend(  # type: ignore[attr-defined]
        handles=entries, loc="outside lower center", ncols=3, frameon=False, fontsize=TEXT_SIZE
    )
