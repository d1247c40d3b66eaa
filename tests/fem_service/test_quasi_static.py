"""Equilibria of laminates against closed forms: one ply, bending, sudden failure, stiff layers, viscosity, levers."""

from __future__ import annotations

import numpy as np
import pytest

from fem_service.cohesive_law import CohesiveLaw
from fem_service.equilibrium import Grips
from fem_service.laminate_mesh import LaminateMesh, stack
from fem_service.lever import Lever
from fem_service.plane_mesh import open_hole, rectangle
from fem_service.point_material import ElasticMaterial, PointAnswer, PointState
from fem_service.quasi_static import QuasiStatic
from fem_service.tension import tension_grips
from fem_service.verification.beams import transversely_isotropic
from fem_service.verification.laminate_stiffness import bent, lamination

PLY = transversely_isotropic(167e9, 15e9, 0.34, 0.29, 3.9e9, 5.8e9)
#: Table 6.6 with K = 2.71e8 MPa/mm.
STIFF = CohesiveLaw(2.71e17, 60e6, 90e6, 200.0, 1000.0, 1.0)
SOFT = CohesiveLaw(1e14, 60e6, 90e6, 200.0, 1000.0, 1.0)


class SuddenDeath:
    """A material that keeps a share of its stiffness for good from a strain along x on."""

    softens = False

    def __init__(self, limit: float, left: float) -> None:
        self.limit = limit
        self.tangents = np.array([PLY, left * PLY])

    def fresh(self, points: int) -> PointState:
        return PointState(np.zeros((points, 1), np.uint8), np.zeros((points, 0)))

    def intact(self, points: int) -> PointAnswer:
        return self.respond(np.zeros((points, 6)), self.fresh(points), np.zeros(points))

    def respond(self, strain: np.ndarray, state: PointState, element_length: np.ndarray) -> PointAnswer:
        failed = np.maximum(state.failed, (strain[:, :1] > self.limit).astype(np.uint8))
        index = failed[:, 0].astype(np.int64)
        stress = np.einsum("pij,pj->pi", self.tangents[index], strain)
        return PointAnswer(stress, PointState(failed, state.history), index, self.tangents)


def split_bar(law: CohesiveLaw, viscosity: float = 0.0) -> QuasiStatic:
    """Two bricks and the layer between them, 1 mm x 1 mm, pulled along z; the load is how far."""
    mesh = stack(rectangle(1e-3, 1e-3, 1, 1), np.array([0.0, np.pi]), 0.1e-3, cohesive=True)
    ends = (mesh.nodes[:, 2] == 0.0) | (mesh.nodes[:, 2] == 0.2e-3)
    moves = np.zeros((len(mesh.nodes), 3))
    moves[mesh.nodes[:, 2] == 0.2e-3, 2] = 1.0
    held = np.repeat(True, 3 * len(mesh.nodes)).reshape(-1, 3)
    held[:, 2] = ends
    freedoms = np.flatnonzero(held)
    grips = Grips(freedoms, moves.reshape(-1)[freedoms])
    return QuasiStatic(mesh, ElasticMaterial(PLY), grips, law=law, tolerance=1e-10, viscosity=viscosity)


class Cooled(ElasticMaterial):
    """An elastic material that has shrunk, and by different parts along and across its fibres."""

    shrunk = np.array([1e-4, -3e-3, -3e-3, 0.0, 0.0, 0.0])

    def respond(self, strain: np.ndarray, state: PointState, element_length: np.ndarray) -> PointAnswer:
        return super().respond(strain - self.shrunk, state, element_length)


