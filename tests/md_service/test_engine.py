import numpy as np
import pytest

from md_service.engine import Engine
from md_service.errors import EngineError
from md_service.force_fields import force_field
from md_service.graphene import graphene
from md_service.lammps_dynamics import LammpsDynamics
from md_service.statistics import estimate

CARBON_MASS = 12.011e-3 / 6.02214076e23
ANGSTROM = 1e-10
METRE_PER_SECOND = 100.0  # per Angstrom/ps


def pulled(sample, strain):
    return sample.anchor * [1.0 + strain, 1.0, 1.0]


def store_trajectory(sample, path):
    """Let LAMMPS write every step to a file of its own."""
    sample.engine.dynamics._system.session.commands(
        [f"dump all_steps all custom 1 {path} id x y z vx vy vz", "dump_modify all_steps sort id format float %.17g"]
    )


def read_trajectory(path, n_atoms):
    lines = path.read_text().splitlines()
    frames = {}
    for start in range(0, len(lines), n_atoms + 9):
        rows = np.array([line.split() for line in lines[start + 9 : start + 9 + n_atoms]], dtype=float)
        frames[int(lines[start + 1])] = (rows[:, 1:4] * ANGSTROM, rows[:, 4:7] * METRE_PER_SECOND)
    return frames


def test_reaction_is_that_of_the_mean_positions_in_an_independent_trajectory(make_sample, tmp_path):
    sample = make_sample()
    engine, k = sample.engine, sample.stiffness[:, None]
    engine.equilibrate(100)
    store_trajectory(sample, tmp_path / "trajectory")
    reference = engine.measure_reference(8, 10).anchor_force
    anchor, velocity = pulled(sample, 0.01), pulled(sample, 0.01) * 1e11
    got = [engine.advance(10, anchor, velocity), engine.advance(10, 1.001 * anchor, velocity)]
    frames = read_trajectory(tmp_path / "trajectory", engine.n_atoms)

    def mean_over(steps, index):
        # The moment at the window's start and the one at its end count half.
        values = [frames[step][index][sample.atom_id] for step in (steps[0] - 1, *steps)]
        return np.trapezoid(values, axis=0) / len(steps)

    def expected(steps, held, speed):
        return k * (mean_over(steps, 0) - held) - sample.damping[:, None] * (speed - mean_over(steps, 1))

    at_rest = np.mean([expected(range(10 * w + 1, 10 * w + 11), sample.anchor, 0.0) for w in range(8)], axis=0)
    at_rest -= at_rest.mean(axis=0)  # a sample that is held gains no momentum
    scale = np.abs(at_rest).max()
    np.testing.assert_allclose(reference, at_rest, atol=1e-9 * scale)
    for w, (answer, held) in enumerate(zip(got, [anchor, 1.001 * anchor], strict=True)):
        force = expected(range(81 + 10 * w, 91 + 10 * w), held, velocity) - at_rest
        np.testing.assert_allclose(answer.anchor_force, force, atol=1e-9 * np.abs(force).max())
        by_cell = np.array([force[sample.ivc == cell].sum(axis=0) for cell in range(4)])
        np.testing.assert_allclose(answer.ivc_force, by_cell, atol=1e-9 * np.abs(by_cell).max())


def test_impulse_of_the_anchors_is_the_change_of_momentum(make_sample):
    """Undamped: the total momentum changes by the anchors' impulse alone, as pair forces sum to zero."""
    sample = make_sample(damping_time=None)
    engine = sample.engine
    engine.equilibrate(200)
    reference = engine.measure_reference(8, 10).anchor_force
    anchor = sample.anchor + np.array([0.3e-10, -0.2e-10, 0.1e-10])
    still = np.zeros_like(anchor)
    engine.advance(10, anchor, still)

    momentum = CARBON_MASS * engine.fields(["velocity"])["velocity"].sum(axis=0)
    impulse = np.zeros(3)
    for _ in range(5):
        answer = engine.advance(10, anchor, still)
        impulse -= 10 * engine.time_step * (answer.anchor_force + reference).sum(axis=0)
    momentum_after = CARBON_MASS * engine.fields(["velocity"])["velocity"].sum(axis=0)
    np.testing.assert_allclose(impulse, momentum_after - momentum, rtol=1e-6)
    assert np.linalg.norm(impulse) > 1e-23


