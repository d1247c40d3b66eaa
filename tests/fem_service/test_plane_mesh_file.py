"""Plane meshes from files of other programs are the same mesh, or are refused with the number of the element."""

from __future__ import annotations

import re
from pathlib import Path

import meshio
import numpy as np
import pytest
from numpy.typing import NDArray

from fem_service.plane_check import check_plane, corner_sines, fitted
from fem_service.plane_mesh import PlaneMesh, open_hole, rectangle
from fem_service.plane_mesh_file import read_plane_mesh

#: Quarter of a plate of 8 x 8 mm with a hole of 3.175 mm, written by gmsh 4.15.2 (format 4.1), in mm.
GMSH = Path(__file__).parent / "data" / "quarter_hole.msh"


def quarter() -> PlaneMesh:
    return open_hole(8e-3, 8e-3, 3.175e-3, around=6, radial=5, growth=3.0, quadrant=True)


def deck(mesh: PlaneMesh, kind: str, scale: float, elements: NDArray[np.int64] | None = None) -> str:
    """The mesh with odd numbers, a node of no element, and a line element; elements count from 100."""
    rows = mesh.elements if elements is None else elements
    nodes = [f"{10 * row + 7}, {x * scale!r}, {y * scale!r}" for row, (x, y) in enumerate(mesh.nodes.tolist())]
    quads = [f"{100 + row}, {', '.join(str(10 * node + 7) for node in nodes)}" for row, nodes in enumerate(rows)]
    lines = ["*NODE", "3, 1., 1., 9.", *nodes, "*ELEMENT, TYPE=T3D2", "1, 7, 17", f"*ELEMENT, TYPE={kind}", *quads]
    return "\n".join(lines) + "\n"


def written(text: str, folder: Path) -> Path:
    path = folder / "plate.inp"
    path.write_text(text)
    return path


def area(mesh: PlaneMesh) -> float:
    x, y = mesh.nodes[mesh.elements].transpose(2, 0, 1)
    return float(0.5 * np.sum(x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1)))


@pytest.mark.parametrize("kind", ["S4", "CPS4R", "CPE4", "M3D4R"])
def test_a_mesh_that_went_through_a_deck_is_the_same_to_the_last_bit(kind: str, tmp_path: Path) -> None:
    mesh = quarter()
    found = read_plane_mesh(written(deck(mesh, kind, 1.0), tmp_path), 1.0)
    np.testing.assert_array_equal(found.nodes, mesh.nodes)
    np.testing.assert_array_equal(found.elements, mesh.elements)


def test_the_unit_of_the_file_counts(tmp_path: Path) -> None:
    mesh = quarter()
    found = read_plane_mesh(written(deck(mesh, "S4", 1e3), tmp_path), 1e-3)
    np.testing.assert_allclose(found.nodes, mesh.nodes, rtol=1e-15, atol=0.0)


def test_clockwise_elements_are_turned_round_one_by_one(tmp_path: Path) -> None:
    mesh = quarter()
    mixed = mesh.elements.copy()
    mixed[::3] = mixed[::3, ::-1]
    found = read_plane_mesh(written(deck(mesh, "S4", 1.0, mixed), tmp_path), 1.0)
    assert (corner_sines(found) > 0.0).all() and area(found) == pytest.approx(area(mesh), rel=1e-14)
    np.testing.assert_array_equal(np.sort(found.elements, axis=1), np.sort(mesh.elements, axis=1))


@pytest.mark.parametrize(("name", "kind"), [("plate.msh", "gmsh22"), ("plate.vtu", "vtu")])
def test_formats_of_meshio(name: str, kind: str, tmp_path: Path) -> None:
    mesh = quarter()
    points = np.column_stack([mesh.nodes, np.zeros(len(mesh.nodes))])
    cells = [("vertex", np.array([[0]])), ("line", mesh.elements[:3, :2]), ("quad", mesh.elements)]
    meshio.write(tmp_path / name, meshio.Mesh(points, cells), file_format=kind)
    found = read_plane_mesh(tmp_path / name, 1.0)
    np.testing.assert_array_equal(found.nodes, mesh.nodes)
    np.testing.assert_array_equal(found.elements, mesh.elements)


def test_a_file_of_gmsh_covers_the_plate_but_for_the_hole() -> None:
    mesh = fitted(read_plane_mesh(GMSH, 1e-3), 8e-3, 8e-3, quarter=True)
    radii = np.linalg.norm(mesh.nodes, axis=1)
    on_hole = np.flatnonzero(np.abs(radii - 1.5875e-3) < 1e-9)
    angles = np.sort(np.arctan2(mesh.nodes[on_hole, 1], mesh.nodes[on_hole, 0]))
    hole = 0.5 * 1.5875e-3**2 * np.sin(np.diff(angles)).sum()  # the triangles between its straight edges
    assert len(on_hole) > 4 and angles[0] == 0.0 and angles[-1] == pytest.approx(0.5 * np.pi)
    assert area(mesh) == pytest.approx(16e-6 - hole, rel=1e-9)


def test_bad_elements_are_refused_with_their_number(tmp_path: Path) -> None:
    mesh = quarter()
    crossed = mesh.elements.copy()
    crossed[4, :2] = crossed[4, 1::-1]
    with pytest.raises(
        ValueError, match=re.escape("plate.inp: element 104 is turned inside out or flat at its corner")
    ):
        read_plane_mesh(written(deck(mesh, "S4", 1.0, crossed), tmp_path), 1.0)
    twice = mesh.elements.copy()
    twice[7, 3] = twice[7, 0]
    with pytest.raises(ValueError, match="element 107 is turned inside out or flat"):
        read_plane_mesh(written(deck(mesh, "S4", 1.0, twice), tmp_path), 1.0)


