"""The benchmark `mpm` measures what it says, in short runs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from importlib import metadata
from itertools import product
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numba import njit
from numba.core import event

from benchmarks.mpm_accuracy import DEFAULT, FLIP, STUDIES, Clock, bar_error, front_of, measure_accuracy
from benchmarks.mpm_accuracy_picture import draw_accuracy
from benchmarks.mpm_bandwidth import bytes_per_step, copy, measure_bandwidth, point_passes, triad
from benchmarks.mpm_speed import CONFIGURATIONS, SIZES, bytes_per_point, make_square, measure_speed
from benchmarks.mpm_speed_picture import draw_speed
from mpm_service import Scheme, SolverError
from mpm_service.compile_kernels import compile_kernels
from mpm_service.mapping import Mapping
from mpm_service.scheme import Integration, Transfer
from mpm_service.verification.bar_wave import make_bar
from mpm_service.verification.edge_crack import run_edge_crack
from protocol.verification import BENCHMARKS, BenchmarkRow

BANDWIDTH = {1: 10e9, 2: 16e9}
SMALL = 1000
PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture(scope="module")
def speed() -> list[BenchmarkRow]:
    return measure_speed(sizes=(SMALL, 2 * SMALL), middle=SMALL, rounds=3, batch=4 * SMALL, bandwidth=BANDWIDTH)


def test_each_configuration_has_its_rows(speed: list[BenchmarkRow]) -> None:
    found = [(row.knobs["configuration"], row.knobs["size"], row.knobs["threads"]) for row in speed]
    runs = ((SMALL, 1), (2 * SMALL, 1), (SMALL, 2))
    assert found == [(c.label, *run) for c in CONFIGURATIONS for run in runs]


def test_figures_of_a_row_belong_together(speed: list[BenchmarkRow]) -> None:
    targets = {c.label: c.target for c in CONFIGURATIONS}
    for row in speed:
        figures, points, threads = row.figures, float(row.knobs["points"]), int(row.knobs["threads"])
        assert 0.0 < figures["least"] <= figures["ns"]
        assert row.seconds == pytest.approx(1e-9 * figures["ns"] * points)
        assert figures["bound"] == pytest.approx(1e9 * float(row.knobs["bytes"]) / BANDWIDTH[threads])
        assert 0.0 < figures["core share"] < 1.2
        target = targets[str(row.knobs["configuration"])] if threads == 1 else None
        assert figures.get("target") == target
        if target is not None:
            assert figures["ns/target"] == pytest.approx(figures["ns"] / target)
        assert ("speed-up" in figures) == (threads == 2)


def test_memory_of_a_point_holds_its_row_and_more(speed: list[BenchmarkRow]) -> None:
    stated = [row for row in speed if "B/point" in row.figures]
    assert [row.knobs["configuration"] for row in stated] == [c.label for c in CONFIGURATIONS]
    for row in stated:
        # A row of 16 doubles, two maps of ids, reference place, weight, material: none can be done without.
        assert row.figures["B/point"] > 16 * 8 + 2 * 8 + 2 * 8 + 8 + 8


def test_regression_memory_of_a_point_in_the_default_scheme() -> None:
    """Measured: 258 bytes at 100k points."""
    (default,) = [c for c in CONFIGURATIONS if c.scheme == DEFAULT]
    assert bytes_per_point(default, 40_000) == pytest.approx(258.0, rel=0.1)


@pytest.mark.parametrize("configuration", CONFIGURATIONS, ids=lambda c: c.label)
def test_the_square_is_what_the_row_says(configuration: Any) -> None:
    solver = make_square(configuration, SIZES[0], threads=1)
    assert solver.points.count == pytest.approx(SIZES[0], rel=0.1)
    assert solver.scheme == configuration.scheme
    assert (solver.cracks is not None) == (configuration.feature == "crack")
    sizes = np.unique(solver.body.half)
    assert sizes.tolist() == ([0.125, 0.25] if configuration.feature == "levels" else [0.25])
    solver.advance(3)
    assert solver.points_lost == 0
    assert np.all(np.abs(solver.points.stress).max(axis=1) > 0.0)


READS_AND_WRITES = {
    "scatter_state": (1, 0),
    "scatter_filtered": (1, 0),
    "update": (1, 1),
    "update_remap": (1, 1),
    "update_deform": (1, 1),
    "deform": (1, 1),
    "move": (1, 1),
}


@pytest.mark.parametrize(("integration", "transfer"), [*product(get_args(Integration), get_args(Transfer))])
def test_passes_are_those_that_a_step_makes(
    integration: Integration, transfer: Transfer, monkeypatch: pytest.MonkeyPatch
) -> None:
    scheme = Scheme(integration=integration, transfer=transfer, order=3)
    solver = make_square(replace(CONFIGURATIONS[0], scheme=scheme), SMALL, threads=1)
    counted = np.zeros(2, dtype=np.int64)

    def counting(name: str, sweep: Callable[..., Any]) -> Callable[..., Any]:
        def wrapped(*arguments: Any) -> Any:
            counted[:] += READS_AND_WRITES[name]
            return sweep(*arguments)

        return wrapped

    for name in READS_AND_WRITES:
        monkeypatch.setattr(Mapping, name, counting(name, getattr(Mapping, name)))
    solver.advance(1)
    assert point_passes(scheme) == tuple(counted)
    assert bytes_per_step(scheme) == 128 * counted.sum()


def test_copy_and_triad_do_what_they_are_named_for() -> None:
    a, b = np.random.default_rng(1).normal(size=(2, 10))
    c = np.zeros(10)
    copy(a, c, 2, 7)
    assert np.array_equal(c, np.where((np.arange(10) >= 2) & (np.arange(10) < 7), a, 0.0))
    triad(a, b, c, 0, 10)
    assert c == pytest.approx(a + b / 3.0, rel=1e-15)


def test_bandwidth_is_of_the_order_of_a_machine_of_today() -> None:
    for rate in measure_bandwidth((1, 2), rounds=2, array_bytes=2**22).values():
        assert 1e8 < rate < 1e12


@given(st.lists(st.tuples(st.integers(0, 6), st.integers(0, 6)), min_size=1, max_size=20))
def test_front_holds_what_none_beats(pairs: list[tuple[int, int]]) -> None:
    values = [(float(a), float(b)) for a, b in pairs]
    front = front_of(values)
    for k, (seconds, error) in enumerate(values):
        beaten = any((s <= seconds and e <= error) and (s < seconds or e < error) for s, e in values)
        if k in front:
            assert not beaten
        else:
            assert beaten or (seconds, error) in [values[i] for i in front]


def test_front_leaves_out_runs_that_broke_off() -> None:
    assert front_of([(0.1, float("inf")), (1.0, 0.5)]) == [1]


def test_bar_error_is_that_of_the_profile() -> None:
    """FLIP rings with an overshoot of 27 %, the default has none; the error of the default falls with the cells."""
    clock = Clock()
    coarse, fine, ringing = bar_error(DEFAULT, 50, clock), bar_error(DEFAULT, 100, clock), bar_error(FLIP, 100, clock)
    assert fine < coarse < 0.05
    assert ringing > 2.0 * fine
    assert clock.seconds > 0.0


def test_a_bar_at_rest_has_the_error_of_all_its_way() -> None:
    """Without steps nothing has travelled, so all of the exact stress is missing: the error is one."""

    class Stopped(Clock):
        def advance(self, solver: Any, steps: int) -> None:
            rows = solver.state()
            super().advance(solver, steps)
            solver.restore(rows | {"step": solver.state()["step"]})

    assert bar_error(DEFAULT, 20, Stopped()) == pytest.approx(1.0, abs=1e-12)


def test_a_study_has_a_row_for_every_run_and_marks_its_front(tmp_path: Path) -> None:
    def error(scheme: Scheme, cells: int, clock: Clock) -> float:
        clock.seconds = float(cells)
        if scheme == FLIP and cells == 4:
            raise SolverError("gone", 0, 0, (0.0, 0.0))
        return 1.0 / cells if scheme == DEFAULT else 2.0 / cells

    study = replace(STUDIES[0], name="made up", error=error, runs={DEFAULT: (2, 4, 8), FLIP: (2, 4, 16)}, warm=1)
    rows = measure_accuracy(study)
    assert [(row.knobs["transfer"], row.knobs["cells"]) for row in rows] == [
        *(("fmpm", cells) for cells in (2, 4, 8)),
        *(("flip", cells) for cells in (2, 4, 16)),
    ]
    assert [row.error for row in rows] == [0.5, 0.25, 0.125, 1.0, None, 0.125]
    assert [row.figures["front"] for row in rows] == [1.0, 1.0, 1.0, 0.0, 0.0, 0.0]
    draw_accuracy(study, rows, tmp_path / "made_up.png")
    assert (tmp_path / "made_up.png").read_bytes()[:8] == PNG


def test_every_study_runs_the_default_at_each_of_its_sizes() -> None:
    for study in STUDIES:
        assert set(study.runs[DEFAULT]) == {cells for sizes in study.runs.values() for cells in sizes}


def test_the_picture_of_speed_is_a_png(speed: list[BenchmarkRow], tmp_path: Path) -> None:
    draw_speed(speed, BANDWIDTH, tmp_path / "speed.png")
    assert (tmp_path / "speed.png").read_bytes()[:8] == PNG


def test_bench_finds_it_by_its_entry_point() -> None:
    (entry,) = [e for e in metadata.entry_points(group=BENCHMARKS) if e.name == "mpm"]
    assert entry.load().name == "mpm"


def test_usual_runs_find_all_kernels_compiled() -> None:
    """After `compile_kernels` neither a loaded bar nor a cracked strip compiles anything."""
    compile_kernels()

    class Compiled(event.Listener):
        def __init__(self) -> None:
            self.names: list[str] = []

        def on_start(self, event: Any) -> None:
            self.names.append(event.data["dispatcher"].py_func.__qualname__)

        def on_end(self, event: Any) -> None:
            pass

    compiled = Compiled()
    with event.install_listener("numba:compile", compiled):
        make_bar(DEFAULT, cells=20).advance(2)
        run_edge_crack(5)
        make_square(replace(CONFIGURATIONS[-1], scheme=DEFAULT), SMALL, threads=1).advance(2)
        assert compiled.names == []
        njit(_one)()
    assert compiled.names == ["_one"]


def _one() -> int:
    return 1
