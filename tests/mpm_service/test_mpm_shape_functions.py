"""Shape functions against values worked out by hand, their own consistency, and the compiled sweeps."""

from typing import Any, get_args

import numpy as np
import pytest

from mpm_service import Grid
from mpm_service.material_points import COLUMNS, DX, DY, HXX, HXY, HYX, HYY, MASS, SXX, SYY, VOLUME, VX, VY, X, Y
from mpm_service.scheme import Interpolation
from mpm_service.shape_functions import shape_functions
from mpm_service.shapes import make_shape
from mpm_service.sweeps import Lattice, deform_points, scatter_state, update_points

PLANE = Grid((-1.0, 2.0), 0.5, (12, 10))
SPACE = Grid((-1.0, 2.0, 0.5), 0.5, (9, 10, 8))

# Kind, half domain [cells], place beyond node 5 [cells], first node, weights, slopes [1/cell].
# Averaged kinds: the area under the hat over the domain by triangles and trapezoids; slope: hat at the domain's upper
# end less that at its lower end, over its length.
HAND_TABLE = [
    ("linear", 0.0, 0.25, 5, (3 / 4, 1 / 4), (-1.0, 1.0)),
    ("linear", 0.0, -0.125, 4, (1 / 8, 7 / 8), (-1.0, 1.0)),
    ("ugimp", 0.0, 0.25, 5, (3 / 4, 1 / 4), (-1.0, 1.0)),
    ("ugimp", 1 / 4, 0.0, 4, (1 / 16, 7 / 8, 1 / 16), (-1 / 2, 0.0, 1 / 2)),
    ("ugimp", 1 / 4, 1 / 8, 4, (1 / 64, 27 / 32, 9 / 64), (-1 / 4, -1 / 2, 3 / 4)),
    ("ugimp", 1 / 4, -1 / 8, 4, (9 / 64, 27 / 32, 1 / 64), (-3 / 4, 1 / 2, 1 / 4)),
    ("ugimp", 1 / 4, 1 / 4, 5, (3 / 4, 1 / 4), (-1.0, 1.0)),
    ("ugimp", 1 / 4, 7 / 16, 5, (9 / 16, 7 / 16), (-1.0, 1.0)),
    ("ugimp", 1 / 4, -3 / 8, 4, (3 / 8, 5 / 8), (-1.0, 1.0)),
    ("ugimp", 1 / 2, 0.0, 4, (1 / 8, 3 / 4, 1 / 8), (-1 / 2, 0.0, 1 / 2)),
    ("ugimp", 1 / 2, 1 / 4, 4, (1 / 32, 11 / 16, 9 / 32), (-1 / 4, -1 / 2, 3 / 4)),
    ("ugimp", 1 / 2, 1 / 2, 5, (1 / 2, 1 / 2), (-1.0, 1.0)),
    ("ugimp", 1 / 6, 0.0, 4, (1 / 24, 11 / 12, 1 / 24), (-1 / 2, 0.0, 1 / 2)),
    ("cpgimp", 3 / 4, 1 / 2, 4, (1 / 48, 23 / 48, 23 / 48, 1 / 48), (-1 / 6, -1 / 2, 1 / 2, 1 / 6)),
    ("cpgimp", 9 / 10, 0.0, 4, (9 / 40, 11 / 20, 9 / 40), (-1 / 2, 0.0, 1 / 2)),
    ("cpgimp", 1.0, 0.0, 4, (1 / 4, 1 / 2, 1 / 4), (-1 / 2, 0.0, 1 / 2)),
    (
        "cpgimp",
        3 / 2,
        0.0,
        3,
        (1 / 24, 7 / 24, 1 / 3, 7 / 24, 1 / 24),
        (-1 / 6, -1 / 6, 0.0, 1 / 6, 1 / 6),
    ),
    ("bspline", 0.0, 0.0, 4, (1 / 8, 3 / 4, 1 / 8), (-1 / 2, 0.0, 1 / 2)),
    ("bspline", 0.0, 1 / 4, 4, (1 / 32, 11 / 16, 9 / 32), (-1 / 4, -1 / 2, 3 / 4)),
    ("bspline", 0.0, -3 / 8, 4, (49 / 128, 39 / 64, 1 / 128), (-7 / 8, 3 / 4, 1 / 8)),
]


