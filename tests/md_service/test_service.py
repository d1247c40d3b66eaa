"""The role `atomistic` on each engine: the contract, and what version 1.2 of the protocol asks for."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from md_service import service as services
from md_service.data_file import write_data_file
from md_service.force_fields import force_field
from md_service.k_field import KField
from md_service.sample_source import build_sample
from md_service.service import AtomisticService
from protocol import atomistic as a
from protocol.conformance import check_service
from protocol.errors import ProtocolError
from protocol.messages import Empty, FieldsRequest, RestoreRequest
from protocol.server import running

ENGINES: dict[str, Callable[[Path], AtomisticService]] = {
    "lammps": services.make_service,
    "lattice": services.make_lattice,
    "openmm": services.make_openmm,
    "ase": services.make_ase,
}
A = 1e-10
SPRING = 250.0  # N/m, of the harmonic lattice
SPACING = 3.45 * A


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.timeout(300)
def test_every_engine_keeps_the_contract(engine: str, tmp_path: Path) -> None:
    service = ENGINES[engine](tmp_path)
    with running(service, f"ipc://{tmp_path}/s") as server:
        checks = check_service(server.endpoint, role="atomistic")
    assert [f"{check.name}: {check.detail}" for check in checks if check.passed is False] == []
    names = {check.name: check.detail for check in checks}
    # All engines have what 1.2 brought; none gets by as a service that lacks it.
    for kind in ("passive atoms", "surface atoms", "anchors that move", "an equilibration that settles",
                 "windows until the error", "thermostat nose-hoover"):  # fmt: skip
        assert names[f"kinds: {kind}"] == "taken"
    assert names["file: a sample comes back as it was sent"] == "taken"
    for operation in ("grid_fields", "j_integral", "displace"):
        assert f"{operation}: is answered" in names
    assert "kg m/s" in names["momentum: is that of the velocities"]
    assert "atoms" in names["keep: atoms outside of a polygon are left out"]
    if engine in ("lattice", "lammps"):
        assert "bonds" in names["cut: is answered"]
    else:
        assert names["cut: is not offered, and refused"]


def configure(**changes: Any) -> a.AtomisticConfigure:
    values: dict[str, Any] = {
        "force_field": "harmonic", "temperature": 0.0, "time_step": 1e-15, "seed": 3,
        "sample": a.Sample(material="hexagonal", width=60 * A, height=60 * A),
    }  # fmt: skip
    return a.AtomisticConfigure(**{**values, **changes})


def frame(built: a.AtomisticConfigured, depth: float, **changes: Any) -> a.AtomisticRegister:
    """Anchors on all atoms nearer than `depth` to the sample's edge."""
    flat = built.position[:, :2]
    rows = np.flatnonzero((np.minimum(flat - flat.min(axis=0), flat.max(axis=0) - flat) < depth).any(axis=1))
    values: dict[str, Any] = {
        "atom_id": built.atom_id[rows], "anchor_position": built.position[rows], "damping_time": 1e-13,
        "anchor_ivc": (flat[rows, 1] > 0).astype(np.int64), "stiffness": np.full(len(rows), 200.0),
    }  # fmt: skip
    return a.AtomisticRegister(**{**values, **changes})


def held_at(register: a.AtomisticRegister, moved: np.ndarray, steps: int = 20, **more: Any) -> a.AtomisticAdvance:
    place = register.anchor_position + moved
    return a.AtomisticAdvance(steps=steps, anchor_position=place, anchor_velocity=np.zeros_like(place), **more)


def ready(
    service: AtomisticService, request: a.AtomisticConfigure, collect: bool = True, depth: float = 10 * A, **how: Any
) -> tuple[a.AtomisticConfigured, a.AtomisticRegister]:
    built = service.configure(request)
    register = frame(built, depth)
    service.register(register)
    if collect:
        service.collect_fields(a.CollectRequest(active=True))
    service.equilibrate(a.EquilibrateRequest(**{"steps": 40, "windows": 8, "window_steps": 5, **how}))
    return built, register


