"""Loads that are there from the start, and the momentum that the anchors hand over: protocol 1.3 on each engine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from md_service import service as services
from md_service.service import AtomisticService
from protocol import atomistic as a
from protocol.errors import ProtocolError
from protocol.messages import Empty, FieldsRequest, RestoreRequest

A = 1e-10


@dataclass(frozen=True)
class Subject:
    """An engine with a small sample; `exact` is the relative error of its forces."""

    make: Callable[[Path], AtomisticService]
    force_field: str
    material: str
    size: float
    time_step: float
    exact: float


SUBJECTS = {
    "lattice": Subject(services.make_lattice, "harmonic", "hexagonal", 40 * A, 1e-15, 1e-11),
    "lammps": Subject(services.make_service, "tersoff", "graphene", 22 * A, 0.5e-15, 1e-9),
    "openmm": Subject(services.make_openmm, "lennard-jones", "hexagonal", 30 * A, 5e-15, 1e-3),
    "ase": Subject(services.make_ase, "lennard-jones", "hexagonal", 26 * A, 5e-15, 1e-9),
}


class Run:
    """A service with a frame of anchors, the left edge of it passive and the right one of surface atoms."""

    def __init__(
        self,
        subject: Subject,
        folder: Path,
        *,
        temperature: float = 0.0,
        damping_time: float | None = 1e-13,
        kinds: bool = True,
        collect: bool = False,
    ) -> None:
        self.time_step = subject.time_step
        self.service = subject.make(folder)
        sample = a.Sample(material=subject.material, width=subject.size, height=subject.size)
        self.configure = a.AtomisticConfigure(
            force_field=subject.force_field, sample=sample, temperature=temperature, time_step=subject.time_step, seed=3
        )
        built = self.service.configure(self.configure)
        self.place, self.mass = built.position, built.atom_mass
        scaled = built.position[:, :2] / np.abs(built.position[:, :2]).max(axis=0)
        rows = np.flatnonzero(np.abs(scaled).max(axis=1) > 0.7)
        self.rows = rows
        kind = np.zeros(len(rows), dtype=np.int64)
        if kinds:
            kind[scaled[rows, 0] < -0.9] = a.PASSIVE
            kind[scaled[rows, 0] > 0.9] = a.SURFACE
        self.register = a.AtomisticRegister(
            atom_id=built.atom_id[rows],
            anchor_position=built.position[rows],
            anchor_ivc=(scaled[rows, 1] > 0.0).astype(np.int64),
            stiffness=np.linspace(8.0, 12.0, len(rows)),
            damping_time=damping_time,
            anchor_kind=kind,
        )
        self.service.register(self.register)
        if collect:
            self.service.collect_fields(a.CollectRequest(active=True))
        self.reference = self.service.equilibrate(a.EquilibrateRequest(steps=200, windows=8, window_steps=5))

    def advance(self, place: NDArray[np.float64], steps: int = 5) -> a.AtomisticAdvanced:
        """A window with the anchors at rest at places."""
        request = a.AtomisticAdvance(steps=steps, anchor_position=place, anchor_velocity=np.zeros_like(place))
        return self.service.advance(request)

    def displace(self, displacement: NDArray[np.float64]) -> a.Displaced:
        """Move atoms and anchors alike, from the anchors' places at rest."""
        request = a.DisplaceRequest(
            displacement=displacement, anchor_position=self.register.anchor_position + displacement[self.rows]
        )
        return self.service.displace(request)

    def field(self, name: str) -> NDArray[np.float64]:
        return self.service.fields(FieldsRequest(names=[name])).fields[name]


@pytest.fixture(params=SUBJECTS)
def subject(request: pytest.FixtureRequest) -> Subject:
    if request.param in ("openmm", "ase"):
        pytest.importorskip(request.param)
    return SUBJECTS[request.param]


def stretched(place: NDArray[np.float64], strain: float) -> NDArray[np.float64]:
    """Displacement of a uniform strain along y."""
    return np.column_stack([np.zeros(len(place)), strain * place[:, 1], np.zeros(len(place))])


def test_displacement_moves_all_atoms_and_nothing_else(subject: Subject, tmp_path: Path) -> None:
    run = Run(subject, tmp_path, temperature=20.0, collect=True)
    last = run.advance(run.register.anchor_position, 50)  # LAMMPS takes a sample every 50 steps
    before = {name: run.field(name) for name in ("position", "velocity", "mean_position")}
    way = stretched(run.place, 0.01)
    assert run.displace(way).step == last.step
    moved = before["position"] + way
    np.testing.assert_allclose(run.field("position"), moved, rtol=0.0, atol=1e-22)
    np.testing.assert_allclose(run.field("velocity"), before["velocity"], rtol=1e-14)
    # Means collected so far stay what they are, and J keeps the unloaded sample as its reference.
    np.testing.assert_array_equal(run.field("mean_position"), before["mean_position"])
    rest = run.service._configured().reference_fields()["mean_position"]
    np.testing.assert_allclose(rest, run.place, rtol=0.0, atol=0.5 * A)
    loaded = run.advance(run.register.anchor_position + way[run.rows])
    assert loaded.step == last.step + 5
    assert np.abs(run.field("position") - moved).max() < 0.1 * A


