"""Nested 2:1 grid: its functions against consistency, hand tables and samples; filling, splitting, waves."""

import numpy as np
import pytest
from scipy.sparse import csr_matrix

from mpm_service.grid import Grid
from mpm_service.hierarchy import HierarchicalGrid
from mpm_service.hierarchy_filling import fill_hierarchy
from mpm_service.hierarchy_stencils import (
    CONVECTED_DOMAIN,
    FIXED_DOMAIN,
    NO_DOMAIN,
    OUTSIDE,
    STENCIL_NODES,
    TOO_WIDE,
    fill_stencils,
    hierarchy_stencils,
)
from mpm_service.material_points import COLUMNS, HALF, HXX, HXY, HYX, HYY, MASS, VOLUME, VX, VY, X, Y
from mpm_service.overlap import Overlap, cut_overlaps
from mpm_service.shape_functions import shape_functions
from mpm_service.splitting import find_oversized, split_points
from mpm_service.stencils import Stencils

ANGSTROM = 1e-10
# Level 0 has cells of 0.5 and spans -1..9 x 2..10; level 1 0.25 in 1..7 x 4..8; level 2 0.125 in 2..5 x 5..7;
# level 3 0.0625 in 3..4 x 5.5..6.5.
GRID = HierarchicalGrid(
    Grid((-1.0, 2.0), 0.5, (20, 16)),
    [((1.0, 4.0), (7.0, 8.0)), ((2.0, 5.0), (5.0, 7.0)), ((3.0, 5.5), (4.0, 6.5))],
)


def places() -> np.ndarray:
    """Random places, and places on and beside borders, corners, and kinks of every level."""
    rng = np.random.default_rng(5)
    anywhere = GRID.grid.lower + 2.1 + rng.random((1500, 2)) * (GRID.grid.upper - GRID.grid.lower - 4.2)
    special = []
    for level, fine in enumerate(GRID.grids[1:]):
        for x in (fine.lower[0], 0.5 * (fine.lower[0] + fine.upper[0]) + fine.cell_size, fine.upper[0]):
            for y in (fine.lower[1], 0.5 * (fine.lower[1] + fine.upper[1]) + fine.cell_size, fine.upper[1]):
                for shift in (-1.0, -0.3, -1e-9, 0.0, 1e-9, 0.3, 1.0):
                    for side in (-1.0, -0.3, 0.0, 0.3, 1.0):
                        special.append((x + shift * GRID.grids[level].cell_size, y + side * fine.cell_size))
    return np.concatenate([anywhere, np.array(special)])