def relax(service: AtomisticService, register: a.AtomisticRegister, moved: np.ndarray) -> None:
    """Minimise the energy with the anchors moved; the reference of J stays that of the unloaded sample."""
    service.collect_fields(a.CollectRequest(active=False))
    service.advance(held_at(register, moved, 1))
    service.equilibrate(a.EquilibrateRequest(steps=4000, windows=8, window_steps=1))
    service.collect_fields(a.CollectRequest(active=True))
    service.advance(held_at(register, moved, 1))


def refused(service: AtomisticService, request: a.AtomisticConfigure) -> tuple[str, str, str]:
    with pytest.raises(ProtocolError) as caught:
        service.configure(request)
    report = caught.value.report
    return report.code, report.field, report.sentence


# Samples and force fields -----------------------------------------------------------------------------------------


def test_a_built_sample_is_the_same_by_name_and_by_file(tmp_path: Path) -> None:
    service = services.make_lattice(tmp_path)
    crack = a.CrackCut(tip_x=0.0, y=2 * A)
    sample = a.Sample(material="hexagonal", width=60 * A, height=60 * A, crack=crack)
    by_name = service.configure(configure(sample=sample))
    atoms = build_sample("hexagonal", 60 * A, 60 * A, spacing=SPACING, crack=None)
    assert len(by_name.position) < len(atoms)
    cracked = service._configured().atoms
    write_data_file(tmp_path / "cracked.data", cracked, "metal", "atomic")
    content = (tmp_path / "cracked.data").read_bytes()
    for data in (content, gzip.compress(content)):
        file = configure(sample=None, sample_file=a.SampleFile(), sample_data=np.frombuffer(data, np.uint8))
        by_file = service.configure(file)
        assert np.array_equal(by_file.position, by_name.position)
        assert np.array_equal(by_file.atom_mass, by_name.atom_mass)
        assert service._configured().atoms.crack == cracked.crack


def test_a_file_of_a_solid_is_free_along_x_and_y_and_repeats_along_z_as_it_says(tmp_path: Path) -> None:
    service = services.make_service(tmp_path)
    solid = build_sample("argon", 30 * A, 30 * A, spacing=3.72 * A, layers=5)
    write_data_file(tmp_path / "solid.data", replace(solid, box=replace(solid.box, periodic=(True, True, True))),
                    "metal", "atomic")  # fmt: skip
    data = np.frombuffer((tmp_path / "solid.data").read_bytes(), np.uint8)
    for given, wanted in ((None, True), (False, False), (True, True)):
        request = configure(force_field="lennard-jones", sample=None, sample_data=data,
                            sample_file=a.SampleFile(periodic_z=given))  # fmt: skip
        built = service.configure(request)
        assert service._configured().atoms.box.periodic == (False, False, wanted)
        assert np.allclose(built.position, solid.position, atol=1e-20)


