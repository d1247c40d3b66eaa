"""Order of convergence on a manufactured solution, for every shape function and update scheme."""

from __future__ import annotations

import csv
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..conditions import symmetry
from ..grid import Grid
from ..hyperelastic import NeoHookean
from ..loads import BodyForce
from ..material_points import fill_rectangle
from ..scheme import Scheme
from ..solver import MaterialPointSolver
from .manufactured import StretchingSquare
from .plots import COLOURS, GREY, new_picture, save_picture
from .signals import observed_order

SIDE = 1.0  # m
LAW = NeoHookean(1.0e7, 0.3, 1000.0, "plane_strain")
#: Amplitudes of the displacement [m]: points that stay in their cells, and points that cross into others on fine
#: grids, where the moving quadrature sets a floor to the error.
SMALL, LARGE = 0.001, 0.02
SIZES = (8, 16, 32)
COURANT = 0.4


@dataclass(frozen=True)
class Row:
    """One run.

    Attributes
    ----------
    label : str
        Scheme.
    cells : int
        Cells along the side.
    error : float
        Root mean square error of the displacement at the end over the amplitude.
    seconds : float
        Wall time of the steps.
    """

    label: str
    cells: int
    error: float
    seconds: float


def manufactured_square(amplitude: float = LARGE) -> StretchingSquare:
    """Build the solution: its frequency is that of a bar wave that crosses the square and back."""
    rate = np.pi * np.sqrt(LAW.young / LAW.density) / SIDE
    return StretchingSquare(SIDE, amplitude, float(rate), LAW.lame, LAW.shear_modulus, LAW.density)


def run_manufactured(
    scheme: Scheme, cells: int, amplitude: float = LARGE, courant: float = COURANT
) -> tuple[float, float]:
    """Follow the manufactured motion over three quarters of a period.

    Parameters
    ----------
    scheme : Scheme
    cells : int
        Cells along the side.
    amplitude : float
        [m].
    courant : float
        Courant number, if the scheme allows it, else the largest allowed.

    Returns
    -------
    float, float
        Root mean square error of the displacement over the amplitude; wall time of the steps [s].
    """
    exact = manufactured_square(amplitude)
    cell = SIDE / cells
    body = fill_rectangle((0.0, 0.0), (SIDE, SIDE), cell)
    end = 1.5 * np.pi / exact.angular_frequency
    courant = min(courant, scheme.courant_limit)
    steps = int(np.ceil(end * LAW.pressure_wave_speed / (courant * cell)))
    solver = MaterialPointSolver(
        Grid((-3.0 * cell, -3.0 * cell), cell, (cells + 6, cells + 6)),
        body,
        LAW,
        1.0,
        end / steps,
        edge_conditions=(symmetry("left"), symmetry("right"), symmetry("bottom"), symmetry("top")),
        initial_velocity=exact.velocity(body.position, 0.0),
        loads=(BodyForce(exact.acceleration_at),),
        scheme=scheme,
    )
    started = time.perf_counter()
    solver.advance(steps)
    seconds = time.perf_counter() - started
    off = solver.points.displacement - exact.displacement(body.position, solver.time)
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1))) / amplitude), seconds


def label_of(scheme: Scheme) -> str:
    """Short name of a scheme, such as ``ugimp musl fmpm(2)``."""
    order = f"({scheme.order})" if scheme.transfer in ("fmpm", "xpic") else ""
    return f"{scheme.interpolation} {scheme.integration} {scheme.transfer}{order}"


def convergence_table(schemes: Sequence[Scheme], amplitude: float = LARGE, sizes: Sequence[int] = SIZES) -> list[Row]:
    """Run every scheme at every size."""
    rows = []
    for scheme in schemes:
        run_manufactured(scheme, 4, amplitude)  # compiles what is not compiled yet
        for cells in sizes:
            error, seconds = run_manufactured(scheme, cells, amplitude)
            rows.append(Row(label_of(scheme), cells, error, seconds))
    return rows


def order_of(rows: Sequence[Row], label: str) -> float:
    """Observed order of one scheme over all its sizes."""
    own = [row for row in rows if row.label == label]
    return observed_order(np.array([1.0 / row.cells for row in own]), np.array([row.error for row in own]))


def write_table(rows: Sequence[Row], path: Path) -> Path:
    """Write all rows as comma-separated values."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(("scheme", "cells", "rms_error_over_amplitude", "seconds"))
        table.writerows((row.label, row.cells, f"{row.error:.6e}", f"{row.seconds:.4f}") for row in rows)
    return path


def draw_convergence(small: Sequence[Row], large: Sequence[Row], path: Path) -> Path:
    """Draw error against cell size and against seconds; colour is the shape function, line the update scheme."""
    picture, (by_size, crossing, by_time) = new_picture(1, 3, width=15.0, height=5.0)
    labels = list(dict.fromkeys(row.label for row in large))
    shapes = list(dict.fromkeys(label.split()[0] for label in labels))
    updates = list(dict.fromkeys(label.split(" ", 1)[1] for label in labels))
    styles = ("-", "--", "-.", ":", (0, (1, 3)), (0, (5, 1, 1, 1, 1, 1)))
    for panel, rows in ((by_size, small), (crossing, large), (by_time, large)):
        for label in labels:
            own = [row for row in rows if row.label == label]
            panel.loglog(
                [row.seconds if panel is by_time else SIDE / row.cells for row in own],
                [row.error for row in own],
                color=COLOURS[shapes.index(label.split()[0])],
                linestyle=styles[updates.index(label.split(" ", 1)[1]) % len(styles)],
                marker="o",
                markersize=3.0,
                linewidth=1.2,
                label=label if panel is crossing else None,
            )
    sizes = SIDE / np.array(sorted({row.cells for row in large}))
    for panel, rows in ((by_size, small), (crossing, large)):
        first = max(row.error for row in rows if row.cells == min(r.cells for r in rows))
        panel.loglog(sizes, first * (sizes / sizes[0]) ** 2, color=GREY, linewidth=3.0, alpha=0.4, zorder=0)
        panel.annotate("order 2", (sizes[-1], first * (sizes[-1] / sizes[0]) ** 2), color=GREY, fontsize=8)
        panel.set_xlabel("cell size over side of the square")
        panel.set_xticks(sizes, [f"1/{round(SIDE / size)}" for size in sizes], minor=False)
        panel.set_xticks([], minor=True)
    by_size.set_ylabel("rms error of displacement over amplitude")
    by_size.set_title("points stay in their cells")
    crossing.set_title("points cross cells")
    by_time.set_title("the same against time")
    by_time.set_xlabel("wall time of the run (s)")
    picture.suptitle("Manufactured neo-Hookean square")
    picture.legend(loc="outside right upper", frameon=False, fontsize=8)
    return save_picture(picture, path)
