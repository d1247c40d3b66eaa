"""The role `continuum` with the law `laminate`: a micromechanics service behind a real socket at every point."""

from __future__ import annotations

import itertools
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zmq
from laminate_cell import CELL_FILE

from gmc_service.service import make_gmc, read_definition
from mpm_service.service import MaterialPointService
from protocol import continuum as c
from protocol.errors import ProtocolError
from protocol.laminate_material import CellDefinition
from protocol.messages import Empty, FieldsRequest, RestoreRequest
from protocol.micromechanics import MaterialPlasticity, RegisterCell
from protocol.security import make_keys
from protocol.server import running

NAMES = itertools.count()


@pytest.fixture(scope="module")
def folder() -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="scalebridge-") as name:
        yield Path(name)


@pytest.fixture(scope="module")
def cells(folder: Path) -> Iterator[str]:
    """Endpoint of a micromechanics service."""
    with running(make_gmc(folder), f"ipc://{folder}/cells") as server:
        yield server.endpoint


@pytest.fixture
def points() -> Iterator[MaterialPointService]:
    service = MaterialPointService()
    yield service
    service.close()


def cell() -> RegisterCell:
    return read_definition(CELL_FILE)


def request(cells: str, definition: RegisterCell | None = None, **changes: Any) -> c.ContinuumConfigure:
    """A quarter of a cross-ply with a hole, 8 x 8 cells, pulled fast along x."""
    values: dict[str, Any] = {
        "assumption": "plane_stress",
        "thickness": 1e-3,
        "body": c.Rectangle(lower=(0.0, 0.0), upper=(4e-3, 4e-3)),
        "cell_size": 5e-4,
        "points_per_cell": 2,
        "holes": [c.Hole(centre=(0.0, 0.0), radius=1.5e-3)],
        "material": c.LaminateMaterial(
            angles=[0.0, np.pi / 2], density=1600.0, cell=CellDefinition.of(definition or cell()), micromechanics=cells
        ),
        "edges": [
            c.EdgeSymmetry(edge="left"),
            c.EdgeSymmetry(edge="bottom"),
            c.EdgeCondition(edge="right", component=0, times=[0.0, 2e-5], displacements=[0.0, 2e-4]),
        ],
        "initial_velocity_gradient": (2500.0, 0.0, 0.0, 0.0),
        "time_step": 4e-8,
    }
    return c.ContinuumConfigure(**{**values, **changes})


def bits(service: MaterialPointService) -> dict[str, np.ndarray]:
    return service.checkpoint(Empty()).state


