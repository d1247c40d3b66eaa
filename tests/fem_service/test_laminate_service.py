"""The role `structure` on the real solver, with a real micromechanics service behind a real socket."""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from laminate_requests import request, strong_cell

import fem_service.service
from fem_service.cell_client import CellClient
from fem_service.service import LaminateService
from gmc_service.service import make_gmc
from protocol import micromechanics as m
from protocol import structure as s
from protocol.client import Client
from protocol.conformance_micromechanics import micromechanics_cell
from protocol.errors import ProtocolError
from protocol.messages import CheckpointReply, Empty, FieldsRequest, Message, RestoreRequest
from protocol.server import running
from protocol.service import Service

FIELDS = ["displacement", "stress", "failed", "layer_damage"]
NAMES = itertools.count()


def plate(cells: str, angles: list[float], cell: m.RegisterCell | None = None, **changes: Any) -> s.StructureConfigure:
    """A whole plate without a hole."""
    mesh = s.PlateMesh(columns=3, rows=2)
    plain = {"hole_diameter": None, "mesh": mesh, "quarter": False, "lower_half": False, "angles": angles}
    return request(cells, cell, **{**plain, **changes})


def curve(service: LaminateService, increments: int) -> list[s.StructureAdvanced]:
    return [service.advance(s.StructureAdvance()) for _ in range(increments)]


def bits(found: Message, *without: str) -> dict[str, Any]:
    """All that a reply holds, bit by bit, without times and running counts."""
    left_out = {"seconds", "factorisations", *without}
    plain = {name: value for name, value in found.plain_values().items() if name not in left_out}
    arrays = {name: (array.shape, array.tobytes()) for name, array in found.array_values().items()}
    return {**plain, **arrays}


def fields(service: LaminateService) -> dict[str, Any]:
    return bits(service.fields(FieldsRequest(names=FIELDS)))


def go_on(service: LaminateService, increments: int) -> list[dict[str, Any]]:
    return [bits(made) for made in curve(service, increments)] + [fields(service)]


def restored(service: LaminateService, saved: CheckpointReply) -> None:
    state = {name: array.copy() for name, array in saved.state.items()}
    assert service.restore(RestoreRequest(step=saved.step, state=state)).step == saved.step


def raised(call: Callable[[], object]) -> ProtocolError:
    with pytest.raises(ProtocolError) as caught:
        call()
    return caught.value


# --- what it answers ---------------------------------------------------------------------------------------------


def test_replies_fit_the_laminate(laminate: LaminateService, cells: str) -> None:
    cohesive = s.CohesiveConstants(
        stiffness=1e14, normal_strength=6e7, shear_strength=8e7, opening_toughness=200.0, sliding_toughness=600.0
    )
    built = laminate.configure(request(cells, cohesive=cohesive))
    bricks = 2 * 4 * 3
    assert built.bricks.shape == (bricks, 8) and built.points == 8 * bricks
    assert np.bincount(built.ply).tolist() == [12, 12]
    assert built.layers.shape == (12, 8) and not built.interface.any()
    assert built.section == pytest.approx(8e-3 * 4 * 2.5e-4, rel=1e-12)
    made = curve(laminate, 4)
    assert [one.step for one in made] == [1, 2, 3, 4]
    assert [one.load for one in made] == pytest.approx([0.1, 0.2, 0.3, 0.4], rel=1e-9)
    assert made[3].strain == pytest.approx(1.5e-2 * made[3].load, rel=1e-12)
    assert made[0].new_failures.shape == (2, 2) and made[0].layer_damage.shape == (1,)
    assert all(one.residual <= 1e-6 for one in made)
    assert set(made[0].seconds) == {"assembly", "solution", "micromechanics", "wire", "other"}
    found = laminate.fields(FieldsRequest(names=FIELDS)).fields
    assert found["displacement"].shape == built.nodes.shape
    assert found["stress"].shape == (bricks, 6)
    assert found["failed"].shape == (bricks, 2)
    assert found["layer_damage"].shape == (12,)
    total = np.sum([one.new_failures for one in made], axis=0)
    assert total.sum() > 0 and not total[:, 0].any()  # the fibre has no strength, so it holds for ever
    # Two of six subcells are fibre, so four of each of eight points can fail in a brick.
    by_ply = np.bincount(built.ply, found["failed"][:, 1]) * 8 * 4
    assert by_ply == pytest.approx(total[:, 1])


def test_one_ply_along_the_fibre_has_the_stiffness_of_its_cell(laminate: LaminateService, cells: str) -> None:
    compliance = np.linalg.inv(plane_stress_stiffness())
    for angle, axis in ((0.0, 0), (np.pi / 2, 1)):
        built = laminate.configure(plate(cells, [angle], strong_cell()))
        made = curve(laminate, 2)[-1]
        young = 1.0 / compliance[axis, axis]
        assert made.force / built.section / made.strain == pytest.approx(young, rel=1e-9)