def test_a_force_field_of_the_users_own_gives_the_forces_of_the_profile(tmp_path: Path) -> None:
    """Lennard-Jones by commands against the profile of the same numbers, on the same sample."""
    service = services.make_service(tmp_path)
    sample = a.Sample(material="hexagonal", width=40 * A, height=40 * A, lattice_constant=3.9 * A)
    energies = []
    built = service.configure(configure(force_field="lennard-jones", sample=sample))
    energies.append(service.fields(FieldsRequest(names=["energy"])).fields["energy"])
    write_data_file(tmp_path / "sheet.data", service._configured().atoms, "metal", "atomic")
    data = np.frombuffer((tmp_path / "sheet.data").read_bytes(), np.uint8)
    profile = force_field("lennard-jones")
    commands = a.ForceFieldCommands(unit_style="metal", atom_style="atomic", commands=list(profile.styles))
    own = configure(force_field="mine", commands=commands, sample=None, sample_file=a.SampleFile(), sample_data=data)
    assert np.array_equal(service.configure(own).position, built.position)
    energies.append(service.fields(FieldsRequest(names=["energy"])).fields["energy"])
    assert energies[0].min() < -0.01 * 1.6e-19
    assert np.allclose(energies[0], energies[1], rtol=1e-12)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("shell rm -rf x", "shell"), ("include in.lammps", "include"), ("variable a equal 1", "variable"),
        ("pair_style lj/cut $(1+1)", "$"), ("python f invoke", "python"), ("fix 1 all nve", "fix"),
        ("pair_coeff * * /etc/passwd C", "/etc/passwd"), ("pair_coeff * * ../x.tersoff C", "../x.tersoff"),
    ],
)  # fmt: skip
def test_commands_that_set_no_force_field_are_refused(line: str, said: str, tmp_path: Path) -> None:
    commands = a.ForceFieldCommands(unit_style="metal", atom_style="atomic", commands=["pair_style tersoff", line])
    code, field, sentence = refused(services.make_service(tmp_path), configure(commands=commands))
    assert (code, field) == ("bad_field", "commands") and said in sentence


def test_what_a_sample_or_an_engine_cannot_have_is_said_by_field(tmp_path: Path) -> None:
    lattice, lammps = services.make_lattice(tmp_path), services.make_service(tmp_path)
    lattice.configure(configure())
    before = lattice.fields(FieldsRequest(names=["position"])).fields["position"]
    sample = {"material": "hexagonal", "width": 60 * A, "height": 60 * A}
    commands = a.ForceFieldCommands(unit_style="metal", atom_style="atomic", commands=["pair_style zero 5.0"])
    for service, changes, code, field in (
        (lattice, {"sample": a.Sample(**sample, layers=2)}, "unsupported", "sample.layers"),
        (lattice, {"sample": a.Sample(**sample, orientation="zigzag")}, "unsupported", "sample.orientation"),
        (lattice, {"sample": a.Sample(**{**sample, "material": "graphene"})}, "bad_field", "sample.material"),
        (lattice, {"commands": commands}, "unsupported", "commands"),
        (lattice, {"sample": a.Sample(**sample, crack=a.CrackCut(tip_x=1e-7, y=0.0))}, "bad_field",
         "sample.crack.tip_x"),
        (lattice, {"sample": None, "sample_file": a.SampleFile(name="none")}, "bad_field", "sample_file.name"),
        (lammps, {"force_field": "tersoff"}, "bad_field", "sample.material"),
        (lammps, {"force_field": "mine", "commands": commands}, "bad_field", "sample.lattice_constant"),
    ):  # fmt: skip
        assert refused(service, configure(**changes))[:2] == (code, field), changes
    # None of them disturbed the sample that was there.
    assert np.array_equal(lattice.fields(FieldsRequest(names=["position"])).fields["position"], before)


def test_a_sample_with_an_element_that_the_force_field_lacks_is_refused(tmp_path: Path) -> None:
    service = services.make_service(tmp_path)
    write_data_file(tmp_path / "argon.data", build_sample("hexagonal", 40 * A, 40 * A, spacing=3.8 * A), "metal",
                    "atomic")  # fmt: skip
    data = np.frombuffer((tmp_path / "argon.data").read_bytes(), np.uint8)
    request = configure(force_field="tersoff", sample=None, sample_file=a.SampleFile(), sample_data=data)
    code, field, sentence = refused(service, request)
    assert (code, field) == ("bad_field", "force_field") and "Ar" in sentence and "tersoff" in sentence


# Anchors, ensembles, windows --------------------------------------------------------------------------------------


