"""Look of the pictures that go with the verification cases."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

#: Colours that stay apart for colour-blind readers and in grey print.
BLUE, ORANGE, GREEN, RED, PURPLE, GREY = "#0072b2", "#e69f00", "#009e73", "#d55e00", "#cc79a7", "#666666"
COLOURS = (BLUE, ORANGE, GREEN, RED, PURPLE, GREY)


def new_picture(rows: int = 1, columns: int = 1, *, width: float = 7.0, height: float = 4.3) -> tuple[Figure, Any]:
    """Start a picture of so many panels; returns it and its axes as ``pyplot.subplots`` does.

    Drawn without pyplot, so nothing is kept and no display is asked for.
    """
    picture = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(picture)
    axes = picture.subplots(rows, columns, squeeze=False)
    for panel in axes.ravel():
        panel.grid(True, color="#dddddd", linewidth=0.6)
        panel.set_axisbelow(True)
        panel.spines[["top", "right"]].set_visible(False)
    return picture, axes[0, 0] if rows * columns == 1 else axes.ravel()


def save_picture(picture: Figure, path: Path) -> Path:
    """Write the picture as PNG and return its path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    picture.savefig(path, dpi=130)
    return path
