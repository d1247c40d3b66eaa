import numpy as np
import pytest

from md_service.atoms import Atoms, Box
from md_service.thermal_stress import averaging_radius, local_motion, thermal_virial
from md_service.units import BOLTZMANN

CARBON, HYDROGEN = 1.9945e-26, 1.6737e-27
TEMPERATURE = 300.0


def glass(n=600, edge=20e-10, periodic=(True, True, True), tilt=(0.0, 0.0, 0.0), seed=1):
    """Carbon and hydrogen at random places; the second half of the atoms is hydrogen."""
    rng = np.random.default_rng(seed)
    box = Box(np.array([-3e-10, 2e-10, 0.0]), np.array([-3e-10, 2e-10, 0.0]) + edge, periodic, np.array(tilt))
    position = box.low + rng.uniform(size=(n, 3)) @ box.edges
    mass = np.where(np.arange(n) < n // 2, CARBON, HYDROGEN)
    return position, mass, box


def thermal_velocity(mass, seed=2):
    return np.random.default_rng(seed).normal(size=(len(mass), 3)) * np.sqrt(BOLTZMANN * TEMPERATURE / mass)[:, None]


RADIUS = 5e-10
SPIN = np.array([[0.0, -3e10, 1e10], [3e10, 0.0, -2e10], [-1e10, 2e10, 0.0]])
SHEAR = np.array([[2e10, 4e10, 0.0], [0.0, -1e10, 5e10], [1e10, 0.0, 3e10]])


@pytest.mark.parametrize("gradient", [np.zeros((3, 3)), SPIN, SHEAR])
def test_a_body_that_moves_turns_or_is_sheared_has_no_thermal_stress(gradient):
    """With free faces, where neighbours lie to one side only."""
    position, mass, box = glass(periodic=(False, False, False))
    velocity = position @ gradient.T + [700.0, -200.0, 50.0]
    local, _ = local_motion(position, velocity, mass, box, RADIUS)
    np.testing.assert_allclose(local, velocity, rtol=1e-9, atol=1e-7)
    assert np.abs(thermal_virial(position, velocity, mass, box, RADIUS)).max() < 1e-15 * BOLTZMANN * TEMPERATURE
    # Thermal motion on top is told as without.
    noise = thermal_velocity(mass)
    np.testing.assert_allclose(
        thermal_virial(position, velocity + noise, mass, box, RADIUS),
        thermal_virial(position, noise, mass, box, RADIUS),
        atol=1e-8 * BOLTZMANN * TEMPERATURE,
    )


@pytest.mark.parametrize("periodic", [(True, True, True), (False, False, True)])
@pytest.mark.parametrize("radius", [4e-10, 5e-10])
def test_in_equilibrium_each_atom_has_minus_kt_whatever_its_mass_and_neighbours(periodic, radius):
    """Perfect gas: closed form, for heavy and light atoms, inside and at a face, near and far neighbours."""
    position, mass, box = glass(periodic=periodic)
    samples = [thermal_virial(position, thermal_velocity(mass, seed), mass, box, radius) for seed in range(100)]
    in_kt = np.array(samples) / (BOLTZMANN * TEMPERATURE)
    mean = in_kt.mean(axis=0)
    _, share = local_motion(position, thermal_velocity(mass), mass, box, radius)
    assert (share > 0.05).mean() > 0.95
    depth = np.abs(position - 0.5 * (box.low + box.high)).max(axis=1)
    near_face = depth > 0.4 * 20e-10
    for group in (mass == CARBON, mass == HYDROGEN, near_face, share < 0.5):
        group = group & (share > 0.05)
        count = 100 * group.sum()
        assert count > 1000
        tolerance = 5.0 / np.sqrt(count)
        # Where little of the motion is left its samples scatter more.
        spread = np.std(in_kt[:, group, :3]) / np.sqrt(2.0)
        np.testing.assert_allclose(mean[group, :3].mean(axis=0), -1.0, atol=tolerance * max(spread, 1.0) * np.sqrt(2.0))
        np.testing.assert_allclose(mean[group, 3:].mean(axis=0), 0.0, atol=tolerance * max(spread, 1.0))


def test_without_the_correction_the_stress_would_be_too_small():
    """So the test above sees the share of an atom in its own mean."""
    position, mass, box = glass()
    _, share = local_motion(position, thermal_velocity(mass), mass, box, RADIUS)
    carbon = mass == CARBON
    assert share[carbon].mean() < 0.9
    assert share[carbon].mean() < share[~carbon].mean() < 1.2


def test_the_local_motion_is_that_of_a_weighted_fit_made_by_lstsq():
    position, mass, box = glass(n=300, periodic=(False, False, False))
    velocity = thermal_velocity(mass)
    local, share = local_motion(position, velocity, mass, box, RADIUS)
    for i in (0, 17, 250):
        offset = position - position[i]
        near = np.linalg.norm(offset, axis=1) < RADIUS
        q = (offset[near] ** 2).sum(axis=1) / RADIUS**2
        root = np.sqrt(mass[near] / CARBON) * (1.0 - q)
        columns = np.hstack([np.ones((near.sum(), 1)), offset[near] / RADIUS])
        pseudo = np.linalg.pinv(columns * root[:, None]) * root
        np.testing.assert_allclose(local[i], (pseudo @ velocity[near])[0], rtol=1e-9)
        h = pseudo[0] - (np.flatnonzero(near) == i)
        np.testing.assert_allclose(share[i], np.sum(h**2 * mass[i] / mass[near]), rtol=1e-9)


def test_a_flat_sheet_that_ripples_keeps_its_motion_across():
    """In a sheet neighbours tell no gradient along the normal; the motion across is thermal all the same."""
    rng = np.random.default_rng(0)
    x, y = np.meshgrid(np.arange(20.0), np.arange(20.0))
    position = np.stack([x.ravel(), y.ravel(), np.zeros(400)], axis=1) * 1.6e-10
    box = Box(np.array([0.0, 0.0, -1e-10]), np.array([32e-10, 32e-10, 1e-10]), (True, True, False))
    mass = np.full(400, CARBON)
    for height in (0.0, 0.3e-10):
        position[:, 2] = height * rng.normal(size=400)
        mean = np.mean([thermal_virial(position, thermal_velocity(mass, s), mass, box, 4.4e-10) for s in range(50)], 0)
        np.testing.assert_allclose(mean[:, :3].mean(axis=0) / (BOLTZMANN * TEMPERATURE), -1.0, atol=0.05)


def test_periodic_and_sheared_boxes_are_seamless():
    """The same crystal in an upright and in a sheared cell; atoms moved by whole periods."""
    position, mass, box = glass(n=300)
    velocity = thermal_velocity(mass)
    expected = thermal_virial(position, velocity, mass, box, RADIUS)
    shifted = position + np.random.default_rng(5).integers(-2, 3, size=(300, 3)) @ box.edges
    np.testing.assert_allclose(thermal_virial(shifted, velocity, mass, box, RADIUS), expected, rtol=1e-6, atol=1e-30)
    length = 20e-10
    sheared = Box(box.low, box.high, box.periodic, np.array([length, -length, 2 * length]))
    np.testing.assert_allclose(
        thermal_virial(position, velocity, mass, sheared, RADIUS), expected, rtol=1e-6, atol=1e-30
    )
    # A tilt that is no whole period is another crystal: periodicity by brute force.
    tilted = Box(box.low, box.high, box.periodic, np.array([4e-10, -3e-10, 6e-10]))
    copies = [(a, b, c) for a in (-1, 0, 1) for b in (-1, 0, 1) for c in (-1, 0, 1)]
    copies.sort(key=lambda shift: shift != (0, 0, 0))
    inside, _ = tilted.wrapped(position)
    block = np.concatenate([inside + np.array(shift) @ tilted.edges for shift in copies])
    free = Box(block.min(axis=0), block.max(axis=0), (False, False, False))
    brute = thermal_virial(block, np.tile(velocity, (27, 1)), np.tile(mass, 27), free, RADIUS)[:300]
    np.testing.assert_allclose(thermal_virial(position, velocity, mass, tilted, RADIUS), brute, rtol=1e-6, atol=1e-30)


def test_a_lone_atom_moves_as_its_body_and_one_far_out_costs_no_memory():
    position, mass, box = glass(n=100, periodic=(False, False, False))
    position[0] = [1e-3, 0.0, 0.0]
    found = thermal_virial(position, thermal_velocity(mass), mass, box, RADIUS)
    assert (found[0] == 0.0).all()
    assert np.abs(found[1:]).max() > 0.0
    assert thermal_virial(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), box, RADIUS).shape == (0, 6)