def test_an_unsymmetric_layup_curls_as_laminate_theory_has_it(laminate: LaminateService, cells: str) -> None:
    """The ends stay straight along x, so it curls across its width alone."""
    thick, young = 1e-3, plane_stress_stiffness()
    turned = young[::-1, ::-1]
    extension = thick * (young + turned)
    coupling = 0.5 * thick**2 * (turned - young)
    bending = thick**3 / 3.0 * (young + turned)
    across = np.array([[extension[1, 1], coupling[1, 1]], [coupling[1, 1], bending[1, 1]]])
    strain_y, curvature = np.linalg.solve(across, -np.array([extension[0, 1], coupling[0, 1]]))
    stress = (extension[0, 0] + extension[0, 1] * strain_y + coupling[0, 1] * curvature) / (2 * thick)
    mesh = s.PlateMesh(columns=2, rows=40, bricks_per_ply=4)
    asked = plate(cells, [0.0, np.pi / 2], strong_cell(), width=1.6e-2, ply_thickness=thick, mesh=mesh)
    built = laminate.configure(asked)
    made = curve(laminate, 1)[0]
    assert made.force / built.section / made.strain == pytest.approx(stress, rel=1e-3)
    moved = laminate.fields(FieldsRequest(names=["displacement"])).fields["displacement"]
    inner = (built.nodes[:, 0] == 0.0) & (np.abs(built.nodes[:, 1]) < 5e-3)  # free edges curl a little more
    middle = inner & (np.abs(built.nodes[:, 2] - thick) < 1e-9)
    bend = -2.0 * np.polyfit(built.nodes[middle, 1], moved[middle, 2], 2)[0] / made.strain
    assert bend == pytest.approx(curvature, rel=1e-2)
    assert abs(bend) * 1.6e-2 > 0.1  # the edges turn by a tenth of the elongation and more


def plane_stress_stiffness() -> np.ndarray:
    """Of a ply of the strong cell, along the fibre and across it, Pa."""
    gmc = make_gmc(Path("."))
    name = gmc.register(strong_cell()).cell
    stiffness = gmc.properties(m.CellPropertiesRequest(cell=name, temperature=300.0)).stiffness
    return np.asarray(np.linalg.inv(np.linalg.inv(stiffness)[:2, :2]))


def test_planes_of_symmetry_change_no_force(laminate: LaminateService, cells: str) -> None:
    """Through first failures: one eighth, the lower half, the quarter and the whole plate."""
    forces = []
    cross, whole = [0.0, np.pi / 2], [0.0, np.pi / 2, np.pi / 2, 0.0]
    for quarter, half in itertools.product((True, False), repeat=2):
        increments = s.Increments(first=0.1, most=0.1, tolerance=1e-10)
        asked = request(cells, quarter=quarter, lower_half=half, angles=cross if half else whole, increments=increments)
        laminate.configure(asked)
        made = curve(laminate, 4)
        assert sum(one.new_failures.sum() for one in made) > 0
        forces.append([one.force for one in made])
    assert np.array(forces[1:]) == pytest.approx(np.array([forces[0]] * 3), rel=1e-8)


