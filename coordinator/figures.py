"""One style for all figures of a report, and how a figure gets into a page."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from html import escape
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

# Okabe and Ito's set, told apart by the colour-blind.
BLUE, ORANGE, GREEN, RED, PURPLE, SKY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9"
INK, PALE = "#20262e", "#8a94a0"

STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 9.0,
    "axes.edgecolor": PALE,
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e6e9ed",
    "grid.linewidth": 0.7,
    "lines.linewidth": 1.5,
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "savefig.dpi": 170,
    "svg.fonttype": "path",
    "svg.hashsalt": "scalebridge",
    "path.simplify": True,
}
#: Width of every figure, inches: the page shows two beside each other, or one on a phone.
WIDTH = 5.2


@dataclass(frozen=True)
class Picture:
    """A figure ready for a page.

    Parameters
    ----------
    title : str
    caption : str
        What is seen and what to look for.
    data : bytes
    kind : str
        ``png`` or ``svg+xml``.
    """

    title: str
    caption: str
    data: bytes
    kind: str

    def html(self) -> str:
        """Return the figure as an HTML element that needs no other file."""
        source = f"data:image/{self.kind};base64,{base64.b64encode(self.data).decode('ascii')}"
        return (
            f'<figure><h3>{escape(self.title)}</h3><img src="{source}" alt="{escape(self.title)}">'
            f"<figcaption>{escape(self.caption)}</figcaption></figure>"
        )


@contextmanager
def style() -> Iterator[None]:
    """Apply the style within a block."""
    with matplotlib.rc_context(STYLE):
        yield


def picture(figure: Figure, title: str, caption: str, raster: bool = False) -> Picture:
    """Render a figure: lines as SVG, fields of many points as PNG.

    Figures are made without pyplot, so no window system is touched and nothing stays open.
    """
    buffer = io.BytesIO()
    if raster:
        figure.savefig(buffer, format="png")
    else:
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    return Picture(title, caption, buffer.getvalue(), "png" if raster else "svg+xml")


#: Least ratio of the sides of a map.
_LEAST_ASPECT = 0.05


def panels(count: int, height: float) -> tuple[Figure, list[Axes]]:
    """Return a figure with `count` panels below each other that share the x axis."""
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    axes = figure.subplots(count, 1, sharex=True, squeeze=False)
    return figure, list(axes[:, 0])


def _widened(span: tuple[float, float], other: tuple[float, float]) -> tuple[float, float]:
    """Return a span of at least a part of the other: a row of atoms has no height."""
    lack = 0.5 * max(0.0, _LEAST_ASPECT * (other[1] - other[0]) - (span[1] - span[0]))
    return span[0] - lack, span[1] + lack


def map_axes(
    x: tuple[float, float], y: tuple[float, float], bar: bool, unit: str = "Å"
) -> tuple[Figure, Axes, Axes | None, float]:
    """Return axes of equal scale that just hold a region in `unit`, room for a colour bar, and the scale.

    Returns
    -------
    figure, axes, bar axes or None
    scale : float
        Points of print (1/72 inch) a unit, for the size of markers.
    """
    left, right, bottom, top = 0.74, 0.88 if bar else 0.1, 0.42, 0.1
    x, y = _widened(x, y), _widened(y, x)
    width = WIDTH - left - right
    height = width * (y[1] - y[0]) / (x[1] - x[0])
    if height > 1.25 * width:  # a tall body is drawn narrower, not longer than a screen
        width, height = width * 1.25 * width / height, 1.25 * width
    total = height + bottom + top
    figure = Figure(figsize=(WIDTH, total))
    axes = figure.add_axes((left / WIDTH, bottom / total, width / WIDTH, height / total))
    axes.set(xlim=x, ylim=y, xlabel=f"x ({unit})", ylabel=f"y ({unit})")
    axes.grid(False)
    axes.spines[["top", "right"]].set_visible(True)
    side = None
    if bar:
        side = figure.add_axes(((left + width + 0.08) / WIDTH, bottom / total, 0.12 / WIDTH, height / total))
    return figure, axes, side, 72.0 * width / (x[1] - x[0])
