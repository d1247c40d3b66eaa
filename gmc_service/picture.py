"""Pictures of repeating unit cells: phases in colours, or a field with one value per subcell."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PatchCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle
from numpy.typing import NDArray

from gmc_service.cell import Cell

#: Of phases that have these names.
NAMED: Final = {"fibre": "#4a5a70", "matrix": "#f0e2b6", "void": "#ffffff"}
#: Of others, in the order of the materials; those that are taken already are left out.
COLOURS: Final = ("#4a5a70", "#f0e2b6", "#c96f4a", "#6f9e86", "#a98bb8", "#d8b04a", "#7fa8d0", "#b06a7a")
_INK: Final = "#2b2f36"
_LINE: Final = "#b9b4a4"
_SIDE: Final = 5.2  # inches, of the longer side of the cell
_LABELLED: Final = 8  # rows and columns up to which subcells carry their indices
_LENGTHS: Final = ((1e-9, "nm"), (1e-6, "um"), (1e-3, "mm"), (1.0, "m"))


def draw_cell(
    cell: Cell,
    path: Path,
    title: str = "",
    field: NDArray[np.float64] | None = None,
    field_label: str = "",
) -> None:
    """Draw a cell into a PNG file.

    Axis 3 points to the right, axis 2 up; row 0 is the lowest. Without a field each subcell has the colour of its
    phase, and a legend gives the fractions; with one it has the colour of its value beside a colour bar, and lines
    stand between phases.

    Parameters
    ----------
    cell : Cell
    path : Path
        File to write; its suffix must be ``.png``.
    title : str
        Line above the picture.
    field : ndarray of float, shape (subcells,), optional
        One value per subcell in the order of the flat index.
    field_label : str
        What the field is, with its unit.

    Raises
    ------
    ValueError
        If the suffix is another one, or the field has another shape or holds a number that is not finite.
    """
    if path.suffix != ".png":
        raise ValueError(f"picture is {str(path)!r}; its suffix must be .png")
    if field is not None and field.shape != (cell.subcells,):
        raise ValueError(f"field has shape {field.shape}; it must have {(cell.subcells,)}")
    if field is not None and not np.isfinite(field).all():
        raise ValueError("field holds a number that is not finite; it must be finite everywhere")
    height, width = float(cell.heights.sum()), float(cell.widths.sum())
    size, unit = _unit(max(height, width))
    inches = _SIDE * np.array([width, height]) / max(height, width)
    inches = np.maximum(inches, 1.2)
    beside = 2.4 if field is None else 1.5
    figure = Figure(figsize=(inches[0] + beside + 0.9, inches[1] + 1.35), dpi=160, facecolor="white")
    FigureCanvasAgg(figure)
    page = figure.get_size_inches()
    axes = figure.add_axes((0.8 / page[0], 0.65 / page[1], inches[0] / page[0], inches[1] / page[1]))
    _draw_subcells(axes, cell, size, field)
    if field is None:
        _draw_legend(axes, cell, inches)
    else:
        bar = figure.add_axes(((0.95 + inches[0]) / page[0], 0.65 / page[1], 0.18 / page[0], inches[1] / page[1]))
        figure.colorbar(axes.collections[0], cax=bar).set_label(field_label, color=_INK)
    axes.set(xlim=(0.0, width / size), ylim=(0.0, height / size))
    axes.set_xlabel(f"axis 3 ({unit})", color=_INK)
    axes.set_ylabel(f"axis 2 ({unit})", color=_INK)
    if title:
        axes.set_title(title, loc="left", color=_INK, fontsize=11)
    figure.savefig(path)


def _draw_subcells(axes: Axes, cell: Cell, size: float, field: NDArray[np.float64] | None) -> None:
    tops, rights = np.cumsum(cell.heights) / size, np.cumsum(cell.widths) / size
    bottoms, lefts = tops - cell.heights / size, rights - cell.widths / size
    boxes = [
        Rectangle((lefts[column], bottoms[row]), rights[column] - lefts[column], tops[row] - bottoms[row])
        for row in range(cell.rows)
        for column in range(cell.columns)
    ]
    most = max(cell.rows, cell.columns)
    colours = _colours(cell)
    if field is None:
        facecolors = [colours[phase] for phase in cell.phase.reshape(-1)]
        axes.add_collection(
            PatchCollection(boxes, facecolors=facecolors, edgecolors=_LINE, linewidths=4.0 / (most + 3.0))
        )
    else:
        drawn = PatchCollection(boxes, cmap="viridis", edgecolors="face", linewidths=0.2)
        drawn.set_array(field)
        low, high = float(field.min()), float(field.max())
        margin = 0.0 if high > low else max(abs(high), 1.0) * 1e-3
        drawn.set_clim(low - margin, high + margin)
        axes.add_collection(drawn)
        _draw_borders(axes, cell, np.append(0.0, tops), np.append(0.0, rights))
    if most <= _LABELLED and field is None:
        for row in range(cell.rows):
            for column in range(cell.columns):
                box = min(cell.heights[row], cell.widths[column]) / max(cell.heights.sum(), cell.widths.sum())
                if box > 0.07:
                    dark = sum(colours[cell.phase[row, column]]) < 1.5
                    axes.text(
                        0.5 * (lefts[column] + rights[column]), 0.5 * (bottoms[row] + tops[row]),
                        f"{row}, {column}", ha="center", va="center", fontsize=8, color="white" if dark else _INK,
                    )  # fmt: skip


def _draw_borders(axes: Axes, cell: Cell, across: NDArray[np.float64], along: NDArray[np.float64]) -> None:
    """Lines between subcells of different phases."""
    phase = cell.phase
    for row, column in np.argwhere(phase[1:] != phase[:-1]):
        axes.plot(along[column : column + 2], [across[row + 1]] * 2, color="white", lw=1.0)
    for row, column in np.argwhere(phase[:, 1:] != phase[:, :-1]):
        axes.plot([along[column + 1]] * 2, across[row : row + 2], color="white", lw=1.0)


def _draw_legend(axes: Axes, cell: Cell, inches: NDArray[np.float64]) -> None:
    fractions, colours = cell.phase_fractions(), _colours(cell)
    entries = [
        Patch(facecolor=colours[phase], edgecolor=_INK, lw=0.5, label=f"{material.name}\n{_percent(fractions[phase])}")
        for phase, material in enumerate(cell.materials)
    ]
    title = f"{cell.rows} x {cell.columns} subcells"
    axes.legend(
        handles=entries, title=title, loc="upper left", bbox_to_anchor=(1.0 + 0.2 / inches[0], 1.0),
        borderaxespad=0.0, frameon=False, labelspacing=0.9, alignment="left",
    )  # fmt: skip


def _percent(fraction: float) -> str:
    return f"{100.0 * fraction:.4g} %"


def _colours(cell: Cell) -> list[tuple[float, float, float]]:
    """One for each material."""
    names = [material.name for material in cell.materials]
    taken = {NAMED[name] for name in names if name in NAMED}
    free = cycle(colour for colour in COLOURS if colour not in taken)
    return [to_rgb(NAMED[name] if name in NAMED else next(free)) for name in names]


def _unit(length: float) -> tuple[float, str]:
    fitting: Sequence[tuple[float, str]] = [unit for unit in _LENGTHS if length >= unit[0]]
    return fitting[-1] if fitting else _LENGTHS[0]
