"""Ensembles on copper: temperature and pressure that they hold, and the work that they do."""

from pathlib import Path

import numpy as np
import pytest

from md_service.crystals import fcc, hexagonal
from md_service.ensembles import Ensemble
from md_service.force_fields import force_field
from md_service.lammps_dynamics import LammpsDynamics

BOLTZMANN = 1.380649e-23
TEMPERATURE = 300.0


def copper(folder: Path, seed: int = 3, spacing_factor: float = 1.0) -> LammpsDynamics:
    profile = force_field("eam-copper")
    atoms = fcc("Cu", profile.spacing("copper", 0.0) * spacing_factor, (4, 4, 4))
    return LammpsDynamics(folder, profile, atoms, temperature=TEMPERATURE, seed=seed, time_step=2e-15)


def kinetic_energy(dynamics: LammpsDynamics) -> float:
    velocity = dynamics.velocity()
    return 0.5 * float(dynamics.atoms.atom_mass @ np.einsum("ij,ij->i", velocity, velocity))


@pytest.mark.parametrize("thermostat", ["langevin", "nose-hoover", "berendsen", "andersen"])
def test_a_thermostat_holds_the_temperature_of_equipartition(tmp_path, thermostat):
    dynamics = copper(tmp_path)
    dynamics.draw_velocities(TEMPERATURE)
    dynamics.hold(Ensemble(thermostat, TEMPERATURE, 1e-13))
    dynamics.run(1000)
    kinetic = []
    for _ in range(100):
        dynamics.run(20)
        kinetic.append(kinetic_energy(dynamics))
    dynamics.close()
    # 256 atoms without momentum of the whole have 765 degrees of freedom; Langevin noise gives it back.
    freedom = 768 if thermostat == "langevin" else 765
    expected = 0.5 * freedom * BOLTZMANN * TEMPERATURE
    # The standard deviation of kinetic energy in NVT is sqrt(2 / freedom), here 5.1 %; 4 ps hold some 15
    # independent values, so the mean scatters by 1.3 %.
    assert np.mean(kinetic) == pytest.approx(expected, rel=0.04)
    if thermostat != "berendsen":  # which is known not to sample the canonical ensemble
        assert np.std(kinetic) / expected == pytest.approx(np.sqrt(2.0 / freedom), rel=0.5)


def test_npt_lets_the_box_relax_to_the_pressure(tmp_path):
    dynamics = copper(tmp_path, spacing_factor=1.01)
    dynamics.draw_velocities(TEMPERATURE)
    dynamics.hold(Ensemble("nose-hoover", TEMPERATURE, 1e-13, pressure=0.0, pressure_time=5e-13))
    dynamics.run(1500)
    edges = []
    for _ in range(50):
        dynamics.run(20)
        edges.append(dynamics.box().high - dynamics.box().low)
    dynamics.close()
    # Mishin et al., Phys. Rev. B 63, 224106 (2001): 3.615 A at 0 K; linear expansion of copper 16.5e-6 / K.
    expected = 4 * 3.615e-10 * (1.0 + 16.5e-6 * TEMPERATURE)
    assert np.mean(edges) == pytest.approx(expected, rel=2e-3)


def test_pressure_needs_a_periodic_direction(make_sample):
    with pytest.raises(ValueError, match=r"pressure is 0\.0 Pa, but the sample is periodic in no direction"):
        make_sample().engine.dynamics.hold(Ensemble("langevin", 300.0, pressure=0.0))


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ({"thermostat": "csvr"}, "thermostat is 'csvr'; known are none, langevin"),
        ({"temperature": -1.0}, "temperature is -1.0 K"),
        ({"damping_time": 0.0}, "damping_time is 0.0 s"),
        ({"pressure": np.nan}, "pressure is nan Pa"),
    ],
)
def test_bad_ensembles_are_refused(wrong, sentence):
    with pytest.raises(ValueError, match=sentence):
        Ensemble(**{"thermostat": "langevin", "temperature": 300.0, **wrong})


