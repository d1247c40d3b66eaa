"""Error of the material point solver against the time it takes, over cell size, shape function and update."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mpm_service import MaterialPointSolver, Scheme, SolverError
from mpm_service.verification import bar_wave, beam, edge_crack
from mpm_service.verification.beam_theory import elastic_deflection
from protocol.verification import BenchmarkRow

DEFAULT = Scheme()
#: Share of the bar that the front has travelled when it is read.
TRAVELLED = 0.75
#: Times at which the beam's deflection is read in the one period of the force that is followed.
BEAM_SAMPLES = 200
#: Runs shorter than this are repeated, and the median counts [s].
SHORT = 0.5
REPEATS = 3


@dataclass
class Clock:
    """Wall time of the steps, without building the solver or reading it [s]."""

    seconds: float = 0.0

    def advance(self, solver: MaterialPointSolver, steps: int) -> None:
        """Let the solver make steps and add the time they take."""
        began = time.perf_counter()
        solver.advance(steps)
        self.seconds += time.perf_counter() - began


def bar_error(scheme: Scheme, cells: int, clock: Clock) -> float:
    """Step of stress along a bar: mean error of the stress over the length travelled.

    Parameters
    ----------
    scheme : Scheme
    cells : int
        Cells along the bar.
    clock : Clock

    Returns
    -------
    float
        Integral of |stress - exact| along the bar over traction times length travelled; overshoot, width and place
        of the front all count.
    """
    solver = bar_wave.make_bar(scheme, min(bar_wave.COURANT, scheme.courant_limit), cells)
    travel = TRAVELLED * bar_wave.LENGTH
    clock.advance(solver, round(travel / bar_wave.wave_speed() / solver.time_step))
    cell = bar_wave.LENGTH / cells
    column = (solver.points.reference_position[:, 0] // cell).astype(np.int64)
    stress = np.bincount(column, weights=solver.points.stress[:, 0]) / np.bincount(column) / bar_wave.TRACTION
    front = bar_wave.wave_speed() * solver.time
    exact = np.clip(front / cell - np.arange(cells), 0.0, 1.0)  # mean over each cell
    return float(np.abs(stress - exact).sum() * cell / front)


def beam_error(scheme: Scheme, cells: int, clock: Clock) -> float:
    """Simply supported beam under a harmonic force, over one period of the force.

    Parameters
    ----------
    scheme : Scheme
    cells : int
        Cells through the height, an even number.
    clock : Clock

    Returns
    -------
    float
        Largest error of the deflection at mid-span over the largest exact deflection.
    """
    solver = beam.make_beam(cells, scheme, courant=min(beam.COURANT, scheme.courant_limit))
    place = solver.points.reference_position
    middle = np.abs(place[:, 0] - 0.5 * beam.LENGTH) < 0.5 * beam.HEIGHT / cells
    steps = round(0.5 * beam.DURATION / solver.time_step)
    moments, deflection = np.zeros((2, BEAM_SAMPLES))
    for k in range(BEAM_SAMPLES):
        clock.advance(solver, steps * (k + 1) // BEAM_SAMPLES - solver.step)
        moments[k] = solver.time
        deflection[k] = solver.points.displacement[middle, 1].mean()
    exact = elastic_deflection(beam.BEAM, place[middle], moments)
    return beam.Deflection(moments, deflection, exact).error


def crack_error(scheme: Scheme, cells: int, clock: Clock) -> float:
    """Strip with an edge crack at rest under tension: relative error of J. The whole run is timed.

    Parameters
    ----------
    scheme : Scheme
    cells : int
        Cells along the crack.
    clock : Clock

    Returns
    -------
    float
        |J / J of Tada - 1|.
    """
    began = time.perf_counter()
    run = edge_crack.run_edge_crack(cells, scheme)
    clock.seconds += time.perf_counter() - began
    return abs(float(run.release_rate[0]) / edge_crack.tada_release_rate() - 1.0)


@dataclass(frozen=True)
class Study:
    """A case that is run with several schemes at several cell sizes.

    Parameters
    ----------
    name, title, measure, resolution : str
        Name; title of its picture; what its error is; what its number of cells counts.
    error : callable
        From scheme, cells and clock to the error.
    runs : dict of Scheme to tuple of int
        Numbers of cells for each scheme.
    courant : float
        Courant number of schemes that allow it; others run at their limit.
    warm : int
        Number of cells of a short run that loads or compiles what the others need.
    """

    name: str
    title: str
    measure: str
    resolution: str
    error: Callable[[Scheme, int, Clock], float]
    runs: dict[Scheme, tuple[int, ...]]
    courant: float
    warm: int = 10


FLIP = Scheme(transfer="flip")
USL_FLIP = Scheme(integration="usl", transfer="flip")
USAVG = Scheme(integration="usavg")
FMPM4 = Scheme(order=4)
OTHER_SHAPES = (Scheme("linear"), Scheme("cpgimp"), Scheme("bspline"))
OTHER_SHAPES_FLIP = tuple(replace(scheme, transfer="flip") for scheme in OTHER_SHAPES)
STUDIES = (
    Study(
        "bar",
        "Stress step along a bar of graphene (Fig 2.9)",
        "mean error of the stress over the way of the front",
        "cells along the bar",
        bar_error,
        dict.fromkeys(
            (
                *(DEFAULT, *OTHER_SHAPES, FLIP, *OTHER_SHAPES_FLIP, FMPM4, USL_FLIP, USAVG),
                *(
                    Scheme(integration="usl"),
                    Scheme(integration="usf"),
                    Scheme(transfer="xpic"),
                    Scheme(transfer="pic"),
                ),
            ),
            (50, 100, 200, 400),
        ),
        bar_wave.COURANT,
    ),
    Study(
        "beam",
        "Beam under a harmonic force, one period (Fig 2.6)",
        "largest error of the deflection",
        "cells through the height",
        beam_error,
        {
            **dict.fromkeys((DEFAULT, FLIP, USL_FLIP), (4, 6, 8, 12)),
            **dict.fromkeys((*OTHER_SHAPES_FLIP, USAVG, replace(USAVG, transfer="flip"), FMPM4), (4, 6, 8)),
        },
        beam.COURANT,
        warm=2,
    ),
    Study(
        "edge crack",
        "Edge crack in a plate under tension, a/W = 0.5",
        "error of J",
        "cells along the crack",
        crack_error,
        dict.fromkeys((DEFAULT, FLIP, OTHER_SHAPES[2], OTHER_SHAPES_FLIP[0]), edge_crack.CELLS),
        edge_crack.COURANT,
        warm=edge_crack.CELLS[0],
    ),
)


def measure_accuracy(study: Study) -> list[BenchmarkRow]:
    """Run every scheme of a study at every cell size.

    Returns
    -------
    list of BenchmarkRow
        `seconds` of the steps; figure ``front`` is 1 where no other row is both faster and more exact. A run that
        broke off has no error.
    """
    found: list[tuple[Scheme, int, float, float]] = []
    for scheme, sizes in study.runs.items():
        study.error(scheme, study.warm, Clock())
        for cells in sizes:
            times: list[float] = []
            while not times or (times[0] < SHORT and len(times) < REPEATS):
                clock = Clock()
                try:
                    error = study.error(scheme, cells, clock)
                except SolverError:
                    error = float("inf")
                times.append(clock.seconds)
            found.append((scheme, cells, float(np.median(times)), error if np.isfinite(error) else float("inf")))
    front = front_of([(seconds, error) for *_, seconds, error in found])
    return [
        BenchmarkRow(
            label=f"{study.name}, {scheme_text(scheme)}, {cells} cells",
            knobs={
                "benchmark": study.name,
                "scheme": scheme_text(scheme),
                "interpolation": scheme.interpolation,
                "integration": scheme.integration,
                "transfer": scheme.transfer,
                "order": scheme.order,
                "courant": min(study.courant, scheme.courant_limit),
                "cells": cells,
            },
            seconds=seconds,
            error=error if np.isfinite(error) else None,
            figures={"front": float(k in front)},
        )
        for k, (scheme, cells, seconds, error) in enumerate(found)
    ]


def front_of(pairs: Sequence[tuple[float, float]]) -> list[int]:
    """Return which pairs no other beats, rising in the first number.

    Parameters
    ----------
    pairs : sequence of (float, float)
        Seconds and error.
    """
    best = np.inf
    front = []
    for k in sorted(range(len(pairs)), key=lambda k: pairs[k]):
        if pairs[k][1] < best:
            front.append(k)
            best = pairs[k][1]
    return front


def scheme_text(scheme: Scheme) -> str:
    """Return a short name such as ``uGIMP MUSL FMPM(2)``."""
    shape = {"linear": "linear", "ugimp": "uGIMP", "cpgimp": "cpGIMP", "bspline": "B-spline"}[scheme.interpolation]
    order = f"({scheme.order})" if scheme.transfer in ("fmpm", "xpic") else ""
    return f"{shape} {scheme.integration.upper()} {scheme.transfer.upper()}{order}"
