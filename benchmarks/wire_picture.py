"""The picture of the benchmark `wire`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from protocol.verification import BenchmarkRow

# Okabe and Ito's colours, told apart by the colour-blind.
OURS_COLOUR, PEER_COLOUR = "#0072B2", "#9aa3ad"
TEXT_SIZE = 9.0


def draw(rows: Sequence[BenchmarkRow], path: Path) -> None:
    """Draw the median of each row as a bar with its number, one panel a payload, and write it to `path`."""
    payloads = sorted({int(row.knobs["payload_bytes"]) for row in rows})
    figure = Figure(figsize=(8.6, 2.9), layout="constrained")
    panels = figure.subplots(1, len(payloads), sharey=True, squeeze=False)[0]
    for panel, payload in zip(panels, payloads, strict=True):
        here = [row for row in rows if row.knobs["payload_bytes"] == payload]
        medians = np.array([row.figures["median us"] for row in here])
        least = np.array([row.figures["min us"] for row in here])
        places = np.arange(len(here))
        colours = [PEER_COLOUR if row.peer else OURS_COLOUR for row in here]
        panel.barh(places, medians, color=colours, height=0.66)
        panel.scatter(least, places, marker="|", s=90, color="black", linewidths=1.1, zorder=3)
        for place, row, median in zip(places, here, medians, strict=True):
            ratio = row.figures["times raw pyzmq"]
            panel.annotate(
                f"{_microseconds(median)}  ({ratio:.2g}x)", (median, place),
                xytext=(4, 0), textcoords="offset points", va="center", fontsize=TEXT_SIZE - 1,
            )  # fmt: skip
        panel.spines[["top", "right"]].set_visible(False)
        panel.set_xscale("log")
        panel.set_xlim(0.5 * least.min(), 12 * medians.max())
        panel.set_yticks(places, [str(row.knobs["lane"]) for row in here])
        panel.tick_params(axis="y", length=0, labelsize=TEXT_SIZE)
        panel.set_title(f"{_bytes(payload)} each way", loc="left", fontsize=TEXT_SIZE + 0.5, fontweight="bold")
    panels[0].invert_yaxis()
    figure.supxlabel("round trip, µs (bar: median, tick: minimum; in brackets: times raw pyzmq)", fontsize=TEXT_SIZE)
    figure.savefig(path, dpi=170)


def _microseconds(value: float) -> str:
    return f"{value:.2g} µs" if value < 10 else f"{value:,.0f} µs"


def _bytes(count: int) -> str:
    return f"{count / 1e6:.1f} MB" if count >= 1e6 else f"{count / 1e3:.0f} kB"
