"""Hard case: the crack's line is a grid line, and its tip a node, in a coupled run; beside it the grid 0.3 cells off.

A crack in a harmonic lattice under the displacements of a K field at the edges, at rest. A node on the crack's line
belongs to the upper face by rule. What is seen must be that of a lattice as large as the body all the same, alike on
both faces, and not depend on where the lines of the grid lie.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from coordinator.results import Results
from coordinator.verification_cases.k_field import SPACING, STIFFNESS, k_displacement
from coordinator.verification_cases.runs import run_text, shipped
from coordinator.verification_cases.whole_lattice import Lattice, lengthened
from protocol.arrays import FloatArray

ANGSTROM = 1e-10
HALF_BODY, CELL = 200.0, 8.0  # angstrom; lines at multiples of the cell
K_1 = 0.01e6  # Pa m^0.5, of the scene
POISSON = 1.0 / 3.0
YOUNG = 2.0 * STIFFNESS / (np.sqrt(3.0) * np.sqrt(2.0 / 3.0) * SPACING)  # of a sheet of springs
ROW = 0.5 * np.sqrt(3.0) * SPACING
STEPS, MEANS_OVER = 150, 50


@dataclass(frozen=True)
class Seen:
    """What a run came to; the whole lattice's values are of the same bonds and atoms."""

    tip: FloatArray  # stretches of the four tip bonds over those of the whole lattice
    opening: FloatArray  # of the slit between its faces, over that of the whole lattice
    askew: FloatArray  # mean of the two faces' displacements over the opening; 0 by symmetry
    faces: tuple[float, float]  # displacement of the points beside the crack over the K field's, above and below
    settled: float  # kinetic energy at the end over its largest
    books: tuple[float, float]  # residuals of continuum and atoms over the energy passed


def see(folder: Path, shift: float) -> Seen:
    """Run with the grid shifted by a part of a cell along x and y."""
    low, high = -HALF_BODY + shift * CELL, HALF_BODY + shift * CELL
    overrides = [
        f'continuum.lower=["{low} angstrom", "{low} angstrom"]',
        f'continuum.upper=["{high} angstrom", "{high} angstrom"]',
        "atomistic.width=128 angstrom", "atomistic.height=128 angstrom", "continuum.preload.tolerance=1e-6",
        f"atomistic.fields.interval={MEANS_OVER}",
        *(f"run.{name}={STEPS}" for name in ("steps", "output_every", "checkpoint_every")),
    ]  # fmt: skip
    with run_text(shipped("k_field_lattice"), folder, overrides) as results:
        kinetic = results.series["continuum_kinetic"] + results.series["atomistic_kinetic"]
        tip, opening, askew = atoms_against_whole_lattice(results)
        faces = points_against_field(results)
    measures = json.loads((folder / "run" / "summary.json").read_text())["measures"]
    books = measures["books_continuum_relative"], measures["books_atoms_relative"]
    return Seen(tip, opening, askew, faces, float(kinetic[-1] / kinetic.max()), books)


def atoms_against_whole_lattice(results: Results) -> tuple[FloatArray, FloatArray, FloatArray]:
    assert results.atoms is not None
    sample = results.atoms.reference[:, :2]
    place = lengthened(sample, SPACING, HALF_BODY * ANGSTROM, 0.0, 0.0, 3)
    lattice = Lattice.of(place, SPACING)
    at_border = (np.abs(place) > HALF_BODY * ANGSTROM - 2.0 * SPACING).any(axis=1)
    whole = lattice.at_rest(k_displacement(place, K_1, YOUNG, POISSON), at_border)
    moved = np.zeros_like(place)
    moved[: len(sample)] = results.atoms.field("displacement")[1][-1][:, :2]
    stretch, wanted = lattice.stretches(moved), lattice.stretches(whole)
    near = (lattice.bonds < len(sample)).all(axis=1) & (np.abs(lattice.middles) < 30.0 * ANGSTROM).all(axis=1)
    tip = np.argsort(-wanted * near, kind="stable")[:4]
    behind = (sample[:, 0] < -10.0 * ANGSTROM) & (sample[:, 0] > -40.0 * ANGSTROM)
    upper, lower = (np.flatnonzero(behind & (np.abs(sample[:, 1] - y) < 0.1 * ROW)) for y in (2 * ROW, -2 * ROW))
    upper, lower = upper[np.argsort(sample[upper, 0])], lower[np.argsort(sample[lower, 0])]
    assert len(upper) == len(lower) > 5
    opening = moved[upper, 1] - moved[lower, 1]
    askew = 0.5 * (moved[upper, 1] + moved[lower, 1]) / opening
    return stretch[tip] / wanted[tip], opening / (whole[upper, 1] - whole[lower, 1]), askew


def points_against_field(results: Results) -> tuple[float, float]:
    assert results.points is not None
    frame = results.points.frame(len(results.points) - 1)
    place = (frame.position - frame.displacement)[:, :2]
    field = k_displacement(place, K_1, YOUNG, POISSON)[:, 1]
    found = []
    for sign in (1.0, -1.0):
        height = sign * place[:, 1] / ANGSTROM
        beside = (height > 0.0) & (height < 12.0) & (np.abs(place[:, 0] / ANGSTROM + 120.0) < 30.0)
        found.append(float(frame.displacement[beside, 1] @ field[beside] / (field[beside] @ field[beside])))
    return found[0], found[1]


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Seen]]:
    folder = tmp_path_factory.mktemp("grid_line")
    yield {"on the line": see(folder / "on", 0.0), "beside it": see(folder / "off", 0.3)}


@pytest.mark.parametrize("name", ["on the line", "beside it"])
def test_the_atoms_at_the_tip_are_those_of_the_whole_lattice(runs: dict[str, Seen], name: str) -> None:
    np.testing.assert_allclose(runs[name].tip, 1.0, atol=0.005)
    np.testing.assert_allclose(runs[name].opening, 1.0, atol=0.005)


@pytest.mark.parametrize("name", ["on the line", "beside it"])
def test_the_continuum_opens_as_the_k_field(runs: dict[str, Seen], name: str) -> None:
    np.testing.assert_allclose(runs[name].faces, 1.0, atol=0.006)


def test_the_two_faces_open_alike_though_the_nodes_between_belong_to_the_upper(runs: dict[str, Seen]) -> None:
    seen = runs["on the line"]
    assert np.abs(seen.askew).max() < 1e-3
    assert seen.faces[0] == pytest.approx(seen.faces[1], rel=1e-3)


def test_a_grid_three_tenths_of_a_cell_off_gives_the_same_answer(runs: dict[str, Seen]) -> None:
    on, off = runs["on the line"], runs["beside it"]
    np.testing.assert_allclose(on.tip, off.tip, atol=0.002)
    np.testing.assert_allclose(on.opening, off.opening, atol=0.002)
    np.testing.assert_allclose(on.faces, off.faces, atol=0.002)


@pytest.mark.parametrize("name", ["on the line", "beside it"])
def test_it_comes_to_rest_with_its_books_closed(runs: dict[str, Seen], name: str) -> None:
    assert runs[name].settled < 0.2
    np.testing.assert_allclose(runs[name].books, 0.0, atol=0.01)