def test_passive_atoms_follow_and_hand_on_the_force_of_the_others(tmp_path: Path) -> None:
    """At rest under a uniform strain, passive or by stiff springs, the frame carries the same force."""
    service = services.make_lattice(tmp_path)
    found = {}
    rest = a.EquilibrateRequest(steps=3000, windows=8, window_steps=5)
    for kind in (a.SPRING, a.PASSIVE):
        built = service.configure(configure())
        register = frame(built, 8 * A)
        kinds = np.full(len(register.atom_id), kind, dtype=np.int64)
        register = register.model_copy(update={"anchor_kind": kinds, "stiffness": np.full(len(kinds), 2e4)})
        service.register(register)
        unloaded = service.equilibrate(rest).reference_ivc_force
        assert np.abs(unloaded).max() < 1e-13
        moved = 1e-3 * register.anchor_position * [0.0, 1.0, 0.0]
        service.advance(held_at(register, moved, 1))
        # At 0 K that minimises the energy, with the anchors where they are.
        found[kind] = service.equilibrate(rest).reference_ivc_force
        place = service.fields(FieldsRequest(names=["position"])).fields["position"][register.atom_id]
        if kind == a.PASSIVE:
            assert np.abs(place - register.anchor_position - moved).max() < 1e-22
    # The upper half is pulled downwards, the lower one upwards.
    assert found[a.PASSIVE][1, 1] < -1e-9 and found[a.PASSIVE][0, 1] > 1e-9
    assert found[a.SPRING] == pytest.approx(found[a.PASSIVE], rel=0.02, abs=2e-11)


def test_windows_go_on_until_the_error_is_small(tmp_path: Path) -> None:
    service = services.make_lattice(tmp_path)
    _, register = ready(service, configure(temperature=300.0), collect=False, steps=400)
    still = np.zeros_like(register.anchor_position)
    once = service.advance(held_at(register, still))
    assert once.windows == 1
    target = float(once.ivc_standard_error.max()) / 3
    before = service.step
    longer = service.advance(held_at(register, still, until_error=target, most_windows=200))
    assert 3 <= longer.windows < 200
    assert longer.ivc_standard_error.max() <= target
    assert service.step == before + 20 * longer.windows
    least = service.advance(held_at(register, still, until_error=target / 100, most_windows=3))
    assert least.windows == 3 and least.ivc_standard_error.max() > target / 100
    assert least.correlation_time is not None and least.correlation_time > 0


def test_a_global_thermostat_stays_on_and_is_not_doubled(tmp_path: Path) -> None:
    service = services.make_lattice(tmp_path)
    built = service.configure(configure(temperature=300.0))
    ensemble = a.Ensemble(thermostat="nose-hoover", damping_time=5e-14)
    keep = a.EquilibrateRequest(steps=600, windows=8, window_steps=20, ensemble=ensemble, keep_ensemble=True)
    service.register(frame(built, 10 * A))
    with pytest.raises(ProtocolError, match="one thermostat at a time") as caught:
        service.equilibrate(keep)
    assert caught.value.report.field == "keep_ensemble"
    free = frame(built, 10 * A, damping_time=None)
    service.register(free)
    service.equilibrate(keep)
    still = np.zeros_like(free.anchor_position)
    # Without damper and thermostat nothing but the bath could hold this temperature against the work of the anchors.
    warm = [service.advance(held_at(free, still, 50)).temperature for _ in range(30)]
    assert np.mean(warm) == pytest.approx(300.0, rel=0.05)
    work = service.advance(held_at(free, still, 50)).thermostat_work
    assert work is not None and work != 0.0
    pressed = keep.model_copy(update={"ensemble": ensemble.model_copy(update={"pressure": 1e5})})
    with pytest.raises(ProtocolError, match="repeats nowhere"):
        service.equilibrate(pressed)


def test_an_equilibration_that_settles_tells_its_drifts(tmp_path: Path) -> None:
    service = services.make_lattice(tmp_path)
    built = service.configure(configure(temperature=300.0))
    service.register(frame(built, 10 * A))
    reply = service.equilibrate(a.EquilibrateRequest(steps=6_000, windows=8, window_steps=5, settle=True))
    assert reply.settled is True and reply.steps_done is not None
    assert 3_000 < reply.steps_done < 6_000
    names = [drift.quantity for drift in reply.drifts]
    assert names == ["energy", *(f"stress_{k}" for k in ("xx", "yy", "zz", "xy", "xz", "yz"))]
    energy = reply.drifts[0]
    assert abs(energy.drift) <= energy.standard_error > 0


