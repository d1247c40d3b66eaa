"""One suite of physics for all engines: what `md_service.dynamics.Dynamics` promises."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from md_service.anchors import PASSIVE, SPRING, Anchors, checked_anchors
from md_service.ase_dynamics import CalculatorForces
from md_service.atoms import Atoms
from md_service.crystals import hexagonal
from md_service.dynamics import Dynamics, Window
from md_service.engines import LAMMPS
from md_service.ensembles import Ensemble
from md_service.errors import EngineError
from md_service.graphene import graphene
from md_service.lattice_dynamics import LATTICE
from md_service.lennard_jones import lennard_jones_parameters
from md_service.openmm_dynamics import OPENMM
from md_service.units import BOLTZMANN, ENERGY, LENGTH
from md_service.velocity_verlet import VelocityVerlet

Make = Callable[..., Dynamics]


@dataclass(frozen=True)
class Subject:
    """An engine with a sample, and how exactly it adds up.

    Attributes
    ----------
    rounding : float
        Relative error of its forces.
    impulse, damper, work : float
        Relative error of the momentum handed over by springs and by dampers, and of the energy. LAMMPS converts
        units with seven digits, and its friction sees the velocity of mid-step, so its momentum errs by the order of
        time step over damping time.
    """

    name: str
    make: Make
    atoms: Atoms
    temperature: float
    time_step: float
    stiffness: float
    damping_time: float
    rounding: float
    impulse: float
    damper: float
    work: float


class OwnCalculator:
    """A user's calculator for ASE, all pairs at once: quicker for a few atoms than the one that ASE has."""

    def make(
        self, folder: Path, force_field: str, atoms: Atoms, *, temperature: float, seed: int, time_step: float
    ) -> Dynamics:
        from ase.calculators.calculator import Calculator, all_changes

        epsilon, sigma, _ = lennard_jones_parameters()

        class AllPairs(Calculator):  # type: ignore[misc]  # untyped base
            implemented_properties = ["energy", "energies", "forces", "stresses"]  # noqa: RUF012

            def calculate(self, atoms=None, properties=None, system_changes=all_changes):  # type: ignore[no-untyped-def]
                super().calculate(atoms, properties, system_changes)
                way = self.atoms.positions[None] - self.atoms.positions[:, None]
                square = np.sum(way**2, axis=2)
                np.fill_diagonal(square, np.inf)
                s6 = (sigma / LENGTH) ** 6 / square**3
                pull = -24.0 * epsilon / ENERGY * (2.0 * s6**2 - s6) / square
                energies = 2.0 * epsilon / ENERGY * np.sum(s6**2 - s6, axis=1)
                virial = 0.5 * np.einsum("ij,ija,ijb->iab", pull, way, way)
                self.results = {
                    "energy": energies.sum(),
                    "energies": energies,
                    "forces": np.einsum("ij,ija->ia", pull, way),
                    "stresses": virial[:, [0, 1, 2, 1, 0, 0], [0, 1, 2, 2, 2, 1]] / self.atoms.get_volume(),
                }

        forces = CalculatorForces(atoms, lambda _: AllPairs(), planar=True)
        return VelocityVerlet(atoms, forces, temperature=temperature, seed=seed, time_step=time_step)


def _lattice() -> Atoms:
    return hexagonal(3.45e-10, 36e-10, 30e-10)


def _argon() -> Atoms:
    return hexagonal(3.786e-10, 23e-10, 20e-10)


def _graphene() -> Atoms:
    return graphene(20e-10, 20e-10, spacing=1.438785e-10)


SUBJECTS = {
    "lattice": (LATTICE, "harmonic", _lattice, 300.0, 1e-15, 30.0, 1e-13, 1e-13, 1e-9, 1e-9, 2e-3),
    "openmm": (OPENMM, "lennard-jones", _argon, 15.0, 5e-15, 0.5, 2e-13, 1e-5, 1e-4, 1e-4, 2e-3),
    "ase": (OwnCalculator(), "lennard-jones", _argon, 15.0, 5e-15, 0.5, 2e-13, 1e-13, 1e-9, 1e-9, 2e-3),
    "lammps": (LAMMPS, "tersoff", _graphene, 300.0, 0.5e-15, 30.0, 1e-13, 1e-9, 1e-6, 1e-2, 2e-2),
}