def test_a_load_given_to_all_atoms_is_no_work_of_the_anchors(subject: Subject, tmp_path: Path) -> None:
    run = Run(subject, tmp_path, damping_time=None)
    last = run.advance(run.register.anchor_position)
    way = stretched(run.place, 0.02)
    place = run.register.anchor_position + way[run.rows]
    run.displace(way)
    with_load = run.field("energy").sum()
    given = with_load - last.potential_energy
    gained = run.advance(place)
    for _ in range(5):
        gained = run.advance(place)
    work = gained.anchor_work - last.anchor_work
    passed = gained.potential_energy + gained.kinetic_energy - (with_load + last.kinetic_energy)
    assert given > 10.0 * abs(work) > 0.0
    assert abs(work - passed) < 2e-3 * given
    assert gained.thermostat_work == last.thermostat_work


def test_a_moved_sample_is_held_as_one_that_was_not_moved(subject: Subject, tmp_path: Path) -> None:
    """Forces do not know where the whole is; a reference and a window before the move are in the answer."""
    answers = []
    for moved in (False, True):
        folder = tmp_path / str(moved)
        folder.mkdir()
        run = Run(subject, folder)
        pulled = run.register.anchor_position * [1.001, 1.0, 1.0]
        run.advance(pulled)
        way = np.tile([30 * A, -20 * A, 0.0] if moved else [0.0, 0.0, 0.0], (len(run.place), 1))
        run.displace(way)
        answers.append([run.advance(pulled + way[run.rows]) for _ in range(3)])
    scale = max(np.abs(answer.anchor_force).max() for answer in answers[0])
    for still, far in zip(*answers, strict=True):
        np.testing.assert_allclose(far.anchor_force, still.anchor_force, rtol=0.0, atol=subject.exact * scale)
        assert far.step == still.step


def test_run_goes_on_bit_by_bit_from_a_checkpoint_after_a_displacement(subject: Subject, tmp_path: Path) -> None:
    for name in ("one", "other"):
        (tmp_path / name).mkdir()
    run = Run(subject, tmp_path / "one", temperature=20.0)
    run.advance(run.register.anchor_position)
    way = stretched(run.place, 0.01)
    run.displace(way)
    place = run.register.anchor_position + way[run.rows]
    run.advance(place)
    saved = run.service.checkpoint(Empty())
    fresh = subject.make(tmp_path / "other")
    fresh.configure(run.configure)
    fresh.register(run.register)
    fresh.restore(RestoreRequest(step=saved.step, state=saved.state))
    for _ in range(2):
        request = a.AtomisticAdvance(steps=5, anchor_position=place, anchor_velocity=np.zeros_like(place))
        one, other = run.service.advance(request), fresh.advance(request)
        assert np.array_equal(one.anchor_force, other.anchor_force)
        assert one.momentum == other.momentum and one.anchor_work == other.anchor_work


def test_displacements_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    run = Run(SUBJECTS["lattice"], tmp_path)
    place, anchors = run.place, run.register.anchor_position
    for field, displacement, position in (
        ("displacement", np.zeros((len(place) + 1, 3)), anchors),
        ("anchor_position", np.zeros_like(place), anchors[:-1]),
    ):
        with pytest.raises(ProtocolError) as caught:
            run.service.displace(a.DisplaceRequest(displacement=displacement, anchor_position=position))
        assert (caught.value.report.code, caught.value.report.field) == ("bad_field", field)


@pytest.mark.parametrize(
    ("engine", "damping_time", "exact"),
    # LAMMPS converts units with seven digits, OpenMM computes forces in single precision.
    [("lattice", None, 1e-10), ("lattice", 1e-13, 1e-10), ("ase", None, 1e-10), ("lammps", None, 1e-6),
     ("openmm", None, 1e-4)],
)  # fmt: skip
def test_momentum_changes_by_the_impulse_of_the_reaction(
    engine: str, damping_time: float | None, exact: float, tmp_path: Path
) -> None:
    """The anchors jump at the start of each window, and the first kick of the window knows it."""
    if engine in ("openmm", "ase"):
        pytest.importorskip(engine)
    run = Run(SUBJECTS[engine], tmp_path, damping_time=damping_time, kinds=False)
    window, dt = 7, run.time_step
    reference = run.reference.reference_ivc_force.sum(axis=0)
    rng = np.random.default_rng(1)
    before = run.advance(run.register.anchor_position, window)
    for _ in range(5):
        place = run.register.anchor_position + rng.normal(0.0, 0.05 * A, run.register.anchor_position.shape)
        place[:, 2] = 0.0
        now = run.advance(place, window)
        impulse = -window * dt * (now.anchor_force.sum(axis=0) + reference)
        assert now.momentum is not None and before.momentum is not None
        change = np.subtract(now.momentum, before.momentum)
        np.testing.assert_allclose(impulse, change, rtol=0.0, atol=exact * np.linalg.norm(change))
        before = now


def test_momentum_is_that_of_the_velocities(subject: Subject, tmp_path: Path) -> None:
    run = Run(subject, tmp_path, temperature=20.0)
    told = np.array(run.advance(run.register.anchor_position).momentum)
    expected = np.array(run.mass @ run.field("velocity"))
    np.testing.assert_allclose(
        told, expected, rtol=0.0, atol=1e-12 * run.mass.sum() * np.abs(run.field("velocity")).max()
    )
