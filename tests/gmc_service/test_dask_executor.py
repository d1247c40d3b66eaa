"""A real Dask cluster of processes behind the front: same bits, a killed worker, one definition for each worker."""

from __future__ import annotations

import logging
import os
import signal
import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest
from cell_definitions import query, random_cell, same_bits

from gmc_service import dask_executor
from gmc_service.dask_executor import DaskExecutor, scheduler_address
from gmc_service.front import Front
from gmc_service.service import MicromechanicsService
from protocol import micromechanics as m
from protocol.backend import BackendError
from protocol.errors import ErrorReport, ProtocolError

distributed = pytest.importorskip("distributed")


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    """Two worker processes of one thread, which their nannies start again when they end."""
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, host="127.0.0.1", dashboard_address=None, silence_logs=50
    ) as cluster:
        yield "dask://" + cluster.scheduler_address.removeprefix("tcp://")


@pytest.fixture(scope="module")
def front(address: str) -> Iterator[Front]:
    made = Front("gmc_service", DaskExecutor(address, "gmc_service"))
    yield made
    made.close()


@pytest.fixture(scope="module")
def single() -> MicromechanicsService:
    return MicromechanicsService("gmc_service", "gmc")


def worker_pids(address: str) -> dict[str, int]:
    with distributed.Client("tcp://" + address.removeprefix("dask://"), set_as_default=False) as client:
        return dict(client.run(os.getpid, on_error="ignore"))  # one that was killed may still be listed


def kill_a_busy_worker(address: str, pids: dict[str, int], killed: list[int]) -> None:
    """Kill the first worker that is seen to have a part of a query."""
    end = time.monotonic() + 60
    with distributed.Client("tcp://" + address.removeprefix("dask://"), set_as_default=False) as client:
        while not killed and time.monotonic() < end:
            busy = [one for one, tasks in client.processing().items() if any("answer_job" in str(t) for t in tasks)]
            if busy:
                os.kill(pids[busy[0]], signal.SIGKILL)
                killed.append(pids[busy[0]])
            time.sleep(0.01)


def test_a_cluster_answers_the_bits_of_one_process(front: Front, single: MicromechanicsService) -> None:
    name = front.register(random_cell(5)).cell
    assert single.register(random_cell(5)).cell == name
    assert front.capabilities() == {**single.capabilities(), "workers": 2}
    request = query(name, 20_000)
    expected = single.evaluate(request)
    assert expected.new_failures > 0
    assert same_bits(front.evaluate(request), expected)
    bare = m.LocaliseRequest(cell=name, temperature=300.0, strain=request.strain[:9000])
    assert front.localise(bare).stress.tobytes() == single.localise(bare).stress.tobytes()
    properties = m.CellPropertiesRequest(cell=name, temperature=300.0)
    assert front.properties(properties).stiffness.tobytes() == single.properties(properties).stiffness.tobytes()


def test_errors_of_a_worker_come_back_with_code_and_field(front: Front) -> None:
    name = front.register(random_cell(5)).cell
    with pytest.raises(ProtocolError) as caught:
        front.evaluate(query(name, 3).model_copy(update={"history": query(name, 3).strain}))
    assert (caught.value.code, caught.value.report.field) == ("bad_field", "history")
    with pytest.raises(ProtocolError) as caught:
        front.evaluate(query("nobody", 3))
    assert caught.value.code == "unknown_cell"


def test_a_worker_of_the_cluster_killed_in_mid_query_loses_nothing(
    front: Front, single: MicromechanicsService, address: str, caplog: pytest.LogCaptureFixture
) -> None:
    name = front.register(random_cell(9)).cell
    single.register(random_cell(9))
    request = query(name, 60_000)
    expected = single.evaluate(request)
    before = worker_pids(address)
    assert len(before) == 2
    killed: list[int] = []
    killer = threading.Thread(target=kill_a_busy_worker, args=(address, before, killed))
    killer.start()
    with caplog.at_level(logging.WARNING):
        answer = front.evaluate(request)
    killer.join()
    assert killed and same_bits(answer, expected)
    end = time.monotonic() + 60
    while len(after := set(worker_pids(address).values()) - set(killed)) < 2 and time.monotonic() < end:
        time.sleep(0.2)
    assert len(after) == 2
    # The new worker makes the cell from its definition.
    assert same_bits(front.evaluate(request), expected)


def test_an_aborted_query_is_taken_back(front: Front) -> None:
    name = front.register(random_cell(9)).cell
    front.activity.begin("evaluate")
    threading.Timer(0.2, front.activity.abort.set).start()
    with pytest.raises(ProtocolError) as caught:
        front.evaluate(query(name, 200_000))
    assert caught.value.code == "aborted"
    front.activity.begin("evaluate")
    assert front.evaluate(query(name, 5)).stress.shape == (5, 6)


@pytest.mark.parametrize(
    ("problem", "code"), [(KeyError("a defect"), "internal"), (ProtocolError("aborted", "ended"), "aborted")]
)
def test_what_a_backend_raises_is_no_lost_worker(
    problem: Exception, code: str, monkeypatch: pytest.MonkeyPatch, single: MicromechanicsService
) -> None:
    def fail(request: m.EvaluateRequest) -> m.Evaluated:
        raise problem

    monkeypatch.setattr(single, "evaluate", fail)
    monkeypatch.setitem(dask_executor._services, "broken", single)
    report = dask_executor.answer_job("broken", "evaluate", query("c", 1), None)
    assert isinstance(report, ErrorReport) and report.code == code


def test_a_reply_with_a_nan_is_a_failure_of_the_solver(
    monkeypatch: pytest.MonkeyPatch, single: MicromechanicsService
) -> None:
    def fail(request: m.EvaluateRequest) -> m.Localised:
        return m.Localised(stress=np.full((1, 1, 6), np.nan), strain=np.zeros((1, 1, 6)))

    monkeypatch.setattr(single, "localise", fail)
    monkeypatch.setitem(dask_executor._services, "broken", single)
    report = dask_executor.answer_job("broken", "localise", query("c", 1), None)
    assert isinstance(report, ErrorReport) and (report.code, report.field) == ("solver_failed", "stress")


def test_addresses_beyond_this_machine_need_certificates() -> None:
    assert scheduler_address("dask://127.0.0.1:8786") == "tcp://127.0.0.1:8786"
    assert scheduler_address("dask://localhost:8786") == "tcp://localhost:8786"
    with pytest.raises(BackendError, match="has no certificates"):
        scheduler_address("dask://192.0.2.1:8786")
    for wrong in ("tcp://127.0.0.1:8786", "dask://127.0.0.1", "dask://:8786", "dask://127.0.0.1:x"):
        with pytest.raises(BackendError, match="dask://HOST:PORT"):
            scheduler_address(wrong)


def test_a_cluster_that_is_not_there_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gmc_service.dask_executor.READY_SECONDS", 0.5)
    with pytest.raises(BackendError, match=r"no Dask scheduler answers at dask://127\.0\.0\.1:9"):
        DaskExecutor("dask://127.0.0.1:9", "gmc_service")
