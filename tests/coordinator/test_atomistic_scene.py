"""What a scene may say of its atoms: keys, mistakes, and the requests that follow from them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from coordinator.atom_measurements import AtomMeasurements
from coordinator.atomistic_request import (
    check_extent,
    configure_request,
    equilibrate_request,
    grid_request,
    register_request,
)
from coordinator.frame import Frame
from coordinator.handshake import HandshakeError
from coordinator.interface import build_interface
from coordinator.region import Region
from coordinator.ring import rectangle_ring
from coordinator.scene import Place, Scene, SceneError, load_scene, read_resolved
from protocol import atomistic as a
from protocol.errors import ProtocolError
from protocol.messages import FieldsReply, newer_fields
from protocol.version import Version

SCENES = Path(__file__).parents[2] / "scenes"
A = 1e-10
MATERIAL = (
    "continuum.material.young=900 GPa", "continuum.material.poisson=0.2", "continuum.material.density=2200 kg/m^3",
    "continuum.material.thickness=3.35 angstrom",
)  # fmt: skip
J = ("atomistic.j.interval=10", 'atomistic.j.half_sizes=["15 angstrom", "25 angstrom"]')
FIELDS = ("atomistic.fields.interval=20", "atomistic.fields.spacing=5 angstrom")


def scene_of(*overrides: str, name: str = "graphene_crack") -> Scene:
    return load_scene(SCENES / f"{name}.toml", overrides)


def said(*overrides: str, name: str = "graphene_crack") -> str:
    with pytest.raises(SceneError) as caught:
        scene_of(*overrides, name=name)
    assert len(caught.value.problems) == 1, caught.value.problems
    return caught.value.problems[0]


@pytest.mark.parametrize("name", ["graphene_crack", "graphene_patch", "lattice_patch"])
def test_scenes_of_version_1_1_ask_for_nothing_newer(name: str) -> None:
    """Without the new keys a service of an older protocol gets what it always got."""
    scene = scene_of(name=name)
    requests = [configure_request(scene, Frame(), None, []), equilibrate_request(scene)]
    assert [newer_fields(request, Version(1, 0)) for request in requests] == [[], []]
    configure = requests[0]
    assert isinstance(configure, a.AtomisticConfigure) and configure.sample is not None
    assert scene.atomistic is not None and configure.sample.width == scene.atomistic.width


def test_every_key_reaches_its_request() -> None:
    scene = scene_of(
        "atomistic.layers=2", "atomistic.orientation=armchair", "atomistic.settle=true",
        "atomistic.ensemble.thermostat=nose-hoover", "atomistic.ensemble.damping_time=0.2 ps",
        "atomistic.ensemble.pressure=1 MPa", "handshake.motion=linear", *J, *FIELDS,
        'atomistic.fields.atoms=["stress", "displacement"]',
    )  # fmt: skip
    configure = configure_request(scene, Frame(), 1.4 * A, [])
    assert configure.sample is not None
    assert (configure.sample.layers, configure.sample.orientation) == (2, "armchair")
    assert configure.sample.lattice_constant == 1.4 * A and configure.sample.crack == a.CrackCut(tip_x=0.0, y=0.0)
    rest = equilibrate_request(scene)
    assert rest.settle and not rest.keep_ensemble and rest.ensemble is not None
    assert (rest.ensemble.thermostat, rest.ensemble.pressure) == ("nose-hoover", pytest.approx(1e6))
    assert rest.ensemble.damping_time == pytest.approx(2e-13)
    assert read_resolved(scene.model_dump(mode="json")).model_dump() == scene.model_dump()


def test_mistakes_are_named_with_what_is_allowed() -> None:
    keep = ("atomistic.ensemble.thermostat=langevin", "atomistic.ensemble.keep=true")
    assert "one thermostat at a time" in said(*keep)
    assert "must be left out beside passive_width" in said(
        "handshake.passive_width=5 angstrom", "handshake.surface_width=5 angstrom"
    )
    assert "must be smaller than handshake.width, 15 angstrom" in said("handshake.passive_width=15 angstrom")
    assert 'must be left out with motion = "linear"' in said("handshake.motion=linear", "handshake.until_error=1 nN")
    assert "must be a force with its unit" in said("handshake.until_error=1")
    assert "at most 37.5 angstrom" in said("atomistic.j.interval=1", 'atomistic.j.half_sizes=["40 angstrom"]')
    assert "multiple of atomistic.j.interval, 10" in said(*J, "atomistic.fields.interval=15",
                                                          "atomistic.fields.spacing=5 angstrom")  # fmt: skip
    assert "must have spacing" in said("atomistic.fields.interval=10")
    assert "must be left out without spacing" in said(
        "atomistic.fields.interval=10", "atomistic.fields.radius=5 angstrom", 'atomistic.fields.atoms=["stress"]'
    )
    assert "must be left out without [crack]" in said(*J, name="graphene_patch")
    assert "must be one of 'zigzag' or 'armchair'" in said("atomistic.orientation=diagonal")
    assert "must be left out with atomistic.sample" in said("atomistic.sample=epoxy", "atomistic.layers=2", *MATERIAL)
    assert "no constants can be measured" in said("atomistic.sample=epoxy")
    assert "must be left out without atomistic.sample" in said("atomistic.periodic_z=true")
    own = ('atomistic.commands.lines=["pair_style zero 5.0"]', "atomistic.commands.unit_style=metal")
    assert "no sample can be built for a force field of your own" in said(*own, *MATERIAL)
    assert "there is no such file" in said("atomistic.sample=nowhere.data", *MATERIAL)


def test_a_sample_in_a_file_is_sent_from_beside_the_scene(tmp_path: Path) -> None:
    (tmp_path / "sheet.data.gz").write_bytes(b"\x1f\x8b and so on")
    (tmp_path / "own.toml").write_text((SCENES / "graphene_crack.toml").read_text())
    lines = 'atomistic.commands.lines=["pair_style tersoff", "pair_coeff * * BNC.tersoff C"]'
    scene = load_scene(
        tmp_path / "own.toml",
        ["atomistic.sample=sheet.data.gz", "atomistic.commands.unit_style=metal", lines, *MATERIAL],
    )
    request = configure_request(scene, Frame(), None, [])
    assert request.sample is None and request.sample_data is not None
    assert request.sample_data.tobytes() == b"\x1f\x8b and so on"
    assert request.sample_file == a.SampleFile(crack=a.CrackCut(tip_x=0.0, y=0.0))
    assert request.commands is not None and request.commands.commands[0] == "pair_style tersoff"
    named = scene_of("atomistic.sample=epoxy", "atomistic.periodic_z=true", *MATERIAL)
    held = configure_request(named, Frame(), None, [])
    assert held.sample_file is not None and held.sample_data is None
    assert (held.sample_file.name, held.sample_file.periodic_z) == ("epoxy", True)


def test_the_sample_of_a_file_must_be_what_the_scene_says() -> None:
    table = scene_of("atomistic.sample=epoxy", *MATERIAL).atomistic
    assert table is not None
    half = np.array([51.5, 51.5]) * A
    check_extent(table, 5 * A, -half, half)
    with pytest.raises(HandshakeError, match=r"over 83\.018 angstrom along y; atomistic\.height is 103 angstrom"):
        check_extent(table, 5 * A, -half * [1, 0.806], half * [1, 0.806])
    with pytest.raises(HandshakeError, match=r"lies at x = 20 angstrom"):
        check_extent(table, 5 * A, -half + np.array([20 * A, 0]), half + np.array([20 * A, 0]))


def test_the_outermost_atoms_become_passive_or_surface_atoms() -> None:
    x = np.arange(-20, 21) * 1.0 * A
    atoms = np.column_stack([grid.ravel() for grid in np.meshgrid(x, x)] + [np.zeros(x.size**2)])
    half = np.array([20 * A, 20 * A])
    inner = ((-10 * A, -10 * A), (10 * A, 10 * A))
    ring = rectangle_ring(inner, -half, half, ["left", "right", "bottom", "top"])
    for widths, kind in (((2.5 * A, 0.0), a.PASSIVE), ((0.0, 2.5 * A), a.SURFACE)):
        interface = build_interface(atoms, ring, 5 * A, None, *widths)
        depth = 20 * A - np.abs(atoms[interface.anchor, :2]).max(axis=1)
        assert np.array_equal(interface.anchor_kind == kind, depth < 2.5 * A)
        assert set(interface.anchor_kind) == {a.SPRING, kind}
        # Three rows on each side of a square of 41.
        assert np.count_nonzero(interface.anchor_kind == kind) == 41**2 - 35**2
        stiffness = np.ones(len(interface.anchor))
        handshake = scene_of().handshake
        assert handshake is not None
        ids = np.arange(len(atoms)) + 7
        request = register_request(handshake, ids, atoms[interface.anchor], interface, stiffness, stiffness)
        assert request.anchor_kind is not None and np.array_equal(request.anchor_kind, interface.anchor_kind)
        assert np.array_equal(request.atom_id, interface.anchor + 7)


def test_the_grid_lies_evenly_over_the_atoms() -> None:
    low, high = np.array([-51.0, -49.0, 0.0]) * A, np.array([51.0, 49.0, 0.0]) * A
    request = grid_request(scene_of(*FIELDS), low, high)
    assert request is not None and request.counts == (21, 20, 1)
    assert request.origin == pytest.approx((-50 * A, -47.5 * A, 0.0), abs=1e-20)
    assert request.radius == pytest.approx(10 * A)
    assert grid_request(scene_of(), low, high) is None
    thick = grid_request(scene_of(*FIELDS), low - np.array([0, 0, 12 * A]), high + np.array([0, 0, 12 * A]))
    assert thick is not None and thick.counts == (21, 20, 5)
    assert thick.origin[2] == pytest.approx(-10 * A)


class Service:
    """Stands for the atomistic service: notes what it was asked, answers from a list of J."""

    def __init__(self, j: list[Any]) -> None:
        self.asked: list[str] = []
        self._j = j

    def call(self, operation: str, request: Any, reply: Any, step: int = 0) -> Any:
        self.asked.append(operation)
        if operation == "collect_fields":
            return a.Collecting(step=step)
        if operation == "fields":
            return FieldsReply(step=step, fields={name: np.full((4, 6), float(step)) for name in request.names})
        if operation == "grid_fields":
            return a.GridFields(step=step, samples=1, fields={n: np.zeros(request.counts) for n in request.names})
        value = self._j.pop(0)
        if isinstance(value, Exception):
            raise value
        one = np.array([value, 2 * value])
        return a.JIntegral(
            step=step, samples=3, tip=request.tip or (1e-9, 0.0), contour=one, domain=one + 0.5,
            standard_error=0.1 * one, domain_error=0.2 * one,
        )  # fmt: skip


def region_of(service: Service) -> Region:
    """A region around the origin, whose atoms span 100 A."""
    client: Any = service
    region = Region(scene_of(), Place(name="atomistic"), client)
    region.own_reference = np.array([[-50.0, -50, 0], [50, 50, 0]]) * A
    return region


def measurements(service: Service, *overrides: str) -> AtomMeasurements:
    return AtomMeasurements(scene_of(*J, *overrides), region_of(service))


def test_j_and_fields_are_taken_when_they_are_due() -> None:
    service = Service([1.0, 2.0])
    taken = measurements(service, *FIELDS, 'atomistic.fields.atoms=["stress"]')
    values: dict[str, float] = {}
    assert taken.take(9, values) is None and values == {} and service.asked == []
    assert taken.take(10, values) is None
    assert values["j_contour_0"] == 1.0 and values["j_contour_1"] == 2.0 and values["j_domain_1"] == 2.5
    assert values["j_contour_error_1"] == pytest.approx(0.2) and values["j_domain_error_0"] == pytest.approx(0.2)
    assert values["j_tip"] == 1e-9
    frame = taken.take(20, values)
    assert frame is not None and frame.atoms["stress"][0, 0] == 20.0
    assert frame.grid is not None and frame.on_grid["density"].shape == frame.grid.counts
    # J comes last: its answer begins the next average, also that of the fields.
    assert service.asked == ["j_integral", "fields", "grid_fields", "j_integral"]
    fixed = measurements(Service([1.0]), "atomistic.j.tip=start")
    fixed.take(10, values)
    assert values["j_tip"] == 0.0


def test_without_j_the_average_of_fields_begins_anew_after_each_frame() -> None:
    service = Service([])
    taken = AtomMeasurements(scene_of(*FIELDS, name="graphene_patch"), region_of(service))
    for step in (10, 20, 40):
        taken.take(step, {})
    assert service.asked == ["grid_fields", "collect_fields"] * 2


def test_a_tip_that_runs_out_of_reach_ends_j_but_not_the_run() -> None:
    far = ProtocolError("bad_field", "contour of half_size 2.5e-09 m reaches beyond the atoms", field="half_sizes")
    taken = measurements(Service([1.0, far, far]))
    values: dict[str, float] = {}
    taken.take(10, values)
    for step in (20, 30):
        values.clear()
        taken.take(step, values)
        assert values == {}
    assert len(taken.notes) == 1 and "at step 20" in taken.notes[0]
    # At the first value it is the scene that is wrong.
    with pytest.raises(ProtocolError, match="beyond the atoms"):
        measurements(Service([far])).take(10, {})
    # Any other error is one.
    broken = measurements(Service([1.0, ProtocolError("solver_failed", "atoms are lost")]))
    broken.take(10, {})
    with pytest.raises(ProtocolError, match="lost"):
        broken.take(20, {})