def dense(grid: Grid, node: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values by place and grid node, (n, nodes)."""
    out = np.zeros((node.shape[0], grid.node_count))
    np.add.at(out, (np.arange(node.shape[0])[:, None], node), values)
    return out


def random_places(grid: Grid, margin: float, count: int = 300) -> np.ndarray:
    """Random places, and some on nodes, mid cells and a hair beside them."""
    rng = np.random.default_rng(3)
    place = margin + rng.random((count, grid.dimension)) * (np.array(grid.cells) - 2.0 * margin)
    place[: count // 3] = np.round(2.0 * place[: count // 3]) / 2.0
    place[: count // 6] += rng.choice([-1e-13, 1e-13], (count // 6, grid.dimension))
    return grid.lower + grid.cell_size * np.clip(place, margin, np.array(grid.cells) - margin)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize(("kind", "half", "beyond", "first", "weights", "slopes"), HAND_TABLE)
def test_hand_computed_table(
    kind: Interpolation, half: float, beyond: float, first: int, weights: tuple, slopes: tuple, axis: int
) -> None:
    """Along one axis the tabulated function; in the others the place lies on a node with domains of no extent."""
    for grid in (PLANE, SPACE):
        if axis >= grid.dimension:
            continue
        at = np.full(grid.dimension, 5.0)
        at[axis] += beyond
        sides = np.zeros(grid.dimension)
        sides[axis] = half
        node, weight, gradient = shape_functions(grid, [grid.lower + grid.cell_size * at], sides * grid.cell_size, kind)
        expected, slope = np.zeros(grid.cells[axis] + 1), np.zeros(grid.cells[axis] + 1)
        expected[first : first + len(weights)] = weights
        slope[first : first + len(slopes)] = np.array(slopes) / grid.cell_size
        others = tuple(b for b in range(grid.dimension) if b != grid.dimension - 1 - axis)
        shape = tuple(n + 1 for n in reversed(grid.cells))
        found = dense(grid, node, weight).reshape(shape).sum(axis=others)
        rate = dense(grid, node, gradient[:, :, axis]).reshape(shape).sum(axis=others)
        np.testing.assert_allclose(found, expected, atol=2e-15)
        np.testing.assert_allclose(rate, slope, atol=2e-14)


@pytest.mark.parametrize("grid", [PLANE, SPACE])
@pytest.mark.parametrize(
    ("kind", "half"),
    [
        ("linear", 0.0),
        ("ugimp", 0.5),
        ("ugimp", 0.25),
        ("ugimp", 1 / 6),
        ("cpgimp", 0.9),
        ("cpgimp", 1.7),
        ("bspline", 0.0),
    ],
)
def test_partition_of_unity_and_linear_completeness(grid: Grid, kind: Interpolation, half: float) -> None:
    place = random_places(grid, max(half, 0.5) + 0.01)
    node, weight, gradient = shape_functions(grid, place, half * grid.cell_size, kind)
    at = grid.node_positions()[node]
    assert weight.min() >= 0.0
    assert np.abs(weight.sum(axis=1) - 1.0).max() < 1e-14
    assert np.abs(gradient.sum(axis=1)).max() < 1e-13
    assert np.abs(np.einsum("pn,pni->pi", weight, at - place[:, None])).max() < 1e-14
    moments = np.einsum("pni,pnj->pij", at, gradient)
    assert np.abs(moments - np.eye(grid.dimension)).max() < 1e-12


def test_averaged_values_are_samples_of_the_hat_over_the_domain() -> None:
    place = random_places(PLANE, 1.3, 20)
    half = PLANE.cell_size * (0.1 + np.random.default_rng(4).random(place.shape))
    node, weight, gradient = shape_functions(PLANE, place, half, "cpgimp")
    sample = (np.arange(4000) + 0.5) / 2000 - 1.0
    for p in range(place.shape[0]):
        for k in range(node.shape[1]):
            if weight[p, k] == 0.0:
                continue
            x = PLANE.node_positions()[node[p, k]]
            hats = [
                np.maximum(1.0 - np.abs(place[p, i] + half[p, i] * sample - x[i]) / PLANE.cell_size, 0.0)
                for i in (0, 1)
            ]
            assert abs(weight[p, k] - hats[0].mean() * hats[1].mean()) < 1e-6
            ends = [max(0.0, 1.0 - abs(place[p, 0] + s * half[p, 0] - x[0]) / PLANE.cell_size) for s in (1.0, -1.0)]
            assert abs(gradient[p, k, 0] - (ends[0] - ends[1]) / (2.0 * half[p, 0]) * hats[1].mean()) < 1e-5


def test_slivers_keep_all_their_digits() -> None:
    """A domain that reaches over a cell line by e has the weight e^2 / 4 l there and the slope e / 2 l for any e."""
    quarter, line = 0.25, 5.0
    for reach in (2.0**-10, 2.0**-25, 2.0**-40):
        place = [PLANE.lower + 0.5 * np.array([line + 1.0 - quarter + reach, 4.5])]
        node, weight, gradient = shape_functions(PLANE, place, 0.125)
        row = np.flatnonzero(node[0] % 13 == 7)
        assert row.size == 2
        round_off = 16.0 * 2.0**-52 / reach  # of the place itself
        assert weight[0, row].sum() == pytest.approx(reach**2 / (4.0 * quarter), rel=round_off, abs=0.0)
        assert gradient[0, row, 0].sum() == pytest.approx(reach / (2.0 * quarter) / 0.5, rel=round_off, abs=0.0)


def test_bspline_is_the_hat_averaged_over_a_whole_cell() -> None:
    for grid in (PLANE, SPACE):
        place = random_places(grid, 0.6)
        tables = [shape_functions(grid, place, 0.5 * grid.cell_size, kind) for kind in ("bspline", "ugimp")]
        for which in range(2):
            ours, theirs = (dense(grid, t[0], t[1] if which == 0 else t[2][:, :, grid.dimension - 1]) for t in tables)
            np.testing.assert_allclose(ours, theirs, atol=3e-14)


@pytest.mark.parametrize("kind", get_args(Interpolation))
def test_shifted_grid_has_the_same_functions(kind: Interpolation) -> None:
    place = random_places(PLANE, 1.2)
    shift = np.array([0.37 * 0.5, -7.13 * 0.5])
    moved = Grid(tuple(PLANE.lower + shift), 0.5, PLANE.cells)
    here = shape_functions(PLANE, place[150:], 0.2, kind)
    there = shape_functions(moved, place[150:] + shift, 0.2, kind)
    np.testing.assert_allclose(dense(PLANE, *there[:2]), dense(PLANE, *here[:2]), atol=2e-14)
    np.testing.assert_allclose(
        dense(PLANE, there[0], there[2][:, :, 1]), dense(PLANE, here[0], here[2][:, :, 1]), atol=2e-12
    )


# The compiled sweeps, one point at a time.


def sweep_functions(kind: Interpolation, half: float, at: np.ndarray, stretch: np.ndarray) -> tuple[Any, Any, Any, Any]:
    """Weights and gradients by node of a point, from what it gives to the nodes and from what it takes from them."""
    shape = make_shape(kind, half)
    lattice = Lattice(PLANE.origin[0], PLANE.origin[1], 1.0 / PLANE.cell_size, PLANE.cells[0] + 1, 0, shape)
    row = np.zeros((1, COLUMNS))
    row[0, [X, Y]] = at
    row[0, [HXX, HXY, HYX, HYY]] = (stretch - np.eye(2)).ravel()
    row[0, [MASS, VOLUME]] = 1.0
    given = []
    for stress in (SXX, SYY):
        pushed = row.copy()
        pushed[0, stress] = 1.0
        momentum = np.zeros((PLANE.node_count, 5))
        scatter_state(pushed, np.array([[0, 1]]), lattice, momentum)
        given.append(momentum)
    give_weight = given[0][:, 0]
    give_gradient = -np.stack([given[0][:, 3], given[1][:, 4]], axis=1)
    take_weight, take_gradient = np.zeros(PLANE.node_count), np.zeros((PLANE.node_count, 2))
    for n in np.flatnonzero(give_weight):
        taking = row.copy()
        taking[0, [HXX, HXY, HYX, HYY]] = (stretch - np.eye(2)).ravel()
        motion = np.zeros((PLANE.node_count, 4))
        motion[n] = 1.0
        update_points(taking, np.array([[0, 1]]), lattice, motion, 0.0, 1.0)
        take_weight[n] = taking[0, DX]
        assert np.all(taking[0, [DX, DY, VX, VY]] == taking[0, DX])
        deform_points(taking, np.array([[0, 1]]), lattice, np.ascontiguousarray(motion[:, :2]), 1.0, 0.0)
        rate = (taking[0, [HXX, HXY, HYX, HYY]].reshape(2, 2) - (stretch - np.eye(2))) @ np.linalg.inv(stretch)
        take_gradient[n] = rate[0]
    return give_weight, give_gradient, take_weight, take_gradient


@pytest.mark.parametrize(
    ("kind", "half"),
    [("linear", 0.25), ("ugimp", 0.5), ("ugimp", 0.25), ("ugimp", 1 / 6), ("cpgimp", 0.25), ("bspline", 0.5)],
)
def test_compiled_sweeps_use_the_tabulated_functions(kind: Interpolation, half: float) -> None:
    stretch = np.array([[1.2, 0.5], [-0.3, 0.8]])
    sides = np.full(2, half * PLANE.cell_size)
    if kind == "cpgimp":
        sides *= np.linalg.norm(stretch, axis=1)
    for place in random_places(PLANE, 1.2, 30):
        node, weight, gradient = shape_functions(PLANE, [place], sides, kind)
        expected = dense(PLANE, node, weight)[0]
        slopes = np.stack([dense(PLANE, node, gradient[:, :, a])[0] for a in (0, 1)], axis=1)
        give_weight, give_gradient, take_weight, take_gradient = sweep_functions(kind, half, place, stretch)
        np.testing.assert_allclose(give_weight, expected, atol=1e-14)
        np.testing.assert_allclose(take_weight, expected, atol=1e-14)
        near = np.abs(place / 0.5 - np.round(place / 0.5)) < 1e-12
        if kind == "linear" and near.any():
            continue  # the slope jumps at a node, either side's is right
        np.testing.assert_allclose(give_gradient, slopes, atol=1e-11)
        np.testing.assert_allclose(take_gradient, np.where(expected[:, None] > 0, slopes, 0.0), atol=1e-11)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([[-1.2, 3.0]], 0.25), r"position\[0\].*beyond the grid"),
        (([[0.0, 3.0], [4.9, 3.0]], 0.25), r"position\[1\] = \(4.9, 3.0\)"),
        (([[0.0, np.nan]], 0.25), "position: finite"),
        (([[0.0, 3.0, 1.0]], 0.25), r"position.*\(n, 2\)"),
        (([[0.0, 3.0]], 1.1), "half: from 0 to 2 cells"),
        (([[0.0, 3.0]], -0.1), "half: from 0"),
        (([[0.0, 3.0]], [0.1, 0.1, 0.1]), r"half: a number or shape \(2,\)"),
        (([[0.0, 3.0]], 0.1, "cubic"), "interpolation = 'cubic': allowed are linear, ugimp"),
    ],
)
def test_bad_input_is_named(arguments: tuple, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        shape_functions(PLANE, *arguments)


def test_no_places_give_empty_tables() -> None:
    node, weight, gradient = shape_functions(SPACE, np.zeros((0, 3)), 0.1)
    assert node.shape == weight.shape == (0, 0)
    assert gradient.shape == (0, 0, 3)