# Fields and J -----------------------------------------------------------------------------------------------------


def test_grid_fields_of_a_uniform_strain(tmp_path: Path) -> None:
    service = services.make_lattice(tmp_path)
    built, register = ready(service, configure())
    strain = np.array([2e-4, 5e-4])
    moved = np.column_stack([register.anchor_position[:, :2] * strain, np.zeros(len(register.atom_id))])
    relax(service, register, moved)
    spacing = 6 * A
    names = ["density", "velocity", "displacement", "stress", "temperature"]
    reply = service.grid_fields(
        a.GridFieldsRequest(names=names, origin=(-spacing, -spacing, 0.0), spacing=spacing, counts=(3, 3, 1),
                            radius=4 * SPACING)
    )  # fmt: skip
    assert reply.samples == 1
    thickness = service._configured().atoms.thickness
    assert thickness is not None
    inside = np.abs(built.position[:, :2]).max(axis=1) < 15 * A
    now = service.fields(FieldsRequest(names=["displacement"])).fields["displacement"]
    gradient = np.linalg.lstsq(built.position[inside, :2], now[inside, :2], rcond=None)[0]
    xx, yy = gradient[0, 0], gradient[1, 1]
    young = 2 * SPRING / (np.sqrt(3.0) * thickness)
    # Closed form of the lattice, plane stress with nu = 1/3; the lattice under the averaging function is not smooth.
    stress = young / (1 - 1 / 9) * np.array([xx + yy / 3, yy + xx / 3])
    assert reply.fields["stress"][1, 1, 0, :2] == pytest.approx(stress, rel=0.01)
    mass = built.atom_mass[0] / (np.sqrt(3.0) / 2 * SPACING**2 * thickness)
    assert reply.fields["density"] == pytest.approx(mass, rel=0.01)
    assert reply.fields["displacement"][2, 1, 0, 0] == pytest.approx(xx * spacing, rel=0.05)
    assert reply.fields["temperature"][1, 1, 0] < 1.0
    assert np.abs(reply.fields["velocity"]).max() < 1.0
    flat = a.GridFieldsRequest(names=["density"], origin=(0.0, 0.0, 0.0), spacing=spacing, counts=(2, 2, 2), radius=A)
    with pytest.raises(ProtocolError, match="one point along z") as caught:
        service.grid_fields(flat)
    assert caught.value.report.field == "counts"


def cracked(service: AtomisticService) -> tuple[a.AtomisticConfigured, a.AtomisticRegister]:
    sample = a.Sample(material="hexagonal", width=200 * A, height=200 * A, crack=a.CrackCut(tip_x=0.0, y=0.0))
    return ready(service, configure(sample=sample), depth=20 * A)


def test_j_of_a_k_field_on_the_lattice(tmp_path: Path) -> None:
    """K from linear elasticity on the frame, atoms at rest between: J by contour and domain is K^2 / E."""
    service = services.make_lattice(tmp_path)
    _, register = cracked(service)
    thickness = service._configured().atoms.thickness
    assert thickness is not None
    young = 2 * SPRING / (np.sqrt(3.0) * thickness)
    wanted = 0.5  # J/m^2
    flat = KField.of_energy_release_rate(wanted, young, 1.0 / 3.0).displacement(register.anchor_position)
    moved = np.column_stack([flat[:, :2], np.zeros(len(flat))])
    relax(service, register, moved)
    for _ in range(4):
        service.advance(held_at(register, moved, 1))
    reply = service.j_integral(a.JIntegralRequest(half_sizes=[30 * A, 40 * A, 50 * A]))
    assert reply.samples == 5 and reply.tip == (0.0, 0.0)
    assert reply.contour == pytest.approx(wanted, rel=0.05)
    assert reply.domain == pytest.approx(wanted, rel=0.05)
    with pytest.raises(ProtocolError, match="advance comes before"):
        service.j_integral(a.JIntegralRequest(half_sizes=[30 * A]))