def test_points_that_are_spared_change_no_bit(
    laminate: LaminateService, cells: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    laminate.configure(request(cells))
    first = curve(laminate, 5)
    assert first[0].spared > 0 and sum(one.new_failures.sum() for one in first) > 0
    seen = fields(laminate)
    monkeypatch.setattr(fem_service.service, "CellClient", partial(CellClient, spare=False))
    laminate.configure(request(cells))
    second = curve(laminate, 5)
    assert not any(one.spared for one in second)
    assert [bits(one, "queried", "spared") for one in second] == [bits(one, "queried", "spared") for one in first]
    assert fields(laminate) == seen


# --- checkpoints -------------------------------------------------------------------------------------------------


def test_a_restored_laminate_goes_on_with_the_same_bits(laminate: LaminateService, cells: str) -> None:
    laminate.configure(request(cells))
    curve(laminate, 2)
    saved = laminate.checkpoint(Empty())
    before = fields(laminate)
    expected = go_on(laminate, 3)
    assert any(np.frombuffer(one["new_failures"][1], np.int64).any() for one in expected[:-1])
    restored(laminate, saved)
    assert fields(laminate) == before and laminate.step == 2
    assert go_on(laminate, 3) == expected
    other = LaminateService()
    other.configure(request(cells))
    restored(other, saved)
    assert go_on(other, 3) == expected
    other.close()


def test_a_state_that_does_not_fit_is_refused_and_changes_nothing(laminate: LaminateService, cells: str) -> None:
    laminate.configure(request(cells))
    curve(laminate, 1)
    saved, before = laminate.checkpoint(Empty()), fields(laminate)
    stress = saved.state["stress"].copy()
    stress[0, 0, 0] = np.nan
    for state, step, field in (
        ({**saved.state, "failed": saved.state["failed"][:-1]}, 1, "state"),
        ({**saved.state, "displacement": saved.state["displacement"].astype("<f4")}, 1, "state"),
        ({name: array for name, array in saved.state.items() if name != "history"}, 1, "state"),
        ({**saved.state, "stress": stress}, 1, "state"),
        ({**saved.state, "numbers": saved.state["numbers"] * np.array([20.0, *np.ones(7)])}, 1, "state"),
        (saved.state, 2, "step"),
    ):
        asked = RestoreRequest.model_construct(step=step, state=state)
        error = raised(lambda asked=asked: laminate.restore(asked))  # type: ignore[misc]
        assert (error.code, error.report.field) == ("bad_field", field)
    assert fields(laminate) == before and laminate.step == 1


# --- what it refuses ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "field", "sentence"),
    [
        ({"mesh": s.PlateMesh(radial=3)}, "mesh.around", "a plate with a hole or notches needs it"),
        ({"mesh": s.PlateMesh(around=4)}, "mesh.radial", "a plate with a hole or notches needs it"),
        ({"mesh": s.PlateMesh(around=3, radial=3)}, "mesh", "around is 3; it must be even"),
        ({"mesh": s.PlateMesh(around=4, radial=3, beyond=2)}, "mesh", "beyond is 2; it must be 0"),
        ({"hole_diameter": 9e-3}, "mesh", "diameter is 0.009 m"),
        ({"hole_diameter": None}, "mesh.columns", "a plate without a hole needs it"),
        ({"angles": [0.0, 0.5]}, "quarter", "planes of symmetry"),
        ({"micromechanics": "nowhere"}, "micromechanics", "'nowhere' is no endpoint"),
    ],
)
def test_what_cannot_be_meshed_or_reached_is_named(
    laminate: LaminateService, cells: str, changes: dict[str, Any], field: str, sentence: str
) -> None:
    laminate.configure(plate(cells, [0.0]))
    curve(laminate, 1)
    before = fields(laminate)
    error = raised(lambda: laminate.configure(request(cells, **changes)))
    assert (error.code, error.report.field) == ("bad_field", field)
    assert sentence in str(error)
    assert fields(laminate) == before and laminate.step == 1


def test_a_micromechanics_service_that_is_not_there_is_named(
    laminate: LaminateService, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fem_service.service, "CONNECT_SECONDS", 0.3)
    error = raised(lambda: laminate.configure(request(f"ipc://{folder}/nobody")))
    assert (error.code, error.report.field) == ("bad_field", "micromechanics")
    assert "within 0.3 s" in str(error)


def test_a_cell_that_the_micromechanics_service_refuses_is_named(laminate: LaminateService, cells: str) -> None:
    materials = [
        one.model_copy(
            update={
                "temperatures": [300.0, 400.0], "stiffness": 2 * one.stiffness, "expansion": 2 * one.expansion,
            }
        )
        for one in micromechanics_cell().materials
    ]  # fmt: skip
    cell = micromechanics_cell().model_copy(update={"materials": materials})
    error = raised(lambda: laminate.configure(request(cells, cell, temperature=1000.0)))
    assert (error.code, error.report.field) == ("bad_field", "temperature")


def test_without_equilibrium_above_the_least_increment_it_says_where(laminate: LaminateService, cells: str) -> None:
    laminate.configure(request(cells, increments=s.Increments(first=0.5, most=0.5, least=0.4, iterations=2)))
    error = raised(lambda: curve(laminate, 2))
    assert (error.code, error.report.field) == ("solver_failed", "increments")
    assert "the increment is below the least, 0.4" in str(error)


@pytest.mark.filterwarnings("ignore:overflow encountered", "ignore:invalid value encountered")
def test_a_strain_beyond_all_numbers_is_a_failed_solver_and_never_nan(folder: Path, cells: str) -> None:
    with running(LaminateService(), f"ipc://{folder}/huge") as server:
        client = Client.connect(server.endpoint, "structure")
        client.call("configure", request(cells, final_strain=1e300), s.StructureConfigured)
        error = raised(lambda: client.call("advance", s.StructureAdvance(), s.StructureAdvanced))
        assert error.code == "solver_failed"
        client.close()


