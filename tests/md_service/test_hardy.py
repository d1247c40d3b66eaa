import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import minimize

from md_service.atoms import Box
from md_service.hardy import HardyAverage, HardyGrid, PairForces, grid_over
from md_service.thermal_stress import thermal_virial
from md_service.units import BOLTZMANN

MASS = 6.6e-26  # argon
EPSILON, SIGMA = 1.65e-21, 3.4e-10
CUTOFF = 2.2 * SIGMA


class LennardJones:
    """Pairs by brute force over all atoms and 27 images, with energy and force shifted to zero at the cut-off."""

    def __init__(self, box):
        self.box = box
        axes = [(-1, 0, 1) if periodic else (0,) for periodic in box.periodic]
        self.shifts = np.array([(a, b, c) for a in axes[0] for b in axes[1] for c in axes[2]]) @ box.edges

    @staticmethod
    def _raw(r):
        s = (SIGMA / r) ** 6
        return 4.0 * EPSILON * (s**2 - s), 24.0 * EPSILON * (2.0 * s**2 - s) / r

    def pairs(self, position):
        first, separation = [], []
        for shift in self.shifts:
            apart = position[:, None] - position[None] - shift
            near = (apart**2).sum(axis=2) < CUTOFF**2
            # Each pair once: within the home box by index, across by the sign of the shift.
            near &= (
                np.arange(len(position))[:, None] < np.arange(len(position))[None]
                if not shift.any()
                else tuple(shift) > (0.0, 0.0, 0.0)
            )
            i, j = np.nonzero(near)
            first.append(np.stack([i, j]))
            separation.append(apart[i, j])
        (i, j), apart = np.concatenate(first, axis=1), np.concatenate(separation)
        r = np.linalg.norm(apart, axis=1)
        energy, push = self._raw(r)
        end_energy, end_push = self._raw(CUTOFF)
        self.energy = np.sum(energy - end_energy + end_push * (r - CUTOFF))
        self.second = j
        return PairForces(i, apart, ((push - end_push) / r)[:, None] * apart)

    def forces(self, position):
        pairs = self.pairs(position)
        total = np.zeros_like(position)
        np.add.at(total, pairs.first, pairs.force)
        np.add.at(total, self.second, -pairs.force)
        return total

    def virial(self, position):
        """Half of each pair's to either atom."""
        pairs = self.pairs(position)
        d, f = -pairs.separation, pairs.force
        tensor = np.stack([d[:, a] * f[:, b] for a, b in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))], axis=1)
        each = np.zeros((len(position), 6))
        np.add.at(each, pairs.first, 0.5 * tensor)
        np.add.at(each, self.second, 0.5 * tensor)
        return each


def fcc(n, strain=0.0, shift=0.0, periodic=(True, True, True)):
    edge = 1.56 * SIGMA
    cell = np.array([[0, 0, 0], [0.5, 0.5, 0], [0.5, 0, 0.5], [0, 0.5, 0.5]])
    corner = np.array([(x, y, z) for x in range(n) for y in range(n) for z in range(n)])
    position = ((corner[:, None] + cell).reshape(-1, 3) + 0.25) * edge
    stretch = np.eye(3) + np.array([[strain, shift, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, -0.5 * strain]])
    edges = n * edge * stretch.T
    box = Box(np.zeros(3), np.diag(edges).copy(), periodic, np.array([edges[1, 0], edges[2, 0], edges[2, 1]]))
    return position @ stretch.T, box


def liquid(n=3, seed=0, periodic=(True, True, True)):
    position, box = fcc(n, periodic=periodic)
    return position + np.random.default_rng(seed).uniform(-0.15, 0.15, size=position.shape) * SIGMA, box


def thermal(n, temperature=90.0, seed=1):
    return np.random.default_rng(seed).normal(size=(n, 3)) * np.sqrt(BOLTZMANN * temperature / MASS)