@pytest.fixture(params=SUBJECTS)
def subject(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Subject]:
    factory, force_field, sample, temperature, time_step, *rest = SUBJECTS[request.param]
    if request.param in ("openmm", "ase"):
        pytest.importorskip(request.param)
    atoms = sample()
    made: list[Dynamics] = []

    def make(temperature: float = temperature, seed: int = 1, time_step: float = time_step) -> Dynamics:
        folder = tmp_path / str(len(made))
        folder.mkdir()
        made.append(factory.make(folder, force_field, atoms, temperature=temperature, seed=seed, time_step=time_step))
        return made[-1]

    yield Subject(request.param, make, atoms, temperature, time_step, *rest)
    for dynamics in made:
        dynamics.close()
        dynamics.close()


def frame_of(atoms: Atoms) -> NDArray[np.int64]:
    """Rows of the atoms near the edges."""
    half = np.abs(atoms.position[:, :2]).max(axis=0)
    width = 1.5 * float(atoms.spacing or 0.0)
    return np.flatnonzero((np.abs(atoms.position[:, :2]) > half - width).any(axis=1))


def anchors_of(subject: Subject, *, damped: bool = True, moving: bool = False, passive: bool = False) -> Anchors:
    rows = frame_of(subject.atoms)
    stiffness = subject.stiffness * np.linspace(0.8, 1.2, len(rows))
    kind = np.full(len(rows), PASSIVE if passive else SPRING)
    return checked_anchors(
        rows, subject.atoms.position[rows], stiffness, np.zeros(len(rows), dtype=np.int64),
        subject.damping_time if damped else None, subject.atoms.atom_mass, kind, moving,
    )  # fmt: skip


def momentum_of(
    subject: Subject, dynamics: Dynamics, rows: NDArray[np.int64] | slice = slice(None)
) -> NDArray[np.float64]:
    return np.asarray(subject.atoms.atom_mass[rows] @ dynamics.velocity()[rows])


def energy_of(window: Window) -> float:
    return window.kinetic_handshake + window.kinetic_inner + window.potential_energy


def shift(anchors: Anchors, way: tuple[float, float], time: float) -> None:
    """Move anchors in place by a way in m, and give them the speed of doing so within a time in s."""
    anchors.position[:, :2] += way
    anchors.velocity[:, :2] = np.array(way) / time


@pytest.mark.parametrize("moving", [False, True], ids=["held", "moving"])
def test_means_of_a_window_are_those_of_its_trajectory(subject: Subject, moving: bool) -> None:
    window, speed = 10, np.array([30.0, -20.0, 0.0])
    runs = []
    for _ in range(2):
        dynamics = subject.make(temperature=0.0)
        dynamics.draw_velocities(2.0 * subject.temperature)
        anchors = anchors_of(subject, moving=moving)
        dynamics.adopt(anchors)
        dynamics.run_window(window)
        anchors.position += 1e-12
        anchors.velocity[:] = speed
        dynamics.move_anchors()
        runs.append((dynamics, anchors))
    (whole, anchors), (single, _) = runs
    means = whole.run_window(window)
    position, velocity = [single.position()[anchors.atom_id]], [single.velocity()[anchors.atom_id]]
    for _ in range(window):
        single.run(1)
        position.append(single.position()[anchors.atom_id])
        velocity.append(single.velocity()[anchors.atom_id])
    way = 0.5 * window * subject.time_step * speed if moving else np.zeros(3)
    mean_position, mean_velocity = (np.trapezoid(values, axis=0) / window for values in (position, velocity))
    by_hand = anchors.stiffness[:, None] * (mean_position - (anchors.position + way))
    by_hand -= anchors.damping[:, None] * (speed - mean_velocity)
    answer = anchors.force_on_continuum(
        means.mean_position, means.mean_velocity, means.mean_pair_force,
        anchors.mean_position(window, subject.time_step),
    )  # fmt: skip
    np.testing.assert_allclose(answer, by_hand, rtol=0.0, atol=1e-9 * np.abs(by_hand).max())
    assert whole.step == single.step == 2 * window
    np.testing.assert_array_equal(means.mean_pair_force, 0.0)
    np.testing.assert_array_equal(means.position, whole.position()[anchors.atom_id])


