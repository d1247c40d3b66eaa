"""Passive atoms, surface atoms, anchors that move during a window, anchors in periodic boxes."""

import numpy as np
import pytest

from md_service.anchors import PASSIVE, SPRING, SURFACE
from md_service.crystals import fcc
from md_service.engine import Engine
from md_service.force_fields import force_field
from md_service.lammps_dynamics import LammpsDynamics

EDGE = 4.5e-10  # m, more than two cut-offs of the potential: no atom further in feels the surface


def outer(kind):
    return lambda depth: np.where(depth < EDGE, kind, SPRING)


def largest_reference(sample, which):
    force = sample.engine.measure_reference(8, 10).anchor_force
    return np.abs(force[sample.engine.anchors.kind == which]).max()


def test_passive_atoms_give_their_neighbours_the_bulk(make_sample):
    """At the lattice's own spacing an infinite sheet is free of force; a free edge is not."""
    free = make_sample(temperature=0.0, size=30e-10, frame=9e-10)
    carried = make_sample(temperature=0.0, size=30e-10, frame=9e-10, kind=outer(PASSIVE))
    for sample in (free, carried):
        sample.engine.equilibrate(2000)
    pulled_by_edge = largest_reference(free, SPRING)
    assert pulled_by_edge > 1e-10
    # The spacing of the profile is good to 1e-6 of itself.
    assert largest_reference(carried, SPRING) < 1e-4 * pulled_by_edge
    # What the passive atoms themselves feel at the sheet's end goes to the continuum.
    assert largest_reference(carried, PASSIVE) > 1e-9


def test_passive_atoms_sit_at_their_anchors(make_sample):
    sample = make_sample(kind=outer(PASSIVE))
    passive = sample.engine.anchors.passive
    sample.engine.equilibrate(100)
    sample.engine.measure_reference(8, 10)
    anchor = sample.anchor * [1.02, 1.0, 1.0]
    sample.engine.advance(10, anchor, np.zeros_like(anchor))
    now = sample.engine.fields(["position", "velocity"])
    np.testing.assert_allclose(now["position"][sample.atom_id[passive]], anchor[passive], atol=1e-20)
    assert np.abs(now["velocity"][sample.atom_id[passive]]).max() == 0.0
    assert np.abs(now["velocity"][sample.atom_id[~passive]]).max() > 100.0


def test_moving_passive_atoms_move_with_their_anchors(make_sample):
    sample = make_sample(kind=outer(PASSIVE), moving=True)
    passive = sample.engine.anchors.passive
    sample.engine.equilibrate(100)
    sample.engine.measure_reference(8, 10)
    velocity = np.full_like(sample.anchor, 300.0) * [1.0, 0.0, 0.0]
    sample.engine.advance(10, sample.anchor, velocity)
    way = 10 * sample.engine.time_step * 300.0
    now = sample.engine.fields(["position"])["position"][sample.atom_id[passive]]
    np.testing.assert_allclose(now - sample.anchor[passive], np.tile([way, 0.0, 0.0], (passive.sum(), 1)), atol=1e-20)


def test_forces_on_passive_atoms_and_springs_are_in_balance(make_sample):
    """Without dampers the impulse of springs and passive atoms is the change of the moving atoms' momentum."""
    sample = make_sample(damping_time=None, kind=outer(PASSIVE), time_step=2e-16)
    engine, still = sample.engine, np.zeros_like(sample.anchor)
    engine.equilibrate(200)
    reference = engine.measure_reference(8, 10).anchor_force
    mass = engine.atoms.atom_mass

    def momentum():
        return mass @ engine.fields(["velocity"])["velocity"]

    anchor = sample.anchor * [1.01, 1.0, 1.0] + [0.2e-10, 0.0, 0.0]
    engine.advance(10, anchor, still)
    before, impulse = momentum(), np.zeros(3)
    for _ in range(40):
        impulse -= 10 * engine.time_step * (engine.advance(10, anchor, still).anchor_force + reference).sum(axis=0)
    # Verlet counts the first and last step half, the mean counts the last in full: of the order of one step in 400.
    np.testing.assert_allclose(impulse, momentum() - before, atol=0.02 * np.abs(impulse).max())
    assert np.abs(impulse).max() > 1e-23