def test_j_needs_a_reference_a_tip_and_room(tmp_path: Path) -> None:
    service = services.make_lattice(tmp_path)
    request = a.JIntegralRequest(half_sizes=[30 * A])
    _, register = ready(service, configure(), collect=False)
    still = np.zeros_like(register.anchor_position)
    service.advance(held_at(register, still))
    with pytest.raises(ProtocolError) as caught:
        service.j_integral(request)
    assert caught.value.report.code == "wrong_state"
    ready(service, configure())
    service.advance(held_at(register, still))
    with pytest.raises(ProtocolError, match="no crack to follow") as caught:
        service.j_integral(request)
    assert caught.value.report.field == "tip"
    for size in (5 * A, 1e-8):
        with pytest.raises(ProtocolError) as caught:
            service.j_integral(a.JIntegralRequest(half_sizes=[size], tip=(0.0, 0.0)))
        assert caught.value.report.field == "half_sizes"


def test_averages_go_on_bit_by_bit_from_a_checkpoint(tmp_path: Path) -> None:
    """J with its error, over windows on both sides of a checkpoint, thermostat noise included."""
    request = configure(
        sample=a.Sample(material="hexagonal", width=120 * A, height=120 * A, crack=a.CrackCut(tip_x=0.0, y=0.0)),
        temperature=50.0,
    )
    ask = a.JIntegralRequest(half_sizes=[30 * A])
    service = services.make_lattice(tmp_path)
    _, register = ready(service, request)
    pulls = [np.tile([0.0, 1e-13 * k, 0.0], (len(register.atom_id), 1)) for k in range(12)]
    for pull in pulls[:5]:
        service.advance(held_at(register, pull))
    saved = service.checkpoint(Empty())

    def go_on(other: AtomisticService) -> tuple[a.JIntegral, np.ndarray]:
        for pull in pulls[5:]:
            other.advance(held_at(register, pull))
        energy = other.fields(FieldsRequest(names=["energy"])).fields["energy"]
        return other.j_integral(ask), energy

    one, energy = go_on(service)
    fresh = services.make_lattice(tmp_path)
    fresh.configure(request)
    fresh.register(register)
    fresh.restore(RestoreRequest(step=saved.step, state=saved.state))
    other, other_energy = go_on(fresh)
    assert one.samples == other.samples == 12
    assert one.standard_error[0] > 0
    for name in ("contour", "domain", "standard_error", "domain_error"):
        assert np.array_equal(getattr(one, name), getattr(other, name)), name
    assert np.array_equal(energy, other_energy)
    short = dict(saved.state)
    short["j_total"] = short["j_total"][:-1]
    with pytest.raises(ProtocolError) as caught:
        fresh.restore(RestoreRequest(step=saved.step, state=short))
    assert caught.value.report.field == "state"


def test_properties_of_each_engine_agree_on_lennard_jones(tmp_path: Path) -> None:
    """Three codes, one potential: spacing, E and nu of the hexagonal layer at 0 K."""
    request = a.PropertiesRequest(force_field="lennard-jones", material="hexagonal", temperature=0.0, seed=1)
    found = [ENGINES[name](tmp_path / name).properties(request) for name in ("lammps", "openmm", "ase")]
    for other in found[1:]:
        assert other.lattice_constant == pytest.approx(found[0].lattice_constant, rel=1e-4)
        assert other.young == pytest.approx(found[0].young, rel=2e-3)
        assert other.poisson == pytest.approx(found[0].poisson, abs=2e-3)
    assert found[0].poisson == pytest.approx(1 / 3, abs=1e-3)