@pytest.mark.parametrize("damped", [False, True], ids=["springs", "dampers"])
def test_impulse_of_the_reaction_is_the_momentum_that_the_atoms_lose(subject: Subject, damped: bool) -> None:
    window, windows = 10, 12
    dynamics = subject.make(temperature=0.0)
    dynamics.draw_velocities(subject.temperature)
    anchors = anchors_of(subject, damped=damped)
    dynamics.adopt(anchors)

    shift(anchors, (1e-11, -0.5e-11), window * subject.time_step)
    dynamics.move_anchors()
    dynamics.run_window(window)
    before = momentum_of(subject, dynamics)
    impulse, passed = np.zeros(3), []
    for _ in range(windows):
        means = dynamics.run_window(window)
        mean = anchors.force_on_continuum(
            means.mean_position, means.mean_velocity, means.mean_pair_force, anchors.position
        ).sum(axis=0)
        impulse += subject.time_step * window * mean
        passed.append(momentum_of(subject, dynamics) - before)
    allowed = (subject.damper if damped else subject.impulse) * np.abs(passed).max()
    np.testing.assert_allclose(-impulse, passed[-1], rtol=0.0, atol=allowed)


def test_energy_of_free_motion_errs_by_the_square_of_the_time_step(subject: Subject) -> None:
    errors = []
    for refinement in (1, 2):
        dynamics = subject.make(temperature=0.0, time_step=2.0 * subject.time_step / refinement)
        dynamics.draw_velocities(2.0 * subject.temperature)
        anchors = anchors_of(subject, damped=False)
        dynamics.adopt(anchors)
        energies = []
        for _ in range(40):
            window = dynamics.run_window(refinement)
            energies.append(energy_of(window) + anchors.spring_energy(window.position, anchors.position))
        errors.append(float(np.std(energies)))
    assert 3.2 < errors[0] / errors[1] < 5.0


@pytest.mark.parametrize("temperature", [0.0, 1.0], ids=["cold", "noisy"])
def test_work_account_closes(subject: Subject, temperature: float) -> None:
    window, windows = 10, 15
    dynamics = subject.make(temperature=temperature * subject.temperature, time_step=0.5 * subject.time_step)
    dynamics.draw_velocities(2.0 * subject.temperature)
    anchors = anchors_of(subject)
    dynamics.adopt(anchors)
    last = dynamics.run_window(window)
    at_start, thermostat_before = energy_of(last), last.thermostat_work
    springs, exchanged = 0.0, 0.0
    for _ in range(windows):
        shift(anchors, (2e-12, 1e-12), window * subject.time_step)
        dynamics.move_anchors()
        loaded = anchors.spring_energy(last.position, anchors.position)
        last = dynamics.run_window(window)
        given = loaded - anchors.spring_energy(last.position, anchors.position)
        springs += given
        exchanged += abs(given)
    gained = energy_of(last) - at_start
    account = springs + last.thermostat_work - thermostat_before
    assert abs(last.thermostat_work - thermostat_before) > 0.01 * exchanged
    assert abs(gained - account) < subject.work * exchanged


@pytest.mark.parametrize("thermostat", [None, "langevin", "nose-hoover", "andersen"])
def test_restored_run_goes_on_bit_by_bit(subject: Subject, thermostat: str | None) -> None:
    window = 4
    dynamics = subject.make()
    dynamics.draw_velocities(subject.temperature)
    dynamics.adopt(anchors_of(subject))
    if thermostat is not None:
        dynamics.hold(Ensemble(thermostat, subject.temperature, 6 * subject.time_step))  # type: ignore[arg-type]
    dynamics.run_window(window)
    state = {name: np.array(value) for name, value in dynamics.state().items()}
    other = subject.make(seed=7)
    other.restore(state)
    assert other.step == window
    for run in (dynamics, other):
        assert run.anchors is not None
        shift(run.anchors, (1e-12, 0.0), window * subject.time_step)
        run.move_anchors()
    pairs = [(dynamics.run_window(window), other.run_window(window)) for _ in range(3)]
    for one, two in pairs:
        for name, value in vars(one).items():
            np.testing.assert_array_equal(value, getattr(two, name), err_msg=name)
    np.testing.assert_array_equal(dynamics.position(), other.position())
    np.testing.assert_array_equal(dynamics.velocity(), other.velocity())


