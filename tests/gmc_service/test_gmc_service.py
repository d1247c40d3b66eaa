"""The role `micromechanics` on the real solver: what it answers, what it refuses, what it keeps."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cell_definitions import material, query, random_cell, same_bits, square_fibre

from gmc_service import service as gmc
from gmc_service.backend import BACKEND, HIGH_FIDELITY, MORI_TANAKA
from gmc_service.cell import Cell
from gmc_service.front import Executor, Front, Job, is_slow, parts_of
from gmc_service.kept_cells import MOST_CELLS, KeptCells
from gmc_service.material import Failure, Material, Plasticity, isotropic_stiffness
from gmc_service.service import MicromechanicsService, cell_of, definition_of, make_gmc
from protocol import micromechanics as m
from protocol.backend import BackendError, find, installed
from protocol.channel import InProcessChannel
from protocol.client import Client
from protocol.conformance import check_service
from protocol.dispatcher import Host
from protocol.errors import ProtocolError
from protocol.server import running
from protocol.service import Capabilities

FOLDER = Path(".")


@pytest.fixture
def client() -> Iterator[Client]:
    made = Client(InProcessChannel(Host(make_gmc(FOLDER))), "micromechanics")
    made.hello(5.0)
    yield made
    made.close()


def test_the_backends_are_announced() -> None:
    for backend in (BACKEND, HIGH_FIDELITY, MORI_TANAKA):
        assert installed()[backend.name] == backend
        service = backend.make(FOLDER)
        assert (service.role, service.backend, service.step) == ("micromechanics", backend.name, 0)
    assert find("micromechanics", None) == BACKEND


@pytest.mark.parametrize("backend", [BACKEND, MORI_TANAKA], ids=lambda backend: backend.name)
def test_the_contract_is_kept(backend: Any, tmp_path: Path) -> None:
    with running(backend.make(tmp_path), f"ipc://{tmp_path}/s", max_message_bytes=1 << 22) as server:
        checks = check_service(server.endpoint, deadline=60.0, shutdown=True)
    assert [f"{check.name}: {check.detail}" for check in checks if check.passed is not True] == []
    assert len(checks) > 95


def test_stress_of_a_laminate_is_that_of_reuss_and_voigt(client: Client) -> None:
    """One row of layers along 3: in series across them, in parallel along them; closed form, isotropic layers."""
    one, two, share = material("fibre"), material("matrix"), 0.3
    cell = square_fibre().model_copy(
        update={"heights": np.ones(1), "widths": np.array([share, 1 - share]), "phase": np.array([[0, 1]]),
                "materials": [one, two]}
    )  # fmt: skip
    registered = client.call("register", cell, m.CellRegistered)
    request = m.CellPropertiesRequest(cell=registered.cell, temperature=300.0)
    found = client.call("properties", request, m.CellProperties).stiffness
    c1, c2 = (np.reshape(one_.stiffness[0], (6, 6)) for one_ in (one, two))
    series = 1.0 / (share / c1[2, 2] + (1 - share) / c2[2, 2])
    shear = 1.0 / (share / c1[3, 3] + (1 - share) / c2[3, 3])
    assert found[2, 2] == pytest.approx(series, rel=1e-12)
    assert found[3, 3] == pytest.approx(shear, rel=1e-12) and found[4, 4] == pytest.approx(shear, rel=1e-12)
    assert found[5, 5] == pytest.approx(share * c1[5, 5] + (1 - share) * c2[5, 5], rel=1e-12)
    assert registered.material_fraction == pytest.approx([share, 1 - share])


def test_parts_of_a_query_do_not_show(monkeypatch: pytest.MonkeyPatch) -> None:
    whole, parted = make_gmc(FOLDER), make_gmc(FOLDER)
    for cell in (square_fibre(), random_cell(5)):
        request = query(whole.register(cell).cell, 3000)
        parted.register(cell)
        monkeypatch.setattr(gmc, "FIRST_PART", 32_000_000)
        expected = whole.evaluate(request)
        assert expected.new_failures > 0
        monkeypatch.setattr(gmc, "FIRST_PART", 1)
        assert same_bits(parted.evaluate(request), expected)


def test_a_query_between_threads_is_the_same_query() -> None:
    service = make_gmc(FOLDER)
    name = service.register(random_cell(6)).cell
    expected = make_gmc(FOLDER)
    expected.register(random_cell(6))
    requests = [query(name, 500, seed=seed) for seed in range(4)]
    answers: dict[int, m.Evaluated] = {}

    def ask(number: int) -> None:
        answers[number] = service.evaluate(requests[number])

    threads = [threading.Thread(target=ask, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for number, request in enumerate(requests):
        assert same_bits(answers[number], expected.evaluate(request))


def test_a_long_query_can_be_aborted() -> None:
    service = make_gmc(FOLDER)
    name = service.register(random_cell(12)).cell
    service.activity.begin("evaluate")
    timer = threading.Timer(0.2, service.activity.abort.set)
    timer.start()
    with pytest.raises(ProtocolError) as caught:
        service.evaluate(query(name, 200_000))
    assert caught.value.code == "aborted"
    service.activity.begin("evaluate")
    assert service.evaluate(query(name, 3)).stress.shape == (3, 6)


def refused(client: Client, operation: str, request: Any, reply: Any, code: str, field: str) -> ProtocolError:
    with pytest.raises(ProtocolError) as caught:
        client.call(operation, request, reply)
    assert (caught.value.code, caught.value.report.field) == (code, field), caught.value
    return caught.value


def test_bad_input_has_code_and_field_and_the_service_goes_on(client: Client) -> None:
    """The list of bad input of the micromechanics issue, one after another to one service."""
    cell = square_fibre()
    name = client.call("register", cell, m.CellRegistered).cell
    right = query(name, 4)
    expected = client.call("evaluate", right, m.Evaluated)

    def register(code: str, field: str, **changes: Any) -> None:
        refused(client, "register", cell.model_copy(update=changes), m.CellRegistered, code, field)

    def evaluate(code: str, field: str, **changes: Any) -> None:
        refused(client, "evaluate", right.model_copy(update=changes), m.Evaluated, code, field)

    def with_material(**changes: Any) -> list[m.CellMaterial]:
        return [cell.materials[0], cell.materials[1].model_copy(update=changes)]

    unstable = np.reshape(cell.materials[1].stiffness[0], (6, 6)).copy()
    unstable[:3, :3] = 1e9 * (2 * np.ones((3, 3)) - np.eye(3))
    register("bad_field", "knock_down", knock_down=1.2)  # fractions out of range
    register("bad_field", "knock_down", knock_down=-0.1)
    register("bad_field", "materials.1.stiffness.0", materials=with_material(stiffness=[[1e9] * 30]))  # moduli missing
    register("bad_field", "materials.1.stiffness", materials=with_material(stiffness=[]))
    register(
        "bad_field", "materials.1.stiffness", materials=with_material(stiffness=[unstable.reshape(-1).tolist()])
    )  # not positive definite
    register("bad_field", "phase", phase=np.array([[0, 1], [1, 2]]))
    register("unsupported", "phase", heights=np.ones(65), widths=np.ones(65), phase=np.zeros((65, 65), np.int64))
    evaluate("unknown_cell", "cell", cell="0" * 64)
    evaluate("bad_field", "strain", strain=np.zeros((4, 5)))  # wrong shape
    evaluate("bad_field", "strain", strain=np.zeros(6))
    evaluate("bad_field", "failed", failed=np.zeros((4, 2), np.uint8))
    evaluate("bad_field", "failed", failed=np.full((4, 1), 16, np.uint8))  # a fifth subcell of four
    evaluate("bad_field", "history", history=np.zeros((4, 1)))
    nan = right.strain.copy()
    nan[2, 3] = np.nan
    evaluate("bad_field", "strain", strain=nan)
    evaluate("bad_field", "temperature", temperature=-1.0)
    localise = m.LocaliseRequest(cell="x", temperature=300.0, strain=np.zeros((1, 6)))
    refused(client, "localise", localise, m.Localised, "unknown_cell", "cell")
    properties = m.CellPropertiesRequest(cell=name, temperature=300.0, failed=np.zeros(3, np.uint8))
    refused(client, "properties", properties, m.CellProperties, "bad_field", "failed")
    assert same_bits(client.call("evaluate", right, m.Evaluated), expected)


def test_a_temperature_beyond_a_table_is_refused(client: Client) -> None:
    cell = square_fibre()
    warm = cell.materials[1]
    table = warm.model_copy(
        update={"temperatures": [290.0, 350.0], "stiffness": 2 * warm.stiffness, "expansion": 2 * warm.expansion}
    )
    name = client.call(
        "register", cell.model_copy(update={"materials": [cell.materials[0], table]}), m.CellRegistered
    ).cell
    assert client.call("evaluate", query(name, 2), m.Evaluated).stress.any()
    too_hot = query(name, 2).model_copy(update={"temperature": 351.0})
    error = refused(client, "evaluate", too_hot, m.Evaluated, "bad_field", "temperature")
    assert "351" in error.report.sentence and "350" in error.report.sentence
    too_cold = m.CellPropertiesRequest(cell=name, temperature=289.0)
    refused(client, "properties", too_cold, m.CellProperties, "bad_field", "temperature")


def test_an_error_at_one_point_names_its_field(client: Client) -> None:
    cell = square_fibre()
    tough = cell.materials[1].model_copy(update={"fracture_energy": 1e-3})
    name = client.call(
        "register", cell.model_copy(update={"materials": [cell.materials[0], tough]}), m.CellRegistered
    ).cell
    too_long = query(name, 2).model_copy(update={"element_length": np.array([1e-12, 1.0])})
    error = refused(client, "evaluate", too_long, m.Evaluated, "bad_field", "element_length")
    assert error.report.sentence.startswith("element_length[1] is 1 m; the most is")


def test_a_definition_is_the_cell_to_the_bit() -> None:
    plastic = Material(
        "all of it", np.array([250.0, 300.0]), np.stack([isotropic_stiffness(3e9, 0.3), isotropic_stiffness(2e9, 0.3)]),
        np.array([[1e-5] * 3 + [0.0] * 3, [2e-5] * 3 + [0.0] * 3]),
        (Failure("hashin", (1e8, np.inf, 2e8), shear=(np.inf, 3e7, np.inf)),), 120.0, Plasticity(5e7, 1e8),
        reduces_strength=True,
    )  # fmt: skip
    cell = Cell(
        np.array([0.1, 0.7]), np.array([0.3]), np.array([[0], [0]]), (plastic,), 280.0, 0.25, after_failure="floor"
    )
    message = definition_of(cell)
    arrived = type(message).from_parts(message.plain_values(), message.array_values())
    assert cell_of(arrived).identity() == cell.identity()
    assert cell_of(arrived).materials[0].failures == plastic.failures
    assert cell_of(arrived).materials[0].reduces_strength


@pytest.mark.parametrize("size", [1e-300, 1e-30, 1e3, 1e30, 1e150, 1e300])
def test_extreme_numbers_are_answered_or_refused(client: Client, size: float) -> None:
    cell = square_fibre()
    stiff = [(size * np.array(cell.materials[0].stiffness[0])).tolist()]
    strange = [cell.materials[0].model_copy(update={"stiffness": stiff}), cell.materials[1]]
    requests = [
        cell.model_copy(update={"heights": size * cell.heights}),
        cell.model_copy(update={"heights": np.array([size, 1.0])}),
        cell.model_copy(update={"materials": strange}) if size < 1e290 else cell,
    ]
    answered = 0
    for request in requests:
        try:
            name = client.call("register", request, m.CellRegistered).cell
            for points in (query(name, 5), query(name, 5, size=min(size, 1e290))):
                answered += bool(np.isfinite(client.call("evaluate", points, m.Evaluated).stress).all())
        except ProtocolError as error:
            assert error.code in ("bad_field", "solver_failed"), error
    assert answered or size > 1e100
    assert client.call("register", cell, m.CellRegistered).subcells == 4


# --- what is kept ------------------------------------------------------------------------------------------------


def test_the_cell_unused_for_longest_goes_first() -> None:
    kept: KeptCells[str] = KeptCells(most=3)
    for name in "abc":
        assert kept.keep(name, lambda name=name: name.upper()) == name.upper()  # type: ignore[misc]
    assert kept.get("a") == "A"  # now b is the oldest
    kept.keep("d", lambda: "D")
    assert [kept.get(name) for name in "abcd"] == ["A", None, "C", "D"]
    assert kept.keep("a", lambda: "another") == "A"


def test_kept_cells_stay_few_under_many_threads() -> None:
    kept: KeptCells[int] = KeptCells(most=8)

    def work(start: int) -> None:
        for number in range(2000):
            name = str((start + number * 7) % 40)
            assert kept.keep(name, lambda name=name: int(name)) == int(name)  # type: ignore[misc]

    threads = [threading.Thread(target=work, args=(start,)) for start in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sum(kept.get(str(number)) is not None for number in range(40)) == 8


def test_a_service_keeps_a_stated_number_of_cells() -> None:
    service = make_gmc(FOLDER)
    assert service.capabilities()["cells"] == MOST_CELLS
    names = [service.register(square_fibre(0.3 + 0.004 * number)).cell for number in range(MOST_CELLS + 1)]
    assert len(set(names)) == MOST_CELLS + 1
    with pytest.raises(ProtocolError) as caught:
        service.evaluate(query(names[0], 1))
    assert caught.value.code == "unknown_cell"
    assert service.evaluate(query(names[-1], 1)).stress.any()
    assert service.register(square_fibre(0.3)).cell == names[0]


# --- the front, with workers of this process ---------------------------------------------------------------------


class Threads(Executor):
    """Services of this process that take parts in turn; each knows only what it was told."""

    def __init__(self, workers: int) -> None:
        self.services = [MicromechanicsService("gmc_service", "gmc") for _ in range(workers)]
        self.registered = 0
        self.sizes: list[int] = []

    @property
    def workers(self) -> int:
        return len(self.services)

    def capabilities(self) -> Capabilities:
        return self.services[0].capabilities()

    def run(self, jobs: list[Job], look: Any) -> None:
        for number, job in enumerate(jobs):
            service = self.services[number % len(self.services)]
            if isinstance(job.request, m.LocaliseRequest):
                self.sizes.append(len(job.request.strain))
            try:
                job.answer = getattr(service, job.operation)(job.request)
            except ProtocolError as error:
                job.answer = error
                if error.code == "unknown_cell" and job.definition is not None:
                    service.register(job.definition)
                    self.registered += 1
                    job.answer = getattr(service, job.operation)(job.request)
            look(number)

    def close(self) -> None:
        pass


@pytest.mark.parametrize("workers", [1, 2, 3, 5])
def test_the_answer_does_not_depend_on_the_number_of_workers(workers: int) -> None:
    single, executor = make_gmc(FOLDER), Threads(workers)
    front = Front("gmc_service", executor)
    for cell in (square_fibre(), random_cell(5)):
        registered = front.register(cell)
        assert registered.cell == single.register(cell).cell
        request = query(registered.cell, 21_111)
        expected = single.evaluate(request)
        assert expected.tangents is not None and len(expected.tangents) > 1
        assert same_bits(front.evaluate(request), expected)
        bare = request.model_copy(update={"want_tangent": False})
        assert same_bits(front.evaluate(bare), single.evaluate(bare))
        state = request.model_copy(update={"failed": expected.failed, "history": expected.history})
        assert same_bits(front.evaluate(state), single.evaluate(state))
        fields = m.LocaliseRequest(**{name: getattr(request, name) for name in m.LocaliseRequest.model_fields})
        inside, wanted = front.localise(fields), single.localise(fields)
        assert inside.stress.tobytes() == wanted.stress.tobytes()
        assert inside.strain.tobytes() == wanted.strain.tobytes()
    assert executor.registered == 2 * (workers - 1)  # one made it, each other was told once


def test_a_small_query_is_one_part_and_a_large_one_many() -> None:
    assert [parts_of(points, 4) for points in (0, 1, 8191, 8192, 16_384, 1_000_000, 2_000_000)] == [1, 1, 1, 2, 4, 4, 8]
    assert [parts_of(points, 2, slow=True) for points in (0, 2047, 2048, 6000)] == [1, 1, 2, 2]
    cell = square_fibre()
    soft = [one.model_copy(update={"fracture_energy": 100.0}) for one in cell.materials]
    assert not is_slow(cell) and is_slow(cell.model_copy(update={"materials": soft}))
    assert is_slow(cell.model_copy(update={"phase": np.zeros((5, 4), np.int64)}))
    executor = Threads(4)
    front = Front("gmc_service", executor)
    name = front.register(square_fibre()).cell
    front.evaluate(query(name, 5000))
    assert executor.sizes == [5000]


def test_the_front_refuses_as_a_service_does() -> None:
    front = Front("gmc_service", Threads(2))
    name = front.register(square_fibre()).cell
    with pytest.raises(ProtocolError) as caught:
        front.evaluate(query("nobody", 1))
    assert (caught.value.code, caught.value.report.field) == ("unknown_cell", "cell")
    wrong = query(name, 20_000).model_copy(update={"failed": np.zeros((20_000, 2), np.uint8)})
    with pytest.raises(ProtocolError) as caught:
        front.evaluate(wrong)
    assert (caught.value.code, caught.value.report.field) == ("bad_field", "failed")
    with pytest.raises(ProtocolError) as caught:
        front.properties(m.CellPropertiesRequest(cell="nobody", temperature=300.0))
    assert caught.value.code == "unknown_cell"
    request = m.CellPropertiesRequest(cell=name, temperature=300.0)
    assert front.properties(request).stiffness[0, 0] > 1e11


def test_a_backend_with_a_state_has_no_workers() -> None:
    with pytest.raises(BackendError, match="holds a state"):
        find("continuum", "mpm_service").make_front(FOLDER, [], 2, None)
    with pytest.raises(BackendError, match="one of the two"):
        BACKEND.make_front(FOLDER, [], 2, "dask://127.0.0.1:1")
