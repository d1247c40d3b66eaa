"""Seconds of the open-hole cross-ply with 400 elements in 50 increments, and what more or fewer of both would give.

Points soften by the crack band, which is the dear way: each softening point is solved by itself. The cells answer from
a process of their own, so both services have a core. Errors are those of the peak against the finest run of the sweep,
whose own error is that of the finest meshes of `structure/oht-mesh`.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np
from matplotlib.figure import Figure

from fem_service.verification.oht_mesh import CRACK_BAND, PAST, cross_ply, elements
from fem_service.verification.pulled_laminates import BACKEND, Pull, pull, shipped_cell
from protocol.verification import CannotRun, Case, Check

#: Elements round a quarter of the hole and from the hole to the side; 392 in the plate.
MESH: Final = (14, 7)
INCREMENTS: Final = 50
#: Just below the peak: beyond it a crack runs through the plate, and one increment takes what all before it took.
FINAL_STRAIN: Final = 0.0144
WANTED: Final = 60.0
#: The sweep: meshes, and increments of strain.
MESHES: Final = ((8, 4), (12, 6), (14, 7), (18, 9))
SIZES: Final = (1.6e-3, 0.8e-3, 0.4e-3)
PARTS: Final = ("solution", "assembly", "micromechanics", "wire", "other")

_SERVE: Final = """
import sys
from pathlib import Path
from protocol.backend import find
from protocol.server import Server
service = find("micromechanics", sys.argv[1]).make(Path("."))
Server(service, sys.argv[2], parent=int(sys.argv[3])).run(lambda bound: print(bound, flush=True))
"""


@contextmanager
def _served() -> Iterator[str]:
    """Endpoint of a micromechanics service in a process of its own."""
    with TemporaryDirectory(prefix="scalebridge-") as folder:
        words = [sys.executable, "-c", _SERVE, BACKEND, f"ipc://{folder}/cells", str(os.getpid())]
        process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
        try:
            assert process.stdout is not None  # asked for above
            endpoint = process.stdout.readline().strip()
            if not endpoint:
                raise CannotRun(f"no micromechanics service {BACKEND}")
            yield endpoint
        finally:
            process.terminate()
            process.wait(10)


def split(found: Pull) -> dict[str, float]:
    """Where the seconds of a pull went; those of the wire are beside those of micromechanics here."""
    sums = {part: sum(made.seconds[part] for made in found.made) for part in PARTS}
    sums["micromechanics"] -= sums["wire"]
    return sums


def _speed(folder: Path) -> list[Check]:
    cell = shipped_cell(CRACK_BAND)
    with _served() as endpoint:
        # Compiles, and fills the table of damaged cells.
        pull(cross_ply(endpoint, cell, (4, 3), 0.012, 0.004))
        began = time.perf_counter()
        whole = pull(cross_ply(endpoint, cell, MESH, FINAL_STRAIN, FINAL_STRAIN / INCREMENTS), stop_below=0.0)
        seconds = time.perf_counter() - began
        parts = split(whole)
        sweep = []
        for mesh in MESHES:
            for size in SIZES:
                began = time.perf_counter()
                found = pull(cross_ply(endpoint, cell, mesh, 0.024, size), stop_below=PAST[CRACK_BAND])
                sweep.append((mesh, size, found.peak, time.perf_counter() - began))
    _written(folder, whole, seconds, parts, sweep)
    _drawn(folder, parts, sweep)
    made = whole.made
    words = ", ".join(f"{part} {value:.1f}" for part, value in parts.items())
    iterations = sum(one.iterations for one in made)
    return [
        Check(
            f"seconds of {len(made)} increments with {elements(MESH)} elements ({words}; {iterations} iterations, "
            f"{made[-1].factorisations} factorisations, {sum(one.queried for one in made)} points asked)",
            seconds, WANTED, 0.0, "the issue's limit, with two cores", "s", at_most=True,
        ),
        Check("increments made", len(made), INCREMENTS, 0.0, "as asked for"),
    ]  # fmt: skip


Sweep = list[tuple[tuple[int, int], float, float, float]]


def _written(folder: Path, whole: Pull, seconds: float, parts: dict[str, float], sweep: Sweep) -> None:
    lines = [f"{elements(MESH)} elements, {len(whole.made)} increments: {seconds:.1f} s"]
    lines += [f"    {part:15s} {value:6.1f} s {value / seconds:5.0%}" for part, value in parts.items()]
    finest = sweep[-1][2]
    lines.append("elements increment_%  peak_MPa error_%  seconds")
    for mesh, size, peak, took in sweep:
        lines.append(
            f"{elements(mesh):8d} {100 * size:11g} {peak / 1e6:9.2f} {100 * (peak / finest - 1.0):+7.2f} {took:8.1f}"
        )
    (folder / "oht-speed.txt").write_text("\n".join(lines) + "\n")


def _drawn(folder: Path, parts: dict[str, float], sweep: Sweep) -> None:
    figure = Figure(figsize=(11, 4.0), layout="constrained")
    bars, errors = figure.subplots(1, 2)
    places = np.arange(len(parts))
    bars.barh(places, list(parts.values()), color="#4477aa")
    bars.set_yticks(places, list(parts))
    bars.invert_yaxis()
    bars.set(xlabel="seconds", title=f"{elements(MESH)} elements, {INCREMENTS} increments")
    finest = sweep[-1][2]
    for mesh, mark in zip(MESHES, "ov^s", strict=False):
        here = [(took, 100.0 * abs(peak / finest - 1.0)) for at, _, peak, took in sweep if at == mesh]
        errors.plot(*zip(*here, strict=True), f"{mark}-", label=f"{elements(mesh)} elements")
    sizes = ", ".join(f"{100 * size:g}" for size in SIZES)
    errors.set(
        xlabel="seconds", ylabel="peak, % off that of the finest", ylim=(0.0, None), xlim=(0.0, None),
        title=f"along each line increments of {sizes} %",
    )  # fmt: skip
    errors.legend(fontsize="small")
    figure.savefig(folder / "oht-speed.png", dpi=130)


CASES: list[Case] = [
    Case("structure", "oht-speed", "seconds of the open-hole cross-ply, where they go, and the error they buy", _speed,
         slow=True)
]  # fmt: skip