@pytest.mark.parametrize("thickness", [None, 1e-9])
@pytest.mark.parametrize(("cells", "tolerance"), [(2, 1e-2), (4, 1e-3)])
def test_density_times_volume_is_the_mass_and_momentum_alike(thickness, cells, tolerance):
    position, box = liquid(periodic=(False, False, False))
    box = Box(position.min(axis=0), position.max(axis=0))
    velocity = thermal(len(position)) + np.array([30.0, -60.0, 90.0])
    radius = 2.0 * SIGMA
    average = HardyAverage(
        grid_over(box, radius / cells, thickness, margin=radius), box, np.full(len(position), MASS), radius
    )
    average.add(position, velocity, virial=np.zeros((len(position), 6)), displacement=0.01 * position)
    found = average.fields()
    volume = found.grid.cell_volume
    assert found.density.sum() * volume == pytest.approx(MASS * len(position), rel=tolerance)
    full = found.density > 0.0
    for field, value in ((found.velocity, velocity), (found.displacement, 0.01 * position)):
        total = (found.density[full, None] * field[full]).sum(axis=0) * volume
        np.testing.assert_allclose(total, MASS * value.sum(axis=0), rtol=2 * tolerance)
    # Outside there is nothing, and that is said.
    assert not full.all()
    assert np.isnan(found.velocity[~full]).all() and np.isnan(found.temperature[~full]).all()
    assert (found.stress[~full] == 0.0).all()


def energy_slope(strain, shift, which):
    """Stress from the energy: derivative of the energy per volume by a further strain."""
    h, energies = 1e-5, []
    for sign in (1.0, -1.0):
        position, box = fcc(3, strain, shift)
        stretch = np.eye(3)
        stretch[which] += sign * h
        moved = Box(box.low, box.high, box.periodic, box.tilt)
        potential = LennardJones(moved)
        potential.shifts = potential.shifts @ stretch.T
        potential.pairs(position @ stretch.T)
        energies.append(potential.energy)
    return (energies[0] - energies[1]) / (2 * h) / box.volume


