"""Laminates that are hard to solve, with a cell at every point: against closed forms and against laminate theory."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fem_service.cell_client import CellClient
from fem_service.cohesive_law import CohesiveLaw
from fem_service.cohesive_layer import CohesiveLayers
from fem_service.equilibrium import Equilibrium, Grips
from fem_service.hexahedron import InvertedElement
from fem_service.laminate_mesh import LaminateMesh, stack
from fem_service.plane_mesh import PlaneMesh, open_hole, rectangle
from fem_service.point_material import ElasticMaterial, PointAnswer, PointState
from fem_service.quasi_static import QuasiStatic
from fem_service.tension import tension_grips
from fem_service.verification.beams import transversely_isotropic
from fem_service.verification.laminate_stiffness import lamination
from gmc_service.service import make_gmc, read_definition
from protocol.client import Client
from protocol.micromechanics import RegisterCell
from protocol.server import running

CELL = Path(__file__).parents[2] / "scenes" / "cells" / "im7_epon862_neat.toml"
#: Of that cell: share and modulus of the fibre and its last strain, the resin's modulus, what a failed subcell keeps.
FIBRE, YOUNG, LAST, RESIN, KEPT = 0.6, 276e9, 0.019, 2.963e9, 1e-4
#: The constants that `lamination` takes.
PLY = transversely_isotropic(166785.894e6, 15003.7323e6, 0.340531864, 0.286246729, 3858.68478e6, 2681.12315e6)
THICK = 0.25e-3
#: Table 6.6: K = 2.71e8 MPa/mm.
STIFF = CohesiveLaw(2.71e17, 60e6, 90e6, 200.0, 1000.0, 1.0)
SOFT = replace(STIFF, stiffness=1e14)


@pytest.fixture(scope="module")
def endpoint(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    folder = tmp_path_factory.mktemp("c")
    with running(make_gmc(folder), "tcp://127.0.0.1:*") as server:
        yield server.endpoint


@pytest.fixture
def ask(endpoint: str) -> Iterator[CellClient]:
    client = cell_client(endpoint, read_definition(CELL))
    yield client
    client.close()


def cell_client(endpoint: str, cell: RegisterCell) -> CellClient:
    return CellClient(lambda: Client.connect(endpoint, "micromechanics"), cell, 300.0)


def endless_fibres() -> RegisterCell:
    """The cell with fibres that do not fail."""
    cell = read_definition(CELL)
    fibre, resin = cell.materials
    return cell.model_copy(update={"materials": [fibre.model_copy(update={"failures": []}), resin]})


def strip(*degrees: float, cohesive: bool = False) -> LaminateMesh:
    return stack(rectangle(8e-3, 4e-3, 4, 2), np.radians(degrees), THICK, cohesive=cohesive)


def failed_share(found: Equilibrium, subcells: slice) -> float:
    bits = np.unpackbits(found.points.failed, axis=1, bitorder="little")[:, :4]
    return float(bits[:, subcells].mean())


# --- all of it at once -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("law", [None, SOFT], ids=["tied", "layers"])
def test_fibres_alone_hold_what_is_left_where_all_matrix_fails_at_once(endpoint: str, law: CohesiveLaw | None) -> None:
    """One increment, a hundred times that of the first failure: plies along the load keep share x modulus x strain."""
    material = cell_client(endpoint, endless_fibres())
    mesh = strip(0.0, 90.0, cohesive=law is not None)
    plate = QuasiStatic(mesh, material, tension_grips(mesh, lower_half=True), law=law)
    strain = 0.3
    found = plate.advance(plate.rest(), strain * 8e-3)
    material.close()
    assert failed_share(found, slice(1, 4)) == 1.0 and failed_share(found, slice(0, 1)) == 0.0
    assert found.residual <= 1e-8
    assert found.force == pytest.approx(FIBRE * YOUNG * strain * 4e-3 * THICK, rel=1e-3)


def test_one_ply_breaks_at_the_last_strain_of_its_fibre_and_its_resin_holds_on(ask: CellClient) -> None:
    mesh = strip(0.0)
    plate = QuasiStatic(mesh, ask, tension_grips(mesh))
    area = 4e-3 * THICK
    young = FIBRE * YOUNG + (1.0 - FIBRE) * RESIN  # parallel, but for 2e-7 by Poisson's ratios
    before = plate.advance(plate.rest(), 0.99999 * LAST * 8e-3)
    assert before.force == pytest.approx(young * 0.99999 * LAST * area, rel=1e-4) and not before.points.failed.any()
    after = plate.advance(before, 1.00001 * LAST * 8e-3)
    assert failed_share(after, slice(0, 1)) == 1.0 and failed_share(after, slice(1, 4)) == 0.0
    left = KEPT * FIBRE * YOUNG + (1.0 - FIBRE) * RESIN  # whose strength is reached at 4 % only
    assert after.force == pytest.approx(left * 1.00001 * LAST * area, rel=1e-4) and after.residual <= 1e-8


# --- increments --------------------------------------------------------------------------------------------------


def test_first_ply_failure_is_the_same_in_one_increment_and_in_a_hundred(ask: CellClient) -> None:
    """A strip without a hole: all points of a ply are alike, so their order does not matter."""
    mesh = strip(0.0, 90.0)
    plate = QuasiStatic(mesh, ask, tension_grips(mesh, lower_half=True), tolerance=1e-10)
    end = 0.015 * 8e-3
    once = plate.advance(plate.rest(), end)
    state = plate.rest()
    for load in np.linspace(0.0, end, 101)[1:]:
        state = plate.advance(state, float(load))
    assert np.array_equal(once.points.failed, state.points.failed) and state.points.failed.any()
    assert once.force == pytest.approx(state.force, rel=1e-9)


@pytest.mark.parametrize("law", [None, SOFT], ids=["tied", "layers"])
def test_increments_100_times_too_large_end_near_small_ones(ask: CellClient, law: CohesiveLaw | None) -> None:
    """Beside a hole the order of failures counts. Before fibres break the force differs little for all that."""
    plane = open_hole(8e-3, 8e-3, 3.175e-3, around=6, radial=5, growth=3.0, quadrant=True)
    mesh = stack(plane, np.radians([0.0, 90.0]), THICK, cohesive=law is not None)
    grips = tension_grips(mesh, quarter=True, lower_half=True)
    plate = QuasiStatic(mesh, ask, grips, law=law, tolerance=1e-6)
    end = 0.0035 * 8e-3
    once = plate.advance(plate.rest(), end)
    state = plate.rest()
    for load in np.linspace(0.0, end, 101)[1:]:
        state = plate.advance(state, float(load))
    for found in (once, state):
        assert found.points.failed.any() and found.residual <= 1e-6
    assert once.force == pytest.approx(state.force, rel=0.01)


class Brittle(ElasticMaterial):
    """Points that keep a millionth of their stiffness for good from a strain across the ply on."""

    def __init__(self, limit: float) -> None:
        super().__init__(PLY)
        self.limit = limit

    def fresh(self, points: int) -> PointState:
        return PointState(np.zeros((points, 1), np.uint8), np.zeros((points, 0)))

    def respond(self, strain: np.ndarray, state: PointState, element_length: np.ndarray) -> PointAnswer:
        failed = np.maximum(state.failed, (strain[:, 2:3] > self.limit).astype(np.uint8))
        tangents, index = np.array([PLY, 1e-6 * PLY]), failed[:, 0].astype(np.int64)
        stress = np.einsum("pij,pj->pi", tangents[index], strain)
        return PointAnswer(stress, PointState(failed, state.history), index, tangents)


@pytest.mark.parametrize("law", [SOFT, STIFF], ids=["K 1e14", "K 2.71e17"])
@pytest.mark.parametrize("count", [1, 10])
def test_bricks_that_are_stronger_than_their_layer_outlive_it(law: CohesiveLaw, count: int) -> None:
    """Bricks hold twice what the layer holds. On its way to a balance an increment strains them far beyond that."""
    mesh = stack(rectangle(1e-3, 1e-3, 1, 1), np.array([0.0, np.pi]), 0.1e-3, cohesive=True)
    z = mesh.nodes[:, 2]
    moves = np.zeros((len(z), 3))
    moves[z == z.max(), 2] = 1.0
    held = np.ones((len(z), 3), dtype=bool)
    held[:, 2] = (z == 0.0) | (z == z.max())
    freedoms = np.flatnonzero(held)
    bar = QuasiStatic(
        mesh, Brittle(120e6 / PLY[2, 2]), Grips(freedoms, moves.reshape(-1)[freedoms]), law=law, tolerance=1e-6
    )
    state = bar.rest()
    for load in np.linspace(0.0, 9e-6, count + 1)[1:]:  # 6.7e-6 m part the layer, 1.6e-6 m alone would break a brick
        state = bar.advance(state, float(load))
    assert state.layers[:, :, 0].min() == 1.0
    assert not state.points.failed.any()
    assert abs(state.force) < 1e-6 * 60e6 * 1e-6


# --- stiff layers ------------------------------------------------------------------------------------------------


def quasi_isotropic(law: CohesiveLaw | None) -> Equilibrium:
    """[45/0/-45/90]s with a hole, far below all strengths."""
    plane = open_hole(16e-3, 16e-3, 3.175e-3, around=6, radial=5, growth=6.0)
    mesh = stack(plane, np.radians([45.0, 0.0, -45.0, 90.0]), 0.125e-3, cohesive=law is not None)
    plate = QuasiStatic(mesh, ElasticMaterial(PLY), tension_grips(mesh, lower_half=True), law=law, tolerance=1e-9)
    return plate.advance(plate.rest(), 1e-6 * 16e-3)


def test_the_compliance_of_layers_goes_with_one_over_their_stiffness() -> None:
    """Down to K = 2.71e8 MPa/mm, where a layer is 1e4 times as stiff as the ply beside it."""
    tied = quasi_isotropic(None)
    softer = {}
    for share in (1e-4, 1e-2, 1.0):
        found = quasi_isotropic(replace(STIFF, stiffness=share * STIFF.stiffness))
        assert found.residual <= 1e-9 and not found.layers.any()
        softer[share] = 1.0 - found.force / tied.force
    assert softer[1e-4] > 80.0 * softer[1e-2]  # 1 % already: no longer small
    assert softer[1e-2] == pytest.approx(100.0 * softer[1.0], rel=0.01)
    assert 0.0 < softer[1.0] < 2e-6


def test_an_unsymmetric_layup_with_stiff_layers_bends_as_lamination_theory_says() -> None:
    """[0/90] between straight ends: no bending along the load, and across it whatever leaves no moment."""
    a, b, d = lamination((0.0, 90.0), THICK)
    across = np.array([[a[1, 1], b[1, 1]], [b[1, 1], d[1, 1]]])
    wanted = -np.linalg.solve(across, [a[0, 1], b[0, 1]])[1]  # curvature over the strain along
    bend = {}
    for law in (None, STIFF):
        mesh = stack(rectangle(16e-3, 6e-3, 4, 60), np.radians([0.0, 90.0]), THICK, per_ply=2, cohesive=law is not None)
        plate = QuasiStatic(mesh, ElasticMaterial(PLY), tension_grips(mesh), law=law, tolerance=1e-9)
        found = plate.advance(plate.rest(), 1e-5 * 16e-3)
        x, y, z = mesh.nodes.T
        line = (np.abs(x - 8e-3) < 1e-9) & (np.abs(y - 3e-3) < 1.5e-3) & (z == 0.0)
        fit = np.polyfit(y[line] - 3e-3, found.displacement[line, 2], 2)
        bend[law] = -2.0 * fit[0] / 1e-5
    assert bend[None] == pytest.approx(wanted, rel=0.01)
    assert bend[STIFF] == pytest.approx(bend[None], rel=1e-4)


# --- distorted elements ------------------------------------------------------------------------------------------


def with_moved_node(share: float) -> tuple[PlaneMesh, int]:
    """A quarter of a plate in which a node at the hole's edge is moved along its ray, by a share of the element there.

    Returns the node, too.
    """
    plane = open_hole(8e-3, 8e-3, 3.175e-3, around=6, radial=5, quadrant=True)
    radius, angle = np.hypot(*plane.nodes.T), np.arctan2(plane.nodes[:, 1], plane.nodes[:, 0])
    edge = np.flatnonzero(radius < 1.001 * radius.min())
    node = int(edge[np.argsort(angle[edge])[2]])
    element = plane.elements[(plane.elements == node).any(axis=1)][0]
    size = np.ptp(radius[element])
    nodes = plane.nodes.copy()
    nodes[node] *= 1.0 + share * size / radius[node]
    return replace(plane, nodes=nodes), node


@pytest.mark.parametrize("share", [-0.6, 0.5])
def test_a_uniform_strain_passes_through_distorted_elements_at_the_hole(share: float) -> None:
    """Patch test: the faces move as in a uniform strain, and all points inside have that strain."""
    plane, _ = with_moved_node(share)
    mesh = stack(plane, np.zeros(1), THICK, per_ply=2)
    gradient = np.array([[1e-3, 4e-4, 0.0], [2e-4, -5e-4, 0.0], [0.0, 0.0, 3e-4]])
    moved = (mesh.nodes @ gradient.T).reshape(-1)
    edges = np.sort(np.stack([plane.elements, np.roll(plane.elements, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    once, count = np.unique(edges, axis=0, return_counts=True)
    outside = np.zeros(len(plane.nodes), dtype=bool)
    outside[once[count == 1]] = True
    z = mesh.nodes[:, 2]
    held = np.flatnonzero(np.repeat(np.tile(outside, 3) | (z == 0.0) | (z == z.max()), 3))
    plate = QuasiStatic(mesh, ElasticMaterial(PLY), Grips(held, moved[held]), tolerance=1e-10)
    assert plate.unknowns == 3 * np.count_nonzero(~outside)
    strain = plate.ply_strains(plate.advance(plate.rest(), 1.0).displacement)
    assert np.abs(strain - [1e-3, -5e-4, 3e-4, 0.0, 0.0, 6e-4]).max() < 1e-12


def test_an_inverted_element_at_the_hole_is_named_by_its_number() -> None:
    plane, node = with_moved_node(1.3)
    mesh = stack(plane, np.radians([0.0, 90.0]), THICK, cohesive=True)
    with pytest.raises(InvertedElement, match="is inverted or flat: its Jacobian determinant is -") as caught:
        QuasiStatic(mesh, ElasticMaterial(PLY), tension_grips(mesh, quarter=True), law=STIFF)
    assert node in mesh.bricks[caught.value.element]
    assert f"element {caught.value.element} is" in str(caught.value)
    with pytest.raises(InvertedElement) as layer:  # a layer alone finds it, too
        CohesiveLayers(mesh.nodes, mesh.layers, STIFF)
    assert np.isin(mesh.layers[layer.value.element] % len(plane.nodes), node).any()