def same(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> bool:
    return one.keys() == other.keys() and all(np.array_equal(one[name], other[name]) for name in one)


def test_definition_is_the_request_that_registers_a_cell() -> None:
    definition = CellDefinition.of(cell())
    assert set(CellDefinition.model_fields) == set(RegisterCell.model_fields)
    back = definition.request()
    assert back.plain_values() == cell().plain_values()
    assert all(np.array_equal(back.array_values()[name], value) for name, value in cell().array_values().items())


def test_definition_with_phases_that_do_not_fit_is_refused() -> None:
    plain = CellDefinition.of(cell()).model_dump()
    with pytest.raises(ValueError, match="2 rows of 2"):
        CellDefinition.model_validate({**plain, "phase": [[0, 1]]})
    with pytest.raises(ValueError, match="holds 7, allowed is 0 to 1"):
        CellDefinition.model_validate({**plain, "phase": [[0, 1], [1, 7]]})


def test_plate_fails_and_tells_of_it(points: MaterialPointService, cells: str) -> None:
    configured = points.configure(request(cells))
    events, queried, spared = [], 0, 0
    for _ in range(50):
        made = points.advance(c.ContinuumAdvance(steps=10))
        events += made.events
        queried, spared = queried + made.queried, spared + made.spared
    told = [event.sentence.split(" plies")[0] for event in events if event.kind == "failure"]
    assert told[0] in ("matrix fails first in the 90 degree", "matrix fails first in the 0 degree")
    assert len(set(told)) == len(told) >= 3
    assert queried > 0 and spared > 0 and queried + spared == 500 * 2 * len(configured.position)
    failed = points.fields(FieldsRequest(names=["failed"])).fields["failed"]
    assert failed.shape == (len(configured.position), 2, 2)
    assert failed.max() == 1.0 and failed.min() == 0.0
    assert made.dissipated_energy > 0.0
    balance = made.kinetic_energy + made.strain_energy + made.dissipated_energy + (made.filter_loss or 0.0)
    start = 0.5 * 1600.0 * 1e-3 * 2500.0**2 * _second_moment()
    assert balance - start == pytest.approx(made.edge_work, rel=5e-3)


def _second_moment() -> float:
    """Integral of x^2 over the quarter plate less its quarter of the hole [m^4]."""
    return 4e-3**4 / 3.0 - np.pi * 1.5e-3**4 / 16.0


def softening() -> RegisterCell:
    """The cell with a matrix that softens."""
    found = [
        material.model_copy(update={"fracture_energy": 5e3} if material.name == "matrix" else {})
        for material in cell().materials
    ]
    return cell().model_copy(update={"materials": found})


@pytest.mark.parametrize("definition", [cell, softening])
def test_run_goes_on_bit_for_bit_from_a_checkpoint(
    points: MaterialPointService, cells: str, definition: Callable[[], RegisterCell]
) -> None:
    points.configure(request(cells, definition()))
    points.advance(c.ContinuumAdvance(steps=300))
    kept = points.checkpoint(Empty())
    points.advance(c.ContinuumAdvance(steps=100))
    other = MaterialPointService()
    other.configure(request(cells, definition()))
    other.restore(RestoreRequest(step=kept.step, state=kept.state))
    ahead = other.advance(c.ContinuumAdvance(steps=100))
    assert same(bits(points), bits(other))
    told = [event.sentence for event in ahead.events]
    assert definition is softening or not any("90 degree" in sentence for sentence in told)  # before the checkpoint
    assert ahead.dissipated_energy > 0.0
    other.close()


def test_a_micromechanics_service_started_anew_changes_no_bit(points: MaterialPointService, folder: Path) -> None:
    endpoint = f"ipc://{folder}/anew-{next(NAMES)}"
    other = MaterialPointService()
    with running(make_gmc(folder), endpoint):
        for one in (points, other):
            one.configure(request(endpoint))
        other.advance(c.ContinuumAdvance(steps=300))
        points.advance(c.ContinuumAdvance(steps=150))
    with running(make_gmc(folder), endpoint):
        points.advance(c.ContinuumAdvance(steps=150))
    assert same(bits(points), bits(other))
    other.close()


def test_static_preload_is_the_linear_answer(points: MaterialPointService, cells: str) -> None:
    """Force of the drawn edge at rest, from the work: twice the strain energy over the displacement."""
    drawn = c.EdgeCondition(edge="right", component=0, times=[0.0, 1.0], displacements=[4e-7, 4e-7])
    edges = [c.EdgeSymmetry(edge="left"), c.EdgeSymmetry(edge="bottom"), drawn]
    preload = c.Preload(tolerance=1e-9, max_steps=30, method="static")
    configured = points.configure(request(cells, edges=edges, preload=preload, initial_velocity_gradient=None))
    assert configured.relaxation is not None and configured.relaxation.converged
    made = points.advance(c.ContinuumAdvance(steps=1))
    assert made.edge_force[2] == pytest.approx(2.0 * made.strain_energy / 4e-7, rel=1e-3)
    assert made.queried == 0


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"assumption": "plane_strain"}, "assumption"),
        ({"holes": [c.Hole(centre=(9.0, 9.0), radius=1e-3)]}, "holes"),
        ({"time_step": 1e-6}, "time_step"),
    ],
)
def test_what_cannot_be_is_refused_and_the_body_before_stays(
    points: MaterialPointService, cells: str, changes: dict[str, Any], field: str
) -> None:
    points.configure(request(cells))
    with pytest.raises(ProtocolError) as caught:
        points.configure(request(cells, **changes))
    assert caught.value.code == "bad_field" and caught.value.report.field == field
    assert points.advance(c.ContinuumAdvance(steps=10)).step == 10


def test_cells_that_yield_are_refused(points: MaterialPointService, cells: str) -> None:
    first, *others = cell().materials
    yielding = first.model_copy(update={"plasticity": MaterialPlasticity(yield_stress=1e8)})
    with pytest.raises(ProtocolError, match=r"material\.cell\.materials\.0\.plasticity"):
        points.configure(request(cells, cell().model_copy(update={"materials": [yielding, *others]})))


def test_no_service_there(points: MaterialPointService, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mpm_service.service.CONNECT_SECONDS", 0.2)
    with pytest.raises(ProtocolError, match="micromechanics") as caught:
        points.configure(request(f"ipc://{folder}/nobody"))
    assert caught.value.report.field == "material.micromechanics"
    with pytest.raises(ProtocolError, match="is no endpoint"):
        points.configure(request("nonsense"))


@pytest.mark.skipif(not zmq.has("curve"), reason="this libzmq has no CURVE")
def test_keys_reach_the_link(
    points: MaterialPointService, tmp_path: Path, cells: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A micromechanics service over TCP that takes clients with keys alone: with them same bits, without them named."""
    make_keys(tmp_path / "own")
    points.configure(request(cells))
    points.advance(c.ContinuumAdvance(steps=20))
    expected = bits(points)
    with running(make_gmc(tmp_path), "tcp://127.0.0.1:*", keys=tmp_path / "own") as server:
        monkeypatch.setattr("mpm_service.service.CONNECT_SECONDS", 2.0)
        with pytest.raises(ProtocolError) as caught:
            points.configure(request(server.endpoint))
        assert (caught.value.code, caught.value.report.field) == ("bad_field", "material.micromechanics")
        points.link_keys = tmp_path / "nothing"
        with pytest.raises(ProtocolError, match=r"material\.micromechanics: no secret key"):
            points.configure(request(server.endpoint))
        points.link_keys = tmp_path / "own"
        points.configure(request(server.endpoint))
        points.advance(c.ContinuumAdvance(steps=20))
        assert same(bits(points), expected)
        points.close()