def test_state_of_another_system_is_refused(subject: Subject) -> None:
    dynamics = subject.make()
    state = dynamics.state()
    with pytest.raises(ValueError, match="position"):
        dynamics.restore({**state, "position": state["position"][:-1]})
    with pytest.raises(ValueError, match="velocity"):
        dynamics.restore({name: value for name, value in state.items() if name != "velocity"})


@pytest.mark.parametrize("thermostat", ["langevin", "nose-hoover", "berendsen", "andersen"])
def test_ensemble_brings_the_sample_to_its_temperature(subject: Subject, thermostat: str) -> None:
    period = 25 * subject.time_step
    dynamics = subject.make()
    dynamics.adopt(anchors_of(subject, damped=False))
    dynamics.minimise(3000)
    dynamics.draw_velocities(2.0 * subject.temperature)
    dynamics.hold(Ensemble(thermostat, subject.temperature, period))  # type: ignore[arg-type]
    for _ in range(15):
        dynamics.run_window(10)
    kinetic = []
    for _ in range(60):
        window = dynamics.run_window(10)
        kinetic.append(window.kinetic_handshake + window.kinetic_inner)
    freedoms = dynamics.dimension * len(subject.atoms)
    expected = 0.5 * freedoms * BOLTZMANN * subject.temperature
    # Samples 10 steps apart: some 12 independent ones, each with a relative deviation of sqrt(2 / freedoms).
    assert abs(np.mean(kinetic) / expected - 1.0) < 4.0 * np.sqrt(2.0 / freedoms / 12.0)


def test_dampers_of_the_anchors_alone_keep_the_temperature(subject: Subject) -> None:
    dynamics = subject.make()
    dynamics.adopt(anchors_of(subject))
    dynamics.minimise(3000)
    dynamics.draw_velocities(2.0 * subject.temperature)
    lifetime = round(subject.damping_time / subject.time_step / 10)
    kinetic = []
    for number in range(14 * lifetime):
        window = dynamics.run_window(10)
        if number >= 4 * lifetime:
            kinetic.append(window.kinetic_handshake + window.kinetic_inner)
    freedoms = dynamics.dimension * len(subject.atoms)
    expected = 0.5 * freedoms * BOLTZMANN * subject.temperature
    # Ten damping times: some five independent samples.
    assert abs(np.mean(kinetic) / expected - 1.0) < 4.0 * np.sqrt(2.0 / freedoms / 5.0)


def test_drawn_velocities_have_the_temperature_and_no_momentum(subject: Subject) -> None:
    dynamics, again = subject.make(), subject.make()
    for run in (dynamics, again):
        run.draw_velocities(subject.temperature)
    velocity, mass = dynamics.velocity(), subject.atoms.atom_mass
    np.testing.assert_array_equal(velocity, again.velocity())
    scale = np.sum(mass * np.linalg.norm(velocity, axis=1))
    assert np.abs(mass @ velocity).max() < 1e-12 * scale
    freedoms = dynamics.dimension * (len(mass) - 1)
    temperature = np.sum(mass[:, None] * velocity**2) / (freedoms * BOLTZMANN)
    assert abs(temperature / subject.temperature - 1.0) < 4.0 * np.sqrt(2.0 / freedoms)
    if dynamics.dimension == 2:
        np.testing.assert_array_equal(velocity[:, 2], 0.0)


@pytest.mark.parametrize("moving", [False, True], ids=["held", "moving"])
def test_passive_atoms_sit_at_their_anchors_and_feel_what_the_others_lose(subject: Subject, moving: bool) -> None:
    window, windows = 10, 8
    dynamics = subject.make(temperature=0.0)
    dynamics.draw_velocities(subject.temperature)
    anchors = anchors_of(subject, passive=True, moving=moving)
    dynamics.adopt(anchors)
    inner = np.setdiff1d(np.arange(len(subject.atoms)), anchors.atom_id)
    anchors.velocity[:, :2] = np.array([2e-12, -1e-12]) / (window * subject.time_step)
    momentum, impulse, last = [], [np.zeros(3)], []
    for number in range(windows):
        if moving and number:
            anchors.position[:] = anchors.end_position(window, subject.time_step)
        elif number == 0:
            anchors.position[:, :2] += [2e-12, -1e-12]
        dynamics.move_anchors()
        means = dynamics.run_window(window)
        place = anchors.end_position(window, subject.time_step)
        np.testing.assert_allclose(means.position, place, rtol=0.0, atol=1e-10 * np.abs(place).max())
        assert means.kinetic_handshake == 0.0
        momentum.append(momentum_of(subject, dynamics, inner))
        if number:
            impulse.append(impulse[-1] - subject.time_step * window * means.mean_pair_force.sum(axis=0))
        last.append(np.abs(means.mean_pair_force.sum(axis=0)).max())
    # From the end of the first window on. The mean leaves out half of its first moment and counts the last one whole.
    gained = np.array(momentum) - momentum[0]
    allowed = subject.time_step * max(last) + subject.impulse * np.abs(np.array(momentum)).max()
    assert np.abs(gained).max() > 4.0 * allowed
    np.testing.assert_allclose(impulse, gained, rtol=0.0, atol=allowed)


