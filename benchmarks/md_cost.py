"""Time of an MD step: bare LAMMPS without and with anchors, and the same through the service."""

from __future__ import annotations

import cProfile
import pstats
import shutil
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from md_service.atoms import CrackCut
from md_service.engine import Engine
from md_service.force_fields import force_field as profile_of
from md_service.graphene import graphene
from md_service.j_meter import AtomFields, JMeter
from md_service.lammps_dynamics import LammpsDynamics
from md_service.overhead import DAMPING_TIME, MARGIN, SIZE, STIFFNESS, TEMPERATURE
from md_service.verification.overhead import BareSheet, ServedSheet
from protocol.verification import BenchmarkRow

#: Force fields, and steps of a timed run: about a second.
FORCE_FIELDS = {"tersoff": 200, "airebo": 200, "reaxff": 50}
WINDOWS = (10, 100)
RANKS = (1, 2)
ROUNDS = 5
_J_INTERVAL = 100  # steps


def service_rows(folder: Path) -> list[BenchmarkRow]:
    """Rows of bare LAMMPS (peer), of LAMMPS with anchors (peer) and of the service, timed in turn.

    `seconds` is the time of a step; the figures `over_free` and `over_anchored` are medians of ratios of neighbours in
    time, which the machine's slow changes leave alone.
    """
    rows = []
    for ranks in RANKS:
        for force_field, steps in FORCE_FIELDS.items():
            for window in WINDOWS:
                rows += _compared(folder, force_field, max(steps, window), window, ranks)
    return rows


def _compared(folder: Path, force_field: str, steps: int, window: int, ranks: int) -> list[BenchmarkRow]:
    where = folder / f"{force_field}_{window}_{ranks}"
    shutil.rmtree(where, ignore_errors=True)
    where.mkdir()
    free = BareSheet(where / "free", force_field, window, anchored=False, ranks=ranks)
    anchored = BareSheet(where / "anchored", force_field, window, ranks=ranks)
    served = ServedSheet(where / "served", force_field, window, ranks=ranks)
    sheets: dict[str, BareSheet | ServedSheet] = {"LAMMPS": free, "LAMMPS with anchors": anchored, "service": served}
    times = np.array([[sheet.seconds_per_step(steps) for sheet in sheets.values()] for _ in range(ROUNDS)])
    for sheet in sheets.values():
        sheet.close()
    knobs: dict[str, str | int | float] = {"force_field": force_field, "M": window, "ranks": ranks}
    rows = []
    for column, label in enumerate(sheets):
        over = {"over_free": float(np.median(times[:, column] / times[:, 0]))} if column else {}
        if column == 2:
            over["over_anchored"] = float(np.median(times[:, 2] / times[:, 1]))
        rows.append(BenchmarkRow(label, knobs, float(np.median(times[:, column])), None, over, peer=column < 2))
    return rows


def j_row(folder: Path) -> BenchmarkRow:
    """J at every 100th step of an airebo run with a crack: processor time of a step, and over that without J."""
    profile = profile_of("airebo")
    atoms = graphene(SIZE, SIZE, spacing=profile.lattice_constant, crack=CrackCut(0.0))
    plane = np.abs(atoms.position[:, :2])
    frame = np.flatnonzero(~(plane < plane.max(axis=0) - MARGIN).all(axis=1))
    place, still = atoms.position[frame], np.zeros((len(frame), 3))
    engine = Engine(
        LammpsDynamics(folder / "j", profile, atoms, temperature=TEMPERATURE, seed=1), temperature=TEMPERATURE
    )
    cells = np.zeros(len(frame), dtype=np.int64)
    engine.register_anchors(frame, place, np.full(len(frame), STIFFNESS), cells, DAMPING_TIME)
    engine.equilibrate(100)
    engine.collect_fields(True)
    engine.measure_reference(8, _J_INTERVAL)
    meter = JMeter(atoms, (0.0, 0.0), (15e-10, 20e-10, 25e-10), temperature=TEMPERATURE)
    meter.set_reference(_fields(engine.reference_fields()))
    engine.collect_fields(True)
    engine.advance(_J_INTERVAL, place, still)  # a first window with a setup of its own
    # The processor's time of a window swings by more than what J costs, so the parts are timed inside it.
    profile_of_run = cProfile.Profile(time.process_time)
    windows = 2 * ROUNDS
    profile_of_run.enable()
    for _ in range(windows):
        engine.advance(_J_INTERVAL, place, still)
        meter.measure(_fields(engine.fields(["mean_position", "virial", "energy"])))
    profile_of_run.disable()
    engine.close()
    spent = {
        (Path(where).name, name): cumulative
        for (where, _, name), (_, _, _, cumulative, _) in pstats.Stats(profile_of_run).stats.items()  # type: ignore[attr-defined]
    }
    advance = spent["engine.py", "advance"]
    parts = [spent["field_means.py", "add"], spent["engine.py", "fields"], spent["j_meter.py", "measure"]]
    # The tally of virials in one step of the hundred counts as a step more, which it never is.
    share = sum(parts) / (advance - parts[0]) + 1.0 / _J_INTERVAL
    knobs: dict[str, str | int | float] = {"force_field": "airebo", "M": _J_INTERVAL, "ranks": 1, "contours": 3}
    seconds = advance / (windows * _J_INTERVAL)
    return BenchmarkRow("J at every 100th step", knobs, seconds, None, {"over_without": 1.0 + share})


def _fields(fields: dict[str, NDArray[np.float64]]) -> AtomFields:
    return AtomFields(fields["mean_position"], fields["energy"], fields["virial"])