def energy_fluctuation(sample, windows, window):
    engine = sample.engine
    engine.measure_reference(8, window)
    still = np.zeros_like(sample.anchor)
    energy = []
    for _ in range(windows):
        now = engine.advance(window, sample.anchor, still)
        energy.append(now.potential_energy + now.kinetic_energy + now.spring_energy)
    return np.std(energy), np.mean(now.kinetic_energy)


def test_energy_is_conserved_without_dampers_to_second_order(make_sample):
    fluctuation = []
    for time_step, window in ((0.8e-15, 3), (0.4e-15, 6)):
        sample = make_sample(damping_time=None, time_step=time_step)
        sample.engine.equilibrate(int(200e-15 / time_step))
        spread, kinetic = energy_fluctuation(sample, 150, window)
        assert spread < 2e-3 * kinetic
        fluctuation.append(spread)
    assert 3.0 < fluctuation[0] / fluctuation[1] < 5.3


@pytest.mark.parametrize("temperature", [0.0, 300.0])
def test_work_of_anchors_is_the_energy_of_the_atoms(make_sample, temperature):
    """Springs, dampers and noise account for every change of the atoms' energy, up to the order of the step."""
    sample = make_sample(temperature=temperature)
    engine = sample.engine
    engine.equilibrate(400)
    engine.measure_reference(8, 10)
    first = engine.advance(10, sample.anchor, np.zeros_like(sample.anchor))
    difference, exchanged = [], 0.0
    for i in range(40):
        speed = sample.anchor * [1e-3 / (10 * engine.time_step), 0.0, 0.0]
        last = engine.advance(10, pulled(sample, 1e-3 * i), speed)
        gained = last.potential_energy + last.kinetic_energy - first.potential_energy - first.kinetic_energy
        difference.append(last.anchor_work - first.anchor_work - gained)
        exchanged = max(exchanged, abs(gained))
    assert exchanged > 1e-19
    assert np.abs(difference).max() < 0.02 * exchanged


def test_force_after_the_reference_is_taken_off_vanishes_without_load(make_sample):
    sample = make_sample(seed=11)
    engine, windows = sample.engine, 200
    engine.equilibrate(1000)
    reference = engine.measure_reference(windows, 10)
    still = np.zeros_like(sample.anchor)
    force = np.array([engine.advance(10, sample.anchor, still).ivc_force for _ in range(windows)])
    mean = force.mean(axis=0)
    # The reference is balanced, these means are not: each has its own error.
    own = estimate(force, 10 * engine.time_step).standard_error
    error = np.hypot(own, reference.ivc_standard_error)
    assert (np.abs(mean) < 3.0 * error).all()
    # Free edges pull: what was taken off is far from zero.
    in_plane = np.abs(reference.ivc_force[:, :2]) / reference.ivc_standard_error[:, :2]
    assert in_plane.max() > 6.0


def test_standard_error_of_a_window_against_the_scatter_over_replicas(make_sample):
    sample = make_sample()
    engine = sample.engine
    engine.equilibrate(1000)
    engine.measure_reference(16, 10)
    start = engine.state()
    still = np.zeros_like(sample.anchor)
    force, error = [], []
    for replica in range(24):
        start["counters"][1] = 100 + replica
        engine.restore(start)
        for _ in range(40):
            answer = engine.advance(10, sample.anchor, still)
        force.append(answer.ivc_force)
        error.append(answer.ivc_standard_error)
    scatter = np.sqrt(np.mean(np.var(force, axis=0, ddof=1)))
    told = np.sqrt(np.mean(np.square(error)))
    # 12 components of 24 replicas: the scatter is known to about 5 %, correlations between cells included 10 %.
    assert told == pytest.approx(scatter, rel=0.25)


