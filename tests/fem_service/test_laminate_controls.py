"""Laminates over the role's messages: watched bricks, viscosity, control by dissipation, meshes that are given."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from laminate_requests import request, strong_cell

from fem_service.plane_mesh import open_hole
from fem_service.service import LaminateService
from protocol import micromechanics as m
from protocol import structure as s
from protocol.client import Client
from protocol.conformance_micromechanics import micromechanics_cell
from protocol.errors import ProtocolError
from protocol.messages import CheckpointReply, Empty, RestoreRequest
from protocol.server import running

YOUNG, STRENGTH, TOUGHNESS = 3e9, 50e6, 1250.0
COHESIVE = s.CohesiveConstants(
    stiffness=1e14, normal_strength=4e6, shear_strength=4e6, opening_toughness=50.0, sliding_toughness=100.0
)


def softening_cell(toughness: float = TOUGHNESS) -> m.RegisterCell:
    """One material with no contraction that softens in tension along axis 1 alone."""
    stiffness = YOUNG * np.diag([1.0, 1.0, 1.0, 0.5, 0.5, 0.5])
    material = m.CellMaterial(
        name="resin", temperatures=[300.0], stiffness=[stiffness.reshape(-1).tolist()], expansion=[[0.0] * 6],
        failures=[m.MaterialFailure(criterion="maximum_stress", tension=(STRENGTH, None, None))],
        fracture_energy=toughness,
    )  # fmt: skip
    return m.RegisterCell(
        heights=np.ones(1), widths=np.ones(1), phase=np.zeros((1, 1), np.int64), materials=[material], knock_down=1e-6
    )


def restored(service: LaminateService, saved: CheckpointReply) -> None:
    service.restore(RestoreRequest(step=saved.step, state={name: a.copy() for name, a in saved.state.items()}))


def bits(made: s.StructureAdvanced) -> dict[str, Any]:
    plain = {name: value for name, value in made.plain_values().items() if name not in ("seconds", "factorisations")}
    return {**plain, **{name: (array.shape, array.tobytes()) for name, array in made.array_values().items()}}


# --- watched bricks ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("angle", [0.0, np.pi / 2, np.pi / 6])
def test_the_mean_of_the_subcells_is_the_macroscopic_stress(
    laminate: LaminateService, cells: str, angle: float
) -> None:
    """In bricks some points of which have failed, with thermal stress, in any ply."""
    cell = micromechanics_cell()
    hot = cell.model_copy(update={"stress_free_temperature": 290.0})
    asked = request(cells, hot, quarter=False, lower_half=False, angles=[angle, 0.2])
    built = laminate.configure(asked)
    everywhere = list(range(len(built.bricks)))
    area = np.outer(cell.heights, cell.widths).reshape(-1)
    partly = 0
    for _ in range(5):
        made = laminate.advance(s.StructureAdvance(watched=everywhere))
        assert made.watched_strain is not None and made.watched_stress is not None
        assert made.watched_subcells is not None and made.watched_subcells.shape == (len(everywhere), 6, 6)
        mean = np.einsum("s,esi->ei", area / area.sum(), made.watched_subcells)
        assert mean == pytest.approx(made.watched_stress, abs=1e-9 * np.abs(made.watched_stress).max())
        state = laminate.checkpoint(Empty()).state["failed"].reshape(len(everywhere), 8, -1)
        partly += int((state != state[:, :1]).any(axis=(1, 2)).sum())
    assert partly > 10  # bricks whose points are in different states


def test_watched_strain_and_stress_are_those_of_a_bar_in_the_axes_of_its_ply(
    laminate: LaminateService, cells: str
) -> None:
    angle, plain = np.pi / 2, {"hole_diameter": None, "quarter": False, "lower_half": False}
    asked = request(cells, strong_cell(), **plain, mesh=s.PlateMesh(columns=3, rows=2), angles=[angle])
    built = laminate.configure(asked)
    made = laminate.advance(s.StructureAdvance(watched=[4, 0]))
    assert made.watched_strain is not None and made.watched_stress is not None
    stress = made.force / built.section
    assert made.watched_strain[:, 1] == pytest.approx([made.strain] * 2, rel=1e-9)
    wanted = np.zeros((2, 6))
    wanted[:, 1] = stress
    assert made.watched_stress == pytest.approx(wanted, abs=1e-8 * stress)


def test_without_watched_bricks_none_are_answered_and_a_wrong_one_is_named(
    laminate: LaminateService, cells: str
) -> None:
    laminate.configure(request(cells, strong_cell()))
    with pytest.raises(ProtocolError, match=r"watched\.1: there is no brick 24, only 0 to 23") as caught:
        laminate.advance(s.StructureAdvance(watched=[0, 24]))
    assert caught.value.report.field == "watched.1" and laminate.step == 0
    made = laminate.advance(s.StructureAdvance())
    assert made.watched_strain is None and made.watched_stress is None and made.watched_subcells is None


# --- energy ------------------------------------------------------------------------------------------------------


def test_work_of_an_elastic_plate_is_half_of_force_times_elongation(laminate: LaminateService, cells: str) -> None:
    for parts in ({}, {"quarter": False, "lower_half": False, "angles": [0.0, np.pi / 2, np.pi / 2, 0.0]}):
        laminate.configure(request(cells, strong_cell(), **parts))
        for _ in range(3):
            made = laminate.advance(s.StructureAdvance())
            assert made.work == pytest.approx(0.5 * made.force * made.strain * 8e-3, rel=1e-9)
            assert made.viscous_energy == 0.0


def test_viscosity_takes_energy_that_is_told_and_kept(laminate: LaminateService, cells: str) -> None:
    found = {}
    for viscosity in (0.0, 2e-3, 2e-2):
        steps = s.Increments(first=0.02, most=0.02, viscosity=viscosity)
        laminate.configure(request(cells, strong_cell(), cohesive=COHESIVE, increments=steps))
        for number in range(20):
            made = laminate.advance(s.StructureAdvance())
            if viscosity and number == 9:
                saved, before = laminate.checkpoint(Empty()), made.viscous_energy
        found[viscosity] = made
    assert found[0.0].viscous_energy == 0.0
    assert found[0.0].layer_damage[0] > 0.0 or found[0.0].force < found[2e-2].force
    assert 0.0 < found[2e-3].viscous_energy < found[2e-2].viscous_energy < 0.5 * found[2e-2].work
    assert 0.0 < before < found[2e-2].viscous_energy
    restored(laminate, saved)
    again = [laminate.advance(s.StructureAdvance()) for _ in range(10)][-1]
    assert bits(again) == bits(found[2e-2])


# --- control by dissipation --------------------------------------------------------------------------------------

LENGTH, WIDTH, THICKNESS, WAIST = 10e-3, 1e-3, 1e-3, 0.9e-3


def waisted(cells: str, dissipation: float | None, **changes: Any) -> s.StructureConfigure:
    """A bar with one square element at its waist, long enough to snap back when that one softens."""
    half = 0.5 * WAIST
    x = np.array([-5e-3, -3e-3, -1.2e-3, -half, half, 1.2e-3, 3e-3, 5e-3])
    y = 0.5 * np.array([WIDTH, WIDTH, WIDTH, WAIST, WAIST, WIDTH, WIDTH, WIDTH])
    nodes = np.concatenate([np.stack([x, -y], axis=-1), np.stack([x, y], axis=-1)])
    first = np.arange(7)
    elements = np.stack([first, first + 1, first + 9, first + 8], axis=-1)
    steps = s.Increments(first=0.1, most=0.1, least=1e-4, iterations=30, dissipation=dissipation)
    values = {
        "length": LENGTH, "width": WIDTH, "hole_diameter": None, "quarter": False, "lower_half": False,
        "angles": [0.0], "ply_thickness": THICKNESS, "plane_nodes": nodes, "plane_elements": elements,
        "final_strain": 0.02, "increments": steps, "mesh": s.PlateMesh(),
    }  # fmt: skip
    return request(cells, softening_cell(), **{**values, **changes})


def opened(stress: np.ndarray) -> np.ndarray:
    """Elongation of the softening element at the waist beyond that of an elastic one, m: its law in closed form."""
    onset, end = STRENGTH / YOUNG, 2.0 * TOUGHNESS / (WAIST * STRENGTH)
    strain = end - (end - onset) * stress / STRENGTH
    return np.asarray(WAIST * (strain - stress / YOUNG))


def test_a_bar_that_snaps_back_follows_its_closed_form(laminate: LaminateService, cells: str) -> None:
    area, whole = WAIST * THICKNESS, TOUGHNESS * WAIST * THICKNESS
    built = laminate.configure(waisted(cells, whole / 25))
    path, saved = [], None
    while not path or path[-1].force > 0.03 * max(made.force for made in path):
        path.append(laminate.advance(s.StructureAdvance()))
        if saved is None and len(path) > 1 and path[-1].load < path[-2].load:
            saved, place = laminate.checkpoint(Empty()), len(path)
        assert path[-1].residual <= 1e-6 and len(path) < 80
    force, moved = np.array([(made.force, LENGTH * made.strain) for made in path]).T
    assert built.section == pytest.approx(WIDTH * THICKNESS, rel=1e-12)
    assert force.max() == pytest.approx(STRENGTH * area, rel=0.05)  # the increment next to the peak
    assert moved[-1] < 0.5 * moved.max()  # it has snapped back
    after = int(np.argmax(force)) + 1
    assert len(path) - after >= 20
    compliance = moved[0] / force[0]
    # The waist of the bricks feels a little of the wider ones beside it.
    softening = slice(after, len(path) - 1)  # the last one may be beyond, where nothing holds any more
    wanted = compliance * force[softening] + opened(force[softening] / area)
    assert moved[softening] == pytest.approx(wanted, rel=0.02)
    taken = 0.5 * (force[:-1] * moved[1:] - force[1:] * moved[:-1])
    own = np.array([made.halved == 0 for made in path[1:]])[after:]
    own[-1] = False
    assert own.sum() >= 18
    assert taken[after:][own] == pytest.approx(np.full(own.sum(), whole / 25), rel=1e-4)
    # All but what the last 3 % of the force still hold is the toughness of the broken section.
    assert path[-1].work - 0.5 * force[-1] * moved[-1] == pytest.approx(whole, rel=0.03)
    assert saved is not None
    restored(laminate, saved)
    assert [bits(laminate.advance(s.StructureAdvance())) for _ in range(4)] == [bits(made) for made in path[place:][:4]]


def test_an_increment_by_dissipation_keeps_within_the_largest_change_of_load(
    laminate: LaminateService, cells: str
) -> None:
    laminate.configure(waisted(cells, TOUGHNESS * WAIST * THICKNESS / 4))
    loads = [0.0]
    while len(loads) < 20 or loads[-1] > loads[-2]:
        loads.append(laminate.advance(s.StructureAdvance(largest=0.06)).load)
    loads += [laminate.advance(s.StructureAdvance(largest=0.06)).load for _ in range(4)]
    assert np.abs(np.diff(loads)).max() <= 0.06 * (1 + 1e-9) and min(np.diff(loads)) < -0.01


@pytest.mark.parametrize(
    ("cell", "changes", "sentence"),
    [
        (micromechanics_cell(), {}, r"materials\.1 \(matrix\) has no fracture_energy"),
        (strong_cell(), {"temperature": 310.0}, "temperature is not stress_free_temperature"),
    ],
)
def test_dissipation_that_cannot_be_prescribed_is_refused(
    laminate: LaminateService, cells: str, cell: m.RegisterCell, changes: dict[str, Any], sentence: str
) -> None:
    steps = s.Increments(first=0.1, most=0.1, dissipation=1e-3)
    with pytest.raises(ProtocolError, match=sentence) as caught:
        laminate.configure(request(cells, cell, increments=steps, **changes))
    assert (caught.value.code, caught.value.report.field) == ("bad_field", "increments.dissipation")
    laminate.configure(request(cells, micromechanics_cell(), increments=steps, damage="none"))


# --- meshes that are given ---------------------------------------------------------------------------------------


def test_a_given_mesh_is_the_made_one(laminate: LaminateService, cells: str) -> None:
    """All but rounding: nodes at a side are set on it."""
    plane = open_hole(8e-3, 8e-3, 3e-3, around=4, radial=3, growth=3.0, quadrant=True)
    given = {"plane_nodes": plane.nodes, "plane_elements": plane.elements, "mesh": s.PlateMesh()}
    found = []
    for changes in ({}, given, {**given, "hole_diameter": None}):
        built = laminate.configure(request(cells, micromechanics_cell(), **changes))
        found.append((built, [laminate.advance(s.StructureAdvance()) for _ in range(5)]))
    for built, made in found[1:]:
        assert built.nodes == pytest.approx(found[0][0].nodes, abs=1e-17)
        assert np.array_equal(built.bricks, found[0][0].bricks)
        assert [one.force for one in made] == pytest.approx([one.force for one in found[0][1]], rel=1e-12)
        assert [one.new_failures.tolist() for one in made] == [one.new_failures.tolist() for one in found[0][1]]
    assert np.sum([one.new_failures for one in found[0][1]]) > 0


def test_an_element_turned_inside_out_at_the_hole_is_refused_with_its_number(folder: Path, cells: str) -> None:
    """Over a socket; the laminate that there was stays."""
    plane = open_hole(8e-3, 8e-3, 3e-3, around=4, radial=3, growth=3.0, quadrant=True)
    nodes = plane.nodes.copy()
    on_hole = np.flatnonzero(np.isclose(np.hypot(*nodes.T), 1.5e-3))
    bad = int(on_hole[2])
    nodes[bad] *= 2.0
    given = {"plane_elements": plane.elements, "mesh": s.PlateMesh()}
    own = np.flatnonzero((plane.elements == bad).any(axis=1))
    with running(LaminateService(), f"ipc://{folder}/given") as server:
        client = Client.connect(server.endpoint, "structure")
        client.call("configure", request(cells, strong_cell()), s.StructureConfigured)
        with pytest.raises(ProtocolError) as caught:
            wrong = request(cells, strong_cell(), plane_nodes=nodes, **given)
            client.call("configure", wrong, s.StructureConfigured)
        assert (caught.value.code, caught.value.report.field) == ("bad_field", "plane_elements")
        assert any(f"element {number} " in str(caught.value) for number in own), str(caught.value)
        assert client.call("advance", s.StructureAdvance(), s.StructureAdvanced).step == 1
        client.close()


# --- hard cases --------------------------------------------------------------------------------------------------


def test_one_increment_for_the_whole_load_ends_where_small_ones_end(laminate: LaminateService, cells: str) -> None:
    """A hundred times too large: what fails at once in a cascade depends on the increments, so both are told apart."""
    ends, failures = {}, {}
    for size in (0.01, 1.0):
        steps = s.Increments(first=size, most=size)
        laminate.configure(request(cells, micromechanics_cell(), increments=steps))
        made = [laminate.advance(s.StructureAdvance())]
        while made[-1].load < 1.0:
            made.append(laminate.advance(s.StructureAdvance()))
        ends[size], failures[size] = made[-1], np.sum([one.new_failures for one in made], axis=0)
        assert made[-1].load == 1.0 and all(one.residual <= 1e-6 for one in made)
    assert failures[0.01].sum() > 100
    assert ends[1.0].force == pytest.approx(ends[0.01].force, rel=0.01)
