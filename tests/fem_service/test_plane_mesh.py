"""Meshes in the plane against closed forms: areas, shapes, symmetry; the quarter answers as the whole does."""

from __future__ import annotations

import numpy as np
import pytest

from fem_service.hexahedron import InvertedElement
from fem_service.laminate_mesh import LaminateMesh, stack
from fem_service.plane_mesh import PlaneMesh, graded, open_hole, rectangle
from fem_service.point_material import ElasticMaterial
from fem_service.quasi_static import QuasiStatic
from fem_service.tension import tension_grips
from fem_service.verification.beams import transversely_isotropic

PLY = transversely_isotropic(167e9, 15e9, 0.34, 0.29, 3.9e9, 5.8e9)


def corner_crosses(mesh: PlaneMesh) -> np.ndarray:
    """Twice the area of the triangle at each corner, positive where an element turns counterclockwise there."""
    place = mesh.nodes[mesh.elements]
    following, preceding = np.roll(place, -1, axis=1) - place, np.roll(place, 1, axis=1) - place
    return following[..., 0] * preceding[..., 1] - following[..., 1] * preceding[..., 0]


def area(mesh: PlaneMesh) -> float:
    return float(corner_crosses(mesh)[:, [0, 2]].sum() / 2.0)


@pytest.mark.parametrize("quadrant", [False, True])
@pytest.mark.parametrize(("length", "beyond"), [(16e-3, 0), (64e-3, 12)])
@pytest.mark.parametrize(("around", "radial", "growth"), [(2, 1, 1.0), (8, 6, 4.0), (24, 16, 30.0)])
def test_area_with_a_hole(length: float, beyond: int, around: int, radial: int, growth: float, quadrant: bool) -> None:
    width, diameter = 16e-3, 3.175e-3
    mesh = open_hole(
        length, width, diameter, around=around, radial=radial, growth=growth, beyond=beyond, quadrant=quadrant
    )
    # The hole is a polygon of 4 `around` sides whose corners lie on the circle.
    hole = 0.5 * 4 * around * (0.5 * diameter) ** 2 * np.sin(0.5 * np.pi / around)
    assert area(mesh) == pytest.approx((length * width - hole) * (0.25 if quadrant else 1.0), rel=1e-12)
    assert corner_crosses(mesh).min() > 0.0
    assert len(np.unique(mesh.elements)) == len(mesh.nodes)


def test_whole_mesh_is_symmetric_and_has_no_seam() -> None:
    mesh = open_hole(40e-3, 16e-3, 4e-3, around=6, radial=5, growth=3.0, beyond=5)
    rounded = {(round(x * 1e9), round(y * 1e9)) for x, y in mesh.nodes}
    assert len(rounded) == len(mesh.nodes)
    assert rounded == {(-x, y) for x, y in rounded} == {(x, -y) for x, y in rounded}
    # Euler: a sheet with one hole has as many nodes as edges less elements.
    edges = {tuple(sorted(pair)) for e in mesh.elements.tolist() for pair in zip(e, e[1:] + e[:1], strict=True)}
    assert len(mesh.nodes) - len(edges) + len(mesh.elements) == 0


def test_graded_places() -> None:
    places = graded(9, 16.0)
    sizes = np.diff(places)
    assert places[0] == 0.0 and places[-1] == pytest.approx(1.0, rel=1e-15)
    assert sizes[-1] / sizes[0] == pytest.approx(16.0)
    assert np.allclose(sizes[1:] / sizes[:-1], 16.0 ** (1 / 8))


def pulled(length: float, quarter: bool, lower_half: bool) -> tuple[float, float]:
    """Force on the whole laminate, N, and its largest stress, of [0/90]s pulled by 1 um."""
    plane = open_hole(length, 8e-3, 3e-3, around=4, radial=4, growth=2.0, beyond=2, quadrant=quarter)
    angles = np.radians([0.0, 90.0] if lower_half else [0.0, 90.0, 90.0, 0.0])
    mesh = stack(plane, angles, 0.25e-3)
    problem = QuasiStatic(
        mesh, ElasticMaterial(PLY), tension_grips(mesh, quarter=quarter, lower_half=lower_half), tolerance=1e-11
    )
    found = problem.advance(problem.rest(), 1e-6)
    # The force is work per load, of which a quarter has a quarter.
    return found.force * (4.0 if quarter else 1.0) * (2.0 if lower_half else 1.0), float(found.stress[:, :, 0].max())


def test_parts_cut_at_planes_of_symmetry_answer_as_the_whole() -> None:
    force, stress = pulled(12e-3, quarter=False, lower_half=False)
    for quarter, lower in ((True, False), (False, True), (True, True)):
        other_force, other_stress = pulled(12e-3, quarter, lower)
        assert other_force == pytest.approx(force, rel=1e-9)
        assert other_stress == pytest.approx(stress, rel=1e-9)


def test_an_inverted_element_at_the_hole_is_named() -> None:
    plane = open_hole(8e-3, 8e-3, 3e-3, around=4, radial=3, quadrant=True)
    mesh = stack(plane, np.zeros(1), 0.25e-3)
    # A node of the hole's edge pushed through the element behind it.
    centres = plane.nodes[plane.elements].mean(axis=1)
    at_hole = int(np.argmin(np.hypot(*centres.T)))
    node = int(plane.elements[at_hole][np.argmin(np.hypot(*plane.nodes[plane.elements[at_hole]].T))])
    moved = mesh.nodes.copy()
    moved[[node, node + len(plane.nodes)], :2] *= 3.0
    bad = LaminateMesh(moved, mesh.bricks, mesh.ply, mesh.layers, mesh.interface, mesh.angles)
    with pytest.raises(InvertedElement) as caught:
        QuasiStatic(bad, ElasticMaterial(PLY), tension_grips(bad, quarter=True, lower_half=True))
    assert node in mesh.bricks[caught.value.element]
    assert str(caught.value).startswith(f"element {caught.value.element} is inverted")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"around": 3}, "around is 3; it must be even"),
        ({"around": 0}, "around is 0; it must be at least 1"),
        ({"diameter": 0.02}, "diameter is 0.02 m; it must be less than the width"),
        ({"length": 0.005}, "length is 0.005 m; it must be at least the width"),
        ({"beyond": 3}, "beyond is 3; it must be 0"),
        ({"length": 0.02}, "beyond is 0; it must be at least 1"),
        ({"growth": -1.0}, "growth is -1.0"),
    ],
)
def test_wrong_numbers_are_named(change: dict, message: str) -> None:
    arguments = {"length": 8e-3, "width": 8e-3, "diameter": 3e-3, "around": 4, "radial": 3, "growth": 1.0, "beyond": 0}
    with pytest.raises(ValueError, match=message):
        open_hole(**{**arguments, **change})
    with pytest.raises(ValueError, match="rows is 0"):
        rectangle(1.0, 1.0, 2, 0)