def test_stretching_is_resisted_and_the_temperature_kept(make_sample):
    sample = make_sample()
    engine = sample.engine
    engine.equilibrate(1500)
    reference = engine.measure_reference(60, 10)
    # 300 K with the scatter of a sheet of some 240 atoms.
    assert reference.temperature == pytest.approx(300.0, rel=0.1)
    answers = [engine.advance(10, pulled(sample, 0.02), np.zeros_like(sample.anchor)) for _ in range(60)]
    force = np.mean([answer.ivc_force[:, 0] for answer in answers[20:]], axis=0)
    error = answers[-1].ivc_standard_error[:, 0] / np.sqrt(40)
    # The sheet pulls the anchors of either side inwards, far above the noise.
    assert (force[[0, 2]] > 6 * error[[0, 2]]).all()
    assert (force[[1, 3]] < -6 * error[[1, 3]]).all()


def test_run_through_a_checkpoint_and_run_restored_from_it_are_equal_to_the_bit(make_sample):
    through, resumed = make_sample(seed=5), make_sample(seed=99)
    through.engine.equilibrate(100)
    through.engine.measure_reference(10, 10)
    through.engine.collect_fields(True)
    for i in range(3):
        through.engine.advance(10, pulled(through, 1e-3 * i), pulled(through, 1e-3) * 1e10)
    state = through.engine.state()
    resumed.engine.restore(state)
    assert resumed.engine.step == through.engine.step == 100 + 130
    for window in (10, 10, 7, 10):
        a, b = (s.engine.advance(window, pulled(s, 5e-3), pulled(s, 1e-3) * 1e10) for s in (through, resumed))
        for name, value in vars(a).items():
            assert np.array_equal(value, getattr(b, name), equal_nan=True), name
    names = ["position", "velocity", "stress", "mean_position"]
    a, b = through.engine.fields(names), resumed.engine.fields(names)
    assert all(np.array_equal(a[name], b[name]) for name in names)


def test_static_equilibrium_at_zero_temperature(make_sample):
    """After minimisation nothing moves: mean reactions are the reference, and they balance."""
    sample = make_sample(temperature=0.0)
    sample.engine.equilibrate(2000)
    reference = sample.engine.measure_reference(8, 10)
    answer = sample.engine.advance(10, sample.anchor, np.zeros_like(sample.anchor))
    largest = np.abs(reference.anchor_force).max()
    assert largest > 1e-11
    assert np.abs(answer.anchor_force).max() < 1e-5 * largest
    np.testing.assert_allclose(reference.anchor_force.sum(axis=0), 0.0, atol=1e-5 * largest)
    assert answer.temperature < 1e-6


def test_collected_stress_is_the_mean_of_the_samples(make_sample):
    sample = make_sample(temperature=0.0)
    engine, still = sample.engine, np.zeros_like(sample.anchor)
    engine.equilibrate(500)
    engine.measure_reference(8, 5)
    engine.collect_fields(True)
    start = engine.state()
    single = []
    for i in range(3):
        engine.advance(50, pulled(sample, 2e-3 * i), still)
        total = engine.fields(["stress", "mean_position"])
        single.append((total["stress"], total["mean_position"], engine.fields(["position"])["position"]))
    np.testing.assert_allclose(single[2][1], np.mean([entry[2] for entry in single], axis=0), atol=1e-20)
    # The same motion, looked at once with an instantaneous evaluation: the third sample by difference.
    engine.restore(start)
    engine.collect_fields(False)
    for i in range(3):
        engine.advance(50, pulled(sample, 2e-3 * i), still)
    instant = engine.fields(["stress"])["stress"]
    third = 3.0 * single[2][0] - 2.0 * single[1][0]
    np.testing.assert_allclose(third, instant, atol=1e-6 * np.abs(instant).max())


def test_runaway_names_atom_step_and_knob_and_a_restore_revives(make_sample):
    sample = make_sample(time_step=5e-15)
    still = np.zeros_like(sample.anchor)
    state = sample.engine.state()
    with pytest.raises(EngineError, match=r"(?s)step.*atom \d+.*smaller time step"):
        sample.engine.equilibrate(200)
        sample.engine.measure_reference(8, 10)
        for _ in range(50):
            sample.engine.advance(10, sample.anchor, still)
    with pytest.raises(EngineError, match="needs a restore"):
        sample.engine.fields(["position"])
    sample.engine.restore(state)
    np.testing.assert_allclose(sample.engine.fields(["position"])["position"], sample.position, atol=1e-22)


