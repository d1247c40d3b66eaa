"""The atoms of a coupled run in one LAMMPS run without a break: what windows, anchors and the service are held against.

``python -m md_service.overhead FOLDER FORCE_FIELD WINDOW anchored|free``, alone or under mpiexec, makes the sheet,
writes ``ready``, and then for each line with a number of steps on its input the seconds of a step.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from md_service.anchors import checked_anchors
from md_service.atoms import Atoms
from md_service.force_fields import force_field as profile_of
from md_service.graphene import graphene
from md_service.lammps_dynamics import LammpsDynamics
from md_service.ranks import MpiRanks, OneRank, Ranks

TEMPERATURE: Final = 300.0  # K
STIFFNESS: Final = 100.0  # N/m
DAMPING_TIME: Final = 2e-13  # s
SIZE: Final = 103e-10  # m, edge of the sheet
#: Smaller sheets, m, for force fields that take long.
SMALLER: Final = {"reaxff": 52e-10}
MARGIN: Final = 15e-10  # m, width of the anchored frame
_WARM_UP: Final = 100  # steps


class BareRun:
    """A sheet in LAMMPS, run without a break.

    Parameters
    ----------
    work_dir : Path
        Folder of the LAMMPS log.
    force_field : str
        Profile name.
    window : int
        Steps M of the averaging fix, where there are anchors.
    anchored : bool
        With the anchors of a coupled run on the frame, their thermostat and averages; else atoms alone.
    ranks : Ranks, optional
        MPI ranks.
    """

    def __init__(
        self, work_dir: Path, force_field: str, window: int, anchored: bool = True, ranks: Ranks | None = None
    ) -> None:
        atoms, frame = framed_sheet(force_field)
        self._dynamics = LammpsDynamics(
            work_dir, profile_of(force_field), atoms, temperature=TEMPERATURE, seed=1, ranks=ranks
        )
        if anchored:
            place = atoms.position[frame]
            stiffness, cells = np.full(len(frame), STIFFNESS), np.zeros(len(frame), dtype=np.int64)
            self._dynamics.adopt(checked_anchors(frame, place, stiffness, cells, DAMPING_TIME, atoms.atom_mass))
        self._dynamics.draw_velocities(TEMPERATURE)
        self._dynamics.run(_WARM_UP)
        if anchored:
            self._dynamics.run_window(window)

    def seconds_per_step(self, steps: int) -> float:
        """Run on, a multiple of the window, and return the wall time of a step, s."""
        start = time.perf_counter()
        self._dynamics.run(steps)
        return (time.perf_counter() - start) / steps

    def close(self) -> None:
        """Let go of LAMMPS."""
        self._dynamics.close()


def framed_sheet(
    force_field: str, size: float | None = None, margin: float = MARGIN
) -> tuple[Atoms, NDArray[np.int64]]:
    """Return a square sheet with free edges and the rows of the atoms in its frame, edge and width in m."""
    size = SMALLER.get(force_field, SIZE) if size is None else size
    atoms = graphene(size, size, spacing=profile_of(force_field).lattice_constant)
    plane = np.abs(atoms.position[:, :2])
    inside = plane < plane.max(axis=0) - margin
    return atoms, np.flatnonzero(~inside.all(axis=1))


def _main(arguments: list[str]) -> None:
    folder, force_field, window, kind = arguments
    ranks: Ranks = OneRank() if int(os.environ.get("PMI_SIZE", "1")) == 1 else MpiRanks()
    run = BareRun(Path(folder), force_field, int(window), kind == "anchored", ranks)
    first = ranks.rank == 0
    if first:
        print("ready", flush=True)
    while True:
        line = sys.stdin.readline() if first else ""
        steps = int(ranks.sum(np.array([float(line or 0)]))[0])
        if steps == 0:
            break
        seconds = run.seconds_per_step(steps)
        if first:
            print(seconds, flush=True)
    run.close()


if __name__ == "__main__":
    _main(sys.argv[1:])