def test_a_ply_that_has_cooled_is_free_of_stress_and_measured_from_there() -> None:
    mesh = stack(rectangle(4e-3, 2e-3, 4, 2), np.zeros(1), 0.25e-3)
    rest = QuasiStatic(mesh, Cooled(PLY), tension_grips(mesh)).rest()
    assert np.abs(rest.stress).max() < 1e-9 * np.abs(PLY @ Cooled.shrunk).max()
    for axis, extent in enumerate((4e-3, 2e-3, 0.25e-3)):
        moved = rest.displacement[:, axis]
        ends = [moved[mesh.nodes[:, axis] == place].mean() for place in (0.0, extent)]
        assert ends[1] - ends[0] == pytest.approx(Cooled.shrunk[axis] * extent, rel=1e-9)


def test_a_laminate_that_has_cooled_is_pulled_as_one_that_has_not() -> None:
    mesh = stack(rectangle(4e-3, 2e-3, 4, 2), np.array([0.4, -0.2]), 0.25e-3)
    cooled, plain = (QuasiStatic(mesh, ply, tension_grips(mesh)) for ply in (Cooled(PLY), ElasticMaterial(PLY)))
    rest = cooled.rest()
    assert np.abs(rest.stress).max() > 1e6
    pulled, like = cooled.advance(rest, 4e-6), plain.advance(plain.rest(), 4e-6)
    assert pulled.force == pytest.approx(like.force, rel=1e-9)
    np.testing.assert_allclose(pulled.stress - rest.stress, like.stress, atol=1e-9 * np.abs(like.stress).max())


def test_stresses_of_a_cooled_cross_ply_are_those_of_lamination_theory() -> None:
    # Wide: along its free edges a laminate is not as the theory says, and both share the force.
    mesh = stack(rectangle(8e-3, 80e-3, 8, 80), np.radians([0.0, 90.0]), 0.25e-3)
    problem = QuasiStatic(mesh, Cooled(PLY), tension_grips(mesh, lower_half=True))
    rest = problem.rest()
    # Plane stress in each ply; the mean over both plies is free of force.
    plane = PLY[:2, :2] - np.outer(PLY[:2, 2], PLY[2, :2]) / PLY[2, 2]
    across, shrunk = plane[::-1, ::-1], Cooled.shrunk[:2]
    common = np.linalg.solve(plane + across, plane @ shrunk + across @ shrunk[::-1])
    middle = np.argsort(np.abs(mesh.nodes[mesh.bricks].mean(axis=1)[:, 1] - 40e-3))[:16]
    for ply, wanted in ((0, plane @ (common - shrunk)), (1, across @ (common - shrunk[::-1]))):
        found = rest.stress[middle[mesh.ply[middle] == ply]].mean(axis=(0, 1))
        np.testing.assert_allclose(found[:2], wanted, rtol=2e-3)


def test_one_ply_is_a_bar() -> None:
    mesh = stack(rectangle(4e-3, 2e-3, 4, 2), np.zeros(1), 0.25e-3)
    problem = QuasiStatic(mesh, ElasticMaterial(PLY), tension_grips(mesh))
    found = problem.advance(problem.rest(), 4e-6)
    assert found.force == pytest.approx(167e9 * 1e-3 * 2e-3 * 0.25e-3, rel=1e-10)
    assert np.abs(found.stress[:, :, 1:]).max() < 1e-8 * found.stress.max()
    assert problem.factorisations == 1
    problem.advance(found, 8e-6)
    assert problem.factorisations == 1  # the same stiffness is not factorised again


def test_an_unsymmetric_layup_bends_as_lamination_theory_says() -> None:
    a, b, d = lamination((0.0, 90.0), 0.25e-3)
    wanted = np.linalg.inv(np.block([[a, b], [b, d]]))[3, 0]
    found = bent(0.3e-3, 2)[0]
    assert found[2] == pytest.approx(wanted, rel=0.05)  # 2.9 % by this mesh; the case `laminate` refines it
    assert abs(found[3]) < 0.005 * found[2]


