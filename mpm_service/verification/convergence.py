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
#: Amplitude of the displacement [m]; points cross cells on fine grids.
AMPLITUDE = 0.02
SIZES = (8, 16, 32, 64)
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


def manufactured_square(amplitude: float = AMPLITUDE) -> StretchingSquare:
    """Build the solution: its frequency is that of a bar wave that crosses the square and back."""
    rate = np.pi * np.sqrt(LAW.young / LAW.density) / SIDE
    return StretchingSquare(SIDE, amplitude, float(rate), LAW.lame, LAW.shear_modulus, LAW.density)


def run_manufactured(
    scheme: Scheme, cells: int, amplitude: float = AMPLITUDE, courant: float = COURANT
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
        Courant number.

    Returns
    -------
    float, float
        Root mean square error of the displacement over the amplitude; wall time of the steps [s].
    """
    exact = manufactured_square(amplitude)
    cell = SIDE / cells
    body = fill_rectangle((0.0, 0.0), (SIDE, SIDE), cell)
    end = 1.5 * np.pi / exact.angular_frequency
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


def convergence_table(schemes: Sequence[Scheme], sizes: Sequence[int] = SIZES) -> list[Row]:
    """Run every scheme at every size; a run that leaves the physical range has error NaN."""
    rows = []
    for scheme in schemes:
        run_manufactured(scheme, 4)  # compiles what is not compiled yet
        for cells in sizes:
            error, seconds = run_manufactured(scheme, cells)
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


def draw_convergence(rows: Sequence[Row], path: Path) -> Path:
    """Draw error against cell size and against seconds; colour is the shape function, line the update scheme."""
    picture, (by_size, by_time) = new_picture(1, 2, width=11.5, height=5.0)
    labels = list(dict.fromkeys(row.label for row in rows))
    shapes = list(dict.fromkeys(label.split()[0] for label in labels))
    styles = ("-", "--", "-.", ":", (0, (1, 3)))
    updates = list(dict.fromkeys(label.split(" ", 1)[1] for label in labels))
    for label in labels:
        own = [row for row in rows if row.label == label]
        look = {
            "color": COLOURS[shapes.index(label.split()[0])],
            "linestyle": styles[updates.index(label.split(" ", 1)[1]) % len(styles)],
            "marker": "o",
            "markersize": 3.0,
            "linewidth": 1.2,
        }
        error = [row.error for row in own]
        by_size.loglog([SIDE / row.cells for row in own], error, label=label, **look)
        by_time.loglog([row.seconds for row in own], error, **look)
    sizes = np.array(sorted({SIDE / row.cells for row in rows}))
    worst = max(row.error for row in rows if np.isfinite(row.error))
    by_size.loglog(sizes, 0.8 * worst * (sizes / sizes[-1]) ** 2, color=GREY, linewidth=2.5, alpha=0.5, label="order 2")
    by_size.set_xlabel("cell size over side of the square")
    by_size.set_ylabel("rms error of displacement over amplitude")
    by_size.set_title("Manufactured neo-Hookean square")
    by_time.set_xlabel("wall time of the run (s)")
    by_time.set_title("Error against time")
    picture.legend(loc="outside right upper", frameon=False, fontsize=8)
    return save_picture(picture, path)