def test_uniform_stress_of_a_strained_crystal_is_that_of_its_energy():
    """In an upright and a sheared periodic box, both ways of the potential part, at every cell of the grid."""
    for strain, shift in ((0.02, 0.0), (-0.01, 0.08)):
        position, box = fcc(3, strain, shift)
        potential = LennardJones(box)
        expected = [energy_slope(strain, shift, at) for at in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
        still = np.zeros_like(position)
        for way in ({"pairs": potential.pairs(position)}, {"virial": potential.virial(position)}):
            average = HardyAverage(grid_over(box, 0.8 * SIGMA), box, np.full(len(position), MASS), 3.5 * SIGMA)
            average.add(position, still, **way)
            found = average.fields()
            largest = np.abs(expected).max()
            np.testing.assert_allclose(found.stress.mean(axis=(0, 1, 2)), expected, atol=1e-3 * largest)
            np.testing.assert_allclose(found.stress, np.broadcast_to(expected, found.stress.shape), atol=0.02 * largest)
            assert found.density == pytest.approx(4 * MASS * 27 / box.volume, rel=0.02)
            assert (found.thermal_stress == 0.0).all()


def force_across(pairs, position, box, plane):
    """Force along x by the atoms right of a plane on those left of it, over the whole cross-section."""
    x = position[pairs.first, 0]
    other = x - pairs.separation[:, 0]
    total = 0.0
    for image in range(-2, 3):
        a, b = x + image * box.edges[0, 0], other + image * box.edges[0, 0]
        total += np.sum(pairs.force[(a < plane) & (plane <= b), 0])
        total -= np.sum(pairs.force[(b < plane) & (plane <= a), 0])
    return total


def smeared_force_across(pairs, position, box, at, radius, power, factor):
    """The force across planes around `at`, weighted by the localisation function summed over the cross-section."""
    s = (np.arange(800) + 0.5) / 400 - 1.0
    weight = factor * (1.0 - s**2) ** power / 400
    assert weight.sum() == pytest.approx(1.0, abs=1e-4)
    return sum(w * force_across(pairs, position, box, at + radius * q) for w, q in zip(weight, s, strict=True))


@pytest.mark.parametrize("thickness", [None, 3e-10])
def test_stress_of_a_liquid_is_the_force_across_planes(thickness):
    """Atoms out of equilibrium, so the force differs from plane to plane; independent of any bond function."""
    position, box = liquid(seed=3)
    pairs = LennardJones(box).pairs(position)
    radius = 1.5 * SIGMA
    average = HardyAverage(grid_over(box, 0.2 * SIGMA, thickness), box, np.full(len(position), MASS), radius)
    average.add(position, np.zeros_like(position), pairs=pairs)
    found = average.fields()
    profile = found.stress[..., 0].reshape(found.grid.shape[0], -1).sum(axis=1)
    force = profile * found.grid.cell_volume / found.grid.spacing[0]
    power, factor = (3.0, 35.0 / 32.0) if thickness is None else (2.5, 16.0 / (5.0 * np.pi))
    for k in (0, 5, 11):
        at = found.grid.centres()[0][k]
        expected = smeared_force_across(pairs, position, box, at, radius, power, factor)
        assert force[k] == pytest.approx(expected, abs=2e-3 * np.abs(force).max())
    assert np.ptp(force) > 0.05 * np.abs(force).max()


def test_stress_by_pairs_balances_where_the_spread_virial_does_not():
    """A slab at rest with free faces carries no force across any plane; what the other way is off is known."""
    position, box = fcc(4, periodic=(False, True, True))
    potential = LennardJones(box)

    def energy(flat):
        where = flat.reshape(-1, 3) * SIGMA
        gradient = -potential.forces(where) * SIGMA / EPSILON
        return potential.energy / EPSILON, gradient.ravel()

    found = minimize(energy, (position / SIGMA).ravel(), jac=True, method="L-BFGS-B", options={"ftol": 0, "gtol": 1e-9})
    at_rest = found.x.reshape(-1, 3) * SIGMA
    assert np.abs(potential.forces(at_rest)).max() < 1e-6 * EPSILON / SIGMA
    profiles = []
    for way in ({"pairs": potential.pairs(at_rest)}, {"virial": potential.virial(at_rest)}):
        average = HardyAverage(
            grid_over(box, 0.25 * SIGMA, margin=1.5 * SIGMA), box, np.full(len(at_rest), MASS), 1.5 * SIGMA
        )
        average.add(at_rest, np.zeros_like(at_rest), **way)
        profiles.append(average.fields().stress.mean(axis=(1, 2)))
    by_pairs, spread = profiles
    lateral = np.abs(by_pairs[:, 1]).max()
    # What is left of zero is the sum over the grid, good to 1e-3 with six cells a radius.
    assert np.abs(by_pairs[:, 0]).max() < 1e-3 * lateral
    assert np.abs(spread[:, 0]).max() > 0.5 * lateral
    # The integrals over the slab are one: the bonds are shared out differently, not changed.
    np.testing.assert_allclose(spread.sum(axis=0), by_pairs.sum(axis=0), atol=1e-3 * np.abs(by_pairs[:, 1]).sum())


def test_the_bond_function_against_an_integral_along_the_bond():
    box = Box(np.zeros(3), np.full(3, 10.0), (False, False, False))
    start, end, force, radius = np.array([4.0, 5.0, 4.5]), np.array([6.5, 4.0, 5.5]), np.array([0.3, -0.2, 0.7]), 1.7
    grid = HardyGrid(np.zeros(3), np.full(3, 0.5), (20, 20, 20))
    average = HardyAverage(grid, box, np.ones(2), radius)
    pair = PairForces(np.array([0]), (start - end)[None], force[None])
    average.add(np.stack([start, end]), np.zeros((2, 3)), pairs=pair)
    found = average.fields()
    centres = grid.centres()[0]

    def share(centre):
        def weight(s):
            q = np.sum((start + s * (end - start) - centre) ** 2) / radius**2
            return 105.0 / (32.0 * np.pi * radius**3) * max(1.0 - q, 0.0) ** 2

        return quad(weight, 0.0, 1.0, epsabs=1e-11, limit=200)[0]

    rng = np.random.default_rng(2)
    seen = 0
    for index in rng.integers(5, 15, size=(80, 3)):
        expected = share(centres[index]) * (end - start)[0] * force[0]
        assert found.stress[tuple(index)][0] == pytest.approx(expected, rel=1e-7, abs=1e-10)
        seen += expected != 0.0
    assert 20 < seen < 80


@pytest.mark.parametrize("gradient", [[[0, -2e10, 0], [2e10, 0, 0], [0, 0, 0]], [[0, 3e10, 0], [0, 0, 0], [0, 0, 0]]])
def test_turning_and_shearing_flows_have_no_thermal_stress(gradient):
    position, box = fcc(3, periodic=(False, False, False))
    flow = np.array(gradient)
    average = HardyAverage(grid_over(box, 0.8 * SIGMA), box, np.full(len(position), MASS), 2.0 * SIGMA)
    average.add(position, position @ flow.T, virial=np.zeros((len(position), 6)))
    found = average.fields()
    speed = np.abs(position @ flow.T).max()
    assert np.abs(found.thermal_stress).max() < 1e-12 * found.density.max() * speed**2
    assert np.nanmax(found.temperature) < 1e-9
    # The velocity is that of the flow where neighbours lie to all sides.
    mid = tuple(n // 2 for n in found.grid.shape)
    centre = np.array([axis[k] for axis, k in zip(found.grid.centres(), mid, strict=True)])
    np.testing.assert_allclose(found.velocity[mid], flow @ centre, atol=0.03 * speed)


def test_temperature_and_kinetic_pressure_of_a_perfect_gas():
    position, box = liquid(n=4)
    average = HardyAverage(grid_over(box, SIGMA), box, np.full(len(position), MASS), 2.5 * SIGMA)
    for seed in range(40):
        drift = np.array([200.0, 0.0, -100.0])
        average.add(position, thermal(len(position), seed=seed) + drift, virial=np.zeros((len(position), 6)))
    found = average.fields()
    assert found.samples == 40
    # 256 atoms, 3 directions, 40 samples: 0.8 % by counting.
    assert found.temperature.mean() == pytest.approx(90.0, rel=0.02)
    pressure = len(position) / box.volume * BOLTZMANN * 90.0
    np.testing.assert_allclose(found.stress.mean(axis=(0, 1, 2))[:3], -pressure, rtol=0.05)
    np.testing.assert_allclose(found.stress.mean(axis=(0, 1, 2))[3:], 0.0, atol=0.03 * pressure)
    np.testing.assert_allclose(found.velocity.mean(axis=(0, 1, 2)), [200.0, 0.0, -100.0], atol=10.0)


def test_fields_are_means_over_the_samples_and_see_no_seam():
    """Two samples against each alone; a whole period or a shifted origin change nothing."""
    position, box = liquid()
    potential = LennardJones(box)
    grid = grid_over(box, 0.9 * SIGMA)
    mass = np.full(len(position), MASS)

    def fields(*samples):
        average = HardyAverage(grid, box, mass, 2.0 * SIGMA)
        for where, velocity, pairs in samples:
            average.add(where, velocity, pairs=pairs)
        return average.fields()

    first = (position, thermal(len(position), seed=1), potential.pairs(position))
    later = position + 0.1 * SIGMA
    second = (later, thermal(len(position), seed=2), potential.pairs(later))
    one, two, both = fields(first), fields(second), fields(first, second)
    np.testing.assert_allclose(both.stress, 0.5 * (one.stress + two.stress), rtol=1e-10)
    momentum = 0.5 * (one.density[..., None] * one.velocity + two.density[..., None] * two.velocity)
    np.testing.assert_allclose(both.density[..., None] * both.velocity, momentum, rtol=1e-10)
    # A thermal part that is given stands for that of the velocities.
    average = HardyAverage(grid, box, mass, 2.0 * SIGMA)
    given = thermal_virial(position, first[1], mass, box, 2.0 * SIGMA)
    average.add(position, 0.0 * first[1], pairs=first[2], thermal=given)
    np.testing.assert_allclose(average.fields().stress, one.stress, rtol=1e-10)
    assert (average.fields().velocity == 0.0).all()
    wrapped = position + np.random.default_rng(4).integers(-2, 3, size=position.shape) @ box.edges
    again = fields((wrapped, first[1], first[2]))
    np.testing.assert_allclose(again.stress, one.stress, atol=1e-9 * np.abs(one.stress).max())


def test_a_grid_over_a_box_fills_periodic_directions_and_leaves_a_margin_in_free_ones():
    box = Box(np.array([0.0, 1.0, 0.0]), np.array([10.0, 6.0, 3.0]), (True, False, False))
    grid = grid_over(box, 1.5, margin=2.0)
    assert grid.shape == (7, 6, 5)
    np.testing.assert_allclose(grid.low, [0.0, -1.0, -2.0])
    np.testing.assert_allclose(grid.low + grid.spacing * grid.shape, [10.0, 8.0, 5.0])
    np.testing.assert_allclose(grid.centres()[0][[0, -1]], [5.0 / 7.0, 10.0 - 5.0 / 7.0])
    assert grid_over(box, 1.0).shape == (10, 5, 3)
    sheet = grid_over(box, 1.0, thickness=0.5)
    assert sheet.shape == (10, 5)
    assert sheet.cell_volume == pytest.approx(0.5)


def test_bad_input_names_field_and_value():
    position, box = liquid()
    grid = grid_over(box, SIGMA)
    mass = np.full(len(position), MASS)
    average = HardyAverage(grid, box, mass, SIGMA)
    zero, virial = np.zeros_like(position), np.zeros((len(position), 6))
    good = PairForces(np.array([0]), np.ones((1, 3)), np.ones((1, 3)))
    for call, message in (
        (lambda: average.fields(), "no samples yet"),
        (lambda: average.add(position, zero), "virial and pairs are both absent"),
        (lambda: average.add(position[1:], zero, virial=virial), r"position has shape \(107, 3\); \(108, 3\)"),
        (lambda: average.add(position, zero + np.nan, virial=virial), "velocity holds values"),
        (lambda: average.add(position, zero, virial=zero), r"virial has shape \(108, 3\)"),
        (lambda: average.add(position, zero, pairs=PairForces(good.first + 108, good.separation, good.force)), "first"),
        (lambda: average.add(position, zero, pairs=PairForces(good.first, zero, good.force)), r"pairs.separation"),
        (lambda: HardyAverage(grid, box, mass, 0.0), "radius is 0.0 m"),
        (lambda: grid_over(box, -1.0), "spacing is -1.0 m"),
        (lambda: HardyGrid(np.zeros(2), np.ones(2), (3, 3)), "thickness is None"),
        (lambda: HardyGrid(np.zeros(3), np.ones(3), (3, 3, 3), 1.0), "thickness is 1.0"),
        (lambda: HardyGrid(np.zeros(3), np.zeros(3), (3, 3, 3)), "must be positive"),
        (lambda: HardyGrid(np.zeros(1), np.ones(1), (3,)), "2 or 3 entries"),
    ):
        with pytest.raises(ValueError, match=message):
            call()
    assert average.samples == 0