@pytest.mark.parametrize("degrees", [(0.0, 90.0), (30.0, -30.0), (30.0, 0.0, 60.0)])
def test_a_laminate_that_twists_is_held_without_force(degrees: tuple[float, ...]) -> None:
    """Two ends that stay straight and the motions of a rigid body are all that is held: corners feel nothing."""
    mesh = stack(rectangle(8e-3, 4e-3, 4, 2), np.radians(degrees), 0.25e-3)
    problem = QuasiStatic(mesh, ElasticMaterial(PLY), tension_grips(mesh), tolerance=1e-11)
    found = problem.advance(problem.rest(), 8e-6)
    inside = np.zeros((len(mesh.nodes), 3))
    np.add.at(inside, mesh.bricks, problem.bricks.forces(found.stress).reshape(-1, 8, 3))
    corners = problem.grips.freedoms[problem.grips.freedoms % 3 != 0]
    assert len(corners) == 3
    assert np.abs(inside.reshape(-1)[corners]).max() < 1e-9 * np.abs(inside).max()


def test_stiff_layers_answer_as_plies_that_share_their_nodes() -> None:
    plane = open_hole(8e-3, 8e-3, 3.175e-3, around=6, radial=5, growth=3.0, quadrant=True)
    found = []
    for cohesive in (False, True):
        mesh = stack(plane, np.radians([45.0, 0.0, -45.0, 90.0]), 0.125e-3, cohesive=cohesive)
        problem = QuasiStatic(
            mesh,
            ElasticMaterial(PLY),
            tension_grips(mesh, lower_half=True),
            law=STIFF if cohesive else None,
            tolerance=1e-9,
        )
        found.append(problem.advance(problem.rest(), 1e-8))
    tied, layered = found
    assert layered.residual <= 1e-9 and not layered.layers.any()
    assert layered.force == pytest.approx(tied.force, rel=1e-4)
    assert np.abs(layered.stress[:, :, 0].max() / tied.stress[:, :, 0].max() - 1.0) < 1e-3


def test_everything_fails_at_once() -> None:
    mesh = stack(rectangle(4e-3, 2e-3, 4, 2), np.radians([0.0, 0.0]), 0.25e-3)
    problem = QuasiStatic(mesh, SuddenDeath(1e-3, 1e-6), tension_grips(mesh))
    before = problem.advance(problem.rest(), 3.9e-6)
    after = problem.advance(before, 4.1e-6)
    area = 2e-3 * 0.5e-3
    assert before.force == pytest.approx(167e9 * 3.9e-6 / 4e-3 * area, rel=1e-9) and not before.points.failed.any()
    assert after.points.failed.all() and after.residual <= 1e-8
    assert after.force == pytest.approx(1e-6 * 167e9 * 4.1e-6 / 4e-3 * area, rel=1e-6)
    assert not before.points.failed.any()  # the start stays as it was


def test_a_cascade_ends_in_equilibrium() -> None:
    plane = open_hole(8e-3, 8e-3, 3e-3, around=6, radial=6, growth=3.0, quadrant=True)
    mesh = stack(plane, np.zeros(1), 0.25e-3)
    problem = QuasiStatic(
        mesh, SuddenDeath(1e-3, 1e-3), tension_grips(mesh, quarter=True, lower_half=True), tolerance=1e-9
    )
    whole = problem.advance(problem.rest(), 1e-6)
    broken = problem.advance(whole, 7e-6)
    failed = int(broken.points.failed.sum())
    assert 0 < failed < len(broken.points.failed) and broken.residual <= 1e-9
    # Nothing that stands is beyond its limit.
    strain = problem.bricks.strains(broken.displacement).reshape(-1, 6)
    assert strain[broken.points.failed[:, 0] == 0, 0].max() <= 1e-3
    assert broken.force < 7.0 * whole.force


