"""The harmonic lattice against closed forms."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from md_service.anchors import checked_anchors
from md_service.crystals import chain, fcc, hexagonal
from md_service.engine import Engine
from md_service.ensembles import Ensemble
from md_service.lattice_dynamics import LATTICE, SPRINGS, LatticeForces
from md_service.units import BOLTZMANN
from md_service.velocity_verlet import VelocityVerlet

HARMONIC = SPRINGS["harmonic"]
A, K = HARMONIC.spacing, HARMONIC.stiffness


def no_progress(done: int, total: int) -> None:
    """Nobody watches."""


def test_constants_of_the_sheet_are_those_of_the_closed_form(tmp_path: Path) -> None:
    measured = LATTICE.properties(tmp_path, "harmonic", "hexagonal", 0.0, 1, no_progress)
    assert measured.lattice_constant == pytest.approx(A, rel=1e-9)
    assert measured.young == pytest.approx(2.0 * K / (np.sqrt(3.0) * measured.thickness), rel=1e-6)
    assert measured.young == pytest.approx(HARMONIC.young(measured.thickness), rel=1e-6)
    assert measured.poisson == pytest.approx(1.0 / 3.0, rel=1e-6)
    sheet = hexagonal(A, 6 * A, 6 * A)
    per_atom = 0.5 * np.sqrt(3.0) * A**2 * measured.thickness
    assert measured.density == pytest.approx(sheet.mass[0] / per_atom, rel=1e-9)


def test_constants_at_a_temperature_are_those_at_rest(tmp_path: Path) -> None:
    cold, warm = (LATTICE.properties(tmp_path, "harmonic", "hexagonal", t, 1, no_progress) for t in (0.0, 300.0))
    assert (warm.young, warm.temperature) == (cold.young, 300.0)


def test_fcc_crystal_has_the_closed_form_of_nearest_neighbour_springs() -> None:
    from md_service.elastic_tensor import SOLID
    from md_service.static_constants import _stiffness

    tensor = _stiffness(lambda atoms: LatticeForces(atoms, HARMONIC), fcc("Ar", A, (2, 2, 2)), SOLID)
    direct = np.sqrt(2.0) * K / A
    np.testing.assert_allclose(np.diag(tensor), direct * np.array([1, 1, 1, 0.5, 0.5, 0.5]), rtol=1e-5)
    np.testing.assert_allclose(tensor[[0, 0, 1], [1, 2, 2]], 0.5 * direct, rtol=1e-5)
    np.testing.assert_allclose(tensor[3:, :3], 0.0, atol=1e-5 * direct)


@pytest.mark.parametrize("axis", [0, 1], ids=["longitudinal", "transverse"])
def test_frequency_of_a_wave_follows_the_dispersion_of_the_lattice(axis: int) -> None:
    sheet = hexagonal(A, 16 * A, 4 * A, periodic=True)
    step = 1e-15
    dynamics = VelocityVerlet(sheet, LatticeForces(sheet, HARMONIC), temperature=0.0, seed=1, time_step=step)
    length = 2.0 * np.pi / (sheet.box.high[0] - sheet.box.low[0])
    shape = np.cos(length * sheet.position[:, 0])
    state = dynamics.state()
    state["velocity"][:, axis] = 0.1 * shape
    dynamics.restore(state)
    amplitude = [0.0]
    for _ in range(4000):
        dynamics.run(1)
        amplitude.append(float(shape @ (dynamics.position() - sheet.position)[:, axis]))
    rising = np.array(amplitude)
    crossings = np.flatnonzero(rising[:-1] * rising[1:] < 0.0)
    moments = crossings + rising[crossings] / (rising[crossings] - rising[crossings + 1])
    period = 2.0 * step * (moments[-1] - moments[0]) / (len(moments) - 1)
    # Six neighbours: two along the wave, four at 60 degrees.
    along, oblique = 1.0 - np.cos(length * A), 1.0 - np.cos(0.5 * length * A)
    squared = K / sheet.mass[0] * ((2.0 * along + oblique) if axis == 0 else 3.0 * oblique)
    assert len(moments) > 6
    assert 2.0 * np.pi / period == pytest.approx(np.sqrt(squared), rel=1e-3)


def test_forces_are_the_slope_of_the_energy() -> None:
    sheet = hexagonal(A, 6 * A, 6 * A, periodic=True)
    rng = np.random.default_rng(2)
    position = sheet.position + rng.normal(0.0, 0.03 * A, sheet.position.shape)
    forces = LatticeForces(sheet, HARMONIC)
    force, energy = forces.forces(position)
    np.testing.assert_allclose(force.sum(axis=0), 0.0, atol=1e-12 * np.abs(force).max())
    h = 1e-5 * A
    for row, axis in ((0, 0), (7, 1), (20, 2)):
        moved = position.copy()
        moved[row, axis] += h
        above = forces.forces(moved)[1]
        moved[row, axis] -= 2.0 * h
        below = forces.forces(moved)[1]
        assert force[row, axis] == pytest.approx(-(above - below) / (2.0 * h), rel=1e-6)
    virial, energies = forces.virial_and_energy(position)
    assert energies.sum() == pytest.approx(energy, rel=1e-12)
    assert virial.shape == (len(sheet), 6)


def test_stress_of_a_stretched_sheet_is_that_of_plane_stress() -> None:
    strain = 1e-4
    sheet = hexagonal(A, 6 * A, 6 * A, periodic=True)
    stretched = sheet.position * [1.0 + strain, 1.0, 1.0]
    from md_service.atoms import Box

    box = Box(sheet.box.low * [1 + strain, 1, 1], sheet.box.high * [1 + strain, 1, 1], sheet.box.periodic)
    virial, _ = LatticeForces(sheet.at(stretched, box), HARMONIC).virial_and_energy(stretched)
    stress = virial.sum(axis=0) / sheet.volume
    young = HARMONIC.young(float(sheet.thickness or 0.0))
    direct = young / (1.0 - 1.0 / 9.0) * strain
    np.testing.assert_allclose(stress[:2], [direct, direct / 3.0], rtol=1e-3)
    np.testing.assert_allclose(stress[2:], 0.0, atol=1e-3 * direct)


def test_brittle_spring_keeps_its_energy_and_lets_go() -> None:
    springs = SPRINGS["harmonic-brittle"]
    sheet = hexagonal(A, 3 * A, 3 * A)
    forces = LatticeForces(sheet, springs)
    apart = sheet.position * 1.2
    force, energy = forces.forces(apart)
    np.testing.assert_array_equal(force, 0.0)
    assert energy == pytest.approx(len(forces.first) * 0.5 * K * (0.15 * A) ** 2, rel=1e-12)
    held, _ = forces.forces(sheet.position * 1.14)
    assert np.abs(held).max() > 0.0
    profile = LATTICE.force_field("harmonic-brittle")
    assert profile.switching_end == pytest.approx(1.15 * A)
    assert LATTICE.force_field("harmonic").switching_end is None


def test_reaction_of_a_strained_sheet_is_the_force_in_its_middle() -> None:
    strain, rows = 0.01, 24
    sheet = hexagonal(A, 24 * A, rows * 0.5 * np.sqrt(3.0) * A)
    half = np.abs(sheet.position[:, :2]).max(axis=0)
    frame = np.flatnonzero((np.abs(sheet.position[:, :2]) > half - 4.0 * A).any(axis=1))
    dynamics = LATTICE.make(Path(), "harmonic", sheet, temperature=0.0, seed=1, time_step=1e-15)
    engine = Engine(dynamics, temperature=0.0, force_field=LATTICE.force_field("harmonic"))
    place = sheet.position[frame]
    side = (place[:, 0] > 0.0).astype(np.int64)
    engine.register_anchors(frame, place, np.full(len(frame), 2000.0), side, 2e-14)
    engine.equilibrate(200)
    engine.measure_reference(8, 10)
    forces, positions = [], []
    for number in range(300):
        # Loaded slowly, so that no waves are left to average out.
        load = strain * min(1.0, (number + 1) / 200.0)
        speed = place * [strain / 200.0 / 1e-14, 0.0, 0.0] if number < 200 else np.zeros_like(place)
        forces.append(engine.advance(10, place * [1.0 + load, 1.0, 1.0], speed).ivc_force)
        positions.append(dynamics.position())
    force, position = np.mean(forces[200:], axis=0), np.mean(positions[200:], axis=0)
    # One bond of each row and one oblique bond between rows cross the middle.
    section = K * strain * A * (rows + (rows - 1) / 8.0)
    np.testing.assert_allclose(force[:, 0], [section, -section], rtol=1e-2)
    np.testing.assert_allclose(force[:, 2], 0.0, atol=1e-12 * section)
    inner = np.flatnonzero(np.abs(sheet.position[:, :2]).max(axis=1) < 6.0 * A)
    slope = np.polyfit(sheet.position[inner, 0], (position - sheet.position)[inner, 0], 1)[0]
    assert slope == pytest.approx(strain, rel=5e-3)


@pytest.mark.parametrize("thermostat", ["langevin", "andersen"])
def test_kinetic_energy_fluctuates_as_in_the_canonical_ensemble(thermostat: str) -> None:
    sheet = hexagonal(A, 6 * A, 6 * A, periodic=True)
    dynamics = VelocityVerlet(sheet, LatticeForces(sheet, HARMONIC), temperature=300.0, seed=3, time_step=1e-15)
    dynamics.draw_velocities(600.0)
    dynamics.hold(Ensemble(thermostat, 300.0, 4e-14))  # type: ignore[arg-type]
    dynamics.run(600)
    kinetic = []
    for _ in range(1500):
        dynamics.run(6)
        kinetic.append(float(0.5 * sheet.atom_mass @ np.sum(dynamics.velocity() ** 2, axis=1)))
    # Noise and new draws set the total momentum in motion too.
    freedoms = 2 * len(sheet)
    assert np.mean(kinetic) == pytest.approx(0.5 * freedoms * BOLTZMANN * 300.0, rel=0.03)
    assert np.var(kinetic) / np.mean(kinetic) ** 2 == pytest.approx(2.0 / freedoms, rel=0.25)


def test_nose_hoover_chain_keeps_its_conserved_energy() -> None:
    # A lattice of springs is no test of its temperature fluctuations: its vibrations hardly exchange energy.
    temperature, period = 300.0, 4e-14
    sheet = hexagonal(A, 6 * A, 6 * A, periodic=True)
    forces = LatticeForces(sheet, HARMONIC)
    freedoms, kt = 2 * (len(sheet) - 1), BOLTZMANN * temperature
    masses = kt * period**2 * np.array([freedoms, 1.0, 1.0])
    errors = []
    for step in (1e-15, 0.5e-15):
        dynamics = VelocityVerlet(sheet, forces, temperature=temperature, seed=3, time_step=step)
        dynamics.draw_velocities(2.0 * temperature)
        dynamics.hold(Ensemble("nose-hoover", temperature, period))
        turned, last = np.zeros(3), np.zeros(3)
        atoms, whole = [], []
        for _ in range(round(1e-12 / step)):
            dynamics.run(1)
            rate = dynamics.state()["chain"]
            turned += 0.5 * step * (last + rate)
            last = rate
            kinetic = float(0.5 * sheet.atom_mass @ np.sum(dynamics.velocity() ** 2, axis=1))
            atoms.append(kinetic + forces.forces(dynamics.position())[1])
            chain = 0.5 * float(masses @ rate**2) + kt * float(freedoms * turned[0] + turned[1] + turned[2])
            whole.append(atoms[-1] + chain)
        errors.append(np.ptp(whole) / np.ptp(atoms))
    assert errors[0] < 0.02
    assert 3.0 < errors[0] / errors[1] < 7.0


def test_ensembles_that_it_cannot_hold_are_refused() -> None:
    sheet = hexagonal(A, 6 * A, 6 * A)
    dynamics = LATTICE.make(Path(), "harmonic", sheet, temperature=0.0, seed=1, time_step=1e-15)
    with pytest.raises(ValueError, match=r"pressure is 100000\.0 Pa; this engine keeps its box"):
        dynamics.hold(Ensemble("berendsen", 300.0, pressure=1e5))
    with pytest.raises(ValueError, match="temperature is 0 K"):
        dynamics.hold(Ensemble("nose-hoover", 0.0))
    with pytest.raises(ValueError, match="damping_time"):
        dynamics.hold(Ensemble("langevin", 300.0, 1e-16))


def test_wrong_lattice_and_names_are_refused() -> None:
    with pytest.raises(ValueError, match="spacing"):
        LatticeForces(hexagonal(1.15 * A, 6 * A, 6 * A), HARMONIC)
    with pytest.raises(ValueError, match="no atoms nearer"):
        LatticeForces(hexagonal(1.5 * A, 6 * A, 6 * A), HARMONIC)
    with pytest.raises(ValueError, match=r"force_field is 'tersoff'.*harmonic"):
        LATTICE.spacing("tersoff", "hexagonal")
    with pytest.raises(ValueError, match="material is 'graphene'"):
        LATTICE.spacing("harmonic", "graphene")


def test_damping_shorter_than_the_step_is_refused() -> None:
    sheet = hexagonal(A, 6 * A, 6 * A)
    dynamics = LATTICE.make(Path(), "harmonic", sheet, temperature=0.0, seed=1, time_step=1e-15)
    anchors = checked_anchors([0], sheet.position[:1], [1.0], [0], 0.9e-15, sheet.atom_mass)
    with pytest.raises(ValueError, match="damping_time"):
        dynamics.adopt(anchors)


def test_chain_is_a_bar_with_the_constants_that_are_stated(tmp_path: Path) -> None:
    """Pulled by a force at its ends, and hit at one: modulus from its stretch, density from its wave speed."""
    stated = LATTICE.properties(tmp_path, "harmonic", "chain", 0.0, 1, no_progress)
    sheet = LATTICE.properties(tmp_path, "harmonic", "hexagonal", 0.0, 1, no_progress)
    assert (stated.young, stated.density) == pytest.approx((sheet.young, sheet.density), rel=1e-6)
    assert (stated.poisson, stated.thickness) == (0.0, sheet.thickness)
    bar = chain(A, 60 * A)
    area = A**2 / np.sqrt(2.0)
    assert np.prod((bar.box.high - bar.box.low)[1:]) == pytest.approx(area, rel=1e-12)
    force = 1e-10
    still, pulled = np.zeros_like(bar.position), bar.position.copy()
    pulled[:, 0] *= 1.0 + force / (area * stated.young)
    forces = LatticeForces(bar, HARMONIC)
    still[0, 0], still[-1, 0] = force, -force
    np.testing.assert_allclose(forces.forces(pulled)[0], still, rtol=0.0, atol=1e-9 * force)

    wave = chain(A, 64 * A, periodic=True)
    dynamics = VelocityVerlet(wave, LatticeForces(wave, HARMONIC), temperature=0.0, seed=1, time_step=1e-15)
    number = 2.0 * np.pi / (64 * A)
    state = dynamics.state()
    state["velocity"][:, 0] = 0.1 * np.cos(number * wave.position[:, 0])
    dynamics.restore(state)
    dynamics.run(500)
    amplitude = 2.0 / 64 * np.cos(number * wave.position[:, 0]) @ (dynamics.position() - wave.position)[:, 0]
    # Of a standing wave; the row is slower than the bar by (q a)^2 / 24, 4e-4 here.
    speed = np.sqrt(stated.young / stated.density)
    frequency = speed * number * (1.0 - (number * A) ** 2 / 24.0)
    assert amplitude == pytest.approx(0.1 / frequency * np.sin(frequency * 500e-15), rel=1e-3)
    assert not dynamics.position()[:, 1:].any() and not dynamics.velocity()[:, 1:].any()


def test_chain_at_a_temperature_moves_along_itself_only() -> None:
    bar = chain(A, 200 * A)
    dynamics = VelocityVerlet(bar, LatticeForces(bar, HARMONIC), temperature=0.0, seed=1, time_step=1e-15)
    assert dynamics.dimension == 1
    dynamics.hold(Ensemble("langevin", 100.0, 2e-14))
    kinetic = []
    for _ in range(400):
        dynamics.run(20)
        kinetic.append(0.5 * bar.mass[0] * np.sum(dynamics.velocity() ** 2))
    # Half a kT an atom; 200 atoms and about 100 independent samples.
    assert np.mean(kinetic[100:]) == pytest.approx(0.5 * 200 * BOLTZMANN * 100.0, rel=0.03)
    assert not dynamics.position()[:, 1:].any() and not dynamics.velocity()[:, 1:].any()


def test_chain_that_is_too_short_is_refused() -> None:
    with pytest.raises(ValueError, match="holds 2 atoms"):
        chain(A, 2 * A)