def test_other_shapes_are_refused(tmp_path: Path) -> None:
    mesh = quarter()
    lone = deck(mesh, "S4", 1.0) + "*ELEMENT, TYPE=S3\n900, 7, 17, 27\n"
    with pytest.raises(ValueError, match=r"TYPE=S3 \(element 900\): only quadrilaterals"):
        read_plane_mesh(written(lone, tmp_path), 1.0)
    brick = deck(mesh, "S4", 1.0) + "*ELEMENT, TYPE=C3D8\n900, 7, 17, 27, 37, 47, 57, 67, 77\n"
    with pytest.raises(ValueError, match="element 900 is a C3D8; a plane mesh has quadrilaterals only"):
        read_plane_mesh(written(brick, tmp_path), 1.0)
    with pytest.raises(ValueError, match="holds no quadrilaterals"):
        read_plane_mesh(written("*NODE\n1, 0., 0.\n", tmp_path), 1.0)
    points = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    meshio.write(tmp_path / "three.vtu", meshio.Mesh(points, [("triangle", np.array([[0, 1, 2]]))]))
    with pytest.raises(ValueError, match=r"three\.vtu: holds 1 cells of type triangle; only quad is read"):
        read_plane_mesh(tmp_path / "three.vtu", 1.0)


def test_a_mesh_that_is_not_flat_is_refused(tmp_path: Path) -> None:
    text = deck(quarter(), "S4", 1.0)
    first = text.splitlines()[2]
    with pytest.raises(ValueError, match=r"is not flat: its nodes differ by 0\.001 in z"):
        read_plane_mesh(written(text.replace(first, f"{first}, 1e-3"), tmp_path), 1.0)


@pytest.mark.parametrize(("name", "text"), [("gone.msh", None), ("broken.msh", "$MeshFormat\nnot one"), ("a.xyz3", "")])
def test_what_meshio_cannot_read_does_not_end_the_process(name: str, text: str | None, tmp_path: Path) -> None:
    if text is not None:
        (tmp_path / name).write_text(text)
    with pytest.raises(ValueError, match=re.escape(name)):
        read_plane_mesh(tmp_path / name, 1.0)


# --- what the service checks too -------------------------------------------------------------------


def test_meshes_in_pieces_and_doubled_elements_are_refused() -> None:
    mesh = rectangle(2.0, 1.0, 2, 1)
    apart = np.concatenate([mesh.nodes, mesh.nodes])
    with pytest.raises(ValueError, match="is of 2 pieces: element 2 does not hang together with element 0"):
        check_plane(PlaneMesh(apart, np.concatenate([mesh.elements, mesh.elements + 6])))
    with pytest.raises(ValueError, match="elements 0 and 2 lie on each other"):
        check_plane(PlaneMesh(mesh.nodes, np.concatenate([mesh.elements, mesh.elements[:1]])))
    with pytest.raises(ValueError, match="node 6 belongs to no element"):
        check_plane(PlaneMesh(np.concatenate([mesh.nodes, [[0.5, 0.5]]]), mesh.elements))
    with pytest.raises(ValueError, match="element 1 goes clockwise"):
        check_plane(PlaneMesh(mesh.nodes, np.stack([mesh.elements[0], mesh.elements[1, ::-1]])))


def test_a_slit_is_no_fault() -> None:
    mesh = rectangle(2.0, 2.0, 2, 2)
    # The middle of the lower side is two nodes: a crack that runs up to the centre.
    nodes = np.concatenate([mesh.nodes, mesh.nodes[3:4]])
    elements = mesh.elements.copy()
    elements[2][elements[2] == 3] = 9
    check_plane(PlaneMesh(nodes, elements))


def test_borders_are_set_on_the_sides_and_others_refused() -> None:
    mesh = quarter()
    digits = PlaneMesh(np.round(mesh.nodes, 9) + 1e-9, mesh.elements)  # 4e-3 m within 1e-6
    found = fitted(digits, 8e-3, 8e-3, quarter=True)
    assert found.nodes.min(axis=0).tolist() == [0.0, 0.0] and found.nodes.max(axis=0).tolist() == [4e-3, 4e-3]
    assert np.count_nonzero(found.nodes == 0.0) == np.count_nonzero(mesh.nodes < 1e-12)
    with pytest.raises(ValueError, match=r"the mesh ends at x = 0 m; the part that is modelled ends at -0\.004 m"):
        fitted(mesh, 8e-3, 8e-3, quarter=False)
    with pytest.raises(ValueError, match=r"there is a node at x = .* from \(0, 0\) to \(0\.003, 0\.004\) m"):
        fitted(mesh, 6e-3, 8e-3, quarter=True)
    cut = PlaneMesh(mesh.nodes, mesh.elements[mesh.nodes[mesh.elements][:, :, 1].max(axis=1) < 3.9e-3])
    used, place = np.unique(cut.elements, return_inverse=True)
    with pytest.raises(ValueError, match="the mesh ends at y"):
        fitted(PlaneMesh(mesh.nodes[used], place.reshape(-1, 4)), 8e-3, 8e-3, quarter=True)