def test_the_end_of_the_load_is_met_exactly_and_nothing_follows(laminate: LaminateService, cells: str) -> None:
    laminate.configure(plate(cells, [0.0], strong_cell(), increments=s.Increments(first=0.3, most=0.7)))
    made = curve(laminate, 3)
    assert made[-1].load == 1.0 and made[-1].strain == 1.5e-2
    assert raised(lambda: curve(laminate, 1)).report.field == "largest"


def test_an_increment_is_not_larger_than_asked(laminate: LaminateService, cells: str) -> None:
    laminate.configure(plate(cells, [0.0], strong_cell()))
    assert laminate.advance(s.StructureAdvance(largest=0.013)).load == pytest.approx(0.013, rel=1e-12)


def test_all_matrix_failed_at_once_still_finds_its_equilibrium(laminate: LaminateService, cells: str) -> None:
    """One increment a hundred times too large."""
    laminate.configure(request(cells, final_strain=0.3, increments=s.Increments(first=1.0, most=1.0)))
    made = curve(laminate, 1)[0]
    assert made.load == 1.0 and made.residual <= 1e-6
    assert made.new_failures[:, 1].tolist() == [12 * 8 * 4, 12 * 8 * 4]


# --- the service behind it ---------------------------------------------------------------------------------------


class Slow(Service):
    """A micromechanics service that takes its time over queries."""

    role = "micromechanics"
    backend = "slow"
    backend_version = "1"

    def __init__(self, inner: Service) -> None:
        super().__init__()
        self.inner = inner
        self.queries = 0
        self.wait = 0.0

    @property
    def step(self) -> int:
        return 0

    def capabilities(self) -> Any:
        return self.inner.capabilities()

    def __getattr__(self, name: str) -> Any:
        return getattr(self.inner, name)

    def evaluate(self, asked: m.EvaluateRequest) -> m.Evaluated:
        self.queries += 1
        end = time.monotonic() + self.wait
        while time.monotonic() < end:
            self.activity.progress(0, 1)
            time.sleep(0.02)
        found: m.Evaluated = self.inner.evaluate(asked)  # type: ignore[attr-defined]
        return found


def test_abort_ends_a_wait_for_the_micromechanics_at_once(folder: Path) -> None:
    slow = Slow(make_gmc(folder))
    with running(slow, f"ipc://{folder}/slow") as cells:
        service = LaminateService()
        service.configure(request(cells.endpoint))
        service.activity.begin("advance")
        slow.wait = 20.0
        timer = threading.Timer(0.5, service.activity.abort.set)
        timer.start()
        began = time.monotonic()
        error = raised(lambda: curve(service, 5))
        timer.join()
        assert error.code == "aborted"
        assert time.monotonic() - began < 10.0
        service.close()


def test_abort_ends_a_wait_for_a_service_that_is_not_there(folder: Path, laminate: LaminateService) -> None:
    laminate.activity.begin("configure")
    timer = threading.Timer(0.3, laminate.activity.abort.set)
    timer.start()
    began = time.monotonic()
    assert raised(lambda: laminate.configure(request(f"ipc://{folder}/nobody"))).code == "aborted"
    assert time.monotonic() - began < 10.0
    timer.join()


def test_a_micromechanics_service_started_anew_in_mid_run_changes_no_bit(
    folder: Path, cells: str, laminate: LaminateService
) -> None:
    laminate.configure(request(cells))
    expected = go_on(laminate, 5)
    endpoint = f"ipc://{folder}/restarted"
    with running(make_gmc(folder), endpoint):
        laminate.configure(request(endpoint))
        made = [bits(one) for one in curve(laminate, 2)]
    with running(make_gmc(folder), endpoint):  # it knows no cell
        made += go_on(laminate, 3)
    assert made == expected


def test_a_cell_that_was_forgotten_is_registered_again(folder: Path, cells: str, laminate: LaminateService) -> None:
    laminate.configure(request(cells))
    expected = go_on(laminate, 5)
    slow = Slow(make_gmc(folder))
    with running(slow, f"ipc://{folder}/forgetful") as forgetful:
        laminate.configure(request(forgetful.endpoint))
        made = [bits(one) for one in curve(laminate, 2)]
        slow.inner = make_gmc(folder)
        assert made + go_on(laminate, 3) == expected


def test_a_micromechanics_service_that_stays_away_fails_the_solver(
    folder: Path, laminate: LaminateService, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fem_service.service, "CONNECT_SECONDS", 0.3)
    monkeypatch.setattr("protocol.client.LINK_GRACE_SECONDS", 0.3)
    with running(make_gmc(folder), f"ipc://{folder}/gone"):
        laminate.configure(request(f"ipc://{folder}/gone"))
        curve(laminate, 1)
    error = raised(lambda: curve(laminate, 4))
    assert (error.code, error.report.field) == ("solver_failed", "micromechanics")