def test_the_work_that_parts_two_plies_is_their_toughness() -> None:
    for viscosity in (0.0, 2e-8):
        problem = split_bar(SOFT, viscosity)
        state, work = problem.rest(), 0.0
        for load in np.linspace(0.0, 9e-6, 361)[1:]:
            following = problem.advance(state, float(load))
            work += 0.5 * (state.force + following.force) * (following.load - state.load)
            state = following
        rest = 0.5 * state.force * state.load  # springs that viscosity has not let go yet
        assert state.layers[:, :, 0].min() == 1.0
        assert work - rest == pytest.approx(200.0 * 1e-6 + state.viscous_energy, rel=2e-3)
        if viscosity:
            assert 0.001 * 200e-6 < state.viscous_energy < 0.1 * 200e-6
        else:
            assert state.viscous_energy == 0.0 and abs(state.force) < 1e-9


@pytest.mark.parametrize("end", [0.5e-6, 4e-6, 6.6e-6, 9e-6])
def test_increments_100_times_too_large_end_on_the_closed_form(end: float) -> None:
    """Bricks and layer are springs in a row: u = d + t / k, t = K d up to the onset and a falling line from there."""
    onset, final, spring = 60e6 / SOFT.stiffness, SOFT.final_opening(0.0), PLY[2, 2] / 0.2e-3
    falling = 60e6 / (final - onset)
    if end < 60e6 * (1.0 / SOFT.stiffness + 1.0 / spring):
        traction = end / (1.0 / SOFT.stiffness + 1.0 / spring)
    else:
        traction = max(0.0, (final - end) / (1.0 / falling - 1.0 / spring))
    for count in (1, 100):
        problem = split_bar(SOFT)
        state = problem.rest()
        for load in np.linspace(0.0, end, count + 1)[1:]:
            state = problem.advance(state, float(load))
        assert state.force == pytest.approx(traction * 1e-6, rel=1e-8, abs=1e-9)


def test_a_lever_pulls_with_forces_in_its_ratio() -> None:
    mesh = stack(rectangle(4e-3, 1e-3, 4, 1), np.zeros(1), 1e-3)
    root = np.flatnonzero(mesh.nodes[:, 0] == 0.0)
    freedoms = np.sort(np.concatenate([3 * root, 3 * root + 1, 3 * root + 2]))
    tip = np.flatnonzero(mesh.nodes[:, 0] == 4e-3)
    weights = np.zeros((len(tip), 3))
    weights[:, 0] = [0.1, 0.2, 0.3, 0.4]
    problem = QuasiStatic(
        mesh, ElasticMaterial(PLY), Grips(freedoms, np.zeros(len(freedoms))), lever=Lever(tip, weights, 1e8)
    )
    found = problem.advance(problem.rest(), 1e-6)
    inside = np.zeros((len(mesh.nodes), 3))
    np.add.at(inside, mesh.bricks, problem.bricks.forces(found.stress).reshape(-1, 8, 3))
    assert np.allclose(inside[tip, 0], found.force * weights[:, 0], rtol=1e-6)
    assert problem.lever is not None
    assert problem.lever.moved(found.displacement) == pytest.approx(1e-6 - found.force / 1e8, rel=1e-9)


def test_wrong_arguments_are_named() -> None:
    mesh: LaminateMesh = stack(rectangle(1e-3, 1e-3, 1, 1), np.array([0.0, np.pi]), 1e-3, cohesive=True)
    grips = Grips(np.array([0]), np.array([0.0]))
    with pytest.raises(ValueError, match="law is missing"):
        QuasiStatic(mesh, ElasticMaterial(PLY), grips)
    with pytest.raises(ValueError, match="iterations is 0"):
        QuasiStatic(mesh, ElasticMaterial(PLY), grips, law=SOFT, iterations=0)
    with pytest.raises(ValueError, match="viscosity is -1"):
        QuasiStatic(mesh, ElasticMaterial(PLY), grips, law=SOFT, viscosity=-1.0)
    with pytest.raises(ValueError, match=r"weights has shape \(2, 2\)"):
        Lever(np.array([0, 1]), np.zeros((2, 2)), 1.0)
    with pytest.raises(ValueError, match="stiffness is 0"):
        Lever(np.array([0]), np.zeros((1, 3)), 0.0)