@pytest.mark.parametrize("moving", [False, True])
def test_work_of_all_kinds_of_anchors_is_the_energy_of_the_atoms(make_sample, moving):
    def kinds(depth):
        return np.select([depth < 1.5e-10, depth < 3e-10], [PASSIVE, SURFACE], SPRING)

    sample = make_sample(kind=kinds, moving=moving)
    engine = sample.engine
    engine.equilibrate(400)
    engine.measure_reference(8, 10)
    speed = sample.anchor * [1e-3 / (10 * engine.time_step), 0.0, 0.0]
    first = engine.advance(10, sample.anchor, speed)
    missing, exchanged = [], 0.0
    for step in range(1, 40):
        last = engine.advance(10, sample.anchor * [1.0 + 1e-3 * step, 1.0, 1.0], speed)
        gained = last.potential_energy + last.kinetic_energy - first.potential_energy - first.kinetic_energy
        missing.append(last.anchor_work - first.anchor_work - gained)
        exchanged = max(exchanged, abs(gained))
    assert exchanged > 1e-18
    assert np.abs(missing).max() < 0.02 * exchanged


def test_surface_atoms_are_held_by_a_constant_force_per_cell(make_sample):
    """Eq 82: what the springs of a cell held on average is shared by its atoms, and the springs are gone."""
    free = make_sample(temperature=0.0, size=30e-10, frame=9e-10)
    sample = make_sample(temperature=0.0, size=30e-10, frame=9e-10, kind=outer(SURFACE))
    for one in (free, sample):
        one.engine.equilibrate(2000)
    without = largest_reference(free, SPRING)
    reference = sample.engine.measure_reference(8, 10)
    anchors = sample.engine.anchors
    surface = anchors.kind == SURFACE
    assert (anchors.stiffness[surface] == 0.0).all()
    for cell in range(4):
        same = anchors.force[surface & (sample.ivc == cell)]
        assert np.ptp(same, axis=0).max() == 0.0
        # A free edge of graphene would shrink or spread: the cells of a quadrant push outwards or pull inwards alike.
        assert np.abs(same).max() > 1e-12
    # Springs, passive atoms and compensating forces are in balance.
    total = reference.anchor_force.sum(axis=0) - anchors.force.sum(axis=0)
    assert np.abs(total).max() < 1e-6 * np.abs(reference.anchor_force).max()
    # The anchored atoms next to the surface feel less of it.
    assert np.abs(reference.anchor_force[~surface]).max() < 0.5 * without


def test_anchors_lead_atoms_through_a_periodic_boundary(tmp_path):
    """A crystal is carried around its box by a third of an edge; nothing in it may notice."""
    profile = force_field("eam-copper")
    atoms = fcc("Cu", profile.spacing("copper", 0.0), (3, 3, 3))
    dynamics = LammpsDynamics(tmp_path, profile, atoms, temperature=0.0, seed=1, time_step=2e-15)
    engine = Engine(dynamics, temperature=0.0)
    ids = np.arange(0, len(atoms), 2)
    engine.register_anchors(ids, atoms.position[ids], np.full(len(ids), 30.0), np.zeros(len(ids), int), 1e-13)
    engine.equilibrate(500)
    engine.measure_reference(8, 10)
    energy = engine.advance(10, atoms.position[ids], np.zeros((len(ids), 3))).potential_energy
    speed = 400.0
    way = 0.0
    while way < 4e-10:
        way += speed * 10 * engine.time_step
        shifted = atoms.position[ids] + [way, 0.0, 0.0]
        last = engine.advance(10, shifted, np.full((len(ids), 3), speed) * [1.0, 0.0, 0.0])
    for _ in range(200):
        last = engine.advance(10, shifted, np.zeros((len(ids), 3)))
    moved = engine.fields(["displacement"])["displacement"]
    np.testing.assert_allclose(moved, np.tile([way, 0.0, 0.0], (len(atoms), 1)), atol=0.01e-10)
    assert last.potential_energy == pytest.approx(energy, rel=1e-6)
    assert np.abs(last.anchor_force).max() < 1e-2 * 30.0 * way
    engine.close()