def test_lost_atom_is_an_error_with_the_sentence_of_lammps(make_sample):
    sample = make_sample(damping_time=None, temperature=0.0)
    sample.engine.measure_reference(8, 10)
    with pytest.raises(EngineError, match=r"(?s)ost atoms|moves"):
        for _ in range(200):
            sample.engine.advance(10, sample.anchor + np.array([1e-8, 0.0, 0.0]), np.zeros_like(sample.anchor))


def test_nothing_is_written_to_the_terminal(make_sample, capfd):
    sample = make_sample()
    sample.engine.measure_reference(8, 5)
    assert capfd.readouterr() == ("", "")


def test_progress_is_told_and_may_stop_a_run(make_sample):
    sample = make_sample()
    seen = []
    sample.engine.equilibrate(500, progress=lambda done, total: seen.append((done, total)))
    assert seen == [(200, 500), (250, 500), (450, 500), (500, 500)]

    def stop(done, total):
        if done == 3:
            raise InterruptedError("enough")

    with pytest.raises(InterruptedError, match="enough"):
        sample.engine.measure_reference(8, 10, progress=stop)
    assert sample.engine.step == 530
    assert sample.engine.measure_reference(8, 10).temperature > 50.0


def test_methods_out_of_order_say_what_comes_first(make_sample, tmp_path):
    sample = make_sample()
    with pytest.raises(EngineError, match="call measure_reference before advance"):
        sample.engine.advance(10, sample.anchor, 0 * sample.anchor)
    profile = force_field("tersoff")
    atoms = graphene(2e-9, 2e-9, spacing=profile.lattice_constant)
    bare = Engine(LammpsDynamics(tmp_path / "bare", profile, atoms, temperature=0.0, seed=0), temperature=0.0)
    with pytest.raises(EngineError, match="call register_anchors first"):
        bare.measure_reference(8, 10)
    bare.close()
    with pytest.raises(EngineError, match="closed"):
        bare.fields(["position"])


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("atom_id", [0, 5000], "atom_id holds 5000; allowed are 0 to"),
        ("atom_id", [3, 3], "atom_id holds 3 more than once"),
        ("atom_id", [0.5, 1.5], "list of integers"),
        ("position", np.zeros((3, 3)), r"position has shape \(3, 3\); \(2, 3\)"),
        ("position", np.full((2, 3), np.nan), "position holds values that are not finite"),
        ("stiffness", [1.0, 0.0], "stiffness holds 0.0 N/m"),
        ("ivc", [0, -1], "ivc"),
        ("damping_time", -1e-13, "damping_time is -1e-13 s"),
        ("kind", [0, 3], "kind has shape"),
    ],
)
def test_bad_anchors_name_field_value_and_what_is_allowed(make_sample, field, value, message):
    sample = make_sample()
    good = {
        "atom_id": [0, 1],
        "position": sample.position[:2],
        "stiffness": [1.0, 1.0],
        "ivc": [0, 0],
        "damping_time": 1e-13,
    }
    with pytest.raises(ValueError, match=message):
        sample.engine.register_anchors(**{**good, field: value})


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"temperature": -1.0}, "temperature is -1"),
        ({"time_step": 0.0}, "time_step is 0"),
        ({"seed": -2}, "seed is -2"),
    ],
)
def test_bad_settings_name_field_and_value(tmp_path, settings, message):
    with pytest.raises(ValueError, match=message):
        profile = force_field("tersoff")
        atoms = graphene(2e-9, 2e-9, spacing=profile.lattice_constant)
        LammpsDynamics(tmp_path, profile, atoms, **{"temperature": 0.0, "seed": 0, **settings})


def test_bad_arguments_of_methods_are_refused_without_harm(make_sample):
    sample = make_sample()
    sample.engine.measure_reference(8, 10)
    with pytest.raises(ValueError, match="anchor_position has shape"):
        sample.engine.advance(10, np.zeros((1, 3)), 0 * sample.anchor)
    with pytest.raises(ValueError, match="window is 0"):
        sample.engine.advance(0, sample.anchor, 0 * sample.anchor)
    with pytest.raises(ValueError, match=r"'colour'; known fields are position, velocity"):
        sample.engine.fields(["colour"])
    with pytest.raises(ValueError, match="state lacks engine_counters"):
        sample.engine.restore({})
    assert sample.engine.advance(10, sample.anchor, 0 * sample.anchor).step == 90