def test_work_of_passive_atoms_is_in_the_account(subject: Subject) -> None:
    window, windows = 10, 12
    dynamics = subject.make(temperature=0.0)
    anchors = anchors_of(subject, passive=True, moving=True)
    dynamics.adopt(anchors)
    # The wave of an edge that is set in motion.
    last = dynamics.run_window(window)
    at_start, work_before = energy_of(last), last.thermostat_work
    for number in range(windows):
        anchors.position[:] = anchors.end_position(window, subject.time_step)
        stretch = (2e-2 if number < windows // 2 else -1e-2) / windows
        anchors.velocity[:] = stretch * anchors.position / (window * subject.time_step)
        dynamics.move_anchors()
        last = dynamics.run_window(window)
    gained = energy_of(last) - at_start
    assert abs(gained - (last.thermostat_work - work_before)) < 0.02 * abs(gained)


def test_minimum_has_no_forces_and_no_motion(subject: Subject) -> None:
    dynamics = subject.make(temperature=0.0)
    anchors = anchors_of(subject)
    dynamics.adopt(anchors)
    anchors.position[:, 0] *= 1.01
    dynamics.move_anchors()
    start = dynamics.run_window(1)
    dynamics.minimise(20000)
    assert dynamics.step == 1
    np.testing.assert_array_equal(dynamics.velocity(), 0.0)
    found = dynamics.run_window(20)
    # What forces are left has set the atoms in motion.
    left = subject.atoms.atom_mass[:, None] * dynamics.velocity() / (20 * subject.time_step)
    pulled = subject.stiffness * 0.01 * np.abs(subject.atoms.position).max()
    assert np.abs(left).max() < max(1e-5, 3.0 * subject.rounding) * pulled

    def energy(window: Window) -> float:
        return energy_of(window) + anchors.spring_energy(window.position, anchors.position)

    assert energy(found) < energy(start)


def test_exploding_time_step_names_atom_step_and_cure(subject: Subject) -> None:
    dynamics = subject.make(time_step=100.0 * subject.time_step)
    dynamics.draw_velocities(subject.temperature)
    state = dynamics.state()
    with pytest.raises(EngineError, match=r"(?s)(?=.*atom \d+)(?=.*\(.*step.*\d+)(?=.*time step)"):
        dynamics.run(200)
    assert "atom" in dynamics.failure
    dynamics.restore(state)
    assert dynamics.failure == ""


def test_atoms_share_the_whole_energy_and_a_virial_that_follows_the_stretch(subject: Subject) -> None:
    energies, virials = [], []
    for stretch in (-1e-4, 0.0, 1e-4):
        dynamics = subject.make(temperature=0.0)
        anchors = checked_anchors(
            np.arange(len(subject.atoms)), subject.atoms.position * [1.01 + stretch, 1.0, 1.0],
            np.ones(len(subject.atoms)), np.zeros(len(subject.atoms), dtype=np.int64), None, subject.atoms.atom_mass,
            np.full(len(subject.atoms), PASSIVE),
        )  # fmt: skip
        dynamics.adopt(anchors)
        window = dynamics.run_window(1)
        virial, energy = dynamics.virial_and_energy()
        assert virial.shape == (len(subject.atoms), 6)
        assert energy.sum() == pytest.approx(window.potential_energy, rel=max(1e-9, subject.rounding))
        energies.append(float(energy.sum()))
        virials.append(float(virial[:, 0].sum()))
    # dU/d(ln stretch) is the virial, tension positive.
    slope = (energies[2] - energies[0]) / 2e-4 * 1.01
    assert virials[1] == pytest.approx(slope, rel=2e-3)
    assert virials[1] > 0.0