@pytest.mark.parametrize("thermostat", ["langevin", "nose-hoover", "berendsen", "andersen"])
def test_work_of_a_global_thermostat_is_the_energy_of_the_atoms(make_sample, thermostat):
    """Springs and thermostat account for every change of the atoms' energy, up to the order of the step."""
    sample = make_sample(damping_time=None)
    engine = sample.engine
    engine.equilibrate(200, ensemble=Ensemble(thermostat, 300.0, 5e-14), keep_ensemble=True)
    engine.measure_reference(8, 10)
    still = np.zeros_like(sample.anchor)
    first = engine.advance(10, sample.anchor, still)
    missing, exchanged = [], 0.0
    for step in range(40):
        anchor = sample.anchor * [1.0 + 1e-3 * step, 1.0, 1.0]
        last = engine.advance(10, anchor, still)
        gained = last.potential_energy + last.kinetic_energy - first.potential_energy - first.kinetic_energy
        missing.append(last.anchor_work - first.anchor_work - gained)
        exchanged = max(exchanged, abs(gained))
    assert exchanged > 1e-19
    assert np.abs(missing).max() < 0.02 * exchanged
    assert last.thermostat_work != 0.0


@pytest.mark.parametrize("thermostat", ["langevin", "nose-hoover", "berendsen", "andersen"])
def test_a_restored_run_goes_on_bit_by_bit_under_a_global_thermostat(make_sample, thermostat):
    sample = make_sample()
    engine = sample.engine
    engine.equilibrate(100, ensemble=Ensemble(thermostat, 300.0, 2e-14), keep_ensemble=True)
    engine.measure_reference(8, 10)
    state = engine.state()

    def onward():
        for _ in range(5):
            last = engine.advance(10, sample.anchor, np.zeros_like(sample.anchor))
        return last, engine.fields(["position"])["position"]

    (first, position), _ = onward(), engine.restore(state)
    again, same_position = onward()
    np.testing.assert_array_equal(first.anchor_force, again.anchor_force)
    np.testing.assert_array_equal(position, same_position)
    assert first.anchor_work == again.anchor_work


def test_an_equilibration_ends_when_energy_and_stress_have_settled(make_sample):
    engine = make_sample(damping_time=5e-14).engine
    ended = engine.equilibrate(6000, settle=True)
    assert ended.settled
    assert 3000 < ended.steps < 6000
    assert abs(ended.energy_drift) <= ended.energy_error
    assert np.mean((ended.stress_drift / ended.stress_error) ** 2) <= 1.0


def test_an_equilibration_that_does_not_settle_says_so(make_sample, monkeypatch):
    """A sample of atoms that still heat up through few weak dampers drifts to the end."""
    sample = make_sample(damping_time=2e-12, frame=2e-10)
    ended = sample.engine.equilibrate(700, settle=True, ensemble=Ensemble("langevin", 10.0, 5e-14))
    assert ended.settled is False
    assert ended.steps == 700
    assert ended.energy_drift > ended.energy_error


@pytest.mark.parametrize("thermostat", ["langevin", "nose-hoover", "berendsen", "andersen"])
def test_a_flat_sheet_of_pairwise_forces_moves_in_its_plane_at_the_temperature(tmp_path, thermostat):
    profile = force_field("lennard-jones")
    spacing = profile.spacing("hexagonal", 20.0)
    atoms = hexagonal(spacing, 16 * spacing, 14 * spacing, periodic=True)
    dynamics = LammpsDynamics(tmp_path, profile, atoms, temperature=20.0, seed=5)
    assert dynamics.dimension == 2
    dynamics.draw_velocities(20.0)
    dynamics.hold(Ensemble(thermostat, 20.0, 3e-13))
    dynamics.run(600)
    kinetic = []
    for _ in range(100):
        dynamics.run(20)
        kinetic.append(kinetic_energy(dynamics))
    assert (dynamics.position()[:, 2] == 0.0).all()
    assert (dynamics.velocity()[:, 2] == 0.0).all()
    dynamics.close()
    # About 220 atoms of two degrees of freedom scatter by 7 %, in 10 ps some 15 times independently.
    assert np.mean(kinetic) == pytest.approx(len(atoms) * BOLTZMANN * 20.0, rel=0.06)