def halves(position: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Half sides from none to two cells of the place's own level, but none wider than four of the finest."""
    size = np.array(GRID.cell_sizes)[GRID.level_of(position)]
    return size[:, None] * rng.random((position.shape[0], 2)) ** 2 * 0.99


@pytest.mark.parametrize("wide", [0.0, 0.25, 1.0])
def test_partition_of_unity_and_linear_completeness(wide: float) -> None:
    place = places()
    half = wide * halves(place, np.random.default_rng(6))
    node, weight, gradient = (s := hierarchy_stencils(GRID, place, half)).node, s.weight, s.gradient
    at = GRID.node_positions()[node]
    finest = GRID.cell_sizes[-1]
    level = np.searchsorted(GRID.first_rows, node, side="right")
    used = np.arange(node.shape[1]) < s.entries[:, None]
    spans = np.where(used, level, 0).max(axis=1) - np.where(used, level, 9).min(axis=1)
    assert np.count_nonzero(spans) > 100  # stencils of two levels are among them
    assert weight.min() >= 0.0
    assert np.abs(weight.sum(axis=1) - 1.0).max() < 1e-13
    assert np.abs(gradient.sum(axis=1)).max() < 1e-13 / finest
    assert np.abs(np.einsum("pn,pni->pi", weight, at) - place).max() < 1e-13
    moments = np.einsum("pni,pnj->pij", at - place[:, None], gradient)
    assert np.abs(moments - np.eye(2)).max() < 1e-12


def test_every_entry_is_a_row_of_its_own_that_holds_values() -> None:
    place = places()
    s = hierarchy_stencils(GRID, place, halves(place, np.random.default_rng(7)))
    owner = GRID.owner()
    for row, count in zip(s.node, s.entries, strict=True):
        assert np.unique(row[:count]).size == count
        assert np.array_equal(owner[row[:count]], row[:count])


# A level-0 cell with level 1 below it: corners 1 (0, 0), 2 (1, 0), 3 (1, 1), 4 (0, 1), node 5 at (1/2, 0).
# From Eqs 32-37 with xi = 2u - 1, eta = 2v - 1: N5 = (1 - |2u - 1|)(1 - v), N1 = (1-u)(1-v) - N5/2,
# N2 = u(1-v) - N5/2, N3 = uv, N4 = (1-u)v. Order here: N1, N2, N3, N4, N5.
HAND_TABLE = [
    ((0.0, 0.0), (1.0, 0.0, 0.0, 0.0, 0.0)),
    ((0.5, 0.0), (0.0, 0.0, 0.0, 0.0, 1.0)),
    ((0.25, 0.0), (0.5, 0.0, 0.0, 0.0, 0.5)),
    ((0.75, 0.0), (0.0, 0.5, 0.0, 0.0, 0.5)),
    ((0.5, 0.5), (0.0, 0.0, 0.25, 0.25, 0.5)),
    ((0.25, 0.5), (0.25, 0.0, 0.125, 0.375, 0.25)),
    ((0.75, 0.25), (0.0, 0.375, 0.1875, 0.0625, 0.375)),
    ((0.375, 0.75), (0.0625, 0.0, 0.28125, 0.46875, 0.1875)),
]
# Directions of u and v for level 1 below, above, left and right of the cell whose node 1 is given.
SIDES = {
    "below": ((2.5, 8.0), (1.0, 0.0), (0.0, 1.0)),
    "above": ((2.5, 4.0), (1.0, 0.0), (0.0, -1.0)),
    "left": ((7.0, 4.5), (0.0, 1.0), (1.0, 0.0)),
    "right": ((1.0, 4.5), (0.0, 1.0), (-1.0, 0.0)),
}


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize(("place", "values"), HAND_TABLE)
def test_five_node_functions_of_a_hand_computed_table(side: str, place: tuple, values: tuple) -> None:
    start, along, across = (np.array(v) for v in SIDES[side])
    cell = GRID.grid.cell_size

    def at(u: float, v: float) -> np.ndarray:
        return start + cell * (u * along + v * across)

    # On the border itself either side gives the same values; the coarse side is asked a hair's breadth away.
    s = hierarchy_stencils(GRID, at(place[0], place[1] + 1e-13))
    found = np.zeros(5)
    for row, weight in zip(s.node[0, : s.entries[0]], s.weight[0], strict=False):
        where = GRID.node_positions()[row]
        match = [k for k, n in enumerate([(0, 0), (1, 0), (1, 1), (0, 1), (0.5, 0)]) if np.allclose(at(*n), where)]
        assert len(match) == 1
        found[match[0]] += weight
    np.testing.assert_allclose(found, values, atol=1e-12)


def test_gradients_of_the_five_node_functions_by_hand() -> None:
    # At u = 1/4, v = 1/2 above level 1, where u < 1/2: N1 = (1-u)(1-v) - u(1-v) = (1-2u)(1-v), N2 = 0,
    # N3 = uv, N4 = (1-u)v, N5 = 2u(1-v). Derivatives over u and v, then over the cell side 1/2.
    s = hierarchy_stencils(GRID, np.array([2.5 + 0.125, 8.0 + 0.25]))
    expected = {(2.5, 8.0): (-1.0, -0.5), (3.0, 8.5): (0.5, 0.25), (2.5, 8.5): (-0.5, 0.75)}
    expected[(2.75, 8.0)] = (1.0, -0.5)
    for row, gradient in zip(s.node[0, : s.entries[0]], s.gradient[0], strict=False):
        slope = expected.pop(tuple(GRID.node_positions()[row].tolist()))
        np.testing.assert_allclose(gradient, np.array(slope) / 0.5, atol=1e-14)
    assert not expected


def test_functions_are_continuous_across_every_border() -> None:
    rng = np.random.default_rng(8)
    for fine in GRID.grids[1:]:
        for axis in (0, 1):
            for end in (fine.lower[axis], fine.upper[axis]):
                place = fine.lower + rng.random((200, 2)) * (fine.upper - fine.lower)
                sides = []
                for shift in (-1e-12, 1e-12):
                    place[:, axis] = end + shift
                    s = hierarchy_stencils(GRID, place)
                    dense = np.zeros((200, GRID.node_count))
                    np.add.at(dense, (np.arange(200)[:, None], s.node), s.weight)
                    sides.append(dense)
                assert np.abs(sides[1] - sides[0]).max() < 1e-10


def dense(stencils: Stencils, values: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """Sum over stencils of shares times values, by grid row."""
    total = np.zeros(GRID.node_count)
    np.add.at(total, stencils.node, shares[:, None] * values)
    return total


def test_averages_against_sampled_linear_functions() -> None:
    # Domains across level borders, corners and kinks. Weights: the mean over a raster of places. Gradients: by
    # Gauss' theorem, the linear functions summed over the domain's edges.
    centres = np.array([(1.0, 4.0), (7.05, 6.13), (2.0, 6.9), (3.1, 5.45), (4.0, 6.5), (5.0, 5.06), (2.2, 8.0)])
    half = np.array([(0.2, 0.3), (0.2, 0.1), (0.2, 0.2), (0.1, 0.09), (0.05, 0.11), (0.12, 0.06), (0.25, 0.25)])
    mean = hierarchy_stencils(GRID, centres, half)
    raster = (np.arange(60) + 0.5) / 30.0 - 1.0
    edge = (np.arange(2000) + 0.5) / 1000.0 - 1.0
    for p, centre in enumerate(centres):
        own = slice(p, p + 1)
        one = Stencils(0, mean.node[own], mean.weight[own], mean.gradient[own], mean.entries[own])
        cloud = centre + half[p] * np.stack(np.meshgrid(raster, raster), axis=-1).reshape(-1, 2)
        s = hierarchy_stencils(GRID, cloud)
        sampled = dense(s, s.weight, np.full(3600, 1.0 / 3600))
        assert np.abs(dense(one, one.weight, np.ones(1)) - sampled).max() < 2e-4
        for axis in (0, 1):
            flux = np.zeros(GRID.node_count)
            for sign in (-1.0, 1.0):
                place = centre + half[p] * np.stack([edge, edge], axis=1)
                place[:, axis] = centre[axis] + sign * half[p, axis]
                s = hierarchy_stencils(GRID, place)
                flux += dense(s, s.weight, np.full(2000, sign / 2000 / (2.0 * half[p, axis])))
            assert np.abs(dense(one, one.gradient[:, :, axis], np.ones(1)) - flux).max() < 1e-5


def test_one_level_is_uniform_gimp() -> None:
    grid = Grid((-1.0, 2.0), 0.5, (12, 10))
    rng = np.random.default_rng(3)
    place = grid.lower + 0.5 * (1.0 + rng.random((400, 2)) * (np.array(grid.cells) - 2.0))
    for size in (0.5, 0.25, 0.1):
        node, weight, gradient = shape_functions(grid, place, 0.5 * size)
        s = hierarchy_stencils(HierarchicalGrid(grid), place, 0.5 * size)
        for ours, theirs in (
            (s.weight, weight),
            (s.gradient[:, :, 0], gradient[:, :, 0]),
            (s.gradient[:, :, 1], gradient[:, :, 1]),
        ):
            dense = np.zeros((2, 400, grid.node_count))
            np.add.at(dense[0], (np.arange(400)[:, None], s.node), ours)
            np.add.at(dense[1], (np.arange(400)[:, None], node), theirs)
            assert np.abs(dense[0] - dense[1]).max() < 1e-13


def test_points_that_are_not_special_have_the_block_of_their_level_wherever_they_travel() -> None:
    mask, owner = GRID.special_mask(), GRID.owner()
    rng = np.random.default_rng(9)
    place = GRID.grid.lower + 0.6 + rng.random((6000, 2)) * (GRID.grid.upper - GRID.grid.lower - 1.2)
    level = GRID.level_of(place)
    size = np.array(GRID.cell_sizes)[level]
    nearest = np.empty(place.shape[0], dtype=np.int64)
    for k, grid in enumerate(GRID.grids):
        own = level == k
        i, j = np.rint((place[own] - grid.lower) / grid.cell_size).astype(int).T
        nearest[own] = GRID.first_rows[k] + j * (grid.cells[0] + 1) + i
    regular = mask[nearest] == 0
    assert {0, 1, 2, 3} == set(level[regular].tolist())
    moved = place + 0.999 * size[:, None] * (2.0 * rng.random(place.shape) - 1.0)
    inside = np.all((moved > GRID.grid.lower + 0.3) & (moved < GRID.grid.upper - 0.3), axis=1)
    chosen = np.flatnonzero(regular & inside)
    assert np.array_equal(GRID.level_of(moved[chosen]), level[chosen])
    s = hierarchy_stencils(GRID, moved[chosen], 0.5 * size[chosen, None])
    for k, p in enumerate(chosen):
        grid, first = GRID.grids[level[p]], GRID.first_rows[level[p]]
        node, weight, _ = shape_functions(grid, moved[p : p + 1], 0.5 * size[p])
        assert np.array_equal(owner[first + node[0]], first + node[0])
        used = slice(0, s.entries[k])
        ours = dict(zip(s.node[k, used].tolist(), s.weight[k, used].tolist(), strict=True))
        for n, w in zip(first + node[0], weight[0], strict=True):
            assert abs(ours.pop(int(n), 0.0) - w) < 1e-12
        assert all(abs(w) < 1e-12 for w in ours.values())


def test_special_rows_are_those_whose_block_and_one_cell_around_it_is_not_plain() -> None:
    mask, owner = GRID.special_mask(), GRID.owner()
    for level, grid in enumerate(GRID.grids):
        nx, ny, first = grid.cells[0], grid.cells[1], GRID.first_rows[level]
        for j in range(ny + 1):
            for i in range(nx + 1):
                special = False
                for b in range(j - 2, j + 3):
                    for a in range(i - 2, i + 3):
                        row = first + b * (nx + 1) + a
                        outside = not (0 <= a <= nx and 0 <= b <= ny)
                        special |= level > 0 if outside else bool(owner[row] != row)
                assert mask[first + j * (nx + 1) + i] == special, (level, i, j)
    assert not HierarchicalGrid(GRID.grid).special_mask().any()


def test_bad_refinements_name_level_value_and_nearest_allowed() -> None:
    grid = Grid((0.0, 0.0), 1.0, (12, 12))
    with pytest.raises(ValueError, match=r"level 1, lower\[0\] = 3\.3 m.*nearest allowed value is 3\.0 m"):
        HierarchicalGrid(grid, [((3.3, 3.0), (8.0, 8.0))])
    with pytest.raises(ValueError, match=r"level 1, upper\[1\] = 11\.0 m.*nearest allowed value is 10\.0 m"):
        HierarchicalGrid(grid, [((3.0, 3.0), (8.0, 11.0))])
    with pytest.raises(ValueError, match=r"level 2, lower\[0\] = 3\.5 m.*nearest allowed value is 4\.0 m"):
        HierarchicalGrid(grid, [((3.0, 3.0), (8.0, 8.0)), ((3.5, 4.0), (6.0, 6.0))])
    with pytest.raises(ValueError, match=r"level 1, upper\[0\] = 4\.0 m.*lowest allowed value is 5\.0 m"):
        HierarchicalGrid(grid, [((3.0, 3.0), (4.0, 8.0))])
    with pytest.raises(ValueError, match=r"level 1, lower\[1\] = nan"):
        HierarchicalGrid(grid, [((3.0, float("nan")), (6.0, 8.0))])


def test_domains_off_the_grid_or_too_wide_are_told_apart() -> None:
    table = np.zeros((3, COLUMNS))
    table[:, :2] = [(3.0, 3.0), (-0.95, 3.0), (3.5, 6.0)]
    table[:, HALF] = (0.125, 0.125, 0.5)
    stencils = Stencils(
        0,
        np.zeros((3, STENCIL_NODES), np.int64),
        np.zeros((3, STENCIL_NODES)),
        np.zeros((3, STENCIL_NODES, 2)),
        np.zeros(3, np.int64),
    )
    assert fill_stencils(GRID.arrays, table, FIXED_DOMAIN, stencils) == 1
    assert stencils.entries[0] == 9 and stencils.entries[1] == OUTSIDE and stencils.entries[2] == TOO_WIDE
    assert fill_stencils(GRID.arrays, table, NO_DOMAIN, stencils) == -1
    assert stencils.entries.tolist() == [4, 4, 4]
    with pytest.raises(ValueError, match="leaves the grid"):
        hierarchy_stencils(GRID, np.array([(9.1, 4.0)]))
    with pytest.raises(ValueError, match="too many nodes"):
        hierarchy_stencils(GRID, np.array([(3.5, 6.0)]), 0.5)


def test_convected_domains_follow_the_rows_of_f() -> None:
    table = np.zeros((1, COLUMNS))
    table[0, [X, Y, HALF]] = (5.05, 7.02, 0.08)
    table[0, [HXX, HXY, HYX, HYY]] = (0.5, 0.8, -0.3, -0.2)
    stencils = Stencils(
        0,
        np.zeros((1, STENCIL_NODES), np.int64),
        np.zeros((1, STENCIL_NODES)),
        np.zeros((1, STENCIL_NODES, 2)),
        np.zeros(1, np.int64),
    )
    assert fill_stencils(GRID.arrays, table, CONVECTED_DOMAIN, stencils) == -1
    # Rows of F: (1.5, 0.8), length 1.7; (-0.3, 0.8), length sqrt(0.73).
    reference = hierarchy_stencils(GRID, table[:, :2], np.array([[0.08 * 1.7, 0.08 * np.sqrt(0.73)]]))
    count = int(stencils.entries[0])
    assert count == reference.entries[0]
    assert np.array_equal(stencils.node[0, :count], reference.node[0, :count])
    np.testing.assert_allclose(stencils.weight[0, :count], reference.weight[0, :count], atol=1e-13)


def seed_grid(levels: int) -> HierarchicalGrid:
    """The grid of Sec 5.1 around a square of 61440 angstrom: cells of 2560 angstrom halved towards the centre."""
    cell = 2560.0 * ANGSTROM
    grid = Grid((-16 * cell, -16 * cell), cell, (32, 32))
    rectangles = []
    for level in range(levels - 1):
        reach = 6.0 * cell / 2**level
        rectangles.append(((-reach, -reach), (reach, reach)))
    return HierarchicalGrid(grid, rectangles)


@pytest.mark.parametrize("levels", [9, 10])
def test_levels_from_2560_to_10_angstrom_on_the_seed_square(levels: int) -> None:
    grid = seed_grid(levels)
    assert abs(grid.cell_sizes[8] / ANGSTROM - 10.0) < 1e-9
    assert grid.node_count == 33**2 + (levels - 1) * 25**2
    side = 61440.0 * ANGSTROM
    fill = fill_hierarchy(grid, (-side / 2, -side / 2), (side / 2, side / 2))
    level = grid.level_of(fill.position)
    cell = np.array(grid.cell_sizes)[level]
    np.testing.assert_allclose(fill.half, 0.25 * cell, rtol=1e-15)
    per_level = np.bincount(level)
    # Level 0: 24^2 cells less 12^2; levels between: 24^2 less 12^2; the finest: 24^2; four points each.
    assert per_level.tolist() == [4 * (576 - 144)] * (levels - 1) + [4 * 576]
    assert abs((4.0 * fill.half**2).sum() / side**2 - 1.0) < 1e-13
    s = hierarchy_stencils(grid, fill.position, fill.half[:, None])
    at = grid.node_positions()[s.node]
    assert np.abs(s.weight.sum(axis=1) - 1.0).max() < 1e-12
    assert (np.abs(np.einsum("pn,pni->pi", s.weight, at) - fill.position).max(axis=1) / cell).max() < 1e-10
    # A uniform stress puts no force on nodes inside: the weak form's patch test.
    force = np.zeros((grid.node_count, 2))
    np.add.at(force, s.node, s.gradient * (4.0 * fill.half**2)[:, None, None])
    inner = np.all(np.abs(grid.node_positions()) < side / 2 - 1.0 * ANGSTROM, axis=1)
    assert np.abs(force[inner]).max() < 1e-9 * grid.cell_sizes[-1]
    # Lumped mass of area density one is the area.
    mass = np.zeros(grid.node_count)
    np.add.at(mass, s.node, s.weight * (4.0 * fill.half**2)[:, None])
    assert abs(mass.sum() / side**2 - 1.0) < 1e-12
    assert np.all(mass[grid.owner() != np.arange(grid.node_count)] == 0.0)


def test_filling_counts_every_cell_once_with_hole_and_ring() -> None:
    overlap = Overlap.between(((3.5, 5.875), (3.625, 6.0)), ((3.1, 5.6), (3.9, 6.4)), 0.1)
    fill = cut_overlaps(fill_hierarchy(GRID, (0.0, 3.0), (8.5, 9.0), 3), [overlap])
    area = 4.0 * fill.half**2
    assert abs(area.sum() - (8.5 * 6.0 - 0.125**2)) < 1e-12
    ring = 0.8 * 0.8 - 0.125**2
    assert abs((fill.weight * area).sum() - (8.5 * 6.0 - 0.125**2 - 0.9 * ring)) < 1e-12
    # No two domains overlap and none is left out: each point of a fine raster lies in exactly one domain.
    raster = np.stack(np.meshgrid(np.arange(2.9, 4.1, 0.037) + 1e-4, np.arange(5.3, 6.7, 0.041) + 1e-4), -1).reshape(
        -1, 2
    )
    covered = np.all(np.abs(raster[:, None] - fill.position) < fill.half[:, None], axis=2).sum(axis=1)
    in_hole = np.all((raster > (3.5, 5.875)) & (raster < (3.625, 6.0)), axis=1)
    assert in_hole.sum() > 3
    assert np.array_equal(covered, np.where(in_hole, 0, 1))


def test_edges_that_cut_cells_are_refused_with_the_nearest_allowed() -> None:
    with pytest.raises(ValueError, match=r"body lower\[0\] = 0\.2 m: cuts cells of level 0.*allowed value is 0\.0 m"):
        fill_hierarchy(GRID, (0.2, 3.0), (8.5, 9.0))
    with pytest.raises(ValueError, match=r"body upper\[1\] = 6\.3125 m: cuts cells of level 0"):
        fill_hierarchy(GRID, (0.0, 3.0), (8.5, 6.3125))
    with pytest.raises(ValueError, match=r"upper\[1\] = 2\.0 m: must lie above"):
        fill_hierarchy(GRID, (0.0, 3.0), (8.5, 2.0))
    with pytest.raises(ValueError, match="leaves the grid"):
        fill_hierarchy(GRID, (-1.5, 3.0), (8.5, 9.0))
    # An edge may lie on a line of the level it runs in alone.
    fill = fill_hierarchy(GRID, (3.0625, 5.5625), (3.9375, 6.0))
    assert set(GRID.level_of(fill.position).tolist()) == {3}
    assert abs((4.0 * fill.half**2).sum() - 0.875 * 0.4375) < 1e-14


def crossing_points() -> np.ndarray:
    """Deformed, moving points with the size of level 0, at places of all levels."""
    rng = np.random.default_rng(11)
    rows = rng.standard_normal((40, COLUMNS))
    rows[:, :2] = (1.5, 4.5) + rng.random((40, 2)) * (5.0, 3.0)
    rows[:, HXX : HYY + 1] *= 0.2
    rows[:, HALF] = 0.125
    rows[:, MASS] = 0.1 + rng.random(40)
    rows[:, VOLUME] = 0.1 + rng.random(40)
    return rows


def test_splitting_keeps_mass_momentum_energy_and_angular_momentum() -> None:
    rows = crossing_points()
    before = rows.copy()
    parent = find_oversized(GRID.arrays, rows, 0, 40, 2)
    assert parent.size == 40
    split = split_points(rows, parent)
    assert np.array_equal(rows, before)
    children = split.rows
    old = rows[parent]
    for column in (MASS, VOLUME):
        assert np.array_equal(children[:, :, column].sum(axis=1), old[:, column])
    m, v, x = children[:, :, MASS, None], children[:, :, VX : VY + 1], children[:, :, :2]
    assert np.array_equal((m * v).sum(axis=1), old[:, MASS, None] * old[:, VX : VY + 1])
    assert np.array_equal((m * (v * v)).sum(axis=1), old[:, MASS, None] * old[:, VX : VY + 1] ** 2)
    spin = (m[..., 0] * (x[..., 0] * v[..., 1] - x[..., 1] * v[..., 0])).sum(axis=1)
    old_spin = old[:, MASS] * (old[:, X] * old[:, VY] - old[:, Y] * old[:, VX])
    assert np.abs(spin - old_spin).max() < 1e-13
    # Deformation and stress unchanged, so V0 W(F) summed over four quarters of the volume is the parent's.
    unchanged = [c for c in range(COLUMNS) if c not in (X, Y, MASS, VOLUME, HALF)]
    assert np.array_equal(children[:, :, unchanged], np.repeat(old[:, None, unchanged], 4, axis=1))
    # Places: F applied to the quarters' centres, which tile the reference square.
    deformation = np.eye(2) + old[:, HXX : HYY + 1].reshape(-1, 2, 2)
    assert np.abs(x - old[:, None, :2] - np.einsum("pij,pcj->pci", deformation, split.reference_offset)).max() < 1e-14
    assert np.array_equal(
        np.sort(split.reference_offset[0], axis=0), 0.0625 * np.array([[-1, -1], [-1, -1], [1, 1], [1, 1]])
    )


def test_split_points_fit_their_level_after_as_many_calls_as_levels_crossed() -> None:
    rows = crossing_points()[:1]
    rows[0, [X, Y]] = (3.5, 6.0)
    rows[0, HXX : HYY + 1] = 0.0
    calls = 0
    while (parent := find_oversized(GRID.arrays, rows, 0, rows.shape[0], 2)).size:
        split = split_points(rows, parent)
        rows = np.concatenate([np.delete(rows, parent, axis=0), split.rows.reshape(-1, COLUMNS)])
        calls += 1
    assert calls == 3
    assert rows.shape[0] == 64
    assert np.allclose(rows[:, HALF], 0.0625 / 4)
    assert np.ptp(rows[:, :2] - (3.5, 6.0), axis=0) == pytest.approx([0.25 - 0.03125] * 2)
    # Fine points among coarse cells, and points that fit, stay.
    rows[:, X] += 4.0
    assert find_oversized(GRID.arrays, rows, 0, rows.shape[0], 2).size == 0


def reflected_share(wavelength: float, towards: int, refined: bool = True) -> float:
    """Backward wave over the forward one after a wave packet met a 2:1 border; lengths in coarse cells.

    Points held at their places (plane strain, longitudinal modulus and density one, nu = 1/4), lumped mass, central
    differences at a fifth of the stable step: what is left is the grid. ``towards`` is 1 from coarse to fine.
    """
    reach = 2.0 * wavelength
    high, border = 4, int(2.0 * reach) + 12
    grid = Grid((-4.0, -8.0), 1.0, (2 * border + 8, 20))
    fine = [((border, -6.0), (2.0 * border + 2.0, 10.0))] if refined else []
    nested = HierarchicalGrid(grid, fine)
    fill = fill_hierarchy(nested, (0.0, 0.0), (2.0 * border, high))
    s = hierarchy_stencils(nested, fill.position, fill.half[:, None])
    area = 4.0 * fill.half**2
    shape = (fill.half.size, nested.node_count)
    index = (np.repeat(np.arange(shape[0]), s.node.shape[1]), s.node.ravel())
    weight, along, across = (
        csr_matrix((v.ravel(), index), shape=shape) for v in (s.weight, s.gradient[:, :, 0], s.gradient[:, :, 1])
    )
    mass = weight.T @ area
    inverse = np.where(mass > 0.0, 1.0 / np.where(mass > 0.0, mass, 1.0), 0.0)[:, None]
    # Strains xx, yy, xy of all points from the displacements of all nodes; stress = modulus * strain.
    modulus = np.array([[1.0, 1.0 / 3.0, 0.0], [1.0 / 3.0, 1.0, 0.0], [0.0, 0.0, 1.0 / 3.0]])
    place = nested.node_positions()
    held = (place[:, 1] == 0.0) | (place[:, 1] == high)

    def acceleration(u: np.ndarray) -> np.ndarray:
        strain = np.stack([along @ u[:, 0], across @ u[:, 1], across @ u[:, 0] + along @ u[:, 1]], axis=1)
        stress = area[:, None] * (strain @ modulus)
        a = -inverse * np.stack(
            [along.T @ stress[:, 0] + across.T @ stress[:, 2], across.T @ stress[:, 1] + along.T @ stress[:, 2]], axis=1
        )
        a[held, 1] = 0.0
        return a

    start = border - towards * (reach + 4.0)

    def packet(time: float) -> np.ndarray:
        at = place[:, 0] - start - towards * time
        window = np.where(np.abs(at) < reach, np.cos(0.5 * np.pi * at / reach) ** 2, 0.0)
        return np.stack([window * np.sin(2.0 * np.pi * at / wavelength), np.zeros_like(at)], axis=1)

    dt = 0.1
    u = packet(0.0)
    velocity = (u - packet(-dt)) / dt  # of the half step before, as the leapfrog wants it
    for _ in range(int((2.0 * reach + 8.0) / dt)):
        velocity += dt * acceleration(u)
        u += dt * velocity
    rate = weight @ (velocity[:, 0] + 0.5 * dt * acceleration(u)[:, 0])
    strain = along @ u[:, 0]
    incoming_side = towards * (fill.position[:, 0] - border) < -2.0
    backward = np.abs(rate + towards * strain)[incoming_side].max()
    return float(backward / np.abs(rate - towards * strain).max())


@pytest.mark.parametrize("towards", [1, -1])
def test_little_of_a_wave_of_20_coarse_cells_is_reflected(towards: int) -> None:
    assert reflected_share(20.0, towards) < 0.01