def test_the_radius_holds_two_dozen_atoms():
    def atoms(position, low, high, thickness=None):
        box = Box(np.array(low), np.array(high), (True, True, True))
        zeros = np.zeros(len(position), dtype=np.int64)
        return Atoms(position, zeros, ("C",), ("C",), np.array([CARBON]), box, thickness=thickness)

    rng = np.random.default_rng(0)
    solid = atoms(rng.uniform(size=(1000, 3)), [0, 0, 0], [1e-9, 2e-9, 3e-9])
    assert 4.0 / 3.0 * np.pi * averaging_radius(solid) ** 3 * 1000 / 6e-27 == pytest.approx(24.0)
    sheet = atoms(rng.uniform(size=(1000, 3)), [0, 0, 0], [5e-9, 5e-9, 1e-9], thickness=3.35e-10)
    assert np.pi * averaging_radius(sheet) ** 2 * 1000 / 25e-18 == pytest.approx(24.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"radius": 0.0}, "radius is 0.0 m"),
        ({"radius": np.inf}, "radius is inf m"),
        ({"velocity": np.zeros((2, 3))}, r"velocity has shape \(2, 3\); \(100, 3\)"),
        ({"mass": np.full(100, np.nan)}, "mass holds values that are not finite"),
    ],
)
def test_bad_input_names_field_and_value(change, message):
    position, mass, box = glass(n=100)
    good = {"position": position, "velocity": thermal_velocity(mass), "mass": mass, "box": box, "radius": RADIUS}
    with pytest.raises(ValueError, match=message):
        thermal_virial(**{**good, **change})
