"""Laminates as decks: read back they are the same laminate, and CalculiX finds the same displacements and reactions."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from fem_service.equilibrium import Grips
from fem_service.hexahedron import Hexahedra
from fem_service.laminate_deck import laminate_deck
from fem_service.laminate_file import _TURNED, read_laminate
from fem_service.laminate_mesh import LaminateMesh, stack
from fem_service.plane_mesh import open_hole, rectangle
from fem_service.point_material import ElasticMaterial
from fem_service.tension import tension_grips
from fem_service.verification.calculix import largest_differences, run_calculix, solved

needs_calculix = pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX (ccx) is not installed")

STRAIN = 1e-3
LENGTH = 8e-3
#: E1, E2, E3, nu12, nu13, nu23, G12, G13, G23, Pa.
CONSTANTS = (160e9, 9e9, 8e9, 0.3, 0.28, 0.45, 5e9, 4.5e9, 3e9)


def orthotropic() -> NDArray[np.float64]:
    e1, e2, e3, nu12, nu13, nu23, g12, g13, g23 = CONSTANTS
    compliance = np.diag([1 / e1, 1 / e2, 1 / e3, 1 / g23, 1 / g13, 1 / g12])
    compliance[0, 1] = compliance[1, 0] = -nu12 / e1
    compliance[0, 2] = compliance[2, 0] = -nu13 / e1
    compliance[1, 2] = compliance[2, 1] = -nu23 / e2
    return np.linalg.inv(compliance)


def tied() -> NDArray[np.float64]:
    """A stiffness of which all 21 constants differ."""
    root = np.random.default_rng(5).normal(size=(6, 6)) + 3.0 * np.eye(6)
    return np.asarray(1e9 * root @ root.T)


def plate(angles: list[float], shaken: float = 0.0) -> LaminateMesh:
    """A plate with a hole, whose inner nodes may be moved at random by a part of the smallest edge."""
    plane = open_hole(LENGTH, LENGTH, 3.175e-3, around=4, radial=4, growth=3.0)
    mesh = stack(plane, np.radians(angles), 0.25e-3)
    low, high = mesh.nodes.min(axis=0), mesh.nodes.max(axis=0)
    inner = ((mesh.nodes > low + 1e-9) & (mesh.nodes < high - 1e-9)).all(axis=1)
    moves = np.random.default_rng(2).uniform(-shaken * 0.25e-3, shaken * 0.25e-3, (int(inner.sum()), 3))
    nodes = mesh.nodes.copy()
    nodes[inner] += moves
    return replace(mesh, nodes=nodes)


def grips(mesh: LaminateMesh, **symmetry: bool) -> Grips:
    unit = tension_grips(mesh, **symmetry)
    return replace(unit, per_load=unit.per_load * STRAIN * LENGTH)


CASES = {
    "quasi-isotropic half": ([45.0, 0.0, -45.0, 90.0], {"lower_half": True}, orthotropic(), 0.0),
    "bends and twists, shaken": ([0.0, 45.0, 90.0], {}, orthotropic(), 0.3),
    "all constants differ": ([30.0, -60.0], {}, tied(), 0.3),
}


@needs_calculix
@pytest.mark.parametrize("case", list(CASES))
def test_calculix_finds_the_same_displacements_and_reactions(case: str, tmp_path: Path) -> None:
    angles, symmetry, stiffness, shaken = CASES[case]
    mesh = plate(angles, shaken)
    held = grips(mesh, **symmetry)
    theirs = run_calculix(laminate_deck(mesh, held, stiffness), tmp_path)
    full = largest_differences(theirs, solved(mesh, held, ElasticMaterial(stiffness)))
    assert max(full) < 1e-6, full
    # It is full integration that equals theirs: the mean dilatation is another element.
    mean = largest_differences(theirs, solved(mesh, held, ElasticMaterial(stiffness), mean_dilatation=True))
    assert min(mean) > 1e-3, mean


# --- what can be said without CalculiX -------------------------------------------------------------


@pytest.mark.parametrize("shaken", [0.0, 0.3])
def test_read_back_it_is_the_same_laminate(shaken: float, tmp_path: Path) -> None:
    mesh = plate([45.0, 0.0, -45.0], shaken)
    (tmp_path / "plate.inp").write_text(laminate_deck(mesh, grips(mesh), orthotropic(), ["[45/0/-45]"]))
    plies = [(f"Ply_{number}", angle) for number, angle in enumerate(mesh.angles, 1)]
    found = read_laminate(tmp_path / "plate.inp", plies, 1e-3)
    np.testing.assert_allclose(found.nodes, mesh.nodes, rtol=1e-13, atol=1e-18)
    for name in ("bricks", "ply", "angles"):
        np.testing.assert_array_equal(getattr(found, name), getattr(mesh, name))


def test_numbers_are_short_enough_for_calculix_and_constants_those_of_the_manuals_order() -> None:
    mesh = plate([30.0], 0.3)
    deck = laminate_deck(mesh, grips(mesh), orthotropic())
    data = [line for line in deck[deck.index("*NODE") :].splitlines() if not line.startswith("*")]
    assert max(len(word.strip()) for line in data for word in line.split(",")) <= 20
    assert max(line.count(",") for line in data) <= 8  # an element and its nodes; eight values otherwise
    block = re.split(r"^\*.*$", deck[deck.index("*ELASTIC, TYPE=ENGINEERING CONSTANTS") :], flags=re.MULTILINE)[1]
    found = [float(word) for word in block.replace("\n", ",").split(",") if word.strip()]
    moduli = np.array(CONSTANTS)
    moduli[[0, 1, 2, 6, 7, 8]] /= 1e6
    np.testing.assert_allclose(found, moduli, rtol=1e-12)


def test_grips_are_sets_of_the_nodes_that_are_held() -> None:
    mesh = plate([0.0])
    held = grips(mesh, quarter=False)
    deck = laminate_deck(mesh, held, orthotropic())
    sets = dict(re.findall(r"\*NSET, NSET=(GRIP_\d+)\n((?:[\d, ]+\n)+)", deck))
    moves = re.findall(r"^(GRIP_\d+), (\d), \2, (\S+)$", deck, flags=re.MULTILINE)
    assert len(sets) == len(moves)
    found = {
        3 * (int(node) - 1) + int(axis) - 1: 1e-3 * float(value)
        for name, axis, value in moves
        for node in sets[name].replace("\n", ",").split(",")
        if node.strip()
    }
    assert sorted(found) == held.freedoms.tolist()
    np.testing.assert_allclose([found[freedom] for freedom in held.freedoms.tolist()], held.per_load, rtol=1e-15)


def test_what_a_deck_cannot_hold_is_refused() -> None:
    plane = rectangle(1e-3, 1e-3, 1, 1)
    layered = stack(plane, np.radians([0.0, 90.0]), 1e-4, cohesive=True)
    with pytest.raises(ValueError, match="the mesh has cohesive layers"):
        laminate_deck(layered, grips(layered), orthotropic())


# --- decks of others -------------------------------------------------------------------------------

BLOCK = """*NODE
1, 0., 0., 5.
2, 2., 0., 5.
3, 2., 1., 5.
4, 0., 1., 5.
5, 0., 0., 6.
6, 2., 0., 6.
7, 2., 1., 6.
8, 0., 1., 6.
15, 0., 0., 7.
16, 2., 0., 7.
17, 2., 1., 7.
18, 0., 1., 7.
99, 3., 3., 3.
*ELEMENT, TYPE=C3D8R, ELSET=UPPER
20, 5, 6, 7, 8, 15, 16, 17, 18
*ELEMENT, TYPE=C3D8
10, 1, 4, 8, 5, 2, 3, 7, 6
*ELEMENT, TYPE=S4, ELSET=SKIN
30, 1, 2, 3, 4
*ELSET, ELSET=LOWER
10
"""
PLIES = [("Lower", 0.0), ("upper", 1.0)]


def read_block(text: str, folder: Path, plies: list[tuple[str, float]] = PLIES) -> LaminateMesh:
    (folder / "block.inp").write_text(text)
    return read_laminate(folder / "block.inp", plies, 1e-3)


def test_bricks_are_counted_from_their_lower_face_whatever_the_deck_does(tmp_path: Path) -> None:
    """Brick 10 of the deck has x = 0 for its first face."""
    found = read_block(BLOCK, tmp_path)
    assert found.ply.tolist() == [1, 0] and found.angles.tolist() == [0.0, 1.0] and len(found.nodes) == 12
    z = found.nodes[found.bricks][:, :, 2]
    np.testing.assert_allclose(z, 1e-3 * np.array([[1, 1, 1, 1, 2, 2, 2, 2], [0, 0, 0, 0, 1, 1, 1, 1]]), atol=1e-18)
    np.testing.assert_allclose(Hexahedra(found.nodes, found.bricks).volumes.sum(axis=1), 2e-9, rtol=1e-14)


def test_the_six_ways_to_count_a_brick_are_one_brick() -> None:
    unit = stack(rectangle(1.0, 1.0, 1, 1), np.zeros(1), 1.0)
    volumes = Hexahedra(unit.nodes, unit.bricks[0][_TURNED]).volumes
    np.testing.assert_allclose(volumes, 0.125, rtol=1e-14)
    lower = {frozenset(way[:4].tolist()) for way in _TURNED}
    assert len(lower) == 6


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("20, 5, 6, 7, 8, 15, 16, 17, 18", "20, 8, 7, 6, 5, 18, 17, 16, 15", "element 20 is inverted or flat"),
        ("*ELSET, ELSET=LOWER\n10", "*ELSET, ELSET=LOWER\n10, 20", "element 20 is in the sets Lower and upper"),
        ("*ELSET, ELSET=LOWER\n10", "*ELSET, ELSET=LOWER\n30", "the element set Lower holds no brick"),
        ("ELSET=LOWER", "ELSET=LOW", "there is no element set Lower; there are LOW, SKIN, UPPER"),
        ("TYPE=C3D8\n", "TYPE=C3D10\n", r"TYPE=C3D10 \(element 10\): only"),
        ("20, 5, 6, 7, 8,", "20, 25, 26, 27, 28,", "is of 2 pieces: element 10 does not hang together with element 20"),
    ],
)
def test_bricks_that_make_no_laminate_are_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in BLOCK
    doubled = "".join(f"2{node}, {x}., {y}., 6.\n" for node, x, y in ((5, 0, 0), (6, 2, 0), (7, 2, 1), (8, 0, 1)))
    text = BLOCK.replace(old, new).replace("99, 3., 3., 3.\n", doubled)
    with pytest.raises(ValueError, match=message):
        read_block(text, tmp_path)


def test_plies_that_are_missing_or_out_of_order_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="ply Lower does not lie above upper"):
        read_block(BLOCK, tmp_path, PLIES[::-1])
    with pytest.raises(ValueError, match="element 20 is in none of the sets Lower"):
        read_block(BLOCK, tmp_path, PLIES[:1])
    with pytest.raises(ValueError, match="holds no bricks"):
        read_block("*NODE\n1, 0., 0.\n", tmp_path)
