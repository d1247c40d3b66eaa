"""Plot of a failure path: macroscopic stress and subcell stresses against the driven strain."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from gmc_service.cell import Cell
from gmc_service.failure_path import COMPONENTS, FailurePath
from gmc_service.picture import COLOURS

_INK: Final = "#2b2f36"
_STYLES: Final = ("-", "--", "-.", ":")
#: Up to so many subcells of one material have a line each; more are shown by their mean and their range.
_MOST_LINES: Final = 4


def draw_failure_path(cell: Cell, path: FailurePath, component: str, file: Path, title: str = "") -> None:
    """Draw a failure path: the macroscopic stress, and for each material that of its subcells (Figs 6.7 and 6.8).

    Parameters
    ----------
    cell : Cell
    path : FailurePath
    component : str
        The driven one of `failure_path.COMPONENTS`; the stresses drawn are those of the same component.
    file : Path
        PNG.
    title : str
    """
    k = COMPONENTS.index(component)
    stress_name = f"stress {component[3:]}, MPa"
    used = [m for m in range(len(cell.materials)) if (cell.phase == m).any()]
    figure = Figure(figsize=(4.2 * (1 + len(used)), 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, 1 + len(used), squeeze=False)[0]
    percent = 100.0 * path.strain
    axes[0].plot(percent, path.stress[:, k] / 1e6, color=_INK, lw=1.8)
    axes[0].set_title("cell", fontsize=10, color=_INK)
    for event in path.events:
        axes[0].axvline(100.0 * event.strain, color="#b9b4a4", lw=0.8, zorder=0)
    for axis, material in zip(axes[1:], used, strict=True):
        colour = COLOURS[material % len(COLOURS)] if material != 1 else "#b8862f"  # the matrix' own is too pale
        subcells = np.flatnonzero(cell.phase.reshape(-1) == material)
        stresses = path.subcell_stress[:, subcells, k] / 1e6
        groups = _equal_columns(stresses)
        if len(groups) <= _MOST_LINES:
            for number, group in enumerate(groups):
                names = [f"({n // cell.columns},{n % cell.columns})" for n in subcells[group]]
                label = " ".join(names) if len(names) <= _MOST_LINES else f"{len(names)} subcells"
                style = _STYLES[number % len(_STYLES)]
                axis.plot(percent, stresses[:, group[0]], color=colour, lw=1.6, ls=style, label=label)
        else:
            axis.fill_between(percent, stresses.min(axis=1), stresses.max(axis=1), color=colour, alpha=0.3, lw=0.0,
                              label=f"range of {len(subcells)} subcells")  # fmt: skip
            areas = cell.volume_fractions()[subcells]
            axis.plot(percent, stresses @ areas / areas.sum(), color=colour, lw=1.6, label="mean")
        axis.legend(fontsize=8, frameon=False)
        axis.set_title(f"subcells of {cell.materials[material].name}", fontsize=10, color=_INK)
    for axis in axes:
        axis.axhline(0.0, color="#b9b4a4", lw=0.6, zorder=0)
        axis.set_xlabel(f"strain {component[3:]}, %")
        axis.spines[["top", "right"]].set_visible(False)
        axis.margins(x=0.0)
    axes[0].set_ylabel(stress_name)
    figure.suptitle(title, fontsize=11, color=_INK)
    figure.savefig(file, dpi=150)


def _equal_columns(values: NDArray[np.float64]) -> list[NDArray[np.int64]]:
    """Columns that are equal but for rounding, grouped, in the order of their first."""
    near = 1e-9 * max(float(np.abs(values).max()), 1e-300)
    groups: list[list[int]] = []
    for column in range(values.shape[1]):
        for group in groups:
            if np.abs(values[:, group[0]] - values[:, column]).max() <= near:
                group.append(column)
                break
        else:
            groups.append([column])
    return [np.array(group) for group in groups]
