"""uGIMP shape functions against tables worked out by hand and their own consistency conditions."""

import numpy as np
import pytest

from mpm_service import Grid, gimp_shape_functions

GRID = Grid((-1.0, 2.0), 0.5, (12, 10))


def random_positions(count: int = 500) -> np.ndarray:
    rng = np.random.default_rng(3)
    return GRID.lower + GRID.cell_size * (1.0 + rng.random((count, 2)) * (np.array(GRID.cells) - 2.0))


@pytest.mark.parametrize("points_per_cell", [1, 2, 3])
def test_partition_of_unity_and_linear_completeness(points_per_cell: int) -> None:
    place = random_positions()
    node, weight, gradient = gimp_shape_functions(GRID, place, GRID.cell_size / points_per_cell)
    at = GRID.node_positions()[node]
    assert weight.min() >= -1e-16
    assert np.abs(weight.sum(axis=1) - 1.0).max() < 1e-14
    assert np.abs(gradient.sum(axis=1)).max() < 1e-13
    assert np.abs(np.einsum("pn,pni->pi", weight, at) - place).max() < 1e-14
    moments = np.einsum("pni,pnj->pij", at, gradient)
    assert np.abs(moments - np.eye(2)).max() < 1e-12


# Distance of the point right of the nearest node [cells], half domain l = 1/4 (two points a cell): weights
# and slopes of nodes c-1, c, c+1. At d = 0: S(c) = 1 - l/2, sides l/4. At d = 1/8: sides (l -+ d)^2 / 4l.
# At d >= l the functions are the linear hat.
HAND_TABLE = [
    (0.0, (0.0625, 0.875, 0.0625), (-0.5, 0.0, 0.5)),
    (0.125, (0.015625, 0.84375, 0.140625), (-0.25, -0.5, 0.75)),
    (0.25, (0.0, 0.75, 0.25), (0.0, -1.0, 1.0)),
    (0.4375, (0.0, 0.5625, 0.4375), (0.0, -1.0, 1.0)),
    (-0.125, (0.140625, 0.84375, 0.015625), (-0.75, 0.5, 0.25)),
    (-0.375, (0.375, 0.625, 0.0), (-1.0, 1.0, 0.0)),
]


@pytest.mark.parametrize(("offset", "weights", "slopes"), HAND_TABLE)
def test_values_of_a_hand_computed_table(offset: float, weights: tuple, slopes: tuple) -> None:
    place = GRID.lower + GRID.cell_size * np.array([[5.0 + offset, 4.0]])
    node, weight, gradient = gimp_shape_functions(GRID, place, GRID.cell_size / 2)
    side = np.array([0.0625, 0.875, 0.0625])
    assert node[0, 4] == 4 * 13 + 5
    np.testing.assert_allclose(weight[0].reshape(3, 3), np.outer(side, weights), atol=1e-15)
    np.testing.assert_allclose(
        gradient[0, :, 0].reshape(3, 3), np.outer(side, np.array(slopes)) / GRID.cell_size, atol=1e-14
    )


def test_values_are_the_hat_averaged_over_the_domain() -> None:
    place = random_positions(20)
    size = GRID.cell_size / 2
    node, weight, gradient = gimp_shape_functions(GRID, place, size)
    sample = (np.arange(4000) + 0.5) / 4000 - 0.5
    for p in range(place.shape[0]):
        for k in range(9):
            x = GRID.node_positions()[node[p, k]]
            hats = [np.clip(1.0 - np.abs(place[p, i] + size * sample - x[i]) / GRID.cell_size, 0, None) for i in (0, 1)]
            assert abs(weight[p, k] - hats[0].mean() * hats[1].mean()) < 1e-6
            ends = [max(0.0, 1.0 - abs(place[p, 0] + s * size / 2 - x[0]) / GRID.cell_size) for s in (1.0, -1.0)]
            assert abs(gradient[p, k, 0] - (ends[0] - ends[1]) / size * hats[1].mean()) < 1e-5


def test_point_at_the_border_is_refused() -> None:
    with pytest.raises(ValueError, match="border"):
        gimp_shape_functions(GRID, np.array([[-0.9, 3.0]]), 0.25)
